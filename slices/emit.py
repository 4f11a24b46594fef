# SPDX-License-Identifier: Apache-2.0
"""C++ of a design's pass: one word per net, one statement per table, in functions that are short
enough for the compiler.

All words of a slice are one array. A unit's code is written once, and called with the place of
every instance's words and the place of those that the instances share.
"""

from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import TypeAlias

from attrs import define, field, frozen

from .netlist import ONE, ZERO, Block, Instance, NetlistError, Nets, Read, Table
from .schedule import (
    Call,
    Copy,
    DarkTables,
    Evaluate,
    Guard,
    Op,
    Put,
    Schedule,
    Write,
    settling,
    with_dark_tables,
)

STATEMENTS = 400  # in a function, about
Value: TypeAlias = Callable[[int], str]  # expression for a net


@frozen
class DarkInput:
    """A hint: an input port of a block is dark, which means nearly always 0, and so are most
    fields of `field_bits` bits.
    """

    block: str
    port: str
    field_bits: int


@define
class Layout:
    """Where things are among the words of a slice.

    words, flags: how many there are. inputs, outputs: words of each port's bits. nets: words of
    those nets of the top that last from pass to pass; instances: the same for each instance.
    memories: first word of each; bit b of row r is at first + r * width + b. ones: words that
    are 1 at the beginning. flags_of: flags to be set with bit b of a dark input.
    """

    words: int = 0
    flags: int = 0
    inputs: dict[str, list[int]] = field(factory=dict)
    outputs: dict[str, list[int]] = field(factory=dict)
    nets: dict[int, int] = field(factory=dict)
    instances: dict[str, dict[int, int]] = field(factory=dict)
    memories: dict[str, int] = field(factory=dict)
    ones: list[int] = field(factory=list)
    flags_of: dict[str, list[list[int]]] = field(factory=dict)

    def take(self, words: int = 1) -> int:
        """Add some words and return the first of them."""
        self.words += words
        return self.words - words


@define
class _Unit:
    """A unit's words. own, shared: net -> its place among the words of an instance, or among
    those that all instances share.

    moves: (word, net of the top) of inputs that are set before the call.
    """

    block: Block
    own: dict[int, int]
    shared: dict[int, int]
    flags: list[tuple[int, frozenset[int]]]
    temporaries: int = 0
    first_shared: int = 0
    first_own: int = 0
    first_flag: int = 0
    instances: int = 0
    moves: list[tuple[int, int]] = field(factory=list)


class Emission:
    """C++ (`source`, `header`) and `layout` of the block `top`; the other blocks are units that
    repeat in it.
    """

    def __init__(
        self, blocks: Mapping[str, Block], top: str, dark_inputs: Sequence[DarkInput] = ()
    ):
        self.top, self.blocks = blocks[top], blocks
        self.layout = Layout()
        used = dict.fromkeys(instance.unit for instance in self.top.instances)
        flags = {name: _dark_fields(blocks[name], dark_inputs) for name in (*used, top)}
        nodes = {name: with_dark_tables(blocks[name], flags[name], blocks) for name in (*used, top)}
        schedules = {
            name: Schedule(blocks[name], blocks, nodes[name], name != top) for name in (*used, top)
        }
        self._units = {name: self._unit(name, flags[name]) for name in used}
        text = []
        for name, unit in self._units.items():
            places = {net: f"M[{k}]" for net, k in unit.own.items()}
            places |= {net: f"C[{k}]" for net, k in unit.shared.items()}
            for what, ops in (
                ("pass", schedules[name].ops),
                ("settle", settling(unit.block, {}, nodes[name])),
            ):
                writer = _Writer(f"{_identifier(name)}_{what}", places, len(unit.shared))
                text += writer.text(ops)
                unit.temporaries = max(unit.temporaries, writer.temporaries)
        first_flag = self._place(schedules[top].homes, flags)
        places = {net: f"V[{k}]" for net, k in self.layout.nets.items()}
        lasting, temporaries = self.layout.words, 0
        for what, ops in (
            ("pass", schedules[top].ops),
            ("settle", settling(self.top, blocks, nodes[top])),
        ):
            top_writer = _TopWriter(what, places, lasting, first_flag, self.layout, self._units)
            text += top_writer.text(ops)
            temporaries = max(temporaries, top_writer.temporaries)
        self.layout.words += temporaries
        self.source = "\n".join(['#include "slice.h"', ROWS, *text, ""])
        self.header = _header(self.layout)

    def _unit(self, name: str, flags: list[tuple[int, frozenset[int]]]) -> _Unit:
        block, instances = self.blocks[name], [i for i in self.top.instances if i.unit == name]
        if block.memories or block.instances:
            raise NetlistError(f"{name}: a unit with a memory of rows, or with units of its own")
        shared = [
            net
            for port, nets in block.inputs.items()
            for k, net in enumerate(nets)
            if len({instance.nets[port][k] for instance in instances}) == 1
        ]
        own = [net for nets in block.inputs.values() for net in nets if net not in set(shared)]
        own += [flop.output for flop in block.flops]
        own += [
            net
            for nets in block.outputs.values()
            for net in nets
            if net > ONE and net not in set(shared)
        ]
        return _Unit(
            block,
            {net: k for k, net in enumerate(dict.fromkeys(own))},
            {net: k for k, net in enumerate(shared)},
            flags,
            instances=len(instances),
        )

    def _place(self, homes: set[int], flags: Mapping[str, list[tuple[int, frozenset[int]]]]) -> int:
        """Give a word to every net that lasts, and a flag to every dark field; return the first
        flag of the top.
        """
        layout = self.layout
        top = self.top
        place = layout.nets
        place |= {ZERO: layout.take(), ONE: layout.take()}
        layout.ones.append(place[ONE])
        flags_of: dict[int, list[int]] = defaultdict(list)  # net of the top -> flags
        for name, unit in self._units.items():
            self._place_unit(name, unit, homes, flags_of)
        first_flag = layout.flags
        layout.flags += len(flags[top.name])
        for number, fields in flags[top.name]:
            for net in fields:
                flags_of[net].append(first_flag + number)
        self._place_lasting()
        self._place_memories()
        layout.ones += [place[flop.output] for flop in top.flops if flop.init]
        layout.inputs = {port: [place[net] for net in nets] for port, nets in top.inputs.items()}
        layout.outputs = {port: [place[net] for net in nets] for port, nets in top.outputs.items()}
        given = {net for nets in top.inputs.values() for net in nets}
        if flags_of.keys() - given - {ZERO}:  # nobody would set its flag
            raise NetlistError(f"{top.name}: a dark input of a unit that is not one of the top")
        for port, nets in top.inputs.items():
            if any(net in flags_of for net in nets):
                layout.flags_of[port] = [flags_of[net] for net in nets]
        return first_flag

    def _place_unit(
        self, name: str, unit: _Unit, homes: set[int], flags_of: dict[int, list[int]]
    ) -> None:
        """Reserve the words and the flags of a unit, and place each instance in them."""
        layout = self.layout
        unit.first_shared = layout.take(len(unit.shared) + unit.temporaries)
        unit.first_own = layout.take(len(unit.own) * unit.instances)
        unit.first_flag = layout.flags
        layout.flags += len(unit.flags) * unit.instances
        instances = [instance for instance in self.top.instances if instance.unit == name]
        for k, instance in enumerate(instances):
            words = {net: unit.first_shared + at for net, at in unit.shared.items()}
            words |= {net: unit.first_own + k * len(unit.own) + at for net, at in unit.own.items()}
            layout.instances[instance.name] = words
            layout.ones += [words[flop.output] for flop in unit.block.flops if flop.init]
            outer = _outer_nets(unit.block, instance)
            self._connect_inputs(unit, outer, words, homes)
            self._connect_outputs(unit.block, instance, words)
            first_flag = unit.first_flag + k * len(unit.flags)
            for number, fields in unit.flags:
                for inner in fields:
                    flags_of[outer[inner]].append(first_flag + number)
        unit.moves = list(dict.fromkeys(unit.moves))

    def _connect_inputs(
        self, unit: _Unit, outer: Mapping[int, int], words: Mapping[int, int], homes: set[int]
    ) -> None:
        """Give nets of the top the words of the inputs that they drive, or else list their
        moves.
        """
        place = self.layout.nets
        for inner, net in outer.items():
            if net == ONE:
                self.layout.ones.append(words[inner])
            elif net in homes and net not in place:
                place[net] = words[inner]
            elif net > ONE and place.get(net) != words[inner]:
                unit.moves.append((words[inner], net))

    def _connect_outputs(self, block: Block, instance: Instance, words: Mapping[int, int]) -> None:
        """Give nets of the top the words of the outputs that drive them."""
        place = self.layout.nets
        for port, nets in block.outputs.items():
            connected = instance.nets.get(port, ())
            for inner, net in zip(nets, connected, strict=False):  # an output may be open
                place[net] = words[inner] if inner > ONE else place[inner]

    def _place_lasting(self) -> None:
        """Give words to the rows that memories show, and to ports and flops of the top that have
        none yet.
        """
        layout = self.layout
        top = self.top
        place = layout.nets
        for memory in top.memories:
            for read in memory.reads:  # a row's bits are neighbours
                first = layout.take(memory.width)
                place |= {net: first + k for k, net in enumerate(read.outputs)}
        lasting = [net for nets in top.inputs.values() for net in nets]
        lasting += [flop.output for flop in top.flops]
        lasting += [net for nets in top.outputs.values() for net in nets]
        for net in lasting:
            if net > ONE and net not in place:
                place[net] = layout.take()

    def _place_memories(self) -> None:
        """Give words to the rows of the memories."""
        layout = self.layout
        for memory in self.top.memories:
            first = layout.take(memory.rows * memory.width)
            layout.memories[memory.name] = first
            for row, value in enumerate(memory.init):
                first_of_row = first + row * memory.width
                layout.ones += [
                    first_of_row + bit for bit in range(memory.width) if value >> bit & 1
                ]


def _outer_nets(block: Block, instance: Instance) -> dict[int, int]:
    """Return the nets of the top at the inputs of an instance, by net of the block."""
    outer: dict[int, int] = {}
    for port, nets in block.inputs.items():
        outer |= dict(zip(nets, instance.nets[port], strict=True))
    return outer


def _identifier(name: str) -> str:
    return "".join(c if c.isalnum() else "_" for c in name)


def _dark_fields(
    block: Block, dark_inputs: Sequence[DarkInput]
) -> list[tuple[int, frozenset[int]]]:
    """Return number and nets of the fields of a block's dark inputs, and of all of them
    together.
    """
    fields = []
    for hint in dark_inputs:
        nets = block.inputs[hint.port] if hint.block == block.name else ()
        fields += [
            frozenset(nets[k : k + hint.field_bits]) for k in range(0, len(nets), hint.field_bits)
        ]
    return list(enumerate([*fields, frozenset().union(*fields)] if len(fields) > 1 else fields))


ROWS = """\
// A memory's row for the chosen lanes: all are cleared first, unless other lanes have theirs already.
static inline void show_row(W* __restrict value, const W* __restrict row, W chosen, int width, bool first) {
    if (first) for (int i = 0; i < width; i++) value[i] = row[i] & chosen;
    else for (int i = 0; i < width; i++) value[i] |= row[i] & chosen;
}

static inline void put_row(W* row, const W* V, const int* from, W chosen, int width) {
    for (int i = 0; i < width; i++) row[i] = mux(chosen, V[from[i]], row[i]);
}
"""


def _header(layout: Layout) -> str:
    lines = [
        "#pragma once",
        '#include "word.h"',
        f"constexpr int SLICE_WORDS = {layout.words}, SLICE_FLAGS = {max(1, layout.flags)};",
        "void slice_pass(W* __restrict V, uint8_t* F);    // a rising edge of the clock",
        "void slice_settle(W* __restrict V, uint8_t* F);  // outputs that are not registers",
        f"constexpr int SLICE_ONES[] = {{{_listed([*layout.ones, -1])}}};  // words that are 1 at the beginning, and -1",
    ]
    for kind, ports in (("IN", layout.inputs), ("OUT", layout.outputs)):
        lines += [
            f"constexpr int {kind}_{port}[] = {{{_listed(words)}}};"
            for port, words in ports.items()
            if words
        ]
    for port, flags in layout.flags_of.items():
        most = max(map(len, flags))
        # A bit with fewer flags repeats its last one.
        rows = ["{" + _listed([*of, *of[-1:] * (most - len(of))]) + "}" for of in flags]
        lines.append(f"constexpr int FLAGS_OF_{port}[][{most}] = {{{', '.join(rows)}}};")
    return "\n".join([*lines, ""])


def _listed(numbers: Iterable[int]) -> str:
    return ", ".join(map(str, numbers))


@frozen(eq=False)
class _Part:
    """A function: its name, and operations."""

    name: str
    ops: list[Op]


class _Writer:
    """Functions of a unit's pass. `temporaries`: words that pass values from one function to the
    next.

    places: expression of every net that lasts; first_temporary, first_flag: in their arrays.
    """

    STATIC, PARAMETERS, ARGUMENTS = (
        "static ",
        "W* __restrict M, W* __restrict C, const uint8_t* F",
        "M, C, F",
    )
    TEMPORARIES = "C"

    def __init__(
        self, name: str, places: Mapping[int, str], first_temporary: int, first_flag: int = 0
    ):
        self.temporaries = 0
        self._name, self._places, self._first_temporary, self._first_flag = (
            name,
            places,
            first_temporary,
            first_flag,
        )
        self._parts: list[_Part] = []
        self._bodies: dict[Guard, list[_Part]] = {}
        self._shared_words: dict[
            int, str
        ] = {}  # value that several functions use -> expression of its word
        self._locals = 0

    def text(self, ops: Sequence[Op]) -> list[str]:
        """Return the functions; the last one, called as the block's pass, calls the others."""
        whole = self._split(ops)
        self._find_shared(whole)
        lines = []
        for part in self._parts:
            lines.append(f"static void __attribute__((noinline)) {part.name}({self.PARAMETERS}) {{")
            values: dict[int, str] = {}
            for op in part.ops:
                lines += [f"    {line}" for line in self._statement(op, values)]
            lines += ["}", ""]
        lines.append(f"{self.STATIC}void {self._name}({self.PARAMETERS}) {{")
        return [*lines, *(f"    {part.name}({self.ARGUMENTS});" for part in whole), "}", ""]

    def _split(self, ops: Sequence[Op]) -> list[_Part]:
        """Return operations in parts of about `STATEMENTS`; long bodies of guards become parts
        of their own.
        """
        parts: list[_Part] = []
        current: list[Op] = []
        statements = 0
        for op in ops:
            size = _size(op)
            if isinstance(op, Guard) and size > STATEMENTS // 2:
                self._bodies[op] = self._split(op.body)
                size = 1 + len(self._bodies[op])
            if current and statements + size > STATEMENTS:
                parts.append(self._part(current))
                current, statements = [], 0
            current.append(op)
            statements += size
        return [*parts, self._part(current)] if current else parts

    def _part(self, ops: list[Op]) -> _Part:
        part = _Part(f"{self._name}_{len(self._parts)}", ops)
        self._parts.append(part)
        return part

    def _walk(self, parts: Iterable[_Part]) -> Iterator[tuple[_Part, Op]]:
        """Yield operations and the functions that contain them, in the order of time."""
        for part in parts:
            for op in part.ops:
                yield part, op
                if isinstance(op, Guard):
                    yield from self._walk(self._bodies.get(op, [_Part(part.name, list(op.body))]))

    def _find_shared(self, parts: Sequence[_Part]) -> None:
        """Find the values that several functions use, and give each a word from its first to its
        last use.
        """
        made: dict[int, tuple[int, str]] = {}
        last: dict[int, int] = {}
        shared: set[int] = set()
        for time, (part, op) in enumerate(self._walk(parts)):
            for value in _used(op):
                if value in made:
                    last[value] = time
                    if made[value][1] != part.name:
                        shared.add(value)
            if isinstance(op, Put):
                shared |= {op.names.get(net, net) for net in op.store.data} & made.keys()
            for value in _made(op):
                if value not in self._places:
                    made[value] = (time, part.name)
        free: list[int] = []
        ending: list[tuple[int, int]] = []
        for value in sorted(shared, key=lambda value: made[value][0]):
            start = made[value][0]
            free += [word for end, word in ending if end < start]
            ending = [(end, word) for end, word in ending if end >= start]
            if free:
                word = free.pop()
            else:
                word, self.temporaries = self.temporaries, self.temporaries + 1
            ending.append((last[value], word))
            self._shared_words[value] = f"{self.TEMPORARIES}[{self._first_temporary + word}]"

    def _reader(self, op: Op, values: Mapping[int, str]) -> Value:
        """Return a function that gives the expression of a net in an operation. values: net ->
        local variable.
        """
        names: Mapping[int, int] = getattr(op, "names", {})

        def value(net: int) -> str:
            if net in (ZERO, ONE):
                return "ONES" if net == ONE else "ZEROS"
            net = names.get(net, net)
            return values.get(net) or self._shared_words.get(net) or self._places[net]

        return value

    def _statement(self, op: Op, values: dict[int, str]) -> Iterator[str]:
        """Yield the lines of an operation. values: net -> local variable; new ones are added."""

        value = self._reader(op, values)
        if isinstance(op, Copy):
            yield from self._define(op.name, self._places[op.net], values)
        elif isinstance(op, Evaluate):
            if isinstance(op.node, DarkTables):
                yield from self._dark_tables(op.node, value, values)
            elif isinstance(op.node, Table):
                yield from self._define(op.node.outputs[0], _expression(op.node, value), values)
        elif isinstance(op, Write):
            place = self._places[op.flop.output]
            yield f"{place} = {_next(op, place, value)};"
        elif isinstance(op, Guard):
            yield from self._guard(op, value, values)

    def _define(self, name: int, expression: str, values: dict[int, str]) -> Iterator[str]:
        self._locals += 1
        values[name] = f"t{self._locals}"
        yield f"const W t{self._locals} = {expression};"
        yield from self._stored(name, values)

    def _stored(self, name: int, values: Mapping[int, str]) -> Iterator[str]:
        word = self._shared_words.get(name) or self._places.get(name)
        if word:
            yield f"{word} = {values[name]};"

    def _dark_tables(self, node: DarkTables, value: Value, values: dict[int, str]) -> Iterator[str]:
        found: dict[int, str] = {}
        for net, value_in_dark in zip(node.outputs, node.dark_values, strict=True):
            self._locals += 1
            found[net] = f"t{self._locals}"
            yield f"W {found[net]} = {'ONES' if value_in_dark else 'ZEROS'};"
        yield f"if (F[{self._first_flag + node.flag}]) {{"
        inner: dict[int, str] = {}
        for table in node.tables:
            self._locals += 1
            expression = _expression(table, lambda net: inner.get(net) or value(net))
            inner[table.outputs[0]] = f"t{self._locals}"
            yield f"    const W t{self._locals} = {expression};"
        for net in node.outputs:
            yield f"    {found[net]} = {inner[net]};"
        yield "}"
        values |= found
        for net in node.outputs:
            yield from self._stored(net, values)

    def _guard(self, op: Guard, value: Value, values: dict[int, str]) -> Iterator[str]:
        enable, reset = value(op.enable), value(op.reset)
        yield f"if (any({_gate(enable, reset)})) {{"
        if op in self._bodies:
            yield from (f"    {part.name}({self.ARGUMENTS});" for part in self._bodies[op])
        else:
            inner = dict(values)
            for inside in op.body:
                yield from (f"    {line}" for line in self._statement(inside, inner))
        if op.enable == ONE:
            yield "} else {"
            for flop in op.flops:
                yield f"    {self._places[flop.output]} = {'ONES' if flop.reset_value else 'ZEROS'};"
        yield "}"


class _TopWriter(_Writer):
    """Functions of the top block's pass, which has memories and calls units."""

    STATIC, PARAMETERS, ARGUMENTS = "", "W* __restrict V, uint8_t* F", "V, F"
    TEMPORARIES = "V"

    def __init__(
        self,
        what: str,
        places: Mapping[int, str],
        first_temporary: int,
        first_flag: int,
        layout: Layout,
        units: Mapping[str, _Unit],
    ):
        super().__init__(f"slice_{what}", places, first_temporary, first_flag)
        self._what, self._layout, self._units = what, layout, units

    def _statement(self, op: Op, values: dict[int, str]) -> Iterator[str]:
        value = self._reader(op, values)
        if isinstance(op, Evaluate) and isinstance(op.node, Read):
            yield from self._read(op.node, _gate(value(op.enable), value(op.reset)), value)
        elif isinstance(op, Put):
            yield from self._put(op, value)
        elif isinstance(op, Call):
            yield from self._call(op, value)
        else:
            yield from super()._statement(op, values)

    def _read(self, node: Read, gate: str, value: Value) -> Iterator[str]:
        memory = node.memory
        shown, first = self._layout.nets[node.outputs[0]], self._layout.memories[memory.name]
        yield "{"
        yield f"    const W gate = {gate};"
        yield "    bool first = true;"
        for row in range(memory.rows):
            yield f"    if (const W chosen = gate & {_row(node.inputs, row, value)}; any(chosen)) {{"
            yield f"        show_row(V + {shown}, V + {first + row * memory.width}, chosen, {memory.width}, first);"
            yield "        first = false;"
            yield "    }"
        yield f"    if (first) for (int i = 0; i < {memory.width}; i++) V[{shown} + i] = ZEROS;"
        yield "}"

    def _put(self, op: Put, value: Value) -> Iterator[str]:
        memory, first = op.memory, self._layout.memories[op.memory.name]
        yield f"if (const W enable = {value(op.store.enable)}; any(enable)) {{"
        # Every bit of the row has a word, so that one loop serves all rows.
        names = [op.names.get(net, net) for net in op.store.data]
        words = [self._shared_words.get(name) or self._places[name] for name in names]
        yield f"    static const int FROM[] = {{{', '.join(word[2:-1] for word in words)}}};  // words of V"
        for row in range(memory.rows):
            yield f"    if (const W chosen = enable & {_row(op.store.address, row, value)}; any(chosen))"
            yield f"        put_row(V + {first + row * memory.width}, V, FROM, chosen, {memory.width});"
        yield "}"

    def _call(self, op: Call, value: Value) -> Iterator[str]:
        name = op.instances[0].unit
        unit = self._units[name]
        for word, net in unit.moves:
            yield f"V[{word}] = {value(net)};"
        own, flags = len(unit.own), len(unit.flags)
        yield f"for (int k = 0; k < {unit.instances}; k++)"
        arguments = f"V + {unit.first_own} + k * {own}, V + {unit.first_shared}, F + {unit.first_flag} + k * {flags}"
        yield f"    {_identifier(name)}_{self._what}({arguments});"


def _row(address: Nets, row: int, value: Value) -> str:
    return (
        " & ".join(f"{'' if row >> k & 1 else '~'}{value(net)}" for k, net in enumerate(address))
        or "ONES"
    )


def _size(op: Op) -> int:
    if isinstance(op, Guard):
        return 2 + sum(map(_size, op.body))
    if isinstance(op, Evaluate) and isinstance(op.node, DarkTables):
        return len(op.node.tables) + len(op.node.outputs)
    return 1


def _used(op: Op) -> Iterator[int]:
    """Yield the values that an operation reads, without its body."""
    if isinstance(op, Copy):
        nets: Iterable[int] = (op.net,)
    elif isinstance(op, Evaluate):
        nets = (*op.node.inputs, op.enable, op.reset)
    elif isinstance(op, Write):
        nets = op.flop.inputs
    elif isinstance(op, Put):
        nets = op.store.inputs
    elif isinstance(op, Guard):
        nets = (op.enable, op.reset)
    else:
        nets = (net for instance in op.instances for of in instance.nets.values() for net in of)
    names = getattr(op, "names", {})
    yield from (names.get(net, net) for net in nets)


def _made(op: Op) -> Iterator[int]:
    if isinstance(op, Copy):
        yield op.name
    elif isinstance(op, Evaluate) and not isinstance(op.node, Read):
        yield from op.node.outputs


def _expression(table: Table, value: Value) -> str:
    if not table.inputs:
        return "ONES" if table.bits else "ZEROS"
    return f"table<{table.bits}>({', '.join(map(value, table.inputs))})"


def _gate(enable: str, reset: str) -> str:
    """Return the lanes in which a group of flip-flops does not just keep its values."""
    if reset == "ZEROS":
        return enable
    return f"~{reset}" if enable == "ONES" else f"({enable} | {reset})"


def _next(op: Write, place: str, value: Value) -> str:
    """Return a flip-flop's next value."""
    flop = op.flop
    data = value(flop.data)
    if flop.enable != ONE:
        data = f"mux({value(flop.enable)}, {data}, {place})"
    if flop.reset == ZERO:
        return data
    return f"{value(flop.reset)} | {data}" if flop.reset_value else f"~{value(flop.reset)} & {data}"
