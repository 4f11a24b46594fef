# SPDX-License-Identifier: Apache-2.0
"""Pixel numbering: the index rules of the contract as tables, and the SPAD ports of the
polyphase view.

Pixels are numbered row by row, both in the array and in a subgroup. The same holds for the
subgroups in the array and the minigroups in a subgroup.
"""

from functools import cache
from typing import Any, NamedTuple

import numpy as np

from ..shared.errors import check_integer
from .config import Config
from .edges import Edges
from .parameters import Sensor


class Pixels(NamedTuple):
    """Tables by pixel, int64: subgroup and number in it for the array's pixels; minigroup and
    bit for a subgroup's.
    """

    subgroup: np.ndarray
    inside: np.ndarray
    minigroup: np.ndarray
    bit: np.ndarray


def pixel_number(sensor: Sensor, pixel: Any) -> int:
    """Return the number of a pixel that is given as (row, column) or by its number. Raises
    `InputError`.
    """
    if isinstance(pixel, tuple | list) and len(pixel) == 2:
        row, col = (
            check_integer(*one)
            for one in (
                ("row", pixel[0], 0, sensor.rows - 1),
                ("column", pixel[1], 0, sensor.cols - 1),
            )
        )
        return row * sensor.cols + col
    last = sensor.array_pixels - 1
    return check_integer(
        "pixel", pixel, 0, last, f"or (row, column); the number is row * {sensor.cols} + column"
    )


def subgroup_image(values: np.ndarray, sensor: Sensor) -> np.ndarray:
    """Return one value per subgroup, arranged as in the array: [subgroups down, subgroups
    across].
    """
    return values.reshape(sensor.rows // sensor.subgroup[0], sensor.cols // sensor.subgroup[1])


@cache
def pixel_table(sensor: Sensor) -> Pixels:
    """Return the tables of a sensor, which are made once; do not change them."""
    (sr, sc), (mr, mc) = sensor.subgroup, sensor.minigroup
    row, col = np.divmod(np.arange(sensor.array_pixels), sensor.cols)
    r, c = np.divmod(np.arange(sensor.pixels), sc)
    return Pixels(
        subgroup=(row // sr) * (sensor.cols // sc) + col // sc,
        inside=(row % sr) * sc + col % sc,
        minigroup=(r // mr) * (sc // mc) + c // mc,
        bit=(r % mr) * mc + c % mc,
    )


def port_bits(config: Config, edges: Edges) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return a frame's edges as (cycle of the frame, subgroup whose port it is, bit in its
    word), int64[n] each.

    Bit i * phases + k is phase k of pixel i.
    """
    table, phases = pixel_table(config.sensor), config.sensor.phases
    cycle, phase = np.divmod(edges.tick, phases)
    pixel = edges.pixel
    return (
        config.start_cycles()[edges.pulse] + cycle,
        table.subgroup[pixel],
        table.inside[pixel] * phases + phase,
    )
