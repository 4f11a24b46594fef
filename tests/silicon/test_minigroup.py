# SPDX-License-Identifier: Apache-2.0
"""Minigroup of the asynchronous view: the step of the first edge from any sampled mark."""

import numpy as np
import pytest
from amaranth.sim import Simulator

from coincid.hdl.silicon.minigroup import AsyncMinigroup
from coincid.model.contract.parameters import QUARTERS, Sensor

TO_OFFSET = 4  # cycles from the sampled mark to the offset


def mark_at(place: int, steps: int) -> int:
    """Return the mark at a step of two cycles: taps that change one after another, each for half a
    cycle, and the parity of half cycles.
    """
    taps = sum((((place - k) % steps) < steps // 2) << k for k in range(steps // 2))
    half = not steps // 2 <= place < steps + steps // 2
    return taps | half << steps // 2


@pytest.mark.parametrize("steps", [4, 8, 16])
def test_the_step_of_a_mark_beyond_the_cycle_is_the_one_at_its_border(steps):
    """Marks within the cycle and within a quarter around it, for cycles of both parities."""
    dut = AsyncMinigroup(Sensor(rows=8, cols=8, phases=16, offset_phases=steps))
    quarter = steps // QUARTERS
    places = np.arange(-quarter, steps + quarter)
    found = []

    async def edges(ctx):
        for signal in (dut.active, dut.hit, dut.winner, dut.opening):
            ctx.set(signal, 1)
        for parity in (0, 1):
            for place in places.tolist():
                ctx.set(dut.parity, parity)
                ctx.set(dut.mark, mark_at((place + parity * steps) % (2 * steps), steps))
                await ctx.tick().repeat(TO_OFFSET + 1)
                found.append(ctx.get(dut.offset))

    simulator = Simulator(dut)
    simulator.add_clock(1e-8)
    simulator.add_testbench(edges)
    simulator.run()
    assert found == 2 * places.clip(0, steps - 1).tolist()
