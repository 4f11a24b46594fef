# SPDX-License-Identifier: Apache-2.0
"""Which of the hit pixels of a minigroup was its first, whose time the offset is."""

from math import erf, exp, prod, sqrt

import numpy as np
import pytest

from coincid.model.contract.parameters import OFFSET_NONE
from coincid.model.depth.clusters import SubgroupEvents
from coincid.model.depth.evidence import Shape, first_shares
from coincid.model.depth.heard import nothing_heard
from coincid.model.depth.law import Law

STAMP, WINDOW, PHASES, STEP_TICKS = 101, 12, 8, 2
SIGMA_TICKS = 3.0
MINIGROUP = np.repeat(np.arange(3), 4)  # of each pixel
FAR = 500.0
TIME = np.array([102.0, FAR, FAR, FAR, 104.0, FAR, 107.0, 111.0, 103.0, 109.0, FAR, np.nan])
LIGHT = np.array([1.0, 1.0, 1.0, 1.0, 2.0, 1.5, 0.25, 1.0, 0.5, 0.0, 1.0, 0.0])
NONE = np.zeros(1, np.int64)


def unfired(tick, time, light):
    return exp(-light * 0.5 * (1 + erf((tick - time) / SIGMA_TICKS / sqrt(2))))


def later_share(pixel, step):
    """Return the chance that a hit pixel fired after a step of the offsets, in the window."""
    cycle = STAMP // PHASES * PHASES
    end = STAMP + WINDOW
    begin = max(STAMP, cycle + step * STEP_TICKS)
    after = min(end, cycle + (step + 1) * STEP_TICKS)
    first, own, last = (unfired(tick, TIME[pixel], LIGHT[pixel]) for tick in (begin, after, end))
    if not first - last > 1e-9:  # only background can have fired it, at any of these ticks
        return (end - after) / (end - begin)
    return (own - last) / (first - last)


def shares_of(hits, offsets):
    """float[pixels]: of one event that pixel 0 has won."""
    law = Law(
        window=WINDOW,
        mapped=True,
        phases=PHASES,
        offset=STEP_TICKS,
        reach=12,
        step=1,
        origin=0,
        lights=1,
        noise=1e-4,
        alive=np.float32(1),
        pulses=1,
        heard=nothing_heard(),
        sharp=np.empty((0, 0, 0), np.float32),
        margin=0,
        fired=np.empty(0, np.float32),
    )
    events = SubgroupEvents(
        stamp=np.array([STAMP]),
        armed=NONE,
        pulse=NONE,
        winner=NONE,
        hits=np.array([[sum(1 << pixel for pixel in hits)]], np.uint64),
        offset=np.array([offsets], np.uint8),
        overrun=np.zeros(1, bool),
        known=NONE,
        quiet=NONE,
        since=NONE,
        clusters=NONE,
        alike=NONE,
        shares=np.empty((0, 0), np.float32),
    )
    shape = Shape(SIGMA_TICKS, np.empty(0), np.empty(0))
    return first_shares(law, events, MINIGROUP, TIME, LIGHT, shape)[0]


@pytest.mark.parametrize("steps", [(4, 6), (3, 2), (8, 7), (5, OFFSET_NONE)], ids=str)
@pytest.mark.parametrize(
    "hits",
    [(0, 4), (0, 4, 7), (0, 4, 5, 6, 7, 9, 10), (0, 1, 5, 6, 8, 9, 11)],
    ids=["one", "two", "all_of_one", "in_the_dark"],
)
def test_a_pixel_was_the_first_if_all_others_of_its_minigroup_came_later(hits, steps):
    """Those of the winner's minigroup are not asked, nor those of one without an offset."""
    found = shares_of(hits, (2, *steps))
    expected = np.zeros(len(MINIGROUP))
    for group, step in enumerate(steps, 1):
        members = [pixel for pixel in hits if MINIGROUP[pixel] == group]
        if step == OFFSET_NONE:
            continue
        for pixel in members:
            others = [other for other in members if other != pixel]
            expected[pixel] = prod(later_share(other, step) for other in others)
    np.testing.assert_allclose(found, expected, atol=1e-5)
