# SPDX-License-Identifier: Apache-2.0
"""A dead wire in any file of hdl or board/rtl stops the build, with a message that names the port.

Wires are cut in copies of the sources, one at a time: a port gets another name in its block's own
file, or a connection is left out. The blocks are only elaborated, so a cut takes a fraction of a
second. `CUTS_IN_FILE` of each kind are tried in a file.
"""

import ast
import importlib
import re
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib.abc import MetaPathFinder
from importlib.machinery import SourceFileLoader
from importlib.util import spec_from_file_location
from pathlib import Path

import numpy as np
import pytest
from amaranth.lib.wiring import ConnectionError
from attrs import evolve, frozen

import coincid
from coincid.board.parameters import Emulator
from coincid.model.contract.parameters import Sensor

ROOMS = Path(coincid.__file__).parent
HDL = ROOMS / "hdl"
BOARD = ROOMS / "board" / "rtl"
PACKAGES = ("coincid.hdl", "coincid.board.rtl")
SENSOR = Sensor(
    rows=4,
    cols=8,
    phases=4,
    coarse_bits=4,
    window_max=9,
    rearm=1,
    fifo_depth=2,
    subgroup=(4, 4),
    minigroup=(2, 2),
)
COUNTING = evolve(SENSOR, counts=1)  # every block of the room; the asynchronous view has no counts
PLACING = ("place", "put")  # functions that put a block into another one
CUTS_IN_FILE = 2
pytestmark = pytest.mark.filterwarnings("ignore:.*created but never used")  # of builds that stop
RENAMED = "renamed"  # the new name of a port
PORT = re.compile(r"\b(\w+)=(?:In|Out)\(")
# Ports of the tops, which other blocks do not read.
OUTER = {(BOARD / "top.py", "laser"), (HDL / "sensor.py", "spad_gate")}
OUTSIDE = {BOARD / "ulx3s.py", HDL / "sensor.py"}  # files with such ports only


@frozen
class Cut:
    """A dead wire. source: the file's text with it."""

    file: Path
    port: str
    source: str

    def __str__(self) -> str:
        return f"{self.file.relative_to(ROOMS)}: {self.port}"


def renamed_ports(file: Path) -> Iterator[Cut]:
    """Yield a file with another name for each of its ports, wherever the file uses it."""
    text = file.read_text(encoding="utf-8")
    for port in dict.fromkeys(PORT.findall(text)):
        if file in OUTSIDE or (file, port) in OUTER:
            continue
        declared = rf"(?<=[\s(]){port}(?==(?:In|Out)\()"
        used = rf"(?<=self\.){port}\b"
        source = re.sub(f"{declared}|{used}", RENAMED, text)
        if source != text:
            yield Cut(file, port, source)


def missing_connections(file: Path) -> Iterator[Cut]:
    """Yield a file without each of the connections of the blocks that it places."""
    text = file.read_text(encoding="utf-8")
    lines = text.splitlines(keepends=True)
    for call in ast.walk(ast.parse(text)):
        if not isinstance(call, ast.Call):
            continue
        if not isinstance(call.func, ast.Name) or call.func.id not in PLACING:
            continue
        for word in call.keywords:
            if word.arg in (None, "domain", "platform", "soft_reset"):
                continue
            begin = lines[word.lineno - 1][: word.col_offset]
            end = lines[word.end_lineno - 1][word.end_col_offset :].lstrip(",")
            before = lines[: word.lineno - 1]
            after = lines[word.end_lineno :]
            yield Cut(file, word.arg, "".join([*before, begin + end, *after]))


def missing_interfaces(file: Path) -> Iterator[Cut]:
    """Yield a file without each of its connections of whole interfaces."""
    text = file.read_text(encoding="utf-8")
    for line in re.findall(r"^ +(?:wiring\.)?connect\(.*\)$", text, re.MULTILINE):
        indent = line[: len(line) - len(line.lstrip())]
        yield Cut(file, line.strip(), text.replace(line, f"{indent}pass"))


def missing_outputs(file: Path) -> Iterator[Cut]:
    """Yield a file without each of the lines that pass on another block's output."""
    text = file.read_text(encoding="utf-8")
    for line in re.findall(r"^ +\w+\.\w+\.eq\(\w+\.\w+\),$", text, re.MULTILINE):
        port = line.split(".")[1]
        yield Cut(file, port, text.replace(f"{line}\n", "", 1))


SOURCES = sorted([*HDL.rglob("*.py"), *BOARD.rglob("*.py")])
STRUCTURE = [HDL / name for name in ("subgroup.py", "subgroup_pair.py", "sensor.py")]


def _drawn(kind: Callable[[Path], Iterator[Cut]], files: list[Path]) -> list[Cut]:
    """Return some cuts of a kind in each file, the same in every run."""
    drawn = []
    for file in files:
        cuts = list(kind(file))
        some = min(CUTS_IN_FILE, len(cuts))
        chosen = np.random.default_rng(len(cuts)).choice(len(cuts), some, replace=False)
        drawn += [cuts[k] for k in sorted(chosen)]
    return drawn


RENAMES = _drawn(renamed_ports, SOURCES)
CONNECTIONS = _drawn(missing_connections, SOURCES)
INTERFACES = _drawn(missing_interfaces, SOURCES)
OUTPUTS = _drawn(missing_outputs, STRUCTURE)


class _CutLoader(SourceFileLoader, MetaPathFinder):
    """Loads a cut file instead of the one on the disk."""

    def __init__(self, cut: Cut):
        parts = cut.file.relative_to(ROOMS).with_suffix("").parts
        super().__init__(".".join(["coincid", *parts]), str(cut.file))
        self.cut = cut

    def find_spec(self, fullname, path=None, target=None):
        if fullname == self.name:
            return spec_from_file_location(fullname, self.path, loader=self)
        return None

    def get_code(self, fullname):
        return compile(self.cut.source, self.path, "exec")


@contextmanager
def _fresh_blocks(cut: Cut | None) -> Iterator[None]:
    """Import the blocks again, with a cut; afterwards the modules are those of before."""
    kept = {name: module for name, module in sys.modules.items() if name.startswith(PACKAGES)}
    finders = [] if cut is None else [_CutLoader(cut)]
    for name in kept:
        del sys.modules[name]
    sys.meta_path[:0] = finders
    try:
        yield
    finally:
        for finder in finders:
            sys.meta_path.remove(finder)
        for name in [name for name in sys.modules if name.startswith(PACKAGES)]:
            del sys.modules[name]
        sys.modules.update(kept)
        for package in PACKAGES:
            if package in kept:
                above, _, name = package.rpartition(".")
                setattr(sys.modules[above], name, kept[package])


def build(cut: Cut | None = None) -> int:
    """Elaborate every block, and return how many there are; first the top to which a cut file
    belongs.
    """
    with _fresh_blocks(cut):
        export = importlib.import_module("coincid.hdl.export")
        views = importlib.import_module("coincid.hdl.front_end_views")
        sensor = importlib.import_module("coincid.hdl.sensor")
        pair = importlib.import_module("coincid.hdl.subgroup_pair")
        top = importlib.import_module("coincid.board.rtl.top")
        board = importlib.import_module("coincid.board.rtl.ulx3s")
        emulator = Emulator(sensor=SENSOR)
        tops = {
            "hdl": sensor.SensorTop(COUNTING),
            "silicon": sensor.SensorTop(SENSOR, views.VIEWS["async"]),
            "rtl": top.EmulatorTop(emulator),
            "bus": top.EmulatorTop(emulator, serial=False),
            "fpga": sensor.SensorTop(SENSOR, levels=True),
            "core": sensor.Core(COUNTING),
            "slice": pair.Slice(COUNTING),
            "lights": board.Lights(),
        }
        first = cut.file.parent.name if cut else "hdl"
        units = sorted(tops, key=lambda name: name != first)
        return sum(len(list(export.elaborated([tops[name]]))) for name in units)


def test_the_sources_have_no_dead_wire():
    assert build() > 100


def test_every_file_with_ports_is_cut():
    blocks = [file for file in SOURCES if "(Unit)" in file.read_text(encoding="utf-8")]
    assert len(blocks) > 25
    assert {cut.file for cut in RENAMES} >= set(blocks) - OUTSIDE
    assert {cut.file for cut in CONNECTIONS} >= {*STRUCTURE, HDL / "readout.py"}
    assert len(INTERFACES) > 5 and len(OUTPUTS) > 4


@pytest.mark.parametrize("cut", CONNECTIONS, ids=str)
def test_a_missing_connection_stops_the_build(cut):
    with pytest.raises(ConnectionError, match=rf"nothing drives the input `{cut.port}"):
        build(cut)


@pytest.mark.parametrize("cut", INTERFACES, ids=str)
def test_an_unconnected_interface_stops_the_build(cut):
    with pytest.raises(ConnectionError, match=r"nothing drives"):
        build(cut)


@pytest.mark.parametrize("cut", OUTPUTS, ids=str)
def test_an_output_that_nothing_drives_stops_the_build(cut):
    with pytest.raises(ConnectionError, match=rf"nothing drives .*`{cut.port}"):
        build(cut)


@pytest.mark.parametrize("cut", RENAMES, ids=str)
def test_a_renamed_port_stops_the_build(cut):
    with pytest.raises(
        (ConnectionError, AttributeError, TypeError), match=rf"{RENAMED}|{cut.port}"
    ):
        build(cut)
