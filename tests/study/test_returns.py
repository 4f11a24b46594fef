# SPDX-License-Identifier: Apache-2.0
"""Four surfaces per pixel and a point at 150 m; two windows per cycle: both circuits do the same as a loop over the ticks."""

import numpy as np
import pytest
from amaranth.sim import Simulator

from coincid.lab.outcomes import Run
from coincid.model.contract.parameters import Sensor
from coincid.model.depth.quality import TOLERANCE_M
from coincid.study import returns
from coincid.study.rearm import WINDOWS, Ahead, Twice

CYCLES = 300


def plain(roots, phases, window):
    """Return the phases at which windows open and the number that close, by cycle."""
    told, until = [], 0  # the tick at which the open window ends
    for cycle, root in enumerate(roots):
        start, opened, closed = cycle * phases, [], 0
        used = until > start
        closed += used and until <= start + phases
        for tick in range(start, start + phases):
            if root[tick - start] and tick >= until and used + len(opened) < WINDOWS:
                opened.append(tick - start)
                until = tick + window
                closed += until <= start + phases
        told.append((opened, closed))
    return told


@pytest.mark.parametrize("window", [1, 4, 8, 16, 40])
@pytest.mark.parametrize("unit", [Twice, Ahead])
def test_windows_are_those_of_a_loop_over_ticks(unit, window):
    sensor = Sensor()
    rng = np.random.default_rng(window)
    roots = rng.random((CYCLES, sensor.phases)) < rng.choice([0, 0.02, 0.05, 0.2], CYCLES)[:, None]
    device, told = unit(sensor), []

    async def bench(ctx):
        ctx.set(device.window_ticks, window)
        await ctx.tick().repeat(8)
        for root in [*roots, *np.zeros((device.latency, sensor.phases), bool)]:
            ctx.set(device.root, sum(1 << int(k) for k in np.flatnonzero(root)))
            await ctx.tick()
            opened = [ctx.get(device.opened) >> k & 1 for k in range(WINDOWS)]
            at = [ctx.get(device.phase_0), ctx.get(device.phase_1)]
            told.append(([p for p, now in zip(at, opened) if now], ctx.get(device.closed).bit_count()))

    simulator = Simulator(device)
    simulator.add_clock(1e-6)
    simulator.add_testbench(bench)
    simulator.run()
    expected = plain(roots, sensor.phases, window)
    assert told[device.latency - 1 :][:CYCLES] == expected
    assert any(len(opened) > 1 for opened, _ in expected) == (window < sensor.phases)


@pytest.mark.parametrize("step_m", returns.STEPS_M)
def test_four_surfaces_in_every_histogram(step_m):
    shares = returns.all_found(Run(returns.setup(returns.NEAREST_M[0], step_m)))
    assert min(shares.values()) >= 0.95


def test_a_cycle_hides_its_second_surface_in_bright_light():
    slow, fast = (
        returns.all_found(Run(returns.setup(4.0, 0.15, photons=0.6, pulses=1000, faster=faster)))["map"]
        for faster in (False, True)
    )
    assert slow < 0.05 and fast > 0.9


def test_a_point_at_150_m():
    near, far = (abs(returns.point_error_m(Run(returns.point(0.1, 10.0, 1000, 0, nj)))) for nj in (2.0, 0.01))
    assert near < TOLERANCE_M < far
