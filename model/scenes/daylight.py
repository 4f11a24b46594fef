# SPDX-License-Identifier: Apache-2.0
"""Scenes in which the sun lights one part and not the other. Geometry and reflectivities are our
choice.

Ref: paper I and III-A: thresholds are "adapted" where the background differs, which takes a
picture in which it does.
"""

import math

import numpy as np
from attrs import evolve

from ..light.link_budget import Optics
from .flat_scenes import Plane, planes_scene
from .scene import Scene

SHADE = 0.01  # share of the sun's light that reaches the shade: 1 klux beside 100

# A facade in the sun; on its left a dark gateway in the shade of a roof, whose shadow's edge
# slants through the picture.
YARD = (
    Plane(1, 9.0, 0.50, left=14 / 32),  # facade
    Plane(2, 12.5, 0.10, right=14 / 32),  # back wall of the gateway
    Plane(3, 7.0, 0.10, top=6 / 32, left=3 / 32, right=5 / 32),  # posts in front of it
    Plane(3, 7.5, 0.10, 10 / 32, 28 / 32, 9 / 32, 11 / 32),
    Plane(4, 7.4, 0.12, 15 / 32, 30 / 32, 22 / 32, 30 / 32),  # back of a dark car, in the sun
    Plane(5, 5.6, 0.45, 4 / 32, 11 / 32, 24 / 32, 29 / 32),  # a sign, in the sun
)
# where the shadow's edge meets the upper and lower border of the picture
SHADOW_TOP, SHADOW_BOTTOM = (18 / 32, 14 / 32)

TUNNEL_HALF_M = 2.0  # from the axis to each wall of a square tunnel
EXIT_M = 11.0  # where the tunnel ends
OUTSIDE_M, OUTSIDE_REFLECTIVITY = 14.0, 0.5  # a wall behind the exit
WALL_REFLECTIVITY = 0.15
TRUCK = Plane(3, 8.2, 0.08, 15 / 32, 26 / 32, 9 / 32, 18 / 32)  # dark, in front of the exit's light


def sun_and_shade(rows: int, cols: int, name: str, shade: float) -> Scene:
    """Return the yard: in the sun to the right of the shadow's edge, with `shade` of that light
    to the left.
    """
    yard = planes_scene(YARD, rows, cols, name)
    y, x = (np.arange(rows)[:, None] + 0.5) / rows, (np.arange(cols) + 0.5) / cols
    in_the_sun = x >= SHADOW_TOP + (SHADOW_BOTTOM - SHADOW_TOP) * y
    return evolve(yard, sunlit=np.where(in_the_sun, 1.0, shade))


def tunnel(rows: int, cols: int, name: str, shade: float) -> Scene:
    """Return the exit of a square tunnel: dark receding walls, a dark truck, and a sunlit wall
    behind the exit.
    """
    optics = Optics()
    up = (1 - 2 * (np.arange(rows)[:, None] + 0.5) / rows) * math.tan(
        math.radians(optics.fov_v_deg / 2)
    )
    right = (2 * (np.arange(cols) + 0.5) / cols - 1) * math.tan(math.radians(optics.fov_h_deg / 2))
    steepest = np.maximum(np.abs(up), np.abs(right))
    wall_m = TUNNEL_HALF_M / np.maximum(steepest, TUNNEL_HALF_M / OUTSIDE_M)  # along the axis
    outside = wall_m > EXIT_M
    distance_m = np.where(outside, OUTSIDE_M, wall_m) * np.sqrt(1 + up**2 + right**2)
    truck = planes_scene((TRUCK,), rows, cols, name)
    before = truck.valid
    return Scene(
        name=name,
        distance_m=np.where(before, truck.truth_m, distance_m),
        reflectivity=np.where(
            before,
            truck.reflectivity[:, :, 0],
            np.where(outside, OUTSIDE_REFLECTIVITY, WALL_REFLECTIVITY),
        ),
        labels=np.where(before, truck.labels, np.where(outside, 2, 1)),
        sunlit=np.where(outside & ~before, 1.0, shade),
    )
