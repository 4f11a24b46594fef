# SPDX-License-Identifier: Apache-2.0
"""Edges that a sensor cannot have are refused before an engine plays them."""

import re

import numpy as np
import pytest

from coincid.model.contract.config import parse_config
from coincid.model.contract.edges import Edges
from coincid.model.shared.errors import InputError
from coincid.tb.replay import replay, replay_together

PULSES, FRAMES, PERIOD, PIXELS = 3, 2, 40, 64
CONFIG = parse_config(
    {
        "sensor": {"rows": 8, "cols": 8},
        "frame": {"pulses": PULSES, "frames": FRAMES, "period": PERIOD},
    }
)
TOO_MUCH = {"pulse": PULSES * FRAMES, "pixel": PIXELS, "tick": CONFIG.period_ticks}


def edges_with(name, value):
    columns = {column: np.zeros(2, np.int64) for column in TOO_MUCH}
    columns[name][1] = value
    return Edges(**columns)


def by_golden(edges):
    return replay("golden", CONFIG, edges)


def side_by_side(edges):
    return replay_together([(CONFIG, edges)])


@pytest.mark.parametrize("play", [by_golden, side_by_side])
@pytest.mark.parametrize("name", TOO_MUCH)
def test_edges_out_of_range_are_refused(play, name):
    for value in (-1, TOO_MUCH[name]):
        told = re.escape(f"edges: {name}[1] = {value}: must be an integer from 0 to")
        with pytest.raises(InputError, match=told):
            play(edges_with(name, value))


@pytest.mark.parametrize("name", TOO_MUCH)
def test_the_last_of_every_range_is_played(name):
    """Pulses count through the frames."""
    assert len(by_golden(edges_with(name, TOO_MUCH[name] - 1))["fate"]) == 2


def test_offsets_are_one_for_each_edge():
    zero = np.zeros(2, np.int64)
    with pytest.raises(InputError, match="edges: offset_ps: holds .* must hold 2 numbers"):
        by_golden(Edges(zero, zero, zero, np.zeros(3)))


def test_progress_ends_with_the_cycles_of_all_frames():
    """And not with their number: bars have the cycles as their total."""
    told = []
    replay("golden", CONFIG, edges_with("tick", 0), progress=told.append)
    assert told == sorted(told)
    assert told[-1] >= FRAMES * CONFIG.frame_cycles
