# SPDX-License-Identifier: Apache-2.0
"""The recorder that tells which files the programs of the pages read."""

import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[1]


def recorded(folder, code, *arguments):
    """Return what the recorder writes about a program, in a folder for its file."""
    environment = {
        "PYTHONPATH": str(ROOT / "docs" / "recorder"),
        "COINCID_READ": str(folder / "read"),
    }
    command = [sys.executable, "-c", code, *arguments]
    subprocess.run(command, cwd=ROOT, env=os.environ | environment, check=True)
    return (folder / "read").read_text(encoding="utf-8")


def test_the_recorder_sees_reads_of_all_processes(tmp_path):
    code = "import subprocess, sys; from pathlib import Path; Path('pyproject.toml').read_bytes(); "
    code += "subprocess.run([sys.executable, '-c', 'import coincid.model.contract.latency'], check=True)"
    read = recorded(tmp_path, code)
    assert "pyproject.toml" in read.split() and "latency" in read


def test_the_recorder_takes_no_folder_for_a_file(tmp_path):
    """`shutil.rmtree` opens each folder by its name in the folder above."""
    (tmp_path / "outer" / "inner").mkdir(parents=True)
    code = "import shutil, sys; shutil.rmtree(sys.argv[1])"
    assert "inner" not in recorded(tmp_path, code, str(tmp_path / "outer")).split()
