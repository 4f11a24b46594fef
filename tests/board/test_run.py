# SPDX-License-Identifier: Apache-2.0
"""`coincid emulate`: a scene on the emulator, simulated behind its pins; a mismatch is found; bad
ports are refused.
"""

from contextlib import nullcontext
from types import SimpleNamespace

import numpy as np
import pytest
from attrs import evolve

from coincid.board import driver as board_driver
from coincid.board import run, serial_transport, simulated
from coincid.board.driver import EmulatorDriver
from coincid.board.parameters import SPREAD_MAX
from coincid.board.run import RECOVERIES_MAX, Session, Tally, source_settings
from coincid.board.serial_link import BAUD
from coincid.board.serial_transport import SerialTransport
from coincid.board.simulated import PATIENCE_S, SimulatedPort
from coincid.board.source_model import source_edges
from coincid.host.transport import DeviceResetError, LinkError
from coincid.lab.setup import scene_of
from coincid.model.contract.config import changes_of_text, load_config
from coincid.model.depth.histograms import by_subgroup
from coincid.model.depth.quality import OTHER_SURFACE_M
from coincid.model.golden.frame import Golden
from coincid.model.scenes.catalogue import load_scene
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
    out = tmp_path / "of" / "today"
    done = command(f"emulate --simulate --frames 2 --scene flat:5 --out {out} {given}")
    assert done.exit_code == 0, done.output
    assert "2 frames" in done.output and "all as the golden model predicts" in done.output
    assert (out / "depth.png").stat().st_size > 1000


def test_the_picture_is_drawn_while_frames_come(driver, tmp_path, monkeypatch):
    """With no time between two pictures: one per frame, each with all frames so far."""
    titles = []
    monkeypatch.setattr(run, "REDRAW_S", 0.0)
    monkeypatch.setattr(
        run, "depth_row", lambda path, panels, truth_m, **_: titles.append(panels[0].title)
    )
    run.emulate(driver, CONFIG, scene_of(CONFIG, "flat:5"), tmp_path, klux=50.0, frames=3)
    assert titles == [f"{n} frames of the emulator" for n in (1, 2, 3)]


def test_while_frames_come_fast_a_picture_is_drawn_once_a_second(monkeypatch, tmp_path):
    """Always after the last frame, too. The clock goes on by 0.3 s at each reading."""
    readings, titles = iter(range(1000)), []
    clock = SimpleNamespace(monotonic=lambda: 0.3 * next(readings))
    monkeypatch.setattr(run, "time", clock)
    monkeypatch.setattr(run.Session, "_now", lambda session: (0.0, 0.0))
    monkeypatch.setattr(
        run, "depth_row", lambda path, panels, truth_m, **_: titles.append(panels[0].title)
    )
    scene = scene_of(CONFIG, "flat:5")
    settings = source_settings(CONFIG, scene, 50.0)
    run.emulate(Predicted(CONFIG, settings), CONFIG, scene, tmp_path, klux=50.0, frames=10)
    # Four readings after the last picture: 1.2 s. To begin anew is a reading, too.
    assert titles == [f"{n} frames of the emulator" for n in (4, 8, 10)]


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


@pytest.mark.parametrize(("metres", "klux"), [(6, 50.0), (4, 51.0), (8, 20.0), (10, 0.0)])
def test_a_scene_as_settings(metres, klux):
    """Probabilities are the nearest that the source can have."""
    config = load_config("emulator")
    scene = scene_of(config, f"flat:{metres},0.4")
    settings = source_settings(config, scene, klux)
    tick = int(2 * metres / 299_792_458 / config.tick_s)
    cycle_s = 1e-6 / config.clock_mhz
    assert (settings.tick == tick).all()
    assert (settings.level == round((1 - np.exp(-0.613 * (4 / metres) ** 2)) * 256)).all()
    rate = 1.226e6 * klux / 50 * cycle_s
    assert (settings.background == round((1 - np.exp(-rate)) * 65536)).all()
    assert settings.dead_cycles == 1


@pytest.mark.parametrize(("klux", "distance_m"), [(1e7, 4.0), (0.0, 0.05)])
def test_light_beyond_what_a_source_can_make_is_the_most_that_it_can(klux, distance_m):
    """Of the sun or of the laser; and so is a longer spread than the longest one."""
    config = load_config("emulator")
    settings = source_settings(config, scene_with([distance_m]), klux, spread=SPREAD_MAX + 1)
    most = {"background": settings.background, "level": settings.level}
    assert (most["background" if klux else "level"] == (65535 if klux else 255)).all()
    assert settings.spread == SPREAD_MAX
    settings.register_writes(config.sensor)


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


LIT = source_settings(CONFIG, scene_of(CONFIG, "flat:5"), 50.0)


class Changing(Predicted):
    """The same, with one frame that is changed by a function."""

    change = staticmethod(lambda beats: beats)

    def frame(self):
        return self.change(super().frame())


@pytest.mark.parametrize("at", [0, 3, -1])
def test_a_wrong_word_is_told_with_its_place_and_both_words(at):
    """First what came, then what the golden model says; a frame may also be too short or too
    long.
    """
    (beats,) = Golden(CONFIG.sensor).frame(CONFIG, source_edges(CONFIG, LIT, 0)).beats
    place = range(len(beats))[at]
    driver = Changing(CONFIG, LIT)
    wrong = beats.copy()
    wrong[place] ^= 1
    word, wanted = (f"{int(words[place]):#018x}" for words in (wrong, beats))
    more = np.append(beats, wrong[place])
    cases = [
        (wrong, f"beat {place}: {word}, golden model {wanted}"),
        (beats[:-1], f"beat {len(beats) - 1}: nothing, golden model {int(beats[-1]):#018x}"),
        (more, f"beat {len(beats)}: {word}, golden model nothing"),
    ]
    for came, told in cases:
        driver.change = lambda _, came=came: came
        session = Session(driver, CONFIG, LIT)
        with pytest.raises(Mismatch, match=f"^frame 0, {told}$"):
            session.frame()
        assert session.tally.frames == 0


class Clock:
    """A clock of which each reading adds a second, and the port of a line with another clock."""

    def __init__(self):
        self.seconds = 0

    def monotonic(self):
        self.seconds += 1
        return float(self.seconds)

    @property
    def port(self):
        return self

    def now(self):
        return 1e-3 * self.seconds


def test_a_tally_has_the_time_of_both_clocks_since_the_first_start(monkeypatch):
    """What comes before the first frame does not count; words are those of all frames."""
    clock = Clock()
    monkeypatch.setattr(run, "time", clock)
    driver = Predicted(CONFIG, LIT)
    driver.transport = clock
    session = Session(driver, CONFIG, LIT)
    clock.seconds += 1000
    beats = []
    for frames in (1, 2, 3):
        beats.append(session.frame())
        tally = session.tally
        assert tally.frames == frames and tally.beats == sum(map(len, beats))
        assert tally.seconds == frames
        assert tally.seconds_on_line == pytest.approx(1e-3 * frames)
        assert tally.recoveries == 0


class Stalling(Predicted):
    """The same, of which each reading of the stalls gives the next of these numbers."""

    buffer_beats = 256

    def __getitem__(self, name):
        assert name == "stalls"
        return self.stalls.pop(0)


def test_only_a_buffer_that_was_full_in_this_session_is_an_error():
    """It may have been full before, and other sessions may have waited for it."""
    driver = Stalling(CONFIG, LIT)
    driver.stalls = [7, 7, 7, 8]
    session = Session(driver, CONFIG, LIT)
    session.frame()
    session.frame()
    told = "^frame.pulses = 8: the frame buffer of 256 beats was full; must be fewer$"
    with pytest.raises(InputError, match=told):
        session.frame()
    assert session.tally.frames == 2


@pytest.mark.parametrize("number", [255, 256, 0xFFFF])
def test_a_frame_of_any_number_is_as_predicted(number):
    """The number has 16 bits, and begins anew behind the last one."""
    driver = Changing(CONFIG, LIT)
    driver.golden.frames = number
    session = Session(driver, CONFIG, LIT)
    beats = [session.frame() for _ in range(3)]
    numbers = [number, number + 1, number + 2]
    assert [int(of[0]) >> 32 & 0xFFFF for of in beats] == [n & 0xFFFF for n in numbers]
    driver.change = lambda beats: beats[:-1]
    with pytest.raises(Mismatch, match=f"^frame {number + 3 & 0xFFFF}, beat"):
        session.frame()


class Losing(Predicted):
    """The same, whose line fails: `frames` and `rests` are numbers of failures to come."""

    frames = rests = programmed = 0

    def resume(self):
        if self.rests:
            self.rests -= 1
            raise LinkError("no answer")

    def program(self, config):
        self.programmed += 1

    def frame(self):
        if self.frames:
            self.frames -= 1
            raise DeviceResetError("reset") if self.frames % 2 else LinkError("no answer")
        return super().frame()


class Emptied(Stalling):
    """The same, which is reset in its second frame."""

    def frame(self):
        if self.golden.frames == 1:
            self.golden.frames = 0
            raise DeviceResetError("reset")
        return super().frame()


@pytest.mark.parametrize("later", [0, 3])
def test_after_a_reset_the_stalls_are_counted_from_what_they_are_then(later):
    """They were more before it; a buffer that is full after it is an error, too."""
    driver = Emptied(CONFIG, LIT)
    driver.stalls = [7, 7, 0, 0, later]
    session = Session(driver, CONFIG, LIT)
    session.frame()
    session.frame()
    assert (session.tally.frames, session.tally.recoveries) == (2, 1)
    driver.golden.frames = 2
    with pytest.raises(InputError, match="was full") if later else nullcontext():
        session.frame()


@pytest.mark.parametrize("failures", range(RECOVERIES_MAX))
def test_a_session_recovers_from_each_failure_and_counts_it(failures):
    """It programs the emulator anew each time; failures of the recovery itself are not counted."""
    driver = Losing(CONFIG, LIT)
    session = Session(driver, CONFIG, LIT)
    driver.frames, driver.rests = failures, failures
    session.frame()
    assert (session.tally.frames, session.tally.recoveries) == (1, failures)
    assert driver.programmed == 1 + failures
    session.frame()
    assert (session.tally.frames, session.tally.recoveries) == (2, failures)


def test_a_session_gives_up_after_some_failures_in_a_row():
    driver = Losing(CONFIG, LIT)
    session = Session(driver, CONFIG, LIT)
    driver.frames = RECOVERIES_MAX
    with pytest.raises(LinkError, match=f"^no whole frame in {RECOVERIES_MAX} tries$"):
        session.frame()
    driver.frames, driver.rests = 1, RECOVERIES_MAX
    told = f"^the emulator does not recover in {RECOVERIES_MAX} tries$"
    with pytest.raises(LinkError, match=told):
        session.frame()
    assert session.tally.frames == 0
    session.frame()
    assert session.tally.frames == 1


def test_what_the_emulator_does_not_have_is_refused():
    """A controller, of any subgroup, and pictures that follow each other."""
    automatic = CONFIG.with_settings(auto=np.arange(CONFIG.sensor.subgroups) == 1)
    with pytest.raises(InputError, match="^subgroup.auto = true: .* must be false$"):
        Session(Unused(), automatic, LIT)
    sensor = CONFIG.sensor
    moving = load_scene(np.full((3, sensor.rows, sensor.cols), 5.0), sensor.rows, sensor.cols)
    with pytest.raises(InputError, match="^scene: has 3 pictures, must have one for the emulator"):
        source_settings(CONFIG, moving, 0.0)


def test_the_picture_is_held_against_the_truth_of_its_scene(monkeypatch, tmp_path):
    """With the tolerance for coarse ticks; a frame is told when it has been checked."""
    drawn, told = [], []
    monkeypatch.setattr(run, "depth_row", lambda *given, **named: drawn.append((given, named)))
    scene = scene_of(CONFIG, "flat:5")
    settings = source_settings(CONFIG, scene, 50.0, seed=3)
    tally = run.emulate(
        Predicted(CONFIG, settings),
        CONFIG,
        scene,
        tmp_path / "new",
        klux=50.0,
        frames=3,
        seed=3,
        tell=lambda so_far: told.append((so_far.frames, so_far.beats > 0)),
    )
    assert told == [(1, True), (2, True), (3, True)] and tally.frames == 3
    ((path, (panel,), truth_m), named) = drawn[-1]
    assert path == tmp_path / "new" / run.DEPTH and path.parent.is_dir()
    assert panel.title == "3 frames of the emulator"
    assert np.array_equal(truth_m, scene.truth_m)
    assert named == {"tolerance_m": OTHER_SURFACE_M}


class Line:
    """Stands for a line that is used in a `with`."""

    def __enter__(self):
        return self

    def __exit__(self, *_):
        pass


@pytest.fixture
def told(monkeypatch):
    """Let `coincid emulate` run on nothing; return what its parts are given."""
    given = {}

    def note(name, result):
        def noted(*values, **named):
            given[name] = values, named
            return result

        return noted

    tally = Tally(frames=4, beats=321, recoveries=2, seconds=0.5, seconds_on_line=0.008)
    monkeypatch.setattr(simulated, "SimulatedPort", note("simulated", Line()))
    monkeypatch.setattr(serial_transport, "SerialPort", note("board", Line()))
    transport = SimpleNamespace(repeats=7)
    monkeypatch.setattr(serial_transport, "SerialTransport", note("transport", transport))
    monkeypatch.setattr(board_driver, "EmulatorDriver", note("driver", None))
    monkeypatch.setattr(run, "emulate", note("run", tally))
    return given


COUNTED = [
    "4 frames, 321 words, all as the golden model predicts",
    "8 frames per second; 7 requests repeated, 2 recoveries",
]


def test_what_a_session_counted_is_told_number_by_number(told, tmp_path):
    """In simulation, also the time of a frame by the clock of the line."""
    end = f"{tmp_path / run.DEPTH}"
    shown = command(f"emulate --simulate --scene flat:5 --out {tmp_path}").stdout.splitlines()
    assert shown == ["2 ms of simulated time per frame", *COUNTED, end]
    shown = command(f"emulate --port /dev/a --scene flat:5 --out {tmp_path}").stdout.splitlines()
    assert shown == [*COUNTED, end]


@pytest.mark.parametrize("line", ["--simulate", "--port /dev/a"])
def test_a_folder_that_cannot_be_is_told_before_a_line_is_opened(told, tmp_path, line):
    """Or an emulator is built, which takes minutes."""
    (tmp_path / "file").touch()
    done = command(f"emulate {line} --scene flat:5 --out {tmp_path}/file/below")
    assert done.exit_code == 2 and "cannot be written" in done.output
    assert not told


@pytest.mark.parametrize(("baud", "times"), [(25_000_000, 1), (5_000_000, 5), (100_000, 250)])
def test_a_slower_simulated_line_gets_as_much_more_patience(told, baud, times):
    command(f"emulate --simulate --scene flat:5 --set clock_mhz=100 --baud {baud}")
    (built, clock_mhz, library), _ = told["simulated"]
    assert (built.clocks_per_bit, clock_mhz, library) == (4 * times, 100, None)
    assert told["transport"][1] == {"patience_s": pytest.approx(PATIENCE_S * times)}


@pytest.mark.parametrize(("words", "baud"), [("", BAUD), ("--baud 9600", 9600)])
def test_a_board_has_its_own_rate_and_the_usual_patience(told, words, baud):
    command(f"emulate --port /dev/a --scene flat:5 {words}")
    assert told["board"] == (("/dev/a", baud), {})
    assert told["transport"][1] == {}


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
