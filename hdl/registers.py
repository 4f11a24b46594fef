"""Register front: AXI4-Lite slave, range checks, global registers, and the start of a frame. The map is `model/contract/registers.py`."""

from types import SimpleNamespace

from amaranth.hdl import Array, Cat, Const, Module, Mux, Signal
from amaranth.lib.wiring import In, Out

from ..model.contract import registers
from ..model.contract.parameters import Sensor, bits_for
from ..model.contract.registers import AUTO_BOUNDS, BY_NAME, DATA_BITS, SUBGROUP_BASE, SUBGROUP_STRIDE, Access
from . import bus
from .axi import LITE, OKAY, SLVERR
from .logic import any_of
from .unit import Unit

DECODE_CYCLES = 2  # an address stands in its register -> the decoder says what it means
READ_CYCLES = 5  # the configuration bus names a word -> its data stand in this block's input register
CHECK_CYCLES = 7  # from decoding a start: by then all subgroups' start checks have seen the write before it
BLOCK_BITS = bits_for(SUBGROUP_STRIDE - 1)  # of an address inside a subgroup's block
CONTROL, STATUS = BY_NAME["control"], BY_NAME["status"]
WRITABLE = (Access.SETTING, Access.PULSE, Access.STATUS)


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
        self.state = SimpleNamespace()
        self._write_channel(m)
        self._read_channel(m)
        self._global_settings(m)
        self._decode(m)
        self._select(m)
        self._start_checks(m)
        self._accesses(m)
        return m

    def _write_channel(self, m):
        """Address and data of a write, each held until the write is answered."""
        axi, state = self.s_axi, self.state
        state.write_address = Signal(registers.ADDRESS_BITS)
        state.value = Signal(DATA_BITS)
        state.whole = Signal()  # all bytes of the word are to be written
        state.held_address = Signal()
        state.held_data = Signal()
        m.d.comb += [axi.awready.eq(~state.held_address), axi.wready.eq(~state.held_data)]
        with m.If(axi.awvalid & axi.awready):
            m.d.sync += [state.held_address.eq(1), state.write_address.eq(axi.awaddr)]
        with m.If(axi.wvalid & axi.wready):
            m.d.sync += [state.held_data.eq(1), state.value.eq(axi.wdata), state.whole.eq(axi.wstrb.all())]
        with m.If(axi.bvalid & axi.bready):
            m.d.sync += [axi.bvalid.eq(0), state.held_address.eq(0), state.held_data.eq(0)]

    def _read_channel(self, m):
        """The address of a read, held until the read is answered."""
        axi, state = self.s_axi, self.state
        state.read_address = Signal(registers.ADDRESS_BITS)
        state.held_read = Signal()
        m.d.comb += axi.arready.eq(~state.held_read)
        with m.If(axi.arvalid & axi.arready):
            m.d.sync += [state.held_read.eq(1), state.read_address.eq(axi.araddr)]
        with m.If(axi.rvalid & axi.rready):
            m.d.sync += [axi.rvalid.eq(0), state.held_read.eq(0)]

    def _global_settings(self, m):
        """The global block's settings as programmed, by name and index, and the status flags, by name."""
        state = self.state
        state.setting = {
            (register.name, index): Signal(
                bits_for(register.high(self.sensor)), init=register.reset(self.sensor), name=f"{register.name}_{index}"
            )
            for _, register, index in registers.words(registers.GLOBAL, self.sensor)
            if register.access is Access.SETTING
        }
        state.flag = {bits.name: Signal(name=f"status_{bits.name}") for bits in STATUS.bits}
        m.d.comb += self.period.eq(state.setting["period", 0])

    def _decode(self, m):
        """What the access's address means: it lies in a subgroup's block, is mapped, may be written, and takes the value.

        A register behind the address: which word it is, and which ranges hold the value. One more behind: what the table says of the word.
        """
        sensor, state = self.sensor, self.state
        state.address = Signal(registers.ADDRESS_BITS)
        state.in_subgroup = Signal()
        state.mapped = Signal()
        state.writable = Signal()
        state.legal = Signal()
        in_block = Signal()
        m.d.comb += in_block.eq(
            (state.address >= SUBGROUP_BASE) & (state.address < SUBGROUP_BASE + SUBGROUP_STRIDE * sensor.subgroups)
        )
        state.named = {}
        mapped, writable, legal = [], [], []
        in_range = self._ranges(m)
        for table, where, key in (
            (registers.GLOBAL, 1, state.address),
            (registers.SUBGROUP, in_block, state.address[:BLOCK_BITS]),
        ):
            for offset, register, index in registers.words(table, sensor):
                word = state.named[register.name, index] = Signal(name=f"named_{register.name}_{index}")
                m.d.sync += word.eq(where & (key == offset))
                mapped.append(word)
                if register.access in WRITABLE:
                    writable.append(word)
                    legal.append(word & in_range[register.low(sensor), register.high(sensor)])
        m.d.sync += [
            state.in_subgroup.eq(in_block),
            state.mapped.eq(Cat(mapped).any()),
            state.writable.eq(Cat(writable).any()),
            state.legal.eq(Cat(legal).any()),
        ]

    def _ranges(self, m):
        """(low, high) of every register that can be written -> registered: the value is between them. Many registers share a range."""
        limits = {(r.low(self.sensor), r.high(self.sensor)) for r in BY_NAME.values() if r.access in WRITABLE}
        in_range = {(low, high): Signal(name=f"from_{low}_to_{high}") for low, high in sorted(limits)}
        value = self.state.value
        m.d.sync += [inside.eq((value >= low) & (value <= high)) for (low, high), inside in in_range.items()]
        return in_range

    def _select(self, m):
        """The global register at the address, as late as what the decoder says."""
        state = self.state
        state.found = Signal(DATA_BITS)
        content = state.setting | {("status", 0): Cat(state.flag[bits.name] for bits in STATUS.bits)}
        for _, register, index in registers.words(registers.GLOBAL, self.sensor):
            if register.access is Access.CONSTANT:
                content[register.name, index] = Const(register.reset(self.sensor), DATA_BITS)
        chosen = [Mux(state.named[name], word, 0) for name, word in content.items()]
        m.d.sync += state.found.eq(any_of(m, chosen, "found_of"))

    def _start_checks(self, m):
        """What refuses a start, by the flag that then tells of it."""
        bounds = [self.state.setting["auto_bounds", k] for k in range(AUTO_BOUNDS)]
        bounds_descend = Signal()
        gate_late = Signal()
        m.d.sync += [
            bounds_descend.eq(any_of(m, [low > high for low, high in zip(bounds, bounds[1:])], "descends")),
            gate_late.eq(self.gate_late),
        ]
        self.state.failed = {
            "start_period": self.period <= self.sensor.guard,
            "start_bounds": bounds_descend,
            "start_gate": gate_late,
        }

    def _accesses(self, m):
        """One access at a time: reads, writes, and the write that starts a frame."""
        axi, state = self.s_axi, self.state
        state.wait = Signal(range(max(READ_CYCLES, CHECK_CYCLES) + 1))  # cycles of the access until now
        state.bound = Signal(range(AUTO_BOUNDS))
        state.data = Signal(DATA_BITS)
        m.d.sync += [
            state.data.eq(self.data),
            state.wait.eq(state.wait + 1),
            self.start_frame.eq(0),
            self.abort_frame.eq(0),
            self.command.operation.eq(bus.Operation.IDLE),
        ]
        with m.FSM() as state.machine:
            with m.State("idle"):
                m.d.sync += state.wait.eq(0)
                with m.If(state.held_address & state.held_data & ~axi.bvalid):
                    m.d.sync += state.address.eq(state.write_address)
                    m.next = "decode"
                with m.Elif(state.held_read & ~axi.rvalid):
                    m.d.sync += state.address.eq(state.read_address)
                    m.next = "read"
            with m.State("read"):
                m.d.sync += self._name_word()
                with m.If(state.wait == READ_CYCLES):
                    self._answer_read(m)
                    m.next = "idle"
            with m.State("decode"):
                with m.If(state.wait == DECODE_CYCLES - 1):
                    m.next = "write"
            with m.State("write"):
                m.next = "idle"
                with m.If(state.writable & state.whole & state.legal):
                    m.d.sync += self._respond(OKAY)
                    self._write(m)
                with m.Else():
                    m.d.sync += self._respond(SLVERR)
                    self._refuse_write(m)
            with m.State("check"):
                with m.If(state.wait == CHECK_CYCLES):
                    m.next = "idle"
                    self._start_or_refuse(m)
            with m.State("bounds"):
                self._send_bounds(m)
            with m.State("begin"):
                m.d.sync += [self.command.operation.eq(bus.Operation.BEGIN), self.start_frame.eq(1)]
                m.d.sync += self._respond(OKAY)
                m.next = "idle"
            with m.State("lost"):  # the one code that is no state: an upset there must not hang the bus
                m.next = "idle"
        with m.If(self.done):
            m.d.sync += [state.flag["busy"].eq(0), state.flag["done"].eq(1)]

    def _respond(self, response):
        return [self.s_axi.bvalid.eq(1), self.s_axi.bresp.eq(response)]

    def _name_word(self):
        """Asks the subgroups for the word at the address."""
        word, block = self.state.address[2:], self.state.address[BLOCK_BITS:]
        return [self.command.subgroup.eq(block - SUBGROUP_BASE // SUBGROUP_STRIDE), self.command.word.eq(word)]

    def _answer_read(self, m):
        axi, state = self.s_axi, self.state
        m.d.sync += [
            axi.rvalid.eq(1),
            axi.rresp.eq(Mux(state.mapped, OKAY, SLVERR)),
            axi.rdata.eq(Mux(state.mapped, Mux(state.in_subgroup, state.data, state.found), 0)),
        ]
        with m.If(~state.mapped):
            m.d.sync += state.flag["bad_address"].eq(1)

    def _refuse_write(self, m):
        """Tells by a sticky flag why."""
        state = self.state
        with m.If(~state.writable):
            m.d.sync += state.flag["bad_address"].eq(1)
        with m.Elif(~state.whole):
            m.d.sync += state.flag["bad_strobe"].eq(1)
        with m.Else():
            m.d.sync += state.flag["bad_value"].eq(1)

    def _write(self, m):
        """Carries out a write: sends it to the subgroups, or changes what is global; a start is answered only after its checks."""
        state, value = self.state, self.state.value
        with m.If(state.in_subgroup):
            m.d.sync += [self.command.operation.eq(bus.Operation.WRITE), self.command.data.eq(value)]
            m.d.sync += self._name_word()
        for name, setting in state.setting.items():
            with m.If(state.named[name]):
                m.d.sync += setting.eq(value)
        with m.If(state.named["status", 0]):
            for bits in STATUS.bits:
                if bits.clears:
                    with m.If(value[bits.lsb]):
                        m.d.sync += state.flag[bits.name].eq(0)
        with m.If(state.named["control", 0]):
            m.d.sync += self.abort_frame.eq(value[CONTROL.bit("abort")])
            with m.If(value[CONTROL.bit("start")]):
                m.d.sync += self.s_axi.bvalid.eq(0)
                m.next = "check"

    def _start_or_refuse(self, m):
        """Takes the settings, or tells by a sticky flag what is wrong with them."""
        state = self.state
        with m.If(state.flag["busy"]):
            m.d.sync += [state.flag["start_busy"].eq(1), *self._respond(SLVERR)]
        with m.Elif(Cat(state.failed.values()).any()):
            m.d.sync += [state.flag[name].eq(state.flag[name] | bad) for name, bad in state.failed.items()]
            m.d.sync += self._respond(SLVERR)
        with m.Else():
            m.d.sync += [state.flag["busy"].eq(1), state.bound.eq(0), self.command.operation.eq(bus.Operation.TAKE)]
            for taken in (self.frame, self.plan):
                m.d.sync += [taken[name].eq(state.setting[name, 0]) for name in taken.shape().members]
            m.next = "bounds"

    def _send_bounds(self, m):
        """Sends the controller's bounds to the subgroups, one per cycle."""
        state = self.state
        bounds = Array(state.setting["auto_bounds", k] for k in range(AUTO_BOUNDS))
        m.d.sync += [self.command.operation.eq(bus.Operation.COMPARE), self.command.data.eq(bounds[state.bound])]
        m.d.sync += state.bound.eq(state.bound + 1)
        with m.If(state.bound == AUTO_BOUNDS - 1):
            m.next = "begin"
