# SPDX-License-Identifier: Apache-2.0
"""Pages show the same of a frame, for every pair of features."""

import pytest

from ...digests import read_digests
from ...lab.result_pairs import CASES, told
from .view_pairs import DIGESTS, digests_of

EXPECTED = read_digests(DIGESTS)


def test_every_case_has_its_digests():
    assert len(EXPECTED) == len(CASES)


@pytest.mark.parametrize("number", range(len(CASES)))
def test_the_same_words_and_columns(number):
    assert digests_of(CASES[number], number) == EXPECTED[number], told(CASES[number])
