# SPDX-License-Identifier: Apache-2.0
"""Lint of the emulator's Verilog, by the tools of `flow/lint.py`."""

from collections.abc import Mapping
from pathlib import Path

from ..flow.lint import findings
from ..flow.waivers import CONTROL_FILE
from ..hdl.front_end_views import POLYPHASE
from .rtl.top import EMULATOR_LIST
from .rtl.ulx3s import BOARD_TOP

PLL_MODEL = Path(__file__).with_name("ecp5_pll.v")


def lint_emulator(files: Mapping[str, str], top: str) -> dict[str, str]:
    """Return tool -> its findings in the files of `emulator_release`, "" if there are none.

    Of the PLL, only the ports are known. Raises `ToolchainError`.
    """
    names = files[EMULATOR_LIST].split()
    linted = {name: files[name] for name in (*names, CONTROL_FILE)}
    if top == BOARD_TOP:
        names.append(PLL_MODEL.name)
        linted[PLL_MODEL.name] = PLL_MODEL.read_text(encoding="utf-8")
    return findings(linted, [(top, names)], POLYPHASE)
