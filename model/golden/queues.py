# SPDX-License-Identifier: Apache-2.0
"""Queues of the golden model: the events and minigroup records of a stream's subgroups that are on
their way, from one piece of a frame to the next.

A queue is a row of indices into the rows of events and records. `join` puts the rows of a piece
behind those that are left of the pieces before; `split` takes out the rows that nothing needs any
more.
"""

from typing import NamedTuple

import numpy as np

from ..shared.compiled import njit
from .front_end import Events, Records
from .shape import row_type

NONE = -1

# Queue of a subgroup.
QUEUE = row_type(
    "next_event",  # to be committed
    "end_event",
    "read",  # event that is read next
    "oldest",  # event whose place may still be occupied
    "level",  # occupied places
    "lost",  # an event was dropped since the last stored one
    "next_record",  # to be written
    "end_record",
    "waiting",  # record in the only place, or NONE
    "place_free_at",  # cycle from which on that place is free
    "stored",  # counters
    "dropped",
    "mg_stored",
    "mg_dropped",
)
_EVENT_INDICES = ("next_event", "end_event", "read", "oldest")
_RECORD_INDICES = ("next_record", "end_record")


class Commits(NamedTuple):
    """Stored events, by subgroup and then by time."""

    subgroup: np.ndarray  # int64[n], number in the stream
    cycle: np.ndarray  # int64[n], of the commit
    freed_at: np.ndarray  # int64[n], from this cycle on, the event's place is free


def new_queues(subgroups: int) -> np.ndarray:
    """QUEUE[subgroups]: the queues of a stream at the beginning of a frame."""
    queues = np.zeros(subgroups, QUEUE)
    queues["waiting"] = NONE
    return queues


def join(
    queues: np.ndarray, kept: tuple[Events, Records], made: tuple[Events, Records]
) -> tuple[Events, Records]:
    """Return the rows of `kept`, and behind those of each subgroup its rows of `made`; let the
    queues follow. All of one stream.
    """
    for name in _EVENT_INDICES:
        queues[name] += made[0].bounds[:-1]
    queues["end_event"] += np.diff(made[0].bounds)
    for name in _RECORD_INDICES:
        queues[name] += made[1].bounds[:-1]
    queues["waiting"] += np.where(queues["waiting"] == NONE, 0, made[1].bounds[:-1])
    queues["end_record"] += np.diff(made[1].bounds)
    events = Events(*_joined(kept[0], made[0]))
    records = Records(*_joined(kept[1], made[1]))
    return events, records


def _joined(kept: Events | Records, made: Events | Records) -> list[np.ndarray]:
    """Return bounds and columns of both."""
    if not kept.bounds[-1]:
        return list(made)
    bounds = kept.bounds + made.bounds
    columns = [bounds]
    for old, new in zip(kept[1:], made[1:], strict=True):
        column = np.empty((bounds[-1], *new.shape[1:]), new.dtype)
        _put_together(_plain(column), _plain(old), kept.bounds, _plain(new), made.bounds)
        columns.append(column)
    return columns


def _plain(column: np.ndarray) -> np.ndarray:
    """Return a view of a column as numbers, [rows, numbers per row]."""
    if column.dtype.names is None:
        return column
    return column.view(np.int64).reshape(len(column), len(column.dtype.names))


@njit(allocates=False)
def _put_together(
    column: np.ndarray,
    old: np.ndarray,
    old_bounds: np.ndarray,
    new: np.ndarray,
    new_bounds: np.ndarray,
) -> None:
    """Write, for each subgroup, the `old` rows and then the `new` rows to `column`. All: [rows,
    numbers per row].
    """
    row = 0
    for s in range(len(old_bounds) - 1):
        for k in range(old_bounds[s], old_bounds[s + 1]):
            for n in range(column.shape[1]):
                column[row, n] = old[k, n]
            row += 1
        for k in range(new_bounds[s], new_bounds[s + 1]):
            for n in range(column.shape[1]):
                column[row, n] = new[k, n]
            row += 1


def split(
    queues: np.ndarray, events: Events, records: Records
) -> tuple[tuple[Events, Records], Commits]:
    """Return the rows that may still be needed, and the stored events among the others; let the
    queues follow.
    """
    rows = int(events.bounds[-1])
    left = np.empty(rows, np.bool_)
    commits = Commits(*(np.empty(rows, np.int64) for _ in Commits._fields))
    gone = _let_go(queues, events, left, commits)
    number = _before(left)
    for name in _EVENT_INDICES:
        queues[name] = number[queues[name]]
    still_events = Events(*_chosen(events, left, number))

    left = np.empty(int(records.bounds[-1]), np.bool_)
    _let_records_go(queues, records, left)
    number = _before(left)
    for name in _RECORD_INDICES:
        queues[name] = number[queues[name]]
    waiting = queues["waiting"] != NONE
    queues["waiting"][waiting] = number[queues["waiting"][waiting]]
    still = still_events, Records(*_chosen(records, left, number))
    return still, Commits(*(column[:gone].copy() for column in commits))


@njit(allocates=False)
def _let_go(queues: np.ndarray, events: Events, left: np.ndarray, commits: Commits) -> int:
    """Set which events are still to be committed or may occupy a place; write the stored ones
    among the others to `commits`, and return their number.
    """
    gone = 0
    for s in range(len(queues)):
        queue = queues[s]
        for k in range(events.bounds[s], events.bounds[s + 1]):
            event = events.row[k]
            left[k] = k >= queue.next_event or (k >= queue.oldest and event.stored)
            if event.stored and not left[k]:
                commits.subgroup[gone] = s
                commits.cycle[gone] = event.cycle
                commits.freed_at[gone] = event.free_at
                gone += 1
    return gone


@njit(allocates=False)
def _let_records_go(queues: np.ndarray, records: Records, left: np.ndarray) -> None:
    """Set which records are still to be written or wait in their place."""
    for s in range(len(queues)):
        for k in range(records.bounds[s], records.bounds[s + 1]):
            left[k] = k >= queues[s].next_record or k == queues[s].waiting


def _chosen(rows: Events | Records, left: np.ndarray, number: np.ndarray) -> list[np.ndarray]:
    """Return bounds and columns of the rows that are left. number: `_before(left)`."""
    index = np.flatnonzero(left)
    return [number[rows.bounds], *(column[index] for column in rows[1:])]


def _before(left: np.ndarray) -> np.ndarray:
    """int64[n + 1]: how many rows are left before each row."""
    before = np.zeros(len(left) + 1, np.int64)
    np.cumsum(left, out=before[1:])
    return before
