# SPDX-License-Identifier: Apache-2.0
"""Exchange of photons and edges with other instruments and programs: PTU, CSV, NPZ and HDF5.

Tables have named columns (CSV: a header line; NPZ, HDF5: one array each); other columns are
ignored. Names of times end
with their unit: `time_ps`, `time_ns`, `time_us`, `time_s`. A table holds one of

* `pulse, pixel, tick`, and perhaps `offset_ps`: edges, as this project writes them;
* `sync, channel, time_ps`: time since the laser's trigger number `sync`;
* `channel, time_ps`: absolute times, with the triggers as events on a channel of their own.

HDF5 files may also be Photon-HDF5 (`photon_hdf5.py`).
"""

import io
import re
import warnings
from collections.abc import Callable
from typing import Any, TypeAlias

import h5py
import numpy as np
from attrs import evolve

from ..contract.edges import NAMES, Edges
from ..light.timing import Timing
from ..shared.arguments import check_kind
from ..shared.errors import InputError, check_integer, wrong_value
from ..shared.files import FilePath, check_path, read_npz, reading, whole_file
from .columns import Columns, checked_columns, integers, not_negative
from .photon_hdf5 import is_photon_hdf5, read_photon_hdf5
from .ptu import read_ptu, write_ptu
from .recordings import DIVIDER_MAX, SYNC_MAX, Recording, since_sync, undivided

UNITS_PS = {"time_ps": 1, "time_ns": 1000, "time_us": 1_000_000, "time_s": 1_000_000_000_000}
OFFSET = "offset_ps"  # column of edges that know their place in their tick
HDF5 = (".h5", ".hdf5")
SUFFIXES = (".npz", ".csv", *HDF5, ".ptu")
Read: TypeAlias = Callable[[tuple[str, ...]], Columns]
_PAIR = r"\s*-?\d{1,18}\s*:\s*\d{1,18}\s*"  # channel and pixel, which fit int64
EXPECTED = "pulse, pixel, tick; or sync, channel, time_ps; or channel, time_ps (or time_ns, time_us, time_s)"


def read_recording(
    path: FilePath, sync_channel: int | None = None, sync_divider: int | None = None
) -> Recording:
    """Return the photons of a file. Raises `InputError` with the file's name and its fault.

    sync_channel: channel of the laser's trigger among absolute times (T2: by default the sync
    input). sync_divider: laser pulses per recorded trigger; None: as the file says, or 1.
    """
    recording = _read(path, sync_channel)
    divider = recording.divider
    if sync_divider is not None:
        divider = check_integer("sync-divider", sync_divider, 1, DIVIDER_MAX)
    return recording if divider == 1 else undivided(recording, divider)


def _read(path: FilePath, sync_channel: int | None) -> Recording:
    suffix = check_suffix(path)
    if suffix == ".ptu":
        return read_ptu(path, sync_channel)
    if suffix in HDF5 and is_photon_hdf5(path):
        return read_photon_hdf5(path, sync_channel)
    names, read = {".npz": _npz, ".csv": _csv}.get(suffix, _hdf5)(path)
    if set(NAMES) <= set(names):
        if OFFSET not in names:
            return _of_syncs(path, NAMES, read(NAMES), "table of edges", sync_channel)
        *of_edges, offset_ps = read((*NAMES, OFFSET))
        not_negative(path, OFFSET, offset_ps)
        found = _of_syncs(path, NAMES, of_edges, "table of edges", sync_channel)
        return evolve(found, offset_ps=offset_ps.astype(np.float64))
    units = [name for name in UNITS_PS if name in names]
    if not units or "channel" not in names:
        raise InputError(
            f"{path}: has the columns {', '.join(names) or 'none'}; must have {EXPECTED}"
        )
    if len(units) > 1:
        raise InputError(f"{path}: has the columns {', '.join(units)}; must have one of them")
    (unit,) = units
    if "sync" in names:
        of_photons = ("sync", "channel", unit)
        found = _of_syncs(path, of_photons, read(of_photons), "table of syncs", sync_channel)
        return evolve(found, time_ps=found.time_ps * float(UNITS_PS[unit]))
    channel, time = read(("channel", unit))
    channel = integers(path, "channel", channel)
    if sync_channel is None:
        raise InputError(
            f"{path}: has absolute times and no column sync: --sync-channel must name the channel of the laser's trigger"
        )
    is_sync = channel == sync_channel
    if not is_sync.any():
        raise InputError(f"{path}: has no events on channel {sync_channel} (--sync-channel)")
    not_negative(path, unit, time)
    _exact(path, unit, time)
    return since_sync(
        time[~is_sync], channel[~is_sync], time[is_sync], UNITS_PS[unit], "table of absolute times"
    )


def write_edges(path: FilePath, edges: Edges, timing: Timing) -> None:
    """Write edges to a file, whole or not at all; the same edges give the same bytes. The suffix
    selects the format. PTU files have no place for offsets.
    """
    check_kind("edges", edges, Edges)
    check_kind("timing", timing, Timing)
    suffix = check_suffix(path)
    if suffix == ".npz":
        edges.save(path)
    elif suffix == ".ptu":
        write_ptu(path, edges, timing)
    elif suffix == ".csv":
        with whole_file(path) as file:
            columns = _written(edges)
            # 17 digits bring every float back
            forms = ["%d" if name in NAMES else "%.17g" for name in columns]
            table = np.rec.fromarrays(list(columns.values()))
            np.savetxt(file, table, forms, ",", header=",".join(columns), comments="")
    else:
        data = io.BytesIO()
        with h5py.File(data, "w") as archive:
            for name, column in _written(edges).items():
                archive.create_dataset(
                    name, data=column, compression="gzip" if len(edges) else None
                )
        with whole_file(path) as file:
            file.write(data.getvalue())


def _written(edges: Edges) -> dict[str, np.ndarray]:
    """Return the columns of a table of edges by name."""
    columns = {name: getattr(edges, name) for name in NAMES}
    return columns if edges.offset_ps is None else columns | {OFFSET: edges.offset_ps}


def offsets_note(path: FilePath, edges: Edges) -> str:
    """Return a sentence if `write_edges` leaves out the offsets of edges, else nothing."""
    if edges.offset_ps is None or check_suffix(path) != ".ptu":
        return ""
    return f"left out: {OFFSET}, for which a PTU file has no place"


def check_suffix(path: FilePath) -> str:
    """Return the kind of the file, which is its suffix in lower case. Raises `InputError`."""
    suffix = check_path(path).suffix.lower()
    if suffix not in SUFFIXES:
        raise InputError(f"{path}: must end with one of {', '.join(SUFFIXES)}")
    return suffix


def parse_channels(text: str) -> dict[int, int]:
    """Return the pixel by channel, from `CHANNEL:PIXEL,...` or from a CSV file with the columns
    channel and pixel.
    """
    if text.lower().endswith(".csv"):
        names, read = _csv(text)
        if not {"channel", "pixel"} <= set(names):
            raise InputError(
                f"{text}: has the columns {', '.join(names) or 'none'}; must have channel, pixel"
            )
        columns = zip(("channel", "pixel"), read(("channel", "pixel")), strict=True)
        pairs = list(
            zip(*(integers(text, name, column).tolist() for name, column in columns), strict=True)
        )
        if not pairs:
            raise InputError(f"{text}: names no channel")
    else:
        if not re.fullmatch(f"{_PAIR}(,{_PAIR})*", text):
            legal = "CHANNEL:PIXEL,CHANNEL:PIXEL,... or a CSV file with the columns channel, pixel"
            raise wrong_value("channels", text, legal)
        pairs = [
            (int(channel), int(pixel))
            for channel, pixel in (pair.split(":") for pair in text.split(","))
        ]
    for which, values in zip(("channel", "pixel"), zip(*pairs, strict=True), strict=True):
        twice = [value for value in values if values.count(value) > 1]
        if twice:
            raise InputError(f"channels: {which} {twice[0]} comes twice")
    return dict(pairs)


def _of_syncs(
    path: FilePath, names: tuple[str, ...], columns: Columns, kind: str, sync_channel: int | None
) -> Recording:
    """Return the photons of a table with syncs, whose times are in the unit of their column, or of
    edges, whose times are ticks. names: of the columns, in messages.
    """
    if sync_channel is not None:
        raise InputError(
            f"sync-channel = {sync_channel}: {path} is a {kind}, which has no triggers among its events"
        )
    whole = [
        values if name in UNITS_PS else integers(path, name, values)
        for name, values in zip(names, columns, strict=True)
    ]
    for name, values in zip(names, whole, strict=True):
        not_negative(path, name, values)
    sync, channel, time = whole
    return Recording(sync=sync, channel=channel, time_ps=time, kind=kind, in_ticks=names == NAMES)


def _exact(path: FilePath, name: str, values: np.ndarray) -> None:
    """Refuse floats that are too large to hold every integer: they have lost the difference
    between trigger and photon.
    """
    bad = np.flatnonzero((values >= SYNC_MAX) & (values.dtype.kind == "f"))
    if len(bad):
        raise InputError(
            f"{path}: {name}[{bad[0]}] = {values[bad[0]]}: must be below 2^53 in a column of floats; integers may be larger"
        )


def _csv(path: FilePath) -> tuple[list[str], Read]:
    """Return the column names of a CSV file, and a function that reads columns. Lines with # are
    comments.

    The names are the first line that is no comment; if that has numbers, or there is none, they
    are the last comment.
    """
    comment = ""
    with reading(path, "CSV file"), open(path, encoding="utf-8-sig") as file:
        lines = 1
        while (head := file.readline()).lstrip().startswith("#") or head.isspace():
            comment = head.lstrip("# \t") if head.strip() else comment
            lines += 1
    line = head or comment
    separator = next((mark for mark in (",", ";", "\t") if mark in line), None)
    if comment and (not head or _are_numbers(head.split(separator))):
        head = comment
        lines -= 1
    names = [name.strip().strip('"').lower() for name in head.split(separator)]

    def read(chosen: tuple[str, ...]) -> Columns:
        form: dict[str, Any] = {"delimiter": separator, "skiprows": lines, "encoding": "utf-8-sig"}
        columns = []
        for name in chosen:
            if names.count(name) > 1:
                raise InputError(f"{path}: has {names.count(name)} columns {name}, must have one")
        try:
            with warnings.catch_warnings(
                category=UserWarning, action="ignore"
            ):  # no rows: no photons
                for name in chosen:
                    columns.append(_read_column(path, names.index(name), form))
        except (OSError, ValueError, IndexError) as error:
            raise InputError(f"{path}: is not a table of numbers ({error})") from None
        return columns

    return names, read


def _read_column(path: FilePath, number: int, form: dict[str, Any]) -> np.ndarray:
    """Return a column of a CSV file: int64 if all are such integers, otherwise float64. Raises
    `ValueError`.
    """

    def read(kind: type) -> np.ndarray:
        return np.loadtxt(path, dtype=kind, usecols=number, ndmin=1, quotechar='"', **form)

    try:
        return read(np.int64)
    except ValueError:
        return read(np.float64)


def _are_numbers(texts: list[str]) -> bool:
    try:
        for text in texts:
            float(text.strip().strip('"'))
        return True
    except ValueError:
        return False


def _npz(path: FilePath) -> tuple[list[str], Read]:
    try:
        with np.load(path, allow_pickle=False) as archive:
            names = list(archive.files)
    except Exception:  # the fault is reported below
        names = list(NAMES)
    return names, lambda chosen: checked_columns(path, read_npz(path, chosen))


def _hdf5(path: FilePath) -> tuple[list[str], Read]:
    """Return the names of the datasets at the file's root, and a function that reads some of
    them.
    """
    with reading(path, "HDF5 file"), h5py.File(path, "r") as archive:
        names = [name for name, item in archive.items() if isinstance(item, h5py.Dataset)]

    def read(chosen: tuple[str, ...]) -> Columns:
        with reading(path, "HDF5 file"), h5py.File(path, "r") as archive:
            arrays = {name: archive[name][()] for name in chosen}
        return checked_columns(path, arrays)

    return names, read
