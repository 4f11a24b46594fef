// SPDX-License-Identifier: Apache-2.0
// Black boxes of the asynchronous front end's macros, for synthesis. Behaviour: async_cells.v; requirements: docs/async.md.

`ifdef SYNTHESIS
(* blackbox *)
module coincid_phases #(
  parameter PHASES = 32, parameter CLOCK_FS = 2000000, parameter LAG_FS = 0, parameter [32*PHASES-1:0] MISMATCH_FS = 0
) (input clk, output [PHASES/2-1:0] phases, output mark, output shut, output wipe);
endmodule

(* blackbox *)
module coincid_window #(
  parameter PHASES = 32, parameter BITS = 8, parameter CLOCK_FS = 2000000, parameter LINE = 0, parameter GAIN_PPM = 0
) (input start, input [BITS-1:0] ticks, input [PHASES/2-1:0] phases, output ended);
endmodule

(* blackbox *)
module coincid_delay #(parameter DELAY_FS = 0) (input a, output y);
endmodule

(* blackbox *)
module coincid_mutex #(parameter TIE_FS = 0, parameter DELAY_FS = 0) (input a, input b, output second);
endmodule
`endif
