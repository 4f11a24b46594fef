"""Register front: AXI4-Lite slave, range checks, global registers, and the start of a frame. The map is `model/contract/registers.py`."""

from amaranth.hdl import Array, Cat, Module, Mux, Signal
from amaranth.lib.wiring import In, Out

from ..model.contract import registers
from ..model.contract.parameters import Sensor, bits_for
from ..model.contract.registers import AUTO_BOUNDS, BY_NAME, DATA_BITS, SUBGROUP_BASE, SUBGROUP_STRIDE, Access
from . import bus
from .axi import LITE, OKAY, SLVERR
from .logic import any_of
from .unit import Unit

READ_CYCLES = 5  # the configuration bus names a word -> its data stand in this block's input register
CHECK_CYCLES = 7  # from decoding a start: by then all subgroups' start checks have seen the write before it
CONTROL, STATUS = BY_NAME["control"], BY_NAME["status"]


class Registers(Unit):
    """Register front of the sensor.

    Ports
    -----
    s_axi : AXI4-Lite slave, 32-bit data. One access at a time; address and data of a write may come in any order. A write that is refused
        answers SLVERR, changes nothing and sets a sticky bit; a read of an unmapped address answers SLVERR with 0.
    command : out, configuration bus to all subgroups; data : in, OR of their answers; gate_late : in, OR of their start checks
    period : out, as programmed; frame : out, settings of the running frame; plan : out, the sequencer's
    start_frame, abort_frame : out, strobes; done : in, strobe

    Reset loads the table's reset values and forgets accesses under way.
    """

    unit_name = "coincid_registers"

    def __init__(self, sensor: Sensor):
        self.sensor = sensor
        super().__init__(
            {
                "s_axi": In(LITE),
                "command": Out(bus.CONFIG_BUS),
                "data": In(DATA_BITS),
                "gate_late": In(1),
                "period": Out(sensor.coarse_bits + 1),
                "frame": Out(bus.frame_layout(sensor)),
                "plan": Out(bus.plan_layout(sensor)),
                "start_frame": Out(1),
                "abort_frame": Out(1),
                "done": In(1),
            }
        )

    def elaborate(self, platform):
        m = Module()
        sensor, axi = self.sensor, self.s_axi
        setting = {
            (register.name, index): Signal(
                bits_for(register.high(sensor)), init=register.reset(sensor), name=f"{register.name}_{index}"
            )
            for _, register, index in registers.words(registers.GLOBAL, sensor)
            if register.access is Access.SETTING
        }
        flag = {bits.name: Signal(name=f"status_{bits.name}") for bits in STATUS.bits}
        data = Signal(DATA_BITS)
        gate_late = Signal()
        m.d.sync += [
            data.eq(self.data),
            gate_late.eq(self.gate_late),
            self.start_frame.eq(0),
            self.abort_frame.eq(0),
            self.command.operation.eq(bus.Operation.IDLE),
        ]
        m.d.comb += self.period.eq(setting["period", 0])

        # The channels: each holds what came until it is answered.
        write_address = Signal(registers.ADDRESS_BITS)
        read_address = Signal(registers.ADDRESS_BITS)
        value = Signal(DATA_BITS)
        whole = Signal()
        held_address = Signal()
        held_data = Signal()
        held_read = Signal()
        m.d.comb += [axi.awready.eq(~held_address), axi.wready.eq(~held_data), axi.arready.eq(~held_read)]
        with m.If(axi.awvalid & axi.awready):
            m.d.sync += [held_address.eq(1), write_address.eq(axi.awaddr)]
        with m.If(axi.wvalid & axi.wready):
            m.d.sync += [held_data.eq(1), value.eq(axi.wdata), whole.eq(axi.wstrb.all())]
        with m.If(axi.arvalid & axi.arready):
            m.d.sync += [held_read.eq(1), read_address.eq(axi.araddr)]
        with m.If(axi.bvalid & axi.bready):
            m.d.sync += [axi.bvalid.eq(0), held_address.eq(0), held_data.eq(0)]
        with m.If(axi.rvalid & axi.rready):
            m.d.sync += [axi.rvalid.eq(0), held_read.eq(0)]

        # One access at a time, its address decoded a cycle before it is used.
        address = Signal(registers.ADDRESS_BITS)
        mapped, writable, legal, in_subgroup = self._decode(m, address, value)
        found = Signal(DATA_BITS)
        self._read(m, address, found, setting, flag)
        bounds_descend = Signal()
        bounds = [setting["auto_bounds", k] for k in range(AUTO_BOUNDS)]
        m.d.sync += bounds_descend.eq(any_of(m, [low > high for low, high in zip(bounds, bounds[1:])], "descends"))
        wait = Signal(range(max(READ_CYCLES, CHECK_CYCLES) + 1))
        bound = Signal(range(AUTO_BOUNDS))
        m.d.sync += wait.eq(wait + 1)

        def respond(error):
            return [axi.bvalid.eq(1), axi.bresp.eq(Mux(error, SLVERR, OKAY))]

        with m.FSM() as self.machine:  # proofs speak of its states
            with m.State("idle"):
                m.d.sync += wait.eq(0)
                with m.If(held_address & held_data & ~axi.bvalid):
                    m.d.sync += address.eq(write_address)
                    m.next = "decode"
                with m.Elif(held_read & ~axi.rvalid):
                    m.d.sync += address.eq(read_address)
                    m.next = "read"
            with m.State("read"):
                m.d.sync += self._name_word(address)
                with m.If(wait == READ_CYCLES):
                    m.d.sync += [
                        axi.rvalid.eq(1),
                        axi.rresp.eq(Mux(mapped, OKAY, SLVERR)),
                        axi.rdata.eq(Mux(mapped, Mux(in_subgroup, data, found), 0)),
                    ]
                    with m.If(~mapped):
                        m.d.sync += flag["bad_address"].eq(1)
                    m.next = "idle"
            with m.State("decode"):
                m.next = "write"
            with m.State("write"):
                m.next = "idle"
                with m.If(~(writable & whole & legal)):
                    with m.If(~writable):
                        m.d.sync += flag["bad_address"].eq(1)
                    with m.Elif(~whole):
                        m.d.sync += flag["bad_strobe"].eq(1)
                    with m.Else():
                        m.d.sync += flag["bad_value"].eq(1)
                    m.d.sync += respond(1)
                with m.Elif(in_subgroup):
                    m.d.sync += [
                        self.command.operation.eq(bus.Operation.WRITE),
                        self.command.data.eq(value),
                        *self._name_word(address),
                    ]
                    m.d.sync += respond(0)
                with m.Else():
                    m.d.sync += respond(0)
                    with m.Switch(address):
                        for offset, register, index in registers.words(registers.GLOBAL, sensor):
                            if register.access is Access.SETTING:
                                with m.Case(offset):
                                    m.d.sync += setting[register.name, index].eq(value)
                        with m.Case(STATUS.offset):
                            for bits in STATUS.bits:
                                if bits.clears:
                                    with m.If(value[bits.lsb]):
                                        m.d.sync += flag[bits.name].eq(0)
                        with m.Case(CONTROL.offset):
                            m.d.sync += self.abort_frame.eq(value[CONTROL.bit("abort")])
                            with m.If(value[CONTROL.bit("start")]):
                                m.d.sync += axi.bvalid.eq(0)
                                m.next = "check"
            with m.State("check"):
                with m.If(wait == CHECK_CYCLES):
                    failed = {
                        "start_period": self.period <= sensor.guard,
                        "start_bounds": bounds_descend,
                        "start_gate": gate_late,
                    }
                    m.next = "idle"
                    with m.If(flag["busy"]):
                        m.d.sync += [flag["start_busy"].eq(1), *respond(1)]
                    with m.Elif(Cat(failed.values()).any()):
                        m.d.sync += [flag[name].eq(flag[name] | bad) for name, bad in failed.items()]
                        m.d.sync += respond(1)
                    with m.Else():
                        m.d.sync += [flag["busy"].eq(1), bound.eq(0), self.command.operation.eq(bus.Operation.TAKE)]
                        m.d.sync += [self.frame[name].eq(setting[of, 0]) for name, of in FRAME_SETTINGS.items()]
                        m.d.sync += [self.plan[name].eq(setting[name, 0]) for name in self.plan.shape().members]
                        m.next = "bounds"
            with m.State("bounds"):
                m.d.sync += [
                    self.command.operation.eq(bus.Operation.COMPARE),
                    self.command.data.eq(Array(bounds)[bound]),
                    bound.eq(bound + 1),
                ]
                with m.If(bound == AUTO_BOUNDS - 1):
                    m.next = "begin"
            with m.State("begin"):
                m.d.sync += [self.command.operation.eq(bus.Operation.BEGIN), self.start_frame.eq(1), *respond(0)]
                m.next = "idle"
            with m.State("lost"):  # the one code that is no state: an upset there must not hang the bus
                m.next = "idle"
        with m.If(self.done):
            m.d.sync += [flag["busy"].eq(0), flag["done"].eq(1)]
        return m

    def _name_word(self, address):
        blocks = address[(SUBGROUP_STRIDE - 1).bit_length() :]
        return [self.command.subgroup.eq(blocks - SUBGROUP_BASE // SUBGROUP_STRIDE), self.command.word.eq(address[2:])]

    def _decode(self, m, address, value):
        """Registered: the address is mapped, may be written, takes the value, and lies in a subgroup's block."""
        sensor = self.sensor
        mapped, writable, legal, in_subgroup = (
            Signal(name=name) for name in ("mapped", "writable", "legal", "in_subgroup")
        )
        subgroup = Signal()
        m.d.comb += subgroup.eq(
            (address >= SUBGROUP_BASE) & (address < SUBGROUP_BASE + SUBGROUP_STRIDE * sensor.subgroups)
        )
        m.d.sync += [in_subgroup.eq(subgroup), mapped.eq(0), writable.eq(0), legal.eq(0)]

        def rules(key, table):
            with m.Switch(key):
                for offset, register, _ in registers.words(table, sensor):
                    with m.Case(offset):
                        m.d.sync += [
                            mapped.eq(1),
                            writable.eq(register.access in (Access.SETTING, Access.PULSE, Access.STATUS)),
                            legal.eq((value >= register.low(sensor)) & (value <= register.high(sensor))),
                        ]

        with m.If(subgroup):
            rules(address[: (SUBGROUP_STRIDE - 1).bit_length()], registers.SUBGROUP)
        with m.Else():
            rules(address, registers.GLOBAL)
        return mapped, writable, legal, in_subgroup

    def _read(self, m, address, found, setting, flag):
        """Registered: the global register at the address."""
        m.d.sync += found.eq(0)
        with m.Switch(address):
            for offset, register, index in registers.words(registers.GLOBAL, self.sensor):
                with m.Case(offset):
                    if register.access is Access.CONSTANT:
                        m.d.sync += found.eq(register.reset(self.sensor))
                    elif register.access is Access.SETTING:
                        m.d.sync += found.eq(setting[register.name, index])
                    elif register is STATUS:
                        m.d.sync += found.eq(Cat(flag[bits.name] for bits in STATUS.bits))


FRAME_SETTINGS = {
    "format": "format",
    "mg_records": "minigroup_records",
    "mg_threshold": "mg_threshold",
    "mg_window": "mg_window",
}
