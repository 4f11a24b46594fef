# SPDX-License-Identifier: Apache-2.0
"""Control of the emulator: routes each access to the sensor, the photon sources or the frame
buffer, or answers it.
"""

from functools import reduce
from operator import or_

from amaranth.hdl import Cat, Const, Module, Mux, Signal
from amaranth.lib.memory import Memory
from amaranth.lib.wiring import In, Out, Signature, connect, flipped

from ...hdl import bus
from ...hdl.axi import LITE, OKAY, STREAM
from ...hdl.unit import Unit, place
from ...model.contract.registers import DATA_BITS, Access, control
from .. import parameters as chip
from ..parameters import Emulator
from .buffer import FrameBuffer, StreamSlice
from .source import COMMON, SEED_BUS, Seeder, write_bus

# `valid` stays high until `done`, a strobe. `refused`: nothing was changed. `value`: the word that
# was read. The next access may begin two cycles later.
ACCESS = Signature(
    {
        "valid": Out(1),
        "write": Out(1),
        "address": Out(chip.ADDRESS_BITS),
        "data": Out(DATA_BITS),
        "done": In(1),
        "refused": In(1),
        "value": In(DATA_BITS),
    }
)
LOCAL_CYCLES = 4  # from an access to the answer, for registers and memories
REGIONS = {
    "sensor": chip.SENSOR_BASE,
    "own": chip.OWN_BASE,
    "source": chip.SOURCE_BASE,
    "buffer": chip.BUFFER_BASE,
}
BLOCK_BITS = (chip.SOURCE_STRIDE - 1).bit_length()


class EmulatorControl(Unit):
    """Control of the emulator.

    Ports
    -----
    access : in, from the serial link or from a bus; one at a time
    m_axi : out, AXI4-Lite master to the sensor; s_axis : in, the sensor's stream
    number : in, number of the sensor's frame; frame_done : in, strobe
    seed, write, common : out, to the photon sources; link_errors : in, from the serial link

    An access to the sensor waits while the sources are being seeded, so no frame begins before they
    are ready. Every access is answered; an illegal one with `refused`. Reset drops an access in
    progress. The settings of the sources are not reset (an FPGA powers up with 0).
    """

    unit_name = "coincid_emulator_control"

    def __init__(self, emulator: Emulator):
        self.emulator = emulator
        self.echo_bits = chip.LEVEL_BITS + emulator.sensor.stamp_bits
        super().__init__(
            access=In(ACCESS),
            m_axi=Out(LITE),
            s_axis=In(STREAM),
            number=In(bus.PULSE_BITS),
            frame_done=In(1),
            seed=Out(SEED_BUS),
            write=Out(write_bus(emulator.sensor)),
            common=Out(COMMON),
            link_errors=In(DATA_BITS),
        )
        sensor = emulator.sensor
        # The emulator's own settings.
        self.setting = {
            r.name: Signal(r.high(sensor).bit_length(), init=r.reset(sensor), name=r.name)
            for r in chip.OWN
            if r.access is Access.SETTING
        }
        # What the address names.
        self.region = {name: Signal(name=f"region_{name}") for name in REGIONS}
        self.named = {r.name: Signal(name=f"named_{r.name}") for r in chip.OWN}
        self.is_echo = Signal()  # the echo of a pixel
        self.is_background = Signal()  # the background of a source
        self.aligned = Signal()
        self.legal = Signal()  # a write of this value is possible
        self.mapped = Signal()  # a read is possible
        # The word that is read there.
        self.own = Signal(DATA_BITS, reset_less=True)  # of the emulator's own registers
        self.sources = Signal(DATA_BITS, reset_less=True)  # of the sources
        # Strobes to the blocks.
        self.reseed = Signal()  # a seed was written
        self.renumbered = Signal()  # a soft reset has set the sensor's frame number to 0
        self.begin = Signal()  # to the seeder
        self.take = Signal()  # to the frame buffer

    def elaborate(self, platform):
        m = Module()
        buffer = FrameBuffer(self.emulator)
        seeder = Seeder(self.emulator)
        between = StreamSlice()
        place(
            m,
            "buffer",
            buffer,
            platform,
            take=self.take,
            amount=self.access.data[: len(buffer.amount)],
            address=self.access.address[2 : chip.REGION_BITS][: len(buffer.address)],
        )
        place(
            m,
            "seeder",
            seeder,
            platform,
            seed=self.setting["seed"],
            number=self.number,
            begin=self.begin,
        )
        place(m, "slice", between, platform)
        connect(m, flipped(self.s_axis), between.s_axis)
        connect(m, between.m_axis, buffer.s_axis)
        m.d.comb += self.seed.eq(seeder.out)
        self._settings(m)
        self._decode(m)
        self._own(m, buffer, seeder)
        self._sources(m)
        self._checks(m, buffer)
        self._accesses(m, buffer, seeder)
        return m

    def _settings(self, m):
        """Let the emulator's own settings take effect."""
        late = Signal()  # the frame number changes with `frame_done`
        m.d.sync += late.eq(self.frame_done)
        m.d.comb += self.begin.eq(self.reseed | self.renumbered | late)
        m.d.sync += [
            self.common.spread.eq((1 << self.setting["spread"]) - 1),
            self.common.dead.eq(self.setting["dead_cycles"] - 1),
        ]

    def _decode(self, m):
        """Register what an address outside the sensor names."""
        access, sensor = self.access, self.emulator.sensor
        inside = access.address[: chip.REGION_BITS]
        for name, base in REGIONS.items():
            m.d.sync += self.region[name].eq(
                access.address[chip.REGION_BITS :] == base >> chip.REGION_BITS
            )
        for r in chip.OWN:
            m.d.sync += self.named[r.name].eq(inside == r.offset)
        block = inside[:BLOCK_BITS]
        self.subgroup = inside[BLOCK_BITS:]
        self.pixel = (block - chip.ECHO_OFFSET)[2:]
        exists = self.subgroup < sensor.subgroups
        m.d.sync += [
            self.is_echo.eq(
                exists
                & (block >= chip.ECHO_OFFSET)
                & (block < chip.ECHO_OFFSET + 4 * sensor.pixels)
            ),
            self.is_background.eq(exists & (block == 0)),
            self.aligned.eq(access.address[:2] == 0),
        ]

    def _own(self, m, buffer, seeder):
        """Register the word that is read at an address of the emulator's own registers."""
        content = {
            r.name: Const(r.reset(self.emulator.sensor), DATA_BITS)
            for r in chip.OWN
            if r.access is Access.CONSTANT
        }
        content |= self.setting | {
            "buffer_beats": Const(self.emulator.buffer_beats, DATA_BITS),
            "buffer_level": buffer.level,
            "buffer_first": buffer.first,
            "stalls": buffer.stalls,
            "link_errors": self.link_errors,
            "seeding": seeder.busy,
        }
        words = [
            Mux(self.named[r.name], content.get(r.name, Const(0, DATA_BITS)), 0) for r in chip.OWN
        ]
        m.d.sync += self.own.eq(reduce(or_, words))

    def _sources(self, m):
        """Keep a copy of the sources' settings, which cannot be read back themselves, and register
        the word that is read.
        """
        access, sensor = self.access, self.emulator.sensor
        places = 1 << (sensor.pixels - 1).bit_length()
        m.submodules.echoes = echoes = Memory(
            shape=self.echo_bits, depth=sensor.subgroups * places, init=[]
        )
        m.submodules.backgrounds = backgrounds = Memory(
            shape=chip.RATE_BITS, depth=max(2, sensor.subgroups), init=[]
        )
        self.echo_write = echoes.write_port()
        self.background_write = backgrounds.write_port()
        echo_read = echoes.read_port()
        background_read = backgrounds.read_port()
        at_echo = Signal(range(sensor.subgroups * places))
        m.d.comb += at_echo.eq(Cat(self.pixel[: places.bit_length() - 1], self.subgroup))
        for write, read, at in (
            (self.echo_write, echo_read, at_echo),
            (self.background_write, background_read, self.subgroup),
        ):
            m.d.comb += [
                write.addr.eq(at),
                write.data.eq(access.data),
                read.addr.eq(at),
                read.en.eq(1),
            ]
        m.d.sync += self.sources.eq(Mux(self.is_echo, echo_read.data, background_read.data))

    def _checks(self, m, buffer):
        """Check a write's value: first against the range of each register, then for the addressed
        one. Check a read's address.
        """
        access, sensor = self.access, self.emulator.sensor
        fits = {
            r.name: (access.data >= r.low(sensor)) & (access.data <= r.high(sensor))
            for r in chip.OWN
            if r.access is Access.SETTING
        }
        assert chip.OWN_BY_NAME["buffer_take"].access is Access.PULSE
        fits["buffer_take"] = access.data <= buffer.level
        checks = []
        for name, in_range in fits.items():
            fit = Signal(name=f"fits_{name}")
            m.d.sync += fit.eq(in_range)
            checks.append(self.named[name] & fit)
        of_echo = self.is_echo & (access.data < 1 << self.echo_bits)
        of_background = self.is_background & (access.data < 1 << chip.RATE_BITS)
        of_source = self.region["source"] & (of_echo | of_background)
        beats = access.address[: chip.REGION_BITS] < self.emulator.buffer_beats * 8
        in_own = self.region["own"] & Cat(self.named.values()).any()
        in_source = self.region["source"] & (self.is_echo | self.is_background)
        in_buffer = self.region["buffer"] & beats
        m.d.sync += [
            self.legal.eq(Mux(self.region["own"], Cat(checks).any(), of_source) & self.aligned),
            self.mapped.eq(self.aligned & (in_own | in_source | in_buffer)),
        ]

    def _accesses(self, m, buffer, seeder):
        """Carry out one access at a time."""
        access, axi = self.access, self.m_axi
        wait = Signal(range(LOCAL_CYCLES + 1))
        m.d.comb += [
            axi.bready.eq(1),
            axi.rready.eq(1),
            axi.wstrb.eq(0b1111),
            axi.awprot.eq(0),
            axi.arprot.eq(0),
        ]
        strobes = access.done, self.reseed, self.renumbered, self.write.valid, self.take
        m.d.sync += [strobe.eq(0) for strobe in strobes]
        m.d.sync += [
            self.write.subgroup.eq(self.subgroup),
            self.write.echo.eq(self.is_echo),
            self.write.pixel.eq(self.pixel),
            self.write.data.eq(access.data),
        ]
        for channel in ("aw", "w", "ar"):
            valid, ready = getattr(axi, f"{channel}valid"), getattr(axi, f"{channel}ready")
            with m.If(valid & ready):
                m.d.sync += valid.eq(0)
        with m.FSM():
            with m.State("idle"):
                m.d.sync += wait.eq(0)
                with m.If(access.valid & ~access.done):
                    with m.If(
                        access.address[chip.REGION_BITS :] == chip.SENSOR_BASE >> chip.REGION_BITS
                    ):
                        with m.If(~seeder.busy & ~self.begin):
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
                # The sensor resets itself before it answers.
                address, reset = control("reset")
                resets = (axi.awaddr == address) & (axi.wdata & reset).any()
                with m.If(axi.bvalid & (axi.bresp == OKAY) & resets):
                    m.d.sync += self.renumbered.eq(1)
            with m.State("local"):
                m.d.sync += wait.eq(wait + 1)
                with m.If(wait == LOCAL_CYCLES):
                    m.next = "idle"
                    m.d.sync += [
                        access.done.eq(1),
                        access.refused.eq(~Mux(access.write, self.legal, self.mapped)),
                        access.value.eq(
                            Mux(
                                self.region["own"],
                                self.own,
                                Mux(self.region["source"], self.sources, buffer.word),
                            )
                        ),
                    ]
                    with m.If(access.write & self.legal):
                        self._write(m)
            with m.State(
                "lost"
            ):  # the one code that is not a state: after an upset, the bus must not hang
                m.next = "idle"

    def _write(self, m):
        access = self.access
        with m.If(self.region["source"]):
            m.d.sync += self.write.valid.eq(1)
            m.d.comb += [
                self.echo_write.en.eq(self.is_echo),
                self.background_write.en.eq(self.is_background),
            ]
        with m.Else():
            for name, setting in self.setting.items():
                with m.If(self.named[name]):
                    m.d.sync += setting.eq(access.data)
            m.d.sync += [
                self.reseed.eq(self.named["seed"]),
                self.take.eq(self.named["buffer_take"]),
            ]
