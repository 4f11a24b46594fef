# SPDX-License-Identifier: Apache-2.0
"""Edges as levels of SPAD lines: each is in its tick, wherever in it."""

import numpy as np
import pytest

from coincid.hdl.silicon.circuit import clock_fs
from coincid.model.contract.edges import Edges
from coincid.model.contract.pixels import pixel_table
from coincid.tb.stimulus import check_offsets, line_levels, line_toggles, tick_ps

from ..random_cases import SENSORS, configured

CONFIG = configured(SENSORS["tiny"], {"pulses": 3, "dither_bits": 2})
TICK_FS = clock_fs(CONFIG.clock_mhz) // CONFIG.sensor.phases
EDGES = Edges(
    pulse=np.array([0, 0, 1, 2, 2]),
    pixel=np.array([5, 47, 5, 0, 16]),
    tick=np.array([0, 9, CONFIG.period_ticks - 1, 3, 3]),
)


@pytest.mark.parametrize("share", (None, 0.0, 0.3, 1.0))
def test_a_line_rises_in_the_tick_of_its_edge(share):
    offset = None if share is None else np.full(len(EDGES), share * tick_ps(CONFIG))
    edges = Edges(EDGES.pulse, EDGES.pixel, EDGES.tick, offset)
    check_offsets(CONFIG, edges)
    time_fs, subgroup, line = line_toggles(CONFIG, edges)
    assert np.all(np.diff(time_fs) >= 0) and len(time_fs) == 2 * len(edges)
    table = pixel_table(CONFIG.sensor)
    begin = CONFIG.start_cycles()[EDGES.pulse] * CONFIG.sensor.phases + EDGES.tick
    for pixel, tick in zip(EDGES.pixel, begin, strict=True):
        own = (subgroup == table.subgroup[pixel]) & (line == table.inside[pixel])
        rises = time_fs[own][::2]
        inside = (rises > tick * TICK_FS) & (rises < (tick + 1) * TICK_FS)
        assert inside.sum() == 1, (pixel, tick)


def test_levels_have_one_bit_for_each_line_that_is_high():
    times, subgroups, words = line_levels(CONFIG, EDGES)
    assert times == sorted(times) and len(words) == 2 * len(EDGES)
    assert [word.bit_count() for word in words].count(0) == len(EDGES)
    table = pixel_table(CONFIG.sensor)
    high = {(s, word) for s, word in zip(subgroups, words, strict=True) if word}
    of_edges = zip(table.subgroup[EDGES.pixel], table.inside[EDGES.pixel], strict=True)
    assert high == {(int(s), 1 << int(bit)) for s, bit in of_edges}
