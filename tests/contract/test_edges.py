# SPDX-License-Identifier: Apache-2.0
"""Limits of the numbers in an edge file."""

import re

import numpy as np
import pytest

from coincid.model.contract.edges import NAMES, Edges, checked_edges, load_edges
from coincid.model.shared.errors import InputError

BOUNDS = {"pulse": 6, "pixel": 5, "tick": 4}


def checked(**arrays):
    usual = {name: np.zeros(3, np.int64) for name in NAMES}
    return checked_edges(
        usual | arrays,
        pixels=BOUNDS["pixel"],
        pulses=BOUNDS["pulse"],
        period_ticks=BOUNDS["tick"],
    )


@pytest.mark.parametrize("name", NAMES)
def test_the_last_legal_number_is_taken_and_the_next_is_not(name):
    last = BOUNDS[name] - 1
    assert getattr(checked(**{name: np.array([0, last, 0])}), name).max() == last
    for wrong in (-1, BOUNDS[name]):
        told = re.escape(f"{name}[2] = {wrong}: must be an integer from 0 to {last}")
        with pytest.raises(InputError, match=told) as refused:
            checked(**{name: np.array([0, 0, wrong])})
        error = refused.value
        assert (error.field, error.low, error.high) == (name, 0, last)


@pytest.mark.parametrize("name", ["pixels", "pulses", "period_ticks"])
def test_limits_of_a_file_are_numbers(name, tmp_path):
    nothing = np.zeros(0, np.int64)
    path = tmp_path / "edges.npz"
    Edges(nothing, nothing, nothing).save(path)
    limits = {"pixels": 4, "pulses": 4, "period_ticks": 4}
    load_edges(path, **limits)
    for wrong in (0, 2.5, "4", None):
        told = re.escape(f"{name} = {wrong!r}: must be an integer from 1 to")
        with pytest.raises(InputError, match=told):
            load_edges(path, **limits | {name: wrong})


@pytest.mark.parametrize("kind", [np.uint8, np.int16, np.uint64])
def test_any_type_of_integers_is_taken(kind):
    edges = checked(tick=np.array([3, 0, 1], kind))
    assert edges.tick.dtype == np.int64
    assert edges.tick.tolist() == [3, 0, 1]


def test_edges_that_are_chosen_keep_their_positions_in_the_ticks():
    zero = np.zeros(3, np.int64)
    edges = Edges(np.array([0, 1, 1]), zero, zero, np.array([1.0, 2.0, 3.0]))
    assert edges.take(edges.pulse == 1).offset_ps.tolist() == [2.0, 3.0]
    assert edges.take(slice(0, 1)).offset_ps.tolist() == [1.0]
    own, _ = edges.frame(1, 1)
    assert own.offset_ps.tolist() == [2.0, 3.0]


def test_parts_are_joined_one_behind_the_other_without_offsets():
    """Of whole numbers, also if there are none."""
    first = Edges(*(np.array([k, k + 1]) for k in (0, 10, 20)), np.array([1.0, 2.0]))
    second = Edges(*(np.array([k]) for k in (7, 17, 27)))
    empty = first.take(slice(0, 0))
    edges = Edges.joined([first, empty, second])
    assert [getattr(edges, name).tolist() for name in NAMES] == [
        [0, 1, 7],
        [10, 11, 17],
        [20, 21, 27],
    ]
    assert edges.offset_ps is None
    for joined in (edges, Edges.joined([]), Edges.joined([empty])):
        assert all(getattr(joined, name).dtype == np.int64 for name in NAMES)
