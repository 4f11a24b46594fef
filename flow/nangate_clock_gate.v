// SPDX-License-Identifier: Apache-2.0
// The clock gate at the root of a subgroup in NanGate 45 nm: the library's largest, which drives some 200 clock pins.

module coincid_clock_gate (
    input  clk,
    input  rst,
    input  enable,
    output gated
);
  CLKGATE_X8 gate (
      .CK (clk),
      .E  (enable),
      .GCK(gated)
  );
endmodule
