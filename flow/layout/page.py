# SPDX-License-Identifier: Apache-2.0
"""The page of `make layout`: what was laid out, which rules hold, timing and simulation with wires, and what is not there."""

from collections.abc import Callable
from pathlib import Path

from PIL import Image

from ...hdl.minigroup import Minigroup
from ...model.contract.config import load_config
from ...model.contract.parameters import Sensor
from ...model.shared.files import whole_file
from ...tb.errors import Mismatch
from ..mapped import map_block, slack_ns
from .delays import INPUT_NS, simulate
from .flow import FINAL, Layout, lay_out

PICTURE = "layout-minigroup.png"
SMALL = Sensor(rows=8, cols=8)  # of the simulation: 16 minigroups
COLOURS = 32  # of the picture
TOO_SLOW = 4.0  # factor on all delays that no cycle has room for


def write_page(path: Path, tell: Callable[[str], None]) -> None:
    """Lays the silicon preset's minigroup out and writes what came of it, and the picture to `images/` beside the page."""
    config = load_config("silicon")
    unit, clock_ns = Minigroup(config.sensor), 1000 / config.clock_mhz
    layout = lay_out(unit, config.clock_mhz, tell)
    mapped = map_block(unit)
    tell("simulating the sensor with the routed minigroups and their delays")
    checked, cycles = simulate(SMALL, Minigroup(SMALL), layout)
    broken = breaks(Minigroup(SMALL), layout)
    if not broken:
        raise Mismatch(f"delays of {TOO_SLOW:g} times the layout's change nothing: they are not in force")
    text = PAGE.format(
        gds=FINAL,
        picture=PICTURE,
        rows="\n".join(f"| {name} | {value} |" for name, value in facts(layout, mapped.area_um2)),
        slack=slack_ns(mapped.folder, unit.unit_name, clock_ns),
        routed_slack=layout.slack_ns,
        hold=layout.hold_ns,
        clock=clock_ns,
        rules="\n".join(f"| {name} | {found} |" for name, found in layout.rules),
        checked=checked,
        cycles=cycles,
        factor=TOO_SLOW,
        input=INPUT_NS,
    )
    images = path.parent / "images"
    images.mkdir(exist_ok=True)
    picture = Image.open(layout.folder / f"{unit.unit_name}.png").convert("RGB").quantize(COLOURS)
    with whole_file(images / PICTURE) as file:
        picture.save(file, format="png", optimize=True)
    with whole_file(path, "w") as file:
        file.write(text)


def breaks(unit: Minigroup, layout: Layout) -> bool:
    """Whether the bench fails with much longer delays, as it must where the delays are in force."""
    try:
        simulate(SMALL, unit, layout, TOO_SLOW)
    except Mismatch:
        return True
    return False


def facts(layout: Layout, mapped_um2: float) -> list[tuple[str, str]]:
    """The rows of the page's first table."""
    area = layout.width_um * layout.height_um
    return [
        ("cells before layout", f"{mapped_um2:,.0f} um2"),
        ("cells, clock tree and buffers included", f"{layout.cells}, {layout.cell_area_um2:,.0f} um2"),
        ("buffers of the clock tree", str(layout.buffers)),
        ("power of the clock tree, without the flip-flops' pins", f"{layout.clock_tree_mw:.2f} mW"),
        ("block", f"{layout.width_um:.1f} x {layout.height_um:.1f} um, {area:,.0f} um2"),
        ("share of the block that cells cover", f"{layout.cell_area_um2 / area:.0%}"),
        ("nets", str(layout.nets)),
        (
            "wire",
            f"{layout.wire_um / 1000:.2f} mm, {layout.wire_um / layout.sinks:.1f} um for each input that it reaches",
        ),
        (
            "capacitance of the wires",
            f"{layout.wire_ff:.0f} fF, {layout.wire_ff / layout.sinks:.2f} fF for each such input",
        ),
    ]


PAGE = """\
# Layout of a minigroup

Written by `make layout`, which takes about two minutes: the minigroup of the preset `silicon`
(2 x 2 pixels, 32 phases), polyphase view, in NanGate 45 nm cells. Yosys maps it, Coriolis places
it, builds its clock tree and routes it, KLayout merges the cells' own layouts and checks the
result, OpenSTA times it. What it means for the sensor is in [silicon.md](silicon.md).

![The routed minigroup](images/{picture})

The picture shows the routed block: cells (dark), metal3 (green), metal4 (orange), metal5 and
metal6. `{gds}` in the build folder is its GDS.

| | |
| --- | ---: |
{rows}

Cells cover so little because the router stops a few nets short of the end where pins are denser.
Every cell is widened until each of its pins has room; fillers take that room in the end.

## Checks

Opens: 0. Shorts: 0. The wires (metal2 to metal6) are extracted from the GDS and compared with the
placed netlist, pin by pin; the flow fails on any difference.

| rule | violations |
| --- | ---: |
{rules}

Values are those of the cells' LEF file, for wires of least width. Not checked: rules for wide
metal, area and density rules, antennas, wells and everything below metal1 (the cells' own), the
supply: rows share rails of metal1, and there is no power mesh above them.

## Timing

| path between registers, cycle of {clock:g} ns | slack in ns |
| --- | ---: |
| longest, before layout: no wires, ideal clock | {slack:+.2f} |
| longest, with wires and clock tree | {routed_slack:+.2f} |
| shortest (hold), with wires and clock tree | {hold:+.2f} |

The longest path is the half cycle to the latches of the record's stamp. A wire's capacitance is
that of its length on each metal, its resistance that of the direct way to each pin. Coupling
between wires is not in it, nor any corner except the typical one.

## Simulation

OpenSTA writes the delays as SDF. A sensor of 8 x 8 pixels, whose 16 minigroups are the routed
netlist with these delays, plays the random frames of `make gls` on Icarus: {checked} words and commits in
{cycles} cycles, 0 mismatches. Inputs of a minigroup come {input:g} ns after the clock's edge, as from
flip-flops. With all delays {factor:g} times as long the same bench fails, so the delays are in force.
Icarus ignores two parts of the SDF: delays of single wires, and setup and hold checks.

## What is not there

* The minigroup of the asynchronous view: its macros have no layout.
* Tree and subgroup. Flat, they place, and do not route in an hour. They would need minigroups as
  macros, with pins at their borders.
"""
