# SPDX-License-Identifier: Apache-2.0
"""Histograms, hits and rates of results that are written by hand."""

import numpy as np
import pytest

from coincid.model.contract.counters import COUNTER_NAMES
from coincid.model.depth.arrivals import photons_of
from coincid.model.depth.count_light import LEAST_RATE, fit_lights
from coincid.model.depth.count_likelihood import Seen
from coincid.model.depth.histograms import frame_events, hits_away, pixel_histogram
from coincid.model.depth.planes import ACTIVITY_HITS, background_activity
from coincid.model.depth.pulse_ticks import PulseTicks, pulse_ticks
from coincid.model.shared.errors import InputError

from ..random_cases import configured

PULSES = 10
PULSE = PulseTicks(3.0)


def written(config, **columns):
    """Return a result without events and records except these columns."""
    frames, subgroups = config.frames, config.sensor.subgroups
    arrays = {name: np.zeros((frames, subgroups), np.int64) for name in COUNTER_NAMES}
    names = "pulse", "subgroup", "stamp", "count", "winner"
    arrays |= {name: np.zeros(0, np.int64) for name in names}
    arrays["overrun"] = np.zeros(0, bool)
    arrays["hits"] = np.zeros((0, 1), np.uint64)
    return arrays | columns


def with_records(minigroup, frames=1):
    sensor = {"rows": 8, "cols": 16, "minigroup": minigroup}
    frame = {"pulses": PULSES, "frames": frames, "minigroup_records": True}
    return configured(sensor, frame)


def records(config, *rows):
    """Return the columns of records: pulse, subgroup, minigroup, quarter and pixels of each."""
    number = len(rows), config.sensor.minigroups
    stamp, maps = np.zeros(number, np.uint16), np.zeros(number, np.uint16)
    for k, (_, _, minigroup, quarter, pixels) in enumerate(rows):
        stamp[k, minigroup] = quarter
        maps[k, minigroup] = sum(1 << pixel for pixel in pixels)
    pulse, subgroup = (np.array([row[k] for row in rows]) for k in (0, 1))
    return {"mg_pulse": pulse, "mg_subgroup": subgroup, "mg_stamp": stamp, "mg_map": maps}


def first_tick(histogram):
    (found,) = np.flatnonzero(histogram)
    assert histogram[found] == 1
    return found


@pytest.mark.parametrize("minigroup", [[2, 2], [4, 4]])
def test_a_record_is_moved_later_by_the_lead_of_all_pixels_that_fired(minigroup):
    config = with_records(minigroup)
    last = config.sensor.minigroup_pixels - 1
    middle_ticks = config.sensor.quarter_ticks * 40.5
    for fired in ([last], range(last + 1)):
        arrays = written(config, **records(config, (3, 1, 1, 40, fired)))
        pixel = config.sensor.members(1)[last]
        at = pixel // 8 * 16 + 8 + pixel % 8  # in the second subgroup
        photons = max(1.0, photons_of(len(fired), last + 1))
        expected = middle_ticks + pulse_ticks(config).lead(np.array(photons))
        found = pixel_histogram(arrays, config, at, source="minigroup")
        assert first_tick(found) == int(expected)
        everywhere = [
            pixel_histogram(arrays, config, k, source="minigroup").sum() for k in range(128)
        ]
        assert sum(everywhere) == len(fired)


def test_a_frame_has_the_records_of_its_own_pulses():
    config = with_records([2, 2], frames=3)
    rows = [(pulse, 0, 0, 20 + pulse // PULSES, [0]) for pulse in (0, 9, 10, 20, 21, 29)]
    arrays = written(config, **records(config, *rows))
    numbers = [
        pixel_histogram(arrays, config, 0, source="minigroup", frame=frame).sum()
        for frame in (0, 1, 2, None)
    ]
    assert numbers == [2, 1, 3, 6]
    with pytest.raises(InputError, match="frame = 3: must be an integer from 0 to 2"):
        pixel_histogram(arrays, config, 0, source="minigroup", frame=3)


def test_every_pixel_of_the_array_has_a_histogram_and_no_other():
    config = with_records([2, 2])
    arrays = written(config, **records(config, (0, 1, 15, 20, [3])))
    assert config.sensor.array_pixels == 128
    assert pixel_histogram(arrays, config, 127, source="minigroup").sum() == 1
    assert pixel_histogram(arrays, config, 0, source="minigroup").sum() == 0
    for pixel in (-1, 128):
        with pytest.raises(
            InputError, match=f"^pixel = {pixel}: must be an integer from 0 to 127$"
        ):
            pixel_histogram(arrays, config, pixel, source="minigroup")


@pytest.mark.parametrize("rearm", [0, 3])
@pytest.mark.parametrize("frames, frame", [(1, None), (2, None), (2, 1)])
def test_the_rate_of_photons_is_that_of_the_ticks_in_which_the_tree_is_armed(rearm, frames, frame):
    """A window and the wait for the next cycle, half a cycle on average, and the re-arm gap block
    it.
    """
    config = configured(
        {"rows": 8, "cols": 16, "rearm": rearm},
        {"pulses": PULSES, "frames": frames, "period": 100},
        {"window": 20},
    )
    arrays = written(config)
    opened = np.array([30, 80])
    arrays["opened"] += opened
    sensor = config.sensor
    blocked = 20 + (sensor.phases - 1) / 2 + rearm * sensor.phases
    armed = (100 - sensor.guard) * sensor.phases - opened / PULSES * blocked
    events = frame_events(arrays, config, PULSE, frame)
    np.testing.assert_allclose(events.photon_rate, opened / PULSES / armed)
    of_frames = 1 if frame is not None else frames
    assert events.opened.tolist() == (of_frames * opened).tolist()


def test_hits_away_are_those_at_least_so_many_ticks_from_the_pixels_time():
    stamp = np.array([90, 97, 103, 110, 100])
    hits = np.array([[0b11], [0b01], [0b11], [0b10], [0b11]], np.uint64)
    time = np.array([[100.0, 100.0], [np.nan, 100.0]])
    bounds = np.array([0, 4, 5])
    found = hits_away(stamp, hits, bounds, time, np.full(len(time), 5.0))
    assert found.tolist() == [[1, 2], [1, 0]]


def test_a_hot_pixel_is_one_with_many_hits_away_from_its_surface():
    """More than three sigmas away; a pixel with half of them is not hot. Masked ones do not count."""
    config = with_records([2, 2])
    near, hot, half, masked = 0, 1, 2, 3
    rows = [(100 - 8, near)] * 90 + [(100 + 13, hot)] * 90 + [(500, half)] * 12
    number = len(rows)
    arrays = written(
        config,
        pulse=np.zeros(number, np.int64),
        subgroup=np.zeros(number, np.int64),
        stamp=np.array([stamp for stamp, _ in rows]),
        count=np.ones(number, np.int64),
        winner=np.array([pixel for _, pixel in rows]),
        overrun=np.zeros(number, bool),
        hits=np.array([[1 << pixel] for _, pixel in rows], np.uint64),
    )
    events = frame_events(arrays, config, PULSE)
    mask = config.mask.copy()
    mask[0, masked:] = False
    found = background_activity(events, mask, np.full(mask.shape, 100.0), 4.0)
    mean = (90 + 12) / 3
    assert found[0, hot] == pytest.approx((90 + ACTIVITY_HITS) / (mean + ACTIVITY_HITS))
    assert np.all(np.delete(found.ravel(), hot) == 1)


@pytest.mark.parametrize("background", [0.0, 0.002])
@pytest.mark.parametrize("light", [0.1, 0.8, 3.0])
def test_the_light_of_counts_as_they_are_expected_is_found(light, background):
    """Hits by light and background, of a million pulses."""
    share = np.array([0.0, 0.2, 0.5, 0.3]).reshape(1, 1, 1, 4)
    width, pulses = 8, 1_000_000
    chance = 1 - np.exp(-light * share) + background * width * np.exp(-light * share)
    hits = np.round(pulses * chance).astype(np.int64)
    seen = Seen(
        first=np.zeros((1, 1, 1), np.int64),
        hits=hits,
        misses=pulses - hits.astype(np.float64),
        background=np.full((1, 1), max(background, LEAST_RATE)),
        width=width,
    )
    found, error = fit_lights(seen, share)
    assert found[0, 0] == pytest.approx(light, rel=0.02)
    assert 0 < error[0, 0] < 0.02
