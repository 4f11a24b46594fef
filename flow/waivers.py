# SPDX-License-Identifier: Apache-2.0
"""Warnings of Verilator's lint that generated Verilog may cause, each with its reason, as a control file."""

from typing import NamedTuple

from ..hdl.front_end_views import View

CONTROL_FILE = "coincid.vlt"


class Waiver(NamedTuple):
    """A warning that is expected. rule: its name in Verilator; files, message: patterns."""

    rule: str
    reason: str
    files: str = "*"
    message: str = "*"


_REGISTERS = "*coincid_registers.v"
WAIVERS = (
    Waiver("PROCASSINIT", "a register's initial value is its reset value, so that simulation starts as after a reset"),
    Waiver(
        "UNUSEDSIGNAL",
        "the generator names every field and reads through wires of its own; the names are for waveforms",
    ),
    Waiver("CASEINCOMPLETE", "the generator assigns the default ahead of the case statement"),
    Waiver("WIDTHEXPAND", "operands of different widths: the source language extends the shorter one, as Verilog does"),
    Waiver("WIDTHTRUNC", "a comparison with 0 is written as !vector", message="Logical operator LOGNOT*"),
    Waiver("UNSIGNED", "range checks come from the register table, also where the lowest value is 0", _REGISTERS),
    Waiver("CMPCONST", "range checks come from the register table, also where every value is legal", _REGISTERS),
    Waiver("DECLFILENAME", "the library's FIFO stands in the file of the block that uses it", "*coincid_readout_*.v"),
    Waiver("LATCH", "memories of latches, and the latch of a clock gate", "*cells/coincid_*.v"),
    Waiver("BLKSEQ", "a test bench does one thing after the other", "*_smoke.v"),
    Waiver(
        "ASCRANGE",
        "a counter of one value (no re-arm gap, a FIFO of one place) has no bits; nothing reads it",
        message="*[-1:0]*",
    ),
)
_PARTS = "the library's parts stand in the file of the block that uses them"
_PLL = "the chip's PLL has a name of its own, and dividers that its model does not need"
OF_EMULATOR = (  # more, in the emulator
    *(Waiver(rule, "as in the sensor's registers", "*coincid_emulator_control.v") for rule in ("UNSIGNED", "CMPCONST")),
    Waiver("CMPCONST", "a read may have as many words as its count can say", "*coincid_serial_bridge.v"),
    *(
        Waiver("DECLFILENAME", _PARTS, f"*coincid_{block}.v")
        for block in ("deframer", "framer", "serial_bridge", "uart_receiver", "lights")
    ),
    *(Waiver(rule, _PLL, "*ecp5_pll.v") for rule in ("DECLFILENAME", "UNUSEDPARAM")),
    Waiver("VARHIDDEN", "the library's CRC has a port of its own name", "*framer.v"),
    Waiver("WIDTHTRUNC", "a part of a word is written as a shift", "*coincid_frame_buffer.v", "Operator ASSIGNW*"),
)
OF_CELLS = (  # more, where a view has cells and macros
    Waiver("DECLFILENAME", "cells and macros of the asynchronous view stand together", "*async_*.v"),
    Waiver("UNDRIVEN", "a black box drives nothing", "*async_macros.v"),
    Waiver("UNUSEDPARAM", "delays and errors of cells and macros are for simulation", "*async_*.v"),
)


def control_file(view: View, emulator: bool = False) -> str:
    """Return the waivers of a view of `front_end_views.py` in Verilator's language. emulator: also those of the emulator."""
    lines = ["`verilator_config"]
    for rule, reason, files, message in WAIVERS + OF_EMULATOR * emulator + (OF_CELLS if view.macros else ()):
        lines += [f"// {reason}", f'lint_off -rule {rule} -file "{files}" -match "{message}"']
    return "\n".join(lines) + "\n"
