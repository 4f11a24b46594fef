# SPDX-License-Identifier: Apache-2.0
"""Edges as levels of SPAD lines: each is in its tick, wherever in it."""

import numpy as np
import pytest

from coincid.hdl.silicon.circuit import clock_fs
from coincid.model.contract.edges import Edges
from coincid.model.contract.pixels import pixel_table, port_bits
from coincid.model.shared.errors import InputError
from coincid.tb.stimulus import (
    check_offsets,
    line_levels,
    line_toggles,
    off_centre,
    port_words,
    tick_ps,
)

from ..random_cases import SENSORS, configured

# At another clock than the usual one.
CONFIG = configured(SENSORS["tiny"], {"pulses": 3, "dither_bits": 2, "clock_mhz": 320.0})
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


def test_lines_that_change_together_are_one_level_of_their_subgroup():
    """And one level for each subgroup. A line that rises when another one falls is its own level."""
    table = pixel_table(CONFIG.sensor)
    first = np.flatnonzero(table.subgroup == 0)[:3]
    other = np.flatnonzero(table.subgroup == 1)[:1]
    pixel = np.concatenate([first, other])
    edges = Edges(pulse=np.zeros(4, int), pixel=pixel, tick=np.full(4, 7))
    times, subgroups, words = line_levels(CONFIG, edges)
    together = sum(1 << int(bit) for bit in table.inside[first])
    alone = 1 << int(table.inside[other[0]])
    assert list(zip(subgroups, words, strict=True)) == [(0, together), (1, alone), (0, 0), (1, 0)]
    assert times[0] == times[1] and times[2] == times[3] == times[0] + TICK_FS // 4


def test_a_line_falls_half_way_to_its_next_edge_at_the_latest():
    """So that it rises again. Of two edges a femtosecond apart, one is left."""
    of_one = Edges(
        pulse=np.zeros(4, int),
        pixel=np.full(4, 5),
        tick=np.array([2, 2, 2, 3]),
        offset_ps=np.array([0.100, 0.101, 0.201, 0.0]),
    )
    time_fs, _, _ = line_toggles(CONFIG, of_one)
    begin = 2 * TICK_FS
    gap_fs = TICK_FS + 1 - 201
    assert (time_fs - begin).tolist() == [
        101,
        151,
        201,
        201 + min(TICK_FS // 4, gap_fs // 2),
        TICK_FS + 1,
        TICK_FS + 1 + TICK_FS // 4,
    ]


def test_an_offset_outside_of_its_tick_is_refused():
    assert tick_ps(CONFIG) == TICK_FS / 1000
    beyond = np.array([0.0, tick_ps(CONFIG), 1.5 * tick_ps(CONFIG), 0.0, 0.0])
    edges = Edges(EDGES.pulse, EDGES.pixel, EDGES.tick, beyond)
    told = rf"^offset_ps\[2\] = {beyond[2]}: must be a number from 0 to {tick_ps(CONFIG):g}$"
    with pytest.raises(InputError, match=told):
        check_offsets(CONFIG, edges)


def test_random_places_of_edges_fill_their_ticks_and_the_seed_makes_them():
    many = Edges(*(np.zeros(1000, int) for _ in range(3)))
    moved = off_centre(CONFIG, many, 1)
    assert 0 <= moved.offset_ps.min() < 0.01 * tick_ps(CONFIG)
    assert 0.99 * tick_ps(CONFIG) < moved.offset_ps.max() <= tick_ps(CONFIG)
    assert np.array_equal(off_centre(CONFIG, many, 1).offset_ps, moved.offset_ps)
    assert not np.array_equal(off_centre(CONFIG, many, 2).offset_ps, moved.offset_ps)


def test_edges_of_a_subgroup_in_one_cycle_are_one_word():
    """Words are in the order of the subgroups, at cycles that count through the periods."""
    words = port_words(CONFIG, EDGES)
    cycle, subgroup, bit = port_bits(CONFIG, EDGES)
    assert words.keys() == set(cycle.tolist())
    for c, at in words.items():
        assert [s for s, _ in at] == sorted({int(s) for s in subgroup[cycle == c]})
        for s, word in at:
            bits = set(bit[(cycle == c) & (subgroup == s)].tolist())
            assert word == sum(1 << int(b) for b in bits)
    twice = Edges(np.zeros(3, int), np.array([5, 6, 5]), np.array([4, 5, 4]))
    ((at,),) = port_words(CONFIG, twice).values()
    assert at[1].bit_count() == 2
