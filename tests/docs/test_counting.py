# SPDX-License-Identifier: Apache-2.0
"""Counts in gates, against small examples by hand, and their likelihood against a drawn frame."""

import numpy as np

from coincid.lab.outcomes import Run
from coincid.lab.setup import Setup, scene_of
from coincid.model.contract.parameters import Sensor
from coincid.model.depth.quality import wrong_share
from docs.studies.count_kernels import NO_GATE, Stops
from docs.studies.counting import Rule, coarse_histograms, count, gates_of, memory_bits, sent_bits
from docs.studies.counts import Way, counted_depth_m

SENSOR = Sensor(rows=8, cols=8)
PERIOD_TICKS = 1024
RULE = Rule(
    coarse_ticks=64,
    bins=4,
    bin_ticks=8,
    count_bits=2,
    event_ticks=8,
    event_bits=2,
    event_minigroups=1,
)


def stops(rows):
    """Return events of subgroup 0 from (pulse, stamp, pixels)."""
    maps = [sum(1 << pixel for pixel in pixels) for _, _, pixels in rows]
    return Stops(
        bounds=np.array([0, len(rows)]),
        pulse=np.array([pulse for pulse, _, _ in rows]),
        stamp=np.array([stamp for _, stamp, _ in rows]),
        hits=np.array(maps, np.uint64)[:, None],
    )


def test_first_pass_counts_hits_of_its_pulses_by_minigroup():
    seen = stops([(0, 70, [0, 1, 8]), (1, 130, [2]), (2, 70, [0])])
    coarse = coarse_histograms(seen, SENSOR, RULE, 2, PERIOD_TICKS)
    assert coarse[0, 0, 1] == 3
    assert coarse[0, 1, 2] == 1
    assert coarse.sum() == 4


def test_minigroup_stops_when_a_coarse_bin_is_full():
    seen = stops([(0, 70, [0])] * 20 + [(1, 200, [0])])
    coarse = coarse_histograms(seen, SENSOR, RULE, 2, PERIOD_TICKS)
    assert coarse[0, 0, 1] == 15
    assert coarse[0, 0, 3] == 0


def test_gates_are_around_the_highest_pairs_and_do_not_overlap():
    coarse = np.zeros((1, SENSOR.minigroups, 16), np.int64)
    coarse[0, 0, 3] = 6
    coarse[0, 0, 4] = 6
    coarse[0, 0, 10] = 5
    coarse[0, 1, 2] = 1
    start = gates_of(coarse, RULE)
    first = start[0, 0, 0]
    second = start[0, 0, 1]
    assert first == 4 * 64 - RULE.gate_ticks // 2
    assert first % RULE.bin_ticks == 0
    assert second >= first + RULE.gate_ticks or second + RULE.gate_ticks <= first
    assert start[0, 1, 1] == NO_GATE
    assert np.all(start[0, 2] == NO_GATE)


def test_pixel_counts_by_the_stamp_and_stops_when_full():
    start = np.full((1, SENSOR.minigroups, 2), NO_GATE)
    start[0, 0] = (64, 320)
    seen = stops(
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
    counts = count(seen, start, SENSOR, RULE, range(6, 12))
    assert counts.hits[0, 0].tolist() == [[0, 3, 0, 0], [1, 0, 0, 0]]
    assert counts.hits[0, 1].tolist() == [[0, 1, 0, 0], [0, 0, 0, 0]]
    assert counts.pulses[0, 0] == 3
    assert counts.pulses[0, 1] == 6
    assert counts.hits[0, 2].sum() == 0
    assert counts.events[0, 0].tolist() == [[0, 3, 0, 0], [1, 0, 0, 0]]
    assert counts.event_pulses[0, 0] == 3


def test_bits_of_the_rule_are_those_of_its_fields():
    rule = Rule()
    of_pixel = 2 * 14 * 4 + 10
    of_minigroup = 4 * of_pixel + (2 * 28 * 6 + 10) / 4 + 2 * 10
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
    assert wrong_share(counted_depth_m(run, Way(Rule())), distance_m) < 0.02
