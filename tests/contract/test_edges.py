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


@pytest.mark.parametrize("name", NAMES)
def test_columns_of_other_lengths_kinds_and_shapes_are_named(name):
    """Whichever column it is."""
    for wrong, told in (
        (np.zeros(2, np.int64), f"lengths differ: .*{name} 2"),
        (np.zeros(3), f"^{name}: holds float64, must hold integers"),
        (np.zeros(3, bool), f"^{name}: holds bool, must hold integers"),
        (np.zeros((3, 1), np.int64), f"^{name}: has 2 dimensions, must have 1"),
    ):
        with pytest.raises(InputError, match=told):
            checked(**{name: wrong})


def test_no_edges_are_edges():
    """Also as an empty list, which NumPy takes for floats."""
    edges = checked(**{name: np.array([]) for name in NAMES})
    assert len(edges) == 0
    assert all(getattr(edges, name).dtype == np.int64 for name in NAMES)
    assert repr(edges) == "<Edges: none>"


@pytest.mark.parametrize("kind", [np.int8, np.uint16, np.float32, np.float64])
def test_positions_in_a_tick_are_numbers_of_any_type(kind):
    edges = checked(offset_ps=np.array([0, 3, 1], kind))
    assert edges.offset_ps.dtype == np.float64
    assert edges.offset_ps.tolist() == [0, 3, 1]


@pytest.mark.parametrize(
    ("offset_ps", "told"),
    [
        ([0.0, 1.0], r"^offset_ps: holds float64\[2\], must hold 3 numbers"),
        ([False, True, True], r"^offset_ps: holds bool\[3\], must hold 3 numbers"),
        ([0.0, 1.0, -0.5], r"^offset_ps\[2\] = -0.5: must be a number from 0 to a tick's length"),
        ([0.0, np.nan, -1.0], r"^offset_ps\[1\] = nan: must be"),
        ([np.inf, 0.0, 0.0], r"^offset_ps\[0\] = inf: must be"),
    ],
)
def test_positions_that_are_none_are_told_with_their_place(offset_ps, told):
    with pytest.raises(InputError, match=told) as raised:
        checked(offset_ps=np.array(offset_ps))
    assert raised.value.field == "offset_ps"


@pytest.mark.parametrize("offset_ps", [None, np.array([0.5, 2.0])])
def test_edges_come_back_from_their_file(tmp_path, offset_ps):
    edges = Edges(np.array([1, 3]), np.array([4, 0]), np.array([2, 3]), offset_ps)
    edges.save(tmp_path / "a.npz")
    again = load_edges(tmp_path / "a.npz", pixels=5, pulses=6, period_ticks=4)
    for name in NAMES:
        assert getattr(again, name).tolist() == getattr(edges, name).tolist()
    assert again.offset_ps is None if offset_ps is None else again.offset_ps.tolist() == [0.5, 2.0]
    assert repr(again) == "<Edges: 2, pulses 1 to 3>"


@pytest.mark.parametrize("name", ["a.csv", "a.CSV", "a.h5", "a.hdf5", "a.ptu"])
def test_a_file_of_another_program_is_told_what_makes_edges_of_it(name, tmp_path):
    """If there is one."""
    limits = {"pixels": 5, "pulses": 6, "period_ticks": 4}
    path = tmp_path / name
    with pytest.raises(InputError, match=f"{name}: no such file$"):
        load_edges(path, **limits)
    path.touch()
    told = f"{name}: is read as NPZ; coincid edges makes one of a {path.suffix.lower()} file$"
    with pytest.raises(InputError, match=told):
        load_edges(path, **limits)
