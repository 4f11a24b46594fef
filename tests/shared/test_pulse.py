# SPDX-License-Identifier: Apache-2.0
"""Measured pulses: shares of their light, units and files."""

import numpy as np
import pytest

from coincid.model.shared.errors import InputError
from coincid.model.shared.pulse import Pulse, pulse_of, with_pulse

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
