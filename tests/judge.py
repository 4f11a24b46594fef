# SPDX-License-Identifier: Apache-2.0
"""Judge of mutants of the golden model: `python -m tests.judge MODULE SOURCE JOBS [frames]`.

It fails if the regression notices the mutant. SOURCE replaces the module MODULE before anything
imports it. First every frame of JOBS, by sensor, must equal its record; then, without the last
word, the tests of the golden model must pass.
"""

import importlib.util
import signal
import sys
from itertools import groupby
from pathlib import Path

import numpy as np
import pytest

GOLDEN_TESTS = Path(__file__).parent / "golden"
# CPU time of a frame. A mutant that takes longer hangs; the process then ends with a failure.
FRAME_SECONDS = 5
PYTEST_OPTIONS = (
    "-q",
    "-x",
    *("-p", "no:randomly"),
    *("-p", "no:xdist"),
    *("-p", "no:cacheprovider"),
    "--hypothesis-seed=0",
)


def put_in_place(module: str, source: Path) -> None:
    """Import `source` as `module`."""
    spec = importlib.util.spec_from_file_location(module, source)
    mutant = importlib.util.module_from_spec(spec)
    sys.modules[module] = mutant
    spec.loader.exec_module(mutant)


def differs(jobs: Path) -> bool:
    """Return whether the golden model's result differs from the record of any job in a file."""
    # Imported here, after the mutant has taken its place.
    from coincid.model.golden.frame import Golden
    from coincid.tb.frame_record import load_job

    recorded, _ = load_job(jobs)
    for sensor, of_sensor in groupby(recorded, key=lambda job: job.config.sensor):
        golden = Golden(sensor)
        for job in of_sensor:
            signal.setitimer(signal.ITIMER_PROF, FRAME_SECONDS)
            shown = golden.frame(job.config, job.edges, job.ready)
            if not equal(shown, job.expected):
                return True
    signal.setitimer(signal.ITIMER_PROF, 0)
    return False


def equal(shown, expected) -> bool:
    """Return whether two traces of a frame have the same commits, fates, counters and beats."""
    pairs = [
        (shown.commit_subgroup, expected.commit_subgroup),
        (shown.commit_cycle, expected.commit_cycle),
        (shown.fate, expected.fate),
        (shown.counters, expected.counters),
        *zip(shown.beats, expected.beats, strict=True),
        *zip(shown.beat_cycle, expected.beat_cycle, strict=True),
    ]
    return all(np.array_equal(one, other) for one, other in pairs)


def tests_fail() -> bool:
    """Return whether a test of the golden model fails."""
    return pytest.main([*PYTEST_OPTIONS, str(GOLDEN_TESTS)]) != pytest.ExitCode.OK


def main(module: str, source: str, jobs: str, only_frames: str = "") -> bool:
    """Return whether the regression notices a mutant; the arguments are those of the command."""
    put_in_place(module, Path(source))
    if differs(Path(jobs)):
        return True
    return not only_frames and tests_fail()


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
