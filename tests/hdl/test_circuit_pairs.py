# SPDX-License-Identifier: Apache-2.0
"""The circuit of a sensor changes only on purpose, for every pair of what can be built."""

import pytest

from ..digests import read_digests
from .circuit_pairs import DIGESTS, TOPS, digests_of

EXPECTED = read_digests(DIGESTS)


def test_every_case_has_its_digests():
    assert len(EXPECTED) == len(TOPS)


@pytest.mark.parametrize("number", range(len(TOPS)))
def test_the_same_blocks(number):
    assert digests_of(*TOPS[number]) == EXPECTED[number], TOPS[number]
