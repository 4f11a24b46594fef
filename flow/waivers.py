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

OF_CELLS = (  # additional ones for a view with cells and macros
    ("DECLFILENAME", "*async_*.v", "*", "cells and macros of the asynchronous view stand together"),
    ("UNDRIVEN", "*async_macros.v", "*", "a black box drives nothing"),
    ("UNUSEDPARAM", "*async_*.v", "*", "delays and errors of cells and macros are for simulation"),
)


def control_file(view: View) -> str:
    """Return the waivers of a view from `views.py` in Verilator's language."""
    lines = ["`verilator_config"]
    for rule, files, message, reason in WAIVERS + (OF_CELLS if view.macros else ()):
        lines += [f"// {reason}", f'lint_off -rule {rule} -file "{files}" -match "{message}"']
    return "\n".join(lines) + "\n"
