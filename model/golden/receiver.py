# SPDX-License-Identifier: Apache-2.0
"""When the link behind a stream, and the receiver behind the link, take a beat (kernels)."""

from typing import NamedTuple

import numpy as np

from ..contract.config import Config
from ..contract.link import next_taken, takes_beats
from ..shared.compiled import part

_next_taken = part(next_taken)


class Receiver(NamedTuple):
    """The link of a stream, and the receiver behind it in the first n cycles of a frame. From
    cycle n on, the receiver takes every beat of the link.
    """

    early: np.ndarray  # int64[n], first cycle from each of these on in which a beat is taken
    beats: int  # share of the link: so many beats
    cycles: int  # in so many cycles


def receiver_of(config: Config, ready: np.ndarray | None = None) -> Receiver:
    """Return what takes the beats of a configuration's streams.

    ready: uint8[n], the cycles in which the receiver behind the link takes a beat; it takes
    every one from cycle n on, or if this is None.
    """
    share = config.link_share
    behind = np.zeros(0, np.uint8) if ready is None else np.asarray(ready, np.uint8)
    n = len(behind)
    taken = takes_beats(share, n) & (behind != 0)
    later = next_taken(n, share.numerator, share.denominator)
    following = np.where(taken, np.arange(n), later)
    return Receiver(
        early=np.minimum.accumulate(following[::-1])[::-1].copy(),
        beats=share.numerator,
        cycles=share.denominator,
    )


@part
def taken_from(receiver: Receiver, cycle: int) -> int:
    """Return the first cycle from `cycle` on in which a beat is taken."""
    if cycle < len(receiver.early):
        return receiver.early[cycle]
    return _next_taken(cycle, receiver.beats, receiver.cycles)
