# SPDX-License-Identifier: Apache-2.0
"""Any netlist, updated in place in the order of its schedule, takes the step that all registers
take at once.
"""

import random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from coincid.slices import schedule
from coincid.slices.netlist import ONE, ZERO, Block, Flop, Table
from coincid.slices.schedule import (
    Copy,
    DarkTables,
    Evaluate,
    Guard,
    Op,
    Schedule,
    Write,
    with_dark_tables,
)

INPUTS, FLOPS, TABLES = 8, 40, 60
DARK = 4  # inputs that are mostly dark


def random_block(rng: random.Random) -> Block:
    """Return a block whose flip-flops share few enables and resets, which may be registers of the
    same group.
    """
    inputs = tuple(range(2, 2 + INPUTS))
    outputs = list(range(100, 100 + FLOPS))
    nets, tables = [*inputs, *outputs], []
    for k in range(TABLES):
        chosen = tuple(rng.sample(nets, rng.randint(1, 3)))
        tables.append(Table(chosen, (200 + k,), rng.randrange(1, (1 << (1 << len(chosen))) - 1)))
        nets.append(200 + k)
    controls = [(rng.choice([ONE, *nets]), rng.choice([ZERO, ZERO, *nets])) for _ in range(4)]
    flops = []
    for output in outputs:
        enable, reset = rng.choice(controls)
        flops.append(Flop(rng.choice(nets), output, enable, reset, rng.randint(0, 1)))
    return Block("any", {"in": inputs}, {"out": tuple(outputs[:3])}, tables, flops, [], [], {})


def value(table: Table, of: dict[int, int]) -> int:
    return table.bits >> sum(of[net] << k for k, net in enumerate(table.inputs)) & 1


def following(flop: Flop, data: int, enable: int, reset: int, now: int) -> int:
    return flop.reset_value if reset else data if enable else now


def step(block: Block, now: dict[int, int]) -> dict[int, int]:
    """Return the registers after an edge, all at once."""
    known = now | {ZERO: 0, ONE: 1}
    for table in block.tables:
        known[table.outputs[0]] = value(table, known)
    return {
        f.output: following(f, *(known[net] for net in f.inputs), known[f.output])
        for f in block.flops
    }


def play(ops: list[Op], words: dict[int, int], flags: set[int]) -> None:
    """Do the operations on the words, in their order; a guard or a DarkTables that does not apply
    is skipped.
    """

    def named(op, nets):
        return {net: words[op.names.get(net, net)] for net in nets}

    for op in ops:
        if isinstance(op, Copy):
            words[op.name] = words[op.net]
        elif isinstance(op, Write):
            of = named(op, op.flop.inputs)
            words[op.flop.output] = following(
                op.flop, *(of[n] for n in op.flop.inputs), words[op.flop.output]
            )
        elif isinstance(op, Guard):
            of = named(op, (op.enable, op.reset))
            if of[op.enable] or of[op.reset] if op.enable != ONE else not of[op.reset]:
                play(list(op.body), words, flags)
            elif op.enable == ONE:
                words |= {flop.output: flop.reset_value for flop in op.flops}
        elif isinstance(op, Evaluate) and isinstance(op.node, DarkTables):
            inner = named(op, op.node.inputs)
            for table in op.node.tables:
                inner[table.outputs[0]] = value(table, inner)
            for net, dark_value in zip(op.node.outputs, op.node.dark_values, strict=True):
                words[net] = inner[net] if op.node.flag in flags else dark_value
        elif isinstance(op, Evaluate) and isinstance(op.node, Table):
            words[op.node.outputs[0]] = value(op.node, named(op, op.node.inputs))


@pytest.mark.parametrize("guard_min", [2, 12])
@settings(max_examples=150, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_updates_in_place_equal_all_at_once(guard_min, seed):
    rng = random.Random(seed)
    block = random_block(rng)
    (inputs,) = block.inputs.values()
    dark_fields = [(k, frozenset(inputs[k : k + 2])) for k in range(0, DARK, 2)] + [
        (1, frozenset(inputs[:DARK]))
    ]
    flags = list(enumerate(nets for _, nets in dark_fields))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(schedule, "GUARD_MIN", guard_min)
        ops = Schedule(block, {}, with_dark_tables(block, flags)).ops
    words = {flop.output: rng.randint(0, 1) for flop in block.flops} | {ZERO: 0, ONE: 1}
    for _ in range(8):
        words |= {net: rng.randint(0, 1) & rng.randint(0, 1) for net in inputs}
        expected = step(block, words)
        play(ops, words, {flag for flag, nets in flags if any(words[net] for net in nets)})
        assert {output: words[output] for output in expected} == expected


@pytest.mark.parametrize("seed", range(20))
def test_each_node_comes_after_those_that_it_reads(seed):
    """Whatever the order in a netlist, and whichever of several outputs is read."""
    rng = random.Random(seed)
    nodes, nets = [], list(range(2, 6))
    for k in range(20):
        inputs = tuple(rng.sample(nets, rng.randint(1, 3)))
        outputs = tuple(range(100 + 10 * k, 100 + 10 * k + rng.randint(1, 3)))
        if len(outputs) == 1:
            nodes.append(Table(inputs, outputs, 1))
        else:
            nodes.append(DarkTables(0, inputs, outputs, (0,) * len(outputs), ()))
        nets += outputs
    shuffled = rng.sample(nodes, len(nodes))
    ordered = schedule.in_order(shuffled)
    assert sorted(map(id, ordered)) == sorted(map(id, nodes))
    known = set(range(2, 6))
    for node in ordered:
        assert known.issuperset(node.inputs)
        known |= set(node.outputs)
