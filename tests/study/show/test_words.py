# SPDX-License-Identifier: Apache-2.0
"""Numbers of a frame in words: each stands beside its own name, in its own unit."""

from types import SimpleNamespace

import pytest

from coincid.study.show.words import number_rows, object_table, story, where_to_look

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


COUNTED = NUMBERS | {"counted": 4_321, "opened": None, "sun_share": None, "mean_gbps": None}
TOLD_OF_COUNTS = [
    ("edges", "12,345"),
    ("counted hits", "4,321"),
    ("data per frame", "65,432 bits"),
    ("stream load", "25.0%"),
    ("link load", "50.0%"),
    ("wrong, above 3.4 cm", "6.2%"),
    ("wrong, above 15 cm", "not known"),
]


@pytest.mark.parametrize("hits", [0, 4_321])
def test_counts_have_hits_and_no_windows(hits):
    """Also a frame in which no gate had a hit."""
    view = SimpleNamespace(numbers=COUNTED | {"counted": hits})
    view.objects, view.config = [], SimpleNamespace(gap=0)
    told = [(label, f"{hits:,}" if label == "counted hits" else n) for label, n in TOLD_OF_COUNTS]
    assert [tuple(row) for row in number_rows(view)] == told
    assert [tuple(row) for row in number_rows(view, view)] == [(*row, row[1]) for row in told]
    assert story(view) == (
        f"The pixels counted {hits:,} hits in their gates; 65,432 bits left the sensor."
    )


@pytest.mark.parametrize("order", [1, -1])
def test_events_beside_counts_keep_their_windows(order):
    """Whichever is the first of the two; of counts, those numbers are not known."""
    views = [
        SimpleNamespace(numbers=NUMBERS | {"counted": None}),
        SimpleNamespace(numbers=COUNTED),
    ][::order]
    rows = number_rows(*views)
    assert [label for label, *_ in rows] == [label for label, _ in TOLD]
    assert rows[1] == ["windows", *["2,000", "not known"][::order]]


@pytest.mark.parametrize("gap", [0, 7])
@pytest.mark.parametrize("mean_gbps", [0.0125, None])
def test_the_pace_is_told_where_there_are_gaps(gap, mean_gbps):
    """And where it is known."""
    numbers = NUMBERS | {"committed": 1_700, "frames_per_s": 30.0, "mean_gbps": mean_gbps}
    view = SimpleNamespace(numbers=numbers, objects=[], config=SimpleNamespace(gap=gap))
    pace = "At 30 frames per second, the busiest link carries 12.5 Mbit/s in the mean."
    assert (pace in story(view)) == ("frames per second" in story(view))
    assert (pace in story(view)) == bool(gap and mean_gbps)


@pytest.mark.parametrize(
    ("changed", "told"),
    [
        ({"dropped": 0}, "Of 2,000 windows 1,700 met their threshold."),
        *(
            ({name: None}, "The numbers of windows and drops are not known, because counters are")
            for name in ("opened", "committed", "dropped")
        ),
    ],
)
@pytest.mark.parametrize("sun_share", [0.0, None])
def test_what_happens_in_a_frame_is_told_as_far_as_it_is_known(changed, told, sun_share):
    """A share of the sun that is none is told, too; a single object is no darkest part."""
    numbers = NUMBERS | {"committed": 1_700, "mean_gbps": None, "sun_share": sun_share} | changed
    config = SimpleNamespace(gap=0)
    view = SimpleNamespace(numbers=numbers, objects=OBJECTS[:1], config=config)
    assert story(view).startswith(told)
    assert ("0% of the events contain only sunlight." in story(view)) == (sun_share == 0)
    assert "found the FIFO full" not in story(view)
    assert "darkest" not in story(view)
    view.objects = OBJECTS[:2]
    assert where_to_look(view) == "The darkest part, wall, is around row 3, column 17."
    assert "In the darkest part, wall" in story(view)


def seen(name, signal, wrong_share, middle):
    return SimpleNamespace(
        name=name,
        signal=signal,
        wrong_share=wrong_share,
        middle=middle,
        reflectivity=0.1,
        distance_m=4.56,
    )


OBJECTS = [
    seen("wall", 0.125, 0.5, (3, 17)),
    seen("floor", 0.25, 0.25, (9, 1)),
    seen("lamp", 2.5, 0.0625, (5, 6)),
]


def test_the_darkest_part_is_where_to_look():
    """And the brightest is told beside it."""
    told = where_to_look(SimpleNamespace(objects=OBJECTS))
    assert told == "The darkest part, wall, is around row 3, column 17."
    assert where_to_look(SimpleNamespace(objects=OBJECTS[:1])) == ""
    numbers = NUMBERS | {"committed": 1_700, "mean_gbps": None}
    view = SimpleNamespace(numbers=numbers, objects=OBJECTS, config=SimpleNamespace(gap=0))
    assert (
        "In the darkest part, wall (0.12 photons per pixel and pulse), 50% of the pixels are wrong;"
        " in the brightest, lamp (2.50), 6%."
    ) in story(view)
    assert story(view).startswith(
        "Of 2,000 windows 1,700 met their threshold, and 100 found the FIFO full and were dropped."
        " 12% of the events contain only sunlight."
    )


def test_objects_of_compared_views_are_matched_by_name():
    """An object that another view lacks has no share there."""
    other = SimpleNamespace(objects=[seen("lamp", 9.0, 0.75, (0, 0))])
    rows = object_table(SimpleNamespace(objects=OBJECTS), other)
    assert rows[0] == ["wall", "10%", "4.6 m", "0.12", "50.0%", "not known"]
    assert rows[2] == ["lamp", "10%", "4.6 m", "2.50", "6.2%", "75.0%"]
    assert len(rows) == 3
