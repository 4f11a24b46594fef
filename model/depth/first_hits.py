# SPDX-License-Identifier: Apache-2.0
"""Which pixel set the offset of its minigroup (format full): the one that was hit first."""

import math

import numpy as np

from ..contract.parameters import OFFSET_NONE
from ..shared.compiled import njit
from .firing import RARE
from .histograms import is_hit


@njit
def first_shares(law, events, minigroup, time, light, sigma):
    """float32[n, pixels]: probability that a hit pixel was the first of its minigroup, so that all others fired later."""
    stamp, winner, hits, offset = events.stamp, events.winner, events.hits, events.offset
    n, pixels = len(stamp), len(minigroup)
    shares = np.zeros((n, pixels), np.float32)
    members = np.empty(pixels, np.int64)
    later = np.empty(pixels)
    for e in range(n):
        cycle, end = stamp[e] // law.phases * law.phases, stamp[e] + law.window
        for g in range(offset.shape[1]):
            if offset[e, g] == OFFSET_NONE or g == minigroup[winner[e]]:
                continue
            begin = max(stamp[e], cycle + offset[e, g] * law.offset)
            own = min(end, cycle + (offset[e, g] + 1) * law.offset)
            number = 0
            for i in range(pixels):
                if minigroup[i] == g and is_hit(hits, e, i):
                    members[number] = i
                    last = _unfired(end - time[i], light[i], sigma)
                    inside = _unfired(begin - time[i], light[i], sigma) - last
                    if inside > RARE:
                        later[number] = (_unfired(own - time[i], light[i], sigma) - last) / inside
                    else:  # background, or an unknown surface
                        later[number] = (end - own) / (end - begin)
                    number += 1
            for j in range(number):
                share = 1.0
                for k in range(number):
                    if k != j:
                        share *= later[k]
                shares[e, members[j]] = share
    return shares


@njit(allocates=False)
def _unfired(distance, light, sigma):
    """Return 1 - F."""
    return math.exp(-light * 0.5 * math.erfc(-distance / sigma * math.sqrt(0.5)))
