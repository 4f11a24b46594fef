# SPDX-License-Identifier: Apache-2.0
"""Runs whose edges do not fit into memory give what other runs give."""

import gc
import tracemalloc
import weakref

import numpy as np
import pytest

from coincid.lab import long_frames
from coincid.lab.outcomes import Run
from coincid.lab.setup import Setup
from coincid.model.contract.counters import COUNTER_NAMES
from coincid.model.contract.edges import Edges
from coincid.model.contract.gate_counts import Counts
from coincid.model.golden.frame import Golden, golden_result
from coincid.model.scenes.catalogue import load_scene
from coincid.model.shared.pulse import Pulse

SENSOR = {"rows": 8, "cols": 16}


def setup_of(*, sensor=SENSOR, **frame):
    return Setup.of("five-objects", klux=20, sensor=sensor, frame={"frames": 3} | frame)


@pytest.fixture
def long(monkeypatch):
    """Make every run a long one, which keeps 900 edges of each of three frames."""
    monkeypatch.setattr(long_frames, "EDGES_MAX", 0)
    monkeypatch.setattr(long_frames, "EDGES_SHOWN_MAX", 2700)


UNEQUAL_STREAMS = {"rows": 8, "cols": 24, "streams": 2}


@pytest.mark.parametrize("sensor", [SENSOR, UNEQUAL_STREAMS], ids=["one stream", "two streams"])
@pytest.mark.parametrize("subgroup", [{"threshold": 2}, {"auto": True}], ids=["fixed", "auto"])
def test_a_long_run_gives_the_same_events_and_depth(subgroup, sensor, monkeypatch):
    setup = setup_of(pulses=70, dither_bits=3, sensor=sensor).but(subgroup=subgroup)
    usual = Run(setup)
    expected = usual.result
    monkeypatch.setattr(long_frames, "EDGES_MAX", 0)
    run = Run(setup)
    assert run.is_long and not usual.is_long
    assert run.result.keys() == expected.keys() - {"fate"}
    for name, array in run.result.items():
        np.testing.assert_array_equal(array, expected[name], err_msg=name)
    np.testing.assert_array_equal(run.frame().depth_m, usual.frame().depth_m)
    assert run.frame(1)["edges"] == usual.frame(1)["edges"]


@pytest.mark.parametrize("form", ["full", "compact"])
def test_each_frame_of_a_long_run_has_its_rows_of_other_runs(form, long):
    """Decoded alone: pulses count from the first frame, counters are those of all frames, and a
    measured pulse of the laser is with them.
    """
    shape = Pulse.gaussian(4e-10)
    setup = setup_of(pulses=70, format=form, minigroup_records=True).but(pulse=shape)
    expected = dict(Run(setup).result)
    run = Run(setup)
    rows = {"pulse": ("subgroup", "stamp", "count"), "mg_pulse": ("mg_subgroup", "mg_stamp")}
    for number in range(3):
        frame = run.frame(number)
        found = frame.result
        assert found.keys() == expected.keys() - {"fate"}
        assert np.array_equal(Pulse.of_result(found).density, shape.density)
        assert len(frame.events) == len(found["pulse"]) > 0
        for pulse, others in rows.items():
            own = expected[pulse] // 70 == number
            for name in (pulse, *others):
                np.testing.assert_array_equal(found[name], expected[name][own], err_msg=name)
        for name in COUNTER_NAMES:
            np.testing.assert_array_equal(found[name], expected[name], err_msg=name)
    assert not run.has_result


def test_a_long_run_gives_the_same_counts_of_each_frame(monkeypatch):
    """The frames differ, so one in another's place shows."""
    setup = Setup.of(
        "five-objects",
        klux=20,
        sensor=SENSOR | {"counts": 1},
        frame={"frames": 3, "pulses": 70, "format": "counts"},
    )
    usual = Run(setup)
    expected = [usual.frame(number).depth_m for number in range(3)]
    monkeypatch.setattr(long_frames, "EDGES_MAX", 0)
    run = Run(setup)
    for number in range(3):
        np.testing.assert_array_equal(run.frame(number).depth_m, expected[number])
        for name in Counts._fields:
            own, of_all = run.frame(number).result[name], usual.result[name]
            assert (own.shape, own.dtype) == (of_all.shape, of_all.dtype), name
            np.testing.assert_array_equal(own[number], of_all[number], err_msg=name)
    assert not np.array_equal(expected[0], expected[1], equal_nan=True)
    assert not run.has_result  # each frame was decoded alone


def test_a_long_run_keeps_the_edges_and_fates_of_the_first_pulses(long):
    setup = setup_of(pulses=700)
    run = Run(setup)
    everything = setup.photons.edges()
    golden = Golden(setup.config.sensor)
    fates = long_frames.play_long_frames(golden, setup.config, iter([everything]))
    of_all = golden_result(setup.config, everything)["fate"]
    place = 0
    for number in range(3):
        expected, _ = everything.frame(number, 700)
        kept = run.frame(number).edges
        assert 0 < len(kept) <= 900 < len(expected)
        for name in ("pulse", "pixel", "tick"):
            np.testing.assert_array_equal(
                getattr(kept, name), getattr(expected, name)[: len(kept)], err_msg=name
            )
        own = run.traces[number].fate
        np.testing.assert_array_equal(own, of_all[place : place + len(kept)])
        assert (len(own), own.dtype) == (len(kept), of_all.dtype)
        place += len(expected)
        assert run.frame(number).edge_count == fates.seen[number].total == len(expected)
    assert run.edge_count == len(everything)


@pytest.mark.parametrize("lack", [0, 1])
def test_a_frame_whose_edges_just_fit_keeps_all_of_them(lack, monkeypatch):
    """One more, and its last pulse is left out."""
    setup = setup_of(pulses=20, frames=1)
    edges = setup.photons.edges()
    monkeypatch.setattr(long_frames, "EDGES_SHOWN_MAX", len(edges) - lack)
    chunks = [edges.take(edges.pulse < 10), edges.take(edges.pulse >= 10)]
    golden = Golden(setup.config.sensor)
    (seen,) = long_frames.play_long_frames(golden, setup.config, iter(chunks)).seen
    pulses = int(edges.pulse[-1]) if lack else 20
    assert (seen.pulses, seen.total) == (pulses, len(edges))
    assert np.array_equal(seen.edges.tick, edges.tick[edges.pulse < pulses])


def test_a_frame_whose_first_part_just_fits_keeps_that_part(monkeypatch):
    """Its pulses are those of which all edges are kept, and no others."""
    setup = setup_of(pulses=20, frames=1)
    edges = setup.photons.edges()
    chunks = [edges.take(edges.pulse // 5 == part) for part in range(4)]
    monkeypatch.setattr(long_frames, "EDGES_SHOWN_MAX", len(chunks[0]) + len(chunks[1]))
    golden = Golden(setup.config.sensor)
    (seen,) = long_frames.play_long_frames(golden, setup.config, iter(chunks)).seen
    assert (seen.pulses, seen.total) == (10, len(edges))
    assert np.array_equal(seen.edges.tick, edges.tick[edges.pulse < 10])


@pytest.mark.parametrize("format_name", ["id", "compact"])
def test_memory_does_not_grow_with_the_events_of_a_long_frame(format_name, monkeypatch):
    monkeypatch.setattr(long_frames, "EDGES_SHOWN_MAX", 1000)

    def play(pulses):
        """Return the most bytes in use, and the number of events."""
        setup = setup_of(pulses=pulses, frames=1, format=format_name, link_gbps=1)
        edges = setup.photons.edges()
        firsts = range(0, pulses, 200)
        chunks = [
            edges.take((edges.pulse >= first) & (edges.pulse < first + 200)) for first in firsts
        ]
        golden = Golden(setup.config.sensor)
        tracemalloc.start()
        played = long_frames.play_long_frames(golden, setup.config, iter(chunks))
        most = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        return most, len(played.traces[0].commit_cycle)

    play(50)  # compiles
    few_bytes, few_events = play(800)
    many_bytes, many_events = play(3200)
    # a trace has at least 40 bytes per event: its beat, and four cycles and numbers
    assert many_bytes - few_bytes < 16 * (many_events - few_events)


def test_frames_in_a_file_are_a_sequence_of_traces():
    setup = setup_of(pulses=20)
    traces = Run(setup).traces
    edges = setup.photons.edges()
    stored = long_frames.play_long_frames(
        Golden(setup.config.sensor), setup.config, iter([edges])
    ).traces
    assert len(stored) == len(traces) == 3
    for trace, expected in zip([stored[0], *stored[1:]], traces, strict=True):
        np.testing.assert_array_equal(trace.beats[0], expected.beats[0])
        np.testing.assert_array_equal(trace.beat_cycle[0], expected.beat_cycle[0])
        np.testing.assert_array_equal(trace.freed_cycle, expected.freed_cycle)
    np.testing.assert_array_equal(stored[-1].commit_cycle, traces[-1].commit_cycle)
    for cut in (slice(None, None, -1), slice(-2, None), slice(0, -1), slice(1, 9), slice(2, 0)):
        found = [trace.commit_cycle.tolist() for trace in stored[cut]]
        assert found == [trace.commit_cycle.tolist() for trace in traces[cut]]
    assert stored.counters[2].tolist() == traces[2].counters.tolist()


def test_the_last_frame_of_several_sensors_is_played_for_each(monkeypatch):
    """With settings of its own, and a share of the edges that are kept."""
    monkeypatch.setattr(long_frames, "EDGES_SHOWN_MAX", 600)
    setup = setup_of(pulses=100, minigroup_records=True)
    configs = [setup.config.with_settings(threshold=threshold) for threshold in (1, 2, 4)]
    players = [(Golden(config.sensor), config) for config in configs]
    edges = setup.photons.edges()
    last, _ = edges.frame(2, 100)
    parts = np.array_split(np.arange(len(edges)), [700, 1500])
    whole = [int(edges.pulse[part[0]]) for part in parts]  # chunks have whole pulses
    chunks = [
        edges.take((edges.pulse >= first) & (edges.pulse < end))
        for first, end in zip(whole, [*whole[1:], 300], strict=True)
    ]
    for workers in (1, 2):
        players = [(Golden(config.sensor), config) for config in configs]
        played = long_frames.play_last_frame(players, 3, iter(chunks), workers)
        for config, one in zip(configs, played, strict=True):
            expected = Golden(config.sensor).frame(config, last)
            (trace,) = one.traces
            assert trace.beats[0].tolist() == expected.beats[0].tolist()
            assert trace.counters.tolist() == expected.counters.tolist()
            assert [of.tolist() for of in one.counters] == [expected.counters.tolist()]
            (seen,) = one.seen
            assert (seen.total, seen.pulses < 100) == (len(last), True)
            assert 0 < len(seen.edges) <= 200
            assert trace.fate.tolist() == expected.fate[: len(seen.edges)].tolist()


def test_a_long_run_has_one_decoded_frame_in_memory(long):
    run = Run(setup_of(pulses=200))
    first = weakref.ref(run.frame(0).result["stamp"])
    assert first() is run.frame(0).result["stamp"]
    assert run.frame(1).depth_m.shape == (8, 16)
    gc.collect()
    assert first() is None


def test_long_runs_that_share_a_cache_have_frames_of_their_own(long):
    run = Run(setup_of(pulses=200))
    other = run.but(subgroup={"threshold": 3})
    expected = Run(other.setup).frame(1).result["stamp"]
    assert len(run.frame(1).result["stamp"]) > len(expected)
    np.testing.assert_array_equal(other.frame(1).result["stamp"], expected)


def test_chunks_are_cut_where_frames_end():
    pulse = np.array([0, 0, 1, 4, 5, 11])
    edges = Edges(pulse, np.arange(6), np.arange(6))
    pieces = list(long_frames.frame_pieces(iter([edges.take(slice(0, 0)), edges]), 3))
    assert [number for number, _ in pieces] == [0, 1, 2, 3]
    assert [piece.pulse.tolist() for _, piece in pieces] == [[0, 0, 1], [1, 2], [], [2]]
    assert [piece.pixel.tolist() for _, piece in pieces] == [[0, 1, 2], [3, 4], [], [5]]


def test_the_estimate_of_edges_is_above_their_number():
    setup = setup_of(pulses=200)
    assert len(setup.photons.edges()) < setup.photons.edges_at_most


def test_the_estimate_for_a_scene_that_moves_is_the_sum_of_its_pictures():
    walls = [np.full((8, 16), wall_m) for wall_m in (3.0, 6.0, 12.0)]
    moving = load_scene(np.stack(walls), 8, 16)
    together = setup_of(pulses=50).but(scene=moving).photons.edges_at_most
    alone = [
        setup_of(pulses=50, frames=1).but(scene=moving.at(k)).photons.edges_at_most
        for k in range(3)
    ]
    assert together == pytest.approx(sum(alone))
