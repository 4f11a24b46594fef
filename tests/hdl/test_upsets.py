# SPDX-License-Identifier: Apache-2.0
"""Recovery from single upsets: the campaign of `tests/upsets.py`."""

import pytest

from coincid.tb.rtl import rtl

from ..upsets import Campaign, cases, registers_of


@pytest.mark.long
@pytest.mark.parametrize("name", cases())
def test_one_upset_heals_itself(name):
    with Campaign(cases()[name]) as campaign:
        report = campaign.run(campaign.trials(seed=1))
    registers = registers_of(rtl(campaign.sensor))
    flipped = [flop for flop in campaign.flops if flop.register in registers]
    assert len(flipped) + campaign.absent.total() == sum(registers.values()) > 10_000
    assert campaign.absent.total() < 100
    if name == "steps":
        assert report.changed > report.trials // 20  # the upsets have an effect
    assert len(report.misled) < report.trials // 1000
    assert not report.failures, "\n".join(map(str, report.failures))
