# SPDX-License-Identifier: Apache-2.0
"""The list of planted bugs agrees with the sources."""

import pytest

from coincid.board import proofs as proofs  # registers the emulator's proofs
from coincid.formal import prove as prover
from coincid.formal.proof_bench import PROOFS

from .planted import BUGS, ROOT


@pytest.mark.parametrize("bug", BUGS, ids=lambda bug: bug.name)
def test_planted_bugs_fit(bug):
    assert (ROOT / bug.file).read_text(encoding="utf-8").count(bug.old) == 1
    assert bug.old != bug.new and (bug.proofs or bug.tests)
    assert set(bug.proofs) <= PROOFS.keys()


def test_proofs_are_registered_once():
    assert prover.PROOFS is PROOFS and len(PROOFS) >= 15
