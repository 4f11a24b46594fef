# SPDX-License-Identifier: Apache-2.0
"""Counts, areas and depths of blocks from Yosys's files, for a made-up hierarchy."""

import json

import pytest

from coincid.flow.synth import Block, Netlist, _blocks, _mapped


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
