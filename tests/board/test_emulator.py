# SPDX-License-Identifier: Apache-2.0
"""The emulator through its serial pins: frames word by word against the golden models, and a bad
line.

The RTL runs behind its pins as a library.
"""

import itertools
import re
import sys
from functools import partial
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from coincid.board import serial_transport
from coincid.board.driver import EmulatorDriver
from coincid.board.parameters import (
    BUFFER_BASE,
    DEAD_MAX,
    EMULATOR_ID,
    EMULATOR_VERSION,
    Emulator,
    background_address,
    echo_address,
    own_address,
)
from coincid.board.run import Session
from coincid.board.serial_link import (
    BAUD,
    ESCAPE,
    FLAG,
    FLIP,
    READ_WORDS_MAX,
    WRITE_WORDS_MAX,
    Answer,
    Operation,
)
from coincid.board.serial_transport import Deframer, SerialTransport, frame
from coincid.board.simulated import PATIENCE_S, SimulatedPort
from coincid.board.source_model import SourceSettings, source_edges
from coincid.host.driver import Status
from coincid.host.transport import STATUS, DeviceResetError, HostError, LinkError, RefusedError
from coincid.model.contract.config import sensor_table
from coincid.model.contract.packet import built_formats
from coincid.model.contract.parameters import Sensor
from coincid.model.contract.registers import address as register_address
from coincid.model.contract.registers import control
from coincid.model.golden.frame import Golden
from coincid.model.shared.errors import InputError

from ..feature_pairs import USED, config_of, covering_cases
from ..random_cases import configured

SENSOR = Sensor(rows=4, cols=8, phases=8, window_max=16, subgroup=(4, 4))
EMULATOR = Emulator(sensor=SENSOR, buffer_beats=256, clocks_per_bit=4)
CLOCK_MHZ = 100.0


def config(pulses=4, **frame):
    return configured(
        SENSOR,
        {"period": 63, "pulses": pulses, "clock_mhz": CLOCK_MHZ, "format": "id"} | frame,
        {"threshold": 2, "window": 4},
    )


def source(seed=1, background=3000) -> SourceSettings:
    rng = np.random.default_rng(seed)
    return SourceSettings(
        background=np.array([background // 2, background]),
        tick=rng.integers(0, 480, (2, 16)),
        level=rng.integers(0, 256, (2, 16)),
        spread=int(rng.integers(0, 5)),
        dead_cycles=int(rng.integers(1, 16)),
        seed=int(rng.integers(0, 1 << 32)),
    )


@pytest.fixture
def port():
    with SimulatedPort(EMULATOR, CLOCK_MHZ) as line:
        yield line


class BadLine:
    """A port that loses, doubles and damages bytes in both directions, with given probabilities."""

    def __init__(self, port, lose=0.0, double=0.0, damage=0.0):
        self.port, self.rates, self.rng = port, (lose, double, damage), np.random.default_rng(1)
        self.faults = 0

    def spoilt(self, data: bytes) -> bytes:
        lose, double, damage = self.rates
        out = bytearray()
        for byte, chance in zip(data, self.rng.random(len(data)), strict=True):
            self.faults += chance < lose + double + damage
            if chance < lose:
                continue
            if chance < lose + double:
                out += bytes([byte, byte])
            elif chance < lose + double + damage:
                out.append(byte ^ 1 << int(self.rng.integers(8)))
            else:
                out.append(byte)
        return bytes(out)

    def write(self, data):
        self.port.write(self.spoilt(data))

    def read(self):
        return self.spoilt(self.port.read())

    def now(self):
        return self.port.now()


def programmed(line, of, settings, **transport):
    """Return a driver whose emulator has these settings."""
    driver = EmulatorDriver(SerialTransport(line, patience_s=PATIENCE_S, **transport))
    driver.program(of)
    driver.write_settings(settings.register_writes(SENSOR))
    return driver


def check_frames(driver, of, settings, numbers) -> int:
    """Take frames of these numbers and check each word with the golden model; return the number of
    words.
    """
    golden, words = Golden(SENSOR), 0
    for number in numbers:
        golden.frames = number
        expected = golden.frame(of, source_edges(of, settings, number)).beats[0]
        assert np.array_equal(driver.frame(), expected), number
        words += len(expected)
    return words


def emulated_features():
    """Return the features of frames on the emulator: it has its own light, and buffers its words."""
    others = "abort", "receiver", "link_gbps", "search_pulses"
    features = {name: USED[name] for name in USED if name not in others}
    return features | {"format": built_formats(SENSOR), "light": tuple(BACKGROUND)}


BACKGROUND = {"some": 3000, "none": 0, "crowded": 12000}


def test_every_pair_of_features(port):
    """Every word of every frame is predicted."""
    driver = EmulatorDriver(SerialTransport(port, patience_s=PATIENCE_S))
    assert driver.sensor == SENSOR and driver.buffer_beats == EMULATOR.buffer_beats
    golden, words = Golden(SENSOR), 0
    table = sensor_table(SENSOR)
    usual = {"abort": "none", "receiver": "always", "link_gbps": 0.0, "search_pulses": 1}
    for seed, case in enumerate(covering_cases(emulated_features(), frozenset())):
        of = config_of(table, case | usual).with_frame(clock_mhz=CLOCK_MHZ, pulses=4)
        settings = source(seed, BACKGROUND[case["light"]])
        driver.program(of)
        driver.write_settings(settings.register_writes(SENSOR))
        for _ in range(of.frames):
            edges = source_edges(of, settings, golden.frames)
            expected = golden.frame(of, edges).beats[0]
            assert np.array_equal(driver.frame(), expected), case
            words += len(expected)
    assert words > 400
    for name in ("stalls", "link_errors"):
        assert driver[name] == 0
    assert driver.transport.repeats == 0


@pytest.mark.parametrize("frames", [0, 2])
def test_after_a_soft_reset_the_light_is_that_of_frame_0_again(port, frames):
    """Also where frame 0 was running, so that its number stays."""
    of, settings = config(), source(3)
    driver = programmed(port, of, settings)
    check_frames(driver, of, settings, range(frames))
    driver.program(config(pulses=200))
    driver.start()
    assert driver.status().busy
    driver.reset()
    while len(driver.waiting()):  # what the frame sent before
        pass
    driver.program(of)
    check_frames(driver, of, settings, range(2))


def test_registers(port):
    driver = EmulatorDriver(SerialTransport(port, patience_s=PATIENCE_S))
    for name, value in (("seed", 0xFFFF_FFFF), ("spread", 4), ("dead_cycles", 15)):
        driver[name] = value
        assert driver[name] == value
    for at, value in (
        (echo_address(1, 15), (1 << 21) - 1),
        (background_address(1), 0xFFFF),
        (echo_address(0, 0), 5),
    ):
        driver.transport.write(at, value)
        assert driver.transport.read(at) == value
    with pytest.raises(InputError, match="spread = 5: must be an integer from 0 to 4"):
        driver["spread"] = 5
    with pytest.raises(InputError, match="read-only"):
        driver["stalls"] = 0
    raw = driver.transport
    for at, value in (
        (own_address("spread"), 5),
        (own_address("dead_cycles"), 0),
        (own_address("emulator_id"), 1),
        (own_address("buffer_take"), 1),
        (background_address(0), 1 << 16),
        (echo_address(0, 0), 1 << 21),
        (background_address(2), 0),
        (background_address(0) + 4, 0),
        (BUFFER_BASE, 0),
        (0x400000, 0),
        (own_address("seed") + 1, 0),
        (0xFFC, 0),  # in the sensor's address space
    ):
        with pytest.raises(RefusedError):
            raw.write(at, value)
    ends = background_address(0) + 8, background_address(2), BUFFER_BASE + 8 * EMULATOR.buffer_beats
    for at in (0x100100, *ends, 0xF00000, 0xFFC):
        with pytest.raises(RefusedError):
            raw.read(at)
    driver.clear()
    # Settings before the wrong word are written.
    with pytest.raises(RefusedError, match=f"{own_address('dead_cycles') + 4:#08x}"):
        raw.write_block(own_address("spread"), [3, 7, 1])
    assert (driver["spread"], driver["dead_cycles"]) == (3, 7)
    driver["period"] = SENSOR.guard
    with pytest.raises(RefusedError) as refused:
        driver.start()
    assert refused.value.reasons == ("start_period",)


def test_a_frame_larger_than_the_buffer(port):
    """The sensor waits, as the stalls show; nothing hangs, and the host gets a whole frame."""
    driver = programmed(port, config(pulses=40), source(background=20000))
    beats = driver.frame()
    assert len(beats) > EMULATOR.buffer_beats and driver["stalls"] > 0
    settings = source(background=500)
    driver.program(config())
    driver.write_settings(settings.register_writes(SENSOR))
    check_frames(driver, config(), settings, [1, 2])


@pytest.mark.parametrize(
    ("busy", "told"), [(False, "nothing more came for 0.05 s"), (True, "no frame end after 0.05 s")]
)
def test_a_frame_is_waited_for_as_long_as_asked(port, busy, told):
    """For its beats, and for its end."""
    driver = programmed(port, config(pulses=1), source())
    if busy:
        driver.status = lambda: Status(busy=True, done=False)
    else:
        driver.start = lambda: None
    with pytest.raises(HostError, match=told):
        driver.frame(seconds=0.05)


def test_a_line_that_spoils_bytes(port):
    """Every frame is right anyway, because damaged frames are requested again."""
    line = BadLine(port, lose=0.002, double=0.002, damage=0.002)
    of, settings = config(pulses=4), source(7)
    driver = programmed(line, of, settings, tries=30)
    check_frames(driver, of, settings, range(2))
    assert line.faults > 5 and driver.transport.repeats > 3
    assert 0 < driver["link_errors"] <= line.faults


def test_a_cable_that_is_pulled_in_a_frame(port):
    """Nothing is answered while the cable is out; when it is back, a session continues, and all
    words are right.
    """
    transport = SerialTransport(port, tries=2, patience_s=PATIENCE_S)
    session = Session(EmulatorDriver(transport), config(), source(4))
    session.frame()
    session.driver.start()
    # the last one is incomplete
    port.write(frame(bytes([0, Operation.READ, 255, 0, 0, 0x30]))[:-4])
    port.connect(False)
    with pytest.raises(LinkError, match="no right answer in 2 tries"):
        session.driver.status()
    port.connect(True)
    session.driver.resume()
    session._program()
    for _ in range(2):
        session.frame()
    assert session.tally.frames == 3


def test_a_request_that_a_cable_cut_off_is_not_sent_later(port):
    """Only what is written while the cable is in is answered."""
    read_at = bytes([0, Operation.READ, 1, 0, 0, 0x00])
    port.write(frame(read_at))
    port.connect(False)
    port.connect(True)
    assert port.read() == b""
    port.write(frame(read_at))
    assert port.read() != b""


def test_nothing_that_is_written_while_the_cable_is_out_arrives(port):
    transport = SerialTransport(port, tries=1, patience_s=PATIENCE_S)
    seed = own_address("seed")
    transport.write(seed, 5)
    port.connect(False)
    with pytest.raises(LinkError):
        transport.write(seed, 6)
    port.connect(True)
    assert SerialTransport(port, patience_s=PATIENCE_S).read(seed) == 5


def test_a_reset_is_noticed(port):
    """A device that was reset does nothing before a HELLO; a session programs it again and
    continues.
    """
    session = Session(
        EmulatorDriver(SerialTransport(port, patience_s=PATIENCE_S)), config(), source(5)
    )
    session.frame()
    port.reset()
    with pytest.raises(DeviceResetError):
        session.driver.status()
    port.reset()
    session.driver.status()  # greeted for the first time
    port.reset()
    session.frame()
    assert session.tally.recoveries >= 1 and session.tally.frames == 2


def test_frames_from_before_an_error_do_not_come_after_it(port):
    """Two frames wait in the buffer; one was taken, and the other one was read with it."""
    session = Session(
        EmulatorDriver(SerialTransport(port, patience_s=PATIENCE_S)), config(1), source(6)
    )
    driver = session.driver
    for _ in range(2):
        driver.start()
        driver.finish()
    assert len(driver.receive()) == 1
    driver.resume()
    session._program()
    beats = session.frame()
    assert int(beats[0]) >> 32 & 0xFFFF == 2  # the number of the third frame


class Device:
    """The device's end of the serial link, as its protocol says: one register, and its answers."""

    def __init__(self):
        self.value = 0
        self.greeted = self.used = False
        self.last = 0  # number of the last request
        self.last_written = None  # answer to it, if it was a write

    def answer(self, number, operation, value):
        """Return status and content of the answer to a request of one word, or of none."""
        if operation == Operation.HELLO:
            self.greeted, self.last, self.last_written = True, number, None
            return (Answer.OKAY if self.used else Answer.FRESH), b""
        if not self.greeted:
            return Answer.FRESH, b""
        if number not in (self.last, (self.last + 1) % 256):
            return Answer.SEQUENCE, b""
        if operation == Operation.WRITE and number == self.last:
            return self.last_written or (Answer.SEQUENCE, b"")
        self.last, self.used = number, True
        if operation == Operation.READ:
            self.last_written = None
            return Answer.OKAY, self.value.to_bytes(4, "little")
        legal = value < 1 << 32 and 1 <= value <= DEAD_MAX
        self.value = value if legal else self.value
        self.last_written = (Answer.OKAY, b"\1") if legal else (Answer.REFUSED, b"\0")
        return self.last_written


def asked(port, deframer, number, operation, *values):
    """Send a request to read one word, to write `values`, or of no word, and return the bodies that
    come back.
    """
    written = values if operation == Operation.WRITE else ()
    words = 1 if operation == Operation.READ else len(written)
    address = own_address("dead_cycles").to_bytes(3, "little") if words else bytes(3)
    head = bytes([number, operation, words]) + address
    data = b"".join(value.to_bytes(4, "little") for value in written)
    port.write(frame(head + data))
    found = []
    end = port.now() + PATIENCE_S
    while not found and port.now() < end:
        found = deframer.add(port.read())
    return found


def test_a_device_that_was_only_read_is_not_fresh_any_more(port):
    deframer = Deframer()
    requests = enumerate((Operation.HELLO, Operation.READ, Operation.HELLO))
    answers = [asked(port, deframer, number, operation)[0][-1] for number, operation in requests]
    assert answers == [Answer.FRESH, Answer.OKAY, Answer.OKAY]


def test_the_longest_request_is_answered(port):
    deframer = Deframer()
    asked(port, deframer, 0, Operation.HELLO)
    (answer,) = asked(port, deframer, 1, Operation.WRITE, *[1] * WRITE_WORDS_MAX)
    assert answer[-1] in (Answer.OKAY, Answer.REFUSED)


@pytest.mark.parametrize("seed", range(3))
def test_any_requests_are_answered_as_the_protocol_says(port, seed):
    """Numbers that repeat, follow or jump; greetings among them; values that are refused."""
    rng = np.random.default_rng(seed)
    device, deframer = Device(), Deframer()
    number = 0
    for step in range(80):
        operation = Operation(int(rng.choice([0, 1, 2, 2], p=[0.2, 0.3, 0.25, 0.25])))
        number = (number + int(rng.choice([0, 1, 1, 7]))) % 256
        value = int(rng.integers(0, 3 * DEAD_MAX))
        if device.value == 0 and operation == Operation.READ:
            continue  # its value after a reset is not of the protocol
        status, content = device.answer(number, operation, value)
        found = asked(port, deframer, number, operation, value)
        assert found == [bytes([number]) + content + bytes([status])], (step, operation)
        number = device.last


def test_no_emulator():
    class Nothing:
        time = 0.0

        def write(self, data):
            pass

        def read(self):
            self.time += 1e-5
            return b""

        def now(self):
            return self.time

    with pytest.raises(HostError, match="no right answer in 3 tries"):
        EmulatorDriver(SerialTransport(Nothing(), tries=3, patience_s=PATIENCE_S))


_FLAGS = bytes([FLAG]) * 3


def test_frames_of_bytes():
    rng = np.random.default_rng(1)
    bodies = [rng.integers(0, 256, n).astype(np.uint8).tobytes() for n in range(2, 60)]
    special = (FLAG, ESCAPE, FLAG ^ FLIP, ESCAPE ^ FLIP)  # also what looks like an escaped byte
    bodies += [bytes(pair * 9) for pair in itertools.product(special, repeat=2)]
    line, deframer, found = b"".join(map(frame, bodies)), Deframer(), []
    for at in range(0, len(line), 7):
        found += deframer.add(line[at : at + 7])
    assert found == bodies and deframer.dropped == 0
    right = 0
    for _ in range(3000):  # a damaged frame is never taken for a right one
        body = bodies[int(rng.integers(len(bodies)))]
        spoilt = bytearray(frame(body))
        for _ in range(int(rng.integers(1, 4))):
            spoilt[int(rng.integers(1, len(spoilt) - 1))] = int(rng.integers(256))
        right += sum(part != body for part in Deframer().add(bytes(spoilt)))
    assert right == 0


def test_every_damaged_frame_is_dropped_and_counted():
    """Also one that is too short; flags without anything between them are no frames."""
    whole = frame(b"whole body")
    damaged = [b"\1", b"12345", b"no right check", whole[1:-1] + b"\0", whole[2:-1]]
    damaged += [frame(short)[1:-1] for short in (b"", b"\1")]  # with a right check
    deframer = Deframer()
    for number, inside in enumerate(damaged, 1):
        assert deframer.add(_FLAGS + inside + _FLAGS) == []
        assert deframer.dropped == number
        assert deframer.add(_FLAGS + whole + whole) == [b"whole body"] * 2
    assert deframer.dropped == len(damaged)


def test_blocks_of_the_page_run(tmp_path, monkeypatch):
    """Run the blocks of docs/board.md, with simulated pins in place of the board."""
    monkeypatch.chdir(tmp_path)
    page = (Path(__file__).parents[2] / "docs" / "board.md").read_text(encoding="utf-8")
    export, drive = re.findall(r"^```python\n(.*?)^```", page, re.DOTALL | re.MULTILINE)
    exec(compile(export, "board.md", "exec"), {})
    assert any((tmp_path / "build" / "emulator").glob("*.v"))
    monkeypatch.setattr(
        serial_transport, "SerialPort", lambda device: SimulatedPort(EMULATOR, CLOCK_MHZ)
    )
    monkeypatch.setattr(
        serial_transport, "SerialTransport", partial(SerialTransport, patience_s=PATIENCE_S)
    )
    names: dict = {}
    exec(compile(drive, "board.md", "exec"), names)
    assert len(names["beats"]) > 0


def test_a_port_is_opened_as_it_is_asked_for(monkeypatch):
    """Device and rate; the line's own rate is that of a port without one. A reading waits for
    some milliseconds, in seconds, so that the patience for an answer can end; a device that takes
    no bytes is no longer waited for some time later.
    """
    opened, waits = [], []
    module = ModuleType("serial")
    module.SerialException = OSError

    def serial(device, baud, timeout, write_timeout):
        opened.append((device, baud))
        waits.append((timeout, write_timeout))

    module.Serial = serial
    monkeypatch.setitem(sys.modules, "serial", module)
    serial_transport.SerialPort("/dev/ttyUSB3")
    serial_transport.SerialPort("/dev/ttyUSB4", 115_200)
    assert opened == [("/dev/ttyUSB3", BAUD), ("/dev/ttyUSB4", 115_200)]
    for timeout, write_timeout in waits:
        assert 0 < timeout <= serial_transport.PATIENCE_S / 5
        assert serial_transport.PATIENCE_S < write_timeout < 10


class OpenedError(Exception):
    """Stands for pyserial's own error."""


class Opened:
    """Stands for a port of pyserial, on which `waiting` bytes wait. error: what it raises."""

    def __init__(self, waiting=b"", error=None):
        self.waiting, self.error, self.sent, self.closed = waiting, error, b"", False

    @property
    def in_waiting(self):
        if self.error:
            raise self.error
        return len(self.waiting)

    def read(self, number):
        assert number > 0  # otherwise nobody waits for the next byte
        found, self.waiting = self.waiting[:number], self.waiting[number:]
        return found

    def write(self, data):
        if self.error:
            raise self.error
        self.sent += data

    def close(self):
        self.closed = True


@pytest.fixture
def opened(monkeypatch):
    """Return a function that opens a serial port over a stand-in."""

    def opened(line):
        module = ModuleType("serial")
        module.SerialException = OpenedError
        module.Serial = lambda device, baud, **options: line
        monkeypatch.setitem(sys.modules, "serial", module)
        return serial_transport.SerialPort("/dev/ttyUSB3")

    return opened


@pytest.mark.parametrize("waiting", [b"", b"a", b"abc" * 50])
def test_a_port_gives_all_that_waits_and_is_closed_after_its_use(opened, waiting):
    line = Opened(waiting)
    with opened(line) as port:
        assert port.read() == waiting and port.read() == b""
        port.write(b"sent")
        assert not line.closed
    assert line.sent == b"sent" and line.closed


@pytest.mark.parametrize("error", [OpenedError("no bytes"), OSError("no device")])
def test_a_port_that_is_gone_is_an_error_of_the_link(opened, error):
    """Whatever the library or the system says; it is closed all the same."""
    line = Opened(error=error)
    told = rf"^the serial port is gone \({error}\)$"
    with opened(line) as port:
        with pytest.raises(LinkError, match=told):
            port.read()
        with pytest.raises(LinkError, match=told):
            port.write(b"sent")
    assert line.closed


def test_a_port_tells_the_time_of_this_computer_and_no_beats_of_its_own(opened, monkeypatch):
    """In seconds, whatever the clock on the wall does. Beats wait in the emulator's buffer."""
    monkeypatch.setattr(serial_transport.time, "monotonic", lambda: 12.5)
    with opened(Opened()) as port:
        assert port.now() == 12.5
        beats = SerialTransport(port).receive(0)
    assert beats.dtype == np.uint64 and beats.shape == (0,)


class Counting:
    """A port to a device that gives each word its address; it loses the answers to some requests,
    and refuses the words from the address `refused` on.

    asked: operation, number of words and address of every request. written: address -> value.
    """

    def __init__(self, lost=(), refused=1 << 24):
        self.lost, self.asked, self.time, self.answers = set(lost), [], 0.0, []
        self.refused, self.written = refused, {}

    def write(self, data):
        (body,) = Deframer().add(data)
        number, operation, words = body[:3]
        address = int.from_bytes(body[3:6], "little")
        self.asked.append((Operation(operation), words, address))
        if len(self.asked) - 1 in self.lost:
            return
        addresses = range(address, min(address + 4 * words, self.refused), 4)
        content = b""
        if operation == Operation.READ:
            content = b"".join(at.to_bytes(4, "little") for at in addresses)
        elif operation == Operation.WRITE:
            values = np.frombuffer(body[6:], "<u4").tolist()
            self.written |= dict(zip(addresses, values, strict=False))
            content = bytes([len(addresses)])
        status = Answer.OKAY if len(addresses) == words else Answer.REFUSED
        self.answers += self.parts(frame(bytes([number]) + content + bytes([status])))

    def parts(self, answer):
        """Return what each reading gives of an answer."""
        return [answer]

    def read(self):
        self.time += 0.25
        return self.answers.pop(0) if self.answers else b""

    def now(self):
        return self.time


def test_reads_are_shorter_on_a_bad_line_and_grow_again_on_a_good_one():
    """Half as many words in each further try, twice as many after each answer at once."""
    line = Counting(lost=[2, 3])
    transport = SerialTransport(line, tries=3, patience_s=1.0)
    words = 3 * READ_WORDS_MAX
    assert transport.read_block(0x100, words) == list(range(0x100, 0x100 + 4 * words, 4))
    assert line.asked[0] == (Operation.HELLO, 0, 0)
    reads = [count for _, count, _ in line.asked[1:]]
    most = READ_WORDS_MAX
    assert reads[:4] == [most, most, most // 2, most // 4]
    assert reads[4:6] == [most // 4, 2 * (most // 4)] and max(reads[6:]) <= most
    assert transport.repeats == 2
    answered = [asked for k, asked in enumerate(line.asked) if k not in (0, 2, 3)]
    assert sum(count for _, count, _ in answered) == words


LENGTHS = (1, WRITE_WORDS_MAX - 1, WRITE_WORDS_MAX, WRITE_WORDS_MAX + 1, 2 * WRITE_WORDS_MAX + 5)


@pytest.mark.parametrize("words", LENGTHS)
def test_a_block_of_any_length_is_written_word_by_word_at_its_address(words):
    """In as few requests as there may be; none is empty."""
    line = Counting()
    values = [0xFFFF_FF00 + k % 200 for k in range(words)]
    SerialTransport(line, patience_s=1.0).write_block(0x100, values)
    assert line.written == {0x100 + 4 * k: value for k, value in enumerate(values)}
    writes = [count for operation, count, _ in line.asked if operation == Operation.WRITE]
    assert len(writes) == -(-words // WRITE_WORDS_MAX) and 0 not in writes
    assert max(writes) <= WRITE_WORDS_MAX


REFUSED = (0, 1, WRITE_WORDS_MAX - 1, WRITE_WORDS_MAX, WRITE_WORDS_MAX + 3, READ_WORDS_MAX + 2)


@pytest.mark.parametrize("word", REFUSED)
def test_a_refusal_names_the_first_word_that_is_refused(word):
    """By its address, also in a later request of the block; a write with its value."""
    refused = 0x100 + 4 * word
    values = list(range(500, 500 + READ_WORDS_MAX + 9))
    line = Counting(refused=refused)
    transport = SerialTransport(line, patience_s=1.0)
    told = f"write of {values[word]:#x} to {refused:#08x}"
    with pytest.raises(RefusedError, match=f"^{told}$"):
        transport.write_block(0x100, values)
    assert line.written == {0x100 + 4 * k: values[k] for k in range(word)}
    with pytest.raises(RefusedError, match=f"^read of {refused:#08x}$"):
        transport.read_block(0x100, len(values))
    assert transport.read_block(0x100, word) == list(range(0x100, refused, 4))


class Answering(Counting):
    """A device that gives other status codes to some requests, by their number."""

    def __init__(self, status):
        super().__init__()
        self.status = status

    def parts(self, answer):
        (body,) = Deframer().add(answer)
        request = len(self.asked) - 1
        if request in self.status:
            body = body[:1] + bytes([self.status[request]])
        return [frame(body)]


RESET = "^the device was reset: its settings are lost$"
GREETED = [Operation.HELLO, Operation.READ]


@pytest.mark.parametrize(
    ("status", "error", "told"),
    [
        ({0: Answer.FRESH}, None, None),  # a device of which nothing was known
        ({2: Answer.FRESH, 3: Answer.FRESH}, DeviceResetError, RESET),
        ({2: Answer.SEQUENCE}, LinkError, "^the device answers SEQUENCE: .* use the port\\?$"),
        ({2: Answer.UNKNOWN}, LinkError, "^the device answers UNKNOWN: .* use the port\\?$"),
    ],
)
def test_a_device_that_does_not_go_on_is_greeted_anew(status, error, told):
    """It was reset, or has answered another program; the next request is carried out."""
    line = Answering(status)
    transport = SerialTransport(line, tries=1, patience_s=1.0)
    assert transport.read(8) == 8
    if error:
        with pytest.raises(error, match=told):
            transport.read(12)
    assert transport.read(16) == 16
    again = [Operation.READ, *GREETED] if error else [Operation.READ]
    assert [operation for operation, *_ in line.asked] == [*GREETED, *again]


def test_a_reset_behind_a_dead_line_is_told_once():
    """By the greeting after it."""
    line = Answering({3: Answer.FRESH})
    line.lost = {2}
    transport = SerialTransport(line, tries=1, patience_s=1.0)
    assert transport.read(8) == 8
    with pytest.raises(LinkError, match="^no right answer in 1 tries$"):
        transport.read(12)
    with pytest.raises(DeviceResetError, match=RESET):
        transport.read(12)
    assert transport.read(12) == 12
    operations = [operation for operation, *_ in line.asked]
    assert operations == [*GREETED, Operation.READ, *GREETED]


@pytest.mark.parametrize("operation", Operation)
def test_an_answer_with_a_status_that_is_not_known_is_asked_for_again(operation):
    """It is that of another protocol, or damaged; a single word is read as a single one again."""
    line = Answering({int(operation != Operation.HELLO): max(Answer) + 1})
    transport = SerialTransport(line, tries=2, patience_s=1.0)
    if operation == Operation.WRITE:
        transport.write(8, 5)
        assert line.written == {8: 5}
    else:
        assert transport.read(8) == 8
    assert transport.repeats == 1
    asked = [one for one in line.asked if one[0] == operation]
    assert len(asked) == 2 and asked[0] == asked[1]


class Slow(Counting):
    """A device whose answers come in parts, each a little later."""

    def parts(self, answer):
        return [answer[k : k + 3] for k in range(0, len(answer), 3)]


def test_an_answer_is_waited_for_as_long_as_it_goes_on():
    """Also where all of it takes longer than the patience."""
    line = Slow()
    transport = SerialTransport(line, tries=1, patience_s=0.6)
    assert transport.read_block(0x100, 20) == list(range(0x100, 0x150, 4))
    assert line.time > 5 and transport.repeats == 0


@pytest.mark.parametrize("change", [-4, -1, 3])
def test_an_answer_of_another_length_than_was_asked_for_is_an_error(change):
    """A write tells as many words as there were; a read has whole words."""

    class Wrong(Counting):
        def parts(self, answer):
            (body,) = Deframer().add(answer)
            number, content, status = body[:1], body[1:-1], body[-1:]
            if len(content) == 1:
                content = bytes([content[0] + change])
            elif content:
                content = (content + bytes(4))[: len(content) + change]
            return [frame(number + content + status)]

    transport = SerialTransport(Wrong(), tries=1, patience_s=1.0)
    with pytest.raises(LinkError, match="^write to 0x000200: .* of 9 words$"):
        transport.write_block(0x200, [7] * 9)
    with pytest.raises(LinkError, match=f"^read of 0x000200: {4 + change} bytes for 1 words$"):
        transport.read_block(0x200, 1)


def test_requests_have_numbers_of_one_byte():
    line = Counting()
    transport = SerialTransport(line, patience_s=1.0)
    assert [transport.read(4 * k) for k in range(300)] == [4 * k for k in range(300)]
    assert transport.repeats == 0 and len(line.asked) == 301


def test_a_line_that_goes_dead_is_an_error_and_greeted_anew():
    line = Counting(lost=range(2, 5))
    transport = SerialTransport(line, tries=3, patience_s=1.0)
    assert transport.read(8) == 8
    with pytest.raises(LinkError, match="no right answer in 3 tries"):
        transport.read(12)
    assert transport.repeats == 2 and transport.read(16) == 16
    operations = [operation for operation, _, _ in line.asked]
    assert operations == [Operation.HELLO, *[Operation.READ] * 4, Operation.HELLO, Operation.READ]


class Words(dict):
    """A transport whose words are given by address."""

    def read(self, address):
        return self[address]


@pytest.mark.parametrize(
    ("found", "told"),
    [
        ({"emulator_id": 0x1234}, "no emulator: its ID is 0x00001234, must be 0x454d554c"),
        (
            {"emulator_version": EMULATOR_VERSION + (2 << 16)},
            "emulator's registers of version 3: this driver knows 1",
        ),
    ],
)
def test_what_is_no_emulator_that_the_driver_knows_is_refused(found, told):
    """Before anything else of it is read."""
    known = {"emulator_id": EMULATOR_ID, "emulator_version": EMULATOR_VERSION}
    words = {own_address(name): value for name, value in (known | found).items()}
    with pytest.raises(HostError, match=f"^{told}$"):
        EmulatorDriver(Words(words))


class Resting(dict):
    """A transport to an emulator of which a few words are known: its status is busy for so many
    readings after an abort.
    """

    def __init__(self, busy, status=0):
        super().__init__(
            {
                own_address("emulator_id"): EMULATOR_ID,
                own_address("emulator_version"): EMULATOR_VERSION,
                own_address("buffer_beats"): 64,
                own_address("buffer_level"): 0,
                own_address("buffer_first"): 0,
                register_address("status"): status,
            }
        )
        self.busy, self.written = busy, []

    def read(self, address):
        if address != register_address("status"):
            return self[address]
        self.busy -= bool(self.written)
        return self[address] | (self.busy > 0) << STATUS.bit("busy")

    def write(self, address, value):
        self.written.append((address, value))


def test_an_emulator_is_brought_to_rest_and_all_sticky_bits_are_cleared():
    """Only a running frame is ended. Afterwards, no setting is known."""
    sticky = sum(1 << bits.lsb for bits in STATUS.bits if bits.clears)
    clear = (register_address("status"), sticky)
    for busy, ended in ((0, []), (3, [control("abort")])):
        line = Resting(busy)
        driver = EmulatorDriver(line, SENSOR, fresh=True)
        driver.resume()
        assert line.written == [*ended, clear]
        assert not driver.programmed


def test_an_emulator_that_does_not_come_to_rest_is_an_error():
    line = Resting(10**9)
    with pytest.raises(HostError, match=r"^the sensor is still busy 0\.01 s after an abort$"):
        EmulatorDriver(line, SENSOR).resume(seconds=0.01)
    assert line.written == [control("abort")]


def test_a_later_map_of_the_same_version_is_known():
    sensor_left_out = {
        own_address("emulator_id"): EMULATOR_ID,
        own_address("emulator_version"): EMULATOR_VERSION + 5,
        own_address("buffer_beats"): 512,
    }
    assert EmulatorDriver(Words(sensor_left_out), SENSOR).buffer_beats == 512
