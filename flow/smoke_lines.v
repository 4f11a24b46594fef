// SPDX-License-Identifier: Apache-2.0
`timescale 1ps / 1fs

// Smoke test of coincid_sensor: prints PASS, or FAIL and why. The expected words are the golden model's.
module coincid_smoke;
  `include "smoke_tables.vh"

  localparam real HALF_PS = CLOCK_FS / 2000.0;
  localparam real SETTLE = HALF_PS / 2.0;

  `include "smoke_bench.vh"

  always #(HALF_PS) clk = !clk;

  // Lines rise at their own times: `flip_time` counts femtoseconds from the start of cycle 0, which is known in its middle.
  realtime begun_ps;

  initial begin
    @(negedge clk);
    while (laser !== 1'b1) @(negedge clk);
    begun_ps = $realtime - HALF_PS;
    while (next < flip_from[FRAMES]) begin
      #(begun_ps + flip_time[next] / 1000.0 - $realtime);
      flip;
    end
  end

  `include "smoke_sensor.vh"
endmodule
