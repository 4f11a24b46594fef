# SPDX-License-Identifier: Apache-2.0
"""The link behind the streams: its rate, its even spacing, and that all engines use it."""

import re
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from coincid.model.contract.config import parse_config
from coincid.model.contract.link import SHARE_MIN, beats_waiting_max, link_share, next_taken
from coincid.model.contract.parameters import Sensor
from coincid.model.contract.result import differences
from coincid.model.golden.receiver import receiver_of
from coincid.model.shared.errors import InputError
from coincid.tb.replay import replay

from ..random_cases import SENSORS, trouble

SMALL = {
    "sensor": SENSORS["default"],
    "frame": {"pulses": 3, "period": 40},
    "subgroup": {"threshold": 1, "window": 4},
}


def configured(**frame):
    return parse_config(SMALL | {"frame": SMALL["frame"] | frame})


def test_share_is_that_of_a_beat_per_cycle():
    assert link_share(8, 500) == Fraction(1, 4)
    assert link_share(8, 125) == link_share(0, 500) == link_share(1000, 500) == 1
    assert configured(link_gbps=8.0).link_share == Fraction(1, 4)


@given(gbps=st.floats(0.5, 40), stalled=st.integers(0, 50))
def test_beats_are_taken_evenly(gbps, stalled):
    config = configured(link_gbps=gbps)
    ready = config.tready(np.zeros(stalled, np.uint8))
    if config.link_share == 1:
        assert len(ready) == stalled and not ready.any()
        return
    assert not ready[:stalled].any() and len(ready) > config.frame_cycles + stalled
    taken = np.cumsum(config.tready())
    cycles = np.arange(1, len(taken) + 1)
    assert np.all(taken <= cycles * float(config.link_share) + 1e-6)
    assert np.all(taken > cycles * float(config.link_share) - 1 - 1e-6)


@pytest.mark.parametrize("gbps", [0.1, 2.0, 20.0, 31.0])
def test_levels_of_a_link_are_told_until_all_beats_that_may_wait_have_left(gbps):
    """Behind the last one, engines take it as ready: a beat would leave too early."""
    config = configured(link_gbps=gbps)
    for stalled in (0, 1000):
        behind = config.tready(np.zeros(stalled, np.uint8))[config.frame_cycles + stalled :]
        assert behind.sum() >= beats_waiting_max(config.sensor)


@given(
    share=st.fractions(SHARE_MIN, 1, max_denominator=1 << 20),
    cycle=st.integers(0, 1 << 50),
)
def test_next_beat_of_a_link_is_the_first_that_the_rule_finds(share, cycle):
    beats = share.numerator
    cycles = share.denominator
    later = range(cycle, cycle + int(1 / SHARE_MIN) + 1)
    rule = (c for c in later if (c + 1) * beats // cycles > c * beats // cycles)
    assert next_taken(np.int64(cycle), np.int64(beats), np.int64(cycles)) == next(rule)


@given(gbps=st.floats(0.5, 40), behind=st.lists(st.integers(0, 1), max_size=100))
def test_golden_model_and_engines_have_the_same_receiver(gbps, behind):
    config = configured(link_gbps=gbps)
    behind = np.array(behind, np.uint8)
    afterwards = np.ones(config.frame_cycles + 1, np.uint8)
    taken = np.flatnonzero(np.append(config.tready(behind), afterwards))
    cycles = np.arange(len(behind) + config.frame_cycles)
    receiver = receiver_of(config, behind)
    later = next_taken(cycles[len(behind) :], receiver.beats, receiver.cycles)
    found = np.append(receiver.early, later)
    assert np.array_equal(found, taken[np.searchsorted(taken, cycles)])


def test_slow_link_fills_the_fifos_and_engines_agree():
    slow, fast = configured(link_gbps=2.5), configured()
    edges = trouble(slow, seed=5, per_subgroup_period=60)
    found = {
        gbps: replay("golden", config, edges) for gbps, config in (("slow", slow), ("fast", fast))
    }
    assert found["slow"]["dropped"].sum() > found["fast"]["dropped"].sum()
    assert np.array_equal(found["slow"]["committed"], found["fast"]["committed"])
    assert not differences(found["slow"], replay("sliced", slow, edges))


def test_a_receiver_that_stalls_fills_the_fifos_and_engines_agree():
    config = configured()
    edges = trouble(config, seed=5, per_subgroup_period=60)
    stalled = np.zeros(config.frame_cycles // 2, np.uint8)
    expected = replay("golden", config, edges, stalled)
    assert expected["dropped"].sum() > replay("golden", config, edges)["dropped"].sum()
    assert not differences(expected, replay("sliced", config, edges, stalled))


@pytest.mark.parametrize("gbps", [-1, 0.001, float("nan"), "fast", True])
def test_link_that_makes_no_sense_is_refused(gbps):
    with pytest.raises(InputError, match="frame.link_gbps"):
        configured(link_gbps=gbps)


def test_the_lowest_rate_that_a_message_tells_is_legal():
    with pytest.raises(InputError, match="as fast as the stream") as raised:
        configured(link_gbps=0.001, clock_mhz=123.4567)
    told = re.search(r"or from (\S+) to", str(raised.value))[1]
    assert configured(link_gbps=float(told), clock_mhz=123.4567).frame.link_gbps == float(told)


@pytest.mark.parametrize("wrong", [2, -1, 256])
def test_levels_of_a_receiver_are_0_or_1(wrong):
    """Another number would be taken for either, by one engine or the other."""
    config = configured(link_gbps=2.5)
    edges = trouble(config, seed=5, per_subgroup_period=60)
    ready = np.array([0, 1, 0, 1], np.int64)
    assert not differences(
        replay("golden", config, edges, ready), replay("golden", config, edges, ready > 0)
    )
    ready[2] = wrong
    for engine in ("golden", "sliced"):
        told = re.escape(f"ready[2] = {wrong}: must be 0 or 1")
        with pytest.raises(InputError, match=told):
            replay(engine, config, edges, ready)


SMALLEST = {"rows": 8, "cols": 16, "fifo_depth": 4, "counter_bits": 32}


@pytest.mark.parametrize(
    "sensor, beats",
    [
        ({}, 2 * ((4 + 2) * 6 + 6)),  # none is longer than the counters, 11 x 32 bits
        ({"fifo_depth": 9}, 2 * ((9 + 2) * 6 + 6)),
        ({"counts": 1, "fifo_depth": 1}, 2 * (16 * 10 + 6)),  # a packet of every minigroup
    ],
)
def test_beats_that_wait_at_the_end_are_those_of_all_places_or_minigroups(sensor, beats):
    assert beats_waiting_max(Sensor(**SMALLEST | sensor)) == beats
