// SPDX-License-Identifier: Apache-2.0
  // Sensor's ports. No process reads at the moment at which another one writes, so their order does not matter:
  // at a falling edge, the inputs of both buses change; outputs are looked at SETTLE later; the rising edge takes inputs.
  reg clk = 1'b0;
  reg rst = 1'b1;
  reg [19:0] s_axi_awaddr = 0;
  reg [2:0] s_axi_awprot = 0;
  reg s_axi_awvalid = 0;
  wire s_axi_awready;
  reg [31:0] s_axi_wdata = 0;
  reg [3:0] s_axi_wstrb = 0;
  reg s_axi_wvalid = 0;
  wire s_axi_wready;
  wire [1:0] s_axi_bresp;
  wire s_axi_bvalid;
  reg s_axi_bready = 0;
  reg [19:0] s_axi_araddr = 0;
  reg [2:0] s_axi_arprot = 0;
  reg s_axi_arvalid = 0;
  wire s_axi_arready;
  wire [31:0] s_axi_rdata;
  wire [1:0] s_axi_rresp;
  wire s_axi_rvalid;
  reg s_axi_rready = 0;
  wire [64*STREAMS-1:0] tdata;
  wire [STREAMS-1:0] tvalid;
  reg [STREAMS-1:0] tready = 0;
  wire [STREAMS-1:0] tlast;
  wire test_enable = 1'b0;
  wire laser;
  wire [SUBGROUPS-1:0] spad_gate;

  integer checks = 0;
  integer errors = 0;

  task check(input ok, input [63:0] got, input [63:0] wanted);
    begin
      checks = checks + 1;
      if (!ok) begin
        errors = errors + 1;
        $display("FAIL: %h where %h is expected, at time %0t, check %0d", got, wanted, $time, checks);
      end
    end
  endtask

  initial begin
    repeat (TIMEOUT_CYCLES) @(posedge clk);
    $display("FAIL: no end after %0d cycles", TIMEOUT_CYCLES);
    $fatal(1);
  end

  // The argument +waves=FILE writes a waveform of everything (VCD).
  reg [8*256-1:0] wave_file;

  initial begin
    if ($value$plusargs("waves=%s", wave_file)) begin
      $dumpfile(wave_file);
      $dumpvars;
    end
  end

  // Registers.
  localparam [1:0] OKAY = 2'd0;
  localparam [1:0] SLVERR = 2'd2;

  // VALID does not wait for READY, and stays until both are high at a rising edge.
  reg address_taken = 1'b0;
  reg data_taken = 1'b0;
  reg answered = 1'b0;
  reg [1:0] answer = 0;

  task write(input [19:0] address, input [31:0] value, input [1:0] response);
    begin
      @(negedge clk);
      s_axi_awaddr = address;
      s_axi_wdata = value;
      s_axi_wstrb = 4'hf;
      s_axi_awvalid = 1'b1;
      s_axi_wvalid = 1'b1;
      while (s_axi_awvalid || s_axi_wvalid) begin
        #SETTLE;
        address_taken = s_axi_awready;
        data_taken = s_axi_wready;
        @(negedge clk);
        if (address_taken) s_axi_awvalid = 1'b0;
        if (data_taken) s_axi_wvalid = 1'b0;
      end
      s_axi_bready = 1'b1;
      answered = 1'b0;
      while (!answered) begin
        #SETTLE;
        answered = s_axi_bvalid;
        answer = s_axi_bresp;
        @(negedge clk);
      end
      s_axi_bready = 1'b0;
      check(answer === response, {62'd0, answer}, {62'd0, response});
    end
  endtask

  reg [31:0] data = 0;

  task read(input [19:0] address);
    begin
      @(negedge clk);
      s_axi_araddr = address;
      s_axi_arvalid = 1'b1;
      while (s_axi_arvalid) begin
        #SETTLE;
        address_taken = s_axi_arready;
        @(negedge clk);
        if (address_taken) s_axi_arvalid = 1'b0;
      end
      s_axi_rready = 1'b1;
      answered = 1'b0;
      while (!answered) begin
        #SETTLE;
        answered = s_axi_rvalid;
        answer = s_axi_rresp;
        data = s_axi_rdata;
        @(negedge clk);
      end
      s_axi_rready = 1'b0;
      check(answer === OKAY, {62'd0, answer}, {62'd0, OKAY});
    end
  endtask

  task expect_register(input [19:0] address, input [31:0] value);
    begin
      read(address);
      check(data === value, {32'd0, data}, {32'd0, value});
    end
  endtask

  // Frames follow one another. Tables hold all of them: those of frame f begin at NAME_from[f].
  integer frame = 0;

  // Streams. Beats of stream s of the frame are expected[first[k]] to expected[first[k + 1] - 1] with k = frame * STREAMS + s.
  integer received [0:STREAMS-1];
  integer slot;

  task take(input integer s, input integer begins, input integer ends);
    if (tready[s] && tvalid[s]) begin
      if (begins + received[s] < ends) begin
        check(tdata[64*s+:64] === expected[begins + received[s]], tdata[64*s+:64], expected[begins + received[s]]);
      end
      received[s] = received[s] + 1;
      check(tlast[s] === (begins + received[s] == ends), {63'd0, tlast[s]}, {63'd0, begins + received[s] == ends});
    end
  endtask

  // The frame: cycle 0 is the one in which `laser` goes high for the first time.
  integer cycle = -1;  // counts at falling edges, and ends with a rising one
  integer stream;
  integer complete;
  reg whole = 1'b0;  // every stream has sent what is expected of it

  initial for (stream = 0; stream < STREAMS; stream = stream + 1) received[stream] = 0;

  always @(negedge clk) begin
    if (cycle >= 0) cycle = cycle + 1;
    else if (laser) cycle = 0;
    tready = {STREAMS{cycle >= 0 && (cycle >= STALL_CYCLES || cycle % STALL_EVERY != 0)}};
    #SETTLE;
    complete = 0;
    for (stream = 0; stream < STREAMS; stream = stream + 1) begin
      slot = frame * STREAMS + stream;
      take(stream, first[slot], first[slot + 1]);
      if (first[slot] + received[stream] == first[slot + 1]) complete = complete + 1;
    end
    whole = complete == STREAMS;
  end

  // Light: at `flip_time` (its unit depends on the bench), the line `flip_line` of port `flip_port` changes.
  reg [LINES-1:0] spad [0:PORTS-1];
  integer next = 0;
  integer port;

  initial for (port = 0; port < PORTS; port = port + 1) spad[port] = 0;

  task flip;
    begin
      spad[flip_port[next]][flip_line[next]] = !spad[flip_port[next]][flip_line[next]];
      next = next + 1;
    end
  endtask

  // The test itself.
  integer k;

  task play_frame;
    begin
      for (k = setting_from[frame]; k < setting_from[frame+1]; k = k + 1) begin
        write(setting[k][51:32], setting[k][31:0], OKAY);
      end
      write(PERIOD, 32'd0, SLVERR);
      expect_register(STATUS, BAD_VALUE);
      write(STATUS, BAD_VALUE, OKAY);
      write(CONTROL, START, OKAY);
      while (!whole) @(negedge clk);
      repeat (50) @(negedge clk);
      expect_register(STATUS, DONE);
      for (k = counter_from[frame]; k < counter_from[frame+1]; k = k + 1) begin
        expect_register(counter[k][51:32], counter[k][31:0]);
      end
      check(whole, 64'd0, 64'd1);
    end
  endtask

  task next_frame;
    begin
      @(posedge clk);
      frame = frame + 1;
      cycle = -1;
      whole = 1'b0;
      for (k = 0; k < STREAMS; k = k + 1) received[k] = 0;
    end
  endtask

  initial begin
    repeat (8) @(negedge clk);
    rst = 1'b0;
    repeat (8) @(negedge clk);
    for (k = 0; k < CONSTANTS; k = k + 1) expect_register(constant[k][51:32], constant[k][31:0]);
    play_frame;
    while (frame + 1 < FRAMES) begin
      write(STATUS, DONE, OKAY);
      next_frame;
      play_frame;
    end
    if (errors == 0) begin
      $display("PASS: %0d checks", checks);
      $finish;
    end else begin
      $display("FAIL: %0d of %0d checks", errors, checks);
      $fatal(1);
    end
  end
