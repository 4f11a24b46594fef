# SPDX-License-Identifier: Apache-2.0
"""Where the pixels look: the geometry that scenes, point clouds and PLY files share.

A distance is the length along the ray through the middle of a pixel; z is its part along the
axis of the lens.
"""

import numpy as np
from attrs import frozen

from ..light.link_budget import Optics
from ..shared.errors import InputError
from ..shared.quantities import real


@frozen(kw_only=True)
class View:
    """Field of view that the pixels share, evenly spaced in the plane of the sensor."""

    h_deg: float = real(Optics().fov_h_deg, 1e-3, 179)
    v_deg: float = real(Optics().fov_v_deg, 1e-3, 179)

    def tangents(self, rows: int, cols: int) -> tuple[np.ndarray, np.ndarray]:
        """float64[rows, cols] twice: how far right and down a pixel looks, per metre of z."""
        right = _tangents(cols, self.h_deg)
        down = _tangents(rows, self.v_deg)
        every_right, every_down = np.meshgrid(right, down)
        return every_right, every_down

    def ray_per_z(self, rows: int, cols: int) -> np.ndarray:
        """float64[rows, cols]: length along the ray of a pixel, per metre of z."""
        right, down = self.tangents(rows, cols)
        return np.sqrt(1 + right**2 + down**2)

    @classmethod
    def of_part(cls, whole_deg: float, full: tuple[int, int], part: tuple[int, int]) -> "View":
        """Return the view of the middle of a picture. whole_deg: of its whole width; full, part:
        rows and columns.

        The samples of the picture are square. Raises `InputError` for a part that is too narrow or too
        wide.
        """
        per_sample = 2 * np.tan(np.radians(whole_deg) / 2) / full[1]
        half = np.arctan(per_sample * np.array(part) / 2)
        v_deg, h_deg = np.degrees(2 * half).tolist()
        try:
            return cls(h_deg=h_deg, v_deg=v_deg)
        except InputError as error:
            message = f"fov_deg = {whole_deg:g}: does not go with the sensor's part of the picture: {error}"
            raise InputError(message, field="fov_deg") from None


def _tangents(pixels: int, fov_deg: float) -> np.ndarray:
    """Return the tangents of the angles between the axis and the middles of pixels that share a
    field of view.
    """
    return (2 * np.arange(pixels) + 1 - pixels) / pixels * np.tan(np.radians(fov_deg) / 2)
