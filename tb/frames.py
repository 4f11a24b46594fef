"""A frame to play and what it showed: what all ways of running the RTL take and give."""

import numpy as np
from attrs import define, field, frozen

from ..model.contract.config import Config
from ..model.contract.edges import Edges
from ..model.contract.latency import FINISH
from ..model.contract.packet import layout
from ..model.golden.frame import Trace

STORED_TO_COMMIT = 1  # the subgroup's `stored` strobe stands a cycle after the commit


@frozen(eq=False)
class FrameJob:
    """A frame to play. expected: the golden model's prediction, checked on the fly; None: only recorded.

    ready: uint8[n], `tready` of cycle c is ready[c], and 1 from cycle n on.
    """

    config: Config
    edges: Edges
    expected: Trace | None = None
    ready: np.ndarray = field(factory=lambda: np.zeros(0, np.uint8))


@define(eq=False)
class Recorded:
    """What a frame showed: per stream beats (uint64) and their cycles; stored events by subgroup, then time."""

    beats: list[np.ndarray]
    beat_cycle: list[np.ndarray]
    commit_subgroup: np.ndarray
    commit_cycle: np.ndarray
    cycles: int
    checked: int = field(default=0)


def cycle_limit(config: Config, ready_cycles: int) -> int:
    """Cycles by which a frame must have ended, whatever it holds: a sensor that needs more hangs."""
    sensor, parts = config.sensor, layout(config.sensor)
    waiting = sensor.subgroups * ((sensor.fifo_depth + 2) * parts.longest + parts.counter_beats)
    return config.frame_cycles + ready_cycles + FINISH + 2 * waiting + 1000
