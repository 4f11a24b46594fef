# SPDX-License-Identifier: Apache-2.0
"""The same scene from a depth file, for every pair of a kind of file and what is said of it."""

import json

import pytest

from .file_pairs import CASES, DIGESTS, digest_of

EXPECTED = json.loads(DIGESTS.read_text(encoding="utf-8"))


def test_every_case_has_its_digest():
    assert len(EXPECTED) == len(CASES)


@pytest.mark.parametrize("number", range(len(CASES)))
def test_the_same_scene(number):
    case = CASES[number]
    assert digest_of(case) == EXPECTED[number], case
