// Flip-flops of the netlists: they wake up at random, and take an unknown input at random.

module \$_DFF_P_ (
    input D,
    input C,
    output reg Q
);
  initial Q = $random;
  always @(posedge C) Q <= D === 1'b0 || D === 1'b1 ? D : $random;
endmodule

module DFFPOSX1 (
    input D,
    input CLK,
    output Q
);
  \$_DFF_P_ flop (
      .D(D),
      .C(CLK),
      .Q(Q)
  );
endmodule
