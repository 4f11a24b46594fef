# SPDX-License-Identifier: Apache-2.0
"""The cocotb test that test_toolchain.py runs in the simulators, on its `toy`; BEHAVE selects its
behaviour.
"""

import os
import random
from pathlib import Path

import cocotb
from cocotb.clock import Clock
from cocotb.triggers import ClockCycles, Timer

import coincid.hdl  # noqa: F401  the whole project must be importable in a simulator
import coincid.model
import coincid.tb  # noqa: F401

BEHAVE = os.environ.get("BEHAVE", "pass")

if BEHAVE == "break import":
    raise ImportError("as asked")


@cocotb.test(skip=BEHAVE == "skip")
async def counts(dut):
    Clock(dut.clk, 10, "ns").start()
    await ClockCycles(dut.clk, 5)
    before = int(dut.count.value)
    await ClockCycles(dut.clk, 100)
    assert int(dut.count.value) - before == 100
    assert int(dut.inner.square.value) == int(dut.count.value) ** 2 % 256  # a signal below the top
    print(f"random number {random.random()}")
    if BEHAVE == "fail":
        raise AssertionError("as asked")
    if BEHAVE == "crash":
        os.abort()
    if BEHAVE == "hang":
        Path("pid").write_text(str(os.getpid()), encoding="utf-8")
        while True:
            await Timer(1, "us")
