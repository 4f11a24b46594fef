// SPDX-License-Identifier: Apache-2.0
// Windows, for Icarus: prints the beginning and the end of each in ps. LINE, GAIN_PPM: as in coincid_window.
`timescale 1ps / 1fs
module async_window;
  parameter PHASES = 32;
  parameter CLOCK_FS = 2000000;
  parameter LINE = 0;
  parameter GAIN_PPM = 0;
  parameter TICKS = 128;
  parameter STARTS = 400;

  localparam real CYCLE_PS = CLOCK_FS / 1000.0;

  reg clk = 0, start = 0;
  wire [PHASES/2-1:0] phases;
  wire mark, shut, wipe, ended;
  integer n, seed = 5;
  real begun_ps;

  always #(CYCLE_PS / 2) clk = ~clk;

  coincid_phases #(
    .PHASES(PHASES),
    .CLOCK_FS(CLOCK_FS)
  ) generator (clk, phases, mark, shut, wipe);
  coincid_window #(
    .PHASES(PHASES),
    .CLOCK_FS(CLOCK_FS),
    .LINE(LINE),
    .GAIN_PPM(GAIN_PPM)
  ) dut (start, TICKS[7:0], phases, ended);

  initial begin
    #(4 * CYCLE_PS);
    for (n = 0; n < STARTS; n = n + 1) begin
      #(CYCLE_PS + $urandom(seed) % CLOCK_FS / 1000.0) start = 1;
      begun_ps = $realtime;
      @(posedge ended) $display("%0.3f %0.3f", begun_ps, $realtime);
      #1 start = 0;
    end
    $finish;
  end
endmodule
