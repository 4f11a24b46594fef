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
