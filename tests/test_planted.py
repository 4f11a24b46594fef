# SPDX-License-Identifier: Apache-2.0
"""The list of planted bugs agrees with the sources."""

import pytest

from coincid.formal.proof_bench import PROOFS
from coincid.formal.prove import all_proofs

from .planted import BUGS, ROOT


@pytest.mark.parametrize("bug", BUGS, ids=lambda bug: bug.name)
def test_planted_bugs_fit(bug):
    assert (ROOT / bug.file).read_text(encoding="utf-8").count(bug.old) == 1
    assert bug.old != bug.new and (bug.proofs or bug.tests)
    assert set(bug.proofs) <= all_proofs().keys()


def test_proofs_of_all_rooms_are_registered_once():
    proofs = all_proofs()
    assert proofs is PROOFS and len(proofs) >= 30
    assert {"tree", "async_one_bank", "deframer"} <= proofs.keys()
