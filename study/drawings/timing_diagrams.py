# SPDX-License-Identifier: Apache-2.0
"""Draws the timing diagrams of docs/integrate.md from a simulation of the RTL, 8 x 8 pixels, in Amaranth's simulator.

python -m coincid.study.drawings.timing_diagrams
"""

from collections.abc import Callable, Sequence

import matplotlib.pyplot as plt
import numpy as np
from amaranth.sim import Simulator, SimulatorContext
from attrs import frozen
from matplotlib.figure import Figure

from ...hdl.axi import OKAY
from ...hdl.sensor import SensorTop
from ...model.contract import registers
from ...model.contract.config import Config, parse_config
from ...model.contract.packet import FORMATS, FRAME_END, FRAME_START, GROUP_KIND, header_field
from ...tb.pysim import write_register
from ..palette import DEEP_INK, FAINT, NOISE, PALE, SIGNAL
from . import save
from .waveform import CLOCK_S, PHASES

EDGES = {0: ((9, 22), (10, 25), (18, 30)), 3: ((37, 4),), 10: ((5, 1), (6, 2))}  # cycle: (pixel, phase)
STALLED = range(26, 33)  # cycles of the frame in which `tready` is low
PERIOD, START, BAD_THRESHOLD = 24, 1, 0
KINDS = {FRAME_START.code: "S", FORMATS["id"].code: "E", GROUP_KIND: "G", FRAME_END.code: "F"}
Row = dict[str, int]  # port -> value in a cycle


@frozen
class Trace:
    """Values of all ports by cycle, and the cycles in which the accesses and the frame's cycle 0 begin."""

    rows: list[Row]
    accesses: list[int]
    frame: int

    def values(self, name: str, begin: int, end: int) -> list[int]:
        """Return the values of a port in the cycles from `begin` to before `end`."""
        return [row[name] for row in self.rows[begin:end]]


def config(form: str) -> Config:
    return parse_config(
        {
            "sensor": {"rows": 8, "cols": 8, "phases": PHASES},
            "frame": {"period": PERIOD, "pulses": 2, "format": form},
            "subgroup": {"threshold": 2},
        }
    )


def simulate(form: str) -> Trace:
    """Write and read a register, have a write refused, then play a frame of two laser periods, with events of some form."""
    of = config(form)
    sensor = SensorTop(of.sensor)
    rows: list[Row] = []
    accesses: list[int] = []
    ports = {name: value for name, (_, value) in sensor.flat_ports().items()}

    async def write(ctx: SimulatorContext, address: int, value: int) -> None:
        accesses.append(len(rows) - 1)
        await write_register(ctx, sensor, address, value)

    async def read(ctx: SimulatorContext, address: int) -> None:
        accesses.append(len(rows) - 1)
        ctx.set(sensor.s_axi.araddr, address)
        ctx.set(sensor.s_axi.arvalid, 1)
        answered = False
        while not answered:
            taken = ctx.get(sensor.s_axi.arvalid) and ctx.get(sensor.s_axi.arready)
            answered = bool(ctx.get(sensor.s_axi.rvalid))
            await ctx.tick()
            if taken:
                ctx.set(sensor.s_axi.arvalid, 0)

    async def host(ctx: SimulatorContext) -> None:
        ctx.set(sensor.s_axi.wstrb, 0xF)
        ctx.set(sensor.s_axi.bready, 1)
        ctx.set(sensor.s_axi.rready, 1)
        ctx.set(sensor.m_axis.tready, 1)
        await ctx.tick().repeat(4)
        threshold = registers.address("threshold")
        await write(ctx, threshold, 2)
        await ctx.tick()
        await read(ctx, threshold)
        await ctx.tick()
        await write(ctx, threshold, BAD_THRESHOLD)
        await ctx.tick()
        for address, value in of.register_writes():
            await write(ctx, address, value)
        await write(ctx, *registers.control("start"))
        await ctx.tick().repeat(100)

    async def spads(ctx: SimulatorContext) -> None:
        cycle = -1
        while True:
            if cycle < 0 and ctx.get(sensor.laser):
                cycle = 0
            if cycle >= 0:
                word = sum(1 << (pixel * PHASES + phase) for pixel, phase in EDGES.get(cycle, ()))
                ctx.set(sensor.spad_0, word)
                ctx.set(sensor.m_axis.tready, int(cycle not in STALLED))
                cycle += 1
            await ctx.tick()

    async def watch(ctx: SimulatorContext) -> None:
        while True:
            rows.append({name: int(ctx.get(value)) for name, value in ports.items()})
            await ctx.tick()

    simulator = Simulator(sensor)
    simulator.add_clock(CLOCK_S)
    simulator.add_testbench(host)
    simulator.add_testbench(spads, background=True)
    simulator.add_testbench(watch, background=True)  # last, so it sees the values that the others set in this cycle
    simulator.run()
    return Trace(rows, accesses, next(cycle for cycle, row in enumerate(rows) if row["laser"]))


def draw(lines: Sequence[tuple[str, Sequence[object], str]], title: str, first: int = 0) -> Figure:
    """Draw a timing diagram whose first cycle has the number `first`.

    lines: name, one value per cycle (bits as bool, texts in boxes, None: nothing), note.
    """
    cycles = len(lines[0][1])
    figure, axes = plt.subplots(figsize=(12, 0.42 * len(lines) + 0.9))
    for cycle in range(cycles + 1):
        axes.axvline(cycle, color=PALE, lw=0.8, zorder=0)
    for i, (name, values, note) in enumerate(lines):
        y = -float(i)
        axes.text(-0.3, y + 0.3, name, ha="right", va="center", color=DEEP_INK, fontsize=9, family="monospace")
        axes.text(cycles + 0.3, y + 0.3, note, ha="left", va="center", color=NOISE, fontsize=8.5)
        if isinstance(values[0], bool):
            bits = np.array(values, int)
            axes.step(np.arange(cycles + 1), y + 0.6 * np.append(bits, bits[-1]), where="post", color=DEEP_INK, lw=1.3)
            axes.fill_between(
                np.arange(cycles + 1),
                y,
                y + 0.6 * np.append(bits, bits[-1]),
                step="post",
                color=DEEP_INK,
                alpha=0.15,
                lw=0,
            )
        else:
            axes.plot([0, cycles], [y + 0.3] * 2, color=FAINT, lw=1.2, zorder=0)
            _boxes(axes.fill, axes.text, y, values)
    axes.set_xlim(-3.2, cycles + 6.5)
    axes.set_ylim(-len(lines) + 0.6, 0.9)
    step = 1 if cycles <= 30 else 2
    numbered = np.arange(-first % step, cycles, step)
    axes.set_xticks(numbered + 0.5, [str(first + cycle) for cycle in numbered])
    axes.tick_params(length=0, labelsize=8, labelcolor=NOISE, top=True, labeltop=True, bottom=False, labelbottom=False)
    axes.set_title(title, fontsize=9, color=NOISE, loc="left", pad=18)
    axes.set_yticks([])
    for side in axes.spines.values():
        side.set_visible(False)
    figure.tight_layout(pad=0.4)
    return figure


def _boxes(fill: Callable[..., object], text: Callable[..., object], y: float, values: Sequence[object]) -> None:
    begin = 0
    for cycle in range(1, len(values) + 1):
        if cycle == len(values) or values[cycle] != values[begin]:
            if values[begin] is not None:
                x = [begin, begin + 0.12, cycle - 0.12, cycle, cycle - 0.12, begin + 0.12]
                fill(x, [y + 0.3, y + 0.6, y + 0.6, y + 0.3, y, y], fc="white", ec=SIGNAL, lw=1.2)
                text(
                    (begin + cycle) / 2,
                    y + 0.3,
                    str(values[begin]),
                    ha="center",
                    va="center",
                    fontsize=7.5,
                    color=SIGNAL,
                )
            begin = cycle


def bits(values: Sequence[int]) -> list[bool]:
    return [bool(value) for value in values]


def while_valid(values: Sequence[int], valid: Sequence[int], told: Callable[[int], str]) -> list[str | None]:
    """Return the texts of a bus in the cycles in which its `valid` is high."""
    return [told(value) if on else None for value, on in zip(values, valid)]


def register_access(trace: Trace) -> Figure:
    """Draw a write, a read, and a write that is refused."""
    begin, end = trace.accesses[0] - 1, trace.accesses[3]

    def of(name: str) -> list[int]:
        return trace.values(f"s_axi_{name}", begin, end)

    def answer(value: int) -> str:
        return "OK" if value == OKAY else "ERR"

    return draw(
        [
            ("awvalid", bits(of("awvalid")), "address and data of a write may come"),
            ("awready", bits(of("awready")), "in any order; each is held"),
            ("awaddr", while_valid(of("awaddr"), of("awvalid"), lambda value: f"{value:x}"), "hexadecimal"),
            ("wvalid", bits(of("wvalid")), ""),
            ("wdata", while_valid(of("wdata"), of("wvalid"), str), "threshold 2; then 0, which is illegal"),
            ("bvalid", bits(of("bvalid")), "stays until bready"),
            ("bresp", while_valid(of("bresp"), of("bvalid"), answer), "ERR: SLVERR, nothing has changed"),
            ("arvalid", bits(of("arvalid")), ""),
            ("arready", bits(of("arready")), ""),
            ("rvalid", bits(of("rvalid")), "stays until rready"),
            ("rdata", while_valid(of("rdata"), of("rvalid"), str), ""),
        ],
        "register access: a write, a read, a refused write (bready and rready are high)",
    )


def frame_start(trace: Trace) -> Figure:
    """Draw a frame's start from the write to the first words, with the cycle that `laser` marks."""
    begin = trace.accesses[-1] - 1
    end = trace.frame + PERIOD + 4
    words = trace.values("spad_0", begin, end)
    pixels = [str(word.bit_count()) if word else None for word in words]
    return draw(
        [
            ("awvalid", bits(trace.values("s_axi_awvalid", begin, end)), "start: 1 to control"),
            ("bvalid", bits(trace.values("s_axi_bvalid", begin, end)), ""),
            ("laser", bits(trace.values("laser", begin, end)), "cycle 0 of each period"),
            ("spad_0", pixels, "edges in this cycle: pixels 9, 10, 18; 37; 5, 6"),
            (
                "cycle",
                [str((c - trace.frame) % PERIOD) if c >= trace.frame else None for c in range(begin, end)],
                "of the period",
            ),
            ("tvalid", bits(trace.values("m_axis_tvalid", begin, end)), ""),
            ("tdata", _packets(trace, begin, end), "S: frame start, E: event, M: map"),
        ],
        f"frame start: periods of {PERIOD} cycles; the edges that stand at the ports while `laser` is high have stamps below {PHASES}",
        begin - trace.frame,
    )


def event_packet(trace: Trace) -> Figure:
    """Draw an event, from its edges to its beats."""
    begin, end = trace.frame, trace.frame + 24
    words = trace.values("spad_0", begin, end)
    pixels = [str(word.bit_count()) if word else None for word in words]
    header = next(
        beat for beat in trace.values("m_axis_tdata", begin, end) if header_field(beat, "kind") == FORMATS["id"].code
    )
    stamp, count, winner = (int(header_field(header, name)) for name in ("stamp", "count", "winner"))
    return draw(
        [
            ("spad_0", pixels, "edges: pixels 9, 10, 18; 37 alone; 5, 6"),
            ("tvalid", bits(trace.values("m_axis_tvalid", begin, end)), ""),
            ("tready", bits(trace.values("m_axis_tready", begin, end)), ""),
            ("tlast", bits(trace.values("m_axis_tlast", begin, end)), "with the last beat of the frame"),
            ("tdata", _packets(trace, begin, end), f"E: stamp {stamp}, count {count}, winner {winner}"),
        ],
        "an event packet: three edges in cycle 0, threshold 2, format id",
    )


def group_of_events(trace: Trace) -> Figure:
    """Draw a laser pulse's group of events, from the edges to its beats."""
    begin, end = trace.frame, trace.frame + 60
    words = trace.values("spad_0", begin, end)
    pixels = [str(word.bit_count()) if word else None for word in words]
    return draw(
        [
            ("laser", bits(trace.values("laser", begin, end)), "cycle 0 of each period"),
            ("spad_0", pixels, "edges: pixels 9, 10, 18; 37 alone; 5, 6"),
            ("tvalid", bits(trace.values("m_axis_tvalid", begin, end)), ""),
            ("tready", bits(trace.values("m_axis_tready", begin, end)), ""),
            ("tdata", _packets(trace, begin, end), "S: frame start, G: group of events"),
        ],
        "a group: the two events of a laser pulse, packed to the bit, format compact",
    )


def back_pressure(trace: Trace) -> Figure:
    """Draw a stream that stalls: an offered beat does not change until it is taken."""
    begin, end = trace.frame + 16, trace.frame + 40
    return draw(
        [
            ("tvalid", bits(trace.values("m_axis_tvalid", begin, end)), "stays until the beat is taken"),
            ("tready", bits(trace.values("m_axis_tready", begin, end)), "may be low for any time"),
            ("tdata", _packets(trace, begin, end), "the beat on offer does not change"),
        ],
        "back-pressure: events wait in the output buffer and the FIFOs; what finds a FIFO full is dropped and counted",
        begin - trace.frame,
    )


def _packets(trace: Trace, begin: int, end: int) -> list[str | None]:
    """Return the type of each beat: S frame start, E event, M map, G group, F frame end, C counters; boxes are kept apart."""
    texts: list[str | None] = []
    following, number, open_beat = "", 0, False
    for row in trace.rows[:end]:
        if not row["m_axis_tvalid"]:
            texts.append(None)
            continue
        if not open_beat:
            number += 1
            kind = int(header_field(row["m_axis_tdata"], "kind"))
            name = following or KINDS[kind]
            following = {"E": "M", "F": "C", "C": "C"}.get(name, "")
        texts.append(name + "\u200b" * (number % 2))
        open_beat = not row["m_axis_tready"]
    return texts[begin:]


PICTURES: dict[str, tuple[str, Callable[[Trace], Figure]]] = {  # file: format of the events, and what draws it
    "timing-register.svg": ("id", register_access),
    "timing-frame.svg": ("id", frame_start),
    "timing-event.svg": ("id", event_packet),
    "timing-stall.svg": ("id", back_pressure),
    "timing-group.svg": ("compact", group_of_events),
}


if __name__ == "__main__":
    traces = {form: simulate(form) for form, _ in PICTURES.values()}
    for name, (form, picture) in PICTURES.items():
        save(picture(traces[form]), name)
