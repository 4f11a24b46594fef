# SPDX-License-Identifier: Apache-2.0
"""Parts of a user's own: those of docs/extend.md, from its own code blocks, and what is refused."""

import importlib
import re
import sys
from pathlib import Path

import numpy as np
import pytest
from amaranth.hdl import Module, Signal
from amaranth.sim import Simulator
from attrs import evolve

import coincid
from coincid.hdl.front_end_views import Polyphase
from coincid.lab.bound import bound
from coincid.lab.campaign import FinishedFiles, Processes, campaign
from coincid.lab.outcomes import Run
from coincid.lab.setup import Setup
from coincid.model.contract.coincidence import AT_LEAST, Rule, rises
from coincid.model.contract.config import parse_config
from coincid.model.contract.counters import COUNTER_NAMES
from coincid.model.contract.edges import Edges
from coincid.model.contract.parameters import Sensor
from coincid.model.depth import methods
from coincid.model.depth.arrivals import SYSTEM_FWHM_S
from coincid.model.depth.belief import LAW
from coincid.model.depth.depth import Depth
from coincid.model.depth.estimate import PEAKS, PLANES, estimate_depth
from coincid.model.depth.intensity import Intensity
from coincid.model.depth.methods import METHODS, method_names, register_estimator
from coincid.model.golden.frame import golden_result
from coincid.model.light.analytic import FORMS, histogram
from coincid.model.light.light import Light
from coincid.model.light.photons import generate_edges
from coincid.model.light.spad import OwnSpad, Spad, SpadGate, SpadTimes
from coincid.model.light.timing import Timing
from coincid.model.shared.pulse import Pulse, with_pulse
from coincid.study.sweep_spec import read_spec
from coincid.tb.replay import replay

from .commands import BLOCK
from .depth.equal import assert_equal_depths
from .told import Told

PAGE = Path(__file__).parents[1] / "docs" / "extend.md"
SHAPE = (8, 8)
SMALL = {"sensor": {"rows": 8, "cols": 8}, "frame": {"pulses": 100, "frames": 3, "capacity": 40}}


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    """Return the page's code blocks, one after the other, as a module in a folder of its own."""
    code = [
        block
        for language, block in BLOCK.findall(PAGE.read_text(encoding="utf-8"))
        if language == "python"
    ]
    folder = tmp_path_factory.mktemp("own")
    (folder / "own_parts.py").write_text("\n\n".join(code), encoding="utf-8")
    sys.path.insert(0, str(folder))
    try:
        yield importlib.import_module("own_parts")
    finally:
        sys.path.remove(str(folder))
        methods._registered.clear()


@pytest.fixture(autouse=True)
def registered():
    """Forget the estimators that a test registers."""
    before = dict(methods._registered)
    yield
    methods._registered.clear()
    methods._registered.update(before)


class Ready(OwnSpad):
    """A SPAD that is always ready."""

    name = "ready"
    version = "1"

    def edges_of(self, photons, *, pixels, seed):
        return SpadTimes(photons.pixel[::-1], photons.time_s[::-1])


class Far:
    """An estimator that sees everything at 7 m."""

    name = "far"
    reads = ("opened",)

    def __init__(self, version="1"):
        self.version = version

    def estimate(self, reading):
        return Depth.of(np.full((reading.config.sensor.rows, reading.config.sensor.cols), 7.0))


class Counts(Rule):
    """The paper's rule, as a rule of a user's own, without a circuit."""

    name = "counts"
    version = "1"

    def meets(self, maps, threshold):
        return maps.sum(axis=(1, 2)) >= threshold


def test_estimator_of_the_page_measures_the_wall(page):
    assert page.median_wrong < 0.1 and page.maximum_wrong < 0.1
    assert page.depth.depth_m.shape == (8, 8, 1)
    assert np.nanmedian(page.depth.depth_m) == pytest.approx(5, abs=0.03)
    run = page.run
    more = run.frame(0, page.Median()).depth(returns=3)
    assert (
        np.array_equal(more.depth_m[:, :, :1], page.depth.depth_m)
        and np.isnan(more.depth_m[:, :, 1:]).all()
    )
    with pytest.raises(
        coincid.InputError, match=r"method = 'mean': must be one of maximum, .*, planes, median$"
    ):
        run.depth("mean")
    with pytest.raises(
        coincid.InputError,
        match="source = 'subgroup': must be left out, because the estimator median",
    ):
        run.depth("median/subgroup")


def test_every_built_in_method_has_its_finder_and_its_law():
    assert set(METHODS) == {PLANES, *PEAKS} == set(LAW) - {"counts"}


def test_what_an_estimator_does_not_find_is_nan_in_all_that_it_tells():
    """It finds one return of three, with its error and its light."""
    run = Run(Setup.of("flat:5,0.4", **SMALL))

    def estimate(self, reading):
        one = np.full((*run.scene.truth_m.shape, 1), 2.0)
        light = Intensity(signal=one + 1, error=one + 2)
        slope_m = np.full((*run.scene.truth_m.shape, 2), 6.0)
        return evolve(Depth.of(one), error_m=one + 3, slope_m=slope_m, light=light)

    found = run.depth(type("Single", (Far,), {"estimate": estimate, "name": "single"})(), returns=3)
    told = {"depth_m": 2.0, "signal_per_pulse": 3.0, "signal_error": 4.0, "error_m": 5.0}
    for name, value in told.items():
        values = getattr(found, name)
        assert values.shape == (*run.scene.truth_m.shape, 3), name
        assert (values[:, :, 0] == value).all() and np.isnan(values[:, :, 1:]).all(), name
    assert np.array_equal(found.confidence, np.ones((*run.scene.truth_m.shape, 3)) * [1, 0, 0])
    assert np.all(found.slope_m == 6) and found.slope_m.shape == (*run.scene.truth_m.shape, 2)


@pytest.mark.parametrize("part", ["signal_per_pulse", "signal_error"])
def test_light_of_another_shape_than_the_distances_is_refused(part):
    run = Run(Setup.of("flat:5,0.4", **SMALL))
    right = np.ones((*run.scene.truth_m.shape, 1))
    parts = {"signal_per_pulse": right, "signal_error": right} | {part: right[:-1]}
    light = Intensity(signal=parts["signal_per_pulse"], error=parts["signal_error"])

    def estimate(self, reading):
        return evolve(Depth.of(right), light=light)

    own = type("Lit", (Far,), {"estimate": estimate, "name": "lit"})()
    with pytest.raises(coincid.InputError, match=f"lit.estimate: {part} has shape"):
        run.depth(own)


@pytest.mark.parametrize(
    ("part", "shape"),
    [
        ("error_m", SHAPE),
        ("error_m", (1, 1, 1)),
        ("slope_m", (*SHAPE, 1)),
        ("slope_m", (2,)),
        ("confidence", SHAPE),
        ("confidence", (*SHAPE, 2)),
        ("reason", (*SHAPE, 1)),
        ("reason", (1, 1)),
        ("depth_m", SHAPE),
        ("depth_m", (*SHAPE, 2)),
        ("depth_m", (*SHAPE, 0)),
    ],
)
def test_an_estimate_of_another_shape_is_refused(part, shape):
    run = Run(Setup.of("flat:5,0.4", **SMALL))
    found = evolve(Depth.of(np.ones(run.scene.truth_m.shape)), **{part: np.zeros(shape)})
    other = type("Misshapen", (Far,), {"estimate": lambda self, reading: found})()
    with pytest.raises(coincid.InputError, match=f"far.estimate: {part} has shape"):
        run.depth(other)


class Listening(Far):
    """Keeps what it is told."""

    name = "listening"
    reads = ("opened", "stamp")

    def estimate(self, reading):
        self.reading = reading
        return super().estimate(reading)


@pytest.fixture(scope="module")
def two_frames():
    frame = {"frames": 2, "pulses": 40}
    return Run(Setup.of("flat:5,0.4", sensor=SMALL["sensor"], frame=frame))


@pytest.mark.parametrize("method", ["maximum", "planes", Far()], ids=["peaks", "planes", "own"])
@pytest.mark.parametrize(
    ("option", "legal", "refused", "told"),
    [
        ("frame", (0, 1), (-1, 2, True, 0.0), "an integer from 0 to 1"),
        ("returns", (1, 8), (0, 9, True, 2.0), "an integer from 1 to 8"),
        ("workers", (1,), (0, 257, True), "an integer from 1 to 256"),
        ("system_fwhm_s", (1e-9,), (0.0, -1.0, np.nan, "1"), "a number from 1e-15 to 2e-08"),
    ],
)
def test_options_have_their_ranges_whatever_the_estimator_is(
    two_frames, method, option, legal, refused, told
):
    """Nothing is estimated of a frame that is not there."""
    result = two_frames.result
    options = {"method": method, "workers": 1}
    for value in legal:
        estimate_depth(result, two_frames.config, **options | {option: value})
    for value in refused:
        with pytest.raises(coincid.InputError, match=f"^{option} = .*: must be {told}$"):
            estimate_depth(result, two_frames.config, **options | {option: value})


def test_an_estimator_is_told_all_that_was_asked_for(two_frames):
    """With its own arrays only, and the pulse of the result where none is given."""
    own, pulse, other = Listening(), Pulse.gaussian(300e-12), Pulse.gaussian(400e-12)
    asked = {"frame": 1, "returns": 3, "workers": 2, "system_fwhm_s": 7e-10, "pulse": pulse}
    result = with_pulse(two_frames.result, other)
    estimate_depth(result, two_frames.config, method=own, **asked)
    assert {name: getattr(own.reading, name) for name in asked} == asked
    assert own.reading.arrays.keys() == set(own.reads)
    assert own.reading.config == two_frames.config
    estimate_depth(result, two_frames.config, method=own)
    assert own.reading.frame is own.reading.workers is None and own.reading.returns == 1
    assert np.array_equal(own.reading.pulse.density, other.density)
    assert np.array_equal(own.reading.pulse.time_s, other.time_s)
    estimate_depth(two_frames.result, two_frames.config, method=own)
    assert own.reading.pulse is None and own.reading.system_fwhm_s == SYSTEM_FWHM_S


def test_an_estimator_that_is_none_is_refused():
    run = Run(Setup.of("flat:5,0.4", **SMALL))

    def refused(message, **changed):
        other = type("Changed", (Far,), changed)()
        with pytest.raises(coincid.InputError, match=message):
            run.depth(other)

    refused("method = 'planes': is the name of a built-in estimator", name="planes")
    refused("method = 'a/b': must be a name", name="a/b")
    refused("far.reads = 'heat': must be one of", reads=("pulse", "heat"))
    refused("far.estimate: returned NoneType, must be a Depth", estimate=lambda self, reading: None)
    refused("depth_m has shape", estimate=lambda self, reading: Depth.of(np.zeros((2, 2))))
    with pytest.raises(coincid.InputError, match="method = 3: must be one of maximum"):
        register_estimator(3)


@pytest.mark.parametrize("source", ["minigroup", "subgroup"])
def test_an_estimator_of_a_users_own_has_no_source_in_a_setup_either(source):
    register_estimator(Far())
    assert Setup.of("flat:5,0.4", **SMALL, estimators=("far/map",)).estimators[0].name == "far"
    with pytest.raises(coincid.InputError, match=f"source = '{source}': must be left out, because"):
        Setup.of("flat:5,0.4", **SMALL, estimators=(f"far/{source}",))


def test_a_kept_point_is_not_taken_for_another_version(tmp_path):
    """Neither by object nor by name, here and in a sweep's SPEC; and another worker needs no registration."""
    finished = FinishedFiles(tmp_path, ["seen"])
    asked = []

    def seen(run):
        asked.append(run.setup.estimators[0].version)
        return {"seen": len(asked)}

    (tmp_path / "spec.toml").write_text('method = "far"\n[[axis]]\nklux = [5]\n', encoding="utf-8")
    for version in ("1", "2"):
        register_estimator(Far(version))
        (point,) = read_spec(tmp_path / "spec.toml").points
        setups = {"object": Setup.of("flat:5,0.4", **SMALL, estimators=(Far(version),))}
        setups |= {
            "name": Setup.of("flat:5,0.4", **SMALL, estimators=("far",)),
            "sweep": point.setup,
        }
        for _ in range(2):
            with Processes(1) as workers:
                campaign(setups, seen, workers, finished=finished)
    assert asked == ["1", "1", "2", "2"] and method_names()[-1] == "far"


def test_estimators_of_one_name_with_other_parameters_have_frames_of_their_own():
    run = Run(Setup.of("flat:5,0.4", **SMALL))
    for distance_m in (3.0, 5.0):
        frame = run.frame(0, Told(distance_m))
        assert np.all(frame.depth_m == distance_m)
        assert frame["wrong_share"] == (distance_m != 5.0)


def test_spad_of_the_page_recovers_slowly(page):
    edges = page.recovering.edges
    often = Run(page.recovering.setup.but(spad=Ready(), klux=1000.0)).edges
    less = Run(page.recovering.setup.but(klux=1000.0)).edges
    assert len(edges) > 100 and 0.3 * len(often) < len(less) < 0.9 * len(often)
    assert (
        np.all(np.diff(edges.pulse) >= 0) and edges.tick.max() < page.recovering.config.period_ticks
    )
    assert page.recovering["wrong_share"] < 0.3


def test_a_spad_that_is_always_ready_gets_the_photons_of_the_built_in_one():
    """With dither, gaps, light from beyond the period, a gate, unequal taps, unequal dark counts and
    a span that begins later.
    """
    taps = np.linspace(0.5, 1.5, 32)
    timing = Timing(
        period_cycles=40, tap_width_lsb=taps, dither_bits=4, gap_cycles=9, frame_pulses=50
    )
    gate = SpadGate(start_cycles=3, len_cycles=30)
    distance_m = np.where(np.arange(16) % 2, 2.0, 20.0)
    light = Light(rows=4, cols=4, distance_m=distance_m, signal_per_pulse=0.5, background_cps=2e6)
    options = {"pulses": 80, "pulse_start": 20, "seed": 5, "gate": gate}
    detector = {"jitter_fwhm_s": 0.0, "dark_cps": np.linspace(0, 5e6, 16)}
    own = generate_edges(light, Ready(**detector), timing, **options)
    ready = generate_edges(light, Spad(dead_time_s=0.0, **detector), timing, **options)
    same = (own.pulse == ready.pulse) & (own.pixel == ready.pixel) & (own.tick == ready.tick)
    assert len(own) == len(ready) > 500
    # a photon within a sixteenth of a tick of a tap's border may change its tick
    assert same.mean() > 0.9
    assert np.abs(own.tick - ready.tick)[own.pixel == ready.pixel].max() <= 1


@pytest.mark.parametrize("phases", [1, 100, 1024])
def test_photons_of_an_own_spad_are_no_coarser_than_a_tick(phases):
    """However short that is."""
    timing = Timing(period_cycles=40, phases=phases)
    light = Light(rows=4, cols=4, distance_m=2.0, signal_per_pulse=0.5, background_cps=2e6)
    own = generate_edges(light, Ready(jitter_fwhm_s=0.0), timing, pulses=20, seed=5)
    ready = Spad(dead_time_s=0.0, jitter_fwhm_s=0.0)
    built_in = generate_edges(light, ready, timing, pulses=20, seed=5)
    assert len(own) == len(built_in) > 100
    for name in ("pulse", "pixel", "tick"):
        assert np.array_equal(getattr(own, name), getattr(built_in, name))


class Late(Ready):
    """A SPAD whose avalanches come a microsecond after the photon."""

    name = "late"

    def edges_of(self, photons, *, pixels, seed):
        return SpadTimes(photons.pixel, photons.time_s + 1e-6)


def test_a_spad_of_a_users_own_and_a_measured_pulse_are_refused_together():
    """The pulse has a jitter in it already, which the SPAD would add again."""
    wall = Setup.of("flat:5", sensor={"rows": 8, "cols": 8}, frame={"pulses": 2}, spad=Ready())
    assert len(Run(wall).edges)
    told = "^pulse: the SPAD ready adds its own jitter, which a measured pulse has in it$"
    with pytest.raises(coincid.InputError, match=told) as raised:
        _ = Run(wall.but(pulse=Pulse.gaussian(500e-12))).edges
    assert raised.value.field == "pulse"


def test_avalanches_between_two_periods_are_no_edges():
    light = Light(rows=4, cols=4, distance_m=2.0, signal_per_pulse=0.5, background_cps=2e6)
    delay_cycles = round(1e-6 * Timing().clock_hz)
    for gap, share in ((2 * delay_cycles, 0), (delay_cycles - 40, 1)):
        timing = Timing(period_cycles=40, frame_pulses=50, gap_cycles=gap)
        ready = generate_edges(light, Ready(), timing, pulses=50, seed=5)
        late = generate_edges(light, Late(), timing, pulses=50, seed=5)
        assert len(ready) > 100
        assert len(late) == pytest.approx(share * len(ready), rel=0.1)


def test_a_spad_of_a_users_own_is_told_rows_and_then_columns():
    """It needs them for crosstalk."""
    told = []

    def edges_of(self, photons, *, pixels, seed):
        told.append(pixels)
        return photons

    own = type("Told", (Ready,), {"edges_of": edges_of, "name": "told"})()
    light = Light(rows=2, cols=6, distance_m=2.0, signal_per_pulse=0.5)
    generate_edges(light, own, Timing(), pulses=2, seed=1)
    assert told == [(2, 6)]


def edges_by(pixel, time_s, timing, **options):
    """Return the edges of 4 x 4 pixels with a SPAD that makes these, whatever the photons are."""

    def edges_of(self, photons, *, pixels, seed):
        return SpadTimes(pixel, time_s)

    own = type("Told", (Ready,), {"edges_of": edges_of, "name": "told"})()
    light = Light(rows=4, cols=4, distance_m=2.0, signal_per_pulse=0.0)
    return generate_edges(light, own, timing, **{"pulses": 2, "seed": 1} | options)


@pytest.mark.parametrize(
    ("pixel", "time_s", "told"),
    [
        ([0, 16], [0.0, 0.0], "pixel must be from 0 to 15$"),
        ([-1, 3], [0.0, 0.0], "pixel must be from 0 to 15$"),
        ([0.0, 1.0], [0.0, 0.0], r"must return int64\[n\] and float64\[n\] of the same length$"),
        ([0, 1], [0.0], r"must return int64\[n\] and float64\[n\] of the same length$"),
        ([[0, 1]], [[0.0, 0.0]], r"must return int64\[n\] and float64\[n\] of the same length$"),
    ],
)
def test_avalanches_that_are_none_are_refused(pixel, time_s, told):
    with pytest.raises(coincid.InputError, match=f"^told.edges_of: {told}"):
        edges_by(np.array(pixel), np.array(time_s), Timing())


@pytest.mark.parametrize("start", [0, 3])
def test_avalanches_of_all_pixels_count_from_the_first_to_the_last_tick_of_a_period(start):
    """Times count from the first pulse of the span. The clock is such that they are exact."""
    timing = Timing(clock_hz=2.0**29, phases=4, period_cycles=40, gap_cycles=8)
    cycle = np.array([-0.25, 0.0, 39.75, 40.0, 47.75, 48.0, 87.75, 88.0, 96.0, np.inf, np.nan])
    time_s = cycle / timing.clock_hz
    pixel = np.arange(len(cycle)) + 5
    found = edges_by(pixel, time_s, timing, pulse_start=start)
    rows = np.stack([found.pulse, found.pixel, found.tick], axis=1)
    first, second = start, start + 1
    assert rows.tolist() == [[first, 6, 0], [first, 7, 159], [second, 10, 0], [second, 11, 159]]
    none = np.zeros(0, np.int64)
    assert len(edges_by(none, none.astype(float), timing)) == 0


def touches(maps):
    return (maps[:, :, 1:] & maps[:, :, :-1]).any(axis=(1, 2)) | (maps[:, 1:] & maps[:, :-1]).any(
        axis=(1, 2)
    )


def maps_of(result, shape=SHAPE):
    bits = np.unpackbits(
        result["hits"].view(np.uint8), axis=1, bitorder="little", count=shape[0] * shape[1]
    )
    return bits.astype(bool).reshape(-1, *shape)


def test_rule_of_the_page_keeps_windows_with_neighbours_only(page):
    all_events = maps_of(Run(page.setup).result)
    events = maps_of(page.touching.result)
    assert np.array_equal(events, all_events[touches(all_events)]) and 10 < len(events) < len(
        all_events
    )
    counters = page.touching.traces[0].counters
    other = Run(page.setup).traces[0].counters
    count = dict(zip(COUNTER_NAMES, counters[0].tolist(), strict=True))
    assert (
        count["opened"]
        == count["committed"] + count["rejected"]
        == other[0, COUNTER_NAMES.index("opened")]
    )


def test_circuit_of_the_page_is_its_rule(page):
    rule = page.Neighbours()
    random = np.random.default_rng(1)
    m = Module()
    hits = Signal(64)
    count = Signal(7)
    threshold = Signal(7)
    met = Signal()
    m.d.comb += met.eq(rule.judging_circuit(hits, count, threshold, SHAPE))
    told = []

    async def bench(ctx):
        for _ in range(200):
            drawn = random.random((1, *SHAPE)) < random.uniform(0.01, 0.15)
            limit = int(random.integers(1, 5))
            ctx.set(hits, int("".join(map(str, drawn.ravel().astype(int)[::-1])), 2))
            ctx.set(count, int(drawn.sum()))
            ctx.set(threshold, limit)
            told.append(bool(ctx.get(met)))
            assert told[-1] == rule.judged(drawn, limit)[0]

    simulator = Simulator(m)
    simulator.add_testbench(bench)
    simulator.run()
    assert 20 < sum(told) < 180


class LastRow(Rule):
    """Enough pixels, one of them in the last row."""

    name = "last-row"
    version = "1"

    def meets(self, maps, threshold):
        return (maps.sum(axis=(1, 2)) >= threshold) & maps[:, -1].any(axis=1)


@pytest.mark.parametrize("subgroup", [[4, 8], [8, 4], [16, 8]])
def test_a_rule_sees_the_rows_and_columns_of_the_subgroup(subgroup):
    """Also where the map of a window is several words."""
    setup = Setup.of(
        "flat:5,0.4",
        sensor={"rows": 16, "cols": 8, "subgroup": subgroup},
        frame={"pulses": 200, "link_gbps": 0},
        klux=50.0,
    )
    edges = Run(setup).edges
    result = golden_result(setup.config, edges)
    in_last_row = maps_of(result, subgroup)[:, -1].any(axis=1)
    kept = golden_result(setup.config.with_rule(LastRow()), edges)
    assert 10 < np.count_nonzero(in_last_row) < len(in_last_row) - 10
    names = ("subgroup", "pulse", "stamp", "winner")
    found = sorted(zip(*(kept[name] for name in names), strict=True))
    assert found == sorted(zip(*(result[name][in_last_row] for name in names), strict=True))


class OneMore(Rule):
    """One pixel more than the threshold."""

    name = "one-more"
    version = "1"

    def meets(self, maps, threshold):
        return maps.sum(axis=(1, 2)) > threshold

    def least(self, threshold):
        return threshold + 1


@pytest.mark.parametrize("threshold", (2, 3, 4))
def test_the_counter_of_the_threshold_below_is_what_that_threshold_commits(threshold):
    """Also at threshold 1, which every window meets, whatever its own rule."""
    setup = Setup.of("flat:5,0.4", **SMALL, klux=50.0)
    config = setup.config.with_rule(OneMore())
    edges = Run(setup).edges
    result = golden_result(config.with_settings(threshold=threshold), edges)
    below = golden_result(config.with_settings(threshold=threshold - 1), edges)
    assert np.array_equal(result["lower"], below["committed"])
    assert result["committed"].sum() < result["lower"].sum()


def test_the_papers_rule_as_ones_own_gives_the_papers_words_bounds_and_light():
    for subgroup in ({"threshold": 3}, {"auto": True, "threshold": 2}, {"coincidence": False}):
        setup = Setup.of("flat:5,0.4", **SMALL, klux=50.0, subgroup=subgroup)
        own = setup.config.with_rule(Counts())
        edges = Run(setup).edges
        expected, found = golden_result(setup.config, edges), golden_result(own, edges)
        assert all(np.array_equal(expected[name], found[name]) for name in expected)
        assert own.auto_bounds.tolist() == setup.config.auto_bounds.tolist()
        assert own.with_sensor(fifo_depth=4).sensor.rule == Counts() != AT_LEAST
    assert rises(Counts(), SHAPE, 5) == rises(AT_LEAST, SHAPE, 5) == ((5, 1.0),)


def test_a_threshold_means_to_light_what_the_rule_says(page):
    """At two pixels, the share of random windows that touch is known: 112 of 2016 pairs."""
    first = rises(page.Neighbours(), SHAPE, 2)[0]
    assert first.pixels == 2 and first.share == pytest.approx(112 / 2016, abs=0.015)
    assert sum(rise.share for rise in rises(page.Neighbours(), SHAPE, 2)) == pytest.approx(1)
    light = {"threshold": 2, "window_ticks": 40, "pulses": 100, "timing": Timing(period_cycles=40)}
    own = Sensor(rows=8, cols=8, rule=page.Neighbours())
    of_pairs, of_neighbours = (
        histogram(2.0, 0.05, 1e6, form=FORMS[1], sensor=sensor, **light).sum()
        for sensor in (None, own)
    )
    assert 0.05 * of_pairs < of_neighbours < 0.5 * of_pairs
    with pytest.raises(
        coincid.InputError, match="knows only the paper's rule, not sensor.rule = 'neighbours'"
    ):
        histogram(2.0, 0.05, 1e6, form=FORMS[0], sensor=own, **light)


@pytest.mark.parametrize("method", METHODS)
def test_depth_and_light_by_a_rule_are_those_of_what_it_means(method):
    """One pixel more than a threshold of 2 is the paper's threshold of 3."""
    setup = Setup.of("flat:5,0.4", **SMALL, klux=20.0, subgroup={"threshold": 3})
    own = setup.config.with_rule(OneMore()).with_settings(threshold=2)
    edges = Run(setup).edges
    expected, found = (
        estimate_depth(golden_result(config, edges), config, method=method)
        for config in (setup.config, own)
    )
    assert np.nanmedian(found.signal_per_pulse) > 0
    assert_equal_depths(found, expected, ("depth_m", "confidence", "reason", "signal_per_pulse"))


def test_a_bound_by_a_rule_is_that_of_what_it_means():
    usual = parse_config({"subgroup": {"threshold": 3}})
    own = usual.with_rule(OneMore()).with_settings(threshold=2)
    assert bound(own, trials=1) == bound(usual, trials=1)


@pytest.mark.parametrize("method", ["planes", "background"])
def test_a_rule_that_windows_meet_more_and_more_often_does_not_move_a_wall(page, method):
    """Nor its light: of the windows of two pixels, few have two that touch; of those of ten, most."""
    setup = Setup.of(
        "flat:4,0.2",
        sensor={"rows": 16, "cols": 16},
        frame={"pulses": 500, "link_gbps": 0},
        subgroup={"threshold": 2},
        klux=20.0,
    )
    run = Run(setup.but(config=setup.config.with_rule(page.Neighbours())))
    assert run["rejected"] > 0.3 * run["opened"]
    depth = run.depth(method)
    assert np.mean(depth.depth_m) == pytest.approx(4, abs=4e-3)
    assert np.mean(depth.signal_per_pulse) == pytest.approx(run.light.total_signal.mean(), rel=0.05)


class EveryPixel(Rule):
    """Only windows in which all pixels fire."""

    name = "every-pixel"
    version = "1"

    def meets(self, maps, threshold):
        return maps.all(axis=(1, 2))


def test_a_rule_that_only_full_windows_meet_rises_at_all_pixels():
    assert rises(EveryPixel(), SHAPE, 2) == ((SHAPE[0] * SHAPE[1], 1.0),)


def test_a_rule_without_a_circuit_is_refused_by_the_rtl():
    config = Setup.of("flat:5,0.4", **SMALL).config.with_rule(Counts())
    with pytest.raises(
        coincid.InputError,
        match="sensor.rule = 'counts': has no circuit, so only the engine golden",
    ):
        Counts().circuit(Signal(64), Signal(7), Signal(7), SHAPE)
    edges = Edges(*(np.zeros(0, np.int64) for _ in range(3)))
    for engine in ("sliced", "icarus"):
        with pytest.raises(coincid.InputError, match="sensor.rule = 'counts': has no circuit"):
            replay(engine, config, edges)
    with pytest.raises(coincid.InputError, match="sensor.rule = 3: must be a Rule"):
        config.with_rule(3)


def test_view_of_the_page_has_its_own_front_end(page):
    assert re.search(r"windows_seen <= ", page.files["watched_tree.v"])
    assert {"watched_subgroup.v", "watched_module_1.v"} <= page.files.keys()
    config = Setup.of("flat:5,0.4", **SMALL).config
    edges = Edges(*(np.zeros(0, np.int64) for _ in range(3)))
    with pytest.raises(
        coincid.InputError,
        match="engine of the view watched = 'sliced': must be one of verilator, icarus",
    ):
        replay("sliced", config, edges, view=page.Watched())
    taken = type("Taken", (Polyphase,), {})()
    with pytest.raises(coincid.InputError, match="view = 'polyphase': must be another name"):
        replay("verilator", config, edges, view=taken)
