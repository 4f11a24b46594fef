# SPDX-License-Identifier: Apache-2.0
"""`coincid advise` and `coincid show`: an answer with its price, and what a configuration means."""

import math
import re
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from pandas import read_csv

from coincid.lab.outcomes import Run
from coincid.lab.pace import frames_per_s
from coincid.lab.setup import Setup, for_pictures
from coincid.model.contract.config import load_config, parse_config
from coincid.model.contract.counts import CYCLES_MAX
from coincid.model.contract.edges import Edges
from coincid.model.scenes.catalogue import load_scene
from coincid.study.advise import HEADS, Advice, Tried, advise, cheapest, links_of, write_advice
from coincid.study.advise import _limit as limit
from coincid.study.advise import _tried as outcome_of
from coincid.study.explain import meaning, warnings
from coincid.study.price import (
    MEASURED_MHZ,
    UM2_PER_PIXEL,
    UW_PER_PIXEL,
    um2_per_pixel,
    uw_per_pixel,
)
from coincid.study.usefulness import is_useful, useless_sentence

from ..command import command
from ..random_cases import configured

DOCS = Path(__file__).parents[2] / "docs"


def test_advice_for_a_scene_of_ones_own(tmp_path):
    far_m = np.full((16, 16), 5.0)
    far_m[4:12, 4:12] = 3.0
    np.save(tmp_path / "room.npy", far_m * 100)
    given = "--unit cm --klux 20 --set rows=8 --set cols=8 --set pulses=30"
    done = command(f"advise {tmp_path}/room.npy {given} --out {tmp_path}/out")
    assert done.exit_code == 0, done.output
    sentence = next(line for line in done.output.splitlines() if line.startswith("Take "))
    for unit in (" ns (", "Gbit/s", "of the pixels are wrong", "bits per frame", "mW", "um2"):
        assert unit in sentence
    limit = next(line for line in done.output.splitlines() if line.startswith("The limit of a"))
    told = [float(number) for number in re.findall(r"([\d.]+) mm", limit)]
    assert len(told) == 4 and told[0] < told[1] <= told[3]
    best = read_csv(tmp_path / "out" / "advise.csv")["wrong pixels"].min()
    advised = load_config(tmp_path / "out" / "advised.toml")
    share = float(re.search(r"([\d.]+)% of the pixels", sentence)[1]) / 100
    assert share <= best + max(0.002, 0.1 * best) + 0.001
    assert advised.sensor.rows == 8 and advised.pulses == 30 and advised.format in sentence
    assert (tmp_path / "out" / "advise.png").read_bytes().startswith(b"\x89PNG")


def outcome(wrong, bits=1, dropped=0.0, load=0.5, config=None):
    """Return what one configuration leaves."""
    return Tried(
        config=config or parse_config({}),
        wrong=wrong,
        far=0.0,
        error_mm=9.0,
        bits=bits,
        dropped=dropped,
        load=load,
    )


def test_advice_overloads_no_link_where_it_need_not():
    def sentence(*settings):
        best = settings[0]
        return Advice(
            settings=list(settings), chosen=best, links=[best], best=best, klux=1.0
        ).sentence

    full, lossy, fits = (
        outcome(0.004, 100, 0.0, 1.08),
        outcome(0.002, 200, 0.24, 0.9),
        outcome(0.002, 300, 0.0, 0.7),
    )
    assert cheapest([full, lossy, fits], lambda one: one.bits) is fits
    worse = outcome(0.1, 50, 0.0, 0.1)
    assert cheapest([full, lossy, worse], lambda one: one.bits) is full
    # Somewhat more wrong pixels are better than an overload, and the least one comes before the
    # price.
    a_little_worse = outcome(0.005, 900, 0.0, 0.9)
    assert cheapest([full, lossy, a_little_worse], lambda one: one.bits) is a_little_worse
    # A useful picture on an overloaded link is better than a useless one.
    useful, useless = outcome(0.2, 100, 0.2, 1.02), outcome(0.36, 50, 0.0, 0.1)
    assert cheapest([useful, useless], lambda one: one.bits) is useful
    bad, nothing = outcome(0.8, 100, 0.02, 1.02), outcome(1.0, 50, 0.0, 0.02)
    assert cheapest([bad, nothing], lambda one: one.bits) is bad
    slow, fast = outcome(1.0, 100, 0.0, 19.58), outcome(1.0, 200, 0.0, 1.2)
    assert cheapest([slow, fast], lambda one: one.bits) is fast
    assert "is overloaded (108%" in sentence(full, worse)
    assert "without an overload leaves 10.0% of the pixels wrong" in sentence(full, worse)
    assert "Everything that was tried overloads its link (120%" in sentence(fast, slow)
    assert "overload" not in sentence(fits)


@pytest.mark.parametrize("streams", (1, 3))
@pytest.mark.parametrize("gap", (0, 40_000))
def test_the_rates_of_an_advice_are_those_of_one_stream(streams, gap):
    """In the mean of the streams: bits over the time in which they are sent."""
    config = parse_config({"sensor": {"streams": streams}, "frame": {"gap": gap, "pulses": 50}})
    bits = 123_456_789
    best = Tried(config=config, wrong=0.1, far=0.0, error_mm=9.0, bits=bits, dropped=0.0, load=0.1)
    told = Advice(settings=[best], chosen=best, links=[best], best=best, klux=1.0).sentence
    cycles = 50 * 250 + 49 * gap
    gbps = bits / streams / (cycles * 2e-9) * 1e-9
    assert float(re.search(r"frame \(([\d.e+]+) Gbit/s\)", told)[1]) == pytest.approx(
        gbps, rel=0.05
    )
    if gap:
        mbps = float(re.search(r"carries ([\d.e+]+) Mbit/s", told)[1])
        assert mbps == pytest.approx(gbps * 1e3, rel=0.05)


@pytest.mark.parametrize("counts", (0, 1))
def test_frames_of_too_few_pulses_for_counts_have_advice(counts):
    """Counts need searches before and after them."""
    sensor = {"rows": 8, "cols": 8, "counts": counts}
    advice = advise(Setup.of("flat:3", sensor=sensor, frame={"pulses": 2}, klux=1.0), klux=1.0)
    assert not advice.counts
    assert all(tried.config.format != "counts" for tried in advice.links)


@pytest.mark.parametrize(
    ("frame", "subgroup", "override"),
    [
        ({}, {"threshold": 2, "window": 8}, {}),
        ({"frames": 5}, {"auto": True}, {}),  # one for each picture of a scene that moves
        ({}, {"mask": "f" * 15 + "0"}, {}),
        ({"gap": 0, "minigroup_records": False}, {"gate_start": 0, "auto": False}, {}),
        ({}, {"gating": True}, {"subgroups": [1, 3], "gate_start": 30, "mask": "fffe"}),
        ({}, {"gate_start": 7}, {"subgroups": [0, 2], "gate_start": 30, "auto": True}),
        ({"auto_bounds": [1, 2, 3, 4, 5, 6]}, {}, {"subgroups": [3], "threshold": 5}),
    ],
)
def test_the_settings_that_are_written_are_those_that_were_tried(
    tmp_path, monkeypatch, frame, subgroup, override
):
    monkeypatch.setattr("coincid.study.advise._draw", lambda *given: None)
    config = configured({"rows": 16, "cols": 16}, frame, subgroup, *[override] * bool(override))
    config = config.with_frame(capacity=None, link_gbps=4.0)
    best = Tried(config=config, wrong=0.1, far=0.0, error_mm=9.0, bits=10, dropped=0.0, load=0.1)
    advice = Advice(settings=[best], chosen=best, links=[best], best=best, klux=1.0)
    read = load_config(write_advice(tmp_path, advice, "a wall")[-1])
    assert read.sensor == config.sensor and read.frame == config.frame
    assert read.register_writes() == config.register_writes()
    assert read.given == config.given - {"frame.capacity"}


def test_the_limit_is_that_of_the_picture_that_is_judged():
    """The last one of a scene that moves."""
    sensor = {"rows": 8, "cols": 8}
    pictures_m = np.array([[[3.0]], [[15.0]]]) * np.ones((2, 8, 8))
    moving = Setup.of(load_scene(pictures_m, 8, 8), sensor=sensor, klux=30.0)
    last = Setup.of(load_scene(pictures_m[1], 8, 8), sensor=sensor, klux=30.0)
    assert limit(Run(moving), moving.config) == limit(Run(last), last.config)


def test_the_limit_of_a_mask_or_a_gate_is_told():
    sensor = {"rows": 8, "cols": 8}
    for subgroup in ({"mask": "0"}, {"gating": True, "gate_start": 100}):
        setup = Setup.of("flat:3", sensor=sensor, subgroup=subgroup, klux=30.0)
        assert "no events" in limit(Run(setup), setup.config)


def test_the_limit_of_a_pulse_much_shorter_than_a_tick_is_none():
    sensor = {"rows": 8, "cols": 8, "phases": 4}
    frame = {"clock_mhz": 20.0, "pulses": 50}
    setup = Setup.of("flat:3", sensor=sensor, frame=frame, klux=30.0)
    assert limit(Run(setup), setup.config).startswith("The pulse is much shorter than a tick")


@pytest.mark.parametrize(
    ("frame", "written"),
    [({}, 3), ({"frames": 3}, 3), ({"frames": 2}, 2)],
)
def test_the_advice_for_a_scene_that_moves_plays_its_pictures(
    tmp_path, monkeypatch, frame, written
):
    """As many as it has, or as were asked for."""
    monkeypatch.setattr("coincid.study.advise._draw", lambda *given: None)
    pictures_m = np.array([[[3.0]], [[4.0]], [[5.0]]]) * np.ones((3, 8, 8))
    scene = load_scene(pictures_m, 8, 8)
    sensor = {"rows": 8, "cols": 8}
    setup = Setup.of(scene, sensor=sensor, frame=frame | {"pulses": 5}, klux=1.0)
    advice = advise(setup, klux=1.0)
    file = write_advice(tmp_path, advice, "a wall")[-1]
    assert for_pictures(load_config(file), scene).frames == written
    # The pictures tell their own number.
    lines = file.read_text(encoding="utf-8").splitlines()
    assert any(re.match(r"frames\s*=", line) for line in lines) == (written != 3)


@pytest.mark.parametrize(
    ("pictures", "asked", "auto", "written"),
    [
        (1, {"frames": 3}, False, "frames = 3"),
        (1, {"frames": 1}, False, "frames = 1"),
        (1, {}, False, None),
        (1, {"frames": 3}, True, "frames = 3"),
        (1, {}, True, "frames = 7"),  # in which the controller has settled
        (7, {}, True, None),
        (7, {"frames": 3}, True, "frames = 3"),
    ],
)
def test_advice_writes_the_frames_that_were_asked_for(
    tmp_path, monkeypatch, pictures, asked, auto, written
):
    """And not those that the advice played; the pictures of a scene tell their own number."""
    monkeypatch.setattr("coincid.study.advise._draw", lambda *given: None)
    monkeypatch.setattr("coincid.study.advise._limit", lambda *given: "")
    monkeypatch.setattr("coincid.study.advise._settings", lambda *given: iter([best]))
    monkeypatch.setattr("coincid.study.advise._links", lambda *given: iter([best]))
    sensor = {"rows": 8, "cols": 8}
    wall_m = np.full((pictures, 8, 8), 4.0)
    scene = load_scene(wall_m if pictures > 1 else wall_m[0], 8, 8)
    setup = Setup.of(scene, sensor=sensor, frame=asked | {"pulses": 5}, klux=1.0)
    config = setup.config.with_frame(frames=7 if auto else 1).with_settings(auto=auto)
    best = Tried(config=config, wrong=0.1, far=0.0, error_mm=9.0, bits=10, dropped=0.0, load=0.1)
    file = write_advice(tmp_path, advise(setup, klux=1.0), "a wall")[-1]
    lines = file.read_text(encoding="utf-8").splitlines()
    found = [line for line in lines if re.match(r"frames\s*=", line)]
    assert found == ([] if written is None else [written])


def test_where_no_setting_helps_the_advice_begins_with_what_would(tmp_path):
    given = "--klux 100 --set rows=8 --set cols=8 --set pulses=5"
    done = command(f"advise flat:9,0.05 {given} --out {tmp_path}/out")
    assert done.exit_code == 0, done.output
    first, *others = done.output[done.output.index("No setting") :].splitlines()
    assert re.match(r"No setting leaves a useful picture: at best, \d+.\d% of the pixels", first)
    for words in ("20 laser pulses", "10 klux", "half the distance, 4.5 m", "9 to 9 m", "--unit"):
        assert words in first
    assert re.search("threshold.*error, mm", others[0])
    assert any(line.startswith("The least bad: take ") for line in others)


def test_what_would_help_is_said_of_the_last_picture_of_a_scene_that_moves(monkeypatch):
    """As everything else in the advice."""
    monkeypatch.setattr("coincid.study.advise.is_useful", lambda wrong: False)
    monkeypatch.setattr("coincid.study.usefulness._least_wrong", lambda setup, *given: 0.9)
    pictures_m = np.array([[[8.0]], [[9.0]]]) * np.ones((2, 8, 8))
    scene = load_scene(pictures_m, 8, 8, reflectivity=0.05)
    setup = Setup.of(scene, sensor={"rows": 8, "cols": 8}, frame={"pulses": 5}, klux=100.0)
    assert "half the distance, 4.5 m" in advise(setup, klux=100.0).useless


@pytest.mark.parametrize("auto", (False, True))
def test_links_are_tried_with_the_coincidence_that_was_chosen(auto):
    """Also if the configuration begins without it."""
    own = {"coincidence": False, "auto": auto}
    setup = Setup.of("flat:6", sensor={"rows": 8, "cols": 8}, frame={"pulses": 20}, klux=50.0)
    advice = advise(setup.but(subgroup=own), klux=50.0)
    assert advice.chosen.config.coincidence.all()
    for tried in (advice.best, *advice.links):
        assert tried.config.coincidence.all(), tried.config
        assert np.array_equal(tried.config.threshold, advice.chosen.config.threshold)


@pytest.mark.parametrize(
    ("clock_mhz", "gap", "slowest_gbps"),
    [(500, 0, 1.0), (500, 1, 0.05), (800, 1, 0.05), (801, 1, 0.1), (1600, 1, 0.1), (1601, 1, 0.25)],
)
def test_all_links_are_tried_that_a_sensor_may_have(clock_mhz, gap, slowest_gbps):
    """From the slowest legal one on; those below 1 Gbit/s only if the pulses are apart."""
    config = parse_config({"frame": {"clock_mhz": clock_mhz, "gap": gap}})
    rates_gbps = [0.05, 0.1, 0.25, 0.5, 1.0, 2.0, 4.0, 8.0, 16.0]
    tried = links_of(config)
    assert tried == [one for one in rates_gbps if one >= slowest_gbps]
    assert [config.with_frame(link_gbps=one).frame.link_gbps for one in tried] == tried


def test_what_would_help_a_near_scene_stays_in_front_of_the_sensor(monkeypatch):
    monkeypatch.setattr("coincid.study.usefulness._least_wrong", lambda setup, *given: 0.9)
    setup = Setup.of("flat:0.08", sensor={"rows": 8, "cols": 8}, frame={"pulses": 5}, klux=1.0)
    told = useless_sentence(0.9, setup, window=32)
    assert "half the distance, 0.05 m in the middle" in told and "0.08 to 0.08 m" in told


@pytest.fixture
def tried(monkeypatch):
    """The setups of what would help, in place of their simulations."""
    setups = []

    def least_wrong(setup, *given):
        setups.append(setup)
        return 0.9

    monkeypatch.setattr("coincid.study.usefulness._least_wrong", least_wrong)
    return setups


def test_less_light_is_less_in_every_pixel(tried):
    """Where the sun does not lie everywhere, a tenth of it does not, either."""
    klux = np.linspace(0, 90, 64).reshape(8, 8)
    setup = Setup.of("flat:9,0.05", sensor={"rows": 8, "cols": 8}, frame={"pulses": 5}, klux=klux)
    told = useless_sentence(0.9, setup, window=32)
    assert "a tenth of the ambient light, 4.5 klux" in told
    (less,) = (one for one in tried if not np.array_equal(one.klux, klux))
    assert less.klux == pytest.approx(klux / 10)


def test_what_would_help_is_tried_in_one_frame_at_fixed_thresholds(tried):
    """Whatever the configuration has."""
    setup = Setup.of(
        "flat:9,0.05",
        sensor={"rows": 8, "cols": 16},
        frame={"pulses": 5, "frames": 3},
        subgroup={"auto": True, "threshold": 2},
        klux=10.0,
    )
    config = setup.config.with_settings(coincidence=np.array([True, False]))
    useless_sentence(0.9, setup.but(config=config), window=32)
    assert len(tried) == 3
    for one in tried:
        assert one.config.frames == 1
        assert not one.config.auto.any()
        assert one.config.coincidence.all()


def test_the_curve_of_a_window_has_each_threshold_once(monkeypatch, tmp_path):
    """And links and formats are tried with the window, the threshold and the controller that were
    chosen, whatever those of the configuration are.
    """
    drawn = []
    monkeypatch.setattr(
        "coincid.study.advise.save_figure", lambda figure, path: drawn.append(figure)
    )
    sensor = {"rows": 8, "cols": 8}
    odd = {"threshold": 5, "window": 7}
    setup = Setup.of("flat:5,0.5", sensor=sensor, frame={"pulses": 20}, subgroup=odd, klux=1.0)
    advice = advise(setup, klux=1.0)
    for one in advice.links:
        for name in ("auto", "threshold", "window"):
            chosen = getattr(advice.chosen.config, name)
            assert np.array_equal(getattr(one.config, name), chosen), name
    assert advice.chosen.config.window[0] != 7
    write_advice(tmp_path, advice, "a wall")
    lines = drawn[0].axes[0].lines
    curves = [one for one in lines if str(one.get_label()).startswith("window")]
    assert [len(one.get_xdata()) for one in curves] == [6, 6, 6]
    ring = next(one for one in lines if str(one.get_label()).startswith("advised"))
    points = {(x, y) for one in lines if one is not ring for x, y in one.get_xydata().tolist()}
    assert tuple(ring.get_xydata()[0]) in points


def test_what_a_configuration_means():
    told = dict(meaning(load_config("fpga")))
    assert told["tick"].startswith("1000 ps, 14.99 cm") and told["window"] == "2 ticks, 2 ns"
    assert told["array"] == "32 x 32 pixels in 16 subgroups of 8 x 8"
    shown = command("show fpga --set streams=3").output
    for name, value in told.items():
        if name != "stream" and "events" not in name:
            assert f"{name} " in shown and value in shown
    assert "* streams = 3 does not divide 16 subgroups" in shown


@pytest.mark.parametrize("clock_mhz", (125.0, 500.0))
@pytest.mark.parametrize("gap", (0, 5000))
def test_what_a_configuration_means_by_hand(clock_mhz, gap):
    frame = {"clock_mhz": clock_mhz, "period": 200, "pulses": 40, "gap": gap, "link_gbps": 4.0}
    config = parse_config({"frame": frame})
    told = {
        name: [float(number.replace(",", "")) for number in re.findall(r"[\d.,]*\d", text)]
        for name, text in meaning(config)
    }
    cycle_ns = 1e3 / clock_mhz
    frame_us = (40 * 200 + 39 * gap) * cycle_ns / 1e3
    cm_per_ns = 29.9792458 / 2
    near = {"rel": 1e-3}
    assert told["clock"] == pytest.approx([clock_mhz, cycle_ns, cycle_ns * cm_per_ns], **near)
    assert told["tick"][:2] == pytest.approx(
        [cycle_ns * 1e3 / 32, cycle_ns * cm_per_ns / 32], **near
    )
    period_ns = 200 * cycle_ns
    assert told["laser period"] == pytest.approx([200, period_ns, 1e6 / period_ns], **near)
    assert told["range"][0] == pytest.approx(period_ns * cm_per_ns / 100, **near)
    assert told["frame"][:2] == pytest.approx([40, frame_us], **near)
    assert told["frame"][2] == pytest.approx(1e6 / frame_us, abs=0.51)
    assert told["stream"][1] == pytest.approx(64 * clock_mhz / 1e3, **near)
    assert told["stream"][2] == pytest.approx(100 * 4.0 / (64 * clock_mhz / 1e3), rel=0.02)
    fitting = [config.capacity, config.capacity / frame_us]
    assert told["events that fit"] == pytest.approx(fitting, **near)
    if gap:
        assert told["gap"] == pytest.approx([gap, gap * cycle_ns / 1e3], **near)


def test_the_events_that_fit_are_those_of_the_link():
    """Whatever the controller is told."""
    for capacity in (0, 20, 1 << 30):
        told = dict(meaning(parse_config({"frame": {"capacity": capacity}})))
        assert told["events that fit"] == dict(meaning(parse_config({})))["events that fit"]


WITH_COUNTS = {"counts": 1}
COUNTING = {"format": "counts"}


def test_what_frames_of_counts_mean():
    document = {"sensor": WITH_COUNTS, "frame": COUNTING | {"pulses": 60, "period": 250}}
    told = dict(meaning(parse_config(document)))
    assert told["steps"] == "12 pulses for regions, 12 for gates, 36 for counts"
    assert told["counts"] == "10 beats per minigroup, 163.8 kbit per frame"
    assert told["range"].endswith("; hits count in the first 250 cycles")
    assert not told.keys() & {"window", "threshold", "event", "events that fit"}
    # the controller and thresholds do nothing, and hits of all cycles count
    of_events = {"subgroup": {"threshold": 1, "mask": "0"}}
    assert not warnings(parse_config(document | of_events | {"sensor": LEAN_WITH_COUNTS}))


LEAN_WITH_COUNTS = WITH_COUNTS | {"window_max": 16, "coarse_bits": 8}


@pytest.mark.parametrize(
    ("document", "words"),
    [
        ({"frame": {"link_gbps": 64.0}}, "more than a stream sends"),
        ({"subgroup": {"threshold": 1}}, "threshold 1 lets every photon through"),
        ({"subgroup": {"auto": True}}, "on for one frame"),
        ({"subgroup": {"auto": True, "coincidence": False}}, "coincidence is off"),
        ({"subgroup": {"gate_start": 5}}, "gating is off"),
        ({"subgroup": {"gating": True}, "frame": {"gate_every": 5}}, "moves by 0 cycles"),
        ({"subgroup": {"mask": "1"}}, "nothing can commit"),
        ({"frame": {"format": "short"}}, "no depth per pixel"),
        ({"frame": {"mg_window": 3}}, "minigroup_records is off"),
        ({"frame": {"dither_seed": 3}}, "dither_seed has no effect"),
        ({"frame": {"pulses": 2}}, "Counters fill"),
        ({"sensor": WITH_COUNTS, "frame": {"search_pulses": 2}}, "the format is not 'counts'"),
        ({"sensor": WITH_COUNTS, "frame": COUNTING | {"period": 257}}, "Hits after cycle 255"),
        (
            {"sensor": WITH_COUNTS, "frame": COUNTING, "subgroup": {"window": 9}},
            "frames have counts",
        ),
        (
            {"sensor": WITH_COUNTS, "frame": COUNTING | {"minigroup_records": True}},
            "minigroup_records has no effect",
        ),
    ],
)
def test_what_is_wasted(document, words):
    assert any(words in sentence for sentence in warnings(parse_config(document)))
    lean = {"sensor": {"window_max": 16, "coarse_bits": 8}, "frame": {"format": "compact"}}
    assert not any(words in sentence for sentence in warnings(parse_config(lean)))


def test_hits_of_events_count_in_all_cycles():
    document = {"frame": {"format": "id", "period": 2 * CYCLES_MAX}}
    assert not any("Hits after" in one for one in warnings(parse_config(document)))


def test_the_controller_lowers_a_threshold_above_all_pixels():
    mask = {"mask": "7", "threshold": 5}
    words = "nothing can commit"
    for auto, told in ((False, True), (True, False)):
        config = parse_config({"subgroup": mask | {"auto": auto}, "frame": {"frames": 6}})
        assert any(words in line for line in warnings(config)) == told


def test_counters_have_the_gaps_for_their_way():
    few = {"frame": {"pulses": 2, "gap": 0}}
    with_gap = {"frame": {"pulses": 2, "gap": 20_000}}
    assert any("Counters fill" in one for one in warnings(parse_config(few)))
    assert not any("Counters fill" in one for one in warnings(parse_config(with_gap)))


PERIOD, CLOCK_MHZ = 250, 500.0


@pytest.mark.parametrize(
    ("table", "key", "quiet", "told", "words"),
    [
        ("subgroup", "threshold", 4, 5, "nothing can commit"),
        ("subgroup", "gate_len", PERIOD - 10, PERIOD - 9, "ends after the laser period"),
        ("frame", "link_gbps", 64 * CLOCK_MHZ / 1e3, 64.1 * CLOCK_MHZ / 1e3, "more than a stream"),
        ("subgroup", "window", 25, 24, "the longest window has"),
        ("frame", "period", 129, 128, "coarse_bits = 9 counts"),
        ("frame", "frames", 2, 1, "on for one frame"),
        ("frame", "gap", 0, 1, "one pulse"),
        ("frame", "capacity", 1, 0, "capacity is 0"),
    ],
)
def test_what_is_wasted_begins_at_its_edge(table, key, quiet, told, words):
    """A value, and the next one to it, of which only the second wastes something."""
    document = {
        "sensor": {"window_max": 50, "coarse_bits": 9},
        "frame": {"period": PERIOD, "clock_mhz": CLOCK_MHZ, "pulses": 1, "frames": 1},
        "subgroup": {"mask": "5a", "gating": True, "gate_start": 10, "auto": True, "window": 20},
    }
    for value, holds in ((quiet, False), (told, True)):
        changed = document | {table: document[table] | {key: value}}
        sentences = warnings(parse_config(changed))
        assert any(words in sentence for sentence in sentences) == holds


def test_the_controller_is_counted_where_it_acts():
    """It does nothing without coincidence."""
    config = configured(
        {"rows": 32, "cols": 32},
        {},
        {"auto": True},
        {"subgroups": [3, 5], "coincidence": False},
        {"subgroups": [7], "auto": False},
    )
    told = dict(meaning(config))["threshold"]
    assert "by the controller in 13 of 16; coincidence is off in 2" in told


def test_power_is_that_of_the_light_and_in_proportion_to_clock_and_area():
    config = parse_config({})
    for klux, uw in zip(*UW_PER_PIXEL, strict=True):
        assert uw_per_pixel(config.with_frame(clock_mhz=MEASURED_MHZ), klux) == pytest.approx(uw)
        slower = config.with_frame(clock_mhz=MEASURED_MHZ / 4)
        assert uw_per_pixel(slower, klux) == pytest.approx(uw / 4)
    lean = load_config("lean").with_frame(clock_mhz=MEASURED_MHZ)
    smaller = um2_per_pixel(lean.sensor) / um2_per_pixel(config.sensor)
    assert smaller < 1 and uw_per_pixel(lean, 50.0) == pytest.approx(37.0 * smaller)


def test_the_power_beside_a_gap_is_that_in_a_period():
    """Between periods the sensor takes less, and nobody has measured how much."""
    for gap in (0, 168_097):
        told = dict(meaning(configured({}, {"gap": gap})))["power"]
        assert ("in a period" in told) == (gap > 0)


def test_prices_are_those_of_the_pages():
    cost = read_csv(DOCS / "images" / "cost.csv").set_index(["parameter", "value"])[
        "area_um2_per_pixel"
    ]
    for parameter, name in (
        ("subgroup", "pixels"),
        ("minigroup", "minigroup_pixels"),
        ("phases", "phases"),
    ):
        assert cost[parameter].to_dict() == dict(zip(*UM2_PER_PIXEL[name], strict=True))
    chosen = read_csv(DOCS / "images" / "cost_choices.csv").set_index("choice")["um2_per_pixel"]
    for name, choice in (
        ("offsets", "no coarse offsets"),
        ("records", "no minigroup records"),
        ("controller", "no threshold controller"),
        ("fifo_depth", "FIFO of 8 events"),
    ):
        assert UM2_PER_PIXEL[name][1] == (chosen[choice], chosen["`silicon`"])
    assert um2_per_pixel(load_config("lean").sensor) == pytest.approx(
        chosen["`lean`: all of them"], rel=0.1
    )
    row = next(
        line
        for line in (DOCS / "power.md").read_text(encoding="utf-8").splitlines()
        if line.startswith("| uW per pixel |")
    )
    assert list(map(float, row.split("|")[2:6])) == list(UW_PER_PIXEL[1])


def test_what_helps_most_is_told_first(monkeypatch):
    shares = {"pulses": 0.7, "light": 0.2, "distance": 0.5}
    wrong = iter(shares.values())
    monkeypatch.setattr("coincid.study.usefulness._least_wrong", lambda *given: next(wrong))
    setup = Setup.of("flat:9,0.05", sensor={"rows": 8, "cols": 8}, frame={"pulses": 5}, klux=1.0)
    told = useless_sentence(0.9, setup, window=32)
    assert [float(share) for share in re.findall(r"\((\d+\.\d)% wrong\)", told)] == [20, 50, 70]
    assert told.index("ambient light") < told.index("half the distance") < told.index("pulses per")


@pytest.mark.parametrize("window", (2, 16))
def test_what_would_help_is_played_at_its_best_threshold_with_the_window_that_is_asked(window):
    """Whatever threshold and window the configuration has. Of ten times less light, by hand."""
    sensor, frame = {"rows": 8, "cols": 8}, {"pulses": 20}

    def setup_of(klux, **subgroup):
        return Setup.of("flat:9,0.05", sensor=sensor, frame=frame, subgroup=subgroup, klux=klux)

    told = useless_sentence(0.9, setup_of(100.0, threshold=7, window=9), window)
    darker = [setup_of(10.0, threshold=1 + k, window=window) for k in range(7)]
    shares = [Run(setup)["wrong_share"] for setup in darker]
    assert len({*shares}) > 1
    light = re.search(r"a tenth of the ambient light, 10 klux \(([\d.]+)% wrong\)", told)[1]
    assert float(light) == pytest.approx(100 * min(shares), abs=0.05)


def test_the_numbers_of_an_advice_are_in_the_units_that_it_tells():
    """By hand: 12.5 million cycles of 25,000 pulses at 0.5 GHz take 25 ms."""
    frame = {"pulses": 25_000, "clock_mhz": MEASURED_MHZ, "period": 500, "link_gbps": 0}
    config = parse_config({"sensor": {"streams": 2}, "frame": frame})
    config = config.with_settings(threshold=3, window=32)
    best = Tried(
        config=config,
        wrong=0.0123,
        far=0.0046,
        error_mm=9.0,
        bits=3_000_000,
        dropped=0.0,
        load=0.1,
    )
    advice = Advice(settings=[best], chosen=best, links=[best], best=best, klux=50.0)
    uw = UW_PER_PIXEL[1][UW_PER_PIXEL[0].index(50.0)]
    um2 = um2_per_pixel(config.sensor)
    assert advice.price == f"about {uw / 1000:.2g} mW and {um2:.0f} um2 per pixel in 45 nm"
    frame_s = 25_000 * 500 / (MEASURED_MHZ * 1e6)
    window_ns = 32 * 1e3 / MEASURED_MHZ / config.sensor.phases
    link_gbps = 64 * MEASURED_MHZ / 1e3
    assert advice.sentence == (
        f"Take threshold 3, a window of {window_ns:.3g} ns (32 ticks), the format {config.format}"
        f" and a link of {link_gbps:g} Gbit/s: 1.2% of the pixels are wrong (0.5% by more than"
        f" 15 cm), for 3,000,000 bits per frame ({3e6 / 2 / frame_s / 1e9:.2g} Gbit/s), and"
        f" {advice.price}."
    )
    assert best.frames_per_s == pytest.approx(1 / frame_s)


def test_each_number_of_a_row_stands_below_its_head():
    """In the table that is written, and on the console."""
    config = parse_config({"frame": {"pulses": 100, "clock_mhz": 500, "link_gbps": 4}})
    config = config.with_settings(threshold=3, window=32)
    shares = {"wrong": 0.1, "far": 0.2, "dropped": 0.3, "load": 0.4}
    one = Tried(config=config, error_mm=9.0, bits=700, **shares)
    assert dict(zip(HEADS, one.row(), strict=True)) == {
        "threshold": "3",
        "window, ns": pytest.approx(2.0),
        "format": config.format,
        "link, Gbit/s": 4.0,
        "wrong pixels": 0.1,
        "off by 15 cm": 0.2,
        "error, mm": 9.0,
        "bits per frame": 700,
        "dropped": 0.3,
        "link load": 0.4,
        "frames per second": pytest.approx(one.frames_per_s),
    }


@pytest.mark.parametrize("light", ("transient", "light"))
def test_only_what_can_be_changed_is_tried_as_a_help(tried, light):
    """Recorded light has no distance, and light of one's own has no sun, either."""
    given = {"sensor": {"rows": 8, "cols": 8}, "frame": {"pulses": 5}, "klux": 10.0}
    setup = Setup.of("flat:9,0.05", **given)
    if light == "light":
        setup = setup.but(light=Run(setup).light)
        helps = ["pulses"]
    else:
        counts = np.ones((8, 8, 100))
        counts[:, :, 40] = 500  # a wall at 3 m
        scene = load_scene(counts, 8, 8, bin_ps=500.0, recorded_pulses=1000)
        setup = setup.but(scene=scene)
        helps = ["pulses", "ambient"]
    told = useless_sentence(0.9, setup, window=32)
    words = {"pulses": "20 laser pulses", "ambient": "ambient light", "distance": "half the"}
    assert [name for name, word in words.items() if word in told] == helps
    assert len(tried) == len(helps)


@pytest.mark.parametrize(
    ("least", "worse", "is_equal"),
    [
        (0.1, 0.1099, True),  # a tenth of them more
        (0.1, 0.1101, False),
        (0.0, 0.0019, True),  # or 0.2 % of all pixels
        (0.0, 0.0021, False),
    ],
)
def test_a_few_more_wrong_pixels_count_as_equal(least, worse, is_equal):
    """Then fewer bits decide, and fewer drops among links that are all overloaded."""
    dear, cheap = outcome(least, bits=200), outcome(worse, bits=100)
    assert cheapest([dear, cheap], lambda one: one.bits) is (cheap if is_equal else dear)
    lossy = outcome(least, bits=100, dropped=0.3, load=2.0)
    fuller = outcome(worse, bits=200, dropped=0.2, load=3.0)
    assert cheapest([lossy, fuller], lambda one: one.bits) is (fuller if is_equal else lossy)


@pytest.mark.parametrize(("wrong", "is_better"), [(0.2019, True), (0.2021, False)])
def test_twice_as_many_wrong_pixels_are_better_than_an_overload(wrong, is_better):
    """And 0.2 % of all pixels more; beyond that the overload is taken."""
    overloaded, fits = outcome(0.1, load=1.5), outcome(wrong)
    assert cheapest([overloaded, fits], lambda one: one.bits) is (fits if is_better else overloaded)


@pytest.mark.parametrize(
    ("dropped", "load", "overloaded"),
    [(0.01, 1.0, False), (0.0101, 0.5, True), (0.0, 1.001, True)],
)
def test_a_link_that_is_just_full_is_not_overloaded(dropped, load, overloaded):
    assert outcome(0.1, dropped=dropped, load=load).overloaded == overloaded


def test_an_advice_tells_the_controller_and_a_single_tick():
    config = parse_config({"subgroup": {"auto": True, "window": 1}})
    best = outcome(0.1, config=config)
    told = Advice(settings=[best], chosen=best, links=[best], best=best, klux=1.0).sentence
    assert told.startswith("Take the controller, a window of 0.0625 ns (1 tick), the format id")


def test_beside_an_overload_the_best_of_what_fits_is_told():
    full = outcome(0.004, load=1.5)
    others = [outcome(wrong) for wrong in (0.3, 0.1, 0.2)]
    for before, behind in ((others[:2], others[2:]), (others[2:], others[:2])):
        advice = Advice(settings=before, chosen=full, links=[full, *behind], best=full, klux=1.0)
        assert "without an overload leaves 10.0% of the pixels wrong" in advice.sentence


def test_the_table_has_all_that_was_tried_in_its_order(tmp_path, monkeypatch):
    """Thresholds and windows first, then links and formats."""
    monkeypatch.setattr("coincid.study.advise._draw", lambda *given: None)
    tried = [outcome(0.1, bits=bits) for bits in (5, 9, 2, 7)]
    advice = Advice(settings=tried[:2], chosen=tried[1], links=tried[2:], best=tried[3], klux=1.0)
    table, *_ = write_advice(tmp_path, advice, "a wall")
    assert read_csv(table)["bits per frame"].tolist() == [5, 9, 2, 7]


def test_an_outcome_has_the_measures_of_its_last_frame_in_the_units_of_its_fields():
    """What has no value is the worst; drops that are not known are all."""

    def run(known, **measures):
        frame = type("Frame", (dict,), {"knows": lambda frame, name: known})(measures)
        return SimpleNamespace(config=parse_config({}), frame=lambda: frame)

    measures = {
        "wrong_share": 0.1,
        "wrong_share_15cm": 0.02,
        "right_rms_m": 0.0125,
        "bits": 77,
        "dropped_share": 0.3,
        "link_load": 0.4,
    }
    found = outcome_of(run(True, **measures))
    assert (found.wrong, found.far, found.error_mm) == (0.1, 0.02, pytest.approx(12.5))
    assert (found.bits, found.dropped, found.load) == (77, 0.3, 0.4)
    assert outcome_of(run(False, **measures)).dropped == 1.0
    nothing = outcome_of(run(True, **dict.fromkeys(measures)))
    assert (nothing.wrong, nothing.far, nothing.bits) == (1.0, 1.0, 0)
    assert (nothing.dropped, nothing.load) == (0.0, 0.0) and math.isnan(nothing.error_mm)


@pytest.fixture
def advised(monkeypatch):
    """Advice for a wall, of outcomes that a function makes from each configuration."""

    def advised(
        wrong, *, sensor=None, frame=None, progress=lambda *told: None, limit=lambda *given: ""
    ):
        nothing = Edges(*(np.zeros(0, np.int64) for _ in range(3)))
        for name, stand_in in {
            "_tried": lambda run: outcome(wrong(run.config), config=run.config),
            "_limit": limit,
            "Run._generated_edges": lambda run: nothing,
        }.items():
            monkeypatch.setattr(f"coincid.study.advise.{name}", stand_in)
        sensor = {"rows": 8, "cols": 8, "controller": 1} | (sensor or {})
        setup = Setup.of("flat:3", sensor=sensor, frame={"pulses": 200} | (frame or {}), klux=1.0)
        return advise(setup, klux=1.0, progress=progress)

    return advised


@pytest.mark.parametrize(
    ("sensor", "clock_mhz", "windows"),
    [
        ({}, 500, [8, 16, 32]),
        ({"window_max": 20}, 500, [8, 16, 20]),
        ({"window_max": 16}, 500, [8, 16]),  # which is two of them
        ({"phases": 8}, 125, [1, 2]),  # a tick is 1 ns
        ({"controller": 0}, 500, [8, 16, 32]),
    ],
)
def test_thresholds_and_the_controller_are_tried_with_each_window(
    advised, sensor, clock_mhz, windows
):
    """On one link and in one format. The controller has settled in its last frame; a threshold
    needs one frame.
    """
    frame = {"clock_mhz": clock_mhz, "frames": 3, "format": "full", "link_gbps": 2.0}
    advice = advised(lambda config: 0.1, sensor=sensor, frame=frame)
    found = []
    for one in (tried.config for tried in advice.settings):
        assert (one.format, one.frame.link_gbps) == ("compact", 8.0)
        assert one.coincidence.all()
        auto = bool(one.auto.all())
        assert one.frames == (8 if auto else 1)
        found.append((one.window[0], "auto" if auto else one.threshold[0]))
    settings = [1, 2, 3, 4, 5, 6, *["auto"] * (sensor.get("controller") != 0)]
    assert found == [(window, one) for window in windows for one in settings]


@pytest.mark.parametrize("auto", (False, True))
@pytest.mark.parametrize("counts", (0, 1))
def test_every_link_is_tried_with_every_format(advised, auto, counts):
    """In the frames of what was chosen; counts need one frame."""
    wrong = {auto: 0.1, not auto: 0.2}
    advice = advised(
        lambda config: wrong[bool(config.auto.any())],
        sensor={"counts": counts},
        frame={"gap": 10},
    )
    formats = ["compact", "id", *["counts"] * counts]
    rates_gbps = [0.05, 0.1, 0.25, 0.5, 1.0, 2.0, 4.0, 8.0, 16.0]
    expected = [(rate_gbps, name) for rate_gbps in rates_gbps for name in formats]
    configs = [tried.config for tried in advice.links]
    assert [(one.frame.link_gbps, one.format) for one in configs] == expected
    for one in configs:
        assert one.frames == (8 if auto and not one.counting else 1)


def test_the_progress_of_an_advice_ends_with_all_that_is_tried(advised):
    told = []
    advice = advised(lambda config: 0.1, progress=lambda *of: told.append(of))
    done = {}
    for stage, *amounts in told:
        done.setdefault(stage.partition(" (")[0], []).append(tuple(amounts))
    assert list(done) == ["photons", "thresholds and windows", "links and formats"]
    for name, tried in (
        ("thresholds and windows", advice.settings),
        ("links and formats", advice.links),
    ):
        assert done[name] == [(number, len(tried)) for number in range(len(tried) + 1)]


@pytest.mark.parametrize(("best", "is_told"), [(0.3, False), (0.4, True)])
def test_a_scene_is_useless_only_if_no_link_and_no_format_helps(
    advised, monkeypatch, best, is_told
):
    """Here the format `id` does, in which thresholds and windows were not tried."""
    told = []
    monkeypatch.setattr(
        "coincid.study.advise.useless_sentence", lambda *given: told.append(given) or "useless"
    )
    advice = advised(lambda config: best if config.format == "id" else 0.9)
    assert advice.useless == ("useless" if is_told else "")
    assert [given[0] for given in told] == [best] * is_told


@pytest.mark.parametrize("window", [8, 32])
def test_what_would_help_and_the_limit_are_those_of_the_window_that_is_advised(
    advised, monkeypatch, window
):
    """The configuration that one begins with has one of 16 ticks."""
    helped, limited = [], []
    monkeypatch.setattr(
        "coincid.study.advise.useless_sentence", lambda *given: helped.append(given[2]) or ""
    )
    advised(
        lambda config: 0.5 if config.window[0] == window else 0.9,
        limit=lambda run, config: limited.append(config.window[0]) or "",
    )
    assert helped == limited == [window]


def test_what_counts_would_do_is_told_with_both_shares(advised, monkeypatch):
    config = None

    def tried(run):
        nonlocal config
        config = run.config
        return Tried(
            config=config, wrong=0.123, far=0.045, error_mm=9.0, bits=4567, dropped=0.0, load=0.1
        )

    advised(lambda config: 0.1)  # in place of frames that are played
    monkeypatch.setattr("coincid.study.advise._tried", tried)
    setup = Setup.of("flat:3", sensor={"rows": 8, "cols": 8}, frame={"pulses": 200}, klux=1.0)
    assert advise(setup, klux=1.0).counts == (
        "With counts (counts = 1, format = counts), the sensor would send 4,567 bits per frame, and"
        " 12.3% of the pixels would be wrong (4.5% by more than 15 cm), at"
        f" {frames_per_s(config):,.4g} frames per second."
    )
    assert config.counting and config.frames == 1


def test_a_picture_is_useful_up_to_three_of_ten_wrong_pixels():
    assert is_useful(0.3) and not is_useful(0.3001)


@pytest.mark.parametrize(
    ("pulses", "more"), [(16_384, 65_536), (16_385, 65_536), (65_535, 65_536), (65_536, None)]
)
def test_more_pulses_help_up_to_the_most_that_a_frame_may_have(tried, pulses, more):
    setup = Setup.of("flat:9", sensor={"rows": 8, "cols": 8}, frame={"pulses": pulses}, klux=1.0)
    told = useless_sentence(0.9, setup, window=32)
    words = f"{more} laser pulses per frame instead of {pulses}"
    assert (words in told) == (more is not None)
    assert [one.config.pulses for one in tried] == [*[more] * bool(more), pulses, pulses]


def test_in_the_dark_less_light_does_not_help(tried):
    setup = Setup.of("flat:9", sensor={"rows": 8, "cols": 8}, frame={"pulses": 5}, klux=0.0)
    assert "ambient light" not in useless_sentence(0.9, setup, window=32)
    assert len(tried) == 2


@pytest.mark.parametrize(
    ("shares", "told"),
    [((0.9, 0.3, 0.8), "What would help: "), ((0.9, 0.31, 0.8), "None of these is enough by itse")],
)
def test_help_is_promised_only_where_one_change_is_enough(monkeypatch, shares, told):
    """Beside the distances: the nearest, the middle and the farthest."""
    found = iter(shares)
    monkeypatch.setattr("coincid.study.usefulness._least_wrong", lambda *given: next(found))
    wall_m = np.full((8, 8), 4.0)
    wall_m[0], wall_m[1, 3], wall_m[2] = 9.0, np.nan, 3.0
    setup = Setup.of(load_scene(wall_m, 8, 8), sensor={"rows": 8, "cols": 8}, klux=1.0)
    sentence = useless_sentence(0.456, setup, window=32)
    assert sentence.startswith(
        f"No setting leaves a useful picture: at best, 45.6% of the pixels are wrong. {told}"
    )
    assert "The distances are 3 to 9 m, 4 m in the middle;" in sentence


COUNTED = {"sensor": {"counts": 1}, "frame": {"format": "counts"}}


@pytest.mark.parametrize(
    ("quiet", "told", "words"),
    [
        ({"subgroup": {"gate_len": 5, "gating": True}}, {"subgroup": {"gate_len": 5}}, "gating is"),
        ({"frame": {"gate_step": 2}}, {"frame": {"gate_every": 5}}, "gating is off"),
        (
            {"frame": {"gate_every": 5, "gate_step": 1}},
            {"frame": {"gate_every": 5, "gate_step": 0}},
            "moves by 0 cycles",
        ),
        ({"frame": {"format": "compact"}}, {"frame": {"format": "short"}}, "sends no map"),
        (COUNTED, {"frame": {"format": "short"}}, "sends no map"),
        ({"frame": {"format": "compact"}}, {"frame": {"format": "id"}}, "; 'compact' carries"),
        ({"frame": {"format": "compact"}}, {"frame": {"format": "full"}}, "; 'compact-full' carr"),
        (
            {"frame": {"mg_threshold": 2, "minigroup_records": True}},
            {"frame": {"mg_threshold": 2}},
            "minigroup_records is off",
        ),
        (
            {"frame": {"minigroup_records": True}},
            {"frame": COUNTED["frame"] | {"minigroup_records": True}} | {"sensor": {"counts": 1}},
            "minigroup_records has no effect",
        ),
        (
            {"frame": {"dither_seed": 3, "dither_bits": 2}},
            {"frame": {"dither_seed": 3}},
            "dither_seed has no effect",
        ),
        (
            {"subgroup": {"window": 9}},
            {"subgroup": {"window": 9, "coincidence": False}},
            "window is set, but has no effect: coincidence is off",
        ),
        (
            {"subgroup": {"coincidence": False}},
            {"subgroup": {"window": 9, "coincidence": False}},
            "window is set",
        ),
        (
            {"subgroup": {"threshold": 1, "auto": True}},
            {"subgroup": {"threshold": 1}},
            "lets every photon through",
        ),
        (
            {"sensor": {"counts": 1}, "frame": COUNTED["frame"] | {"period": 256}},
            {"sensor": {"counts": 1}, "frame": COUNTED["frame"] | {"period": 257}},
            "Hits after cycle 255",
        ),
    ],
)
def test_what_is_wasted_is_not_told_beside_what_uses_it(quiet, told, words):
    for document, holds in ((quiet, False), (told, True)):
        assert any(words in line for line in warnings(parse_config(document))) == holds


@pytest.mark.parametrize(
    ("subgroup", "override", "words", "holds"),
    [
        ({"threshold": 2}, {"threshold": 1}, "lets every photon through", True),
        ({"mask": "f"}, {"mask": "1"}, "nothing can commit", True),
        ({"window": 20}, {"window": 64}, "but the longest window has", False),
        ({"window": 20}, {"window": 63}, "but the longest window has 63", True),
        ({"gate_len": 9}, {"gating": True}, "A gate is set, but gating is off", False),
        ({"gating": True, "gate_len": 9}, {"gate_start": 242}, "after the laser period", True),
        ({"window": 9}, {"coincidence": False}, "window is set, but has no effect", False),
        ({"auto": True}, {"coincidence": False}, "but coincidence is off: it has", True),
    ],
)
def test_what_one_subgroup_wastes_is_told_and_what_one_uses_is_not_wasted(
    subgroup, override, words, holds
):
    config = configured({}, {}, subgroup, {"subgroups": [7]} | override)
    assert any(words in line for line in warnings(config)) == holds


def test_every_row_of_what_a_configuration_means():
    """With sizes that are no squares, subgroups that differ, and a gap."""
    sensor = {"rows": 16, "cols": 24, "subgroup": [8, 12], "minigroup": [2, 3], "streams": 2}
    own = {"subgroups": [1], "window": 8, "threshold": 5}
    config = configured(sensor, {"gap": 5000}, {"window": 4}, own)
    frame_us = (100 * 250 + 99 * 5000) * 2 / 1000
    fitting = config.with_frame(capacity=None).capacity
    uw = uw_per_pixel(config, 50.0)
    assert dict(meaning(config)) == {
        "array": "16 x 24 pixels in 4 subgroups of 8 x 12",
        "minigroups": "16 of 2 x 3 in a subgroup",
        "clock": "500 MHz: a cycle is 2 ns, 29.98 cm",
        "tick": "62.5 ps, 0.9369 cm (32 per cycle)",
        "window": "4 to 8 ticks, 0.25 to 0.5 ns",
        "threshold": "2 to 5 pixels",
        "laser period": "250 cycles, 500 ns: 2000 kHz",
        "gap": "5,000 cycles, 10 us, between two periods",
        "laser": f"10 mW of mean power are {10e-3 * frame_us * 1e-6 / 100 * 1e9:.4g} nJ per pulse",
        "range": f"74.95 m; no window opens in the last {config.sensor.guard} cycles",
        "frame": f"100 pulses, {frame_us:.4g} us: {1e6 / frame_us:,.0f} frames per second",
        "event": "id: 3 beats of 64 bits",
        "events that fit": f"{fitting:,} per stream and frame, {fitting / frame_us:.4g} million"
        " per second",
        "stream": "2 of 32 Gbit/s; the link takes 100.0% of its beats",
        "area": f"about {um2_per_pixel(config.sensor):.0f} um2 per pixel in 45 nm",
        "power": f"about {uw / 1000:.3g} mW per pixel at 50 klux in a period",
    }
    grouped = dict(meaning(config.with_frame(format="compact")))["event"]
    assert grouped.startswith("compact: 0.") and grouped.endswith(
        "beats of 64 bits with three pixels"
    )
    counting = dict(meaning(parse_config(COUNTED)))
    assert counting["area"].endswith("in 45 nm, without the part for counts")
    assert counting["power"].endswith("at 50 klux, without the part for counts")


@pytest.mark.parametrize(
    ("name", "sensors"),
    [
        (
            "pixels",
            [{"subgroup": [rows, cols]} for rows, cols in ((4, 4), (4, 8), (8, 8), (16, 16))],
        ),
        ("minigroup_pixels", [{"minigroup": [side, side]} for side in (1, 2, 4)]),
        ("phases", [{"phases": phases} for phases in (8, 16, 32, 64)]),
        ("offsets", [{"offsets": 0}, {"offsets": 1}]),
        ("records", [{"records": 0}, {"records": 1}]),
        ("controller", [{"controller": 0}, {"controller": 1}]),
        ("fifo_depth", [{"fifo_depth": 8}, {"fifo_depth": 16}]),
    ],
)
def test_a_sensor_that_was_measured_has_the_area_of_its_measurement(name, sensors):
    """With the other parameters at their defaults. Between two sizes, it is between their areas."""
    values, areas = UM2_PER_PIXEL[name]
    found = [parse_config({"sensor": sensor}).sensor for sensor in sensors]
    assert [getattr(sensor, name) for sensor in found] == list(values)
    assert [um2_per_pixel(sensor) for sensor in found] == pytest.approx(areas)
    between = um2_per_pixel(parse_config({"sensor": {"subgroup": [8, 16]}}).sensor)
    assert 538.6 < between < 658.3


def test_the_limit_is_told_for_each_threshold_whatever_the_configuration_has(monkeypatch):
    """By hand: of the events 10 mm per pixel of the threshold, 5 mm of all photons."""

    def of_words(config, *light):
        assert config.coincidence.all() and not config.auto.any()
        (threshold,) = set(config.threshold.tolist())
        return SimpleNamespace(pixel_mm=10.0 * threshold)

    monkeypatch.setattr("coincid.study.advise.word_bounds_mm", of_words)
    monkeypatch.setattr("coincid.study.advise.photon_bound_mm", lambda *given: 5.0)
    own = {"coincidence": False, "auto": True, "threshold": 6}
    setup = Setup.of("flat:3", sensor={"rows": 8, "cols": 8}, subgroup=own, klux=1.0)
    told = limit(Run(setup), setup.config)
    assert re.fullmatch(
        r"The limit of a pixel with the median light \([\d.]+ photons per pulse\), without its"
        r" neighbours' distances: 5\.0 mm from all photons; from the words 10\.0 mm at threshold 1,"
        r" 20\.0 mm at threshold 2, 30\.0 mm at threshold 3\.",
        told,
    )
    monkeypatch.setattr("coincid.study.advise.median_light", lambda light: None)
    assert limit(Run(setup), setup.config) == "No pixel has light."


def test_the_picture_of_an_advice_has_a_mark_for_each_outcome(monkeypatch, tmp_path):
    """Numbers at the thresholds, a diamond for the controller, in the colour of their window."""
    drawn = []
    monkeypatch.setattr(
        "coincid.study.advise.save_figure", lambda figure, path: drawn.append(figure)
    )
    settings = []
    for window, least in ((8, 0.1), (16, 0.3)):
        for number, own in enumerate(({"threshold": 2}, {"threshold": 4}, {"auto": True})):
            config = parse_config({"subgroup": own | {"window": window}})
            wrong, bits = least + 0.01 * number, 1000 * window + number
            settings.append(outcome(wrong, bits=bits, config=config))
    best = outcome(0.5, config=parse_config({"frame": {"link_gbps": 4.0}}))
    advice = Advice(settings=settings, chosen=settings[1], links=[best], best=best, klux=1.0)
    write_advice(tmp_path, advice, "a wall")
    (axis,) = drawn[0].axes
    lines = {}
    for line in axis.lines:
        places = [tuple(place) for place in line.get_xydata().tolist()]
        lines.setdefault(line.get_marker(), []).append((places, line.get_color()))
    places = [(one.bits, one.wrong) for one in settings]
    (near, colour), (far, other), ring = lines["o"]
    assert (near, far, ring[0]) == (places[:2], places[3:5], [places[1]])
    own = [(found, shade) for found, shade in lines["D"] if found]
    assert own == [([places[2]], colour), ([places[5]], other)] and colour != other
    told = [(text.get_text(), text.xy, text.get_color()) for text in axis.texts]
    assert told == [
        (name, place, shade)
        for shade, of_window in ((colour, places[:2]), (other, places[3:5]))
        for name, place in zip("24", of_window, strict=True)
    ]
    assert [text.get_text() for text in axis.get_legend().get_texts()] == [
        "window of 0.5 ns",
        "window of 1 ns",
        "controller",
        "advised, with a link of 4 Gbit/s",
    ]
    assert (axis.get_xlabel(), axis.get_xscale()) == ("bits per frame", "log")
    assert axis.get_ylabel() == "share of wrong pixels" and axis.get_ylim()[0] == 0
    assert axis.get_title(loc="left").startswith("a wall: ")
