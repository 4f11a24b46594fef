# SPDX-License-Identifier: Apache-2.0
"""Draws waveform.svg, the way of photons to a word, from a simulation of the RTL (8 x 8 pixels) in
Amaranth's simulator.

python -m docs.studies.drawings.waveform
"""

import tempfile
from collections.abc import Awaitable, Callable, Container, Sequence
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from amaranth.sim import Simulator, SimulatorContext
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from pywellen import Waveform

from coincid.hdl.sensor import SensorTop
from coincid.model.contract import registers
from coincid.model.contract.config import Config, parse_config
from coincid.model.contract.edges import Edges
from coincid.model.contract.packet import FORMATS, header_field
from coincid.model.light.timing import Timing
from coincid.study.palette import DEEP_INK, FAINT, NOISE, PALE, SIGNAL
from coincid.tb.pysim import write_register
from coincid.tb.stimulus import port_words
from coincid.tools.pages import put

from . import save

PHASES = 32
EDGES = (  # (pixel, cycle, phase): a single background photon, then four photons of a laser pulse
    (37, 3, 20),
    (9, 8, 22),
    (10, 8, 25),
    (18, 8, 30),
    (2, 9, 3),
)
SHOWN_CYCLES = 30
SIMULATED_CYCLES = 100  # from the laser trigger on
CLOCK_S = Timing().tick_s * PHASES
SIGNALS = {  # name in the picture: path in the simulation
    "laser": "laser",
    "spad": "spad_0",
    "tvalid": "m_axis_tvalid",
    "tdata": "m_axis_tdata",
    "root": "module_0.subgroup_0.tree.line__root",
    "open": "module_0.subgroup_0.tree.window_open",
    "opening": "module_0.subgroup_0.tree.opening",
    "first": "module_0.subgroup_0.tree.line__phase",
    "end": "module_0.subgroup_0.tree.end",
    "hits": "module_0.subgroup_0.tree.hits",
    "closed": "module_0.subgroup_0.dpcu.closed",
    "commit": "module_0.subgroup_0.dpcu.commit",
}


async def no_access(ctx: SimulatorContext, sensor: SensorTop) -> None:
    """Access no register before the sensor is programmed."""


def recorded_signals(
    config: Config,
    edges: Sequence[tuple[int, int, int]],
    signals: dict[str, str],
    first: Callable[[SimulatorContext, SensorTop], Awaitable[None]] = no_access,
    stalled: Container[int] = (),
) -> dict[str, list[int]]:
    """Simulate a sensor of one subgroup; return the value of each of `signals` (name: path) at the
    end of every clock cycle.

    first: register accesses before it is programmed and started. edges: (pixel, cycle, phase).
    stalled: cycles in which `tready` is low. Cycles count from the laser trigger.
    """
    sensor = SensorTop(config.sensor)

    async def host(ctx: SimulatorContext) -> None:
        ctx.set(sensor.s_axi.wstrb, 0xF)
        for ready in (sensor.s_axi.bready, sensor.s_axi.rready, sensor.m_axis.tready):
            ctx.set(ready, 1)
        await first(ctx, sensor)
        for address, value in [*config.register_writes(), registers.control("start")]:
            await write_register(ctx, sensor, address, value)

    pixel, cycle, phase = np.array(edges).T
    words = port_words(config, Edges(np.zeros_like(pixel), pixel, cycle * PHASES + phase))

    async def light(ctx: SimulatorContext) -> None:
        while not ctx.get(sensor.laser):
            await ctx.tick()
        for now in range(SIMULATED_CYCLES):
            ctx.set(sensor.spad_0, dict(words.get(now, ())).get(0, 0))
            ctx.set(sensor.m_axis.tready, int(now not in stalled))
            await ctx.tick()

    with tempfile.TemporaryDirectory() as folder:
        vcd = Path(folder) / "sensor.vcd"
        simulator = Simulator(sensor)
        simulator.add_clock(CLOCK_S)
        simulator.add_testbench(host)
        simulator.add_testbench(light)
        with simulator.write_vcd(str(vcd)):
            simulator.run()
        waveform = Waveform(str(vcd))
    found = {
        name: waveform[f"bench.top.{path}"].signal
        for name, path in {"clk": "clk", **signals}.items()
    }
    ends = [time - 1 for time, value in found.pop("clk") if value and time]
    return {name: [signal.value_at(end) for end in ends] for name, signal in found.items()}


def one_period() -> dict[str, list[int]]:
    """Return the values of `SIGNALS` in each cycle from the laser trigger on."""
    config = parse_config(
        {"sensor": {"rows": 8, "cols": 8, "phases": PHASES}, "frame": {"period": 40, "pulses": 1}}
    )
    values = recorded_signals(config, EDGES, SIGNALS)
    begin = values["laser"].index(1)
    return {name: line[begin : begin + SHOWN_CYCLES] for name, line in values.items()}


def covered(values: dict[str, list[int]]) -> list[int]:
    """Return the phases that a window covers in each cycle, one bit per phase; the window begins at
    its first edge.
    """
    words = []
    for is_open, opening, first, end in zip(
        values["open"], values["opening"], values["first"], values["end"], strict=True
    ):
        begin = 0 if is_open else first
        words.append(((1 << min(end, PHASES)) - (1 << begin)) if is_open or opening else 0)
    return words


def draw_grid(axes: Axes, cycles: int) -> None:
    """Draw a line at each boundary between two cycles."""
    for cycle in range(cycles + 1):
        axes.axvline(cycle, color=PALE, lw=0.8, zorder=0)


def draw_boxes(
    axes: Axes, y: float, texts: Sequence[object], color: str, *, fontsize: float
) -> None:
    """Draw a bus at height `y`: a box per cycle with its text. Equal neighbours share a box; None:
    no box.
    """
    begin = 0
    for cycle in range(1, len(texts) + 1):
        if cycle == len(texts) or texts[cycle] != texts[begin]:
            if texts[begin] is not None:
                x = [begin, begin + 0.12, cycle - 0.12, cycle, cycle - 0.12, begin + 0.12]
                axes.fill(
                    x, [y + 0.3, y + 0.6, y + 0.6, y + 0.3, y, y], fc="white", ec=color, lw=1.2
                )
                at = (begin + cycle) / 2, y + 0.3
                axes.text(
                    *at, str(texts[begin]), ha="center", va="center", fontsize=fontsize, color=color
                )
            begin = cycle


def finish(figure: Figure, axes: Axes, title: str, label_pt: float) -> None:
    """Put title and cycle numbers above the picture, and remove its frame."""
    axes.tick_params(
        length=0,
        labelsize=label_pt,
        labelcolor=NOISE,
        top=True,
        labeltop=True,
        bottom=False,
        labelbottom=False,
    )
    axes.set_title(title, fontsize=9, color=NOISE, loc="left", pad=18)
    axes.set_yticks([])
    axes.spines[:].set_visible(False)
    figure.tight_layout(pad=0.4)


def draw(values: dict[str, list[int]]) -> Figure:
    """Draw the picture over clock cycles; the 32 phases of a word are drawn side by side in their
    cycle.
    """
    figure, axes = plt.subplots(figsize=(12, 6.6))
    spads = [f"SPAD {pixel}" for pixel, _, _ in sorted(EDGES, key=lambda edge: edge[1:])]
    rows = ["laser", *spads, "root", "window", "ID map", "closed", "commit", "tdata"]
    notes = {
        "laser": "cycle 0 of the period",
        "root": "OR of the pixels, sampled in\n32 phases: stage 2",
        "window": "16 ticks from the first edge:\nstage 3",
        "ID map": "distinct pixels in the window:\nstage 5",
        "closed": "counted: stage 7",
        "commit": "count >= threshold 2:\nstage 8, into the FIFO",
        "tdata": "AXI4-Stream",
    }
    level = {row: -1.0 * i - 0.35 * (i > 0) - 0.35 * (i > 5) for i, row in enumerate(rows)}
    draw_grid(axes, SHOWN_CYCLES)
    for row, y in level.items():
        axes.text(
            -0.5, y + 0.3, row, ha="right", va="center", color=DEEP_INK, fontsize=10, weight="bold"
        )
        axes.text(
            SHOWN_CYCLES + 0.4,
            y + 0.3,
            notes.get(row, ""),
            ha="left",
            va="center",
            color=NOISE,
            fontsize=8.5,
        )

    def wave(row: str, bits: list[int], steps: int, color: str = DEEP_INK) -> None:
        """Draw a line of bits with `steps` bits per cycle."""
        turns = [0, *(np.flatnonzero(np.diff(bits)) + 1), len(bits)]
        x = np.array(turns) / steps
        y = level[row] + 0.6 * np.array([bits[at] for at in turns[:-1]] + [bits[-1]])
        axes.step(x, y, where="post", color=color, lw=1.3, solid_joinstyle="miter")
        axes.fill_between(x, level[row], y, step="post", color=color, alpha=0.18, lw=0)

    def phases(words: list[int], offset: int = 0) -> list[int]:
        return [word >> offset + k & 1 for word in words for k in range(PHASES)]

    def bus(row: str, texts: Sequence[object], color: str = DEEP_INK) -> None:
        draw_boxes(axes, level[row], texts, color, fontsize=8)

    wave("laser", values["laser"], 1)
    for pixel, cycle, _ in EDGES:
        wave(
            f"SPAD {pixel}",
            phases(values["spad"], pixel * PHASES),
            PHASES,
            SIGNAL if cycle > 5 else NOISE,
        )
    wave("root", phases(values["root"]), PHASES)
    wave("window", phases(covered(values)), PHASES)
    counts = [bin(value).count("1") for value in values["hits"]]
    bus("ID map", [n or None for n in counts])
    wave("closed", values["closed"], 1)
    wave("commit", values["commit"], 1, SIGNAL)
    axes.plot([0, SHOWN_CYCLES], [level["tdata"] + 0.3] * 2, color=FAINT, lw=1.2, zorder=0)
    beats = [
        (cycle, data)
        for cycle, (valid, data) in enumerate(zip(values["tvalid"], values["tdata"], strict=True))
        if valid
    ]
    event = next(cycle for cycle, data in beats if header_field(data, "kind") == FORMATS["id"].code)
    for cycle, _ in beats:
        text = {event: "event", event + 1: "map"}.get(cycle, "frame start")
        color = DEEP_INK if text == "frame start" else SIGNAL
        bus("tdata", ["" if c == cycle else None for c in range(SHOWN_CYCLES)], color)
        x, align = (cycle - 0.2, "right") if text == "event" else (cycle + 1.2, "left")
        axes.text(x, level["tdata"] + 0.3, text, ha=align, va="center", fontsize=8.5, color=color)

    # The path of the first photon of each window through the pipeline.
    for (_, cycle, phase), color in ((EDGES[0], NOISE), (EDGES[1], SIGNAL)):
        x = cycle + phase / PHASES
        pixel = next(p for p, c, k in EDGES if (c, k) == (cycle, phase))
        path = [(x, f"SPAD {pixel}"), (x + 1, "root"), (x + 2, "window")]
        axes.plot(
            [at for at, _ in path],
            [level[row] + 0.3 for _, row in path],
            color=color,
            lw=1,
            ls=(0, (2, 2)),
            zorder=0,
        )
    rejected = values["closed"].index(1)
    axes.text(
        rejected + 1.3,
        level["commit"] + 0.3,
        "1 pixel: rejected",
        va="center",
        fontsize=8.5,
        color=NOISE,
    )
    committed = values["commit"].index(1)
    axes.text(
        committed + 1.3,
        level["commit"] + 0.3,
        "4 pixels: committed",
        va="center",
        fontsize=8.5,
        color=SIGNAL,
    )

    header, pixels = (
        values["tdata"][event],
        [i for i in range(64) if values["tdata"][event + 1] >> i & 1],
    )
    pulse, stamp, count, winner = (
        int(header_field(header, name)) for name in ("pulse", "stamp", "count", "winner")
    )
    metres = stamp * Timing().tick_m
    words = f"event = pulse {pulse}, stamp {stamp} ticks of 62.5 ps ({metres:.2f} m), count {count}, winner {winner}"
    words += f"     map = pixels {', '.join(map(str, pixels))}"
    axes.text(0, level["tdata"] - 0.75, words, fontsize=9.5, color=SIGNAL, va="center")
    axes.set_xticks(range(0, SHOWN_CYCLES + 1, 2))
    axes.set_xlim(-3.4, SHOWN_CYCLES + 7.2)
    axes.set_ylim(level["tdata"] - 1.1, 0.8)
    finish(figure, axes, "clock cycles of 2 ns since the laser trigger", 8.5)
    return figure


def make() -> None:
    """Draw the picture for its page."""
    save(draw(one_period()), "waveform.svg")
    put("docs/architecture.md", "waveform")


if __name__ == "__main__":
    make()
