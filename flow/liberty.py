# SPDX-License-Identifier: Apache-2.0
"""Energies, capacitances and leakage of standard cells from a liberty file.

An energy is in fJ for one transition at an input slew of `SLEW_NS`. It is the mean over rise and
fall, and over the conditions in the file. For a clock pin, it is the energy while the data of
the flip-flop do not change. For a data pin, it is the energy while the clock is low. For the
clock pin of a clock gate, it is the energy of a closed gate; the energy of an open gate is at
its output.
"""

import re
from collections.abc import Collection, Iterator, Mapping
from pathlib import Path

import numpy as np
from attrs import field, frozen

SLEW_NS = 0.02
STATEMENT = re.compile(
    r'\s*(?:(?P<group>\w+)\s*\((?P<of>[^)]*)\)\s*\{|(?P<end>\})|(?P<name>\w+)\s*:\s*(?P<value>"[^"]*"|[^;]+);'
    r"|(?P<list>\w+)\s*\((?P<items>[^)]*)\)\s*;)",
    re.DOTALL,
)
CLOCKS = ("CK", "G", "GN")  # clock pins of flip-flops and latches
DATA = "D"
CLOSED = re.compile(r"!E & !GCK")  # a clock gate stays closed
AT_REST = re.compile(r"!D & !Q\b|(?<!!)\bD & Q\b")  # the data of a flip-flop equal its output


@frozen
class Group:
    """A group of the file: its argument, its values by name, and its inner groups by name."""

    of: str
    values: dict[str, str] = field(factory=dict)
    groups: dict[str, list["Group"]] = field(factory=dict)


@frozen
class Energies:
    """Energies of a transition in fJ for loads in fF. If the file gives no loads, there is one
    load.
    """

    loads_ff: np.ndarray
    fj: np.ndarray

    def at(self, load_ff: float) -> float:
        return float(np.interp(load_ff, self.loads_ff, self.fj))


@frozen
class Pin:
    """A pin. capacitance_ff: of an input. energies: of its transitions; None: not in the file.

    clock: whether an input clocks its cell, or an output is a gated clock.
    """

    output: bool
    capacitance_ff: float
    energies: Energies | None
    clock: bool


@frozen
class Cell:
    """A standard cell. leakage_nw: mean over its states."""

    leakage_nw: float
    pins: Mapping[str, Pin]


def read_cells(path: Path, names: Collection[str]) -> dict[str, Cell]:
    """Return some cells of a liberty file. Raises `ValueError` if one is missing."""
    text = path.read_text(encoding="utf-8")
    starts = [
        (found[1], found.start())
        for found in re.finditer(r"^\s*cell \((\w+)\) \{", text, re.MULTILINE)
    ]
    ends = [*(at for _, at in starts[1:]), len(text)]
    cells = {
        name: _cell(_parsed(text[at:end]))
        for (name, at), end in zip(starts, ends, strict=True)
        if name in names
    }
    if missing := sorted(set(names) - set(cells)):
        raise ValueError(f"{path.name}: no cell {missing[0]}")
    return cells


def cell_areas(text: str) -> dict[str, float]:
    """Return the area of every cell of a liberty file, in its unit."""
    found = re.finditer(r"^\s*cell \((\w+)\) \{.*?^\s*area\s*:\s*([\d.]+)", text, re.M | re.S)
    return {match[1]: float(match[2]) for match in found}


def supply_v(path: Path) -> float:
    found = re.search(r"nom_voltage\s*:\s*([\d.]+)", path.read_text(encoding="utf-8"))
    if found is None:
        raise ValueError(f"{path.name}: no nom_voltage")
    return float(found[1])


def _parsed(text: str) -> Group:
    """Return the first group of a text."""
    text = text.replace("\\\n", " ")
    stack = [Group("")]
    for found in STATEMENT.finditer(text):
        if found["group"]:
            inner = Group(found["of"].strip(' "'))
            stack[-1].groups.setdefault(found["group"], []).append(inner)
            stack.append(inner)
        elif found["end"]:
            stack.pop()
            if len(stack) == 1:
                break
        else:
            stack[-1].values[found["name"] or found["list"]] = (
                found["value"] or found["items"]
            ).strip(' "')
    return next(iter(stack[0].groups.values()))[0]


def _cell(group: Group) -> Cell:
    return Cell(
        float(group.values["cell_leakage_power"]),
        {pin.of: _pin(pin) for pin in group.groups.get("pin", [])},
    )


def _pin(group: Group) -> Pin:
    name = group.of
    powers = group.groups.get("internal_power", [])
    gate = group.values.get("clock_gate_clock_pin") == "true"
    if gate:
        powers = [power for power in powers if CLOSED.fullmatch(power.values.get("when", ""))]
    elif name in CLOCKS:
        powers = [
            power for power in powers if AT_REST.search(power.values.get("when", "D & Q"))
        ] or powers
    elif name == DATA:
        powers = [
            power for power in powers if re.search(r"!(CK|G)\b", power.values.get("when", "!CK"))
        ] or powers
    tables = [
        table for power in powers for table in _tables(power) if table.fj.any()
    ]  # all 0: this edge does not occur
    return Pin(
        output=group.values["direction"] == "output",
        capacitance_ff=float(group.values.get("capacitance", 0)),
        energies=_mean(tables) if tables else None,
        clock=gate or "true" in (group.values.get("clock"), group.values.get("clock_gate_out_pin")),
    )


def _tables(power: Group) -> Iterator[Energies]:
    """Yield the tables of rise and fall at `SLEW_NS`."""
    for name in ("rise_power", "fall_power"):
        for table in power.groups.get(name, []):
            slews, loads = (
                _numbers(table.values.get(index, "0")) for index in ("index_1", "index_2")
            )
            rows = _numbers(table.values["values"]).reshape(len(slews), len(loads))
            yield Energies(
                loads, np.array([np.interp(SLEW_NS, slews, column) for column in rows.T])
            )


def _mean(tables: list[Energies]) -> Energies:
    loads = max((table.loads_ff for table in tables), key=len)
    return Energies(
        loads, np.mean([[table.at(load) for load in loads] for table in tables], axis=0)
    )


def _numbers(text: str) -> np.ndarray:
    return np.array(re.findall(r"-?[\d.]+(?:e[+-]?\d+)?", text), float)
