# SPDX-License-Identifier: Apache-2.0
"""The exported C driver: its sources, and a header with the packets of the stream (from
`model/contract/packet.py`).
"""

from pathlib import Path

from ..model.contract import counts, groups
from ..model.contract.counters import COUNTER_NAMES
from ..model.contract.packet import (
    COUNTS,
    FRAME_END,
    GROUP_KIND,
    KIND_BITS,
    PACKETS,
    UNUSED,
    WITH_COUNTS,
    WITH_GROUPS,
    Field,
    Packet,
)
from ..model.contract.parameters import QUARTERS
from ..model.contract.table import Limit
from ..model.shared.licence import SPDX

EXAMPLE = "coincid_decode.c"  # has a `main`
SOURCES = tuple(Path(__file__).with_name(name) for name in ("coincid.h", "coincid.c", EXAMPLE))
PACKETS_HEADER = "coincid_packets.h"
_GROUPS = {  # places and widths in groups of events
    "FIRST_LSB": groups.FIRST_LSB,
    "LAST_LSB": groups.LAST_LSB,
    "PAYLOAD_BITS": groups.PAYLOAD_BITS,
    "CHECK_LSB": groups.CHECK_LSB,
    "CHECK_POLYNOMIAL": groups.CHECK_POLYNOMIAL,
    "LISTED_BITS": groups.LISTED_BITS,
    "MAPPED": groups.MAPPED,
    "AGE_BITS": groups.AGE_BITS,
} | {f"{name.upper()}_IN_HEAD": bits for name, bits in groups.HEAD._asdict().items()}
_COUNTS = {
    "GATES": counts.GATES,
    "NO_GATE": counts.NO_GATE,
    "GATE_BITS": counts.GATE_BITS,
    "GATE_CYCLES": counts.GATE_CYCLES,
    "QUARTERS": QUARTERS,
    "COUNT_BITS": counts.COUNT_BITS,
    "COUNT_PULSE_BITS": next(field.width for field in COUNTS.fields if field.name == "pulses"),
}


def c_driver() -> dict[str, str]:
    """Return the files of the driver by name. It fits every sensor, and needs the header of the
    registers.
    """
    return {path.name: path.read_text(encoding="utf-8") for path in SOURCES} | {
        PACKETS_HEADER: _packets_header()
    }


def _packets_header() -> str:
    kinds = ", ".join(f"{_kind(packet)} = {code}" for code, packet in PACKETS.items())
    counters = ", ".join(f"COINCID_COUNTER_{name.upper()}" for name in COUNTER_NAMES)
    lines = [
        f"/* {SPDX} */",
        "/* Packets of the stream. The kind is in the highest bits of the first beat; the fields fill the other bits, lowest",
        "   first: NUMBER(name, bits), or ITEMS(name, bits of an item, items), which begin with a new beat. */",
        "#ifndef COINCID_PACKETS_H",
        "#define COINCID_PACKETS_H",
        "",
        f"#define COINCID_KIND_BITS {KIND_BITS}u",
        f"#define COINCID_COUNTERS {len(COUNTER_NAMES)}u /* of a subgroup, in a frame end */",
        f"enum {{ {counters} }};",
        f"enum {{ {kinds}, COINCID_GROUP = {GROUP_KIND}, COINCID_DAMAGED = {1 << KIND_BITS} }};",
        *(f"#define COINCID_{name} {value}u" for name, value in _GROUPS.items()),
        "/* Counts in gates. */",
        *(f"#define COINCID_{name} {value}u" for name, value in _COUNTS.items()),
        "/* `count` of a frame start, if the frame does not have events one by one. */",
        f"enum {{ COINCID_WITH_GROUPS = {WITH_GROUPS}, COINCID_WITH_COUNTS = {WITH_COUNTS} }};",
        "/* Bits of the first beat that are 0 in these kinds. */",
        *(
            f"#define {_kind(PACKETS[code])}_UNUSED {unused:#x}ull"
            for code, unused in UNUSED.items()
        ),
        "",
        "/* PACKET(kind, times, fields): whatever follows the first beat comes `times` times. */",
        "#define COINCID_PACKETS(PACKET, NUMBER, ITEMS) \\",
        " \\\n".join(f"    {_packet(packet)}" for packet in PACKETS.values()),
        "",
        "#endif",
        "",
    ]
    return "\n".join(lines)


def _kind(packet: Packet) -> str:
    name = "gate_counts" if packet is COUNTS else packet.name  # `COINCID_COUNTS` is a register
    return f"COINCID_{name.upper()}"


def _packet(packet: Packet) -> str:
    fields = [
        f"ITEMS({field.name}, {_number(field.width)}, {_number(field.items)})"
        if field.aligned
        else f"NUMBER({field.name}, {_bits(field)})"
        for field in packet.fields
    ]
    times = "subgroups" if packet is FRAME_END else "1u"
    return f"PACKET({_kind(packet)}, {times}, {' '.join(fields)})"


def _bits(field: Field) -> str:
    """Return the bits of all items of a field, which is one number for the driver."""
    if isinstance(field.width, int) and isinstance(field.items, int):
        return _number(field.width * field.items)
    raise TypeError(f"{field.name}: its width depends on the sensor")


def _number(limit: Limit) -> str:
    """Return a number, or the field of `coincid_sensor_info` that holds it."""
    return f"info->{limit}" if isinstance(limit, str) else f"{limit}u"
