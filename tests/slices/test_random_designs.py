# SPDX-License-Identifier: Apache-2.0
"""Designs with units and memories, drawn at random: a pass through the words of their layout is an
edge that all registers take at once.
"""

import random

import pytest

from coincid.slices import schedule
from coincid.slices.emit import DarkInput, Emission, _dark_fields
from coincid.slices.netlist import ONE, ZERO, Block, Flop, Instance, Memory, Read, Store, Table
from coincid.slices.schedule import DarkTables, Schedule, settling, with_dark_tables

from .test_schedule import following, value

INPUTS, FLOPS, CYCLES = 8, 24, 6
TOP, UNITS = "top", ("one", "two")
PASS, SETTLE = range(2)


class Drawn:
    """Nets of a block that is drawn part by part: each part may read all that was there before.

    often: nets that come up more often than others, as the latest do.
    """

    def __init__(self, rng):
        self.rng, self.next, self.nets, self.tables, self.often = rng, 100, [], [], []

    def new(self, number):
        self.next += number
        return tuple(range(self.next - number, self.next))

    def some(self, number):
        of = [*self.nets, *self.nets[-6:], *4 * self.often]
        return tuple(self.rng.choices(of, k=number))

    def add_tables(self, number):
        for _ in range(number):
            inputs = tuple(dict.fromkeys(self.some(self.rng.randint(1, 3))))
            self.tables.append(
                Table(inputs, self.new(1), self.rng.randrange(1 << (1 << len(inputs))))
            )
            self.nets += self.tables[-1].outputs

    def flops(self, outputs):
        rng = self.rng
        controls = [(ONE, ZERO)]
        controls += [(rng.choice([ONE, *self.nets]), rng.choice([ZERO, *self.nets]))] * 2
        controls += [(rng.choice(self.nets), rng.choice([ZERO, *self.nets]))]
        bit = (0, 1)
        return [
            Flop(
                rng.choice(self.nets), net, *rng.choice(controls), rng.choice(bit), rng.choice(bit)
            )
            for net in outputs
        ]


def unit(rng, name):
    """Return a unit; its outputs may be registers, logic, or its inputs."""
    drawn = Drawn(rng)
    inputs = {"dark": drawn.new(2), "other": drawn.new(3)}
    registers = drawn.new(rng.randint(1, 4))
    drawn.nets += [*inputs["dark"], *inputs["other"], *registers]
    drawn.often = inputs["dark"]
    drawn.add_tables(rng.randint(2, 8))
    outputs = {"q": tuple(rng.choices(registers, k=2)), "c": tuple(rng.choices(drawn.nets, k=2))}
    return Block(name, inputs, outputs, drawn.tables, drawn.flops(registers), [], [], {})


def memory(drawn, number):
    """Return a memory that is read, and the bits of its addresses; some have no row."""
    rng = drawn.rng
    bits, width = rng.randint(1, 2), rng.randint(1, 3)
    rows = rng.randint(2, 1 << bits)
    found = Memory(f"rows_{number}", rows, width, [rng.getrandbits(width) for _ in range(rows)])
    for _ in range(rng.randint(1, 2)):
        found.reads.append(Read(found, drawn.some(bits), drawn.new(width)))
        drawn.nets += found.reads[-1].outputs
    return found, bits


def design(rng):
    """Return the blocks of a design by name: units of up to two kinds, one to three of each."""
    units = [unit(rng, name) for name in UNITS[: rng.randint(0, 2)]]
    drawn, instances, memories = Drawn(rng), [], []
    inputs, dark, registers = drawn.new(INPUTS), drawn.new(2), drawn.new(FLOPS)
    drawn.nets += [*inputs, *dark, *registers]
    drawn.often = dark
    connected = {}
    for of in units:
        flops = {flop.output for flop in of.flops}
        for k in range(rng.randint(1, 3)):
            ports = [port for port in of.outputs if port == "q" or rng.random() < 0.8]
            nets = {port: drawn.new(2) for port in ports}
            connected[of.name, k] = nets
            for port in ports:
                pairs = zip(nets[port], of.outputs[port], strict=True)
                drawn.nets += [net for net, inner in pairs if inner in flops]
    drawn.add_tables(6)
    for of in units:
        if rng.random() < 0.5:
            memories.append(memory(drawn, len(memories)))
        drawn.add_tables(4)
        before = list(drawn.nets)
        shared = tuple(rng.choices([*4 * (ZERO, ONE), *before], k=3))
        for (name, k), outputs in connected.items():
            if name == of.name:
                own = tuple(rng.choices([ZERO, ONE, *before], k=3))
                given = {"other": shared if rng.random() < 0.5 else own}
                given["dark"] = tuple(rng.choices([*dark, inputs[0], ZERO], k=2))
                instances.append(Instance(f"{name}_{k}", name, given | outputs))
        for instance in instances:
            drawn.nets += [net for net in instance.nets.get("c", ()) if net not in drawn.nets]
        drawn.add_tables(6)
    memories.append(memory(drawn, len(memories)))
    drawn.add_tables(10)
    for rows, bits in memories:
        for _ in range(rng.randint(0, 2)):
            enable = rng.choice([ONE, *drawn.nets])
            rows.stores.append(Store(drawn.some(bits), drawn.some(rows.width), enable))
    flops = drawn.flops(registers)
    for of in (drawn.tables, instances):
        rng.shuffle(of)
    ports = {"in": inputs, "dark": dark}
    outputs = {"out": tuple(rng.choices([ZERO, ONE, *drawn.nets], k=6))}
    top = Block(TOP, ports, outputs, drawn.tables, flops, [m for m, _ in memories], instances, {})
    return {of.name: of for of in (*units, top)}


class AtOnce:
    """A design by its meaning: nets are looked up, and all registers are updated at once."""

    def __init__(self, blocks):
        self.blocks, self.top = blocks, blocks[TOP]
        self.registers = {("", flop.output): flop.init for flop in self.top.flops}
        self.rows = {rows.name: list(rows.init) for rows in self.top.memories}
        self.outer, self.driver = {}, {}
        self.nodes = {("", node.outputs[0]): node for node in self.top.tables}
        for rows in self.top.memories:
            for read in rows.reads:
                self.nodes |= {("", net): (read, k) for k, net in enumerate(read.outputs)}
        for instance in self.top.instances:
            name, of = instance.name, blocks[instance.unit]
            self.registers |= {(name, flop.output): flop.init for flop in of.flops}
            self.nodes |= {(name, node.outputs[0]): node for node in of.tables}
            for port, nets in of.inputs.items():
                self.outer |= {
                    (name, inner): net for inner, net in zip(nets, instance.nets[port], strict=True)
                }
            for port, nets in instance.nets.items():
                if port in of.outputs:
                    pairs = zip(nets, of.outputs[port], strict=True)
                    self.driver |= {net: (name, inner) for net, inner in pairs}

    def get(self, net, scope=""):
        at = scope, net
        if net in (ZERO, ONE):
            return net
        if at not in self.known:
            self.known[at] = self._found(at)
        return self.known[at]

    def _found(self, at):
        scope, net = at
        if at in self.outer:
            return self.get(self.outer[at])
        if not scope and net in self.driver:
            name, inner = self.driver[net]
            return self.get(inner, name)
        node = self.nodes[at]
        if isinstance(node, Table):
            return value(node, {net: self.get(net, scope) for net in node.inputs})
        read, bit = node
        rows, row = self.rows[read.memory.name], self.number(read.inputs)
        return rows[row] >> bit & 1 if row < len(rows) else 0

    def number(self, nets):
        return sum(self.get(net) << k for k, net in enumerate(nets))

    def look(self, given):
        """Return the outputs for these inputs, net -> bit."""
        self.known = self.registers | {("", net): bit for net, bit in given.items()}
        return [self.get(net) for net in self.top.outputs["out"]]

    def step(self):
        following_ones = {
            (scope, flop.output): following(
                flop,
                *(self.get(net, scope) for net in flop.inputs),
                self.registers[scope, flop.output],
            )
            for scope, of in [("", self.top)]
            + [(one.name, self.blocks[one.unit]) for one in self.top.instances]
            for flop in of.flops
        }
        stores = [
            (self.rows[rows.name], self.number(store.address), self.number(store.data))
            for rows in self.top.memories
            for store in rows.stores
            if self.get(store.enable)
        ]
        for rows, row, number in stores:
            if row < len(rows):
                rows[row] = number
        self.registers = following_ones


class Pass:
    """A pass through the top or an instance: `places` of its nets, and values that have none."""

    def __init__(self, of, what, places, first_flag):
        self.of, self.what, self.places, self.first_flag = of, what, places, first_flag
        self.words, self.values = of.words, {}

    def play(self, ops):
        for op in ops:
            self.names = getattr(op, "names", {})
            getattr(self, type(op).__name__.lower())(op)

    def get(self, net):
        net = self.names.get(net, net)
        if net in (ZERO, ONE):
            return net
        return self.values[net] if net in self.values else self.words[self.places[net]]

    def row(self, memory, nets):
        """Return the words of the row at an address, if there is one."""
        row = sum(self.get(net) << k for k, net in enumerate(nets))
        first = self.of.layout.memories[memory.name] + row * memory.width
        return range(first, first + memory.width) if row < memory.rows else range(0)

    def copy(self, op):
        self.values[op.name] = self.words[self.places[op.net]]

    def write(self, op):
        at = self.places[op.flop.output]
        self.words[at] = following(op.flop, *map(self.get, op.flop.inputs), self.words[at])

    def guard(self, op):
        if (
            not self.get(op.reset)
            if op.enable == ONE
            else self.get(op.enable) or self.get(op.reset)
        ):
            before = dict(self.values)
            self.play(op.body)
            self.values = before
        elif op.enable == ONE:
            for flop in op.flops:
                self.words[self.places[flop.output]] = flop.reset_value

    def put(self, op):
        if self.get(op.store.enable):
            for word, net in zip(
                self.row(op.memory, op.store.address), op.store.data, strict=False
            ):
                self.words[word] = self.get(net)

    def call(self, op):
        name, emission = op.instances[0].unit, self.of.emission
        unit = emission._units[name]
        for word, net in unit.moves:
            self.words[word] = self.get(net)
        for k in range(unit.instances):
            own = unit.first_own + k * len(unit.own)
            places = {net: own + at for net, at in unit.own.items()}
            places |= {net: unit.first_shared + at for net, at in unit.shared.items()}
            flag = unit.first_flag + k * len(unit.flags)
            Pass(self.of, self.what, places, flag).play(self.of.ops[name][self.what])

    def evaluate(self, op):
        node = op.node
        if isinstance(node, Read):
            words = self.row(node.memory, node.inputs)
            found = [self.words[word] for word in words] or [0] * node.memory.width
        else:
            known = {net: self.get(net) for net in node.inputs}
            for table in node.tables if isinstance(node, DarkTables) else [node]:
                known[table.outputs[0]] = value(table, known)
            found = [known[net] for net in node.outputs]
            if isinstance(node, DarkTables) and self.first_flag + node.flag not in self.of.flags:
                found = node.dark_values
        for net, bit in zip(node.outputs, found, strict=True):
            self.values[net] = bit
            if net in self.places:
                self.words[self.places[net]] = bit


class InWords:
    """A design by its words: the operations of its passes, in their order, as `emit` writes them."""

    def __init__(self, blocks, dark):
        self.emission = Emission(blocks, TOP, dark)
        self.layout = self.emission.layout
        self.words = [0] * self.layout.words
        for word in self.layout.ones:
            self.words[word] = 1
        self.first_flag = self.layout.flags - len(_dark_fields(blocks[TOP], dark))
        self.ops = {}
        for name, block in blocks.items():
            nodes = with_dark_tables(block, _dark_fields(block, dark), blocks)
            inner = blocks if name == TOP else {}
            whole = Schedule(block, blocks, nodes, name != TOP).ops
            self.ops[name] = whole, settling(block, inner, nodes)

    def set(self, given):
        self.flags = set()
        for port, nets in self.emission.top.inputs.items():
            of = self.layout.flags_of.get(port, [[]] * len(nets))
            for net, word, flags in zip(nets, self.layout.inputs[port], of, strict=True):
                self.words[word] = given[net]
                self.flags.update(flags if given[net] else [])

    def play(self, what):
        Pass(self, what, self.layout.nets, self.first_flag).play(self.ops[TOP][what])

    def registers(self):
        """Return register -> bit, and memory -> rows, as `AtOnce` has them."""
        top = self.emission.top
        found = {("", flop.output): self.words[self.layout.nets[flop.output]] for flop in top.flops}
        for instance in top.instances:
            places = self.layout.instances[instance.name]
            for flop in self.emission.blocks[instance.unit].flops:
                found[instance.name, flop.output] = self.words[places[flop.output]]
        rows = {}
        for of in top.memories:
            first, width = self.layout.memories[of.name], of.width
            bits = [self.words[first + row * width :][:width] for row in range(of.rows)]
            rows[of.name] = [sum(bit << k for k, bit in enumerate(row)) for row in bits]
        return found, rows


@pytest.mark.parametrize("guard_min", [2, 12])
@pytest.mark.parametrize("first", range(0, 100, 25))
def test_any_design_in_words_is_the_design_at_once(guard_min, first, monkeypatch):
    """Registers, rows and outputs, also those of units that only pass an input on."""
    monkeypatch.setattr(schedule, "GUARD_MIN", guard_min)
    for seed in range(first, first + 25):
        rng = random.Random(seed)
        blocks = design(rng)
        dark = [DarkInput(name, "dark", rng.randint(1, 2)) for name in blocks if rng.random() < 0.7]
        in_words, at_once = InWords(blocks, dark), AtOnce(blocks)
        for cycle in range(CYCLES):
            given = {net: rng.getrandbits(1) for net in blocks[TOP].inputs["in"]}
            given |= {net: int(rng.random() < 0.3) for net in blocks[TOP].inputs["dark"]}
            expected = at_once.look(given)
            in_words.set(given)
            in_words.play(SETTLE)
            shown = [in_words.words[word] for word in in_words.layout.outputs["out"]]
            assert shown == expected, (seed, cycle)
            at_once.step()
            in_words.play(PASS)
            assert in_words.registers() == (at_once.registers, at_once.rows), (seed, cycle)
