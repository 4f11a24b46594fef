// SPDX-License-Identifier: Apache-2.0
// Flip-flops and latches of the netlists: their initial values are random, and they take a random value for an unknown input.

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
  \$_DFF_P_ flop (
      .D(D),
      .C(CK),
      .Q(Q)
  );
  assign QN = ~Q;
endmodule

module DLH_X1 (
    input D,
    input G,
    output reg Q
);
  initial Q = $random;
  always @* if (G) Q = D === 1'b0 || D === 1'b1 ? D : $random;
endmodule
