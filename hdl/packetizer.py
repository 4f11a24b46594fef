"""Packetizer: sends a subgroup's events, minigroup records and counters as beats when the readout grants them.

The word formats are the project's; the paper only says that stamps and IDs leave the subgroup.
"""

from collections.abc import Callable
from types import SimpleNamespace

from amaranth.hdl import Cat, Module, Mux, Signal
from amaranth.lib.wiring import In, Out

from ..model.contract.packet import BEAT_BITS, FORMATS, HEADER, OFFSET_BITS, Kind, layout
from ..model.contract.parameters import OFFSET_NONE, Sensor
from ..model.contract.registers import COUNTER_BITS, COUNTER_NAMES
from . import bus
from .unit import Unit


def header(**fields):
    """A header beat from values; fields that are not given are 0."""
    parts = []
    for name, (_, width) in sorted(HEADER.items(), key=lambda item: item[1]):
        field = Signal(width, name=f"field_{name}")
        parts.append((field, fields.get(name, 0)))
    return Cat(field for field, _ in parts), [field.eq(value) for field, value in parts]


def of_format(form, value: Callable[[Kind], int]):
    """`value` of the kind of event that `form`, the format register, chooses."""
    *others, last = FORMATS.values()
    chosen = value(last)
    for number, kind in reversed(list(enumerate(others))):
        chosen = Mux(form == number, value(kind), chosen)
    return chosen


class Packetizer(Unit):
    """Forms the beats of one subgroup.

    Ports
    -----
    grant, send : in, registered: a packet of this kind begins now. Grants come no closer than the packets' lengths
    frame : in, settings; subgroup : in, this one's number
    head, record, counters : in; take_event, take_record : out, with the packet's last beat
    valid, beat : out, one cycle later; 0 while nothing is sent, so that the beats of all subgroups can be ORed

    Reset ends a packet.
    """

    unit_name = "coincid_packetizer"

    def __init__(self, sensor: Sensor):
        self.sensor = sensor
        super().__init__(
            {
                "grant": In(1),
                "send": In(bus.Send),
                "frame": In(bus.frame_layout(sensor)),
                "subgroup": In(bus.SUBGROUP_BITS),
                "head": In(bus.event_layout(sensor)),
                "record": In(bus.record_layout(sensor)),
                "counters": In(COUNTER_BITS * len(COUNTER_NAMES)),
                "take_event": Out(1),
                "take_record": Out(1),
                "valid": Out(1),
                "beat": Out(BEAT_BITS),
            }
        )

    def elaborate(self, platform):
        m = Module()
        parts = layout(self.sensor)
        event = self._event_beats(m)
        record = self._record_beats(m)
        counters = [self.counters.word_select(k, BEAT_BITS) for k in range(parts.counter_beats)]

        # The packet under way: what is sent, and which beat.
        sending = Signal()
        send_before = Signal(bus.Send)
        index_before = Signal(range(parts.longest + 1))
        send = Signal(bus.Send)
        index = Signal.like(index_before)
        last = Signal.like(index_before)
        active = Signal()
        m.d.comb += [
            active.eq(self.grant | sending),
            send.eq(Mux(self.grant, self.send, send_before)),
            index.eq(Mux(self.grant, 0, index_before)),
        ]
        chosen = Signal(BEAT_BITS)
        with m.Switch(send):
            for kind, beats in ((bus.Send.EVENT, event), (bus.Send.RECORD, record), (bus.Send.COUNTERS, counters)):
                with m.Case(kind):
                    if kind is bus.Send.EVENT:
                        m.d.comb += last.eq(of_format(self.frame.format, lambda kind: parts.length(kind) - 1))
                    else:
                        m.d.comb += last.eq(len(beats) - 1)
                    with m.Switch(index):
                        for k, beat in enumerate(beats):
                            with m.Case(k):
                                m.d.comb += chosen.eq(beat)
        ends = Signal()
        m.d.comb += [
            ends.eq(active & (index == last)),
            self.take_event.eq(ends & (send == bus.Send.EVENT)),
            self.take_record.eq(ends & (send == bus.Send.RECORD)),
        ]
        m.d.sync += [
            sending.eq(active & ~ends),
            send_before.eq(send),
            index_before.eq(index + 1),
            self.valid.eq(active),
            self.beat.eq(Mux(active, chosen, 0)),
        ]
        self.state = SimpleNamespace(sending=sending, send_before=send_before, index_before=index_before)
        return m

    def _event_beats(self, m):
        window = self.head.window
        kind = Signal(bus.KIND_BITS)
        m.d.comb += kind.eq(of_format(self.frame.format, int))
        beat, fields = header(
            kind=kind,
            overrun=self.head.overrun,
            subgroup=self.subgroup,
            pulse=self.head.pulse,
            count=window.count,
            winner=window.winner,
            stamp=window.stamp,
        )
        m.d.comb += fields
        offsets = []
        for g in range(self.sensor.minigroups):
            hit = Cat(window.hits[i] for i in self.sensor.members(g)).any()
            offset = Signal(OFFSET_BITS, name=f"offset_{g}")
            m.d.comb += offset.eq(Mux(hit, window.offsets[g], OFFSET_NONE))
            offsets.append(offset)
        return [beat, *_beats(window.hits), *_beats(Cat(offsets))]

    def _record_beats(self, m):
        beat, fields = header(kind=Kind.RECORD, subgroup=self.subgroup, pulse=self.record.pulse)
        m.d.comb += fields
        entries = []
        for g in range(self.sensor.minigroups):
            entry = Signal(self.sensor.record_bits, name=f"entry_{g}")
            m.d.comb += entry.eq(self.record.entries[g].as_value())
            entries.append(entry)
        return [beat, *_beats(Cat(entries))]


def _beats(value):
    return [value[at : at + BEAT_BITS] for at in range(0, len(value), BEAT_BITS)]
