# SPDX-License-Identifier: Apache-2.0
"""The words and the depth of a frame are the same in every supported Python. As a program, it prints their digests."""

import hashlib
import os
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from coincid.lab.outcomes import Run
from coincid.lab.setup import Setup

ROOT = Path(__file__).parents[1]
SMALL = {"rows": 8, "cols": 8}
OTHERS = ("python3.12", "python3.13")


def digests() -> list[str]:
    """Return the digests of the beats and of the depth of one frame."""
    run = Run(Setup.of("five-objects", klux=20, sensor=SMALL, frame={"pulses": 50}))
    words = hashlib.sha256()
    for trace in run.traces:
        for beats in trace.beats:
            words.update(beats.tobytes())
    depth = hashlib.sha256(run.depth("planes").depth_m.tobytes())
    return [words.hexdigest(), depth.hexdigest()]


@pytest.mark.long  # compiles the kernels for another Python
@pytest.mark.parametrize("name", [pytest.param(name, marks=pytest.mark.needs(name)) for name in OTHERS])
def test_another_python_gives_the_same_words_and_depth(name):
    from .needs import other_python

    environment = os.environ | {"PYTHONPATH": str(ROOT / "src")}
    command = [other_python(name), __file__]
    other = subprocess.run(command, env=environment, capture_output=True, text=True, encoding="utf-8", check=True)
    assert other.stdout.split() == digests()


def test_the_project_names_the_versions_of_python_that_tests_play():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    own = f"python{sys.version_info.major}.{sys.version_info.minor}"
    named = [line.rpartition(" :: ")[2] for line in project["classifiers"] if "Python :: 3." in line]
    assert {f"python{version}" for version in named} >= {own, *OTHERS}


if __name__ == "__main__":
    print(*digests())
