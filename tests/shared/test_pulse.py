# SPDX-License-Identifier: Apache-2.0
"""Measured pulses: shares of their light, units and files."""

import numpy as np
import pytest

from coincid.model.shared.errors import InputError
from coincid.model.shared.pulse import (
    DENSITY_MAX,
    DENSITY_MIN,
    SAMPLES_MAX,
    TIME_MAX_S,
    Pulse,
    pulse_of,
    with_pulse,
)

TIME_PS = [-100.0, 0.0, 300.0, 400.0]  # unevenly apart
DENSITY = [0.0, 2.0, 2.0, 0.0]
SHARE_BEFORE = [0.0, 1 / 8, 7 / 8, 1.0]  # areas of 100, 600 and 100


def test_samples_that_are_far_apart_have_more_of_the_light():
    pulse = Pulse(time_s=np.array(TIME_PS) * 1e-12, density=np.array(DENSITY))
    assert pulse.share_before == pytest.approx(SHARE_BEFORE)


@pytest.mark.parametrize("name", ["pulse.csv", "pulse.npy", "PULSE.NPY"])
def test_files_hold_picoseconds_and_density(name, tmp_path):
    columns = np.column_stack([TIME_PS, DENSITY])
    if name.lower().endswith("npy"):
        with (tmp_path / name).open("wb") as file:
            np.save(file, columns)
    else:
        np.savetxt(tmp_path / name, columns, delimiter=",", header="time_ps,density", comments="")
    for source in (tmp_path / name, str(tmp_path / name), columns):
        pulse = pulse_of(source)
        assert pulse.time_s == pytest.approx(np.array(TIME_PS) * 1e-12)
        assert pulse.density == pytest.approx(np.array(DENSITY))


def test_a_result_has_both_arrays_of_its_pulse_or_none():
    pulse = Pulse.gaussian(500e-12)
    arrays = with_pulse({"stamp": np.arange(3)}, pulse)
    again = Pulse.of_result(arrays)
    assert np.array_equal(again.time_s, pulse.time_s)
    assert np.array_equal(again.density, pulse.density)
    assert Pulse.of_result(with_pulse({"stamp": np.arange(3)}, None)) is None
    for name in set(arrays) - {"stamp"}:
        with pytest.raises(InputError, match="must have both"):
            Pulse.of_result({name: arrays[name]})


@pytest.mark.parametrize(
    "time_s",
    [(0.0, 1e-9), (0.0, 1.1e-18), (-1e-9, 0.0), (-TIME_MAX_S, TIME_MAX_S), (-1e-12, 0.0, 1e-12)],
)
def test_time_0_and_the_ends_of_the_range_are_legal_samples(time_s):
    pulse = Pulse(time_s=np.array(time_s), density=np.ones(len(time_s)))
    assert pulse.share_before[[0, -1]].tolist() == [0, 1]


@pytest.mark.parametrize("time_s", [(1e-12, 1e-9), (-1e-9, -1e-12)])
def test_time_0_lies_within_the_samples(time_s):
    with pytest.raises(InputError, match=r"pulse.time_s: 0, .* must lie within"):
        Pulse(time_s=np.array(time_s), density=np.ones(2))


@pytest.mark.parametrize("time_s", [(0.0, 0.0, 1e-9), (-1e-9, 1e-9, 0.5e-9), (0.0, 0.9e-18, 1e-9)])
def test_samples_ascend(time_s):
    with pytest.raises(InputError, match="pulse.time_s: must ascend"):
        Pulse(time_s=np.array(time_s), density=np.ones(3))


@pytest.mark.parametrize("samples", [2, SAMPLES_MAX])
def test_a_pulse_has_any_legal_number_of_samples(samples):
    pulse = Pulse(time_s=np.linspace(-1e-9, 1e-9, samples), density=np.ones(samples))
    assert pulse.share_before == pytest.approx(np.linspace(0, 1, samples))


@pytest.mark.parametrize("samples", [1, SAMPLES_MAX + 1])
def test_other_numbers_of_samples_are_refused(samples):
    with pytest.raises(InputError, match=f"must have 2 to {SAMPLES_MAX} samples"):
        Pulse(time_s=np.linspace(0, 1e-9, samples), density=np.ones(samples))


@pytest.mark.parametrize("kind", [np.uint16, np.int64])
def test_an_array_of_a_pulse_may_hold_any_integers(kind):
    pulse = pulse_of(np.array([(0, 1), (100, 2), (400, 0)], kind))
    assert pulse.time_s == pytest.approx([0, 100e-12, 400e-12])
    assert pulse.density.tolist() == [1, 2, 0]


@pytest.mark.parametrize("fwhm_s", [1e-12, 500e-12, 9e-9])
def test_a_gaussian_is_half_as_high_half_a_width_from_time_0(fwhm_s):
    """At both ends of the legal range, too."""
    pulse = Pulse.gaussian(fwhm_s)
    at = np.interp([-fwhm_s / 2, 0, fwhm_s / 2], pulse.time_s, pulse.density)
    assert at == pytest.approx([0.5, 1, 0.5], rel=1e-3)
    assert np.interp(0, pulse.time_s, pulse.share_before) == pytest.approx(0.5)
    assert pulse.density.max() == 1
    assert pulse.density[[0, -1]].max() < 1e-5


@pytest.mark.parametrize("fwhm_s", [0.0, 0.99e-12, 9.01e-9, np.nan])
def test_a_gaussian_of_another_width_is_refused(fwhm_s):
    with pytest.raises(InputError, match="^fwhm_s = .*: must be a number from 1e-12 to 9e-09$"):
        Pulse.gaussian(fwhm_s)


@pytest.mark.parametrize("most", [2 * DENSITY_MIN, 1.0, DENSITY_MAX])
def test_a_density_has_any_scale(most):
    pulse = Pulse(time_s=np.array([-1e-9, 0, 1e-9]), density=np.array([0, most, 0]))
    assert pulse.share_before == pytest.approx([0, 0.5, 1])


@pytest.mark.parametrize(
    ("density", "told"),
    [
        ([0, 0, 0], "^pulse.density: must have a sample above 0"),
        ([0, DENSITY_MIN, 0], "^pulse.density: must have a sample above 0"),
        ([0, -1, 5], r"^pulse.density\[1\] = -1.0: must be from 0 to"),
        ([0, 1, 2 * DENSITY_MAX], r"^pulse.density\[2\] = 2e\+100: must be from 0 to 1e\+100"),
        ([0, np.nan, 1], r"^pulse.density\[1\] = nan: must be from 0 to"),
    ],
)
def test_a_density_that_is_none_is_refused(density, told):
    with pytest.raises(InputError, match=told):
        Pulse(time_s=np.array([-1e-9, 0, 1e-9]), density=np.array(density))


@pytest.mark.parametrize(
    "head", ["time_ps,density,more", "time_s,density", "density,time_ps", "time_ps", "0,1", ""]
)
def test_a_table_with_another_first_line_is_refused(head, tmp_path):
    """Its columns could have another order or unit."""
    path = tmp_path / "pulse.csv"
    path.write_text(f"{head}\n-100,1\n100,1\n", encoding="utf-8")
    with pytest.raises(InputError, match=r"pulse\.csv: its first line must be time_ps,density$"):
        Pulse.load(path)


@pytest.mark.parametrize("shape", [(4,), (4, 1), (4, 3), (2, 4), (1, 4, 2)])
def test_a_pulse_has_two_columns(shape, tmp_path):
    """As an array and in a file."""
    array = np.arange(np.prod(shape), dtype=float).reshape(shape)
    with pytest.raises(InputError, match=r"^pulse: has shape .*, must have two columns"):
        pulse_of(array)
    np.save(tmp_path / "pulse.npy", array)
    with pytest.raises(InputError, match=r"pulse\.npy: has shape .*, must have two columns"):
        pulse_of(tmp_path / "pulse.npy")


@pytest.mark.parametrize("kind", ["complex", "U4", "m8[ps]", bool])
def test_a_file_of_a_pulse_holds_numbers(kind, tmp_path):
    np.save(tmp_path / "pulse.npy", np.array([[0, 1], [1, 1]]).astype(kind))
    with pytest.raises(InputError, match=r"pulse\.npy: holds .*, must hold numbers$"):
        Pulse.load(tmp_path / "pulse.npy")


def test_what_is_no_pulse_is_refused():
    assert pulse_of(None) is None
    pulse = Pulse.gaussian(1e-10)
    assert pulse_of(pulse) is pulse
    for wrong in (
        3,
        [[0, 1], [1, 1]],
        b"pulse.csv",
        np.zeros((2, 2), bool),
        np.array([["a", "b"]]),
    ):
        with pytest.raises(InputError, match="(?s)^pulse = .*: must be a Pulse, an array"):
            pulse_of(wrong)
