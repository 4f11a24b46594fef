# SPDX-License-Identifier: Apache-2.0
"""The order in which a pass evaluates a block and updates its registers in place.

A pass is a clock edge: everything that it computes reads the registers as they were before. A
register is written once its readers have been computed, so most need no second place; later
readers get a copy (`Copy`). Flip-flops that share an enable, with the logic that only they need,
are skipped if no lane enables them (`Guard`). Logic that is constant while some inputs are dark
(0) is skipped if they are dark in all lanes (`DarkTables`).
"""

from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from types import MappingProxyType
from typing import TypeAlias, TypeVar

import numpy as np
from attrs import define, field, frozen

from .netlist import (
    ONE,
    ZERO,
    Block,
    Flop,
    Instance,
    Memory,
    NetlistError,
    Nets,
    Read,
    Store,
    Table,
)

ELSEWHERE = -1
NO_UNITS: Mapping[str, Block] = MappingProxyType({})
FORCED = 1e6  # weight of an order that must be kept
T = TypeVar("T")
N = TypeVar("N", bound="Node | _Through")
GUARD_MIN = (
    12  # flip-flops and nodes of a group for which it is worth asking whether any lane enables it
)


@frozen(eq=False)
class DarkTables:
    """Tables that are constant while some inputs are dark (0). flag: its number, set if one of
    these inputs is 1 in any lane.

    outputs: those of the tables that others read; dark_values: their values while all these
    inputs are dark.
    """

    flag: int
    inputs: Nets
    outputs: Nets
    dark_values: Nets
    tables: Sequence[Table]


Node: TypeAlias = Table | Read | DarkTables


@frozen(eq=False)
class _Through:
    """Logic that is computed together: all instances of a unit, or tables that are dark together."""

    inputs: Nets
    outputs: Nets
    tables: Sequence[Table] = ()


@frozen(eq=False)
class Copy:
    """The present value of `net` gets a second name, because the register is written before its
    last reader comes.
    """

    net: int
    name: int


@frozen(eq=False)
class Evaluate:
    """Compute a node. names: of inputs that have a second name; enable, reset: of the guard
    around it.
    """

    node: Node
    names: Mapping[int, int]
    enable: int = ONE
    reset: int = ZERO


@frozen(eq=False)
class Write:
    """Update a flip-flop."""

    flop: Flop
    names: Mapping[int, int]


@frozen(eq=False)
class Put:
    """Write a row of a memory in the lanes that enable it."""

    memory: Memory
    store: Store
    names: Mapping[int, int]


@frozen(eq=False)
class Call:
    """Update all instances of a unit, or, to settle, only compute their outputs."""

    instances: Sequence[Instance]
    names: Mapping[int, int]


@frozen(eq=False)
class Guard:
    """Do `body` if any lane has enable or reset. If all lanes have reset, flip-flops without
    enable take their reset values.
    """

    enable: int
    reset: int
    names: Mapping[int, int]
    body: Sequence["Op"]
    flops: Sequence[Flop]


Op: TypeAlias = Copy | Evaluate | Write | Put | Call | Guard


@define(eq=False)
class _Group:
    """Registers that are updated together: flip-flops, the rows of a memory, or all instances of a
    unit.
    """

    flops: Sequence[Flop] = ()
    memory: Memory | None = None
    instances: Sequence[Instance] = ()
    guarded: bool = False
    own: list[Node] = field(factory=list)  # nodes that nothing else reads, in order

    @property
    def enable(self) -> int:
        return self.flops[0].enable

    @property
    def reset(self) -> int:
        return self.flops[0].reset


def in_order(nodes: Iterable[N]) -> list[N]:
    """Return nodes so that each comes after those that it reads. Raises `NetlistError` if they
    form a loop.
    """
    nodes = list(nodes)
    producer = {net: node for node in nodes for net in node.outputs}
    return _last_first(
        nodes, lambda node: (producer[net] for net in node.inputs if net in producer)
    )


def with_dark_tables(
    block: Block,
    flags: Sequence[tuple[int, frozenset[int]]],
    units: Mapping[str, Block] = NO_UNITS,
) -> list[Node]:
    """Return the tables of a block, gathered where they are dark together. flags: (number,
    inputs), smaller ones first. units: the blocks of the instances.
    """
    order = in_order(block.tables)
    chosen, dark_values = _dark_together(block, flags, units) if flags else ({}, {})
    gathered: list[list[Table]] = [[] for _ in flags]
    for table in order:
        if table in chosen:
            gathered[chosen[table]].append(table)
    read_by: dict[int, set[int]] = defaultdict(
        set, {net: {ELSEWHERE} for net in _read_elsewhere(block)}
    )
    for table in order:
        for net in table.inputs:
            read_by[net].add(chosen.get(table, ELSEWHERE))
    nodes: list[Node] = [table for table in order if table not in chosen]
    for k, tables in enumerate(gathered):
        own = {table.outputs[0] for table in tables}
        inputs = {net for table in tables for net in table.inputs} - own
        outputs = tuple(sorted(net for net in own if read_by[net] - {k}))
        if tables:
            nodes.append(
                DarkTables(
                    flags[k][0],
                    tuple(sorted(inputs)),
                    outputs,
                    tuple(dark_values[net] for net in outputs),
                    tables,
                )
            )
    return nodes


def _dark_together(
    block: Block, flags: Sequence[tuple[int, frozenset[int]]], units: Mapping[str, Block]
) -> tuple[dict[Table, int], dict[int, int]]:
    """Return table -> place of its flag in `flags`, and the value of its output while it is dark."""
    # Tables before and behind a memory, a unit or other dark tables are not dark together.
    nodes: list[Table | Read | _Through] = [*block.tables, *_reads(block), *_through(block, units)]
    chosen: dict[Table, int] = {}
    dark_values: dict[int, int] = {}
    for k, (_, zeros) in enumerate(flags):
        known: dict[int, int] = dict.fromkeys(zeros, 0)
        mine: list[Table] = []
        outputs: set[int] = set()  # of mine
        # nets that depend on this DarkTables's tables, and are not among them
        behind: set[int] = set()
        for node in in_order(nodes):
            for table in _tables_in(node):
                value = _constant(table, known)
                if value is not None:
                    known[table.outputs[0]] = value
            inputs = set(node.inputs)
            if isinstance(node, Table) and node.outputs[0] in known and not behind & inputs:
                mine.append(node)
                outputs.update(node.outputs)
            elif (behind | outputs) & inputs:
                behind.update(node.outputs)
        chosen |= dict.fromkeys(mine, k)
        dark_values |= {net: known[net] for net in outputs}
        nodes = [node for node in nodes if node not in chosen]
        inner = {net for table in mine for net in table.inputs}
        nodes.append(_Through(tuple(sorted(inner - outputs)), tuple(sorted(outputs)), mine))
    return chosen, dark_values


def _tables_in(node: Table | Read | _Through) -> Sequence[Table]:
    if isinstance(node, Table):
        return (node,)
    return node.tables if isinstance(node, _Through) else ()


def _through(block: Block, units: Mapping[str, Block]) -> list[_Through]:
    computed, _ = _of_units(block, units)
    return [
        _Through(
            tuple(_read_by(instances, units)),
            tuple(net for net, unit in computed.items() if unit == name),
        )
        for name, instances in _by_unit(block).items()
    ]


def _read_elsewhere(block: Block) -> set[int]:
    """Return the nets that something other than a table reads."""
    found = {net for nets in block.outputs.values() for net in nets}
    found |= {net for flop in block.flops for net in flop.inputs}
    found |= {
        net for instance in block.instances for nets in instance.nets.values() for net in nets
    }
    for memory in block.memories:
        found |= {net for read in memory.reads for net in read.inputs}
        found |= {net for store in memory.stores for net in store.inputs}
    return found


def _constant(table: Table, known: Mapping[int, int]) -> int | None:
    """Return a table's value if the known inputs determine it."""
    if not any(net in known for net in table.inputs):
        return None
    values = {
        table.bits >> row & 1
        for row in range(1 << len(table.inputs))
        if all(known.get(net, row >> i & 1) == row >> i & 1 for i, net in enumerate(table.inputs))
    }
    return values.pop() if len(values) == 1 else None


class Schedule:
    """Operations of one pass through a block, in `ops`. homes: nets whose place is an input of
    an instance.

    units: the blocks of the instances; nodes: from `with_dark_tables`; second names are numbers
    below 0. outputs: whether the pass also computes the outputs that are not registers, as they
    were before the edge.
    """

    def __init__(
        self, block: Block, units: Mapping[str, Block], nodes: Sequence[Node], outputs: bool = False
    ):
        self.block, self.units = block, units
        self._shown = [net for nets in block.outputs.values() for net in nets] if outputs else []
        self.ops: list[Op] = []
        nodes = [*nodes, *_reads(block)]
        self._producer: dict[int, Node] = {net: node for node in nodes for net in node.outputs}
        self._called, registered = _of_units(block, units)
        self._groups = self._grouped()
        live = self._live(nodes)
        self._own(live)
        self._producer = {net: node for node in live for net in node.outputs}
        written = {flop.output for flop in block.flops} | set(registered)
        self._writer = {flop.output: group for group in self._groups for flop in group.flops}
        calls = {group.instances[0].unit: group for group in self._groups if group.instances}
        self._writer |= {net: calls[unit] for net, unit in registered.items()}
        self._calls = calls
        self._readers: dict[int, int] = defaultdict(int)
        for inputs in self._consumers(live):
            for net in set(inputs) & written:
                self._readers[net] += 1
        feeds = set(_read_by(block.instances, units))
        given = {net for nets in block.inputs.values() for net in nets}
        self.homes = feeds & (given | {flop.output for flop in block.flops})
        self.homes -= _passed_on(block.instances, units)
        self._names: dict[int, int] = {}
        self._done: set[Node | _Group] = set()
        self._begun: set[_Group] = set()  # calls, also those whose inputs are not computed yet
        self._alias = 0
        self._need(self._shown, self.ops)
        self._read(self._shown)
        for group in self._readers_first(live):
            self._update(group)

    def _grouped(self) -> list[_Group]:
        """Return the groups of registers; `_own` decides which are guarded."""
        shared: dict[Nets, list[Flop]] = defaultdict(list)
        for flop in self.block.flops:
            shared[flop.enable, flop.reset].append(flop)
        groups = []
        for (enable, reset), flops in shared.items():
            if (enable, reset) == (ONE, ZERO):
                groups += [_Group([flop]) for flop in flops]
            else:
                groups.append(_Group(flops, guarded=True))
        groups += [_Group(memory=memory) for memory in self.block.memories if memory.stores]
        return groups + [_Group(instances=instances) for instances in _by_unit(self.block).values()]

    def _inputs(self, group: _Group) -> list[int]:
        """Return what a group's registers read."""
        if group.memory:
            return [net for store in group.memory.stores for net in store.inputs]
        if group.instances:
            return _read_by(group.instances, self.units)
        return [net for flop in group.flops for net in flop.inputs]

    def _live(self, nodes: Sequence[Node]) -> list[Node]:
        """Return the nodes that some register reads, in order."""
        todo = [*self._shown, *(net for group in self._groups for net in self._inputs(group))]
        live: set[Node] = set()
        while todo:
            node = self._producer.get(todo.pop())
            if node is not None and node not in live:
                live.add(node)
                todo += node.inputs
        return [node for node in in_order(nodes) if node in live]

    def _own(self, live: Sequence[Node]) -> None:
        """Find the nodes that only one guarded group reads, and split guarded groups that are
        too small.
        """
        owner = self._owners(live)
        size: dict[_Group, int] = {group: len(group.flops) for group in self._groups}
        for group in owner.values():
            size[group] += 1
        split = [group for group in self._groups if group.guarded and size[group] < GUARD_MIN]
        self._groups = [group for group in self._groups if group not in split]
        self._groups += [_Group([flop]) for group in split for flop in group.flops]
        for node in live:
            if node in owner and owner[node] not in split:
                owner[node].own.append(node)
        self._owner = {node: group for node, group in owner.items() if group not in split}

    def _owners(self, live: Sequence[Node]) -> dict[Node, _Group]:
        users: dict[int, set[_Group | None]] = defaultdict(
            set, {net: {None} for net in self._shown}
        )
        for group in self._groups:
            if group.guarded:
                for flop in group.flops:
                    users[flop.data].add(group)
                for net in (group.enable, group.reset):
                    users[net].add(None)
            else:
                for net in self._inputs(group):
                    users[net].add(None)
        owner: dict[Node, _Group] = {}
        for node in reversed(live):
            of = {user for net in node.outputs for user in users[net]}
            only = of.pop() if len(of) == 1 else None
            if only is not None:
                owner[node] = only
            for net in node.inputs:
                users[net].add(only)
        return owner

    def _consumers(self, live: Sequence[Node]) -> Iterable[Iterable[int]]:
        """Return what each consumer reads: nodes, flip-flops, guards, memories, calls."""
        yield self._shown
        yield from (node.inputs for node in live)
        for group in self._groups:
            if group.flops:
                yield from ((flop.data,) if group.guarded else flop.inputs for flop in group.flops)
                if group.guarded:
                    yield (group.enable, group.reset)
            else:
                yield self._inputs(group)

    def _readers_first(self, live: Sequence[Node]) -> list[_Group]:
        """Return the groups so that most come after those that read their registers."""
        number = {group: k for k, group in enumerate(self._groups)}
        reached: dict[int, int] = defaultdict(int)  # net -> groups, as a number's bits
        for group, k in number.items():
            for net in self._inputs(group):
                reached[net] |= 1 << k
        _reach(live, reached)
        # before[j][k]: registers of group k that group j reads, so that a copy of each is needed
        # if j comes later.
        before = np.zeros((len(self._groups), len(self._groups)))
        for net, group in self._writer.items():
            before[list(_bits(reached[net])), number[group]] += 1
        for (
            net,
            unit,
        ) in self._called.items():  # there is no copy of an instance's output before it is computed
            before[number[self._calls[unit]], list(_bits(reached[net]))] = FORCED
        for group, k in number.items():  # nor of a register in the place of an instance's input
            if self.homes & {flop.output for flop in group.flops}:
                before[[number[call] for call in self._calls.values()], k] = FORCED
        return [self._groups[k] for k in _least_backward(before)]

    def _named(self, nets: Iterable[int]) -> dict[int, int]:
        return {net: self._names[net] for net in nets if net in self._names}

    def _read(self, nets: Iterable[int]) -> None:
        for net in set(nets):
            if net in self._readers:
                self._readers[net] -= 1

    def _need(self, nets: Iterable[int], into: list[Op], inside: _Group | None = None) -> None:
        """Compute some nets. inside: only nodes of this guarded group, whose other inputs are
        there.
        """
        for root in nets:
            stack = [root]
            while stack:
                net = stack[-1]
                if net in self._called and self._calls[self._called[net]] not in self._done:
                    self._update(self._calls[self._called[net]])
                node = self._producer.get(net)
                if node is None or node in self._done:
                    stack.pop()
                    continue
                missing = [x for x in node.inputs if self._missing(x)]
                if missing:
                    stack += missing
                    continue
                stack.pop()
                self._done.add(node)
                gates = (inside.enable, inside.reset) if inside else (ONE, ZERO)
                into.append(Evaluate(node, self._named((*node.inputs, *gates)), *gates))
                self._read(node.inputs)

    def _missing(self, net: int) -> bool:
        if net in self._called:
            return self._calls[self._called[net]] not in self._done
        node = self._producer.get(net)
        return node is not None and node not in self._done

    def _copy(self, net: int, into: list[Op]) -> None:
        self._alias -= 1
        into.append(Copy(net, self._alias))
        self._names[net] = self._alias

    def _update(self, group: _Group) -> None:
        """Put a group's update into the pass, after everything that it needs."""
        if group in self._done:
            return
        if self.homes & {flop.output for flop in group.flops}:
            for call in self._calls.values():
                self._update(call)
        if not group.instances:
            self._done.add(group)
        if group.memory:
            self._put(group)
        elif group.instances:
            self._call(group)
        elif group.guarded:
            self._guard(group)
        else:
            flop = group.flops[0]
            self._need(flop.inputs, self.ops)
            self._read(flop.inputs)
            self._write(flop, self.ops)

    def _write(self, flop: Flop, into: list[Op]) -> None:
        names = self._named(flop.inputs)
        if self._readers[flop.output] and flop.output not in self._names:
            self._copy(flop.output, into)
        into.append(Write(flop, names))

    def _put(self, group: _Group) -> None:
        """Write the rows of a memory, after they are read; of two stores in a row, the later wins."""
        memory = group.memory
        assert memory is not None
        for read in memory.reads:
            if read in self._owner:
                self._update(self._owner[read])
            elif read.outputs[0] in self._producer and read not in self._done:
                self._need(read.outputs[:1], self.ops)
        inputs = self._inputs(group)
        self._need(inputs, self.ops)
        self._read(inputs)
        self.ops += [Put(memory, store, self._named(store.inputs)) for store in memory.stores]

    def _call(self, group: _Group) -> None:
        inputs = self._inputs(group)
        if group in self._begun:  # by itself, perhaps through another unit
            raise NetlistError(
                f"{group.instances[0].unit}: an output leads to an input without a register"
            )
        self._begun.add(group)
        self._need(inputs, self.ops)
        self._done.add(group)
        self._read(inputs)
        names = self._named(inputs)
        for net, writer in self._writer.items():
            if writer is group and self._readers[net] and net not in self._names:
                self._copy(net, self.ops)
        self.ops.append(Call(group.instances, names))

    def _guard(self, group: _Group) -> None:
        own = set(group.own)
        outer = [net for node in group.own for net in node.inputs] + [
            flop.data for flop in group.flops
        ]
        outer = [net for net in outer if self._producer.get(net) not in own]
        controls = {group.enable, group.reset}  # which may be registers of this very group
        self._need([*outer, *controls], self.ops)
        # Readers that come after the guard get their copies before it.
        inside: dict[int, int] = defaultdict(int)
        for inputs in (
            controls,
            *(node.inputs for node in group.own),
            *((flop.data,) for flop in group.flops),
        ):
            for net in set(inputs):
                inside[net] += 1
        for flop in group.flops:
            if self._readers[flop.output] > inside[flop.output] and flop.output not in self._names:
                self._copy(flop.output, self.ops)
        names = self._named((group.enable, group.reset))
        body: list[Op] = []
        names_before = dict(self._names)
        for flop in self._readers_within(group):
            self._need((flop.data,), body, group)
            self._read((flop.data,))
            self._write(flop, body)
        self._read(controls)
        self._names = names_before
        self.ops.append(Guard(group.enable, group.reset, names, body, group.flops))

    def _readers_within(self, group: _Group) -> list[Flop]:
        """Return the flip-flops of a guarded group so that most come after those that read them."""
        reached: dict[int, int] = defaultdict(int)
        for k, flop in enumerate(group.flops):
            reached[flop.data] |= 1 << k
        _reach(group.own, reached)
        order = _last_first(
            range(len(group.flops)), lambda k: _bits(reached[group.flops[k].output]), loops=True
        )
        return [group.flops[k] for k in order]


def _reach(nodes: Sequence[Node], reached: dict[int, int]) -> None:
    """Let nets reach what the nodes behind them reach. reached: net -> a bit for each group or
    flip-flop.
    """
    for node in reversed(nodes):
        of = 0
        for net in node.outputs:
            of |= reached[net]
        for net in node.inputs:
            reached[net] |= of


def settling(block: Block, units: Mapping[str, Block], nodes: Sequence[Node]) -> list[Op]:
    """Return the operations that compute a block's outputs, and update nothing."""
    instances = _by_unit(block)
    producer: dict[int, Node | str] = {
        net: node for node in (*nodes, *_reads(block)) for net in node.outputs
    }
    producer |= _of_units(block, units)[0]

    def below(nets: Sequence[int]) -> list[Node | str]:
        return [producer[net] for net in reversed(nets) if net in producer]

    shown = [net for nets in block.outputs.values() for net in nets]
    order = _last_first(
        below(shown),
        lambda of: below(_read_by(instances[of], units) if isinstance(of, str) else of.inputs),
    )
    return [Call(instances[of], {}) if isinstance(of, str) else Evaluate(of, {}) for of in order]


def _reads(block: Block) -> list[Read]:
    return [read for memory in block.memories for read in memory.reads]


def _by_unit(block: Block) -> dict[str, list[Instance]]:
    found: dict[str, list[Instance]] = defaultdict(list)
    for instance in block.instances:
        found[instance.unit].append(instance)
    return found


def _read_by(instances: Iterable[Instance], units: Mapping[str, Block]) -> list[int]:
    """Return what instances read."""
    return [net for i in instances for port in units[i.unit].inputs for net in i.nets.get(port, ())]


def _passed_on(instances: Iterable[Instance], units: Mapping[str, Block]) -> set[int]:
    """Return what instances read at inputs that are also outputs of their unit. Such an input must
    stay as it was before the edge.
    """
    found: set[int] = set()
    for instance in instances:
        unit = units[instance.unit]
        outputs = {net for nets in unit.outputs.values() for net in nets}
        for port, nets in unit.inputs.items():
            for net, inner in zip(instance.nets.get(port, ()), nets, strict=False):
                if inner in outputs:
                    found.add(net)
    return found


def _of_units(block: Block, units: Mapping[str, Block]) -> tuple[dict[int, str], dict[int, str]]:
    """Return the outputs of instances, net -> unit: those that their logic computes, and those
    that are registers.
    """
    computed: dict[int, str] = {}
    registered: dict[int, str] = {}
    for instance in block.instances:
        unit = units[instance.unit]
        flops = {flop.output for flop in unit.flops}
        for port, nets in unit.outputs.items():
            for net, inner in zip(instance.nets.get(port, ()), nets, strict=False):
                (registered if inner in flops else computed)[net] = instance.unit
    return computed, registered


def _least_backward(weight: np.ndarray) -> list[int]:
    """Return an order of the nodes of a graph in which edges of little weight go backward.

    weight[j, k]: of the edge from j to k. Heuristic: sinks to the end, sources to the front,
    else the node to the front that gains most. Source: P. Eades, X. Lin, W. F. Smyth, "A fast
    and effective heuristic for the feedback arc set problem", 1993.
    """
    weight = weight.copy()
    np.fill_diagonal(weight, 0)
    left = np.ones(len(weight), bool)
    to, of = weight.sum(axis=1), weight.sum(axis=0)
    front: list[int] = []
    back: list[int] = []
    while left.any():
        rank = np.where(
            left, np.where(to == 0, -np.inf, np.where(of == 0, np.inf, to - of)), np.nan
        )
        k = int(np.nanargmin(rank)) if np.nanmin(rank) == -np.inf else int(np.nanargmax(rank))
        (back if rank[k] == -np.inf else front).append(k)
        left[k] = False
        to -= weight[:, k]
        of -= weight[k]
    return front + back[::-1]


def _last_first(
    roots: Iterable[T], below: Callable[[T], Iterable[T]], loops: bool = False
) -> list[T]:
    """Return the roots and all below them, each after those below it. loops: permitted; then
    most are, else `NetlistError`.
    """
    order: list[T] = []
    done: dict[T, bool] = {}
    for root in roots:
        stack = [] if root in done else [(root, iter(below(root)))]
        done.setdefault(root, False)
        while stack:
            node, rest = stack[-1]
            for child in rest:
                if child not in done:
                    done[child] = False
                    stack.append((child, iter(below(child))))
                    break
                if not done[child] and not loops:
                    raise NetlistError("a loop of logic without a register, or through a unit")
            else:
                done[node] = True
                order.append(node)
                stack.pop()
    return order


def _bits(number: int) -> Iterable[int]:
    """Return the positions of a number's ones, lowest first."""
    while number:
        lowest = number & -number
        yield lowest.bit_length() - 1
        number ^= lowest
