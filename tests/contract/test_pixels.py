# SPDX-License-Identifier: Apache-2.0
"""Numbers and places of pixels and subgroups, in an array that is not square."""

import numpy as np
import pytest

from coincid.model.contract.parameters import Sensor
from coincid.model.contract.pixels import pixel_number, pixel_table, subgroup_image
from coincid.model.shared.errors import InputError

SENSOR = Sensor(rows=8, cols=24, subgroup=(4, 6), minigroup=(2, 3))


def test_a_pixel_has_one_number_as_a_place_and_as_a_number():
    numbers = [pixel_number(SENSOR, place) for place in np.ndindex(SENSOR.rows, SENSOR.cols)]
    assert numbers == list(range(8 * 24))
    assert [pixel_number(SENSOR, number) for number in numbers] == numbers
    assert pixel_number(SENSOR, [7, 23]) == 8 * 24 - 1


@pytest.mark.parametrize(
    ("pixel", "told"),
    [
        ((8, 0), "row = 8: must be an integer from 0 to 7"),
        ((-1, 0), "row = -1: must be an integer from 0 to 7"),
        ((0, 24), "column = 24: must be an integer from 0 to 23"),
        ((0, -1), "column = -1: must be an integer from 0 to 23"),
        (
            192,
            "pixel = 192: must be an integer from 0 to 191 (or (row, column); the number is row * 24 + column)",
        ),
        (-1, "pixel = -1: must be an integer from 0 to 191 "),
        ((1, 2, 3), "pixel = (1, 2, 3): must be an integer from 0 to 191 "),
    ],
)
def test_what_is_no_pixel_is_told_with_its_range(pixel, told):
    with pytest.raises(InputError) as raised:
        pixel_number(SENSOR, pixel)
    assert str(raised.value).startswith(told)


def test_a_picture_of_subgroups_has_each_where_its_pixels_are():
    picture = subgroup_image(np.arange(SENSOR.subgroups), SENSOR)
    of_pixels = pixel_table(SENSOR).subgroup.reshape(SENSOR.rows, SENSOR.cols)
    assert np.array_equal(np.kron(picture, np.ones(SENSOR.subgroup, int)), of_pixels)


def test_a_subgroup_has_each_of_its_pixels_once_in_its_minigroups():
    """In the table's order, and in that of `members`."""
    table = pixel_table(SENSOR)
    for minigroup in range(SENSOR.minigroups):
        own = np.flatnonzero(table.minigroup == minigroup)
        assert own[np.argsort(table.bit[own])].tolist() == SENSOR.members(minigroup)
        assert sorted(table.bit[own]) == [*range(SENSOR.minigroup_pixels)]
    assert SENSOR.members(3) == [15, 16, 17, 21, 22, 23]
