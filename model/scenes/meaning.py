# SPDX-License-Identifier: Apache-2.0
"""What the numbers of a depth file mean, as far as the user says so."""

from collections.abc import Sequence
from types import NoneType

import numpy as np
from attrs import frozen

from ..light.light import NEAREST_M
from ..shared.arguments import check_kind
from ..shared.errors import InputError, told_value, wrong_value
from ..shared.quantities import real
from .conventions import check_unit, convention

# "no depth" of most writers: the largest integer of 16 bits, the largest half float
MARKS = (65535, 65504)
SCALES = 1e-3, 1e3


@frozen(kw_only=True)
class Meaning:
    """What the numbers of a depth file mean, as far as the user says so.

    unit: None = metres for floats, millimetres for integers. scale: factor for all distances,
    applied last. missing: further numbers of the file that mean "no depth". sky_m: distance
    before the scale, from which on there is nothing to see. z: distances are along the axis, not
    along the rays. fov_deg: horizontal field of view of the whole picture;
    None: the part that the sensor sees has the sensor's. channel: of a picture with several.
    bin_ps: the file holds histograms with bins of this width (`recorded_light`), and no depth.
    recorded_pulses: laser pulses whose photons the histograms count; None = unknown.
    """

    unit: str | None = None
    scale: float = real(1.0, *SCALES)
    missing: float | Sequence[float] | None = None
    sky_m: float | None = real(None, NEAREST_M)
    z: bool = False
    fov_deg: float | None = real(None, 1e-3, 179)
    channel: str | None = None
    bin_ps: float | None = None
    recorded_pulses: int | None = None

    def __attrs_post_init__(self) -> None:
        if self.unit is not None:
            check_unit(self.unit)
        check_kind("z", self.z, bool, np.bool_)
        check_kind("channel", self.channel, str, NoneType)
        if self.bin_ps is None and self.recorded_pulses is not None:
            raise InputError(
                f"recorded_pulses = {told_value(self.recorded_pulses)}: goes with histograms, whose bins need"
                " their width (bin_ps)"
            )

    @property
    def marks(self) -> np.ndarray:
        """float64[n]: the numbers that mean "no depth", of the user and of the unit's
        convention.
        """
        known = convention(self.unit)
        try:
            given = () if self.missing is None else np.atleast_1d(self.missing)
            if np.iscomplexobj(given):
                raise TypeError
            numbers = np.asarray([*given, *MARKS, *(known.missing if known else ())], np.float64)
        except (TypeError, ValueError, OverflowError):
            raise wrong_value("missing", self.missing, "a number, or several") from None
        return numbers
