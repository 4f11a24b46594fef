"""The register map for people and for software: Markdown, a C header and JSON, all from the one table of `model/registers.py`."""

import json

from attrs import asdict

from ..model.parameters import Sensor
from ..model.registers import (
    ADDRESS_BITS,
    DATA_BITS,
    GLOBAL,
    SUBGROUP,
    SUBGROUP_BASE,
    SUBGROUP_STRIDE,
    Access,
    Register,
)

MARKDOWN, HEADER, JSON = "registers.md", "coincid_regs.h", "registers.json"
PREFIX = "COINCID"
WRITABLE = (Access.SETTING, Access.PULSE, Access.STATUS)


def register_files(sensor: Sensor) -> dict[str, str]:
    """File name -> text of the register map of `sensor`. Equal parameters give equal bytes."""
    return {
        MARKDOWN: _markdown(sensor),
        HEADER: _header(sensor),
        JSON: json.dumps(register_map(sensor), indent=2) + "\n",
    }


def register_map(sensor: Sensor) -> dict:
    """The map as plain data: addresses and offsets in bytes, ranges and reset values as built."""
    return {
        "data_bits": DATA_BITS, "address_bits": ADDRESS_BITS, "subgroups": sensor.subgroups,
        "subgroup_base": SUBGROUP_BASE, "subgroup_stride": SUBGROUP_STRIDE,
        "global": [_plain(register, sensor) for register in GLOBAL],
        "subgroup": [_plain(register, sensor) for register in SUBGROUP],
    }


def _plain(register: Register, sensor: Sensor) -> dict:
    values = {
        "name": register.name, "offset": register.offset, "count": register.count(sensor), "access": register.access.name.lower(),
        "reset": register.reset(sensor), "doc": register.doc,
    }
    if register.access in WRITABLE:
        values |= {"low": register.low(sensor), "high": register.high(sensor)}
    if register.bits:
        values["bits"] = [asdict(bits) for bits in register.bits]
    return values


def _markdown(sensor: Sensor) -> str:
    lines = [
        f"# Registers of the {sensor.rows} x {sensor.cols} sensor", "",
        f"AXI4-Lite, {DATA_BITS}-bit words, {ADDRESS_BITS}-bit byte addresses. A write outside the range of its register, to a",
        "read-only or an unmapped address, or of less than a word answers SLVERR, changes nothing, and sets a bit of `status`.", "",
        *(f"* {access.name.lower()}: {access.value}" for access in Access), "",
        "## Global block", "", *_table(GLOBAL, sensor), "",
        f"## Block of subgroup s, 0 to {sensor.subgroups - 1}", "",
        f"At {SUBGROUP_BASE:#x} + {SUBGROUP_STRIDE:#x} * s; offsets are within the block.", "", *_table(SUBGROUP, sensor), "",
    ]
    return "\n".join(lines)


def _table(registers: tuple[Register, ...], sensor: Sensor) -> list[str]:
    lines = ["| offset | name | access | range | reset | meaning |", "| --- | --- | --- | --- | --- | --- |"]
    for register in registers:
        count, offset = register.count(sensor), f"{register.offset:#05x}"
        if count > 1:
            offset += f" + 4 i, i < {count}"
        legal = f"{register.low(sensor)} to {register.high(sensor)}" if register.access in WRITABLE else ""
        reset = "" if register.access is Access.COUNTER else register.reset(sensor)
        doc = register.doc.replace("|", r"\|")
        lines.append(f"| {offset} | {register.name} | {register.access.name.lower()} | {legal} | {reset} | {doc} |")
        for bits in register.bits:
            lines.append(f"| | bit {bits.lsb}: {bits.name} | | | | {bits.doc}{' Write 1 to clear.' if bits.clears else ''} |")
    return lines


def _header(sensor: Sensor) -> str:
    lines = [
        f"/* Registers of the {sensor.rows} x {sensor.cols} sensor: byte addresses, ranges, bits. See {MARKDOWN}. */",
        f"#ifndef {PREFIX}_REGS_H", f"#define {PREFIX}_REGS_H", "", f"#define {PREFIX}_SUBGROUPS {sensor.subgroups}u", "",
    ]
    for register in GLOBAL:
        lines += _defines(register, sensor, f"{register.offset:#06x}u", [])
    for register in SUBGROUP:
        lines += _defines(register, sensor, f"{SUBGROUP_BASE + register.offset:#06x}u + {SUBGROUP_STRIDE:#x}u * (sg)", ["sg"])
    return "\n".join([*lines, "", f"#endif /* {PREFIX}_REGS_H */", ""])


def _defines(register: Register, sensor: Sensor, address: str, arguments: list[str]) -> list[str]:
    name = f"{PREFIX}_{register.name.upper()}"
    if register.count(sensor) > 1:
        address, arguments = f"{address} + 4u * (i)", [*arguments, "i"]
    macro = f"{name}({', '.join(arguments)})" if arguments else name
    lines = [f"#define {macro} ({address})  /* {register.doc} */"]
    if register.access is Access.CONSTANT:
        lines.append(f"#define {name}_VALUE {register.reset(sensor)}u")
    if register.access is Access.SETTING:
        lines += [f"#define {name}_LOWEST {register.low(sensor)}u", f"#define {name}_HIGHEST {register.high(sensor)}u"]
    for bits in register.bits:
        mask = ((1 << bits.width) - 1) << bits.lsb
        lines.append(f"#define {name}_{bits.name.upper()} {mask:#x}u  /* {bits.doc} */")
    return lines
