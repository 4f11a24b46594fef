# SPDX-License-Identifier: Apache-2.0
"""Corners of netlists in slices: constants at the ports of units, memories written beside a copy,
and what a design is kept by.
"""

import json
import re

import pytest

from coincid.slices import synthesis
from coincid.slices.emit import DarkInput, Emission
from coincid.slices.netlist import (
    ONE,
    ZERO,
    Block,
    Flop,
    Instance,
    Memory,
    NetlistError,
    Read,
    Table,
)
from coincid.slices.slices import Slices
from coincid.slices.synthesis import Design

LANES = 64

UNITS = """
module unit(input clk, input rst, input on, input [2:0] step, input [2:0] add, output reg [5:0] value, output odd);
  assign odd = value[0];
  initial value = 5;
  always @(posedge clk) if (rst) value <= 5; else if (on) value <= value + step + add;
endmodule

module units(input clk, input rst, input on, input [2:0] add, output [23:0] out, output [1:0] odd);
  wire unused_0, unused_1;
  unit unit_0(.clk(clk), .rst(rst), .on(1'b1), .step(3'd6), .add(add), .value(out[5:0]), .odd(odd[0]));
  unit unit_1(.clk(clk), .rst(rst), .on(1'b0), .step(3'd1), .add(3'd0), .value(out[11:6]), .odd(unused_0));
  unit unit_2(.clk(clk), .rst(1'b0), .on(on), .step(3'd7), .add(3'd7), .value(out[17:12]), .odd(odd[1]));
  unit unit_3(.clk(clk), .rst(rst), .on(on), .step(add), .add(3'd7), .value(out[23:18]), .odd(unused_1));
endmodule
"""


def units_by_hand(given):
    """Yield the outputs before each edge of (rst, on, add)."""
    values = [5] * 4
    for rst, on, add in given:
        out = sum(value << 6 * k for k, value in enumerate(values))
        yield out, (values[0] & 1) | (values[2] & 1) << 1
        steps = [(rst, 1, 6 + add), (rst, 0, 1), (0, on, 14), (rst, on, add + 7)]
        values = [
            5 if reset else value + step & 63 if enable else value
            for value, (reset, enable, step) in zip(values, steps, strict=True)
        ]


def inputs(lane, cycle):
    """Return (rst, on, add) of a lane in a cycle."""
    number = 7 * lane + 5 * cycle
    return int(number % 11 == 0), number >> 1 & 1, number * 3 % 8


def test_inputs_of_units_that_are_tied_to_a_constant():
    """To 1 and to 0, of some instances only, between others that share an input; outputs may be open."""
    design = Design("units", {"units.v": UNITS}, "units", ["unit"])
    given = [[inputs(lane, cycle) for lane in range(LANES)] for cycle in range(24)]
    seen = []
    with Slices(design, LANES) as slices:
        for cycle in given:
            for k, port in enumerate(("rst", "on", "add")):
                slices.set(port, [lane[k] for lane in cycle])
            slices.step(0)
            seen.append((slices.get("out"), slices.get("odd")))
            slices.step()
    for lane in range(LANES):
        expected = list(units_by_hand([cycle[lane] for cycle in given]))
        assert [(out[lane], odd[lane]) for out, odd in seen] == expected, lane


# A memory stores a register of a unit beside logic of the same unit, which is there only when the
# unit has been called.
ROWS = """
module unit(input clk, input rst, input [4:0] d, output reg [4:0] value, output [4:0] changed);
  initial value = 3;
  assign changed = value ^ d;
  always @(posedge clk) if (rst) value <= 3; else value <= value + d;
endmodule

module rows(input clk, input rst, input put, input [1:0] to, input [1:0] from, input [4:0] d,
            output [9:0] shown, output [4:0] value);
  reg [9:0] row [0:3];
  wire [4:0] changed;
  integer k;
  initial for (k = 0; k < 4; k = k + 1) row[k] = 2 * k;
  unit unit_0(.clk(clk), .rst(rst), .d(d), .value(value), .changed(changed));
  assign shown = row[from];
  always @(posedge clk) if (put) row[to] <= {value, changed};
endmodule
"""


def drawn(lane, cycle):
    """Return (put, to, from, d) of a lane in a cycle."""
    number = 13 * lane + 29 * cycle
    return int(number % 3 != 0), number >> 2 & 3, number >> 4 & 3, number * 7 & 31


def rows_by_hand(given):
    """Yield the outputs before each edge."""
    rows, value = [0, 2, 4, 6], 3
    for put, to, source, d in given:
        yield rows[source], value
        if put:
            rows[to] = value << 5 | value ^ d
        value = value + d & 31


def test_a_row_stores_what_was_there_before_the_edge():
    design = Design("rows_of_units", {"rows.v": ROWS}, "rows", ["unit"])
    cycles = [[drawn(lane, cycle) for lane in range(LANES)] for cycle in range(20)]
    seen = []
    with Slices(design, LANES) as slices:
        for cycle in cycles:
            for k, port in enumerate(("put", "to", "from", "d")):
                slices.set(port, [lane[k] for lane in cycle])
            slices.step(0)
            seen.append((slices.get("shown"), slices.get("value")))
            slices.step()
    for lane in range(LANES):
        expected = list(rows_by_hand([cycle[lane] for cycle in cycles]))
        assert [(shown[lane], value[lane]) for shown, value in seen] == expected, lane


def test_a_dark_input_of_a_design_without_units_sets_its_flags():
    """A bit sets that of its field and that of all fields together."""
    inputs = tuple(range(2, 10))
    tables = [Table(inputs[k : k + 3], (100 + k,), 0x80) for k in (0, 5)]
    tables += [Table((100, 105), (110,), 14)]
    flops = [Flop(table.outputs[0], 200 + k) for k, table in enumerate(tables)]
    block = Block("own", {"in": inputs}, {"out": (200, 201, 202)}, tables, flops, [], [], {})
    emission = Emission({"own": block}, "own", [DarkInput("own", "in", 4)])
    assert emission.layout.flags == 3
    assert emission.layout.flags_of == {"in": [[0, 2]] * 4 + [[1, 2]] * 4}
    rows = ", ".join(["{0, 2}"] * 4 + ["{1, 2}"] * 4)
    assert f"constexpr int FLAGS_OF_in[][2] = {{{rows}}};" in emission.header
    for number in range(3):
        assert f"if (F[{number}]) {{" in emission.source
    light = Emission({"own": block}, "own")
    assert light.layout.flags == 0 and not light.layout.flags_of and "F[" not in light.source


def of_dark_units(*inputs):
    """Return the emission of a top with units that read these nets at a dark input of two bits."""
    unit = Block("unit", {"d": (2, 3)}, {"q": (200,)}, [], [Flop(2, 200)], [], [], {})
    units = [
        Instance(f"u{k}", "unit", {"d": nets, "q": (300 + k,)}) for k, nets in enumerate(inputs)
    ]
    ports = {"in": (2, 3, 4)}, {"out": (300,)}
    top = Block("top", *ports, [Table((2,), (100,), 1)], [Flop(100, 50)], [], units, {})
    return Emission({"unit": unit, "top": top}, "top", [DarkInput("unit", "d", 2)])


def test_a_bit_sets_the_flags_of_all_units_that_it_reaches():
    """Another bit of the same port reaches fewer of them, or none."""
    emission = of_dark_units((3, 4), (ZERO, 4))
    assert emission.layout.flags_of == {"in": [[], [0], [0, 1]]}
    assert "FLAGS_OF_in[][2] = {{}, {0, 0}, {0, 1}};" in emission.header


def test_dark_tables_lead_to_each_other_in_one_way():
    """Where a memory, or tables that are dark at other times, lie between them, too: a hint makes
    no loop of a design that has none.
    """
    first, second, light = 2, 3, 4

    def both(k, *nets):
        return Table(nets, (k,), 8)

    rows = Memory("rows", 2, 1, [0, 0])
    rows.reads.append(Read(rows, (100,), (101,)))
    behind_rows = [both(100, first, light), both(102, first, 101)], [rows]
    crossed = [both(100, first, light), Table((second, 100), (101,), 2)]
    crossed += [both(102, second, light), both(103, first, 102)]
    for tables, memories in (behind_rows, (crossed, [])):
        flops = [Flop(table.outputs[0], 200 + k) for k, table in enumerate(tables)]
        ports = {"in": (first, second), "light": (light,)}, {"out": (200, 201)}
        block = Block("own", *ports, tables, flops, memories, [], {})
        source = Emission({"own": block}, "own", [DarkInput("own", "in", 1)]).source
        assert "if (F[0]) {" in source


@pytest.mark.parametrize("net", [50, 100, 300, ONE])
def test_a_dark_input_of_a_unit_is_one_of_the_top(net):
    """Nobody would set the flag for what the top makes, and the unit would be dark for ever."""
    told = "^top: a dark input of a unit that is not one of the top$"
    with pytest.raises(NetlistError, match=told):
        of_dark_units((2, net))


def test_a_table_without_inputs_is_a_constant():
    tables = [Table((), (100,), 0), Table((), (101,), 1), Table((2, 101), (102,), 8)]
    flops = [Flop(100 + k, 200 + k, enable=ONE, reset=ZERO) for k in range(3)]
    block = Block("own", {"in": (2,)}, {"out": (200, 201, 202)}, tables, flops, [], [], {})
    source = Emission({"own": block}, "own").source
    values = dict(re.findall(r"const W (t\d+) = (.*);", source))
    (one,) = re.findall(r"table<8>\(V\[\d+\], (t\d+)\)", source)
    assert values.pop(one) == "ONES" and "ZEROS" in values.values()


def test_a_unit_has_a_name_of_cpp_whatever_yosys_calls_it():
    """As one whose parameters are in its name."""
    name = r"$paramod\unit\N=32'00.1"
    unit = Block(name, {"d": (2,)}, {"q": (3,)}, [], [Flop(2, 3)], [], [], {})
    instances = [Instance("u", name, {"d": (2,), "q": (5,)})]
    top = Block("top", {"in": (2,)}, {"out": (5,)}, [], [], [], instances, {})
    source = Emission({name: unit, "top": top}, "top").source
    functions = re.findall(r"void (?:__attribute__\(\(noinline\)\) )?(.*?)\(", source)
    assert len(functions) > 2 and all(function.isidentifier() for function in functions)


def test_a_design_keeps_its_code_beside_its_netlist(monkeypatch, tmp_path):
    ports = {way[0]: {"direction": way, "bits": [2]} for way in ("input", "output")}
    module = {"ports": ports, "cells": {}, "netnames": {}}
    netlist = json.dumps({"modules": {"a": module}})
    (tmp_path / synthesis.NETLIST).write_text(netlist, encoding="utf-8")

    def once(folder, files, script, state, emit):
        assert (folder.name, folder.parent.name) == ("design", "slices")
        emit(tmp_path)
        return tmp_path

    monkeypatch.setattr(synthesis, "yosys_once", once)
    design = Design("design", {"a.v": ""}, "a")
    emission = design.emission()
    kept = {path.name: path.read_text(encoding="utf-8") for path in tmp_path.iterdir()}
    code = {"slice.cpp": emission.source, "slice.h": emission.header}
    assert kept == {synthesis.NETLIST: netlist} | code


def test_no_design_is_taken_for_another(monkeypatch, tmp_path):
    """Everything from which its C++ is made is among what it is kept by."""
    asked = []

    def once(folder, files, script, state=(), then=None):
        asked.append((sorted(files.items()), list(script), list(state)))
        return tmp_path

    monkeypatch.setattr(synthesis, "yosys_once", once)
    monkeypatch.setattr(synthesis, "sources_digest", lambda *rooms: f"sources of {rooms}")
    usual = {
        "name": "design",
        "sources": {"a.v": "module a; endmodule"},
        "top": "a",
        "units": ["one"],
        "dark_inputs": [DarkInput("one", "edges", 4)],
        "before": ["opt"],
    }
    others = [
        {"sources": {"a.v": "module a(); endmodule"}},
        {"top": "b"},
        {"units": ["two"]},
        {"units": []},
        {"dark_inputs": []},
        {"dark_inputs": [DarkInput("one", "edges", 8)]},
        {"dark_inputs": [DarkInput("one", "other", 4)]},
        {"before": []},
    ]
    for changed in ({}, *others):
        Design(**usual | changed)
    monkeypatch.setattr(synthesis, "sources_digest", lambda *rooms: "sources of later")
    Design(**usual)
    assert len({repr(one) for one in asked}) == len(asked) == 2 + len(others)
