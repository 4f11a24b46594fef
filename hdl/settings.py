# SPDX-License-Identifier: Apache-2.0
"""Settings of a subgroup: its block of the register map, as programmed and in force."""

from typing import Any

from amaranth.hdl import Cat, Module, Mux, Signal, Value
from amaranth.lib.wiring import In, Out

from ..model.contract import registers
from ..model.contract.counters import COUNTER_BITS, COUNTER_NAMES
from ..model.contract.parameters import MASK_BITS, Sensor
from ..model.contract.registers import DATA_BITS
from ..model.contract.settings import SUBGROUP, frame_defaults
from ..model.contract.table import Kind
from . import bus
from .clock_gate import ClockGate, behind
from .logic import any_of
from .unit import Unit


class SubgroupRegisters(Unit):
    """Register block of a subgroup. Ranges are checked before a write arrives here.

    Ports
    -----
    command : in, configuration bus, registered; subgroup : in, number of this subgroup; period :
        in, the programmed laser period
    settings : out, in force since the last TAKE; in a sensor that does not hold them, as programmed
    counters : in
    data : out, the word of this subgroup that an operation of the bus named two cycles ago; 0 if it
        named another subgroup, so the data of all subgroups can be ORed
    gate_late : out, gating is programmed on, and gate_start is not below the period
    upset : out, the parity of a programmed word differs from the one that was written with it
    test_enable : in, opens the clock gate for a test of the chip

    Reset loads the reset values of the table. A gate stops the clock two cycles after an operation
    of the bus; `period` changes only together with one.
    """

    unit_name = "coincid_settings"

    def __init__(self, sensor: Sensor):
        self.sensor = sensor
        super().__init__(
            command=In(bus.CONFIG_BUS),
            subgroup=In(bus.SUBGROUP_BITS),
            period=In(sensor.coarse_bits + 1),
            settings=Out(bus.settings_layout(sensor)),
            counters=In(COUNTER_BITS * len(COUNTER_NAMES)),
            data=Out(DATA_BITS),
            gate_late=Out(1),
            upset=Out(1),
            test_enable=In(1),
        )
        self.programmed = Signal(bus.settings_layout(sensor), init=_reset(sensor))  # the settings
        # Bits of the mask's last word that stand for no pixel. They are kept like the others, so
        # that a word reads as it was written, and its parity is that of the write.
        beyond = sensor.mask_words * sensor.mask_word_max.bit_length() - sensor.pixels
        self.beyond_mask = [Signal(beyond, name="beyond_mask", init=-1)] if beyond else []
        # One bit per word, so that no decoder is in the path of a read.
        self.named = Signal(sum(1 for _ in registers.words(registers.SUBGROUP, sensor)))
        self.shown: dict[int, Any] = {}  # number of a word -> value that a read returns
        self.upsets: list[Value] = []  # one bit per programmed word: its parity is wrong
        self.clock_gate = ClockGate(small=True)

    def elaborate(self, platform):
        m = Module()
        programmed = self.programmed
        named = self.named
        shown = self.shown
        selected = Signal()
        m.d.comb += selected.eq(self.command.subgroup == self.subgroup)
        m.d.sync += [self.gate_late.eq(programmed.gating & (programmed.gate_start >= self.period))]
        if self.sensor.held:
            with m.If(self.command.operation == bus.Operation.TAKE):
                m.d.sync += self.settings.eq(programmed)
        else:
            m.d.comb += self.settings.eq(programmed)
        write = selected & (self.command.operation == bus.Operation.WRITE)
        for offset, register, index in registers.words(registers.SUBGROUP, self.sensor):
            if register.access is registers.Access.SETTING:
                field = self._field(programmed, register, index)
                parity = Signal(
                    init=register.reset(self.sensor).bit_count() & 1,
                    name=f"parity_of_{register.name}_{index}",
                )
                with m.If(write & (self.command.word == offset // 4)):
                    m.d.sync += [field.eq(self.command.data), parity.eq(self.command.parity)]
                self.upsets.append(Value.cast(field).xor() ^ parity)
            else:
                field = self.counters.word_select(COUNTER_NAMES.index(register.name), COUNTER_BITS)
            shown[offset // 4] = field
        values = [Mux(bit, field, 0) for bit, field in zip(named, shown.values(), strict=True)]
        accessed = Signal()  # in the previous cycle
        m.d.sync += [
            accessed.eq(self.command.operation != bus.Operation.IDLE),
            self.upset.eq(Cat(self.upsets).any()),
        ]
        with m.If(self.command.operation != bus.Operation.IDLE):
            m.d.sync += named.eq(Cat(selected & (self.command.word == number) for number in shown))
        with m.If(accessed):
            m.d.sync += self.data.eq(any_of(m, values, "shown"))
        awake = (self.command.operation != bus.Operation.IDLE) | accessed
        return behind(m, platform, self.clock_gate, awake, self.test_enable)

    def _field(self, settings, register, index):
        if register is registers.MODE:
            bits = settings.as_value()
            return bits[: register.high(self.sensor).bit_length()]
        if register.name == "mask":
            mask = Cat(settings.mask, *self.beyond_mask)
            return mask[index * MASK_BITS : (index + 1) * MASK_BITS]
        return settings[register.name]


def _reset(sensor: Sensor) -> dict[str, int]:
    """Return the settings after a reset."""
    frame = frame_defaults(sensor)
    resets = {
        name: setting.reset_of(sensor, frame)
        for name, setting in SUBGROUP.items()
        if setting.kind is not Kind.MASK
    }
    return resets | {"mask": (1 << sensor.pixels) - 1}
