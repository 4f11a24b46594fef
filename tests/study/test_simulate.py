# SPDX-License-Identifier: Apache-2.0
"""The main job: files, report, every beat checked, orientation of a letter F, behaviour after a
mismatch, waveform views.
"""

import io
import itertools
import json
import re
import sys
from types import SimpleNamespace

import numpy as np
import pytest
from attrs import evolve
from pywellen import Waveform
from rich.console import Console

from coincid.lab import long_frames
from coincid.lab.setup import Setup
from coincid.model.contract.config import parse_config
from coincid.model.contract.parameters import TOP
from coincid.model.depth.estimate import estimate_depth
from coincid.model.depth.quality import wrong_share
from coincid.model.golden.frame import Golden
from coincid.model.scenes.catalogue import load_scene
from coincid.study import pictures, progress, schemes, show, simulate
from coincid.study.schemes import SCHEMES
from coincid.study.simulate import (
    ANIMATION,
    DEPTH,
    DEPTHS,
    EVENTS,
    LIGHT,
    PAGE,
    PICTURES,
    REPORT,
    WAVES,
    settings_of,
    simulate_to_folder,
)
from coincid.tb import wave_views
from coincid.tb.rtl_errors import Mismatch

from ..command import command
from ..random_cases import SENSORS, configurations, drawn

# Sensors that other tests compile, too. Rows and columns differ, so that swapping them shows; the
# period covers the letter's 8 m.
LETTER = {"sensor": {"rows": 8, "cols": 16}, "frame": {"period": 40, "pulses": 60}}
SMALL = {"sensor": {"rows": 8, "cols": 8}, "frame": {"period": 60, "pulses": 4}}
# waveforms are slow to compile
SMALLEST = {"rows": 4, "cols": 4, "subgroup": [4, 4], "phases": 4, "coarse_bits": 9}
FRAMES = 3  # frames in which the controller settles
# frame of the result file that stands for each scheme
SHOWN = {"off": 0, "fixed": 1, "auto": 1 + FRAMES}


def run(out, document=SMALL, scene="flat:5,0.4", threshold=None, waves=False, **setup):
    """Return the report, the arrays of the result and the lines of the console."""
    console = Console(file=io.StringIO(), width=100)
    setup = Setup.of(scene, **document, **{"klux": 5.0, "engine": "golden"} | setup)
    report = simulate_to_folder(
        setup, out=out, console=console, settling=FRAMES, threshold=threshold, waves=waves
    )
    return report, dict(np.load(out / EVENTS)), console.file.getvalue()


@pytest.fixture
def no_pictures(monkeypatch):
    """Leave out the pictures, which take most of the time of a small run."""
    monkeypatch.setattr(simulate, "_light_picture", lambda *_: None)
    monkeypatch.setattr(pictures, "save_figure", lambda *_: None)


@pytest.fixture
def undrawn(no_pictures, monkeypatch):
    """Leave out the page, too."""
    monkeypatch.setattr(simulate, "_write_report_page", lambda *_: False)


@pytest.mark.usefixtures("undrawn")
@pytest.mark.parametrize("engine", ["golden", "sliced"])
def test_the_time_of_a_report_is_that_between_two_looks_at_the_clock(engine, tmp_path, monkeypatch):
    clock = itertools.count(1000.0, 2.0)
    monkeypatch.setattr(simulate, "time", SimpleNamespace(perf_counter=lambda: next(clock)))
    report, _, told = run(tmp_path, engine=engine)
    assert report["seconds"] == 2.0
    assert report["cycles_per_s"] == report["cycles"] / 2
    assert "in 2.0 s" in told


def test_report_agrees_with_the_events(tmp_path):
    report, arrays, told = run(tmp_path)
    assert json.loads((tmp_path / REPORT).read_text(encoding="utf-8")) == json.loads(
        json.dumps(report)
    )
    assert report["events"] == len(arrays["pulse"]) == arrays["stored"].sum()
    assert report["dropped"] == arrays["dropped"].sum()
    assert report["mismatches"] == 0
    assert report["configuration"]["frame"]["pulses"] == 4
    assert list(SHOWN) == list(SCHEMES)
    for name, k in SHOWN.items():
        assert report[f"events_{name}"] == np.sum(arrays["pulse"] // 4 == k)
    assert f"{report['events_fixed']:,}" in told
    assert {path.name for path in tmp_path.iterdir()} == {
        *PICTURES,
        LIGHT,
        EVENTS,
        DEPTH,
        PAGE,
        REPORT,
    }


@pytest.fixture
def without_bokeh(monkeypatch):
    """The extra `explore` is not installed."""
    of_page = {f"{show.__name__}.{name}" for name in ("figures", "report")}
    for name in [*sys.modules]:
        if name.partition(".")[0] == "bokeh" or name in of_page:
            monkeypatch.delitem(sys.modules, name)
    for name in of_page:
        monkeypatch.delattr(show, name.rpartition(".")[2], raising=False)
    monkeypatch.setitem(sys.modules, "bokeh", None)


def test_without_the_library_of_the_page_all_else_is_written(without_bokeh, tmp_path):
    """And a page of an earlier run is removed."""
    (tmp_path / PAGE).write_text("of an earlier run", encoding="utf-8")
    report, _, told = run(tmp_path)
    assert report["mismatches"] == 0 and PAGE not in told
    written = {path.name for path in tmp_path.iterdir()}
    assert written == {*PICTURES, LIGHT, EVENTS, DEPTH, REPORT}


def test_without_the_library_of_the_page_an_engine_can_be_prepared(without_bokeh, monkeypatch):
    """A run on the RTL ends with the error of its preparation."""
    prepared = []
    monkeypatch.setattr("coincid.tb.play.prepare", lambda *given: prepared.append(given))
    sensor, view = parse_config(SMALL).sensor, object()
    simulate._prepare("sliced", sensor, True, view)
    simulate._prepare("golden", sensor, False, None)
    assert prepared == [("sliced", sensor, True, view)]


@pytest.mark.usefixtures("no_pictures")
def test_a_scene_that_moves(tmp_path):
    """There are as many frames as pictures, and the depth of all of them is written; the schemes
    are compared in the last one. A still scene leaves no animation of an earlier run.
    """
    walls_m = np.stack([np.full((8, 8), wall_m) for wall_m in (3.0, 4.0)])
    setup = Setup.of(load_scene(walls_m, 8, 8), **SMALL, klux=0.0)
    told = Console(file=io.StringIO())
    report = simulate_to_folder(setup, out=tmp_path, console=told)
    assert report["frames"] == len(report["wrong_share_frames"]) == 2
    assert report["wrong_share_auto"] == report["wrong_share_frames"][-1]
    written = np.load(tmp_path / DEPTHS)
    assert np.array_equal(written["truth_m"], walls_m)
    assert np.array_equal(np.load(tmp_path / DEPTH)["depth_m"], written["depth_m"][-1])
    assert (tmp_path / ANIMATION).exists()
    run(tmp_path)
    assert not (tmp_path / DEPTHS).exists() and not (tmp_path / ANIMATION).exists()


@pytest.mark.usefixtures("undrawn")
def test_frames_see_the_same_light_under_their_own_thresholds(tmp_path):
    document = SMALL | {"subgroup": {"threshold": 3, "auto": True}}
    report, arrays, _ = run(tmp_path, document, klux=50.0)
    assert report["threshold_off"] == [1]
    assert report["threshold_fixed"] == [3]  # set by the configuration
    assert report["threshold_auto"] == arrays["threshold_used"][-1].tolist()
    # the same edges, whatever the threshold
    assert arrays["photons"][1].tolist() == arrays["photons"][-1].tolist()
    # the controller settles on other photons
    assert arrays["photons"][1].tolist() != arrays["photons"][-2].tolist()
    assert arrays["threshold_used"][2].tolist() == [3]  # the initial value
    assert 1 in arrays["count"][arrays["pulse"] // 4 == 0]
    assert (arrays["count"][arrays["pulse"] // 4 == 1] >= 3).all()


@pytest.mark.usefixtures("undrawn")
def test_fixed_threshold_is_named_or_the_best_of_all(tmp_path):
    document = SMALL | {"frame": {"period": 60, "pulses": 50}}
    best, *_ = run(tmp_path / "best", document, klux=50.0)
    for threshold in (1, 4):
        report, *_ = run(tmp_path / f"{threshold}", document, klux=50.0, threshold=threshold)
        assert report["threshold_fixed"] == [threshold]
        assert best["wrong_share_fixed"] <= report["wrong_share_fixed"]


@pytest.mark.long
def test_the_controller_saves_bandwidth_on_the_default_scene(tmp_path):
    """Sun beside shade on a link of 8 Gbit/s: the case that the job demonstrates."""
    assert command("sim --engine golden --out", tmp_path).exit_code == 0
    report = json.loads((tmp_path / REPORT).read_text(encoding="utf-8"))
    assert report["configuration"]["frame"]["link_gbps"] == 8.0
    assert report["configuration"]["frame"]["format"] == "compact"
    # The fixed threshold is the best one, which is chosen with the truth.
    assert report["wrong_share_auto"] < report["wrong_share_fixed"] + 0.005
    assert report["wrong_share_auto"] < 0.8 * report["wrong_share_off"]
    assert report["load_auto"] < 0.8 * report["load_fixed"]
    assert (
        report["wrong_share_auto_peak"]
        < report["wrong_share_fixed_peak"]
        < report["wrong_share_off_peak"]
    )
    assert len(set(report["threshold_auto"])) > 1
    assert report["load_auto"] <= 1.1


def test_same_seed_same_bytes(tmp_path):
    for name in "ab":
        run(tmp_path / name, seed=7)
    for file in (*PICTURES, LIGHT, EVENTS):
        assert (tmp_path / "a" / file).read_bytes() == (tmp_path / "b" / file).read_bytes()
    # Bokeh goes on counting its models in a process.
    a, b = (
        re.sub(r'"p\d+"', "", (tmp_path / name / PAGE).read_text(encoding="utf-8")) for name in "ab"
    )
    assert a == b


@pytest.mark.usefixtures("undrawn")
def test_another_seed_gives_other_events(tmp_path):
    for seed in (7, 8):
        run(tmp_path / str(seed), seed=seed)
    assert (tmp_path / "7" / EVENTS).read_bytes() != (tmp_path / "8" / EVENTS).read_bytes()


@pytest.mark.usefixtures("undrawn")
def test_letter_f_comes_out_as_it_went_in(tmp_path):
    report, arrays, _ = run(tmp_path, LETTER, "letter-f", engine="sliced")
    for name in SCHEMES:
        assert report[f"wrong_share_{name}"] < 0.1, name  # wrongly oriented: a fifth
    assert report["checked"] > report["events"]
    depth_m = estimate_depth(arrays, parse_config(LETTER), frame=1).depth_m[:, :, 0]
    assert (
        wrong_share(depth_m, load_scene("letter-f", 8, 16).truth_m) == report["wrong_share_fixed"]
    )
    _, golden, _ = run(tmp_path / "golden", LETTER, "letter-f")
    for name, array in arrays.items():
        assert np.array_equal(array, golden[name]), name


@pytest.mark.parametrize("given", ["", "--threshold 2 --set dither_bits=3 --set controller=0"])
def test_a_long_simulation_leaves_the_same_files(given, tmp_path, monkeypatch, request):
    """The pictures are drawn for the first case only."""
    if given:
        request.getfixturevalue("undrawn")
    words = "sim --engine golden --scene five-objects --set rows=8 --set cols=8 --pulses 20"
    usual = tmp_path / "usual"
    long = tmp_path / "long"
    assert command(f"{words} {given} --out {usual}").exit_code == 0
    monkeypatch.setattr(long_frames, "EDGES_MAX", 0)
    assert command(f"{words} {given} --out {long}").exit_code == 0
    names = {EVENTS, DEPTH} if given else {*PICTURES, LIGHT, EVENTS, DEPTH}
    for name in names:
        assert (usual / name).read_bytes() == (long / name).read_bytes(), name
    reports = [json.loads((out / REPORT).read_text(encoding="utf-8")) for out in (usual, long)]
    differing = {name for name in reports[0] if reports[0][name] != reports[1][name]}
    assert reports[0].keys() == reports[1].keys() and differing <= {"seconds", "cycles_per_s"}


@pytest.mark.usefixtures("no_pictures")
def test_the_report_of_a_long_simulation_shows_the_pulses_that_are_kept(tmp_path, monkeypatch):
    monkeypatch.setattr(long_frames, "EDGES_MAX", 0)
    monkeypatch.setattr(long_frames, "EDGES_SHOWN_MAX", 8000)
    words = "sim --engine golden --scene flat:5,0.4 --set rows=8 --set cols=16 --pulses 400"
    assert command(f"{words} --out {tmp_path}").exit_code == 0
    page = (tmp_path / PAGE).read_text(encoding="utf-8")
    pulses = int(re.search(r'"pulses",(\d+)', page)[1])
    assert 1 < pulses < 400


@pytest.mark.usefixtures("no_pictures")
def test_a_report_page_of_too_many_events_is_left_out_and_told(tmp_path, monkeypatch):
    monkeypatch.setattr(simulate, "PAGE_EVENTS_MAX", 10)
    (tmp_path / PAGE).write_text("of an earlier run", encoding="utf-8")
    words = "sim --engine golden --scene flat:5,0.4 --set rows=8 --set cols=8 --pulses 20"
    result = command(f"{words} --out {tmp_path}")
    assert result.exit_code == 0
    assert "report.html is left out: its frames have" in result.stdout
    assert not (tmp_path / PAGE).exists()
    assert (tmp_path / REPORT).exists()


@pytest.mark.usefixtures("undrawn")
def test_spad_gate_leaves_fewer_edges(tmp_path):
    # 5 m: cycle 16
    document = SMALL | {"subgroup": {"gating": True, "gate_start": 14, "gate_len": 8}}
    logic, switched = (run(tmp_path, document, klux=50.0, spad_gate=gate) for gate in (False, True))
    assert 0 < switched[0]["edges"] < logic[0]["edges"]
    for _, arrays, _ in (logic, switched):
        assert ((arrays["stamp"] // 32 >= 14) & (arrays["stamp"] // 32 < 22)).all()


def test_a_difference_stops_the_run_and_is_told(tmp_path, monkeypatch):
    class Wrong(Golden):
        """A golden model that expects one pixel more in the count of the last frame's first
        event.
        """

        def frame(self, *arguments):
            trace = super().frame(*arguments)
            if self.frames == 3:
                trace.beats[0][1] += np.uint64(1 << 23)
            return trace

    out = tmp_path / "out"
    out.mkdir()
    of_a_run = {*PICTURES, LIGHT, EVENTS, DEPTH, PAGE}
    for name in of_a_run:
        (out / name).write_text("of an earlier run", encoding="utf-8")
    given = "--set rows=8 --set cols=8 --set period=60 --set pulses=4 --set format=id"
    words = f"sim --engine icarus --scene flat:5,0.4 {given} --out {out}"
    monkeypatch.setattr(schemes, "Golden", Wrong)
    result = command(words)
    assert (result.exit_code, result.stderr.count("\n")) == (1, 1)
    for word in (
        "frame 2",
        "subgroup 0",
        "pulse 0",
        "cycle",
        "count is",
        "golden model",
        "sim.log",
    ):
        assert word in result.stderr
    report = json.loads((out / REPORT).read_text(encoding="utf-8"))
    assert report["mismatches"] == 1 and report["mismatch"] in result.stderr
    assert of_a_run.isdisjoint(path.name for path in out.iterdir())
    assert (out / "sim.log").exists()


@pytest.mark.usefixtures("undrawn")
def test_only_waveforms_of_an_earlier_run_are_deleted(tmp_path):
    """Not the files of an export, whose names begin like those of a waveform."""
    exported = [tmp_path / f"{TOP}{suffix}" for suffix in (".v", ".sdc", ".core")]
    waves = [tmp_path / name for name in WAVES]
    for path in (*exported, *waves):
        path.write_text("", encoding="utf-8")
    run(tmp_path)
    assert all(path.exists() for path in exported)
    assert not any(path.exists() for path in waves)


@pytest.mark.usefixtures("undrawn")
def test_a_waveform_is_told_with_its_views_and_stays(tmp_path, monkeypatch):
    """They are the last of the results; those of an earlier run are replaced, not deleted."""
    usual, viewed = simulate.play_runs, []
    for name in WAVES:
        (tmp_path / name).write_text("a wave", encoding="utf-8")

    def play(*given, **how):
        return evolve(usual(*given, **how), wave=tmp_path / WAVES[0])

    def views(path):
        viewed.append(path)
        return [path.with_name(name) for name in WAVES[1:]]

    monkeypatch.setattr(simulate, "play_runs", play)
    monkeypatch.setattr(wave_views, "views", views)
    *_, told = run(tmp_path)
    paths = [tmp_path / name for name in WAVES]
    assert told.splitlines()[-1].split()[-3:] == [str(path) for path in paths]
    assert viewed == paths[:1] and all(path.exists() for path in paths)


@pytest.mark.long
@pytest.mark.parametrize("simulator", ["icarus", "verilator"])
def test_views_name_signals_of_the_waveform(tmp_path, simulator):
    *_, told = run(tmp_path, SMALL | {"sensor": SMALLEST}, engine=simulator, waves=True)
    assert {path.name for path in tmp_path.glob(f"{TOP}.*")} == set(WAVES)
    fst = tmp_path / f"{TOP}.fst"
    widths = {variable.full_name: variable.bitwidth for variable in Waveform(str(fst)).all_vars()}
    assert (widths[f"{TOP}.m_axis_tdata"], widths[f"{TOP}.spad_0"], widths[f"{TOP}.laser"]) == (
        64,
        16 * 4,
        1,
    )

    gtkwave = (tmp_path / f"{TOP}.gtkw").read_text(encoding="utf-8").splitlines()
    start = int(gtkwave[1].removeprefix("[timestart] "))
    laser = next(v for v in Waveform(str(fst)).all_vars() if v.full_name == f"{TOP}.laser")
    assert dict(laser.tv)[start] == 1 and not any(v for at, v in laser.tv if at < start)
    shown = [line for line in gtkwave if line.startswith(TOP)]
    assert [line[1:] for line in gtkwave if line.startswith("-")] == [
        title for title, _, _ in wave_views.BLOCKS
    ]
    blocks = [
        (f"{TOP}.{scope}".rstrip("."), signals.split()) for _, scope, signals in wave_views.BLOCKS
    ]
    wanted = [f"{scope}.{name}" for scope, names in blocks for name in names]
    assert shown == [
        f"{path}[{widths[path] - 1}:0]" if widths[path] > 1 else path for path in wanted
    ]
    surfer = (tmp_path / f"{TOP}.sucl").read_text(encoding="utf-8").splitlines()
    assert [line.split()[1] for line in surfer if line.startswith("variable_add")] == wanted
    for suffix in (".fst", ".gtkw", ".sucl"):
        assert f"{TOP}{suffix}" in told


@pytest.mark.parametrize(
    ("compiled", "told"),
    [(False, "photons (compiling the models, first run only)"), (True, "photons")],
)
def test_a_stage_that_compiles_says_so(compiled, told, monkeypatch):
    monkeypatch.setattr(progress, "is_compiled", lambda module: compiled)
    assert progress.first_time("photons", "coincid.model.light.photons") == told


class Ended(Exception):
    """The frames would be played."""


@pytest.fixture
def unplayed(monkeypatch):
    """Run simulations up to their frames, which raise an error; return their told progress."""
    told = []

    class Recording(progress.Bar):
        def stage(self, name, total=None):
            super().stage(name, total)
            told.append((name, total))

        def done(self, amount, total=None):
            super().done(amount, total)
            told.append(amount)

    def unplayed(out, document, scene="flat:5", error=Ended, **setup):
        def play(*given, progress, **options):
            progress(77)
            raise error

        monkeypatch.setattr(simulate, "Bar", Recording)
        runs = SimpleNamespace(threshold=2)
        monkeypatch.setattr(simulate, "_golden_runs", lambda *given: runs)
        monkeypatch.setattr(simulate, "play_runs", play)
        with pytest.raises(type(error) if isinstance(error, Exception) else error):
            run(out, document, scene, **setup)
        return told

    return unplayed


@pytest.mark.parametrize(
    ("controller", "pictures", "frames"), [(1, 1, 2 + 3), (0, 1, 2), (1, 3, 2 + 3), (0, 3, 1 + 3)]
)
def test_the_progress_of_a_simulation_is_that_of_all_frames_of_all_schemes(
    unplayed, tmp_path, controller, pictures, frames
):
    """In cycles, gaps included."""
    walls_m = np.full((pictures, 8, 8), 3.0)
    scene = load_scene(walls_m if pictures > 1 else walls_m[0], 8, 8)
    document = {
        "sensor": SMALL["sensor"] | {"controller": controller},
        "frame": SMALL["frame"] | {"gap": 10},
    }
    cycles = parse_config(document).frame_cycles
    assert cycles == 4 * 60 + 3 * 10
    expected = [(f"{frames} frames on golden", frames * cycles), 77]
    assert unplayed(tmp_path, document, scene) == expected


OF_COUNTS = {
    "sensor": {"rows": 8, "cols": 8, "counts": 1},
    "frame": {"pulses": 60, "format": "counts"},
}


@pytest.mark.parametrize(
    ("document", "gone"),
    [(SMALL, {DEPTHS, ANIMATION}), (OF_COUNTS, {DEPTHS, ANIMATION, "depth_peak.png"})],
)
def test_files_of_an_earlier_run_that_are_not_written_again_go_first(
    unplayed, tmp_path, document, gone
):
    names = {*PICTURES, LIGHT, EVENTS, DEPTH, PAGE, REPORT, DEPTHS, ANIMATION, "mine.txt"}
    for name in names:
        (tmp_path / name).write_text("of an earlier run", encoding="utf-8")
    unplayed(tmp_path, document)
    assert {path.name for path in tmp_path.iterdir()} == names - gone


def test_after_a_mismatch_only_the_report_is_left(unplayed, tmp_path):
    """And what is no result."""
    for name in (*PICTURES, LIGHT, EVENTS, DEPTH, PAGE, DEPTHS, ANIMATION, "sim.log"):
        (tmp_path / name).write_text("of an earlier run", encoding="utf-8")
    unplayed(tmp_path, SMALL, error=Mismatch("beat 3 differs"))
    assert {path.name for path in tmp_path.iterdir()} == {REPORT, "sim.log"}
    report = json.loads((tmp_path / REPORT).read_text(encoding="utf-8"))
    assert (report["mismatches"], report["mismatch"]) == (1, "beat 3 differs")


def test_a_report_tells_of_what_its_frames_were_made(unplayed, tmp_path):
    """In the units of its keys; times and rates of frames with gaps, of 60 cycles in 4 periods."""
    frame = SMALL["frame"] | {"clock_mhz": 400.0, "gap": 90}
    given = {"klux": "5|20", "background": "even", "seed": 7, "spad_gate": True}
    document = {"sensor": SMALL["sensor"] | {"phases": 16}, "frame": frame}
    unplayed(tmp_path, document, error=Mismatch("it differs"), **given)
    report = json.loads((tmp_path / REPORT).read_text(encoding="utf-8"))
    words = {"scene": "flat:5", "engine": "golden", "view": "polyphase", "frames": FRAMES}
    assert {name: report[name] for name in words | given} == words | given
    frame_s = (4 * 60 + 3 * 90) / 400e6
    numbers = {
        "clock_mhz": 400.0,
        "tick_s": 1 / 400e6 / 16,
        "range_m": 299_792_458 / 2 * 60 / 400e6,
        "frames_per_s": 1 / frame_s,
        "pulse_nj": 10e-3 * frame_s / 4 * 1e9,
    }
    assert {name: report[name] for name in numbers} == pytest.approx(numbers)
    assert report["configuration"]["frame"]["gap"] == 90


@pytest.mark.parametrize(
    ("shares", "least"), [((0.9, 0.3, 0.8), None), ((0.9, 0.31, None), 0.31), ((None, None), 1.0)]
)
def test_a_simulation_says_what_would_help_where_no_scheme_leaves_a_useful_picture(
    monkeypatch, shares, least
):
    """Of the last picture that was played, with the longest window."""
    asked = []

    def sentence(wrong, setup, window, workers):
        asked.append((wrong, float(setup.seen.truth_m[0, 0]), window, setup.config.frames))
        return "what would help"

    monkeypatch.setattr(simulate, "useless_sentence", sentence)
    walls_m = np.array([3.0, 4.0, 5.0])[:, None, None] * np.ones((3, 8, 16))
    setup = Setup.of(load_scene(walls_m, 8, 16), **LETTER, engine="sliced", estimators=("maximum",))
    config = setup.config.with_settings(window=np.array([7, 9]))
    names = list(SCHEMES)[: len(shares)]
    report = {f"wrong_share_{name}": one for name, one in zip(names, shares, strict=True)}
    console = Console(file=io.StringIO(), width=100)
    simulate._tell_if_useless(console, setup, config, report | {"frames": 2}, names)
    assert asked == ([] if least is None else [(least, 4.0, 9, config.frames)])
    assert console.file.getvalue() == ("" if least is None else "what would help\n")


@pytest.mark.parametrize("sensor", SENSORS)
def test_the_configuration_in_a_report_repeats_the_run(sensor):
    """Settings of every kind, also those that differ between subgroups."""
    for config in drawn(configurations(SENSORS[sensor]), 6):
        told = json.loads(json.dumps(settings_of(config)))
        again = parse_config({"sensor": told["sensor"], "frame": told["frame"]})
        again = again.with_settings(**told["subgroup"])
        assert again.sensor == config.sensor and again.frame == config.frame
        assert again.register_writes() == config.register_writes()


@pytest.mark.parametrize(
    ("sensor", "derived"),
    [
        ({"controller": 0, "counts": 0}, []),
        ({"controller": 1, "counts": 0}, ["auto_bounds", "capacity"]),
        ({"controller": 0, "counts": 1}, ["search_pulses"]),
        ({"controller": 1, "counts": 1}, ["auto_bounds", "capacity", "search_pulses"]),
    ],
)
def test_what_follows_from_a_configuration_is_told_of_sensors_that_have_it(sensor, derived):
    """Though nobody has set it."""
    config = parse_config({"sensor": {"rows": 8, "cols": 8} | sensor})
    frame = settings_of(config)["frame"]
    for name in ("auto_bounds", "capacity", "search_pulses"):
        follows = np.asarray(getattr(config, name)).tolist() if name in derived else None
        assert frame[name] == follows, name
