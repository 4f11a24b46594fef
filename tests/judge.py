# SPDX-License-Identifier: Apache-2.0
"""Judge of mutants of the golden model: `python -m tests.judge MODULE SOURCE JOBS [frames]` fails if the regression notices it.

SOURCE replaces the module MODULE before anything imports it. First every frame of JOBS, by sensor, must equal its
record; then, without the last word, the tests of the golden model must pass.
"""

import importlib.util
import signal
import sys
from itertools import groupby
from pathlib import Path

import numpy as np
import pytest

GOLDEN_TESTS = Path(__file__).parent / "golden"
FRAME_SECONDS = 5  # a mutant that takes longer for a frame hangs; the process then ends with a failure
PYTEST_OPTIONS = ("-q", "-x", "-p", "no:randomly", "-p", "no:xdist", "-p", "no:cacheprovider", "--hypothesis-seed=0")


def put_in_place(module: str, source: Path) -> None:
    """Import `source` as `module`."""
    spec = importlib.util.spec_from_file_location(module, source)
    mutant = importlib.util.module_from_spec(spec)
    sys.modules[module] = mutant
    spec.loader.exec_module(mutant)


def differs(jobs: Path) -> bool:
    """Return whether the golden model's result differs from the record of any job."""
    from coincid.model.golden.frame import Golden
    from coincid.tb.frame_record import load_job

    recorded, _ = load_job(jobs)
    for sensor, of_sensor in groupby(recorded, key=lambda job: job.config.sensor):
        golden = Golden(sensor)
        for job in of_sensor:
            signal.alarm(FRAME_SECONDS)
            if not _equal(golden.frame(job.config, job.edges, job.ready), job.expected):
                return True
    signal.alarm(0)
    return False


def _equal(shown, expected) -> bool:
    parts = [(shown.commit_subgroup, expected.commit_subgroup), (shown.commit_cycle, expected.commit_cycle)]
    parts += [(shown.fate, expected.fate), (shown.counters, expected.counters)]
    parts += [*zip(shown.beats, expected.beats, strict=True), *zip(shown.beat_cycle, expected.beat_cycle, strict=True)]
    return all(np.array_equal(a, b) for a, b in parts)


if __name__ == "__main__":
    module, source, jobs, *only_frames = sys.argv[1:]
    put_in_place(module, Path(source))
    sys.exit(
        differs(Path(jobs))
        or (not only_frames and pytest.main([*PYTEST_OPTIONS, str(GOLDEN_TESTS)]) != pytest.ExitCode.OK)
    )
