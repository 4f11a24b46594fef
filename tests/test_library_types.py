# SPDX-License-Identifier: Apache-2.0
"""The types with which Python calls the functions of a compiled library are those of its C++: a
number that is passed as a shorter one is cut off only when it is large.
"""

import ctypes
import re
from pathlib import Path
from unittest.mock import MagicMock

import pytest

from coincid.board import simulated
from coincid.slices import library, slices
from coincid.tb import sliced

INTEGERS = {
    "int": ctypes.c_int,
    "int64_t": ctypes.c_int64,
    "uint32_t": ctypes.c_uint32,
    "uint64_t": ctypes.c_uint64,
}
POINTERS = (ctypes.c_void_p, ctypes.c_char_p)
FUNCTION = re.compile(r"^([\w :*]+?[ *])(\w+)\(([^)]*)\) \{", re.MULTILINE)


class LoadedError(Exception):
    """A library would be loaded now."""


def loading(monkeypatch, module, made_up, make):
    """Return the table of functions with which a module loads its library; nothing is built."""
    for name in made_up:
        monkeypatch.setattr(module, name, MagicMock())

    def load(_, prefix, functions):
        raise LoadedError(prefix, functions)

    monkeypatch.setattr(module, "load", load)
    with pytest.raises(LoadedError) as found:
        make()
    return found.value.args


def of_lanes(monkeypatch):
    design = MagicMock()
    return loading(monkeypatch, slices, ["library", "Probe"], lambda: slices.Slices(design, 64))


def of_sensors(monkeypatch):
    names = [
        "design",
        "compiled",
        "prove_module",
        "verilated_unit",
        "run_time",
        "objects_in",
        "library",
        "toolchain",
        "wiring_header",
    ]
    monkeypatch.setattr(sliced, "rtl_in_two", lambda sensor: ([], []))
    build = sliced._library.__wrapped__
    return loading(monkeypatch, sliced, names, lambda: build(MagicMock(), 64, Path("none")))


def of_line(monkeypatch):
    return loading(monkeypatch, simulated, [], lambda: simulated._library.__wrapped__(Path("none")))


LIBRARIES = {
    "lanes": (of_lanes, library.PLAIN),
    "sensors": (of_sensors, sliced.SOURCE),
    "line": (of_line, simulated.SOURCE),
}


def declared(source):
    """Return name -> types of the answer and of the arguments of each function for C."""
    text = source.read_text(encoding="utf-8").split('extern "C" {')[1]
    found = {}
    for answer, name, arguments in FUNCTION.findall(text):
        each = [argument.rpartition(" ") for argument in arguments.split(",") if argument.strip()]
        types = [before + "*" * last.count("*") for before, _, last in each]
        found[name] = (answer, types)
    return found


def fits(python, declared_type):
    """Return whether a type of Python stands for one of C++."""
    kind = re.sub(r"\bconst\b|\s", "", declared_type)
    if kind == "void":
        return python is None
    if kind in INTEGERS:
        return python is INTEGERS[kind]
    return kind.endswith("*") and (python in POINTERS or issubclass(python, ctypes._Pointer))


@pytest.mark.parametrize("name", LIBRARIES)
def test_types_of_python_are_those_of_the_library(name, monkeypatch):
    captured, source = LIBRARIES[name]
    prefix, functions = captured(monkeypatch)
    found = declared(source)
    assert len(functions) > 5
    for function, (answer, arguments) in functions.items():
        declared_answer, declared_arguments = found[f"{prefix}_{function}"]
        assert fits(answer, declared_answer), function
        assert len(arguments) == len(declared_arguments), function
        for k, (python, declared_type) in enumerate(
            zip(arguments, declared_arguments, strict=True)
        ):
            assert fits(python, declared_type), f"{function}, argument {k}: {declared_type}"
