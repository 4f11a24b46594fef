# SPDX-License-Identifier: Apache-2.0
"""What is told about placements with several seeds, from nextpnr's reports, written by hand."""

import json

import pytest

from coincid.flow.pnr import Placement, fastest


@pytest.fixture
def placed(tmp_path):
    """Return a placement with these frequencies of its clocks in MHz."""

    def placed(seed, **fmax_mhz):
        folder = tmp_path / str(seed)
        folder.mkdir()
        fmax = {f"$glbnet${clock}": {"achieved": mhz} for clock, mhz in fmax_mhz.items()}
        (folder / "report.json").write_text(json.dumps({"fmax": fmax}), encoding="utf-8")
        return Placement(seed, folder)

    return placed


def test_the_fastest_placement_is_that_whose_slowest_clock_is_the_fastest(placed):
    """Neither that with the fastest clock of all, nor the fastest on average."""
    uneven = placed(1, bus=90, sensor=300)
    even = placed(2, bus=101, sensor=102)
    slow = placed(3, bus=99, sensor=99)
    assert fastest([uneven, even, slow]) is even
    assert fastest([slow, uneven]) is slow
