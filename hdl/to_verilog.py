# SPDX-License-Identifier: Apache-2.0
"""From Yosys's own language to Verilog, with the passes of Amaranth's back end.

Every design gets a fresh Yosys, because the order of the output depends on what Yosys has read before.
"""

import os
import tempfile
from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from ..tools.wheels import run_yosys

ATTRIBUTES = ("generator", "top", "src", "amaranth.hierarchy", "amaranth.decoding")  # that the Verilog leaves out
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


def to_verilog(designs: Iterable[str]) -> list[str]:
    """Return the Verilog of each design, on all cores. Raises `ToolchainError` with Yosys's message."""
    with ThreadPoolExecutor(os.cpu_count() or 1) as pool:
        return list(pool.map(_converted, designs))


def _converted(design: str) -> str:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / DESIGN).write_text(design, encoding="utf-8")
        run_yosys(folder, *SCRIPT)
        return (folder / VERILOG).read_text(encoding="utf-8")
