# SPDX-License-Identifier: Apache-2.0
"""Compiled code is renewed when a file that it depends on changes, is kept otherwise, and does not
require a folder.
"""

import errno
import os
import subprocess
import sys

import numba
import numpy as np
import pytest

from coincid.model.shared import compiled
from coincid.model.shared.compiled import is_compiled, njit, part
from coincid.model.shared.errors import InputError

from ..planted import copy_of_sources

# A kernel outside the package that uses the contract's arithmetic: with windows of one cycle, the
# second photon opens the second window.
PROGRAM = """
import numba, numpy as np
from docs.studies import other_schemes
assert not numba.config.CACHE_DIR, "other packages' code would go there, too"
tick = np.array([0, 32, 64])
print(other_schemes._windows(np.zeros(3, np.int64), tick, 32, 32)[2].tolist(), sum(other_schemes._windows.stats.cache_hits.values()))
"""
OPENED, OPENED_LATE = "[0, 32, 64]", "[0, 64]"
REARM = "close + 1 + rearm_cycles"


@pytest.fixture
def run(tmp_path):
    """Run `PROGRAM` on a copy of the sources; return its output: stamps of windows, and whether
    compiled code was found.
    """
    everything = copy_of_sources(tmp_path)
    environment = {
        name: value for name, value in everything.items() if not name.startswith("NUMBA_")
    }

    def run(**variables):
        command, settings = [sys.executable, "-c", PROGRAM], environment | variables
        done = subprocess.run(
            command,
            cwd=tmp_path,
            env=settings,
            capture_output=True,
            text=True,
            check=False,
            encoding="utf-8",
        )
        return done.stdout.strip() or done.stderr

    return run


def test_a_change_in_a_file_that_a_kernel_takes_in_is_seen(run, tmp_path):
    assert run() == f"{OPENED} 0"
    assert run() == f"{OPENED} 1"
    file = tmp_path / "model" / "contract" / "latency.py"
    original = file.read_text(encoding="utf-8")
    assert original.count(REARM) == 1
    file.write_text(original.replace(REARM, f"{REARM} + 1"), encoding="utf-8")
    assert run() == f"{OPENED_LATE} 0"
    assert run() == f"{OPENED_LATE} 1"


PARTS = """
from coincid.model.shared.compiled import part

@part
def changed(number):
    return number + 1
"""
KERNELS = """
from coincid.model.shared.compiled import njit
from parts_of.others import changed

@njit
def twice(number):
    return 2 * changed(number)
"""


def test_a_change_in_a_part_of_another_package_is_seen(tmp_path):
    """As where a kernel of a test, or of a user's own, has parts of this project."""
    for package, module, text in (("parts_of", "others", PARTS), ("kernels", "own", KERNELS)):
        (tmp_path / package).mkdir()
        (tmp_path / package / "__init__.py").write_text("", encoding="utf-8")
        (tmp_path / package / f"{module}.py").write_text(text, encoding="utf-8")
    program = "from kernels.own import twice; print(twice(3), sum(twice.stats.cache_hits.values()))"
    settings = os.environ | {"COINCID_BUILD": str(tmp_path / "build")}

    def run():
        command = [sys.executable, "-c", program]
        return subprocess.check_output(command, cwd=tmp_path, env=settings, encoding="utf-8")

    assert run() == "8 0\n"
    assert run() == "8 1\n"
    parts = tmp_path / "parts_of" / "others.py"
    parts.write_text(PARTS.replace("+ 1", "+ 5"), encoding="utf-8")
    assert run() == "16 0\n"


def test_without_a_folder_to_write_to_nothing_is_kept(run, tmp_path):
    (tmp_path / "file").touch()
    assert run(COINCID_BUILD=str(tmp_path / "file" / "build")) == f"{OPENED} 0"
    assert not list(tmp_path.rglob("*.nbi"))


@njit
def _half(number):
    return number // 2


def test_compiled_code_on_a_full_disk_is_one_line(monkeypatch):
    def full(signature, code):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(_half._cache, "save_overload", full)
    with pytest.raises(
        InputError, match=r"\Abuild directory .*: No space left .*; COINCID_BUILD names another\Z"
    ):
        _half(4)


@part
def _add(number, more):
    return number + more


@numba.njit
def _twice(number):
    return _add(_add(number, 1), 2)


@part
def _subtract(number, less):
    return number - less


@numba.njit
def _less_by_name(number):
    return _subtract(less=2, number=_subtract(number=number, less=1))


def test_a_part_is_compiled_once_for_all_constants_that_are_given_by_name():
    assert _less_by_name(4) == 1
    assert len(_subtract.signatures) == 1


def test_a_part_is_compiled_once_for_all_constants():
    assert _twice(4) == 7
    assert len(_add.signatures) == 1


def test_a_part_cannot_be_called_from_python():
    with pytest.raises(
        TypeError, match="^_add is a part of kernels, and cannot be called from Python$"
    ):
        _add(1, 2)


@pytest.mark.parametrize("kind", [njit, part])
def test_kernels_never_run_in_the_interpreter_and_never_hold_its_lock(kind):
    """So threads of a session run side by side, and an interrupt is seen at once."""
    options = kind(lambda x: x).targetoptions
    assert options["nopython"] is True
    assert options["nogil"] is True


@pytest.mark.parametrize("kind", [njit, part])
def test_kernels_are_functions_of_python_where_numba_is_told_not_to_compile(kind, monkeypatch):
    """As for a debugger, with and without options."""
    monkeypatch.setattr(compiled._NUMBA, "DISABLE_JIT", 1)

    def half(number):
        return number // 2

    assert kind(half) is half
    assert kind(error_model="numpy")(half) is half


@njit(error_model="numpy")
def _inverse(number):
    return 1 / number


@njit
def _plain_inverse(number):
    return 1 / number


def test_a_kernel_has_the_options_that_it_asks_for():
    """Here what a division by zero is."""
    assert _inverse(0.0) == np.inf
    with pytest.raises(ZeroDivisionError):
        _plain_inverse(0.0)


@pytest.mark.parametrize("kind", [njit, part])
@pytest.mark.parametrize("allocates", [False, True])
def test_only_what_makes_no_arrays_counts_no_references(kind, allocates):
    """Whatever else is asked for."""
    for more in ({}, {"error_model": "numpy"}):
        options = kind(allocates=allocates, **more)(lambda x: x).targetoptions
        assert options.get("_nrt", True) is allocates
        assert options.get("error_model") == more.get("error_model")


def test_a_package_is_compiled_once_some_process_has_kept_its_code(tmp_path, monkeypatch):
    """Where nothing can be kept, there is nothing to wait for."""
    asked = []
    monkeypatch.setattr(compiled, "_folder", lambda *packages: asked.append(packages) or tmp_path)
    assert is_compiled("own.kernels.fast") is False
    (tmp_path / "fast").mkdir()
    (tmp_path / "fast" / "one.nbc").touch()
    assert is_compiled("own.kernels.fast") is False
    (tmp_path / "fast" / "one.nbi").touch()
    assert is_compiled("own.kernels.fast") is True
    assert asked == [("own.kernels",)] * 3
    monkeypatch.setattr(compiled, "_folder", lambda *packages: None)
    assert is_compiled("own.kernels.fast") is True


def test_code_is_kept_in_a_folder_for_its_sources_and_those_of_all(tmp_path, monkeypatch):
    """In any order of the packages, each once."""
    monkeypatch.setenv("COINCID_BUILD", str(tmp_path))
    monkeypatch.setattr(compiled, "packages_digest", lambda *packages: "+".join(packages))
    of_all = ["coincid.model.contract", "coincid.model.shared"]
    for packages in (("a", "z"), ("z", "a"), ("a", "z", "coincid.model.shared")):
        folder = compiled._folder.__wrapped__(*packages)
        assert folder == tmp_path / "numba" / "+".join(["a", *of_all, "z"])
    (tmp_path / "file").touch()
    monkeypatch.setenv("COINCID_BUILD", str(tmp_path / "file"))
    assert compiled._folder.__wrapped__("a") is None
