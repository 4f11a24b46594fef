# SPDX-License-Identifier: Apache-2.0
"""The sliced engine beside the whole RTL: many frames at once, faults, and waveforms."""

from itertools import cycle
from types import SimpleNamespace

import numpy as np
import pytest
from attrs import evolve
from pywellen import Waveform

from coincid.hdl.export import units_files
from coincid.hdl.subgroup_pair import SensorModule, Slice
from coincid.host.transport import RefusedError
from coincid.model.contract.parameters import TOP, Sensor
from coincid.model.contract.pixels import pixel_table
from coincid.model.contract.registers import address
from coincid.model.contract.result import differences
from coincid.model.golden.frame import Golden
from coincid.model.shared.errors import InputError
from coincid.slices.library import LANES
from coincid.tb import slice_proof, sliced
from coincid.tb.frame_record import FrameJob
from coincid.tb.play import play
from coincid.tb.replay import replay
from coincid.tb.rtl import of_one_subgroup, rtl_in_two
from coincid.tb.rtl_errors import SimulationError
from coincid.tb.scoreboard import check
from coincid.tb.slice_proof import prove_module
from coincid.tb.sliced import Engine, SlicedSensor, play_side_by_side
from coincid.tools.build import ToolchainError

from .. import random_cases

SENSOR, ODD = random_cases.SENSORS["default"], random_cases.SENSORS["odd"]
PROOF = Sensor(rows=4, cols=4, subgroup=(4, 4), phases=4, window_max=20, records=0, controller=0)
CYCLE_PS = 2000  # of the simulators' clock
# Signals that may differ: what the host asks for and when, a count that never rests, a choice among
# nothing, a word of which nobody sets the count, and steps of edges that no window has counted: they
# load in a reset, and the cycles of a reset differ.
FREE = {
    "command",
    "command_taken",
    "data",
    "index",
    "index_before",
    "at_last",
    "winner_5_0",
    "step_5",
    "step_6",
    "step_7",
    "tree.half",
    "tree.half.count",
}


def job(golden: Golden, config, seed: int, kind: str = "always") -> FrameJob:
    edges = random_cases.trouble(config, seed, 12.0)
    ready = random_cases.ready_pattern(seed, kind, config.pulses * config.period + 200)
    return random_cases.predicted(golden, config, edges, ready)


@pytest.mark.parametrize("threads", [1, 3])
def test_chains_side_by_side_equal_one_by_one(threads, tmp_path):
    """Settings, light, length and the controller's memory differ between the sensors that share a
    word.
    """
    chains = []
    for number, kind in zip(range(7), cycle(random_cases.READY_KINDS)):
        golden, chain = Golden(random_cases.built_sensor(ODD)), []
        for k in range(1 + number % 3):
            period, dither_bits = 60 + 7 * number, number % 4
            config = random_cases.configured(
                ODD,
                dict(
                    period=period, pulses=2 + k, capacity=20, dither_bits=dither_bits, dither_seed=5
                ),
                {"auto": True, "threshold": 1 + number % 3, "window": 10 + number},
                {"subgroups": [1], "gating": True, "gate_start": 5, "gate_len": 30 + number},
            )
            chain.append(job(golden, config, 10 * number + k, kind))
        chains.append(chain)
    for chain, together in zip(chains, play_side_by_side(chains, threads=threads), strict=True):
        alone, _ = play(chain, "sliced", tmp_path)
        for one, other, frame, number in zip(alone, together, chain, range(9), strict=False):
            assert check(frame.config.sensor, frame.expected, other, number) == one.checked


def test_settings_that_come_back_are_programmed_again():
    """Of a subgroup and of the frame: what the sensor has is what the frame before wrote."""
    golden = Golden(random_cases.built_sensor(ODD))
    chain = []
    for number, (threshold, period) in enumerate([(1, 60), (2, 70), (1, 60), (2, 60)]):
        frame = {"period": period, "pulses": 3}
        config = random_cases.configured(ODD, frame, {"threshold": threshold})
        chain.append(job(golden, config, number))
    (records,) = play_side_by_side([chain])
    for number, (frame, record) in enumerate(zip(chain, records, strict=True)):
        check(frame.config.sensor, frame.expected, record, number)


@pytest.mark.parametrize("threads", [1, 3])
def test_the_told_cycles_are_in_the_end_those_of_all_frames(threads):
    """Summed over the sensors and their frames, which differ in length, of one engine or several."""
    told = []
    chains = []
    for number in range(3):
        golden = Golden(random_cases.built_sensor(ODD))
        config = random_cases.configured(ODD, {"period": 60 + 7 * number, "pulses": 3})
        chains.append([job(golden, config, 3 * number + k) for k in range(1 + number)])
    records = play_side_by_side(chains, told.append, threads=threads)
    assert told == sorted(told)
    assert told[-1] == sum(record.cycles for chain in records for record in chain)


@pytest.mark.parametrize("lit", range(2))
def test_a_frame_lasts_until_the_last_of_its_streams_ends(lit):
    """Whichever that is: on a slow link, the one whose subgroups see light."""
    config = random_cases.configured(
        ODD,
        {"period": 60, "pulses": 8, "link_gbps": 1.0},
        {"threshold": 1, "coincidence": False},
    )
    edges = random_cases.trouble(config, 1, 12.0)
    of_stream = config.sensor.stream_subgroups(lit)
    edges = edges.take(np.isin(pixel_table(config.sensor).subgroup[edges.pixel], of_stream))
    frame = random_cases.predicted(Golden(config.sensor), config, edges)
    ends = [int(cycles[-1]) for cycles in frame.expected.beat_cycle]
    assert ends[lit] > 2 * ends[1 - lit]
    told = []
    ((record,),) = play_side_by_side([[frame]], told.append)
    assert record.cycles == told[-1] == ends[lit] + 1


def test_frames_follow_each_other_where_some_subgroups_have_the_controller():
    """Its thresholds are those of the frame before; those of the other subgroups stay."""
    subgroups = random_cases.built_sensor(ODD).subgroups
    config = random_cases.configured(
        ODD,
        {
            "frames": 3,
            "pulses": 30,
            "period": 80,
            "capacity": 20,
            "auto_bounds": [1, 2, 3, 4, 5, 6],
        },
        {"threshold": 1},
        {"subgroups": list(range(0, subgroups, 2)), "auto": True},
    )
    edges = random_cases.random_edges(config, 6000, 1)
    golden = replay("golden", config, edges)
    used = golden["threshold_used"]
    assert (used[:, 1::2] == 1).all()
    assert (used[1:, ::2] > 1).any()
    assert not differences(golden, replay("sliced", config, edges))


def running() -> random_cases.Config:
    return random_cases.configured(
        SENSOR,
        {"period": 60, "pulses": 6, "format": "full", "minigroup_records": True},
        {"threshold": 1, "window": 12},
        {"subgroups": [1], "gating": True, "gate_start": 5, "gate_len": 40},
    )


def test_reset_in_any_cycle():
    """In a frame whose stream stalls at random, and after it; afterwards, the sensor plays a frame
    like a new one.
    """
    config = running()
    golden = job(Golden(config.sensor), config, 3)
    stalling = random_cases.ready_pattern(1, "random", config.frame_cycles)
    with SlicedSensor(config.sensor) as rtl:
        for cycle in (
            1,
            37,
            59,
            60,
            *np.random.default_rng(1).integers(61, config.frame_cycles + 60, 20).tolist(),
        ):
            rtl.begin(config, golden.edges, stalling)
            rtl.step(cycle)
            rtl.reset()
            assert (
                check(config.sensor, golden.expected, rtl.frame(config, golden.edges, golden.ready))
                > 50
            )


def test_soft_reset_with_a_dead_receiver():
    """The receiver takes no beat, and the sensor stays busy until software resets it."""
    config = running()
    golden = job(Golden(config.sensor), config, 3)
    dead = np.zeros(100_000, np.uint8)
    with SlicedSensor(config.sensor) as rtl:
        for cycle in (90, 400, 2000):
            rtl.begin(config, golden.edges, dead)
            rtl.step(cycle)
            rtl.soft_reset()
            assert not rtl.driver.status().busy
            record = rtl.frame(config, golden.edges, golden.ready)
            assert check(config.sensor, golden.expected, record) > 50


@pytest.mark.parametrize("link_gbps", [0, 8, 0.3])
@pytest.mark.parametrize("kind", random_cases.READY_KINDS)
def test_idle_cycles_of_gaps_are_not_played(kind, link_gbps):
    """The frame lasts for hundreds of millions of cycles. Playing them would take an hour."""
    config = random_cases.configured(
        ODD,
        {
            "period": 60,
            "pulses": 3,
            "gap": 100_000_001,
            "link_gbps": link_gbps,
            "dither_bits": 3,
            "format": "compact",
            "minigroup_records": True,
        },
        {"threshold": 1, "window": 12},
    )
    golden = Golden(random_cases.built_sensor(ODD))
    frames = [job(golden, config, seed, kind) for seed in (1, 2)]
    with SlicedSensor(config.sensor) as rtl:
        for number, frame in enumerate(frames):
            record = rtl.frame(config, frame.edges, frame.ready)
            assert record.cycles > config.frame_cycles > 2 * config.gap
            assert check(config.sensor, frame.expected, record, number) > 50


def test_idle_cycles_are_skipped_where_all_sensors_are_idle():
    """Sensors that share words are in gaps of different lengths, or have nothing left to do."""
    chains = []
    for number, gap in enumerate((50_000, 20_000_000, 20_007_777)):
        golden = Golden(random_cases.built_sensor(ODD))
        config = random_cases.configured(
            ODD, {"period": 70, "pulses": 3, "gap": gap}, {"threshold": 1, "auto": number == 1}
        )
        chains.append([job(golden, config, 5 * number + k) for k in range(1 + number)])
    for chain, records in zip(chains, play_side_by_side(chains, threads=1), strict=True):
        for number, (frame, record) in enumerate(zip(chain, records, strict=True)):
            assert check(frame.config.sensor, frame.expected, record, number) > 50


@pytest.mark.parametrize("cycle", [5_000, 120_000])
def test_abort_in_a_long_gap(cycle):
    """The frame ends in the gap, and has the periods that have begun."""
    config = random_cases.configured(
        SENSOR, {"period": 60, "pulses": 4, "gap": 100_000}, {"threshold": 1, "window": 12}
    )
    first = job(Golden(config.sensor), config, 4)
    begun = 1 + cycle // (config.period + config.gap)
    edges = first.edges.take(first.edges.pulse < begun)
    shorter = Golden(config.sensor).frame(config, edges, pulses=begun)
    with SlicedSensor(config.sensor) as rtl:
        rtl.begin(config, first.edges)
        rtl.step(cycle)
        rtl.abort()
        assert np.array_equal(rtl.end().beats[0], shorter.beats[0])


@pytest.mark.parametrize("cycle", [100, 130, 290])
def test_abort_makes_a_shorter_frame(cycle):
    """The frame equals one of as many pulses as have begun when the command arrives."""
    config = running()
    model = Golden(config.sensor)
    first = job(model, config, 4)

    def shorter(pulses: int) -> np.ndarray:
        edges = first.edges.take(first.edges.pulse < pulses)
        return Golden(config.sensor).frame(config, edges, pulses=pulses).beats[0]

    with SlicedSensor(config.sensor) as rtl:
        rtl.begin(config, first.edges)
        rtl.step(cycle)
        rtl.abort()
        record = rtl.end()
        pulses = next(
            n for n in range(1, config.pulses) if np.array_equal(record.beats[0], shorter(n))
        )
        assert cycle // config.period <= pulses <= cycle // config.period + 2


def test_an_abort_that_its_frame_does_not_take_is_over():
    """With a reset, or because the frame has ended: the next frame has all its periods."""
    config = running()
    golden = Golden(config.sensor)
    first, second = (job(golden, config, seed) for seed in (3, 4))
    with SlicedSensor(config.sensor) as rtl:
        rtl.begin(config, second.edges)
        rtl.step(100)
        rtl.abort()
        rtl.reset()
        check(config.sensor, first.expected, rtl.frame(config, first.edges, first.ready))
        rtl.abort()
        record = rtl.frame(config, second.edges, second.ready)
        check(config.sensor, second.expected, record, 1)
        third, fourth = (job(golden, config, seed) for seed in (5, 6))
        rtl.begin(config, third.edges)
        rtl.step(100)
        for _ in range(1000):  # more than the frame has cycles for
            rtl.abort()
        rtl.end()
        check(config.sensor, fourth.expected, rtl.frame(config, fourth.edges, fourth.ready), 3)


def test_registers_can_be_changed_in_a_frame():
    """A threshold that nothing reaches lets no event through, and only in its subgroup."""
    config = running()
    frame = job(Golden(config.sensor), config, 6)
    with SlicedSensor(config.sensor) as rtl:
        rtl.begin(config, frame.edges)
        rtl.step(100)
        assert rtl.peek(1, "subgroup_0.dpcu.threshold_used") == 1
        rtl.poke(1, "subgroup_0.dpcu.threshold", 63)
        record = rtl.end()
    late = record.commit_cycle > 120
    assert np.any(late & (record.commit_subgroup == 0)) and not np.any(
        late & (record.commit_subgroup == 1)
    )


def test_a_refusal_names_its_access_and_is_over_after_it():
    config = random_cases.configured(ODD, {"period": 60, "pulses": 3}, {"threshold": 1})
    frame = job(Golden(config.sensor), config, 1)
    nowhere, period = 0xFFC, address("period")
    with SlicedSensor(config.sensor) as rtl:
        rtl.driver.program(config)
        for _ in range(2):
            with pytest.raises(RefusedError, match="^read of 0x00ffc: SLVERR$"):
                rtl.read(nowhere)
            assert rtl.read(period) == config.period
            with pytest.raises(RefusedError, match=f"^write of 0x0 to {period:#07x}: SLVERR$"):
                rtl.write(period, 0)
            assert rtl.read(period) == config.period
        assert set(rtl.driver.status().errors) == {"bad_address", "bad_value"}
        rtl.driver.clear()
        rtl.write(period, config.sensor.guard)
        rtl.begin(config, frame.edges)
        with pytest.raises(RefusedError, match="^start: SLVERR, status 0x[0-9a-f]+$"):
            rtl.end()
        assert rtl.driver.status().errors == ("start_period",)
        rtl.driver.clear()
        rtl.write(period, config.period)
        record = rtl.frame(config, frame.edges, frame.ready)
        assert all(map(np.array_equal, record.beats, frame.expected.beats))


def test_what_is_posted_behind_a_refused_access_is_given_up():
    config = random_cases.configured(ODD, {"period": 60, "pulses": 3}, {"threshold": 1})
    nowhere, period = 0xFFC, address("period")
    with SlicedSensor(config.sensor) as rtl:
        rtl.driver.program(config)
        for write in ((nowhere, 1), (period, config.period + 1)):
            rtl._call("write", *write)
        with pytest.raises(RefusedError, match="^both: SLVERR$"):
            rtl._finish("both")
        assert rtl.read(period) == config.period


def test_every_sensor_of_an_engine_shows_the_registers_of_its_own_subgroups():
    """The sensors and their subgroups are as many lanes, in two parts of a word; no two that are
    together in a part have the same threshold.
    """
    sensor = random_cases.built_sensor(ODD)
    number_of_sensors = 64 // sensor.subgroups + 2
    engine, threshold = Engine(sensor, number_of_sensors), "subgroup_0.dpcu.threshold"
    sensors = [SlicedSensor(sensor, engine, number) for number in range(number_of_sensors)]
    due = {}
    for number, rtl in enumerate(sensors):
        own = {s: 1 + (7 * number + s) % sensor.pixels for s in range(sensor.subgroups)}
        due |= {(number, s): value for s, value in own.items()}
        tables = ({"subgroups": [s], "threshold": value} for s, value in own.items())
        config = random_cases.configured(ODD, {}, {}, *tables)
        rtl.begin(config, random_cases.random_edges(config, 0, 1))
    engine.call("run", config.period)

    def shown():
        return {(number, s): sensors[number].peek(s, threshold) for number, s in due}

    assert shown() == due
    pokes = {(1, 2): 18, (number_of_sensors - 1, 3): 18}
    for (number, s), value in pokes.items():
        sensors[number].poke(s, threshold, value)
    assert shown() == due | pokes
    engine.close()


@pytest.mark.parametrize("subgroup", (-1, 5, "0"))
def test_a_subgroup_that_is_not_there_is_refused(subgroup):
    """The engine would read beyond its words."""
    with SlicedSensor(random_cases.built_sensor(ODD)) as rtl:
        for asked in (
            lambda: rtl.watch(0, subgroup),
            lambda: rtl.peek(subgroup, "number"),
            lambda: rtl.poke(subgroup, "number", 0),
        ):
            with pytest.raises(InputError, match="^subgroup = .*: must be an integer from 0 to 4$"):
                asked()


def test_a_sensor_whose_engine_is_closed_is_told_as_that():
    with SlicedSensor(random_cases.built_sensor(ODD)) as rtl:
        rtl.read(address("period"))
    for asked in (rtl.reset, lambda: rtl.read(address("period")), lambda: rtl.peek(0, "number")):
        with pytest.raises(SimulationError, match="^the sliced engine is closed$"):
            asked()


@pytest.fixture(scope="module")
def large():
    """Return a sensor of more subgroups than a part of a word has lanes; its second stream lies in
    two parts, and has more subgroups than a port of the core has bits in a word.
    """
    return evolve(PROOF, cols=70 * PROOF.cols, streams=2)


def of_large(sensor, number):
    """Return settings of which no two neighbours, nor their places in two sensors, are alike."""
    thresholds = [1 + (s + s // 3 + number) % 3 for s in range(sensor.subgroups)]
    tables = ({"subgroups": [s], "threshold": value} for s, value in enumerate(thresholds))
    frame = {"period": 40 + number, "pulses": 4}
    return random_cases.configured(sensor, frame, {"window": 6}, *tables), thresholds


def test_sensors_of_any_size_are_played_side_by_side(large):
    frames = []
    for number in range(2):
        config, _ = of_large(large, number)
        edges = random_cases.trouble(config, number, 30.0)
        frames.append(random_cases.predicted(Golden(large), config, edges))
        stored = np.bincount(frames[-1].expected.commit_subgroup, minlength=large.subgroups)
        assert (stored > 0).all()
    together = play_side_by_side([[frame] for frame in frames], threads=1)
    for number, (frame, (record,)) in enumerate(zip(frames, together, strict=True)):
        check(large, frame.expected, record, number)


def test_registers_of_a_sensor_of_any_size_are_those_of_its_subgroups(large):
    engine, threshold, own = Engine(large, 2), "subgroup_0.dpcu.threshold", {}
    sensors = [SlicedSensor(large, engine, number) for number in range(2)]
    for number, rtl in enumerate(sensors):
        config, thresholds = of_large(large, number)
        rtl.begin(config, random_cases.random_edges(config, 0, 1))
        own |= {(number, s): value for s, value in enumerate(thresholds)}
    engine.call("run", config.period)
    for number, subgroup in ((0, 69), (1, 0), (1, 63), (1, 64)):
        sensors[number].poke(subgroup, threshold, 9)
        own[number, subgroup] = 9
    assert {(k, s): sensors[k].peek(s, threshold) for k, s in own} == own
    assert [sensors[1].peek(s, "number") for s in (0, 63, 64, 69)] == [0, 63, 64, 69]
    engine.close()


def test_the_beats_of_a_frame_are_received_once():
    """Stream by stream, and those of the latest frame only."""
    golden = Golden(random_cases.built_sensor(ODD))
    config = random_cases.configured(ODD, {"period": 60, "pulses": 3}, {"threshold": 1})
    with SlicedSensor(config.sensor) as rtl:
        assert [len(rtl.receive(stream)) for stream in range(2)] == [0, 0]
        for seed in (1, 2):
            frame = job(golden, config, seed)
            rtl.frame(config, frame.edges, frame.ready)
            for stream in (1, 0):
                assert np.array_equal(rtl.receive(stream), frame.expected.beats[stream])
                assert len(rtl.receive(stream)) == 0


def test_every_signal_is_that_of_the_whole_rtl(tmp_path):
    """All signals of two subgroups that both waveforms name, in every cycle of a frame."""
    config = running()
    frame = job(Golden(config.sensor), config, 5)
    _, fst = play([frame], "icarus", tmp_path, waves=True)
    with SlicedSensor(config.sensor) as rtl:
        rtl.watch(0, 1)
        rtl.frame(config, frame.edges, frame.ready)
        rtl.waves(tmp_path / "sliced.vcd", cycle_ps=CYCLE_PS)
    whole, sliced = (
        {
            variable.full_name.replace("\\", ""): variable.signal
            for variable in Waveform(str(path)).all_vars()
        }
        for path in (fst, tmp_path / "sliced.vcd")
    )
    pairs = []
    for name in sliced:
        subgroup, _, inside = name.partition(".subgroup_0.")
        pair = f"{TOP}.module_0.{subgroup}.{inside}", name
        if pair[0] in whole and not FREE & {inside, *inside.split(".")}:
            pairs.append(pair)
    assert len(pairs) > 1000

    def begins(signal) -> int:
        """Return the time of the first strobe."""
        return next(time for time, value in (signal[k] for k in range(len(signal))) if value)

    start = "timing.start"
    shift = begins(whole[f"{TOP}.module_0.{start}"]) - begins(sliced[f"subgroup_0.{start}"])
    first = begins(sliced[f"subgroup_0.{start}"])
    # From some cycles on: what no reset touches is the same once light and frame have touched it.
    times = range(
        first + 2 * config.period * CYCLE_PS, first + config.frame_cycles * CYCLE_PS, CYCLE_PS
    )
    wrong = [
        other
        for one, other in pairs
        if any(
            whole[one].value_at(time + shift + CYCLE_PS - 1) != sliced[other].value_at(time)
            for time in times
        )
    ]
    assert not wrong


def test_slices_do_not_depend_on_the_size_of_the_array():
    sensor = random_cases.built_sensor(ODD)
    alone = of_one_subgroup(sensor)
    assert (sensor.subgroups, alone.subgroups) == (5, 1)
    assert units_files([Slice(sensor), SensorModule(sensor)]) == units_files(
        [Slice(alone), SensorModule(alone)]
    )


def test_arrays_of_any_size_share_the_build_of_their_slices(monkeypatch):
    """Another sensor has another one."""
    monkeypatch.setattr(sliced, "rtl_in_two", lambda sensor: ([], []))
    monkeypatch.setattr(
        sliced, "Design", lambda name, *content, **options: (name, content, options)
    )
    odd, other = random_cases.built_sensor(ODD), random_cases.built_sensor(SENSOR)
    assert sliced.design(odd) == sliced.design(of_one_subgroup(odd))
    assert sliced.design(odd)[0] != sliced.design(other)[0]


def of_odd(**frame):
    """Return a configuration whose subgroups have thresholds of their own."""
    subgroups = range(random_cases.built_sensor(ODD).subgroups)
    tables = ({"subgroups": [s], "threshold": 1 + s} for s in subgroups)
    return random_cases.configured(ODD, {"period": 60, "pulses": 3} | frame, {}, *tables)


def test_a_frame_that_hangs_is_told_with_its_cycles_and_over_with_a_reset(monkeypatch):
    config = of_odd()
    frame = job(Golden(config.sensor), config, 1)
    with SlicedSensor(config.sensor) as rtl, monkeypatch.context() as patch:
        patch.setattr(sliced, "cycle_limit", lambda config, receiver_cycles: 100)
        with pytest.raises(SimulationError, match="^no frame end within 100 cycles: the sensor"):
            rtl.frame(config, frame.edges, frame.ready)
        patch.undo()
        rtl.reset()
        check(config.sensor, frame.expected, rtl.frame(config, frame.edges, frame.ready))


def test_a_frame_is_played_step_by_step_up_to_its_end(monkeypatch):
    """A step says whether the frame goes on; `end` tells the cycle in which it is."""
    config = of_odd()
    golden = Golden(config.sensor)
    with SlicedSensor(config.sensor) as rtl:
        frame = job(golden, config, 1)
        rtl.begin(config, frame.edges, frame.ready)
        seen = [rtl.cycle]
        goes_on = True
        while goes_on and len(seen) < 2 * config.frame_cycles:
            goes_on = rtl.step()
            seen.append(rtl.cycle)
        assert goes_on is False
        record = rtl.end()
        check(config.sensor, frame.expected, record)
        played = [cycle for cycle in seen if cycle >= 0]
        assert seen[0] == -1 and played == list(range(record.cycles))
        monkeypatch.setattr(sliced, "CHUNK_CYCLES", 50)
        frame = job(golden, config, 2)
        rtl.begin(config, frame.edges, frame.ready)
        rtl.step(40)
        begun, told = rtl.cycle, []
        assert begun >= 0
        record = rtl.end(told.append)
        check(config.sensor, frame.expected, record)
        assert told == list(range(begun + 50, record.cycles, 50))


def test_a_waveform_has_what_was_watched_last_and_the_signals_that_are_named(tmp_path):
    """Subgroups in any order, each with its own values."""
    config = of_odd()
    threshold, number = "subgroup_0.dpcu.threshold", "number"
    with SlicedSensor(config.sensor) as rtl:
        assert rtl.signals() == sorted(set(rtl.signals())) and {threshold, number} < {
            *rtl.signals()
        }
        edges = random_cases.trouble(config, 1, 12.0)
        rtl.watch(0, 1, 2)
        rtl.frame(config, edges)
        rtl.watch(4, 1)
        rtl.begin(config, edges)
        rtl.step(30)
        rtl.waves(tmp_path / "some.vcd", [threshold, number], cycle_ps=10)
        rtl.watch()
        rtl.end()
    shown = {one.full_name: one for one in Waveform(str(tmp_path / "some.vcd")).all_vars()}
    scopes = {"subgroup_4": 4, "subgroup_1": 1}
    assert shown.keys() == {f"{scope}.{name}" for scope in scopes for name in (threshold, number)}
    for scope, subgroup in scopes.items():
        assert {value for _, value in shown[f"{scope}.{threshold}"].tv} == {1 + subgroup}
        assert {value for _, value in shown[f"{scope}.{number}"].tv} == {subgroup}
    text = (tmp_path / "some.vcd").read_text(encoding="utf-8")
    assert 30 * 10 <= int(text.split()[-1].removeprefix("#")) < config.frame_cycles * 10


def test_a_waveform_has_every_cycle_of_a_long_gap(tmp_path):
    """Cycles in which nothing happens are skipped only where nobody watches."""
    config = of_odd(gap=3000)
    frame = job(Golden(config.sensor), config, 1)
    with SlicedSensor(config.sensor) as rtl:
        rtl.watch(0)
        record = rtl.frame(config, frame.edges, frame.ready)
        rtl.waves(tmp_path / "gap.vcd", ["number"])
    check(config.sensor, frame.expected, record)
    text = (tmp_path / "gap.vcd").read_text(encoding="utf-8")
    cycles = int(text.split()[-1].removeprefix("#")) / CYCLE_PS
    assert cycles >= record.cycles > 2 * config.gap
    assert cycles < 1.5 * record.cycles


def test_an_error_in_the_progress_ends_all_sensors_and_is_told(monkeypatch):
    """And every engine is closed, once."""
    config = of_odd()
    made, closed = [], []
    chains = [[job(Golden(config.sensor), config, seed)] for seed in range(3)]
    begin, close = Engine.__init__, Engine.close

    def noted(engine, *values, **named):
        made.append(engine)
        begin(engine, *values, **named)

    monkeypatch.setattr(Engine, "__init__", noted)
    monkeypatch.setattr(Engine, "close", lambda engine: closed.append(engine) or close(engine))

    def enough(cycles):
        raise ValueError("enough")

    with pytest.raises(ValueError, match="^enough$"):
        play_side_by_side(chains, enough, threads=3)
    assert made and sorted(map(id, closed)) == sorted(map(id, made))
    for chain, (record,) in zip(chains, play_side_by_side(chains, threads=3), strict=True):
        check(config.sensor, chain[0].expected, record)
    assert sorted(map(id, closed)) == sorted(map(id, made))


def test_an_interrupt_ends_all_sensors(monkeypatch):
    """At the end of the cycles that they play at once, not of their frames."""
    config = of_odd(pulses=20_000)
    chains = [[FrameJob(config, random_cases.random_edges(config, 0, 1))] for _ in range(3)]
    sliced.build_library(config.sensor)
    played, close = [], Engine.close

    class Interrupted(sliced.ThreadPoolExecutor):
        def map(self, *given):
            super().map(*given)
            raise KeyboardInterrupt

    def noted(engine):
        played.append(engine.call("cycles"))
        close(engine)

    monkeypatch.setattr(sliced, "ThreadPoolExecutor", Interrupted)
    monkeypatch.setattr(Engine, "close", noted)
    with pytest.raises(KeyboardInterrupt):
        play_side_by_side(chains, threads=3)
    assert len(played) == 3
    assert max(played) < config.frame_cycles / 2


@pytest.mark.parametrize("longest", LANES[1:])
def test_words_are_the_shortest_that_hold_all_sensors(longest, monkeypatch):
    """Of those that the processor has; sensors of less than a chunk of 64 share it, and never lie
    in two.
    """
    monkeypatch.setattr(sliced, "widest", lambda: longest)
    for subgroups in (1, 5, 32, 33, 63, 64, 65, 128, 130, 600):
        sensor = SimpleNamespace(subgroups=subgroups)
        for sensors in range(1, 20):
            of_chunk = max(1, 64 // subgroups)
            bits = 64 * -(-sensors // of_chunk) * -(-subgroups // 64)
            words = [width for width in LANES[1:] if width <= longest]
            due = min((width for width in words if width >= bits), default=longest)
            assert sliced.lanes(sensor, sensors) == due, (subgroups, sensors)


def test_a_module_that_is_not_two_slices_is_found_and_told(tmp_path):
    """The second subgroup of a module takes the light of the first one."""
    _, files = rtl_in_two(PROOF)
    prove_module(PROOF, files)
    name = f"{SensorModule(PROOF).unit_name}.v"
    (whole,) = (path for path in files if path.name == name)
    text = whole.read_text(encoding="utf-8")
    assert text.count(".words(words_1)") == 1
    (tmp_path / name).write_text(
        text.replace(".words(words_1)", ".words(words_0)"), encoding="utf-8"
    )
    wrong = [tmp_path / name if path == whole else path for path in files]
    with pytest.raises(SimulationError, match="not two slices.*; verilator and icarus can$"):
        prove_module(PROOF, wrong)


def test_another_error_of_the_proofs_tool_is_told_as_it_is(monkeypatch):
    def yosys_once(*given):
        raise ToolchainError("no such program")

    monkeypatch.setattr(slice_proof, "yosys_once", yosys_once)
    with pytest.raises(ToolchainError, match="^no such program$"):
        prove_module(PROOF, [])
