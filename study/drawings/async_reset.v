// SPDX-License-Identifier: Apache-2.0
// Single edges around the border of two cycles, for Icarus: prints the number of the offset, of words, and of wrong words.
`timescale 1ps / 1fs
module async_reset;
  parameter EVENTS = 600;
  parameter OFFSETS = 25;
  parameter FIRST_PS = -60;
  parameter STEP_PS = 5;

  `include "front.vh"
  `include "async_quiet.vh"

  localparam PIXEL = 5;
  integer n, words, wrong;

  initial begin
    wake;
    for (n = 0; n < EVENTS; n = n + 1) begin
      @(posedge clk);
      words = 0;
      wrong = 0;
      #(CLOCK_FS / 1000 + FIRST_PS + STEP_PS * (n % OFFSETS)) spad[PIXEL] = 1;
      #3 spad[PIXEL] = 0;
      repeat (14) begin
        @(negedge clk);
        if (closed) begin
          words = words + 1;
          if (hits != 1 << PIXEL || winner != PIXEL || count != 1) wrong = wrong + 1;
        end
      end
      $display("%0d %0d %0d", n % OFFSETS, words, wrong);
    end
    $finish;
  end
endmodule
