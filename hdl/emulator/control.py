# SPDX-License-Identifier: Apache-2.0
"""Control of the emulator: routes each access to the sensor, the photon sources or the frame buffer, or answers it."""

from types import SimpleNamespace

from amaranth.hdl import Cat, Const, Module, Mux, Signal
from amaranth.lib.memory import Memory
from amaranth.lib.wiring import In, Out, Signature, connect, flipped

from ...model.contract.emulator import (
    ADDRESS_BITS,
    BUFFER_BASE,
    ECHO_OFFSET,
    LEVEL_BITS,
    OWN,
    OWN_BASE,
    OWN_BY_NAME,
    RATE_BITS,
    REGION_BITS,
    SENSOR_BASE,
    SOURCE_BASE,
    SOURCE_STRIDE,
    Emulator,
)
from ...model.contract.registers import DATA_BITS, Access
from .. import bus
from ..axi import LITE, OKAY, STREAM
from ..unit import Unit, place
from .buffer import FrameBuffer, StreamSlice
from .source import COMMON, SEED_BUS, Seeder, write_bus

# `valid` stays high until `done`, a strobe. `refused`: nothing was changed. `value`: the word that was read. The next
# access may begin two cycles later.
ACCESS = Signature(
    {
        "valid": Out(1),
        "write": Out(1),
        "address": Out(ADDRESS_BITS),
        "data": Out(DATA_BITS),
        "done": In(1),
        "refused": In(1),
        "value": In(DATA_BITS),
    }
)
LOCAL_CYCLES = 4  # from an access to the answer, for registers and memories
REGIONS = {"sensor": SENSOR_BASE, "own": OWN_BASE, "source": SOURCE_BASE, "buffer": BUFFER_BASE}
BLOCK_BITS = (SOURCE_STRIDE - 1).bit_length()


class EmulatorControl(Unit):
    """Control of the emulator.

    Ports
    -----
    access : in, from the serial link or from a bus; one at a time
    m_axi : out, AXI4-Lite master to the sensor; s_axis : in, the sensor's stream
    number : in, number of the sensor's frame; frame_done : in, strobe
    seed, write, common : out, to the photon sources; link_errors : in, from the serial link

    An access to the sensor waits while the sources are being seeded, so no frame begins before they are ready. Every
    access is answered; an illegal one with `refused`. Reset drops an access in progress. The settings of the sources
    are not reset (an FPGA powers up with 0).
    """

    unit_name = "coincid_emulator_control"

    def __init__(self, emulator: Emulator):
        self.emulator = emulator
        super().__init__(
            {
                "access": In(ACCESS),
                "m_axi": Out(LITE),
                "s_axis": In(STREAM),
                "number": In(bus.PULSE_BITS),
                "frame_done": In(1),
                "seed": Out(SEED_BUS),
                "write": Out(write_bus(emulator.sensor)),
                "common": Out(COMMON),
                "link_errors": In(DATA_BITS),
            }
        )

    def elaborate(self, platform):
        m = Module()
        self.state = SimpleNamespace()
        buffer = place(m, "buffer", FrameBuffer(self.emulator), platform)
        seeder = place(m, "seeder", Seeder(self.emulator), platform)
        between = place(m, "slice", StreamSlice(), platform)
        connect(m, flipped(self.s_axis), between.s_axis)
        connect(m, between.m_axis, buffer.s_axis)
        m.d.comb += [seeder.number.eq(self.number), self.seed.eq(seeder.out)]
        self._settings(m, seeder)
        self._local(m, buffer, seeder)
        self._accesses(m, buffer, seeder)
        return m

    def _settings(self, m, seeder):
        """The emulator's own settings, by name."""
        state = self.state
        state.setting = {
            r.name: Signal(r.high(self.emulator.sensor).bit_length(), init=r.reset(self.emulator.sensor), name=r.name)
            for r in OWN
            if r.access is Access.SETTING
        }
        state.reseed = Signal()
        late = Signal()  # the frame number changes with `frame_done`
        m.d.sync += late.eq(self.frame_done)
        m.d.comb += [seeder.seed.eq(state.setting["seed"]), seeder.begin.eq(state.reseed | late)]
        m.d.sync += [
            self.common.spread.eq((1 << state.setting["spread"]) - 1),
            self.common.dead.eq(state.setting["dead_cycles"] - 1),
        ]

    def _local(self, m, buffer, seeder):
        """Decode an address outside the sensor, and register the word that is read there."""
        state, access, sensor = self.state, self.access, self.emulator.sensor
        inside = access.address[:REGION_BITS]
        state.region = {}
        for name, base in REGIONS.items():
            state.region[name] = Signal(name=f"in_{name}")
            m.d.sync += state.region[name].eq(access.address[REGION_BITS:] == base >> REGION_BITS)
        content = {name: signal for name, signal in state.setting.items()}
        content |= {
            "buffer_beats": Const(self.emulator.buffer_beats, DATA_BITS),
            "buffer_level": buffer.level,
            "buffer_first": buffer.first,
            "stalls": buffer.stalls,
            "link_errors": self.link_errors,
            "seeding": seeder.busy,
        }
        state.own = Signal(DATA_BITS, reset_less=True)
        state.named = {r.name: Signal(name=f"named_{r.name}") for r in OWN}
        for r in OWN:
            m.d.sync += state.named[r.name].eq(inside == r.offset)
        words = []
        for r in OWN:
            value = (
                Const(r.reset(sensor), DATA_BITS)
                if r.access is Access.CONSTANT and r.name not in content
                else content.get(r.name, Const(0, DATA_BITS))
            )
            words.append(Mux(state.named[r.name], value, 0))
        found = words[0]
        for word in words[1:]:
            found = found | word
        m.d.sync += state.own.eq(found)
        # The settings of the sources cannot be read back, so this memory keeps a copy.
        subgroup, block = inside[BLOCK_BITS:], inside[:BLOCK_BITS]
        pixel = (block - ECHO_OFFSET)[2:]
        state.subgroup, state.pixel = subgroup, pixel
        state.is_echo, state.is_background, state.aligned = Signal(), Signal(), Signal()
        m.d.sync += [
            state.is_echo.eq(
                (subgroup < sensor.subgroups) & (block >= ECHO_OFFSET) & (block < ECHO_OFFSET + 4 * sensor.pixels)
            ),
            state.is_background.eq((subgroup < sensor.subgroups) & (block == 0)),
            state.aligned.eq(access.address[:2] == 0),
        ]
        width = LEVEL_BITS + sensor.stamp_bits
        places = 1 << (sensor.pixels - 1).bit_length()
        m.submodules.echoes = echoes = Memory(shape=width, depth=sensor.subgroups * places, init=[])
        m.submodules.backgrounds = backgrounds = Memory(shape=RATE_BITS, depth=max(2, sensor.subgroups), init=[])
        state.echo_write, state.background_write = echoes.write_port(), backgrounds.write_port()
        echo_read, background_read = echoes.read_port(), backgrounds.read_port()
        at_echo = Signal(range(sensor.subgroups * places))
        m.d.comb += at_echo.eq(Cat(pixel[: places.bit_length() - 1], subgroup))
        for port, at in (
            (state.echo_write, at_echo), (echo_read, at_echo), (state.background_write, subgroup), (background_read, subgroup)
        ):  # fmt: skip
            m.d.comb += port.addr.eq(at)
        m.d.comb += [
            echo_read.en.eq(1),
            background_read.en.eq(1),
            state.echo_write.data.eq(access.data),
            state.background_write.data.eq(access.data),
            buffer.address.eq(inside[2:]),
            buffer.amount.eq(access.data),
        ]
        state.sources = Signal(DATA_BITS, reset_less=True)
        m.d.sync += state.sources.eq(Mux(state.is_echo, echo_read.data, background_read.data))
        # Checks of the ranges: first of each, then of the one that is meant.
        state.legal = Signal()
        fits = {
            r.name: (access.data >= r.low(sensor)) & (access.data <= r.high(sensor))
            for r in OWN
            if r.access is Access.SETTING
        }
        fits["buffer_take"] = access.data <= buffer.level
        checks = []
        for name, in_range in fits.items():
            fit = Signal(name=f"fits_{name}")
            m.d.sync += fit.eq(in_range)
            checks.append(state.named[name] & fit)
        m.d.sync += state.legal.eq(
            Mux(
                state.region["own"],
                Cat(checks).any(),
                state.region["source"]
                & (
                    (state.is_echo & (access.data < 1 << width))
                    | (state.is_background & (access.data < 1 << RATE_BITS))
                ),
            )
            & state.aligned
        )
        state.mapped = Signal()
        places_in_buffer = self.emulator.buffer_beats * 8
        m.d.sync += state.mapped.eq(
            state.aligned
            & (
                (state.region["own"] & Cat(state.named.values()).any())
                | (state.region["source"] & (state.is_echo | state.is_background))
                | (
                    state.region["buffer"]
                    & (inside < places_in_buffer if places_in_buffer < 1 << REGION_BITS else Const(1))
                )
            )
        )
        assert OWN_BY_NAME["buffer_take"].access is Access.PULSE

    def _accesses(self, m, buffer, seeder):
        """Carry out one access at a time."""
        state, access, axi = self.state, self.access, self.m_axi
        wait = Signal(range(LOCAL_CYCLES + 1))
        m.d.comb += [axi.bready.eq(1), axi.rready.eq(1), axi.wstrb.eq(0b1111), axi.awprot.eq(0), axi.arprot.eq(0)]
        m.d.sync += [access.done.eq(0), state.reseed.eq(0), self.write.valid.eq(0), buffer.take.eq(0)]
        m.d.sync += [
            self.write.subgroup.eq(state.subgroup),
            self.write.echo.eq(state.is_echo),
            self.write.pixel.eq(state.pixel),
            self.write.data.eq(access.data),
        ]
        for channel in ("aw", "w", "ar"):
            valid, ready = getattr(axi, f"{channel}valid"), getattr(axi, f"{channel}ready")
            with m.If(valid & ready):
                m.d.sync += valid.eq(0)
        with m.FSM() as state.machine:
            with m.State("idle"):
                m.d.sync += wait.eq(0)
                with m.If(access.valid & ~access.done):
                    with m.If(access.address[REGION_BITS:] == SENSOR_BASE >> REGION_BITS):
                        with m.If(~seeder.busy & ~seeder.begin):
                            m.d.sync += [
                                axi.awaddr.eq(access.address),
                                axi.araddr.eq(access.address),
                                axi.wdata.eq(access.data),
                                axi.awvalid.eq(access.write),
                                axi.wvalid.eq(access.write),
                                axi.arvalid.eq(~access.write),
                            ]
                            m.next = "sensor"
                    with m.Else():
                        m.next = "local"
            with m.State("sensor"):
                with m.If(axi.bvalid | axi.rvalid):
                    m.d.sync += [
                        access.done.eq(1),
                        access.refused.eq(Mux(axi.bvalid, axi.bresp, axi.rresp) != OKAY),
                        access.value.eq(axi.rdata),
                    ]
                    m.next = "idle"
            with m.State("local"):
                m.d.sync += wait.eq(wait + 1)
                with m.If(wait == LOCAL_CYCLES):
                    m.next = "idle"
                    m.d.sync += [
                        access.done.eq(1),
                        access.refused.eq(~Mux(access.write, state.legal, state.mapped)),
                        access.value.eq(
                            Mux(state.region["own"], state.own, Mux(state.region["source"], state.sources, buffer.word))
                        ),
                    ]
                    with m.If(access.write & state.legal):
                        self._write(m, buffer)
            with m.State("lost"):  # the one code that is no state: after an upset, the bus must not hang
                m.next = "idle"

    def _write(self, m, buffer):
        state, access = self.state, self.access
        with m.If(state.region["source"]):
            m.d.sync += self.write.valid.eq(1)
            m.d.comb += [state.echo_write.en.eq(state.is_echo), state.background_write.en.eq(state.is_background)]
        with m.Else():
            for name, setting in state.setting.items():
                with m.If(state.named[name]):
                    m.d.sync += setting.eq(access.data)
            m.d.sync += [state.reseed.eq(state.named["seed"]), buffer.take.eq(state.named["buffer_take"])]
