# SPDX-License-Identifier: Apache-2.0
"""The same photons, for every pair of features of light, SPADs, gates and clocks."""

import pytest
from attrs import fields

from coincid.model.light.light import Arrivals, Interferer, Light
from coincid.model.light.spad import Spad, SpadGate
from coincid.model.light.timing import Timing

from ..digests import read_digests
from .photon_pairs import CASES, DIGESTS, digest_of, gate_of, light_of, spad_of, timing_of

EXPECTED = read_digests(DIGESTS)
# Sizes, scales, and what is for the link budget only.
NOT_VARIED = {
    Light: {"rows", "cols"},
    Spad: {"pdp", "fill_factor", "jitter_tail_s"},
    SpadGate: set(),
    Timing: {"clock_hz", "phases", "period_cycles", "search_minigroups"},
    Arrivals: {"first", "start_s", "photons"},
    Interferer: {"phase_s", "fwhm_s"},
}


def inputs_of(case):
    """Return all inputs of a case's photons."""
    light = light_of(case)
    inputs = [light, light.arrivals, light.interferer, spad_of(case), timing_of(case)]
    return [*inputs, gate_of(case)]


def test_every_field_varies():
    """Also those that come with a later version."""
    seen = {}
    for case in CASES:
        for one in inputs_of(case):
            if one is not None:
                for field in fields(type(one)):
                    told = repr(getattr(one, field.name))
                    seen.setdefault((type(one), field.name), set()).add(told)
    for kind, constant in NOT_VARIED.items():
        same = {name for (of, name), values in seen.items() if of is kind and len(values) == 1}
        assert same <= constant, kind


def test_every_case_has_its_digest():
    assert len(EXPECTED) == len(CASES)


@pytest.mark.parametrize("number", range(len(CASES)))
def test_the_same_photons(number):
    case = CASES[number]
    assert digest_of(case) == EXPECTED[number], case
