# SPDX-License-Identifier: Apache-2.0
"""Measures what counts cost in standard cells: area, with and without a macro for the memory, and
power.

The power of a frame is that of its three steps and of its two searches. A frame with few pulses in
step 3 and one with more differ only in these pulses. So their difference is the energy of a pulse,
and the rest of the short frame is the energy of the searches.
"""

from collections.abc import Sequence
from functools import partial
from typing import Any, NamedTuple

from attrs import evolve

from coincid.flow.mapped import Mapped, map_block, slacks_ns
from coincid.hdl.gate_search import GateSearch
from coincid.hdl.memory import Memory
from coincid.hdl.minigroup_counts import MinigroupCounts
from coincid.hdl.subgroup import Subgroup
from coincid.model.contract import counts
from coincid.model.contract.packet import COUNTS
from coincid.model.contract.parameters import CLOCK_MHZ, Sensor
from coincid.model.shared.markdown import text_table
from coincid.tools.pages import put

from .power_against_light import MIDDLE, measure, setup

PAGE = "docs/counts.md"
MACRO_UM2 = 1000.0  # of an 8 x 64 memory with its periphery, 2 um2 per bit: an assumption
# Nothing for events but the smallest that the parameters allow.
LEAN = {"fifo_depth": 1, "offsets": 0, "records": 0, "controller": 0, "counter_bits": 9, "held": 0}
SENSORS: dict[str, dict[str, Any]] = {
    "`silicon`, events only": {},
    "`silicon` with counts": {"counts": 1},
    "as little as possible for events": LEAN,
    "the same with counts": LEAN | {"counts": 1},
}
CASE = MIDDLE
# A quarter of a subgroup: the netlist plays the searches, which takes hours in a whole one.
QUARTER = {"rows": 4, "cols": 4, "subgroup": [4, 4]}
SHORT_PULSES, LONG_PULSES = 3, 11  # of a frame; one in each step, or nine in step 3
VIDEO_HZ, VIDEO_PULSES = 30, 1000


def area_table() -> str:
    """Return the area of subgroups with and without counts, as Markdown."""
    rows = []
    memory = map_block(Memory(counts.ROWS, counts.ROW_BITS)).area_um2
    for name, parameters in SENSORS.items():
        sensor = Sensor(**parameters)
        block = map_block(Subgroup(sensor))
        number = sensor.minigroups * sensor.counts
        with_macros = block.area_um2 + number * (MACRO_UM2 - memory)
        slack = slacks_ns(block.folder, block.name, 1e3 / CLOCK_MHZ)
        rows.append(
            (
                name,
                f"{block.area_um2:,.0f}",
                f"{block.area_um2 / sensor.pixels:,.0f}",
                f"{with_macros / sensor.pixels:,.0f}" if number else "",
                f"{(with_macros / sensor.pixels) ** 0.5:.1f}",
                f"{min(slack.values()):+.2f}",
            )
        )
    heads = (
        "subgroup of 8 x 8 pixels",
        "um2",
        "um2 per pixel",
        "with macros",
        "pitch um",
        "slack ns",
    )
    return text_table(heads, rows)


def block_table() -> str:
    """Return the blocks of counts, as Markdown."""
    sensor = Sensor(counts=1)
    rows = [
        _block_row("counts of a minigroup", map_block(MinigroupCounts(sensor))),
        _block_row(
            "... its memory of 8 x 64 bits", map_block(Memory(counts.ROWS, counts.ROW_BITS))
        ),
        _block_row("search of a subgroup", map_block(GateSearch(sensor))),
    ]
    return text_table(("block", "cells", "flip-flops", "latches", "um2"), rows)


def _block_row(name: str, block: Mapped) -> tuple[str, ...]:
    cells = block.cells
    flops = sum(n for cell, n in cells.items() if cell.startswith("DFF"))
    latches = sum(n for cell, n in cells.items() if cell.startswith("DLH"))
    return name, f"{sum(cells.values()):,}", f"{flops}", f"{latches}", f"{block.area_um2:,.0f}"


class Energy(NamedTuple):
    """Energy of a frame, in nJ per pixel."""

    pulse: float
    searches: float


def energy(form: str) -> Energy:
    """Return the energy of a pulse, and of both searches."""
    short, long = (_frame_nj(form, pulses) for pulses in (SHORT_PULSES, LONG_PULSES))
    pulse = (long - short) / (LONG_PULSES - SHORT_PULSES)
    return Energy(pulse, short - SHORT_PULSES * pulse)


def _frame_nj(form: str, pulses: int) -> float:
    """Return the energy of a frame of so many pulses, in nJ per pixel."""
    sensor = QUARTER | {"counts": int(form == COUNTS.name)}
    case = evolve(CASE, frame={"format": form, "pulses": pulses})
    (measured,), _ = measure(partial(print, flush=True), [case], **sensor)
    config = setup(case, **sensor).config
    return measured.total.total * config.frame_cycles / CLOCK_MHZ / config.sensor.pixels


def power_table() -> str:
    """Return the energy and power of a pixel with events and with counts, as Markdown."""
    rows: list[Sequence[str]] = []
    for form in ("id", COUNTS.name):
        found = energy(form)
        frame_nj = VIDEO_PULSES * found.pulse
        searches = ""
        if form == COUNTS.name:
            frame_nj += found.searches
            searches = f"{found.searches:.2f}"
        mean_uw = frame_nj * VIDEO_HZ * 1e-3
        rows.append((f"`{form}`", f"{1e3 * found.pulse:.1f}", searches, f"{mean_uw:.2f}"))
    heads = ("format", "pJ per pulse", "nJ for both searches", "uW at 30 frames/s of 1000 pulses")
    return text_table(heads, rows)


def make_area() -> None:
    """Write the areas into the page."""
    put(PAGE, "area", f"{area_table()}\n\n{block_table()}")


def make_power() -> None:
    """Write the power into the page."""
    put(PAGE, "power of counts", power_table())


if __name__ == "__main__":
    make_area()
    make_power()
