# SPDX-License-Identifier: Apache-2.0
"""Pixel numbering: the index rules of the contract, as tables.

Pixels count row by row, over the array and inside a subgroup; so do subgroups over the array and minigroups inside a
subgroup.
"""

from typing import NamedTuple

import numpy as np

from .parameters import Sensor


class Pixels(NamedTuple):
    """Tables by pixel: subgroup and number inside for a pixel of the array; minigroup and bit for one of a subgroup (int64)."""

    subgroup: np.ndarray
    inside: np.ndarray
    minigroup: np.ndarray
    bit: np.ndarray


def subgroup_image(values: np.ndarray, sensor: Sensor) -> np.ndarray:
    """One value per subgroup, arranged as in the array: [subgroups down, subgroups across]."""
    return values.reshape(sensor.rows // sensor.subgroup[0], sensor.cols // sensor.subgroup[1])


def pixel_table(sensor: Sensor) -> Pixels:
    """The tables of a sensor, by the index rules of the contract."""
    (sr, sc), (mr, mc) = sensor.subgroup, sensor.minigroup
    row, col = np.divmod(np.arange(sensor.array_pixels), sensor.cols)
    r, c = np.divmod(np.arange(sensor.pixels), sc)
    return Pixels(
        subgroup=(row // sr) * (sensor.cols // sc) + col // sc,
        inside=(row % sr) * sc + col % sc,
        minigroup=(r // mr) * (sc // mc) + c // mc,
        bit=(r % mr) * mc + c % mc,
    )
