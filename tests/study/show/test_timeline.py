# SPDX-License-Identifier: Apache-2.0
"""The timeline against the golden model's counters and events, for many settings."""

import numpy as np
import pytest

from coincid.model.contract.config import parse_config
from coincid.model.contract.counters import COUNTER_NAMES
from coincid.model.contract.edges import Edges, Fate
from coincid.model.golden.frame import Golden
from coincid.model.shared.errors import InputError
from coincid.study.show.timeline import Verdict, frame_timeline

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
}  # fmt: skip


def played(document, edges_per_period=60, seed=7):
    """Return (config, edges, trace) of one frame with uniformly random edges."""
    document = {"frame": {"period": 40, "pulses": 6}, **document}
    document["frame"] = {"period": 40, "pulses": 6} | document["frame"]
    config = parse_config(document | {"sensor": SENSOR | document.get("sensor", {})})
    edges = random_edges(config, edges_per_period * config.pulses, seed)
    return config, edges, Golden(config.sensor).frame(config, edges)


def counters(trace, name):
    return trace.counters[:, COUNTER_NAMES.index(name)]


@pytest.mark.parametrize("name", BUSY)
def test_windows_are_those_of_the_counters(name):
    config, edges, trace = played(BUSY[name])
    timeline = frame_timeline(config, edges, trace)
    subgroup = np.repeat(np.arange(config.sensor.subgroups), np.diff(timeline.window_bounds[:: config.pulses]))
    windows = timeline.windows

    def of(*verdicts):
        return np.bincount(subgroup[np.isin(windows.verdict, verdicts)], minlength=config.sensor.subgroups)

    assert np.array_equal(of(*Verdict), counters(trace, "opened"))
    assert np.array_equal(of(Verdict.REJECTED), counters(trace, "rejected"))
    assert np.array_equal(of(Verdict.COMMITTED), counters(trace, "stored"))
    assert np.array_equal(of(Verdict.DROPPED), counters(trace, "dropped"))
    assert np.array_equal(np.bincount(subgroup, windows.count, config.sensor.subgroups), counters(trace, "photons"))


@pytest.mark.parametrize("name", BUSY)
def test_a_drop_finds_the_fifo_full_and_a_commit_does_not(name):
    config, edges, trace = played(BUSY[name], edges_per_period=200)
    timeline = frame_timeline(config, edges, trace)
    depth = config.sensor.fifo_depth
    assert timeline.fill.min() == 0 and timeline.fill.max() <= depth
    dropped = 0
    for s in range(config.sensor.subgroups):
        part = slice(*timeline.fill_bounds[s : s + 2])
        cycles, fill = timeline.fill_cycle[part], timeline.fill[part]
        assert fill[0] == fill[-1] == 0
        for pulse in range(config.pulses):
            k = s * config.pulses + pulse
            here = slice(*timeline.window_bounds[k : k + 2])
            for verdict, commit in zip(timeline.windows.verdict[here], timeline.windows.commit[here]):
                cycle = timeline.start_cycles[pulse] + commit
                after = fill[np.searchsorted(cycles, cycle, "right") - 1]
                if verdict == Verdict.DROPPED:
                    assert after == depth
                    dropped += 1
                elif verdict == Verdict.COMMITTED:
                    assert 1 <= after <= depth
    assert dropped == counters(trace, "dropped").sum()
    assert dropped or name not in ("every photon", "records between events")


def test_periods_hold_every_edge_once_in_time_order_and_inside_windows_as_the_fate_says():
    config, edges, trace = played(BUSY["gated"])
    timeline = frame_timeline(config, edges, trace)
    seen = 0
    for s in range(config.sensor.subgroups):
        for pulse in range(config.pulses):
            period = timeline.period(s, pulse)
            seen += len(period.tick)
            assert np.all(np.diff(period.tick) >= 0)
            first, end = period.gate_cycles
            cycle = period.tick // config.sensor.phases
            assert np.array_equal(
                period.fate == Fate.GATED, ((cycle < first) | (cycle >= end)) & (period.fate != Fate.DUPLICATE)
            )
            assert set(period.windows.start) == set(period.tick[period.fate == Fate.OPENING])
            for tick in period.tick[period.fate == Fate.COUNTED]:
                assert np.any((period.windows.start <= tick) & (tick < period.windows.end))
            assert period.fill_cycle[0] == 0 and np.all(period.fill_cycle < config.period)
            assert np.all(np.diff(period.fill_cycle) >= 0)
    assert seen == len(edges)


def test_a_known_period():
    config = parse_config({"sensor": SENSOR, "frame": {"period": 40, "pulses": 2}, "subgroup": {"threshold": 2}})
    pixel = np.array([0, 1, 2, 0, 17])
    edges = Edges(np.zeros(5, np.int64), pixel, np.array([100, 104, 116, 300, 500]))
    period = frame_timeline(config, edges, Golden(config.sensor).frame(config, edges)).period(0, 0)
    assert period.tick.tolist() == [100, 104, 116, 300, 500]
    assert period.pixel.tolist() == [0, 1, 2, 0, 9]  # 17 is row 1, column 1 of the first subgroup
    assert [Fate(f).name for f in period.fate] == ["OPENING", "COUNTED", "BLIND", "OPENING", "OPENING"]
    windows = period.windows
    assert (windows.start.tolist(), windows.end.tolist()) == ([100, 300, 500], [116, 316, 516])
    assert windows.count.tolist() == [2, 1, 1]
    assert [Verdict(v).name for v in windows.verdict] == ["COMMITTED", "REJECTED", "REJECTED"]
    assert windows.commit.tolist()[0] == 115 // 32 + 8
    assert period.gate_cycles is None and period.threshold == 2
    assert period.fill.tolist() == [0, 1, 0] and period.fill_cycle[1] == 11


@pytest.mark.parametrize("subgroup, pulse, field", [(2, 0, "subgroup"), (-1, 0, "subgroup"), (0, 6, "pulse")])
def test_what_is_not_there_is_named(subgroup, pulse, field):
    timeline = frame_timeline(*played(BUSY["threshold 2"]))
    with pytest.raises(InputError, match=f"{field} = .*must be an integer from 0 to"):
        timeline.period(subgroup, pulse)
