# SPDX-License-Identifier: Apache-2.0
"""Reconstructs a frame inside its subgroups: each edge with its fate, each window with its verdict,
the fill of each FIFO.

Nothing is simulated here. Windows follow from the fates of the edges; commits and departures come
from the golden model's record of the frame. The selection is our choice; the terms are those of the
contract (paper III-A).
"""

import enum

import numpy as np
from attrs import evolve, frozen

from ...model.contract import latency
from ...model.contract.coincidence import AT_LEAST
from ...model.contract.config import Config
from ...model.contract.counters import COUNTER_NAMES
from ...model.contract.edges import Edges, Fate
from ...model.contract.pixels import pixel_table
from ...model.depth.gates import gate_moved
from ...model.golden.frame import Trace
from ...model.shared.errors import check_integer


class Verdict(enum.IntEnum):
    """Fate of a window."""

    COMMITTED = 0
    REJECTED = 1
    DROPPED = 2


@frozen(eq=False)
class Windows:
    """Windows, arrays [n], in the order of the edges that opened them.

    start, end: int64, ticks of their period; the window is [start, end). count: int64, distinct
    pixels. verdict: uint8, `Verdict`. commit: int64, cycles from the start of the period to the
    commit; also given for windows without a commit.
    """

    start: np.ndarray
    end: np.ndarray
    count: np.ndarray
    verdict: np.ndarray
    commit: np.ndarray


@frozen(eq=False)
class Timeline:
    """One frame, sorted by subgroup, laser period and time; period k = subgroup * pulses + pulse.

    Edges, arrays [edges]: tick (int64, in its period), pixel (int64, in the subgroup), fate
    (uint8); period k has edge_bounds[k] to edge_bounds[k + 1]. windows: likewise, with
    window_bounds. start_cycles: int64[pulses], first cycles of the periods. FIFOs: fill_cycle
    (int64, of the frame) is the time of a change, fill (int64) the level from then on; subgroup s
    has fill_bounds[s] to fill_bounds[s + 1], starting with level 0 in cycle 0. threshold:
    int64[subgroups], number of pixels that a window needed.
    """

    config: Config
    tick: np.ndarray
    pixel: np.ndarray
    fate: np.ndarray
    edge_bounds: np.ndarray
    windows: Windows
    window_bounds: np.ndarray
    start_cycles: np.ndarray
    fill_cycle: np.ndarray
    fill: np.ndarray
    fill_bounds: np.ndarray
    threshold: np.ndarray

    def period(self, subgroup: int, pulse: int) -> "Period":
        """Return one laser period of one subgroup. Raises `InputError`."""
        sensor, pulses = self.config.sensor, self.config.pulses
        subgroup = check_integer("subgroup", subgroup, 0, sensor.subgroups - 1)
        pulse = check_integer("pulse", pulse, 0, pulses - 1)
        k = subgroup * pulses + pulse
        edges = slice(*self.edge_bounds[k : k + 2])
        windows = slice(*self.window_bounds[k : k + 2])
        first = self.start_cycles[pulse]
        cycles = self.fill_cycle[slice(*self.fill_bounds[subgroup : subgroup + 2])] - first
        fill = self.fill[slice(*self.fill_bounds[subgroup : subgroup + 2])]
        inside = slice(
            np.searchsorted(cycles, 0, "right") - 1,
            np.searchsorted(cycles, self.config.period, "left"),
        )
        return Period(
            tick=self.tick[edges],
            pixel=self.pixel[edges],
            fate=self.fate[edges],
            windows=Windows(
                *(getattr(self.windows, part.name)[windows] for part in Windows.__attrs_attrs__)
            ),
            fill_cycle=np.maximum(cycles[inside], 0),
            fill=fill[inside],
            gate_cycles=gate_of(self.config, subgroup, pulse),
            threshold=int(self.threshold[subgroup]),
        )


@frozen(eq=False)
class Period:
    """One laser period of one subgroup, with arrays as in `Timeline`; fill_cycle counts from the
    first cycle of the period.

    gate_cycles: (first, last + 1) of the gate, None if gating is off.
    """

    tick: np.ndarray
    pixel: np.ndarray
    fate: np.ndarray
    windows: Windows
    fill_cycle: np.ndarray
    fill: np.ndarray
    gate_cycles: tuple[int, int] | None
    threshold: int


def gate_of(config: Config, subgroup: int, pulse: int) -> tuple[int, int] | None:
    """Return (first, last + 1), the cycles of a subgroup's gate at a pulse of the frame; None if
    gating is off.
    """
    if not config.gating[subgroup]:
        return None
    first = int(config.gate_start[subgroup] + gate_moved(config, np.array([pulse]))[0])
    return min(first, config.period), min(first + int(config.gate_len[subgroup]), config.period)


def one_period(config: Config, edges: Edges, trace: Trace, subgroup: int, pulse: int) -> Period:
    """Return `Timeline.period` without making the timeline of all other periods."""
    of_pulse = np.flatnonzero(edges.pulse == pulse)
    own = of_pulse[pixel_table(config.sensor).subgroup[edges.pixel[of_pulse]] == subgroup]
    commits = slice(*np.searchsorted(trace.commit_subgroup, (subgroup, subgroup + 1)))
    part = evolve(
        trace,
        fate=trace.fate[own],
        commit_subgroup=trace.commit_subgroup[commits],
        commit_cycle=trace.commit_cycle[commits],
        freed_cycle=trace.freed_cycle[commits],
    )
    return frame_timeline(config, edges.take(own), part).period(subgroup, pulse)


def frame_timeline(config: Config, edges: Edges, trace: Trace) -> Timeline:
    """Return the timeline of a frame that the golden model played without stalls. edges: pulses
    count from the frame's start.
    """
    sensor, pulses = config.sensor, config.pulses
    table = pixel_table(sensor)
    subgroup, inside = table.subgroup[edges.pixel], table.inside[edges.pixel]
    period = subgroup * pulses + edges.pulse
    order = np.argsort(
        (period * config.period_ticks + edges.tick) * sensor.pixels + inside, kind="stable"
    )
    period = period[order]
    tick, fate = edges.tick[order], trace.fate[order]
    periods = np.arange(sensor.subgroups * pulses + 1)
    opening = fate == Fate.OPENING
    threshold = np.where(
        config.coincidence, trace.counters[:, COUNTER_NAMES.index("threshold_used")], 1
    )
    count = _counts(opening, fate)
    limit = threshold[subgroup[order][opening]]
    if sensor.rule == AT_LEAST:
        meets = count >= limit
    else:
        meets = _judged(config, _maps(config, opening, fate, inside[order]), limit)
    windows = _windows(config, trace, period[opening], tick[opening], count, meets)
    fill_cycle, fill, fill_bounds = _fill(config, trace)
    return Timeline(
        config=config,
        tick=tick,
        pixel=inside[order],
        fate=fate,
        edge_bounds=np.searchsorted(period, periods),
        windows=windows,
        window_bounds=np.searchsorted(period[opening], periods),
        start_cycles=config.start_cycles()[:-1],
        fill_cycle=fill_cycle,
        fill=fill,
        fill_bounds=fill_bounds,
        threshold=threshold,
    )


def _counts(opening: np.ndarray, fate: np.ndarray) -> np.ndarray:
    """int64[windows]: distinct pixels of each window: the edge that opened it, and those counted
    after it.
    """
    of_window = np.cumsum(opening) - 1
    return np.bincount(of_window[opening | (fate == Fate.COUNTED)], minlength=opening.sum())


def _maps(config: Config, opening: np.ndarray, fate: np.ndarray, pixel: np.ndarray) -> np.ndarray:
    """bool[windows, rows, cols]: the pixels of a subgroup that are in each window."""
    counted = opening | (fate == Fate.COUNTED)
    of_window = np.cumsum(opening) - 1
    maps = np.zeros((opening.sum(), config.sensor.pixels), bool)
    maps[of_window[counted], pixel[counted]] = True
    return maps.reshape(-1, *config.sensor.subgroup)


def _judged(config: Config, maps: np.ndarray, limit: np.ndarray) -> np.ndarray:
    """bool[windows]: which windows the sensor's own rule lets become events. limit: the threshold
    of each.
    """
    meets = np.zeros(len(maps), bool)
    for one in np.unique(limit):
        own = limit == one
        meets[own] = config.sensor.rule.judged(maps[own], int(one))
    return meets


def _windows(
    config: Config,
    trace: Trace,
    period: np.ndarray,
    start: np.ndarray,
    count: np.ndarray,
    meets: np.ndarray,
) -> Windows:
    """Return the windows. meets: bool[windows], those that become events if the FIFO has room."""
    subgroup, pulse = np.divmod(period, config.pulses)
    end = start + np.where(config.coincidence, config.window, 1)[subgroup]
    commit = (end - 1 >> config.sensor.phase_bits) + latency.COMMIT
    cycle = config.start_cycles()[pulse] + commit
    stored = np.isin(_key(subgroup, cycle), _key(trace.commit_subgroup, trace.commit_cycle))
    met = np.where(stored, Verdict.COMMITTED, Verdict.DROPPED)
    verdict = np.where(meets, met, Verdict.REJECTED).astype(np.uint8)
    return Windows(start, end, count, verdict, commit)


def _key(subgroup: np.ndarray, cycle: np.ndarray) -> np.ndarray:
    """Return one integer per (subgroup, cycle); a subgroup commits at most once per cycle."""
    return subgroup.astype(np.int64) << 48 | cycle


def _fill(config: Config, trace: Trace) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return (fill_cycle, fill, fill_bounds) of `Timeline`. An event adds 1 when it is stored, and
    -1 when its place is free again.

    A place that becomes free in the cycle of a commit can take that commit.
    """
    subgroups = np.arange(config.sensor.subgroups)
    subgroup = np.concatenate([subgroups, trace.commit_subgroup, trace.commit_subgroup])
    cycle = np.concatenate([np.zeros_like(subgroups), trace.commit_cycle, trace.freed_cycle])
    change = np.repeat(
        [0, 1, -1], [len(subgroups), len(trace.commit_cycle), len(trace.freed_cycle)]
    )
    order = np.lexsort((change, cycle, subgroup))
    # Every event has left by the end of the frame, so the sum over the earlier subgroups is 0.
    return (
        cycle[order],
        np.cumsum(change[order]),
        np.searchsorted(subgroup[order], np.arange(len(subgroups) + 1)),
    )
