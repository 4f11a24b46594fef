# SPDX-License-Identifier: Apache-2.0
"""PicoQuant PTU files: T3 and T2 recordings and scanned images to photons per sync; edges to T3.

Ref: PicoQuant's unified file format. `ptufile` reads the header and resolves the overflows. Two
things that its decoder
leaves out are done here: finding the syncs among the records of T2, and the position of a photon
in a scan.

Inputs are numbered from 0 in both modes; the sync input has no number. A T3 time is a bin of the
device, and the middle of the bin is used; a T2 time is the difference of two clock readings.
"""

import logging
import os
import struct

import numpy as np
import ptufile
from attrs import evolve

from ..contract.edges import Edges
from ..light.timing import Timing
from ..shared.errors import InputError
from ..shared.files import FilePath, reading, whole_file
from .recordings import DIVIDER_MAX, NO_SYNC, Recording, folded, since_sync

PS_PER_S = 1e12
DIVIDER = "HWSync_Divider"  # tag of the header: laser pulses per sync of the device
T2_SYNC = 1 << 6  # upper 7 bits of a sync's record: the special bit, and input 0
# widths in a written record, below the special bit
CHANNEL_BITS, DTIME_BITS, NSYNC_BITS = (6, 15, 10)
NO_SYNC_YET = np.int64(1) << 62
OVERFLOW = (
    1 << CHANNEL_BITS + 1
) - 1  # special bit and channel of a record that counts wraps of nsync
MAGIC, VERSION = b"PQTTTR\0\0", b"1.0.00\0\0"
INTEGER, REAL, EMPTY = 0x10000008, 0x20000008, 0xFFFF0008  # types of tags


def read_ptu(path: FilePath, sync_channel: int | None = None) -> Recording:
    """Return the photons of a PTU file. Raises `InputError`.

    sync_channel: in T2, the input that carries the laser's trigger (None: the sync input). In an
    image recorded point by point, the photons' channels are positions, row by row. Syncs then
    count from the beginning of each position's dwell, and continue through the further frames of
    the image. A sync divider of the header counts in T2, whose syncs are divided. In T3, syncs
    are numbered as the laser's pulses, and times beyond their period belong to later ones.
    """
    logging.getLogger("ptufile").setLevel(logging.CRITICAL)  # the errors below report the fault
    with reading(path, "PTU file"), ptufile.PtuFile(path) as file:
        stored = (os.path.getsize(path) - file.record_offset) / 4
        if file.number_records > stored:
            raise InputError(
                f"{path}: is truncated: {int(stored)} whole records of {file.number_records}"
            )
        raw, photons = file.read_records(), file.decode_records()
        unit_ps = file.global_resolution * PS_PER_S
        if not 0 < unit_ps < np.inf:
            raise InputError(
                f"{path}: MeasDesc_GlobalResolution = {unit_ps / PS_PER_S:g}: must be above 0"
            )
        divider = int(file.tags.get(DIVIDER, 1) or 1)
        if not 1 <= divider <= DIVIDER_MAX:
            raise InputError(f"{path}: {DIVIDER} = {divider}: must be from 0 to {DIVIDER_MAX}")
        if not file.is_t3:
            found = _t2(path, raw, photons, unit_ps, file.record_type, sync_channel)
            return evolve(found, divider=divider) if sync_channel is None else found
        if sync_channel is not None:
            raise InputError(
                f"sync-channel = {sync_channel}: {path} is a T3 recording, whose syncs are counted"
            )
        bin_ps = file.tcspc_resolution * PS_PER_S
        if not 0 < bin_ps < np.inf:
            raise InputError(
                f"{path}: MeasDesc_Resolution = {bin_ps / PS_PER_S:g}: must be above 0"
            )
        scan = _Scan.of(path, file) if file.measurement_ndim == 3 else None
    chosen = photons["channel"] >= 0
    time = photons["time"].astype(np.int64)
    recording = Recording(
        sync=time[chosen],
        channel=photons["channel"][chosen].astype(np.int64),
        time_ps=(photons["dtime"][chosen] + 0.5) * bin_ps,
        period_ps=unit_ps,
        kind=f"T3, bins of {bin_ps:.6g} ps",
    )
    placed = scan.place(recording, time, photons["marker"]) if scan else recording
    if divider > 1 and np.any(placed.time_ps >= unit_ps):
        return folded(evolve(placed, kind=f"{placed.kind}, sync divider {divider}"))
    return placed


def _t2(
    path: FilePath,
    raw: np.ndarray,
    photons: np.ndarray,
    unit_ps: float,
    record_type: int,
    sync_channel: int | None,
) -> Recording:
    channel, time = photons["channel"].astype(np.int64), photons["time"].astype(np.int64)
    if record_type == ptufile.PtuRecordType.PicoHarpT2:
        is_sync = channel == 0
        channel = channel - 1
    else:
        is_sync = raw >> np.uint32(25) == T2_SYNC
    is_photon = (photons["channel"] >= 0) & ~is_sync
    if sync_channel is not None:
        is_sync = is_photon & (channel == sync_channel)
        is_photon &= ~is_sync
    if not is_sync.any():
        inputs = ", ".join(map(str, np.unique(channel[is_photon]))) or "none"
        which = "on the sync input" if sync_channel is None else f"on input {sync_channel}"
        raise InputError(
            f"{path}: has no events {which}: --sync-channel must name the input of the laser's trigger "
            f"(inputs with events: {inputs})"
        )
    return since_sync(
        time[is_photon],
        channel[is_photon],
        time[is_sync],
        unit_ps,
        f"T2, clock of {unit_ps:.6g} ps",
    )


class _Scan:
    """An image that a single spot recorded line by line."""

    def __init__(self, rows: int, cols: int, start: int, stop: int, frame: int, both_ways: bool):
        self.rows, self.cols, self.both_ways = rows, cols, both_ways
        self.start, self.stop, self.frame = start, stop, frame

    @classmethod
    def of(cls, path: FilePath, file: ptufile.PtuFile) -> "_Scan":
        if file.is_sinusoidal:
            raise InputError(f"{path}: is a sinusoidal scan, must be one of constant speed")
        rows, cols = (int(file.tags.get(name, 0)) for name in ("ImgHdr_PixY", "ImgHdr_PixX"))
        if rows < 1 or cols < 1 or not file.line_start_mask or not file.line_stop_mask:
            raise InputError(
                f"{path}: is an image without its size or its line markers (ImgHdr_PixX, PixY, LineStart, LineStop)"
            )
        return cls(
            rows,
            cols,
            file.line_start_mask,
            file.line_stop_mask,
            file.frame_change_mask,
            file.is_bidirectional,
        )

    def place(self, recording: Recording, time: np.ndarray, marker: np.ndarray) -> Recording:
        """Return `recording` with positions as channels, and syncs that count in a position's
        dwell, then through frames.
        """
        begins, ends, changes = (
            time[(marker & mask) > 0] for mask in (self.start, self.stop, self.frame)
        )
        ends = np.append(ends, -1)[np.searchsorted(ends, begins, side="right")]
        # no stop before the next start
        cut = (ends < begins) | (ends > np.append(begins[1:], NO_SYNC_YET))
        if cut.all():
            raise InputError("scan: the recording holds no whole line between its markers")
        first = np.searchsorted(begins, changes)
        # lines of a frame whose beginning is not recorded
        begun_before = first[0] % self.rows if len(first) else 0
        cut[:begun_before] = True
        ends = np.where(cut, begins, ends)
        base = np.zeros(len(begins), np.int64)  # first line of each line's frame
        base[begun_before] = begun_before
        base[first[first < len(begins)]] = first[first < len(begins)]
        row = (np.arange(len(begins)) - np.maximum.accumulate(base)) % self.rows
        row[:begun_before] = -1
        frame = np.cumsum(row == 0) - 1
        dwell = int(np.median((ends - begins)[~cut]) // self.cols)
        line = np.searchsorted(begins, recording.sync, side="right") - 1
        inside = (line >= 0) & (recording.sync < ends[line])
        line = np.where(inside, line, 0)
        into = (recording.sync - begins[line]) * self.cols
        length = np.maximum(ends - begins, 1)[line]
        col = np.where(inside, into // length, 0)
        first = begins[line] - (-col * length // self.cols)  # the first sync of that column
        within = recording.sync - first
        if self.both_ways:
            col = np.where(row[line] % 2, self.cols - 1 - col, col)
        inside &= within < dwell
        return Recording(
            sync=np.where(inside, frame[line] * dwell + within, NO_SYNC),
            channel=row[line] * self.cols + col,
            time_ps=recording.time_ps,
            period_ps=recording.period_ps,
            grid=(self.rows, self.cols),
            outside="between the positions of the scan",
            kind=f"{recording.kind}, scan of {self.rows} x {self.cols} positions, {dwell} syncs each, {frame[-1] + 1} image(s)",
        )


def write_ptu(path: FilePath, edges: Edges, timing: Timing) -> None:
    """Write edges as a T3 recording (MultiHarp's records), whole or not at all: sync = pulse,
    input = pixel, bin = tick.

    Raises `InputError` for pixels or ticks that the records cannot hold.
    """
    pulse, pixel, tick = (
        getattr(edges, name)[np.lexsort((edges.pixel, edges.tick, edges.pulse))]
        for name in ("pulse", "pixel", "tick")
    )
    for name, values, bits in (("pixel", pixel, CHANNEL_BITS), ("tick", tick, DTIME_BITS)):
        if len(values) and values.max() >> bits:
            raise InputError(
                f"{path}: {name} = {values.max()}: must be from 0 to {(1 << bits) - 1} in a PTU file"
            )
    wraps = np.diff(pulse >> NSYNC_BITS, prepend=0)
    most = (1 << NSYNC_BITS) - 1  # wraps that one record can count
    before = -(-wraps // most)
    counts = np.full(before.sum(), most)
    counts[(np.cumsum(before) - 1)[before > 0]] = (wraps - (before - 1) * most)[before > 0]
    records = pixel << DTIME_BITS + NSYNC_BITS | tick << NSYNC_BITS | pulse & most
    records = np.insert(
        records,
        np.repeat(np.arange(len(pulse)), before),
        OVERFLOW << DTIME_BITS + NSYNC_BITS | counts,
    )
    tags = {
        "Measurement_Mode": int(ptufile.PtuMeasurementMode.T3),
        "Measurement_SubMode": int(ptufile.PtuMeasurementSubMode.POINT),
        "MeasDesc_GlobalResolution": timing.period_s,
        "MeasDesc_Resolution": timing.tick_s,
        "TTResult_SyncRate": round(1 / timing.period_s),
        "TTResult_NumberOfRecords": len(records),
        "TTResultFormat_TTTRRecType": int(ptufile.PtuRecordType.GenericT3),
        "TTResultFormat_BitsPerRecord": 32,
    }
    with whole_file(path) as file:
        file.write(MAGIC + VERSION)
        for name, value in tags.items():
            file.write(
                struct.pack(
                    "<32siI", name.encode(), -1, REAL if isinstance(value, float) else INTEGER
                )
            )
            file.write(struct.pack("<d" if isinstance(value, float) else "<q", value))
        file.write(struct.pack("<32siIq", b"Header_End", -1, EMPTY, 0))
        file.write(records.astype("<u4").tobytes())
