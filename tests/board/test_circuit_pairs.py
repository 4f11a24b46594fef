# SPDX-License-Identifier: Apache-2.0
"""The circuit of an emulator changes only on purpose, for every pair of what can be built."""

import pytest

from ..digests import read_digests
from .circuit_pairs import CASES, DIGESTS, digests_of

EXPECTED = read_digests(DIGESTS)


def test_every_case_has_its_digests():
    assert len(EXPECTED) == len(CASES)


@pytest.mark.parametrize("number", range(len(CASES)))
def test_the_same_blocks(number):
    assert digests_of(CASES[number]) == EXPECTED[number], CASES[number]
