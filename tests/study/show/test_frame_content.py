# SPDX-License-Identifier: Apache-2.0
"""Maps of a frame in a scene with several targets per pixel, in an array that is no square."""

import re
from copy import copy
from types import SimpleNamespace

import numpy as np
import pytest

from coincid.lab import long_frames
from coincid.lab.outcomes import Run
from coincid.lab.setup import Setup
from coincid.model.contract.pixels import pixel_table
from coincid.model.scenes.catalogue import load_scene
from coincid.model.scenes.scene import Scene
from coincid.model.shared.errors import InputError
from coincid.study.show import report
from coincid.study.show.figures import FATE_MARKS, REASON_MARKS, VERDICT_MARKS, map_scales
from coincid.study.show.frame_content import FrameView, seen_objects

ROWS, COLS, TARGETS = 8, 24, 3


@pytest.fixture(scope="module")
def scene():
    rng = np.random.default_rng(5)
    distance_m = rng.uniform(2, 9, (ROWS, COLS, TARGETS))
    distance_m[rng.random(distance_m.shape) < 0.3] = np.nan
    reflectivity = rng.uniform(0.05, 0.3, distance_m.shape)
    return Scene(name="random", distance_m=distance_m, reflectivity=reflectivity)


@pytest.fixture(scope="module")
def view(scene):
    setup = Setup.of(
        scene,
        sensor={"rows": ROWS, "cols": COLS, "fifo_depth": 1},
        frame={"pulses": 20, "link_gbps": 4.0},
        klux=20.0,
    )
    config = setup.config.with_settings(threshold=[1, 2, 3])
    return FrameView("a frame", Run(setup.but(config=config)).frame())


def test_reflectivity_is_that_of_the_nearest_target(scene, view):
    for row, col in np.ndindex(ROWS, COLS):
        targets = [
            (distance_m, share)
            for distance_m, share in zip(
                scene.distance_m[row, col], scene.reflectivity[row, col], strict=True
            )
            if not np.isnan(distance_m)
        ]
        shown = view.reflectivity[row, col]
        assert np.isnan(shown) if not targets else shown == min(targets)[1]


def test_light_of_a_pixel_is_that_of_all_its_targets(scene, view):
    config = view.config
    signal = 0.613 * scene.reflectivity / 0.4 * (4 / scene.distance_m) ** 2
    assert np.allclose(view.signal, np.nansum(signal, axis=2))
    period_s = config.period / (config.clock_mhz * 1e6)
    assert view.background.shape == (ROWS, COLS)
    assert np.all(view.background > 0) and np.all(view.background < 1.226e6 * 3 * period_s)


def test_numbers_of_subgroups_lie_on_their_pixels(view):
    subgroup = pixel_table(view.config.sensor).subgroup.reshape(ROWS, COLS)
    assert np.array_equal(view.threshold, 1.0 + subgroup)
    drops = np.bincount(subgroup.ravel(), view.drops.ravel()) / 64
    assert drops.sum() == view.numbers["dropped"] > 0
    assert np.array_equal(view.drops, drops[subgroup])
    for pixel in (0, 30, 77, 191):
        row, col = divmod(pixel, COLS)
        assert view.subgroup_of(row, col) == subgroup[row, col]
        of_pixel, of_subgroup = view.histogram(row, col)
        assert np.all(of_pixel <= of_subgroup)
        span = slice(*view.events.bounds[subgroup[row, col] :][:2])
        assert of_subgroup.sum() == len(view.events.stamp[span])


def test_events_lie_in_the_bins_of_their_arrivals():
    """Not of their time stamps; what is beyond either end lies in the first or the last bin."""
    arrival = np.array([-2.0, 0.0, 7.49, 7.5, 29.9, 30.0, 1e6])
    events = SimpleNamespace(arrival=arrival, stamp=np.arange(100, 107))
    bins_m = SimpleNamespace(tick_m=0.02)
    shown = SimpleNamespace(events=events, config=bins_m, histogram_bins=5)
    assert FrameView.event_bins(shown).tolist() == [0, 0, 0, 1, 3, 4, 4]


@pytest.fixture(scope="module")
def recorded():
    """Return the view of a scene of histograms, half of which are twice as bright."""
    counts = np.zeros((8, 8, 100))
    counts[:, :4, 40] = 20
    counts[:, 4:, 40] = 40
    scene = load_scene(counts, 8, 8, bin_ps=500.0, recorded_pulses=100)
    setup = Setup.of(scene, sensor={"rows": 8, "cols": 8}, frame={"pulses": 20, "frames": 2})
    run = Run(setup)
    return [FrameView(f"frame {number}", run.frame(number)) for number in range(2)]


def test_light_in_bins_is_shown(recorded):
    """Of recorded histograms and of ray-traced scenes, whose light has no targets."""
    view = recorded[0]
    assert view.signal == pytest.approx(np.repeat([[0.2] * 4 + [0.4] * 4], 8, axis=0))
    assert [(one.name, one.signal) for one in view.objects] == [
        ("darker half", pytest.approx(0.2)),
        ("brighter half", pytest.approx(0.4)),
    ]


def test_background_in_bins_is_shown_and_no_share_of_the_sun_is_told(recorded):
    """That of the histograms and that of the surroundings, per laser period of 500 ns."""
    counts = np.full((8, 8, 100), 2.0)
    counts[:, :, 40] += 40
    scene = load_scene(counts, 8, 8, bin_ps=500.0, recorded_pulses=100)
    for klux, more in ((0.0, 0.0), (50.0, 1.226e6 * 500e-9)):
        sensor = {"rows": 8, "cols": 8}
        setup = Setup.of(scene, sensor=sensor, frame={"pulses": 20}, klux=klux)
        view = FrameView("a frame", Run(setup).frame())
        assert view.background == pytest.approx(np.full((8, 8), 20.0 + more))
        assert view.numbers["sun_share"] is None


def test_a_report_has_the_periods_the_gates_and_the_returns_of_all_pixels():
    """A period has the number subgroup * pulses + pulse, of the pulses that are kept."""
    setup = Setup.of(
        "two-returns:3,6",
        sensor={"rows": 8, "cols": 16},
        frame={"pulses": 8, "gate_every": 2, "gate_steps": 3, "gate_step": 7},
        klux=5.0,
    )
    config = setup.config.with_settings(
        gating=[True, False],
        gate_start=[9, 4],
        gate_len=60,
        coincidence=[True, False],
        threshold=2,
    )
    view = FrameView("a frame", Run(setup.but(config=config)).frame())
    sources = report._sources(view, 5)
    assert sources["threshold"] == [2, 1]
    edges, windows, bounds = (sources[name].data for name in ("edges", "windows", "bounds"))
    for k, (subgroup, pulse) in enumerate(np.ndindex(2, 5)):
        period = view.period(subgroup, pulse)
        here = slice(*bounds["edges"][k : k + 2])
        assert len(period.tick) and np.array_equal(edges["tick"][here], period.tick)
        assert np.array_equal(edges["pixel"][here], period.pixel)
        here = slice(*bounds["windows"][k : k + 2])
        assert np.array_equal(windows["start"][here], period.windows.start)
    gates = sources["gates"].data
    first = [9, 9, 16, 16, 23]
    assert gates["first"].tolist() == [*first, *[0] * 5]
    assert gates["end"].tolist() == [*(start + 60 for start in first), *[config.period] * 5]
    returns = sources["returns"].data
    assert np.array_equal(
        returns["at_m"], view.candidate_m.astype(np.float32).ravel(), equal_nan=True
    )
    assert view.candidate_m.shape == (8, 16, 4)
    assert np.array_equal(
        returns["confidence"],
        view.candidate_confidence.astype(np.float32).ravel(),
        equal_nan=True,
    )


def objects_of(labels, distance_m, signal, reflectivity, depth_m):
    """Return the objects of pictures of 2 x 5 pixels, by name."""
    distance_m = np.array(distance_m)[:, :, None]
    reflectivity = np.broadcast_to(np.array(reflectivity)[:, :, None], distance_m.shape)
    scene = Scene(
        name="hand-made",
        distance_m=distance_m,
        reflectivity=np.where(np.isnan(distance_m), 0, reflectivity),
        labels=np.array(labels, np.int32),
    )
    light = SimpleNamespace(total_signal=np.array(signal).ravel())
    return seen_objects(scene, light, np.array(depth_m))


NO = np.nan


def test_an_object_has_the_medians_of_its_own_pixels():
    """Without pixels that no target is in, which have labels, too."""
    near, far = objects_of(
        labels=[[7, 7, 7, 3, 3], [7, 7, 3, 3, 3]],
        distance_m=[[4.0, 5.0, 9.0, 20.0, 21.0], [NO, NO, 22.0, NO, 29.0]],
        signal=[[0.1, 0.2, 0.6, 1.0, 2.0], [0.0, 0.0, 3.0, 0.0, 7.0]],
        reflectivity=[[0.25, 0.5, 0.875, 0.1, 0.2], [0.0, 0.0, 0.3, 0.0, 0.9]],
        depth_m=[[4.0, 5.5, 9.0, 20.0, 21.0], [NO, NO, 1.0, NO, NO]],
    )
    assert (near.name, near.pixels, near.middle) == ("object 7", 3, (0, 1))
    assert (near.distance_m, near.reflectivity, near.signal) == (5.0, 0.5, 0.2)
    assert near.wrong_share == pytest.approx(1 / 3)
    assert (far.name, far.pixels, far.middle) == ("object 3", 4, (0, 3))
    assert (far.distance_m, far.signal, far.wrong_share) == (21.5, 2.5, 0.5)
    assert far.reflectivity == pytest.approx(0.25)


def test_a_scene_without_objects_has_two_halves_of_what_is_seen():
    """Pixels without a target send no light, and are in neither half."""
    darker, brighter = objects_of(
        labels=np.zeros((2, 5)),
        distance_m=[[5.0, 5.0, NO, NO, NO], [6.0, 6.0, NO, NO, NO]],
        signal=[[0.1, 0.3, 0.0, 0.0, 0.0], [0.2, 0.4, 0.0, 0.0, 0.0]],
        reflectivity=np.full((2, 5), 0.5),
        depth_m=[[5.0, 6.0, NO, NO, NO], [6.0, NO, NO, NO, NO]],
    )
    assert [(one.name, one.pixels) for one in (darker, brighter)] == [
        ("darker half", 2),
        ("brighter half", 2),
    ]
    assert (darker.signal, brighter.signal) == pytest.approx((0.15, 0.35))
    assert (darker.wrong_share, brighter.wrong_share) == (0.0, 1.0)


@pytest.mark.parametrize("frames", (1, 2))
def test_a_report_keeps_no_more_edges_than_fit_for_all_its_frames(recorded, frames, monkeypatch):
    views = recorded[:frames]
    edges = sum(len(view.timeline.tick) for view in views)
    monkeypatch.setattr(report, "EDGES_MAX", edges // 2)
    page = report.report_html("a run", views)
    (pulses,) = {int(number) for number in re.findall(r'"pulses",(\d+)', page)}
    assert pulses == 10


@pytest.mark.parametrize(
    ("edges", "kept"),
    [
        ([0], 100),
        ([2_000_000], 100),
        ([1_000_000, 1_000_000], 100),
        ([1_000_000, 1_500_000], 80),
        ([300_000_000], 1),
    ],
)
def test_two_million_edges_fit_into_a_report_and_those_of_one_pulse_in_any_case(edges, kept):
    views = [
        SimpleNamespace(pulses_seen=100, timeline=SimpleNamespace(tick=range(one))) for one in edges
    ]
    assert report._pulses_kept(views) == kept


@pytest.mark.parametrize("seen", [(40, 100), (100, 40)])
def test_a_report_has_the_pulses_that_were_kept_of_all_its_frames(seen):
    timeline = SimpleNamespace(tick=range(10))
    views = [SimpleNamespace(pulses_seen=one, timeline=timeline) for one in seen]
    assert report._pulses_kept(views) == 40


def test_a_report_that_is_written_is_that_of_all_its_frames(recorded, tmp_path):
    """In place of an older one. Bokeh numbers the figures of a process."""

    def unnumbered(page):
        return re.sub(r"\bp\d{4,}\b", "figure", page)

    path = tmp_path / "report.html"
    path.write_text("an older one", encoding="utf-8")
    report.write_report(path, "a <run>", recorded[:2])
    page = unnumbered(path.read_text(encoding="utf-8"))
    assert page == unnumbered(report.report_html("a <run>", recorded[:2]))
    assert "a &lt;run&gt;" in page
    assert [one.name for one in tmp_path.iterdir()] == ["report.html"]


def test_a_report_has_one_scale_for_all_its_frames_and_the_words_of_each(recorded, monkeypatch):
    far = copy(recorded[1])
    far.truth_m = recorded[1].truth_m + 30
    given, told = [], []
    monkeypatch.setattr(report.Views, "show", lambda *views, scales: given.append(scales))
    monkeypatch.setattr(report, "_words", lambda view: told.append(view) or "words")
    report.report_html("a run", [recorded[0], far])
    assert given == [map_scales([recorded[0], far])]
    assert told == [recorded[0], far]


def test_a_report_holds_its_key_and_the_numbers_of_a_sensor_that_is_no_square():
    """By hand, each under its own name; it needs no network."""
    sensor = {"rows": 8, "cols": 48, "subgroup": [4, 24], "minigroup": [2, 4], "phases": 16}
    frame = {"period": 200, "pulses": 7, "clock_mhz": 400.0}
    view = FrameView("a frame", Run(Setup.of("flat:5", klux=5, sensor=sensor, frame=frame)).frame())
    page = report.report_html("a run", [view])
    metre_ns = 2e9 / 299_792_458
    numbers = {
        "rows": 8,
        "cols": 48,
        "height": 4,
        "width": 24,
        "pixels": 96,
        "words": 4,
        "period": 200,
        "pulses": 7,
        "tick_ns": 2.5 / 16,
        "cycle_ns": 2.5,
        "bin_m": 0.15,
        "bins": 500,
        "ns_per_m": metre_ns,
    }
    (held,) = re.findall(r'\["sensor",\{"type":"map","entries":\[(.*?)\]\]', page)
    found = {name: float(number) for name, number in re.findall(r'"(\w+)",([^\]]+)', held)}
    assert found == pytest.approx(numbers)
    assert "cdn.bokeh.org" not in page
    looks = r'data-look="(\w+)" min="0" max="(\d+)" value="(\d+)"'
    assert re.findall(looks, page) == [("row", "7", "4"), ("col", "47", "24"), ("pulse", "6", "0")]
    assert re.findall(r'<option value="(\d+)">(.*?)</option>', page) == [("0", "a frame")]
    marks = re.findall('data-mark=".+?" style=".*?">(.*?)</span>', page)
    drawn = [*FATE_MARKS, *VERDICT_MARKS, ("", "", "light expected"), *REASON_MARKS]
    assert marks == [meaning for *_, meaning in drawn]


def test_a_report_holds_the_times_of_the_longest_period():
    """Of 1,024 cycles of 32 ticks; light comes until its end."""
    sensor = {"rows": 8, "cols": 8, "coarse_bits": 10, "phases": 32}
    setup = Setup.of("flat:5", klux=50, sensor=sensor, frame={"period": 1024, "pulses": 2})
    view = FrameView("a frame", Run(setup).frame())
    line = view.timeline
    found = report._sources(view, 2)
    assert line.windows.end.max() > 32_000
    assert np.array_equal(found["edges"].data["tick"], line.tick)
    for name, values in found["windows"].data.items():
        assert np.array_equal(values, getattr(line.windows, name)), name


def test_a_report_holds_the_times_of_a_frame_with_the_longest_gaps():
    """Of more cycles than an integer of 32 bits holds."""
    sensor = {"rows": 8, "cols": 8}
    frame = {"pulses": 10, "gap": (1 << 28) - 1}
    setup = Setup.of("flat:5", klux=5, sensor=sensor, frame=frame, subgroup={"threshold": 1})
    view = FrameView("a frame", Run(setup).frame())
    line = view.timeline
    found = report._sources(view, 10)
    assert line.fill_cycle.max() > 1 << 31
    assert np.array_equal(found["fill"].data["cycle"], line.fill_cycle)
    assert found["starts"] == line.start_cycles.tolist()


def test_periods_of_a_long_frame_are_those_whose_edges_are_kept(scene, monkeypatch):
    """Of the subgroup and the pulse that were asked for."""
    setup = Setup.of(scene, sensor={"rows": ROWS, "cols": COLS}, frame={"pulses": 20}, klux=20.0)
    monkeypatch.setattr(long_frames, "EDGES_MAX", 0)
    monkeypatch.setattr(long_frames, "EDGES_SHOWN_MAX", 600)
    view = FrameView("a frame", Run(setup).frame())
    kept = view.pulses_seen
    assert 1 < kept < 20
    found, whole = view.period(1, kept - 1), view.timeline.period(1, kept - 1)
    assert len(found.tick)
    for name in ("tick", "pixel", "fate"):
        assert np.array_equal(getattr(found, name), getattr(whole, name))
    for pulse in (-1, kept, 19):
        with pytest.raises(InputError, match=f"pulse.*{pulse}.*from 0 to {kept - 1}"):
            view.period(1, pulse)
