# SPDX-License-Identifier: Apache-2.0
"""A measured pulse on its way in: `simulate`, the commands, the explorer."""

import numpy as np
import pytest

import coincid
from coincid.lab.setup import Setup
from coincid.model.contract.result import differences, read_result
from coincid.model.light.light import Light
from coincid.model.shared.pulse import Pulse
from coincid.study.explore.control_values import check_settings, command, given_settings
from coincid.study.explore.uploads import Uploads

from ..command import command as played

TABLE = np.array([[-300.0, 0.0], [0.0, 3.0], [200.0, 1.0], [1500.0, 0.0]])
TEXT = "time_ps,density\n" + "".join(f"{time:g},{density:g}\n" for time, density in TABLE)
SMALL = {"rows": 8, "cols": 8, "pulses": 20, "period": 60}
SETTINGS = " ".join(f"--set {name}={value}" for name, value in SMALL.items())


@pytest.fixture
def path(tmp_path):
    file = tmp_path / "pulse.csv"
    file.write_text(TEXT, encoding="utf-8")
    return file


@pytest.fixture(scope="module")
def run():
    return coincid.simulate(None, "flat:5,0.4", pulse=TABLE, **SMALL)


def test_simulate_takes_array_file_and_pulse(run, path):
    assert differences(coincid.simulate(None, "flat:5,0.4", **SMALL).result, run.result)
    for pulse in (path, Pulse.load(path)):
        same = coincid.simulate(None, "flat:5,0.4", pulse=pulse, **SMALL)
        assert same.setup.key == run.setup.key
        assert not differences(same.result, run.result)


def test_commands_take_a_file(run, path, tmp_path):
    edges = tmp_path / "edges.npz"
    assert (
        played(f"photons --scene flat:5,0.4 --pulse {path} {SETTINGS} --out {edges}").exit_code == 0
    )
    assert np.array_equal(np.load(edges)["tick"], run.edges.tick)
    out = tmp_path / "sim"
    words = (
        f"sim --scene flat:5,0.4 --pulse {path} {SETTINGS} --frames 1 --engine golden --out {out}"
    )
    assert played(words).exit_code == 0
    arrays = read_result(out / "events.npz")
    np.testing.assert_array_equal(arrays["pulse_density"], TABLE[:, 1])
    wrong = played(f"photons --pulse {tmp_path / 'none.csv'} --out {edges}")
    assert (wrong.exit_code, wrong.stderr.count("\n")) == (2, 1)


def test_a_pulse_beside_a_light_is_refused(path):
    light = Light(rows=8, cols=8, distance_m=5.0, signal_per_pulse=0.1)
    config = coincid.parse_config({"sensor": {"rows": 8, "cols": 8}})
    with pytest.raises(coincid.InputError, match="pulse: goes with a scene, a Light has its own"):
        Setup(config=config, light=light, pulse=path)


def test_explorer_takes_a_file_of_a_pulse(path, tmp_path):
    uploads = Uploads().with_file("pulse", "../mine.csv", TEXT.encode(), tmp_path)
    settings = check_settings({"scene": "flat", "pulse": "file"}, uploads)
    np.testing.assert_array_equal(settings.setup().pulse.density, TABLE[:, 1])
    assert command(settings).endswith("--set pulse=file --set pulse_file=mine.csv")
    given = given_settings(["pulse=file", f"pulse_file={path}"])
    np.testing.assert_array_equal(given.light(given.scene()).pulse.density, TABLE[:, 1])
    with pytest.raises(coincid.InputError, match="pulse = 'file': choose a file"):
        check_settings({"pulse": "file"}).setup()
    with pytest.raises(coincid.InputError, match="^mine.csv: its first line must be"):
        Uploads().with_file("pulse", "mine.csv", b"1,2", tmp_path)
