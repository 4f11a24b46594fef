# SPDX-License-Identifier: Apache-2.0
"""Cells and macros of the asynchronous front end, each alone on Icarus: what they do and when."""

import subprocess
from pathlib import Path

import pytest

from coincid.hdl import silicon

CELLS = Path(silicon.__file__).with_name("async_cells.v")
# In each bench one unit of time is 1 ps; times in fs are parameters.
MUTEX = """
`timescale 1ps / 1fs
module bench;
  reg a = 0, b = 0;
  wire second;
  coincid_mutex #(.TIE_FS(3000), .DELAY_FS(500)) mutex (.a(a), .b(b), .second(second));
  task pair(input real at_a, input real at_b);
    begin
      a = 0; b = 0; #100;
      fork
        #at_a a = 1;
        #at_b b = 1;
      join
      #100 $display("%0d", second);
    end
  endtask
  initial begin
    pair(10.0, 20.0);
    pair(10.0, 10.0);
    pair(12.9, 10.0);
    pair(13.1, 10.0);
    pair(40.0, 10.0);
    a = 0; b = 0; #100;
    b = 1; #0.4 $display("%0d", second);
    #0.2 $display("%0d", second);
    $finish;
  end
endmodule
"""
DELAY = """
`timescale 1ps / 1fs
module bench;
  reg a = 0;
  wire y, or_y, hit;
  reg clear = 0;
  coincid_delay #(.DELAY_FS(7250)) delay (.a(a), .y(y));
  coincid_or2 #(.DELAY_FS(1500)) node (.a(a), .b(1'b0), .y(or_y));
  coincid_hit_flop #(.DELAY_FS(2500)) flop (.edge_in(a), .arm(1'b1), .clear(clear), .hit(hit));
  always @(y) if ($realtime > 50) $display("delay %0d %0.3f", y, $realtime);
  always @(or_y) if ($realtime > 50) $display("or %0d %0.3f", or_y, $realtime);
  always @(hit) if ($realtime > 50) $display("hit %0d %0.3f", hit, $realtime);
  initial begin
    #100 a = 1;
    #1 a = 0;
    #0.5 a = 1;
    #98.5 clear = 1;
    #100 $finish;
  end
endmodule
"""
PHASES = """
`timescale 1ps / 1fs
module bench;
  reg clk = 0;
  wire [3:0] phases;
  wire mark, shut, wipe;
  coincid_phases #(
    .PHASES(8), .CLOCK_FS(1600000), .LAG_FS(30000),
    .MISMATCH_FS({32'd0, 32'd0, 32'd0, -32'sd20000, 32'd0, 32'd10000, 32'd0, 32'd0})
  ) generator (.clk(clk), .phases(phases), .mark(mark), .shut(shut), .wipe(wipe));
  always @(phases) if ($realtime < 3000) $display("phases %b %0.0f", phases, $realtime - 800);
  always @(mark) if ($realtime > 800) $display("mark %0d %0.0f", mark, $realtime - 800);
  always @(shut) if ($realtime > 800) $display("shut %0d %0.0f", shut, $realtime - 800);
  always @(wipe) if ($realtime > 800) $display("wipe %0d %0.0f", wipe, $realtime - 800);
  always #800 clk = ~clk;
  initial #2550 $finish;
endmodule
"""
WINDOW = """
`timescale 1ps / 1fs
module bench;
  reg start = 0;
  reg [3:0] phases = 0;
  wire counted, line;
  integer n;
  coincid_window #(.PHASES(8), .BITS(4), .CLOCK_FS(1600000)) one (
    .start(start), .ticks(4'd5), .phases(phases), .ended(counted));
  coincid_window #(.PHASES(8), .BITS(4), .CLOCK_FS(1600000), .LINE(1), .GAIN_PPM(20000)) other (
    .start(start), .ticks(4'd5), .phases(phases), .ended(line));
  always @(counted) if ($realtime > 0) $display("counted %0d %0.0f", counted, $realtime - 1000);
  always @(line) if ($realtime > 0) $display("line %0d %0.0f", line, $realtime - 1000);
  initial begin
    #1000 start = 1;
    #50 for (n = 0; n < 10; n = n + 1) #200 phases[n % 4] = ~phases[n % 4];
    #50 start = 0;
    #500 start = 1;      // it falls too early: this window does not end
    #100 start = 0;
    #300 start = 1;      // its end would come now; this window has an end of its own
    #2000 start = 0;
    #3000 $finish;
  end
endmodule
"""


def said_by(bench, folder):
    """Return the lines that a bench prints."""
    source, program = folder / "bench.v", folder / "bench.vvp"
    source.write_text(bench, encoding="utf-8")
    command = ["iverilog", "-g2012", "-s", "bench", "-o", program, CELLS, source]
    subprocess.run(command, check=True)
    done = subprocess.run(
        ["vvp", "-n", program], check=True, capture_output=True, text=True, encoding="utf-8"
    )
    return [line for line in done.stdout.splitlines() if "$finish" not in line]


def test_a_mutex_takes_requests_within_its_tie_for_the_first_ones(tmp_path):
    """3 ps here; it answers after its delay."""
    said = said_by(MUTEX, tmp_path)
    assert said == ["0", "0", "0", "1", "1", "0", "1"]


def test_delays_of_cells_are_in_femtoseconds(tmp_path):
    """A matched delay repeats also pulses that are shorter than it; a flop takes the first edge."""
    said = said_by(DELAY, tmp_path)
    assert sorted(said) == sorted(
        [
            "delay 1 107.250",
            "delay 0 108.250",
            "delay 1 108.750",
            "or 1 103.000",
            "hit 1 102.500",
            "hit 0 202.500",
        ]
    )


def test_borders_and_strobes_of_a_cycle(tmp_path):
    """Eight borders of 200 ps, behind a lag of 30 ps; two of them are out of place."""
    said = [line.split() for line in said_by(PHASES, tmp_path)]
    taps, strobes = {}, {}
    before = "0000"
    for name, value, at in said:
        if name != "phases":
            strobes.setdefault(name, []).append((int(value), int(at)))
            continue
        if "x" not in value and "x" not in before:
            for k in range(4):
                if value[3 - k] != before[3 - k]:
                    taps.setdefault(k, []).append((int(value[3 - k]), int(at)))
        before = value
    assert {k: changes[:2] for k, changes in taps.items()} == {
        0: [(1, 30), (0, 810)],
        1: [(1, 230), (0, 1030)],
        2: [(1, 440), (0, 1230)],
        3: [(1, 630), (0, 1430)],
    }
    assert strobes == {
        "mark": [(1, 530), (0, 1230)],
        "shut": [(1, 900), (0, 1700)],
        "wipe": [(1, 1200), (0, 1500)],
    }


LINE_PS = round((4.5 * 1.02 + 2) * 200)


@pytest.mark.parametrize(
    ("kind", "changes"),
    [
        ("counted", [(1, 50 + 7 * 200), (0, 2100)]),
        ("line", [(1, LINE_PS), (0, 2100), (1, 3000 + LINE_PS), (0, 5000)]),
    ],
)
def test_a_window_ends_after_its_ticks_and_a_quarter_of_a_cycle(tmp_path, kind, changes):
    """Counted in borders, of which the last window has none, or with the gain error of a line of
    (ticks - 1/2) LSB; only while its start is high, and not by the start of a window before it.
    """
    said = [line for line in said_by(WINDOW, tmp_path) if line.startswith(kind)]
    assert said == [f"{kind} {value} {at}" for value, at in changes]
