# SPDX-License-Identifier: Apache-2.0
"""Combinational helpers of the RTL, against Python's integers."""

import random

import pytest
from amaranth.hdl import Cat, Module, Signal
from amaranth.sim import Simulator

from coincid.hdl import logic

SEED = 1
CASES = 200
EIGHT_NUMBERS = [4] * 8
SEVEN_NUMBERS = [6] * 7


def index_of_lowest(number, width):
    return next((i for i in range(width) if number >> i & 1), width - 1)


def at_least(number):
    """Return a number whose bits say whether at least one, two and three bits are ones."""
    return sum(1 << k for k in range(3) if number.bit_count() > k)


HELPERS = {  # name: widths of the inputs, the circuit, and what it computes
    "any": (SEVEN_NUMBERS, lambda m, a: logic.any_of(m, a, "x"), lambda a: or_of(a)),
    "item": (
        [3, *SEVEN_NUMBERS],
        lambda m, a: logic.item_of(m, a[0], a[1:], "x"),
        lambda a: (*a[1:], 0)[a[0]],
    ),
    "total": (SEVEN_NUMBERS, lambda m, a: logic.total(m, a, "x"), sum),
    "popcount": ([13], lambda m, a: logic.popcount(m, a[0], "x"), lambda a: a[0].bit_count()),
    "up to": (
        [13],
        lambda m, a: logic.up_to(m, a[0], "x"),
        lambda a: sum(1 << k for k in range(13) if a[0] & (2 << k) - 1),
    ),
    "counted": (
        [13],
        lambda m, a: Cat(logic.counted(m, a[0], "x")),
        lambda a: at_least(a[0]),
    ),
    "lowest": (
        [16],
        lambda m, a: logic.lowest(m, a[0], "x"),
        lambda a: index_of_lowest(a[0], 16),
    ),
    "first one": (
        [16],
        lambda m, a: Cat(*logic.first_one(m, a[0], "x")),
        lambda a: (a[0] > 0) | index_of_lowest(a[0], 16) << 1,
    ),
    "wide sum": ([32, 32], lambda m, a: logic.carry_select(m, *a, "x"), sum),
    "wide and narrow": ([32, 9], lambda m, a: logic.carry_select(m, *a, "x"), sum),
    "narrow sum": ([9, 9], lambda m, a: logic.carry_select(m, *a, "x"), sum),
    "least": (EIGHT_NUMBERS, lambda m, a: logic.least(m, a, "x"), min),
}


def or_of(numbers):
    found = 0
    for number in numbers:
        found |= number
    return found


def drawn(widths, rng):
    """Return numbers of these widths, often with few or with nearly all bits."""
    numbers = []
    for width in widths:
        sparse = rng.getrandbits(width) & rng.getrandbits(width) & rng.getrandbits(width)
        full = (1 << width) - 1
        numbers.append(rng.choice([0, full, sparse, full ^ sparse, rng.getrandbits(width)]))
    return numbers


@pytest.mark.parametrize("name", HELPERS)
def test_a_helper_computes_what_python_does(name):
    widths, circuit, law = HELPERS[name]
    m = Module()
    inputs = [Signal(width, name=f"input_{k}") for k, width in enumerate(widths)]
    made = circuit(m, inputs)
    out = Signal(len(made))
    m.d.comb += out.eq(made)
    rng = random.Random(SEED)

    async def bench(context):
        for _ in range(CASES):
            numbers = drawn(widths, rng)
            for signal, number in zip(inputs, numbers, strict=True):
                context.set(signal, number)
            await context.delay(1e-9)
            assert context.get(out) == law(numbers), numbers

    simulator = Simulator(m)
    simulator.add_testbench(bench)
    simulator.run()


@pytest.mark.parametrize("steps", [(1, 1, 1), (0, 1, 1), (3, 2, 3)])
def test_counters_stay_at_their_end(steps):
    m = Module()
    sums, counts = Signal(5), Signal(5)
    amount, strobe = Signal(2), Signal()
    logic.saturating_add(m, sums, amount)
    logic.count_up(m, counts, strobe)
    end = 31

    async def bench(context):
        total = number = 0
        for cycle in range(60):
            step = steps[cycle % len(steps)]
            context.set(amount, step)
            context.set(strobe, step > 0)
            await context.tick()
            total = min(end, total + step)
            number = min(end, number + (step > 0))
            assert (context.get(sums), context.get(counts)) == (total, number)
        assert total == number == end

    simulator = Simulator(m)
    simulator.add_clock(1e-9)
    simulator.add_testbench(bench)
    simulator.run()
