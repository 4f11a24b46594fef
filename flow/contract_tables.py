# SPDX-License-Identifier: Apache-2.0
"""Generated tables of the pages: the header of the stream's packets and the packet of counts
(docs/contract.md), and settings (docs/files.md).
"""

from itertools import groupby

from ..model.contract.config import TABLES
from ..model.contract.packet import (
    BEAT_BITS,
    COUNTS,
    EVENT_FORMATS,
    FRAME_END,
    FRAME_START,
    GROUP_KIND,
    HEADER,
    KIND_BITS,
    KIND_LSB,
    RECORD,
    Field,
    Part,
    parts_of,
)
from ..model.contract.parameters import Sensor
from ..model.contract.table import Kind, Limit, Setting, number
from ..model.shared import markdown


def settings_tables() -> dict[str, str]:
    """Return the keys of the configuration file, by the names of their markers."""
    return {f"settings of {table}": _settings_table(table) for table in TABLES}


def _settings_table(table: str) -> str:
    rows = [
        (f"`{name}`", _default(setting), _legal(setting), setting.unit, setting.doc)
        for name, setting in TABLES[table].items()
    ]
    return "\n".join(
        [
            *markdown.table(
                [f"`[{table}]`", "default", "legal", "unit", "meaning"], rows, left=range(5)
            ),
            "",
        ]
    )


def _default(setting: Setting) -> str:
    if setting.kind is Kind.MASK:
        return "all on"
    if setting.derived:
        section = "counts" if setting.needs == "counts" else "threshold-controller"
        return f"[by its rule](contract.md#{section})"
    default = setting.default
    if setting.follows:
        return f"`{setting.follows}`"
    if isinstance(default, bool):
        return str(default).lower()
    return str(list(default) if isinstance(default, tuple) else default)


def _legal(setting: Setting) -> str:
    if setting.kind is Kind.SWITCH:
        return "true, false"
    if setting.kind is Kind.CHOICE:
        return ", ".join(setting.choices)
    if setting.kind is Kind.MASK:
        return "hex digits"
    numbers = f"{_number(setting.low)} to {_number(setting.high)}"
    if setting.kind is Kind.SIZE:
        return f"[rows, cols] of {numbers}"
    return f"{setting.count} integers, {numbers}" if setting.kind is Kind.INTEGERS else numbers


def _number(limit: Limit) -> str:
    return f"`{limit}`" if isinstance(limit, str) else f"{limit:.10g}"


def header_table() -> str:
    """Return the fields of a packet's header."""
    docs = {field.name: field.doc for field in FRAME_START.fields}
    kinds = ", ".join(
        f"{of.code} {name}{f' (with {of.doc})' * bool(of.doc)}"
        for name, of in EVENT_FORMATS.items()
        if not of.grouped
    )
    docs["kind"] = (
        f"{COUNTS.code} [counts](#counts) of a minigroup; event: {kinds}; {GROUP_KIND} group of events,"
        f" {RECORD.code} minigroup record, {FRAME_START.code} frame start, {FRAME_END.code} frame end"
    )
    rows = [
        (f"`{name}`", f"{lsb + width - 1}:{lsb}", docs[name])
        for name, (lsb, width) in HEADER.items()
    ]
    return "\n".join(
        [*markdown.table(["header field", "bits", "meaning"], rows, left=range(3)), ""]
    )


def counts_table() -> str:
    """Return the fields of a packet with counts: by beat, the highest bits of each beat first."""
    sensor = Sensor(counts=1)
    kind = Part("kind", KIND_BITS, 0, 0, KIND_LSB)
    meanings = {"kind": str(COUNTS.code)} | {
        field.name: _meaning(field, sensor) for field in COUNTS.fields
    }
    parts = [kind, *parts_of(sensor, COUNTS)]
    parts.sort(key=lambda part: (part.beat, -part.lsb))
    rows = []
    for name, group in groupby(parts, lambda part: part.field):
        first, *others = group
        beats = f"{first.beat} to {others[-1].beat}" if others else f"{first.beat}"
        bits = f"{first.lsb + first.width - 1}:{first.lsb}"
        rows.append((beats, bits, f"`{name}`", meanings[name]))
    head = "beat", "bits", "field", "meaning"
    return "\n".join([*markdown.table(head, rows, left=range(4)), ""])


def _meaning(field: Field, sensor: Sensor) -> str:
    """Return what a field holds; several items in a beat with their width."""
    width = int(number(field.width, sensor))
    items = field.bits(sensor) // width
    return f"{items} x {width} bits: {field.doc}" if items > 1 and width < BEAT_BITS else field.doc
