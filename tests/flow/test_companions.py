# SPDX-License-Identifier: Apache-2.0
"""Register descriptions of an export, read by other people's tools, and held against the registers
of the RTL: reset values, ranges, what a write does.
"""

import json
import re
import subprocess
from html.parser import HTMLParser
from string import Template

import pytest
from attrs import frozen
from peakrdl_ipxact import IPXACTImporter
from systemrdl import RDLCompiler
from systemrdl.node import RegfileNode, RegNode

from coincid.flow.register_files import HEADER, HTML, IP_XACT, JSON, MARKDOWN, RDL, register_files
from coincid.host.transport import RefusedError
from coincid.model.contract.parameters import Sensor
from coincid.model.contract.registers import control
from coincid.tb.sliced import SlicedSensor

from .. import random_cases
from ..random_cases import built_sensor

SENSOR = built_sensor(random_cases.SENSORS["odd"])  # which other tests build, too
LAST = SENSOR.subgroups - 1
WORD_MAX = (1 << 32) - 1
BLOCK = re.compile(r"At (0x\w+) \+ (0x\w+) \* s")
RANGE = re.compile(r"Range: (\d+) to (\d+)\.")


@frozen(kw_only=True)
class Described:
    """What a description says of a register, or of the last one of an array.

    reset: None where nothing is said. span: the lowest and the highest value that a write may
    have; None: it is read-only. cleared: bits that a write of 1 clears; state: bits that a write
    leaves alone; pulse: bits that act, and read as 0.
    """

    address: int
    reset: int | None = None
    span: tuple[int, int] | None = None
    cleared: int = 0
    state: int = 0
    pulse: int = 0


@pytest.fixture(scope="module")
def files():
    return register_files(SENSOR)


@pytest.fixture(scope="module")
def rtl():
    with SlicedSensor(SENSOR) as sensor:
        yield sensor


def by_rdl(files, folder):
    """Return what SystemRDL's compiler finds."""
    (folder / RDL).write_text(files[RDL], encoding="utf-8")
    compiler = RDLCompiler()
    compiler.compile_file(str(folder / RDL))
    return _of_compiler(compiler)


def by_ip_xact(files, folder):
    """Return what PeakRDL's importer finds in the IP-XACT."""
    (folder / IP_XACT).write_text(files[IP_XACT], encoding="utf-8")
    compiler = RDLCompiler()
    IPXACTImporter(compiler).import_file(str(folder / IP_XACT))
    return _of_compiler(compiler)


def _of_compiler(compiler):
    found = {}
    for node in compiler.elaborate().descendants(unroll=True):
        if isinstance(node, RegNode):
            found[node.inst_name] = _of_node(node)  # the last one of an array stays
    return found


def _of_node(node):
    cleared = state = pulse = reset = 0
    writable = []
    for field in node.fields():
        mask = ((1 << field.width) - 1) << field.low
        reset |= field.get_property("reset", default=0) << field.low
        clears = field.get_property("onwrite") is not None
        if clears:
            assert field.get_property("onwrite").name == "woclr"
            cleared |= mask
        elif field.is_sw_writable and not field.is_sw_readable:
            pulse |= mask
        elif field.is_sw_writable:
            writable.append(field)
        elif node.has_sw_writable:
            state |= mask
    span = None
    if writable:
        told = RANGE.search(node.get_property("desc"))
        highest = sum((1 << field.width) - 1 << field.low for field in writable)
        span = (int(told[1]), int(told[2])) if told else (0, highest)
    counter = any(field.is_hw_writable for field in node.fields())
    return Described(
        address=node.absolute_address,
        reset=None if counter and not node.has_sw_writable else reset,
        span=span,
        cleared=cleared,
        state=state,
        pulse=pulse,
    )


class Tables(HTMLParser):
    """The cells of all tables of a page, and the address before each row of a block."""

    def __init__(self):
        super().__init__()
        self.rows = []
        self.block = self.stride = 0
        self._tag = ""

    def handle_starttag(self, tag, attributes):
        self._tag = tag
        if tag == "tr":
            self.rows.append([])
        elif tag == "td":
            self.rows[-1].append("")

    def handle_endtag(self, tag):
        self._tag = ""

    def handle_data(self, data):
        if self._tag == "td":
            self.rows[-1][-1] += data
        elif self._tag == "p" and (at := BLOCK.match(data)):
            self.rows.append([at[1], at[2]])


def by_page(files, folder):
    """Return what the table of the HTML says."""
    tables = Tables()
    tables.feed(files[HTML])
    return _of_rows(tables.rows)


def by_markdown(files, folder):
    """Return what the table of the Markdown says."""
    rows = []
    for line in files[MARKDOWN].splitlines():
        if at := BLOCK.match(line):
            rows.append([at[1], at[2]])
        elif line.startswith("| ") and "---" not in line and not line.startswith("| offset"):
            rows.append([cell.strip() for cell in line[1:-1].split(" | ")])
    return _of_rows(rows)


def _of_rows(rows):
    """Return what the rows of the tables say. A row of two cells has the place of the registers
    behind it.
    """
    base, found, register = 0, {}, None
    for row in rows:
        if len(row) == 2:
            base = int(row[0], 16) + LAST * int(row[1], 16)
        if len(row) != 6:
            continue
        where, name, access, span, reset, meaning = row
        if where:
            offset, *array = where.split(" + 4 i, i < ")
            address_there = base + int(offset, 16) + (4 * (int(array[0]) - 1) if array else 0)
            register = name
            found[register] = {"address": address_there, "reset": int(reset) if reset else None}
            if access == "setting":
                low, high = span.split(" to ")
                found[register]["span"] = int(low), int(high)
            found[register]["access"] = access
            continue
        access, mask = found[register]["access"], 1 << int(re.match(r"bit (\d+):", name)[1])
        kind = "cleared" if "Write 1 to clear." in meaning else "state"
        if access == "pulse":
            kind = "pulse"
        if access != "setting":
            found[register][kind] = found[register].get(kind, 0) | mask
    for said in found.values():
        del said["access"]
    return {name: Described(**said) for name, said in found.items()}


def by_json(files, folder):
    """Return what the JSON says."""
    said, found = json.loads(files[JSON]), {}
    bases = {"global": 0, "subgroup": said["subgroup_base"] + LAST * said["subgroup_stride"]}
    for block, base in bases.items():
        for one in said[block]:
            bits = one.get("bits", ())
            clears = sum(1 << bit["lsb"] for bit in bits if bit["clears"])
            others = sum(1 << bit["lsb"] for bit in bits if not bit["clears"])
            access = one["access"]
            found[one["name"]] = Described(
                address=base + one["offset"] + 4 * (one["count"] - 1),
                reset=None if access == "counter" else one["reset"],
                span=(one["low"], one["high"]) if access == "setting" else None,
                cleared=clears,
                state=others if access == "status" else 0,
                pulse=others if access == "pulse" else 0,
            )
    return found


MACRO = re.compile(r"^#define COINCID_(\w+?)(?:\(([a-z, ]+)\))? ", re.MULTILINE)


def by_c_compiler(files, folder):
    """Return what a C program prints of the header: addresses, constants and ranges.

    Indices are sums, and addresses are factors, so that brackets which are missing matter.
    """
    counts = {one["name"].upper(): one["count"] for one in _registers(files)}
    lines = []
    for name, arguments in MACRO.findall(files[HEADER]):
        register, _, what = name.rpartition("_")
        if name in counts:
            values = {"sg": LAST, "i": counts[name] - 1}
            given = ", ".join(f"0u + {values[one]}u" for one in arguments.split(", ") if one)
            lines.append(f'PRINT("{name}", COINCID_{name}{f"({given})" if given else ""})')
        elif register in counts and what in ("VALUE", "LOWEST", "HIGHEST"):
            lines.append(f'PRINT("{name}", COINCID_{name})')
    program = Template(PROGRAM).substitute(header=HEADER, lines="\n".join(lines))
    (folder / HEADER).write_text(files[HEADER], encoding="utf-8")
    (folder / "print.c").write_text(program, encoding="utf-8")
    subprocess.run(["cc", "-o", "print", "print.c"], cwd=folder, check=True)
    printed = subprocess.run([folder / "print"], capture_output=True, encoding="ascii", check=True)
    values = {name: int(value) for name, value in map(str.split, printed.stdout.splitlines())}
    found = {}
    for name in counts:
        lowest, highest = values.get(f"{name}_LOWEST"), values.get(f"{name}_HIGHEST")
        found[name.lower()] = Described(
            address=values[name],
            reset=values.get(f"{name}_VALUE"),
            span=None if highest is None else (lowest, highest),
        )
    return found


PROGRAM = """#include <stdio.h>
#include "$header"
#define PRINT(name, value) printf("%s %u\\n", name, 1u * value);
int main(void) {
$lines
return 0;
}
"""


def _registers(files):
    said = json.loads(files[JSON])
    return [*said["global"], *said["subgroup"]]


@pytest.mark.parametrize("file", (MARKDOWN, HTML, RDL, IP_XACT))
@pytest.mark.parametrize("held", (0, 1))
def test_pages_tell_that_settings_of_a_subgroup_are_not_held(file, held):
    """Then a write while busy is refused, and others take effect at once."""
    text = register_files(Sensor(held=held))[file]
    assert ("while busy is refused" in text) == (not held)


@pytest.mark.parametrize("file", (MARKDOWN, HTML, HEADER, JSON, RDL, IP_XACT))
@pytest.mark.parametrize("built", (0, 1))
def test_only_formats_and_modes_that_are_built_are_described(file, built):
    """The sensor refuses the others."""
    text = register_files(Sensor(offsets=built, counts=built, controller=built))[file]
    for told in ("2 full", "4 compact-full", "5 counts", "the controller sets the threshold"):
        assert (told in text) == bool(built), told
    assert ("Other numbers are refused." in text) == (not built)
    assert "1 id (map)" in text and "3 compact (id in groups)" in text


READERS = {
    IP_XACT: by_ip_xact,
    HTML: by_page,
    MARKDOWN: by_markdown,
    JSON: by_json,
    HEADER: by_c_compiler,
}


@pytest.fixture(scope="module")
def described(files, tmp_path_factory):
    """What the SystemRDL says, which the tests hold against the RTL."""
    return by_rdl(files, tmp_path_factory.mktemp("rdl"))


@pytest.mark.parametrize("file", READERS)
def test_descriptions_agree(files, described, tmp_path, file):
    """The header in C does not tell what a write to a bit does; some resets are not told."""
    other = READERS[file](files, tmp_path)
    assert other.keys() == described.keys()
    for name, said in described.items():
        found = other[name]
        assert (found.address, found.span) == (said.address, said.span), name
        assert found.reset in (None, said.reset), name
        if file != HEADER:
            of_bits = found.cleared, found.state, found.pulse
            assert of_bits == (said.cleared, said.state, said.pulse), name


def test_sizes_of_the_map_are_those_of_the_sensor(files, tmp_path):
    """Of words, addresses and subgroups, for programs that read the JSON or the header."""
    said = json.loads(files[JSON])
    (tmp_path / RDL).write_text(files[RDL], encoding="utf-8")
    compiler = RDLCompiler()
    compiler.compile_file(str(tmp_path / RDL))
    nodes = list(compiler.elaborate().descendants(unroll=True))
    registers = [node for node in nodes if isinstance(node, RegNode)]
    blocks = [node for node in nodes if isinstance(node, RegfileNode)]
    assert said["subgroups"] == len(blocks) == SENSOR.subgroups
    assert f"#define COINCID_SUBGROUPS {len(blocks)}u\n" in files[HEADER]
    first, second, *_ = (block.absolute_address for block in blocks)
    assert (said["subgroup_base"], said["subgroup_stride"]) == (first, second - first)
    assert {node.get_property("regwidth") for node in registers} == {said["data_bits"]}
    last = max(node.absolute_address for node in registers)
    assert last < 1 << said["address_bits"] <= 1 << 32


def test_masks_of_the_header_are_the_bits_of_the_registers(files):
    """Each with its meaning; no two bits of a register overlap."""
    found = re.findall(r"^#define COINCID_(\w+) (0x\w+)u  /\* (.*) \*/$", files[HEADER], re.M)
    masks = {name: (int(mask, 16), doc) for name, mask, doc in found}
    expected = {}
    for one in _registers(files):
        taken = 0
        for bits in one.get("bits", ()):
            mask = sum(1 << bits["lsb"] + k for k in range(bits["width"]))
            assert not taken & mask
            taken |= mask
            expected[f"{one['name']}_{bits['name']}".upper()] = mask, bits["doc"]
    assert masks == expected and len(masks) > 10


def refused(rtl, where, value):
    """Return whether the RTL refuses a write."""
    try:
        rtl.write(where, value)
    except RefusedError:
        return True
    return False


def test_registers_behave_as_described(rtl, described):
    """Reset values, the ends of ranges and what lies beyond them, and what is read-only."""
    rtl.reset()
    for name, said in described.items():
        if said.reset is not None:
            assert rtl.read(said.address) == said.reset, name
    for name, said in described.items():
        if said.span is None and not said.cleared and not said.pulse:
            value = rtl.read(said.address)
            assert refused(rtl, said.address, value ^ 1), name
            assert rtl.read(said.address) == value, name
        if said.span is None:
            continue
        low, high = said.span
        for legal in (high, low):
            rtl.write(said.address, legal)
            assert rtl.read(said.address) == legal, name
        assert low == 0 or refused(rtl, said.address, low - 1), name
        assert high == WORD_MAX or refused(rtl, said.address, high + 1), name
        assert rtl.read(said.address) == low, name


def test_bits_clear_and_act_as_described(rtl, described):
    """A write of 1 clears a bit that is described so, and no other one; a state bit stays."""
    status, commands = described["status"], described["control"]
    rtl.reset()
    period = described["period"]
    assert refused(rtl, period.address, 0) and refused(rtl, described["id"].address, 0)
    rtl.write(period.address, period.span[0])
    assert refused(rtl, *control("start"))
    provoked = rtl.read(status.address)
    assert provoked.bit_count() == 3 and not provoked & ~status.cleared
    rtl.write(status.address, 0)
    rtl.write(status.address, WORD_MAX & ~provoked)
    assert rtl.read(status.address) == provoked
    for bit in (1 << k for k in range(32) if provoked >> k & 1):
        rtl.write(status.address, bit)
        provoked &= ~bit
        assert rtl.read(status.address) == provoked
    assert status.state and not status.state & status.cleared
    for name in ("start", "abort", "reset"):
        assert commands.pulse & control(name)[1]
    rtl.write(commands.address, control("abort")[1])
    assert rtl.read(commands.address) == 0
