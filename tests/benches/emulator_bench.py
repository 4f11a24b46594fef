# SPDX-License-Identifier: Apache-2.0
"""cocotb tests of the emulator's pins: the host software, as it is, talks to them bit by bit, over a line with every fault it can have.

Each frame is compared word by word with the golden model.
"""

from collections import deque

import cocotb
import numpy as np
from cocotb.clock import Clock
from cocotb.task import bridge, resume
from cocotb.triggers import ClockCycles, FallingEdge, Timer
from cocotb.utils import get_sim_time

from coincid.host.driver import read_sensor
from coincid.host.emulator_driver import EmulatorDriver
from coincid.host.serial_transport import SerialTransport, frame
from coincid.host.transport import DeviceResetError, LinkError
from coincid.model.contract.config import parse_config, sensor_table
from coincid.model.contract.parameters import Sensor
from coincid.model.contract.serial_link import Operation
from coincid.model.golden.frame import Golden
from coincid.model.light.on_chip import SourceSettings, source_edges

SENSOR = Sensor(rows=4, cols=4, phases=4, window_max=4, coarse_bits=6, fifo_depth=4, subgroup=(4, 4), minigroup=(4, 4))
BUFFER_BEATS, CLOCK_NS, CLOCKS_PER_BIT = 64, 10, 4
BIT_NS = CLOCK_NS * CLOCKS_PER_BIT
WAIT_NS = 10_000  # that a read waits for a byte
PATIENCE_S = 30e-6
PATIENT_S = 600  # of this computer, for a frame: a simulator on a busy machine is slow
FAULTS = "lose", "double", "damage"

CONFIG = parse_config(
    {
        "sensor": sensor_table(SENSOR),
        "frame": {"period": 24, "pulses": 4, "clock_mhz": 100, "format": "id"},
        "subgroup": {"threshold": 2, "window": 4},
    }
)
SETTINGS = SourceSettings(
    background=np.array([6000]),
    tick=np.arange(30, 46).reshape(1, 16),
    level=np.full((1, 16), 128),
    spread=1,
    dead_cycles=2,
    seed=5,
)


class Pins:
    """A port of the host's transport at the pins. fault_every: every so many bytes, in each direction, has a fault, of all kinds in turn."""

    def __init__(self, dut, fault_every=0):
        self.dut, self.bytes, self.fault_every = dut, deque(), fault_every
        self.passed = {"in": 0, "out": 0}
        self.connected, self.faults = True, 0
        dut.rx.value = 1
        cocotb.start_soon(self._listen())

    def _on_the_way(self, byte, way):
        """What arrives of a byte."""
        self.passed[way] += 1
        if not self.connected:
            return []
        turn, rest = divmod(self.passed[way], self.fault_every) if self.fault_every else (0, 1)
        if rest:
            return [byte]
        self.faults += 1
        fault = FAULTS[turn % len(FAULTS)]
        return {"lose": [], "double": [byte, byte], "damage": [byte ^ 0x10]}[fault]

    async def _listen(self):
        while True:
            await FallingEdge(self.dut.tx)
            await Timer(BIT_NS // 2, "ns")
            byte = 0
            for k in range(8):
                await Timer(BIT_NS, "ns")
                byte |= int(self.dut.tx.value) << k
            await Timer(BIT_NS, "ns")
            if int(self.dut.tx.value):  # a stop bit; none where a reset came in between
                self.bytes.extend(self._on_the_way(byte, "out"))

    async def _send(self, data):
        for sent in data:
            for byte in self._on_the_way(sent, "in"):
                for k in range(10):
                    self.dut.rx.value = (byte << 1 | 0x200) >> k & 1
                    await Timer(BIT_NS, "ns")

    async def _take(self):
        end = get_sim_time("ns") + WAIT_NS
        while not self.bytes and get_sim_time("ns") < end:
            await Timer(10 * BIT_NS, "ns")
        taken = bytes(self.bytes)
        self.bytes.clear()
        return taken

    def write(self, data):
        resume(self._send)(data)

    def read(self):
        return resume(self._take)()

    def now(self):
        return get_sim_time("ns") * 1e-9


async def reset(dut):
    dut.rst.value = 1
    await ClockCycles(dut.clk, 4)
    dut.rst.value = 0
    await ClockCycles(dut.clk, 2)


async def begin(dut, **line):
    Clock(dut.clk, CLOCK_NS, "ns").start()
    pins = Pins(dut, **line)
    await reset(dut)
    return pins


def programmed(pins, **transport):
    driver = EmulatorDriver(SerialTransport(pins, patience_s=PATIENCE_S, **transport), SENSOR, fresh=True)
    assert driver.buffer_beats == BUFFER_BEATS
    program(driver)
    return driver


def program(driver):
    driver.program(CONFIG)
    driver.write_settings(SETTINGS.register_writes(SENSOR))


def expected(number):
    golden = Golden(SENSOR)
    golden.frames = number
    beats = golden.frame(CONFIG, source_edges(CONFIG, SETTINGS, number)).beats[0]
    assert len(beats) > 10
    return beats


def check(beats):
    """The frame that `beats` say they are, as the golden model has it; its number."""
    number = int(beats[0]) >> 32 & 0xFFFF
    assert np.array_equal(beats, expected(number)), number
    return number


@cocotb.test()
async def frames_and_a_host_that_stops_reading(dut):
    """It asks, and asks again in the midst of the answer, and hears nothing of either; the next question is answered."""
    pins = await begin(dut)

    def session():
        driver = programmed(pins)
        assert read_sensor(driver.transport) == SENSOR
        assert [check(driver.frame(PATIENT_S)) for _ in range(2)] == [0, 1]
        assert driver.transport.repeats == 0 and driver["link_errors"] == 0
        driver.start()
        for _ in range(3):
            pins.write(frame(bytes([99, Operation.READ, 60, 0, 0, 0x30])))
        pins.bytes.clear()
        (beats,) = driver.receive(PATIENT_S)
        driver.finish(PATIENT_S)
        assert check(beats) == 2

    await bridge(session)()


@cocotb.test()
async def lost_doubled_and_damaged_bytes(dut):
    pins = await begin(dut, fault_every=151)

    def session():
        driver = programmed(pins, tries=20)
        assert check(driver.frame(PATIENT_S)) == 0
        assert driver.transport.repeats >= 2 and driver["link_errors"] > 0

    await bridge(session)()
    assert pins.faults >= len(FAULTS)


@cocotb.test()
async def a_cable_pulled_in_a_frame(dut):
    """In the midst of a request; the frame under way is dropped, and the next one is right."""
    pins = await begin(dut)

    def session():
        driver = programmed(pins, tries=2)
        driver.start()
        pins.write(frame(bytes([0, Operation.READ, 60, 0, 0, 0x30]))[:-3])
        pins.connected = False
        try:
            driver.status()
            raise AssertionError("an answer through no cable")
        except LinkError:
            pass
        pins.connected = True
        driver.resume(PATIENT_S)
        assert check(driver.frame(PATIENT_S)) == 1

    await bridge(session)()


@cocotb.test()
async def a_reset_in_a_frame(dut):
    """The host is told before anything is done; programmed anew, frames begin with the first."""
    pins = await begin(dut)

    def session():
        driver = programmed(pins)
        assert check(driver.frame(PATIENT_S)) == 0
        driver.start()
        resume(reset)(dut)
        try:
            driver.status()
            raise AssertionError("a reset that was not told")
        except DeviceResetError:
            pass
        driver.resume(PATIENT_S)
        program(driver)
        assert check(driver.frame(PATIENT_S)) == 0

    await bridge(session)()
