# SPDX-License-Identifier: Apache-2.0
"""Polynomials through levels at even steps, around the middle one.

Log likelihoods rise faster than they fall. So the slope and the peak of a parabola through three
levels lean: by half a millimetre in single ticks, which is more than the error that many photons
leave, and by most of a tick in coarse steps. A polynomial of fourth degree through five levels does
not, but it follows their noise more.

The functions accept numbers and arrays, and kernels compile their own versions.
"""

from typing import Any, NamedTuple


class Curve(NamedTuple):
    """Derivatives at the middle level, per step: numbers, or arrays of one shape."""

    first: Any
    second: Any
    third: Any
    fourth: Any


def through_three(before: Any, here: Any, after: Any) -> Curve:
    """Return the parabola through three levels."""
    return Curve(
        first=(after - before) / 2,
        second=after + before - 2 * here,
        third=0.0,
        fourth=0.0,
    )


def through_five(two_before: Any, before: Any, here: Any, after: Any, two_after: Any) -> Curve:
    """Return the polynomial of fourth degree through five levels."""
    near = after - before
    far = two_after - two_before
    near_bend = after + before - 2 * here
    far_bend = two_after + two_before - 2 * here
    return Curve(
        first=(8 * near - far) / 12,
        second=(16 * near_bend - far_bend) / 12,
        third=(far - 2 * near) / 2,
        fourth=far_bend - 4 * near_bend,
    )


def slope_at(curve: Curve, at: Any) -> Any:
    """Return the first derivative, so many steps from the middle."""
    return curve.first + at * (curve.second + at * (curve.third / 2 + at * curve.fourth / 6))


def bend_at(curve: Curve, at: Any) -> Any:
    """Return the second derivative, so many steps from the middle."""
    return curve.second + at * (curve.third + at * curve.fourth / 2)
