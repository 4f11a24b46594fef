# SPDX-License-Identifier: Apache-2.0
"""The host driver: names and ranges, configurations, frames cut anywhere, refusals; over the RTL
library and a mapped file.
"""

import inspect
import itertools
import mmap
import re
from contextlib import nullcontext
from pathlib import Path

import numpy as np
import pytest

from coincid.host.driver import Driver, FrameAssembler, Status, find, read_sensor
from coincid.host.mapped_memory import MemoryTransport
from coincid.host.transport import (
    ERRORS,
    STATUS,
    HostError,
    RefusedError,
    read_block,
    runs,
    write_block,
)
from coincid.model.contract import registers
from coincid.model.contract.config import load_config, parse_config, sensor_table
from coincid.model.contract.counters import COUNTER_NAMES
from coincid.model.contract.parameters import Sensor
from coincid.model.contract.registers import ADDRESS_BITS, BY_NAME, Access, address
from coincid.model.contract.result import ResultBuilder
from coincid.model.contract.settings import FRAME
from coincid.model.contract.stream import StreamError, decode_frame
from coincid.model.golden.frame import Golden
from coincid.model.shared.errors import InputError
from coincid.tb.sliced import SlicedSensor

from ..random_cases import GOLDEN_SENSORS, SENSORS, built_sensor, configured, random_edges

SENSOR = Sensor(rows=8, cols=16)
ODD = built_sensor(SENSORS["odd"])  # streams of three and two subgroups


def config(**tables):
    return parse_config({"sensor": sensor_table(SENSOR)} | tables)


class Memory:
    """A transport to a dictionary that records the writes."""

    def __init__(self, sensor=SENSOR):
        self.words = registers.reset_values(sensor) | {address("status"): 0}
        self.words |= {
            address(r.name): r.reset(sensor)
            for r in registers.built(registers.GLOBAL, sensor)
            if r.access is Access.CONSTANT
        }
        self.read, self.written = self.words.__getitem__, []

    def write(self, at, value):
        self.written.append((at, value))
        self.words[at] = value


def test_clear_without_names_clears_every_sticky_bit():
    memory = Memory()
    Driver(memory, SENSOR).clear()
    sticky = sum(1 << bits.lsb for bits in BY_NAME["status"].bits if bits.clears)
    assert memory.written == [(address("status"), sticky)]
    Driver(memory, SENSOR).clear("done")
    assert memory.written[1:] == [(address("status"), 1 << BY_NAME["status"].bit("done"))]


def test_the_end_of_a_frame_leaves_what_went_wrong_before():
    memory = Memory()
    status = address("status")
    for name in ERRORS:
        memory.words[status] = 1 << STATUS.bit("done") | 1 << STATUS.bit(name)
        Driver(memory, SENSOR).finish()
        assert memory.written.pop() == (status, 1 << STATUS.bit("done"))
        assert not memory.written


def test_only_sticky_bits_can_be_cleared_and_another_name_is_told_them():
    memory = Memory()
    for name in ("busy", "moon", ""):
        with pytest.raises(
            InputError, match=f"^bit of the status = '{name}': must be one of done, "
        ):
            Driver(memory, SENSOR).clear("done", name)
    assert not memory.written


@pytest.mark.parametrize("command", ["start", "abort", "reset"])
def test_a_command_is_its_bit_of_the_control_register(command):
    memory = Memory()
    getattr(Driver(memory, SENSOR), command)()
    assert memory.written == [(address("control"), 1 << BY_NAME["control"].bit(command))]


def test_a_frame_is_waited_for_longer_than_the_longest_one_takes():
    """Of the fewest phases, whose counter is the longest, at the slow clock of an FPGA."""
    clock_mhz = load_config("fpga").clock_mhz
    few = {"phases": 4, "window_max": 4}
    longest = parse_config({"sensor": few | {"coarse_bits": Sensor(**few).coarse_bits_max}})
    longest = longest.with_frame(pulses=FRAME["pulses"].high, period=longest.sensor.period_max)
    seconds = longest.with_frame(clock_mhz=clock_mhz).frame_cycles / clock_mhz * 1e-6
    for wait in (Driver.finish, Driver.receive):
        assert inspect.signature(wait).parameters["seconds"].default > seconds


class Refusing(Memory):
    """A transport that refuses all writes but those to the status."""

    def write(self, at, value):
        if at != address("status"):
            raise RefusedError("refused")
        super().write(at, value)


@pytest.mark.parametrize("done", [False, True])
@pytest.mark.parametrize("reason", ERRORS)
def test_a_refusal_clears_its_reasons_and_nothing_else(reason, done):
    """The end of a frame that nobody has waited for yet stays."""
    memory = Refusing()
    status = address("status")
    memory.words[status] = 1 << STATUS.bit(reason) | done << STATUS.bit("done")
    with pytest.raises(RefusedError) as refused:
        Driver(memory, SENSOR)["threshold", 1] = 2
    assert refused.value.reasons == (reason,)
    assert memory.written == [(status, 1 << STATUS.bit(reason))]


@pytest.mark.parametrize("done", [False, True])
def test_a_refusal_without_a_reason_tells_and_clears_none(done):
    memory = Refusing()
    memory.words[address("status")] = done << STATUS.bit("done")
    with pytest.raises(RefusedError) as refused:
        Driver(memory, SENSOR)["threshold", 1] = 2
    assert (str(refused.value), refused.value.reasons) == ("refused", ())
    assert not memory.written


def test_a_setting_that_is_not_known_is_written_whatever_its_value():
    """Also 0; what is known is written only where it changes."""
    memory = Memory()
    writes = config(frame={"dither_bits": 0}).register_writes()
    assert 0 in [value for _, value in writes]
    driver = Driver(memory, SENSOR)
    assert driver.write_settings(writes) == len(writes) and memory.written == writes
    assert driver.write_settings(writes) == 0 and memory.written == writes
    at, value = writes[-1]
    assert driver.write_settings([*writes[:-1], (at, value ^ 1)]) == 1
    assert memory.written[len(writes) :] == [(at, value ^ 1)]
    fresh = Driver(Memory(), SENSOR, fresh=True)
    assert fresh.write_settings(list(registers.reset_values(SENSOR).items())) == 0


def test_of_several_writes_to_one_setting_the_last_one_stays():
    """Also where that is the value which is known, and the one before is not."""
    memory = Memory()
    driver = Driver(memory, SENSOR, fresh=True)
    at = address("period")
    usual = memory.words[at]
    assert driver.write_settings([(at, 99), (at, usual)]) == 2
    assert memory.written == [(at, 99), (at, usual)]
    assert driver.write_settings([(at, usual), (at, 98), (at, 98)]) == 1
    assert memory.words[at] == driver.programmed[at] == 98


@pytest.mark.parametrize("reasons", [ERRORS[:1], ERRORS[-1:], ERRORS[:2]])
@pytest.mark.parametrize("told", [False, True])
def test_a_refusal_tells_each_of_its_reasons_once(reasons, told):
    """Whether the transport has read them already, or the driver reads them."""

    class Refused(Memory):
        def write(self, at, value):
            if at != address("status"):
                raise RefusedError("write of 2", reasons if told else ())
            super().write(at, value)

    memory = Refused()
    memory.words[address("status")] = sum(1 << STATUS.bit(reason) for reason in reasons)
    with pytest.raises(RefusedError) as refused:
        Driver(memory, SENSOR)["threshold", 1] = 2
    assert str(refused.value) == f"write of 2 ({','.join(reasons)})"
    assert refused.value.reasons == reasons


def polled(polls):
    """Return a transport whose frame is done after so many reads of the status, and a list of what
    happens.
    """
    memory, happened = Memory(), []
    status = address("status")

    def read(at):
        if at == status:
            happened.append("poll")
            done = happened.count("poll") > polls
            return done << STATUS.bit("done") | (not done) << STATUS.bit("busy")
        return memory.words[at]

    memory.read = read
    return memory, happened


@pytest.mark.parametrize("polls", [0, 1, 3])
def test_something_is_done_between_two_polls(polls):
    """And nothing after the last one."""
    memory, happened = polled(polls)
    Driver(memory, SENSOR).finish(meanwhile=lambda: happened.append("meanwhile"))
    assert happened == ["poll", "meanwhile"] * polls + ["poll"]
    assert memory.written == [(address("status"), 1 << STATUS.bit("done"))]


def test_a_frame_that_does_not_end_is_an_error_after_the_time_that_was_given():
    """It is not cleared then."""
    memory, happened = polled(10**9)
    with pytest.raises(HostError, match=r"^no frame end after 0\.01 s$"):
        Driver(memory, SENSOR).finish(seconds=0.01)
    assert happened and not memory.written


def test_names():
    assert find(SENSOR, "period").address == address("period")
    assert find(SENSOR, ("auto_bounds", 2)).address == address("auto_bounds", index=2)
    assert find(SENSOR, ("mask", 1, 1)).address == address("mask", 1, 1)
    assert find(SENSOR, ("mask", 1)).address == address("mask", 1)


@pytest.mark.parametrize(
    ("key", "shown"),
    [
        ("period", "period"),
        (("period",), "period"),
        (("threshold", 1), "threshold[1]"),
        ("auto_bounds", "auto_bounds[0]"),
        (("auto_bounds", 2), "auto_bounds[2]"),
        (("mask", 1), "mask[1, 0]"),
        (("mask", 0, 1), "mask[0, 1]"),
    ],
)
def test_a_message_names_a_word_by_its_subgroup_and_then_its_index(key, shown):
    told = re.escape(f"{shown} = -1: must be an integer from ")
    with pytest.raises(InputError, match=f"^{told}"):
        Driver(Memory(), SENSOR)[key] = -1


@pytest.mark.parametrize(
    "key, value, says",
    [
        ("periods", 1, "must be one of"),
        ((), 1, r"register \(\): must be one of"),
        ("search_pulses", 1, "register 'search_pulses': the sensor is built without it"),
        ("threshold", 1, "must be written as"),
        (("threshold", 2), 1, "from 0 to 1"),
        (("mask", 0, 2), 1, "from 0 to 1"),
        (("auto_bounds", 6), 1, "from 0 to 5"),
        (("period", 0, 1), 1, "too many"),
        (("threshold", 1), 0, r"threshold\[1\] = 0: must be an integer from 1 to 64"),
        (("threshold", 1), 65, "from 1 to 64"),
        ("period", 1025, "from 1 to 1024"),
        ("period", 2.5, "must be an integer"),
        ("period", True, "must be an integer"),
        ("id", 1, "read-only"),
        (("opened", 0), 1, "read-only"),
    ],
)
def test_names_and_ranges_are_checked_before_the_bus(key, value, says):
    memory = Memory()
    with pytest.raises(InputError, match=says):
        Driver(memory, SENSOR)[key] = value
    assert not memory.written


class Failing(Memory):
    """A transport whose line fails after so many writes, once."""

    def __init__(self, after):
        super().__init__()
        self.after = after

    def write(self, at, value):
        self.after -= 1
        if self.after == -1:
            raise HostError("the line is lost")
        super().write(at, value)


def test_what_a_write_left_when_it_failed_is_not_taken_for_known():
    """Neither the words that it wrote, nor those that it did not: both configurations can be
    programmed afterwards.
    """
    before = config(frame={"period": 99}, subgroup={"threshold": 3})
    after = config(frame={"period": 80, "pulses": 7}, subgroup={"threshold": 2, "window": 9})
    changed = Driver(Memory(), SENSOR)
    changed.program(before)
    number = changed.program(after)
    assert number > 4
    for failing in range(number):
        for again in (before, after):
            memory = Failing(10**6)
            driver = Driver(memory, SENSOR)
            driver.program(before)
            memory.after = failing
            with pytest.raises(HostError):
                driver.program(after)
            driver.program(again)
            for at, value in again.register_writes():
                assert memory.words[at] == value, (failing, at)


def test_a_setting_whose_write_failed_is_written_again():
    """The sensor may have got it, and only the answer was lost."""
    memory = Failing(10**6)
    driver = Driver(memory, SENSOR, fresh=True)
    driver["period"] = 99
    memory.after = 0
    with pytest.raises(HostError):
        driver["period"] = 50
    memory.words[address("period")] = 50
    driver.write_settings([(address("period"), 99)])
    assert memory.words[address("period")] == 99


def test_blocks_are_words_one_after_the_other_where_a_transport_has_no_faster_way():
    memory = Memory()
    first = address("threshold", 0)
    write_block(memory, first, [5, 6, 7])
    assert memory.written == [(first, 5), (first + 4, 6), (first + 8, 7)]
    assert read_block(memory, first, 3) == [5, 6, 7]


def test_only_what_changes_is_written():
    memory = Memory()
    driver = Driver(memory, fresh=True)
    assert driver.sensor == SENSOR
    of = config(frame={"period": 99}, subgroup={"threshold": 3})
    assert driver.program(of) == len(memory.written) > 3
    assert all(memory.words[at] == value for at, value in of.register_writes())
    assert driver.program(of) == 0
    driver["threshold", 1] = np.int64(2)
    assert driver.program(of) == 1 and memory.words[address("threshold", 1)] == 3
    other = parse_config({})
    told = f"sensor: the configuration is for {other.sensor}, the sensor is {SENSOR}"
    with pytest.raises(InputError, match=f"^{re.escape(told)}$"):
        driver.program(other)


def test_runs():
    assert runs([(8, 1), (12, 2), (20, 3), (16, 4), (20, 5)]) == [
        (8, [1, 2]),
        (20, [3]),
        (16, [4, 5]),
    ]


@pytest.mark.parametrize(
    "name, value, says",
    [
        ("id", 0, "no sensor: its ID is 0x00000000, must be 0x434f494e"),
        ("version", 1 << 24, "register map of version 256: this driver knows 2"),
    ],
)
def test_no_sensor(name, value, says):
    memory = Memory()
    memory.words[address(name)] = value
    with pytest.raises(HostError, match=f"^{says}$"):
        read_sensor(memory)


@pytest.mark.parametrize("name", GOLDEN_SENSORS)
def test_parameters_are_those_as_built(name):
    """A register that is not built is not read."""
    sensor = built_sensor(GOLDEN_SENSORS[name])
    assert read_sensor(Memory(sensor)) == sensor


def test_later_maps_of_the_same_version_are_known():
    sensor = Sensor(rows=8, cols=16, counts=1)
    memory = Memory(sensor)
    memory.words[address("version")] += 1
    assert read_sensor(memory) == sensor


def test_a_sensor_in_use():
    """Registers, refusals and frames of the RTL, used only through the driver, equal the golden
    model's.
    """
    of = configured(ODD, {"period": 80, "pulses": 6, "format": "full", "minigroup_records": True})
    golden = Golden(ODD)
    with SlicedSensor(ODD) as rtl:
        driver = Driver(rtl)
        assert driver.sensor == ODD
        assert driver["threshold", 1] == BY_NAME["threshold"].reset(ODD)
        driver["threshold", 1] = 5
        assert driver["threshold", 1] == 5
        driver["period"] = ODD.guard
        with pytest.raises(RefusedError) as refused:
            driver.start()
        assert refused.value.reasons == ("start_period",)
        assert driver.status() == Status(busy=False, done=False)
        rtl.driver.programmed.clear()
        for seed in range(3):
            edges = random_edges(of, 600, seed)
            trace = golden.frame(of, edges)
            rtl.frame(of, edges)
            assert all(map(np.array_equal, driver.receive(), trace.beats))
            for s in range(ODD.subgroups):
                assert [driver[name, s] for name in COUNTER_NAMES] == trace.counters[s].tolist()
        assert driver.status() == Status(busy=False, done=False)
        with pytest.raises(HostError, match="nothing more came"):
            driver.receive(seconds=0.05)


def test_a_reset_forgets_settings_and_beats():
    """Of the sensor, and in the driver: it programs all that differs from the reset's values."""
    of = configured(ODD, {"period": 80, "pulses": 6})
    reset = registers.reset_values(ODD)
    edges = random_edges(of, 600, 1)
    with SlicedSensor(ODD) as rtl:
        driver = rtl.driver
        trace = Golden(ODD).frame(of, edges)
        rtl.frame(of, edges)
        driver.receive()
        driver["threshold", 1] = 5
        driver.reset()
        assert driver.programmed == reset
        assert [driver["threshold", 1], driver["period"]] == [
            BY_NAME[name].reset(ODD) for name in ("threshold", "period")
        ]
        rtl.frame(of, edges)
        assert all(map(np.array_equal, driver.receive(), trace.beats))


def test_frames_cut_anywhere():
    golden, rng = Golden(ODD), np.random.default_rng(1)
    of = configured(
        ODD, {"period": 80, "pulses": 6, "format": "id", "minigroup_records": True, "frames": 3}
    )
    traces = [golden.frame(of, random_edges(of, 600, seed)) for seed in range(3)]
    assemblers = [FrameAssembler(ODD, k) for k in range(ODD.streams)]
    for k, assembler in enumerate(assemblers):
        stream = np.concatenate([trace.beats[k] for trace in traces])
        for part in np.split(stream, np.cumsum(rng.integers(1, 30, len(stream)))):
            assembler.add(part)
        assert len(assembler.frames) == 3
    result = ResultBuilder(of)
    for trace, *beats in zip(traces, *(assembler.frames for assembler in assemblers), strict=True):
        assert all(map(np.array_equal, beats, trace.beats))
        result.add(beats)
    arrays = result.arrays()
    assert len(arrays["stamp"]) == sum(len(trace.commit_cycle) for trace in traces)
    assert (arrays["commit_cycle"] == -1).all()
    assert np.array_equal(arrays["opened"], [trace.counters[:, 0] for trace in traces])
    assert decode_frame(assembler.frames[1], ODD, 2).number == 1
    assembler.add(stream[:5])
    with pytest.raises(StreamError, match="beat 5"):
        assembler.add(stream[:1])
    assembler.add(stream)
    assert len(assembler.frames) == 6


class Delivery(Memory):
    """A transport that delivers what is put into its streams, one portion per call."""

    def __init__(self, sensor=ODD):
        super().__init__()
        self.streams = {stream: [] for stream in range(sensor.streams)}

    def receive(self, stream):
        portions = self.streams[stream]
        return portions.pop(0) if portions else np.zeros(0, np.uint64)


def three_frames(number=0, sensor=ODD, **settings):
    """The beats of three frames of a sensor from that number on, by frame and stream."""
    of = configured(sensor, {"pulses": 2} | settings)
    golden = Golden(sensor)
    golden.frames = number
    return [golden.frame(of, random_edges(of, 300, seed)).beats for seed in range(3)]


def test_a_stream_may_begin_anew_after_any_beat():
    frames = three_frames(format="id", minigroup_records=True)  # packets of several lengths
    lost, whole, _ = (frame[0] for frame in frames)
    assembler = FrameAssembler(ODD)
    for cut in range(len(lost)):
        assembler.add(lost[:cut])
        assembler.forget()
        assembler.add(whole)
        assert len(assembler.frames) == cut + 1, cut
        assert np.array_equal(assembler.frames[-1], whole)


def test_frames_come_in_their_order_and_none_from_before_a_reset():
    delivery = Delivery()
    driver = Driver(delivery, ODD, fresh=True)
    first, second, third = three_frames()
    for stream, portions in delivery.streams.items():
        portions.append(np.concatenate([first[stream], second[stream], third[stream][:3]]))
    for frame in (first, second):
        assert all(map(np.array_equal, driver.receive(), frame))
    driver.reset()
    for stream, portions in delivery.streams.items():
        portions.append(third[stream])
    assert all(map(np.array_equal, driver.receive(), third))


def test_a_reset_leaves_no_frame_that_other_streams_have_not_sent():
    """The sensor numbers its frames from 0 again."""
    delivery = Delivery()
    driver = Driver(delivery, ODD, fresh=True)
    first, second, _ = three_frames()
    ahead, *behind = delivery.streams
    delivery.streams[ahead].append(np.concatenate([first[ahead], second[ahead]]))
    for stream in behind:
        delivery.streams[stream].append(np.concatenate([first[stream], second[stream][:3]]))
    with pytest.raises(HostError, match="nothing more came"):
        for _ in range(2):
            driver.receive(seconds=0.05)
    driver.reset()
    for stream, portions in delivery.streams.items():
        portions.append(first[stream])
    assert all(map(np.array_equal, driver.receive(), first))


THREE = built_sensor(SENSORS["tiny"] | {"rows": 16})  # three streams


@pytest.mark.parametrize(
    "lost", [(0, 0, 1), (0, 1, 0), (1, 0, 0), (1, 1, 0), (0, 1, 1), (0, 1, 2), (2, 0, 1), (1, 2, 0)]
)
@pytest.mark.parametrize("at_once", [False, True])
def test_the_first_frame_that_no_stream_has_lost_is_received(lost, at_once):
    """Whichever streams have lost how many of those before it, and also if all are there at once."""
    frames = three_frames(sensor=THREE)
    delivery = Delivery(THREE)
    for stream, portions in delivery.streams.items():
        beats = [frame[stream] for frame in frames[lost[stream] :]]
        portions += [np.concatenate(beats)] if at_once else beats
    driver = Driver(delivery, THREE, fresh=True)
    for frame in frames[max(lost) :]:
        assert all(map(np.array_equal, driver.receive(), frame))


def test_a_reset_leaves_the_frames_that_all_streams_have_sent():
    """Also if an error came before they were put together."""
    first, second, _ = three_frames()
    for damage in ([], [np.zeros(1, np.uint64)]):
        delivery = Delivery()
        driver = Driver(delivery, ODD, fresh=True)
        for stream, portions in delivery.streams.items():
            portions.append(np.concatenate([first[stream], second[stream]]))
        *_, last = delivery.streams.values()
        last[0] = np.concatenate([last[0], *damage])
        with pytest.raises(StreamError) if damage else nullcontext():
            assert all(map(np.array_equal, driver.receive(), first))
        driver.reset()
        for frame in (first, second) if damage else (second,):
            assert all(map(np.array_equal, driver.receive(), frame))


def after_an_error(first, second):
    """Return a driver over streams of which one sends a wrong beat in place of its first frame."""
    delivery = Delivery()
    driver = Driver(delivery, ODD, fresh=True)
    damaged, *others = delivery.streams
    delivery.streams[damaged] += [np.zeros(1, np.uint64), second[damaged]]
    for stream in others:
        delivery.streams[stream].append(first[stream])
    with pytest.raises(StreamError):
        driver.receive(seconds=0.05)
    return driver, delivery


@pytest.mark.parametrize("number", [0, 0xFFFF])
def test_a_frame_that_one_stream_has_lost_is_dropped_from_the_others(number):
    first, second, _ = three_frames(number)
    driver, delivery = after_an_error(first, second)
    _, *others = delivery.streams
    for stream in others:
        delivery.streams[stream].append(second[stream])
    assert all(map(np.array_equal, driver.receive(), second))


def test_a_reset_after_an_error_leaves_no_frame_that_one_stream_has_sent():
    first, second, _ = three_frames()
    driver, delivery = after_an_error(first, second)
    with pytest.raises(HostError, match="nothing more came"):
        driver.receive(seconds=0.05)
    driver.reset()
    for stream, portions in delivery.streams.items():
        portions.append(first[stream])
    assert all(map(np.array_equal, driver.receive(), first))


@pytest.mark.parametrize("seconds", [0, 4])
@pytest.mark.parametrize("silent", range(ODD.streams))
def test_a_stream_that_sends_nothing_is_told_by_its_number(silent, seconds, monkeypatch):
    """Also where nobody waits: the frames of the others came in this call."""
    monkeypatch.setattr("coincid.host.driver.time.monotonic", itertools.count().__next__)
    delivery = Delivery()
    driver = Driver(delivery, ODD, fresh=True)
    (frame, *_) = three_frames()
    for stream, portions in delivery.streams.items():
        if stream != silent:
            portions.append(frame[stream])
    told = rf"^stream {silent}: nothing more came for {seconds} s; the frame is not whole$"
    with pytest.raises(HostError, match=told):
        driver.receive(seconds=seconds)
    delivery.streams[silent].append(frame[silent])
    assert all(map(np.array_equal, driver.receive(seconds=seconds), frame))


def test_a_slow_stream_is_waited_for_as_long_as_beats_come(monkeypatch):
    now_s = [0.0]

    def clock():
        now_s[0] += 0.4
        return now_s[0]

    monkeypatch.setattr("coincid.host.driver.time.monotonic", clock)
    delivery = Delivery()
    driver = Driver(delivery, ODD, fresh=True)
    (frame, *_) = three_frames()
    for stream, portions in delivery.streams.items():
        portions += np.array_split(frame[stream], 12)
    assert all(map(np.array_equal, driver.receive(seconds=1.0), frame))
    with pytest.raises(HostError, match="nothing more came for 1 s"):
        driver.receive(seconds=1.0)


def test_mapped_file(tmp_path):
    """In a file of plain memory, every word goes to its place."""
    path, base = tmp_path / "uio", 1 << 16
    path.write_bytes(bytes(base + (1 << ADDRESS_BITS)))
    image = np.memmap(path, np.uint32, "r+", offset=base)
    for at, value in Memory().words.items():
        image[at // 4] = value
    of = config(frame={"period": 99}, subgroup={"threshold": 3, "mask": "f0f"})
    with MemoryTransport(path, base) as transport:
        driver = Driver(transport)
        assert driver.sensor == SENSOR
        driver.program(of)
        assert all(image[at // 4] == value for at, value in of.register_writes())


@pytest.mark.parametrize(
    ("base", "size"), [(0, 4096), (0x3000, 8192), (-4096, 16), (1 << 70, 16), (0, 1 << 70)]
)
def test_a_file_that_cannot_be_mapped_is_named_with_what_was_asked_of_it(tmp_path, base, size):
    short = tmp_path / "short"
    short.write_bytes(bytes(16))
    for path in (tmp_path / "none", short):
        told = re.escape(f"{path}: {size} bytes from {base:#x} on cannot be mapped (")
        with pytest.raises(InputError, match=f"^{told}"):
            MemoryTransport(path, base, size)
    for nothing in (None, 3):
        with pytest.raises(InputError, match="^path = .*: must be the name of a file"):
            MemoryTransport(nothing, base, size)


def test_a_mapped_file_is_free_after_its_use(tmp_path):
    """Also after an error, and however long the transport itself is kept."""
    path = tmp_path / "uio"
    page = mmap.ALLOCATIONGRANULARITY
    path.write_bytes(bytes(2 * page))

    def is_mapped():
        return str(path) in Path("/proc/self/maps").read_text(encoding="utf-8")

    with MemoryTransport(path, page, page) as kept:
        assert is_mapped()
    assert not is_mapped()
    with pytest.raises(KeyError), MemoryTransport(path, 0, page) as other:
        raise KeyError
    assert not is_mapped() and kept is not other


class StickyWords(dict):
    """The words of a mapped sensor: it refuses a threshold or a period of 0, and has nothing at
    `NOWHERE`. A write of 1 clears a bit of its status.
    """

    status = address("status") // 4
    of_values = [address("period") // 4, *(address("threshold", s) // 4 for s in range(2))]

    def refuse(self, reason):
        super().__setitem__(self.status, self[self.status] | 1 << STATUS.bit(reason))

    def __getitem__(self, word):
        if word == NOWHERE // 4:
            self.refuse("bad_address")
            return 0
        return super().__getitem__(word)

    def __setitem__(self, word, value):
        if word == self.status:
            super().__setitem__(word, self[word] & ~value)
        elif word in self.of_values and value == 0:
            self.refuse("bad_value")
        else:
            super().__setitem__(word, value)


NOWHERE = 0xFFC


@pytest.fixture
def mapped(tmp_path):
    path = tmp_path / "uio"
    path.write_bytes(bytes(1 << ADDRESS_BITS))
    with MemoryTransport(path) as transport:
        transport._words = StickyWords(
            {at // 4: value for at, value in registers.reset_values(SENSOR).items()}
            | {StickyWords.status: 0}
        )
        yield transport


def test_a_mapped_sensor_tells_its_refusal_after_the_access(mapped):
    """Not after the next one."""
    mapped.write(address("period"), 99)
    at = f"{address('period'):#07x}"
    with pytest.raises(RefusedError, match=rf"^write of 0x0 to {at} \(bad_value\)$"):
        mapped.write(address("period"), 0)
    mapped.write(address("period"), 98)
    with pytest.raises(RefusedError, match="read of 0x00ffc .*bad_address"):
        mapped.read(NOWHERE)
    assert mapped.read(address("period")) == 98


@pytest.mark.parametrize("old", ["bad_value", "bad_address"])
def test_an_old_error_of_a_mapped_sensor_is_no_refusal_and_hides_none(mapped, old):
    """It stays until it is cleared."""
    mapped._words.refuse(old)
    driver = Driver(mapped, SENSOR)
    driver["period"] = 50
    assert driver["period"] == 50
    assert driver.status().errors == (old,)
    with pytest.raises(RefusedError) as refused:
        mapped.write(address("period"), 0)
    assert refused.value.reasons == ("bad_value",)
    driver.clear()
    assert driver.status().errors == ()


def test_an_old_error_of_a_mapped_sensor_is_no_refusal_of_a_read(mapped):
    mapped._words.refuse("bad_address")
    assert mapped.read(address("period")) == mapped._words[address("period") // 4]


def test_the_errors_of_a_mapped_sensor_are_cleared_and_not_that_it_is_done(mapped):
    for name in ("done", "bad_value"):
        mapped._words.refuse(name)
    mapped.read(address("period"))
    assert Driver(mapped, SENSOR).status().done


def test_a_driver_tells_and_clears_the_new_reason_only(mapped):
    mapped._words.refuse("bad_address")
    driver = Driver(mapped, SENSOR)
    driver.programmed.clear()
    with pytest.raises(RefusedError) as refused:
        driver.write_settings([(address("period"), 0)])
    assert refused.value.reasons == ("bad_value",)
    assert driver.status().errors == ("bad_address",)


def test_a_mapped_sensor_keeps_the_words_after_a_refused_one(mapped):
    first = address("threshold", 0)
    before = mapped.read(first + 4)
    with pytest.raises(RefusedError):
        write_block(mapped, first, [0, before + 1])
    assert mapped.read(first + 4) == before


def test_a_mapped_sensor_has_no_beats_of_any_stream(mapped):
    """They are none, of the kind that a frame's are."""
    for stream in range(2):
        beats = mapped.receive(stream)
        assert (beats.shape, beats.dtype) == ((0,), np.uint64)
