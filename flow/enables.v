// SPDX-License-Identifier: Apache-2.0
// Flip-flops with a synchronous reset and an enable as flip-flops with an enable only, which is what a clock gate needs.
// The characters of a type's name are polarities: of clock, reset, the reset's value, enable. In the types with CE, the reset
// acts only while the flip-flop is enabled.

(* techmap_celltype = "$_SDFFE_PP0P_ $_SDFFE_PP1P_ $_SDFFE_PP0N_ $_SDFFE_PP1N_ $_SDFFCE_PP0P_ $_SDFFCE_PP1P_ $_SDFFCE_PP0N_ $_SDFFCE_PP1N_" *)
module reset_and_enable (
    input  D,
    input  C,
    input  R,
    input  E,
    output Q
);
  parameter _TECHMAP_CELLTYPE_ = "";
  wire enable = _TECHMAP_CELLTYPE_[15:8] == "N" ? ~E : E;
  wire value = _TECHMAP_CELLTYPE_[23:16] == "1" ? D | R : D & ~R;
  \$_DFFE_PP_ flop (
      .D(value),
      .C(C),
      .E(_TECHMAP_CELLTYPE_[63:56] == "C" ? enable : enable | R),
      .Q(Q)
  );
endmodule

module \$_DFFE_PN_ (
    input  D,
    input  C,
    input  E,
    output Q
);
  \$_DFFE_PP_ flop (
      .D(D),
      .C(C),
      .E(~E),
      .Q(Q)
  );
endmodule
