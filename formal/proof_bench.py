# SPDX-License-Identifier: Apache-2.0
"""Bench for writing proofs.

A proof is a function that puts a block into a module, drives its inputs with everything that the
contract allows, and states what must hold. Reset is an input like any other, so proofs hold for a
reset in any cycle. About the state at power-on, the only assumption is that reset is asserted in
the first cycle, so a missing reset shows as well.
"""

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, TypeVar

from amaranth.hdl import Assert, Assume, Cover, Fragment, Module, ResetSignal, Signal, Value
from amaranth.hdl._ast import AnyConst, AnySeq  # Amaranth has no other names for free values
from attrs import field, frozen

from ..hdl.unit import Unit

KEPT = "bench_"  # with which the names of registers begin that keep their value at power-on
Placed = TypeVar("Placed", bound=Unit)
PROOFS: dict[str, "Proof"] = {}


@frozen
class Proof:
    """What is proven, and how.

    build: returns the module; depth: of the induction; cover: steps within which every covered
    situation occurs; models: Verilog of cells, whose outputs may have any value; script: further
    commands of Yosys.
    """

    name: str
    states: str
    build: Callable[[], Module] = field(repr=False)
    depth: int
    cover: int
    models: Sequence[Path] = ()
    script: str = ""


def proof(depth: int = 2, cover: int = 10):
    """Register a function of a `Bench` as a proof, under its name.

    The first paragraph of its docstring is the statement.
    """

    def register(build):
        def module():
            bench = Bench()
            build(bench)
            return bench.m

        name = build.__name__
        first_paragraph = build.__doc__.partition("\n\n")[0]
        states = " ".join(first_paragraph.split())
        PROOFS[name] = Proof(name, states, module, depth, cover)
        return build

    return register


class Bench:
    """A proof under construction: `m` is its module."""

    def __init__(self):
        self.m = Module()
        self.started = Signal(reset_less=True, name=f"{KEPT}started")
        self.m.d.sync += self.started.eq(1)
        self.m.d.comb += Assume(self.started | ResetSignal())

    def always(self, condition, where=None) -> None:
        """State that `condition` holds wherever `where` does, from the first reset on."""
        given = self.started if where is None else self.started & Value.cast(where).bool()
        self.m.d.comb += Assert(~given | Value.cast(condition).bool(), src_loc_at=1)

    def assume(self, condition, where=None) -> None:
        """Restrict the inputs."""
        given = self.started if where is None else self.started & Value.cast(where).bool()
        self.m.d.comb += Assume(~given | Value.cast(condition).bool(), src_loc_at=1)

    def cover(self, condition) -> None:
        """State that `condition` occurs."""
        self.m.d.comb += Cover(
            self.started & ~ResetSignal() & Value.cast(condition).bool(), src_loc_at=1
        )

    def past(self, value, cycles: int = 1):
        """Return `value` as it was `cycles` ago; 0 across a reset."""
        for _ in range(cycles):
            value = Value.cast(value)
            later = Signal(value.shape(), name="past")
            self.m.d.sync += later.eq(value)
            value = later
        return value

    def last(self, value):
        """Return `value` as it was one cycle ago, even across a reset."""
        value = Value.cast(value)
        later = Signal(value.shape(), name="last", reset_less=True)
        self.m.d.sync += later.eq(value)
        return later

    def stable(self, value, where) -> None:
        """State that `value` has not changed since the previous cycle, if `where` held there and
        there was no reset.
        """
        held = self.last(Value.cast(where).bool() & ~ResetSignal() & self.started)
        self.m.d.comb += Assert(~(held & self.started) | (value == self.last(value)), src_loc_at=1)

    def assume_stable(self, value, where) -> None:
        """Restrict an input to its value in the previous cycle if `where` holds now."""
        self.m.d.comb += Assume(
            ~(self.started & Value.cast(where).bool()) | (value == self.last(value)), src_loc_at=1
        )

    def same(self, name: str, value) -> Signal:
        """Return `value` under a name, computed once."""
        value = Value.cast(value)
        signal = Signal(value.shape(), name=name)
        self.m.d.comb += signal.eq(value)
        return signal

    def anything(self, shape):
        """Return an input that may have any value in any cycle."""
        return AnySeq(shape)

    def vary(self, *signals) -> None:
        """Let inputs have any value in any cycle."""
        for signal in map(Value.cast, signals):
            self.m.d.comb += signal.eq(self.anything(len(signal)))

    def constant(self, shape):
        """Return an input that may have any value, but the same in all cycles."""
        return AnyConst(shape)

    def place(self, unit: Placed, **inputs) -> Placed:
        """Place a unit and return it. Its inputs get the values in `inputs` (None: no driver), or
        else any value.
        """
        for path, member, value in unit.signature.flatten(unit):
            port = "__".join(map(str, path))
            if member.flow.name == "In" and inputs.get(port, "") is not None:
                value = Value.cast(value)
                self.m.d.comb += value.eq(
                    inputs.pop(port) if port in inputs else self.anything(len(value))
                )
            inputs.pop(port, None)
        assert not inputs, f"no such ports: {', '.join(inputs)}"
        self.m.submodules += unit
        elaborated(unit)
        return unit

    def drive(self, unit: Unit, name: str, **inputs) -> Fragment:
        """Place a unit under a name, and return it elaborated, for `registers_in`. Its inputs get
        the values in `inputs`, by the names of its ports, or else any value.
        """
        for port, (flow, signal) in unit.flat_ports().items():
            if flow.name == "In":
                self.m.d.comb += signal.eq(
                    inputs.pop(port) if port in inputs else self.anything(len(signal))
                )
        assert not inputs, f"no such ports: {', '.join(inputs)}"
        fragment = Fragment.get(unit, None)
        self.m.submodules[name] = fragment
        return fragment

    def free(self, unit: Any) -> dict[str, Signal]:
        """Let the outputs of a unit inside another one have any value in any cycle, and return them
        by name.
        """
        m, outputs = Module(), unit.outputs()
        m.d.comb += [output.eq(self.anything(len(output))) for output in outputs.values()]
        unit.elaborate = lambda platform: m
        return outputs


def elaborated(component) -> Module:
    """Elaborate `component` now, once and for all, so that its state belongs to the circuit of the
    design.
    """
    body = component.elaborate(None)
    component.elaborate = lambda platform: body
    return body


def parts_of(fragment: Fragment) -> Iterator[Fragment]:
    """Yield a part of an elaborated design and all parts inside it."""
    yield fragment
    for inner, _, _ in fragment.subfragments:
        yield from parts_of(inner)


def registers_in(fragment: Fragment) -> list[Signal]:
    """Return the registers of an elaborated block, in an order that depends on its source only."""
    found: dict[int, Signal] = {}
    for part in parts_of(fragment):
        for domain, statements in part.statements.items():
            if domain != "comb":
                found |= {
                    id(signal): signal
                    for statement in statements
                    for signal in statement._lhs_signals()
                }
    return list(found.values())
