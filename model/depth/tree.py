# SPDX-License-Identifier: Apache-2.0
"""How often a photon leaves no trace, computed from the light of its subgroup.

A window opens at the first photon after the tree was armed. It becomes an event if enough pixels
fire in it. So an early photon of a pulse finds more company than a late one. The chances follow from
one walk forwards through the cycles of a period, with the probability that the tree is armed and
that no event came so far, and one backwards, with the probability that no event will come.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ..contract.coincidence import Rise
from ..shared.compiled import njit, part
from .portable import geometric_steps

SCALES = geometric_steps(0.09, 3.3, 10)  # of the light: factors that are tried
SCALE_SIGMA = 1.5  # standard deviation of the logarithm of the scale, before events are counted
SURE_EVENTS = 8.0  # squared excess over background, relative to all events: half certain
SILENCE_MIN = 1e-30  # share of the pulses without an event in a cycle, at least


class Tree(NamedTuple):
    """What holds for the windows of a subgroup."""

    window: int  # ticks
    phases: int  # ticks per cycle
    rearm: int  # cycles
    kept: np.ndarray  # float64[n], of `kept_shares`


class Without(NamedTuple):
    """What would happen in a pulse without the photon, by tick, float64[ticks]."""

    opens: np.ndarray  # a window opens, if the tree is armed and no photon came in its cycle
    alone: np.ndarray  # no photon came in the cycle before the tick
    rejected: np.ndarray  # a window that opens at the tick is rejected,
    more: np.ndarray  # even if one more pixel fires in it
    own: np.ndarray  # a window that the photon itself opens is rejected


def kept_shares(rising: Sequence[Rise], pixels: int) -> np.ndarray:
    """float64[pixels + 2]: share of the windows of so many pixels that become events."""
    kept = np.zeros(pixels + 2)
    for rise in rising:
        kept[rise.pixels :] += rise.share
    kept[pixels:] = 1.0
    return np.minimum(kept, 1.0)


@njit(error_model="numpy")
def unheard_in(
    signal: np.ndarray, noise: float, tree: Tree, missed: np.ndarray, blind: np.ndarray
) -> None:
    """Compute the chance that a photon leaves no trace, by tick, float32[ticks].

    signal: float64[ticks], photons of the other pixels' surfaces per tick; noise: of their
    background. missed: it makes no event, if without it there was none in the pulse. blind: the tree
    is armed at the next cycle, and no event came, if that was so without it.
    """
    ticks = len(signal)
    cycles = ticks // tree.phases
    span = tree.window + (1 + tree.rearm) * tree.phases
    reach = 2 + tree.rearm + tree.window // tree.phases
    if tree.kept[1] >= 1:  # every window becomes an event
        missed[:] = 0
        blind[:] = 0
        return
    law = Without(
        opens=np.empty(ticks),
        alone=np.empty(ticks),
        rejected=np.empty(ticks),
        more=np.empty(ticks),
        own=np.empty(ticks),
    )
    _without(signal, noise, tree, law)
    silence = np.ones(cycles + reach + 2)
    _fill_silence(law, tree, cycles, silence)
    opened = np.zeros(ticks)  # chance that a window opened at a tick, and no event came before
    coming = np.zeros(cycles + reach + 2)  # chance that the tree is armed first at a cycle
    coming[0] = 1.0
    armed = 0.0
    for c in range(cycles):
        armed += coming[c]
        begin = c * tree.phases
        end = begin + tree.phases
        earliest = max(0, begin - span)
        whole = armed
        for k in range(c + 1, c + reach + 1):
            whole += coming[k]
        _scale(opened[earliest:begin], 1 / whole)
        _scale(coming[c + 1 : c + reach + 1], 1 / whole)
        armed /= whole
        here = 0.0  # of windows that are over, and the tree is not armed yet
        here_armed = 0.0
        within = 0.0  # of windows that are open
        within_armed = 0.0
        silent = armed * silence[c]
        next_armed = armed * law.alone[end - 1] * (1 - law.opens[end - 1])
        for s in range(earliest, begin):
            again = _armed(tree, s)
            if again > c:
                later = opened[s] * _later(silence, c + 1, again)
                silent += later * law.rejected[s]
                is_next = opened[s] if again == c + 1 else 0.0
                next_armed += is_next * law.rejected[s]
                if s + tree.window > begin:
                    within += later * law.more[s]
                    within_armed += is_next * law.more[s]
                else:
                    here += later * law.rejected[s]
                    here_armed += is_next * law.rejected[s]
        for u in range(begin, end):
            opened[u] = armed * law.alone[u] * law.opens[u]
            if _armed(tree, u) == c + 1:
                next_armed += opened[u] * law.rejected[u]
        for u in range(begin, end):
            over = u - tree.window  # that window ended just now
            if over >= earliest and _armed(tree, over) > c and u > begin:
                later = opened[over] * _later(silence, c + 1, _armed(tree, over))
                is_next = opened[over] if _armed(tree, over) == c + 1 else 0.0
                within -= later * law.more[over]
                within_armed -= is_next * law.more[over]
                here += later * law.rejected[over]
                here_armed += is_next * law.rejected[over]
            again = _armed(tree, u)
            first = armed * law.alone[u] * law.own[u]
            total = first * _later(silence, c + 1, again) + within + here
            missed[u] = min(1.0, max(0.0, total / max(SILENCE_MIN, silent)))
            total = (first if again == c + 1 else 0.0) + within_armed + here_armed
            blind[u] = min(1.0, max(0.0, total / max(SILENCE_MIN, next_armed)))
            later = opened[u] * _later(silence, c + 1, again)
            within += later * law.more[u]
            within_armed += (opened[u] if again == c + 1 else 0.0) * law.more[u]
            coming[again] += opened[u] * law.rejected[u]
        armed *= law.alone[end - 1] * (1 - law.opens[end - 1])


@njit(error_model="numpy")
def light_scale(
    signal: np.ndarray, noise: float, tree: Tree, open_share: np.ndarray, events: float, pulses: int
) -> tuple[float, float]:
    """Return the factor by which a guess of the light is to be multiplied, so that as many windows
    become events as were seen; and how far this light is to be trusted, from 0 to 1.

    signal, noise: of `unheard_in`. open_share: float32[ticks], share of the pulses whose gate is
    open. events: number of them in all pulses, in the ticks in which `signal` is not 0.
    """
    if tree.kept[1] >= 1:  # every window becomes an event
        return 1.0, 1.0
    excess = events - pulses * _events_expected(signal, 0.0, noise, tree, open_share)
    if excess <= 0:
        return 1.0, 0.0
    sure = excess * excess / events
    fits = np.empty(len(SCALES))
    for n in range(len(SCALES)):
        expected = pulses * _events_expected(signal, SCALES[n], noise, tree, open_share)
        doubt = np.log(SCALES[n]) / SCALE_SIGMA
        fits[n] = events * np.log(max(SILENCE_MIN, expected)) - expected - 0.5 * doubt * doubt
    best = min(max(1, int(np.argmax(fits))), len(SCALES) - 2)
    bend = 2 * fits[best] - fits[best - 1] - fits[best + 1]
    place = 0.0
    if bend > 0:
        place = min(1.0, max(-1.0, (fits[best + 1] - fits[best - 1]) / 2 / bend))
    step = np.log(SCALES[1] / SCALES[0])
    return SCALES[best] * np.exp(place * step), sure / (sure + SURE_EVENTS)


@njit
def _events_expected(
    signal: np.ndarray, scale: float, noise: float, tree: Tree, open_share: np.ndarray
) -> float:
    """Return the mean number of events of a pulse in the ticks in which `signal` is not 0.

    scale: by which the signal is multiplied.
    """
    ticks = len(signal)
    window = tree.window
    total = 0.0
    armed = 1.0
    coming = np.zeros(ticks // tree.phases + 3 + tree.rearm + window // tree.phases)
    for c in range(ticks // tree.phases):
        begin = c * tree.phases
        lit = False
        for t in range(begin, begin + tree.phases):
            lit |= signal[t] > 0
        if not lit:
            armed = 1.0
            coming[:] = 0.0
            continue
        armed += coming[c]
        armed = min(1.0, armed)
        photons = noise * window
        for t in range(begin, min(ticks, begin + window)):
            photons += scale * signal[t]
        for t in range(begin, begin + tree.phases):
            here = noise + scale * signal[t]
            opens = armed * (1 - math.exp(-here))
            if signal[t] > 0:
                kept = 1 - _rejected(tree, photons - 0.5 * here, 1)
                total += open_share[t] * opens * kept
            armed -= opens
            coming[_armed(tree, t)] += opens
            photons -= scale * signal[t]
            if t + window < ticks:
                photons += scale * signal[t + window]
    return total


@part
def _fill_silence(law: Without, tree: Tree, cycles: int, silence: np.ndarray) -> None:
    """Compute the chance of no event from a cycle on, if the tree is armed, over that from the next
    cycle on.
    """
    for c in range(cycles - 1, -1, -1):
        last = (c + 1) * tree.phases - 1
        share = law.alone[last] * (1 - law.opens[last])
        for s in range(c * tree.phases, last + 1):
            later = _later(silence, c + 1, _armed(tree, s))
            share += law.alone[s] * law.opens[s] * law.rejected[s] * later
        silence[c] = max(SILENCE_MIN, share)


@part
def _armed(tree: Tree, tick: int) -> int:
    """Return the cycle in which the tree is armed again after a window that opened at a tick."""
    return (tick + tree.window - 1) // tree.phases + 1 + tree.rearm


@part
def _later(silence: np.ndarray, from_cycle: int, to_cycle: int) -> float:
    """Return the chance of no event from a later cycle on, to that from an earlier one on."""
    chance = 1.0
    for c in range(from_cycle, to_cycle):
        chance /= silence[c]
    return chance


@part
def _scale(values: np.ndarray, factor: float) -> None:
    """Multiply some values by a factor."""
    for k in range(len(values)):
        values[k] *= factor


@part
def _without(signal: np.ndarray, noise: float, tree: Tree, law: Without) -> None:
    """Compute what would happen without the photon. The others are as in `unheard_in`."""
    ticks = len(signal)
    window = tree.window
    coming = 0.0  # photons of the surfaces in the window from a tick on
    lit = 0  # ticks of this window with such photons
    for t in range(min(window, ticks)):
        coming += signal[t]
        lit += signal[t] > 0
    dim_opens = 1 - math.exp(-noise)
    dim_rejected = _rejected(tree, noise * (window - 0.5), 1)
    dim_more = _rejected(tree, noise * (window - 0.5), 2)
    dim_own = _rejected(tree, noise * window, 1)
    alone = 1.0
    for t in range(ticks):
        if t % tree.phases == 0:
            alone = 1.0
        law.alone[t] = alone
        if lit == 0:
            coming = 0.0
            law.opens[t] = dim_opens
            law.rejected[t] = dim_rejected
            law.more[t] = dim_more
            law.own[t] = dim_own
        else:
            photons = coming + noise * window
            besides = photons - 0.5 * (noise + signal[t])
            law.opens[t] = 1 - math.exp(-noise - signal[t])
            law.rejected[t] = _rejected(tree, besides, 1)
            law.more[t] = _rejected(tree, besides, 2)
            law.own[t] = _rejected(tree, photons, 1)
        alone *= 1 - law.opens[t]
        coming -= signal[t]
        lit -= signal[t] > 0
        if t + window < ticks:
            coming += signal[t + window]
            lit += signal[t + window] > 0


@part
def _rejected(tree: Tree, photons: float, pixels: int) -> float:
    """Return the chance that a window of so many pixels, and so many photons more on average, is
    rejected.
    """
    chance = math.exp(-max(0.0, photons))
    total = 0.0
    more = 0
    while pixels + more < len(tree.kept) and tree.kept[pixels + more] < 1:
        total += chance * (1 - tree.kept[pixels + more])
        more += 1
        chance *= photons / more
    return total


@njit
def light_by_tick(time: np.ndarray, light: np.ndarray, pulse: np.ndarray, ticks: int) -> np.ndarray:
    """float64[ticks]: photons per tick of the surfaces of all pixels but one.

    The one has its surface there, too: its share is the mean over the pixels that do. time, light:
    float64[pixels], ticks and photons per pulse of the surfaces, NaN where they are unknown. pulse:
    float64[4 * reach + 1], share of a pulse before half ticks from its beginning to its end.
    """
    total = np.zeros(ticks)
    square = np.zeros(ticks)
    reach = len(pulse) // 4
    for i in range(len(time)):
        if np.isnan(time[i]):
            continue
        middle = int(np.floor(2 * time[i] + 0.5))  # half ticks
        for t in range(max(0, middle // 2 - reach), min(ticks, middle // 2 + reach + 1)):
            begin = 2 * t - middle + 2 * reach
            from_share = pulse[min(max(begin, 0), 4 * reach)]
            photons = light[i] * (pulse[min(max(begin + 2, 0), 4 * reach)] - from_share)
            total[t] += photons
            square[t] += photons * photons
    for t in range(ticks):
        if total[t] > 0:
            total[t] -= square[t] / total[t]
    return total
