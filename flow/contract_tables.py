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
    RECORD,
    Field,
    Part,
    parts_of,
)
from ..model.contract.parameters import Sensor
from ..model.contract.table import Kind, Limit, Setting
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
        f"event: {kinds}; {GROUP_KIND} group of events, {RECORD.code} minigroup record,"
        f" {COUNTS.code} [counts](#counts) of a minigroup, {FRAME_START.code} frame start, {FRAME_END.code} frame end"
    )
    rows = [
        (f"`{name}`", f"{lsb + width - 1}:{lsb}", docs[name])
        for name, (lsb, width) in HEADER.items()
    ]
    return "\n".join(
        [*markdown.table(["header field", "bits", "meaning"], rows, left=range(3)), ""]
    )


def counts_table() -> str:
    """Return the fields of a packet with counts, beat by beat."""
    sensor = Sensor(counts=1)
    lsb, width = HEADER["kind"]
    rows = [("0", _bits(lsb, width), "`kind`", str(COUNTS.code))]
    fields = {field.name: field for field in COUNTS.fields}
    for name, group in groupby(parts_of(sensor, COUNTS), lambda part: part.field):
        rows.append(_row_of_parts(fields[name], list(group), sensor))
    rows.sort(key=lambda row: int(row[0].split()[0]))
    return "\n".join(
        [*markdown.table(["beat", "bits", "field", "meaning"], rows, left=range(4)), ""]
    )


def _row_of_parts(field: Field, parts: list[Part], sensor: Sensor) -> tuple[str, str, str, str]:
    """Return the row of a field. parts: of one beat, or one whole beat after the other."""
    first = parts[0]
    last = parts[-1]
    beats = f"{first.beat} to {last.beat}" if len(parts) > 1 else f"{first.beat}"
    items = field.bits(sensor) // int(field.width) if isinstance(field.width, int) else 1
    if len(parts) > 1:
        assert all(part.width == BEAT_BITS for part in parts)
    elif items > 1:
        return (
            beats,
            _bits(first.lsb, first.width),
            f"`{field.name}`",
            f"{items} x {field.width} bits: {field.doc}",
        )
    return beats, _bits(first.lsb, first.width), f"`{field.name}`", field.doc


def _bits(lsb: int, width: int) -> str:
    return f"{lsb + width - 1}:{lsb}"
