# SPDX-License-Identifier: Apache-2.0
"""The emulator's top: sensor, one photon source per subgroup, frame buffer, and a serial line or
AXI4-Lite slave.
"""

from typing import Any

from amaranth.hdl import Const, Module, Mux, ResetSignal, Signal
from amaranth.lib import wiring
from amaranth.lib.wiring import In, Out, Signature

from ...hdl.axi import LITE, OKAY, SLVERR
from ...hdl.export import units_files
from ...hdl.sensor import outer_ports, wire_sensor
from ...hdl.unit import Unit, place
from ...model.contract.registers import DATA_BITS
from ..parameters import ADDRESS_BITS, Emulator
from .bridge import SerialBridge
from .control import ACCESS, EmulatorControl
from .source import PhotonSource

SERIAL_TOP, BUS_TOP = "coincid_emulator", "coincid_emulator_axi"
EMULATOR_LIST = "coincid_emulator.f"
# As on the sensor, but with the emulator's address space.
WIDE_LITE = Signature(
    {
        name: type(member)(member.flow, ADDRESS_BITS) if name in ("awaddr", "araddr") else member
        for name, member in LITE.members.items()
    }
)


class BusAccess(Unit):
    """AXI4-Lite slave in front of the emulator's control.

    Ports
    -----
    s_axi : AXI4-Lite slave, 32-bit data, 24-bit addresses; access : out, to the control

    One access at a time; if both wait, reads and writes take turns. A write of no byte asks for
    nothing and is answered with OKAY, because adapters of the bus's width send such writes; a write
    of some bytes of a word is answered with SLVERR. Reset drops accesses in progress.
    """

    unit_name = "coincid_bus_access"

    def __init__(self):
        super().__init__(s_axi=In(WIDE_LITE), access=Out(ACCESS))

    def elaborate(self, platform):
        m = Module()
        axi, access = self.s_axi, self.access
        held_address = Signal()  # the address of a write is there
        held_data = Signal()  # the value to write is there
        held_read = Signal()  # the address of a read is there
        whole = Signal()  # all bytes of the word are to be written
        empty = Signal()  # none is
        to_write = Signal(ADDRESS_BITS)
        to_read = Signal(ADDRESS_BITS)
        m.d.comb += [
            axi.awready.eq(~held_address),
            axi.wready.eq(~held_data),
            axi.arready.eq(~held_read),
        ]
        with m.If(axi.awvalid & axi.awready):
            m.d.sync += [held_address.eq(1), to_write.eq(axi.awaddr)]
        with m.If(axi.wvalid & axi.wready):
            m.d.sync += [
                held_data.eq(1),
                access.data.eq(axi.wdata),
                whole.eq(axi.wstrb.all()),
                empty.eq(~axi.wstrb.any()),
            ]
        with m.If(axi.arvalid & axi.arready):
            m.d.sync += [held_read.eq(1), to_read.eq(axi.araddr)]
        with m.If(axi.bvalid & axi.bready):
            m.d.sync += [axi.bvalid.eq(0), held_address.eq(0), held_data.eq(0)]
        with m.If(axi.rvalid & axi.rready):
            m.d.sync += [axi.rvalid.eq(0), held_read.eq(0)]
        wrote = Signal()
        can_write = Signal()
        can_read = Signal()
        m.d.comb += [
            can_write.eq(held_address & held_data & ~axi.bvalid),
            can_read.eq(held_read & ~axi.rvalid),
        ]
        with m.FSM():
            with m.State("idle"):
                m.d.sync += access.valid.eq(0)
                with m.If(can_write & ~whole):
                    m.d.sync += [axi.bvalid.eq(1), axi.bresp.eq(Mux(empty, OKAY, SLVERR))]
                with m.Elif(can_write | can_read):
                    write = can_write & ~(can_read & wrote)
                    m.d.sync += [
                        access.valid.eq(1),
                        access.write.eq(write),
                        access.address.eq(Mux(write, to_write, to_read)),
                        wrote.eq(write),
                    ]
                    m.next = "wait"
            with m.State("wait"):
                with m.If(access.done):
                    m.d.sync += access.valid.eq(0)
                    m.next = "idle"
                    response = Mux(access.refused, SLVERR, OKAY)
                    with m.If(access.write):
                        m.d.sync += [axi.bvalid.eq(1), axi.bresp.eq(response)]
                    with m.Else():
                        m.d.sync += [
                            axi.rvalid.eq(1),
                            axi.rresp.eq(response),
                            axi.rdata.eq(access.value),
                        ]
        return m


class LocalReset(Unit):
    """Reset of one block, in a register close to it: on an FPGA, the reset is an ordinary net with
    an ordinary delay.

    Ports
    -----
    held : out, the reset, one cycle later
    """

    unit_name = "coincid_local_reset"

    def __init__(self):
        super().__init__(held=Out(1))

    def elaborate(self, platform):
        m = Module()
        held = Signal(init=1, reset_less=True)
        m.d.sync += held.eq(ResetSignal())
        m.d.comb += self.held.eq(held)
        return m


class EmulatorTop(Unit):
    """The emulator.

    Ports
    -----
    rx : in, tx : out, a serial line; or, if not `serial`, bus : AXI4-Lite slave
    laser : out, the sensor's

    Every block has a register of its own for its reset.
    """

    separator = "_"

    def __init__(self, emulator: Emulator, serial: bool = True):
        self.emulator, self.serial = emulator, serial
        self.unit_name = SERIAL_TOP if serial else BUS_TOP
        host = {"rx": In(1), "tx": Out(1)} if serial else {"bus": In(WIDE_LITE)}
        super().__init__(**host, laser=Out(1))

    def elaborate(self, platform):
        m = Module()

        def put(name, unit, **inputs):
            held = place(m, f"reset_{name}", LocalReset(), platform).held
            return place(m, name, unit, platform, held, **inputs)

        sensor = self.emulator.sensor
        outer: Any = Signature(outer_ports(sensor)).create(path=())
        sources = [PhotonSource(self.emulator) for _ in range(sensor.subgroups)]
        words = [source.words for source in sources]
        sequencer, _ = wire_sensor(m, put, sensor, outer, words, test_enable=Const(0))
        link, errors = self._link(m, put)
        control = EmulatorControl(self.emulator)
        put(
            "control",
            control,
            number=sequencer.number,
            frame_done=sequencer.done,
            link_errors=errors,
        )
        for s, source in enumerate(sources):
            put(
                f"source_{s}",
                source,
                subgroup=Const(s, source.subgroup.shape()),
                timing=sequencer.timing,
                seed=control.seed,
                write=control.write,
                common=control.common,
            )
        wiring.connect(m, link.access, control.access)
        wiring.connect(m, control.m_axi, outer.s_axi)
        wiring.connect(m, getattr(outer, sensor.stream_name(0)), control.s_axis)
        m.d.comb += self.laser.eq(outer.laser)
        return m

    def _link(self, m, put):
        """Place the block that talks to the host; return it and its number of damaged frames."""
        if not self.serial:
            access = put("outer", BusAccess())
            wiring.connect(m, wiring.flipped(self.bus), access.s_axi)
            return access, Const(0, DATA_BITS)
        bridge = put("outer", SerialBridge(self.emulator), rx=self.rx)
        m.d.comb += self.tx.eq(bridge.tx)
        return bridge, bridge.errors


def emulator_files(emulator: Emulator, serial: bool = True) -> dict[str, str]:
    """Return the emulator's Verilog by file name: one file per block, and a file list. It depends
    only on the parameters.
    """
    files = units_files([EmulatorTop(emulator, serial)])
    return files | {EMULATOR_LIST: "".join(f"{file}\n" for file in files)}
