# SPDX-License-Identifier: Apache-2.0
"""Edges that a sensor cannot have are refused before an engine plays them."""

import re

import numpy as np
import pytest
from attrs import evolve

from coincid.hdl.front_end_views import VIEWS
from coincid.model.contract.coincidence import AtLeast
from coincid.model.contract.config import parse_config
from coincid.model.contract.edges import Edges
from coincid.model.contract.parameters import Sensor
from coincid.model.contract.result import differences
from coincid.model.golden.frame import Golden
from coincid.model.shared.errors import InputError
from coincid.tb.engines import LANES_MAX, SIMULATORS, sensors_together
from coincid.tb.frame_record import Recorded
from coincid.tb.replay import chosen_view, replay, replay_together
from coincid.tb.rtl import sensor_key
from coincid.tb.stimulus import tick_ps

from ..random_cases import trouble

PULSES, FRAMES, PERIOD, PIXELS = 3, 2, 40, 64
# At another clock than the usual one.
CONFIG = parse_config(
    {
        "sensor": {"rows": 8, "cols": 8},
        "frame": {"pulses": PULSES, "frames": FRAMES, "period": PERIOD, "clock_mhz": 320.0},
    }
)
TOO_MUCH = {"pulse": PULSES * FRAMES, "pixel": PIXELS, "tick": CONFIG.period_ticks}


def edges_with(name, value):
    columns = {column: np.zeros(2, np.int64) for column in TOO_MUCH}
    columns[name][1] = value
    return Edges(**columns)


def by_golden(edges):
    return replay("golden", CONFIG, edges)


def side_by_side(edges):
    return replay_together([(CONFIG, edges)])


@pytest.mark.parametrize("play", [by_golden, side_by_side])
@pytest.mark.parametrize("name", TOO_MUCH)
def test_edges_out_of_range_are_refused(play, name):
    for value in (-1, TOO_MUCH[name]):
        told = re.escape(f"edges: {name}[1] = {value}: must be an integer from 0 to")
        with pytest.raises(InputError, match=told):
            play(edges_with(name, value))


@pytest.mark.parametrize("name", TOO_MUCH)
def test_the_last_of_every_range_is_played(name):
    """Pulses count through the frames."""
    assert len(by_golden(edges_with(name, TOO_MUCH[name] - 1))["fate"]) == 2


@pytest.mark.parametrize("play", [by_golden, side_by_side])
@pytest.mark.parametrize("name", TOO_MUCH)
def test_edges_with_a_mask_are_refused(play, name):
    edges = edges_with(name, 1)
    hidden = np.ma.array(getattr(edges, name), mask=[False, True])
    with pytest.raises(InputError, match=f"edges: .*{name}: has masked elements"):
        play(evolve(edges, **{name: hidden}))


def test_offsets_are_one_for_each_edge():
    zero = np.zeros(2, np.int64)
    with pytest.raises(InputError, match="edges: offset_ps: holds .* must hold 2 numbers"):
        by_golden(Edges(zero, zero, zero, np.zeros(3)))


def test_progress_ends_with_the_cycles_of_all_frames():
    """And not with their number: bars have the cycles as their total."""
    told = []
    replay("golden", CONFIG, edges_with("tick", 0), progress=told.append)
    assert told == sorted(told)
    assert told[-1] >= FRAMES * CONFIG.frame_cycles


@pytest.mark.parametrize(
    ("ready", "told"),
    [
        (
            np.ones((2, 2), np.uint8),
            r"ready: has shape \(2, 2\) and dtype uint8, must be one row of",
        ),
        (np.ones(2), "ready: has shape .* and dtype float64, must be one row of integers"),
        (np.array([0, 1, 3, 2]), r"ready\[2\] = 3: must be 0 or 1"),
        (np.array([1, -1]), r"ready\[1\] = -1: must be 0 or 1"),
    ],
)
def test_what_is_no_row_of_levels_is_refused(ready, told):
    with pytest.raises(InputError, match=told) as refused:
        replay("golden", CONFIG, edges_with("tick", 0), ready)
    if "0 or 1" in told:
        assert (refused.value.low, refused.value.high) == (0, 1)


def test_levels_of_truth_are_levels():
    edges = edges_with("tick", 5)
    stalled = np.zeros(30, bool)
    late = replay("golden", CONFIG, edges, stalled)
    assert np.array_equal(late["stored"], replay("golden", CONFIG, edges)["stored"])


def test_which_engine_runs_which_view():
    """Waveforms and circuits of the asynchronous view are those of a simulator of the whole RTL."""
    clock_mhz = CONFIG.clock_mhz
    assert chosen_view("golden", "polyphase", clock_mhz) is None
    assert chosen_view("golden", VIEWS["polyphase"], clock_mhz) is None
    for engine in ("sliced", *SIMULATORS):
        assert chosen_view(engine, "polyphase", clock_mhz).is_default
    for simulator in SIMULATORS:
        assert chosen_view(simulator, "async", clock_mhz).name == "async"
        assert chosen_view(simulator, "polyphase", clock_mhz, waves=True).is_default
    for engine in ("golden", "sliced"):
        with pytest.raises(InputError, match="engine of the view async = .*: must be one of"):
            chosen_view(engine, "async", clock_mhz)
        with pytest.raises(InputError, match=f"engine = '{engine}': has no waveform"):
            chosen_view(engine, "polyphase", clock_mhz, waves=True)
    with pytest.raises(InputError, match="view"):
        chosen_view("golden", "other", clock_mhz)


def test_builds_have_the_name_of_what_differs_from_the_default():
    default = Sensor()
    size = f"{default.rows}x{default.cols}"
    assert sensor_key(default) == size
    assert sensor_key(evolve(default, rows=8, cols=24)) == "8x24"
    other = evolve(default, phases=16, minigroup=(4, 2), records=0)
    assert sensor_key(other) == f"{size}-phases16-minigroup4x2-records0"
    assert sensor_key(default, VIEWS["async"]) == f"{size}-async"
    own = type("Own", (AtLeast,), {"name": "own-rule"})()
    assert sensor_key(evolve(default, rule=own)) == f"{size}-own-rule"
    assert sensor_key(evolve(default, rows=8, cols=8, rule=own), VIEWS["async"]) == (
        "8x8-own-rule-async"
    )


@pytest.fixture
def asked(monkeypatch):
    """Let the golden model stand in for the engines of the RTL; return what they are asked for."""
    found = {}

    def recorded(job):
        trace = Golden(job.config.sensor).frame(job.config, job.edges, job.ready)
        commits = trace.commit_subgroup, trace.commit_cycle
        return Recorded(trace.beats, trace.beat_cycle, *commits, cycles=700)

    def play(frames, engine, out_dir, *, progress=None, view):
        found.update(engine=engine, view=view, progress=progress, chains=[len(frames)])
        return [recorded(job) for job in frames], None

    def play_side_by_side(chains, progress=None, threads=None):
        lengths = [len(chain) for chain in chains]
        found.update(engine="sliced", progress=progress, threads=threads, chains=lengths)
        return [[recorded(job) for job in chain] for chain in chains]

    monkeypatch.setattr("coincid.tb.play.play", play)
    monkeypatch.setattr("coincid.tb.sliced.play_side_by_side", play_side_by_side)
    return found


@pytest.mark.parametrize(
    ("engine", "view", "chains"),
    [
        ("sliced", "polyphase", [1] * FRAMES),
        ("icarus", "polyphase", [FRAMES]),
        ("icarus", "async", [FRAMES]),
    ],
)
def test_every_engine_gets_all_frames_the_receiver_and_the_progress(engine, view, chains, asked):
    """Frames that depend on none before are played side by side where the engine can. The view has
    the clock of the configuration.
    """
    edges = trouble(CONFIG, 1, 20.0)
    ready = np.arange(FRAMES * CONFIG.frame_cycles) % 3 == 0
    found = replay(engine, CONFIG, edges, ready, print, view)
    assert not differences(replay("golden", CONFIG, edges, ready), found)
    assert len(found["pulse"]) > 10
    assert (asked["engine"], asked["progress"], asked["chains"]) == (engine, print, chains)
    assert asked.get("view", VIEWS["polyphase"]) == VIEWS[view].at(CONFIG.clock_mhz)


def test_offsets_beyond_a_tick_are_refused_by_the_view_that_has_them(asked):
    edges = evolve(edges_with("tick", 3), offset_ps=np.array([0.0, 1.5 * tick_ps(CONFIG)]))
    with pytest.raises(InputError, match=r"^offset_ps\[1\] = "):
        replay("icarus", CONFIG, edges, view="async")
    assert not asked
    replay("icarus", CONFIG, edges)


def test_configurations_that_are_played_together_keep_their_frames_and_their_order(asked):
    configs = [CONFIG.with_frame(frames=frames) for frames in (1, 3, 2)]
    jobs = [(config, trouble(config, seed, 20.0)) for seed, config in enumerate(configs)]
    found = replay_together(jobs, threads=3)
    assert asked == {"engine": "sliced", "progress": None, "threads": 3, "chains": [1, 3, 2]}
    for (config, edges), result in zip(jobs, found, strict=True):
        assert not differences(replay("golden", config, edges), result)


def test_as_many_sensors_as_fit_are_played_at_once():
    """One at least, however large it is."""
    for subgroups in range(1, 2 * LANES_MAX):
        sensors = sensors_together(subgroups)
        assert sensors == 1 or sensors * subgroups <= LANES_MAX
        assert (sensors + 1) * subgroups > LANES_MAX
