# SPDX-License-Identifier: Apache-2.0
"""Events of each subgroup, cut into clusters.

A cluster is events of the same pulse to which the same photon may belong.
"""

from typing import NamedTuple

import numpy as np

from ..contract.config import Config
from ..contract.latency import armed_cycle, close_cycle
from ..shared.latest import Latest
from .gates import gate_moved
from .histograms import Events

NEVER = -(1 << 40)  # a tick long before any other


class SubgroupEvents(NamedTuple):
    """Events of a subgroup; times in ticks.

    Events of the same pulse are treated together, as a cluster, if a photon may belong to either.
    """

    stamp: np.ndarray  # int64[n]
    armed: np.ndarray  # int64[n], the tree is armed again
    pulse: np.ndarray  # int64[n]
    winner: np.ndarray  # int64[n]
    hits: np.ndarray  # uint64[n, words]
    offset: np.ndarray  # uint8[n, minigroups], or without columns
    overrun: np.ndarray  # bool[n]
    known: np.ndarray  # int64[n]: from then to the stamp, the tree was armed and no photon came
    quiet: np.ndarray  # int64[n]: before that, from then on, the tree was armed unless it was blind
    since: np.ndarray  # int64[n]: `armed` of the cluster's previous event, `NEVER` without one
    clusters: np.ndarray  # int64[k]: first events of clusters, those that differ in maps in a row
    alike: np.ndarray  # int64[groups + 1]: where in `clusters` such groups begin, and the last ends
    shares: np.ndarray  # of `first_shares`, or empty


_latest: Latest[list[SubgroupEvents]] = Latest()  # grids of a frame follow each other


def cluster_events(
    events: Events, config: Config, pulses: int, reach: int, offsets: bool
) -> list[SubgroupEvents]:
    """Return the events of each subgroup, without shares.

    pulses: number of pulses in which the events came. reach: ticks from the centre of a pulse to
    its beginning and end. offsets: are they used? Then no cluster is like another.
    """
    key = events, config, pulses, reach, offsets
    return _latest.get(key, lambda: _clustered(*key))


def forget_clusters() -> None:
    """Keep no events in memory for another call of `cluster_events`."""
    _latest.forget()


def _clustered(
    events: Events, config: Config, pulses: int, reach: int, offsets: bool
) -> list[SubgroupEvents]:
    room = _Room(*(np.empty(len(events.stamp), np.int64) for _ in _Room._fields))
    return [
        _of_subgroup(events, s, config, pulses, reach, offsets, room)
        for s in range(config.sensor.subgroups)
    ]


class _Room(NamedTuple):
    """Columns of all subgroups, int64[n], of `SubgroupEvents`.

    Few large arrays go back to the system when they are not needed any more; many small ones may
    not.
    """

    armed: np.ndarray
    pulse: np.ndarray
    known: np.ndarray
    quiet: np.ndarray
    since: np.ndarray
    clusters: np.ndarray

    def put(self, name: str, first: int, values: np.ndarray) -> np.ndarray:
        """Write values to a column, from row `first` on, and return this part of it."""
        part: np.ndarray = getattr(self, name)[first : first + len(values)]
        part[:] = values
        return part


def _of_subgroup(
    events: Events,
    s: int,
    config: Config,
    pulses: int,
    reach: int,
    offsets: bool,
    room: _Room,
) -> SubgroupEvents:
    """Return the events of subgroup `s`, with columns in `room`.

    The other arguments are those of `cluster_events`.
    """
    sensor = config.sensor
    span = slice(events.bounds[s], events.bounds[s + 1])
    window = int(events.window[s])
    stamp = events.stamp[span]
    pulse = events.pulse[span] % pulses
    overrun = events.overrun[span]
    armed = armed_ticks(stamp, window, config)
    previous = _previous_armed(armed, pulse)
    earliest = np.maximum(_gate_opens(pulse, s, config), previous)
    cycle = stamp // sensor.phases * sensor.phases
    known = np.minimum(stamp, np.maximum(earliest, cycle))
    quiet_from = quiet_ticks(cycle, window, sensor.phases, sensor.rearm)
    quiet = np.minimum(known, np.maximum(earliest, quiet_from))
    joins = (previous >= 0) & (quiet <= previous + 2 * reach)
    since = np.where(joins, np.minimum(previous, quiet), NEVER)
    kind = _kind(stamp, overrun)
    clusters = np.flatnonzero(since == NEVER)
    clusters = clusters[np.argsort(kind[clusters], kind="stable")]
    begins = np.ones(len(clusters), bool)
    if not offsets:
        single = np.append(since[1:] == NEVER, True)
        begins = _begin_groups(clusters, single, kind, known, quiet)
    first = span.start
    return SubgroupEvents(
        stamp=stamp,
        armed=room.put("armed", first, armed),
        pulse=room.put("pulse", first, pulse),
        winner=events.winner[span],
        hits=events.hits[span],
        offset=events.offset[span],
        overrun=overrun,
        known=room.put("known", first, known),
        quiet=room.put("quiet", first, quiet),
        since=room.put("since", first, since),
        clusters=room.put("clusters", first, clusters),
        alike=np.append(np.flatnonzero(begins), len(clusters)),
        shares=np.empty((0, 0), np.float32),
    )


def _previous_armed(armed: np.ndarray, pulse: np.ndarray) -> np.ndarray:
    """int64[n]: `armed` of the event before, -1 if that was in another pulse."""
    same_pulse = pulse[1:] == pulse[:-1]
    previous = np.full(len(armed), -1)
    previous[1:][same_pulse] = armed[:-1][same_pulse]
    return previous


def _kind(stamp: np.ndarray, overrun: np.ndarray) -> np.ndarray:
    """int64[n]: a number for each stamp, and drops before and after the event."""
    # Does the next event carry `overrun`, or the last one itself?
    followed = np.append(overrun[1:], overrun[-1:])
    return (stamp * 2 + overrun) * 2 + followed


def _begin_groups(
    clusters: np.ndarray, single: np.ndarray, kind: np.ndarray, known: np.ndarray, quiet: np.ndarray
) -> np.ndarray:
    """bool[k]: does a group of clusters that differ in their maps only begin?

    single: bool[n], is the event the last one of its cluster? The others: int64[n], by event.
    """
    alone = single[clusters]
    same = alone[1:] & alone[:-1]
    for values in (kind, known, quiet):
        of_cluster = values[clusters]
        same &= of_cluster[1:] == of_cluster[:-1]
    return np.concatenate([np.ones(min(1, len(clusters)), bool), ~same])


def _gate_opens(pulse: np.ndarray, s: int, config: Config) -> np.ndarray:
    """int64[n]: tick at which the gate of subgroup `s` opened in each pulse, 0 without gating.

    pulse: int64[n].
    """
    if not config.gating[s]:
        return np.zeros_like(pulse)
    in_frame = pulse % config.pulses
    return (config.gate_start[s] + gate_moved(config, in_frame)) * config.sensor.phases


def quiet_ticks(cycle: np.ndarray, window: int, phases: int, rearm: int) -> np.ndarray:
    """int64[n]: tick before which a window had to open, so that the tree is armed at `cycle`.

    cycle: int64[n], ticks at which cycles begin.
    """
    return cycle - rearm * phases - window + 1


def armed_ticks(stamp: np.ndarray, window: int | np.ndarray, config: Config) -> np.ndarray:
    """int64[n]: tick at which the tree is armed again after events at `stamp`."""
    sensor = config.sensor
    close = close_cycle(stamp + (window - 1), 1, sensor.phases)
    return armed_cycle(close, sensor.rearm) * sensor.phases
