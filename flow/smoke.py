# SPDX-License-Identifier: Apache-2.0
"""The smoke test of an exported sensor. It is plain Verilog, needs no Python, and prints PASS or
FAIL.

It programs registers over AXI4-Lite, plays the edges of a frame, and compares every word of the
streams and all counters with those of the golden model. A sensor with counts plays a frame of
events and then a frame of counts. The bench is in `smoke_*.v` and `smoke_bench.vh`. This file makes
the parts that depend on the sensor (ports, edges and expected words), which replace the `include`
lines.
"""

import re
from collections.abc import Iterable
from pathlib import Path

import numpy as np
from attrs import frozen

from ..hdl import deserialiser
from ..hdl.front_end_views import POLYPHASE, View
from ..hdl.sensor import FPGA_TOP, SensorTop
from ..model.contract import registers
from ..model.contract.config import Config, parse_config, sensor_table
from ..model.contract.counters import COUNTER_NAMES
from ..model.contract.edges import Edges
from ..model.contract.parameters import TOP, Sensor
from ..model.contract.pixels import pixel_table, port_bits
from ..model.golden.frame import Golden, Trace
from ..tb.stimulus import line_toggles

SMOKE, FPGA_SMOKE = "coincid_smoke", "coincid_fpga_smoke"
PULSES = 4  # a power of two, as is
COUNTED_PULSES = 8  # of a frame of counts
SEARCH_PULSES = 3  # of these, in each search
# spread over the frame by a multiplicative sequence; each pulse also has a burst of neighbours
EDGES = 160
SPREAD = 2_654_435_761  # Knuth's multiplier
FOLDER = Path(__file__).parent
BENCH = FOLDER / "smoke_bench.vh"
# One bench per form of light at the ports.
WORDS, LINES, LEVELS = (FOLDER / f"smoke_{light}.v" for light in ("words", "lines", "levels"))
# the bench gives up after so many cycles per cycle of the frame, beat, and access to a register
PATIENCE = 50
STALL_CYCLES, STALL_EVERY = 300, 4  # in these cycles, `tready` is low every fourth cycle
ADDRESSES = ("period", "status", "control")  # registers that the bench uses by name
BITS = {"bad_value": "status", "done": "status", "start": "control"}

Access = tuple[int, int, str]  # address and value of a register, and a comment
ACCESS = "reg [51:0]"  # of the bench: address and value


def smoke_configs(sensor: Sensor) -> list[Config]:
    """Return the frames of the test: one of events, and one of counts if the sensor has them."""
    events = _events_config(sensor)
    if not sensor.counts:
        return [events]
    return [
        events,
        events.with_frame(
            format="counts",
            pulses=COUNTED_PULSES,
            search_pulses=SEARCH_PULSES,
            minigroup_records=False,
        ),
    ]


def _events_config(sensor: Sensor) -> Config:
    """Return a short frame that uses all parts. Most settings keep their reset values, so there
    is less to program.
    """
    played = _played(sensor)
    first_gate = {"gating": True, "gate_start": 3, "gate_len": sensor.guard + 8}
    period = min(2 * sensor.guard + 24, sensor.period_max)
    first, last = (
        {"subgroups": played[:1], **first_gate, "threshold": 3},
        {"subgroups": played[-1:], "threshold": 1},
    )
    return parse_config(
        {
            "sensor": sensor_table(sensor),
            "frame": {
                "period": period,
                "pulses": PULSES,
                "format": "full" if sensor.offsets else "id",
                "minigroup_records": bool(sensor.records),
                "mg_threshold": 1,
            },
            "subgroup": {"gate_len": registers.BY_NAME["gate_len"].reset(sensor)},
            "override": [last, first],
        }
    ).with_rule(sensor.rule)


def smoke_edges(config: Config) -> Edges:
    """Return the edges of a frame: in each pulse some single edges, and four pixels that fire
    together. No pixel fires twice in a pulse.
    """
    sensor = config.sensor
    table = pixel_table(sensor)
    pixels = np.concatenate([np.flatnonzero(table.subgroup == s) for s in _played(sensor)])
    early = deserialiser.CYCLES + 1  # the test bench joins in the middle of cycle 0
    cycles = config.period - 2 - early
    k = np.arange(EDGES, dtype=np.int64) * SPREAD
    pulse, pixel = k >> 7 & config.pulses - 1, pixels[(k >> 10) % len(pixels)]
    tick = early * sensor.phases + (k >> 5) % (cycles * sensor.phases)
    for p in range(config.pulses):
        burst = (
            pixels.take(7 * p + np.arange(4), mode="wrap")
            if p % 2
            else pixels[-4 - p : len(pixels) - p]
        )
        pulse, pixel = np.append(pulse, [p] * 4), np.append(pixel, burst)
        # in a short period, as late as single edges may be
        cycle = early + min(6 + p, cycles - 1)
        tick = np.append(tick, cycle * sensor.phases - 2 + np.arange(4))
    _, once = np.unique(pulse * sensor.array_pixels + pixel, return_index=True)
    return Edges(pulse[once], pixel[once], tick[once])


def _played(sensor: Sensor) -> list[int]:
    """Return the first, middle and last subgroup."""
    return sorted({0, sensor.subgroups // 2, sensor.subgroups - 1})


def smoke_test(sensor: Sensor, levels: bool = False, view: View = POLYPHASE) -> str:
    """Return the test bench of the sensor, which synthesis ignores. levels: for the top of FPGAs,
    whose ports take SPAD levels.
    """
    frames = _frames(sensor)
    bench = LEVELS if levels else WORDS if view.by_words else LINES
    included = {
        BENCH.name: BENCH.read_text(encoding="utf-8"),
        "smoke_tables.vh": _sizes(sensor, frames, levels, view)
        + _registers(sensor, frames)
        + _beats(frames)
        + _flips(frames, levels, view),
        "smoke_sensor.vh": _instance(sensor, levels, view),
    }
    text = re.sub(
        r'^ *`include "(.*)"\n',
        lambda line: included[line[1]],
        bench.read_text(encoding="utf-8"),
        flags=re.MULTILINE,
    )
    licence, _, rest = text.partition("\n")
    return f"{licence}\n`ifndef SYNTHESIS\n{rest}`endif\n"


@frozen
class _Frame:
    """A frame of the test, its light, and what the golden model says of it. settings: to write
    before it. counters: to read after it.
    """

    config: Config
    edges: Edges
    trace: Trace
    settings: list[Access]
    counters: list[Access]


def _frames(sensor: Sensor) -> list[_Frame]:
    """Return the frames that the sensor plays after a reset, in turn."""
    golden = Golden(sensor)
    ready = np.arange(STALL_CYCLES) % STALL_EVERY != 0
    values = registers.reset_values(sensor)
    frames = []
    for config in smoke_configs(sensor):
        edges = smoke_edges(config)
        trace = golden.frame(config, edges, ready.astype(np.uint8))
        frames.append(
            _Frame(config, edges, trace, _settings(config, values), _counters(config, trace))
        )
        values |= dict(config.register_writes())
    return frames


def _instance(sensor: Sensor, levels: bool, view: View) -> str:
    """Return the instance of the sensor in the bench. Subgroups that the test does not use see no
    light.
    """
    played = _played(sensor)
    port = "line" if levels else "spad"
    driver = "at_port" if _by_words(levels, view) else "spad"
    lit = {}
    for s in range(sensor.subgroups):
        lit[f"{port}_{s}"] = f"{driver}[{played.index(s)}]" if s in played else "{LINES{1'b0}}"
    for stream in range(sensor.streams):
        name = sensor.stream_name(stream)
        lit |= {f"{name}_{wire}": f"{wire}[{stream}]" for wire in ("tvalid", "tready", "tlast")}
        lit[f"{name}_tdata"] = f"tdata[{64 * stream}+:64]"
    names = ["clk", "rst", *(port.name for port in SensorTop(sensor, view, levels).ports())]
    pins = ",\n".join(f"    .{name}({lit.get(name, name)})" for name in names)
    return f"  {FPGA_TOP if levels else TOP} sensor (\n{pins}\n  );\n"


def _by_words(levels: bool, view: View) -> bool:
    """Return whether the SPAD ports take words of edges, with one bit per phase."""
    return view.by_words and not levels


def _sizes(sensor: Sensor, frames: list[_Frame], levels: bool, view: View) -> str:
    """Return the numbers that the benches use."""
    work = len(_constants(sensor))
    for frame in frames:
        work += (
            frame.config.frame_cycles
            + sum(map(len, frame.trace.beats))
            + len(frame.settings)
            + len(frame.counters)
        )
    by_words = _by_words(levels, view)
    sizes = {
        "FRAMES": len(frames),
        "STREAMS": sensor.streams,
        "SUBGROUPS": sensor.subgroups,
        "PORTS": len(_played(sensor)),
        "LINES": sensor.pixels * (sensor.phases if by_words else 1),
        "STALL_CYCLES": STALL_CYCLES,
        "STALL_EVERY": STALL_EVERY,
        "TIMEOUT_CYCLES": PATIENCE * work,
    }
    if levels:
        sizes["PHASES"] = sensor.phases
    if view.circuit is not None:
        sizes["CLOCK_FS"] = view.circuit.clock_fs
    return "".join(f"  localparam {name} = {value};\n" for name, value in sizes.items())


def _constants(sensor: Sensor) -> list[Access]:
    """Return the registers that tell what is built."""
    return [
        (r.offset, r.reset(sensor), r.name)
        for r in registers.built(registers.GLOBAL, sensor)
        if r.access is registers.Access.CONSTANT
    ]


def _settings(config: Config, before: dict[int, int]) -> list[Access]:
    """Return the settings to write before a frame: those that differ from the values before it."""
    return [
        (address, value, "")
        for address, value in config.register_writes()
        if before[address] != value
    ]


def _counters(config: Config, trace: Trace) -> list[Access]:
    """Return the counters to read after a frame."""
    return [
        (registers.address(name, s), value, f"{name} of subgroup {s}")
        for s in _played(config.sensor)
        for name, value in zip(COUNTER_NAMES, trace.counters[s].tolist(), strict=True)
    ]


def _registers(sensor: Sensor, frames: list[_Frame]) -> str:
    """Return addresses and bits, expected values of constants and of each frame's counters, and
    each frame's settings to write.
    """
    by_name = registers.BY_NAME
    lines = [
        f"  localparam [19:0] {name.upper()} = 20'h{registers.address(name):05x};"
        for name in ADDRESSES
    ]
    lines += [
        f"  localparam [31:0] {bit.upper()} = 32'd{1 << by_name[register].bit(bit)};"
        for bit, register in BITS.items()
    ]
    return "\n".join(
        [
            *lines,
            _table("constant", ACCESS, map(_word, _constants(sensor)), "CONSTANTS"),
            _by_frame("setting", ACCESS, [_words(frame.settings) for frame in frames]),
            _by_frame("counter", ACCESS, [_words(frame.counters) for frame in frames]),
        ]
    )


def _words(rows: list[Access]) -> list[str]:
    """Return accesses as entries of a table."""
    return [_word(row) for row in rows]


def _word(row: tuple[int, int, str]) -> str:
    """Return address, value and name of a register as an entry of a table."""
    address, value, name = row
    return f"{{20'h{address:05x}, 32'd{value}}};{'  // ' * bool(name)}{name}"


def _beats(frames: list[_Frame]) -> str:
    """Return the words of all streams of all frames, one stream after the other, and the first
    word of each.
    """
    streams = [stream for frame in frames for stream in frame.trace.beats]
    first = np.cumsum([0, *map(len, streams)])
    beats = (f"64'h{int(beat):016x};" for stream in streams for beat in stream)
    return _table("first", "integer", _numbers(first)) + _table("expected", "reg [63:0]", beats)


def _flips(frames: list[_Frame], levels: bool, view: View) -> str:
    """Return tables of the changes at the SPAD ports, frame by frame and in order: their time in
    the frame, the number of the port, and the line.
    """
    times: list[list[str]] = []
    ports: list[str] = []
    lines: list[str] = []
    for frame in frames:
        time, subgroup, line = _flips_of(frame, levels, view)
        port = np.searchsorted(_played(frame.config.sensor), subgroup)
        order = np.lexsort((line, port, time))
        times.append([f"64'd{t};" for t in time[order]])
        ports += _numbers(port[order])
        lines += _numbers(line[order])
    return (
        _by_frame("flip_time", "reg [63:0]", times, "flip")
        + _table("flip_port", "integer", ports)
        + _table("flip_line", "integer", lines)
    )


def _flips_of(frame: _Frame, levels: bool, view: View) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return (time, subgroup, line) of all changes of a frame at the ports of a view."""
    if levels:
        return _level_flips(frame.config, frame.edges)
    if view.by_words:
        return _word_flips(frame.config, frame.edges)
    assert view.circuit is not None, "a view of lines has a circuit"
    timed = frame.config.with_frame(clock_mhz=view.circuit.clock_mhz)
    return line_toggles(timed, frame.edges)


def _numbers(values: np.ndarray) -> Iterable[str]:
    return (f"{value};" for value in values)


def _by_frame(name: str, kind: str, frames: list[list[str]], what: str = "") -> str:
    """Return a table of all frames, and the table NAME_from of where each frame begins and the
    last one ends. what: another NAME.
    """
    begins = np.cumsum([0, *map(len, frames)])
    entries = (entry for frame in frames for entry in frame)
    return _table(name, kind, entries) + _table(f"{what or name}_from", "integer", _numbers(begins))


def _table(name: str, kind: str, entries: Iterable[str], count: str = "") -> str:
    """Return a table in Verilog. Entries end with a semicolon. count: name of a parameter for
    the number of entries.
    """
    filled = [f"    {name}[{k}] = {entry}" for k, entry in enumerate(entries)]
    counted = [f"  localparam {count} = {len(filled)};"] * bool(count)
    return "\n".join(
        [
            *counted,
            f"  {kind} {name} [0:{len(filled) - 1}];",
            "  initial begin",
            *filled,
            "  end",
            "",
        ]
    )


def _word_flips(config: Config, edges: Edges) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return (cycle, subgroup, bit of the word at its port) of all changes. A bit is high in the
    cycle of its edge.
    """
    cycle, subgroup, bit = port_bits(config, edges)
    return np.concatenate([cycle, cycle + 1]), np.tile(subgroup, 2), np.tile(bit, 2)


def _level_flips(config: Config, edges: Edges) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return (tick, subgroup, line) of all changes. A level rises with its edge and falls before
    the period ends.

    It rises earlier than the edge by the delay of the deserialiser.
    """
    table, phases = pixel_table(config.sensor), config.sensor.phases
    start = config.start_cycles() * phases
    rise = start[edges.pulse] + edges.tick - deserialiser.CYCLES * phases
    fall = start[edges.pulse + 1] - 2 * phases
    return (
        np.concatenate([rise, fall]),
        np.tile(table.subgroup[edges.pixel], 2),
        np.tile(table.inside[edges.pixel], 2),
    )
