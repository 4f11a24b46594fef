# SPDX-License-Identifier: Apache-2.0
"""Measured pulses: shares of their light, units and files."""

import numpy as np
import pytest

from coincid.model.shared.errors import InputError
from coincid.model.shared.pulse import SAMPLES_MAX, TIME_MAX_S, Pulse, pulse_of, with_pulse

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
    "time_s", [(0.0, 1e-9), (-1e-9, 0.0), (-TIME_MAX_S, TIME_MAX_S), (-1e-12, 0.0, 1e-12)]
)
def test_time_0_and_the_ends_of_the_range_are_legal_samples(time_s):
    pulse = Pulse(time_s=np.array(time_s), density=np.ones(len(time_s)))
    assert pulse.share_before[[0, -1]].tolist() == [0, 1]


@pytest.mark.parametrize("time_s", [(1e-12, 1e-9), (-1e-9, -1e-12)])
def test_time_0_lies_within_the_samples(time_s):
    with pytest.raises(InputError, match=r"pulse.time_s: 0, .* must lie within"):
        Pulse(time_s=np.array(time_s), density=np.ones(2))


@pytest.mark.parametrize("time_s", [(0.0, 0.0, 1e-9), (-1e-9, 1e-9, 0.5e-9)])
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
