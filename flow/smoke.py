"""Smoke test that ships with the Verilog: plain Verilog, no Python, prints PASS or FAIL.

It programs registers over AXI4-Lite, plays the edges of a frame and compares every word of the streams and the counters
with what the golden model said at export.
"""

from functools import partial

import numpy as np

from ..hdl import deserialiser
from ..hdl.sensor import FPGA_TOP, TOP, netlist
from ..hdl.views import POLYPHASE
from ..model.contract import registers
from ..model.contract.config import Config, parse_config, sensor_table
from ..model.contract.edges import Edges
from ..model.contract.parameters import Sensor
from ..model.contract.pixels import pixel_table
from ..model.golden.frame import Golden, Trace

SMOKE, FPGA_SMOKE = "coincid_smoke", "coincid_fpga_smoke"
PULSES = 4
EDGES = 160  # of the frame, spread by a multiplicative sequence; and a burst of neighbours a pulse
SPREAD = 2_654_435_761  # Knuth's multiplier
STALL_CYCLES = 300  # in these `tready` is low every fourth cycle
TIMEOUT_CYCLES = 200_000


def smoke_config(sensor: Sensor) -> Config:
    """A short frame with everything on. Settings that need not differ from the reset values do not: less to program."""
    played = _played(sensor)
    first_gate = {"gating": True, "gate_start": 3, "gate_len": sensor.guard + 8}
    reset = {name: registers.BY_NAME[name].reset(sensor) for name in ("threshold", "window", "gate_start", "gate_len")}
    return parse_config(
        {
            "sensor": sensor_table(sensor),
            "frame": {
                "period": min(2 * sensor.guard + 24, sensor.period_max),
                "pulses": PULSES,
                "format": "full",
                "minigroup_records": True,
                "mg_threshold": 1,
            },
            "subgroup": reset,
            "override": [
                {"subgroups": played[-1:], "threshold": 1},
                {"subgroups": played[:1], **first_gate, "threshold": 3},
            ],
        }
    )


def smoke_edges(config: Config) -> Edges:
    """Edges on a few subgroups: a burst of four pixels within a tick or two at each pulse, and single ones. No pixel twice in a pulse."""
    sensor = config.sensor
    table = pixel_table(sensor)
    pixels = np.concatenate([np.flatnonzero(table.subgroup == s) for s in _played(sensor)])
    early = deserialiser.CYCLES + 1  # the test bench joins in the middle of cycle 0
    cycles = config.period - 2 - early
    k = np.arange(EDGES, dtype=np.int64) * SPREAD
    pulse, pixel = k >> 7 & PULSES - 1, pixels[(k >> 10) % len(pixels)]
    tick = early * sensor.phases + (k >> 5) % (cycles * sensor.phases)
    for p in range(PULSES):
        burst = pixels[(p * 7) % len(pixels) + np.arange(4)] if p % 2 else pixels[-4 - p : len(pixels) - p]
        pulse, pixel = np.append(pulse, [p] * 4), np.append(pixel, burst)
        tick = np.append(tick, (early + 6 + p) * sensor.phases - 2 + np.arange(4))
    _, once = np.unique(pulse * sensor.array_pixels + pixel, return_index=True)
    return Edges(pulse[once], pixel[once], tick[once])


def _played(sensor: Sensor) -> list[int]:
    """First, middle and last subgroup."""
    return sorted({0, sensor.subgroups // 2, sensor.subgroups - 1})


def smoke_test(sensor: Sensor, levels: bool = False, view=POLYPHASE) -> str:
    """The test bench of the sensor; with `levels` that of the top for FPGAs, which gets SPAD levels in real time. view: of `views.py`."""
    config = smoke_config(sensor)
    edges = smoke_edges(config)
    ready = np.arange(STALL_CYCLES) % 4 != 0
    trace = Golden(sensor).frame(config, edges, ready.astype(np.uint8))
    light = (
        _light_levels if levels else _light_words if view is POLYPHASE else partial(_light_lines, view.circuit.clock_fs)
    )
    return "\n".join(
        [
            *([] if view is POLYPHASE else ["`timescale 1ps / 1fs", ""]),
            f"// Smoke test of {FPGA_TOP if levels else TOP}: prints PASS, or FAIL and why. The expected words are the golden model's.",
            f"module {FPGA_SMOKE if levels else SMOKE};",
            *_wiring(sensor, levels, view),
            *_expected(trace),
            *_checks(),
            *_bus(),
            *_streams(sensor, trace),
            *_frame(sensor),
            *light(config, edges),
            *_story(config, trace),
            "endmodule",
            "",
        ]
    )


def _wiring(sensor: Sensor, levels: bool, view) -> list[str]:
    ports = netlist(sensor, levels, view).ports
    lines = ["  reg clk = 1'b0;", "  reg rst = 1'b1;"]
    for port in ports:
        width = f"[{port.width - 1}:0] " if port.width > 1 else ""
        lines.append(f"  reg {width}{port.name} = 0;" if port.is_input else f"  wire {width}{port.name};")
    connections = ", ".join(f".{name}({name})" for name in ("clk", "rst", *(port.name for port in ports)))
    return [*lines, f"  {FPGA_TOP if levels else TOP} dut ({connections});", ""]


def _expected(trace: Trace) -> list[str]:
    lines = []
    for stream, beats in enumerate(trace.beats):
        lines += [f"  reg [63:0] expected_{stream} [0:{len(beats) - 1}];", "  initial begin"]
        lines += [f"    expected_{stream}[{i}] = 64'h{int(beat):016x};" for i, beat in enumerate(beats)]
        lines += ["  end", ""]
    return lines


def _checks() -> list[str]:
    return f"""\
  integer checks = 0;
  integer errors = 0;

  task check(input ok, input [63:0] got, input [63:0] wanted);
    begin
      checks = checks + 1;
      if (!ok) begin
        errors = errors + 1;
        $display("FAIL: %h where %h is expected, at time %0t, check %0d", got, wanted, $time, checks);
      end
    end
  endtask

  initial begin
    repeat ({TIMEOUT_CYCLES}) @(posedge clk);
    $display("FAIL: no end after {TIMEOUT_CYCLES} cycles");
    $fatal(1);
  end
""".splitlines()


def _bus() -> list[str]:
    return """\
  // Registers. Inputs change at falling edges; the rising edge takes them.
  task write(input [19:0] address, input [31:0] value, input [1:0] response);
    begin
      @(negedge clk);
      while (!s_axi_awready || !s_axi_wready) @(negedge clk);
      s_axi_awaddr = address;
      s_axi_wdata = value;
      s_axi_wstrb = 4'hf;
      s_axi_awvalid = 1'b1;
      s_axi_wvalid = 1'b1;
      s_axi_bready = 1'b1;
      @(negedge clk);
      s_axi_awvalid = 1'b0;
      s_axi_wvalid = 1'b0;
      while (!s_axi_bvalid) @(negedge clk);
      check(s_axi_bresp === response, {62'd0, s_axi_bresp}, {62'd0, response});
      @(negedge clk);
      s_axi_bready = 1'b0;
    end
  endtask

  reg [31:0] data = 0;

  task read(input [19:0] address);
    begin
      @(negedge clk);
      while (!s_axi_arready) @(negedge clk);
      s_axi_araddr = address;
      s_axi_arvalid = 1'b1;
      s_axi_rready = 1'b1;
      @(negedge clk);
      s_axi_arvalid = 1'b0;
      while (!s_axi_rvalid) @(negedge clk);
      data = s_axi_rdata;
      @(negedge clk);
      s_axi_rready = 1'b0;
    end
  endtask

  task expect_register(input [19:0] address, input [31:0] value);
    begin
      read(address);
      check(data === value, {32'd0, data}, {32'd0, value});
    end
  endtask
""".splitlines()


def _streams(sensor: Sensor, trace: Trace) -> list[str]:
    lines = []
    for stream, beats in enumerate(trace.beats):
        name = sensor.stream_name(stream)
        lines += (
            f"""\
  integer received_{stream} = 0;

  task take_{stream};
    if ({name}_tready && {name}_tvalid) begin
      if (received_{stream} < {len(beats)}) begin
        check({name}_tdata === expected_{stream}[received_{stream}], {name}_tdata, expected_{stream}[received_{stream}]);
      end
      received_{stream} = received_{stream} + 1;
      check({name}_tlast === (received_{stream} == {len(beats)}), {{63'd0, {name}_tlast}}, {{63'd0, received_{stream} == {len(beats)}}});
    end
  endtask
""".splitlines()
            + [""]
        )
    whole = " && ".join(f"received_{stream} == {len(beats)}" for stream, beats in enumerate(trace.beats))
    return [*lines, f"  wire whole = {whole};", ""]


def _frame(sensor: Sensor) -> list[str]:
    names = [sensor.stream_name(stream) for stream in range(sensor.streams)]
    return [
        "  // The frame: cycle 0 is the one in which `laser` goes high for the first time.",
        "  integer cycle = -1;",
        "  always @(negedge clk) begin",
        "    if (cycle >= 0) cycle = cycle + 1;",
        "    else if (laser) cycle = 0;",
        *(f"    {name}_tready = cycle >= 0 && (cycle >= {STALL_CYCLES} || cycle % 4 != 0);" for name in names),
        *(f"    take_{stream};" for stream in range(sensor.streams)),
        "    shine;",
        "  end",
        "",
    ]


def _by_time(times: np.ndarray, edges: Edges, sensor: Sensor, signal: str, phase: bool) -> list[str]:
    """Branches of a case statement: at each time, the bits that go high."""
    table, branches = pixel_table(sensor), {}
    for time, pixel, tick in sorted(zip(times.tolist(), edges.pixel.tolist(), edges.tick.tolist())):
        bit = table.inside[pixel] * sensor.phases + tick % sensor.phases if phase else table.inside[pixel]
        branches.setdefault(time, []).append(f"{signal}_{table.subgroup[pixel]}[{bit}] = 1'b1;")
    return [f"        {time}: begin {' '.join(sets)} end" for time, sets in branches.items()]


def _light_words(config: Config, edges: Edges) -> list[str]:
    sensor = config.sensor
    cycles = edges.pulse * config.period + edges.tick // sensor.phases
    return [
        "  always #1 clk = !clk;",
        "",
        "  task shine;",
        "    begin",
        *(f"      spad_{s} = 0;" for s in _played(sensor)),
        "      case (cycle)",
        *_by_time(cycles, edges, sensor, "spad", True),
        "        default: ;",
        "      endcase",
        "    end",
        "  endtask",
        "",
    ]


def _light_lines(cycle_fs: int, config: Config, edges: Edges) -> list[str]:
    """SPAD lines of the asynchronous view: a pulse of a quarter of a tick in the middle of each edge's, set off half a cycle ahead."""
    sensor = config.sensor
    table, branches = pixel_table(sensor), {}
    tick_fs = cycle_fs / sensor.phases
    for pulse, pixel, tick in sorted(zip(edges.pulse.tolist(), edges.pixel.tolist(), edges.tick.tolist())):
        line = f"spad_{table.subgroup[pixel]}[{table.inside[pixel]}]"
        rise_fs = cycle_fs / 2 + (tick % sensor.phases + 0.5) * tick_fs
        branches.setdefault(pulse * config.period + tick // sensor.phases - 1, []).append(
            f"{line} <= #({rise_fs / 1000:g}) 1'b1; {line} <= #({(rise_fs + tick_fs / 4) / 1000:g}) 1'b0;"
        )
    return [
        f"  always #{cycle_fs // 2000} clk = !clk;",
        "",
        "  task shine;",
        "    case (cycle)",
        *(f"      {cycle}: begin {' '.join(sets)} end" for cycle, sets in sorted(branches.items())),
        "      default: ;",
        "    endcase",
        "  endtask",
        "",
    ]


def _light_levels(config: Config, edges: Edges) -> list[str]:
    """SPAD levels: each rises in the middle of its tick, and all fall before the period's end."""
    sensor, phases = config.sensor, config.sensor.phases
    ticks = edges.pulse * config.period_ticks + edges.tick - deserialiser.CYCLES * phases
    lines = [f"line_{s} = 0;" for s in _played(sensor)]
    quiet = [
        f"        {p * config.period_ticks - 2 * phases}: begin {' '.join(lines)} end" for p in range(1, PULSES + 1)
    ]
    branches = sorted(_by_time(ticks, edges, sensor, "line", False) + quiet, key=lambda line: int(line.split(":")[0]))
    return f"""\
  // Clock j is high from tick j of a cycle for half a cycle. `now` counts ticks from the beginning of cycle 0.
  integer tick = 0;
  integer now = -1;

  task shine;
    if (cycle == 0) now = {phases // 2};
  endtask

  always begin
    #1;
    case (now)
{chr(10).join(branches)}
      default: ;
    endcase
    #1;
    tick = tick + 1;
    if (now >= 0) now = now + 1;
    clk = tick % {phases} < {phases // 2};
{chr(10).join(f"    {phase_clock(sensor, j)} = (tick + {phases - j}) % {phases} < {phases // 2};" for j in range(1, phases // 2))}
  end
""".splitlines()


def phase_clock(sensor: Sensor, j: int) -> str:
    """Clock j > 0 of the deserialisers, as Verilog calls it."""
    return f"phase_clocks[{j - 1}]" if sensor.phases > 4 else "phase_clocks"


def _story(config: Config, trace: Trace) -> list[str]:
    sensor = config.sensor
    status = registers.BY_NAME["status"]
    reset = registers.reset_values(sensor)
    writes = [(address, value) for address, value in config.register_writes() if reset[address] != value]
    constants = [register for register in registers.GLOBAL if register.access is registers.Access.CONSTANT]
    lines = ["  initial begin", "    repeat (8) @(negedge clk);", "    rst = 1'b0;", "    repeat (8) @(negedge clk);"]
    lines += [f"    expect_register(20'h{r.offset:05x}, 32'd{r.reset(sensor)});  // {r.name}" for r in constants]
    lines += [f"    write(20'h{address:05x}, 32'd{value}, 2'd0);" for address, value in writes]
    lines += [
        f"    write(20'h{registers.address('period'):05x}, 32'd0, 2'd2);  // refused",
        f"    expect_register(20'h{status.offset:05x}, 32'd{1 << status.bit('bad_value')});",
        f"    write(20'h{status.offset:05x}, 32'd{1 << status.bit('bad_value')}, 2'd0);",
        f"    write(20'h{registers.address('control'):05x}, 32'd1, 2'd0);  // start",
        "    while (!whole) @(negedge clk);",
        "    repeat (50) @(negedge clk);",
        f"    expect_register(20'h{status.offset:05x}, 32'd{1 << status.bit('done')});",
    ]
    for s in _played(sensor):
        for name, value in zip(registers.COUNTER_NAMES, trace.counters[s].tolist()):
            lines.append(
                f"    expect_register(20'h{registers.address(name, s):05x}, 32'd{value});  // {name} of subgroup {s}"
            )
    return [
        *lines,
        "    check(whole, 64'd0, 64'd1);",
        "    if (errors == 0) begin",
        '      $display("PASS: %0d checks", checks);',
        "      $finish;",
        "    end else begin",
        '      $display("FAIL: %0d of %0d checks", errors, checks);',
        "      $fatal(1);",
        "    end",
        "  end",
    ]
