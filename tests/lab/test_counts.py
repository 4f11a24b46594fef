# SPDX-License-Identifier: Apache-2.0
"""Counts of frames: each event of a run is in one frame, whichever measure counts it."""

import numpy as np
import pytest

from coincid.lab.measures import MEASURES
from coincid.lab.outcomes import Run
from coincid.lab.setup import Setup

FRAMES = 3
COUNTED = {  # measure: array of the result whose sum it is part of
    "opened": "opened",
    "committed": "committed",
    "rejected": "rejected",
    "dropped": "dropped",
    "blind_cycles": "blind",
    "photons": "photons",
    "mg_dropped": "mg_dropped",
    "overruns": "overrun",
}
OF_EVENTS = {"events": "pulse", "mg_records": "mg_pulse", "edges": None}


@pytest.fixture(scope="module")
def run():
    return Run(
        Setup.of(
            "flat:5,0.4",
            sensor={"rows": 8, "cols": 24, "streams": 2, "fifo_depth": 1},
            frame={
                "frames": FRAMES,
                "period": 60,
                "pulses": 20,
                "gap": 3,
                "format": "full",
                "link_gbps": 2.0,
                "minigroup_records": True,
                "mg_threshold": 1,
                "capacity": 30,
            },
            subgroup={"threshold": 2},
            klux=100.0,
        )
    )


def test_the_frames_of_a_run_add_up(run):
    arrays = run.result
    for name, array in COUNTED.items():
        of_frames = [run.frame(number)[name] for number in range(FRAMES)]
        assert sum(of_frames) == arrays[array].sum() > 0, name
        assert min(of_frames) > 0, name
    for name, array in OF_EVENTS.items():
        total = len(run.edges if array is None else arrays[array])
        of_frames = [run.frame(number)[name] for number in range(FRAMES)]
        assert sum(of_frames) == total > 0, name
        assert min(of_frames) > 0, name
    integers = {name for name, measure in MEASURES.items() if measure.kind is int}
    assert integers - COUNTED.keys() - OF_EVENTS.keys() == {"beats", "bits"}


def test_rates_are_counts_over_the_time_of_the_frame(run):
    """The time is that of the frame with its gaps; the shares are of what the measure's name says."""
    config = run.config
    for number in range(FRAMES):
        frame = run.frame(number)
        seconds = (20 * 60 + 19 * 3) / (config.clock_mhz * 1e6)
        rates = {"events_per_s": "events", "records_per_s": "mg_records"}
        for rate, count in rates.items():
            assert frame[rate] == pytest.approx(frame[count] / seconds)
        assert frame["frames_per_s"] == pytest.approx(1 / seconds)
        assert frame["dropped_share"] == frame["dropped"] / frame["committed"]
        assert frame["commits_per_pulse"] == frame["committed"] / 20
        assert frame["capacity_share"] == pytest.approx(frame["committed"] / (2 * 30))
        assert frame["bits"] == 64 * frame["beats"] == 64 * int(np.sum(frame.beats))
