# SPDX-License-Identifier: Apache-2.0
"""The same scene from a depth file, for every pair of a kind of file and what is said of it."""

import pytest

from ..digests import read_digests
from .file_pairs import CASES, DIGESTS, digest_of

EXPECTED = read_digests(DIGESTS)


def test_every_case_has_its_digest():
    assert len(EXPECTED) == len(CASES)


@pytest.mark.parametrize("number", range(len(CASES)))
def test_the_same_scene(number):
    case = CASES[number]
    assert digest_of(case) == EXPECTED[number], case
