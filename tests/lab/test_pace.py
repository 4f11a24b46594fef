# SPDX-License-Identifier: Apache-2.0
"""Frames per second, rates of links and energies of pulses, against numbers by hand."""

import re

import pytest

from coincid.lab.outcomes import Run
from coincid.lab.pace import frames_per_s, gap_for, pulse_energy_j, told_pace
from coincid.lab.setup import Setup
from coincid.model.contract.config import parse_config
from coincid.model.contract.dither import GAP_MAX
from coincid.model.shared.errors import InputError
from coincid.study.explain import meaning, warnings


def test_pace_by_hand():
    """100 periods of 250 cycles and 99 gaps of 1000 cycles take 124,000 cycles of 2 ns."""
    config = parse_config({"frame": {"gap": 1000}})
    assert config.frame_cycles == 124_000
    assert frames_per_s(config) == pytest.approx(1 / 248e-6)
    assert pulse_energy_j(config) == pytest.approx(10e-3 * 248e-6 / 100)
    assert told_pace(config) == (
        "4032 frames per second, in which a laser of 10 mW has 24.8 nJ per pulse"
    )
    rows = dict(meaning(config))
    assert rows["gap"] == "1,000 cycles, 2 us, between two periods"
    assert rows["laser"] == "10 mW of mean power are 24.8 nJ per pulse"


def test_gap_for_a_rate_by_hand():
    """A thirtieth of a second has 16,666,666 cycles; 25,000 of them are periods."""
    config = parse_config({"frame": {"gap": 7}})
    assert gap_for(config, 30) == (16_666_666 - 25_000) // 99 == 168_097
    assert 30 <= frames_per_s(config.with_frame(gap=168_097)) < 30.001
    assert gap_for(config, 20_000) == 0
    with pytest.raises(InputError, match="rate_per_s = 20001: must be from 0.0188.* to 20000"):
        gap_for(config, 20_001)
    with pytest.raises(InputError, match="rate_per_s = 0.01: must be from 0.0188"):
        gap_for(config, 0.01)


@pytest.mark.parametrize("gap", (0, 1, 1000, GAP_MAX))
@pytest.mark.parametrize("clock_mhz", (250, 333.3))
def test_the_rate_of_a_frame_leads_back_to_its_gap(clock_mhz, gap):
    """Also where a quotient of floats falls a little short of whole cycles."""
    for period in range(60, 70):
        frame = {"clock_mhz": clock_mhz, "period": period, "pulses": 37, "gap": gap}
        config = parse_config({"frame": frame})
        assert gap_for(config, frames_per_s(config)) == gap


@pytest.mark.parametrize("period", (62, 67))
def test_the_rates_that_a_refusal_names_are_legal(period):
    """In six digits, one of them would be above the highest rate, and the other below it."""
    config = parse_config({"frame": {"period": period, "pulses": 37}})
    with pytest.raises(InputError) as refused:
        gap_for(config, 1e9)
    low, high = re.findall(r"[\d.e-]*\d", str(refused.value).partition("must be")[2])
    assert gap_for(config, float(low)) == GAP_MAX
    assert gap_for(config, float(high)) == 0


@pytest.mark.parametrize("rate_per_s", [0, -1.0, float("nan"), float("inf"), "30"])
def test_what_is_no_rate_is_refused(rate_per_s):
    with pytest.raises(InputError, match="^rate_per_s = .*: must be a number of at least 1e-09$"):
        gap_for(parse_config({}), rate_per_s)


def test_a_frame_of_one_pulse_has_a_single_rate():
    config = parse_config({"frame": {"pulses": 1}})
    assert gap_for(config, 2_000_000) == 0
    for other in (1_900_000, 2_100_000):
        with pytest.raises(InputError, match=r"rate_per_s = .*: must be from 2e\+06 to 2e\+06"):
            gap_for(config, other)


@pytest.mark.parametrize("rate_per_s", (5_000, 10_000, 10_700))
def test_the_gap_for_a_rate_of_counts_is_the_longest(rate_per_s):
    """The waits between searches hold the gap already, so frames do not grow in proportion to it."""
    document = {"sensor": {"counts": 1}, "frame": {"format": "counts", "pulses": 100}}
    config = parse_config(document)
    gap = gap_for(config, rate_per_s)
    assert frames_per_s(config.with_frame(gap=gap)) >= rate_per_s
    assert frames_per_s(config.with_frame(gap=gap + 1)) < rate_per_s


def test_measures_count_the_gaps():
    frame = {"period": 60, "pulses": 20, "gap": 940, "format": "id"}
    run = Run(Setup.of("flat:5,0.4", sensor={"rows": 8, "cols": 16, "streams": 2}, frame=frame))
    frame_s = (20 * 60 + 19 * 940) * 2e-9
    assert run["frames_per_s"] == pytest.approx(1 / frame_s)
    assert run["pulse_nj"] == pytest.approx(10e-3 * frame_s / 20 * 1e9)
    beats = run.frame().beats.max()
    assert beats > 0
    assert run["mean_gbps"] == pytest.approx(64 * beats / frame_s / 1e9)


def test_a_gap_of_a_single_pulse_is_reported():
    config = parse_config({"frame": {"gap": 5, "pulses": 1}})
    assert "gap has no effect: a frame has one pulse." in warnings(config)
    assert not any(line.startswith("gap") for line in warnings(config.with_frame(pulses=2)))
