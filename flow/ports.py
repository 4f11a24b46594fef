# SPDX-License-Identifier: Apache-2.0
"""Ports of the top modules, for integrators: a table and an instance, from the list of ports of
the RTL.

Names, widths and directions come from the RTL. Meanings and values after a reset are defined here.
`python -m coincid.flow.ports` renews these parts of docs/integrate.md, and the tables of
docs/contract.md and docs/files.md.
"""

import re
from itertools import groupby
from pathlib import Path

from attrs import frozen

from ..hdl.deserialiser import CYCLES
from ..hdl.front_end_views import POLYPHASE, View
from ..hdl.sensor import FPGA_TOP, SensorTop
from ..model.contract.counters import COUNTER_NAMES
from ..model.contract.packet import (
    BEAT_BITS,
    COUNTS,
    ENTRIES,
    EVENT_FORMATS,
    FORMATS,
    FRAME_END,
    FRAME_START,
    HEADER,
    MAP,
    OFFSETS,
    RECORD,
    Field,
    built_formats,
    layout,
)
from ..model.contract.parameters import TOP, Sensor
from ..model.shared import markdown
from ..tools.pages import put
from .contract_tables import counts_table, header_table, settings_tables

GROUPS = Path(__file__).with_name("groups.md")
EXAMPLE = Sensor(rows=8, cols=16)  # for docs/integrate.md: two subgroups, one module

UNDEFINED = "any"  # value after a reset of what comes from a memory
_READY = "the port takes what its `valid` offers; low during a reset"
_MEANINGS = {  # pattern of a port's name -> value after a reset (outputs only), meaning
    r"clk": ("", "system clock; every other port is sampled and driven at its rising edge"),
    r"rst": ("", "synchronous reset, high; one cycle is enough"),
    r"s_axi_awaddr": ("", "byte address of a register"),
    r"s_axi_araddr": ("", "byte address of a register; its lowest two bits are ignored"),
    r"s_axi_(aw|ar)prot": ("", "ignored"),
    r"s_axi_(aw|w|ar)valid": ("", "address or data is offered"),
    r"s_axi_(aw|w|ar)ready": ("0; 1 one cycle later", _READY),
    r"s_axi_wdata": ("", "value of a write"),
    r"s_axi_wstrb": (
        "",
        "all ones; a write of a part of a word answers SLVERR, one of no byte OKAY",
    ),
    r"s_axi_bresp": ("0", "answer to a write: 0 OKAY, 2 SLVERR"),
    r"s_axi_rresp": ("0", "answer to a read: 0 OKAY, 2 SLVERR"),
    r"s_axi_rdata": ("0", "value of a read; 0 with SLVERR"),
    r"s_axi_[br]valid": ("0", "the answer stands, and stays until it is taken"),
    r"s_axi_[br]ready": ("", "the answer is taken"),
    r"m_axis\d*_tdata": (
        UNDEFINED,
        "beat of a packet; means something only while `tvalid` is high",
    ),
    r"m_axis\d*_tvalid": ("0", "a beat is offered, and stays until it is taken"),
    r"m_axis\d*_tready": ("", "the beat is taken; may be low for any time"),
    r"m_axis\d*_tlast": (
        UNDEFINED,
        "last beat of the frame on this stream; means something only while `tvalid` is high",
    ),
    r"test_enable": (
        "",
        "0; 1 for a test of the chip: clock gates pass every edge, memories of latches are transparent",
    ),
    r"laser": ("0", "high in cycle 0 of every laser period"),
    r"spad_gate": (
        "0; all ones two cycles later",
        "bit s: the gate of subgroup s is open, or gating is off",
    ),
    r"phase_clocks": ("", "bit j: a clock like `clk`, (j + 1) ticks later, from the same PLL"),
}


@frozen
class PortRow:
    """A row of the table of ports. width: in bits. clock: its clock. reset: value of an output
    after a reset.
    """

    name: str
    width: int
    direction: str
    clock: str
    reset: str
    meaning: str


def port_rows(sensor: Sensor, top: str = TOP, view: View = POLYPHASE) -> list[PortRow]:
    """Return the ports of a top module, `clk` and `rst` first, in the order of its Verilog."""
    ports = [("clk", 1, True), ("rst", 1, True)]
    ports += [
        (port.name, port.width, port.is_input)
        for port in SensorTop(sensor, view, top == FPGA_TOP).ports()
    ]
    return [
        PortRow(
            name,
            width,
            "in" if is_input else "out",
            _clock(name, view),
            *_meaning(name, sensor, view),
        )
        for name, width, is_input in ports
    ]


def _clock(name: str, view: View) -> str:
    if name in ("clk", "phase_clocks"):
        return "is one"
    if name.startswith("line_") or (view.macros and re.fullmatch(r"spad_\d+", name)):
        return "none"
    return "clk"


def _meaning(name: str, sensor: Sensor, view: View) -> tuple[str, str]:
    if match := re.fullmatch(r"(spad|line)_(\d+)", name):
        kind, subgroup = match.groups()
        rises = f"SPADs of subgroup {subgroup}: bit i rises with an avalanche in pixel i"
        if kind == "line":
            late = f"{CYCLES} cycles before its edge word counts"
            skew = "the delays of a bit to its samplers differ by less than half a tick"
            return "", f"levels of the {rises}, {late}; {skew}"
        if view.macros:
            return "", f"lines of the {rises}"
        word = f"bit {sensor.phases} * i + k is an avalanche in pixel i in tick k of this cycle"
        return "", f"edge words of subgroup {subgroup}: {word}"
    for pattern, told in _MEANINGS.items():
        if re.fullmatch(pattern, name):
            return told
    raise AssertionError(f"port {name} has no meaning")


def port_table(sensor: Sensor, top: str = TOP, view: View = POLYPHASE) -> str:
    """Return the ports as a Markdown table. Ports that differ only in their number share a row."""
    told = []
    for _, family in groupby(
        port_rows(sensor, top, view), lambda row: re.sub(r"^(spad|line)_\d+$", r"\1", row.name)
    ):
        first, *others = family
        name, meaning = f"`{first.name}`", first.meaning
        if others:
            name += f" to `{others[-1].name}`"
            meaning = meaning.replace("of subgroup 0", "of the subgroup with the port's number")
        told.append((name, first.width, first.direction, first.clock, first.reset, meaning))
    head = "port", "bits", "direction", "clock", "after reset", "meaning"
    return "\n".join([*markdown.table(head, told, left=(0, 2, 3, 4, 5)), ""])


def instantiation(sensor: Sensor, top: str = TOP, view: View = POLYPHASE) -> str:
    """Return an instance of the top module in Verilog, with a wire of the same name at every
    port.
    """
    rows = port_rows(sensor, top, view)
    wires = [f"wire {f'[{row.width - 1}:0] ' if row.width > 1 else ''}{row.name};" for row in rows]
    ports = [f"  .{row.name}({row.name})" for row in rows]
    return "\n".join([*wires, "", f"{top} sensor (", ",\n".join(ports), ");"]) + "\n"


def stream_words(sensor: Sensor, groups_link: str = "contract.md#groups-of-events") -> str:
    """Return a description of the beats of every packet of a sensor, as Markdown.

    groups_link: to the page that describes groups of events.
    """
    lengths = layout(sensor)
    fields = ", ".join(
        f"[{low + width - 1}:{low}] {'type' if name == 'kind' else name}"
        for name, (low, width) in HEADER.items()
    )
    counters = ", ".join(f"`{name}`" for name in COUNTER_NAMES)
    rows = [(FRAME_START, "frame start", 1, "nothing; `pulse` holds the frame's number")]
    for name, packet in EVENT_FORMATS.items():
        if packet.grouped or name not in built_formats(sensor):
            continue
        behind = (
            ", then ".join(f"the {field.name}" for field in packet.fields if field.aligned)
            or "nothing"
        )
        rows.append((packet, f"event, format {name}", lengths.length(packet), behind))
    if sensor.counts:
        after = "the pulses of its pixels, then its rows"
        rows.append((COUNTS, "counts of a minigroup", lengths.length(COUNTS), after))
    if sensor.records:
        after = "the minigroups' entries"
        rows.append((RECORD, "minigroup record", lengths.length(RECORD), after))
    after = f"{lengths.counter_beats} beats per subgroup of the stream: its counters"
    rows.append((FRAME_END, "frame end", 1, after))

    def beats(field: Field) -> int:
        return -(-field.bits(sensor) // BEAT_BITS)

    told = f"\n* Map, {beats(MAP)} beats: bit i of beat w is pixel 64 w + i.\n"
    if sensor.offsets:
        told += f"* Offsets, {beats(OFFSETS)} beats: a byte per minigroup, eight in a beat; 255 means not hit.\n"
    if sensor.records:
        told += f"* Entries, {beats(ENTRIES)} beats: {sensor.record_bits} bits per minigroup, the map above the stamp; map 0 means nothing latched.\n"
    told += f"* Counters, 32 bits each, two in a beat, lowest bits first: {counters}.\n"
    coded = ((packet.code, name, length, after) for packet, name, length, after in rows)
    table = markdown.table(("type", "packet", "beats", "after the header"), coded, left=(1, 3))
    grouped = " and ".join(f"`{name}`" for name in built_formats(sensor) if FORMATS[name].grouped)
    formats = "formats" if " and " in grouped else "format"
    groups_told = f"In the {formats} {grouped}, events leave in groups, whose beats have type 5"
    told += f"\n{groups_told} ([{groups_link.partition('#')[0]}]({groups_link})).\n"
    if sensor.counts:
        told += f"\nA packet with counts has other fields:\n\n{counts_table()}"
    return (
        f"The first beat of every packet is a header: {fields}.\n\n"
        + "\n".join(table)
        + "\n"
        + told
    )


def groups_page() -> str:
    """Return the rule of the formats with groups of events, as Markdown."""
    return GROUPS.read_text(encoding="utf-8")


def pages() -> dict[str, dict[str, str]]:
    """Return the generated regions by page and by name."""
    return {
        "docs/integrate.md": {
            "ports": port_table(EXAMPLE),
            "instance": f"```verilog\n{instantiation(EXAMPLE)}```\n",
            "words": stream_words(EXAMPLE),
        },
        "docs/contract.md": {
            "header": header_table(),
            "groups": groups_page(),
            "counts": counts_table(),
        },
        "docs/files.md": settings_tables(),
    }


def write_pages() -> None:
    """Write the regions into the pages."""
    for page, parts in pages().items():
        for name, text in parts.items():
            put(page, name, text)


if __name__ == "__main__":
    write_pages()
