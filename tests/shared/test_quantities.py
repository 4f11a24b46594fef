# SPDX-License-Identifier: Apache-2.0
"""Legal ranges include their ends; arrays are copies that nobody can change."""

import numpy as np
import pytest
from attrs import NOTHING, evolve, frozen
from hypothesis import given
from hypothesis import strategies as st

from coincid.model.shared.errors import InputError, check_integer, told_number
from coincid.model.shared.quantities import (
    check_choice,
    check_real,
    check_switch,
    integer,
    real,
    real_array,
    switch,
)

LOW, HIGH = -2.0, 3.0
INSIDE = (LOW, 0.0, HIGH)
OUTSIDE = (np.nextafter(LOW, -9), np.nextafter(HIGH, 9), np.inf, -np.inf, np.nan)


@frozen
class Quantities:
    """Fields with both ends, and without a highest value."""

    share: float = real(1.0, LOW, HIGH)
    rate_cps: float = real(2.0, LOW)
    pulses: int = integer(5, 1, 100)
    far_m: float | None = real(None, 1, 100)
    gated: bool = switch(False)


@frozen
class Rows:
    """A field that must be given."""

    rows: int = integer(NOTHING, 1, 8)


@pytest.mark.parametrize("value", INSIDE)
def test_the_ends_of_a_range_are_legal(value):
    assert check_real("x", value, LOW, HIGH) == value
    assert check_integer("x", int(value), int(LOW), int(HIGH)) == value
    assert real_array("x", [value, 1.0], (2,), LOW, HIGH).tolist() == [value, 1.0]


@pytest.mark.parametrize("value", OUTSIDE)
def test_what_is_beyond_the_ends_is_refused(value):
    with pytest.raises(InputError, match="^x = .*: must be a number from -2 to 3"):
        check_real("x", value, LOW, HIGH)
    with pytest.raises(InputError, match=r"^x\[1\] = .*: must be from -2 to 3$") as raised:
        real_array("x", [1.0, value], (2,), LOW, HIGH)
    assert (raised.value.field, raised.value.low, raised.value.high) == ("x", LOW, HIGH)


@pytest.mark.parametrize("value", (-3, 4))
def test_an_integer_beyond_the_ends_is_refused(value):
    with pytest.raises(InputError, match="must be an integer from -2 to 3"):
        check_integer("x", value, -2, 3)


@pytest.mark.parametrize("kind", (np.int8, np.uint8, np.int16, np.uint32, np.int64, np.uint64))
def test_a_number_of_numpy_comes_back_as_one_of_python(kind):
    """So what is computed from it does not wrap."""
    found = check_integer("x", kind(100), 0, 1 << 40)
    assert type(found) is int
    assert found == 100
    assert type(check_real("x", kind(100), 0.0)) is float


@pytest.mark.parametrize("kind", (np.float16, np.float32, np.float64))
def test_a_float_of_numpy_comes_back_as_one_of_python(kind):
    found = check_real("x", kind(100), 0.0)
    assert type(found) is float
    assert found == 100.0


@pytest.mark.parametrize(
    "value", (True, np.True_, 1.0, np.float64(1), "1", None, [1], np.timedelta64(1, "s"))
)
def test_what_is_no_integer_is_refused(value):
    with pytest.raises(InputError, match=r"^x = .*: must be an integer from 0 to 3 \(2 bits\)$"):
        check_integer("x", value, 0, 3, "2 bits")


@pytest.mark.parametrize("value", (np.inf, -np.inf))
def test_infinity_is_refused_where_nan_is_legal_and_no_end_is_given(value):
    assert np.isnan(real_array("x", [np.nan, 1.0], (2,), 0, nan=True)[0])
    with pytest.raises(InputError, match=r"must be at least 0 or NaN$"):
        real_array("x", [1.0, value], (2,), 0, nan=True)


def test_an_array_is_a_copy():
    mine = np.array([1.0, 2.0])
    checked = real_array("x", mine, (2,), 0)
    mine[0] = 5.0
    assert checked.tolist() == [1.0, 2.0]
    with pytest.raises(ValueError, match="read-only"):
        checked[0] = 3.0


def test_a_field_has_its_default_and_both_ends():
    assert Quantities() == Quantities(share=1.0, rate_cps=2.0)
    for value in INSIDE:
        assert Quantities(share=value, rate_cps=value) == Quantities(value, value)
    assert Quantities(rate_cps=1e300).rate_cps == 1e300


@pytest.mark.parametrize("value", (True, np.True_, False, np.False_))
def test_a_field_of_a_switch_is_a_bool(value):
    assert Quantities(gated=value).gated is bool(value)


@pytest.mark.parametrize("value", (0, 1, "false", None, np.ones(2, bool)))
def test_a_field_of_a_switch_refuses_everything_else(value):
    with pytest.raises(InputError, match="^gated = .*: must be true or false$"):
        Quantities(gated=value)


@pytest.mark.parametrize("value", (*OUTSIDE, None, "1", True))
def test_a_field_refuses_what_is_beyond_its_ends_by_its_name(value):
    with pytest.raises(InputError, match="^share = .*: must be a number from -2 to 3$") as raised:
        Quantities(share=value)
    assert (raised.value.field, raised.value.low, raised.value.high) == ("share", LOW, HIGH)


@pytest.mark.parametrize("value", (np.nextafter(LOW, -9), np.inf, -np.inf, np.nan))
def test_a_field_without_a_highest_value_has_the_lowest(value):
    with pytest.raises(InputError, match="^rate_cps = .*: must be a number of at least -2$"):
        Quantities(rate_cps=value)


@pytest.mark.parametrize("value", (0, 101, 5.0, True, None))
def test_a_field_of_an_integer_refuses_all_else_by_its_name(value):
    with pytest.raises(InputError, match="^pulses = .*: must be an integer from 1 to 100$"):
        Quantities(pulses=value)
    with pytest.raises(InputError, match="^pulses = "):
        evolve(Quantities(), pulses=value)


def test_a_field_may_be_none_if_that_is_its_default():
    assert Quantities().far_m is None
    assert Quantities(far_m=None).far_m is None
    assert Quantities(far_m=7).far_m == 7.0
    with pytest.raises(InputError, match="^far_m = 0: must be a number from 1 to 100$"):
        Quantities(far_m=0)


def test_a_field_without_a_default_must_be_given():
    assert Rows(rows=8).rows == 8
    with pytest.raises(TypeError, match="rows"):
        Rows()


@pytest.mark.parametrize("kind", (np.int8, np.uint8, np.int64))
def test_a_field_of_numpy_holds_a_number_of_python(kind):
    """So what is computed from it does not wrap."""
    made = Quantities(rate_cps=kind(100), pulses=kind(100), far_m=kind(100))
    assert [type(one) for one in (made.rate_cps, made.pulses, made.far_m)] == [float, int, float]
    assert made == Quantities(rate_cps=100.0, pulses=100, far_m=100.0)


@given(st.floats(allow_nan=False) | st.integers(-(2**53), 2**53))
def test_a_told_number_comes_back(value):
    assert float(told_number(value)) == value


@pytest.mark.parametrize(
    ("value", "told"), [(3.0, "3"), (0.25, "0.25"), (1e12, "1e+12"), (1234567.0, "1234567")]
)
def test_a_told_number_is_short(value, told):
    assert told_number(value) == told


def test_a_limit_that_is_told_is_legal():
    low = 1 / 3
    with pytest.raises(InputError, match="must be a number of at least 0.3333333333333333$"):
        check_real("x", 0.333333, low)
    assert check_real("x", 0.3333333333333333, low) == low


@pytest.mark.parametrize(
    ("value", "shape", "place", "wrong"),
    [
        (-1.0, (), "", "-1.0"),
        ([3.0, -1.0], (2,), "[1]", "-1.0"),
        ([[1.0, 2.0], [9.0, -9.0]], (2, 2), "[1, 0]", "9.0"),
        ([[1.0], [9.0]], (2, 3), "[1, 0]", "9.0"),
    ],
)
def test_the_first_wrong_element_of_an_array_is_told_with_its_place(value, shape, place, wrong):
    """A single number has none."""
    with pytest.raises(InputError) as raised:
        real_array("x", value, shape, 0, 5)
    assert str(raised.value) == f"x{place} = {wrong}: must be from 0 to 5"


@pytest.mark.parametrize(
    ("value", "told"),
    [
        ([1.0, 2.0, 3.0], r"^x: has shape \(3,\), must be \(2,\) or broadcast to it$"),
        ([[1.0, 2.0]], r"^x: has shape \(1, 2\), must be \(2,\) or broadcast to it$"),
        (["a", 1.0], r"^x: must hold numbers from 0 to 5$"),
        ([1j, 2.0], r"^x: must hold numbers from 0 to 5$"),
        ([2**2000, 1], r"^x: must hold numbers from 0 to 5$"),
        (None, r"^x(: must hold numbers| = nan: must be) from 0 to 5$"),
    ],
)
def test_an_array_of_another_kind_or_shape_is_refused(value, told):
    with pytest.raises(InputError, match=told) as raised:
        real_array("x", value, (2,), 0, 5) if value is not None else real_array(
            "x", value, (), 0, 5
        )
    assert raised.value.field == "x"


def test_one_number_or_row_stands_for_all():
    assert real_array("x", 2, (2, 3), 0, 5).tolist() == [[2.0] * 3] * 2
    assert real_array("x", [[1], [2]], (2, 3), 0, 5).tolist() == [[1.0] * 3, [2.0] * 3]
    assert real_array("x", [1, 2, 3], (2, 3), 0, 5).flags.c_contiguous


@pytest.mark.parametrize("value", [1, 0, "true", None, np.True_, [True]])
def test_a_switch_is_true_or_false(value):
    assert check_switch("x", True) is True
    assert check_switch("x", False) is False
    with pytest.raises(InputError, match="^x = .*: must be true or false$"):
        check_switch("x", value)


@pytest.mark.parametrize("value", ["c", "A", None, ["a"], np.array(["a", "b"]), {}])
def test_a_choice_is_one_of_those_that_are_told(value):
    """Also if it is of a kind that cannot be compared with them."""
    assert check_choice("x", "b", ("a", "b")) == "b"
    with pytest.raises(InputError, match="^x = .*: must be one of a, b$"):
        check_choice("x", value, ("a", "b"))
