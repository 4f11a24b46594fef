# SPDX-License-Identifier: Apache-2.0
"""The page of `make layout`: routed minigroups with their size, rules, timing, and simulation
with wires.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Any

from PIL import Image

from ...hdl.front_end_views import VIEWS, View
from ...hdl.unit import Unit
from ...model.contract.config import load_config
from ...model.contract.parameters import Sensor
from ...model.shared.files import whole_file
from ...tb.rtl_errors import Mismatch
from ...tools.pages import picture, put, put_page
from ..mapped import map_block, slacks_ns
from .delays import INPUT_NS, play_with_delays
from .flow import FINAL, lay_out

PAGE = Path(__file__).with_name("page.md")
PICTURE, PREFIX = "layout-{}.png", "coincid_"
SMALL = Sensor(rows=8, cols=8)  # simulated with delays: 16 minigroups
COLOURS = 32  # number of colours in the picture
TOO_SLOW = 6.0  # factor on all delays; the sensor must fail with it
Column = list[tuple[str, str]]  # name and value of every row


def write_layout_page(out: Path | None = None, tell: Callable[[str], None] = print) -> None:
    """Lay out both minigroups of the preset `silicon`.

    Write docs/layout.md and its pictures, or the page to the file `out` and pictures to the
    folder `images` beside it.
    """
    config = load_config("silicon")
    clock_mhz = config.clock_mhz
    images = out.parent / "images" if out else picture("docs/images")
    columns = []
    for view in VIEWS.values():
        view = view.at(clock_mhz)
        unit = view.minigroup(config.sensor)
        folder, found = lay_out(unit, clock_mhz, tell, view)
        before = map_block(unit, view, gated=False)
        slack_ns = min(slacks_ns(before.folder, before.name, 1000 / clock_mhz).values())
        rules = [(rule, str(violations)) for rule, violations in found["rules"]]
        played = played_with_delays(view.minigroup(SMALL), view, folder, tell)
        columns.append((facts(found, before.area_um2), rules, slacks(found, slack_ns), played))
        routed = Image.open(folder / f"{unit.unit_name}.png").convert("RGB").quantize(COLOURS)
        with whole_file(images / PICTURE.format(unit.unit_name.removeprefix(PREFIX))) as file:
            routed.save(file, format="png", optimize=True)
    tables = dict(
        zip(
            ("rows", "rules", "slacks", "played"),
            (_rows(*pair) for pair in zip(*columns, strict=True)),
            strict=True,
        )
    )
    text = PAGE.read_text(encoding="utf-8").format(
        gds=FINAL, clock=1000 / clock_mhz, factor=TOO_SLOW, input=INPUT_NS, **tables
    )
    put_page("docs/layout.md", "layout", text, out)
    if out is None:
        put("docs/silicon.md", "layout")


def played_with_delays(unit: Unit, view: View, folder: Path, tell: Callable[[str], None]) -> Column:
    """Simulate a layout with its delays, then with delays `TOO_SLOW` times as long, which must
    fail. Raises `Mismatch`.
    """
    tell(f"{unit.unit_name}: simulating the sensor with the routed minigroups and their delays")
    checked, cycles = play_with_delays(SMALL, unit, folder, 1.0, view)
    try:
        play_with_delays(SMALL, unit, folder, TOO_SLOW, view)
    except Mismatch:
        return [("words and commits", str(checked)), ("cycles", str(cycles)), ("mismatches", "0")]
    raise Mismatch(
        f"the sensor passes with delays {TOO_SLOW:g} times as long, so the delays have no effect"
    )


def _rows(first: Column, second: Column) -> str:
    """Return rows of Markdown from two columns with the same names."""
    return "\n".join(f"| {name} | {value} | {dict(second)[name]} |" for name, value in first)


def facts(found: dict[str, Any], mapped_um2: float) -> Column:
    """Return the names and values of the page's first table."""
    area = found["width_um"] * found["height_um"]
    return [
        ("cells before layout, um2", f"{mapped_um2:,.0f}"),
        ("cells with the clock tree", str(found["cells"])),
        ("their area, um2", f"{found['cell_area_um2']:,.0f}"),
        ("buffers of the clock tree", str(found["buffers"])),
        (
            "power of the clock tree, without the flip-flops' pins, mW",
            f"{found['clock_tree_mw']:.2f}",
        ),
        ("block, um", f"{found['width_um']:.1f} x {found['height_um']:.1f}"),
        ("block, um2", f"{area:,.0f}"),
        ("share of the block that cells cover", f"{found['cell_area_um2'] / area:.0%}"),
        ("nets", str(found["nets"])),
        ("wire, mm", f"{found['wire_um'] / 1000:.2f}"),
        ("wire for each input that it reaches, um", f"{found['wire_um'] / found['sinks']:.1f}"),
        ("capacitance of the wires, fF", f"{found['wire_ff']:.0f}"),
        ("capacitance for each such input, fF", f"{found['wire_ff'] / found['sinks']:.2f}"),
    ]


def slacks(found: dict[str, Any], mapped_ns: float) -> Column:
    """Return the names and values of the table of slacks."""
    return [
        ("longest, before layout: no wires, ideal clock", f"{mapped_ns:+.2f}"),
        ("longest, with wires and clock tree", f"{found['slack_ns']:+.2f}"),
        ("shortest (hold), with wires and clock tree", f"{found['hold_ns']:+.2f}"),
    ]
