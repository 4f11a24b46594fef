# SPDX-License-Identifier: Apache-2.0
"""From Yosys's own language to Verilog, with the passes of Amaranth's back end.

Every design gets a fresh Yosys, because the order of the output depends on what Yosys has read
before.
"""

import tempfile
from collections.abc import Mapping
from pathlib import Path

from ..tools.wheels import run_yosys_scripts

# That the Verilog leaves out.
ATTRIBUTES = (
    "generator",
    "top",
    "src",
    "amaranth.hierarchy",
    "amaranth.decoding",
)
LEFT_OUT = " ".join(f"-remove {attribute}" for attribute in ATTRIBUTES)


def to_verilog(designs: Mapping[str, str]) -> dict[str, str]:
    """Return the Verilog of some designs, by the same names. Raises `ToolchainError` with Yosys's
    message.
    """
    if not designs:
        return {}
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        for name, design in designs.items():
            (folder / f"{name}.il").write_text(design, encoding="utf-8")
        run_yosys_scripts(folder, {f"{name}.ys": _script(name) for name in designs})
        return {name: (folder / f"{name}.v").read_text(encoding="utf-8") for name in designs}


def _script(name: str) -> list[str]:
    return [
        f"read_rtlil {name}.il",
        "proc -nomux -norom",
        "memory_collect",
        f"attrmap {LEFT_OUT}",
        f"attrmap -modattr {LEFT_OUT}",
        f"write_verilog -norename {name}.v",
    ]
