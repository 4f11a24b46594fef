# SPDX-License-Identifier: Apache-2.0
"""Clock domains, resets and latches of a made-up netlist of the asynchronous view."""

from coincid.flow.silicon_report import Domain, domains, general, latches


def flop(kind, clock, polarity, *, q, **pins):
    return {
        "type": kind,
        "parameters": {"CLK_POLARITY": polarity},
        "connections": {"CLK": [clock], "Q": q} | pins,
    }


def inverter(a, y):
    return {"type": "$not", "connections": {"A": a, "Y": y}}


NETLIST = {
    "netnames": {
        "clk_of_the_parent": {"bits": [2]},
        "$1": {"bits": [2], "hide_name": 1},
        "clk": {"bits": [2]},
        "roots": {"bits": [3, 4, "x"]},
        "ends": {"bits": [11]},
        "rst": {"bits": [5]},
        "group_7": {"bits": [6]},
        "group_8": {"bits": [7]},
        "inverted": {"bits": [8, 9]},
        "twice": {"bits": [10]},
    },
    "cells": {
        "not_two": inverter([3, 11], [8, 9]),
        "not_twice": inverter([9], [10]),
        "a": flop("$dff", 2, "1", q=[20, 21, 22]),
        "b": flop("$adff", 2, "1", q=[23], ARST=[5]),
        "c": flop("$adff", 2, "1", q=[24, 25], ARST=["0"]),
        "d": flop("$dff", 2, "0", q=[26, 27, 28, 29]),
        "e": flop("$dff", 8, "1", q=[30] * 5),
        "f": flop("$dffe", 10, "1", q=[31] * 6),
        "g": flop("$dff", 6, "1", q=[32] * 7),
        "h": flop("$dff", 7, "1", q=[33] * 9),
        "latch": {"type": "$dlatch", "connections": {"Q": [40]}},
        "another": {"type": "$adlatch", "connections": {"Q": [41]}},
        "and": {"type": "$and", "connections": {"Y": [42]}},
    },
}


def test_flip_flops_by_clock_edge_and_reset():
    """An inverter in front of a clock changes the edge, two of them do not; numbers of instances
    do not tell clocks apart; of a net's names, the shortest that is not hidden counts. Each bit of
    an inverter is one of its own.
    """
    assert domains(NETLIST) == [
        Domain("clk", False, "", 3),
        Domain("clk", False, "constant", 2),
        Domain("clk", False, "rst", 1),
        Domain("clk", True, "", 4),
        Domain("ends", False, "", 6),
        Domain("group_*", False, "", 16),
        Domain("roots[*]", True, "", 5),
    ]


def test_latches_are_told_in_order():
    assert latches(NETLIST) == ["another", "latch"]


def test_a_general_name_has_no_numbers():
    assert general("subgroup_12.taps[3]$45") == "subgroup_*.taps[*]"
