# SPDX-License-Identifier: Apache-2.0
"""`coincid emulate`: a scene on the emulator, simulated behind its pins; a mismatch is found; bad
ports are refused.
"""

import numpy as np
import pytest
from attrs import evolve

from coincid.board import run, simulated
from coincid.board.driver import EmulatorDriver
from coincid.board.run import Session, source_settings
from coincid.board.serial_transport import SerialTransport
from coincid.board.simulated import PATIENCE_S, SimulatedPort
from coincid.board.source_model import source_edges
from coincid.lab.setup import scene_of
from coincid.model.contract.config import changes_of_text, load_config
from coincid.model.depth.histograms import by_subgroup
from coincid.model.golden.frame import Golden
from coincid.model.scenes.scene import Scene
from coincid.model.shared.errors import InputError
from coincid.tb.rtl_errors import Mismatch

from ..command import command
from ..transients import synthetic
from .test_emulator import EMULATOR

# Of the emulator that `test_emulator.py` compiles.
SETTINGS = "rows=4 cols=8 phases=8 window_max=16 subgroup=4x4 clock_mhz=100 period=63 pulses=8 window=4".split()
CONFIG = load_config(None, changes_of_text(SETTINGS))


@pytest.fixture
def driver():
    with SimulatedPort(EMULATOR, CONFIG.clock_mhz) as port:
        yield EmulatorDriver(SerialTransport(port, patience_s=PATIENCE_S))


def test_a_scene(tmp_path, monkeypatch):
    monkeypatch.setattr(simulated, "simulated", lambda sensor, **_: EMULATOR)
    given = " --set ".join(["", *SETTINGS])
    done = command(f"emulate --simulate --frames 2 --scene flat:5 --out {tmp_path} {given}")
    assert done.exit_code == 0, done.output
    assert "2 frames" in done.output and "all as the golden model predicts" in done.output
    assert (tmp_path / "depth.png").stat().st_size > 1000


def test_the_picture_is_drawn_while_frames_come(driver, tmp_path, monkeypatch):
    """With no time between two pictures: one per frame, each with all frames so far."""
    titles = []
    monkeypatch.setattr(run, "REDRAW_S", 0.0)
    monkeypatch.setattr(
        run, "depth_row", lambda path, panels, truth_m, **_: titles.append(panels[0].title)
    )
    run.emulate(driver, CONFIG, scene_of(CONFIG, "flat:5"), tmp_path, klux=50.0, frames=3)
    assert titles == [f"{n} frames of the emulator" for n in (1, 2, 3)]


def scene_with(distances_m):
    """A scene in which each pixel of the preset has targets at these distances, in this order."""
    sensor = load_config("emulator").sensor
    distance_m = np.broadcast_to(distances_m, (sensor.rows, sensor.cols, len(distances_m)))
    return Scene(name="targets", distance_m=distance_m, reflectivity=np.full(distance_m.shape, 0.2))


@pytest.mark.parametrize("distances_m", [(4.0, 6.0), (6.0, 4.0), (np.nan, 4.0), (np.nan, 6.0, 4.0)])
def test_a_pixel_with_several_targets_has_the_echo_of_the_nearest(distances_m):
    config = load_config("emulator")
    settings, alone = (
        source_settings(config, scene_with(targets), 0.0) for targets in (distances_m, (4.0,))
    )
    assert np.array_equal(settings.tick, alone.tick)
    assert np.array_equal(settings.level, alone.level)
    assert settings.level.min() > 0


@pytest.mark.parametrize("part", [0.1, 0.5, 0.9])
def test_an_echo_begins_in_the_tick_in_which_its_light_arrives(part):
    """Wherever in the tick that is."""
    config = load_config("emulator")
    settings = source_settings(config, scene_with([(30 + part) * config.tick_m]), 0.0)
    assert (settings.tick == 30).all()


def test_a_scene_without_distances_is_refused():
    """It would be dark."""
    config = load_config("emulator")
    scene = evolve(scene_with([4.0]), transient=synthetic(np.ones((8, 8, 5))))
    with pytest.raises(InputError, match="scene: .* must have distances"):
        source_settings(config, scene, 0.0)


def test_a_scene_as_settings():
    config = load_config("emulator")
    scene = scene_of(config, "flat:6,0.4")
    settings = source_settings(config, scene, 50.0)
    tick = int(2 * 6 / 299_792_458 / config.tick_s)
    cycle_s = 1e-6 / config.clock_mhz
    assert (settings.tick == tick).all()
    assert (settings.level == round((1 - np.exp(-0.613 * (4 / 6) ** 2)) * 256)).all()
    assert (settings.background == round((1 - np.exp(-1.226e6 * cycle_s)) * 65536)).all()
    assert settings.dead_cycles == 1


def test_each_subgroup_has_the_background_of_its_own_pixels():
    """The left half reflects twice as much of the sun."""
    config = load_config("emulator")
    sensor = config.sensor
    reflectivity = np.full((sensor.rows, sensor.cols), 0.2)
    reflectivity[:, : sensor.cols // 2] = 0.4
    distance_m = np.full(reflectivity.shape, 5.0)
    scene = Scene(name="halves", distance_m=distance_m, reflectivity=reflectivity)
    background = source_settings(config, scene, 50.0).background
    assert background.shape == (sensor.subgroups,)
    left = by_subgroup(reflectivity, sensor).mean(axis=1) > 0.3
    assert left.any() and not left.all()
    assert background[left] == pytest.approx(2 * background[~left][0], rel=0.01)
    assert len(set(background[left])) == len(set(background[~left])) == 1


@pytest.mark.parametrize("beyond", [-1, 0, 1])
def test_only_what_lies_within_the_period_has_an_echo(beyond):
    """The tick of the period's end is the first of the next one."""
    config = load_config("emulator")
    tick = config.period_ticks + beyond
    distance_m = np.full((config.sensor.rows, config.sensor.cols), 2.0)
    distance_m[0, 0] = (tick + 0.5) * config.tick_m
    scene = Scene(name="far", distance_m=distance_m, reflectivity=np.ones_like(distance_m))
    settings = source_settings(config, scene, 0.0)
    assert (settings.tick < config.period_ticks).all()
    inside = beyond < 0
    assert settings.tick[0, 0] == (tick if inside else 0)
    assert (settings.level[0, 0] > 0) == inside
    assert (settings.level.ravel()[1:] > 0).all()


def test_a_limit_of_the_link_does_not_change_what_is_predicted(driver):
    """The emulator has no such link: its buffer takes the beats."""
    config = CONFIG.with_frame(link_gbps=0.2, pulses=4)
    settings = source_settings(config, scene_of(config, "flat:8"), 200.0)
    session = Session(driver, config, settings)
    beats = session.frame()
    limited = Golden(config.sensor).frame(config, source_edges(config, settings, 0)).beats[0]
    assert not np.array_equal(beats, limited)  # a limit that is felt


class Unused:
    """A driver that nobody may use."""

    def __getattr__(self, name):
        raise AssertionError(name)


def test_a_format_without_a_map_is_refused_before_the_first_frame(tmp_path):
    config = CONFIG.with_frame(format="short")
    scene = scene_of(config, "flat:5")
    with pytest.raises(InputError, match="frame.format = 'short': must be"):
        run.emulate(Unused(), config, scene, tmp_path / "none", klux=50.0, frames=1)


class Predicted:
    """The driver of an emulator whose frames are as the golden model predicts."""

    transport = None

    def __init__(self, config, settings):
        self.config, self.settings = config, settings
        self.golden = Golden(config.sensor)

    def resume(self):
        pass

    def program(self, config):
        pass

    def write_settings(self, writes):
        pass

    def __getitem__(self, name):
        return 0

    def frame(self):
        edges = source_edges(self.config, self.settings, self.golden.frames)
        return self.golden.frame(self.config, edges).beats[0]


def test_depth_of_counts():
    config = CONFIG.with_sensor(counts=1).with_frame(format="counts", pulses=40)
    settings = source_settings(config, scene_of(config, "flat:5"), 0.0)
    session = Session(Predicted(config, settings), config, settings)
    session.frame()
    depth_m = session.depth().depth_m[:, :, 0]
    assert np.nanmedian(depth_m) == pytest.approx(5, abs=2 * config.tick_m)


def test_a_wrong_word_is_found(driver):
    settings = source_settings(CONFIG, scene_of(CONFIG, "flat:5"), 50.0)
    session = Session(driver, CONFIG, settings)
    session.frame()
    session.settings = evolve(settings, background=settings.background + 1)
    with pytest.raises(Mismatch, match=r"frame \d, beat"):
        for _ in range(5):
            session.frame()


AT_100_MHZ = ["--set", "clock_mhz=100"]


@pytest.mark.parametrize(
    "arguments, says",
    [
        ([], "give either --port DEVICE or --simulate"),
        (["--simulate", "--port", "/dev/null"], "give either"),
        (["--port", "/dev/none"], "cannot be opened"),
        (["--simulate", "--frames", "0"], "frames = 0"),
        (["--port", "/dev/none", "--netlist"], "netlist: goes with --simulate only"),
        (
            ["--simulate", "--baud", "100000000", *AT_100_MHZ],
            "baud = 100000000: must be an integer from 1526 to 25000000 (at 100 MHz)",
        ),
        (
            ["--simulate", "--baud", "1525", *AT_100_MHZ],
            "baud = 1525: must be an integer from 1526",
        ),
    ],
)
def test_bad_input(arguments, says):
    done = command("emulate", *arguments)
    assert done.exit_code == 2 and says in done.output
