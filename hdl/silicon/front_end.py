# SPDX-License-Identifier: Apache-2.0
"""Front end of the asynchronous view: hit flops that the SPADs clock, event trees, window banks,
and synchronisers.

It replaces `CoincidenceTree` and has the same outputs in the same cycles. The paper (III-A, Fig. 3)
draws this tree and shows no circuit; flops, banks and synchronisers are our choice, explained in
docs/async.md.
"""

from amaranth.hdl import (
    Cat,
    ClockDomain,
    ClockSignal,
    Const,
    Instance,
    Module,
    Mux,
    ResetSignal,
    Signal,
    Value,
)
from amaranth.lib.wiring import In

from ...model.contract.parameters import QUARTERS, Sensor
from ..logic import any_of
from ..tree import FrontEnd
from ..unit import place
from .circuit import (
    HIT_FS,
    Circuit,
    arbiter_rows,
    delayed,
    hit_flop,
    johnson_number,
    lag_fs,
    sample,
)
from .event_tree import EventTree, mark_bits
from .minigroup import AsyncMinigroup
from .tdc import line_signature
from .window_control import AsyncControl


class AsyncFrontEnd(FrontEnd):
    """Front end of a subgroup.

    Stages count from the SPADs' edges, as in `CoincidenceTree`: a window that closes in cycle c
    leaves at stage 7.

    Ports
    -----
    spad : in, pixels, the rising edge is the avalanche; mask : in; gate : in, the gate is open, or
        gating is off (stage 0)
    window_ticks, frame, timing : in; closed, window, offsets, blind, record_due, latched, entries :
        out, as in `CoincidenceTree`
    line : the subgroup's TDC sampling line

    Reset clears every flop that an event sets at once, without waiting for the clock, and arms the
    tree.
    """

    unit_name = "coincid_async_front"

    def __init__(self, sensor: Sensor, circuit: Circuit):
        self.circuit = circuit
        super().__init__(
            sensor,
            line_signature(sensor),
            spad=In(sensor.pixels),
            mask=In(sensor.pixels),
            gate=In(1),
        )
        self.control = AsyncControl(sensor, circuit)
        # Formed at the clock; numbers are those of stages.
        self.window_open = Signal()  # a window goes on (stage 3)
        self.inside = Signal()  # a window was open in the cycle (stage 3)
        self.opening_4 = Signal()
        self.closing_4 = Signal()
        self.winner = Signal(sensor.winner_bits)

    def elaborate(self, platform):
        m = Module()
        # Timing strobes come two cycles ahead of the SPADs.
        may_open = Signal(5)
        wrap = Signal(5)
        running = Signal(2)
        m.d.sync += [
            may_open.eq((may_open << 1) | self.timing.may_open),
            wrap.eq((wrap << 1) | self.timing.wrap),
            running.eq((running << 1) | self.timing.running),
        ]
        reset = Signal()
        m.d.comb += reset.eq(ResetSignal())
        hits, trees = self._hits(m, platform, running[1], reset)
        pictures = self._windows(m, platform, may_open[0], hits, trees, reset)
        self._collect(m, platform, self._facts(m, hits, trees, pictures), may_open[-1], wrap[-1])
        return m

    def _hits(self, m, platform, running, reset):
        """Two banks of hit flops take turns, one cycle each; one is read and cleared while the
        other listens.

        Return the flops and the trees of both.
        """
        sensor = self.sensor
        line = self.line
        parity = self.control.parity
        skews = self.circuit.pixel_skew_fs or (0,) * sensor.pixels
        lines = []
        for i, skew in enumerate(skews):
            spad = self.spad[i]
            lines.append(delayed(m, f"spad_{i}", spad, skew) if skew else spad)
        banks = []
        trees = []
        for q in range(2):
            listens = Signal(name=f"listens_{q}")
            clear = Signal(name=f"clear_{q}")
            m.d.comb += [
                listens.eq((parity == q) & running & self.gate),
                clear.eq((line.wipe & (parity != q)) | reset),
            ]
            flops = []
            for i, spad in enumerate(lines):
                armed = listens & self.mask[i]
                flops.append(hit_flop(m, f"hit_{q}_{i}", spad, armed, clear, HIT_FS))
            tree = EventTree(sensor)
            place(
                m,
                f"tree_{q}",
                tree,
                platform,
                hits=Cat(flops),
                phases=line.phases,
                gray_a=line.gray_a,
                gray_b=line.gray_b,
                half=line.half,
            )
            banks.append(Cat(flops))
            trees.append(tree)
        return banks, trees

    def _windows(self, m, platform, may_open, hits, trees, reset):
        """Window banks: the first root opens the window, counted phases end it, and its end samples
        the hits.

        The hits are delayed by as much as the end itself. Return the samples of each bank.
        """
        sensor = self.sensor
        line = self.line
        control = self.control
        parity = control.parity
        banks = control.banks
        late = lag_fs(sensor) + self.circuit.clock_fs // QUARTERS - HIT_FS
        parity_late = sample(m, "parity_late", line.mark, parity)
        later = (
            Cat(delayed(m, f"shown_{q}_{i}", hit, late) for i, hit in enumerate(hits[q]))
            for q in (1, 0)
        )
        shown = Mux(parity_late, *later)
        pictures = []
        from_banks: dict[str, Value] = {}  # to the control
        for b in range(banks):
            armed = Signal(2, name=f"armed_{b}")
            clear = Signal(name=f"clear_window_{b}")
            m.d.comb += [
                armed.eq(getattr(control, f"armed_{b}")),
                clear.eq((line.wipe & getattr(control, f"clearing_{b}")) | reset),
            ]
            if (
                banks == 2
            ):  # nothing opens here once it is known that the other bank's window goes on
                m.d.comb += armed.eq(
                    getattr(control, f"armed_{b}")
                    & (
                        (control.current == b).replicate(2)
                        | Cat(~parity & ~line.shut, parity & ~line.shut)
                    )
                )
            opened = Cat(
                hit_flop(m, f"opened_{b}_{q}", trees[q].root, armed[q], clear) for q in range(2)
            )
            start = Signal(name=f"start_{b}")
            ended = Signal(name=f"ended_{b}")
            m.d.comb += start.eq(opened.any())
            m.submodules[f"window_{b}"] = Instance(
                "coincid_window",
                p_PHASES=sensor.phases,
                p_BITS=sensor.window_bits,
                p_CLOCK_FS=self.circuit.clock_fs,
                p_LINE=int(self.circuit.delay_line),
                p_GAIN_PPM=self.circuit.gain_ppm,
                i_start=start,
                i_ticks=self.window_ticks,
                i_phases=line.phases,
                o_ended=ended,
            )
            pictures.append(sample(m, f"picture_{b}", ended, shown))
            from_banks |= {
                f"opened_{b}": opened,
                f"ended_{b}": ended,
                f"parity_{b}": sample(m, f"ended_parity_{b}", ended, parity_late),
            }
        place(m, "control", control, platform, may_open=may_open, **from_banks)
        return pictures

    def _facts(self, m, hits, trees, pictures):
        """Read the facts about a cycle half a cycle after it, when all its events have settled;
        return them at stage 3.

        They are cleared later. Stages 2 and 3 are the synchroniser.
        """
        sensor = self.sensor
        control = self.control
        before = Signal()
        m.d.comb += before.eq(~control.parity)

        def of_before(values):
            return Mux(before, values[1], values[0])

        m.domains.read = read = ClockDomain("read", clk_edge="neg", reset_less=True, local=True)
        m.d.comb += read.clk.eq(ClockSignal())
        active = Signal(sensor.pixels, reset_less=True)
        first = Signal(sensor.pixels - 1, reset_less=True)
        m.d.read += [
            active.eq(of_before(hits)),
            first.eq(of_before([tree.later_first for tree in trees])),
        ]
        facts = {
            "active": active,
            "first": first,
            "picture": Mux(control.bank, pictures[-1], pictures[0]),
            "code": of_before([tree.code for tree in trees]),
            "marks": of_before([tree.marks for tree in trees]),
            "opening": control.opening,
            "closing": control.closing,
            "parity": before,
        }
        stage_3 = {}
        for name, value in facts.items():
            is_strobe = name in ("opening", "closing")
            stage_2 = Signal(len(value), name=f"{name}_2", reset_less=not is_strobe)
            stage_3[name] = Signal(len(value), name=f"{name}_3", reset_less=not is_strobe)
            m.d.sync += [
                stage_2.eq(value),
                stage_3[name].eq(stage_2),
            ]
        return stage_3

    def _collect(self, m, platform, at, may_open, wrap):
        """Form windows and records, at the clock, from the facts about a cycle (`at`, stage 3)."""
        sensor = self.sensor
        line = self.line
        hit = Signal(sensor.pixels)
        m.d.comb += [
            self.inside.eq(at["opening"] | self.window_open),
            hit.eq(
                Mux(at["closing"], at["picture"], at["active"])
                & self.inside.replicate(sensor.pixels)
            ),
        ]
        m.d.sync += self.window_open.eq(self.inside & ~at["closing"])

        # Stages 4 and 5: the winner, the stamp, and the leaves' part of the map.
        opening_5 = Signal()
        opening_6 = Signal()
        winner_4 = Signal(sensor.winner_bits)
        m.d.sync += [
            self.opening_4.eq(at["opening"]),
            self.closing_4.eq(at["closing"] & self.inside),
            self.closed_5.eq(self.closing_4),
            opening_5.eq(self.opening_4),
            opening_6.eq(opening_5),
        ]
        self._elapse(m, opening_6)
        m.d.sync += winner_4.eq(self._winner(m, at["first"]))
        with m.If(self.opening_4):
            m.d.sync += self.winner.eq(winner_4)
        stamp = self._stamp(m, at, self.opening_4)
        is_winner = Signal(sensor.pixels)
        m.d.comb += is_winner.eq(1 << winner_4)
        coarse_4 = Signal(sensor.coarse_bits)
        m.d.sync += coarse_4.eq(line.cycle)
        leaves = [AsyncMinigroup(sensor) for _ in range(sensor.minigroups)]
        for g, leaf in enumerate(leaves):
            place(
                m,
                f"minigroup_{g}",
                leaf,
                platform,
                active=self._of_minigroup(g, at["active"]),
                hit=self._of_minigroup(g, hit),
                winner=self._of_minigroup(g, is_winner),
                mark=at["marks"].word_select(g, mark_bits(sensor)),
                parity=at["parity"],
                opening=self.opening_4,
                elapsed=self.elapsed,
                frame=self.frame,
                may_open=may_open,
                wrap=wrap,
                coarse=coarse_4,
                test_enable=self.test_enable,
            )
            self._leaf(m, g, leaf)
        m.d.sync += self.blind.eq(any_of(m, [leaf.blind for leaf in leaves], "blind_or"))
        m.d.comb += self.record_due.eq(wrap)
        self._closed(m, stamp, self.winner)

    def _winner(self, m, later_first):
        """Return the index of the pixel that came first, from the nodes of the arbiter tree."""
        index = {i: Const(i, self.sensor.winner_bits) for i in range(self.sensor.pixels)}
        top = 0
        for pairs, _ in arbiter_rows(self.sensor.pixels):
            for k, a, b in pairs:
                top = self.sensor.pixels + k
                index[top] = Signal(self.sensor.winner_bits, name=f"first_of_{k}")
                m.d.comb += index[top].eq(Mux(later_first[k], index[b], index[a]))
        return index[top]

    def _stamp(self, m, at, opening_4):
        """Return the stamp of the window that opened last (stage 5, at a register's output).

        The phases give the position of the event in its cycle. Near a cycle boundary, the coarse
        count may be in transition. In this case the copy that changes half a cycle later is used,
        because it is stable there. The hit flops have already decided on which side of the boundary
        the event lies.
        """
        sensor = self.sensor
        line = self.line
        taps = sensor.phases // 2
        bits = sensor.coarse_bits
        phases = at["code"][:taps]
        gray_a = at["code"][taps : taps + bits]
        gray_b = at["code"][taps + bits :]
        phase_4 = Signal(sensor.phase_bits)
        phase = Signal(sensor.phase_bits)
        coarse_a = Signal(bits)  # the count from the cycle's start on,
        coarse_b = Signal(bits)  # and from half a cycle later on
        coarse = Signal(bits)
        base_4 = Signal(bits)
        base = Signal(bits)
        parity_4 = Signal()
        m.d.sync += [
            base_4.eq(line.base),
            phase_4.eq(johnson_number(m, phases, "taps")),
            parity_4.eq(at["parity"]),
            coarse_a.eq(self._binary(gray_a)),
            coarse_b.eq(self._binary(gray_b)),
        ]
        quarter = phase_4[-2:]
        lags = Signal()  # the copy still shows the previous cycle
        m.d.comb += lags.eq(coarse_b[0] != parity_4)
        with m.If(opening_4):
            m.d.sync += [
                phase.eq(phase_4),
                coarse.eq(coarse_a),
                base.eq(base_4),
            ]
            with m.If((quarter == 0) | (quarter == QUARTERS - 1)):
                m.d.sync += coarse.eq(coarse_b + lags)
            with m.If((quarter == 0) & ~lags):
                m.d.sync += phase.eq(sensor.phases - 1)
            with m.If((quarter == QUARTERS - 1) & lags):
                m.d.sync += phase.eq(0)
        return Cat(phase, (coarse - base)[:bits])

    def _binary(self, gray):
        """Return the number that a Gray code stands for."""
        return Cat(gray[k:].xor() for k in range(len(gray)))
