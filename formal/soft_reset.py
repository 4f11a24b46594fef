# SPDX-License-Identifier: Apache-2.0
"""Proofs that a soft reset brings the whole sensor back.

The register front's proof says that the strobe comes within a bounded time after the write that
asks for it, whatever the rest of the sensor does. These proofs say that the strobe, and a reset of
a module, leave nothing of the state before. The blocks' own proofs assume no more than this.
"""

from amaranth.hdl import Fragment, ResetSignal

from ..hdl.sensor import Core
from ..hdl.subgroup_pair import SensorModule
from .proof_bench import Bench, proof, registers_in
from .sensors import SMALL_COUNTS

FRONT = "registers"
BEHIND_PORT = "behind_port"


@proof(depth=2, cover=10)
def soft_reset(b: Bench):
    """From any state and with any receiver, a soft reset gives every register of the core its value
    after `rst`; only the register bus keeps its accesses.
    """
    unit = Core(SMALL_COUNTS)
    dut = b.drive(unit, "dut")
    was_reset = b.last(unit.soft_reset)
    for part, name, _ in dut.subfragments:
        _is_reset(b, _part(part, BEHIND_PORT) if name == FRONT else part, was_reset)
    b.cover(was_reset & ~unit.m_axis.tvalid & b.last(unit.m_axis.tvalid & ~unit.m_axis.tready))


@proof(depth=3, cover=4)
def module_reset(b: Bench):
    """From any state, one cycle of reset gives every register of a module its first value, a cycle
    later.
    """
    _is_reset(b, b.drive(SensorModule(SMALL_COUNTS), "dut"), b.last(b.last(ResetSignal())))
    b.cover(b.last(b.last(ResetSignal())))


def _part(fragment: Fragment, name: str) -> Fragment:
    """Return the part inside an elaborated block that has a name."""
    return next(inner for inner, found, _ in fragment.subfragments if found == name)


def _is_reset(b: Bench, fragment: Fragment, where) -> None:
    """State that all registers of a block that have a reset have their first value."""
    for register in registers_in(fragment):
        if not register.reset_less:
            b.always(register == register.init, where=where)
