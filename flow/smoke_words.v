// SPDX-License-Identifier: Apache-2.0
// Smoke test of coincid_sensor: prints PASS, or FAIL and why. The expected words are the golden model's.
module coincid_smoke;
  localparam SETTLE = 1;

  `include "smoke_tables.vh"
  `include "smoke_bench.vh"

  always #2 clk = !clk;

  // Words of edges: a bit is high for a cycle. `flip_time` counts cycles. Words change after the falling edge has counted.
  always @(negedge clk) begin
    #SETTLE;
    while (cycle >= 0 && next < FLIPS && flip_time[next] == {32'd0, cycle}) flip;
  end

  `include "smoke_sensor.vh"
endmodule
