# SPDX-License-Identifier: Apache-2.0
"""From Verilog to a netlist and its C++: Yosys maps, `emit` writes, and the result is kept.

Yosys turns everything into tables of three inputs and flip-flops of one clock edge. Units keep
their hierarchy, memories of some rows stay memories. Yosys may choose values that the Verilog
leaves undefined; those that Yosys leaves undefined are 0.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path

from ..model.shared.folders import build_root
from ..model.shared.sources import sources_digest
from ..tools.wheels import yosys_once
from .emit import DarkInput, Emission
from .netlist import read_netlist

ROWS_MIN = 4  # memories with fewer rows become flip-flops
FLOP_CELLS = " ".join(
    f"-cell {cell} 01" for cell in ("$_DFF_P_", "$_DFFE_PP_", "$_SDFF_PP?_", "$_SDFFE_PP?P_")
)
# Everything except flip-flops. With them, ABC would map the logic of each clock enable by
# itself: it takes three times as long, and leaves a sixth more tables.
LOGIC = "* t:*DFF* %d"
NETLIST, SOURCE, HEADER = "netlist.json", "slice.cpp", "slice.h"


class Design:
    """A design in slices: a `folder` with its netlist and C++, made once. Raises
    `ToolchainError`, `NetlistError`.

    name: of the build. sources: Verilog, or Yosys's RTLIL (`.il`), by file name. units: modules
    that repeat in the top; their code is written once. dark_inputs: inputs that are nearly
    always 0. before: commands of Yosys that come right after reading.
    """

    def __init__(
        self,
        name: str,
        sources: Mapping[str, str],
        top: str,
        units: Sequence[str] = (),
        dark_inputs: Sequence[DarkInput] = (),
        before: Sequence[str] = (),
    ):
        self.top, self._dark_inputs = top, tuple(dark_inputs)
        lines = _script(top, list(sources), units, before)

        def emit(scratch: Path) -> None:
            emission = self._emission(scratch)
            (scratch / SOURCE).write_text(emission.source, encoding="utf-8")
            (scratch / HEADER).write_text(emission.header, encoding="utf-8")

        state = [sources_digest("slices"), top, repr(self._dark_inputs)]
        self.folder = yosys_once(build_root() / "slices" / name, sources, lines, state, emit)

    def emission(self) -> Emission:
        """Return netlist and layout, which the folder does not hold."""
        return self._emission(self.folder)

    def _emission(self, folder: Path) -> Emission:
        return Emission(read_netlist(folder / NETLIST), self.top, self._dark_inputs)


def _script(
    top: str, files: Sequence[str], units: Sequence[str], before: Sequence[str]
) -> list[str]:
    """Return the lines of Yosys's script."""
    small = " ".join(f"r:SIZE={rows}" for rows in range(1, ROWS_MIN))
    return [
        *(f"{'read_rtlil' if file.endswith('.il') else 'read_verilog'} {file}" for file in files),
        f"hierarchy -check -top {top}",
        *(f"setattr -mod -set keep_hierarchy 1 {unit}" for unit in units),
        *before,
        "proc",
        "flatten",
        "opt_clean",
        "memory_nordff",
        "memory_collect",
        f"memory_map {small}",
        "opt -full",
        "peepopt",
        "wreduce",
        "opt_clean",
        "alumacc",
        "techmap",
        "opt -fast",
        f"dfflegalize {FLOP_CELLS}",
        "opt -fast",
        f"abc -lut 3 {LOGIC}",
        "opt_clean",
        f"write_json {NETLIST}",
    ]
