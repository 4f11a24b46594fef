# SPDX-License-Identifier: Apache-2.0
"""Tables and shares from which the chance of an unheard photon follows, against plain counts."""

import numpy as np
import pytest

from coincid.model.contract.coincidence import Rise, rises
from coincid.model.depth.histograms import frame_events
from coincid.model.depth.law import RARE
from coincid.model.depth.pulse_ticks import PulseTicks
from coincid.model.depth.unheard import (
    BLIND_MAX,
    SHARES,
    _busy,
    _event_share,
    _room_found,
    _shares,
    windows_of,
)
from coincid.model.golden.frame import golden_result

from ..random_cases import SENSORS, configured, random_edges

PHASES, CYCLES, PULSES = 4, 12, 40


def test_the_windows_of_a_subgroup_are_those_that_are_in_effect():
    """Those of a subgroup without coincidence have one tick and threshold 1, whatever is set."""
    tables = [
        {"subgroups": [0], "threshold": 5, "window": 9, "coincidence": False},
        {"subgroups": [2], "threshold": 3, "window": 14},
    ]
    config = configured(SENSORS["tiny"], {"pulses": 5}, {"threshold": 2, "window": 6}, *tables)
    pulse = PulseTicks(2.0)
    events = frame_events(golden_result(config, random_edges(config, 200, 1)), config, pulse)
    found = windows_of(events, config, 5, pulse)
    assert [one.tree.window for one in found] == [1, 6, 14]
    sensor = config.sensor
    for s, (one, threshold) in enumerate(zip(found, (1, 2, 3), strict=True)):
        assert one.law == rises(sensor.rule, sensor.subgroup, threshold)
        assert (one.tree.phases, one.tree.rearm) == (sensor.phases, sensor.rearm)
        assert one.photon_rate == events.photon_rate[s]


def windows(number=60):
    """Return stamps, and the ticks at which the tree is armed again, of windows anywhere."""
    rng = np.random.default_rng(number)
    stamp = rng.integers(0, PHASES * CYCLES, number)
    return stamp, (stamp // PHASES + rng.integers(1, 4, number)) * PHASES


def test_the_tree_is_busy_until_the_next_cycle_and_ready_if_no_window_lasts_longer():
    """A window counts as busy in its last cycle; it keeps the cycles before from being ready."""
    stamp, armed = windows()
    weight = np.linspace(0.5, 1.5, PHASES * CYCLES)
    busy, ready = _busy(stamp, armed, weight, PULSES, PHASES)
    for tick in range(PHASES * CYCLES):
        at = (stamp <= tick) & (tick < armed) & (armed <= tick + PHASES)
        assert busy[tick] == pytest.approx(at.sum() / PULSES * weight[tick])
        begin = tick // PHASES * PHASES
        beyond = np.sum((stamp < begin) & (armed > begin)) / PULSES * weight[begin - 1]
        assert ready[tick] == pytest.approx(max(1 - BLIND_MAX, 1 - beyond))
    assert len(np.unique(ready)) > CYCLES / 2


@pytest.mark.parametrize(
    "law", [((2, 1.0),), ((3, 1.0),), ((6, 1.0),), ((2, 0.1), (3, 0.3), (5, 0.6))], ids=str
)
def test_the_table_of_shares_has_each_share_at_its_place(law):
    """From the first to the last: the photons at a place make so many windows events. Also by a
    rule of a user's own, which some windows of a few pixels meet, and more of many.
    """
    law = tuple(Rise(*rise) for rise in law)
    shares = _shares(law)
    for place in (5, SHARES // 2, SHARES - 5):
        share = np.exp(shares.low + place / shares.per)
        photons = -np.log(np.float64(shares.dark[place]))
        assert _event_share(law, photons) == pytest.approx(share, rel=1e-3)
    one_less = tuple(Rise(rise.pixels - 1, rise.share) for rise in law)
    photons = -np.log(np.float64(shares.dark[SHARES // 2]))
    assert shares.met[SHARES // 2] == pytest.approx(_event_share(one_less, photons), rel=1e-3)
    assert -shares.low * shares.per == pytest.approx(SHARES - 1, rel=1e-6)


def test_room_is_found_as_often_as_windows_were_dropped_before_a_cycle_and_none_came_after():
    """One gap between two events lies within a period; the other one goes past its end."""
    rate = np.array([0.3, 0.0, 0.8, 0.1, 0.5])
    cells = len(rate)
    gaps = [(1, 4), (3, 12)]
    found = np.zeros(cells)
    number = np.zeros(cells)
    for begin, end in gaps:
        windows = rate[np.arange(end) % cells]
        chance = []
        for cycle in range(begin, end):
            dropped = 1 + RARE - np.exp(-windows[begin:cycle].sum())
            chance.append(dropped * np.exp(-windows[cycle:end].sum()))
        for cycle, so_far in zip(range(begin, end), np.cumsum(chance), strict=True):
            found[cycle % cells] += so_far / sum(chance)
            number[cycle % cells] += 1
    expected = found / np.maximum(1, number)
    begin, end = np.array(gaps).T
    assert _room_found(begin.copy(), end.copy(), rate) == pytest.approx(expected)
