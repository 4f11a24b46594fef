# SPDX-License-Identifier: Apache-2.0
"""Counts in gates, against small examples by hand and a second implementation of the rule, and
their likelihood against a drawn frame.
"""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from coincid.lab.outcomes import Run
from coincid.lab.setup import Setup, scene_of
from coincid.model.contract.counts import NO_GATE as NO_CYCLE
from coincid.model.contract.edges import Edges
from coincid.model.contract.parameters import QUARTERS, Sensor
from coincid.model.depth.quality import wrong_share
from docs.studies.count_kernels import NO_GATE, Hits
from docs.studies.counting import (
    Beside,
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
from docs.studies.counts import Way, find, find_built, in_counts

from ..golden import counts_in_rows

SENSOR = Sensor(rows=8, cols=8)
PERIOD_CYCLES = 32
RULE = Rule(wide_bits=4, regions=2, narrow_bits=4, count_bits=2)
NARROW_BINS = 64


def hits(rows):
    """Return hits of subgroup 0 from (pulse, quarter, pixels)."""
    each = [(pulse, quarter, pixel) for pulse, quarter, pixels in rows for pixel in pixels]
    pulse, quarter, pixel = np.array(each).T
    return Hits(np.array([0, len(each)]), pulse, quarter, pixel)


def histogram(seen, pulses, watched=None):
    """Return the histogram of subgroup 0 in bins of 8 quarters of 4 bits."""
    if watched is None:
        watched = np.ones((1, SENSOR.minigroups, 16), np.bool_)
    return histograms(seen, SENSOR, pulses, 8, 4, watched)[0]


def test_histogram_counts_hits_of_its_pulses_by_minigroup():
    seen = hits([(0, 8, [0, 1, 8]), (1, 16, [2]), (2, 8, [0])])
    counted = histogram(seen, range(2))
    assert counted[0, 1] == 3
    assert counted[1, 2] == 1
    assert counted.sum() == 4
    assert histogram(seen, range(2, 3)).sum() == 1


def test_minigroup_stops_after_the_cycle_in_which_a_bin_is_full():
    one_by_one = [(pulse, 8, [0]) for pulse in range(14)]
    last = [(14, 9, [0]), (14, 10, [1, 8]), (14, 12, [9]), (14, 40, [0]), (15, 40, [0])]
    counted = histogram(hits(one_by_one + last), range(16))
    assert counted[0, 1] == 15
    assert counted.sum() == 15


def test_both_narrow_bins_of_the_cycle_that_fills_one_count():
    one_by_one = [(pulse, 8, [0]) for pulse in range(14)]
    last = [(14, 9, [0]), (14, 10, [1, 8]), (14, 12, [9])]
    watched = np.ones((1, SENSOR.minigroups, NARROW_BINS), np.bool_)
    counted = histograms(hits(one_by_one + last), SENSOR, range(16), 2, 4, watched)[0]
    assert counted[0, 4] == 15
    assert counted[0, 5] == 2
    assert counted.sum() == 17


def test_bins_that_a_minigroup_does_not_watch_stay_empty_and_stop_nothing():
    watched = np.ones((1, SENSOR.minigroups, 16), np.bool_)
    watched[0, 0, 1] = False
    seen = hits([(pulse, 8, [0, 2]) for pulse in range(20)] + [(20, 24, [0])])
    counted = histogram(seen, range(21), watched)
    assert counted[0, 1] == 0
    assert counted[0, 3] == 1
    assert counted[1, 1] == 15


def test_neighbours_are_beside_a_minigroup_in_its_subgroup_or_also_in_others():
    sensor = Sensor(rows=8, cols=16)
    histogram = np.zeros((2, sensor.minigroups, 1), np.int64)
    histogram[0, 3] = 1  # at the upper right of the left subgroup
    around = of_neighbours(histogram, sensor, Beside.SUBGROUP)[:, :, 0]
    assert sorted(zip(*np.nonzero(around), strict=True)) == [(0, 2), (0, 7)]
    assert around.max() == 1
    around = of_neighbours(histogram, sensor, Beside.ALL)[:, :, 0]
    assert sorted(zip(*np.nonzero(around), strict=True)) == [(0, 2), (0, 7), (1, 0)]
    assert around.max() == 1


def test_highest_wide_bins_are_divided_the_first_of_equal_ones():
    wide = np.array([[[0, 2, 5, 2, 1]]])
    assert regions_of(wide, RULE)[0, 0].tolist() == [False, True, True, False, False]


def test_gate_lies_where_narrow_bins_of_the_highest_wide_bin_have_hits():
    wide = [(0, 37, [0]), (1, 38, [0])]
    narrow = [(2, 42, [0]), (3, 112, [0])]
    start = find_gates(hits(wide + narrow), SENSOR, RULE._replace(regions=1), 10, PERIOD_CYCLES)
    assert start[0, 0, 0] == 36  # the middle of cycles 9 to 12 is the closest one to quarter 43
    assert start[0, 0, 1] == NO_GATE


def test_gates_are_around_the_highest_peaks_and_do_not_overlap():
    narrow = np.zeros((1, SENSOR.minigroups, NARROW_BINS), np.int64)
    narrow[0, 0, 11] = 6
    narrow[0, 0, 12] = 6
    narrow[0, 0, 17] = 5
    narrow[0, 1, 8] = 1
    start = gates_of(narrow, RULE, QUARTERS * PERIOD_CYCLES)
    assert start[0, 0].tolist() == [16, 32]
    assert start[0, 1, 1] == NO_GATE
    assert np.all(start[0, 2] == NO_GATE)


def test_gates_end_within_the_period():
    narrow = np.zeros((1, SENSOR.minigroups, NARROW_BINS), np.int64)
    narrow[0, 0, 63] = 6
    narrow[0, 1, 0] = 6
    narrow[0, 2, [55, 63]] = (6, 5)
    start = gates_of(narrow, RULE, QUARTERS * PERIOD_CYCLES)
    assert start[0, 0, 0] == 28 * QUARTERS
    assert start[0, 1, 0] == 0
    assert start[0, 2].tolist() == [26 * QUARTERS, NO_GATE]


def test_hit_is_the_first_edge_of_a_pixel_in_a_cycle():
    edges = Edges(
        pulse=np.array([0, 0, 0, 0, 1]),
        pixel=np.array([3, 9, 9, 9, 9]),
        tick=np.array([100, 127, 120, 128, 120]),
    )
    own = hits_of(edges, SENSOR)
    assert own.pulse.tolist() == [0, 0, 0, 1]
    assert own.quarter.tolist() == [12, 15, 16, 15]
    assert own.pixel.tolist() == [3, 9, 9, 9]


def test_pixel_counts_in_its_gates_and_stops_when_full():
    start = np.full((1, SENSOR.minigroups, 2), NO_GATE)
    start[0, 0] = (8, 40)
    own = hits(
        [
            (5, 8, [0, 2]),
            (6, 9, [0, 1]),
            (6, 40, [0]),
            (7, 9, [0]),
            (8, 9, [0]),
            (9, 8, [0]),
            (9, 24, [1]),
        ]
    )
    counts = count(own, start, SENSOR, RULE, range(6, 12))
    assert counts.hits[0, 0, :, :2].tolist() == [[0, 3], [1, 0]]
    assert counts.hits[0, 0].sum() == 4
    assert counts.hits[0, 1, 0, 1] == counts.hits[0, 1].sum() == 1
    assert counts.pulses[0, 0] == 3
    assert counts.pulses[0, 1] == 6
    assert counts.hits[0, 2].sum() == 0


@st.composite
def cases(draw):
    """Return edges of a subgroup, half of them in a narrow return, and what counts them."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    sensor = Sensor(rows=8, cols=8, phases=draw(st.sampled_from((4, 8, 32, 64))), offset_phases=4)
    period_cycles = draw(st.integers(5, 40))
    pulses = draw(st.integers(5, 40))
    number = pulses * draw(st.integers(1, 60))
    ticks = sensor.phases * period_cycles
    even = rng.random(number)
    narrow = np.clip(rng.normal(rng.random(), 2 / period_cycles, number), 0, 0.999999)
    edges = Edges(
        pulse=rng.integers(0, pulses, number),
        pixel=rng.integers(0, sensor.pixels, number),
        tick=np.floor(ticks * np.where(rng.random(number) < 0.5, even, narrow)).astype(np.int64),
    )
    rule = Rule(
        wide_bits=draw(st.integers(2, 8)),
        regions=draw(st.integers(1, 10)),
        narrow_bits=draw(st.integers(2, 6)),
        count_bits=draw(st.integers(1, 4)),
    )
    return edges, sensor, rule, pulses, period_cycles


@given(cases())
@settings(max_examples=25)
def test_kernels_count_what_rows_of_memory_count(case):
    edges, sensor, rule, pulses, period_cycles = case
    seen = hits_of(edges, sensor)
    start = find_gates(seen, sensor, rule, pulses, period_cycles)
    counts = count(seen, start, sensor, rule, range(rule.first_pulses(pulses), pulses))
    own = zip(edges.pulse.tolist(), edges.pixel.tolist(), edges.tick.tolist(), strict=True)
    frame = counts_in_rows.Frame(sensor.subgroup, period_cycles, rule.wide_pulses(pulses), pulses)
    limits = counts_in_rows.Limits(rule.regions, rule.wide_bits, rule.narrow_bits, rule.count_bits)
    of_cycles = counts_in_rows.hits_of(own, sensor.phases)
    groups = counts_in_rows.counted_in_rows(of_cycles, frame, limits)
    expected = counts_in_rows.read_rows(groups, frame)
    gate_cycle = np.where(start[0] == NO_GATE, counts_in_rows.NO_GATE, start[0] // QUARTERS)
    assert gate_cycle.tolist() == expected.gate_cycle.tolist()
    assert np.array_equal(counts.hits[0], expected.gate_hits)
    assert counts.pulses[0].tolist() == expected.count_pulses.tolist()


def test_bits_of_the_rule_are_those_of_its_fields():
    rule = Rule()
    of_pixel = 2 * 16 * 4 + 10
    of_minigroup = 4 * of_pixel + 2 * 8
    assert sent_bits(rule, Sensor(), 1000, 250) == of_minigroup
    assert memory_bits(rule, Sensor(), 1000, 250) == of_minigroup / 4 <= 150


@pytest.mark.parametrize(("scene", "klux"), [("five-objects", 100.0), ("sun-and-shade", 20.0)])
def test_the_rule_is_that_of_the_golden_model(scene, klux):
    setup = in_counts(
        Setup.of(
            scene,
            sensor={"rows": 16, "cols": 16},
            frame={"pulses": 300, "link_gbps": 0},
            klux=klux,
        )
    )
    run = Run(setup)
    config = run.config
    rule = Rule()
    seen = hits_of(run.edges, config.sensor)
    start = find_gates(seen, config.sensor, rule, config.pulses, config.period)
    counted = range(rule.first_pulses(config.pulses), config.pulses)
    counts = count(seen, start, config.sensor, rule, counted)
    result = run.result
    cycle = np.where(start == NO_GATE, NO_CYCLE, start // QUARTERS)
    assert np.array_equal(cycle, result["gate_cycle"][0])
    assert np.array_equal(counts.hits, result["gate_hits"][0])
    assert np.array_equal(counts.pulses, result["count_pulses"][0])
    depth_m = find(run, Way(rule)).depth_m
    assert np.array_equal(depth_m, find_built(run).depth_m, equal_nan=True)


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
