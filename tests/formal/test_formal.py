# SPDX-License-Identifier: Apache-2.0
"""The prover: a proof that holds, one that does not, a vacuous one, and the solver's parser of
commands.
"""

import re
from functools import partial

import pytest
from amaranth.hdl import Mux, Signal

from coincid.formal.proof_bench import PROOFS, Bench, Proof
from coincid.formal.prove import prove
from coincid.formal.solver import commands

from ..command import assert_refused, command


def _counter(highest, reached):
    b, count = Bench(), Signal(4)
    b.m.d.sync += count.eq(count + 1)
    with b.m.If(count == 9):
        b.m.d.sync += count.eq(0)
    b.always(count <= highest)
    b.cover(count == reached)
    return b.m


@pytest.mark.parametrize(
    "highest, reached, complaint",
    [(9, 9, None), (8, 3, "Assert failed"), (9, 12, "Unreached cover")],
)
def test_verdicts(monkeypatch, highest, reached, complaint):
    name = f"counter_{highest}_{reached}"
    monkeypatch.setitem(
        PROOFS, name, Proof(name, "A counter.", partial(_counter, highest, reached), 2, 14)
    )
    (verdict,) = prove([name])
    assert (verdict.statements, verdict.situations) == (1, 1)
    assert complaint in verdict.reason if complaint else not verdict.reason


def _never_twelve():
    """Return a module with a counter of 0 to 9, and what is stated of a number beyond."""
    b, count = Bench(), Signal(4)
    b.m.d.sync += count.eq(Mux(count == 9, 0, count + 1))
    b.always(count != 12)
    b.cover(count == 3)
    return b.m


def test_a_statement_that_holds_but_lacks_an_invariant_is_told_as_such(monkeypatch):
    """Only its induction fails: 11 would lead to 12, and no state that is reached to 11."""
    monkeypatch.setitem(PROOFS, "twelve", Proof("twelve", "A counter.", _never_twelve, 2, 14))
    (verdict,) = prove(["twelve"])
    assert verdict.reason.startswith("induction: Assert failed")


def _stated(state):
    """Return a module with a counter and what is stated of it."""
    bench = Bench()
    count = Signal(4)
    bench.m.d.sync += count.eq(count + 1)
    bench.cover(count == 3)
    state(bench, count)
    return bench.m


WRONG = {  # of a counter
    "always": lambda bench, count: bench.always(count == 0),
    "past": lambda bench, count: bench.always(bench.past(count, 2) == count, where=count > 2),
    "stable": lambda bench, count: bench.stable(count, where=count == 5),
    "cover": lambda bench, count: bench.cover(bench.past(count) == count + 1),
}


@pytest.mark.parametrize("name", WRONG)
def test_what_a_bench_states_of_a_counter_fails_if_it_is_wrong(monkeypatch, name):
    build = partial(_stated, WRONG[name])
    wrong = f"wrong_{name}"  # a folder of its own
    monkeypatch.setitem(PROOFS, wrong, Proof(wrong, "", build, 2, 14))
    (verdict,) = prove([wrong])
    assert re.search("Assert failed|Unreached cover", verdict.reason)


def test_a_proof_that_does_not_end_does_not_hold(monkeypatch):
    monkeypatch.setattr("coincid.formal.prove.SECONDS_MAX", 0)
    proof = Proof("endless", "A counter.", partial(_counter, 9, 9), 2, 14)
    monkeypatch.setitem(PROOFS, "endless", proof)
    (verdict,) = prove(["endless"])
    assert verdict.reason and " FAILS " in str(verdict)


def test_the_command_runs_the_proofs_that_are_named(monkeypatch):
    """Or all of them, which takes long; a proof that fails is an exit code and a sentence."""
    asked = []

    def prove_none(names, tell):
        asked.append(list(names))
        return []

    monkeypatch.setattr("coincid.formal.prove.prove", prove_none)
    assert command("formal dpcu tree").exit_code == 0
    assert command("formal").exit_code == 0
    assert asked == [["dpcu", "tree"], []]


def test_unknown_proof():
    assert_refused(command("formal nothing"), "nothing")


def test_commands_end_where_parentheses_balance():
    lines = ["; a (comment\n", "(assert (= |a(| ; )\n", "b))\n", "(check-sat)\n"]
    assert list(commands(lines)) == [
        "; a (comment\n",
        "(assert (= |a(| ; )\nb))\n",
        "(check-sat)\n",
    ]
