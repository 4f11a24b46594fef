# SPDX-License-Identifier: Apache-2.0
"""The list of planted bugs agrees with the sources, and the mutators do mutate."""

import ast

import pytest

from coincid.formal import prove as prover
from coincid.formal.proof_bench import PROOFS

from .mutation import GOLDEN_SOURCES, golden_mutant, golden_mutants
from .planted import BUGS, ROOT


@pytest.mark.parametrize("bug", BUGS, ids=lambda bug: bug.name)
def test_planted_bugs_fit(bug):
    assert (ROOT / bug.file).read_text().count(bug.old) == 1
    assert bug.old != bug.new and (bug.proofs or bug.tests)
    assert set(bug.proofs) <= PROOFS.keys()


def test_proofs_are_registered_once():
    assert prover.PROOFS is PROOFS and len(PROOFS) >= 15


def test_golden_mutants_differ():
    total, changed = golden_mutants(), set()
    assert total > 300
    for number in range(0, total, 40):
        module, text, what = golden_mutant(number)
        assert what and text != ast.unparse(ast.parse(GOLDEN_SOURCES[module].read_text()))
        changed.add(module)
    assert len(changed) > 2
    assert golden_mutant(total) == ("", "", "")
