# SPDX-License-Identifier: Apache-2.0
"""What a circuit of the asynchronous view may be, and its trees and numbers by hand."""

import re

import pytest
from amaranth.hdl import Cat, Instance, Module, Signal
from amaranth.sim import Simulator

from coincid.hdl.front_end_views import Asynchronous
from coincid.hdl.sensor import SensorTop
from coincid.hdl.silicon import circuit
from coincid.hdl.silicon.circuit import (
    HIT_FS,
    LEVEL_FS,
    STEP_FS,
    Circuit,
    arbiter_rows,
    clock_fs,
    johnson_number,
    lag_fs,
    levels,
    or_tree,
)
from coincid.hdl.subgroup import Subgroup
from coincid.model.contract.parameters import PHASES_MAX, Sensor
from coincid.model.shared.errors import InputError
from coincid.tb.stress import Front

SIZES = (*range(1, 20), 31, 32, 33, 64, 100)


@pytest.mark.parametrize(
    ("given", "told"),
    [
        ({"clock_mhz": 0.99}, "clock_mhz = 0.99: must be a number from 1 to 1000"),
        ({"clock_mhz": 1000.5}, "clock_mhz = 1000.5: must be a number from 1 to 1000"),
        ({"clock_mhz": float("nan")}, "clock_mhz = nan: must be a number"),
        ({"pixel_skew_fs": (3, -7, 0, -2)}, "pixel_skew_fs[1] = -7: must be an integer from 0 to"),
        ({"pixel_skew_fs": (3, 0.5)}, "pixel_skew_fs[1] = 0.5: must be an integer"),
        (
            {"mismatch_fs": (0, 0, 1 << 31)},
            "mismatch_fs[2] = 2147483648: must be an integer from -",
        ),
        ({"mismatch_fs": (-1 << 31,)}, "mismatch_fs[0] = -2147483648: must be an integer from -"),
        ({"banks": 0}, "banks = 0: must be an integer from 1 to 2"),
        ({"banks": 3}, "banks = 3: must be an integer from 1 to 2"),
        ({"gain_ppm": -1_000_000}, "gain_ppm = -1000000: must be an integer from -999999 to"),
        ({"gain_ppm": 0.5}, "gain_ppm = 0.5: must be an integer"),
    ],
)
def test_a_circuit_that_cannot_be_is_refused(given, told):
    with pytest.raises(InputError, match=f"^{re.escape(told)}"):
        Circuit(**given)


SENSOR = Sensor(rows=16, cols=8, phases=8, window_max=16)  # of two subgroups


@pytest.mark.parametrize(
    ("given", "told"),
    [
        ({"mismatch_fs": (1,) * 7}, "mismatch_fs: has 7 numbers, must have none or 8"),
        ({"mismatch_fs": (1,) * 9}, "mismatch_fs: has 9 numbers, must have none or 8"),
        ({"pixel_skew_fs": (1,) * 63}, "pixel_skew_fs: has 63 numbers, must have none or 64"),
        ({"pixel_skew_fs": (1,) * 65}, "pixel_skew_fs: has 65 numbers, must have none or 64"),
        ({"banks": 1}, "sensor.rearm = 0: must be at least 3 with a single window bank"),
    ],
)
def test_a_circuit_is_placed_only_in_a_sensor_that_it_fits(given, told):
    """Each boundary has its error, and each pixel its delay, or there are none."""
    for number in (0, 8):
        Subgroup(SENSOR, Asynchronous(Circuit(mismatch_fs=(-5,) * number)))
        Subgroup(SENSOR, Asynchronous(Circuit(pixel_skew_fs=(5,) * 8 * number)))
    view = Asynchronous(Circuit(**given))
    for place in (SensorTop, Subgroup, lambda sensor, view: Front(sensor, view.circuit)):
        with pytest.raises(InputError, match=f"^{told}$"):
            place(SENSOR, view)


@pytest.mark.parametrize("clock_mhz", [1, 1000])
def test_the_slowest_and_the_fastest_clock_are_clocks(clock_mhz):
    assert Circuit(clock_mhz=clock_mhz).clock_fs == 1_000_000_000 // clock_mhz


def test_a_cycle_has_whole_ticks_and_the_length_of_its_clock():
    """For any number of phases: half a step at most is lost."""
    for clock_mhz in (1.0, 99.9, 123.456, 300.0, 400.0, 500.0, 999.7):
        for step_fs in (STEP_FS, 2000, 1):
            found = clock_fs(clock_mhz, step_fs)
            assert found % step_fs == 0
            assert abs(found - 1e9 / clock_mhz) <= step_fs / 2
        assert clock_fs(clock_mhz) % PHASES_MAX == 0
    assert clock_fs(1e9, 2000) == 2000


def unused_module():
    """Return a module for cells that a test looks at. Amaranth does not warn of it."""
    m = Module()
    m._MustUse__silence = True
    return m


@pytest.mark.parametrize("count", SIZES)
def test_every_input_of_an_or_tree_has_the_same_way_to_its_root(count):
    """As many cells as the tree has levels; and each input reaches the root."""
    m = unused_module()
    inputs = [Signal(name=f"input_{k}") for k in range(count)]
    root = or_tree(m, "tree", inputs)
    follows = {}
    for cell, _ in m._named_submodules.values():
        assert isinstance(cell, Instance) and cell.type == "coincid_or2"
        ports = {name: value for name, (value, _) in cell.ports.items()}
        assert cell.parameters == {"DELAY_FS": LEVEL_FS}
        for name in ("a", "b"):
            follows.setdefault(id(ports[name]), []).append(ports["y"])
    for signal in inputs:
        steps = 0
        while signal is not root:
            (signal,) = follows[id(signal)]
            steps += 1
        assert steps == levels(count) == (count - 1).bit_length()


@pytest.mark.parametrize("requests", SIZES)
def test_an_arbiter_tree_knows_which_of_any_two_requests_came_first(requests):
    """Every node has two parts, each part has one node above it, and there are as many levels as
    an OR tree has.
    """
    rows = list(arbiter_rows(requests))
    assert len(rows) == levels(requests)
    nodes = [node for pairs, _ in rows for node, _, _ in pairs]
    assert nodes == list(range(requests - 1))
    below = {k: [k] for k in range(requests)}
    free = set(range(requests))
    for pairs, alone in rows:
        used = {part for _, a, b in pairs for part in (a, b)} | ({alone} - {None})
        assert used == free
        for node, a, b in pairs:
            assert max(below[a]) < min(below[b])  # the second one has the higher numbers
            below[requests + node] = below[a] + below[b]
            free = free - {a, b} | {requests + node}
    (last,) = free
    assert below[last] == list(range(requests))


@pytest.mark.parametrize("half", [2, 4, 8, 16])
def test_taps_count_the_parts_of_a_cycle_and_a_wrong_tap_is_one_part(half):
    m, taps = Module(), Signal(half)
    out = Signal((2 * half - 1).bit_length())
    m.d.comb += out.eq(johnson_number(m, taps, "taps"))

    async def bench(ctx):
        for place in range(2 * half):
            right = sum(((place - k) % (2 * half) < half) << k for k in range(half))
            ctx.set(taps, right)
            assert ctx.get(out) == place
            for wrong in range(1, half):
                ctx.set(taps, right ^ 1 << wrong)
                assert (ctx.get(out) - place) % (2 * half) in (1, 2 * half - 1)

    simulator = Simulator(m)
    simulator.add_testbench(bench)
    simulator.run()


@pytest.mark.parametrize(
    ("minigroup", "subgroup", "cells"),
    [((4, 4), (8, 8), 6), ((2, 2), (8, 8), 6), ((1, 1), (4, 4), 4)],
)
def test_the_lag_is_that_of_the_two_trees_behind_a_hit(minigroup, subgroup, cells):
    sensor = Sensor(rows=8, cols=8, subgroup=subgroup, minigroup=minigroup)
    assert lag_fs(sensor) == HIT_FS + cells * LEVEL_FS


def test_cells_have_the_delays_and_the_widths_that_they_are_given():
    m = unused_module()
    edge, arm, clear, data = Signal(), Signal(), Signal(), Signal(5)
    hit = circuit.hit_flop(m, "one", edge, arm, clear, 70)
    plain = circuit.hit_flop(m, "plain", edge, arm, clear)
    taken = circuit.sample(m, "two", hit, Cat(data, arm))
    later = circuit.delayed(m, "three", taken[0], 90)
    cells = {name: cell for name, (cell, _) in m._named_submodules.items()}
    assert {name: (cell.type, cell.parameters) for name, cell in cells.items()} == {
        "flop_one": ("coincid_hit_flop", {"DELAY_FS": 70}),
        "flop_plain": ("coincid_hit_flop", {"DELAY_FS": 0}),
        "sample_two": ("coincid_sample", {"WIDTH": 6}),
        "delay_three": ("coincid_delay", {"DELAY_FS": 90}),
    }
    assert [len(one) for one in (hit, plain, taken, later)] == [1, 1, 6, 1]
