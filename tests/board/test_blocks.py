# SPDX-License-Identifier: Apache-2.0
"""Blocks of the emulator in Amaranth's simulator: the seeder with several lanes, the AXI4-Lite slave,
and the settings of the sources.
"""

import numpy as np
import pytest
from amaranth.sim import Simulator
from attrs import evolve

from coincid.board.parameters import (
    LANE_PIXELS,
    LEVEL_BITS,
    RATE_BITS,
    SEED_BIT,
    STATE_BITS,
    Emulator,
    background_address,
    echo_address,
)
from coincid.board.rtl.control import EmulatorControl
from coincid.board.rtl.source import Seeder, write_bus
from coincid.board.rtl.top import BusAccess
from coincid.board.source_model import _tables, advance, seeds
from coincid.hdl.axi import OKAY, SLVERR
from coincid.model.contract.parameters import Sensor

from .sensors import SENSOR


@pytest.mark.parametrize(("size", "seeded"), [((4, 4), 0), ((4, 4), 1), ((14, 16), 0)])
def test_seeder(size, seeded):
    """The seeder makes the states of the golden model: with less than a lane of pixels, and with
    four lanes of which the last one is not full. It starts over in the middle of any subgroup.
    """
    sensor = Sensor(
        rows=size[0], cols=2 * size[1], phases=8, window_max=16, subgroup=size, minigroup=(2, 2)
    )
    dut, seed, frame = Seeder(Emulator(sensor=sensor)), 0x1234_5678, 77
    states = np.zeros((2, sensor.pixels), np.uint32)

    async def watch(ctx):
        ctx.set(dut.seed, seed)
        ctx.set(dut.number, frame)
        while not (ctx.get(dut.out.valid) and ctx.get(dut.out.subgroup) == seeded):
            await ctx.tick()
        ctx.set(dut.begin, 1)  # during the seeding after the reset: it starts over
        await ctx.tick()
        ctx.set(dut.begin, 0)
        while True:
            *_, busy, valid, subgroup, lane, first, last, bits = await ctx.tick().sample(
                dut.busy,
                dut.out.valid,
                dut.out.subgroup,
                dut.out.lane,
                dut.out.first,
                dut.out.last,
                dut.out.bits,
            )
            if valid:
                mine = slice(LANE_PIXELS * lane, min(LANE_PIXELS * (lane + 1), sensor.pixels))
                n = len(states[subgroup, mine])
                took = np.array([bits >> i & 1 for i in range(n)], np.uint32)
                before = (
                    np.zeros(n, np.uint32) if first else advance(states[subgroup, mine], _tables())
                )
                states[subgroup, mine] = (before ^ took << np.uint32(SEED_BIT)) | np.uint32(
                    last << SEED_BIT
                )
            elif not busy:
                return

    simulator = Simulator(dut)
    simulator.add_clock(1e-8)
    simulator.add_testbench(watch)
    simulator.run()
    assert STATE_BITS == 32
    for s in range(2):
        assert np.array_equal(states[s], seeds(seed, frame, s, sensor.pixels))


def test_bus_slave():
    """Accesses take turns and are answered once; refusals and partial writes get SLVERR, writes
    without strobes OKAY, and neither has an effect.
    """
    dut = BusAccess()
    memory, seen = {}, []

    async def control(ctx):
        while True:
            *_, valid, write, address, value = await ctx.tick().sample(
                dut.access.valid, dut.access.write, dut.access.address, dut.access.data
            )
            if valid and not ctx.get(dut.access.done):
                for _ in range(len(seen) % 3):
                    await ctx.tick()
                seen.append(address)
                refused = address >= 0x1000
                if write and not refused:
                    memory[address] = value
                ctx.set(dut.access.refused, refused)
                ctx.set(dut.access.value, memory.get(address, 0))
                ctx.set(dut.access.done, 1)
                await ctx.tick()
                ctx.set(dut.access.done, 0)

    async def write(ctx, address, value, strobe=0xF, data_first=False):
        axi = dut.s_axi
        channels = [(axi.awvalid, axi.awready), (axi.wvalid, axi.wready)]
        ctx.set(axi.awaddr, address)
        ctx.set(axi.wdata, value)
        ctx.set(axi.wstrb, strobe)
        for valid, ready in channels[::-1] if data_first else channels:
            ctx.set(valid, 1)
            await ctx.tick().until(ready)
            ctx.set(valid, 0)
        ctx.set(axi.bready, 1)
        (response,) = await ctx.tick().sample(axi.bresp).until(axi.bvalid)
        ctx.set(axi.bready, 0)
        return response

    async def read(ctx, address):
        axi = dut.s_axi
        ctx.set(axi.araddr, address)
        ctx.set(axi.arvalid, 1)
        await ctx.tick().until(axi.arready)
        ctx.set(axi.arvalid, 0)
        ctx.set(axi.rready, 1)
        response, value = await ctx.tick().sample(axi.rresp, axi.rdata).until(axi.rvalid)
        ctx.set(axi.rready, 0)
        return response, value

    async def master(ctx):
        for k in range(6):
            assert await write(ctx, 4 * k, 100 + k, data_first=k % 2 == 1) == OKAY
        for k in range(6):
            assert await read(ctx, 4 * k) == (OKAY, 100 + k)
        assert await write(ctx, 0x1000, 1) == SLVERR
        assert (await read(ctx, 0x1000))[0] == SLVERR
        before = len(seen)
        assert await write(ctx, 0, 7, strobe=0b0111) == SLVERR
        assert await write(ctx, 0, 7, strobe=0) == OKAY
        assert len(seen) == before and await read(ctx, 0) == (OKAY, 100)
        assert len(seen) == 15

    simulator = Simulator(dut)
    simulator.add_clock(1e-8)
    simulator.add_testbench(control, background=True)
    simulator.add_testbench(master)
    simulator.run()


@pytest.mark.parametrize(
    "sizes",
    [
        {"rows": 4, "cols": 8, "subgroup": (4, 4)},
        {"rows": 6, "cols": 15, "subgroup": (6, 3), "minigroup": (2, 3)},
        {"rows": 6, "cols": 4, "subgroup": (6, 4)},
    ],
    ids=["16 pixels", "18 pixels", "a single subgroup of 24"],
)
def test_every_source_keeps_its_own_settings(sizes):
    """Also where a subgroup's pixels are no power of two."""
    sensor = Sensor(phases=8, window_max=16, **sizes)
    dut = EmulatorControl(Emulator(sensor=sensor, buffer_beats=64))
    rng = np.random.default_rng(1)
    echoes = [
        (echo_address(s, i), s, i) for s in range(sensor.subgroups) for i in range(sensor.pixels)
    ]
    backgrounds = [(background_address(s), s, None) for s in range(sensor.subgroups)]
    places = [(*place, LEVEL_BITS + sensor.stamp_bits) for place in echoes]
    places += [(*place, RATE_BITS) for place in backgrounds]
    values = [int(rng.integers(1 << bits)) for *_, bits in places]
    beyond = echo_address(0, sensor.pixels), background_address(sensor.subgroups)

    async def access(ctx, address, write=0, value=0):
        """Return the answer, and what the sources were told in its cycle."""
        ctx.set(dut.access.address, address)
        ctx.set(dut.access.write, write)
        ctx.set(dut.access.data, value)
        ctx.set(dut.access.valid, 1)
        while not ctx.get(dut.access.done):
            await ctx.tick()
        answer = ctx.get(dut.access.refused), ctx.get(dut.access.value), ctx.get(dut.write)
        ctx.set(dut.access.valid, 0)
        await ctx.tick()
        return answer

    async def host(ctx):
        for k in rng.permutation(len(places)):
            address, s, i, _ = places[k]
            refused, _, told = await access(ctx, address, 1, values[k])
            assert not refused
            assert (told.valid, told.subgroup, told.echo) == (1, s, i is not None)
            assert told.data == values[k]
            assert i is None or told.pixel == i
        for k in rng.permutation(len(places)):
            refused, value, told = await access(ctx, places[k][0])
            assert (refused, value, told.valid) == (0, values[k], 0), places[k]
        for address in beyond:
            for write in (0, 1):
                refused, _, told = await access(ctx, address, write)
                assert (refused, told.valid) == (1, 0)

    simulator = Simulator(dut)
    simulator.add_clock(1e-8)
    simulator.add_testbench(host)
    simulator.run()


@pytest.mark.parametrize("coarse_bits", [5, 6, 12])
def test_a_write_to_a_source_has_room_for_each_of_its_settings(coarse_bits):
    """For a rate of the background, and for the level and the time of an echo."""
    few = evolve(SENSOR, coarse_bits=coarse_bits)
    room = write_bus(few)["data"].width
    assert room == max(RATE_BITS, LEVEL_BITS + few.stamp_bits)
