# SPDX-License-Identifier: Apache-2.0
"""The register map for people and for tools, from the one table in `model/contract/registers.py`.

The formats are Markdown, HTML, a C header, JSON, SystemRDL, and IP-XACT, which PeakRDL makes
from the SystemRDL. The HTML
is our own: it has 9 kB and includes the legal ranges, for which SystemRDL has no place. That of
PeakRDL is an application of 7.8 MB.
"""

import html
import json
import re
import tempfile
from pathlib import Path
from string import Template
from typing import Any

from attrs import asdict

from ..model.contract.packet import FORMAT_NAMES, built_formats
from ..model.contract.parameters import Sensor, bits_for
from ..model.contract.registers import (
    ADDRESS_BITS,
    BY_NAME,
    DATA_BITS,
    GLOBAL,
    MODE,
    SUBGROUP,
    SUBGROUP_BASE,
    SUBGROUP_STRIDE,
    WRITABLE,
    Access,
    Bits,
    Register,
    built,
)
from ..model.contract.settings import SWITCHES
from ..model.shared import markdown
from ..model.shared.licence import SPDX

MARKDOWN, HTML, HEADER = "registers.md", "registers.html", "coincid_regs.h"
JSON, RDL, IP_XACT = "registers.json", "registers.rdl", "registers.xml"
PREFIX, TOP = "COINCID", "coincid_sensor"
PAGE = Path(__file__).with_name("registers.html")


def register_files(sensor: Sensor) -> dict[str, str]:
    """Return the register map of `sensor` by file name. Equal parameters give equal bytes."""
    rdl = _systemrdl(sensor)
    return {
        MARKDOWN: _markdown(sensor),
        HTML: _html(sensor),
        HEADER: _header(sensor),
        JSON: json.dumps(register_map(sensor), indent=2) + "\n",
        RDL: rdl,
        IP_XACT: _ip_xact(rdl),
    }


def register_map(sensor: Sensor) -> dict[str, Any]:
    """Return the map as plain data: addresses and offsets in bytes, ranges and reset values of
    this sensor.
    """
    return {
        "data_bits": DATA_BITS,
        "address_bits": ADDRESS_BITS,
        "subgroups": sensor.subgroups,
        "subgroup_base": SUBGROUP_BASE,
        "subgroup_stride": SUBGROUP_STRIDE,
        "global": [_plain(register, sensor) for register in built(GLOBAL, sensor)],
        "subgroup": [_plain(register, sensor) for register in built(SUBGROUP, sensor)],
    }


def _plain(register: Register, sensor: Sensor) -> dict[str, Any]:
    values = {
        "name": register.name,
        "offset": register.offset,
        "count": register.count(sensor),
        "access": register.access.name.lower(),
        "reset": register.reset(sensor),
        "doc": _doc(register, sensor),
    }
    if register.access in WRITABLE:
        values |= {"low": register.low(sensor), "high": register.high(sensor)}
    if register.bits:
        values["bits"] = [asdict(bits) for bits in _bits(register, sensor)]
    return values


def _doc(register: Register, sensor: Sensor) -> str:
    """Return what a register is for, without the formats that the sensor refuses."""
    doc = register.doc
    if register is not BY_NAME["format"] or len(built_formats(sensor)) == len(FORMAT_NAMES):
        return doc
    for number, name in enumerate(FORMAT_NAMES):
        if name not in built_formats(sensor):
            doc = re.sub(rf", {number} {name} \([^()]*\)", "", doc)
    return f"{doc} Other numbers are refused."


def _bits(register: Register, sensor: Sensor) -> list[Bits]:
    """Return the parts of a register, without the modes that the sensor refuses."""
    if register is not MODE:
        return list(register.bits)
    return [bits for bits in register.bits if SWITCHES[bits.name].built(sensor)]


HEAD = ("offset", "name", "access", "range", "reset", "meaning")


def _intro(sensor: Sensor) -> tuple[str, str]:
    return f"Registers of the {sensor.rows} x {sensor.cols} sensor", (
        f"AXI4-Lite, {DATA_BITS}-bit words, {ADDRESS_BITS}-bit byte addresses. A write outside the range of its register, to a "
        "read-only or an unmapped address, or of less than a word answers SLVERR, changes nothing, and sets a bit of status. A "
        "write of no byte answers OKAY and changes nothing. A read ignores the lowest two bits of its address."
    )


def _blocks(sensor: Sensor) -> list[tuple[str, str, list[list[str]]]]:
    """Return (title, text, rows of `HEAD`) for both blocks."""
    where = f"At {SUBGROUP_BASE:#x} + {SUBGROUP_STRIDE:#x} * s; offsets are within the block."
    where += _while_busy(sensor)
    return [
        ("Global block", "At 0.", _rows(GLOBAL, sensor)),
        (f"Block of subgroup s, 0 to {sensor.subgroups - 1}", where, _rows(SUBGROUP, sensor)),
    ]


def _while_busy(sensor: Sensor) -> str:
    """Return how the settings of a subgroup differ from others if no second copy of them is
    built; "" if one is.
    """
    if sensor.held:
        return ""
    return (
        " held is 0: a write to a setting of a subgroup while busy is refused like a value out of"
        " range; at other times, it takes effect at once and not at frame start."
    )


def _rows(registers: tuple[Register, ...], sensor: Sensor) -> list[list[str]]:
    rows = []
    for register in built(registers, sensor):
        count, offset = register.count(sensor), f"{register.offset:#05x}"
        if count > 1:
            offset += f" + 4 i, i < {count}"
        legal = (
            f"{register.low(sensor)} to {register.high(sensor)}"
            if register.access in WRITABLE
            else ""
        )
        reset = "" if register.access is Access.COUNTER else str(register.reset(sensor))
        rows.append(
            [
                offset,
                register.name,
                register.access.name.lower(),
                legal,
                reset,
                _doc(register, sensor),
            ]
        )
        for bits in _bits(register, sensor):
            meaning = f"{bits.doc}{' Write 1 to clear.' if bits.clears else ''}"
            rows.append(["", f"bit {bits.lsb}: {bits.name}", "", "", "", meaning])
    return rows


def _markdown(sensor: Sensor) -> str:
    title, text = _intro(sensor)
    lines = [
        f"# {title}",
        "",
        text,
        "",
        *(f"* {access.name.lower()}: {access.value}" for access in Access),
        "",
    ]
    for title, text, rows in _blocks(sensor):
        escaped = ([cell.replace("|", r"\|") for cell in row] for row in rows)
        lines += [
            f"## {title}",
            "",
            text,
            "",
            *markdown.table(HEAD, escaped, left=range(len(HEAD))),
            "",
        ]
    return "\n".join(lines)


def _html(sensor: Sensor) -> str:
    lines = []
    for title, text, rows in _blocks(sensor):
        lines += [f"<h2>{html.escape(title)}</h2>", f"<p>{html.escape(text)}</p>", "<table>"]
        lines.append("<tr>" + "".join(f"<th>{cell}</th>" for cell in HEAD) + "</tr>")
        lines += [
            "<tr>" + "".join(f"<td>{html.escape(cell)}</td>" for cell in row) + "</tr>"
            for row in rows
        ]
        lines.append("</table>")
    title, text = map(html.escape, _intro(sensor))
    access = (
        f"<dt>{access.name.lower()}</dt><dd>{html.escape(access.value)}</dd>" for access in Access
    )
    _, _, page = PAGE.read_text(encoding="utf-8").partition("\n")  # without the licence
    return Template(page).substitute(
        title=title, text=text, access="\n".join(access), blocks="\n".join(lines)
    )


RDL_FIELD = {  # access of software and hardware to the field of a register
    Access.CONSTANT: "sw = r; hw = na;",
    Access.SETTING: "sw = rw; hw = r;",
    Access.PULSE: "sw = w; hw = r; singlepulse;",
    Access.COUNTER: "sw = r; hw = w;",
}
# bits of the status register
RDL_CLEARED, RDL_STATE = ("sw = rw; onwrite = woclr; hw = w;", "sw = r; hw = w;")


def _systemrdl(sensor: Sensor) -> str:
    title, text = _intro(sensor)
    lines = [
        "addrmap coincid {",
        f'  name = "{title}";',
        f'  desc = "{text}";',
        f"  default regwidth = {DATA_BITS};",
        "  addressing = compact;",
        "",
        *_rdl_block(GLOBAL, sensor, "  "),
        "",
        "  regfile {",
        f'    desc = "Settings and counters of a subgroup.{_while_busy(sensor)}";',
        *_rdl_block(SUBGROUP, sensor, "    "),
        f"  }} subgroup[{sensor.subgroups}] @ {SUBGROUP_BASE:#x} += {SUBGROUP_STRIDE:#x};",
        "};",
        "",
    ]
    return "\n".join(lines)


def _rdl_block(registers: tuple[Register, ...], sensor: Sensor, indent: str) -> list[str]:
    lines = []
    for register in built(registers, sensor):
        reset, doc = register.reset(sensor), _doc(register, sensor)
        if register.access in WRITABLE and not register.bits:
            doc += f" Range: {register.low(sensor)} to {register.high(sensor)}."
        array = f"[{register.count(sensor)}]" if register.count(sensor) > 1 else ""
        lines += [f"{indent}reg {{", f'{indent}  desc = "{doc}";']
        for bits in _bits(register, sensor):
            use = RDL_FIELD.get(register.access, RDL_CLEARED if bits.clears else RDL_STATE)
            value = reset >> bits.lsb & (1 << bits.width) - 1
            where = f"[{bits.lsb + bits.width - 1}:{bits.lsb}]"
            lines.append(
                f'{indent}  field {{ desc = "{bits.doc}"; {use} }} {bits.name}{where} = {value:#x};'
            )
        if not register.bits:
            width = (
                DATA_BITS
                if register.access in (Access.CONSTANT, Access.COUNTER)
                else bits_for(register.high(sensor))
            )
            lines.append(
                f"{indent}  field {{ {RDL_FIELD[register.access]} }} value[{width - 1}:0] = {reset:#x};"
            )
        lines.append(f"{indent}}} {register.name}{array} @ {register.offset:#x};")
    return lines


def _ip_xact(rdl: str) -> str:
    # here, because simulations use this file without the compiler
    from peakrdl_ipxact import IPXACTExporter
    from systemrdl.compiler import RDLCompiler

    with tempfile.TemporaryDirectory(prefix="coincid-") as folder:
        source, target = Path(folder) / RDL, Path(folder) / IP_XACT
        source.write_text(rdl, encoding="utf-8")
        compiler = RDLCompiler()
        compiler.compile_file(str(source))
        IPXACTExporter(vendor="coincid", library="sensor", version="1.0").export(
            compiler.elaborate(), str(target), component_name=TOP
        )
        return target.read_text(encoding="utf-8")


def _header(sensor: Sensor) -> str:
    lines = [
        f"/* {SPDX} */",
        f"/* Registers of the {sensor.rows} x {sensor.cols} sensor: byte addresses, ranges, bits. See {MARKDOWN}. */",
        f"#ifndef {PREFIX}_REGS_H",
        f"#define {PREFIX}_REGS_H",
        "",
        f"#define {PREFIX}_SUBGROUPS {sensor.subgroups}u",
        "",
    ]
    for register in built(GLOBAL, sensor):
        lines += _defines(register, sensor, f"{register.offset:#06x}u", [])
    for register in built(SUBGROUP, sensor):
        lines += _defines(
            register,
            sensor,
            f"{SUBGROUP_BASE + register.offset:#06x}u + {SUBGROUP_STRIDE:#x}u * (sg)",
            ["sg"],
        )
    return "\n".join([*lines, "", f"#endif /* {PREFIX}_REGS_H */", ""])


def _defines(register: Register, sensor: Sensor, address: str, arguments: list[str]) -> list[str]:
    name = f"{PREFIX}_{register.name.upper()}"
    if register.count(sensor) > 1:
        address, arguments = f"{address} + 4u * (i)", [*arguments, "i"]
    macro = f"{name}({', '.join(arguments)})" if arguments else name
    lines = [f"#define {macro} ({address})  /* {_doc(register, sensor)} */"]
    if register.access is Access.CONSTANT:
        lines.append(f"#define {name}_VALUE {register.reset(sensor)}u")
    if register.access is Access.SETTING:
        lines += [
            f"#define {name}_LOWEST {register.low(sensor)}u",
            f"#define {name}_HIGHEST {register.high(sensor)}u",
        ]
    for bits in _bits(register, sensor):
        mask = ((1 << bits.width) - 1) << bits.lsb
        lines.append(f"#define {name}_{bits.name.upper()} {mask:#x}u  /* {bits.doc} */")
    return lines
