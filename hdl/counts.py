# SPDX-License-Identifier: Apache-2.0
"""Counts of a subgroup: the minigroups' counts, the search between the steps of a frame, and what
leaves at its end.

`docs/contract.md` has the rule. The paper has no counts; all of this is our own choice.
"""

from amaranth.hdl import Cat, Module, Mux, Signal, Value
from amaranth.lib.wiring import In, Out

from ..model.contract import counts
from ..model.contract.parameters import Sensor
from . import bus
from .gate_search import GateSearch
from .logic import item_of
from .minigroup_counts import NOTE_BITS, MinigroupCounts
from .unit import Unit, place

# Stages of strobes that come two cycles ahead of the ports: bit n is at stage n - 1.
_STAGES = 5
_AT_STAGE_1 = 2
_AT_STAGE_2 = 3


class Counts(Unit):
    """Counts of one subgroup.

    Ports
    -----
    frame_begin : in, strobe: a frame begins, and the memories are cleared; counting : in, it is one
        of counts
    start, search, wrap : in, strobes of the time layout, two cycles ahead of the ports
    accepted, quarters : in, of all pixels, in the order of minigroups (stage 2)
    reading : in, show the row with the number read_row (in), one cycle later; next_minigroup : in, strobe: show the
        next one
    busy : out, a search is going on, and needs the clock
    minigroup : out, number of the minigroup that is shown; shown : out, its fields of the packet, and
        the row
    test_enable : in, opens clock gates and latches for a test of the chip

    A search begins in the cycle in which the last hits of the step have been written, and takes less
    than `pause_cycles` of `model/contract/counts.py` from the end of the period. Reset ends a frame.
    """

    unit_name = "coincid_counts"

    def __init__(self, sensor: Sensor):
        self.sensor = sensor
        super().__init__(
            frame_begin=In(1),
            counting=In(1),
            start=In(1),
            search=In(1),
            wrap=In(1),
            accepted=In(sensor.pixels),
            quarters=In(2 * sensor.pixels),
            reading=In(1),
            read_row=In(range(counts.ROWS)),
            next_minigroup=In(1),
            busy=Out(1),
            minigroup=Out(range(sensor.minigroups)),
            shown=Out(bus.minigroup_counts_layout(sensor)),
            test_enable=In(1),
        )
        self.minigroups = [MinigroupCounts(sensor) for _ in range(sensor.minigroups)]
        self.gate_search = GateSearch(sensor)
        self.step = Signal(bus.Step)
        self.starts = Signal(_STAGES)
        self.searches = Signal(_STAGES)
        self.wraps = Signal(_AT_STAGE_1 + 1)
        # Outside of a period the number of the cycle is the highest, so that it comes to rest.
        beyond = counts.CYCLES_MAX
        self.cycle = Signal(range(beyond + 1), init=beyond)  # of the period, at stage 2, saturated
        self.next_cycle = Signal.like(self.cycle)  # of the cycle at stage 1
        self.pulse = Signal(bus.PULSE_BITS)  # number of the pulse in step 3, at stage 3
        self.last_gate = Signal(counts.GATE_BITS)  # last cycle in which a gate may begin

    def elaborate(self, platform):
        m = Module()
        self._time(m)
        self._step(m)
        self._place_search(m, platform)
        self._place_minigroups(m, platform)
        self._show(m)
        return m

    def _time(self, m):
        """Count cycles and pulses."""
        cycle = self.cycle
        ended = self.wraps[_AT_STAGE_1]
        following = Mux(ended, counts.CYCLES_MAX, cycle + (cycle != counts.CYCLES_MAX))
        m.d.comb += self.next_cycle.eq(Mux(self.starts[_AT_STAGE_1], 0, following))
        m.d.sync += [
            self.starts.eq((self.starts << 1) | self.start),
            self.searches.eq((self.searches << 1) | self.search),
            self.wraps.eq((self.wraps << 1) | self.wrap),
            cycle.eq(self.next_cycle),
        ]
        with m.If(self.starts[_AT_STAGE_2] & (self.step == bus.Step.GATED)):
            m.d.sync += self.pulse.eq(self.pulse + 1)
        with m.If(self.searches[_AT_STAGE_1]):  # the period's last cycle is at stage 2
            beyond = cycle == counts.CYCLES_MAX
            last_cycle = Mux(beyond, counts.CYCLES_MAX - 1, cycle)
            m.d.sync += self.last_gate.eq(last_cycle - (counts.GATE_CYCLES - 1))

    def _step(self, m):
        """Go from step to step."""
        with m.If(self.gate_search.done):
            m.d.sync += self.step.eq(bus.step_after(self.step))
        with m.If(self.frame_begin):
            m.d.sync += [
                self.step.eq(Mux(self.counting, bus.Step.WIDE, bus.Step.NONE)),
                self.pulse.eq(0),
            ]

    def _place_search(self, m, platform):
        """Place the search."""
        search = self.gate_search
        place(
            m,
            "gate_search",
            search,
            platform,
            start=self.searches[-1],
            frame_begin=self.frame_begin,
            step=self.step,
            last_gate=self.last_gate,
            wide=_all_of(self.minigroups, "wide"),
            narrow=_all_of(self.minigroups, "narrow"),
        )
        m.d.comb += self.busy.eq(self.searches.any() | search.busy)

    def _place_minigroups(self, m, platform):
        """Place the minigroups' counts. In a search, the cycle is that of the search."""
        search = self.gate_search
        pixels = self.sensor.minigroup_pixels
        cycle = Signal(counts.GATE_BITS)
        first = Signal()
        accepted = Signal(self.sensor.pixels)  # hits of cycles that count
        in_range = self.cycle != counts.CYCLES_MAX
        m.d.comb += [
            cycle.eq(Mux(search.busy, search.cycle, self.cycle)),
            accepted.eq(self.accepted & in_range.replicate(self.sensor.pixels)),
            first.eq((cycle == 0) & (in_range | search.busy)),
        ]
        for g, minigroup in enumerate(self.minigroups):
            is_group = search.group == g
            place(
                m,
                f"counts_of_{g}",
                minigroup,
                platform,
                accepted=accepted.word_select(g, pixels),
                quarters=self.quarters.word_select(g, 2 * pixels),
                step=self.step,
                cycle=cycle,
                first=first,
                next_cycle=self.next_cycle[: counts.GATE_BITS],
                pulse=self.pulse,
                begin=self.frame_begin | search.done,
                clear=search.clear,
                clear_row=search.clear_row,
                shows=search.searching,
                note_to=search.note_to & is_group.replicate(len(search.note_to)),
                note=search.note,
                set_gates=search.set_gates & is_group,
                gates=search.gates,
                reading=self.reading,
                read_row=self.read_row,
                test_enable=self.test_enable,
            )

    def _show(self, m):
        """Show the counts of a minigroup. Without a period of step 3 there are none."""
        begun = Signal()
        m.d.comb += begun.eq((self.step == bus.Step.GATED) & (self.pulse != 0))
        with m.If(self.next_minigroup):
            m.d.sync += self.minigroup.eq(self.minigroup + 1)
        with m.If(self.frame_begin):
            m.d.sync += self.minigroup.eq(0)
        gates = self._of_shown(m, "gates_kept")
        stopped = self._of_shown(m, "stopped")
        stops = self._of_shown(m, "stops")
        row = self._of_shown(m, "row")
        m.d.comb += [
            self.shown.gates.eq(gates | (~begun).replicate(len(gates))),
            self.shown.row.eq(row & begun.replicate(len(row))),
        ]
        pulses = []
        for j, has_stopped in enumerate(stopped):
            played = Signal(bus.PULSE_BITS, name=f"pulses_{j}")
            stop = stops.word_select(j, NOTE_BITS)
            m.d.comb += played.eq(Mux(begun, Mux(has_stopped, stop, self.pulse), 0))
            pulses.append(played)
        m.d.comb += self.shown.pulses.eq(Cat(pulses))

    def _of_shown(self, m, output: str) -> Value:
        """Return an output of the minigroup that is shown."""
        items = [getattr(minigroup, output) for minigroup in self.minigroups]
        return item_of(m, self.minigroup, items, f"shown_{output}")


def _all_of(minigroups: list[MinigroupCounts], output: str) -> Value:
    """Return an output of all minigroups."""
    return Cat(getattr(minigroup, output) for minigroup in minigroups)
