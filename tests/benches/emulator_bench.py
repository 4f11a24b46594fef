# SPDX-License-Identifier: Apache-2.0
"""cocotb test of the emulator's pins: the unchanged host software talks to them bit by bit, and one byte is lost."""

from collections import deque

import cocotb
from cocotb.clock import Clock
from cocotb.task import bridge, resume
from cocotb.triggers import ClockCycles, FallingEdge, Timer
from cocotb.utils import get_sim_time

from coincid.host.emulator import EmulatorDriver
from coincid.host.serial_link import SerialTransport
from coincid.model.contract.parameters import Sensor
from coincid.tb.emulator import PATIENCE_S

SENSOR = Sensor(rows=4, cols=8, phases=8, window_max=16, subgroup=(4, 4))
CLOCK_NS, CLOCKS_PER_BIT = 10, 4
BIT_NS = CLOCK_NS * CLOCKS_PER_BIT
WAIT_NS = 20_000  # time that a read waits for a byte


class Pins:
    """A port at the pins for the host's transport. lose: numbers of the bytes that are lost on the way in."""

    def __init__(self, dut, lose=()):
        self.dut, self.bytes, self.lose, self.sent = dut, deque(), set(lose), 0
        dut.rx.value = 1
        cocotb.start_soon(self._listen())

    async def _listen(self):
        while True:
            await FallingEdge(self.dut.tx)
            await Timer(BIT_NS // 2, "ns")
            byte = 0
            for k in range(8):
                await Timer(BIT_NS, "ns")
                byte |= int(self.dut.tx.value) << k
            await Timer(BIT_NS, "ns")
            assert self.dut.tx.value == 1, "no stop bit"
            self.bytes.append(byte)

    async def _send(self, data):
        for byte in data:
            self.sent += 1
            if self.sent in self.lose:
                continue
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


@cocotb.test()
async def registers_through_the_pins(dut):
    Clock(dut.clk, CLOCK_NS, "ns").start()
    pins = Pins(dut, lose=(40,))
    await reset(dut)
    transport = SerialTransport(pins, patience_s=PATIENCE_S)

    def session():
        driver = EmulatorDriver(transport, SENSOR)
        driver["period"] = 77
        return driver.buffer_beats, driver["period"], driver["seed"]

    assert await bridge(session)() == (256, 77, 1)
    assert transport.repeats == 1
