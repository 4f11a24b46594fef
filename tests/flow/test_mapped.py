# SPDX-License-Identifier: Apache-2.0
"""What is read from OpenSTA's reports and written into its netlists, for made-up blocks."""

from pathlib import Path

import pytest

from coincid.flow.mapped import FLOP, GATE, LATCH, Mapped, least_slacks_ns, without_parameters

# Of latches: a path's slack is what it has not borrowed of the most that it may borrow.
REPORT = """\
   5.55   slack (MET)
FLOPS
   1.25   slack (MET)
  -0.75   slack (VIOLATED)
   0.40   slack (MET)
LATCHES
max time borrow          0.90
actual time borrow       0.22
   0.00   slack (MET)
OPENING
No paths found.
ENABLES
   0.31   slack (MET)
"""


def test_the_least_slack_of_each_kind_of_end():
    """Neither what comes before the first kind, nor a kind without paths."""
    assert least_slacks_ns(REPORT) == pytest.approx(
        {"FLOPS": -0.75, "LATCHES": 0.68, "ENABLES": 0.31}
    )


def test_latches_that_borrow_nothing_have_the_slack_of_their_path():
    """So have flip-flops, whatever else the report says."""
    report = "FLOPS\n  0.50   slack (MET)\nLATCHES\n  0.70   slack (MET)\n  0.60   slack (MET)\n"
    assert least_slacks_ns(report) == {"FLOPS": 0.5, "LATCHES": 0.6}


def test_no_paths_no_slacks():
    assert least_slacks_ns("FLOPS\nNo paths found.\nLATCHES\nOPENING\nENABLES\n") == {}


def test_parameters_go_and_connections_stay():
    instance = "  coincid_delay #(\n    .FS(32'd7),\n    .N(32'd2)\n  ) line (\n    .a(b)\n  );\n"
    assert without_parameters(instance) == "  coincid_delay line (\n    .a(b)\n  );\n"


def test_numbers_of_cells_by_the_beginning_of_their_names():
    cells = {"DFF_X1": 1, "SDFF_X2": 2, "DLH_X1": 4, "DLL_X1": 8, "TLAT_X1": 16}
    cells |= {"CLKGATE_X1": 32, "CLKGATETST_X1": 64, "NAND2_X1": 128, "XDFF": 256}
    block = Mapped("block", Path(), cells, {}, 1.0)
    assert [block.count(kind) for kind in (FLOP, LATCH, GATE)] == [3, 28, 96]
