# SPDX-License-Identifier: Apache-2.0
"""Netlists of one clock: tables of up to three inputs, flip-flops, memories of rows, and
instances of units.

`read_netlist` takes Yosys's JSON. A net is a number: 0 and 1 are the constants, Yosys counts its
own from 2. There are two
states: bits that Yosys leaves undefined are 0.
"""

import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, TypeAlias

from attrs import define, field, frozen

ZERO, ONE = 0, 1  # nets of the constants
CLOCK = "clk"
IGNORED = ("$scopeinfo",)
Nets: TypeAlias = tuple[int, ...]


class NetlistError(ValueError):
    """A netlist that cannot be played in slices; the message says why."""


@frozen(eq=False)
class Table:
    """A function of up to three nets. bits: bit i is its value if the inputs, first one lowest,
    are the number i.
    """

    inputs: Nets
    outputs: Nets  # one
    bits: int


@frozen(eq=False)
class Flop:
    """A flip-flop: at a clock edge it takes reset_value if reset is 1, else data if enable is 1."""

    data: int
    output: int
    enable: int = ONE
    reset: int = ZERO
    reset_value: int = 0
    init: int = 0

    @property
    def inputs(self) -> Nets:
        return self.data, self.enable, self.reset


@frozen(eq=False)
class Read:
    """A port of a memory that shows the row at an address. outputs: the row's bits."""

    memory: "Memory"
    inputs: Nets  # the address
    outputs: Nets


@frozen
class Store:
    """A port of a memory that writes a row at a clock edge."""

    address: Nets
    data: Nets
    enable: int

    @property
    def inputs(self) -> Nets:
        return *self.address, *self.data, self.enable


@define(eq=False)
class Memory:
    """Rows of bits. init: of every row, as a number. A store that comes later in `stores` wins."""

    name: str
    rows: int
    width: int
    init: list[int]
    reads: list[Read] = field(factory=list)
    stores: list[Store] = field(factory=list)


@frozen(eq=False)
class Instance:
    """A unit inside a block. nets: of the block, by the unit's port."""

    name: str
    unit: str
    nets: Mapping[str, Nets]


@define(eq=False)
class Block:
    """A netlist. names: every signal that has a name, with its nets, lowest bit first."""

    name: str
    inputs: dict[str, Nets]
    outputs: dict[str, Nets]
    tables: list[Table]
    flops: list[Flop]
    memories: list[Memory]
    instances: list[Instance]
    names: dict[str, Nets]


FLOPS = {  # cells that `dfflegalize` leaves, and their values at reset
    "$_DFF_P_": 0,
    "$_DFFE_PP_": 0,
    "$_SDFF_PP0_": 0,
    "$_SDFF_PP1_": 1,
    "$_SDFFE_PP0P_": 0,
    "$_SDFFE_PP1P_": 1,
}


def read_netlist(path: Path) -> dict[str, Block]:
    """Return the blocks of a JSON netlist by name. Raises `NetlistError`."""
    modules = json.loads(path.read_text(encoding="utf-8"))["modules"]
    return {name: _block(name, module, modules) for name, module in modules.items()}


def _nets(bits: Iterable[int | str]) -> Nets:
    return tuple(bit if isinstance(bit, int) else int(bit == "1") for bit in bits)


def _block(name: str, module: Mapping[str, Any], units: Mapping[str, Any]) -> Block:
    ports = {
        port: (of["direction"] == "input", _nets(of["bits"]))
        for port, of in module["ports"].items()
    }
    names = {
        signal: _nets(of["bits"])
        for signal, of in module["netnames"].items()
        if not of.get("hide_name")
    }
    block = Block(
        name,
        {port: nets for port, (is_input, nets) in ports.items() if is_input and port != CLOCK},
        {port: nets for port, (is_input, nets) in ports.items() if not is_input},
        [],
        [],
        [],
        [],
        names,
    )
    clock = ports[CLOCK][1] if CLOCK in ports else ()
    inits = _inits(module)
    for cell, of in module["cells"].items():
        kind, nets = of["type"], {port: _nets(bits) for port, bits in of["connections"].items()}
        if kind == "$lut":
            block.tables.append(Table(nets["A"], nets["Y"], int(of["parameters"]["LUT"], 2)))
        elif kind in FLOPS:
            _check_clock(name, nets["C"], clock)
            block.flops.append(
                Flop(
                    nets["D"][0],
                    nets["Q"][0],
                    nets.get("E", (ONE,))[0],
                    nets.get("R", (ZERO,))[0],
                    FLOPS[kind],
                    inits.get(nets["Q"][0], 0),
                )
            )
        elif kind == "$mem_v2":
            block.memories.append(_memory(name, of["parameters"], nets, clock))
        elif kind in units:
            given = _open_inputs(units[kind]) | nets
            block.instances.append(
                Instance(cell, kind, {port: n for port, n in given.items() if port != CLOCK})
            )
        elif kind not in IGNORED:
            raise NetlistError(f"{name}: a cell {kind}, which slices do not know")
    return block


def _open_inputs(unit: Mapping[str, Any]) -> dict[str, Nets]:
    """Return what the inputs of a unit read where nothing is connected, by port."""
    inputs = {port: of for port, of in unit["ports"].items() if of["direction"] == "input"}
    return {port: (ZERO,) * len(of["bits"]) for port, of in inputs.items()}


def _check_clock(block: str, nets: Nets, clock: Nets) -> None:
    if nets != clock:
        raise NetlistError(f"{block}: a clock other than its port {CLOCK}")


def _inits(module: Mapping[str, Any]) -> dict[int, int]:
    """Return net -> initial value."""
    found = {}
    for of in module["netnames"].values():
        for net, bit in zip(of["bits"], reversed(of["attributes"].get("init", "")), strict=False):
            if bit in "01":
                found[net] = int(bit)
    return found


def _memory(
    block: str, parameters: Mapping[str, str], nets: Mapping[str, Nets], clock: Nets
) -> Memory:
    """Return a memory of Yosys's `$mem_v2`, whose reads need no clock."""
    number = {key: int(value, 2) for key, value in parameters.items() if set(value) <= {"0", "1"}}
    rows, width, bits = number["SIZE"], number["WIDTH"], number["ABITS"]
    text = parameters["INIT"].replace("x", "0").replace("z", "0").zfill(rows * width)
    init = [
        int(text[len(text) - (row + 1) * width : len(text) - row * width], 2) for row in range(rows)
    ]
    if number["RD_CLK_ENABLE"] or number["OFFSET"]:
        raise NetlistError(
            f"{block}: a memory whose reads are clocked, or whose rows do not begin at 0"
        )
    memory = Memory(parameters["MEMID"].lstrip("\\"), rows, width, init)
    for k in range(number["RD_PORTS"]):
        address, data = nets["RD_ADDR"][k * bits :][:bits], nets["RD_DATA"][k * width :][:width]
        memory.reads.append(Read(memory, address, data))
    for k in range(number["WR_PORTS"]):
        _check_clock(block, nets["WR_CLK"][k : k + 1], clock)
        enables = set(nets["WR_EN"][k * width :][:width])
        if len(enables) > 1:
            raise NetlistError(f"{block}: memory {memory.name} writes parts of a row")
        memory.stores.append(
            Store(
                nets["WR_ADDR"][k * bits :][:bits], nets["WR_DATA"][k * width :][:width], *enables
            )
        )
    return memory
