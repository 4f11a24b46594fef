# SPDX-License-Identifier: Apache-2.0
"""Netlists as they are read from Yosys's JSON."""

import json
from itertools import product

import pytest

from coincid.slices.netlist import read_netlist


def value(table, values):
    """Return a table's output for the values of nets."""
    return table.bits >> sum(values[net] << i for i, net in enumerate(table.inputs)) & 1


@pytest.mark.parametrize("inputs", [[2], [3, 2], [2, 3, 4], ["0", 2, 2]])
def test_tables_keep_their_function(tmp_path, inputs):
    rows = 1 << len(inputs)
    functions = range(1 << rows)
    cells = {
        f"cell_{bits}": {
            "type": "$lut",
            "parameters": {"LUT": f"{bits:0{rows}b}"},
            "connections": {"A": inputs, "Y": [100 + bits]},
        }
        for bits in functions
    }
    (tmp_path / "netlist.json").write_text(
        json.dumps({"modules": {"top": {"ports": {}, "netnames": {}, "cells": cells}}}),
        encoding="utf-8",
    )
    tables = {
        table.outputs[0] - 100: table
        for table in read_netlist(tmp_path / "netlist.json")["top"].tables
    }
    for bits, free in product(functions, product((0, 1), repeat=3)):
        values = dict(zip((0, 1, 2, 3, 4), (0, 1, *free), strict=True))
        row = sum(values[int(net)] << i for i, net in enumerate(inputs))
        assert value(tables[bits], values) == bits >> row & 1


def test_what_registers_and_memories_hold_at_first_is_in_the_order_of_their_bits(tmp_path):
    flops = {
        f"flop_{net}": {
            "type": "$_DFF_P_",
            "connections": {"C": [2], "D": [3], "Q": [net]},
        }
        for net in (10, 11, 12)
    }
    memory = {
        "type": "$mem_v2",
        "parameters": {
            **{name: f"{number:b}" for name, number in (("SIZE", 3), ("WIDTH", 2), ("ABITS", 2))},
            **{name: "0" for name in ("RD_CLK_ENABLE", "OFFSET", "RD_PORTS", "WR_PORTS")},
            "INIT": "x10110",  # the last row first
            "MEMID": "\\rows",
        },
        "connections": {"RD_ADDR": [], "RD_DATA": []},
    }
    module = {
        "ports": {"clk": {"direction": "input", "bits": [2]}},
        "netnames": {"count": {"bits": [10, 11, 12], "attributes": {"init": "0x1"}}},
        "cells": {**flops, "memory": memory},
    }
    (tmp_path / "netlist.json").write_text(
        json.dumps({"modules": {"top": module}}), encoding="utf-8"
    )
    top = read_netlist(tmp_path / "netlist.json")["top"]
    assert {flop.output: flop.init for flop in top.flops} == {10: 1, 11: 0, 12: 0}
    (rows,) = top.memories
    assert (rows.name, rows.init) == ("rows", [0b10, 0b01, 0b01])
