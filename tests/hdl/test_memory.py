# SPDX-License-Identifier: Apache-2.0
"""The memory's form for standard cells under random traffic beside the plain one; the clock gate's
under random enables.
"""

import subprocess

import pytest

from coincid.hdl.clock_gate import ClockGate
from coincid.hdl.export import units_files
from coincid.hdl.memory import Memory

CYCLES = 2000
# Inputs change behind the rising edge, as those of registers do. A row is not looked at while it is
# written.
MEMORIES = """
module bench;
  reg clk = 0, write = 0;
  reg [{high}:0] to = 0, row = 0;
  reg [{width}-1:0] data = 0;
  wire [{width}-1:0] plain, cells;
  integer n, seen = 0;
  {name} one (.clk(clk), .rst(1'b0), .test_enable(1'b0), .write(write), .data(data), .value(plain){ports});
  {name}_cells other (.clk(clk), .rst(1'b0), .test_enable(1'b0), .write(write), .data(data), .value(cells){ports});
  initial begin
    for (n = 0; n < {cycles}; n = n + 1) begin
      #5 clk = 1;
      #1 write = n < {depth} || $random % 2;
      to = n < {depth} ? n : $unsigned($random) % {depth};
      row = $unsigned($random) % {depth};
      data = {{$random, $random}};
      #4 clk = 0;
      #4 if (n >= {depth} && !(write && to == row)) begin
        seen = seen + 1;
        if (plain !== cells) begin $display("FAIL: row %0d: %h and %h", row, plain, cells); $finish; end
      end
    end
    $display("PASS: %0d", seen);
  end
endmodule
"""
GATE = """
module bench;
  reg clk = 0, enable = 0, test_enable = {test_enable};
  wire gated;
  integer n, wanted = 0, passed = 0;
  coincid_clock_gate gate (.clk(clk), .rst(1'b0), .enable(enable), .test_enable(test_enable), .gated(gated));
  always @(posedge gated) passed = passed + 1;
  initial begin
    for (n = 0; n < 2000; n = n + 1) begin
      #5 clk = 1;
      #1 enable = $random;
      #1 enable = $random;
      #3 clk = 0;
      if (n == 0) passed = 0;  // what came before the latch was known
      #1 enable = $random;
      #1 wanted = wanted + (enable || test_enable);
    end
    #5 clk = 1;
    #1 $display("%0s: %0d of %0d", passed == wanted ? "PASS" : "FAIL", passed, wanted);
  end
endmodule
"""
# In every cycle there are new data, and nobody writes.
TRANSPARENT = """
module bench;
  reg clk = 0;
  reg [1:0] row = 0;
  reg [4:0] data = 0;
  wire [4:0] value;
  integer n, wrong = 0;
  {name} memory (.clk(clk), .rst(1'b0), .test_enable(1'b1), .write(1'b0), .data(data), .value(value), .to(2'd0), .row(row));
  initial begin
    for (n = 0; n < 200; n = n + 1) begin
      #5 clk = ~clk;
      #1 data = $random;
      row = $unsigned($random) % 3;
      #1 wrong = wrong + (value !== data);
    end
    $display("%0s", wrong ? "FAIL" : "PASS");
  end
endmodule
"""


def simulated(folder, *texts):
    """Return what a bench says on Icarus."""
    source, program = folder / "bench.v", folder / "bench.vvp"
    source.write_text("\n".join(texts), encoding="utf-8")
    subprocess.run(["iverilog", "-g2012", "-s", "bench", "-o", program, source], check=True)
    return subprocess.run(
        ["vvp", "-n", program], check=True, capture_output=True, text=True, encoding="utf-8"
    ).stdout


@pytest.mark.parametrize(("depth", "width"), [(1, 12), (2, 5), (3, 40), (16, 64)])
def test_latches_hold_what_the_memory_holds(tmp_path, depth, width):
    unit = Memory(depth, width)
    name = unit.unit_name
    plain, cells = (units_files([unit], cells=form)[f"{name}.v"] for form in (False, True))
    assert plain != cells
    ports = ", .to(to), .row(row)" if depth > 1 else ""
    bench = MEMORIES.format(
        name=name,
        depth=depth,
        width=width,
        high=max(depth - 1, 1).bit_length() - 1,
        ports=ports,
        cycles=CYCLES,
    )
    said = simulated(
        tmp_path, plain, cells.replace(f"module {name} ", f"module {name}_cells "), bench
    )
    assert said.startswith("PASS: "), said
    assert int(said.split()[1]) > CYCLES / 4


def test_latches_are_transparent_in_a_test_of_the_chip(tmp_path):
    unit = Memory(3, 5)
    cells = units_files([unit], cells=True)[f"{unit.unit_name}.v"]
    said = simulated(tmp_path, cells, TRANSPARENT.format(name=unit.unit_name))
    assert said.startswith("PASS")


@pytest.mark.parametrize("test_enable", [0, 1])
def test_a_clock_gate_lets_whole_wanted_edges_pass(tmp_path, test_enable):
    """One edge for each cycle at whose end the enable was high, whatever it did before; in a test
    of the chip, all edges.
    """
    gate = units_files([ClockGate()], cells=True)["coincid_clock_gate.v"]
    said = simulated(tmp_path, gate, GATE.format(test_enable=test_enable))
    assert said.startswith("PASS")
    wanted = int(said.split()[-1])
    assert wanted == 2000 if test_enable else 500 < wanted < 1500
