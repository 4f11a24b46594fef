# SPDX-License-Identifier: Apache-2.0
"""The same photons, for every pair of features of light, SPADs, gates and clocks."""

import json

import pytest

from .photon_pairs import CASES, DIGESTS, digest_of

EXPECTED = json.loads(DIGESTS.read_text(encoding="utf-8"))


def test_every_case_has_its_digest():
    assert len(EXPECTED) == len(CASES)


@pytest.mark.parametrize("number", range(len(CASES)))
def test_the_same_photons(number):
    case = CASES[number]
    assert digest_of(case) == EXPECTED[number], case
