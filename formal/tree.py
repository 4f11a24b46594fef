"""Proofs of the coincID tree, against a specification that goes through a cycle tick by tick as the contract does; of minigroup records.

The subgroup is 4 x 4 pixels of four phases with a window of up to nine ticks: windows end in the cycle they open in, in the next and
in the one after, at every phase. Larger ones differ in widths only: the window's arithmetic never looks at a pixel, and a pixel's at
no other.
"""

from amaranth.hdl import C, Cat, Mux, Signal
from amaranth.lib import wiring
from attrs import evolve

from ..hdl import bus
from ..hdl.minigroup import Minigroup
from ..hdl.tdc import Tdc
from ..hdl.tree import CoincidenceTree
from ..model.contract.parameters import QUARTERS
from .bench import Bench, inside, proof
from .sensors import SMALL


def _word(words, i, phases):
    return words[i * phases : (i + 1) * phases]


def _tree(b: Bench, sensor) -> None:
    m, unit, clock = b.m, CoincidenceTree(sensor), Tdc(sensor, 1)
    phases, pixels = sensor.phases, sensor.pixels
    words, mask, accept = Signal(pixels * phases), Signal(pixels), Signal()
    window_ticks, timing = Signal(sensor.window_bits), Signal(bus.time_layout(sensor))
    for signal in (words, mask, accept, window_ticks):
        m.d.comb += signal.eq(b.anything(len(signal)))
    m.d.comb += timing.as_value().eq(b.anything(timing.shape().size))
    b.assume((window_ticks != 0) & (window_ticks <= sensor.window_max))
    no_line = {f"line__{name}": None for name in ("any", "phase", "up_to", "coarse")}
    body = b.place(
        "dut", unit, words=words, mask=mask, accept=accept, window_ticks=window_ticks, timing=timing, **no_line
    )
    leaves = [inside(leaf) for leaf in body.leaves]
    b.place("tdc", clock, line_0__root=None)
    wiring.connect(m, unit.line, clock.line_0)

    # Stage 1: the edges of pixels that are on, where the gate lets them through. Edges from before a reset are gone.
    at_port = b.last(words)
    edges_1 = b.same(
        "edges_1", Cat(_word(at_port, i, phases) & (accept & mask[i]).replicate(phases) for i in range(pixels))
    )
    edges_2 = b.same("edges_2", b.last(edges_1))
    edges_3 = b.same("edges_3", b.last(edges_2))
    fresh = b.same("fresh", b.past(1, 2))

    # Stage 3: a cycle, tick by tick. State: window open, ticks left of it, map, winner, stamp, cycles since it opened and until armed.
    is_open, left, hits = Signal(), Signal(range(sensor.window_max + 1)), Signal(pixels)
    winner, stamp, elapsed = Signal(sensor.winner_bits), Signal(sensor.stamp_bits), Signal(4)
    offsets = [Signal(sensor.offset_bits, name=f"offset_{g}") for g in range(sensor.minigroups)]
    not_armed = Signal(range(sensor.rearm + 2))
    may_open = b.past(timing.may_open, 5)
    groups = [sensor.members(g) for g in range(sensor.minigroups)]

    now = {
        "open": is_open,
        "left": left,
        "hits": hits,
        "winner": winner,
        "stamp": stamp,
        "offsets": offsets,
        "live": is_open,
        "closed": C(0, 1),
        "blind": C(0, 1),
        "elapsed": elapsed + 1,
    }
    seen = C(0, pixels)
    for tick in range(phases):

        def named(name, value, tick=tick):
            return b.same(f"{name}_{tick}", value)

        raw = Cat(_word(edges_3, i, phases)[tick] & fresh for i in range(pixels))
        edges = named("edges", raw & ~seen)  # of several edges of a pixel in a cycle only the first exists
        seen = named("seen", raw | seen)
        opens = named("opens", ~now["open"] & (not_armed == 0) & ~now["closed"] & may_open & edges.any())
        in_window = named("in_window", now["open"] | opens)
        map_before = named("map_before", Mux(opens, 0, now["hits"]))
        new = named("new", edges & in_window.replicate(pixels) & ~map_before)
        map_after = named("map_after", Mux(in_window, map_before | new, now["hits"]))
        ticks_left = named("ticks_left", Mux(opens, window_ticks, now["left"]))
        closes = named("closes", in_window & (ticks_left == 1))
        winner_now = now["winner"]
        for i in reversed(range(pixels)):
            winner_now = Mux(opens & edges[i], i, winner_now)
        cycles = named("cycles", Mux(opens, 0, now["elapsed"]))
        offsets_now = []
        for g, members in enumerate(groups):
            had = Cat(map_before[i] for i in members).any()
            gets = Cat(new[i] for i in members).any()
            offset = cycles * QUARTERS + tick * QUARTERS // phases
            offsets_now.append(named(f"offset_{g}", Mux(in_window & gets & ~had, offset, now["offsets"][g])))
        now = {
            "open": named("open", in_window & ~closes),
            "left": named("left", ticks_left - in_window),
            "hits": map_after,
            "winner": named("winner", winner_now),
            "stamp": named("stamp", Mux(opens, unit.line.coarse * phases + tick, now["stamp"])),
            "offsets": offsets_now,
            "live": named("live", now["live"] | opens),
            "closed": named("closed", now["closed"] | closes),
            "blind": named("blind", now["blind"] | (edges.any() & ~in_window)),
            "elapsed": cycles,
        }
    m.d.sync += [
        is_open.eq(now["open"]),
        left.eq(now["left"]),
        hits.eq(now["hits"]),
        winner.eq(now["winner"]),
        stamp.eq(now["stamp"]),
        elapsed.eq(now["elapsed"]),
        *(offset.eq(value) for offset, value in zip(offsets, now["offsets"])),
        not_armed.eq(Mux(now["closed"], sensor.rearm, not_armed - (not_armed != 0))),
    ]
    count = sum((now["hits"][i] for i in range(pixels)), start=0)
    result = {"stamp": now["stamp"], "count": count, "winner": now["winner"], "hits": now["hits"]}

    # The tree says the same four cycles later.
    b.always(unit.closed == b.past(now["closed"], 4))
    for name, value in result.items():
        b.always(unit.window[name] == b.past(value, 4), where=unit.closed)
    for g, members in enumerate(groups):
        hit = Cat(unit.window.hits[i] for i in members).any()
        b.always(unit.window.offsets[g] == b.past(now["offsets"][g], 4), where=unit.closed & hit)
    b.always(unit.blind == b.past(now["blind"], 2), where=b.past(1, 4))

    # What follows for whoever reads a window.
    window = unit.window
    b.always(window.hits.any() & window.hits.bit_select(window.winner, 1), where=unit.closed)
    b.always(window.count == sum(window.hits, start=0), where=unit.closed)

    # Self-reset: armed R cycles after the one a window closed in; and where no window may open for a guard, armed at its end.
    since_close = Signal(range(sensor.rearm + 2), init=sensor.rearm + 1)
    m.d.sync += since_close.eq(Mux(now["closed"], 0, since_close + (since_close != sensor.rearm + 1)))
    b.always(body.rearm == 0, where=since_close >= sensor.rearm)
    guarded = Signal(range(sensor.guard + 1))
    m.d.sync += guarded.eq(Mux(may_open, 0, guarded + (guarded != sensor.guard)))
    b.always(~is_open & (not_armed == 0) & ~body.window_open & (body.rearm == 0), where=guarded == sensor.guard)
    closes_by = (sensor.window_max - 2) // phases + 1  # cycles after its opening in which a window is over
    b.always(left + guarded * phases <= sensor.window_max - 1, where=is_open)
    b.always(not_armed + guarded <= sensor.rearm + closes_by + 1, where=not_armed != 0)

    # Invariants: state against state, then the pipeline.
    b.always(body.window_open == is_open)
    b.always((body.left == left) & (left != 0), where=is_open)
    b.always((body.rearm == not_armed) & (not_armed <= sensor.rearm))
    b.always(since_close == sensor.rearm - not_armed, where=not_armed != 0)
    b.always(
        unit.line.root == Cat(Cat(_word(edges_2, i, phases)[k] for i in range(pixels)).any() for k in range(phases)),
        where=b.past(1),
    )
    b.always(unit.line.root == 0, where=~b.past(1))
    b.always(unit.line.any == edges_3.any(), where=fresh)
    b.always(~unit.line.any, where=~fresh)
    b.always(body.may_open[-1] == may_open)
    for leaf, members in zip(leaves, groups):
        second, third = (Cat(_word(edges, i, phases) for i in members) for edges in (edges_2, edges_3))
        b.always(leaf.some_2 == second.any(), where=b.past(1))
        b.always(leaf.words_2 == second, where=second.any() & b.past(1))
        b.always(leaf.some == third.any(), where=fresh)
        b.always(leaf.words == third, where=third.any() & fresh)
        b.always(leaf.active == Cat(_word(edges_3, i, phases).any() for i in members), where=third.any() & fresh)
    live = b.past(now["live"], 2)
    b.always(body.hits == b.past(now["hits"], 2), where=live)
    b.always(body.stamp == b.past(now["stamp"], 2), where=live)
    b.always(body.stamp_4 == b.past(now["stamp"]), where=b.past(now["live"]))
    b.always(body.elapsed == b.past(now["elapsed"]), where=b.past(now["live"]))
    for g, (leaf, members) in enumerate(zip(leaves, groups)):
        b.always(leaf.offset == b.past(now["offsets"][g], 2), where=live & Cat(body.hits[i] for i in members).any())
    lowest = 0
    for i in reversed(range(pixels)):
        lowest = Mux(body.firsts[i], i, lowest)
    b.always((lowest == b.past(now["winner"], 2)) & body.firsts.any(), where=live)
    b.cover(unit.closed & (window.count == 3) & (window.winner == 5) & (window.stamp[:2] == 3))
    b.cover(unit.closed & b.past(unit.closed, sensor.rearm + 1))
    b.cover(unit.blind & b.past(unit.blind))


@proof(depth=6, cover=20)
def tree(b):
    """Tree and TDC line do what the contract says tick by tick: windows, maps, counts, winners, stamps, offsets, re-arming."""
    _tree(b, SMALL)


@proof(depth=6, cover=20)
def tree_without_gap(b):
    """The same with R = 0, where a window may open in the cycle after another one closed."""
    _tree(b, evolve(SMALL, rearm=0))


@proof(depth=4, cover=20)
def minigroup_record(b):
    """A minigroup latches the stamp of a collection's first edge and the map of its pixels if it has enough of them, once a period."""
    sensor, m = SMALL, b.m
    unit = Minigroup(sensor)
    pixels, phases = sensor.minigroup_pixels, sensor.phases
    words, mask, accept = Signal(pixels * phases), Signal(pixels), Signal()
    frame, may_open, wrap = Signal(bus.frame_layout(sensor)), Signal(), Signal()
    for signal in (words, mask, accept, may_open, wrap):
        m.d.comb += signal.eq(b.anything(len(signal)))
    m.d.comb += frame.as_value().eq(b.constant(frame.shape().size))
    b.assume((frame.mg_threshold != 0) & (frame.mg_window != 0) & (frame.mg_window <= 4))
    body = b.place("dut", unit, words=words, mask=mask, accept=accept, frame=frame, may_open=may_open, wrap=wrap)

    at_port = b.last(words)
    edges_1 = Cat(_word(at_port, i, phases) & (accept & mask[i]).replicate(phases) for i in range(pixels))
    edges_2 = b.same("edges_2", b.last(edges_1))
    edges_3 = b.same("edges_3", b.last(edges_2))
    fresh = b.same("fresh", b.past(1, 2))
    b.assume(~may_open, where=~fresh)  # a reset closes the guard for longer than edges from before it take to pass
    active = b.same("active_now", Cat(_word(edges_3, i, phases).any() for i in range(pixels)))
    b.always(unit.root == Cat(Cat(_word(edges_1, i, phases)[k] for i in range(pixels)).any() for k in range(phases)))
    b.always(unit.root == 0, where=~accept)  # the gate lets nothing through

    # A period ends with its guard, in which no collection begins.
    guarded = Signal(range(5))
    m.d.sync += guarded.eq(Mux(may_open, 0, guarded + (guarded != 4)))
    b.assume(guarded == 4, where=wrap)

    latched, remaining, seen, stamp = Signal(), Signal(3), Signal(pixels), Signal(sensor.record_stamp_bits)
    latched_now = b.same("latched_now", latched & ~wrap)
    starts = b.same("starts_now", frame.minigroup_records & active.any() & may_open & ~latched_now & (remaining == 0))
    remaining_now = b.same("remaining_now", Mux(starts, frame.mg_window, remaining))
    first = sum(
        (~Cat(_word(edges_3, i, phases)[: k + 1].any() for i in range(pixels)).any() for k in range(phases)), start=0
    )
    seen_now = b.same("seen_now", Mux(starts, 0, seen) | active)
    with m.If(remaining_now != 0):
        m.d.sync += [seen.eq(seen_now), remaining.eq(remaining_now - 1)]
    m.d.sync += latched.eq(Mux(remaining_now == 1, sum(seen_now, start=0) >= frame.mg_threshold, latched_now))
    with m.If(starts):
        m.d.sync += stamp.eq(unit.coarse * QUARTERS + first * QUARTERS // phases)
    b.always(unit.latched == latched)
    b.always((unit.entry.stamp == stamp) & (unit.entry.map == seen) & seen.any(), where=latched)
    b.always(body.left == remaining)
    b.always((body.seen == seen) & (body.stamp == stamp) & ~latched & seen.any(), where=remaining != 0)
    b.always(remaining == 0, where=wrap)
    b.always(remaining + guarded <= 4, where=remaining != 0)
    b.always(body.some_2 == edges_2.any(), where=b.past(1))
    b.always(body.words_2 == edges_2, where=edges_2.any() & b.past(1))
    b.always(body.some == edges_3.any(), where=fresh)
    b.always((body.words == edges_3) & (body.active == active), where=edges_3.any() & fresh)
    b.cover(latched & wrap & (seen == 0b1011))
    b.cover((remaining == 1) & (frame.mg_window == 4) & ~latched)
