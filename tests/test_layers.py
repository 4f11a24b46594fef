# SPDX-License-Identifier: Apache-2.0
"""The layers: permitted imports, and no cycle between files. All import lines are read, also lazy
ones inside functions.
"""

import ast
import re
import subprocess
import sys
from functools import cache
from graphlib import TopologicalSorter
from importlib.util import resolve_name
from pathlib import Path

import pytest

import coincid
from coincid.model.shared.sources import package_files, room_files

STUDIES = "docs.studies"  # the one room outside the package `coincid`
NOT_ROOMS = ("tests", "examples", "docs")  # nothing imports from these
OF_RTL = ("numba", "scipy", "matplotlib", "cocotb", "coincid.model.golden")
OF_HOST = ("amaranth", "cocotb", "serial", "matplotlib", "coincid.hdl", "coincid.tb")
NEVER = {  # room, or module: packages that it must not even load
    "board.driver": OF_HOST,
    "board.rtl": OF_RTL,
    "board.serial_transport": OF_HOST,
    "board.source_model": ("amaranth", "cocotb", "matplotlib", "coincid.hdl", "coincid.tb"),
    "hdl": OF_RTL,
    "host": OF_HOST,
    "lab": ("matplotlib", "bokeh"),
    "model": ("amaranth", "cocotb", "matplotlib", "coincid.hdl", "coincid.tb"),
}
OPTIONAL = ("mitsuba", "mitransient", "drjit")  # of the extra `raytrace`


@cache
def rooms() -> dict[str, list[str]]:
    """Return README's table: room -> the rooms from which its files may import, in addition to its
    own.
    """
    text = (Path(__file__).parents[1] / "README.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| `([\w/]+)/` \|.*\|([^|]*)\|$", text, re.MULTILINE)
    found = {
        room: re.findall(r"`([\w/]+)`", named) for room, named in rows if room not in NOT_ROOMS
    }
    return {
        room.replace("/", "."): [name.replace("/", ".") for name in named]
        for room, named in found.items()
    }


def package_of(room: str) -> str:
    """Return the package that a room is."""
    return room if room == STUDIES else f"coincid.{room}"


def module_name(path: Path, package: str) -> str:
    """Return the dotted name of a file of a package."""
    inside = path.with_suffix("").parts[-1 - path.parts[::-1].index(package.split(".")[-1]) :][1:]
    return ".".join([package, *(part for part in inside if part != "__init__")])


@cache
def files() -> dict[str, Path]:
    """Return module -> file, for all rooms."""
    top = dict.fromkeys(room if room == STUDIES else room.partition(".")[0] for room in rooms())
    found = {}
    for package in map(package_of, top):
        for path in package_files(package):
            if path.suffix == ".py":
                found[module_name(path, package)] = path
    return found


@cache
def imports() -> dict[str, set[str]]:
    """Return module -> modules of the project that it imports, for all rooms."""
    found: dict[str, set[str]] = {}
    for name, path in files().items():
        package, found[name] = name if path.stem == "__init__" else name.rpartition(".")[0], set()
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ImportFrom):
                base = resolve_name("." * node.level + (node.module or ""), package)
                inner = {alias.name: f"{base}.{alias.name}" for alias in node.names}
                found[name] |= {
                    inner[alias] if inner[alias] in files() else base for alias in inner
                }
            elif isinstance(node, ast.Import):
                found[name] |= {alias.name for alias in node.names}
        found[name] = (found[name] & files().keys()) - {name}
    return found


def inside(module: str, room: str) -> bool:
    package = package_of(room)
    return module == package or module.startswith(f"{package}.")


@pytest.mark.parametrize("room", rooms())
def test_rooms_import_only_what_readme_names(room):
    allowed, above = (room, *rooms()[room]), list(rooms())[: list(rooms()).index(room)]
    assert all(any(inside(package_of(one), other) for one in above) for other in rooms()[room])
    members = {module: targets for module, targets in imports().items() if inside(module, room)}
    assert len(members) > 1
    for module, targets in members.items():
        assert not [
            target for target in targets if not any(inside(target, other) for other in allowed)
        ], module


def test_every_file_is_in_a_room():
    homeless = {module for module in imports() if not any(inside(module, room) for room in rooms())}
    assert homeless <= {"coincid.model"}


def test_only_the_command_knows_the_board():
    """The board's room is an application: it uses the others, which neither import nor name it."""
    knowing = {
        module
        for module, targets in imports().items()
        if any(inside(target, "board") for target in targets)
    }
    assert len(knowing) > 10
    assert not [module for module in knowing if not inside(module, "board")]
    others = {room.partition(".")[0] for room in rooms() if room not in ("board", STUDIES)}
    files = [path for path in room_files(*others) if path.suffix == ".py"]
    files.append(Path(coincid.__file__))
    named = re.compile(r"coincid\.board[. ]|\bboard/")
    assert not [path for path in files if named.search(path.read_text(encoding="utf-8"))]


def test_no_cycle_between_files():
    list(TopologicalSorter(imports()).static_order())


@pytest.mark.parametrize("room", NEVER)
def test_rooms_do_not_load(room):
    """Import a whole room in a fresh process: then everything that it needs is loaded, and nothing
    else.
    """
    program = f"""
import importlib, sys
for name in sys.argv[1:]:
    try:
        importlib.import_module(name)
    except ModuleNotFoundError as missing:
        assert missing.name in {OPTIONAL!r}, missing
print([name for name in {NEVER[room]!r} if name in sys.modules])
"""
    modules = [module for module in imports() if inside(module, room)]
    done = subprocess.run(
        [sys.executable, "-c", program, *modules],
        capture_output=True,
        text=True,
        check=True,
        encoding="utf-8",
    )
    assert done.stdout.strip() == "[]"


def test_kernels_take_in_only_what_renews_their_compiled_code():
    """`compiled.py` names compiled code by a digest of the kernel's own room, the contract and
    `model.shared`.
    """
    holders = {
        module
        for module, targets in imports().items()
        if "coincid.model.shared.compiled" in targets
    }
    assert len(holders) > 5
    for module in holders:
        renew = (
            module.removeprefix("coincid.").rpartition(".")[0],
            "model.contract",
            "model.shared",
        )
        targets = imports()[module] & holders
        assert not [
            target for target in targets if not any(inside(target, room) for room in renew)
        ], module
