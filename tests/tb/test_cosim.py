# SPDX-License-Identifier: Apache-2.0
"""RTL against the golden model: every beat, its cycle, every commit, on every engine."""

from itertools import cycle

import numpy as np
import pytest
from hypothesis import strategies as st

from coincid.model.contract.counters import COUNTER_NAMES
from coincid.model.contract.groups import HEAD, LAST_LSB
from coincid.model.contract.packet import GROUP_KIND
from coincid.model.contract.parameters import SENSOR, Sensor
from coincid.model.contract.pixels import pixel_table
from coincid.model.golden.frame import Golden
from coincid.tb.frame_record import FrameJob
from coincid.tb.play import play
from coincid.tb.scoreboard import check
from coincid.tb.sliced import SlicedSensor

from .. import random_cases
from ..feature_pairs import Played, features_on, paired_cases, played

# The simulators compile the same Verilog as the sliced engine, so some sensors suffice for them: on
# Verilator the one that `test_ports.py` compiles, on Icarus the one with a single subgroup, which
# compiles fast.
# Of its own here: windows of one tick, one column of minigroups in a subgroup, three streams of
# unequal length. Four sensors have one of the switchable parts each, so that with those that have
# all of them every pair of switches comes up.
NARROW = dict(
    rows=32,
    cols=8,
    subgroup=[16, 4],
    minigroup=[4, 4],
    phases=4,
    coarse_bits=7,
    window_max=1,
    streams=3,
)
SWITCHES = ("offsets", "records", "controller", "held")


def only(built: str) -> dict[str, int]:
    """Return the switches of a sensor with one of the switchable parts."""
    return {name: int(name == built) for name in SWITCHES}


SENSORS = random_cases.SENSORS | {
    "one": random_cases.SENSORS["one"] | only("controller"),
    "fine": random_cases.SENSORS["fine"] | only("offsets"),
    "narrow": NARROW | dict(rearm=2, fifo_depth=4) | only("records"),
    "lean": random_cases.LEAN | only("held"),
}
SAMPLES = {
    "sliced": [name for name in SENSORS if name != "one"],
    "icarus": ["one", "tiny", "narrow", "counting"],
    "verilator": ["default", "counting"],
}
LONG = {("narrow", "sliced"), ("coarse", "sliced"), ("wide", "sliced")}  # compiled for little else
BUILDS = [
    pytest.param(sensor, engine, marks=[pytest.mark.long] if (sensor, engine) in LONG else [])
    for engine, sensors in SAMPLES.items()
    for sensor in sensors
]
FRAMES = {"sliced": 40, "icarus": 12, "verilator": 12}


def frames(sensor: dict, number: int) -> list[FrameJob]:
    """Return consecutive frames with settings, edges and back-pressure of their own; the golden
    model keeps its memory. The first one has events whatever is drawn for the others.

    In the later half, the threshold controller, where it is built, acts in every frame, with
    changing capacity.
    """
    golden = Golden(random_cases.built_sensor(sensor))
    controlled = number // 2 if golden.sensor.controller else 0
    drawn = random_cases.configurations(sensor, frames_max=1)
    configs = [random_cases.lively(sensor), *random_cases.drawn(drawn, number - controlled - 1)]
    if controlled:
        (led,) = random_cases.drawn(random_cases.controlled(sensor, frames=1), 1)
        configs += [led.with_frame(capacity=led.capacity * (k % 4)) for k in range(controlled)]
    jobs = []
    seeds = random_cases.drawn(st.integers(0, 2**32 - 1), len(configs))
    for config, seed, density, kind in zip(
        configs, seeds, cycle(random_cases.DENSITIES), cycle(random_cases.READY_KINDS)
    ):
        ready = random_cases.ready_pattern(seed, kind, config.pulses * config.period + 200)
        jobs.append(
            random_cases.predicted(
                golden, config, random_cases.trouble(config, seed, density), ready
            )
        )
    return jobs


def assert_all_checked(records, jobs):
    for record, job in zip(records, jobs, strict=True):
        assert record.checked == sum(map(len, job.expected.beats)) + len(job.expected.commit_cycle)


@pytest.mark.parametrize(("sensor", "engine"), BUILDS)
def test_random_frames(sensor, engine, tmp_path):
    jobs = frames(SENSORS[sensor], FRAMES[engine])
    assert sum(len(job.expected.commit_cycle) for job in jobs) > 50
    records, _ = play(jobs, engine, tmp_path)
    assert_all_checked(records, jobs)


PAIRED = tuple(
    name for name in SAMPLES["sliced"] if (name, "sliced") not in LONG
)  # sensors whose frames have all pairs of features
# Cycles after the planned begin of a period at which an abort still reaches this period: a frame
# begins later, because it takes its settings first.
ABORT_CYCLES = 24


# Cycles from the one at whose end the host begins to write an abort to the one that the abort ends.
ABORT_LATENCY = 10


def abort_in_gap(rtl: SlicedSensor, frames: Played) -> None:
    """Play a frame up to the cycle of a gap in which it is to be aborted."""
    begin = int(frames.config.start_cycles()[frames.pulses - 1])
    abort_in = begin + frames.config.period + frames.into_gap - 1
    while rtl.cycle < abort_in - ABORT_LATENCY:
        rtl.step()
    rtl.abort()


@pytest.mark.parametrize("sensor", PAIRED)
def test_every_pair_of_features(sensor):
    """Each sensor plays its cases of those that have every pair; the host receives the same."""
    built = random_cases.built_sensor(SENSORS[sensor])
    golden = Golden(built)
    cases = paired_cases(*features_on({name: SENSORS[name] for name in PAIRED}))
    with SlicedSensor(built) as rtl:
        for number, case in enumerate(cases):
            if case["sensor"] == sensor:
                frames = played(SENSORS[sensor], case, number)
                for edges, trace in zip(frames.frames, frames.traces(golden), strict=True):
                    rtl.begin(frames.config, edges, frames.ready)
                    if frames.into_gap:
                        abort_in_gap(rtl, frames)
                    elif frames.pulses < frames.config.pulses:
                        last = int(frames.config.start_cycles()[frames.pulses - 1])
                        rtl.step(last + ABORT_CYCLES)
                        rtl.abort()
                    check(built, trace, rtl.end(), number)
                    assert all(map(np.array_equal, rtl.driver.receive(), trace.beats))


@pytest.mark.parametrize("sensor", ("default", "tiny"))
def test_every_mode_in_every_format(sensor, tmp_path):
    """Play each twice in a row, so that the controller has a frame to follow."""
    table = random_cases.SENSORS[sensor]
    jobs, golden = [], Golden(random_cases.built_sensor(table))
    configs = [config for config in random_cases.modes(table) for _ in range(2)]
    configs += [*random_cases.gate_bits(table), *random_cases.collections(table)]
    configs += random_cases.apart(table)
    configs += [
        case(table) for case in (random_cases.overfull, random_cases.lengthy, random_cases.dithered)
    ]
    for (number, config), kind in zip(enumerate(configs), cycle(random_cases.READY_KINDS)):
        edges = random_cases.trouble(config, number, 12.0 * config.period / 60)
        jobs.append(
            random_cases.predicted(
                golden, config, edges, random_cases.ready_pattern(number, kind, 400)
            )
        )
    records, _ = play(jobs, "sliced", tmp_path)
    assert_all_checked(records, jobs)


def test_numbers_of_groups_start_over(tmp_path):
    """A frame has more groups than their numbers tell apart."""
    config = random_cases.lengthy(random_cases.SENSORS["default"])
    config = config.with_frame(format="compact", minigroup_records=False, pulses=400)
    config = config.with_settings(gating=False)
    edges = random_cases.trouble(config, 0, 2.0)
    job = random_cases.predicted(Golden(config.sensor), config, edges)
    (beats,) = job.expected.beats
    kind_and_marks = beats >> np.uint64(LAST_LSB)
    last_of_group = np.isin(kind_and_marks, (GROUP_KIND << 2 | 0b01, GROUP_KIND << 2 | 0b11))
    assert last_of_group.sum() > 1 << HEAD.number
    records, _ = play([job], "sliced", tmp_path)
    assert_all_checked(records, [job])


def test_streams_have_budgets_of_their_own(tmp_path):
    """Only the first stream sees light, so the streams' budgets differ, and its thresholds follow
    its own.
    """
    configs = random_cases.scarce(random_cases.SENSORS["odd"])
    built, jobs = configs[0].sensor, []
    golden = Golden(built)
    for number, config in enumerate(configs):
        edges = random_cases.trouble(config, number, 25.0)
        edges = edges.take(
            np.isin(pixel_table(built).subgroup[edges.pixel], built.stream_subgroups(0))
        )
        jobs.append(random_cases.predicted(golden, config, edges))
    assert any(job.expected.budget[0] != job.expected.budget[-1] for job in jobs)
    records, _ = play(jobs, "sliced", tmp_path)
    assert_all_checked(records, jobs)


@pytest.mark.parametrize(("sensor", "engine"), [("default", "sliced"), ("one", "icarus")])
def test_controller_takes_over_and_hands_back(sensor, engine, tmp_path):
    """Also in a sensor that does not hold its settings, in which the switch is there before the
    frame.
    """
    frame = {"period": 40, "pulses": 3, "auto_bounds": [0] * 6}
    configs = {
        auto: random_cases.configured(SENSORS[sensor], frame, {"auto": auto, "threshold": 4})
        for auto in (False, True)
    }
    golden = Golden(configs[True].sensor)
    jobs = []
    for number, auto in enumerate((True, True, True, False, True, True, False, False, True)):
        edges = random_cases.trouble(configs[auto], number, 10.0)
        jobs.append(random_cases.predicted(golden, configs[auto], edges))
    used = [int(job.expected.counters[0, COUNTER_NAMES.index("threshold_used")]) for job in jobs]
    assert used[0] == used[3] == used[4] == used[6] == used[7] == used[8] == 4
    assert 4 not in (used[1], used[5])
    records, _ = play(jobs, engine, tmp_path)
    assert_all_checked(records, jobs)


def test_counters_saturate(tmp_path):
    config = random_cases.configured(
        SENSORS["lean"], {"period": 60, "pulses": 60}, {"threshold": 1}
    )
    job = random_cases.predicted(
        Golden(config.sensor), config, random_cases.trouble(config, 1, 20.0)
    )
    assert np.any(job.expected.counters == config.sensor.counter_max)
    records, _ = play([job], "sliced", tmp_path)
    assert_all_checked(records, [job])


def test_sizes_reach_every_parameter():
    """Together, the sensors of the random tests change every parameter from its default."""
    default = Sensor()
    built = [random_cases.built_sensor(sensor) for sensor in SENSORS.values()]
    for name in SENSOR:
        assert any(getattr(sensor, name) != getattr(default, name) for sensor in built), name
    assert np.any([sensor.subgroups % 2 for sensor in built])


def test_every_alignment_of_storing_and_freeing(tmp_path):
    """A place becomes free before, in and after the cycle of the next commit or record; the stall
    moves it by one cycle.

    The outcome changes between two such frames, so one of them is the exact tie; model and RTL
    agree in all.
    """
    config = random_cases.configured(
        random_cases.SENSORS["tiny"],
        {"period": 40, "pulses": 6, "format": "full", "minigroup_records": True, "mg_threshold": 1},
        {"threshold": 1, "window": 4},
    )
    golden, edges = Golden(config.sensor), random_cases.trouble(config, 5, 12.0)
    jobs = [random_cases.predicted(golden, config, edges, np.zeros(stall)) for stall in range(320)]
    for name in ("stored", "mg_stored"):
        kept = np.array([job.expected.counters[:, COUNTER_NAMES.index(name)] for job in jobs])
        assert np.all(np.ptp(kept, axis=0) > 0), f"{name}: the stall changes nothing"
    play(jobs, "sliced", tmp_path)
