# SPDX-License-Identifier: Apache-2.0
"""The emulator's top: sensor, one photon source per subgroup, frame buffer, and a serial line or AXI4-Lite slave."""

from types import SimpleNamespace

from amaranth.hdl import Module, Mux, ResetSignal, Signal
from amaranth.lib.wiring import In, Out, Signature

from ...model.contract.emulator import ADDRESS_BITS, Emulator
from ...model.contract.registers import DATA_BITS
from ...model.shared.licence import SPDX
from ..axi import LITE, OKAY, SLVERR
from ..export import units_files
from ..sensor import Netlist, Port, module_text, netlist
from ..unit import Unit
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

    One access at a time; if both wait, reads and writes take turns. A write of less than a whole word is answered with
    SLVERR. Reset drops accesses in progress.
    """

    unit_name = "coincid_bus_access"

    def __init__(self):
        super().__init__({"s_axi": In(WIDE_LITE), "access": Out(ACCESS)})

    def elaborate(self, platform):
        m = Module()
        axi, access = self.s_axi, self.access
        held_address, held_data, held_read, whole = Signal(), Signal(), Signal(), Signal()
        to_write, to_read = Signal(ADDRESS_BITS), Signal(ADDRESS_BITS)
        m.d.comb += [axi.awready.eq(~held_address), axi.wready.eq(~held_data), axi.arready.eq(~held_read)]
        with m.If(axi.awvalid & axi.awready):
            m.d.sync += [held_address.eq(1), to_write.eq(axi.awaddr)]
        with m.If(axi.wvalid & axi.wready):
            m.d.sync += [held_data.eq(1), access.data.eq(axi.wdata), whole.eq(axi.wstrb.all())]
        with m.If(axi.arvalid & axi.arready):
            m.d.sync += [held_read.eq(1), to_read.eq(axi.araddr)]
        with m.If(axi.bvalid & axi.bready):
            m.d.sync += [axi.bvalid.eq(0), held_address.eq(0), held_data.eq(0)]
        with m.If(axi.rvalid & axi.rready):
            m.d.sync += [axi.rvalid.eq(0), held_read.eq(0)]
        wrote = Signal()
        can_write, can_read = Signal(), Signal()
        m.d.comb += [can_write.eq(held_address & held_data & ~axi.bvalid), can_read.eq(held_read & ~axi.rvalid)]
        with m.FSM():
            with m.State("idle"):
                m.d.sync += access.valid.eq(0)
                with m.If(can_write & ~whole):
                    m.d.sync += [axi.bvalid.eq(1), axi.bresp.eq(SLVERR)]
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
                        m.d.sync += [axi.rvalid.eq(1), axi.rresp.eq(response), axi.rdata.eq(access.value)]
        self.state = SimpleNamespace(wrote=wrote)
        return m


class LocalReset(Unit):
    """Reset of one block, a register beside it: on an FPGA, the reset is a net like any other.

    Ports
    -----
    held : out, the reset, one cycle later
    """

    unit_name = "coincid_local_reset"

    def __init__(self):
        super().__init__({"held": Out(1)})

    def elaborate(self, platform):
        m = Module()
        held = Signal(init=1, reset_less=True)
        m.d.sync += held.eq(ResetSignal())
        m.d.comb += self.held.eq(held)
        self.state = SimpleNamespace(held=held)
        return m


def emulator_netlist(emulator: Emulator, serial: bool = True) -> Netlist:
    """Return the emulator's wiring, where the sensor's ports are nets. serial: pins of a serial line, not AXI4-Lite."""
    sensor = emulator.sensor
    n = netlist(sensor)
    outer = SerialBridge(emulator) if serial else BusAccess()
    control = EmulatorControl(emulator)

    def to(unit, member, prefix):
        return {port: f"{prefix}_{port.split('__')[1]}" for port in unit.flat_ports() if port.startswith(f"{member}__")}

    n.nets["errors"] = DATA_BITS
    n.add(
        "control",
        control,
        **to(control, "access", "access"),
        **to(control, "m_axi", "s_axi"),
        **to(control, "s_axis", sensor.stream_name(0)),
        frame_done="done",
        seed="source_seed",
        write="source_write",
        common="source_common",
        link_errors="errors",
    )
    n.add("outer", outer, **to(outer, "access", "access"), **({} if serial else to(outer, "s_axi", "bus")))
    source = PhotonSource(emulator)
    for s in range(sensor.subgroups):
        n.add(
            f"source_{s}",
            source,
            subgroup=s,
            words=f"spad_{s}",
            seed="source_seed",
            write="source_write",
            common="source_common",
        )
    if not serial:
        n.joins["errors"] = ("constant", [0])
    names = [port for port in outer.flat_ports() if port in ("rx", "tx")]
    if not serial:
        names = [port for port in outer.flat_ports() if port.startswith("s_axi__")]
    n.ports = []
    for port in names:
        net = port if serial else f"bus_{port.split('__')[1]}"
        n.ports.append(Port(net, n.nets[net], outer.flat_ports()[port][0].name == "In"))
    n.ports.append(Port("laser", 1, False))
    reset = LocalReset()
    for name, _, ports in list(n.instances):
        ports["rst"] = f"rst_{name}"
        n.add(f"reset_{name}", reset, held=ports["rst"])
    return n


def emulator_files(emulator: Emulator, serial: bool = True) -> dict[str, str]:
    """Return the emulator's Verilog by file name: one file per block, and a file list. It depends only on the parameters."""
    n = emulator_netlist(emulator, serial)
    name = SERIAL_TOP if serial else BUS_TOP
    sensor = emulator.sensor
    what = f"Emulator of a SPAD sensor of {sensor.rows} x {sensor.cols} pixels: wiring of its blocks."
    text, units = module_text(name, what, n.ports, n.instances, n.nets, n.joins)
    files = units_files(list(units.values())) | {f"{name}.v": f"// {SPDX}\n{text}"}
    return files | {EMULATOR_LIST: "".join(f"{file}\n" for file in files)}
