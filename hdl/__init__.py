"""The sensor in Amaranth, one block a file, and its emission as Verilog."""
