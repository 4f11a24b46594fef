// SPDX-License-Identifier: Apache-2.0
  // A frame without end, with all pixels on and windows of one tick.
  task wake;
    begin
      mask = {PIXELS{1'b1}};
      gate = 1;
      running = 1;
      may_open = 1;
      window_ticks = 1;
      repeat (4) @(posedge clk);
      rst = 0;
      repeat (8) @(posedge clk);
      start_tdc = 1;
      @(posedge clk);
      start_tdc = 0;
      repeat (12) @(posedge clk);
    end
  endtask
