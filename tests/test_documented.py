# SPDX-License-Identifier: Apache-2.0
"""Plays the commands of `commands.toml` as they are written, with further words that make them
small.

The commands of a session run one after the other in a folder that holds the files they name. A
target of the Makefile is played by the commands that `make -n` prints, except `scripts/setup`,
which has run before. Sessions that take long have the marker `documented`:
`make test PYTEST_ARGS="-m documented"` plays them.
"""

import json
import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
import tomllib
import urllib.request
from contextlib import contextmanager
from socket import socket

import numpy as np
import pytest
from PIL import Image

from coincid.model.contract.config import load_config
from coincid.model.contract.edges import Edges
from coincid.model.light.timing import Timing
from coincid.model.recorded.exchange import write_edges
from coincid.model.shared.folders import build_root

from .command import command
from .commands import ROOT, commands_of_make, table
from .needs import NEEDS
from .planted import copy_of_sources

SESSIONS = table()["session"]
CONFIG = "[sensor]\nrows = 8\ncols = 8\n[frame]\nperiod = 60\npulses = 4\n"


# a make that runs these tests hands neither its options nor the choice of tests to another one
OUTSIDE_OF_MAKE = {"MAKEFLAGS": "", "MAKEOVERRIDES": "", "PYTEST_ARGS": ""}

QUESTION = (
    "(set-logic QF_BV)\n(declare-const a (_ BitVec 2))\n(assert (distinct a a))\n(check-sat)\n"
)


def picture(path, samples):
    Image.fromarray(samples).save(path)


def make_files(folder):
    """Write the files that the commands name: a room, a configuration, edges, a recording,
    specifications of sweeps.
    """
    import OpenEXR

    (folder / "my.toml").write_text(CONFIG, encoding="utf-8")
    (folder / "question.smt2").write_text(QUESTION, encoding="utf-8")
    depth_mm = np.full((48, 64), 2000, np.uint16)
    depth_mm[16:32, 16:48] = 1200
    colours = np.full((48, 64, 3), 150, np.uint8)
    picture(folder / "depth.png", depth_mm)
    picture(folder / "room.png", depth_mm)
    picture(folder / "colour.jpg", colours)
    picture(folder / "room.jpg", colours)
    arrived = np.zeros((8, 8, 200))
    arrived[:, :, 100:105] = 200
    np.savez(folder / "counts.npz", counts=arrived)
    (folder / "pulse.csv").write_text("time_ps,density\n-300,0\n0,1\n900,0\n", encoding="utf-8")
    (folder / "frames").mkdir()
    (folder / "colours").mkdir()
    for number in range(2):
        picture(folder / "frames" / f"depth_{number:04d}.png", depth_mm + 100 * number)
        picture(folder / "colours" / f"{number}.jpg", colours)
    header = {"compression": OpenEXR.PIZ_COMPRESSION, "type": OpenEXR.scanlineimage}
    OpenEXR.File(header, {"Z": depth_mm.astype(np.float32) / 1000}).write(
        str(folder / "street.exr")
    )
    timing = Timing.from_config(load_config(folder / "my.toml"))
    tick = np.array([100, 101, 102])
    pulse = np.array([0, 1, 3])
    write_edges(folder / "edges.npz", Edges(pulse, np.array([5, 6, 7]), tick), timing)
    write_edges(folder / "recording.ptu", Edges(pulse + 2000, np.array([3, 4, 7]), tick), timing)
    shutil.copy(ROOT / "model" / "scenes" / "ray_scenes" / "corner.xml", folder / "room.xml")
    (folder / "docs").mkdir()
    for path in (ROOT / "docs").glob("sweep-*.toml"):
        (folder / "docs" / path.name).write_text(small_sweep(path), encoding="utf-8")
    shutil.copy(folder / "docs" / "sweep-example.toml", folder / "SPEC.toml")


SMALL_VALUES = {"sensor.rows": [8, 8], "sensor.cols": [16, 16], "frame.pulses": [5, 6]}


def small_sweep(path):
    """Return the text of a sweep with the same keys, on a small sensor, with few pulses and two
    points.
    """
    spec = tomllib.loads(path.read_text(encoding="utf-8"))
    axes = spec.pop("axis")
    spec["sensor"] = spec.get("sensor", {}) | {"rows": 8, "cols": 8}
    spec["frame"] = spec.get("frame", {}) | {"pulses": 5}
    lines = []
    for name in [name for name, value in spec.items() if not isinstance(value, dict)]:
        lines.append(f"{name} = {json.dumps(spec.pop(name))}")
    for name, values in spec.items():
        lines.append(f"[{name}]")
        lines += [f"{key} = {json.dumps(value)}" for key, value in values.items()]
    for number, axis in enumerate(axes):
        lines.append("[[axis]]")
        for key, values in flat(axis):
            few = values[: 2 if number == 0 else 1]
            if key in SMALL_VALUES:
                few = SMALL_VALUES[key][: len(few)]
            lines.append(f"{key} = {json.dumps(few)}")
    return "\n".join([*lines, ""])


def flat(values, before=""):
    """Yield the dotted keys of a table, and their values."""
    for key, value in values.items():
        if isinstance(value, dict):
            yield from flat(value, f"{before}{key}.")
        else:
            yield f"{before}{key}", value


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """A folder with the files that the commands name."""
    folder = tmp_path_factory.mktemp("files")
    make_files(folder)
    return folder


@pytest.fixture
def folder(files, tmp_path, monkeypatch):
    """The current folder: a copy of `files`."""
    shutil.copytree(files, tmp_path / "here")
    monkeypatch.chdir(tmp_path / "here")
    return tmp_path / "here"


def typed(step, place):
    """Return the command lines of a step, with the words that make it small; of a target, those
    that it consists of.
    """
    line = step["command"]
    for before, after in step.get("instead", {}).items():
        assert before in line, (before, line)
        line = line.replace(before, after)
    lines = [line]
    if line.startswith("make ") and place != "checkout":
        lines = commands_of_make(line)
    more = step.get("more", "")
    if isinstance(more, str):
        more = [more] * len(lines)
    return [f"{line} {words}".rstrip() for line, words in zip(lines, more, strict=True)]


def finished(line, folder, environment):
    """Return exit code and output of a command line. `coincid` runs in this process unless it has
    an environment.
    """
    program, _, words = line.partition(" ")
    program = program.removeprefix(".venv/bin/")
    if program == "coincid" and not environment:
        done = command(words)
        assert done.exception is None or isinstance(done.exception, SystemExit), (
            line,
            done.exception,
        )
        return done.exit_code, done.output
    done = subprocess.run(
        as_here(line),
        shell=True,
        cwd=folder,
        env=os.environ | OUTSIDE_OF_MAKE | environment | {"CHECKOUT": str(ROOT)},
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        encoding="utf-8",
        check=False,
    )
    return done.returncode, done.stdout


def as_here(line):
    """Return a command line for a shell, with programs of this environment."""
    program, _, words = line.partition(" ")
    python = shlex.quote(sys.executable)
    programs = {
        "python": python,
        "coincid": f"{python} -m coincid",
        "pip": f"{python} -m pip",
        "dask": f"{python} -m dask",
    }
    name = program.removeprefix(".venv/bin/")
    return f"{programs[name]} {words}" if name in programs else line


def play(step, folder, place="", environment=None):
    """Play a step, and check what it prints and writes."""
    told = ""
    for line in typed(step, place):
        code, printed = finished(line, folder, environment or {})
        assert code == step.get("code", 0), (line, printed)
        told += printed
    for text in step.get("says", ()):
        assert text in told, (step["command"], told)
    for path in step.get("writes", ()):
        assert (folder / path).exists(), (step["command"], path)


def sessions():
    """Return the sessions with their marks."""
    found = []
    for name, session in SESSIONS.items():
        marks = [pytest.mark.needs(need) for need in session.get("needs", ())]
        if session.get("long"):
            marks.append(pytest.mark.documented)
        found.append(pytest.param(name, marks=marks))
    return found


@pytest.mark.parametrize("name", sessions())
def test_session(name, folder):
    session = SESSIONS[name]
    place = session.get("place", "")
    environment = {}
    if place == "checkout":
        folder = ROOT
    if place == "copy":
        folder = folder / "copy"
        folder.mkdir()
        environment = copied(folder)
    for step in session["step"]:
        play(step, folder, place, environment)


def copied(folder):
    """Copy the sources and the pages for programs that write pages; return the environment in which
    the copy is found.
    """
    shutil.copytree(ROOT / "docs", folder / "docs")
    shutil.copytree(ROOT / "scripts", folder / "scripts")
    for path in (
        *ROOT.glob("*.md"),
        *ROOT.glob("requirements*.lock"),
        ROOT / "CITATION.cff",
        ROOT / "Makefile",
    ):
        shutil.copy(path, folder)
    return copy_of_sources(folder) | {"COINCID_BUILD": str(build_root())}


@contextmanager
def served(line):
    """Start a command that serves until it is interrupted; yield it and its first line with an
    address.
    """
    words = shlex.split(as_here(line))
    environment = os.environ | {"BROWSER": "true"}  # a program that opens nothing
    process = subprocess.Popen(
        words,
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        encoding="utf-8",
        start_new_session=True,
    )
    try:
        yield process
    finally:
        process.kill()
        process.wait()
        process.stdout.close()


def ways_to_explore():
    """Return the commands that start the explorer; the first is played always."""
    first, *others = table()["explorer"]["commands"]
    return [first, *(pytest.param(line, marks=pytest.mark.documented) for line in others)]


@pytest.mark.parametrize("line", ways_to_explore())
def test_explorer_serves_until_it_is_interrupted(line, folder):
    lines = commands_of_make(line) if line.startswith("make ") else [line]
    (line,) = (re.sub(r"--port \d+", f"--port {free_port()}", line) for line in lines)
    with served(line) as process:
        told = process.stdout.readline()
        assert "Coincid explorer: " in told, told + process.stdout.read()
        with urllib.request.urlopen(told.split()[2]) as page:
            assert b"Coincid" in page.read()
        process.send_signal(signal.SIGINT)
        process.stdout.read()
        process.wait(60)


def free_port():
    with socket() as one:
        one.bind(("127.0.0.1", 0))
        return one.getsockname()[1]


@pytest.mark.documented
def test_sweep_on_a_cluster(folder):
    """The scheduler, a worker and the sweep of the page, on one machine."""
    scheduler, worker, sweep = table()["cluster"]["commands"]
    port = str(free_port())
    scheduler = f"{scheduler.replace('8786', port)} --host 127.0.0.1 --no-dashboard"
    with served(scheduler) as first:
        while "Scheduler at:" not in first.stdout.readline():
            assert first.poll() is None
        with served(f"{here(worker, port)} --no-dashboard") as second:
            play({"command": here(sweep, port), "writes": ["build/sweep.parquet"]}, folder)
            assert second.poll() is None


def here(line, port):
    """Return a command line for a scheduler on this machine."""
    return line.replace("HOST:8786", f"127.0.0.1:{port}")


def extras():
    """Return the commands that install an extra, with what that needs here."""
    found = []
    for line in table()["extras"]["commands"]:
        marks = [pytest.mark.documented]
        marks += [pytest.mark.needs(name) for name in NEEDS if f"[{name}]" in line]
        found.append(pytest.param(line, marks=marks))
    return found


@pytest.mark.parametrize("line", extras())
def test_extras_have_their_packages(line):
    """Everything of an extra that a message recommends is installed here, in a version that it
    accepts.
    """
    code, told = finished(f"{line} --dry-run --no-index --disable-pip-version-check", ROOT, {})
    assert code == 0 and "does not provide the extra" not in told, told
