# SPDX-License-Identifier: Apache-2.0
"""Histograms of another sensor as light: photons at the recorded times, from every kind of file."""

import h5py
import numpy as np
import pytest
from scipy.io import savemat

from coincid.lab.bound import median_light, word_bounds_mm
from coincid.lab.outcomes import Run
from coincid.lab.setup import Setup
from coincid.model.contract.config import parse_config
from coincid.model.depth.pulse_ticks import pulse_ticks
from coincid.model.scenes.catalogue import load_scene
from coincid.model.scenes.scene import scene_light
from coincid.model.shared.constants import SPEED_OF_LIGHT_M_S
from coincid.model.shared.errors import InputError
from coincid.model.shared.pulse import Pulse
from coincid.study.run import simulate

SHAPE = (8, 8)
BIN_PS = 100.0
BINS = 640  # 64 ns
PULSES = 2000
WALL_M = np.where(np.arange(8) < 4, 3.0, 6.0) * np.ones(SHAPE)
CONFIG = parse_config({"sensor": {"rows": 8, "cols": 8}, "frame": {"pulses": 200, "period": 40}})


def mean_counts():
    """float64[8, 8, bins]: a wall in two halves, 0.5 photons per pulse, and 0.1 of background."""
    time_ps = (np.arange(BINS) + 0.5) * BIN_PS
    flight_ps = 2 * WALL_M / SPEED_OF_LIGHT_M_S * 1e12
    shape = np.exp(-0.5 * ((time_ps - flight_ps[:, :, None]) / 200) ** 2)
    return PULSES * (0.5 * shape / shape.sum(axis=2, keepdims=True) + 0.1 / BINS)


def counts():
    return np.random.default_rng(5).poisson(mean_counts())


def hdf5(at):
    with h5py.File(at / "h.h5", "w") as archive:
        archive["counts"] = counts()
        archive["mask"] = np.ones(SHAPE)
    return f"{at / 'h.h5'}:counts"


def npz(at):
    np.savez(at / "h.npz", counts=counts())
    return str(at / "h.npz")


def npy(at):
    np.save(at / "h.npy", counts().astype(np.uint16))
    return str(at / "h.npy")


def mat(at):
    savemat(at / "h.mat", {"counts": counts()})
    return f"{at / 'h.mat'}:counts"


def mat_73(at):
    with h5py.File(at / "h.mat", "w") as archive:
        archive["counts"] = counts().T
    return str(at / "h.mat")


@pytest.mark.parametrize("source", [lambda at: counts(), npy, npz, hdf5, mat, mat_73])
def test_the_truth_is_the_peak_of_each_histogram(tmp_path, source):
    scene = load_scene(source(tmp_path), *SHAPE, bin_ps=BIN_PS, recorded_pulses=PULSES)
    assert scene.truth_m == pytest.approx(WALL_M, abs=0.01)


def test_masked_counts_are_none():
    """Such as those of a bin that always fires."""
    hidden = np.zeros((*SHAPE, BINS), bool)
    hidden[:, :, 300] = True
    hot = np.ma.masked_array(np.where(hidden, np.nan, counts()), hidden)
    hot.data[0, 0, 300] = 1e4
    scene = load_scene(hot, *SHAPE, bin_ps=BIN_PS, recorded_pulses=PULSES)
    assert scene.truth_m == pytest.approx(WALL_M, abs=0.01)
    assert np.all(scene.transient.photons[:, :, 300] == 0)


def test_the_photons_are_those_of_the_histograms():
    """As many per pulse, and the sensor measures the same distances."""
    run = simulate(CONFIG, counts(), bin_ps=BIN_PS, recorded_pulses=PULSES, seed=2)
    assert run.light.arrivals.photons.sum() / 64 == pytest.approx(0.6, rel=0.1)
    assert np.all(run.light.background_cps == 0)  # nothing besides theirs, unless it is asked for
    assert np.nanmedian(np.abs(run.depth().depth_m[:, :, 0] - WALL_M)) < 0.02


def test_signal_and_background_of_the_histograms_are_told_apart():
    """Bounds and notes are those of 0.5 photons per pulse, and of a pulse that the user tells."""
    setup = Setup.of(
        load_scene(counts(), *SHAPE, bin_ps=BIN_PS, recorded_pulses=PULSES),
        klux=0.0,
        sensor={"rows": 8, "cols": 8},
    )
    light = setup.photons.light
    assert np.all(light.background_cps == 0)
    assert light.total_signal.reshape(SHAPE) == pytest.approx(np.full(SHAPE, 0.5), rel=0.1)
    noise_cps = 0.1 / (BINS * BIN_PS * 1e-12)
    assert light.total_background_cps.mean() == pytest.approx(noise_cps, rel=0.1)
    run = Run(setup)
    usual = median_light(light)
    assert run["bound_mm"] == pytest.approx(word_bounds_mm(setup.config, *usual).pixel_mm)
    wide = Pulse.gaussian(2e-9)
    of_wide = word_bounds_mm(setup.config, *usual, pulse_ticks(setup.config, pulse=wide))
    assert run.but(pulse=wide)["bound_mm"] == pytest.approx(of_wide.pixel_mm)


def test_signal_and_background_are_all_photons_also_if_the_last_bins_have_none():
    """The background lasts as long as the histograms do."""
    given = mean_counts()
    given[:, :, 500:] = 0
    light = scene_light(load_scene(given, *SHAPE, bin_ps=BIN_PS, recorded_pulses=PULSES), 0)
    of_background = light.total_background_cps * BINS * BIN_PS * 1e-12
    photons = given.sum(axis=2).ravel() / PULSES
    assert light.total_signal + of_background == pytest.approx(photons)


def test_counts_without_a_number_of_pulses_are_scaled_by_the_peaks_in_the_range():
    far = WALL_M == 6
    brighter = counts() * np.where(far, 10, 1)[:, :, None]
    signal = [
        scene_light(load_scene(given, *SHAPE, bin_ps=BIN_PS, range_m=5.9), 0).total_signal
        for given in (counts(), brighter)
    ]
    same, other = (each[~far.ravel()] for each in signal)
    assert other == pytest.approx(same)


def test_further_surfaces_are_signal_and_no_background():
    """As behind a window. The truth is the highest peak."""
    twice = counts()
    twice[:, :, 500:505] += PULSES // 50  # 0.1 photons per pulse
    scene = load_scene(twice, *SHAPE, bin_ps=BIN_PS, recorded_pulses=PULSES)
    assert scene.truth_m == pytest.approx(WALL_M, abs=0.01)
    light = scene_light(scene, 0)
    assert light.total_signal == pytest.approx(np.full(64, 0.6), rel=0.1)
    noise_cps = 0.1 / (BINS * BIN_PS * 1e-12)
    assert light.total_background_cps.mean() == pytest.approx(noise_cps, rel=0.1)


def test_a_peak_that_is_too_near_is_no_surface():
    near = counts()
    near[0, 0] = 0
    near[0, 0, :3] = 200
    scene = load_scene(near, *SHAPE, bin_ps=BIN_PS, recorded_pulses=PULSES)
    assert np.flatnonzero(~scene.valid).tolist() == [0]
    assert any("1 of 64 histograms have no peak in this range" in note for note in scene.notes)


@pytest.mark.parametrize("in_file", [True, False])
def test_a_peak_at_or_beyond_the_range_is_no_surface(tmp_path, in_file):
    """Of a recording that lasts longer than the laser period."""
    np.save(tmp_path / "h.npy", counts())
    source = tmp_path / "h.npy" if in_file else counts()
    scene = load_scene(source, *SHAPE, bin_ps=BIN_PS, recorded_pulses=PULSES, range_m=5.9)
    assert np.array_equal(scene.valid, WALL_M == 3)
    assert any("32 of 64 histograms have no peak in this range" in note for note in scene.notes)
    with pytest.raises(InputError, match="no histogram has a peak from 0.05 m to .* of 2.9 m;"):
        load_scene(source, *SHAPE, bin_ps=BIN_PS, range_m=2.9)


def test_what_the_histograms_are_is_told_in_numbers():
    scene = load_scene(counts(), *SHAPE, bin_ps=BIN_PS, recorded_pulses=PULSES)
    assert scene.notes[0].startswith("array: 8 x 8 histograms of 640 bins of 100 ps, 64 ns; the")
    for shape in ((4, 8), (8, 6), (9, 7)):
        high, wide = shape
        told = f"has {high} x {wide} histograms, must have 8 x 8, one for each pixel;"
        told += f" --set rows={high} --set cols={wide} makes the sensor fit$"
        with pytest.raises(InputError, match=told):
            load_scene(np.ones((*shape, 40)), *SHAPE, bin_ps=BIN_PS)


def test_the_noise_of_a_background_is_no_surface():
    """However its highest bin stands out among so many."""
    noise = counts()
    noise[0] = np.random.default_rng(6).poisson(20.0, (8, BINS))
    scene = load_scene(noise, *SHAPE, bin_ps=BIN_PS, recorded_pulses=PULSES)
    assert np.flatnonzero(~scene.valid).tolist() == list(range(8))


def test_light_beyond_that_of_any_sensor_is_as_bright_as_light_can_be():
    """Signal and background alike; no ambient light is to blame."""
    scene = load_scene(1e6 * counts(), *SHAPE, bin_ps=BIN_PS, recorded_pulses=1)
    arrivals = scene_light(scene, 0).arrivals
    assert arrivals.photons.max() == 1e4
    assert np.all(arrivals.background_cps == 1e12)


def test_photons_of_a_bin_come_while_it_lasts():
    """As likely at its beginning as at its end. So few that no SPAD is dead."""
    late = np.zeros((*SHAPE, 8))
    late[:, :, 5] = 0.05 * PULSES
    bin_ps = 4000.0
    edges = Setup(
        config=CONFIG,
        scene=load_scene(late, *SHAPE, bin_ps=bin_ps, recorded_pulses=PULSES),
        klux=0.0,
    ).photons.edges()
    bins = (edges.tick + 0.5) * CONFIG.tick_s * 1e12 / bin_ps
    assert bins.mean() == pytest.approx(5.5, abs=0.1)
    assert bins.std() == pytest.approx(12**-0.5, abs=0.05)


def test_unknown_pulses_are_scaled_to_the_light_of_the_sensor():
    for factor in (1, 7):
        scene = load_scene(factor * counts(), *SHAPE, bin_ps=BIN_PS)
        light = Setup(config=CONFIG, scene=scene, klux=0.0).photons.light
        assert np.median(light.total_signal) == pytest.approx(0.613, rel=0.05)
        assert any("--recorded-pulses" in note for note in scene.notes)
    bright = counts()
    bright[0] *= 1000  # a few pixels with a mirror
    scene = load_scene(bright, *SHAPE, bin_ps=BIN_PS)
    light = Setup(config=CONFIG, scene=scene, klux=0.0).photons.light
    assert np.median(light.total_signal) == pytest.approx(0.613, rel=0.1)


def test_histograms_without_a_peak_do_not_count_for_the_scale():
    """Such as those of pixels that are off, of which there may be many."""
    some = counts()
    some[:5] = 0
    scene = load_scene(some, *SHAPE, bin_ps=BIN_PS)
    assert np.flatnonzero(scene.valid).tolist() == list(range(40, 64))
    signal = scene_light(scene, 0).total_signal
    assert np.median(signal[40:]) == pytest.approx(0.613, rel=0.05)
    assert not signal[:40].any()


def test_background_can_be_added():
    scene = load_scene(counts(), *SHAPE, bin_ps=BIN_PS)
    assert np.all(Setup(config=CONFIG, scene=scene, klux=50.0).photons.light.background_cps > 0)
    assert any("--klux adds more" in note for note in scene.notes)


def test_what_is_no_histogram_is_refused():
    for values, options, words in (
        (counts()[:4], {}, "has 4 x 8 histograms, must have 8 x 8.*--set rows=4"),
        (counts()[0], {}, "in three dimensions"),
        (-counts(), {}, "counts.*must be of at least 0|counts.*must be at least 0"),
        (np.zeros((*SHAPE, 40)), {}, "no histogram has a peak"),
        (counts(), {"bin_ps": 0}, "bin_ps = 0"),
        (counts(), {"recorded_pulses": 0}, "recorded_pulses = 0"),
        (counts(), {"unit": "mm"}, "unit = 'mm': goes with depth files only"),
        (counts(), {"colour": "a.png"}, "colour = 'a.png': goes with depth files only, not with"),
        (counts(), {"reflectivity": 0.9}, "reflectivity: goes with depth files and arrays"),
        (counts(), {"missing": np.array([1.0, 2.0])}, "missing = array.*goes with depth files"),
        (counts(), {"bin_ps": None, "recorded_pulses": 4}, "recorded_pulses = 4: goes with hist"),
    ):
        with pytest.raises(InputError, match=words):
            load_scene(values, *SHAPE, **{"bin_ps": BIN_PS} | options)


@pytest.mark.parametrize("name", ["counts.png", "counts.exr", "counts"])
def test_a_picture_holds_no_histograms(tmp_path, name):
    (tmp_path / name).touch()
    with pytest.raises(InputError, match=f"{name}: must be .npy, .npz, .h5, .hdf5, .mat to hold"):
        load_scene(str(tmp_path / name), *SHAPE, bin_ps=BIN_PS)


def test_histograms_without_their_width_are_told_apart_from_a_sequence():
    scene = load_scene(np.full((3, 8, 64), 4.0), *SHAPE)
    assert any("--bin-ps" in note for note in scene.notes)
    assert not any("--bin-ps" in note for note in load_scene(np.full((3, 8, 8), 4.0), *SHAPE).notes)
