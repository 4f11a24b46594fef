"""Stress of the asynchronous front end: any edges whatsoever, random at every scale, and flops that fall to either side where they may.

The front end and its TDC run alone under Icarus. Every SPAD line is a random process of its own: bursts of femtoseconds, gaps of cycles,
edges on the very borders of cycles and ticks; mask, gate and window change between periods, and resets fall into it. A word is wrong where
its map is empty, its winner is not in the map, or its count is not the map's. The front end is locked up where it shows no word for longer
than it may, or does not answer a single edge when all is quiet.

`python -m coincid.tb.stress EDGES [SEED]` prints the counts.
"""

import json
import subprocess
import sys
from pathlib import Path

from amaranth.hdl import Value

from ..hdl.export import units_files
from ..hdl.silicon.circuit import CLOCK_FS, Circuit
from ..hdl.unit import Unit
from ..hdl.views import Asynchronous
from ..model.contract.parameters import Sensor
from ..model.shared.errors import check_integer
from ..model.shared.folders import build_root
from ..model.shared.sources import digest
from . import toolchain
from .stimulus import FS_PER_PS

TOP = "coincid_async_stress"
PERIOD_CYCLES = 64
EDGES_MAX = 1 << 31
APERTURE_PS = 20  # of a flop that has just met its data
DRIVEN = ("spad", "mask", "gate", "window_ticks", "frame", "timing")  # what the bench drives


def stress(edges: int, seed: int = 1, sensor: Sensor | None = None, circuit: Circuit | None = None) -> dict:
    """Runs `edges` random edges: counts of edges, windows, records, wrong words and lock-ups.

    Raises `toolchain.ToolchainError` where Icarus is missing or fails.
    """
    check_integer("edges", edges, 1, EDGES_MAX)
    front = Front(sensor or Sensor(rows=8, cols=8), circuit or Circuit())
    files = front.files() | {"bench.v": front.bench(_body(front))}
    return json.loads(run_bench(files, f"+edges={edges}", f"+seed={seed}", aperture=True)[-1])


def run_bench(files: dict[str, str], *arguments: str, aperture: bool = False) -> list[str]:
    """The lines that a bench (module `TOP`) prints under Icarus. aperture: flops may fall to either side when their data has just moved."""
    define = [f"-DCOINCID_APERTURE_PS={APERTURE_PS}"] * aperture
    key = digest(*define, *(part for item in files.items() for part in item))

    def make(scratch: Path) -> None:
        for name, text in files.items():
            (scratch / name).write_text(text)
        toolchain.compile_in(
            scratch, scratch / "compile.log", ["iverilog", "-g2012", *define, "-o", "bench.vvp", "-s", TOP, *files]
        )

    folder = toolchain.build_once(build_root() / "bench" / key, make)
    done = subprocess.run(
        ["vvp", "-n", "bench.vvp", *arguments], cwd=folder, capture_output=True, text=True, check=False
    )
    if done.returncode or not done.stdout.strip():
        raise toolchain.ToolchainError(f"bench: the simulation failed: {done.stderr.strip() or 'it printed nothing'}")
    return done.stdout.strip().splitlines()


class Front:
    """A front end with its TDC, alone in a bench that drives `DRIVEN`.

    at, timing, frame: lowest bits of the fields of a window, of the timing word, of the frame settings.
    """

    def __init__(self, sensor: Sensor, circuit: Circuit):
        view = Asynchronous(circuit)
        self.sensor, self.cells = sensor, view.cells
        self.front, self.tdc = view.front_end(sensor), view.tdc(sensor, 1)
        self.at, self.timing, self.frame = (
            {name: field.offset for name, field in getattr(self.front, port).shape()}
            for port in ("window", "timing", "frame")
        )

    def files(self) -> dict[str, str]:
        """Everything but the bench."""
        return units_files([self.front, self.tdc]) | {path.name: path.read_text() for path in self.cells}

    def bench(self, body: str) -> str:
        """Module `TOP`: clock, front end and TDC, and `body`."""

        def widths(unit: Unit) -> dict[str, int]:
            return {port: len(Value.cast(value)) for port, (_, value) in unit.flat_ports().items()}

        of_front = widths(self.front)
        wires = [f"  wire [{width - 1}:0] {port};" for port, width in of_front.items() if port not in DRIVEN]
        driven = [f"  reg [{of_front[port] - 1}:0] {port} = 0;" for port in DRIVEN]
        line = {port: port.replace("line_0__", "line__") for port in widths(self.tdc)}
        tdc_ports = ", ".join(f".{port}({line[port] if port != 'start' else 'start_module'})" for port in line)
        front_ports = ", ".join(f".{port}({port})" for port in of_front)
        return "\n".join(
            [
                "`timescale 1ps / 1fs",
                f"module {TOP};",
                "  reg clk = 0, rst = 1, start_module = 0;",
                f"  always #{CLOCK_FS // 2 / FS_PER_PS} clk = ~clk;",
                *wires,
                *driven,
                f"  {self.tdc.unit_name} tdc (.clk(clk), .rst(rst), {tdc_ports});",
                f"  {self.front.unit_name} front (.clk(clk), .rst(rst), {front_ports});",
                body,
                "endmodule",
                "",
            ]
        )


def _body(front: Front) -> str:
    """Random edges at the front end, and what must hold of every word."""
    sensor, at, timing, frame = front.sensor, front.at, front.timing, front.frame
    pixels, tick_fs = sensor.pixels, CLOCK_FS // sensor.phases
    half_ps, tick_ps = CLOCK_FS / 2 / FS_PER_PS, tick_fs / FS_PER_PS
    return f"""
  integer wanted, seed, edges = 0, windows = 0, records = 0, wrong = 0, locked = 0, resets = 0, blinds = 0, quiet = 0, cycle = 0, since = 0;
  reg bright = 0;
  reg [2:0] light = 4;
  initial begin
    if (!$value$plusargs("edges=%d", wanted)) wanted = 10000;
    if (!$value$plusargs("seed=%d", seed)) seed = 1;
    repeat (4) @(posedge clk);
    rst <= 0; bright = 1;
    wait (edges >= wanted);
    bright = 0; gate <= 1; mask <= {{{pixels}{{1'b1}}}};
    repeat ({4 * PERIOD_CYCLES}) @(posedge clk);
    wait (cycle == 8);
    quiet = windows;
    #{CLOCK_FS / 4000} spad[{pixels - 1}] = 1; #10 spad[{pixels - 1}] = 0;
    repeat ({PERIOD_CYCLES // 2}) @(posedge clk);
    if (windows != quiet + 1 || window[{at["hits"]} +: {pixels}] != {{1'b1, {pixels - 1}'b0}}
        || window[{at["winner"]} +: {sensor.winner_bits}] != {pixels - 1}) locked = locked + 1;
    $write("{{\\"edges\\": %0d, \\"windows\\": %0d, \\"records\\": %0d, ", edges, windows, records);
    $display("\\"blind_cycles\\": %0d, \\"resets\\": %0d, \\"wrong\\": %0d, \\"locked\\": %0d}}", blinds, resets, wrong, locked);
    $finish;
  end

  genvar p;
  generate for (p = 0; p < {pixels}; p = p + 1) begin : pixel
    real gap;
    always begin
      case ($urandom(seed) % 8)
        0: gap = $urandom(seed) % 200 / 1000.0 + 0.001;   // within a burst
        1: gap = $urandom(seed) % {4 * tick_fs} / 1000.0 + 0.001;   // ticks
        2: gap = {half_ps} * (1 + $floor($realtime / {half_ps})) - $realtime;   // the clock's next edge
        3: gap = {tick_ps} * (1 + $urandom(seed) % {sensor.phases} + $floor($realtime / {tick_ps})) - $realtime;   // a tick's border
        default: gap = ($urandom(seed) % {CLOCK_FS // 4} << light) / 1000.0 + 0.001;   // a part of a cycle to many, by the period's light
      endcase
      if (gap < 0.001) gap = 0.001;
      #(gap);
      if (bright) begin
        spad[p] = 1; edges = edges + 1;
        #({tick_fs // 8 / 1000}) spad[p] = 0;
      end
    end
  end endgenerate

  // A laser period, and what may change between two of them.
  integer k;
  always @(posedge clk) begin
    cycle <= cycle == {PERIOD_CYCLES - 1} ? 0 : cycle + 1;
    timing <= (1 << {timing["running"]}) | ((cycle == 0) << {timing["start"]}) | ((cycle == 0) << {timing["wrap"]})
            | ((cycle < {PERIOD_CYCLES - sensor.guard}) << {timing["may_open"]});
    start_module <= cycle == 0;
    rst <= 0;
    if (bright && cycle == 0) begin
      window_ticks <= $urandom(seed) % 3 == 0 ? 1 + $urandom(seed) % {sensor.window_max} : 1 + $urandom(seed) % {sensor.phases};
      light <= $urandom(seed);
      for (k = 0; k < {pixels}; k = k + 1) mask[k] <= $urandom(seed) % 8 != 0;
      frame <= (1 << {frame["minigroup_records"]}) | (1 << {frame["mg_threshold"]}) | ((1 + $urandom(seed) % 4) << {frame["mg_window"]});
      if ($urandom(seed) % 8 == 0) begin rst <= 1; resets = resets + 1; end
    end
    if (bright) gate <= $urandom(seed) % 16 != 0;
    if (cycle == 0 && window_ticks == 0) window_ticks <= 1;
  end

  function [15:0] ones(input [{pixels - 1}:0] bits);
    integer i;
    begin
      ones = 0;
      for (i = 0; i < {pixels}; i = i + 1) ones = ones + bits[i];
    end
  endfunction
  always @(posedge clk) begin
    since <= closed || !bright || rst ? 0 : since + 1;
    if (since > {4 * PERIOD_CYCLES}) begin locked = locked + 1; since <= 0; end
    if (record_due && latched) records = records + 1;
    if (blind) blinds = blinds + 1;
    if (closed && !rst) begin
      windows = windows + 1;
      if (window[{at["hits"]} +: {pixels}] == 0 || !window[{at["hits"]} + window[{at["winner"]} +: {sensor.winner_bits}]]
          || ones(window[{at["hits"]} +: {pixels}]) != window[{at["count"]} +: {sensor.count_bits}]) wrong = wrong + 1;
      if (^window[{at["hits"]} +: {pixels}] === 1'bx || ^window[{at["stamp"]} +: {sensor.stamp_bits}] === 1'bx) wrong = wrong + 1;
    end
  end
"""


if __name__ == "__main__":
    print(json.dumps(stress(*map(int, sys.argv[1:]))))
