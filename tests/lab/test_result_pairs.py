# SPDX-License-Identifier: Apache-2.0
"""Every stage of a run gives the same result, for every pair of features."""

import pytest

from ..digests import read_digests
from .result_pairs import CASES, DIGESTS, digests_of, told

EXPECTED = read_digests(DIGESTS)


def test_every_case_has_its_digests():
    assert len(EXPECTED) == len(CASES)


@pytest.mark.parametrize("number", range(len(CASES)))
def test_the_same_photons_words_and_depth(number):
    assert digests_of(CASES[number], number) == EXPECTED[number], told(CASES[number])
