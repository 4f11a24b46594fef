"""Pixel numbering: the index rules of the contract, as tables.

Pixels count row by row, over the array and inside a subgroup; so do subgroups over the array and minigroups inside a subgroup.
"""

from typing import NamedTuple

import numpy as np

from .parameters import Sensor


class Pixels(NamedTuple):
    """Tables by pixel: of the array its subgroup and its number inside; of a subgroup its minigroup and its bit in that (int64)."""

    subgroup: np.ndarray
    inside: np.ndarray
    minigroup: np.ndarray
    bit: np.ndarray


def pixel_table(sensor: Sensor) -> Pixels:
    """Where every pixel of the array and of a subgroup belongs (index rules of the contract)."""
    (sr, sc), (mr, mc) = sensor.subgroup, sensor.minigroup
    row, col = np.divmod(np.arange(sensor.array_pixels), sensor.cols)
    r, c = np.divmod(np.arange(sensor.pixels), sc)
    return Pixels(
        subgroup=(row // sr) * (sensor.cols // sc) + col // sc,
        inside=(row % sr) * sc + col % sc,
        minigroup=(r // mr) * (sc // mc) + c // mc,
        bit=(r % mr) * mc + c % mc,
    )
