# SPDX-License-Identifier: Apache-2.0
"""Synthesis: cells, flip-flops, area, timing, logic depth and LUTs of every block and of the
sensor.

Every kind of block is synthesized once, and its counts are multiplied by the number of its
instances, so a run takes a minute. There are three targets: two-input gates give the logic
depth; NanGate 45 nm standard cells at the typical corner give area and, with OpenSTA, slack
without wires; ECP5 gives LUTs.
"""

import json
import math
import re
from collections import Counter, defaultdict
from collections.abc import Callable, Mapping
from importlib.metadata import version
from pathlib import Path

from attrs import frozen

from ..hdl.export import FILE_LIST, fpga_files, instantiated, verilog_files
from ..hdl.front_end_views import VIEWS, View
from ..hdl.sensor import FPGA_TOP, SensorTop, has_fpga_top
from ..hdl.subgroup import Subgroup
from ..hdl.subgroup_pair import SensorModule
from ..hdl.unit import Unit
from ..model.contract.config import Config, load_config
from ..model.contract.parameters import TOP, Sensor
from ..model.shared import markdown
from ..model.shared.folders import build_root
from ..tb.rtl import sensor_key
from ..tools.pages import put_page
from ..tools.wheels import YOSYS, yosys_once
from .liberty import cell_areas
from .logic_depth import depths
from .mapped import FLOP, GATE, LATCH, map_block, slacks_ns
from .yosys import LIBERTY, bound, cells_script, generic_script, library_files

# Script of abc for speed, which balances cuts for depth before it selects gates. The default
# script is up to twice as deep for a tenth less area.
SPEED = "+strash;ifraig;scorr;dc2;strash;if,-g,-K,6;strash;dch,-f;map,-B,0.9"
PREFIX = "coincid_"
FLOPS = re.compile(r"\$_DFF|DFF|TRELLIS_FF")
# Beginnings of the names of cells that have another form with a scan input.
SCANNED = re.compile(r"^(?:DFF|CLKGATE_)")
GATES, CELLS, ECP5 = "gates", "nangate45", "ecp5"
# Texts of the page, and above its table of whole blocks.
PAGE, WHOLE = (Path(__file__).with_name(name) for name in ("cost_page.md", "cost_whole_blocks.md"))


@frozen
class Block:
    """A kind of block in a target: the number of its instances, and the contents of one instance
    without its sub-blocks.

    cells: type -> number. area_um2: area in standard cells. levels: number of two-input gates on
    the longest path into its registers (None: unknown).
    """

    name: str
    instances: int
    cells: Mapping[str, int]
    area_um2: float = 0.0
    levels: int | None = None

    @property
    def flops(self) -> int:
        return sum(n for kind, n in self.cells.items() if FLOPS.search(kind))

    @property
    def total(self) -> int:
        """Number of cells, including flip-flops."""
        return sum(self.cells.values())

    def count(self, *kinds: str) -> int:
        """Return the number of cells of some types."""
        return sum(self.cells.get(kind, 0) for kind in kinds)


@frozen
class Netlist:
    """A synthesized sensor. folder: contains netlist.v and netlist.json. units: blocks below the
    top. blocks: by name, top first.
    """

    target: str
    folder: Path
    units: list[str]
    blocks: Mapping[str, Block]

    def total(self, what: Callable[[Block], float]) -> float:
        """Return the sum of `what(block)` over the sensor."""
        return sum(block.instances * what(block) for block in self.blocks.values())


def synthesize(sensor: Sensor, target: str, top: str = TOP) -> Netlist:
    """Return the synthesized sensor. It is made once for each state of its Verilog. Raises
    `ToolchainError`.

    In standard cells its memories consist of latches.
    """
    files = verilog_files(sensor, cells=target == CELLS)
    del files[FILE_LIST]
    if top == FPGA_TOP:
        files |= fpga_files(sensor)
        del files[f"{TOP}.v"]
    if target == CELLS:
        files = bound(files)
    units = instantiated(SensorTop(sensor, levels=top == FPGA_TOP))
    script = _script(target, list(files), top, units)
    if target == CELLS:
        files |= library_files()
    folder = yosys_once(build_root() / "synth" / f"{sensor_key(sensor)}-{target}", files, script)
    return Netlist(target, folder, units, _blocks(folder, top, units if target == GATES else []))


def _script(target: str, names: list[str], top: str, units: list[str]) -> list[str]:
    """Return the commands that map the sensor. Initial values remain only on an FPGA."""
    read = [f"read_liberty -lib {LIBERTY}"] * (target == CELLS) + [
        f"read_verilog -sv {' '.join(names)}"
    ]
    statistics = "tee -q -o stat.json stat -json" + f" -liberty {LIBERTY}" * (target == CELLS)
    end = [
        statistics,
        "write_verilog -simple-lhs -noexpr -noattr netlist.v",
        "write_json netlist.json",
    ]
    if target == ECP5:
        # its own abc9 cannot map blocks one by one
        steps = f"synth_lattice -family ecp5 -noflatten -top {top} -run"
        mapping = [
            f"hierarchy -check -top {top}",
            f"{steps} begin:map_luts",
            "abc -lut 4 -dress",
            "clean",
        ]
        mapping.append(f"{steps} map_cells:")
    elif target == CELLS:
        mapping = cells_script(top)
    else:
        mapping = [
            *generic_script(top),
            "dfflegalize -cell $_DFF_P_ x",
            f"abc -g gates -script {SPEED}",
            "opt_clean",
        ]
        end.append("design -save whole")
        for unit in units:
            end += [
                "design -load whole",
                f"hierarchy -top {unit}",
                "flatten",
                "opt_clean",
                f"write_json {unit}.json",
            ]
    return [*read, *mapping, *end]


def _blocks(folder: Path, top: str, measured: list[str]) -> dict[str, Block]:
    """Return the blocks from the statistics, in the order of the hierarchy. A FIFO of the
    library counts as part of its block.
    """
    modules = {
        name.lstrip("\\"): module
        for name, module in json.loads((folder / "stat.json").read_text(encoding="utf-8"))[
            "modules"
        ].items()
    }
    levels = _levels(folder, top, measured) if measured else {}
    inside = {
        name: {kind: n for kind, n in module["num_cells_by_type"].items() if kind in modules}
        for name, module in modules.items()
    }
    order, level = list[str](), [top]
    while level:  # so a module comes behind all that contain it
        order = [*(name for name in order if name not in level), *level]
        below = [kind for name in level for kind in inside[name]]
        level = [*reversed(dict.fromkeys(reversed(below)))]
    instances = Counter({top: 1})
    for name in order:
        for kind, count in inside[name].items():
            instances[kind] += count * instances[name]
    cells: dict[str, Counter[str]] = defaultdict(Counter)
    area: dict[str, float] = defaultdict(float)
    for name in order:
        owner = name.split(".")[0]
        own = cells[owner]
        area[owner] += float(modules[name].get("area", 0))
        for kind, count in modules[name]["num_cells_by_type"].items():
            if kind in modules:
                area[owner] -= count * float(modules[kind].get("area", 0))
            elif not kind.startswith("$scope"):
                own[kind] += count
    return {
        name: Block(
            name.removeprefix(PREFIX),
            instances[name],
            dict(sorted(count.items())),
            area[name],
            levels.get(name),
        )
        for name, count in cells.items()
    }


def _levels(folder: Path, top: str, units: list[str]) -> dict[str, int]:
    """Return kind of block -> logic depth. A unit below the top is measured as a whole; its
    ports count as registers.
    """
    hierarchy = json.loads((folder / "netlist.json").read_text(encoding="utf-8"))["modules"]
    worst = Counter({top: max(depths(hierarchy[top]).values(), default=0)})
    for unit in units:
        kinds, pending = {"": unit}, [""]
        while pending:
            above = pending.pop()
            for name, cell in hierarchy[kinds[above]]["cells"].items():
                if cell["type"] in hierarchy:
                    path = f"{above}.{name}".lstrip(".")
                    kinds[path] = cell["type"]
                    pending.append(path)
        flat = json.loads((folder / f"{unit}.json").read_text(encoding="utf-8"))["modules"][unit]
        for path, levels in depths(flat).items():
            kind = kinds[path].split(".")[0]
            worst[kind] = max(worst[kind], levels)
    return dict(worst)


def write_synthesis_page(out: Path | None = None) -> None:
    """Write the cost of the presets into docs/synthesis.md, or as Markdown to the file `out`."""
    text = PAGE.read_text(encoding="utf-8").format(yosys=version(YOSYS)) + "\n".join(
        report(name, load_config(name)) for name in ("silicon", "fpga")
    )
    put_page("docs/synthesis.md", "cost", text, out)


def report(name: str, config: Config) -> str:
    """Return the cost of a preset as Markdown."""
    sensor = config.sensor
    gates = synthesize(sensor, GATES)
    fpga = has_fpga_top(sensor)
    mapped = synthesize(sensor, ECP5, FPGA_TOP) if fpga else synthesize(sensor, CELLS)
    head = ["block", "instances", "gates", "flip-flops", "levels"]
    head += ["LUT4", "carry", "RAM", "flip-flops (ECP5)"] if fpga else ["cells", "area um2"]
    rows = []
    for kind, block in {**{k: None for k in mapped.blocks}, **gates.blocks}.items():
        one, other = gates.blocks.get(kind), mapped.blocks.get(kind)
        block = one or mapped.blocks[kind]
        row = [block.name, block.instances]
        row += (
            [one.total - one.flops, one.flops, "" if one.levels is None else one.levels]
            if one
            else ["", "", ""]
        )
        rows.append(row + (_mapped(other, fpga) if other else [""] * (len(head) - len(row))))
    total = [
        "**sensor**",
        "",
        round(gates.total(lambda b: b.total - b.flops)),
        round(gates.total(lambda b: b.flops)),
    ]
    total.append(max(block.levels or 0 for block in gates.blocks.values()))
    used = ([block.instances * n for n in _mapped(block, fpga)] for block in mapped.blocks.values())
    total += [sum(column) for column in zip(*used, strict=True)]
    lines = [
        f"## {name}: {sensor.rows} x {sensor.cols}, {sensor.phases} phases, {config.clock_mhz:g} MHz",
        "",
        *markdown.table(head, [*rows, total]),
        "",
    ]
    return "\n".join(lines + ([] if fpga else whole_blocks(config, mapped)))


def whole_blocks(config: Config, sensor_netlist: Netlist) -> list[str]:
    """Return the table of whole blocks of both views, as Markdown."""
    sensor, clock_ns = config.sensor, 1000 / config.clock_mhz
    head = ["block", "cells", "flip-flops", "latches", "clock gates", "macros", "area um2"]
    head += ["um2 per pixel", "pitch um", "slack ns", "of enables ns"]
    rows = []
    for view in VIEWS.values():
        view = view.at(config.clock_mhz)
        for unit, pixels in view_blocks(sensor, view):
            block = map_block(unit, view)
            share = block.area_um2 / pixels
            row = [unit.unit_name.removeprefix(PREFIX), sum(block.cells.values())]
            row += [block.count(kind) for kind in (FLOP, LATCH, GATE)]
            row += [
                sum(block.macros.values()),
                round(block.area_um2),
                f"{share:.0f}",
                f"{math.sqrt(share):.1f}",
            ]
            slacks = slacks_ns(block.folder, unit.unit_name, clock_ns)
            row += [
                f"{min(slacks.values()):+.2f}",
                f"{slacks['ENABLES']:+.2f}" if "ENABLES" in slacks else "",
            ]
            rows.append(row)
    # Not the module, which is in the table above: here no net between its blocks has buffers.
    module = SensorModule(sensor, min(2, sensor.subgroups)).unit_name
    outside = [
        (
            name.removeprefix(PREFIX),
            f"{min(slacks_ns(sensor_netlist.folder, name, clock_ns).values()):+.2f}",
        )
        for name in sensor_netlist.units
        if name != module
    ]
    return [
        scan_chain(sensor_netlist),
        "",
        WHOLE.read_text(encoding="utf-8").format(clock=clock_ns),
        *markdown.table(head, rows),
        *("", "Outside the modules, with their sub-blocks:", ""),
        *markdown.table(["block", "slack ns"], outside),
        "",
    ]


def scan_chain(netlist: Netlist) -> str:
    """Return what a scan chain through all flip-flops of a sensor in standard cells would cost.

    The library has another cell with a scan input for each kind of flip-flop and clock gate.
    """
    areas = cell_areas(library_files()[LIBERTY])
    replaced: Counter[str] = Counter()
    more = 0.0
    for block in netlist.blocks.values():
        for kind, number in block.cells.items():
            scanned = SCANNED.sub(_with_scan, kind)
            if scanned != kind:
                replaced[f"{kind} by {scanned}"] += number * block.instances
                more += number * block.instances * (areas[scanned] - areas[kind])
    area = netlist.total(lambda block: block.area_um2)
    cells = ", ".join(f"{number} {kind}" for kind, number in sorted(replaced.items()))
    return (
        f"A scan chain would replace cells by those of the library with a scan input ({cells}):"
        f" {round(more)} um2 more, {more / area:.1%} of the area, without its wires."
    )


def _with_scan(kind: re.Match[str]) -> str:
    """Return the beginning of the name of a cell with a scan input."""
    return "CLKGATETST_" if kind[0] == "CLKGATE_" else f"S{kind[0]}"


def view_blocks(sensor: Sensor, view: View) -> list[tuple[Unit, int]]:
    """Return the whole blocks of a view that the table shows, and the pixels of each."""
    front = view.front_end(sensor)
    module = SensorModule(sensor, min(2, sensor.subgroups), view)
    return [
        (view.minigroup(sensor), sensor.minigroup_pixels),
        (front, sensor.pixels),
        (Subgroup(sensor, view), sensor.pixels),
        (module, module.lines * sensor.pixels),
    ]


def _mapped(block: Block, fpga: bool) -> list[int]:
    if not fpga:
        return [block.total, round(block.area_um2)]
    ram = block.count("DP16KD") + block.count("TRELLIS_DPR16X4")
    return [block.count("LUT4"), block.count("CCU2C"), ram, block.count("TRELLIS_FF")]
