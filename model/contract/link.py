# SPDX-License-Identifier: Apache-2.0
"""The link behind each stream: the part of the stream's bandwidth that the pins of the chip carry.

`tready` models the pins. The paper leaves the readout open. Our own choice is a link that may be
slower than 64 bits per cycle and takes beats at even distances.
"""

from fractions import Fraction

import numpy as np

from ..shared.errors import told_number, wrong_value
from .packet import BEAT_BITS, COUNTS, layout
from .parameters import Sensor
from .settings import LINK_GBPS_MAX

# lowest share of the cycles: with a lower one, a frame would take too long
SHARE_MIN = Fraction(1, 1024)
# denominator of the share: keeps products with cycle numbers in 64 bits
_DENOMINATOR_MAX = 1 << 20


def link_share(link_gbps: float, clock_mhz: float) -> Fraction:
    """Return the share of the cycles in which the link takes a beat, at most 1. link_gbps: 0 is
    as fast as the stream.
    """
    share = Fraction(str(link_gbps)) / stream_gbps(clock_mhz) if link_gbps else Fraction(1)
    return min(share, Fraction(1)).limit_denominator(_DENOMINATOR_MAX)


def check_link(link_gbps: float, clock_mhz: float) -> None:
    """Raise `InputError` if the link takes beats in less than `SHARE_MIN` of the cycles."""
    low_gbps = float(stream_gbps(clock_mhz) * SHARE_MIN)
    if 0 < link_gbps < low_gbps:
        legal = f"0 (as fast as the stream) or from {told_number(low_gbps)} to {told_number(LINK_GBPS_MAX)}"
        raise wrong_value("frame.link_gbps", link_gbps, legal, low=low_gbps, high=LINK_GBPS_MAX)


def stream_gbps(clock_mhz: float) -> Fraction:
    """Return the bandwidth of a stream, which is one beat per cycle."""
    return BEAT_BITS * Fraction(str(clock_mhz)) / 1000


def beats_waiting_max(sensor: Sensor) -> int:
    """Return the most beats that a sensor may still have to send when the last period of a frame
    ends.
    """
    parts = layout(sensor)
    of_subgroup = (sensor.fifo_depth + 2) * parts.longest
    if sensor.counts:
        of_subgroup = max(of_subgroup, sensor.minigroups * parts.length(COUNTS))
    return sensor.subgroups * (of_subgroup + parts.counter_beats)


def takes_beats(share: Fraction, cycles: int) -> np.ndarray:
    """uint8[cycles]: whether a link takes a beat in a cycle.

    The link is ready at even distances, with or without a beat: in cycle c if floor((c + 1) *
    share) is above floor(c * share).
    """
    taken = np.arange(cycles + 1, dtype=np.int64) * share.numerator // share.denominator
    return np.diff(taken).astype(np.uint8)


def takes_beat(share: Fraction, cycle: int) -> bool:
    """Return whether a link takes a beat in a cycle: the rule of `takes_beats`."""
    before = cycle * share.numerator // share.denominator
    after = (cycle + 1) * share.numerator // share.denominator
    return after > before


def next_taken(cycle: int, beats: int, cycles: int) -> int:
    """Return the first cycle from `cycle` on in which a link takes a beat: the rule of
    `takes_beats` without a loop.

    beats, cycles: numerator and denominator of the link's share. Every `cycles` cycles, the link
    begins again, so no product is above the square of `_DENOMINATOR_MAX`. Kernels compile their
    own version.
    """
    since = cycle % cycles  # cycles since the link began again
    before = since * beats // cycles  # beats in them
    return cycle - since + ((before + 1) * cycles - 1) // beats
