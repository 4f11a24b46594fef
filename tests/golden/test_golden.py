# SPDX-License-Identifier: Apache-2.0
"""The golden model against the plain model, and laws that it must obey."""

import itertools

import attrs
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from coincid.model.contract.config import parse_config
from coincid.model.contract.counters import COUNTER_NAMES
from coincid.model.contract.edges import Edges, Fate
from coincid.model.contract.groups import FIRST_LSB, HEAD
from coincid.model.contract.latency import COMMIT
from coincid.model.contract.parameters import OFFSET_NONE, STAMP_FIELD_BITS
from coincid.model.contract.result import ResultBuilder, map_numbers
from coincid.model.contract.settings import BUDGET_GROWTHS
from coincid.model.contract.stream import decode_frame
from coincid.model.golden import frame as golden_frame
from coincid.model.golden.controller import Controller
from coincid.model.golden.frame import Golden, Trace, golden_result, trace_of
from coincid.model.golden.shape import COUNTER
from coincid.model.shared.errors import InputError

from ..benches.plain_model import PlainController, PlainSubgroup, period_starts, plain_run
from ..feature_pairs import BUILT, USED, lively_pairs, paired_cases, pairs_of, played, sensor_of
from ..random_cases import GOLDEN_SENSORS as SENSORS
from ..random_cases import (
    READY_KINDS,
    configurations,
    configured,
    controlled,
    ready_pattern,
    trouble,
)
from .counts_in_rows import Frame, plain_counts, read_rows

seeds = st.integers(0, 2**32 - 1)
densities = st.sampled_from((0.0, 0.5, 4.0, 20.0, 40.0))


@pytest.mark.parametrize("sensor", SENSORS)
@settings(max_examples=40)
@given(data=st.data())
def test_plain_model(sensor, data):
    config = data.draw(configurations(SENSORS[sensor]))
    if not config.counting:
        config = config.with_frame(format="full")
    edges = trouble(config, data.draw(seeds), data.draw(densities))
    ready = ready_pattern(
        data.draw(seeds),
        data.draw(st.sampled_from(READY_KINDS)),
        config.pulses * config.period + 100,
    )
    result = golden_result(config, edges, ready)
    assert_plain(config, edges, result)


@pytest.mark.parametrize("sensor", SENSORS)
@settings(max_examples=20)
@given(data=st.data())
def test_a_frame_in_pieces_is_the_frame(sensor, data):
    config = data.draw(configurations(SENSORS[sensor]))
    edges = trouble(config, data.draw(seeds), data.draw(densities))
    of_frame, _ = edges.frame(0, config.pulses)
    ready = ready_pattern(data.draw(seeds), data.draw(st.sampled_from(READY_KINDS)), 1000)
    whole = Golden(config.sensor).frame(config, of_frame, ready)
    cuts = data.draw(st.sets(st.integers(0, config.pulses)))
    borders = [0, *sorted(cuts), config.pulses]
    opened = Golden(config.sensor).begin(config, ready)
    sent = [opened.sent()]
    fate = np.empty(len(of_frame), np.uint8)
    for first, end in itertools.pairwise(borders):
        piece = np.flatnonzero((first <= of_frame.pulse) & (of_frame.pulse < end))
        fate[piece] = opened.take(of_frame.take(piece))
        if data.draw(st.booleans()):
            sent.append(opened.sent())
    ending = opened.close()
    sent.append(opened.sent())
    of_streams = list(zip(*sent, strict=True))
    assert_same_trace(trace_of(of_streams, ending, fate), whole)


@pytest.mark.parametrize(("phases", "coarse_bits"), [(4, 13), (64, 9)])
def test_the_longest_period_of_the_largest_subgroup(phases, coarse_bits):
    """Edges of its first and last pixels, and at the borders of all powers of two of its ticks."""
    sensor = dict(rows=16, cols=16, subgroup=[16, 16], phases=phases, coarse_bits=coarse_bits)
    frame = {"pulses": 3, "period": 1 << coarse_bits, "format": "full", "minigroup_records": True}
    config = configured(sensor, frame, {"threshold": 2, "window": phases + 1})
    assert config.sensor.coarse_bits == config.sensor.coarse_bits_max
    begins = [0, *(1 << bit for bit in range(phases.bit_length(), config.sensor.stamp_bits))]
    last_pixels = np.array([0, 1, 127, 128, 254, 255])
    pulse, begin, pixel = np.meshgrid(range(3), begins, last_pixels, indexing="ij")
    tick = begin + np.random.default_rng(1).integers(0, phases, begin.shape)
    edges = Edges(pulse.ravel(), pixel.ravel(), tick.ravel())
    result = golden_result(config, edges)
    assert result["stamp"].max() >= config.period_ticks // 2
    assert_plain(config, edges, result)


@pytest.mark.parametrize("records", [False, True])
@pytest.mark.parametrize("format_name", ["id", "full", "compact"])
def test_a_frame_in_pieces_behind_a_slow_link_is_the_frame(format_name, records):
    """Events and records of several subgroups wait at the borders of the pieces."""
    frame = {"pulses": 30, "period": 40, "link_gbps": 3.0, "format": format_name}
    frame["minigroup_records"] = records
    config = configured(SENSORS["default"], frame, {"threshold": 1, "window": 4})
    edges = trouble(config, 1, 6.0)
    whole = Golden(config.sensor).frame(config, edges)
    opened = Golden(config.sensor).begin(config)
    sent = []
    fate = np.empty(len(edges), np.uint8)
    for pulse in range(config.pulses):
        piece = np.flatnonzero(edges.pulse == pulse)
        fate[piece] = opened.take(edges.take(piece))
        sent.append(opened.sent())
    ending = opened.close()
    sent.append(opened.sent())
    assert_same_trace(trace_of(list(zip(*sent, strict=True)), ending, fate), whole)


@pytest.mark.parametrize("piece_edges", [1, 7, 100])
@pytest.mark.parametrize("order", ["of time", "any"])
def test_a_frame_of_more_edges_than_a_piece_has_is_the_frame(piece_edges, order, monkeypatch):
    """Each pulse is in one piece, however many edges it has; fates are in the order of the edges."""
    frame = {"pulses": 12, "period": 40, "minigroup_records": True}
    config = configured(SENSORS["default"], frame, {"threshold": 1, "window": 4})
    edges = trouble(config, 1, 6.0)
    in_time = np.argsort(edges.pulse, kind="stable")
    chosen = in_time if order == "of time" else np.random.default_rng(1).permutation(len(edges))
    edges = edges.take(chosen)
    whole = Golden(config.sensor).frame(config, edges)
    assert 100 < len(edges) < golden_frame.PIECE_EDGES
    assert np.bincount(edges.pulse).max() > 7
    monkeypatch.setattr(golden_frame, "PIECE_EDGES", piece_edges)
    assert_same_trace(Golden(config.sensor).frame(config, edges), whole)


def with_rising_thresholds():
    """Return a configuration whose thresholds change from frame to frame, and light for it."""
    config = parse_config(
        {
            "sensor": SENSORS["default"],
            "frame": {"pulses": 6, "capacity": 20, "auto_bounds": [0] * 6},
            "subgroup": {"threshold": 1, "auto": True},
        }
    )
    return config, trouble(config, 3, 10)


def test_a_frame_that_another_model_played_is_followed():
    """The next one has its number, and thresholds and budgets as if this model had played it."""
    config, edges = with_rising_thresholds()
    played, following = Golden(config.sensor), Golden(config.sensor)
    for _ in range(3):
        following.follow(config, played.frame(config, edges).counters)
    assert following.frames == played.frames == 3
    assert_same_trace(following.frame(config, edges), played.frame(config, edges))


def test_the_progress_of_a_result_is_the_number_of_its_frames_so_far():
    config = configured(SENSORS["tiny"], {"pulses": 2, "frames": 3})
    told = []
    golden_result(config, trouble(config, 1, 4.0), progress=told.append)
    assert told == [1, 2, 3]


@pytest.mark.parametrize("stalled", range(1000, 1010))
def test_a_receiver_that_is_ready_again_takes_what_the_link_has(stalled):
    """Behind the last cycle that is told, it is always ready; so it may as well be told. The link
    takes a beat in one of some ten cycles, so the stall ends at each distance from it.
    """
    frame = {"period": 60, "pulses": 40, "link_gbps": 3.3}
    config = configured(SENSORS["one"], frame, {"threshold": 1})
    edges = trouble(config, 1, 4.0)
    traces = [
        Golden(config.sensor).frame(config, edges, np.arange(told) >= stalled)
        for told in (stalled, 4 * stalled)
    ]
    assert len(traces[0].commit_cycle) > 20
    assert_same_trace(*traces)


def test_every_counter_stops_at_its_end():
    """Narrow counters of a long frame are those of 32 bits, and none of these fits into them."""
    frame = {"period": 60, "pulses": 1600, "minigroup_records": True, "mg_threshold": 1}
    wide = configured(SENSORS["one"], frame, {"threshold": 2, "window": 4})
    narrow = wide.with_sensor(counter_bits=9)
    edges = trouble(wide, 1, 30.0)
    cycle = np.arange(wide.pulses * wide.period)
    ready = (cycle < len(cycle) // 2) | (cycle % 40 == 0)  # at first nothing is lost, then most
    expected = golden_result(wide, edges, ready)
    result = golden_result(narrow, edges, ready)
    for name in COUNTER_NAMES:
        if name != "threshold_used":
            assert expected[name].min() > narrow.sensor.counter_max, name
        capped = np.minimum(expected[name], narrow.sensor.counter_max)
        np.testing.assert_array_equal(result[name], capped, err_msg=name)


def assert_same_trace(trace, expected, but=()):
    for name in attrs.fields_dict(Trace).keys() - set(but):
        one = getattr(trace, name)
        other = getattr(expected, name)
        if not isinstance(one, list):
            one = [one]
            other = [other]
        for a, b in zip(one, other, strict=True):
            np.testing.assert_array_equal(a, b, err_msg=name)


def test_a_piece_of_earlier_pulses_is_refused():
    config = configured(SENSORS["tiny"], {"pulses": 4})
    edges = trouble(config, 1, 4.0)
    opened = Golden(config.sensor).begin(config)
    opened.take(edges.take(edges.pulse == 2))
    with pytest.raises(InputError, match=r"pulse = 1: must be from 3 on, behind the last piece"):
        opened.take(edges.take(edges.pulse == 1))


def test_the_frame_number_starts_over_after_16_bits():
    config = configured(SENSORS["tiny"], {"pulses": 1})
    golden = Golden(config.sensor)
    golden.frames = 0xFFFF
    numbers = []
    for _ in range(2):
        beats = golden.frame(config, trouble(config, 1, 4.0)).beats[0]
        subgroups = len(config.sensor.stream_subgroups(0))
        numbers.append(decode_frame(beats, config.sensor, subgroups).number)
    assert numbers == [0xFFFF, 0]


def test_every_pair_of_features():
    """Of the sensor as built, of a frame, its light and its receiver; also in aborted frames.

    Every pair that allows events has some: in an empty frame, no bug can show.
    """
    with_events = set()
    for number, case in enumerate(paired_cases(BUILT | USED)):
        sensor = sensor_of(case)
        frames = played(sensor, case, number)
        traces = frames.traces(Golden(frames.config.sensor))
        assert_whole_frames(frames, traces)
        result = ResultBuilder(frames.shorter)
        for trace in traces:
            result.add(trace.beats, trace.commit_subgroup, trace.commit_cycle)
        fate = np.concatenate([trace.fate for trace in traces])
        arrays = result.arrays() | {"fate": fate}
        assert_plain(frames.shorter, frames.edges, arrays, frames.pulses)
        counted = "gate_hits" in arrays and arrays["gate_hits"].any()
        if counted or any(len(trace.commit_cycle) for trace in traces):
            with_events |= pairs_of(case)
    assert lively_pairs(BUILT | USED) <= with_events


def assert_whole_frames(frames, traces):
    """Check that frames that are aborted equal those that have only these pulses. A frame of counts
    has no such other one.
    """
    if frames.config.counting:
        return
    shorter = Golden(frames.config.sensor)
    for edges, trace in zip(frames.frames, traces, strict=True):
        whole = shorter.frame(frames.shorter, edges, frames.ready, into_gap=frames.into_gap)
        assert_same_trace(trace, whole, but=() if frames.config.sensor.controller else ("budget",))


def assert_plain(config, edges, result, pulses=None):
    """Check a result against the plain model, as far as the format shows it. pulses: of each frame,
    if not those of the configuration.
    """
    sensor = config.sensor
    frames, fate = plain_run(config, edges, pulses)
    assert result["fate"].tolist() == fate
    for f, subgroups in enumerate(frames):
        for s, plain in enumerate(subgroups):
            for name in ("opened", "committed", "rejected", "photons", "blind", "lower"):
                expected = min(getattr(plain, name), sensor.counter_max)
                if name == "lower" and not sensor.controller:
                    expected = 0
                assert result[name][f, s] == expected, name
            assert result["threshold_used"][f, s] == plain.threshold_used
            in_frame = result["pulse"] // config.pulses == f
            rows = np.flatnonzero((result["subgroup"] == s) & in_frame)
            assert min(len(rows), sensor.counter_max) == result["stored"][f, s]
            _check_rows(config, result, rows, plain.events, f)
            in_frame = result["mg_pulse"] // config.pulses == f
            records = np.flatnonzero((result["mg_subgroup"] == s) & in_frame)
            _check_records(config, result, records, plain.records, f)
            assert len(records) == result["mg_stored"][f, s]
            assert len(plain.records) == result["mg_stored"][f, s] + result["mg_dropped"][f, s]
    if config.counting:
        assert_plain_counts(config, edges, result, pulses)


def assert_plain_counts(config, edges, result, pulses):
    """Check gates and counts of a result against the plain counts."""
    frame = Frame(config.sensor.subgroup, config.period, config.search_pulses, config.pulses)
    for f, subgroups in enumerate(plain_counts(config, edges, result["fate"].tolist(), pulses)):
        for s, groups in enumerate(subgroups):
            expected = read_rows(groups, frame)
            for name, values in expected._asdict().items():
                np.testing.assert_array_equal(result[name][f, s], values, err_msg=name)


def _check_records(config, result, rows, records, frame):
    """Check that rows are the records in order, without those that were dropped."""
    left = iter(records)
    for row in rows:
        pulse = result["mg_pulse"][row] - frame * config.pulses
        expected = next(entries for at, entries in left if at == pulse)
        got = {}
        for g in np.flatnonzero(result["mg_map"][row]).tolist():
            got[g] = int(result["mg_stamp"][row, g]), int(result["mg_map"][row, g])
        assert got == expected


def _check_rows(config, result, rows, events, frame):
    """Check that rows are the events in order, gaps are counted as dropped, and only the first
    after a gap has `overrun`.
    """
    starts, at = period_starts(config), 0
    for row in rows:
        gap = 0
        while events[at][:2] != (
            result["pulse"][row] - frame * config.pulses,
            result["stamp"][row],
        ):
            at, gap = at + 1, gap + 1
        pulse, stamp, count, winner, hits, offsets, close_cycle = events[at]
        assert (result["count"][row], result["winner"][row]) == (count, winner)
        assert result["overrun"][row] == (gap > 0)
        assert result["commit_cycle"][row] == starts[pulse] + close_cycle + COMMIT
        if "hits" in result:
            shown = map_numbers(result["hits"][row : row + 1])[0]
            assert int(shown) == sum(1 << pixel for pixel in hits)
        if "mg_offset" in result:
            of_groups = result["mg_offset"][row]
            hit = np.flatnonzero(of_groups != OFFSET_NONE)
            assert dict(zip(hit.tolist(), of_groups[hit].tolist(), strict=True)) == offsets
        at += 1


@pytest.mark.parametrize("auto", ["of none", "of all", "of one"])
def test_frames_side_by_side_are_frames_in_turn(auto):
    config = parse_config(
        {
            "sensor": SENSORS["tiny"],
            "frame": {"period": 40, "pulses": 20},
            "subgroup": {"auto": auto == "of all"},
            "override": [{"subgroups": [0], "auto": auto != "of none"}],
        }
    )
    edges = [trouble(config, seed, 10.0) for seed in range(5)]
    turns, together = Golden(config.sensor), Golden(config.sensor)
    expected = [turns.frame(config, of_frame) for of_frame in edges]
    for one, other in zip(expected, together.frames_of(config, edges, 3), strict=True):
        for name in ("commit_cycle", "freed_cycle", "fate", "counters", "budget"):
            assert np.array_equal(getattr(one, name), getattr(other, name))
        assert all(map(np.array_equal, one.beats + one.beat_cycle, other.beats + other.beat_cycle))
    assert together.frames == 5


def test_counters_that_a_caller_changes_are_not_those_of_the_controller():
    config = parse_config(
        {
            "sensor": SENSORS["tiny"],
            "frame": {"period": 40, "pulses": 20, "auto_bounds": [0] * 6, "capacity": 4},
            "subgroup": {"auto": True},
        }
    )
    edges = [trouble(config, seed, 10.0) for seed in range(4)]
    model, other = Golden(config.sensor), Golden(config.sensor)
    for of_frame in edges:
        trace = model.frame(config, of_frame)
        changed = other.frame(config, of_frame)
        assert np.array_equal(trace.counters, changed.counters)
        changed.counters[:] = 0
    assert trace.counters[:, COUNTER_NAMES.index("threshold_used")].max() > 1


@pytest.mark.parametrize("sensor", ("one", "odd", "tiny", "wide"))
@given(data=st.data())
def test_controller(sensor, data):
    """Thresholds and budgets equal those of the plain model over many frames of changing light."""
    config = data.draw(controlled(SENSORS[sensor], frames=8))
    edges = trouble(config, data.draw(seeds), data.draw(densities))
    keep = np.random.default_rng(data.draw(seeds)).random(config.frames)[
        edges.pulse // config.pulses
    ]
    dimmed = edges.pixel / config.sensor.array_pixels < keep * 1.5
    edges = edges.take(dimmed)
    frames, _ = plain_run(config, edges)
    result = golden_result(config, edges, ready_pattern(0, "stalled", 200))
    for name in ("opened", "committed", "lower", "threshold_used"):
        assert result[name].tolist() == [
            [getattr(plain, name) for plain in subgroups] for subgroups in frames
        ], name


@given(data=st.data())
def test_controller_at_ties(data):
    """Counters are set to the numbers that they are compared with, to one less and to one more.
    Budgets and thresholds are still those of the plain model.
    """
    config = data.draw(controlled(SENSORS["odd"], frames=1))
    rng = np.random.default_rng(data.draw(seeds))
    controller, plain, sensor = Controller(config.sensor), PlainController(config), config.sensor
    stream_of = np.array([sensor.stream_of(s) for s in range(sensor.subgroups)])
    for _ in range(12):
        threshold = controller.begin(config)
        assert threshold.tolist() == plain.threshold
        counters = np.zeros((sensor.subgroups, len(COUNTER)), np.int64)
        counters[:, COUNTER.threshold_used] = threshold
        budget = controller.budget
        grown = [
            np.minimum(budget + (budget >> growth) + 1, config.capacity)
            for growth in BUDGET_GROWTHS
        ]
        for name, choices in (
            ("opened", np.tile(config.auto_bounds, (sensor.subgroups, 1))),
            (
                "committed",
                np.stack([budget, controller.limit, grown[0], 0 * budget], axis=1)[stream_of],
            ),
            ("lower", np.stack([budget, *grown], axis=1)[stream_of]),
        ):
            chosen = rng.integers(0, choices.shape[1], sensor.subgroups)
            ties = choices[np.arange(sensor.subgroups), chosen] + rng.integers(
                -1, 2, sensor.subgroups
            )
            counters[:, getattr(COUNTER, name)] = np.maximum(ties, 0)
        for stream in range(sensor.streams):  # often, the sum is the capacity
            last, others = (
                np.flatnonzero(stream_of == stream)[-1],
                np.flatnonzero(stream_of == stream)[:-1],
            )
            left = (
                config.capacity * rng.integers(1, 3)
                - counters[others, COUNTER.committed].sum()
                + rng.integers(-1, 2)
            )
            if left >= 0 and rng.random() < 0.5:
                counters[last, COUNTER.committed] = left
        alone = threshold == 1  # the lowest threshold keeps every window
        counters[alone, COUNTER.lower] = counters[alone, COUNTER.committed]
        frames = [PlainSubgroup(config, s, int(threshold[s])) for s in range(sensor.subgroups)]
        for s, frame in enumerate(frames):
            for name in ("opened", "committed", "lower"):
                setattr(frame, name, int(counters[s, getattr(COUNTER, name)]))
        budget = controller.end(config, counters)
        plain.frame_ended(frames)
        assert budget.tolist() == [plain.budget[stream] for stream in range(sensor.streams)]
        assert controller.limit.tolist() == [
            plain.limit[stream] for stream in range(sensor.streams)
        ]


def test_budget_stays_between_share_and_capacity():
    """Too many events leave the budget at the share; darkness takes it to the capacity."""
    frame = {"pulses": 20, "capacity": 100}
    config = parse_config(
        {"sensor": SENSORS["default"], "frame": frame, "subgroup": {"auto": True, "threshold": 1}}
    )
    golden, dark = Golden(config.sensor), trouble(config, 0, 0.0)
    bright = golden.frame(config, trouble(config, 3, 20.0))
    assert bright.counters[:, COUNTER.committed].sum() > config.capacity
    assert bright.budget.tolist() == config.shares.tolist() == [50]
    budgets = [int(golden.frame(config, dark).budget[0]) for _ in range(3)]
    assert budgets == [config.capacity] * 3


@pytest.mark.parametrize("sensor", ("default", "tiny"))
@given(data=st.data())
def test_laws(sensor, data):
    config = data.draw(configurations(SENSORS[sensor]))
    edges = trouble(config, data.draw(seeds), data.draw(densities))
    ready = ready_pattern(data.draw(seeds), "random", config.pulses * config.period)
    result = golden_result(config, edges, ready)
    assert np.array_equal(result["opened"], result["committed"] + result["rejected"])
    assert np.array_equal(result["committed"], result["stored"] + result["dropped"])
    assert np.bincount(result["fate"], minlength=len(Fate)).sum() == len(edges)
    assert (result["fate"] == Fate.OPENING).sum() == result["opened"].sum()
    assert np.isin(result["fate"], (Fate.OPENING, Fate.COUNTED)).sum() == result["photons"].sum()

    shuffled = np.random.default_rng(data.draw(seeds)).permutation(len(edges))
    again = golden_result(config, edges.take(shuffled), ready)
    for name in result.keys() - {"fate"}:
        assert np.array_equal(result[name], again[name]), name

    lowest = golden_result(config.with_settings(threshold=1, auto=False), edges, ready)
    assert lowest["rejected"].sum() == 0
    # thresholds do not change what is counted
    assert np.array_equal(lowest["photons"], result["photons"])


def test_after_a_reset_the_sensor_is_a_new_one():
    config, edges = with_rising_thresholds()
    golden = Golden(config.sensor)
    first, second = (golden.frame(config, edges) for _ in range(2))
    assert not np.array_equal(first.beats[0], second.beats[0])
    golden.reset()
    again = golden.frame(config, edges)
    assert np.array_equal(first.beats[0], again.beats[0])
    assert np.array_equal(first.budget, again.budget)


def test_abort_is_a_shorter_frame():
    """A frame that is aborted in period k equals a frame of k + 1 pulses."""
    config = parse_config({"sensor": SENSORS["default"], "frame": {"pulses": 6}})
    edges = trouble(config, 3, 10)
    early = edges.pulse < 4
    of_four = edges.take(early)
    aborted = Golden(config.sensor).frame(config, of_four, pulses=4)
    whole = Golden(config.sensor).frame(config.with_frame(pulses=4), of_four)
    assert all(np.array_equal(a, b) for a, b in zip(aborted.beats, whole.beats, strict=True))


def test_a_frame_of_another_sensor_or_of_no_pulse_is_refused():
    """The model would read beyond its arrays. What it refuses is no frame, and its sensor may be a
    copy.
    """
    config = configured(SENSORS["default"], {"pulses": 6})
    copy = attrs.evolve(config.sensor)
    model = Golden(copy)
    edges = trouble(config, 3, 10)
    for name, other in (("cols", 2 * copy.cols), ("counter_bits", copy.counter_bits - 1)):
        own = getattr(copy, name)
        told = rf"^sensor.{name} = {other}: must be {own}, as in the model$"
        with pytest.raises(InputError, match=told):
            model.frame(config.with_sensor(**{name: other}), edges)
    for pulses in (0, 7):
        told = f"^pulses = {pulses}: must be an integer from 1 to 6$"
        with pytest.raises(InputError, match=told):
            model.frame(config, edges, pulses=pulses)
    assert model.frames == 0
    whole = model.frame(config, edges, pulses=6)
    assert np.array_equal(whole.beats[0], Golden(copy).frame(config, edges).beats[0])


@pytest.mark.parametrize("phases", [4, 8, 16, 32, 64])
def test_a_stamp_fits_beside_any_phases(phases):
    sensor = parse_config({"sensor": {"phases": phases}}).sensor
    assert sensor.coarse_bits == min(10, STAMP_FIELD_BITS - sensor.phase_bits)


@pytest.mark.parametrize(
    ("period", "bits"), [(127, 12), (128, 12), (129, 13), (250, 13), (256, 13), (257, 14)]
)
def test_stamps_in_groups_have_the_bits_of_the_last_tick(period, bits):
    """Of 32 ticks per cycle; a period that is a power of two does not need one more."""
    frame = {"format": "compact", "period": period, "pulses": 1}
    config = configured({"rows": 8, "cols": 8}, frame, {"threshold": 1})
    (beats,) = Golden(config.sensor).frame(config, trouble(config, 1, 4.0)).beats
    group = int(beats[1])
    assert group >> FIRST_LSB == 0b101 << 1 | 1
    assert group >> HEAD.pulse + HEAD.number & 15 == bits
