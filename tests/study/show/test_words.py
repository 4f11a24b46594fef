# SPDX-License-Identifier: Apache-2.0
"""Numbers of a frame in words: each stands beside its own name, in its own unit."""

from types import SimpleNamespace

import pytest

from coincid.study.show.words import number_rows, story

NUMBERS = {
    "edges": 12_345,
    "opened": 2_000,
    "rejected": 300,
    "events": 1_600,
    "sun_share": 0.125,
    "dropped": 100,
    "bits": 65_432,
    "stream_load": 0.25,
    "link_load": 0.5,
    "threshold_mean": 2.5,
    "wrong_share": 0.0625,
    "wrong_share_15cm": None,
}
TOLD = [
    ("edges", "12,345"),
    ("windows", "2,000"),
    ("rejected", "300"),
    ("events", "1,600"),
    ("  with sunlight only", "12.5%"),
    ("drops", "100"),
    ("data per frame", "65,432 bits"),
    ("stream load", "25.0%"),
    ("link load", "50.0%"),
    ("mean threshold", "2.50 pixels"),
    ("wrong, above 3.4 cm", "6.2%"),
    ("wrong, above 15 cm", "not known"),
]


def test_each_number_stands_beside_its_name():
    view = SimpleNamespace(numbers=NUMBERS)
    other = SimpleNamespace(numbers=NUMBERS | {"edges": 7})
    rows = number_rows(view, other)
    assert [(label, first) for label, first, _ in rows] == TOLD
    assert [second for _, _, second in rows][:2] == ["7", "2,000"]


@pytest.mark.parametrize("gap", [0, 7])
def test_the_pace_is_told_where_there_are_gaps(gap):
    numbers = NUMBERS | {"committed": 1_700, "frames_per_s": 30.0, "mean_gbps": 0.0125}
    view = SimpleNamespace(numbers=numbers, objects=[], config=SimpleNamespace(gap=gap))
    pace = "At 30 frames per second, the busiest link carries 12.5 Mbit/s in the mean."
    assert (pace in story(view)) == bool(gap)
