# SPDX-License-Identifier: Apache-2.0
"""Combinational helpers, mostly of logarithmic depth.

Each names its intermediate values, so nothing is emitted twice.
"""

from collections.abc import Callable

from amaranth.hdl import Cat, Const, Module, Mux, Signal, Value
from amaranth.utils import exact_log2

LOW_BITS = 4  # of a counter: the other bits, and their clock, rest in 15 of 16 counts
SUM_PART = 11  # bits through which a carry of `carry_select` ripples


def tree(
    m: Module, items: list[Value], combine: Callable[[Value, Value], Value], name: str
) -> Value:
    """Combine `items` pairwise until one is left; the depth is log2 of their number."""
    items = [Value.cast(item) for item in items]
    level = 0
    while len(items) > 1:
        pairs = []
        for i in range(0, len(items) - 1, 2):
            value = combine(items[i], items[i + 1])
            node = Signal(value.shape(), name=f"{name}_{level}_{i // 2}")
            m.d.comb += node.eq(value)
            pairs.append(node)
        items = pairs + items[len(items) & ~1 :]
        level += 1
    return items[0]


def any_of(m: Module, items: list[Value], name: str) -> Value:
    """Return the OR of equally wide values."""
    return tree(m, items, lambda a, b: a | b, name)


def item_of(m: Module, index: Value, items: list[Value], name: str) -> Value:
    """Return `items[index]` of equally wide values, without priorities; 0 if there is none."""
    own = [item & (index == k).replicate(len(item)) for k, item in enumerate(items)]
    return any_of(m, own, name)


def total(m: Module, numbers: list[Value], name: str) -> Value:
    """Return the sum of numbers, by an adder tree."""
    return tree(m, numbers, lambda a, b: a + b, name)


def popcount(m: Module, bits: Value, name: str) -> Value:
    """Return the number of ones, by an adder tree."""
    return total(m, list(bits), name)


def up_to(m: Module, bits: Value, name: str) -> Signal:
    """Return a signal whose bit k says whether any of bits 0...k is one."""
    step = 1
    value = bits
    while step < len(bits):
        wider = Signal(len(bits), name=f"{name}_{step}")
        m.d.comb += wider.eq(value | (value << step))
        value = wider
        step *= 2
    return value


def counted(m: Module, bits: Value, name: str) -> list[Value]:
    """Return whether at least one, two and three of some bits are ones.

    Bit i of a step's words covers the 2 ** k bits from i on. Whole words cost simulators little.
    Only the gates of bit 0 of the last words remain after synthesis.
    """
    found = [bits, Const(0, len(bits)), Const(0, len(bits))]
    step = 1
    while step < len(bits):
        one, two, three = found
        next_one, next_two, next_three = (word >> step for word in found)
        words = [
            one | next_one,
            two | next_two | (one & next_one),
            three | next_three | (two & next_one) | (one & next_two),
        ]
        found = [Signal(len(bits), name=f"{name}_{step}_{k}") for k in range(3)]
        m.d.comb += [signal.eq(word) for signal, word in zip(found, words, strict=True)]
        step *= 2
    return [word[0] for word in found]


def lowest(m: Module, bits: Value, name: str) -> Value:
    """Return the index of the lowest one of `bits`, a power of two of them; if there is none, the
    last index.

    It is faster than `first_one`. It computes with whole words, as `counted` does.
    """
    found: Value = bits
    numbers: list[Value] = []
    for k in range(exact_log2(len(bits))):
        step = 1 << k
        size = len(bits)
        numbers = [(found & number) | (~found & (number >> step)) for number in numbers] + [~found]
        signals = [Signal(size, name=f"{name}_{step}_{b}") for b in range(k + 1)]
        here = Signal(size, name=f"{name}_{step}")
        m.d.comb += [
            *(signal.eq(number) for signal, number in zip(signals, numbers, strict=True)),
            here.eq(found | (found >> step)),
        ]
        found = here
        numbers = signals
    return Cat(number[0] for number in numbers)


def first_one(m: Module, bits: Value, name: str) -> tuple[Value, Value]:
    """Return whether `bits`, a power of two of them, holds a one, and the index of the lowest (if
    none, the last index).
    """
    index: list[Value] = []
    part = bits
    while len(part) > 1:
        half = len(part) // 2
        in_low = Signal(name=f"{name}_low_{half}")
        rest = Signal(half, name=f"{name}_of_{half}")
        m.d.comb += [in_low.eq(part[:half].any()), rest.eq(Mux(in_low, part[:half], part[half:]))]
        index.insert(0, ~in_low)
        part = rest
    return part[0], Cat(index)


def carry_select(m: Module, a: Value, b: Value, name: str) -> Value:
    """Return a + b with a carry out.

    Parts of `SUM_PART` bits are added for both carries; then the real carry selects.
    """
    parts = []
    carry = Value.cast(0)
    for begin in range(0, max(len(a), len(b)), SUM_PART):
        x = a[begin : begin + SUM_PART]
        y = b[begin : begin + SUM_PART]
        part = Signal(max(len(x), len(y)) + 1, name=f"{name}_{begin}")
        if begin:
            without = Signal.like(part, name_suffix="_0")
            with_one = Signal.like(part, name_suffix="_1")
            m.d.comb += [
                without.eq(x + y),
                with_one.eq((Cat(1, x) + Cat(1, y))[1:]),
                part.eq(Mux(carry, with_one, without)),
            ]
        else:
            m.d.comb += part.eq(x + y)
        parts.append(part[:-1])
        carry = part[-1]
    return Cat(*parts, carry)


def least(m: Module, numbers: list[Value], name: str) -> Value:
    """Return the lowest of some numbers."""
    return tree(m, numbers, lambda a, b: Mux(a < b, a, b), name)


def saturating_add(m: Module, counter: Signal, amount: Value) -> None:
    """Add `amount` to `counter` at the clock, and saturate."""
    total = Signal(len(counter) + 1, name=f"{counter.name}_next")
    amount = Value.cast(amount)
    wide = 2 * len(amount) > len(counter)
    m.d.comb += total.eq(
        carry_select(m, counter, amount, f"{counter.name}_sum") if wide else counter + amount
    )
    m.d.sync += counter.eq(Mux(total[-1], ~0, total))


def count_up(m: Module, counter: Signal, strobe: Value) -> None:
    """Add `strobe` to `counter` at the clock, and saturate.

    The low and the high bits have separate enables.
    """
    low = counter[:LOW_BITS]
    high = counter[LOW_BITS:]
    counts = Signal(name=f"{counter.name}_counts")
    m.d.comb += counts.eq(strobe & ~counter.all())
    with m.If(counts):
        m.d.sync += low.eq(low + 1)
    with m.If(counts & low.all()):
        m.d.sync += high.eq(high + 1)
