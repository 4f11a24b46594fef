// SPDX-License-Identifier: Apache-2.0
// The board's netlist behind the ports of the emulator, for simulation.
module ulx3s_bench (
  input clk,
  input rst,
  input rx,
  output tx,
  output [7:0] led
);
  wire wifi_gpio0;
  coincid_emulator_ulx3s board (
    .clk_25mhz(clk), .btn_fire1(rst), .ftdi_txd(rx), .ftdi_rxd(tx), .led(led), .wifi_gpio0(wifi_gpio0)
  );
endmodule
