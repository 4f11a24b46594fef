# SPDX-License-Identifier: Apache-2.0
"""Columns of events that may come from a run of a configuration: the ends of their ranges."""

import numpy as np
import pytest

from coincid.model.contract.config import parse_config
from coincid.model.contract.result import EVENT_COLUMNS, checked_events
from coincid.model.shared.errors import InputError

CONFIG = parse_config(
    {
        "sensor": {"rows": 8, "cols": 36, "subgroup": [4, 12], "phases": 16},
        "frame": {"pulses": 20, "period": 60, "frames": 2},
    }
)
LAST = {
    "pulse": 2 * 20 - 1,
    "subgroup": 2 * 3 - 1,
    "stamp": 60 * 16 - 1,
    "count": 4 * 12,
    "winner": 4 * 12 - 1,
}
EVENTS = 5
RESULT = {name: np.arange(EVENTS) for name in EVENT_COLUMNS} | {
    "hits": np.arange(EVENTS, dtype=np.uint64)[:, None],
    "opened": np.full((2, 6), 7),
}


@pytest.mark.parametrize("name", LAST)
def test_a_column_of_events_may_hold_its_last_number_and_no_other(name):
    """All pixels of a subgroup may be in a window."""
    for place in (0, -1):
        column = RESULT[name].copy()
        column[place] = LAST[name]
        found = checked_events(RESULT | {name: column}, CONFIG)
        assert np.array_equal(found[name], column)
        assert np.array_equal(found["hits"], RESULT["hits"])
        for wrong in (LAST[name] + 1, -1):
            column[place] = wrong
            ends = rf"{column.min()} to {column.max()}, must be 0 to {LAST[name]}"
            with pytest.raises(InputError, match=f"^arrays: {name} is {ends}; the configuration"):
                checked_events(RESULT | {name: column}, CONFIG)


@pytest.mark.parametrize("kind", ["u1", "i2", ">i4", "u4", "u8", "i8"])
def test_columns_of_any_integers_become_int64(kind):
    """As in a result that was kept in smaller columns: what is computed from them does not wrap."""
    smaller = {name: RESULT[name].astype(kind) for name in LAST}
    found = checked_events(RESULT | smaller, CONFIG)
    for name in LAST:
        assert found[name].dtype == np.int64
        assert found[name].dtype.isnative
        assert np.array_equal(found[name], RESULT[name])


def test_a_result_without_events_is_one_of_any_run():
    empty = {name: RESULT[name][:0] for name in (*EVENT_COLUMNS, "hits")}
    found = checked_events(RESULT | empty, CONFIG)
    assert all(len(found[name]) == 0 for name in LAST)


@pytest.mark.parametrize(
    ("changed", "told"),
    [
        ({"hits": np.zeros((4, 1), np.uint64)}, r"hits is uint64\[4, 1\], must be uint64\[5, 1\]"),
        ({"hits": np.zeros((5, 2), np.uint64)}, r"hits is uint64\[5, 2\], must be uint64\[5, 1\]"),
        ({"hits": np.zeros((5, 1))}, r"hits is float64\[5, 1\], must be uint64\[5, 1\]"),
        (
            {"opened": np.zeros((2, 5))},
            r"opened has shape \(2, 5\), must be \[frames, 6 subgroups\]",
        ),
        ({"opened": np.zeros(6)}, r"opened has shape \(6,\), must be \[frames, 6 subgroups\]"),
        (
            {"count": np.zeros(5)},
            r"count is float64\[5\], must be integers, one for each of 5 events",
        ),
        (
            {"winner": np.zeros(6, int)},
            r"winner is int64\[6\], must be integers, one for each of 5",
        ),
        (
            {"opened": np.zeros((1, 6)), "pulse": RESULT["pulse"] + 16},
            "pulse is 16 to 20, must be 0 to 19",
        ),
    ],
)
def test_what_cannot_come_from_a_run_of_the_configuration_is_told(changed, told):
    """By its array, with what it must be."""
    with pytest.raises(InputError, match=f"^arrays: {told}") as raised:
        checked_events(RESULT | changed, CONFIG)
    assert raised.value.field == "arrays"


def test_a_result_of_a_format_without_maps_has_none():
    without = {name: array for name, array in RESULT.items() if name != "hits"}
    assert set(checked_events(without, CONFIG)) == {*LAST, "opened"}
