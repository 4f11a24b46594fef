# SPDX-License-Identifier: Apache-2.0
"""The recorder that tells which files the programs of the pages read."""

import os
import shutil
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


# In a folder that is a project of its own, with the recorder at its place.
READS = """
import os
import shutil
from pathlib import Path

def packages_digest(name):
    return Path(name).read_bytes()

for name in ("build/made", ".venv/installed", ".git/config", "../elsewhere", "tools/build.py"):
    Path(name).read_bytes()
packages_digest("hdl.py")
for flags in (os.O_WRONLY, os.O_RDWR):
    os.close(os.open("written", flags))
Path("missing").exists()
for _ in range(2):
    Path("tools/build.py").read_bytes()
os.chdir("tools")
for _ in range(2):
    Path("../LICENSE").read_bytes()
os.symlink("../setup.toml", "link")
Path("link").read_bytes()
packages_digest("../read.py")
Path(os.path.abspath("../read.py")).read_bytes()
"""


def test_the_recorder_notes_what_is_read_of_the_project_and_once(tmp_path):
    """By its name in the project. Not what is built, installed or written, nor what is read only for
    the name of a build.
    """
    project = tmp_path / "project"
    names = "build/made .venv/installed .git/config ../elsewhere tools/build.py hdl.py written"
    for name in f"{names} LICENSE setup.toml read.py".split():
        (project / name).parent.mkdir(parents=True, exist_ok=True)
        (project / name).write_text("", encoding="utf-8")
    recorder = project / "docs" / "recorder"
    recorder.mkdir(parents=True)
    shutil.copy(ROOT / "docs" / "recorder" / "sitecustomize.py", recorder)
    environment = {"PYTHONPATH": str(recorder), "COINCID_READ": str(tmp_path / "read")}
    environment |= {"PYTHONDONTWRITEBYTECODE": "1"}
    command = [sys.executable, "-c", READS]
    subprocess.run(command, cwd=project, env=os.environ | environment, check=True)
    read = (tmp_path / "read").read_text(encoding="utf-8").splitlines()
    own = [name for name in read if not name.startswith("docs/recorder")]
    assert own == ["tools/build.py", "LICENSE", "setup.toml", "read.py"]
