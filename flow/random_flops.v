// SPDX-License-Identifier: Apache-2.0
// Flip-flops, latches and clock gates of the netlists: their initial values are random, and they take a random value for an unknown input.
// Where a simulation has delays, theirs come from its SDF file.

module \$_DFF_P_ (
    input D,
    input C,
    output reg Q
);
  initial Q = $random;
  always @(posedge C) Q <= D === 1'b0 || D === 1'b1 ? D : $random;
endmodule

module DFF_X1 (
    input D,
    input CK,
    output Q,
    output QN
);
  wire state;
  \$_DFF_P_ flop (
      .D(D),
      .C(CK),
      .Q(state)
  );
  buf (Q, state);
  not (QN, state);
  specify
    (posedge CK => (Q +: D)) = (0, 0);
    (posedge CK => (QN -: D)) = (0, 0);
  endspecify
endmodule

module DLH_X1 (
    input D,
    input G,
    output Q
);
  reg state;
  initial state = $random;
  always @* if (G) state = D === 1'b0 || D === 1'b1 ? D : $random;
  buf (Q, state);
  specify
    (D => Q) = (0, 0);
    (posedge G => (Q +: D)) = (0, 0);
  endspecify
endmodule

module random_clock_gate (
    input  CK,
    input  E,
    output GCK
);
  reg state;
  initial state = $random;
  always @* if (!CK) state = E === 1'b0 || E === 1'b1 ? E : $random;
  and (GCK, CK, state);
endmodule

`define CLOCK_GATE(name) \
module name ( \
    input  CK, \
    input  E, \
    output GCK \
); \
  random_clock_gate gate ( \
      .CK (CK), \
      .E  (E), \
      .GCK(GCK) \
  ); \
endmodule

`CLOCK_GATE(CLKGATE_X1)
`CLOCK_GATE(CLKGATE_X2)
`CLOCK_GATE(CLKGATE_X4)
`CLOCK_GATE(CLKGATE_X8)
