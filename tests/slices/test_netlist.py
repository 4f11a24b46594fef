# SPDX-License-Identifier: Apache-2.0
"""Netlists as they are read from Yosys's JSON."""

import json
from itertools import product

import pytest

from coincid.slices.netlist import NetlistError, read_netlist


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


def rows(**changed):
    """Return a cell with three rows of two bits, two ports that read it and two that write."""
    numbers = {"SIZE": 3, "WIDTH": 2, "ABITS": 2, "RD_PORTS": 2, "WR_PORTS": 2}
    numbers |= {"RD_CLK_ENABLE": 0, "OFFSET": 0}
    connections = {
        "RD_ADDR": [10, 11, 12, 13],
        "RD_DATA": [20, 21, 22, 23],
        "WR_ADDR": [30, 31, 32, 33],
        "WR_DATA": [40, 41, 42, 43],
        "WR_EN": [50, 50, 51, 51],
        "WR_CLK": [2, 2],
    }
    parameters = {name: f"{changed.get(name, number):b}" for name, number in numbers.items()} | {
        "INIT": "xxxxxx",
        "MEMID": "\\rows",
    }
    connections = {name: changed.get(name, nets) for name, nets in connections.items()}
    return {"type": "$mem_v2", "parameters": parameters, "connections": connections}


def flop(clock):
    return {"type": "$_DFF_P_", "connections": {"C": [clock], "D": [3], "Q": [4]}}


def read(tmp_path, cells, names=None):
    """Return the block of these cells, whose clock is net 2."""
    module = {
        "ports": {"clk": {"direction": "input", "bits": [2]}},
        "netnames": names or {},
        "cells": cells,
    }
    unit = {"ports": {}, "netnames": {}, "cells": {}}
    path = tmp_path / "netlist.json"
    path.write_text(json.dumps({"modules": {"top": module, "unit": unit}}), encoding="utf-8")
    return read_netlist(path)["top"]


@pytest.mark.parametrize(
    ("cell", "told"),
    [
        (flop(3), "top: a clock other than its port clk"),
        (rows(WR_CLK=[2, 3]), "top: a clock other than its port clk"),
        (rows(WR_CLK=[3, 2]), "top: a clock other than its port clk"),
        (rows(WR_EN=[50, 50, 51, 52]), "top: memory rows writes parts of a row"),
        (rows(WR_EN=[50, 51, 52, 52]), "top: memory rows writes parts of a row"),
        (rows(RD_CLK_ENABLE=1), "top: a memory whose reads are clocked, or"),
        (rows(RD_CLK_ENABLE=2), "top: a memory whose reads are clocked, or"),
        (rows(OFFSET=4), "top: a memory .* whose rows do not begin at 0"),
        (
            {"type": "$_ANDNOT_", "connections": {}},
            "top: a cell .*ANDNOT_, which slices do not know",
        ),
    ],
)
def test_what_slices_cannot_play_is_refused_where_it_is_read(cell, told, tmp_path):
    with pytest.raises(NetlistError, match=f"^{told}"):
        read(tmp_path, {"cell": cell})


def test_every_port_of_a_memory_has_its_own_nets(tmp_path):
    (memory,) = read(tmp_path, {"rows": rows()}).memories
    assert (memory.name, memory.rows, memory.width) == ("rows", 3, 2)
    assert [(port.inputs, port.outputs) for port in memory.reads] == [
        ((10, 11), (20, 21)),
        ((12, 13), (22, 23)),
    ]
    assert [(port.address, port.data, port.enable) for port in memory.stores] == [
        ((30, 31), (40, 41), 50),
        ((32, 33), (42, 43), 51),
    ]
    assert all(port.memory is memory for port in memory.reads)


def test_of_a_block_the_signals_with_names_and_the_units_are_left(tmp_path):
    """What only the tool has named is hidden; constants are nets; the clock is no port."""
    unit = {"type": "unit", "connections": {"clk": [2], "a": [3, "1", "x"], "b": ["0", "z"]}}
    names = {
        "bus": {"bits": [3, "1", "0", "x"], "attributes": {}},
        "generated": {"bits": [5], "hide_name": 1, "attributes": {"init": "1"}},
        "shown": {"bits": [4], "hide_name": 0, "attributes": {}},
    }
    cells = {"one": unit, "scope": {"type": "$scopeinfo", "connections": {}}, "flop": flop(2)}
    cells["other"] = {"type": "$_DFF_P_", "connections": {"C": [2], "D": [4], "Q": [5]}}
    block = read(tmp_path, cells, names)
    assert block.names == {"bus": (3, 1, 0, 0), "shown": (4,)}
    (instance,) = block.instances
    assert (instance.name, instance.unit) == ("one", "unit")
    assert instance.nets == {"a": (3, 1, 0), "b": (0, 0)}
    assert block.inputs == block.outputs == {}
    assert [(flop.output, flop.init) for flop in block.flops] == [(4, 0), (5, 1)]


def test_an_input_of_a_unit_to_which_nothing_is_connected_is_0(tmp_path):
    """As all that Yosys leaves undefined; an output stays open."""
    ports = {
        "clk": {"direction": "input", "bits": [2]},
        "a": {"direction": "input", "bits": [3, 4]},
        "b": {"direction": "input", "bits": [5]},
        "q": {"direction": "output", "bits": [6]},
    }
    modules = {"unit": {"ports": ports, "netnames": {}, "cells": {}}}
    cell = {"type": "unit", "connections": {"clk": [2], "b": [9]}}
    clock = {"clk": {"direction": "input", "bits": [2]}}
    modules["top"] = {"ports": clock, "netnames": {}, "cells": {"one": cell}}
    path = tmp_path / "netlist.json"
    path.write_text(json.dumps({"modules": modules}), encoding="utf-8")
    (instance,) = read_netlist(path)["top"].instances
    assert instance.nets == {"a": (0, 0), "b": (9,)}
