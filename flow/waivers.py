# SPDX-License-Identifier: Apache-2.0
"""Warnings of Verilator's lint that generated Verilog may cause, each with its reason, as a control file."""

from ..hdl.views import View

CONTROL_FILE = "coincid.vlt"
WAIVERS = (  # (rule, files, message, reason)
    (
        "PROCASSINIT",
        "*",
        "*",
        "a register's initial value is its reset value, so that simulation starts as after a reset",
    ),
    (
        "UNUSEDSIGNAL",
        "*",
        "*",
        "the generator names every field and reads through wires of its own; the names are for waveforms",
    ),
    ("CASEINCOMPLETE", "*", "*", "the generator assigns the default ahead of the case statement"),
    (
        "WIDTHEXPAND",
        "*",
        "*",
        "operands of different widths: the source language extends the shorter one, as Verilog does",
    ),
    ("WIDTHTRUNC", "*", "Logical operator LOGNOT*", "a comparison with 0 is written as !vector"),
    (
        "UNSIGNED",
        "*coincid_registers.v",
        "*",
        "range checks come from the register table, also where the lowest value is 0",
    ),
    (
        "CMPCONST",
        "*coincid_registers.v",
        "*",
        "range checks come from the register table, also where every value is legal",
    ),
    ("DECLFILENAME", "*coincid_readout_*.v", "*", "the library's FIFO stands in the file of the block that uses it"),
    ("BLKSEQ", "*_smoke.v", "*", "a test bench does one thing after the other"),
    (
        "ASCRANGE",
        "*",
        "*[-1:0]*",
        "a counter of one value (no re-arm gap, a FIFO of one place) has no bits; nothing reads it",
    ),
)

OF_EMULATOR = (  # more, in the emulator
    *((rule, "*coincid_emulator_control.v", "*", "as in the sensor's registers") for rule in ("UNSIGNED", "CMPCONST")),
    ("CMPCONST", "*coincid_serial_bridge.v", "*", "a read may have as many words as its count can say"),
    *(
        (
            "DECLFILENAME",
            f"*coincid_{block}.v",
            "*",
            "the library's parts stand in the file of the block that uses them",
        )
        for block in ("deframer", "framer", "serial_bridge", "uart_receiver", "lights")
    ),
    *(
        (rule, "*ecp5_pll.v", "*", "the chip's PLL has a name of its own, and dividers that its model does not need")
        for rule in ("DECLFILENAME", "UNUSEDPARAM")
    ),
    ("VARHIDDEN", "*framer.v", "*", "the library's CRC has a port of its own name"),
    ("WIDTHTRUNC", "*coincid_frame_buffer.v", "Operator ASSIGNW*", "a part of a word is written as a shift"),
)
OF_CELLS = (  # more, where a view has cells and macros
    ("DECLFILENAME", "*async_*.v", "*", "cells and macros of the asynchronous view stand together"),
    ("UNDRIVEN", "*async_macros.v", "*", "a black box drives nothing"),
    ("UNUSEDPARAM", "*async_*.v", "*", "delays and errors of cells and macros are for simulation"),
)


def control_file(view: View, emulator: bool = False) -> str:
    """The waivers of a view of `views.py` in Verilator's language. emulator: with that around it."""
    lines = ["`verilator_config"]
    for rule, files, message, reason in WAIVERS + OF_EMULATOR * emulator + (OF_CELLS if view.macros else ()):
        lines += [f"// {reason}", f'lint_off -rule {rule} -file "{files}" -match "{message}"']
    return "\n".join(lines) + "\n"
