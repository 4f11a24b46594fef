# SPDX-License-Identifier: Apache-2.0
"""What a layout needs beside the RTL: standard cells, placer and router, and the program that
reads and draws layouts.
"""

from importlib.util import find_spec
from pathlib import Path

from ...model.shared.errors import InputError
from ..yosys import cells_folder

PACKAGES = ("coriolis", "klayout")


def layout_cells() -> Path:
    """Return the folder of the standard cells. Raises `InputError` if they or a tool are
    missing.
    """
    cells = cells_folder()
    if cells is None or None in map(find_spec, PACKAGES):
        raise InputError("the tools for layouts are not installed; run: scripts/setup cells layout")
    return cells
