# SPDX-License-Identifier: Apache-2.0
"""Recovery from single upsets: a sample of the campaign in `tests/upsets.py` (`make upsets` runs all of it)."""

import random

import pytest

from coincid.tb.rtl import rtl

from ..upsets import Campaign, Report, cases, every_bit, flops

TRIALS = 1200
CONTROL = ("registers", "sequencer", "readout", "controller", "module_0.resets")  # where an upset could stop everything


@pytest.mark.parametrize("name", cases())
def test_one_upset_heals_itself(name):
    campaign, report, rng = Campaign(cases()[name]), Report(), random.Random(1)
    targets = every_bit(campaign)
    assert len(targets) == sum(flop.bits * flop.words for flop in flops(rtl(campaign.sensor))) > 10_000
    control = [target for target in targets if str(target[0]).startswith(CONTROL)]
    for flop, word, bit in rng.sample(control, TRIALS // 2) + rng.sample(targets, TRIALS // 2):
        campaign.trial(flop, word, bit, rng.randrange(campaign.span), report)
    campaign.close()
    if name == "steps":
        assert report.changed > TRIALS // 20  # the upsets have an effect
    assert not report.failures, "\n".join(map(str, report.failures))
