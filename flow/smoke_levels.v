// SPDX-License-Identifier: Apache-2.0
// Smoke test of coincid_fpga: prints PASS, or FAIL and why. The expected words are the golden model's.
module coincid_fpga_smoke;
  localparam SETTLE = 1;

  `include "smoke_tables.vh"
  `include "smoke_bench.vh"

  // Clock j is high from tick j of a cycle for half a cycle; two units of time are a tick.
  reg [PHASES/2-2:0] phase_clocks = 0;
  integer tick = 0;
  integer now = -1;  // ticks from the beginning of cycle 0
  integer j;

  // Levels change in the middle of a tick. `flip_time` counts ticks; the first falling edge of cycle 0 sets their clock.
  always begin
    #1;
    if (cycle < 0) now = -1;
    else if (now < 0 && cycle == 0) now = PHASES / 2;
    while (now >= 0 && next < flip_from[frame+1] && flip_time[next] == {32'd0, now}) flip;
    #1;
    tick = tick + 1;
    if (now >= 0) now = now + 1;
    clk = tick % PHASES < PHASES / 2;
    for (j = 1; j < PHASES / 2; j = j + 1) phase_clocks[j-1] = (tick + PHASES - j) % PHASES < PHASES / 2;
  end

  `include "smoke_sensor.vh"
endmodule
