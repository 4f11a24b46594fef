# SPDX-License-Identifier: Apache-2.0
"""Depth from the format `counts`: walls, light, background and confidence, and frames that are not
as usual.
"""

import numpy as np
import pytest
from attrs import frozen

from coincid.lab.outcomes import Run
from coincid.lab.setup import Setup
from coincid.model.contract.config import parse_config
from coincid.model.contract.counts import COUNT_MOST, GATE_CYCLES, GATES, NO_GATE
from coincid.model.contract.pixels import pixel_table
from coincid.model.contract.result import ResultBuilder
from coincid.model.depth.belief import LAW, Reason, signs_of
from coincid.model.depth.count_light import Trials, first_background
from coincid.model.depth.count_likelihood import Seen
from coincid.model.depth.counts import (
    _without_last_hits,
    count_signs,
    find_surfaces,
    gate_counts,
    seen_behind,
)
from coincid.model.depth.depth import Depth
from coincid.model.depth.estimate import estimate_depth
from coincid.model.depth.histograms import by_subgroup, pixel_histogram, pixel_image
from coincid.model.depth.pulse_ticks import pulse_ticks
from coincid.model.depth.quality import TOLERANCE_M
from coincid.model.golden.frame import Golden
from coincid.model.scenes.catalogue import load_scene
from coincid.model.shared.constants import SUCCESS_TOLERANCE_S
from coincid.model.shared.errors import InputError
from coincid.model.shared.threads import Threads

from .equal import assert_equal_depths

SIDE = 16


def counted(scene, klux=20.0, *, side=SIDE, frame=None, subgroup=None, sensor=None, **fields):
    """Return the run of a scene in the format counts."""
    setup = Setup.of(
        scene,
        klux=klux,
        sensor={"rows": side, "cols": side, "counts": 1} | (sensor or {}),
        frame={"pulses": 500, "format": "counts", "link_gbps": 0} | (frame or {}),
        subgroup=subgroup,
        **fields,
    )
    return Run(setup, workers=2)


def off_m(run, **options):
    """Return by how much each pixel is off, in metres."""
    return run.depth(**options).depth_m[:, :, 0] - run.scene.truth_m


@pytest.mark.parametrize(
    ("distance_m", "reflectivity", "klux"),
    [(1.5, 0.2, 10), (3.0, 0.8, 100), (6.0, 0.4, 50), (9.0, 0.5, 0), (14.0, 0.4, 20)],
)
def test_a_wall_has_no_bias_at_any_distance_and_light(distance_m, reflectivity, klux):
    means_m = []
    for seed in range(1, 5):
        off = off_m(counted(f"flat:{distance_m},{reflectivity}", klux, seed=seed))
        assert np.mean(np.abs(off) > TOLERANCE_M) < 0.02
        means_m.append(np.mean(off[np.abs(off) < TOLERANCE_M]))
    assert abs(np.mean(means_m)) < 0.002, means_m


def test_standard_errors_cover_the_errors_of_a_wall():
    scaled = []
    for seed in range(1, 7):
        run = counted("flat:8,0.3", 50.0, seed=seed)
        depth = run.depth()
        scaled.append((depth.depth_m - run.scene.truth_m[:, :, None]) / depth.error_m)
    inside = np.mean(np.abs(scaled) < 2)
    assert 0.85 < inside, inside


def test_confidence_falls_with_the_share_of_right_pixels_where_light_is_scarce():
    sure = []
    right = []
    for seed in range(1, 7):
        run = counted("flat:30,0.3", 50.0, frame={"pulses": 250}, seed=seed)
        depth = run.depth()
        sure.append(depth.confidence[:, :, 0].mean())
        off = np.abs(depth.depth_m[:, :, 0] - run.scene.truth_m)
        right.append(np.mean(off < TOLERANCE_M))
    assert 0.2 < np.mean(right) < 0.98  # neither easy nor hopeless
    assert -0.3 < np.mean(sure) - np.mean(right) < 0.1, (sure, right)
    nothing = counted("flat:60,0.3", 50.0, frame={"pulses": 250}).depth()
    assert nothing.confidence.mean() < 0.2 < np.mean(sure)


@pytest.mark.parametrize(("distance_m", "klux"), [(3.0, 50.0), (8.0, 10.0)])
def test_light_of_the_pixels_is_estimated_with_its_error(distance_m, klux):
    run = counted(f"flat:{distance_m},0.3", klux, side=32)
    depth = run.depth()
    truth = run.light.total_signal.reshape(32, 32)
    signal = depth.signal_per_pulse[:, :, 0]
    assert abs(np.mean(signal) / np.mean(truth) - 1) < 0.045
    scaled = (signal - truth) / depth.signal_error[:, :, 0]
    assert 0.7 < np.std(scaled) < 1.3


def test_pulses_of_the_searches_are_no_trials_of_the_gates():
    """A gate that opens at one place while the subgroup searches, and at another while it counts."""
    frame = {"pulses": 40, "search_pulses": 10, "gate_every": 20, "gate_step": 30, "gate_steps": 2}
    dark = counted(
        "flat:5,0",
        0.0,
        side=8,
        frame=frame,
        subgroup={"gating": True, "gate_start": 0, "gate_len": 30},
    )
    result = dark.result | {"count_pulses": np.full_like(dark.result["count_pulses"], 20)}
    for cycle, pulses in ((5, 0), (40, 20)):
        result["gate_cycle"] = np.full_like(dark.result["gate_cycle"], cycle)
        trials = gate_counts(result, dark.config, 0).trials
        assert np.all(trials.hits + trials.misses == pulses), cycle


def test_pixels_that_stop_early_have_the_gates_of_their_own_pulses():
    """The gate shows the wall in the first half of the counting pulses, in which all pixels stop."""
    moving = {"search_pulses": 150, "gate_every": 600, "gate_step": 125, "gate_steps": 2}
    run = counted(
        "flat:4,0.4",
        5.0,
        frame={"pulses": 1000} | moving,
        subgroup={"gating": True, "gate_start": 0, "gate_len": 120},
    )
    assert run.result["count_pulses"].mean() < 200
    signal = run.depth().signal_per_pulse
    assert np.nanmean(signal) == pytest.approx(run.light.signal_per_pulse.mean(), rel=0.08)


@pytest.mark.parametrize("klux", [10.0, 50.0, 100.0])
def test_background_is_learned_from_the_counts(klux):
    run = counted("five-objects", klux, side=32, frame={"pulses": 1000})
    config = run.config
    truth = run.light.background_cps.reshape(32, 32) * config.tick_s
    counts = gate_counts(run.result, config, 0)
    with Threads(1) as alone:
        found = find_surfaces(
            counts, config, pulse_ticks(config), tolerance_ticks=1.0, threads=alone
        )
    of_subgroups = by_subgroup(truth, config.sensor).mean(axis=1)
    learned = found.seen.background.mean(axis=1)
    assert np.all(np.abs(np.log(learned / of_subgroups)) < 1.2)  # dark ones have few hits
    assert abs(np.log(learned.mean() / of_subgroups.mean())) < 0.2
    first = first_background(counts.trials, config).mean(axis=1)
    assert abs(np.log(first.mean() / of_subgroups.mean())) < 0.9


def test_a_told_background_is_hardly_better():
    run = counted("five-objects", 100.0, side=32, frame={"pulses": 1000})
    config = run.config
    counts = gate_counts(run.result, config, 0)
    told = by_subgroup(run.light.background_cps.reshape(32, 32) * config.tick_s, config.sensor)
    wrong = []
    for background in (None, told):
        with Threads(1) as alone:
            found = find_surfaces(
                counts,
                config,
                pulse_ticks(config),
                tolerance_ticks=SUCCESS_TOLERANCE_S / config.tick_s,
                threads=alone,
                background=background,
            )
        if background is not None:
            assert np.array_equal(found.seen.background, background)
        depth_m = found.time[:, :, 0] * config.tick_m
        wrong.append(np.mean(~(np.abs(depth_m - run.scene.truth_m) < TOLERANCE_M)))
    learned, with_truth = wrong
    assert learned <= with_truth + 0.005


def without_gates(arrays, minigroup):
    """Return a result in which a minigroup of subgroup 0 has found no gate; None: all have not."""
    changed = {name: arrays[name].copy() for name in arrays}
    if minigroup is None:
        changed["gate_cycle"][:] = NO_GATE
        changed["gate_hits"][:] = 0
    else:
        changed["gate_cycle"][:, 0, minigroup] = NO_GATE
        changed["gate_hits"][:, 0, pixel_table_of(minigroup)] = 0
    return changed


def pixel_table_of(minigroup):
    """Return the pixels of a minigroup of the default sensor, by their numbers in the subgroup."""
    return np.flatnonzero(pixel_table(counted("flat:4,0.4").config.sensor).minigroup == minigroup)


def test_confidence_of_counts_has_a_law_of_its_own(monkeypatch):
    """Only the law of counts decides."""
    run = counted("flat:4,0.4")
    assert run.depth().confidence.min() > 0.5
    never = (*LAW["counts"][:-1], -1e3)
    monkeypatch.setitem(LAW, "counts", never)
    assert run.depth().confidence.max() < 0.01


def test_the_guard_of_windows_is_no_edge_of_a_gate():
    """A gate that is always open changes nothing."""
    setting = {"gating": True, "gate_start": 0, "gate_len": 250}
    for subgroup in ({}, setting):
        run = counted("flat:73.5,0.9", 1.0, frame={"pulses": 2000}, subgroup=subgroup)
        reason = run.depth().reason
        assert np.mean(reason == Reason.BELIEVED) > 0.95, subgroup


def test_pixels_without_a_gate_are_not_believed():
    run = counted("flat:4,0.4")
    depth = estimate_depth(without_gates(run.result, 5), run.config)
    empty = np.zeros((run.config.sensor.subgroups, run.config.sensor.pixels), bool)
    empty[0, pixel_table_of(5)] = True
    empty = pixel_image(empty, run.config.sensor)
    assert np.all(depth.reason[empty] == Reason.NO_LIGHT)
    assert np.all(depth.confidence[empty] == 0)
    assert np.mean(depth.reason[~empty] == Reason.BELIEVED) > 0.95


def test_frame_without_any_gate_has_no_depth():
    run = counted("flat:4,0.4")
    depth = estimate_depth(without_gates(run.result, None), run.config)
    assert np.isnan(depth.depth_m).all()
    assert np.all(depth.confidence == 0)
    assert np.all(depth.reason == Reason.NO_LIGHT)
    assert np.isnan(depth.signal_per_pulse).all()


def test_surface_in_no_gate_is_not_believed():
    """All gates are where there is background only."""
    run = counted("flat:20,0.5", 100.0)
    moved = {name: run.result[name].copy() for name in run.result}
    moved["gate_cycle"][:] = (0, GATE_CYCLES)
    rng = np.random.default_rng(1)
    moved["gate_hits"] = rng.poisson(0.1, moved["gate_hits"].shape).astype(np.uint8)
    depth = estimate_depth(moved, run.config)
    assert np.mean(depth.reason == Reason.BELIEVED) < 0.15
    assert np.median(depth.confidence) < 0.3


def test_masked_pixels_have_no_effect():
    masked = {"mask": "fffffffffffffffe"}  # pixel 0 of each subgroup
    run = counted("flat:4,0.4", subgroup=masked)
    assert not run.config.mask[:, 0].any()
    nonsense = {name: run.result[name].copy() for name in run.result}
    assert nonsense["gate_hits"][:, :, 0].sum() == 0
    expected = run.depth()
    nonsense["gate_hits"][:, :, 0] = 3
    depth = estimate_depth(nonsense, run.config)
    known = pixel_image(run.config.mask, run.config.sensor)
    for name in ("depth_m", "error_m", "signal_per_pulse"):
        assert np.array_equal(getattr(depth, name)[known], getattr(expected, name)[known]), name
    assert np.isnan(depth.signal_per_pulse[~known]).all()
    assert not np.isnan(depth.signal_per_pulse[known]).any()


def aborted(run, pulses):
    """Return the result of a frame that is aborted after so many pulses."""
    trace = Golden(run.config.sensor).frame(
        run.config, run.edges.take(run.edges.pulse < pulses), pulses=pulses
    )
    built = ResultBuilder(run.config)
    built.add(trace.beats, trace.commit_subgroup, trace.commit_cycle)
    return built.arrays()


def test_frame_that_is_aborted_while_pixels_count():
    run = counted("flat:4,0.4")
    depth = estimate_depth(aborted(run, 350), run.config)
    assert np.mean(np.abs(depth.depth_m[:, :, 0] - run.scene.truth_m) < TOLERANCE_M) > 0.98
    truth = run.light.total_signal.reshape(SIDE, SIDE)
    assert abs(np.mean(depth.signal_per_pulse[:, :, 0]) / truth.mean() - 1) < 0.1


def test_frame_that_is_aborted_in_the_search_has_no_depth():
    run = counted("flat:4,0.4")
    depth = estimate_depth(aborted(run, 150), run.config)
    assert np.isnan(depth.depth_m).all()


def test_frames_together_say_more_than_one():
    run = counted("flat:30,0.3", 50.0, frame={"pulses": 250, "frames": 6})
    alone, together = (np.abs(off_m(run, frame=frame)) for frame in (0, None))
    assert np.mean(together < TOLERANCE_M) > np.mean(alone < TOLERANCE_M) + 0.2
    with pytest.raises(InputError, match="frame = 6: must be an integer from 0 to 5"):
        run.depth(frame=6)


def test_pulses_of_all_frames_are_those_of_each():
    run = counted("flat:5,0.3", side=8, frame={"pulses": 100, "frames": 3})
    together = gate_counts(run.result, run.config)
    alone = [gate_counts(run.result, run.config, frame) for frame in range(3)]
    assert together.pulses == sum(one.pulses for one in alone) == 3 * (100 - 2 * 20)
    assert np.array_equal(together.own_pulses, sum(one.own_pulses for one in alone))
    assert np.array_equal(
        together.trials.hits, np.concatenate([one.trials.hits for one in alone], axis=2)
    )


PARTS = ("depth_m", "confidence", "reason", "signal_per_pulse", "signal_error")


@pytest.mark.parametrize("number", (0, 2))
def test_a_frame_among_others_is_the_frame_alone(number):
    """Also its light where an estimator of a user's own gives the distances."""
    walls = load_scene(np.multiply.outer((3.0, 9.0, 5.0), np.ones((SIDE, SIDE))), SIDE, SIDE)
    run = counted(walls, frame={"frames": 3, "pulses": 200})
    alone = {
        name: array[number : number + 1] if len(array) == 3 else array
        for name, array in run.result.items()
    }
    config = run.config.with_frame(frames=1)
    for method in ("planes", FirstGate()):
        among = estimate_depth(run.result, run.config, method=method, frame=number)
        assert_equal_depths(among, estimate_depth(alone, config, method=method), PARTS)
    assert np.nanmedian(among.signal_per_pulse) > 0


def test_more_returns_leave_the_first_one():
    run = counted("returns:4@0.2,9@0.6", 5.0)
    assert_equal_depths(run.depth(returns=3), run.depth(), (*PARTS, "error_m"), returns=1)


def test_a_pixel_that_is_full_early_is_as_bright_as_its_hits_per_pulse(monkeypatch):
    """A counter that ends after a quarter of the pulses has a quarter of the hits."""
    run = counted("flat:4,0.4")
    counts = gate_counts(run.result, run.config)
    late, early = (
        counts._replace(own_pulses=np.full_like(counts.own_pulses, pulses)) for pulses in (200, 50)
    )
    lit = []

    def noted(hits, by_chance, of_pixels, *others):
        lit.append(of_pixels)
        return signs_of(hits, by_chance, of_pixels, *others)

    monkeypatch.setattr("coincid.model.depth.counts.signs_of", noted)
    ticks = np.full((SIDE, SIDE), 4 / run.config.tick_m)
    seen = seen_behind(counts, run.config, pulse_ticks(run.config), ticks[:, :, None])
    for one in (late, early):
        count_signs(one, seen, run.config, 2.0, ticks, np.ones((SIDE, SIDE)), ticks)
    assert lit[0].near.min() > 0
    assert np.allclose(lit[1].near, 4 * lit[0].near)
    assert np.allclose(lit[1].fired, 4 * lit[0].fired)


def test_second_return_in_the_second_gate():
    run = counted("returns:4@0.2,9@0.6", 5.0)
    depth = run.depth(returns=2)
    both = np.sort(depth.depth_m, axis=2)
    assert np.median(np.abs(both[:, :, 0] - 4)) < TOLERANCE_M
    assert np.median(np.abs(both[:, :, 1] - 9)) < TOLERANCE_M


def test_no_surface_is_sought_where_the_gating_is_closed():
    """A wall at 4 m is in cycle 13."""
    gate = {"gating": True, "gate_len": 20}
    inside = counted("flat:4,0.4", 50.0, subgroup=gate | {"gate_start": 8})
    assert np.mean(np.abs(off_m(inside)) < TOLERANCE_M) > 0.98
    behind = counted("flat:4,0.4", 50.0, subgroup=gate | {"gate_start": 20})
    assert np.mean(behind.depth().reason == Reason.BELIEVED) < 0.15


def test_number_of_threads_changes_nothing():
    run = counted("five-objects", 50.0, side=32)
    one, three = (run.depth(workers=workers, returns=2) for workers in (1, 3))
    for name in ("depth_m", "confidence", "error_m", "slope_m", "signal_per_pulse"):
        assert np.array_equal(getattr(one, name), getattr(three, name), equal_nan=True)


@pytest.mark.parametrize("method", ["maximum", "matched", "background"])
def test_methods_of_events_are_refused(method):
    run = counted("flat:4,0.4")
    with pytest.raises(
        InputError, match=f"method = '{method}': must be planes, because the format"
    ):
        run.depth(method)
    for others in ((), ("planes",)):
        with pytest.raises(InputError, match="the format counts has no events"):
            counted("flat:4,0.4", estimators=(*others, f"{method}/map"))


def test_views_of_events_are_refused():
    run = counted("flat:4,0.4")
    with pytest.raises(InputError, match=r"frame.format = 'counts': must be one of the formats of"):
        pixel_histogram(run.result, run.config, 0)


def test_counts_of_a_result_of_events_are_asked_for_by_name():
    run = counted("flat:4,0.4")
    events = counted("flat:4,0.4", frame={"format": "id"})
    with pytest.raises(InputError, match="gate_cycle is missing"):
        estimate_depth(events.result, run.config)


@frozen
class FirstGate:
    """An estimator of a user's own: the middle of the first gate that was found."""

    name: str = "first-gate"
    version: str = "1"
    reads: tuple[str, ...] = ("gate_cycle",)

    def estimate(self, reading):
        sensor = reading.config.sensor
        cycle = reading.arrays["gate_cycle"][reading.frame or 0][:, :, 0] + GATE_CYCLES / 2
        ticks = cycle[:, pixel_table(sensor).minigroup] * sensor.phases
        tick_m = reading.config.tick_m
        return Depth.of(pixel_image(ticks * tick_m, sensor))


def test_estimator_of_ones_own_reads_counts_and_is_given_the_light():
    run = counted("flat:4,0.4")
    depth = run.depth(FirstGate())
    assert np.all(np.abs(depth.depth_m - 4) < 0.3)
    assert depth.signal_per_pulse.shape == (SIDE, SIDE, 1)


@pytest.mark.parametrize("gate", (0, 1))
def test_the_last_hit_of_a_pixel_and_its_pulse_are_left_out_in_its_own_frame(gate):
    """Of both gates: their pulses end with it. Frames in which the pixel goes on keep all."""
    shape = (1, 2, 2 * GATES, 3)  # two pixels, two frames
    hits = np.full(shape, 5)
    misses = np.full(shape, 7.0)
    misses[0, 1, GATES + 1 - gate, 0] = 0.5
    hits[0, 1, GATES + gate, 2] = COUNT_MOST
    seen = Seen(np.zeros(shape[:3], np.int64), hits, misses, np.zeros(shape[:2]), 8)
    left = _without_last_hits(seen)
    fewer_hits = np.zeros(shape)
    fewer_hits[0, 1, GATES + gate, 2] = 1
    assert np.array_equal(hits - left.hits, fewer_hits)
    fewer_misses = np.zeros(shape)
    fewer_misses[0, 1, GATES:] = 1
    fewer_misses[0, 1, GATES + gate, 2] = 0
    fewer_misses[0, 1, GATES + 1 - gate, 0] = 0.5
    assert np.array_equal(misses - left.misses, fewer_misses)


@pytest.mark.parametrize("minigroup", [(1, 4), (2, 2), (4, 1)], ids=str)
def test_what_is_summed_over_minigroups_is_of_their_own_pixels(minigroup):
    """Also where these do not follow each other in the subgroup."""
    sensor = {"rows": 8, "cols": 16, "subgroup": [4, 8], "minigroup": list(minigroup)}
    config = parse_config({"sensor": sensor})
    values = np.random.default_rng(3).integers(0, 99, (4, 32, 2, 3))
    empty = np.zeros((4, 32, 2))
    found = Trials(empty, values, values, 4).of_minigroups(values, config)
    across = 8 // minigroup[1]
    expected = np.zeros((4, 32 // np.prod(minigroup), 2, 3), np.int64)
    for pixel in range(32):
        row, col = divmod(pixel, 8)
        expected[:, row // minigroup[0] * across + col // minigroup[1]] += values[:, pixel]
    assert np.array_equal(found, expected)
