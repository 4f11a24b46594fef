# SPDX-License-Identifier: Apache-2.0
"""Warnings of Verilator's lint that generated Verilog may cause, each with its reason, as a
control file.

`waivers.vlt` has two parts: for every sensor, and for views with cells and macros. Every supported
Verilator accepts it. With the macro `EXACT`, it waives less, and needs a Verilator that knows
all the warnings' names.
"""

from pathlib import Path

from ..hdl.front_end_views import View

CONTROL_FILE = "coincid.vlt"
EXACT = "COINCID_EXACT_WAIVERS"
OLDEST_VERILATOR = "5.006"
OF_SENSOR, OF_CELLS = (
    Path(__file__).with_name("waivers.vlt").read_text(encoding="utf-8").split("---\n")
)


def control_file(view: View) -> str:
    """Return the waivers of a view in Verilator's language."""
    return OF_SENSOR + OF_CELLS * bool(view.macros)
