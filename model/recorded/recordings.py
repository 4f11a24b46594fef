# SPDX-License-Identifier: Apache-2.0
"""Recorded photons from a time tagger, and their conversion to edges: sync to pulse, channel to
pixel, time to tick.
"""

from types import NoneType

import numpy as np
from attrs import evolve, frozen

from ..contract.config import Config
from ..contract.edges import Edges
from ..light.timing import Timing
from ..shared.arguments import check_kind
from ..shared.errors import InputError, check_integer
from ..shared.quantities import check_real

PS_PER_S = 1e12
NO_SYNC = -1  # sync of a photon that belongs to no laser pulse
FRACTION = 1e-6  # of a tick: tolerance for rounding errors at the border of a tick
SAME_PERIOD = 1e-3  # relative difference of laser periods up to which there is no note
DIVIDER_MAX = 1 << 16
INTEGER_MAX = (1 << 63) - 1
SYNC_MAX = 1 << 53  # float64 is exact for integers up to this


@frozen(eq=False, kw_only=True)
class Recording:
    """Photons of a time tagger, in any order.

    sync: int64[n], number of the last laser trigger before each photon, `NO_SYNC` if there is
    none. channel: int64[n], input of the tagger; with `grid` (rows, cols), the position in an
    image, row * cols + col. time_ps: float64[n] since the trigger. period_ps: between triggers,
    None = unknown. divider: laser pulses per recorded trigger. kind: description of the recording.
    outside: meaning of `NO_SYNC`. in_ticks: the times already are ticks; offset_ps: float64[n],
    place in that tick, None = unknown.
    """

    sync: np.ndarray
    channel: np.ndarray
    time_ps: np.ndarray
    kind: str
    period_ps: float | None = None
    divider: int = 1
    grid: tuple[int, int] | None = None
    outside: str = "before the first sync"
    in_ticks: bool = False
    offset_ps: np.ndarray | None = None


def since_sync(
    time: np.ndarray, channel: np.ndarray, sync_time: np.ndarray, unit_ps: float, kind: str
) -> Recording:
    """Return a recording of absolute times: each photon belongs to the last trigger at or before
    it.

    time, sync_time: in `unit_ps`, any order; integers (or whole float64) keep the difference exact.
    """
    triggers = np.unique(sync_time)  # a trigger that is recorded twice is one pulse
    sync = np.searchsorted(triggers, time, side="right") - 1
    period = float(np.median(np.diff(triggers))) * unit_ps if len(triggers) > 1 else None
    return Recording(
        sync=sync,
        channel=channel,
        time_ps=(time - triggers[sync]) * unit_ps,
        period_ps=period,
        kind=kind,
    )


def undivided(recording: Recording, divider: int) -> Recording:
    """Return a recording with every trigger of a laser, of which a sync divider has recorded every
    `divider`-th one: each photon belongs to the last pulse before it. Raises `InputError`.
    """
    if recording.period_ps is None or recording.in_ticks:
        raise InputError(
            f"sync-divider = {divider}: goes with T2, T3, Photon-HDF5 and absolute times, whose period"
            " of triggers is known"
        )
    last = int(recording.sync.max(initial=0))
    most = INTEGER_MAX // divider - 1  # the photons of a trigger belong to pulses up to the next
    if last > most:
        raise InputError(
            f"sync-divider = {divider}: sync {last} is too large, must be at most {most}"
        )
    triggers = np.where(recording.sync == NO_SYNC, NO_SYNC, recording.sync * divider)
    return folded(
        evolve(
            recording,
            sync=triggers,
            period_ps=recording.period_ps / divider,
            divider=1,
            kind=f"{recording.kind}, sync divider {divider}",
        )
    )


def folded(recording: Recording) -> Recording:
    """Return a recording whose times are below its period: later ones belong to later triggers."""
    period_ps = recording.period_ps
    assert period_ps is not None, "a recording without a period cannot be folded"
    is_placed = recording.sync != NO_SYNC
    passed = np.where(is_placed, np.floor(recording.time_ps / period_ps), 0).astype(np.int64)
    return evolve(
        recording,
        sync=recording.sync + passed,
        time_ps=recording.time_ps - passed * period_ps,
    )


def recorded_edges(
    recording: Recording,
    config: Config,
    timing: Timing,
    *,
    channels: dict[int, int] | None = None,
    first_sync: int = 0,
    delay_ps: float = 0.0,
) -> tuple[Edges, dict[str, int]]:
    """Return the edges of a recording, sorted by (pulse, tick, pixel), and the number of photons
    lost, by reason.

    Edges are the photons within the frames, pixels and laser period of `config`; a lost photon
    counts for the first reason that applies. channels: pixel of each channel; None = the
    channel's own number (an image: its rows and columns). first_sync: the sync that becomes
    pulse 0. delay_ps: delay of light and cables between trigger and sensor, subtracted from
    every time. Raises `InputError` if no photon is left, and for options that do not fit the
    recording.
    """
    check_kind("recording", recording, Recording)
    check_kind("config", config, Config)
    check_kind("timing", timing, Timing)
    check_kind("channels", channels, dict, NoneType)
    first_sync = check_integer("first-sync", first_sync, 0, SYNC_MAX)
    delay_ps = check_real("delay-ps", delay_ps, -np.inf)
    if not len(recording.sync):
        raise InputError("the recording holds no photons")
    pulses = config.frames * config.pulses
    tick, offset_ps = _ticks(recording, timing.tick_s * PS_PER_S, delay_ps)
    pixel = _pixels(recording, config.sensor.rows, config.sensor.cols, channels)
    pulse = recording.sync - first_sync
    reasons = {
        recording.outside: recording.sync == NO_SYNC,
        f"before sync {first_sync} (--first-sync)": pulse < 0,
        f"after sync {first_sync + pulses - 1}, the last of {config.frames} x {config.pulses} pulses": pulse
        >= pulses,
        "in channels without a pixel": pixel < 0,
        "before the trigger, by the delay": tick < 0,
        f"beyond the laser period of {timing.period_ticks} ticks": tick >= timing.period_ticks,
    }
    left, lost = np.ones(len(tick), bool), {}
    for reason, applies in reasons.items():
        lost[reason] = int(np.sum(left & applies))
        left &= ~applies
    if not left.any():
        syncs = recording.sync[recording.sync != NO_SYNC]
        span = f"; its syncs are {syncs.min()} to {syncs.max()}" if len(syncs) else ""
        raise InputError(f"no photon is left: {told(lost)}{span}")
    pulse, pixel, tick = pulse[left], pixel[left], tick[left].astype(np.int64)
    order = np.lexsort((pixel, tick, pulse))
    edges = Edges(pulse, pixel, tick, None if offset_ps is None else offset_ps[left])
    return edges.take(order), {reason: count for reason, count in lost.items() if count}


def told(lost: dict[str, int]) -> str:
    """Return a message about the photons that `recorded_edges` left out."""
    return "; ".join(f"{count:,} {reason}" for reason, count in lost.items() if count)


def period_note(recording: Recording, timing: Timing) -> str:
    """Return a sentence if the recording's laser period differs from the frame's, else nothing."""
    period_ps = timing.period_s * PS_PER_S
    if (
        recording.period_ps is None
        or abs(recording.period_ps - period_ps) <= SAME_PERIOD * period_ps
    ):
        return ""
    return (
        f"laser period: {recording.period_ps / 1e3:.6g} ns in the recording, {period_ps / 1e3:.6g} ns in the frame "
        f"(frame.period = {max(1, round(recording.period_ps / PS_PER_S * timing.clock_hz))} would fit)"
    )


def _ticks(
    recording: Recording, tick_ps: float, delay_ps: float
) -> tuple[np.ndarray, np.ndarray | None]:
    """Return the tick of each photon, and its place in the tick if the recording knows it."""
    ticks = recording.time_ps if recording.in_ticks else recording.time_ps / tick_ps
    offset_ps = recording.offset_ps
    if offset_ps is None:
        return np.floor(ticks - delay_ps / tick_ps + FRACTION), None
    if delay_ps == 0:  # an offset may lie on the end of its tick, where it stays
        return ticks, offset_ps
    place = ticks + (offset_ps - delay_ps) / tick_ps
    tick = np.floor(place + FRACTION)
    return tick, np.maximum(place - tick, 0) * tick_ps


def _pixels(
    recording: Recording, rows: int, cols: int, channels: dict[int, int] | None
) -> np.ndarray:
    """int64[n]: pixel of each photon, -1 = none."""
    if channels is None:
        row, col = (
            np.divmod(recording.channel, recording.grid[1])
            if recording.grid
            else np.divmod(recording.channel, cols)
        )
        return np.where(
            (recording.channel >= 0) & (row < rows) & (col < cols), row * cols + col, -1
        )
    if recording.grid:
        raise InputError("channels: the recording is an image, whose positions are the pixels")
    pixel_of = {}
    known, index = np.unique(recording.channel, return_inverse=True)
    for channel, pixel in channels.items():
        if channel not in known:
            raise InputError(
                f"channels: channel {channel} is not in the recording, must be one of {_listed(known)}"
            )
        name = f"channels: pixel of channel {channel}"
        pixel_of[int(channel)] = check_integer(name, pixel, 0, rows * cols - 1)
    return np.array([pixel_of.get(int(channel), -1) for channel in known], np.int64)[index]


def _listed(values: np.ndarray, most: int = 16) -> str:
    return ", ".join(map(str, values[:most])) + (
        f", ... {values[-1]}" if len(values) > most else ""
    )
