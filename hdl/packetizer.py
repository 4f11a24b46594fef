# SPDX-License-Identifier: Apache-2.0
"""Packetizer: sends a subgroup's events, minigroup records and counters as beats when the readout
grants them.

The word formats are our choice; the paper only says that stamps and IDs leave the subgroup.
"""

from collections.abc import Callable, Collection
from itertools import groupby
from typing import Any

from amaranth.hdl import Cat, Const, Module, Mux, Signal, Value
from amaranth.lib.wiring import In, Out

from ..model.contract.counters import COUNTER_BITS, COUNTER_NAMES
from ..model.contract.counts import ROWS
from ..model.contract.packet import (
    BEAT_BITS,
    COUNTS,
    EVENT_FORMATS,
    KIND_BITS,
    KIND_LSB,
    OFFSETS,
    RECORD,
    Packet,
    Part,
    built_formats,
    layout,
    parts_of,
)
from ..model.contract.parameters import OFFSET_NONE, Sensor
from . import bus
from .unit import Unit

# Beat of a packet of counts with the first row of the minigroup's memory.
_ROWS_BEAT = next(part.beat for part in parts_of(Sensor(), COUNTS) if part.field == "rows")


def numbers(m, sensor: Sensor, packets: Collection[Packet], kind, **values) -> dict[str, Value]:
    """Return the kind and the numbers of packets as signals of their fields' widths; fields that
    are not given are 0.
    """
    widths: dict[str, int] = {}
    for field in (field for packet in packets for field in packet.fields if not field.aligned):
        widths[field.name] = max(widths.get(field.name, 0), field.bits(sensor))
    widths["kind"] = KIND_BITS
    signals = {name: Signal(width, name=f"field_{name}") for name, width in widths.items()}
    m.d.comb += [
        signal.eq((values | {"kind": kind}).get(name, 0)) for name, signal in signals.items()
    ]
    return signals


def formed(
    sensor: Sensor, packets: Collection[Packet], fields: dict[str, Value]
) -> dict[Packet, list[Value]]:
    """Return the beats of packets with these fields at the places of the table.

    Equal beats are the same object.
    """
    made: dict[tuple[Part, ...], Value] = {}
    beats: dict[Packet, list[Value]] = {packet: [] for packet in packets}
    for packet in packets:
        for beat, group in groupby(parts_of(sensor, packet), lambda part: part.beat):
            parts = tuple(group)
            if beat == 0:
                parts += (Part("kind", KIND_BITS, 0, 0, KIND_LSB),)
            if parts not in made:
                made[parts] = _placed(parts, fields)
            beats[packet].append(made[parts])
    return beats


def _placed(parts: tuple[Part, ...], fields: dict[str, Value]) -> Value:
    """Return a beat that consists of parts of fields."""
    pieces, bit = [], 0
    for part in parts:
        piece = fields[part.field][part.shift : part.shift + part.width]
        pieces += [Const(0, part.lsb - bit)] * (part.lsb > bit) + [piece]
        bit = part.lsb + part.width
    return Cat(*pieces)


def of_format(form, value: Callable[[Packet], int]):
    """Return `value` for the packet of events that `form`, the format register, selects.

    In a frame without events it does not matter.
    """
    *others, last = EVENT_FORMATS.values()
    chosen = value(last)
    for number, packet in reversed(list(enumerate(others))):
        chosen = Mux(form == number, value(packet), chosen)
    return chosen


class Packetizer(Unit):
    """Packetizer of one subgroup.

    Ports
    -----
    grant, send : in, registered: a packet of this kind begins now. The next grant comes after the
        packet's last beat
    frame : in, settings; subgroup : in, number of this subgroup
    head, record, counters : in; take_event, take_record : out, with the last beat of the packet
    of_minigroup, minigroup : in, the counts of a minigroup with this number; read_row : out, row of
        its memory that is sent in the next cycle; take_counts : out, with the last beat of the packet; reading : out, a
        packet of counts is sent (all only if counts are built)
    controlled : in, the threshold controller sets the threshold of this subgroup
    valid, beat, beat_controlled : out, one cycle later; 0 while nothing is sent, so that the beats
        of all subgroups can be ORed

    Reset ends a packet.
    """

    unit_name = "coincid_packetizer"

    def __init__(self, sensor: Sensor):
        self.sensor = sensor
        super().__init__(
            grant=In(1),
            send=In(bus.Send),
            frame=In(bus.frame_layout(sensor)),
            subgroup=In(bus.SUBGROUP_BITS),
            head=In(bus.event_layout(sensor)),
            record=In(bus.record_layout(sensor)),
            counters=In(COUNTER_BITS * len(COUNTER_NAMES)),
            controlled=In(1),
            take_event=Out(1),
            take_record=Out(1),
            valid=Out(1),
            beat=Out(BEAT_BITS),
            beat_controlled=Out(1),
            **self._count_ports(),
        )
        beats = range(layout(sensor).longest + 1)
        self.active = Signal()  # a beat is sent
        self.sending = Signal()  # the packet goes on
        self.at_last = Signal()  # its last beat is next
        self.sent = Signal(bus.Send)  # kind of the packet of the beat that is sent
        self.send_before = Signal(bus.Send)
        self.index = Signal(beats)  # number of this beat in the packet
        self.index_before = Signal(beats)

    def _count_ports(self) -> dict[str, Any]:
        """Return the ports for counts, if they are built."""
        if not self.sensor.counts:
            return {}
        return {
            "of_minigroup": In(bus.minigroup_counts_layout(self.sensor)),
            "minigroup": In(range(self.sensor.minigroups)),
            "read_row": Out(range(ROWS)),
            "take_counts": Out(1),
            "reading": Out(1),
        }

    def elaborate(self, platform):
        m = Module()
        self._sequence(m)
        beats = {
            bus.Send.EVENT: self._event_beats(m),
            bus.Send.RECORD: self._record_beats(m) if self.sensor.records else [],
            bus.Send.COUNTERS: _beats(self.counters),
            bus.Send.COUNTS: self._count_beats(m) if self.sensor.counts else [],
        }
        chosen = Signal(BEAT_BITS)
        with m.Switch(self.sent):
            for send, of_packet in beats.items():
                with m.Case(send), m.Switch(self.index):
                    for k, beat in enumerate(of_packet):
                        with m.Case(k):
                            m.d.comb += chosen.eq(beat)
        with m.If(self.active | Cat(self.valid, self.beat, self.beat_controlled).any()):
            m.d.sync += [
                self.valid.eq(self.active),
                self.beat.eq(Mux(self.active, chosen, 0)),
                self.beat_controlled.eq(self.active & self.controlled),
            ]
        return m

    def _sequence(self, m):
        """Sequence the beats of the current packet. The last beat is recognised one cycle ahead."""
        ends = Signal()
        m.d.comb += [
            self.active.eq(self.grant | self.sending),
            self.sent.eq(Mux(self.grant, self.send, self.send_before)),
            self.index.eq(Mux(self.grant, 0, self.index_before)),
            ends.eq(Mux(self.grant, self._last(self.send) == 0, self.sending & self.at_last)),
            self.take_event.eq(ends & (self.sent == bus.Send.EVENT)),
            self.take_record.eq(ends & (self.sent == bus.Send.RECORD)),
        ]
        if self.sensor.counts:
            is_counts = self.sent == bus.Send.COUNTS
            m.d.comb += [
                self.take_counts.eq(ends & is_counts),
                self.reading.eq(self.active & is_counts),
                self.read_row.eq(self.index - (_ROWS_BEAT - 1)),
            ]
        with m.If(self.active):
            m.d.sync += [
                self.sending.eq(~ends),
                self.send_before.eq(self.sent),
                self.index_before.eq(self.index + 1),
                # Beyond the last beat only after an upset.
                self.at_last.eq(self.index + 1 >= self._last(self.sent)),
            ]

    def _last(self, send):
        """Return the number of a packet's last beat."""
        lengths = layout(self.sensor)
        of_event = of_format(self.frame.format, lambda packet: lengths.length(packet) - 1)
        of_record = lengths.length(RECORD) - 1
        others = Mux(send == bus.Send.RECORD, of_record, lengths.counter_beats - 1)
        if self.sensor.counts:
            others = Mux(send == bus.Send.COUNTS, lengths.length(COUNTS) - 1, others)
        return Mux(send == bus.Send.EVENT, of_event, others)

    def _event_beats(self, m):
        window = self.head.window
        kind = Signal(KIND_BITS)
        m.d.comb += kind.eq(of_format(self.frame.format, lambda packet: packet.code))
        fields = numbers(
            m,
            self.sensor,
            EVENT_FORMATS.values(),
            kind,
            overrun=self.head.overrun,
            subgroup=self.subgroup,
            pulse=self.head.pulse,
            count=window.count,
            winner=window.winner,
            stamp=window.stamp,
        )
        names = [name for name in built_formats(self.sensor) if name in EVENT_FORMATS]
        built = [EVENT_FORMATS[name] for name in names]
        offsets = []
        for g in range(self.sensor.minigroups if self.sensor.offsets else 0):
            hit = Cat(window.hits[i] for i in self.sensor.members(g)).any()
            offset = Signal(OFFSETS.width, name=f"offset_{g}")
            m.d.comb += offset.eq(Mux(hit, self.head.offsets[g], OFFSET_NONE))
            offsets.append(offset)
        beats = formed(self.sensor, built, fields | {"map": window.hits, "offsets": Cat(offsets)})
        longest = max(beats.values(), key=len)
        return [self._of_formats(k, beats, longest[k]) for k in range(len(longest))]

    def _of_formats(self, k, beats, beat):
        """Return beat `k` of an event in the frame's format.

        In formats with fewer beats it does not matter, and is `beat`.
        """
        of_packet = {packet: each[k] if k < len(each) else beat for packet, each in beats.items()}
        same = all(each is beat for each in of_packet.values())
        return (
            beat
            if same
            else of_format(self.frame.format, lambda packet: of_packet.get(packet, beat))
        )

    def _record_beats(self, m):
        fields = numbers(
            m, self.sensor, [RECORD], RECORD.code, subgroup=self.subgroup, pulse=self.record.pulse
        )
        entries = []
        for g in range(self.sensor.minigroups):
            entry = Signal(self.sensor.record_bits, name=f"entry_{g}")
            m.d.comb += entry.eq(self.record.entries[g].as_value())
            entries.append(entry)
        return formed(self.sensor, [RECORD], fields | {"entries": Cat(entries)})[RECORD]

    def _count_beats(self, m):
        """Return the beats of a minigroup's counts; `read_row` says which row is shown."""
        fields = numbers(
            m,
            self.sensor,
            [COUNTS],
            COUNTS.code,
            gates=self.of_minigroup.gates,
            minigroup=self.minigroup,
            subgroup=self.subgroup,
        )
        rows = self.of_minigroup.row.replicate(ROWS)
        fields |= {"pulses": self.of_minigroup.pulses, "rows": rows}
        return formed(self.sensor, [COUNTS], fields)[COUNTS]


def _beats(value):
    return [value[at : at + BEAT_BITS] for at in range(0, len(value), BEAT_BITS)]
