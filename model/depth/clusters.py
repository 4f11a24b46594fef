# SPDX-License-Identifier: Apache-2.0
"""Events of each subgroup, cut into clusters: events of the same pulse to which the same photon may belong."""

from functools import lru_cache
from typing import NamedTuple

import numpy as np

from ..contract.config import Config
from ..contract.latency import armed_cycle, close_cycle
from .histograms import Events

NEVER = -(1 << 40)  # a tick long before any other


class SubgroupEvents(NamedTuple):
    """Events of a subgroup, by event; times in ticks.

    Events of the same pulse are treated together, as a cluster, if a photon may belong to either.
    """

    stamp: np.ndarray
    armed: np.ndarray  # the tree is armed again
    pulse: np.ndarray
    winner: np.ndarray
    hits: np.ndarray
    offset: np.ndarray
    overrun: np.ndarray
    known: np.ndarray  # from then on until the stamp, the tree was armed and no photon came
    quiet: np.ndarray  # before that, from then on, the tree was armed unless it was blind, because no window ends later
    since: np.ndarray  # `armed` of the previous event of the cluster, `NEVER` for the first one
    clusters: np.ndarray  # first events of the clusters, in groups that differ in their maps only
    alike: np.ndarray  # where in `clusters` each group begins, and where the last one ends
    shares: np.ndarray  # of `first_shares`, or empty


@lru_cache(1)  # grids of a frame follow each other
def cluster_events(events: Events, config: Config, pulses: int, reach: int, offsets: bool) -> list[SubgroupEvents]:
    """Return the events of each subgroup, without shares. offsets: are they used? Then no event is like another."""
    sensor = config.sensor
    subgroup = np.repeat(np.arange(sensor.subgroups), np.diff(events.bounds))
    stamp, pulse, overrun = events.stamp, events.pulse % pulses, events.overrun
    armed = armed_ticks(stamp, events.window[subgroup], config)
    with_next = (pulse[1:] == pulse[:-1]) & (subgroup[1:] == subgroup[:-1])  # in the same pulse
    previous = np.full(len(stamp), -1)  # `armed` of the event before, if it was in the same pulse
    previous[1:][with_next] = armed[:-1][with_next]
    earliest, cycle = np.maximum(_gate_opens(events, config), previous), stamp // sensor.phases * sensor.phases
    known = np.minimum(stamp, np.maximum(earliest, cycle))
    quiet_from = cycle - sensor.rearm * sensor.phases - events.window[subgroup] + 1
    quiet = np.minimum(known, np.maximum(earliest, quiet_from))
    since = np.where((previous >= 0) & (quiet <= previous + 2 * reach), np.minimum(previous, quiet), NEVER)
    followed = np.append(overrun[1:], False)  # does the next event carry `overrun`, or the last one itself?
    last = events.bounds[1:][np.diff(events.bounds) > 0] - 1
    followed[last] = overrun[last]
    kind = ((subgroup * config.period_ticks + stamp) * 2 + overrun) * 2 + followed
    clusters = np.flatnonzero(since == NEVER)
    clusters = clusters[np.argsort(kind[clusters], kind="stable")]
    alone = np.append(since[1:] == NEVER, True)[clusters] & (not offsets)
    same = alone[1:] & alone[:-1]
    for part in (kind, known, quiet):
        same &= part[clusters[1:]] == part[clusters[:-1]]
    bounds = np.searchsorted(subgroup[clusters], np.arange(sensor.subgroups + 1))
    begins = np.concatenate([np.ones(min(1, len(clusters)), bool), ~same])

    def of_subgroup(s: int) -> SubgroupEvents:
        span, here = slice(events.bounds[s], events.bounds[s + 1]), slice(bounds[s], bounds[s + 1])
        parts = stamp, armed, pulse, events.winner, events.hits, events.offset, overrun, known, quiet, since
        alike = np.append(np.flatnonzero(begins[here]), bounds[s + 1] - bounds[s])
        own = clusters[here] - events.bounds[s], alike, np.empty((0, 0), np.float32)
        return SubgroupEvents._make([*(part[span] for part in parts), *own])

    return [of_subgroup(s) for s in range(sensor.subgroups)]


def _gate_opens(events: Events, config: Config) -> np.ndarray:
    """int64[n]: tick at which the gate opened in each event's pulse, 0 without gating."""
    subgroup = np.repeat(np.arange(config.sensor.subgroups), np.diff(events.bounds))
    opens = (config.gate_start[subgroup] + gate_moved(config, events.pulse % config.pulses)) * config.sensor.phases
    return np.where(config.gating[subgroup], opens, 0)


def gate_moved(config: Config, pulse: np.ndarray) -> np.ndarray:
    """int64[n]: cycles by which the gate has moved in pulses of a frame, int64[n]."""
    every, steps = config.frame.gate_every, config.frame.gate_steps
    return config.frame.gate_step * (pulse // every % steps if every else np.zeros_like(pulse))


def armed_ticks(stamp: np.ndarray, window: int | np.ndarray, config: Config) -> np.ndarray:
    """int64[n]: tick at which the tree is armed again after events at `stamp`."""
    phases = config.sensor.phases
    return armed_cycle(close_cycle(stamp + (window - 1), 1, phases), config.sensor.rearm) * phases
