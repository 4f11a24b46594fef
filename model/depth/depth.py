# SPDX-License-Identifier: Apache-2.0
"""Estimated depth, as every estimator returns it."""

import math
from collections.abc import Callable, Sequence
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from attrs import evolve, field, frozen
from numpy.typing import ArrayLike

from ..shared.errors import InputError
from ..shared.files import FilePath, write_npz
from ..shared.quantities import real_array, shape_of
from .belief import BELIEVED_MIN, SENTENCES, Reason

if TYPE_CHECKING:
    from .intensity import Intensity

SAVED = (
    "depth_m",
    "confidence",
    "reason",
    "error_m",
    "slope_m",
    "signal_per_pulse",
    "signal_error",
)


@frozen(eq=False)
class Depth:
    """Estimated depth of rows x cols pixels.

    Attributes
    ----------
    depth_m : numpy.ndarray
        float64[rows, cols, returns], in metres, the most likely return first; NaN = none.
    confidence : numpy.ndarray
        float64[rows, cols, returns], from 0 to 1. For the first return, the probability that it
        is right by the paper's criterion; for the others, that they are not accidental background.
    reason : numpy.ndarray
        uint8[rows, cols], `belief.Reason`: whether the first return is to be believed (0), and
        if not, why.
    error_m : numpy.ndarray or None
        float64[rows, cols, returns], standard error in metres; only with `planes`.
    slope_m : numpy.ndarray or None
        float64[rows, cols, 2], increase of the distance from row to row and from column to
        column, in metres; only with `planes`.
    light : Intensity or callable or None
        The light of the returns, or what computes it when `signal_per_pulse` or `signal_error` is
        asked for; None: unknown.
    """

    depth_m: np.ndarray
    confidence: np.ndarray
    reason: np.ndarray
    error_m: np.ndarray | None = None
    slope_m: np.ndarray | None = None
    light: "Intensity | Callable[[], Intensity] | None" = field(default=None, repr=False)

    @cached_property
    def _intensity(self) -> "Intensity | None":
        return self.light() if callable(self.light) else self.light

    def with_light(self) -> "Depth":
        """Return this depth with its light computed, so that no event is kept for it."""
        return evolve(self, light=self._intensity)

    @property
    def signal_per_pulse(self) -> np.ndarray | None:
        """float64[rows, cols, returns] or None: estimated signal of each return in detected photons
        per laser pulse, before the dead time, as `Light.signal_per_pulse`; NaN = no depth, or a
        masked pixel.
        """
        return None if self._intensity is None else self._intensity.signal

    @property
    def signal_error(self) -> np.ndarray | None:
        """float64[rows, cols, returns] or None: standard error of `signal_per_pulse`."""
        return None if self._intensity is None else self._intensity.error

    @classmethod
    def of(cls, depth_m: ArrayLike, confidence: ArrayLike = 1.0) -> "Depth":
        """Return the depth of an estimator that gives no reasons; they follow from its confidence.

        depth_m: float64[rows, cols] or [rows, cols, returns], NaN = none; confidence: broadcast
        to it, 0 where there is no depth. Raises `InputError`.
        """
        shape = shape_of("depth_m", depth_m)
        if len(shape) not in (2, 3) or not all(shape[2:]):
            raise InputError(
                f"depth_m: has shape {shape}, must be [rows, cols] or [rows, cols, returns]",
                field="depth_m",
            )
        distance_m = real_array("depth_m", depth_m, shape, -math.inf, nan=True).copy()
        if distance_m.ndim == 2:
            distance_m = distance_m[:, :, None]
        if len(shape_of("confidence", confidence)) == 2:
            confidence = np.asanyarray(confidence)[:, :, None]
        sure = real_array("confidence", confidence, distance_m.shape, 0, 1, nan=True)
        sure = np.where(np.isnan(distance_m), 0.0, sure)
        if np.isnan(sure).any():
            raise InputError("confidence: is NaN where there is a depth", field="confidence")
        reason = np.full(distance_m.shape[:2], Reason.FEW_PHOTONS, np.uint8)
        reason[np.isnan(distance_m[:, :, 0])] = Reason.NO_LIGHT
        reason[sure[:, :, 0] >= BELIEVED_MIN] = Reason.BELIEVED
        return cls(distance_m, sure, reason)

    def __repr__(self) -> str:
        """Return one line: size, range of the distances, and how many are to be believed."""
        rows, cols, returns = self.depth_m.shape
        first_m = self.depth_m[:, :, 0]
        size = f"{rows} x {cols} pixels, {returns} return{'s' * (returns > 1)}"
        if np.isnan(first_m).all():
            return f"<Depth: {size}, no distance>"
        span = f"{np.nanmin(first_m):.3g} to {np.nanmax(first_m):.3g} m"
        believed = np.mean(self.reason == Reason.BELIEVED)
        return f"<Depth: {size}, {span}, {believed:.0%} to be believed>"

    def save(self, path: FilePath) -> None:
        """Write the arrays that there are as NPZ, whole or not at all; `sentences` are those of
        the reasons. Raises `InputError` for another suffix.
        """
        write_npz(
            path, _saved(self) | {"sentences": np.array([SENTENCES[reason] for reason in Reason])}
        )


def _saved(depth: Depth) -> dict[str, np.ndarray]:
    """Return the arrays that there are, of those that are saved."""
    arrays = {name: getattr(depth, name) for name in SAVED}
    return {name: part for name, part in arrays.items() if part is not None}


def write_depths(path: FilePath, depths: Sequence[Depth], truth_m: ArrayLike | None = None) -> None:
    """Write the depth of several frames as NPZ: the arrays of `Depth.save`, with the frames as
    first axis. Raises `InputError` for another suffix, and without frames.

    truth_m: float64[frames, rows, cols], the true distances; None: unknown.
    """
    if not depths:
        raise InputError("depths: is empty, must have a frame at least", field="depths")
    arrays = {
        name: np.stack([getattr(depth, name) for depth in depths]) for name in _saved(depths[0])
    }
    if truth_m is not None:
        arrays["truth_m"] = np.asarray(truth_m)
    write_npz(path, arrays | {"sentences": np.array([SENTENCES[reason] for reason in Reason])})
