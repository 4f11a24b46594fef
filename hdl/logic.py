"""Log-depth combinational helpers. Each names its intermediate values, so that nothing is emitted twice."""

from collections.abc import Callable

from amaranth.hdl import Cat, Module, Mux, Signal, Value


def tree(m: Module, items: list[Value], combine: Callable[[Value, Value], Value], name: str) -> Value:
    """Combines `items` pairwise until one is left: depth log2 of their number."""
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
    """OR of equally wide values."""
    return tree(m, items, lambda a, b: a | b, name)


def total(m: Module, numbers: list[Value], name: str) -> Value:
    """Sum of numbers, by an adder tree."""
    return tree(m, numbers, lambda a, b: a + b, name)


def popcount(m: Module, bits: Value, name: str) -> Value:
    """Number of ones, by an adder tree."""
    return total(m, list(bits), name)


def up_to(m: Module, bits: Value, name: str) -> Signal:
    """Bit k of the result: any of bits 0...k."""
    step, value = 1, bits
    while step < len(bits):
        wider = Signal(len(bits), name=f"{name}_{step}")
        m.d.comb += wider.eq(value | (value << step))
        value, step = wider, 2 * step
    return value


def lowest(m: Module, bits: Value, name: str) -> Signal:
    """One-hot: the lowest one of `bits`; 0 where there is none."""
    below = up_to(m, bits, f"{name}_upto")
    result = Signal(len(bits), name=name)
    m.d.comb += result.eq(below & ~(below << 1))
    return result


def encode(m: Module, one_hot: Value, name: str) -> Value:
    """Index of the one in `one_hot`; 0 where there is none."""
    width = max(1, (len(one_hot) - 1).bit_length())
    return Cat(
        any_of(m, [bit for k, bit in enumerate(one_hot) if k >> b & 1] or [0], f"{name}_{b}") for b in range(width)
    )


def saturating_add(m: Module, counter: Signal, amount: Value) -> None:
    """Adds `amount` to `counter` at the clock, to its highest value at most."""
    total = Signal(len(counter) + 1, name=f"{counter.name}_next")
    m.d.comb += total.eq(counter + amount)
    m.d.sync += counter.eq(Mux(total[-1], ~0, total))
