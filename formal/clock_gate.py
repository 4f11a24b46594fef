# SPDX-License-Identifier: Apache-2.0
"""Proofs that a subgroup's clock may stop: a clock edge that the gate holds back would have changed
nothing.

Everything except the front end comes to rest: no register and no row of a memory would change.
SPADs also fire between frames, so the first stages of the front end would take edges, which count
nowhere. For the front end, a tree with the gated clock is therefore compared with a tree whose
clock never stops. Some blocks have a gate of their own. As elsewhere, a proof assumes nothing about
the state at power-on.
"""

from collections.abc import Collection
from types import SimpleNamespace
from typing import Any

from amaranth.hdl import Assume, Cat, EnableInserter, Fragment, Mux, ResetSignal, Signal

# Amaranth has no other access to a memory's write enable.
from amaranth.hdl._mem import MemoryInstance

from ..hdl import bus
from ..hdl.counts import Counts
from ..hdl.dpcu import Dpcu
from ..hdl.front_end_views import POLYPHASE
from ..hdl.minigroup import Minigroup
from ..hdl.minigroup_counts import MinigroupCounts
from ..hdl.settings import SubgroupRegisters
from ..hdl.subgroup import AWAKE_CYCLES, Subgroup
from ..hdl.tree import CoincidenceTree
from ..model.contract.counts import CYCLES_MAX
from .proof_bench import Bench, parts_of, proof, registers_in
from .sensors import SMALL, SMALL_COUNTS

# How the names of registers begin that hold edges before the gate, or data that go with them.
EDGE_DATA = ("valid_1", "phases_", "step", "root", "coarse_")
COUNTS_CYCLES = 7  # without a strobe, a hit and a search; then counts stay as they are
TREE_CYCLES = 12  # without a strobe; then a tree shows nothing


def _driven(b: Bench, unit: Any) -> Fragment:
    """Place a unit with any inputs, and return it elaborated."""
    b.vary(*(signal for flow, signal in unit.flat_ports().values() if flow.name == "In"))
    b.m.submodules.dut = dut = Fragment.get(unit, None)
    return dut


def _rests(b: Bench, unit: Any, except_for: Collection[Signal] = ()) -> Signal:
    """State that no register and no row of a memory of a unit changes while its gate is closed,
    except for some registers; return when it is closed.
    """
    dut = _driven(b, unit)
    closed = b.same("closed", ~unit.clock_gate.enable)
    _stays(b, dut, closed, except_for)
    b.cover(b.past(closed) & ~closed)
    return closed


def _stays(b: Bench, dut: Fragment, where: Signal, except_for: Collection[Signal] = ()) -> None:
    """State that no register and no row of a memory of an elaborated block changes, except for some
    registers.
    """
    excepted = {id(register) for register in except_for}
    for register in registers_in(dut):
        if id(register) not in excepted:
            b.stable(register, where=where)
    for part in parts_of(dut):
        if isinstance(part, MemoryInstance):
            b.always(Cat(port._en for port in part._write_ports) == 0, where=where)
    b.cover(where)


def _quiet_for(b: Bench, quiet, most: int) -> Signal:
    """Return for how many cycles before this one `quiet` has held, up to `most`."""
    cycles = Signal(range(most + 1))
    b.m.d.sync += cycles.eq(Mux(quiet, cycles + (cycles != most), 0))
    return cycles


@proof(depth=AWAKE_CYCLES + 4, cover=AWAKE_CYCLES + 8)
def subgroup_rests(b: Bench):
    """Behind a closed clock gate no register of a subgroup would change, and no row of a memory,
    whatever is in them.
    """
    unit, tree = Subgroup(SMALL), CoincidenceTree(SMALL)
    shown = b.free(tree)
    unit.view = SimpleNamespace(
        front_end=lambda sensor: tree,
        from_spads=POLYPHASE.from_spads,
        front_end_rests=True,
    )
    _rests(b, unit)
    strobes = Cat(unit.timing[name] for name in bus.strobes(unit.sensor)).any()
    quiet = b.same(
        "quiet",
        (unit.command.operation == bus.Operation.IDLE) & ~strobes & ~unit.grant & ~ResetSignal(),
    )
    calm = _quiet_for(b, quiet, TREE_CYCLES)
    for name in ("closed", "blind", "record_due"):  # as proven below
        b.assume(~shown[name], where=calm == TREE_CYCLES)


@proof(depth=COUNTS_CYCLES + 3, cover=COUNTS_CYCLES + 6)
def counts_rest(b: Bench):
    """The counts of a subgroup come to rest within `COUNTS_CYCLES` of the last period, strobe, hit,
    read and search, which keep the subgroup's clock running for longer.
    """
    unit = Counts(SMALL_COUNTS)
    dut = _driven(b, unit)
    in_period = _cycle_rests(b, unit)
    asked = (
        in_period | unit.frame_begin | unit.start | unit.search | unit.wrap | unit.accepted.any()
    )
    quiet = ~asked & ~unit.busy & ~unit.reading & ~unit.next_minigroup & ~ResetSignal()
    calm = _quiet_for(b, quiet, COUNTS_CYCLES)
    _stays(b, dut, b.same("rests", quiet & (calm == COUNTS_CYCLES)))


def _cycle_rests(b: Bench, unit: Counts) -> Signal:
    """Return whether a period is going on.

    Help the induction: outside of a period, the number of the cycle is the highest.
    """
    went_on = Signal()
    at_stage_2 = Signal()
    in_period = b.same("in_period", unit.start | (went_on & ~unit.wrap))
    last = len(unit.wraps) - 1
    b.m.d.sync += went_on.eq(in_period)
    b.m.d.sync += at_stage_2.eq(unit.starts[last] | (at_stage_2 & ~unit.wraps[last]))
    b.always(unit.cycle == CYCLES_MAX, where=~at_stage_2)
    b.always(went_on | unit.wraps.any(), where=at_stage_2)
    for k in range(last + 1):
        b.always(went_on | unit.wraps[:k].any(), where=unit.starts[k])
    return in_period


@proof(depth=2, cover=6)
def minigroup_rests(b: Bench):
    """Behind a minigroup's closed clock gate none of its registers would change, whatever is in
    them.
    """
    _rests(b, Minigroup(SMALL))


@proof(depth=2, cover=6)
def minigroup_counts_rest(b: Bench):
    """Behind the closed clock gate of a minigroup's counts nothing would change, whatever is in
    them, except for the pulse before; a cycle that uses it follows one with a clock.
    """
    unit = MinigroupCounts(SMALL_COUNTS)
    closed = _rests(b, unit, except_for=[unit.pulse_before])
    b.always(~b.last(closed), where=unit.stopping.any() & ~b.last(ResetSignal()))


@proof(depth=2, cover=6)
def strobes_rest(b: Bench):
    """Behind the closed clock gate of a tree's strobes none of them would change, whatever is in
    them.
    """
    unit = CoincidenceTree(SMALL)
    _driven(b, unit)
    closed = b.same("closed", ~unit.clock_gate.enable)
    b.stable(Cat(unit.strobes, unit.may_open, unit.closed, unit.blind), where=closed)
    b.cover(closed)


@proof(depth=2, cover=6)
def dpcu_rests(b: Bench):
    """Behind a DPCU's closed clock gate none of its registers would change, whatever is in them."""
    _rests(b, Dpcu(SMALL))


@proof(depth=3, cover=6)
def settings_rest(b: Bench):
    """Behind the closed clock gate of a subgroup's settings none of their registers would
    change.
    """
    unit = SubgroupRegisters(SMALL)
    closed = _rests(b, unit)
    idle = b.same("idle", unit.command.operation == bus.Operation.IDLE)
    # The subgroup takes it in beside an operation.
    b.assume_stable(unit.period, where=idle & b.past(idle))
    programmed = unit.programmed
    b.always(
        unit.gate_late == (programmed.gating & (programmed.gate_start >= unit.period)), where=closed
    )
    b.always(unit.upset == Cat(unit.upsets).any(), where=closed)


@proof(depth=TREE_CYCLES + 4, cover=40)
def tree_rests(b: Bench):
    """A tree whose clock stops while no strobe comes shows the same as one whose clock runs;
    without strobes it shows nothing.
    """
    m, sensor = b.m, SMALL_COUNTS
    gated, free = CoincidenceTree(sensor), CoincidenceTree(sensor)
    for name, (flow, signal) in free.flat_ports().items():
        if flow.name == "In":
            m.d.comb += signal.eq(b.anything(len(signal)))
            m.d.comb += gated.flat_ports()[name][1].eq(signal)
    in_frame = Cat(free.timing[name] for name in bus.strobes(sensor)).any()
    strobes = b.same("strobes", in_frame | free.accept)
    calm = _quiet_for(b, ~strobes & ~ResetSignal(), TREE_CYCLES)
    needed = b.same("needed", strobes | (calm != TREE_CYCLES) | ResetSignal())
    enable = b.same("enable", b.anything(1) | needed)
    bodies = [Fragment.get(EnableInserter(enable)(gated), None), Fragment.get(free, None)]
    m.submodules.gated, m.submodules.free = bodies
    b.assume((free.window_ticks != 0) & (free.window_ticks <= sensor.window_max))

    # The strobes come through the gate, which lets nothing through outside a frame; a frame begins
    # when the clock runs.
    b.assume(~free.accept, where=~b.past(enable) | ~b.past(enable, 2))
    b.assume_stable(free.frame.as_value(), where=~enable)
    for name, signal in gated.outputs().items():
        other = free.outputs()[name]
        if name.startswith(("offsets", "window", "entries", "latched", "quarters")):
            continue
        b.always(signal == other)
    b.always(gated.window.as_value() == free.window.as_value(), where=free.closed)
    b.always(gated.latched == free.latched)
    for j, accepted in enumerate(free.accepted):
        same = gated.quarters.word_select(j, 2) == free.quarters.word_select(j, 2)
        b.always(same, where=accepted)
    for name in ("closed", "blind", "record_due", "accepted"):
        b.always(~getattr(free, name).any(), where=calm == TREE_CYCLES)
    # Registers are equal, as at power-on, except data that edges outside of frames have left:
    # nothing there is valid.
    for one, other in zip(*map(registers_in, bodies), strict=True):
        m.d.comb += Assume(b.started | (one == other))
        if not one.name.startswith(EDGE_DATA):
            b.always(one == other)
    b.cover(~enable & free.words.any())
    b.cover(free.closed & b.past(~enable, 12))
