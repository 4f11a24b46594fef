# SPDX-License-Identifier: Apache-2.0
"""Names say what they hold. So a quantity must not go to a name of another unit, and an argument
must not go to a parameter while another of the same call has its name.
"""

import ast
import re
from collections import defaultdict
from collections.abc import Iterable, Iterator
from itertools import pairwise

from .checkout import package_sources

UNITS = (
    "m mm um nm m2 ps ns us ms s hz khz mhz ghz cps gbps baud klux lux w mw j nj v mv ff rad deg"
    " bits bytes words beats ticks cycles pulses frames windows lines events photons pixels rows cols"
    " percent share"
).split()
UNIT = re.compile(rf"_({'|'.join(UNITS)})$")
SWAPPED = {  # (file, function, parameter): why another name goes there
    ("cli.py", "_writable", "folder"): "the folder is the path",
    (
        "model/depth/intensity.py",
        "_Subgroup",
        "frame_pulses",
    ): "the turns of a gate are those of the whole frame",
    ("model/depth/peaks.py", "_filter", "pulse"): "the pulse is known from its hits",
    (
        "model/depth/refine.py",
        "seen_at",
        "slope_down",
    ): "a plane names its slopes by where they lead",
    (
        "model/depth/refine.py",
        "seen_at",
        "slope_right",
    ): "a plane names its slopes by where they lead",
    ("model/recorded/exchange.py", "since_sync", "sync_time"): "the times of some",
    ("model/recorded/photon_hdf5.py", "since_sync", "sync_time"): "the times of some",
    ("model/recorded/ptu.py", "since_sync", "sync_time"): "the times of some",
    ("study/show/report.py", "_first_pulses", "kept"): "the pulses that a page shows are kept",
}
MIXED = {  # (file, name, other name): why they have two units
    (
        "model/contract/parameters.py",
        "record_stamp_bits",
        "minigroup_pixels",
    ): "one bit of each pixel",
}
Pair = tuple[str, str]


def name_of(node: ast.expr) -> str:
    """Return the last name of what an expression is, "" if it has none."""
    match node:
        case ast.Name(name) | ast.Attribute(attr=name):
            return name
        case ast.Subscript(slice=ast.Constant(str(name))):
            return name
        case ast.Subscript(value=inner) | ast.Call(func=inner):
            return name_of(inner)
    return ""


def signatures(trees: Iterable[ast.Module]) -> dict[str, list[list[str]]]:
    """Return the names of parameters of all functions and classes of a name."""
    found = defaultdict(list)
    for node in (node for tree in trees for node in ast.walk(tree)):
        match node:
            case ast.FunctionDef(name, arguments):
                positional = [each.arg for each in [*arguments.posonlyargs, *arguments.args]]
                parameters = [each.arg for each in arguments.kwonlyargs]
                found[name].append([*positional, *parameters])
            case ast.ClassDef(name, body=parts):
                fields = [
                    part.target.id
                    for part in parts
                    if isinstance(part, ast.AnnAssign) and isinstance(part.target, ast.Name)
                ]
                found[name].append(fields)
    return {
        name: [those[1:] if those[:1] in (["self"], ["cls"]) else those for those in of_name]
        for name, of_name in found.items()
    }


def given(call: ast.Call, parameters: list[str]) -> dict[str, str]:
    """Return the name of what a call gives to each parameter."""
    plain = []
    for argument in call.args:
        if isinstance(argument, ast.Starred):
            break
        plain.append(name_of(argument))
    named = {each.arg: name_of(each.value) for each in call.keywords if each.arg}
    return dict(zip(parameters, plain, strict=False)) | named


def exchanged(call: ast.Call, parameters: list[str]) -> set[str]:
    """Return the parameters that are given the name of another one, which is given their name or
    the same.
    """
    names = given(call, parameters)
    return {
        parameter
        for parameter, name in names.items()
        if name != parameter and name in parameters and names.get(name) in (parameter, name)
    }


def meetings(node: ast.AST) -> Iterator[Pair]:
    """Yield the names of quantities that must have one unit: what is assigned, returned, passed by
    name, added or compared.
    """
    match node:
        case ast.keyword(str(name), value):
            yield name, name_of(value)
        case ast.Assign(targets, value):
            yield from ((name_of(target), name_of(value)) for target in targets)
        case ast.AnnAssign(target, value=ast.expr() as value):
            yield name_of(target), name_of(value)
        case ast.FunctionDef(name):
            returns = (each for each in ast.walk(node) if isinstance(each, ast.Return))
            yield from ((name, name_of(each.value)) for each in returns if each.value)
        case ast.BinOp(left, ast.Add() | ast.Sub(), right):
            yield name_of(left), name_of(right)
        case ast.Compare(left, _, others):
            yield from pairwise(map(name_of, [left, *others]))
        case ast.Dict(keys, values):
            texts = (key.value if isinstance(key, ast.Constant) else "" for key in keys)
            yield from zip(map(str, texts), map(name_of, values), strict=True)


def mixed(tree: ast.Module, known: dict[str, list[list[str]]]) -> set[Pair]:
    """Return the pairs of names of a module that meet, and have different units."""
    pairs = [pair for node in ast.walk(tree) for pair in meetings(node)]
    for call in (node for node in ast.walk(tree) if isinstance(node, ast.Call)):
        candidates = [
            set(given(call, those).items()) for those in known.get(name_of(call.func), [])
        ]
        if candidates:
            pairs += set.intersection(*candidates)
    return {
        (one, other)
        for one, other in pairs
        if (unit := UNIT.search(one)) and (its := UNIT.search(other)) and unit[1] != its[1]
    }


def swapped(tree: ast.Module, known: dict[str, list[list[str]]]) -> set[Pair]:
    """Return functions that a module calls with exchanged arguments, and such a parameter."""
    found = set()
    for call in (node for node in ast.walk(tree) if isinstance(node, ast.Call)):
        name = name_of(call.func)
        candidates = [exchanged(call, those) for those in known.get(name, [])]
        if candidates:
            found |= {(name, parameter) for parameter in set.intersection(*candidates)}
    return found


def test_a_quantity_goes_to_names_of_its_own_unit_and_arguments_to_their_own_parameters():
    trees = {file: ast.parse(text) for file, text in package_sources()}
    known = signatures(trees.values())
    met = {(file, *pair) for file, tree in trees.items() for pair in mixed(tree, known)}
    assert met == MIXED.keys()
    found = {(file, *pair) for file, tree in trees.items() for pair in swapped(tree, known)}
    assert found == SWAPPED.keys()


def test_mixed_units_are_found():
    tree = ast.parse("""
def far_m(first_mm, light):
    last_m = light.far_mm
    near(gate_ns=light.gate_ps, gate_cycles=light.begin_cycles, more=last_m)
    near(light.wide_ticks, 1)
    if {"wide_cps": light.rate_cps, "one_cps": light["one_klux"]} and last_m < 3 < light.all_m2:
        return first_mm
    return last_m + light.begin_s - light.x

def near(gate_ns, gate_cycles, more): ...
""")
    assert mixed(tree, signatures([tree])) == {
        ("last_m", "far_mm"),
        ("gate_ns", "gate_ps"),
        ("gate_ns", "wide_ticks"),
        ("one_cps", "one_klux"),
        ("far_m", "first_mm"),
        ("last_m", "begin_s"),
    }


def test_exchanged_arguments_are_found():
    tree = ast.parse("""
def place(row, col, *, light=1): ...

class Box:
    rows: int
    cols: int

    def put(self, rows, cols): ...

place(col, row)
place(it.row, col=it.col, light=it.row)
place(row, row)
Box(cols=it.rows, rows=it.cols)
Box(1, 1).put(cols, sum(rows))
Box(1, 1).put(*one, cols)
place(row, light)
""")
    assert swapped(tree, signatures([tree])) == {
        ("place", "row"),
        ("place", "col"),
        ("place", "light"),
        ("Box", "rows"),
        ("Box", "cols"),
    }
