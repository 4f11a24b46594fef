# SPDX-License-Identifier: Apache-2.0
"""Photon-HDF5 files: photons of a time tagger in the group `photon_data`.

Ref: Photon-HDF5 reference documentation, version 0.5. With `nanotimes`, `timestamps` count the
laser's triggers, or a clock if `measurement_specs/laser_repetition_rate` says that the laser has
another rate. Without `nanotimes`, `timestamps` are absolute times.
"""

from typing import Any

import h5py
import numpy as np

from ..shared.errors import InputError
from ..shared.files import FilePath, reading
from .columns import checked_columns, integers, not_negative
from .recordings import DIVIDER_MAX, PS_PER_S, SYNC_MAX, Recording, since_sync

GROUP = "photon_data"
TIMES = "timestamps"
TIMES_UNIT = "timestamps_specs/timestamps_unit"
BINS = "nanotimes"
BINS_UNIT = "nanotimes_specs/tcspc_unit"
DETECTORS = "detectors"
LASER_RATE = "measurement_specs/laser_repetition_rate"
WHOLE = 1e-3  # difference of a ratio from a whole number, relative


def is_photon_hdf5(path: FilePath) -> bool:
    """Return whether an HDF5 file holds such groups. Raises `InputError` if it is unreadable."""
    with reading(path, "HDF5 file"), h5py.File(path, "r") as archive:
        return any(name.startswith(GROUP) for name in archive)


def read_photon_hdf5(path: FilePath, sync_channel: int | None = None) -> Recording:
    """Return the photons of a Photon-HDF5 file; their channels are its detectors. Raises
    `InputError`.

    sync_channel: detector that has the laser's trigger, in a file without `nanotimes`.
    """
    with reading(path, "Photon-HDF5 file"), h5py.File(path, "r") as archive:
        groups = [name for name in archive if name.startswith(GROUP)]
        if groups != [GROUP]:
            raise InputError(f"{path}: has {', '.join(groups)}, must have one group {GROUP}")
        group = archive[GROUP]
        names = (TIMES, BINS, DETECTORS, TIMES_UNIT, BINS_UNIT, LASER_RATE)
        found: dict[str, Any] = {name: group[name][()] for name in names if name in group}
    for name in (TIMES, TIMES_UNIT) + (BINS_UNIT,) * (BINS in found):
        if name not in found:
            raise InputError(f"{path}: has no {GROUP}/{name}, which such a file must have")
    unit_ps = _above_zero(path, TIMES_UNIT, found[TIMES_UNIT]) * PS_PER_S
    arrays = {name: found[name] for name in (TIMES, DETECTORS, BINS) if name in found}
    columns = dict(zip(arrays, checked_columns(path, arrays), strict=True))
    for name in (TIMES, BINS):
        not_negative(path, name, columns.get(name, np.zeros(0)))
    time = integers(path, TIMES, columns[TIMES])
    channel = integers(path, DETECTORS, columns.get(DETECTORS, np.zeros(len(time))))
    if BINS not in found:
        return _absolute(path, time, channel, unit_ps, sync_channel)
    if sync_channel is not None:
        raise InputError(
            f"sync-channel = {sync_channel}: {path} has {BINS}, which count from the trigger"
        )
    bin_ps = _above_zero(path, BINS_UNIT, found[BINS_UNIT]) * PS_PER_S
    pulses = 1.0  # of the laser, in a unit of the timestamps
    if LASER_RATE in found:
        pulses = _above_zero(path, LASER_RATE, found[LASER_RATE]) * unit_ps / PS_PER_S
        if pulses > DIVIDER_MAX:
            raise InputError(
                f"{path}: {GROUP}/{LASER_RATE}: is {pulses:g} pulses in a unit of the timestamps,"
                f" must be at most {DIVIDER_MAX}"
            )
    divider = max(1, round(pulses))
    kind = f"Photon-HDF5, bins of {bin_ps:.6g} ps"
    if abs(pulses - divider) > WHOLE * divider:
        last = int(time.max(initial=0))
        if last * pulses >= SYNC_MAX:
            raise InputError(
                f"{path}: {GROUP}/{TIMES}: holds {last}, which is pulse {last * pulses:.6g} of the"
                " laser, must be below 2^53"
            )
        time = np.floor(time * pulses).astype(np.int64)
        unit_ps /= pulses
        divider = 1
        kind += ", syncs by the laser's rate"
    return Recording(
        sync=time,
        channel=channel,
        time_ps=(columns[BINS] + 0.5) * bin_ps,
        period_ps=unit_ps,
        divider=divider,
        kind=kind,
    )


def _absolute(
    path: FilePath, time: np.ndarray, channel: np.ndarray, unit_ps: float, sync_channel: int | None
) -> Recording:
    is_sync = channel == sync_channel
    if not is_sync.any():
        known = ", ".join(map(str, np.unique(channel)))
        which = "" if sync_channel is None else f" {sync_channel}"
        raise InputError(
            f"{path}: has no {BINS}, and no events on a detector{which} of the laser's trigger:"
            f" --sync-channel must name it (detectors with events: {known})"
        )
    kind = f"Photon-HDF5, clock of {unit_ps:.6g} ps"
    return since_sync(time[~is_sync], channel[~is_sync], time[is_sync], unit_ps, kind)


def _above_zero(path: FilePath, name: str, value: Any) -> float:
    numbers = np.asarray(value)
    if numbers.size != 1 or numbers.dtype.kind not in "iuf":
        raise InputError(
            f"{path}: {GROUP}/{name}: holds {numbers.dtype}{list(numbers.shape)}, must hold one number"
        )
    number = float(numbers.item())
    if not 0 < number < np.inf:
        raise InputError(f"{path}: {GROUP}/{name} = {number:g}: must be above 0")
    return number
