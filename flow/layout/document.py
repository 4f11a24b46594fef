# SPDX-License-Identifier: Apache-2.0
"""The page of `make layout`: routed and placed blocks with their size, rules, timing, and simulation with wires."""

from collections.abc import Callable, Iterable
from pathlib import Path

from PIL import Image

from ...hdl.front_end_views import POLYPHASE, VIEWS, View
from ...hdl.minigroup import Minigroup
from ...hdl.silicon.minigroup import AsyncMinigroup
from ...hdl.subgroup import Subgroup
from ...hdl.tree import CoincidenceTree
from ...hdl.unit import Unit
from ...model.contract.config import load_config
from ...model.contract.parameters import Sensor
from ...model.shared.files import whole_file
from ...tb.rtl_errors import Mismatch
from ..mapped import map_block, slacks_ns
from . import hierarchy
from .buffers import FANOUT_MAX
from .delays import INPUT_NS, simulate
from .flow import FINAL, Layout, lay_out
from .hierarchy import DETOUR

PAGE = Path(__file__).with_name("page.md")
PICTURE, PREFIX = "layout-{}.png", "coincid_"
SMALL = Sensor(rows=8, cols=8)  # simulated with delays: 16 minigroups
COLOURS = 32  # number of colours in the picture
TOO_SLOW = 6.0  # factor on all delays; the sensor must fail with it


def write_page(path: Path, tell: Callable[[str], None]) -> None:
    """Lay out blocks of the preset `silicon`. Write the page to `path`, and pictures to the folder `images` beside it."""
    config = load_config("silicon")
    clock_ns = 1000 / config.clock_mhz
    units: list[tuple[Unit, View]] = [(Minigroup(config.sensor), POLYPHASE)]
    units.append((AsyncMinigroup(config.sensor), VIEWS["async"].at(config.clock_mhz)))
    layouts = [lay_out(unit, config.clock_mhz, tell, view) for unit, view in units]
    mapped = [map_block(unit, view, gated=False) for unit, view in units]
    slacks = [min(slacks_ns(block.folder, block.name, clock_ns).values()) for block in mapped]
    placed = [
        hierarchy.lay_out(unit, units[0][0], layouts[0], config.clock_mhz, tell)
        for unit in (CoincidenceTree(config.sensor), Subgroup(config.sensor))
    ]
    small = Minigroup(SMALL), AsyncMinigroup(SMALL)
    played = [
        played_with_delays(unit, view, layout, tell)
        for unit, (_, view), layout in zip(small, units, layouts, strict=True)
    ]
    tell("simulating the sensor with the placed subgroup and its delays")
    subgroup_checked, subgroup_cycles = simulate(SMALL, Subgroup(SMALL), placed[1].folder)
    text = PAGE.read_text().format(
        subgroup_checked=subgroup_checked,
        subgroup_cycles=subgroup_cycles,
        gds=FINAL,
        rows=_table(facts(layout, block.area_um2) for layout, block in zip(layouts, mapped)),
        layouts=layouts,
        slacks=slacks,
        tree=placed[0],
        subgroup=placed[1],
        clock=clock_ns,
        rules=_table([(name, str(found)) for name, found in layout.rules] for layout in layouts),
        played=_table(played),
        fanout=FANOUT_MAX,
        detour=DETOUR,
        factor=TOO_SLOW,
        input=INPUT_NS,
    )
    images = path.parent / "images"
    images.mkdir(exist_ok=True)
    for (unit, _), layout in zip(units, layouts):
        picture = Image.open(layout.folder / f"{unit.unit_name}.png").convert("RGB").quantize(COLOURS)
        with whole_file(images / PICTURE.format(unit.unit_name.removeprefix(PREFIX))) as file:
            picture.save(file, format="png", optimize=True)
    with whole_file(path, "w") as file:
        file.write(text)


def played_with_delays(
    unit: Minigroup, view: View, layout: Layout, tell: Callable[[str], None]
) -> list[tuple[str, str]]:
    """Simulate a layout with its delays, then with delays `TOO_SLOW` times as long, which must fail. Raises `Mismatch`."""
    tell(f"{unit.unit_name}: simulating the sensor with the routed minigroups and their delays")
    checked, cycles = simulate(SMALL, unit, layout.folder, view=view)
    try:
        simulate(SMALL, unit, layout.folder, TOO_SLOW, view)
    except Mismatch:
        return [("words and commits", str(checked)), ("cycles", str(cycles)), ("mismatches", "0")]
    raise Mismatch(f"the sensor passes with delays {TOO_SLOW:g} times as long, so the delays have no effect")


def _table(columns: Iterable[list[tuple[str, str]]]) -> str:
    """Return rows of Markdown from columns with the same names."""
    first, *others = columns
    values = [dict(column) for column in others]
    return "\n".join(f"| {' | '.join([name, value, *(column[name] for column in values)])} |" for name, value in first)


def facts(layout: Layout, mapped_um2: float) -> list[tuple[str, str]]:
    """Return the names and values of the page's first table."""
    area = layout.width_um * layout.height_um
    return [
        ("cells before layout, um2", f"{mapped_um2:,.0f}"),
        ("cells with the clock tree", str(layout.cells)),
        ("their area, um2", f"{layout.cell_area_um2:,.0f}"),
        ("buffers of the clock tree", str(layout.buffers)),
        ("power of the clock tree, without the flip-flops' pins, mW", f"{layout.clock_tree_mw:.2f}"),
        ("block, um", f"{layout.width_um:.1f} x {layout.height_um:.1f}"),
        ("block, um2", f"{area:,.0f}"),
        ("share of the block that cells cover", f"{layout.cell_area_um2 / area:.0%}"),
        ("nets", str(layout.nets)),
        ("wire, mm", f"{layout.wire_um / 1000:.2f}"),
        ("wire for each input that it reaches, um", f"{layout.wire_um / layout.sinks:.1f}"),
        ("capacitance of the wires, fF", f"{layout.wire_ff:.0f}"),
        ("capacitance for each such input, fF", f"{layout.wire_ff / layout.sinks:.2f}"),
    ]
