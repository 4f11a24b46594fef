# SPDX-License-Identifier: Apache-2.0
"""What the bench in a simulator reads from the sensor's outputs, and in which order it tells it."""

import asyncio
from types import SimpleNamespace

import numpy as np
import pytest

from coincid.model.contract.edges import Edges
from coincid.model.contract.registers import control
from coincid.tb import cosim
from coincid.tb.cosim import SensorBench, _Outputs
from coincid.tb.frame_record import STORED_TO_COMMIT, cycle_limit

from ..random_cases import SENSORS, built_sensor, configured

SENSOR = built_sensor(SENSORS["odd"])  # two streams, of three and of two subgroups
# Subgroups that stored an event in a cycle, by stream.
STORED = {20: (0b101, 0b10), 21: (0, 0b11), 23: (0b111, 0), 30: (0b001, 0b01)}
# Valid and last of the streams, by cycle: the first one ends before the other.
VALID = {40: ((1, 0), (1, 0)), 41: ((1, 1), (1, 0)), 42: ((1, 0), (0, 1)), 43: ((1, 1), (1, 1))}


class Board:
    """Stands for the scoreboard."""

    def __init__(self):
        self.told, self.checked = [], 77

    def commit(self, subgroup, cycle):
        self.told.append((subgroup, cycle))

    def beat(self, stream, cycle, data, last):
        self.told.append((stream, cycle, data, last))


@pytest.fixture
def bench():
    wires = "stored", "tvalid", "tdata", "tlast"
    lines = {wire: [SimpleNamespace(value=0) for _ in range(2)] for wire in wires}
    return SimpleNamespace(sensor=SENSOR, **lines)


def word(stream, cycle):
    return (1 << 63) + 100 * stream + cycle


def read(bench, board=None):
    """Return the outputs of the frame above, read to its end."""
    outputs = _Outputs(bench, board)
    for cycle, stored in STORED.items():
        for stream, bits in enumerate(stored):
            bench.stored[stream].value = bits
        outputs.read_commits(cycle)
    for cycle, streams in VALID.items():
        for stream, (valid, last) in enumerate(streams):
            bench.tvalid[stream].value, bench.tlast[stream].value = valid, last
            bench.tdata[stream].value = word(stream, cycle)
        outputs.read_beats(cycle)
    return outputs


def test_commits_are_told_by_subgroup_and_then_by_time(bench):
    first = [SENSOR.stream_subgroups(stream).start for stream in range(2)]
    due = sorted(
        (first[stream] + k, cycle - STORED_TO_COMMIT)
        for cycle, stored in STORED.items()
        for stream, bits in enumerate(stored)
        for k in range(3)
        if bits >> k & 1
    )
    record = read(bench).record(50)
    assert list(zip(record.commit_subgroup, record.commit_cycle, strict=True)) == due
    assert record.commit_subgroup.dtype == record.commit_cycle.dtype == np.int64


def test_beats_of_every_stream_are_read_to_its_end(bench):
    outputs = read(bench)
    assert outputs.running == []
    record = outputs.record(50)
    cycles = [40, 41], [40, 41, 43]
    assert [found.tolist() for found in record.beat_cycle] == list(cycles)
    for stream, found in enumerate(record.beats):
        assert found.dtype == np.uint64
        assert found.tolist() == [word(stream, cycle) for cycle in cycles[stream]]


def test_a_frame_without_events_has_no_commits(bench):
    record = _Outputs(bench, None).record(9)
    assert record.commit_subgroup.shape == record.commit_cycle.shape == (0,)
    assert (record.cycles, record.checked) == (9, 0)


def test_the_board_is_told_what_comes_in_the_order_of_time(bench):
    board = Board()
    record = read(bench, board).record(50)
    assert record.checked == board.checked
    commits = [told for told in board.told if len(told) == 2]
    beats = [told for told in board.told if len(told) == 4]
    assert [cycle for _, cycle in commits] == sorted(record.commit_cycle.tolist())
    assert beats == [
        (stream, cycle, word(stream, cycle), bool(last))
        for cycle, streams in VALID.items()
        for stream, (valid, last) in enumerate(streams)
        if valid and cycle <= (41, 43)[stream]
    ]


class Now:
    """A trigger of the simulator that comes at once."""

    def __init__(self, signal):
        pass

    def __await__(self):
        yield from ()


@pytest.mark.parametrize("stalled", [0, 500])
def test_a_frame_that_hangs_ends_at_its_limit(stalled, bench, monkeypatch):
    """A receiver that refuses beats for some cycles has so many more."""
    monkeypatch.setattr(cosim, "FallingEdge", Now)
    config = configured(SENSORS["odd"], {"period": 60, "pulses": 3})
    sensor = SensorBench.__new__(SensorBench)
    vars(sensor).update(vars(bench), dut=SimpleNamespace(clk=None), spad=[], tready=[])

    async def nothing(*_):
        pass

    sensor.program = sensor._start = nothing
    nobody = np.zeros(0, np.int64)
    told = []
    limit = cycle_limit(config, stalled)
    with pytest.raises(
        AssertionError, match=f"^no frame end after {limit} cycles: the sensor hangs"
    ):
        asyncio.run(
            sensor.play(config, Edges(nobody, nobody, nobody), np.zeros(stalled), None, told.append)
        )
    assert told == list(range(cosim.PROGRESS_CYCLES, limit + 1, cosim.PROGRESS_CYCLES))


def test_what_is_missing_at_the_end_of_a_frame_is_asked_of_the_board(bench, monkeypatch):
    """After the last cycle of the frame, although every stream ends in the first one."""
    monkeypatch.setattr(cosim, "FallingEdge", Now)
    config = configured(SENSORS["odd"], {"period": 60, "pulses": 3})
    for line in (*bench.tvalid, *bench.tlast):
        line.value = 1
    sensor = SensorBench.__new__(SensorBench)
    tready = [SimpleNamespace(value=0) for _ in range(2)]
    vars(sensor).update(vars(bench), dut=SimpleNamespace(clk=None), spad=[], tready=tready)
    happened = []

    async def nothing(*_):
        pass

    async def start(_):
        return nothing()

    async def acknowledge():
        happened.append("acknowledged")

    sensor.program, sensor._start, sensor._acknowledge = nothing, start, acknowledge
    board = Board()
    board.finish = lambda: happened.append("finished")
    nobody = np.zeros(0, np.int64)
    edges, ready = Edges(nobody, nobody, nobody), np.zeros(0, np.uint8)
    record = asyncio.run(sensor.play(config, edges, ready, board))
    assert happened == ["finished", "acknowledged"]
    assert record.cycles == config.frame_cycles and record.checked == board.checked


class Laser:
    """A laser that fires at some reading, or never; a bench that waits for ever is told."""

    def __init__(self, fires_at=None):
        self.fires_at, self.readings = fires_at, 0

    @property
    def value(self):
        self.readings += 1
        assert self.readings < 100, "it still waits for the laser"
        return int(self.readings == self.fires_at)


class Done:
    """A task that has ended, with the error of its coroutine."""

    def __init__(self, coroutine):
        self.error = None
        try:
            coroutine.send(None)
        except StopIteration:
            pass
        except ValueError as error:
            self.error = error

    def done(self):
        return True

    def result(self):
        if self.error:
            raise self.error


@pytest.mark.parametrize("refused", [False, True])
def test_a_start_that_is_refused_is_told_instead_of_waited_for(refused, monkeypatch):
    """Otherwise the frame begins when the laser fires, however long after the answer; no beat is
    taken before it.
    """
    monkeypatch.setattr(cosim, "cocotb", SimpleNamespace(start_soon=Done))
    laser = Laser(None if refused else 20)
    lines = [SimpleNamespace(value=1) for _ in range(2)]
    sensor = SensorBench.__new__(SensorBench)
    vars(sensor).update(dut=SimpleNamespace(laser=laser), tready=lines)
    written = []

    async def write(*given):
        written.append(given)
        if refused:
            raise ValueError("SLVERR")

    sensor.write = write
    if refused:
        with pytest.raises(ValueError, match="^SLVERR$"):
            asyncio.run(sensor._start(Now(None)))
    else:
        assert isinstance(asyncio.run(sensor._start(Now(None))), Done)
        assert laser.readings == 20
    assert written == [("control", control("start")[1])]
    assert [line.value for line in lines] == [0, 0]


def test_after_a_reset_every_setting_is_written_anew(monkeypatch):
    """Before it, only those that differ. No light and no beat meets the reset."""
    monkeypatch.setattr(cosim, "RisingEdge", Now)
    started = []
    clock = SimpleNamespace(start=lambda: None)
    monkeypatch.setattr(cosim, "Clock", lambda *given: started.append(given) or clock)
    spad, ready = ([SimpleNamespace(value=1)] for _ in range(2))
    dut = SimpleNamespace(clk="clk", rst=SimpleNamespace(value=None), test_enable=spad[0])
    written = []

    async def write(address, value):
        written.append((address, value))

    sensor = SensorBench.__new__(SensorBench)
    vars(sensor).update(dut=dut, spad=spad, tready=ready, cycle_fs=2_000_000, programmed={})
    sensor.axi = SimpleNamespace(write=write)
    config = configured(SENSORS["odd"], {"period": 60, "pulses": 3})
    asyncio.run(sensor.program(config))
    settings = list(config.register_writes())
    assert written == settings
    asyncio.run(sensor.program(config.with_frame(pulses=4)))
    assert len(settings) < len(written) < 2 * len(settings)
    written.clear()
    asyncio.run(sensor.reset())
    assert (dut.rst.value, spad[0].value, ready[0].value) == (0, 0, 0)
    assert started == [("clk", 2_000_000, "fs")]
    asyncio.run(sensor.program(config))
    assert written == settings
