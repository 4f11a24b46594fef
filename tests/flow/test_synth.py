# SPDX-License-Identifier: Apache-2.0
"""Counts, areas and depths of blocks from Yosys's files, for a made-up hierarchy."""

import itertools
import json
import math
import re
from pathlib import Path

import pytest
from attrs import evolve

from coincid.flow import synth
from coincid.flow.mapped import Mapped
from coincid.flow.synth import CELLS, GATES, Block, Netlist, _blocks, _mapped
from coincid.flow.yosys import LIBERTY
from coincid.model.contract.config import load_config

from .sensors import SMALL

ROOT = Path(__file__).parents[2]


def module(cells, area):
    return {"num_cells_by_type": cells, "area": area}


# top holds two `coincid_a` and one `coincid_b`; each a, three `coincid_b` and a FIFO of its own.
STATISTICS = {
    "\\top": module({"INV": 5, "coincid_a": 2, "coincid_b": 1, "$scopeinfo": 9}, "100.0"),
    "\\coincid_b": module({"NAND": 7, "DFF_X1": 11}, "4.0"),
    "\\coincid_a": module({"INV": 13, "coincid_b": 3, "coincid_a.fifo": 1}, "40.0"),
    "\\coincid_a.fifo": module({"INV": 17, "DFF_X1": 19}, "20.0"),
}


def chain(length, ends_in=()):
    """Return a flat module with a chain of gates from its input to its output, and a register
    behind gate `n` of each (block, n).
    """
    cells = {
        f"gate_{n}": {
            "type": "$_NAND_",
            "port_directions": {"A": "input", "Y": "output"},
            "connections": {"A": [n], "Y": [n + 1]},
        }
        for n in range(2, 2 + length)
    }
    for block, n in ends_in:
        cells[f"$flatten\\{block}.$auto$ff"] = {
            "type": "$_DFF_P_",
            "port_directions": {"D": "input", "Q": "output"},
            "connections": {"D": [2 + n], "Q": [100 + n]},
        }
    ports = {
        "in": {"direction": "input", "bits": [2]},
        "out": {"direction": "output", "bits": [2 + length]},
    }
    return {"ports": ports, "cells": cells}


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "stat.json").write_text(json.dumps({"modules": STATISTICS}), encoding="utf-8")
    inner = {"type": "coincid_b", "port_directions": {}, "connections": {}}
    fifo = inner | {"type": "coincid_a.fifo"}
    hierarchy = {
        "top": chain(3),
        "coincid_a": {"cells": {"one": inner, "two": inner, "fifo": fifo}},
        "coincid_b": {"cells": {}},
        "coincid_a.fifo": {"cells": {}},
    }
    (tmp_path / "netlist.json").write_text(json.dumps({"modules": hierarchy}), encoding="utf-8")
    ends = [("one", 2), ("two", 6), ("fifo", 8)]
    for unit, flat in (("coincid_a", chain(7, ends)), ("coincid_b", chain(5))):
        flat["cells"] |= {
            f"gate_{n}": chain(12)["cells"][f"gate_{n}"] for n in range(2, 10) if unit[-1] == "a"
        }
        text = json.dumps({"modules": {unit: flat}})
        (tmp_path / f"{unit}.json").write_text(text, encoding="utf-8")
    return tmp_path


def test_a_block_within_a_block_within_a_unit_has_levels_of_its_own(tmp_path):
    def within(**kinds):
        inner = {"port_directions": {}, "connections": {}}
        return {"cells": {name: inner | {"type": kind} for name, kind in kinds.items()}}

    hierarchy = {
        "top": chain(1),
        "coincid_a": within(one="coincid_b"),
        "coincid_b": within(deep="coincid_c"),
        "coincid_c": within(),
    }
    flat = chain(7, [("one", 2), ("one.\\deep", 6)])
    for name, modules in (("netlist", hierarchy), ("coincid_a", {"coincid_a": flat})):
        text = json.dumps({"modules": modules})
        (tmp_path / f"{name}.json").write_text(text, encoding="utf-8")
    found = synth._levels(tmp_path, "top", ["coincid_a"])
    assert found == {"top": 1, "coincid_a": 7, "coincid_b": 2, "coincid_c": 6}


def test_blocks_have_their_own_cells_area_and_the_product_of_instances(folder):
    """The area of sub-blocks goes off as often as a block contains them. A FIFO counts with its
    block.
    """
    blocks = _blocks(folder, "top", [])
    assert list(blocks) == ["top", "coincid_a", "coincid_b"]
    assert {name: block.instances for name, block in blocks.items()} == {
        "top": 1,
        "coincid_a": 2,
        "coincid_b": 7,
    }
    assert {name: block.name for name, block in blocks.items()} == {
        "top": "top",
        "coincid_a": "a",
        "coincid_b": "b",
    }
    assert blocks["top"].cells == {"INV": 5}
    assert blocks["coincid_a"].cells == {"INV": 30, "DFF_X1": 19}
    assert blocks["coincid_b"].cells == {"NAND": 7, "DFF_X1": 11}
    assert blocks["top"].area_um2 == 100 - 2 * 40 - 4
    assert blocks["coincid_a"].area_um2 == 40 - 3 * 4
    assert blocks["coincid_b"].area_um2 == 4
    assert {block.levels for block in blocks.values()} == {None}
    sensor = Netlist("nangate45", folder, [], blocks)
    assert sensor.total(lambda block: block.area_um2) == 100
    assert sensor.total(lambda block: block.flops) == 2 * 19 + 7 * 11
    assert sensor.total(lambda block: block.total) == 5 + 2 * 49 + 7 * 18


@pytest.mark.parametrize("order", [*itertools.permutations("xyz")])
def test_a_block_counts_after_all_that_contain_it(order, tmp_path):
    """In whatever order the statistics name them: x contains y and z, and y contains z, which has
    one more block inside.
    """
    inside = {
        "top": {f"coincid_{name}": 2 for name in order},
        "coincid_x": {"coincid_z": 1, "coincid_y": 3},
        "coincid_y": {"coincid_z": 5},
        "coincid_z": {"coincid_last": 1},
        "coincid_last": {"INV": 1},
    }
    statistics = {name: module(cells, "0.0") for name, cells in inside.items()}
    (tmp_path / "stat.json").write_text(json.dumps({"modules": statistics}), encoding="utf-8")
    x, y = 2, 2 + 2 * 3
    z = 2 + x + 5 * y
    found = {block.name: block.instances for block in _blocks(tmp_path, "top", []).values()}
    assert found == {"top": 1, "x": x, "y": y, "z": z, "last": z}


def test_the_depth_of_a_block_is_that_of_its_deepest_instance(folder):
    """Measured alone or inside another; a FIFO's is its block's."""
    blocks = _blocks(folder, "top", ["coincid_a", "coincid_b"])
    levels = {name: block.levels for name, block in blocks.items()}
    assert levels == {"top": 3, "coincid_a": 8, "coincid_b": 6}


def test_what_the_table_shows_of_a_block_in_a_target():
    """LUTs, carries, memories and flip-flops on an FPGA, otherwise cells and their area."""
    cells = {"LUT4": 1, "CCU2C": 2, "DP16KD": 4, "TRELLIS_DPR16X4": 8, "TRELLIS_FF": 16}
    block = Block("block", 3, cells | {"OTHER": 32}, area_um2=99.6)
    assert _mapped(block, fpga=True) == [1, 2, 12, 16]
    assert _mapped(block, fpga=False) == [63, 100]
    assert block.count("LUT4", "OTHER", "NONE") == 33
    assert block.flops == 16


def tables(text):
    """Return the cells of the rows of all tables of a page."""
    rows = [line[2:-2].split(" | ") for line in text.splitlines() if line.startswith("| ")]
    return [row for row in rows if "---:" not in row]


IN_GATES = {
    "coincid_sensor": Block("sensor", 1, {"$_NAND_": 5, "$_DFF_P_": 3}, levels=4),
    "coincid_a": Block("a", 2, {"$_NAND_": 70, "$_DFF_P_": 11}, levels=9),
    "coincid_c": Block("c", 3, {"$_NAND_": 100}, levels=0),
    "coincid_d": Block("d", 1, {"$_NAND_": 1}),
}
ON_AN_FPGA = {
    "coincid_top": Block("top", 1, {"LUT4": 2, "TRELLIS_FF": 6}),
    "coincid_a": Block("a", 2, {"LUT4": 20, "CCU2C": 3, "DP16KD": 1, "TRELLIS_FF": 30}),
}
IN_CELLS = {
    "coincid_sensor": Block("sensor", 1, {"NAND2_X1": 6, "DFF_X1": 2}, 20.6),
    "coincid_a": Block("a", 2, {"NAND2_X1": 30, "CLKGATE_X8": 1}, 100.2),
}


@pytest.fixture
def made_up(monkeypatch):
    """Synthesis answers with the blocks above, timing with slacks that tell the blocks apart."""
    blocks = {GATES: IN_GATES, CELLS: IN_CELLS, synth.ECP5: ON_AN_FPGA}
    areas = {"DFF_X1": 4.0, "SDFF_X1": 6.0, "CLKGATE_X8": 8.0, "CLKGATETST_X8": 9.0}
    liberty = "".join(f"cell ({name}) {{\n area : {area};\n}}\n" for name, area in areas.items())
    module = synth.SensorModule(load_config("silicon").sensor, 2).unit_name

    def synthesize(sensor, target, top=synth.TOP):
        assert (top == synth.FPGA_TOP) == (target == synth.ECP5)
        return Netlist(target, Path("sensor"), ["coincid_readout", module], blocks[target])

    def map_block(unit, view):
        cells = {"DFF_X1": 40, "DLH_X1": 20, "CLKGATE_X1": 3, "NAND2_X1": 7}
        folder = Path(view.name)
        return Mapped(
            unit.unit_name, folder, cells, {"coincid_delay": 4, "coincid_mutex": 5}, 900.4
        )

    def slacks_ns(folder, block, clock_ns):
        assert clock_ns == 2.0
        if folder == Path("sensor"):
            return {"FLOPS": 0.25, "LATCHES": 0.5}
        return {"FLOPS": -0.125, "ENABLES": 0.75} if block.endswith("subgroup") else {"FLOPS": 1.0}

    monkeypatch.setattr(synth, "synthesize", synthesize)
    monkeypatch.setattr(synth, "map_block", map_block)
    monkeypatch.setattr(synth, "slacks_ns", slacks_ns)
    monkeypatch.setattr(synth, "library_files", lambda: {LIBERTY: liberty})


def test_the_cost_on_an_fpga_has_the_gates_beside_the_cells(made_up):
    """A block of only one of the two has empty cells. The sum counts each instance."""
    head, *rows = tables(synth.report("fpga", load_config("fpga")))
    assert head == "block instances gates flip-flops levels LUT4 carry RAM".split() + [
        "flip-flops (ECP5)"
    ]
    assert rows == [
        ["top", "1", "", "", "", "2", "0", "0", "6"],
        ["a", "2", "70", "11", "9", "20", "3", "1", "30"],
        ["sensor", "1", "5", "3", "4", "", "", "", ""],
        ["c", "3", "100", "0", "0", "", "", "", ""],
        ["d", "1", "1", "0", "", "", "", "", ""],
        ["**sensor**", "", "446", "25", "9", "42", "6", "2", "66"],
    ]


def test_the_cost_in_standard_cells_has_area_and_whole_blocks_of_both_views(made_up):
    """Area of a pixel and its pitch are those of the block's pixels. The module is no row of the
    blocks outside the modules.
    """
    text = synth.report("silicon", load_config("silicon"))
    assert text.startswith("## silicon: 32 x 32, 32 phases, 500 MHz\n\n|")
    assert "a cycle of 2 ns" in " ".join(text.split())
    rows = tables(text)
    assert rows[:5] == [
        ["block", "instances", "gates", "flip-flops", "levels", "cells", "area um2"],
        ["sensor", "1", "5", "3", "4", "8", "21"],
        ["a", "2", "70", "11", "9", "31", "100"],
        ["c", "3", "100", "0", "0", "", ""],
        ["d", "1", "1", "0", "", "", ""],
    ]
    assert rows[5] == ["**sensor**", "", "446", "25", "9", "70", "221"]
    assert rows[6] == ["block", "cells", "flip-flops", "latches", "clock gates", "macros"] + [
        "area um2",
        "um2 per pixel",
        "pitch um",
        "slack ns",
        "of enables ns",
    ]
    counts = ["70", "40", "20", "3", "9", "900"]
    of_pixels = {4: ["225", "15.0"], 64: ["14", "3.8"], 128: ["7", "2.7"]}
    assert rows[7:15] == [
        [name, *counts, *of_pixels[pixels], *slacks]
        for name, pixels, slacks in [
            ("minigroup", 4, ["+1.00", ""]),
            ("tree", 64, ["+1.00", ""]),
            ("subgroup", 64, ["-0.12", "+0.75"]),
            ("module", 128, ["+1.00", ""]),
            ("async_minigroup", 4, ["+1.00", ""]),
            ("async_front", 64, ["+1.00", ""]),
            ("async_subgroup", 64, ["-0.12", "+0.75"]),
            ("async_module", 128, ["+1.00", ""]),
        ]
    ]
    assert rows[15:] == [["block", "slack ns"], ["readout", "+0.25"]]
    assert "(2 CLKGATE_X8 by CLKGATETST_X8, 2 DFF_X1 by SDFF_X1): 6 um2 more, 2.7% of" in text


def test_the_page_of_costs_has_both_presets_and_the_version_of_yosys(made_up, tmp_path):
    page = tmp_path / "page.md"
    synth.write_synthesis_page(page)
    text = page.read_text(encoding="utf-8")
    assert f"(Yosys {synth.version(synth.YOSYS)})" in text
    assert [line.split(":")[0] for line in text.splitlines() if line.startswith("## ")] == [
        "## silicon",
        "## fpga",
    ]


@pytest.mark.parametrize(
    ("words", "page"),
    [
        ("cost_page.md", "synthesis.md"),
        ("cost_whole_blocks.md", "synthesis.md"),
        ("layout/page.md", "layout.md"),
    ],
)
def test_words_around_the_numbers_of_a_page_are_those_of_their_file(words, page):
    """One after the other, whatever the numbers are."""
    shown, template = (
        " ".join(re.sub("<!--.*?-->", "", path.read_text(encoding="utf-8")).split())
        for path in (ROOT / "docs" / page, ROOT / "flow" / words)
    )
    at = 0
    for part in re.split(r"\{[^{}]*\}", template):
        found = shown.find(part, at)
        assert found >= at, part
        at = found + len(part)


@pytest.fixture
def asked(monkeypatch, folder):
    """Return the files and commands that Yosys gets for a target; its answer is made up."""

    def files_of(sensor, cells=False):
        memory = "of latches" if cells else "of flip-flops"
        names = [synth.FILE_LIST, f"{synth.TOP}.v", "coincid_a.v", "coincid_clock_gate.v"]
        return dict.fromkeys(names, memory)

    def asked(target, top=synth.TOP):
        got = []

        def yosys_once(place, files, script):
            got.append((files, script))
            return folder

        statistics = {f"\\{top}": {"num_cells_by_type": {"INV": 1, "coincid_a": 1}}}
        statistics["\\coincid_a"] = {"num_cells_by_type": {}}
        if target == CELLS:
            statistics[f"\\{top}"]["area"] = "3.0"
        hierarchy = {top: chain(1), "coincid_a": {"cells": {}}}
        alone = {"coincid_a": chain(2)}
        for name, modules in (("stat", statistics), ("netlist", hierarchy), ("coincid_a", alone)):
            text = json.dumps({"modules": modules})
            (folder / f"{name}.json").write_text(text, encoding="utf-8")
        monkeypatch.setattr(synth, "yosys_once", yosys_once)
        found = synth.synthesize(SMALL, target, top)
        assert found.folder == folder and found.units == ["coincid_a"]
        levels = [block.levels for block in found.blocks.values()]
        assert levels == ([1, 2] if target == GATES else [None, None])
        areas = [block.area_um2 for block in found.blocks.values()]
        assert areas == ([3.0, 0.0] if target == CELLS else [0.0, 0.0])
        return got[0]

    monkeypatch.setattr(synth, "verilog_files", files_of)
    monkeypatch.setattr(synth, "fpga_files", lambda sensor: {"coincid_fpga.v": "samplers"})
    monkeypatch.setattr(synth, "instantiated", lambda unit: ["coincid_a"])
    monkeypatch.setattr(synth, "library_files", lambda: {LIBERTY: "cells"})
    return asked


BLOCKS = ["coincid_sensor.v", "coincid_a.v", "coincid_clock_gate.v"]


def test_gates_know_no_cells_and_every_block_is_also_measured_alone(asked):
    files, script = asked(GATES)
    assert list(files) == BLOCKS and set(files.values()) == {"of flip-flops"}
    assert script[0] == f"read_verilog -sv {' '.join(BLOCKS)}"
    assert "liberty" not in " ".join(script)
    mapped = script.index(f"abc -g gates -script {synth.SPEED}")
    assert script.index("hierarchy -check -top coincid_sensor") < mapped
    assert script[mapped - 1 : mapped + 4] == [
        "dfflegalize -cell $_DFF_P_ x",
        script[mapped],
        "opt_clean",
        "tee -q -o stat.json stat -json",
        "write_verilog -simple-lhs -noexpr -noattr netlist.v",
    ]
    alone = ["design -load whole", "hierarchy -top coincid_a", "flatten", "opt_clean"]
    written = ["write_json netlist.json", "design -save whole"]
    assert script[-7:] == [*written, *alone, "write_json coincid_a.json"]


def test_standard_cells_have_latches_and_the_area_of_their_library(asked):
    files, script = asked(CELLS)
    assert list(files) == [*BLOCKS, LIBERTY]
    assert files["coincid_a.v"] == "of latches"
    assert "CLKGATE_X8 gate" in files["coincid_clock_gate.v"]
    assert script[:2] == [f"read_liberty -lib {LIBERTY}", f"read_verilog -sv {' '.join(BLOCKS)}"]
    assert f"dfflibmap -liberty {LIBERTY}" in script
    assert script[-3:] == [
        f"tee -q -o stat.json stat -json -liberty {LIBERTY}",
        "write_verilog -simple-lhs -noexpr -noattr netlist.v",
        "write_json netlist.json",
    ]


def test_the_top_of_an_fpga_takes_the_place_of_the_sensor(asked):
    files, script = asked(synth.ECP5, synth.FPGA_TOP)
    names = ["coincid_a.v", "coincid_clock_gate.v", "coincid_fpga.v"]
    assert list(files) == names and files["coincid_a.v"] == "of flip-flops"
    steps = f"synth_lattice -family ecp5 -noflatten -top {synth.FPGA_TOP} -run"
    assert script[:6] == [
        f"read_verilog -sv {' '.join(names)}",
        f"hierarchy -check -top {synth.FPGA_TOP}",
        f"{steps} begin:map_luts",
        "abc -lut 4 -dress",
        "clean",
        f"{steps} map_cells:",
    ]
    assert script[6] == "tee -q -o stat.json stat -json" and "read_liberty" not in script[0]


def test_whole_blocks_are_shown_by_pixel_at_the_clock_of_the_preset(monkeypatch):
    """The pitch is the side of a square of a pixel's area; the slack is the least of all kinds. The
    module of a sensor with one subgroup has one line, and is no block outside the modules.
    """
    config = evolve(load_config("silicon"), sensor=SMALL).with_frame(clock_mhz=400.0)
    clocks_ns = []
    cells = {"DFF_X1": 2, "DLH_X1": 3, "CLKGATE_X1": 5, "NAND2_X1": 7}

    def slacks(folder, block, clock_ns):
        clocks_ns.append(clock_ns)
        return {"FLOPS": 0.5, "LATCHES": -0.25, "ENABLES": 0.75}

    def block_of(unit, view):
        return Mapped(unit.unit_name, Path(), cells, {"coincid_delay": 11}, 1600.0)

    monkeypatch.setattr(synth, "map_block", block_of)
    monkeypatch.setattr(synth, "slacks_ns", slacks)
    monkeypatch.setattr(synth, "scan_chain", lambda netlist: "A scan chain.")
    netlist = Netlist(CELLS, Path(), ["coincid_module_1", "coincid_readout_1"], {})
    lines = synth.whole_blocks(config, netlist)
    assert set(clocks_ns) == {2.5}
    rows = [
        [cell.strip() for cell in line.strip("|").split("|")]
        for line in lines
        if line.startswith("| ")
    ]
    of_block = {row[0]: row[1:] for row in rows if len(row) == 11 and row[1].isdigit()}
    pixels = {"minigroup": SMALL.minigroup_pixels, "subgroup": SMALL.pixels}
    pixels |= {"module_1": SMALL.pixels}
    for name, number in pixels.items():
        share = 1600 / number
        shown = [f"{share:.0f}", f"{math.sqrt(share):.1f}", "-0.25", "+0.75"]
        assert of_block[name] == ["17", "2", "3", "5", "11", "1600", *shown]
    outside = [row for row in rows if len(row) == 2 and not row[0].startswith("---")]
    assert outside == [["block", "slack ns"], ["readout_1", "-0.25"]]
