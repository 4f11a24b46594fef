// SPDX-License-Identifier: Apache-2.0
// Stress test of the asynchronous front end, for Icarus: random edges at every scale, and checks of every word.
//
// +edges=N: number of edges; +seed=N. Prints the counts as one line of JSON.
`timescale 1ps / 1fs
module async_stress;
  `include "front.vh"

  localparam PERIOD_CYCLES = 64;
  localparam TICK_FS = CLOCK_FS / PHASES;
  localparam real HALF_PS = CLOCK_FS / 2 / 1000.0;
  localparam real TICK_PS = TICK_FS / 1000.0;
  localparam real HIGH_PS = TICK_FS / 8 / 1000.0;  // an edge
  localparam real SHORTEST_PS = 0.001;

  integer wanted, seed, edges = 0, windows = 0, records = 0, wrong = 0, locked = 0, resets = 0, blinds = 0;
  integer quiet = 0, cycle = 0, since = 0;
  reg bright = 0;
  reg [2:0] light = 4;

  // Random edges, up to the requested number; then, at rest, a single edge that must give a word.
  initial begin
    if (!$value$plusargs("edges=%d", wanted)) wanted = 10000;
    if (!$value$plusargs("seed=%d", seed)) seed = 1;
    repeat (4) @(posedge clk);
    rst <= 0;
    bright = 1;
    wait (edges >= wanted);
    bright = 0;
    gate <= 1;
    mask <= {PIXELS{1'b1}};
    repeat (4 * PERIOD_CYCLES) @(posedge clk);
    wait (cycle == 8);
    quiet = windows;
    #(HALF_PS / 2) spad[PIXELS-1] = 1;
    #10 spad[PIXELS-1] = 0;
    repeat (PERIOD_CYCLES / 2) @(posedge clk);
    if (windows != quiet + 1 || hits != {1'b1, {PIXELS - 1{1'b0}}} || winner != PIXELS - 1) locked = locked + 1;
    $write("{\"edges\": %0d, \"windows\": %0d, \"records\": %0d, ", edges, windows, records);
    $write("\"blind_cycles\": %0d, \"resets\": %0d, ", blinds, resets);
    $display("\"wrong\": %0d, \"locked\": %0d}", wrong, locked);
    $finish;
  end

  genvar p;
  generate
    for (p = 0; p < PIXELS; p = p + 1) begin : pixel
      real gap_ps;
      always begin
        case ($urandom(seed) % 8)
          0: gap_ps = $urandom(seed) % 200 / 1000.0 + SHORTEST_PS;  // within a burst
          1: gap_ps = $urandom(seed) % (4 * TICK_FS) / 1000.0 + SHORTEST_PS;  // ticks
          2: gap_ps = HALF_PS * (1 + $floor($realtime / HALF_PS)) - $realtime;  // the clock's next edge
          3: gap_ps = TICK_PS * (1 + $urandom(seed) % PHASES + $floor($realtime / TICK_PS)) - $realtime;  // a tick's border
          // a part of a cycle to many, by the period's light
          default: gap_ps = ($urandom(seed) % (CLOCK_FS / 4) << light) / 1000.0 + SHORTEST_PS;
        endcase
        if (gap_ps < SHORTEST_PS) gap_ps = SHORTEST_PS;
        #(gap_ps);
        if (bright) begin
          spad[p] = 1;
          edges = edges + 1;
          #(HIGH_PS) spad[p] = 0;
        end
      end
    end
  endgenerate

  // A laser period, and the settings that may change between two periods.
  integer k;
  always @(posedge clk) begin
    cycle <= cycle == PERIOD_CYCLES - 1 ? 0 : cycle + 1;
    running <= 1;
    start <= cycle == 0;
    wrap <= cycle == 0;
    may_open <= cycle < PERIOD_CYCLES - GUARD;
    start_tdc <= cycle == 0;
    rst <= 0;
    if (bright && cycle == 0) begin
      window_ticks <= $urandom(seed) % 3 == 0 ? 1 + $urandom(seed) % WINDOW_MAX : 1 + $urandom(seed) % PHASES;
      light <= $urandom(seed);
      for (k = 0; k < PIXELS; k = k + 1) mask[k] <= $urandom(seed) % 8 != 0;
      minigroup_records <= 1;
      mg_threshold <= 1;
      mg_window <= 1 + $urandom(seed) % 4;
      if ($urandom(seed) % 8 == 0) begin
        rst <= 1;
        resets = resets + 1;
      end
    end
    if (bright) gate <= $urandom(seed) % 16 != 0;
    if (cycle == 0 && window_ticks == 0) window_ticks <= 1;
  end

  function [15:0] ones(input [PIXELS-1:0] bits);
    integer i;
    begin
      ones = 0;
      for (i = 0; i < PIXELS; i = i + 1) ones = ones + bits[i];
    end
  endfunction

  // Check every word, and that the wait for one is never too long.
  always @(posedge clk) begin
    since <= closed || !bright || rst ? 0 : since + 1;
    if (since > 4 * PERIOD_CYCLES) begin
      locked = locked + 1;
      since <= 0;
    end
    if (record_due && latched) records = records + 1;
    if (blind) blinds = blinds + 1;
    if (closed && !rst) begin
      windows = windows + 1;
      if (hits == 0 || !hits[winner] || ones(hits) != count) wrong = wrong + 1;
      if (^hits === 1'bx || ^stamp === 1'bx) wrong = wrong + 1;
    end
  end
endmodule
