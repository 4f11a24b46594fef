# SPDX-License-Identifier: Apache-2.0
"""Netlists as they are read from Yosys's JSON."""

import json
from itertools import product

import pytest

from coincid.slices.netlist import read_netlist


def value(table, values):
    """Return a table's output for the values of nets."""
    return table.bits >> sum(values[net] << i for i, net in enumerate(table.inputs)) & 1


@pytest.mark.parametrize(
    "inputs", [wires for n in (1, 2, 3) for wires in product(("0", "1", 2, 3, 4)[: n + 2], repeat=n)]
)
def test_tables_keep_their_function_and_only_inputs_that_change_it(tmp_path, inputs):
    rows = 1 << len(inputs)
    functions = range(1 << rows)
    cells = {
        f"cell_{bits}": {
            "type": "$lut",
            "parameters": {"LUT": f"{bits:0{rows}b}"},
            "connections": {"A": list(inputs), "Y": [100 + bits]},
        }
        for bits in functions
    }
    (tmp_path / "netlist.json").write_text(
        json.dumps({"modules": {"top": {"ports": {}, "netnames": {}, "cells": cells}}})
    )
    tables = {table.outputs[0] - 100: table for table in read_netlist(tmp_path / "netlist.json")["top"].tables}
    for bits in functions:
        used = set()
        for free in product((0, 1), repeat=3):
            values = dict(zip((0, 1, 2, 3, 4), (0, 1, *free)))
            row = sum(values[int(net)] << i for i, net in enumerate(inputs))
            assert value(tables[bits], values) == bits >> row & 1
            used |= {
                net for net in (2, 3, 4) if value(tables[bits], values | {net: 1 - values[net]}) != bits >> row & 1
            }
        assert set(tables[bits].inputs) == used
