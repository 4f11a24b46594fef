# SPDX-License-Identifier: Apache-2.0
"""Proofs of the coincID tree against a specification that follows the contract tick by tick, and of
minigroup records.

The subgroup has 4 x 4 pixels, four phases, and a window of up to nine ticks. So windows end in the
cycle in which they open, in the next one and in the one after that, at every phase. Larger sensors
differ only in widths: the arithmetic of the window does not depend on any pixel, and that of a
pixel does not depend on other pixels.
"""

from typing import Any

from amaranth.hdl import C, Cat, Mux, Signal
from amaranth.lib import wiring
from attrs import evolve, frozen

from ..hdl.minigroup import Minigroup
from ..hdl.tdc import Tdc
from ..hdl.tree import CoincidenceTree
from ..model.contract.parameters import QUARTERS, Sensor
from .proof_bench import Bench, elaborated, proof
from .sensors import SMALL


@frozen
class Edges:
    """Edges that count by the contract: from unmasked pixels, and inside the gate. A reset drops
    all earlier edges.

    raw_1, raw_2: edge words of the unmasked pixels, independent of the gate; stage_1, stage_2,
    stage_3: words of all edges that count. The numbers are cycles behind the port. fresh: no reset
    has reached stage 2; fresh_3: none has reached stage 3.
    """

    pixels: int
    phases: int
    raw_1: Signal
    raw_2: Signal
    stage_1: Signal
    stage_2: Signal
    stage_3: Signal
    fresh: Signal
    fresh_3: Signal

    def words(self, stage, pixels=None) -> list[Any]:
        """Return the words of some pixels (default: all)."""
        chosen = range(self.pixels) if pixels is None else pixels
        return [stage[i * self.phases : (i + 1) * self.phases] for i in chosen]

    def at(self, stage, phase: int):
        """Return the edges at a phase, one bit per pixel."""
        return Cat(word[phase] for word in self.words(stage))

    def root(self, stage):
        """Return the OR of the words, one bit per phase."""
        return Cat(self.at(stage, k).any() for k in range(self.phases))


def _edges(b: Bench, words, mask, accept) -> Edges:
    """Return the edges that `words` at the port become. mask: at the port, accept: at stage 1."""
    pixels = len(mask)
    phases = len(words) // pixels
    on = Cat(mask[i].replicate(phases) for i in range(pixels))
    raw_1 = b.same("raw_1", b.last(words & on))
    stage_1 = b.same("edges_1", raw_1 & accept.replicate(len(words)))
    stage_2 = b.same("edges_2", b.last(stage_1))
    stage_3 = b.same("edges_3", b.last(stage_2))
    raw_2 = b.same("raw_2", b.last(raw_1))
    fresh, fresh_3 = b.same("fresh", b.past(1)), b.same("fresh_3", b.past(1, 2))
    return Edges(pixels, phases, raw_1, raw_2, stage_1, stage_2, stage_3, fresh, fresh_3)


def _first(word):
    """Return the phase of a word's first edge; the last phase if there is none."""
    first = len(word) - 1
    for k in reversed(range(len(word))):
        first = Mux(word[k], k, first)
    return first


def _leaf_holds(b: Bench, leaf: Minigroup, edges: Edges, pixels=None) -> None:
    """State the invariants of a minigroup's pipeline: it holds the encoded first edges of its
    pixels.
    """
    for raw, phases, since in (
        (edges.raw_1, leaf.phases_1, 1),
        (edges.raw_2, leaf.phases_2, edges.fresh),
    ):
        words = edges.words(raw, pixels)
        for word, phase in zip(words, phases, strict=True):
            b.always(phase == _first(word), where=since & Cat(words).any())
    for stage, valid, since in (
        (edges.raw_1, leaf.valid_1, 1),
        (edges.stage_2, leaf.valid_2, edges.fresh),
        (edges.stage_3, leaf.active, edges.fresh_3),
    ):
        b.always(valid == Cat(word.any() for word in edges.words(stage, pixels)), where=since)


@frozen
class Placed:
    """A tree on the bench: what it sees, and the pixels of its minigroups; may_open: at stage 2."""

    unit: CoincidenceTree
    edges: Edges
    window_ticks: Signal
    may_open: Signal
    members: list[Any]


class Specification:
    """Registers of the specification, and their next values, `now`.

    elapsed: cycles since the window opened; not_armed: cycles until the tree is armed.
    """

    now: dict[str, Any]

    def __init__(self, sensor: Sensor):
        self.open = Signal()
        self.left = Signal(range(sensor.window_max + 1))
        self.hits = Signal(sensor.pixels)
        self.winner = Signal(sensor.winner_bits)
        self.stamp = Signal(sensor.stamp_bits)
        self.offsets = [
            Signal(sensor.offset_bits, name=f"offset_{g}") for g in range(sensor.minigroups)
        ]
        self.elapsed = Signal(4)
        self.not_armed = Signal(range(sensor.rearm + 2))


def _place_tree(b: Bench, sensor: Sensor) -> Placed:
    """Place a tree with a TDC line, and any edges, any mask and gate, and a window of any legal
    length.
    """
    unit, clock = CoincidenceTree(sensor), Tdc(sensor, 1)
    window_ticks = unit.window_ticks
    b.assume((window_ticks != 0) & (window_ticks <= sensor.window_max))
    no_line = {f"line__{name}": None for name in ("any", "phase", "coarse")}
    b.place(unit, **no_line)
    for leaf in unit.leaves:
        elaborated(leaf)
    b.place(clock, line_0__root=None)
    wiring.connect(b.m, unit.line, clock.line_0)
    return Placed(
        unit=unit,
        edges=_edges(b, unit.words, unit.mask, unit.accept),
        window_ticks=window_ticks,
        may_open=b.past(unit.timing.may_open, 4),
        members=[sensor.members(g) for g in range(sensor.minigroups)],
    )


def _specification(b: Bench, dut: Placed) -> Specification:
    """Specify a cycle of stage 2 by the contract. Return its registers, and their next values in
    `now`.
    """
    sensor, edges = dut.unit.sensor, dut.edges
    spec = Specification(sensor)
    now = {
        name: getattr(spec, name) for name in ("open", "left", "hits", "winner", "stamp", "offsets")
    }
    now |= {"elapsed": spec.elapsed + 1, "live": spec.open, "closed": C(0, 1), "blind": C(0, 1)}
    seen = C(0, sensor.pixels)
    for tick in range(sensor.phases):
        raw = edges.at(edges.stage_2, tick) & edges.fresh.replicate(sensor.pixels)
        # If a pixel has several edges in a cycle, only the first one exists.
        first = b.same(f"edges_at_{tick}", raw & ~seen)
        seen = b.same(f"seen_{tick}", raw | seen)
        now = _tick(b, dut, now, tick, first, armed=(spec.not_armed == 0))
    for name in ("open", "left", "hits", "winner", "stamp", "elapsed"):
        b.m.d.sync += getattr(spec, name).eq(now[name])
    for offset, value in zip(spec.offsets, now["offsets"], strict=True):
        b.m.d.sync += offset.eq(value)
    b.m.d.sync += spec.not_armed.eq(
        Mux(now["closed"], sensor.rearm, spec.not_armed - (spec.not_armed != 0))
    )
    spec.now = now
    return spec


def _tick(b: Bench, dut: Placed, before: dict[str, Any], tick: int, edges, armed) -> dict[str, Any]:
    """Return the window after a tick with `edges` (one bit per pixel), from the window `before` the
    tick.

    live: a window was open in this cycle; closed: a window has ended in it; blind: an edge found no
    window and could not open one.
    """
    sensor, line = dut.unit.sensor, dut.unit.line

    def named(name, value):
        return b.same(f"{name}_{tick}", value)

    opens = named("opens", ~before["open"] & armed & ~before["closed"] & dut.may_open & edges.any())
    in_window = named("in_window", before["open"] | opens)
    hits_before = named("hits_before", Mux(opens, 0, before["hits"]))
    new = named("new", edges & in_window.replicate(sensor.pixels) & ~hits_before)
    ticks_left = named("ticks_left", Mux(opens, dut.window_ticks, before["left"]))
    closes = named("closes", in_window & (ticks_left == 1))
    winner = before["winner"]
    for i in reversed(range(sensor.pixels)):
        winner = Mux(opens & edges[i], i, winner)
    cycles = named("cycles", Mux(opens, 0, before["elapsed"]))
    offsets = []
    for g, members in enumerate(dut.members):
        had = Cat(hits_before[i] for i in members).any()
        gets = Cat(new[i] for i in members).any()
        offset = cycles * sensor.offset_phases + tick * sensor.offset_phases // sensor.phases
        offsets.append(
            named(f"offset_{g}", Mux(in_window & gets & ~had, offset, before["offsets"][g]))
        )
    return {
        "open": named("open", in_window & ~closes),
        "left": named("left", ticks_left - in_window),
        "hits": named("hits", Mux(in_window, hits_before | new, before["hits"])),
        "winner": named("winner", winner),
        "stamp": named("stamp", Mux(opens, line.coarse * sensor.phases + tick, before["stamp"])),
        "offsets": offsets,
        "elapsed": cycles,
        "live": named("live", before["live"] | opens),
        "closed": named("closed", before["closed"] | closes),
        "blind": named("blind", before["blind"] | (edges.any() & ~in_window)),
    }


def _agrees(b: Bench, dut: Placed, now: dict[str, Any]) -> None:
    """State that the tree agrees with the specification, five cycles later, and that a closed
    window is consistent.
    """
    unit, window = dut.unit, dut.unit.window
    b.always(unit.closed == b.past(now["closed"], 5))
    for name, value in {name: now[name] for name in ("stamp", "winner", "hits")}.items():
        b.always(window[name] == b.past(value, 5), where=unit.closed)
    b.always(window.count == b.past(sum(now["hits"], start=0), 5), where=unit.closed)
    for g, members in enumerate(dut.members):
        hit = Cat(window.hits[i] for i in members).any()
        b.always(unit.offsets[g] == b.past(now["offsets"][g], 6), where=b.past(unit.closed & hit))
    b.always(unit.blind == b.past(now["blind"], 3), where=b.past(1, 4))
    b.always(window.hits.any() & window.hits.bit_select(window.winner, 1), where=unit.closed)
    b.always(window.count == sum(window.hits, start=0), where=unit.closed)


def _rearms(b: Bench, dut: Placed, spec: Specification) -> None:
    """State the self-reset: the tree is armed R cycles after the close cycle, and always at the end
    of a guard.
    """
    unit, sensor = dut.unit, dut.unit.sensor
    since_close = Signal(range(sensor.rearm + 2), init=sensor.rearm + 1)
    b.m.d.sync += since_close.eq(
        Mux(spec.now["closed"], 0, since_close + (since_close != sensor.rearm + 1))
    )
    b.always(unit.rearm == 0, where=since_close >= sensor.rearm)
    b.always(since_close == sensor.rearm - spec.not_armed, where=spec.not_armed != 0)
    guarded = Signal(range(sensor.guard + 1))
    b.m.d.sync += guarded.eq(Mux(dut.may_open, 0, guarded + (guarded != sensor.guard)))
    at_rest = ~spec.open & (spec.not_armed == 0) & ~unit.window_open & (unit.rearm == 0)
    b.always(at_rest, where=guarded == sensor.guard)
    closes_by = (
        sensor.window_max - 2
    ) // sensor.phases + 1  # latest cycle after the opening one in which a window closes
    b.always(spec.left + guarded * sensor.phases <= sensor.window_max - 1, where=spec.open)
    b.always(spec.not_armed + guarded <= sensor.rearm + closes_by + 1, where=spec.not_armed != 0)


def _holds(b: Bench, dut: Placed, spec: Specification) -> None:
    """State the invariants: specification against registers, then the pipeline."""
    unit, sensor, edges, line, now = dut.unit, dut.unit.sensor, dut.edges, dut.unit.line, spec.now
    b.always(unit.window_open == spec.open)
    b.always((unit.left == spec.left) & (spec.left != 0), where=spec.open)
    b.always((unit.rearm == spec.not_armed) & (spec.not_armed <= sensor.rearm))
    b.always(line.root == edges.root(edges.stage_1))
    b.always(line.any == edges.stage_2.any(), where=edges.fresh)
    b.always(~line.any, where=~edges.fresh)
    b.always(unit.may_open[-2] == dut.may_open)
    live = b.past(now["live"], 3)
    for g, (leaf, members) in enumerate(zip(unit.leaves, dut.members, strict=True)):
        _leaf_holds(b, leaf, edges, members)
        hit = b.past(Cat(unit.hits[i] for i in members).any(), 3)
        b.always(leaf.offset == b.past(now["offsets"][g], 6), where=b.past(now["live"], 6) & hit)
    b.always(unit.hits == b.past(now["hits"], 3), where=live)
    stamps = (unit.stamp_3, unit.stamp_4, unit.stamp_5)
    winners = (unit.winner_3, unit.winner_4, unit.winner_5)
    for name, stages in (("stamp", stamps), ("winner", winners)):
        for cycles, stage in enumerate(stages, 1):
            b.always(stage == b.past(now[name], cycles), where=b.past(now["live"], cycles))
    b.always(unit.elapsed == b.past(now["elapsed"], 5), where=b.past(now["live"], 5))


def _tree(b: Bench, sensor: Sensor) -> None:
    dut = _place_tree(b, sensor)
    spec = _specification(b, dut)
    _agrees(b, dut, spec.now)
    _rearms(b, dut, spec)
    _holds(b, dut, spec)
    unit, window = dut.unit, dut.unit.window
    b.cover(unit.closed & (window.count == 3) & (window.winner == 5) & (window.stamp[:2] == 3))
    b.cover(unit.closed & b.past(unit.closed, sensor.rearm + 1))
    b.cover(unit.blind & b.past(unit.blind))


@proof(depth=9, cover=20)
def tree(b):
    """Tree and TDC line obey the contract tick by tick: windows, maps, counts, winners, stamps,
    offsets, re-arming.
    """
    _tree(b, SMALL)


@proof(depth=9, cover=20)
def tree_without_gap(b):
    """The tree obeys the contract with R = 0, when a window may open in the cycle after another one
    closed.
    """
    _tree(b, evolve(SMALL, rearm=0))


@proof(depth=4, cover=20)
def minigroup_record(b):
    """A minigroup with enough pixels latches the first edge's stamp and the map of its collection,
    once per period.

    It also finds the step of a cycle's first edge for the coarse offset; the proof of the tree
    covers how it is used.
    """
    # So that ticks, steps and quarters of a cycle differ.
    sensor = evolve(SMALL, phases=16, offset_phases=8)
    m = b.m
    unit = Minigroup(sensor)
    pixels = sensor.minigroup_pixels
    phases = sensor.phases
    frame = unit.frame
    may_open = unit.may_open
    wrap = unit.wrap
    coarse_4 = Signal(sensor.coarse_bits)
    b.assume((frame.mg_threshold != 0) & (frame.mg_window != 0) & (frame.mg_window <= 4))
    b.place(unit, frame=b.constant(frame.shape().size), coarse=coarse_4)

    edges = _edges(b, unit.words, unit.mask, unit.accept)
    # A reset closes the guard for longer than earlier edges take to pass.
    b.assume(~may_open, where=~edges.fresh_3)
    active = b.same("active_now", Cat(word.any() for word in edges.words(edges.stage_3)))
    b.always(b.last(unit.root) == edges.root(edges.raw_1))

    # A period ends with its guard, in which no collection begins.
    guarded = Signal(range(5))
    m.d.sync += guarded.eq(Mux(may_open, 0, guarded + (guarded != 4)))
    b.assume(guarded == 4, where=wrap)

    # At stage 3; the minigroup receives it one cycle later.
    coarse = b.same("coarse", b.anything(sensor.coarse_bits))
    m.d.comb += coarse_4.eq(b.last(coarse))
    latched, remaining, seen, stamp = (
        Signal(),
        Signal(3),
        Signal(pixels),
        Signal(sensor.record_stamp_bits),
    )
    latched_now = b.same("latched_now", latched & ~wrap)
    starts = b.same(
        "starts_now",
        frame.minigroup_records & active.any() & may_open & ~latched_now & (remaining == 0),
    )
    remaining_now = b.same("remaining_now", Mux(starts, frame.mg_window, remaining))
    first = sum((~edges.root(edges.stage_3)[: k + 1].any() for k in range(phases)), start=0)
    seen_now = b.same("seen_now", Mux(starts, 0, seen) | active)
    with m.If(remaining_now != 0):
        m.d.sync += [seen.eq(seen_now), remaining.eq(remaining_now - 1)]
    m.d.sync += latched.eq(
        Mux(remaining_now == 1, sum(seen_now, start=0) >= frame.mg_threshold, latched_now)
    )
    with m.If(starts):
        m.d.sync += stamp.eq(coarse * QUARTERS + first * QUARTERS // phases)
    b.always(
        unit.step == first * sensor.offset_phases // phases, where=active.any() & edges.fresh_3
    )
    b.always(unit.latched == latched)
    b.always((unit.entry.map == seen) & seen.any(), where=latched)
    b.always(unit.entry.stamp == stamp, where=latched & ~unit.started)
    b.always(~unit.started, where=wrap)  # a stamp is never read while it is written
    b.always(unit.left == remaining)
    b.always((unit.seen == seen) & ~latched & seen.any(), where=remaining != 0)
    b.always(unit.entry.stamp == stamp, where=(remaining != 0) & ~unit.started)
    b.always(unit.started == b.past(starts), where=b.past(1))
    b.always(
        stamp == b.last(coarse * QUARTERS + first * QUARTERS // phases),
        where=unit.started & edges.fresh_3,
    )
    b.always(unit.step_4 == b.last(unit.step), where=b.past(1) & unit.started)
    b.always(remaining == 0, where=wrap)
    b.always(remaining + guarded <= 4, where=remaining != 0)
    _leaf_holds(b, unit, edges)
    b.cover(latched & wrap & (seen == 0b1011))
    b.cover((remaining == 1) & (frame.mg_window == 4) & ~latched)
