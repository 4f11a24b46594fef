# SPDX-License-Identifier: Apache-2.0
"""Models of flip-flops, latches and clock gates with random values, each alone on Icarus."""

import subprocess

import pytest

from coincid.flow.gls import FLOPS

# Inputs are known from the first edge on, so outputs are the data of the last one.
BENCH = """
module bench;
  reg clk = 0, d = 0, kept = 0, latched = 0, enabled = 0;
  wire q, qn, plain, latch, gated;
  integer n, wrong = 0, ones = 0, passed = 0, wanted = 0;
  DFF_X1 one (.D(d), .CK(clk), .Q(q), .QN(qn));
  \\$_DFF_P_ other (.D(d), .C(clk), .Q(plain));
  DLH_X1 held (.D(d), .G(clk), .Q(latch));
  CLKGATE_X1 gate (.CK(clk), .E(d), .GCK(gated));
  always @(posedge gated) passed = passed + 1;
  initial begin
    for (n = 0; n < 200; n = n + 1) begin
      d = $random;
      kept = d;
      #1 if (n == 0) passed = 0;
      clk = 1;
      wanted = wanted + kept;
      #1 wrong = wrong + (q !== kept) + (qn !== ~kept) + (plain !== kept) + (latch !== d) + (gated !== kept);
      d = $random;
      #1 latched = d;
      wrong = wrong + (q !== kept) + (latch !== d) + (gated !== kept);
      clk = 0;
      #1 d = $random;
      #1 wrong = wrong + (q !== kept) + (qn !== ~kept) + (latch !== latched) + (gated !== 1'b0);
      ones = ones + kept;
    end
    $display("%0d %0d %0d %0d", wrong, ones, passed, wanted);
  end
endmodule
"""
# Unknown data become a known value, of both kinds in time.
UNKNOWN = """
module bench;
  reg clk = 0;
  wire q, latch, gated;
  integer n, unknown = 0, ones = 0;
  DFF_X1 one (.D(1'bx), .CK(clk), .Q(q), .QN());
  DLH_X1 held (.D(q), .G(1'b1), .Q(latch));
  initial for (n = 0; n < 200; n = n + 1) begin
    #1 unknown = unknown + (q === 1'bx) + (latch === 1'bx);
    ones = ones + q;
    clk = ~clk;
  end
  initial #300 $display("%0d %0d", unknown, ones);
endmodule
"""


def said_by(bench, folder):
    """Return the numbers that a bench prints."""
    source, program = folder / "bench.v", folder / "bench.vvp"
    source.write_text(bench, encoding="utf-8")
    command = ["iverilog", "-g2012", "-gspecify", "-s", "bench", "-o", program, FLOPS, source]
    subprocess.run(command, check=True)
    done = subprocess.run(
        ["vvp", "-n", program], check=True, capture_output=True, text=True, encoding="utf-8"
    )
    return [int(number) for number in done.stdout.split()]


def test_cells_hold_pass_and_gate_as_their_names_say(tmp_path):
    wrong, ones, passed, wanted = said_by(BENCH, tmp_path)
    assert wrong == 0
    assert 50 < ones < 150
    assert passed == wanted


def test_unknown_data_become_random_ones(tmp_path):
    unknown, ones = said_by(UNKNOWN, tmp_path)
    assert unknown == 0
    assert 50 < ones < 150


@pytest.mark.parametrize("strength", [2, 4, 8])
def test_a_stronger_clock_gate_is_the_same(tmp_path, strength):
    name = f"CLKGATE_X{strength}"
    wrong, *_ = said_by(BENCH.replace("CLKGATE_X1", name), tmp_path)
    assert wrong == 0
