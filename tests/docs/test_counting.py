# SPDX-License-Identifier: Apache-2.0
"""Counts in gates, against small examples by hand, and their likelihood against a drawn frame."""

import numpy as np

from coincid.lab.outcomes import Run
from coincid.lab.setup import Setup, scene_of
from coincid.model.contract.edges import Edges
from coincid.model.contract.parameters import Sensor
from coincid.model.depth.quality import wrong_share
from docs.studies.count_kernels import NO_GATE, Hits
from docs.studies.counting import (
    Rule,
    count,
    find_gates,
    gates_of,
    histograms,
    hits_of,
    memory_bits,
    of_neighbours,
    regions_of,
    sent_bits,
)
from docs.studies.counts import Way, find

SENSOR = Sensor(rows=8, cols=8)
PERIOD_TICKS = 1024
RULE = Rule(
    wide_ticks=128,
    wide_bits=4,
    regions=2,
    narrow_ticks=64,
    narrow_bits=4,
    peak_bins=2,
    bins=4,
    bin_ticks=8,
    count_bits=2,
)


def hits(rows):
    """Return hits of subgroup 0 from (pulse, tick, pixels)."""
    each = [(pulse, tick, pixel) for pulse, tick, pixels in rows for pixel in pixels]
    pulse, tick, pixel = np.array(each).T
    return Hits(np.array([0, len(each)]), pulse, tick, pixel)


def histogram(seen, pulses, watched=None):
    """Return the histogram of subgroup 0 in bins of 64 ticks of 4 bits."""
    if watched is None:
        watched = np.ones((1, SENSOR.minigroups, PERIOD_TICKS // 64), np.bool_)
    return histograms(seen, SENSOR, pulses, 64, 4, watched)[0]


def test_histogram_counts_hits_of_its_pulses_by_minigroup():
    seen = hits([(0, 70, [0, 1, 8]), (1, 130, [2]), (2, 70, [0])])
    counted = histogram(seen, range(2))
    assert counted[0, 1] == 3
    assert counted[1, 2] == 1
    assert counted.sum() == 4
    assert histogram(seen, range(2, 3)).sum() == 1


def test_minigroup_stops_when_a_bin_is_full():
    seen = hits([(0, 70, [0])] * 20 + [(1, 200, [0])])
    counted = histogram(seen, range(2))
    assert counted[0, 1] == 15
    assert counted[0, 3] == 0


def test_bins_that_a_minigroup_does_not_watch_stay_empty_and_stop_nothing():
    watched = np.ones((1, SENSOR.minigroups, PERIOD_TICKS // 64), np.bool_)
    watched[0, 0, 1] = False
    seen = hits([(0, 70, [0, 2])] * 20 + [(1, 200, [0])])
    counted = histogram(seen, range(2), watched)
    assert counted[0, 1] == 0
    assert counted[0, 3] == 1
    assert counted[1, 1] == 15


def test_neighbours_of_a_minigroup_are_beside_it_also_in_other_subgroups():
    sensor = Sensor(rows=8, cols=16)
    histogram = np.zeros((2, sensor.minigroups, 1), np.int64)
    histogram[0, 3] = 1  # at the upper right of the left subgroup
    around = of_neighbours(histogram, sensor)[:, :, 0]
    assert sorted(zip(*np.nonzero(around), strict=True)) == [(0, 2), (0, 7), (1, 0)]
    assert around.max() == 1


def test_highest_wide_bins_are_divided_the_first_of_equal_ones():
    wide = np.array([[[0, 2, 5, 2, 1]]])
    assert regions_of(wide, RULE)[0, 0].tolist() == [False, True, True, False, False]


def test_gate_lies_where_narrow_bins_of_the_highest_wide_bin_have_hits():
    wide = [(0, 300, [0]), (1, 310, [0]), (2, 700, [0])]
    narrow = [(5, 340, [0]), (6, 900, [0]), (7, 900, [0])]
    rule = RULE._replace(regions=1, wide_share=0.5, narrow_share=0.4)
    start = find_gates(hits(wide + narrow), SENSOR, rule, 10, PERIOD_TICKS)
    assert start[0, 0, 0] == 352 - rule.gate_ticks // 2
    assert start[0, 0, 1] == NO_GATE


def test_gates_are_around_the_highest_pairs_and_do_not_overlap():
    narrow = np.zeros((1, SENSOR.minigroups, 16), np.int64)
    narrow[0, 0, 3] = 6
    narrow[0, 0, 4] = 6
    narrow[0, 0, 10] = 5
    narrow[0, 1, 2] = 1
    start = gates_of(narrow, RULE)
    first = start[0, 0, 0]
    second = start[0, 0, 1]
    assert first == 4 * 64 - RULE.gate_ticks // 2
    assert first % RULE.bin_ticks == 0
    assert second >= first + RULE.gate_ticks or second + RULE.gate_ticks <= first
    assert start[0, 1, 1] == NO_GATE
    assert np.all(start[0, 2] == NO_GATE)


def test_hit_has_the_time_of_its_own_first_edge_in_a_window():
    edges = Edges(
        pulse=np.array([0, 0, 0, 0, 1]),
        pixel=np.array([3, 9, 9, 12, 5]),
        tick=np.array([100, 120, 125, 140, 64]),
    )
    setup = Setup.of(None, sensor={"rows": 8, "cols": 8}, frame={"pulses": 2}).but(edges=edges)
    own = hits_of(Run(setup), Rule())
    assert own.pulse.tolist() == [0, 0, 1]
    assert own.tick.tolist() == [100, 120, 64]
    assert own.pixel.tolist() == [3, 9, 5]


def test_pixel_counts_in_its_gates_and_stops_when_full():
    start = np.full((1, SENSOR.minigroups, 2), NO_GATE)
    start[0, 0] = (64, 320)
    own = hits(
        [
            (5, 64, [0, 2]),
            (6, 79, [0, 1]),
            (6, 321, [0]),
            (7, 79, [0]),
            (8, 79, [0]),
            (9, 64, [0]),
            (9, 96, [1]),
        ]
    )
    counts = count(own, start, SENSOR, RULE, range(6, 12))
    assert counts.hits[0, 0].tolist() == [[0, 3, 0, 0], [1, 0, 0, 0]]
    assert counts.hits[0, 1].tolist() == [[0, 1, 0, 0], [0, 0, 0, 0]]
    assert counts.pulses[0, 0] == 3
    assert counts.pulses[0, 1] == 6
    assert counts.hits[0, 2].sum() == 0


def test_bits_of_the_rule_are_those_of_its_fields():
    rule = Rule()
    of_pixel = 2 * 16 * 4 + 10
    of_minigroup = 4 * of_pixel + 2 * 10
    assert sent_bits(rule, Sensor(), 1000, 8000) == of_minigroup
    assert memory_bits(rule, Sensor(), 1000, 8000) == of_minigroup / 4 <= 150


def test_counts_find_a_wall_behind_a_bright_box():
    distance_m = np.full((16, 16), 6.0)
    distance_m[4:11, 4:11] = 4.0
    setup = Setup.of(
        None,
        sensor={"rows": 16, "cols": 16},
        frame={"pulses": 200, "link_gbps": 0},
        subgroup={"threshold": 1},
        klux=10.0,
    )
    run = Run(setup.but(scene=scene_of(setup.config, distance_m)), workers=1)
    assert wrong_share(find(run, Way(Rule())).depth_m, distance_m) < 0.02
