# SPDX-License-Identifier: Apache-2.0
"""Views of a waveform: reads the hierarchy of an FST file, and writes block-by-block views for GTKWave and Surfer."""

import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import TypeAlias

from attrs import frozen

from ..model.contract.parameters import TOP
from ..model.shared.files import whole_file

HIERARCHY, HIERARCHY_LZ4, HIERARCHY_LZ4_TWICE = 4, 6, 7  # block types of the FST format
SCOPE, UPSCOPE, ATTRIBUTE, END_ATTRIBUTE = 254, 255, 252, 253  # tags of the hierarchy; lower ones are variables

# Signals worth seeing in each block, in the order of a photon's path; names are those of the Verilog.
Block: TypeAlias = tuple[str, str, tuple[str, ...]]  # title, scope below the top, signals
BLOCKS: tuple[Block, ...] = (
    (
        "sensor",
        "",
        ("clk", "rst", "laser", "spad_gate", "m_axis_tvalid", "m_axis_tready", "m_axis_tlast", "m_axis_tdata"),
    ),
    (
        "registers",
        "registers",
        ("s_axi__awvalid", "s_axi__awaddr", "s_axi__wdata", "s_axi__bvalid", "s_axi__bresp", "start_frame", "done"),
    ),
    ("sequencer", "sequencer", ("frame_begin", "timing", "finish", "number", "done")),
    ("subgroup 0: edges", "module_0.subgroup_0", ("words",)),
    ("subgroup 0: gate", "module_0.subgroup_0.gating", ("accept", "spad_gate")),
    (
        "subgroup 0: tree",
        "module_0.subgroup_0.tree",
        (
            "line__root",
            "line__any",
            "line__phase",
            "line__coarse",
            "opening",
            "window_open",
            "left",
            "closing",
            "blind",
            "hits",
            "closed",
        ),
    ),
    ("TDC of module 0", "module_0.tdc", ("start", "coarse")),
    (
        "subgroup 0: DPCU",
        "module_0.subgroup_0.dpcu",
        ("window_ticks", "threshold", "closed", "enough", "commit", "pulse", "photons"),
    ),
    ("subgroup 0: FIFO", "module_0.subgroup_0.fifo", ("stored", "dropped", "level", "take")),
    ("subgroup 0: packets", "module_0.subgroup_0.packetizer", ("grant", "valid", "beat")),
    ("readout 0", "readout_0", ("stored", "grant", "valid", "beat", "space")),
    ("controller 0", "controller_0", ("total", "more", "done", "budget")),
)


@frozen
class Variable:
    """A variable of a waveform: `path` with its scopes, as viewers name it (a vector ends with its range), and width."""

    path: str
    width: int

    @property
    def name(self) -> str:
        """The path without a range."""
        return self.path.partition("[")[0].rstrip()


Group: TypeAlias = tuple[str, list[Variable]]  # title, the signals of it that are in the waveform


def hierarchy(fst: Path) -> list[Variable]:
    """Return all variables of an FST file, in its order. Raises `ValueError` if it has no hierarchy."""
    with open(fst, "rb") as file:
        while header := file.read(9):
            kind, length = header[0], int.from_bytes(header[1:], "big") - 8
            if kind in (HIERARCHY, HIERARCHY_LZ4, HIERARCHY_LZ4_TWICE):
                return list(_variables(_unpacked(kind, file.read(length))))
            file.seek(length, 1)
    raise ValueError(f"{fst}: has no hierarchy: the simulation did not end properly, or this is not an FST file")


def _unpacked(kind: int, block: bytes) -> bytes:
    if kind == HIERARCHY:
        return zlib.decompress(block[8:], wbits=31)
    if kind == HIERARCHY_LZ4:
        return _lz4(block[8:])
    return _lz4(_lz4(block[16:]))


def _lz4(block: bytes) -> bytes:
    """Return a decompressed LZ4 block: runs of literals, each followed by a copy of earlier bytes."""
    out, at = bytearray(), 0

    def length(nibble: int) -> int:
        """Return the length of a run: 15 continues in the next byte, and each 255 in the byte after it."""
        nonlocal at
        total, more = nibble, nibble == 15
        while more:
            total += block[at]
            more = block[at] == 255
            at += 1
        return total

    while at < len(block):
        token = block[at]
        at += 1
        literals = length(token >> 4)
        out += block[at : at + literals]
        at += literals
        if at >= len(block):  # the last run has no copy
            break
        distance = block[at] | block[at + 1] << 8
        at += 2
        count = length(token & 15) + 4
        start = len(out) - distance
        if not 0 <= start < len(out):
            raise ValueError("damaged LZ4 block")
        while count > 0:  # a copy may overlap itself
            piece = out[start : start + min(count, len(out) - start)]
            out += piece
            start += len(piece)
            count -= len(piece)
    return bytes(out)


def _variables(text: bytes) -> Iterator[Variable]:
    scopes, at = [], 0

    def string() -> str:
        nonlocal at
        end = text.index(0, at)
        value = text[at:end].decode(errors="replace")
        at = end + 1
        return value

    def number() -> int:
        nonlocal at
        value = shift = 0
        while True:
            byte = text[at]
            at += 1
            value |= (byte & 127) << shift
            shift += 7
            if byte < 128:
                return value

    while at < len(text):
        tag = text[at]
        at += 1
        if tag == SCOPE:
            at += 1
            scopes.append(string())
            string()
        elif tag == UPSCOPE:
            scopes.pop()
        elif tag == ATTRIBUTE:
            at += 2
            string()
            number()
        elif tag != END_ATTRIBUTE:
            at += 1
            name, width = string(), number()
            number()
            yield Variable(".".join([*scopes, name]), width)


def views(fst: Path, blocks: tuple[Block, ...] = BLOCKS) -> list[Path]:
    """Write views of `fst` beside it, for GTKWave (.gtkw) and Surfer (.sucl), and return their paths.

    Signals that are not in the waveform (because the sensor lacks the block) are left out.
    """
    known: dict[str, Variable] = {}
    for variable in hierarchy(fst):
        known.setdefault(_below_top(variable.name), variable)
    groups = []
    for title, scope, names in blocks:
        found = [known[path] for path in (f"{scope}.{name}".lstrip(".") for name in names) if path in known]
        if found:
            groups.append((title, found))
    written = []
    for suffix, text in ((".gtkw", _gtkwave(fst, groups)), (".sucl", _surfer(groups))):
        written.append(fst.with_suffix(suffix))
        with whole_file(written[-1], "w") as file:
            file.write(text)
    return written


def _below_top(path: str) -> str:
    """Return the path below the top module, in whatever scope a simulator puts the top."""
    return path.partition(f"{TOP}.")[2]


def _gtkwave(fst: Path, groups: list[Group]) -> str:
    lines = [f'[dumpfile] "{fst.name}"', "[timestart] 0"]
    for title, variables in groups:
        lines += ["@200", f"-{title}"]
        for variable in variables:
            lines += ["@22" if variable.width > 1 else "@28", variable.path.replace(" [", "[")]
    return "\n".join(lines) + "\n"


def _surfer(groups: list[Group]) -> str:
    lines = []
    for title, variables in groups:
        lines.append("divider_add " + title.replace(" ", "_"))  # the command takes only one word
        lines += [f"variable_add {variable.name}" for variable in variables]
    return "\n".join([*lines, "zoom_fit"]) + "\n"
