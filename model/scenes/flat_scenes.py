# SPDX-License-Identifier: Apache-2.0
"""Scenes of planes that face the sensor.

Ref: paper IV, Fig. 4; details that the paper does not give, and the other scenes, are our choice.
"""

from collections.abc import Sequence

import numpy as np
from attrs import frozen

from .scene import NO_OBJECT, Scene

STRIPE_PIXELS = 4  # of the scene `two-targets`: both surfaces in every subgroup of 8 columns


@frozen
class Plane:
    """A rectangle that faces the sensor; borders are shares of the picture, rows from the top,
    columns from the left.
    """

    label: int
    distance_m: float
    reflectivity: float
    top: float = 0.0
    bottom: float = 1.0
    left: float = 0.0
    right: float = 1.0


# After the paper's Fig. 4: numbers and kinds of the objects, nearest and farthest distance are
# from the paper, the rest is ours. Borders are multiples of 1/32 and differ from those of
# subgroups of 8 x 8, so that surfaces share subgroups.
FIVE_OBJECTS = (
    Plane(1, 9.7, 0.60),  # white wall
    Plane(2, 7.2, 0.08, 9 / 32, 21 / 32, 2 / 32, 13 / 32),  # dark object
    Plane(3, 8.4, 0.55, 0, 1, 18 / 32, 23 / 32),  # white pillar
    Plane(4, 4.3, 0.45, 17 / 32, 30 / 32, 21 / 32, 30 / 32),  # aluminium bin
    Plane(5, 6.1, 0.10, 23 / 32, 1, 6 / 32, 17 / 32),  # dark object
)
LETTER_F = (
    Plane(1, 8.0, 0.4),
    Plane(2, 5.0, 0.4, 4 / 32, 27 / 32, 6 / 32, 11 / 32),  # stem
    Plane(2, 5.0, 0.4, 4 / 32, 9 / 32, 6 / 32, 24 / 32),  # upper arm
    Plane(2, 5.0, 0.4, 14 / 32, 18 / 32, 6 / 32, 20 / 32),  # lower arm, shorter
)


def planes_scene(planes: tuple[Plane, ...], rows: int, cols: int, name: str) -> Scene:
    """Return the nearest of `planes` at each pixel's centre; no target if there is none."""
    y, x = (np.arange(rows)[:, None] + 0.5) / rows, (np.arange(cols) + 0.5) / cols
    distance_m = np.full((rows, cols), np.nan)
    reflectivity, labels = np.zeros((rows, cols)), np.full((rows, cols), NO_OBJECT)
    for plane in planes:
        inside = (plane.top <= y) & (y < plane.bottom) & (plane.left <= x) & (x < plane.right)
        seen = inside & ~(distance_m <= plane.distance_m)
        distance_m[seen], reflectivity[seen], labels[seen] = (
            plane.distance_m,
            plane.reflectivity,
            plane.label,
        )
    return Scene(name=name, distance_m=distance_m, reflectivity=reflectivity, labels=labels)


def flat(rows: int, cols: int, name: str, distance_m: float, reflectivity: float) -> Scene:
    """Return a single plane that fills the picture."""
    return planes_scene((Plane(1, distance_m, reflectivity),), rows, cols, name)


def two_targets(
    rows: int, cols: int, name: str, near_m: float, far_m: float, reflectivity: float
) -> Scene:
    """Return stripes of `STRIPE_PIXELS` columns, the near surface first."""
    far = np.broadcast_to(np.arange(cols) // STRIPE_PIXELS % 2, (rows, cols))
    distance_m = np.where(far, far_m, near_m)
    return Scene(name=name, distance_m=distance_m, reflectivity=reflectivity, labels=1 + far)


def returns(rows: int, cols: int, name: str, targets: Sequence[tuple[float, float]]) -> Scene:
    """Return surfaces that every pixel sees behind each other, as through meshes: (distance in
    metres, reflectivity) of each.

    Every surface sends back the light of its reflectivity; none takes light from those behind it.
    """
    distance_m, reflectivity = np.transpose(targets)
    shape = (rows, cols, len(targets))
    return Scene(
        name=name,
        distance_m=np.broadcast_to(distance_m, shape),
        reflectivity=np.broadcast_to(reflectivity, shape),
        labels=1,
    )
