// SPDX-License-Identifier: Apache-2.0
// Single edges of all pixels in turn, for Icarus: prints pixel, time of the edge in ps, and its stamp.
`timescale 1ps / 1fs
module async_skew;
  parameter EVENTS = 480;

  `include "front.vh"
  `include "async_quiet.vh"

  integer n, seed = 3;
  real wait_ps, edge_ps;

  initial begin
    wake;
    for (n = 0; n < EVENTS; n = n + 1) begin
      wait_ps = $urandom(seed) % CLOCK_FS / 1000.0;
      #(wait_ps);
      spad[n % PIXELS] = 1;
      edge_ps = $realtime;
      #5 spad[n % PIXELS] = 0;
      wait (closed);
      @(negedge clk) $display("%0d %0.3f %0d", n % PIXELS, edge_ps, stamp);
      repeat (2) @(posedge clk);
    end
    $finish;
  end
endmodule
