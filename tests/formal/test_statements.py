# SPDX-License-Identifier: Apache-2.0
"""What is proven changes only on purpose."""

import pytest
from amaranth.hdl import Module, Signal

from coincid.formal.proof_bench import Bench, Proof
from coincid.formal.prove import all_proofs

from ..digests import read_digests
from .statements import DIGESTS, digest_of, statements_of

EXPECTED = dict(read_digests(DIGESTS))


def test_every_proof_has_its_digest():
    assert sorted(all_proofs()) == sorted(EXPECTED)


@pytest.mark.parametrize("name", EXPECTED)
def test_a_proof_states_assumes_and_covers_the_same(name):
    assert digest_of(all_proofs()[name]) == EXPECTED[name]


def test_every_proof_states_something():
    for name, proof in all_proofs().items():
        stated = [text for part in statements_of(proof) for of in part.values() for text in of]
        for kind in ("assert", "assume", "cover"):
            assert any(text.startswith(f"({kind} ") for text in stated), (name, kind)


CHANGES = {
    "nothing": lambda b, x, y: None,
    "statement": lambda b, x, y: b.always(x < y),
    "one beyond": lambda b, x, y: b.always(x <= y),
    "another signal": lambda b, x, y: b.always(y < x),
    "where": lambda b, x, y: b.always(x < y, where=y != 0),
    "assumption": lambda b, x, y: b.assume(x < y),
    "situation": lambda b, x, y: b.cover(x < y),
    "before": lambda b, x, y: b.always(b.past(x) < y),
    "before across a reset": lambda b, x, y: b.always(b.last(x) < y),
    "one of two with a name": lambda b, x, y: b.always(_first(b.past(x), b.past(y)) < y),
    "the other of two": lambda b, x, y: b.always(_first(*reversed([b.past(x), b.past(y)])) < y),
    "register": lambda b, x, y: b.always(_copy(b, x, 3) < y),
    "narrow register": lambda b, x, y: b.always(_copy(b, x, 2) < y),
    "register with a first value": lambda b, x, y: b.always(_copy(b, x, 3, init=1) < y),
    "register without a reset": lambda b, x, y: b.always(_copy(b, x, 3, reset_less=True) < y),
    "free output": lambda b, x, y: _put_inside(b, x, b.anything(3)),
    "constant output": lambda b, x, y: _put_inside(b, x, b.constant(3)),
}


def _first(one, other):
    return one


def _copy(bench, of, width, **how):
    """Return a register that holds what a signal was one cycle ago."""
    copy = Signal(width, name="copy", **how)
    bench.m.d.sync += copy.eq(of)
    return copy


def _put_inside(bench, output, value):
    """Drive a signal inside a module of the bench."""
    bench.m.submodules.inner = inner = Module()
    inner.d.comb += output.eq(value)


def test_no_change_of_a_proof_keeps_its_digest():
    """Neither of what it states nor of how it is proven."""

    def proof(change, depth=2, cover=10, **how):
        def build():
            bench = Bench()
            x, y = Signal(3, name="x"), Signal(3, name="y")
            change(bench, x, y)
            return bench.m

        return Proof("some", "", build, depth, cover, **how)

    proofs = [*map(proof, CHANGES.values()), proof(CHANGES["nothing"], depth=3)]
    proofs += [proof(CHANGES["nothing"], cover=11), proof(CHANGES["nothing"], script="opt")]
    assert len({digest_of(one) for one in proofs}) == len(proofs)
    assert digest_of(proof(CHANGES["where"])) == digest_of(proof(CHANGES["where"]))
