// SPDX-License-Identifier: Apache-2.0
// A generator with mismatched taps, and a sampling line, for Icarus: prints the phases that the line samples at random times.
`timescale 1ps / 1fs
module async_tdc;
  parameter PHASES = 32;
  parameter CLOCK_FS = 2000000;
  parameter LAG_FS = 0;
  parameter ERROR_BITS = 32;
  parameter [ERROR_BITS*PHASES-1:0] MISMATCH_FS = 0;
  parameter EVENTS = 40000;

  localparam real CYCLE_PS = CLOCK_FS / 1000.0;

  reg clk = 0, hit = 0;
  wire [PHASES/2-1:0] phases, code;
  wire mark, shut, wipe;
  integer n, seed = 7;

  always #(CYCLE_PS / 2) clk = ~clk;

  coincid_phases #(
    .PHASES(PHASES),
    .CLOCK_FS(CLOCK_FS),
    .LAG_FS(LAG_FS),
    .MISMATCH_FS(MISMATCH_FS)
  ) generator (clk, phases, mark, shut, wipe);
  coincid_sample #(.WIDTH(PHASES / 2)) line (hit, phases, code);

  initial begin
    #(4 * CYCLE_PS);
    for (n = 0; n < EVENTS; n = n + 1) begin
      #(CYCLE_PS + $urandom(seed) % CLOCK_FS / 1000.0) hit = 1;
      #1 $display("%b", code);
      hit = 0;
    end
    $finish;
  end
endmodule
