# SPDX-License-Identifier: Apache-2.0
"""`coincid emulate`: a scene on the emulator, simulated behind its pins; a mismatch is found; bad ports are refused."""

import numpy as np
import pytest
from attrs import evolve

from coincid.host.emulator_driver import EmulatorDriver
from coincid.host.serial_transport import SerialTransport
from coincid.lab.setup import scene_of
from coincid.model.contract.config import load_config
from coincid.study import emulate
from coincid.study.emulate import Session, source_settings
from coincid.tb import verilated_emulator
from coincid.tb.rtl_errors import Mismatch
from coincid.tb.verilated_emulator import PATIENCE_S, SimulatedPort

from ..command import command
from ..tb.test_emulator import EMULATOR

# Of the emulator that `tb/test_emulator.py` compiles.
SMALL = """
[sensor]
rows = 4
cols = 8
phases = 8
window_max = 16
subgroup = [4, 4]

[frame]
clock_mhz = 100
period = 63
pulses = 8

[subgroup]
window = 4
"""


@pytest.fixture
def config_file(tmp_path):
    path = tmp_path / "small.toml"
    path.write_text(SMALL)
    return path


def test_a_scene(config_file, tmp_path, monkeypatch):
    monkeypatch.setattr(verilated_emulator, "simulated", lambda sensor, **_: EMULATOR)
    out = tmp_path / "out"
    done = command(f"emulate --simulate --config {config_file} --frames 2 --scene flat:5 --out {out}")
    assert done.exit_code == 0, done.output
    assert "2 frames" in done.output and "all as the golden model predicts" in done.output
    assert (out / "depth.png").stat().st_size > 1000


def test_the_picture_is_drawn_while_frames_come(config_file, tmp_path, monkeypatch):
    """With no time between two pictures: one per frame, each with all frames so far."""
    config, titles = load_config(str(config_file)), []
    monkeypatch.setattr(emulate, "REDRAW_S", 0.0)
    monkeypatch.setattr(emulate, "depth_row", lambda path, panels, truth_m: titles.append(panels[0].title))
    with SimulatedPort(EMULATOR, config.clock_mhz) as port:
        driver = EmulatorDriver(SerialTransport(port, patience_s=PATIENCE_S))
        emulate.emulate(driver, config, scene_of(config, "flat:5"), tmp_path, klux=50.0, frames=3)
    assert titles == [f"{n} frames of the emulator" for n in (1, 2, 3)]


def test_a_scene_as_settings():
    config = load_config("emulator")
    scene = scene_of(config, "flat:6,0.4")
    settings = source_settings(config, scene, 50.0)
    tick = round(2 * 6 / 299_792_458 / config.tick_s)
    cycle_s = 1e-6 / config.clock_mhz
    assert (settings.tick == tick).all()
    assert (settings.level == round((1 - np.exp(-0.613 * (4 / 6) ** 2)) * 256)).all()
    assert (settings.background == round((1 - np.exp(-1.226e6 * cycle_s)) * 65536)).all()
    assert settings.dead_cycles == 1


def test_a_wrong_word_is_found(config_file):
    config = load_config(str(config_file))
    scene = scene_of(config, "flat:5")
    with SimulatedPort(EMULATOR, config.clock_mhz) as port:
        settings = source_settings(config, scene, 50.0)
        session = Session(EmulatorDriver(SerialTransport(port, patience_s=PATIENCE_S)), config, settings)
        session.frame()
        session.settings = evolve(settings, background=settings.background + 1)
        with pytest.raises(Mismatch, match=r"frame \d, beat"):
            for _ in range(5):
                session.frame()


@pytest.mark.parametrize(
    "arguments, says",
    [
        ([], "give either --port DEVICE or --simulate"),
        (["--simulate", "--port", "/dev/null"], "give either"),
        (["--port", "/dev/none"], "cannot be opened"),
        (["--simulate", "--frames", "0"], "frames = 0"),
        (["--port", "/dev/none", "--netlist"], "netlist: goes with --simulate only"),
    ],
)
def test_bad_input(arguments, says):
    done = command("emulate", *arguments)
    assert done.exit_code == 2 and says in done.output
