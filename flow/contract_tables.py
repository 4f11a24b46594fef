# SPDX-License-Identifier: Apache-2.0
"""Generated tables of the pages: the header of the stream's packets (docs/contract.md), and
settings (docs/files.md).
"""

from ..model.contract.config import TABLES
from ..model.contract.packet import FORMATS, FRAME_END, FRAME_START, GROUP_KIND, HEADER, RECORD
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
        return "[by its rule](contract.md#threshold-controller)"
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
        for name, of in FORMATS.items()
        if not of.grouped
    )
    docs["kind"] = (
        f"event: {kinds}; {GROUP_KIND} group of events, {RECORD.code} minigroup record, {FRAME_START.code} frame start, {FRAME_END.code} frame end"
    )
    rows = [
        (f"`{name}`", f"{lsb + width - 1}:{lsb}", docs[name])
        for name, (lsb, width) in HEADER.items()
    ]
    return "\n".join(
        [*markdown.table(["header field", "bits", "meaning"], rows, left=range(3)), ""]
    )
