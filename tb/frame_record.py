# SPDX-License-Identifier: Apache-2.0
"""A frame to play, and its record: input and output of all ways of running the RTL."""

import pickle
from pathlib import Path

import numpy as np
from attrs import define, field, frozen

from ..model.contract.config import Config
from ..model.contract.edges import Edges
from ..model.contract.latency import FINISH
from ..model.contract.link import beats_waiting_max
from ..model.golden.frame import Trace

JOB_VARIABLE = "COINCID_JOB"  # environment variable of the simulator: path of the job
RESULT, MISMATCH = ".result", ".mismatch"  # suffixes of the files that a job leaves beside it
PROGRESS = "@cycle"  # line of the simulator's output for a progress bar
STORED_TO_COMMIT = 1  # the subgroup's `stored` strobe comes one cycle after the commit


@frozen(eq=False)
class FrameJob:
    """A frame to play. expected: the golden model's prediction, checked on the fly; None: the
    frame is only recorded.

    ready: uint8[n], whether the receiver behind the streams' links takes a beat in cycle c; from
    cycle n on it always does.
    """

    config: Config
    edges: Edges
    expected: Trace | None = None
    ready: np.ndarray = field(factory=lambda: np.zeros(0, np.uint8))


@define(eq=False)
class Recorded:
    """Record of a frame: the beats (uint64) of each stream and their cycles; stored events,
    sorted by subgroup and time.
    """

    beats: list[np.ndarray]
    beat_cycle: list[np.ndarray]
    commit_subgroup: np.ndarray
    commit_cycle: np.ndarray
    cycles: int
    checked: int = field(default=0)


def save_job(path: Path, frames: list[FrameJob], lines: bool = False) -> dict[str, str]:
    """Write frames for `cosim.py` to play, and return the environment in which it finds them.

    lines: every SPAD edge has its own picosecond (for the view with delays).
    """
    path.write_bytes(pickle.dumps((frames, lines)))
    return {JOB_VARIABLE: str(path)}


def load_job(path: Path) -> tuple[list[FrameJob], bool]:
    """Return frames and lines as given to `save_job`."""
    return pickle.loads(path.read_bytes())


def cycle_limit(config: Config, receiver_cycles: int) -> int:
    """Return the number of cycles after which any frame must have ended; a sensor that needs more
    hangs. receiver_cycles: cycles in which the receiver may refuse beats.
    """
    waiting = int(2 * beats_waiting_max(config.sensor) / config.link_share)
    return config.frame_cycles + receiver_cycles + FINISH + waiting + 1000
