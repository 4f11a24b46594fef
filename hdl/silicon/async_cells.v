// SPDX-License-Identifier: Apache-2.0
// Cells and macros of the asynchronous front end: behavioural models with delays in femtoseconds.
//
// Cells go through synthesis as they are. Every flop of the front end that is not clocked by the system clock is one of
// them, and none contains a latch. Macros (coincid_phases, coincid_window, coincid_delay, coincid_mutex) are drawn by a
// circuit designer; the flow uses their black boxes (async_macros.v). docs/async.md has the requirements on each of them.
// With COINCID_APERTURE_PS defined, a flop takes a random value if its data has changed less than that before its clock edge.

`timescale 1ps / 1fs

// The flop of a SPAD, and the flop that opens a window: set by the edge while armed, until cleared. Edges during the clear are ignored.
module coincid_hit_flop #(parameter DELAY_FS = 0) (input edge_in, input arm, input clear, output reg hit);
`ifdef SYNTHESIS
  always @(posedge edge_in or posedge clear)
    if (clear) hit <= 1'b0;
    else if (arm) hit <= 1'b1;
`else
  initial hit = 1'b0;
`ifdef COINCID_APERTURE_PS   // an edge so soon after `arm` changed or `clear` ended: the flop falls to either side
  real moved;
  initial moved = -1e9;
  always @(arm or negedge clear) moved = $realtime;
`define COINCID_ARMED ($realtime - moved < `COINCID_APERTURE_PS ? $random & 1 : arm)
`else
`define COINCID_ARMED arm
`endif
  always @(posedge edge_in or posedge clear)
    if (clear) hit <= #(DELAY_FS / 1000.0) 1'b0;
    else if (`COINCID_ARMED) hit <= #(DELAY_FS / 1000.0) 1'b1;
`endif
endmodule

// Flops clocked by an event: the sampling line of the TDC, and the snapshot taken at the end of a window.
module coincid_sample #(parameter WIDTH = 1) (input event_in, input [WIDTH-1:0] d, output reg [WIDTH-1:0] q);
`ifndef SYNTHESIS
  initial q = {WIDTH{1'b0}};
`endif
`ifdef COINCID_APERTURE_PS
  genvar i;
  generate for (i = 0; i < WIDTH; i = i + 1) begin : flop
    real moved;
    initial moved = -1e9;
    always @(d[i]) moved = $realtime;
    always @(posedge event_in) q[i] <= $realtime - moved < `COINCID_APERTURE_PS ? $random & 1 : d[i];
  end endgenerate
`else
  always @(posedge event_in) q <= d;
`endif
endmodule

// A node of the OR tree.
module coincid_or2 #(parameter DELAY_FS = 0) (input a, input b, output y);
`ifdef SYNTHESIS
  assign y = a | b;
`else
  assign #(DELAY_FS / 1000.0) y = a | b;
`endif
endmodule

`ifndef SYNTHESIS
// Multiphase generator: PHASES borders per clock cycle from PHASES/2 taps; each tap is high for half a cycle from its border on.
// MISMATCH_FS: signed, 32 bits per border. The strobes sequence the front end: mark falls between two borders.
module coincid_phases #(
  parameter PHASES = 32, parameter CLOCK_FS = 2000000, parameter LAG_FS = 0, parameter [32*PHASES-1:0] MISMATCH_FS = 0
) (input clk, output reg [PHASES/2-1:0] phases, output reg mark, output reg shut, output reg wipe);
  genvar k;
  generate for (k = 0; k < PHASES / 2; k = k + 1) begin : tap
    real rise, fall;
    initial begin
      rise = $signed(MISMATCH_FS[32*k +: 32]);   // alone, so that it stays signed
      fall = $signed(MISMATCH_FS[32*(k + PHASES/2) +: 32]);
      rise = (rise + LAG_FS + CLOCK_FS / PHASES * k) / 1000.0;
      fall = (fall + LAG_FS + CLOCK_FS / PHASES * (k + PHASES/2)) / 1000.0;
      phases[k] = 1'b0;
    end
    always @(posedge clk) begin
      phases[k] <= #(rise) 1'b1;
      phases[k] <= #(fall) 1'b0;
    end
  end endgenerate
  initial begin mark = 0; shut = 0; wipe = 0; end
  always @(posedge clk) begin
    mark <= #((LAG_FS + CLOCK_FS / 4 + CLOCK_FS / PHASES / 2) / 1000.0) 1'b1;
    mark <= #((LAG_FS + CLOCK_FS / 4 * 3) / 1000.0) 1'b0;
    shut <= #(CLOCK_FS / 16 * 9 / 1000.0) 1'b1;
    shut <= #(CLOCK_FS / 16 * 17 / 1000.0) 1'b0;
    wipe <= #(CLOCK_FS / 16 * 12 / 1000.0) 1'b1;
    wipe <= #(CLOCK_FS / 16 * 15 / 1000.0) 1'b0;
  end
endmodule

// Window: `ended` rises `ticks` + PHASES/4 borders after `start`, and falls with it.
// LINE = 1: for the study, a delay line of (ticks - 1/2 + PHASES/4) LSB with an error of GAIN_PPM instead.
module coincid_window #(
  parameter PHASES = 32, parameter BITS = 8, parameter CLOCK_FS = 2000000, parameter LINE = 0, parameter GAIN_PPM = 0
) (input start, input [BITS-1:0] ticks, input [PHASES/2-1:0] phases, output reg ended);
  integer left;
  initial ended = 1'b0;
  generate if (LINE) begin : line
    integer entered, left_line;   // which start: one whose `start` has fallen meanwhile does not end anything
    initial begin entered = 0; left_line = 0; end
    always @(posedge start) begin
      entered = entered + 1;
      left_line <= #(((ticks - 0.5) * (1 + GAIN_PPM * 1e-6) + PHASES / 4) * (CLOCK_FS / PHASES) / 1000.0) entered;
    end
    always @(left_line) if (start && left_line == entered) ended = 1'b1;
    always @(negedge start) ended = 1'b0;
  end else begin : counted
    always begin
      @(posedge start);
      left = ticks + PHASES / 4;
      while (start && left > 0) begin
        @(phases or negedge start);
        left = left - 1;
      end
      if (start) begin
        ended = 1'b1;
        @(negedge start);
        ended = 1'b0;
      end
    end
  end endgenerate
endmodule

// Matched delay: repeats every edge of `a` DELAY_FS later, however close the edges are.
module coincid_delay #(parameter DELAY_FS = 0) (input a, output reg y);
  initial y = 1'b0;
  always @(a) y <= #(DELAY_FS / 1000.0) a;
endmodule

// Mutual exclusion: `second` means that request b came before request a. Requests less than TIE_FS apart count as a tie, which a wins.
module coincid_mutex #(parameter TIE_FS = 0, parameter DELAY_FS = 0) (input a, input b, output second);
  real a_at, b_at;
  initial begin a_at = 0; b_at = 0; end
  always @(posedge a) a_at = $realtime;
  always @(posedge b) b_at = $realtime;
  reg earlier;
  initial earlier = 1'b0;
  always @(a or b or a_at or b_at) earlier <= b & (~a | (b_at + TIE_FS / 1000.0 < a_at));
  assign #(DELAY_FS / 1000.0) second = earlier;
endmodule
`endif
