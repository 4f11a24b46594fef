# SPDX-License-Identifier: Apache-2.0
"""What some tests need beside `make test`, and the command that installs it.

`@pytest.mark.needs("cells")` marks such a test. Without what it needs the test is skipped, and the
reason names the command. `--skipped-before` plays exactly the tests that the last run skipped for
such a reason, so

    make test
    scripts/setup cells
    make test PYTEST_ARGS="--skipped-before --no-skips"

plays every test once.
"""

import shutil
from collections.abc import Callable
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import attrs

from coincid.flow.yosys import cells_folder
from docs.studies.drawings.browser import chromium

ROOT = Path(__file__).parents[1]


@attrs.frozen
class Need:
    """One thing that a test may need."""

    what: str  # as in 'the standard cells'
    install: str  # the command that installs it
    there: Callable[[], bool]  # whether it is installed


def _has_cells() -> bool:
    return cells_folder() is not None and shutil.which("sta") is not None


def _has_chromium() -> bool:
    return chromium() is not None


def _has_layout_tools() -> bool:
    return find_spec("coriolis") is not None and find_spec("klayout") is not None


def _has_site_tools() -> bool:
    return find_spec("sphinx_gallery") is not None and find_spec("myst_parser") is not None


def _has_verilator_of_the_system() -> bool:
    return shutil.which("verilator") is not None


def _has_coverage() -> bool:
    return find_spec("coverage") is not None


def _has_renderer() -> bool:
    return find_spec("mitransient") is not None


def other_python(name: str) -> Path:
    """Return the program of another Python's environment in the build folder; it may not exist."""
    return ROOT / "build" / name / "bin" / "python"


NEEDS = {
    "cells": Need("the standard cells", "scripts/setup cells", _has_cells),
    "chromium": Need("the browser Chromium", "scripts/setup chromium", _has_chromium),
    "docs": Need("the tools of the site", "scripts/setup docs", _has_site_tools),
    "python3.12": Need(
        "another Python", "scripts/setup python3.12", other_python("python3.12").exists
    ),
    "python3.13": Need(
        "another Python", "scripts/setup python3.13", other_python("python3.13").exists
    ),
    "layout": Need("the layout tools", "scripts/setup layout", _has_layout_tools),
    "mutants": Need("Coverage.py", "scripts/setup mutants", _has_coverage),
    "verilator": Need(
        "a Verilator of the system", "scripts/setup verilator", _has_verilator_of_the_system
    ),
    "raytrace": Need("the renderer", "scripts/setup raytrace", _has_renderer),
}


def missing(name: str) -> str | None:
    """Return why a test that needs `name` is skipped, or None if it can be played."""
    need = NEEDS[name]
    if need.there():
        return None
    return f"needs {need.what}: {need.install}"


def imported(need: str, module: str) -> Any:
    """Return a module that cannot be imported without `need`, or None; tests that use it are marked
    with `need`.
    """
    if missing(need):
        return None
    return import_module(module)
