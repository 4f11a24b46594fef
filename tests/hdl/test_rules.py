# SPDX-License-Identifier: Apache-2.0
"""A rule of coincidence of one's own in the circuit: it sees each window by its pixels, their
places and their number, at the threshold in force and at the one below.
"""

import numpy as np
import pytest
from amaranth.sim import Simulator

from coincid.hdl import bus
from coincid.hdl.dpcu import Dpcu
from coincid.model.contract.coincidence import Rule
from coincid.model.contract.counters import COUNTER_BITS, COUNTER_NAMES
from coincid.model.contract.parameters import Sensor

WINDOWS = 60
SETTLED = 4  # cycles from an operation or a window until nothing changes


class LastRow(Rule):
    """Enough pixels, one of them in the last row."""

    name = "last-row"
    version = "1"

    def meets(self, maps, threshold):
        return (maps.sum(axis=(1, 2)) >= threshold) & maps[:, -1].any(axis=1)

    def circuit(self, hits, count, threshold, shape):
        rows, cols = shape
        return (count >= threshold) & hits[(rows - 1) * cols :].any()


@pytest.mark.parametrize("subgroup", [(2, 8), (8, 2)])
def test_the_circuit_judges_windows_by_the_rule_of_its_sensor(subgroup):
    """Every window is an event at threshold 1, and where coincidence is off."""
    rule = LastRow()
    rows, cols = subgroup
    sensor = Sensor(rows=rows, cols=cols, subgroup=subgroup, phases=4, window_max=8, rule=rule)
    dut = Dpcu(sensor)
    lower = COUNTER_NAMES.index("lower")
    random = np.random.default_rng(1)
    maps = random.random((WINDOWS, rows, cols)) < random.uniform(0.02, 0.3, (WINDOWS, 1, 1))

    async def bench(ctx):
        for threshold, coincidence in ((1, 1), (2, 1), (3, 1), (4, 1), (4, 0)):
            ctx.set(dut.settings.threshold, threshold)
            ctx.set(dut.settings.coincidence, coincidence)
            ctx.set(dut.operation, bus.Operation.BEGIN)
            await ctx.tick()
            ctx.set(dut.operation, bus.Operation.IDLE)
            await ctx.tick().repeat(SETTLED)
            committed = []
            for of_window in maps:
                hits = sum(1 << int(k) for k in np.flatnonzero(of_window))
                ctx.set(dut.window.hits, hits)
                ctx.set(dut.window.count, hits.bit_count())
                ctx.set(dut.closed, 1)
                await ctx.tick()
                committed.append(bool(ctx.get(dut.commit)))
                assert not committed[-1] or ctx.get(dut.event.hits) == hits
            ctx.set(dut.closed, 0)
            await ctx.tick().repeat(SETTLED)
            limit = threshold if coincidence else 1
            due = rule.judged(maps, limit)
            assert committed == due.tolist()
            assert due.all() == (limit == 1)
            counted = ctx.get(dut.counters) >> COUNTER_BITS * lower & (1 << COUNTER_BITS) - 1
            assert counted == rule.judged(maps, limit - 1).sum()

    simulator = Simulator(dut)
    simulator.add_clock(1e-8)
    simulator.add_testbench(bench)
    simulator.run()
