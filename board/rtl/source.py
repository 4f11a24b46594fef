# SPDX-License-Identifier: Apache-2.0
"""Photon source: generates the edge words of a subgroup's SPADs on the chip.

Its golden model is `board/source_model.py`.

Every pixel has a linear generator of 32 bits that steps once in every cycle of a period. In each
cycle, its state decides whether there is a background photon, and at which phase. In the first
cycle of a period it also decides whether there is an echo, and in the second cycle at which tick.
The paper has no such block; all of it is our choice.
"""

from amaranth.hdl import Cat, Module, Mux, Signal
from amaranth.lib import data
from amaranth.lib.wiring import In, Out

from ...hdl import bus
from ...hdl.unit import Unit
from ...model.contract.parameters import Sensor, bits_for
from .. import parameters as chip
from ..parameters import Emulator

SUBGROUP_BITS = 8  # width of a subgroup's number in the emulator
PIXEL_BITS = 8
HALF = chip.STATE_BITS
SEED_BUS = data.StructLayout(
    {
        "valid": 1,
        "subgroup": SUBGROUP_BITS,
        "lane": bits_for(256 // chip.LANE_PIXELS - 1),
        "first": 1,
        "last": 1,
        "bits": chip.LANE_PIXELS,
    }
)


def write_bus(sensor: Sensor) -> data.StructLayout:
    """A write to a setting of a source.

    echo: to the echo of one pixel; otherwise to the background.
    """
    return data.StructLayout(
        {
            "valid": 1,
            "subgroup": SUBGROUP_BITS,
            "echo": 1,
            "pixel": PIXEL_BITS,
            "data": max(chip.RATE_BITS, chip.LEVEL_BITS + sensor.stamp_bits),
        }
    )


# `spread` is a mask of ticks, `dead` the cycles of dead time - 1.
COMMON = data.StructLayout({"spread": chip.SPREAD_MAX, "dead": bits_for(chip.DEAD_MAX - 1)})


class Seeder(Unit):
    """Seeder of all generators: computes a frame's states from the seed and the frame number with a
    block cipher.

    Ports
    -----
    seed, number : in, of the source and of the frame; begin : in, strobe: one of them has changed
    out : out, one seeding step for one lane of a subgroup: one bit for the generator of each of its
        pixels
    busy : out, from the cycle after `begin` until all bits have been sent

    A block takes `ROUNDS` + 1 cycles; a subgroup has 32 blocks per 64 pixels. `begin` while busy
    starts over. Seeding also starts after a reset.
    """

    unit_name = "coincid_seeder"

    def __init__(self, emulator: Emulator):
        self.emulator = emulator
        super().__init__(
            seed=In(HALF),
            number=In(bus.PULSE_BITS),
            begin=In(1),
            out=Out(SEED_BUS),
            busy=Out(1, init=1),
        )

    def elaborate(self, platform):
        m = Module()
        subgroups = self.emulator.sensor.subgroups
        blocks = self.emulator.lanes * chip.STATE_BITS
        left = Signal(HALF, reset_less=True)
        right = Signal(HALF, reset_less=True)
        key = Signal(HALF, reset_less=True)
        turn = Signal(range(chip.ROUNDS + 1))  # 0: load
        block = Signal(range(blocks + 1))
        subgroup = Signal(SUBGROUP_BITS)
        rotated = Signal(HALF)
        mixed = Signal(HALF)
        lane_step = Signal(range(chip.STATE_BITS))
        m.d.comb += [
            rotated.eq(Cat(left[chip.ROTATE_RIGHT :], left[: chip.ROTATE_RIGHT]) + right),
            mixed.eq(rotated ^ key),
            lane_step.eq(block[: chip.STATE_BITS.bit_length() - 1]),
        ]
        m.d.sync += [
            self.out.valid.eq(0),
            self.out.bits.eq(Cat(right, left)),
            self.out.subgroup.eq(subgroup),
            self.out.lane.eq(block >> (chip.STATE_BITS.bit_length() - 1)),
            self.out.first.eq(lane_step == 0),
            self.out.last.eq(lane_step == chip.STATE_BITS - 1),
        ]
        done = Signal()  # a finished block of the cipher
        with m.If(turn == 0):
            with m.If(done):
                m.d.sync += [self.out.valid.eq(1), done.eq(0), block.eq(block + 1)]
                with m.If(block == blocks - 1):
                    m.d.sync += [block.eq(0), subgroup.eq(subgroup + 1)]
                    with m.If(subgroup == subgroups - 1):
                        m.d.sync += [self.busy.eq(0), subgroup.eq(0)]
            with m.Elif(self.busy):
                m.d.sync += [
                    left.eq(Cat(self.number, subgroup)),
                    right.eq(block),
                    key.eq(self.seed),
                    turn.eq(1),
                ]
        with m.Else():
            m.d.sync += [
                left.eq(mixed),
                right.eq(
                    Cat(right[HALF - chip.ROTATE_LEFT :], right[: HALF - chip.ROTATE_LEFT]) ^ mixed
                ),
                key.eq(key + chip.KEY_STEP),
                turn.eq(Mux(turn == chip.ROUNDS, 0, turn + 1)),
                done.eq(turn == chip.ROUNDS),
            ]
        with m.If(self.begin):
            m.d.sync += [
                self.busy.eq(1),
                self.out.valid.eq(0),
                turn.eq(0),
                done.eq(0),
                block.eq(0),
                subgroup.eq(0),
            ]
        return m


class LaneState:
    """Registers for the generators of a lane: whether they step, and what a step of the seeding
    does to them.
    """

    def __init__(self, lane: int):
        self.enable = Signal(name=f"steps_{lane}", reset_less=True)
        self.first = Signal(name=f"first_{lane}", reset_less=True)
        self.last = Signal(name=f"last_{lane}", reset_less=True)
        self.bits = Signal(chip.LANE_PIXELS, name=f"bits_{lane}", reset_less=True)


class PhotonSource(Unit):
    """Photon source of a subgroup.

    Ports
    -----
    subgroup : in, the subgroup's number
    timing : in, the sequencer's word, three cycles ahead of the ports; seed : in, from the seeder;
        write : in, a setting of one source; common : in, settings of all sources
    words : out, pixels * phases: edge words for the sensor's ports, with at most one edge per pixel
        and cycle

    Settings take effect at once, but should change only between frames. A pixel's edge is the
    earlier of its background photon and its echo, unless the pixel is dead. There are three
    registers from `timing` to the word: timing, draw, word. Reset clears the cycle counter; the
    settings are not reset (an FPGA powers up with 0).
    """

    unit_name = "coincid_source"

    def __init__(self, emulator: Emulator):
        self.emulator = emulator
        sensor = emulator.sensor
        super().__init__(
            subgroup=In(SUBGROUP_BITS),
            timing=In(bus.time_layout(sensor)),
            seed=In(SEED_BUS),
            write=In(write_bus(sensor)),
            common=In(COMMON),
            words=Out(sensor.pixels * sensor.phases),
        )
        # Cycles of dead time left, by pixel.
        self.dead = [Signal(COMMON["dead"].width, name=f"dead_{i}") for i in range(sensor.pixels)]

    def elaborate(self, platform):
        m = Module()
        sensor = self.emulator.sensor
        running = Signal()
        cycle = Signal(sensor.coarse_bits)  # number of the cycle in its period
        is_first = Signal()  # the cycle is the first of a period,
        is_second = Signal()  # the second,
        is_later = Signal()  # or a later one
        m.d.sync += [
            running.eq(self.timing.running),
            is_first.eq(self.timing.running & self.timing.start),
            is_second.eq(is_first),
            is_later.eq(self.timing.running & (is_second | is_later) & ~self.timing.start),
            cycle.eq(Mux(self.timing.start, 0, cycle + 1)),
        ]
        assert chip.ECHO_FROM == 2  # `is_later` begins in this cycle
        background = Signal(chip.RATE_BITS, reset_less=True)
        # Inputs and data go into registers that need no reset, because those that drive or use them
        # have one.
        mine = Signal(reset_less=True)  # a setting of this source is written
        seeded = Signal(SEED_BUS, reset_less=True)
        seeds = [self._lane(m, lane, seeded) for lane in range(self.emulator.lanes)]
        written = Signal(write_bus(sensor), reset_less=True)
        value = Signal.like(written.data, reset_less=True)
        m.d.sync += [
            seeded.eq(self.seed),
            seeded.valid.eq(self.seed.valid & (self.seed.subgroup == self.subgroup)),
        ]
        m.d.sync += [
            written.eq(self.write),
            mine.eq(self.write.valid & (self.write.subgroup == self.subgroup)),
        ]
        m.d.sync += value.eq(written.data)
        with m.If(mine & ~written.echo):
            m.d.sync += background.eq(written.data)
        common = Signal(COMMON, reset_less=True)
        m.d.sync += common.eq(self.common)
        for i in range(sensor.pixels):
            lane, place = divmod(i, chip.LANE_PIXELS)
            state = self._generator(m, i, seeds[lane], place)
            echo = Signal(chip.LEVEL_BITS + sensor.stamp_bits, name=f"echo_{i}", reset_less=True)
            writes = Signal(name=f"writes_{i}", reset_less=True)
            m.d.sync += writes.eq(mine & written.echo & (written.pixel == i))
            with m.If(writes):
                m.d.sync += echo.eq(value)
            fires, phase = self._draw(
                m, i, state, echo, background, common, running, is_first, is_second, is_later, cycle
            )
            self._word(m, i, fires, phase, common)
        return m

    def _lane(self, m, lane, seeded):
        """Return the registers of a lane."""
        seeds = Signal(name=f"seeds_{lane}")
        step = LaneState(lane)
        m.d.comb += seeds.eq(seeded.valid & (seeded.lane == lane))
        m.d.sync += [
            step.enable.eq(self.timing.running | seeds),
            step.first.eq(seeds & seeded.first),
            step.last.eq(seeds & seeded.last),
            step.bits.eq(seeded.bits & seeds.replicate(chip.LANE_PIXELS)),
        ]
        return step

    def _generator(self, m, i, step, place):
        """Return the state that the cycle draws from. step: of its lane; place: in the lane.

        Seeding: the first step clears the old state, every step shifts in one bit, and the last
        step prevents the state 0.
        """
        state = Signal(chip.STATE_BITS, name=f"state_{i}", reset_less=True)
        following = Cat(
            state[taps[0]] ^ state[taps[1]] ^ (state[taps[2]] if len(taps) > 2 else 0)
            for taps in chip.TAPS
        )
        with m.If(step.enable):
            m.d.sync += state.eq(following)
            with m.If(step.first):
                m.d.sync += state.eq(0)
            m.d.sync += state[chip.SEED_BIT].eq(
                (following[chip.SEED_BIT] & ~step.first) ^ step.bits[place] | step.last
            )
        return state

    def _draw(
        self, m, i, state, echo, background, common, running, is_first, is_second, is_later, cycle
    ):
        """Decide, with registers, whether the pixel sees a photon in the cycle, and give the phase
        of the first one.
        """
        sensor = self.emulator.sensor
        phase_bits = sensor.phase_bits
        stamp_bits = sensor.stamp_bits
        hit = Signal(name=f"hit_{i}", reset_less=True)
        arrival = Signal(stamp_bits + 1, name=f"arrival_{i}", reset_less=True)
        level = echo[: chip.LEVEL_BITS]
        tick = echo[chip.LEVEL_BITS :]
        with m.If(is_first):
            m.d.sync += hit.eq(state[chip.LEVEL_LSB : chip.LEVEL_LSB + chip.LEVEL_BITS] < level)
        with m.If(is_second):
            m.d.sync += arrival.eq(
                tick + (state[chip.LEVEL_LSB : chip.LEVEL_LSB + chip.SPREAD_MAX] & common.spread)
            )
        by_light = Signal(name=f"by_light_{i}")
        by_echo = Signal(name=f"by_echo_{i}")
        light_phase = state[chip.PHASE_LSB : chip.PHASE_LSB + phase_bits]
        echo_phase = arrival[:phase_bits]
        fires = Signal(name=f"fires_{i}")
        phase = Signal(phase_bits, name=f"phase_{i}", reset_less=True)
        m.d.comb += [
            by_light.eq(state[chip.RATE_LSB : chip.RATE_LSB + chip.RATE_BITS] < background),
            by_echo.eq(hit & is_later & (arrival[phase_bits:] == cycle)),
        ]
        m.d.sync += [
            fires.eq(running & (by_light | by_echo)),
            phase.eq(
                Mux(by_light & (~by_echo | (light_phase < echo_phase)), light_phase, echo_phase)
            ),
        ]
        return fires, phase

    def _word(self, m, i, fires, phase, common):
        """Register the pixel's part of the word, which is 0 during the dead time."""
        phases = self.emulator.sensor.phases
        dead = self.dead[i]
        word = Signal(phases, name=f"word_{i}")
        m.d.sync += word.eq(0)
        with m.If(dead != 0):
            m.d.sync += dead.eq(dead - 1)
        with m.Elif(fires):
            m.d.sync += [dead.eq(common.dead), word.eq(1 << phase)]
        m.d.comb += self.words[i * phases : (i + 1) * phases].eq(word)
