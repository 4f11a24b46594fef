# SPDX-License-Identifier: Apache-2.0
"""Arguments that several rooms take, and packages that are not there."""

from types import NoneType

import numpy as np
import pytest

from coincid.model.shared.arguments import WORKERS_MAX, check_kind, check_workers
from coincid.model.shared.arrays import joined, keep_only, longer
from coincid.model.shared.errors import TOLD_MAX, InputError, extra, wrong_value


@pytest.mark.parametrize("workers", [1, 2, WORKERS_MAX])
def test_a_number_of_threads_is_taken(workers):
    assert check_workers(workers) == workers


@pytest.mark.parametrize("workers", [0, -1, WORKERS_MAX + 1, 1.0, None])
def test_another_number_of_threads_is_refused(workers):
    with pytest.raises(
        InputError, match=rf"^workers = .*: must be an integer from 1 to {WORKERS_MAX}$"
    ):
        check_workers(workers)


def test_a_value_of_another_class_is_told_all_that_it_may_be():
    assert check_kind("x", None, dict, NoneType) is None
    assert check_kind("x", {}, dict, NoneType) == {}
    for value in (3, "a"):
        with pytest.raises(InputError) as raised:
            check_kind("x", value, dict, NoneType)
        assert str(raised.value) == f"x = {value!r}: must be dict or None"
        assert raised.value.field == "x"


@pytest.mark.parametrize(
    ("missing", "told"), [("pandas", "pandas"), ("coincidence", "coincidence")]
)
def test_a_missing_package_is_told_with_the_extra_that_has_it(missing, told):
    """Which has a name of its own."""
    with (
        pytest.raises(InputError) as raised,
        extra("sweep"),
    ):
        raise ModuleNotFoundError(f"No module named {missing!r}", name=missing)
    assert str(raised.value) == f"{told} is not installed; run: pip install 'coincid[sweep]'"


@pytest.mark.parametrize("own", ["coincid", "coincid.lab.moon"])
def test_a_missing_module_of_this_project_is_our_own_mistake(own):
    with pytest.raises(ModuleNotFoundError), extra("sweep"):
        raise ModuleNotFoundError(f"No module named {own!r}", name=own)


@pytest.mark.parametrize("length", [TOLD_MAX - 1, TOLD_MAX, TOLD_MAX + 1])
def test_a_value_is_told_whole_up_to_its_longest(length):
    value = "x" * (length - 2)  # its text has two quotes
    told = str(wrong_value("name", value, "short"))
    shown = repr(value) if length <= TOLD_MAX else f"{repr(value)[:TOLD_MAX]} ..."
    assert told == f"name = {shown}: must be short"


def test_a_value_is_told_in_one_line_whatever_it_is():
    told = str(wrong_value("name", np.ones((2, 2)), "a number"))
    assert told == "name = array([[1., 1.], [1., 1.]]): must be a number"
    told = str(wrong_value("name", 10**5000, "an integer from 0 to 3"))
    assert told == "name = a number of thousands of digits: must be an integer from 0 to 3"
    assert str(wrong_value("name", "a  b", "x")) == "name = 'a  b': must be x"


def test_a_single_array_is_joined_as_it_is_if_it_is_contiguous():
    rows = np.arange(12).reshape(3, 4)
    assert joined([rows]) is rows
    across = joined([rows.T])
    assert across.flags.c_contiguous
    assert np.array_equal(across, rows.T)
    assert np.array_equal(joined([rows, rows[:1]]), rows[[0, 1, 2, 0]])


def test_a_longer_array_has_zeros_behind_the_old_items():
    """And the same type."""
    found = longer(np.array([3, 4], np.uint8), 5)
    assert found.dtype == np.uint8
    assert found.tolist() == [3, 4, 0, 0, 0]
    assert longer(np.array([3, 4]), 2).tolist() == [3, 4]


@pytest.mark.parametrize(("first", "number"), [(0, 8), (1, 7), (3, 4), (6, 0)])
def test_items_that_are_kept_move_to_the_beginning(first, number):
    """Also where they overlap their new place."""
    array = np.arange(8)
    keep_only(array, first, number)
    assert array[:number].tolist() == [*range(first, first + number)]
