# SPDX-License-Identifier: Apache-2.0
"""From Yosys's own language to Verilog, with the passes of Amaranth's back end.

Every design gets a fresh Yosys, because the order of the output depends on what Yosys has read
before.
"""

import tempfile
from pathlib import Path

from ..tools.wheels import run_yosys

# That the Verilog leaves out.
ATTRIBUTES = (
    "generator",
    "top",
    "src",
    "amaranth.hierarchy",
    "amaranth.decoding",
)
LEFT_OUT = " ".join(f"-remove {attribute}" for attribute in ATTRIBUTES)
DESIGN, VERILOG = "design.il", "design.v"
SCRIPT = (
    f"read_rtlil {DESIGN}",
    "proc -nomux -norom",
    "memory_collect",
    f"attrmap {LEFT_OUT}",
    f"attrmap -modattr {LEFT_OUT}",
    f"write_verilog -norename {VERILOG}",
)


def to_verilog(design: str) -> str:
    """Return the Verilog of a design. Raises `ToolchainError` with Yosys's message."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / DESIGN).write_text(design, encoding="utf-8")
        run_yosys(folder, *SCRIPT)
        return (folder / VERILOG).read_text(encoding="utf-8")
