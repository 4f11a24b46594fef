// SPDX-License-Identifier: Apache-2.0
// The sensor of the FPGA preset on an ECP5: one PLL makes the 125 MHz clock and the deserialisers' clocks, 1 ns apart.
module coincid_ecp5 (
  input clk_in,  // 125 MHz
  input rst_in,
  input [127:0] spad,
  output laser,
  output [1:0] spad_gate,
  input [19:0] s_axi_awaddr,
  input s_axi_awvalid,
  output s_axi_awready,
  input [31:0] s_axi_wdata,
  input [3:0] s_axi_wstrb,
  input s_axi_wvalid,
  output s_axi_wready,
  output [1:0] s_axi_bresp,
  output s_axi_bvalid,
  input s_axi_bready,
  input [19:0] s_axi_araddr,
  input s_axi_arvalid,
  output s_axi_arready,
  output [31:0] s_axi_rdata,
  output [1:0] s_axi_rresp,
  output s_axi_rvalid,
  input s_axi_rready,
  output [63:0] m_axis_tdata,
  output m_axis_tvalid,
  input m_axis_tready,
  output m_axis_tlast
);
  wire clk;
  wire [2:0] phase_clocks;
  wire locked;

  // 500 MHz in the oscillator; an eighth of its period is a step of the fine phase: 1 ns is half a period, 4 steps.
  EHXPLLL #(
    .CLKI_DIV(1), .CLKFB_DIV(1), .FEEDBK_PATH("CLKOP"),
    .CLKOP_ENABLE("ENABLED"), .CLKOP_DIV(4), .CLKOP_CPHASE(3), .CLKOP_FPHASE(0),
    .CLKOS_ENABLE("ENABLED"), .CLKOS_DIV(4), .CLKOS_CPHASE(3), .CLKOS_FPHASE(4),
    .CLKOS2_ENABLE("ENABLED"), .CLKOS2_DIV(4), .CLKOS2_CPHASE(4), .CLKOS2_FPHASE(0),
    .CLKOS3_ENABLE("ENABLED"), .CLKOS3_DIV(4), .CLKOS3_CPHASE(4), .CLKOS3_FPHASE(4)
  ) pll (
    .CLKI(clk_in), .CLKFB(clk), .RST(1'b0), .STDBY(1'b0), .PHASESEL0(1'b0), .PHASESEL1(1'b0), .PHASEDIR(1'b0), .PHASESTEP(1'b0),
    .PHASELOADREG(1'b0), .PLLWAKESYNC(1'b0), .ENCLKOP(1'b0),
    .CLKOP(clk), .CLKOS(phase_clocks[0]), .CLKOS2(phase_clocks[1]), .CLKOS3(phase_clocks[2]), .LOCK(locked)
  );

  reg [1:0] reset = 2'b11;
  always @(posedge clk) reset <= {reset[0], rst_in | ~locked};

  coincid_fpga sensor (
    .clk(clk), .rst(reset[1]), .phase_clocks(phase_clocks), .line_0(spad[63:0]), .line_1(spad[127:64]),
    .laser(laser), .spad_gate(spad_gate), .test_enable(1'b0),
    .s_axi_awaddr(s_axi_awaddr), .s_axi_awprot(3'd0), .s_axi_awvalid(s_axi_awvalid), .s_axi_awready(s_axi_awready),
    .s_axi_wdata(s_axi_wdata), .s_axi_wstrb(s_axi_wstrb), .s_axi_wvalid(s_axi_wvalid), .s_axi_wready(s_axi_wready),
    .s_axi_bresp(s_axi_bresp), .s_axi_bvalid(s_axi_bvalid), .s_axi_bready(s_axi_bready),
    .s_axi_araddr(s_axi_araddr), .s_axi_arprot(3'd0), .s_axi_arvalid(s_axi_arvalid), .s_axi_arready(s_axi_arready),
    .s_axi_rdata(s_axi_rdata), .s_axi_rresp(s_axi_rresp), .s_axi_rvalid(s_axi_rvalid), .s_axi_rready(s_axi_rready),
    .m_axis_tdata(m_axis_tdata), .m_axis_tvalid(m_axis_tvalid), .m_axis_tready(m_axis_tready), .m_axis_tlast(m_axis_tlast)
  );
endmodule
