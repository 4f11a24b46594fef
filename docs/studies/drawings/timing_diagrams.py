# SPDX-License-Identifier: Apache-2.0
"""Draws the timing diagrams of docs/integrate.md from a simulation of the RTL, 8 x 8 pixels, in
Amaranth's simulator.

python -m docs.studies.drawings.timing_diagrams
"""

from collections.abc import Callable, Sequence

import matplotlib.pyplot as plt
import numpy as np
from amaranth.sim import SimulatorContext
from attrs import frozen
from matplotlib.figure import Figure

from coincid.hdl.axi import OKAY
from coincid.hdl.sensor import SensorTop
from coincid.model.contract import registers
from coincid.model.contract.config import parse_config
from coincid.model.contract.packet import FORMATS, FRAME_END, FRAME_START, GROUP_KIND, header_field
from coincid.study.palette import DEEP_INK, FAINT, NOISE, SIGNAL
from coincid.tb.pysim import write_register
from coincid.tools.pages import put

from . import save
from .waveform import PHASES, draw_boxes, draw_grid, finish, recorded_signals

EDGES = (  # (pixel, cycle, phase)
    (9, 0, 22),
    (10, 0, 25),
    (18, 0, 30),
    (37, 3, 4),
    (5, 10, 1),
    (6, 10, 2),
)
STALLED = range(26, 33)  # cycles of the frame in which `tready` is low
PERIOD, BAD_THRESHOLD = 24, 0
KINDS = {FRAME_START.code: "S", FORMATS["id"].code: "E", GROUP_KIND: "G", FRAME_END.code: "F"}
Trace = dict[str, list[int]]  # port -> value in each cycle


async def three_accesses(ctx: SimulatorContext, sensor: SensorTop) -> None:
    """Write and read a register, then try an illegal write."""
    await ctx.tick().repeat(4)
    threshold = registers.address("threshold")
    await write_register(ctx, sensor, threshold, 2)
    await ctx.tick()
    ctx.set(sensor.s_axi.araddr, threshold)
    ctx.set(sensor.s_axi.arvalid, 1)
    await ctx.tick().until(sensor.s_axi.arready)
    ctx.set(sensor.s_axi.arvalid, 0)
    await ctx.tick().until(sensor.s_axi.rvalid)
    await ctx.tick()
    await write_register(ctx, sensor, threshold, BAD_THRESHOLD)
    await ctx.tick()


def traced(form: str) -> Trace:
    """Play `three_accesses`, then a frame of two laser periods. form: format of its events."""
    config = parse_config(
        {
            "sensor": {"rows": 8, "cols": 8, "phases": PHASES},
            "frame": {"period": PERIOD, "pulses": 2, "format": form},
            "subgroup": {"threshold": 2},
        }
    )
    ports = {name: name for name in SensorTop(config.sensor).flat_ports()}
    return recorded_signals(config, EDGES, ports, three_accesses, STALLED)


def frame_of(trace: Trace) -> int:
    """Return the cycle in which the frame begins."""
    return trace["laser"].index(1)


def accesses_of(trace: Trace) -> list[int]:
    """Return the last cycle before each register access."""
    begun = np.maximum(trace["s_axi_awvalid"], trace["s_axi_arvalid"])
    return np.flatnonzero(np.diff(begun) == 1).tolist()


def draw(lines: Sequence[tuple[str, Sequence[object], str]], title: str, first: int = 0) -> Figure:
    """Draw a timing diagram whose first cycle has the number `first`.

    lines: name, one value per cycle (bits as bool, texts in boxes, None: nothing), note.
    """
    cycles = len(lines[0][1])
    figure, axes = plt.subplots(figsize=(12, 0.42 * len(lines) + 0.9))
    draw_grid(axes, cycles)
    for i, (name, values, note) in enumerate(lines):
        y = -float(i)
        axes.text(
            -0.3,
            y + 0.3,
            name,
            ha="right",
            va="center",
            color=DEEP_INK,
            fontsize=9,
            family="monospace",
        )
        axes.text(cycles + 0.3, y + 0.3, note, ha="left", va="center", color=NOISE, fontsize=8.5)
        if isinstance(values[0], bool):
            edges, bits = np.arange(cycles + 1), y + 0.6 * np.array([*values, values[-1]], int)
            axes.step(edges, bits, where="post", color=DEEP_INK, lw=1.3)
            axes.fill_between(edges, y, bits, step="post", color=DEEP_INK, alpha=0.15, lw=0)
        else:
            axes.plot([0, cycles], [y + 0.3] * 2, color=FAINT, lw=1.2, zorder=0)
            draw_boxes(axes, y, values, SIGNAL, fontsize=7.5)
    axes.set_xlim(-3.2, cycles + 6.5)
    axes.set_ylim(-len(lines) + 0.6, 0.9)
    step = 1 if cycles <= 30 else 2
    numbered = np.arange(-first % step, cycles, step)
    axes.set_xticks(numbered + 0.5, [str(first + cycle) for cycle in numbered])
    finish(figure, axes, title, 8)
    return figure


@frozen
class Picture:
    """A diagram. form: format of the events. span: returns the first cycle, the one after the last,
    and the one with number 0.

    lines: (name, note) of each line, see `values`; EVENT in a note stands for the fields of the
    frame's first event.
    """

    form: str
    title: str
    span: Callable[[Trace], tuple[int, int, int]]
    lines: Sequence[tuple[str, str]]

    def __call__(self, trace: Trace) -> Figure:
        begin, end, zero = self.span(trace)
        event = next((beat for beat in _beats(trace) if beat is not None and _kind(beat) == "E"), 0)
        told = ", ".join(
            f"{name} {int(header_field(event, name))}" for name in ("stamp", "count", "winner")
        )
        lines = [
            (name, values(trace, name, begin, end), note.replace("EVENT", told))
            for name, note in self.lines
        ]
        return draw(lines, self.title, begin - zero)


def values(trace: Trace, name: str, begin: int, end: int) -> Sequence[object]:
    """Return the content of a line in each cycle: bits of a port, texts of a valid bus, or a number
    of edges.
    """
    if name == "cycle":
        frame = frame_of(trace)
        return [
            str((cycle - frame) % PERIOD) if cycle >= frame else None for cycle in range(begin, end)
        ]
    if name == "tdata":
        return _packets(trace, begin, end)

    def of(port: str) -> list[int]:
        (whole,) = {port, f"s_axi_{port}", f"m_axis_{port}"} & trace.keys()
        return trace[whole][begin:end]

    if name == "spad_0":
        return [str(word.bit_count()) if word else None for word in of(name)]
    if name in BUSES:
        valid, told = BUSES[name]
        return [told(value) if on else None for value, on in zip(of(name), of(valid), strict=True)]
    return [bool(value) for value in of(name)]


def _beats(trace: Trace) -> list[int | None]:
    """Return the word on offer in each cycle, None without one."""
    return [
        data if valid else None
        for data, valid in zip(trace["m_axis_tdata"], trace["m_axis_tvalid"], strict=True)
    ]


def _kind(beat: int) -> str:
    """Return the letter of the packet that would begin with this beat."""
    return KINDS.get(int(header_field(beat, "kind")), "")


def _packets(trace: Trace, begin: int, end: int) -> list[str | None]:
    """Return the type of each beat: S frame start, E event, M map, G group, F frame end, C
    counters.

    A zero-width space marks every second beat, so that equal neighbours get separate boxes.
    """
    texts: list[str | None] = []
    following, number, open_beat, name = "", 0, False, ""
    for beat, ready in zip(_beats(trace)[:end], trace["m_axis_tready"][:end], strict=True):
        if beat is None:
            texts.append(None)
            continue
        if not open_beat:
            number += 1
            name = following or _kind(beat)
            following = {"E": "M", "F": "C", "C": "C"}.get(name, "")
        texts.append(name + "\u200b" * (number % 2))
        open_beat = not ready
    return texts[begin:]


def _after_laser(begin: int, end: int) -> Callable[[Trace], tuple[int, int, int]]:
    return lambda trace: (frame_of(trace) + begin, frame_of(trace) + end, frame_of(trace))


# Of each bus: the port that says when it is valid, and a function that formats its values.
BUSES: dict[str, tuple[str, Callable[[int], str]]] = {
    "awaddr": ("awvalid", lambda value: f"{value:x}"),
    "wdata": ("wvalid", str),
    "bresp": ("bvalid", lambda value: "OK" if value == OKAY else "ERR"),
    "rdata": ("rvalid", str),
}
PIXELS = "edges: pixels 9, 10, 18; 37 alone; 5, 6"
PICTURES = {
    "timing-register.svg": Picture(
        "id",
        "register access: a write, a read, a refused write (bready and rready are high)",
        lambda trace: (accesses_of(trace)[0] - 1, accesses_of(trace)[3], accesses_of(trace)[0] - 1),
        [
            ("awvalid", "address and data of a write may come"),
            ("awready", "in any order; each is held"),
            ("awaddr", "hexadecimal"),
            ("wvalid", ""),
            ("wdata", "threshold 2; then 0, which is illegal"),
            ("bvalid", "stays until bready"),
            ("bresp", "ERR: SLVERR, nothing has changed"),
            ("arvalid", ""),
            ("arready", ""),
            ("rvalid", "stays until rready"),
            ("rdata", ""),
        ],
    ),
    "timing-frame.svg": Picture(
        "id",
        f"frame start: periods of {PERIOD} cycles; "
        f"the edges that stand at the ports while `laser` is high have stamps below {PHASES}",
        lambda trace: (accesses_of(trace)[-1] - 1, frame_of(trace) + PERIOD + 4, frame_of(trace)),
        [
            ("awvalid", "start: 1 to control"),
            ("bvalid", ""),
            ("laser", "cycle 0 of each period"),
            ("spad_0", "edges in this cycle: pixels 9, 10, 18; 37; 5, 6"),
            ("cycle", "of the period"),
            ("tvalid", ""),
            ("tdata", "S: frame start, E: event, M: map"),
        ],
    ),
    "timing-event.svg": Picture(
        "id",
        "an event packet: three edges in cycle 0, threshold 2, format id",
        _after_laser(0, 24),
        [
            ("spad_0", PIXELS),
            ("tvalid", ""),
            ("tready", ""),
            ("tlast", "with the last beat of the frame"),
            ("tdata", "E: EVENT"),
        ],
    ),
    "timing-stall.svg": Picture(
        "id",
        "back-pressure: events wait in the output buffer and the FIFOs; what finds a FIFO full is dropped and counted",
        _after_laser(16, 40),
        [
            ("tvalid", "stays until the beat is taken"),
            ("tready", "may be low for any time"),
            ("tdata", "the beat on offer does not change"),
        ],
    ),
    "timing-group.svg": Picture(
        "compact",
        "a group: the two events of a laser pulse, packed to the bit, format compact",
        _after_laser(0, 60),
        [
            ("laser", "cycle 0 of each period"),
            ("spad_0", PIXELS),
            ("tvalid", ""),
            ("tready", ""),
            ("tdata", "S: frame start, G: group of events"),
        ],
    ),
}


def make() -> None:
    """Draw the pictures for their page."""
    traces = {form: traced(form) for form in {picture.form for picture in PICTURES.values()}}
    for name, picture in PICTURES.items():
        save(picture(traces[picture.form]), name)
        put("docs/integrate.md", name.removesuffix(".svg"))


if __name__ == "__main__":
    make()
