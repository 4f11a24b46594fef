// SPDX-License-Identifier: Apache-2.0
// The ECP5's PLL for simulation and lint: it hands the clock on, and locks some cycles later.
module EHXPLLL #(
  parameter CLKI_DIV = 1, parameter CLKFB_DIV = 1, parameter FEEDBK_PATH = "CLKOP",
  parameter CLKOP_ENABLE = "ENABLED", parameter CLKOP_DIV = 1, parameter CLKOP_CPHASE = 0, parameter CLKOP_FPHASE = 0
) (
  input CLKI, CLKFB, RST, STDBY, PHASESEL0, PHASESEL1, PHASEDIR, PHASESTEP, PHASELOADREG, PLLWAKESYNC, ENCLKOP,
  output CLKOP, LOCK
);
  reg [3:0] cycles = 0;
  assign CLKOP = CLKI;
  assign LOCK = cycles == 15;
  always @(posedge CLKI) if (!LOCK) cycles <= cycles + 1;
endmodule
