# SPDX-License-Identifier: Apache-2.0
"""Every measure of a frame by hand: from counters, depths and truths that are written here."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from coincid.lab.measures import MEASURES, event_beats, stream_beats
from coincid.model.contract.config import parse_config
from coincid.model.contract.packet import FORMATS

NAN = np.nan
SENSOR = {"rows": 8, "cols": 24, "streams": 2}  # a stream of two subgroups, and one of one
FRAME = {"pulses": 20, "period": 60, "gap": 3, "link_gbps": 8.0, "capacity": 30}
CYCLES = 20 * 60 + 19 * 3
SECONDS = CYCLES * 2e-9
COUNTERS = {
    "opened": [90, 60, 50],
    "committed": [45, 30, 25],
    "rejected": [45, 30, 25],
    "stored": [40, 20, 20],
    "dropped": [5, 10, 5],
    "blind": [7, 0, 1],
    "photons": [200, 100, 90],
    "mg_stored": [3, 0, 4],
    "mg_dropped": [0, 2, 0],
}
BEATS = [300, 170]
TRUTH_M = np.array([[5.0, 5.0, 5.0, 5.0, 5.0, NAN, 5.0, 5.0]])
DEPTH_M = np.array([[5.01, 4.98, 5.1, 5.5, NAN, 6.0, 5.0, 12.0]])
# the fourth pixel also sees another surface, where its depth is
SURFACES_M = np.stack([TRUTH_M, np.where(DEPTH_M == 5.5, 5.5, NAN)], axis=2)
WITH_DEPTH_M = [0.01, -0.02, 0.1, 0.5, 0.0, 7.0]  # errors
RIGHT_M = [0.01, -0.02, 0.0]
FOUND_M = [0.01, -0.02, 0.1, 0.0]


class MadeUp:
    """A frame of which everything is given. unknown: counters that are at their end."""

    edge_count = 1234
    depth_m = DEPTH_M
    events = np.array([1, 2, 4])

    def __init__(self, config=None, truth_m=TRUTH_M, unknown=(), counters=COUNTERS):
        self.config = config or parse_config({"sensor": SENSOR, "frame": FRAME})
        self.truth_m = truth_m
        self.unknown = unknown
        self.counters = counters
        self.scene = SimpleNamespace(surfaces_m=SURFACES_M)
        self.result = {"overrun": np.array([True, True, False, True, True])}
        self.beats = np.array(BEATS)
        self.threshold = np.array([2, 3, 5])

    def counter(self, name):
        return np.array(self.counters[name])

    def knows(self, name):
        return name not in self.unknown

    def __getitem__(self, measure):
        return MEASURES[measure].of(self)


def rms(errors_m):
    return math.sqrt(np.mean(np.square(errors_m)))


EXPECTED = {
    "edges": 1234,
    "opened": 200,
    "committed": 100,
    "rejected": 100,
    "events": 80,
    "dropped": 20,
    "overruns": 2,
    "blind_cycles": 8,
    "photons": 390,
    "mg_records": 7,
    "mg_dropped": 2,
    "threshold_mean": 10 / 3,
    "commits_per_pulse": 100 / 20,
    "dropped_share": 20 / 100,
    "beats": 470,
    "stream_load": 300 / CYCLES,
    "wrong_share": 4 / 7,
    "off_surface_share": 3 / 7,
    "depth_share": 6 / 7,
    "bias_m": np.mean(WITH_DEPTH_M),
    "rms_m": rms(WITH_DEPTH_M),
    "right_bias_m": np.mean(RIGHT_M),
    "right_rms_m": rms(RIGHT_M),
    "bits": 64 * 470,
    "link_load": 4 * 300 / CYCLES,
    "frames_per_s": 1 / SECONDS,
    "mean_gbps": 64 * 300 / SECONDS / 1e9,
    "pulse_nj": 10e-3 * SECONDS / 20 * 1e9,
    "capacity_share": 100 / (2 * 30),
    "events_per_s": 80 / SECONDS,
    "records_per_s": 7 / SECONDS,
    "right_share": 3 / 7,
    "wrong_share_15cm": 3 / 7,
    "found_share": 4 / 7,
    "found_rms_m": rms(FOUND_M),
}
BY_LIGHT = {"bound_mm"}  # test_bound.py has it
OF_DEPTH = {
    "wrong_share", "off_surface_share", "depth_share", "bias_m", "rms_m", "right_bias_m",
    "right_rms_m", "right_share", "wrong_share_15cm", "found_share", "found_rms_m",
}  # fmt: skip


def test_every_measure_is_that_by_hand():
    assert EXPECTED.keys() | BY_LIGHT == MEASURES.keys()
    frame = MadeUp()
    for name, expected in EXPECTED.items():
        found = frame[name]
        assert type(found) is MEASURES[name].kind, name
        assert found == pytest.approx(expected, rel=1e-9), name


@pytest.mark.parametrize(
    ("counter", "measures"),
    [
        ("opened", {"opened"}),
        ("committed", {"committed", "commits_per_pulse", "dropped_share", "capacity_share"}),
        ("rejected", {"rejected"}),
        ("dropped", {"dropped", "dropped_share"}),
        ("blind", {"blind_cycles"}),
        ("photons", {"photons"}),
        ("mg_dropped", {"mg_dropped"}),
    ],
)
def test_what_needs_a_counter_that_is_not_known_is_not_known(counter, measures):
    """And nothing else."""
    frame = MadeUp(unknown=(counter,))
    assert {name for name in EXPECTED if frame[name] is None} == measures


def test_without_any_truth_no_measure_of_depth_has_a_value():
    frame = MadeUp(truth_m=np.full_like(TRUTH_M, NAN))
    assert {name for name in EXPECTED if frame[name] is None} == OF_DEPTH


def test_without_windows_only_their_shares_have_no_value():
    nothing = {name: [0, 0, 0] for name in COUNTERS}
    frame = MadeUp(counters=nothing)
    assert {name for name in EXPECTED if frame[name] is None} == {"dropped_share"}
    of_no_capacity = MadeUp(frame.config.with_frame(capacity=0))
    assert {name for name in EXPECTED if of_no_capacity[name] is None} == {"capacity_share"}


def test_frames_of_counts_have_no_threshold():
    config = parse_config(
        {"sensor": SENSOR | {"counts": 1}, "frame": {"pulses": 20, "format": "counts"}}
    )
    frame = MadeUp(config)
    assert {name for name in EXPECTED if frame[name] is None} == {"threshold_mean"}


@pytest.mark.parametrize("name", FORMATS)
def test_beats_of_a_stream_are_those_of_all_its_words(name):
    """A stream of two subgroups has their events, records, counters and counts, and one frame."""
    sensor = SENSOR | {"counts": 1}
    config = parse_config({"sensor": sensor, "frame": {"pulses": 20, "format": name}})
    events, records = np.array([40, 20, 20]), np.array([3, 0, 4])
    # stamps of an event in a group: 4 bits of listed and overrun, 2 of the subgroup, 1, 13; three
    # pixels of 6 bits, with 7 of their minigroups' offsets
    expected = {
        "short": 1,
        "id": 2,
        "full": 4,
        "compact": (3 + 1 + 2 + 1 + 13 + 3 * 6) / 59,
        "compact-full": (3 + 1 + 2 + 1 + 13 + 3 * 13) / 59,
        "counts": 1,
    }[name]
    at_end = 6 + 16 * 10 * config.counting
    if not config.counting:
        assert event_beats(config) == pytest.approx(expected)
        found = stream_beats(config, events, records)
        assert found == pytest.approx(
            [2 + 60 * expected + 3 * 5 + 2 * at_end, 2 + 20 * expected + 4 * 5 + at_end]
        )
    nothing = stream_beats(config, 0 * events, 0 * records)
    assert nothing.tolist() == [2 + 2 * at_end, 2 + at_end]
