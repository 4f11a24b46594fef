# SPDX-License-Identifier: Apache-2.0
"""The timeline against the golden model's counters and events, for many settings."""

import itertools

import numpy as np
import pytest

from coincid.model.contract.coincidence import AT_LEAST, Rule
from coincid.model.contract.config import parse_config
from coincid.model.contract.counters import COUNTER_NAMES
from coincid.model.contract.edges import Edges, Fate
from coincid.model.golden.frame import Golden
from coincid.study.show.timeline import Verdict, frame_timeline, gate_of

from ...random_cases import random_edges

SENSOR = {"rows": 8, "cols": 16, "subgroup": [8, 8], "fifo_depth": 4}
BUSY = {  # name: document; there are many edges, so that FIFOs overflow
    "every photon": {"subgroup": {"coincidence": False}},
    "threshold 2": {"subgroup": {"threshold": 2}},
    "gated": {"frame": {"gate_step": 3, "gate_every": 2, "gate_steps": 5}, "subgroup": {"gating": True, "gate_start": 5, "gate_len": 9}},
    "full events, masked": {"frame": {"format": "full"}, "subgroup": {"mask": "ffffffff0fffffff"}},
    "records between events": {"frame": {"minigroup_records": True}, "subgroup": {"threshold": 1}},
    "two streams, re-arm gap": {"sensor": {"cols": 24, "streams": 2, "rearm": 2}, "subgroup": {"threshold": 1, "window": 40}},
    "dither": {"frame": {"dither_bits": 3}, "subgroup": {"threshold": 1}},
    "two thresholds": {"frame": {"pulses": 60}, "subgroup": {"threshold": 3, "window": 128}, "override": [{"subgroups": [1], "threshold": 2}]},
    "2^32 cycles apart": {"frame": {"gap": (1 << 28) - 40, "pulses": 17}, "subgroup": {"coincidence": False}},
}  # fmt: skip


class LastPixel(Rule):
    """A window also needs the last pixel of the subgroup."""

    name = "last-pixel"
    version = "1"

    def meets(self, maps, threshold):
        return maps[:, -1, -1] & (maps.sum(axis=(1, 2)) >= threshold)


def played(document, edges_per_period=60, rule=AT_LEAST):
    """Return (config, edges, trace) of one frame with uniformly random edges."""
    frame = {"period": 40, "pulses": 6} | document.get("frame", {})
    config = parse_config(
        document | {"sensor": SENSOR | document.get("sensor", {}), "frame": frame}
    ).with_rule(rule)
    edges = random_edges(config, edges_per_period * config.pulses, 7)
    return config, edges, Golden(config.sensor).frame(config, edges)


def counters(trace, name):
    return trace.counters[:, COUNTER_NAMES.index(name)]


@pytest.mark.parametrize("rule", [AT_LEAST, LastPixel()])
@pytest.mark.parametrize("name", BUSY)
def test_windows_are_those_of_the_counters(name, rule):
    """Also if the sensor has a rule of its own."""
    config, edges, trace = played(BUSY[name], rule=rule)
    timeline = frame_timeline(config, edges, trace)
    subgroup = np.repeat(
        np.arange(config.sensor.subgroups), np.diff(timeline.window_bounds[:: config.pulses])
    )
    windows = timeline.windows

    def of(*verdicts):
        return np.bincount(
            subgroup[np.isin(windows.verdict, verdicts)], minlength=config.sensor.subgroups
        )

    assert np.array_equal(of(*Verdict), counters(trace, "opened"))
    assert np.array_equal(of(Verdict.REJECTED), counters(trace, "rejected"))
    assert np.array_equal(of(Verdict.COMMITTED), counters(trace, "stored"))
    assert np.array_equal(of(Verdict.DROPPED), counters(trace, "dropped"))
    assert np.array_equal(
        np.bincount(subgroup, windows.count, config.sensor.subgroups), counters(trace, "photons")
    )


@pytest.mark.parametrize("name", BUSY)
def test_a_drop_finds_the_fifo_full_and_a_commit_does_not(name):
    config, edges, trace = played(BUSY[name], edges_per_period=200)
    timeline = frame_timeline(config, edges, trace)
    assert timeline.fill.min() == 0 and timeline.fill.max() <= config.sensor.fifo_depth
    assert counters(trace, "dropped").any() or name not in (
        "every photon",
        "records between events",
    )
    for s, pulse in itertools.product(range(config.sensor.subgroups), range(config.pulses)):
        part = slice(*timeline.fill_bounds[s : s + 2])
        cycles, fill = timeline.fill_cycle[part], timeline.fill[part]
        assert fill[0] == fill[-1] == 0
        period = timeline.period(s, pulse)
        windows = period.windows
        inside = windows.commit < config.period
        assert np.all(period.fill_cycle < config.period)
        at = np.searchsorted(period.fill_cycle, windows.commit[inside], "right") - 1
        after = fill[
            np.searchsorted(cycles, timeline.start_cycles[pulse] + windows.commit, "right") - 1
        ]
        assert np.array_equal(period.fill[at], after[inside])
        assert np.all(after[windows.verdict == Verdict.DROPPED] == config.sensor.fifo_depth)
        assert np.all(after[windows.verdict == Verdict.COMMITTED] >= 1)


def test_periods_hold_every_edge_once_in_time_order_and_inside_windows_as_the_fate_says():
    config, edges, trace = played(BUSY["gated"])
    timeline, seen = frame_timeline(config, edges, trace), 0
    for s, pulse in itertools.product(range(config.sensor.subgroups), range(config.pulses)):
        period = timeline.period(s, pulse)
        seen += len(period.tick)
        assert np.all(np.diff(period.tick) >= 0)
        first, end = period.gate_cycles
        cycle = period.tick // config.sensor.phases
        outside = (cycle < first) | (cycle >= end)
        assert np.array_equal(period.fate == Fate.GATED, outside & (period.fate != Fate.DUPLICATE))
        assert set(period.windows.start) == set(period.tick[period.fate == Fate.OPENING])
        for tick in period.tick[period.fate == Fate.COUNTED]:
            assert np.any((period.windows.start <= tick) & (tick < period.windows.end))
        assert period.fill_cycle[0] == 0 and np.all(period.fill_cycle < config.period)
        assert np.all(np.diff(period.fill_cycle) >= 0)
    assert seen == len(edges)


@pytest.mark.parametrize(("first", "length"), [(5, 9), (5, 40), (39, 2), (0, 255), (39, 1)])
def test_a_gate_lies_within_the_period(first, length):
    """Also one that moves out of it step by step: each cycle of the period is in it or not. Another
    subgroup has a gate of its own.
    """
    moving = {"gate_step": 8, "gate_every": 1, "gate_steps": 7, "pulses": 6, "period": 40}
    gate = {"gating": True, "gate_start": first, "gate_len": length}
    config = parse_config({"sensor": SENSOR, "frame": moving, "subgroup": gate})
    config = config.with_settings(gate_start=[7, first], gate_len=[3, length])
    for pulse in range(config.pulses):
        start = first + 8 * pulse
        within = set(range(start, start + length)) & set(range(config.period))
        shown = gate_of(config, 1, pulse)
        assert set(range(*shown)) == within
        assert 0 <= shown[0] <= shown[1] <= config.period


def test_a_known_period():
    config = parse_config(
        {"sensor": SENSOR, "frame": {"period": 40, "pulses": 2}, "subgroup": {"threshold": 2}}
    )
    pixel = np.array([0, 1, 2, 0, 17])
    edges = Edges(np.zeros(5, np.int64), pixel, np.array([100, 104, 116, 300, 500]))
    period = frame_timeline(config, edges, Golden(config.sensor).frame(config, edges)).period(0, 0)
    assert period.tick.tolist() == [100, 104, 116, 300, 500]
    assert period.pixel.tolist() == [0, 1, 2, 0, 9]  # 17 is row 1, column 1 of the first subgroup
    assert [Fate(f).name for f in period.fate] == [
        "OPENING",
        "COUNTED",
        "BLIND",
        "OPENING",
        "OPENING",
    ]
    windows = period.windows
    assert (windows.start.tolist(), windows.end.tolist()) == ([100, 300, 500], [116, 316, 516])
    assert windows.count.tolist() == [2, 1, 1]
    assert [Verdict(v).name for v in windows.verdict] == ["COMMITTED", "REJECTED", "REJECTED"]
    assert windows.commit.tolist()[0] == 115 // 32 + 8
    assert period.gate_cycles is None and period.threshold == 2
    assert period.fill.tolist() == [0, 1, 0] and period.fill_cycle[1] == 11
