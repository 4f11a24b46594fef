# SPDX-License-Identifier: Apache-2.0
"""Counts of the golden model against the plain counts: words, pauses, aborts and pieces."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from coincid.model.contract import latency
from coincid.model.contract.edges import Edges, Fate
from coincid.model.golden.frame import Golden, golden_result, trace_of
from coincid.model.golden.shape import COUNTER

from ..benches.plain_model import period_starts
from ..random_cases import configured, ready_pattern, returns, trouble
from .counts_in_rows import plain_counts
from .test_golden import assert_plain, assert_same_trace

WINDOW_MAX_TICKS = 16
SENSORS = {
    "square": dict(rows=4, cols=8, subgroup=[4, 4], phases=8),
    "flat": dict(rows=4, cols=16, subgroup=[2, 8], phases=4, streams=3),
    "tall": dict(rows=24, cols=6, subgroup=[12, 2], phases=64, streams=2),
    "large": dict(rows=16, cols=16, subgroup=[8, 16], phases=16, rearm=2),
}
for table in SENSORS.values():
    table |= {"counts": 1, "window_max": WINDOW_MAX_TICKS}
HEAD = 6 << 61 | 2 << 23
END = 7 << 61
# from the end of the last period until the frame end leaves, or the counts in front of it
END_LATENCY = latency.FINISH + latency.GRANT_TO_BEAT + latency.BEAT_TO_PORT
seeds = st.integers(0, 2**32 - 1)


@st.composite
def frames(draw):
    """Draw a frame and its light: returns of some pixels at a common time, and background.

    Returns are so bright at times that bins become full in every step.
    """
    table = SENSORS[draw(st.sampled_from(sorted(SENSORS)))]
    short = st.integers(10, 50)
    period = draw(st.one_of(short, short, st.integers(250, 300)))
    search_pulses = draw(st.integers(1, 30))
    config = configured(
        table,
        {
            "format": "counts",
            "period": period,
            "pulses": 2 * search_pulses + draw(st.integers(1, 40)),
            "search_pulses": search_pulses,
            "gap": draw(st.sampled_from((0, 0, 1, 700, 5000))),
            "dither_bits": draw(st.sampled_from((0, 0, 3))),
            "minigroup_records": draw(st.booleans()),
            "mg_threshold": 1,
            "gate_every": draw(st.integers(0, 3)),
            "gate_steps": 3,
            "gate_step": draw(st.integers(0, 9)),
        },
        {"coincidence": draw(st.booleans()), "threshold": draw(st.integers(1, 3)), "window": 9},
        {
            "subgroups": [1],
            "mask": f"{draw(st.integers(0, (1 << 16) - 1)):x}",
            "gating": draw(st.booleans()),
            "gate_start": draw(st.integers(0, 9)),
            "gate_len": draw(st.integers(0, period)),
        },
    )
    density = draw(st.sampled_from((0.2, 3.0, 12.0)))
    return config, returns(config, draw(seeds), density)


def plain_words(config, subgroups, stream):
    """Return the beats of the packets with counts of a stream."""
    words = []
    for s in config.sensor.stream_subgroups(stream):
        for number, group in enumerate(subgroups[s]):
            words += group.words(s, number)
    return words


def assert_plain_words(config, trace, edges, pulses=None):
    """Check the words of a frame's streams against the plain counts."""
    (subgroups,) = plain_counts(config, edges, trace.fate.tolist(), pulses)
    for stream, beats in enumerate(trace.beats):
        words = plain_words(config, subgroups, stream)
        assert beats[: 2 + len(words)].tolist() == [HEAD, *words, END]


@settings(max_examples=150)
@given(case=frames())
def test_counts_are_those_of_the_plain_model(case):
    config, edges = case
    assert_plain(config, edges, golden_result(config, edges))
    assert_plain_words(config, Golden(config.sensor).frame(config, edges), edges)


@given(case=frames(), data=st.data())
def test_aborted_frames(case, data):
    """Whatever the step in which a frame ends."""
    config, edges = case
    search = config.search_pulses
    near = st.sampled_from((search, 2 * search, 2 * search + 1))
    pulses = data.draw(st.one_of(st.integers(1, config.pulses), near))
    edges = edges.take(edges.pulse < pulses)
    into_gap = data.draw(st.sampled_from((0, 1, 300)))
    trace = Golden(config.sensor).frame(config, edges, pulses=pulses, into_gap=into_gap)
    assert_plain_words(config, trace, edges, pulses)
    end = period_starts(config)[pulses - 1] + config.period + into_gap
    assert trace.beat_cycle[0][1] == end + END_LATENCY
    if pulses <= 2 * search:
        counts = trace.beats[0][1:11].tolist()
        assert counts == [0xFFFF, *[0] * 9]


@given(case=frames(), data=st.data())
def test_a_frame_in_pieces_is_the_frame(case, data):
    config, edges = case
    ready = ready_pattern(data.draw(seeds), "random", 500)
    whole = Golden(config.sensor).frame(config, edges, ready)
    cuts = data.draw(st.sets(st.integers(0, config.pulses)))
    opened = Golden(config.sensor).begin(config, ready)
    sent = [opened.sent()]
    fate = np.empty(len(edges), np.uint8)
    for first, end in itertools.pairwise([0, *sorted(cuts), config.pulses]):
        piece = np.flatnonzero((first <= edges.pulse) & (edges.pulse < end))
        fate[piece] = opened.take(edges.take(piece))
        sent.append(opened.sent())
    ending = opened.close()
    sent.append(opened.sent())
    assert_same_trace(trace_of(list(zip(*sent, strict=True)), ending, fate), whole)


def test_counts_leave_when_the_frame_end_leaves_in_other_formats():
    """One beat per cycle, from the cycle in which an empty frame of events has its end."""
    table = SENSORS["flat"]
    frame = {"pulses": 5, "period": 40, "format": "counts", "gap": 100_000}
    config = configured(table, frame)
    edges = trouble(config.with_frame(format="id"), 1, 20.0)
    trace = Golden(config.sensor).frame(config, edges)
    of_events = config.with_frame(format="id")
    empty = Golden(config.sensor).frame(of_events, edges.take(slice(0, 0)))
    for k, (cycles, expected) in enumerate(zip(trace.beat_cycle, empty.beat_cycle, strict=True)):
        assert cycles[:2].tolist() == expected[:2].tolist()
        assert np.all(np.diff(cycles[1:]) == 1)
        packets = config.sensor.minigroups * len(config.sensor.stream_subgroups(k))
        assert len(cycles) == len(expected) + 10 * packets


def test_nothing_else_happens_in_a_frame_of_counts():
    table = SENSORS["large"]
    frame = {"pulses": 6, "period": 60, "format": "counts", "minigroup_records": True}
    config = configured(table, frame | {"mg_threshold": 1}, {"threshold": 1, "auto": True})
    edges = trouble(config.with_frame(format="id"), 1, 30.0)
    golden = Golden(config.sensor)
    for _ in range(2):
        trace = golden.frame(config, edges)
        assert np.isin(trace.fate, (Fate.BLIND, Fate.DUPLICATE)).all()
        assert np.all(trace.counters[:, COUNTER.blind] > 0)
        others = np.delete(trace.counters, [COUNTER.blind, COUNTER.threshold_used], axis=1)
        assert not others.any()
        assert not len(trace.commit_cycle)


def test_frames_do_not_remember_counts():
    """A frame after a frame of counts, or after an aborted one, is like the first one."""
    table = SENSORS["square"]
    config = configured(table, {"pulses": 12, "period": 40, "format": "counts"})
    edges = returns(config, 3, 9.0)
    golden = Golden(config.sensor)
    first = golden.frame(config, edges)
    golden.frame(config, edges.take(edges.pulse < 3), pulses=3)
    golden.frame(config.with_frame(format="id"), edges)
    golden.frames = 0
    assert_same_trace(golden.frame(config, edges), first)


@pytest.mark.parametrize("phases", [4, 16])
def test_bins_become_full_in_every_step(phases):
    """All pixels are hit in each of 16 cycles of every pulse: wide bins stop the minigroups in
    pulse 16 of step 1, narrow bins in pulse 16 of step 2, and pixels in pulse 15 of step 3.
    """
    table = dict(rows=4, cols=4, subgroup=[4, 4], phases=phases, counts=1)
    config = configured(
        table, {"pulses": 90, "period": 40, "format": "counts", "search_pulses": 30}
    )
    pulse, pixel, cycle = (axis.ravel() for axis in np.mgrid[:90, :16, 8:24])
    edges = Edges(pulse, pixel, cycle * phases)
    result = golden_result(config, edges)
    assert_plain(config, edges, result)
    assert np.all(result["count_pulses"] == 15)
    full = result["gate_hits"][0, 0].reshape(16, 2, 4, 4)[..., 0] == 15
    assert full.any(axis=(1, 2)).all()


def test_the_other_bin_of_the_cycle_that_fills_one_gets_its_hits():
    """It makes the peak in cycle 10 higher than the one in cycle 20, so it is the first gate."""
    phases = 4
    sensor = dict(rows=4, cols=4, subgroup=[4, 4], phases=phases, counts=1)
    frame = {"pulses": 41, "period": 40, "format": "counts", "search_pulses": 20}
    config = configured(sensor | {"window_max": WINDOW_MAX_TICKS}, frame)
    minigroup = [0, 1, 4, 5]
    hits = [(20 + k, pixel, 20 * phases + k % 2 * 2) for k in range(16) for pixel in minigroup]
    hits += [(20 + k, pixel, 10 * phases) for k in range(15) for pixel in minigroup]
    hits += [(38, pixel, 10 * phases) for pixel in (0, 1)]
    hits += [(39, 0, 10 * phases)] + [(39, pixel, 10 * phases + 2) for pixel in (1, 4, 5)]
    edges = Edges(*np.array(hits).T)
    result = golden_result(config, edges)
    assert_plain(config, edges, result)
    assert result["gate_cycle"][0, 0, 0].tolist() == [8, 19]
