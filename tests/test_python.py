# SPDX-License-Identifier: Apache-2.0
"""The words and the depth of a frame are the same in every supported Python."""

import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from . import frame_digests
from .needs import other_python

ROOT = Path(__file__).parents[1]
OTHERS = ("python3.12", "python3.13")


@pytest.mark.long  # compiles the kernels for another Python
@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=pytest.mark.needs(name)) for name in OTHERS]
)
def test_another_python_gives_the_same_words_and_depth(name):
    command = [other_python(name), frame_digests.__file__]
    other = subprocess.run(command, capture_output=True, text=True, encoding="utf-8", check=True)
    assert other.stdout.split() == frame_digests.digests()


def test_the_project_names_the_versions_of_python_that_tests_play():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    own = f"python{sys.version_info.major}.{sys.version_info.minor}"
    named = [
        line.rpartition(" :: ")[2] for line in project["classifiers"] if "Python :: 3." in line
    ]
    assert {f"python{version}" for version in named} >= {own, *OTHERS}
