# SPDX-License-Identifier: Apache-2.0
"""Frames of counts on the sliced engine beside the golden model: every beat in its cycle."""

import numpy as np
import pytest

from coincid.model.contract import counts
from coincid.model.contract.stream import decode_frame
from coincid.model.golden.frame import Golden
from coincid.tb.scoreboard import check
from coincid.tb.sliced import SlicedSensor, play_side_by_side

from .. import random_cases

SENSORS = {
    "counting": random_cases.SENSORS["counting"],
    "odd": dict(
        rows=6,
        cols=12,
        subgroup=[6, 4],
        phases=4,
        offset_phases=4,
        window_max=9,
        streams=2,
        records=0,
        controller=0,
        held=0,
        coarse_bits=8,
    ),
}


def counting(name: str, **frame) -> random_cases.Config:
    settings = {"format": "counts", "period": 60, "pulses": 30} | frame
    return random_cases.configured(SENSORS[name] | {"counts": 1}, settings)


def light(config, seed: int, per_pixel: float) -> random_cases.Edges:
    """Hits of surfaces, and background; as many per pixel and frame, some of them again and again
    in the same quarter. A fourth of the surfaces is in the last cycles that count.
    """
    rng = np.random.default_rng(seed)
    sensor = config.sensor
    n = int(per_pixel * sensor.array_pixels)
    pixel = rng.integers(0, sensor.array_pixels, n)
    surface = rng.integers(0, config.period_ticks, sensor.array_pixels)
    last = min(config.period, counts.CYCLES_MAX) * sensor.phases - 1
    late = last - rng.integers(0, counts.GATE_CYCLES * sensor.phases, sensor.array_pixels)
    surface = np.where(rng.random(sensor.array_pixels) < 0.25, late, surface)
    width = rng.choice([0, 1, sensor.phases], sensor.array_pixels)
    tick = surface[pixel] + np.round(rng.normal(size=n) * width[pixel]).astype(np.int64)
    anywhere = rng.random(n) < rng.random()
    tick = np.where(anywhere, rng.integers(0, config.period_ticks, n), tick)
    return random_cases.Edges(
        pulse=rng.integers(0, config.pulses, n),
        pixel=pixel,
        tick=np.clip(tick, 0, config.period_ticks - 1),
    )


def jobs(golden: Golden, configs, seed: int, per_pixel: float):
    kinds = random_cases.READY_KINDS
    for k, config in enumerate(configs):
        ready = random_cases.ready_pattern(seed + k, kinds[(seed + k) % len(kinds)], 2000)
        edges = light(config, seed + k, per_pixel)
        yield random_cases.predicted(golden, config, edges, ready)


@pytest.mark.parametrize("name", SENSORS)
def test_frames_of_counts(name):
    """Masks, gates, gaps, dither, links, short and long periods, few and many hits, frames of
    events in between.
    """
    chains = []
    longest = min(2 * counts.CYCLES_MAX, random_cases.built_sensor(SENSORS[name]).period_max)
    for seed in range(12):
        rng = np.random.default_rng([seed, len(name)])
        config = counting(
            name,
            period=int(rng.integers(12, longest + 1)),
            pulses=int(rng.integers(3, 120)),
            gap=int(rng.choice([0, 3, 20_000])),
            dither_bits=int(rng.choice([0, 4])),
            link_gbps=float(rng.choice([0, 2, 9.7])),
        )
        most = (config.pulses - 1) // 2
        searched = config.with_frame(search_pulses=int(rng.integers(1, most + 1)))
        masked = searched.with_settings(
            mask=rng.random((config.sensor.subgroups, config.sensor.pixels)) < 0.8,
            gating=True,
            gate_start=int(rng.integers(0, 6)),
            gate_len=int(rng.integers(1, 200)),
        )
        events = config.with_frame(format="id", pulses=3, gap=0)
        golden = Golden(config.sensor)
        per_pixel = float(rng.choice([0.5, 5, 60, 300]))
        chains.append(list(jobs(golden, (config, searched, events, masked), 10 * seed, per_pixel)))
    for chain, records in zip(chains, play_side_by_side(chains), strict=True):
        for number, (job, record) in enumerate(zip(chain, records, strict=True)):
            check(job.config.sensor, job.expected, record, number)


def test_resets_and_aborts_in_every_step():
    """An abort in the pauses, and a soft reset in them: the next frame is like a first one."""
    config = counting("counting", pulses=10, period=20)
    pauses = counts.pause_cycles(config.sensor.minigroups)
    edges = light(config, 3, 20)
    ends = [2 * 20 + 5, 2 * 20 + pauses[0] - 3, 4 * 20 + pauses[0] + 700, 2 * 20 + pauses[0] + 25]
    with SlicedSensor(config.sensor) as rtl:
        for cycle in (*ends, 30, 5 * 20 + sum(pauses)):
            for leave in (rtl.abort, rtl.soft_reset, rtl.reset):
                rtl.begin(config, edges)
                while rtl.cycle < cycle:
                    rtl.step()
                leave()
                if leave == rtl.abort:
                    record = rtl.end(lambda cycle: None)
                    frame = decode_frame(record.beats[0], config.sensor, config.sensor.subgroups)
                    begun = cycle >= 4 * 20 + sum(pauses)
                    assert (frame.counts.gate_cycle != counts.NO_GATE).any() == begun
                    assert (frame.counts.count_pulses == (2 if begun else 0)).all()
                    rtl.reset()
                golden = Golden(config.sensor)
                expected = random_cases.predicted(golden, config, edges, None).expected
                check(config.sensor, expected, rtl.frame(config, edges))
