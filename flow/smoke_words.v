// SPDX-License-Identifier: Apache-2.0
// Smoke test of coincid_sensor: prints PASS, or FAIL and why. The expected words are the golden model's.
module coincid_smoke;
  localparam SETTLE = 1;

  `include "smoke_tables.vh"
  `include "smoke_bench.vh"

  always #2 clk = !clk;

  // Words of edges: a bit is high for a cycle. `flip_time` counts cycles. The ports change at the falling edge that counts,
  // by nonblocking assignments: in old versions of Verilator the sensor would not see other changes.
  integer coming;
  always @(posedge clk) begin
    #SETTLE;
    coming = cycle + 1;
    while (next < flip_from[frame+1] && flip_time[next] == {32'd0, coming}) flip;
  end

  reg [LINES-1:0] at_port [0:PORTS-1];
  genvar p;
  generate
    for (p = 0; p < PORTS; p = p + 1) begin : port_words
      initial at_port[p] = 0;
      always @(negedge clk) at_port[p] <= spad[p];
    end
  endgenerate

  `include "smoke_sensor.vh"
endmodule
