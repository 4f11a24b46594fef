# SPDX-License-Identifier: Apache-2.0
"""The edge of the `coincid` command: bad input, remaining files, and the output of replay and
export.
"""

import errno
import json
import os
import re
import shlex
import signal
import subprocess
import sys
import zipfile
from contextlib import nullcontext
from functools import partial
from inspect import getdoc
from types import SimpleNamespace

import numpy as np
import pytest
from attrs import evolve
from typer.main import get_command

import coincid
from coincid import __main__ as program
from coincid.cli import Commands, app
from coincid.flow.lint import findings
from coincid.flow.register_files import HEADER, JSON, MARKDOWN
from coincid.flow.release import CELLS_LIST, MANIFEST
from coincid.flow.waivers import CONTROL_FILE, OF_CELLS, OF_SENSOR
from coincid.hdl.export import FILE_LIST
from coincid.hdl.front_end_views import POLYPHASE
from coincid.host.transport import HostError
from coincid.lab.setup import scene_of
from coincid.model.contract.config import load_config, parse_config
from coincid.model.contract.edges import NAMES, Edges
from coincid.model.contract.parameters import TOP
from coincid.model.contract.registers import BY_NAME, SUBGROUP, address
from coincid.model.contract.result import differences, read_result, stall
from coincid.model.golden.frame import golden_result
from coincid.model.light.link_budget import link_budget
from coincid.model.scenes.catalogue import usual_klux
from coincid.model.shared.errors import InputError
from coincid.model.shared.interrupts import Terminated
from coincid.study.advise import Advice, Tried
from coincid.tb.rtl_errors import Mismatch, SimulationError
from coincid.tools.build import ToolchainError

from .command import assert_refused, command
from .exports import SMALLEST
from .random_cases import SENSORS
from .releases import small_releases

CONFIG = """
[sensor]
rows = 8
cols = 16
[frame]
frames = 2
period = 40
pulses = 3
[subgroup]
window = 12
"""
PULSES, PIXELS, PERIOD_TICKS = 6, 128, 40 * 32


REPLAY = "replay --config config.toml --edges edges.npz --out out/result.npz"


def some_edges(n=200):
    rng = np.random.default_rng(5)
    return {
        name: rng.integers(0, high, n)
        for name, high in zip(NAMES, (PULSES, PIXELS, PERIOD_TICKS), strict=True)
    }


@pytest.fixture
def files(tmp_path, monkeypatch):
    """Return the current folder, with a good configuration and good edges."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "config.toml").write_text(CONFIG, encoding="utf-8")
    np.savez(tmp_path / "edges.npz", **some_edges())
    return tmp_path


# contract/test_config.py has the others
@pytest.mark.parametrize("text", ["[subgroup]\nthreshhold = 2", "threshold:"])
@pytest.mark.parametrize(
    "job",
    ["replay --edges edges.npz --out out/x.npz", "sim --out out", "verilog --out out", "lint"],
)
def test_bad_configuration(files, text, job):
    (files / "config.toml").write_text(text, encoding="utf-8")
    words = ("TOML",) if ":" in text else ("threshhold", "threshold")
    assert_refused(command(f"{job} --config config.toml"), "config.toml", *words)
    assert_refused(
        command(f"{job} --config none.toml"), "none.toml", "no such file", "silicon", "fpga"
    )
    assert not (files / "out").exists()


def one(name, value, dtype=np.int64):
    edges = some_edges()
    edges[name] = edges[name].astype(dtype)
    edges[name][7] = value
    return edges


def each(change):
    return {name: change(array) for name, array in some_edges().items()}


BAD_EDGES = [
    (one("pixel", PIXELS), "pixel[7] = 128", "from 0 to 127"),
    (one("tick", PERIOD_TICKS), "tick[7] = 1280", "from 0 to 1279"),
    (one("pulse", PULSES), "pulse[7] = 6", "from 0 to 5"),
    (one("tick", -1), "tick[7] = -1", "from 0 to 1279"),
    (one("tick", 2**64 - 1, np.uint64), "tick[7]", "from 0 to 1279"),
    (one("tick", 0.5, np.float64), "tick", "integers"),
    (each(lambda array: array > 0), "pulse", "integers"),
    (each(lambda array: array.reshape(2, -1)), "pulse", "1"),
    (some_edges() | {"pixel": some_edges()["pixel"][:-1]}, "lengths", "pixel 199"),
    ({name: some_edges()[name] for name in ("pulse", "pixel")}, "'tick'"),
    (some_edges() | {"tick": np.array([None] * 200)}, "edges.npz"),
]


@pytest.mark.parametrize("arrays, words", [(arrays, words) for arrays, *words in BAD_EDGES])
def test_bad_edges(files, arrays, words):
    np.savez("edges.npz", **arrays)
    assert_refused(command(REPLAY), "edges.npz", *words)
    assert not (files / "out").exists()


def test_replay_tells_how_many_hits_there_are_in_gates(files):
    np.savez("edges.npz", **some_edges(2000))
    shown = command(f"{REPLAY} --set counts=1 --set format=counts").output
    result = read_result("out/result.npz")
    hits = result["gate_hits"].sum()
    gates = (result["gate_cycle"] != 255).sum()
    assert hits > 100
    assert f"out/result.npz: {hits} hits in {gates} gates, of 2000 edges" in shown


def test_replay_tells_how_many_events_and_records_left_the_sensor(files):
    """And what was dropped, over all frames and subgroups."""
    np.savez("edges.npz", **some_edges(4000))
    changes = "--set minigroup_records=true --set fifo_depth=1 --set threshold=1"
    shown = command(f"{REPLAY} {changes}").output
    result = read_result("out/result.npz")
    events, dropped = len(result["pulse"]), result["dropped"].sum()
    records = len(result["mg_pulse"])
    assert len({events, records, dropped, 0}) == 4
    told = (
        f"{events} events and {records} minigroup records of 4000 edges, {dropped} events dropped"
    )
    assert f"out/result.npz: {told}" in shown


@pytest.mark.parametrize(
    ("error", "code"),
    [
        (Mismatch("frame 0, beat 1"), 1),
        (HostError("no frame end"), 1),
        (SimulationError("the simulator ended", None), 1),
        (ToolchainError("verilator is missing"), 2),
        (InputError("period = 1: must be more"), 2),
        (KeyboardInterrupt(), 130),
    ],
)
def test_each_kind_of_error_has_its_sentence_and_exit_code(files, monkeypatch, error, code):
    def fails(*given, **named):
        raise error

    monkeypatch.setattr("coincid.tb.replay.replay", fails)
    done = command(REPLAY)
    assert done.exit_code == code
    told = str(error) or "interrupted"
    assert done.stderr.splitlines()[-1] == f"coincid: {told}"
    assert not (files / "out" / "result.npz").exists()


@pytest.mark.parametrize("error", [AssertionError("own"), RuntimeError("own"), ZeroDivisionError()])
def test_an_error_of_our_own_is_not_told_as_a_difference(files, monkeypatch, error):
    """It keeps its trace."""

    def fails(*given, **named):
        raise error

    monkeypatch.setattr("coincid.tb.replay.replay", fails)
    done = command(REPLAY)
    assert done.exception is error and "coincid:" not in done.stderr


def test_a_module_that_is_not_there_is_an_error_of_our_own(monkeypatch):
    def lost():
        raise ModuleNotFoundError("no module of ours")

    monkeypatch.setattr(program, "_command", lost)
    with pytest.raises(ModuleNotFoundError):
        program._run()


def test_pictures_are_files_whatever_the_surroundings_say(monkeypatch):
    """A way to windows that is not there would end the program."""
    monkeypatch.setenv("MPLBACKEND", "tkagg")
    for name in ("COLUMNS", "LINES", "SOURCE_DATE_EPOCH"):
        monkeypatch.setenv(name, "80")
    monkeypatch.setattr("coincid.cli.app", lambda: sys.exit(3))
    monkeypatch.setattr("coincid.model.shared.interrupts.interruptible", lambda: None)
    assert program._command() == 3
    assert os.environ["MPLBACKEND"] == "agg"


@pytest.mark.parametrize(("signal_raised", "code"), [(KeyboardInterrupt, 130), (Terminated, 143)])
def test_a_signal_while_the_words_are_read_ends_the_command(monkeypatch, signal_raised, code):
    def parse(group, ctx, words):
        raise signal_raised

    monkeypatch.setattr(Commands, "parse_args", parse)
    done = command("show")
    assert (done.exit_code, done.stderr) == (code, "coincid: interrupted\n")


def test_files_that_are_no_edges(files):
    """Damaged files are in `recorded/test_recordings.py`."""
    path = files / "edges.npz"
    with open(path, "wb") as file:
        np.save(file, np.arange(5))
    assert_refused(command(REPLAY), "edges.npz", "is a single array")
    path.write_text("pulse,pixel,tick\n0,0,0\n", encoding="utf-8")
    assert_refused(command(REPLAY), "edges.npz", "is not an NPZ file", "pulse, pixel, tick")
    (files / "edges.csv").write_text("pulse,pixel,tick\n0,0,0\n", encoding="utf-8")
    told = "edges.csv: is read as NPZ; coincid edges makes one of a .csv file"
    assert_refused(command(REPLAY.replace("edges.npz", "edges.csv")), told)
    with zipfile.ZipFile(path, "w") as archive:
        for name in NAMES:
            archive.writestr(f"{name}.npy", b"nothing")
    assert_refused(command(REPLAY), "edges.npz")
    path.unlink()
    assert_refused(command(REPLAY), "edges.npz", "no such file")
    assert not (files / "out").exists()


FILES_OUT = (
    "bench --out",
    "pnr --out",
    "photons --out",
    "edges edges.npz --out",
    "emulator --page",
)
FOLDERS_OUT = ("advise flat:5 --out", "emulator serial --out", "emulate --simulate --out")


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (f"{REPLAY} --stall -1", ("stall = -1", "from 0 to")),
        (REPLAY.replace("result.npz", "result.h5"), ("out/result.h5: must end with .npz",)),
        (
            f"{REPLAY} --engine cocotb-verilator",
            ("engine = 'cocotb-verilator'", "golden, sliced, verilator, icarus"),
        ),
        ("sim --out out --scene letter-g", ("letter-g",)),
        ("sim --out out --klux -1", ("klux = -1",)),
        ("sim --out out --klux nan", ("klux = nan",)),
        ("sim --out out --pulses 0", ("pulses = 0", "from 1 to 65536")),
        ("sim --out out --pulses 65537", ("pulses = 65537", "from 1 to 65536")),
        ("sim --out out --frames 0", ("frames = 0", "from 1 to 1000")),
        ("sim --out out --frames 1001", ("frames = 1001", "from 1 to 1000")),
        (f"{REPLAY} --stall 16777217", ("stall = 16777217", "from 0 to 16777216")),
        ("sim --out out --seed -1", ("seed = -1", "from 0 to")),
        ("sim --out out --engine vcs", ("engine = 'vcs'", "golden, sliced, verilator, icarus")),
        (
            "sim --out out --engine sliced --waves",
            ("engine = 'sliced'", "waveform", "verilator and icarus"),
        ),
        ("sim --out out --engine sliced --view async", ("async = 'sliced'", "verilator, icarus")),
        *(
            (f"{REPLAY} --offset-seed {seed}", (f"offset_seed = {seed}: goes with --view async",))
            for seed in (0, 4)
        ),
        ("sim --out out --clock-mhz 0", ("clock",)),
        ("sim --out out --set format=short", ("frame.format = 'short'",)),
        ("sim --config config.toml --out edges.npz/out.npz", ("out.npz", "cannot be written")),
        ("verilog --config config.toml --out edges.npz/out.npz", ("out.npz", "cannot be written")),
        (REPLAY.replace("out/result.npz", "edges.npz/out.npz"), ("out.npz", "cannot be written")),
        (REPLAY.replace("out/result.npz", "."), ("is a folder",)),
        ("bench --repeats 0", ("repeats = 0", "from 1 to 1000")),
        ("bench --repeats 1001", ("repeats = 1001", "from 1 to 1000")),
        *((f"{words} .", ("is a folder",)) for words in FILES_OUT),
        *((f"{words} edges.npz/below", ("cannot be written",)) for words in FOLDERS_OUT),
        ("sim --out out --spad dead_time_s=fast", ("--spad dead_time_s=fast: must be a number",)),
        ("sim --out out --spad dead_time_s", ("--spad dead_time_s: must be a number",)),
        ("sim --out out --spad dead=1", ("--spad dead=1: must be NAME=VALUE", "dead_time_s")),
        ("budget --form printed", ("form = 'printed'", "literal", "corrected")),
        ("budget --reflectivity 2", ("reflectivity = 2", "from 0 to 1")),
    ],
)
def test_bad_options(files, words, told):
    assert_refused(command(words), *told)
    assert sorted(path.name for path in files.iterdir()) == ["config.toml", "edges.npz"]


@pytest.mark.parametrize(
    ("words", "told"),
    [
        ("emulator serial --out edges.npz/below", "cannot be written"),
        ("emulator ulx3s --set clock_mhz=101.3", "the board's PLL does not make it"),
    ],
)
def test_an_emulator_is_refused_before_its_verilog_is_made(files, monkeypatch, words, told):
    def emitted(*_):
        raise AssertionError("Verilog was made")

    monkeypatch.setattr("coincid.hdl.export._emitted", emitted)
    assert_refused(command(words), told)


@pytest.mark.parametrize("gap", [0, 100])
def test_the_bar_of_a_replay_ends_with_the_cycles_of_all_frames_and_their_gaps(
    files, monkeypatch, gap
):
    bars, told = [], []
    monkeypatch.setattr(
        "coincid.cli._progress",
        lambda *bar: bars.append(bar) or nullcontext(SimpleNamespace(done=told.append)),
    )
    assert command(f"{REPLAY} --set gap={gap}").exit_code == 0
    cycles = 2 * (3 * 40 + 2 * gap)
    assert bars == [(cycles, "200 edges, 2 frames, golden")]
    assert cycles <= told[-1] < cycles + 40


def test_a_benchmark_is_not_named_as_the_table_beside_it(monkeypatch, files):
    monkeypatch.setattr("coincid.study.bench.benchmark", lambda *given, **options: 1 / 0)
    assert_refused(command("bench --out a.md"), "out = 'a.md': must not end with .md")
    assert isinstance(command("bench --out a").exception, ZeroDivisionError)


@pytest.mark.parametrize("missing", [os.W_OK, os.X_OK])
@pytest.mark.parametrize("words", ["sim --out out/deep", "photons --out out/a.npz"])
def test_a_folder_that_is_not_writable_is_told(files, monkeypatch, words, missing):
    """The nearest one that there is: the others would be made. Who may not enter a folder makes no
    files in it, either.
    """
    monkeypatch.setattr(os, "access", lambda path, mode: not mode & missing)
    told = f"cannot be written: {files} is not writable"
    assert_refused(command(words), "out = 'out/", told)
    assert not (files / "out").exists()


def test_result_is_the_golden_models(files):
    given = "--set threshold=1 --set format=full --set fifo_depth=1"
    assert command(f"{REPLAY} --stall 100 {given}").exit_code == 0
    config = load_config("config.toml").with_settings(threshold=1).with_frame(format="full")
    config = config.with_sensor(fifo_depth=1)
    expected = golden_result(config, Edges(**some_edges()), stall(100))
    assert differences(golden_result(config, Edges(**some_edges())), expected)
    with np.load("out/result.npz") as found:
        assert not differences(dict(found), expected)
        assert np.array_equal(found["fate"], expected["fate"])
    assert [path.name for path in (files / "out").iterdir()] == ["result.npz"]


def test_same_input_same_bytes_and_an_earlier_result_stays_where_a_later_run_is_refused(files):
    path = files / "out" / "result.npz"
    command(REPLAY)
    first = path.read_bytes()
    command(REPLAY)
    assert path.read_bytes() == first
    np.savez("edges.npz", **one("tick", -1))
    assert command(REPLAY).exit_code == 2
    assert path.read_bytes() == first


@pytest.mark.parametrize("dtype", [np.int64, np.uint8, np.float64])
def test_empty_edge_file_is_an_empty_frame(files, dtype):
    np.savez("edges.npz", **dict.fromkeys(NAMES, np.empty(0, dtype)))
    assert command(REPLAY).exit_code == 0
    with np.load("out/result.npz") as result:
        assert result["pulse"].shape == result["fate"].shape == (0,)
        assert result["opened"].shape == (2, 2) and not result["opened"].any()


@pytest.mark.parametrize("number, code", [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
@pytest.mark.parametrize("inherited", [signal.SIG_DFL, signal.SIG_IGN])
def test_interrupt_leaves_nothing(files, number, code, inherited):
    """A signal is inherited as the default by a command on a terminal, and as ignored by one in the
    background.
    """
    (files / "edges.npz").unlink()
    os.mkfifo("edges.npz")
    words, disposition = (
        [sys.executable, "-m", "coincid", *REPLAY.split()],
        partial(signal.signal, number, inherited),
    )
    process = subprocess.Popen(
        words, preexec_fn=disposition, stderr=subprocess.PIPE, text=True, encoding="utf-8"
    )
    # opens when the command does, which then waits for bytes
    with process, open("edges.npz", "wb"):
        process.send_signal(number)
        stderr = process.communicate(timeout=60)[1]
    assert (process.returncode, stderr) == (code, "coincid: interrupted\n")
    assert not (files / "out").exists()


@pytest.mark.parametrize(
    ("closed", "words", "code"),
    [
        (">&- 2>&- <&-", "show", 0),
        (">&- 2>&-", "replay --edges none.npz --out x.npz", 2),
    ],
)
def test_a_closed_standard_output_changes_nothing(files, closed, words, code):
    line = f"exec {shlex.quote(sys.executable)} -m coincid {words} {closed}"
    done = subprocess.run(["sh", "-c", line], capture_output=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (code, b"", b"")


@pytest.mark.parametrize("words", ["show", "--help"])
def test_an_output_that_nobody_reads_any_more_ends_as_the_signal_of_it_does(words):
    """Without a word, as a shell expects it; code 1 means that the RTL differs."""
    line = [sys.executable, "-m", "coincid", words]
    with subprocess.Popen(line, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        process.stdout.close()
        stderr = process.stderr.read()
    assert (process.returncode, stderr) == (128 + signal.SIGPIPE, b"")


def test_a_current_folder_that_is_gone_is_told(tmp_path):
    command = f"{shlex.quote(sys.executable)} -m coincid photons --out edges.npz"
    line = f"mkdir gone; cd gone; rmdir ../gone; exec {command}"
    done = subprocess.run(["sh", "-c", line], cwd=tmp_path, capture_output=True, check=False)
    told = f"coincid: the current folder: {os.strerror(errno.ENOENT)}\n"
    assert (done.returncode, done.stderr.decode()) == (2, told)


@pytest.mark.parametrize("words", ["show", "--help"])
def test_a_full_standard_output_is_told_in_one_line(words):
    with open("/dev/full", "w", encoding="utf-8") as full:
        done = subprocess.run(
            [sys.executable, "-m", "coincid", words],
            stdout=full,
            stderr=subprocess.PIPE,
            text=True,
            encoding="utf-8",
        )
    told = f"coincid: standard output: {os.strerror(errno.ENOSPC)}\n"
    assert (done.returncode, done.stderr) == (2, told)


@pytest.mark.parametrize(
    ("told", "kept"),
    [
        ("80", "80"),
        ("120", "120"),
        ("999", "999"),
        ("1000", "999"),
        ("²", "999"),
        ("0", None),
        ("10", "10"),
        ("", ""),
        (None, None),
    ],
)
@pytest.mark.parametrize("name", ["COLUMNS", "LINES"])
def test_only_sizes_of_a_terminal_that_it_cannot_have_are_replaced(monkeypatch, name, told, kept):
    monkeypatch.delenv(name, raising=False)
    if told is not None:
        monkeypatch.setenv(name, told)
    program._bound_terminal()
    assert os.environ.get(name) == kept


@pytest.mark.parametrize(("told", "stays"), [("0", True), ("1700000000", True), ("-1", False)])
def test_a_time_of_the_build_stays_if_it_is_a_number(monkeypatch, told, stays):
    """Files of a build have it."""
    monkeypatch.setenv("SOURCE_DATE_EPOCH", told)
    program._forget_bad_epoch()
    assert os.environ.get("SOURCE_DATE_EPOCH") == (told if stays else None)


def test_the_version_is_that_of_the_library():
    """Before a command is looked for."""
    done = command("--version no-such-command")
    assert (done.exit_code, done.output) == (0, f"coincid {coincid.__version__}\n")


@pytest.mark.parametrize("size", ["99999999", "²", "0"])
def test_help_for_a_terminal_of_an_odd_size_is_short(size):
    environment = os.environ | {"COLUMNS": size, "LINES": size}
    line = [sys.executable, "-m", "coincid", "replay", "--help"]
    done = subprocess.run(line, env=environment, capture_output=True, check=True)
    assert 100 < len(done.stdout) < 100_000


@pytest.mark.parametrize("unbuffered", ["", "1"])
def test_where_nothing_can_be_said_the_exit_code_tells(unbuffered):
    line = f"exec {shlex.quote(sys.executable)} -m coincid show none.toml > /dev/full 2> /dev/full"
    environment = os.environ | {"PYTHONUNBUFFERED": unbuffered}
    done = subprocess.run(["sh", "-c", line], env=environment, capture_output=True, check=False)
    assert done.returncode == 2


def end_of_program(folder, *lines):
    """Return exit code and standard error of the program, in which these lines put another command
    in place of the one that is typed.
    """
    program = folder / "program.py"
    text = ["from coincid import __main__", *lines, "__main__.main()", ""]
    program.write_text("\n".join(text), encoding="utf-8")
    words = [sys.executable, "-m", program.stem]
    done = subprocess.run(words, cwd=folder, capture_output=True, check=False)
    return done.returncode, done.stderr.decode()


@pytest.mark.parametrize(
    ("error", "told"),
    [
        ("MemoryError('Unable to allocate 9 GiB')", "not enough memory. Unable to allocate 9 GiB"),
        ("MemoryError()", "not enough memory"),
        ("ImportError('a.so: failed to map segment')", "a.so: failed to map segment"),
        ("OSError('no more files')", "no more files"),
        ("OSError(13, 'Permission denied', 'a.npz')", "a.npz: Permission denied"),
        ("OSError(28, 'No space left')", "standard output: No space left"),
        ("OSError(2, 'No such file', 'a.npz')", "a.npz: No such file"),
    ],
)
def test_a_lack_of_memory_is_told_in_one_line(tmp_path, error, told):
    ended = end_of_program(
        tmp_path,
        "def command():",
        "    try:",
        "        try:",
        f"            raise {error}",
        "        except ImportError as cause:",
        "            raise ImportError('many\\nlines') from cause",
        "    except ImportError:",
        "        raise ImportError('more\\nlines')",
        "__main__._command = command",
    )
    assert ended == (2, f"coincid: {told}\n")


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_after_the_last_word_changes_nothing(number):
    """The work is done, so the exit code says how."""
    code = "import os, signal, atexit; from coincid import __main__; "
    code += f"atexit.register(os.kill, os.getpid(), {int(number)}); __main__.main()"
    done = subprocess.run([sys.executable, "-c", code, "show"], capture_output=True, check=False)
    assert (done.returncode, done.stderr) == (0, b"")


@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_a_signal_outside_of_a_command_has_its_own_exit_code(tmp_path, number, code):
    """As while the commands are imported."""
    ended = end_of_program(
        tmp_path,
        "import os, time",
        "from coincid.model.shared.interrupts import interruptible",
        "def command():",
        "    interruptible()",
        f"    os.kill(os.getpid(), {int(number)})",
        "    time.sleep(60)",
        "__main__._command = command",
    )
    assert ended == (code, "coincid: interrupted\n")


def test_an_interrupt_in_code_that_comes_as_text_has_the_usual_exit_code(tmp_path):
    """Named tuples and classes of attrs are such code while a command is imported. Python would end
    by the signal, with -2.
    """
    ended = end_of_program(
        tmp_path,
        "import coincid.model.shared.interrupts",
        "__main__._command = lambda: exec('raise KeyboardInterrupt')",
    )
    assert ended == (130, "coincid: interrupted\n")


LONG_NAME = "a" * 300


@pytest.mark.parametrize(
    "words",
    [
        f"show {LONG_NAME}.toml",
        f"photons --scene flat:5 --out {LONG_NAME}.npz",
        f"sim --engine golden --scene {LONG_NAME}.png",
        f"sim --engine golden --scene flat:5 --klux {LONG_NAME}",
    ],
)
def test_a_name_that_no_file_can_have_gets_a_sentence(words, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    result = command(words)
    assert result.exit_code == 2 and result.stderr.count("\n") == 1 and LONG_NAME in result.stderr
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("name", get_command(app).commands)
def test_help_shows_every_text_whole(name):
    """Square brackets, too, which the library that lays it out takes for markup."""
    shown = letters(command(f"{name} --help").output.replace("│", " "))
    one = get_command(app).commands[name]
    for text in (getdoc(one.callback), *(parameter.help for parameter in one.params)):
        assert letters(text.replace("\\[", "[")) in shown
    assert "[[" not in shown


def test_without_a_word_every_command_is_shown_with_its_help():
    shown = letters(command("").output.replace("│", " "))
    for name, one in get_command(app).commands.items():
        assert letters(f"{name} {getdoc(one.callback)}") in shown


@pytest.mark.parametrize("value", ["True", "1", "yes", ""])
def test_a_switch_of_the_detector_is_true_or_false(value, tmp_path):
    given = "photons --scene flat:5 --set rows=8 --set cols=8 --set pulses=5"
    result = command(f"{given} --spad paralyzable={value} --out {tmp_path}/edges.npz")
    assert result.exit_code == 2
    assert "must be true or false" in result.stderr
    for legal in ("true", "false"):
        result = command(f"{given} --spad paralyzable={legal} --out {tmp_path}/edges.npz")
        assert result.exit_code == 0, result.stderr


def test_photons_of_pictures_that_move_are_of_as_many_frames(tmp_path):
    np.save(tmp_path / "moves.npy", np.full((3, 8, 8), 5.0))
    given = "--set rows=8 --set cols=8 --set pulses=5"
    result = command(f"photons --scene {tmp_path}/moves.npy {given} --out {tmp_path}/edges.npz")
    assert result.exit_code == 0, result.stderr
    assert "edges of 15 pulses" in result.stdout


def letters(text):
    """Return a text without its spaces and line ends, which also stand within words."""
    return "".join(text.split())


def test_budget_for_programs_and_people():
    result = command(
        "budget --distance-m 4 --reflectivity 0.4 --klux 50 --spectrum planck --form corrected --json"
    )
    wanted = link_budget(4.0, 0.4, 50.0, spectrum="planck", form="corrected").json()
    assert json.loads(result.stdout) == wanted
    text = command("budget").stdout
    assert all(key in text for key in wanted)
    for words, form in (("", "literal"), ("--form corrected", "corrected")):
        lines = command(f"budget --distance-m 3 --klux 20 {words}").stdout.splitlines()
        rows = link_budget(3.0, 0.4, 20.0, form=form).rows()
        for line, (name, value, unit, source) in zip(lines, rows, strict=True):
            number = value if isinstance(value, str) else f"{value:.6g}"
            assert line.split() == [name, *number.split(), *unit.split(), *source.split()]


def test_the_table_of_an_advice_has_each_number_under_its_head(monkeypatch, tmp_path):
    """With the light that falls on the sunlit pixels, over all pixels."""
    sensor = {"sensor": {"rows": 8, "cols": 8}}
    config = parse_config(sensor | {"frame": {"pulses": 10, "link_gbps": 2.5}})
    config = config.with_settings(threshold=4, window=16)
    one = Tried(
        config=config,
        wrong=0.0123,
        far=0.0046,
        error_mm=7.84,
        bits=1_234_567,
        dropped=0.031,
        load=0.42,
    )
    asked = []

    def advice_of(setup, *, klux, progress):
        asked.append(klux)
        return Advice(settings=[one], chosen=one, links=[], best=one, klux=klux)

    monkeypatch.setattr("coincid.study.advise.advise", advice_of)
    monkeypatch.setattr("coincid.study.advise.write_advice", lambda out, *given: [out / "a.csv"])
    words = "--klux 10|30 --set rows=8 --set cols=8"
    shown = command(f"advise sun-and-shade:0.5 {words} --out", tmp_path).stdout.splitlines()
    cells = next(re.split(r"\s{2,}", line.strip()) for line in shown if "1,234,567" in line)
    window_ns = f"{16 * config.tick_s * 1e9:.3g}"
    rate = f"{one.frames_per_s:,.0f}"
    shares = "1.2%", "0.5%", "7.8", "1,234,567", "3.1%", "42%"
    assert cells == ["4", window_ns, config.format, "2.5", *shares, rate]
    assert asked == [pytest.approx((0.5 * 10 + 30) / 2)]


def test_show_has_a_line_for_each_value_and_each_warning(monkeypatch):
    """Names are in one column; warnings begin with a star."""
    rows = [("first", "1 m"), ("a second one", "2 GHz")]
    sentences = ["Nothing is seen.", "The link is too slow."]
    asked = []
    monkeypatch.setattr("coincid.study.explain.meaning", lambda of: asked.append(of) or rows)
    monkeypatch.setattr("coincid.study.explain.warnings", lambda of: asked.append(of) or sentences)
    shown = command("show fpga --set threshold=3").stdout.splitlines()
    expected = ["first            1 m", "a second one     2 GHz"]
    assert shown == [*expected, *(f"* {sentence}" for sentence in sentences)]
    assert all(of.sensor.phases == 8 and set(of.threshold) == {3} for of in asked)
    assert len(asked) == 2


def test_an_export_is_told_with_its_number_of_files_and_their_size(monkeypatch, tmp_path):
    """In kB of 1000 bytes."""

    def write_release(out, config, view, prefix):
        files = [out / f"{prefix}{number}.v" for number in range(3)]
        for number, path in enumerate(files):
            path.write_bytes(bytes(1000 + 400 * number))
        return files

    monkeypatch.setattr("coincid.flow.release.write_release", write_release)
    shown = command("verilog --prefix near_ --out", tmp_path).stdout
    assert shown == f"{tmp_path}: 3 files, 4 kB\n"


def test_the_sentences_of_an_advice_stand_around_its_table(monkeypatch, tmp_path):
    """First whether any setting is of use, then what is known of the scene and what limits it, and
    the advice at the end.
    """
    config = parse_config({"sensor": {"rows": 8, "cols": 8}})
    one = Tried(config=config, wrong=0, far=0, error_mm=7.84, bits=1, dropped=0, load=0)
    told = {"useless": "No use.", "limit": "A limit.", "counts": "Counts do."}
    advice = SimpleNamespace(tried=[one], best=one, price="5 mW", sentence="Take it.", **told)
    written = [tmp_path / "a.csv", tmp_path / "b.png"]
    monkeypatch.setattr("coincid.study.advise.advise", lambda *_, **__: advice)
    monkeypatch.setattr("coincid.study.advise.write_advice", lambda *_: written)
    monkeypatch.setattr(
        "coincid.lab.setup.scene_of",
        lambda *given, **meaning: evolve(scene_of(*given, **meaning), notes=("Two holes.",)),
    )
    words = f"advise flat:4 --set rows=8 --set cols=8 --out {tmp_path}"
    first, *table, price, note, limit, counts, sentence, files = command(words).stdout.splitlines()
    assert first == "No use." and any("7.8" in line for line in table)
    assert price.startswith("Every row: 5 mW. ")
    assert (note, limit, counts, sentence) == ("Two holes.", "A limit.", "Counts do.", "Take it.")
    assert files == f"{written[0]} {written[1]}"
    advice.useless = advice.counts = ""
    shown = command(words).stdout.splitlines()
    assert "No use." not in shown and "Counts do." not in shown and "" not in shown[-4:]


def test_a_conversion_tells_what_it_read_what_it_left_out_and_what_it_wrote(monkeypatch, files):
    recorded = SimpleNamespace(kind="a table", sync=np.zeros(1234, np.int64))
    converted = Edges(*[np.zeros(1100, np.int64)] * 3)
    notes = {"period_note": "Another period.", "offsets_note": "No offsets."}
    monkeypatch.setattr("coincid.model.recorded.exchange.read_recording", lambda *_: recorded)
    monkeypatch.setattr("coincid.model.recorded.exchange.write_edges", lambda *_: None)
    monkeypatch.setattr(
        "coincid.model.recorded.exchange.offsets_note", lambda *_: notes["offsets_note"]
    )
    monkeypatch.setattr(
        "coincid.model.recorded.recordings.period_note", lambda *_: notes["period_note"]
    )
    monkeypatch.setattr(
        "coincid.model.recorded.recordings.recorded_edges",
        lambda *_, **__: (converted, {"late": 134}),
    )
    monkeypatch.setattr(
        "coincid.model.recorded.recordings.told", lambda lost: f"{lost['late']} too late"
    )
    shown = command("edges own.csv --out a.npz").stdout.splitlines()
    first, last = "own.csv: a table, 1,234 photons", "a.npz: 1,100 edges"
    assert shown == [first, "Another period.", "left out: 134 too late", "No offsets.", last]
    notes |= dict.fromkeys(notes, "")
    shown = command("edges own.csv --out a.npz").stdout.splitlines()
    assert shown == [first, "left out: 134 too late", last]


@pytest.mark.parametrize(
    ("name", "page", "writer"),
    [
        ("synth", "docs/synthesis.md", "coincid.flow.synth.write_synthesis_page"),
        ("pnr", "docs/own.md", "coincid.flow.pnr.write_placement_page"),
    ],
)
def test_the_page_that_is_written_is_told(monkeypatch, tmp_path, name, page, writer):
    """That of the project, unless another file is named."""
    written = []
    board = SimpleNamespace(page="docs/own.md", goal_mhz=1.0, sampled="")
    monkeypatch.setattr("coincid.flow.fpga_module.fpga_module", lambda: board)
    monkeypatch.setattr("coincid.flow.pnr.place", lambda board: [])
    monkeypatch.setattr(writer, lambda *given: written.append(given[-1]))
    assert command(name).stdout == f"{page}\n"
    own = tmp_path / "own.md"
    assert command(f"{name} --out", own).stdout == f"{own}\n"
    assert written == [None, own]
    assert_refused(command(f"{name} --out", tmp_path), "is a folder, must be a file")


def test_the_bitstream_of_a_board_and_its_page_are_written_and_told(monkeypatch, tmp_path):
    board, written = SimpleNamespace(top="lights", page="docs/own.md"), []
    (tmp_path / "placed").write_bytes(b"bits")
    placed = SimpleNamespace(bitstream=tmp_path / "placed")
    monkeypatch.setattr("coincid.board.release.emulator_release", lambda *given: {})
    monkeypatch.setattr("coincid.board.release.write_emulator", lambda *given: [])
    monkeypatch.setattr("coincid.board.lint.lint_emulator", lambda *given: {})
    monkeypatch.setattr("coincid.board.place.ulx3s", lambda *given: board)
    monkeypatch.setattr("coincid.flow.pnr.place", lambda board: [placed])
    monkeypatch.setattr("coincid.flow.pnr.fastest", lambda placements: placements[0])
    monkeypatch.setattr(
        "coincid.flow.pnr.write_placement_page", lambda *given: written.append(given)
    )
    monkeypatch.setattr("coincid.flow.pnr.missed", lambda *given: [])
    out, page = tmp_path / "out", tmp_path / "page.md"
    done = command("emulator --out", out, "--page", page)
    assert done.stdout.splitlines()[1:] == [f"{out / 'lights.bit'}", f"{page}"]
    assert (out / "lights.bit").read_bytes() == b"bits"
    assert written == [(board, [placed], page)]


def test_each_netlist_that_is_simulated_is_told_at_once(monkeypatch):
    def gate_levels():
        yield "gates: all words agree"
        yield "cells: all words agree"

    monkeypatch.setattr("coincid.flow.gls.gate_levels", gate_levels)
    assert command("gls").stdout.splitlines() == list(gate_levels())


@pytest.mark.parametrize("missed", [(), ("clk: 90 MHz, 100 needed", "tck: none")])
def test_a_clock_that_misses_its_goal_is_told_and_in_the_exit_code(monkeypatch, missed):
    """A clock that is late by its pins is only a warning."""
    board = SimpleNamespace(page="docs/own.md")
    monkeypatch.setattr("coincid.flow.fpga_module.fpga_module", lambda: board)
    monkeypatch.setattr("coincid.flow.pnr.place", lambda board: ["placed"])
    monkeypatch.setattr("coincid.flow.pnr.write_placement_page", lambda *given: None)
    monkeypatch.setattr("coincid.flow.pnr.skewed", lambda *given: ["pin a", "pin b"])
    monkeypatch.setattr("coincid.flow.pnr.missed", lambda *given: missed)
    done = command("pnr")
    assert (done.exit_code, done.stdout) == (bool(missed), "docs/own.md\n")
    assert done.stderr.splitlines() == [
        "coincid: warning: pin a",
        "coincid: warning: pin b",
        *(f"coincid: {line}" for line in missed),
    ]


@pytest.mark.parametrize("failing", [(), ("tree",), ("tree", "fifo", "tdc")])
def test_proofs_that_hold_are_counted_and_the_others_are_named(monkeypatch, tmp_path, failing):
    """Each with the place of its log; one of them is enough for the exit code."""

    def prove(names, tell):
        tell(f"asked for {' '.join(names)}")
        return [
            SimpleNamespace(
                proof=SimpleNamespace(name=name),
                reason="step 3" if name in failing else "",
                folder=tmp_path / name,
            )
            for name in names
        ]

    monkeypatch.setattr("coincid.formal.prove.prove", prove)
    done = command("formal tree fifo tdc sequencer")
    assert done.exit_code == bool(failing)
    assert "asked for tree fifo tdc sequencer" in done.stdout
    assert done.stdout.splitlines()[-1] == f"{4 - len(failing)} of 4 proofs hold"
    assert done.stderr.splitlines() == [
        f"coincid: {name}: step 3; log: {tmp_path / name / 'log'}" for name in failing
    ]


@pytest.fixture
def doubtful(monkeypatch):
    """Let scenes have doubts and notes, and photons be none; return what is asked for."""
    asked = []

    class Doubtful:
        doubts = ("It is dark.", "It is far.")
        notes = ("12 pixels are left out.", "The rest is there.")

    def setup(**fields):
        asked.append(fields)
        return SimpleNamespace(
            photons=SimpleNamespace(edges=lambda workers: Edges(*[np.zeros(3, np.int64)] * 3)),
            seen=Doubtful,
            config=fields["config"],
        )

    monkeypatch.setattr("coincid.lab.setup.scene_of", lambda config, scene, **_: Doubtful)
    monkeypatch.setattr("coincid.lab.setup.for_pictures", lambda config, scene: config)
    monkeypatch.setattr("coincid.lab.setup.Setup", setup)
    return asked


def test_doubts_about_a_scene_are_told_first_and_notes_at_the_end(doubtful, files):
    result = command("photons --scene room.npy --set frames=2 --set pulses=7 --out a.npz")
    assert result.exit_code == 0, result.output
    assert result.stdout.splitlines() == [
        "Check this first: It is dark.",
        "Check this first: It is far.",
        "12 pixels are left out.",
        "The rest is there.",
        "a.npz: 3 edges of 14 pulses",
    ]


def test_photons_are_written_at_the_clock_of_their_configuration(doubtful, files, monkeypatch):
    """Formats of other programs have times, not ticks."""
    written = []
    monkeypatch.setattr(
        "coincid.model.recorded.exchange.write_edges", lambda *given: written.append(given[-1])
    )
    assert command("photons --clock-mhz 200 --set period=60 --out a.ptu").exit_code == 0
    (timing,) = written
    assert (timing.clock_hz, timing.period_cycles) == (200e6, 60)


@pytest.mark.parametrize("scene", ["flat:5", "flat", "five-objects", "sun-and-shade"])
def test_the_light_is_that_which_is_given_or_the_usual_one_of_the_scene(doubtful, files, scene):
    command(f"photons --scene {scene} --out a.npz")
    command(f"photons --scene {scene} --klux 0 --out a.npz")
    assert [fields["klux"] for fields in doubtful] == [usual_klux(scene), "0"]


@pytest.mark.parametrize("view", ["polyphase", "async"])
def test_pulses_of_a_frame_scale_the_bounds_of_the_controller(monkeypatch, tmp_path, view):
    """So that it chooses the same thresholds in a shorter frame."""
    asked = []
    monkeypatch.setattr(
        "coincid.study.simulate.simulate_to_folder", lambda setup, **_: asked.append(setup.config)
    )
    words = f"sim --scene flat:5 --out {tmp_path / 'out'} --view {view} --pulses 20"
    given = "--set", "pulses=100", "--set", "auto_bounds=[0, 200, 400, 600, 800, 1000]"
    result = command(words, *given)
    assert result.exit_code == 0, result.output
    (config,) = asked
    assert config.pulses == 20
    assert list(config.frame.auto_bounds) == [0, 40, 80, 120, 160, 200]


@pytest.mark.parametrize(
    "words, engine, pulses, settling, waves",
    [
        ("", "sliced", 100, None, False),
        ("--waves", "verilator", 100, None, True),
        ("--waves --engine icarus", "icarus", 100, None, True),
        ("--pulses 7 --frames 3", "sliced", 7, 3, False),
        ("--view async", "icarus", 4, 1, False),
        ("--view async --pulses 7 --frames 3 --engine verilator", "verilator", 7, 3, False),
    ],
)
def test_engine_pulses_and_frames_of_sim_are_those_of_the_view(
    monkeypatch, tmp_path, words, engine, pulses, settling, waves
):
    """Unless they are given: the asynchronous view takes long."""
    asked = []

    def simulated(setup, **options):
        asked.append((setup, options))

    monkeypatch.setattr("coincid.study.simulate.simulate_to_folder", simulated)
    result = command(f"sim --scene flat:5,0.4 --out {tmp_path / 'out'} {words}")
    assert result.exit_code == 0, result.output
    ((setup, options),) = asked
    assert (setup.engine, setup.config.pulses) == (engine, pulses)
    assert (options["settling"], options["waves"]) == (settling, waves)
    assert setup.view == ("async" if "async" in words else "polyphase")


@pytest.fixture(scope="session")
def exports(tmp_path_factory):
    """Exports of the default sensor over an earlier export, and of 8 x 16 pixels: name -> {file:
    bytes}.
    """
    folder = tmp_path_factory.mktemp("rtl")
    (folder / FILE_LIST).write_text("stale.v\n", encoding="utf-8")
    (folder / "stale.v").write_text("module stale; endmodule\n", encoding="utf-8")
    earlier = {"name": TOP, "sha256": {FILE_LIST: "", "stale.v": ""}}
    (folder / MANIFEST).write_text(json.dumps(earlier), encoding="utf-8")
    assert command("verilog", "--out", folder).exit_code == 0
    return {"default": contents(folder), "small": contents(small_releases() / "silicon")}


def contents(folder):
    """Return the files in a folder and in its folders: path -> bytes."""
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in folder.rglob("*")
        if path.is_file()
    }


@pytest.mark.xdist_group("exports")
def test_export_has_the_files_that_its_list_names(exports):
    assert "stale.v" not in exports["default"]
    sizes = []
    for files in exports.values():
        listed = files[FILE_LIST].decode().split()
        for_cells = files[CELLS_LIST].decode().split() if CELLS_LIST in files else []
        assert {*listed, *for_cells} == {
            name for name in files if name.endswith(".v") and "smoke" not in name
        }
        assert f"{TOP}.v" in listed
        sizes.append(sum(len(files[name]) for name in listed))
    assert max(sizes) <= 1.3 * min(sizes)  # it does not grow with the array


@pytest.mark.xdist_group("exports")
def test_export_names_no_place_of_this_machine(exports):
    programs = os.path.dirname(sys.executable), os.path.dirname(np.__file__)
    places = {os.getcwd(), os.path.expanduser("~"), *programs, "/tmp/", "/work/"}
    for name, data in exports["default"].items():
        assert not [place for place in places if len(place) > 1 and place.encode() in data], name


def test_export_replaces_nothing_but_an_export(tmp_path):
    (tmp_path / "thesis.tex").write_text("x", encoding="utf-8")
    assert_refused(command("verilog", "--out", tmp_path), tmp_path.name, "empty")
    assert (tmp_path / "thesis.tex").exists()


@pytest.mark.xdist_group("exports")
def test_register_files_agree_with_the_register_table(exports, tmp_path):
    files, sensor = exports["default"], parse_config({}).sensor
    described = json.loads(files[JSON])
    built = {name: register for name, register in BY_NAME.items() if register.count(sensor)}
    assert built.keys() < BY_NAME.keys()  # without counts
    assert {register["name"] for register in described["global"] + described["subgroup"]} == set(
        built
    )
    for register in described["subgroup"]:
        at = described["subgroup_base"] + 3 * described["subgroup_stride"] + register["offset"]
        assert at == address(register["name"], 3)
    checks = [f'#include "{HEADER}"']
    for name, register in built.items():
        assert f"| {name} |".encode() in files[MARKDOWN]
        index = int(register.count(sensor) > 1)
        arguments = ", ".join(["3"] * (register in SUBGROUP) + ["1"] * index)
        macro = f"COINCID_{name.upper()}" + (f"({arguments})" if arguments else "")
        checks.append(f'_Static_assert({macro} == {address(name, 3, index)}u, "{name}");')
    (tmp_path / "check.c").write_text("\n".join(checks), encoding="utf-8")
    (tmp_path / HEADER).write_bytes(files[HEADER])
    subprocess.run(
        ["gcc", "-std=c11", "-Wall", "-Werror", "-fsyntax-only", tmp_path / "check.c"], check=True
    )


def lint(sensor, view="polyphase"):
    """Return the result of the command."""
    given = " ".join(f"--set '{key}={value}'" for key, value in sensor.items())
    return command(f"lint --set period=100 --view {view} {given}")


@pytest.mark.long
@pytest.mark.parametrize("name", ("fine", "odd", "tiny"))
def test_lint_is_clean(name):
    """Nothing is found except waived warnings."""
    result = lint(SENSORS[name])
    assert result.exit_code == 0, result.output
    assert result.stdout.splitlines()[0] == "verilator: clean"


def test_lint_tells_what_it_finds_in_each_top():
    """Also in the first one, if the last one is clean."""
    files = {
        "odd.v": "module odd(output b); assign b = c; endmodule\n",
        "clean.v": "module clean(output b); assign b = 1'b0; endmodule\n",
        CONTROL_FILE: "`verilator_config\n",
    }
    found = findings(files, [("odd", ["odd.v"]), ("clean", ["clean.v"])], POLYPHASE)
    assert set(found) == {"verilator", "icarus"}
    assert all("odd.v" in said for said in found.values())


@pytest.mark.parametrize("tool", ["verilator", "icarus"])
def test_a_finding_of_any_tool_is_in_the_exit_code(monkeypatch, tool):
    found = {"verilator": "", "icarus": ""} | {tool: "odd.v:1: odd"}
    monkeypatch.setattr("coincid.flow.lint.lint", lambda *_: found)
    result = lint(SENSORS["one"])
    assert result.exit_code == 1 and "odd.v:1: odd" in result.output


ONE_PLACE = SENSORS["one"] | {"fifo_depth": 1}
ALL_BUILT = SMALLEST | {"minigroup": [2, 2], "fifo_depth": 1, "counts": 1}


@pytest.mark.parametrize(
    "view, own, sensor", [("polyphase", OF_SENSOR, ALL_BUILT), ("async", OF_CELLS, ONE_PLACE)]
)
def test_lint_finds_what_is_waived_and_nothing_else(monkeypatch, view, own, sensor):
    """A waiver that no sensor needs would hide future warnings. own: those of the view."""
    monkeypatch.setattr("coincid.flow.release.control_file", lambda view: "`verilator_config\n")
    result = lint(sensor, view)
    assert result.exit_code == 1 and "verilator: found" in result.stdout
    found = r"^%Warning-(\w+): ([^:]+):[\d:]+ (.*)"
    warnings = re.findall(found, result.stdout, re.MULTILINE)
    exact = re.sub(r"^`else.*?^`endif", "", OF_SENSOR + own, flags=re.MULTILINE | re.DOTALL)
    waivers = re.findall(r'^lint_off (-rule \w+ -file ".*" -match ".*")$', exact, re.MULTILINE)
    patterns = [re.escape(waiver).replace(r"\*", ".*") for waiver in waivers]
    shown = [f'-rule {rule} -file "{file}" -match "{message}"' for rule, file, message in warnings]
    assert [
        one for one in shown if not any(re.fullmatch(pattern, one) for pattern in patterns)
    ] == []
    needed = {
        waiver
        for waiver, pattern in zip(waivers, patterns, strict=True)
        if any(re.fullmatch(pattern, one) for one in shown)
    }
    assert {waiver for waiver in waivers if waiver in own} <= needed
