# SPDX-License-Identifier: Apache-2.0
"""Measured pulses: their files, their limits, and the photons that follow them."""

import numpy as np
import pytest
from scipy import stats

from coincid.model.light.light import Light
from coincid.model.light.photons import generate_edges
from coincid.model.light.spad import Spad
from coincid.model.light.timing import Timing
from coincid.model.shared.errors import InputError
from coincid.model.shared.pulse import Pulse, pulse_of

TIME_S = np.array([-500, 0, 200, 1500]) * 1e-12
DENSITY = np.array([0.0, 4.0, 1.0, 0.0])


def lit(pulse: Pulse) -> Light:
    return Light(rows=8, cols=8, distance_m=10.0, signal_per_pulse=0.05, pulse=pulse)


@pytest.mark.parametrize("height", (1e308, 1e-320, 0.0))
def test_a_density_of_which_no_sum_is_a_number_is_refused(height):
    with pytest.raises(InputError, match="pulse.density"):
        Pulse(time_s=TIME_S, density=np.full(4, height))


def test_photons_follow_the_measured_pulse():
    pulse = Pulse(time_s=TIME_S, density=DENSITY)
    timing = Timing()
    edges = generate_edges(lit(pulse), Spad(dead_time_s=0.0), timing, pulses=4000, seed=3)
    flight_ticks = 2 * 10.0 / 299_792_458 / timing.tick_s
    border = np.arange(timing.period_ticks + 1) - flight_ticks
    share = np.diff(np.interp(border, TIME_S / timing.tick_s, pulse.share_before))
    counts = np.bincount(edges.tick, minlength=timing.period_ticks)
    likely = share * len(edges) > 5
    assert counts[share == 0].sum() == 0
    expected = share[likely] * counts[likely].sum() / share[likely].sum()
    assert stats.chisquare(counts[likely], expected).pvalue > 1e-4


def test_pulse_of_csv_and_npy_files(tmp_path):
    text = "".join(f"{t * 1e12:.0f},{d:g}\n" for t, d in zip(TIME_S, DENSITY, strict=True))
    (tmp_path / "pulse.csv").write_text("time_ps,density\n" + text, encoding="utf-8")
    # as spreadsheets write it, with a mark of the byte order
    (tmp_path / "marked.csv").write_text("time_ps,density\n" + text, encoding="utf-8-sig")
    np.save(tmp_path / "pulse.npy", np.stack([TIME_S * 1e12, DENSITY], axis=1))
    for name in ("pulse.csv", "marked.csv", "pulse.npy"):
        pulse = Pulse.load(tmp_path / name)
        np.testing.assert_allclose(pulse.time_s, TIME_S, atol=1e-18)
        np.testing.assert_array_equal(pulse.density, DENSITY)


def test_array_of_a_pulse_is_its_file(tmp_path):
    """With every digit, whatever kind of numbers it has."""
    path = tmp_path / "pulse.npy"
    columns = np.stack([TIME_S * 1e12, DENSITY], axis=1)
    for kind in (np.float64, ">f8", np.float32, np.float16, np.int16):
        own = (columns + 1 / 3).astype(kind)
        np.save(path, own)
        for source in (own, path, str(path)):
            pulse = pulse_of(source)
            np.testing.assert_array_equal(pulse.time_s, own[:, 0].astype(float) * 1e-12)
            np.testing.assert_array_equal(pulse.density, own[:, 1])
    assert pulse_of(None) is None
    np.save(path, columns.astype(object), allow_pickle=True)
    with pytest.raises(InputError, match="pulse.npy: is not a readable NPY file"):
        pulse_of(path)
    for source in (5, columns.T, columns.astype(str)):
        with pytest.raises(InputError, match="^pulse"):
            pulse_of(source)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("0,1\n1,1\n", "its first line must be time_ps,density"),
        ("time_ps,density\n0,1\n", "must have 2 to 65536 samples"),
        ("time_ps,density\n0,1,2\n1,1,2\n", "must have two columns"),
        ("time_ps,density\n0,1\n0,1\n", "must ascend"),
        ("time_ps,density\n5,1\n9,1\n", "0, the time of flight, must lie within the samples"),
        ("time_ps,density\n-1,0\n1,0\n", "must have a sample above 0"),
        ("time_ps,density\n-1,-1\n1,0\n", "density.*must be from 0"),
        ("time_ps,density\n-1,1\n30000,0\n", "must be from -2e-08 to 2e-08"),
        ("time_ps,density\n-1,a\n1,0\n", "is not a readable CSV file"),
        ("time_ps,density\n\n# none\n", r"pulse\.csv: has no samples, must have at least 2"),
    ],
)
def test_wrong_files_of_pulses_are_refused(tmp_path, text, message):
    path = tmp_path / "pulse.csv"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=message):
        Pulse.load(path)


def test_jitter_beside_a_measured_pulse_is_refused():
    light = lit(Pulse(time_s=TIME_S, density=DENSITY))
    with pytest.raises(InputError, match="jitter_tail_fraction: must be 0 with a measured pulse"):
        generate_edges(light, Spad(jitter_tail_fraction=0.1), Timing(), pulses=1, seed=1)
    with pytest.raises(InputError, match="pulse: must be shorter than the laser period"):
        generate_edges(light, Spad(), Timing(period_cycles=1), pulses=1, seed=1)
