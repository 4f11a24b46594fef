# SPDX-License-Identifier: Apache-2.0
"""The measured shape of a pulse over time: of laser and detector together, as a TCSPC system records
the response of an instrument.
"""

import os
from pathlib import Path
from typing import TypeAlias

import numpy as np
from attrs import field, frozen

from .constants import SIGMA_PER_FWHM
from .errors import InputError, wrong_value
from .files import FilePath, check_path, reading
from .quantities import check_real, given, real_array, shape_of

PULSE_FILES = (".csv", ".npy")
SAMPLES_MAX = 1 << 16
TIME_MAX_S = 20e-9  # from time 0 to the first and to the last sample
STEP_MIN_S = 1e-18  # between two samples: shorter light has no width that could be computed with
PS = 1e-12
DENSITY_MAX = 1e100  # of any scale, whose sums are still numbers,
DENSITY_MIN = 1e-100  # from which on a sample is not nothing
ARRAYS = ("pulse_time_s", "pulse_density")  # of a result that has its pulse with it
GAUSSIAN_SIGMAS = 5.0  # from the centre of a table of a Gaussian to its ends
GAUSSIAN_SAMPLES = 401


@frozen(kw_only=True, eq=False)
class Pulse:
    """When the light of a short echo is detected, as samples over time.

    Between two samples, the density is even: the mean of both. Outside of the samples there is no
    light. Time 0 is the time of flight of the surface, so where time 0 lies in the pulse is the
    calibration of the distance.

    Attributes
    ----------
    time_s : numpy.ndarray
        float64[n], ascending by at least 1e-18 s, from -20 to 20 ns; n from 2 to 65536. 0 must lie within them.
    density : numpy.ndarray
        float64[n], at least 0, of any scale, and not all 0.

    Raises
    ------
    InputError
        If an array is out of its range.
    """

    time_s: np.ndarray = field(converter=given)
    density: np.ndarray = field(converter=given)

    def __attrs_post_init__(self) -> None:
        shape = shape_of("pulse.time_s", self.time_s)
        if len(shape) != 1 or not 2 <= shape[0] <= SAMPLES_MAX:
            raise InputError(
                f"pulse.time_s: has shape {shape}, must have 2 to {SAMPLES_MAX} samples",
                field="pulse",
            )
        time_s = real_array("pulse.time_s", self.time_s, shape, -TIME_MAX_S, TIME_MAX_S)
        density = real_array("pulse.density", self.density, shape, 0, DENSITY_MAX)
        if np.any(np.diff(time_s) < STEP_MIN_S):
            raise InputError(
                f"pulse.time_s: must ascend, by at least {STEP_MIN_S:g} s from sample to sample",
                field="pulse",
            )
        if not time_s[0] <= 0 <= time_s[-1]:
            raise InputError(
                "pulse.time_s: 0, the time of flight, must lie within the samples", field="pulse"
            )
        if not np.any(density > DENSITY_MIN):
            raise InputError("pulse.density: must have a sample above 0", field="pulse")
        object.__setattr__(self, "time_s", time_s)
        object.__setattr__(self, "density", density)

    @property
    def share_before(self) -> np.ndarray:
        """float64[n]: share of the pulse before each sample, from 0 to 1; linear between them."""
        photons = np.diff(self.time_s) * (self.density[1:] + self.density[:-1]) / 2
        until = np.concatenate([[0.0], np.cumsum(photons)])
        return until / until[-1]

    @classmethod
    def load(cls, path: FilePath) -> "Pulse":
        """Read a pulse from CSV or NPY: two columns, time in ps and density.

        A CSV has commas, and its first line names the columns: time_ps,density. An NPY file holds
        an array [n, 2]. Raises `InputError`.
        """
        columns = _npy(path) if check_path(path).suffix.lower() == ".npy" else _csv(path)
        return cls._of_columns(str(path), columns)

    @classmethod
    def gaussian(cls, fwhm_s: float) -> "Pulse":
        """Return the table of a Gaussian of this full width at half maximum, 1 ps to 9 ns. Raises
        `InputError`.
        """
        sigma_s = check_real("fwhm_s", fwhm_s, PS, 9e-9) * SIGMA_PER_FWHM
        at = np.linspace(-GAUSSIAN_SIGMAS, GAUSSIAN_SIGMAS, GAUSSIAN_SAMPLES)
        return cls(time_s=at * sigma_s, density=np.exp(-(at**2) / 2))

    @classmethod
    def of_result(cls, arrays: dict[str, np.ndarray]) -> "Pulse | None":
        """Return the pulse that a result has with it; None: it has none. Raises `InputError`."""
        found = [name for name in ARRAYS if name in arrays]
        if not found:
            return None
        if len(found) < len(ARRAYS):
            raise InputError(
                f"{found[0]}: the result must have both of {' and '.join(ARRAYS)}", field="pulse"
            )
        time_s, density = (arrays[name] for name in ARRAYS)
        return cls(time_s=time_s, density=density)

    @classmethod
    def _of_columns(cls, name: str, columns: np.ndarray) -> "Pulse":
        """Return the pulse of an array [n, 2], time in ps and density. Raises `InputError`."""
        if columns.ndim != 2 or columns.shape[1] != 2:
            raise InputError(
                f"{name}: has shape {columns.shape}, must have two columns: time_ps,density",
                field="pulse",
            )
        if columns.dtype.kind not in "iuf":
            raise InputError(f"{name}: holds {columns.dtype}, must hold numbers", field="pulse")
        columns = np.asarray(columns, np.float64)
        return cls(time_s=columns[:, 0] * PS, density=columns[:, 1])


PulseSource: TypeAlias = Pulse | np.ndarray | FilePath


def with_pulse(arrays: dict[str, np.ndarray], pulse: Pulse | None) -> dict[str, np.ndarray]:
    """Return a result that has its pulse with it, for `Pulse.of_result`."""
    if pulse is None:
        return arrays
    return arrays | dict(zip(ARRAYS, (pulse.time_s, pulse.density), strict=True))


def pulse_of(source: PulseSource | None) -> Pulse | None:
    """Return the pulse of an array [n, 2], time in ps and density, or of a file (`Pulse.load`);
    None: None. Raises `InputError`.
    """
    if source is None or isinstance(source, Pulse):
        return source
    if isinstance(source, str | os.PathLike):
        return Pulse.load(source)
    if isinstance(source, np.ndarray) and source.dtype.kind in "iuf":
        return Pulse._of_columns("pulse", source)
    raise wrong_value("pulse", source, "a Pulse, an array [n, 2] of time_ps and density, or a file")


def _npy(path: FilePath) -> np.ndarray:
    """Return the array of an NPY file."""
    with reading(path, "NPY file"):
        return np.asarray(np.load(path, allow_pickle=False))


def _csv(path: FilePath) -> np.ndarray:
    """Return the lines of a CSV file after the first one."""
    with reading(path, "CSV file of time_ps,density"):
        with Path(path).open(encoding="utf-8-sig") as file:
            if file.readline().strip() != "time_ps,density":
                raise InputError(f"{path}: its first line must be time_ps,density", field="pulse")
            lines = [line for line in file if line.partition("#")[0].strip()]
        if not lines:
            raise InputError(f"{path}: has no samples, must have at least 2", field="pulse")
        return np.loadtxt(lines, delimiter=",", ndmin=2)
