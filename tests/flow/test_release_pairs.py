# SPDX-License-Identifier: Apache-2.0
"""What an export has beside its Verilog changes only on purpose, for every pair of what can be
built, and of views, clocks and prefixes.
"""

import pytest

from ..digests import read_digests
from .release_pairs import CASES, DIGESTS, digests_of

EXPECTED = read_digests(DIGESTS)


def test_every_case_has_its_digests():
    assert len(EXPECTED) == len(CASES)


@pytest.mark.parametrize("number", range(len(CASES)))
def test_the_same_files(number):
    assert digests_of(CASES[number]) == EXPECTED[number], CASES[number]
