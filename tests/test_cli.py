# SPDX-License-Identifier: Apache-2.0
"""The edge of the `coincid` command: bad input, remaining files, and the output of replay and export."""

import contextlib
import io
import json
import os
import re
import signal
import subprocess
import sys
import zipfile

import numpy as np
import pytest

from coincid.flow.register_files import HEADER, JSON, MARKDOWN
from coincid.flow.release import CELLS_LIST
from coincid.flow.waivers import OF_CELLS, OF_SENSOR
from coincid.hdl.export import FILE_LIST
from coincid.model.contract.config import load_config, parse_config
from coincid.model.contract.edges import NAMES, Edges
from coincid.model.contract.parameters import TOP
from coincid.model.contract.registers import BY_NAME, address
from coincid.model.contract.result import differences, stall
from coincid.model.golden.frame import golden_result
from coincid.model.light.link_budget import link_budget

from .command import assert_refused, command
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


def some_edges(n=200):
    rng = np.random.default_rng(5)
    return {name: rng.integers(0, high, n) for name, high in zip(NAMES, (PULSES, PIXELS, PERIOD_TICKS))}


@pytest.fixture
def files(tmp_path):
    """Return a folder with a good configuration and good edges."""
    (tmp_path / "config.toml").write_text(CONFIG)
    np.savez(tmp_path / "edges.npz", **some_edges())
    return tmp_path


def replay(folder, *more):
    words = f"replay --config {folder}/config.toml --edges {folder}/edges.npz --out {folder}/out/result.npz"
    return command(words, *more)


BAD_CONFIGS = {  # tests/contract/test_config.py has the others
    "unknown key": ("[subgroup]\nthreshhold = 2", "threshhold", "threshold"),
    "unknown table": ("[subgroups]\nthreshold = 2", "subgroups", "subgroup"),
    "rows without subgroups": ("[sensor]\nrows = 12", "sensor.rows = 12", "multiple of 8"),
    "override of nothing": ("[[override]]\nsubgroups = [16]", "override[0].subgroups = 16", "from 0 to 15"),
    "not TOML": ("threshold:", "TOML"),
}


@pytest.mark.parametrize("name", BAD_CONFIGS)
@pytest.mark.parametrize("job", ["replay", "sim", "verilog", "lint"])
def test_bad_configuration(files, name, job):
    text, *words = BAD_CONFIGS[name]
    (files / "config.toml").write_text(text)
    more = {"replay": ("--edges", files / "edges.npz"), "lint": ()}.get(job, ())
    out = () if job == "lint" else ("--out", files / "out" / "x")
    assert_refused(command(job, "--config", files / "config.toml", *more, *out), "config.toml", *words)
    assert not (files / "out").exists()


def test_missing_configuration_names_the_presets(files):
    result = command(f"verilog --config {files}/none.toml --out {files}/out")
    assert_refused(result, "none.toml", "no such file", "silicon", "fpga")


def one(name, value, dtype=np.int64):
    edges = some_edges()
    edges[name] = edges[name].astype(dtype)
    edges[name][7] = value
    return edges


BAD_EDGES = {
    "pixel out of range": (one("pixel", PIXELS), "pixel[7] = 128", "from 0 to 127"),
    "tick out of range": (one("tick", PERIOD_TICKS), "tick[7] = 1280", "from 0 to 1279"),
    "pulse beyond the frames": (one("pulse", PULSES), "pulse[7] = 6", "from 0 to 5"),
    "negative tick": (one("tick", -1), "tick[7] = -1", "from 0 to 1279"),
    "huge": (one("tick", 2**64 - 1, np.uint64), "tick[7]", "from 0 to 1279"),
    "floats": (one("tick", 0.5, np.float64), "tick", "integers"),
    "booleans": ({name: array > 0 for name, array in some_edges().items()}, "pulse", "integers"),
    "two dimensions": ({name: array.reshape(2, -1) for name, array in some_edges().items()}, "pulse", "1"),
    "unequal lengths": (some_edges() | {"pixel": some_edges()["pixel"][:-1]}, "lengths", "pixel 199"),
    "missing array": ({name: some_edges()[name] for name in ("pulse", "pixel")}, "'tick'"),
    "objects": (some_edges() | {"tick": np.array([None] * 200)}, "edges.npz"),
}


@pytest.mark.parametrize("name", BAD_EDGES)
def test_bad_edges(files, name):
    arrays, *words = BAD_EDGES[name]
    np.savez(files / "edges.npz", **arrays)
    assert_refused(replay(files), "edges.npz", *words)
    assert not (files / "out").exists()


def single_array():
    out = io.BytesIO()
    np.save(out, np.arange(5))
    return out.getvalue()


def other_archive():
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w") as archive:
        for name in NAMES:
            archive.writestr(f"{name}.npy", b"nothing")
    return out.getvalue()


@pytest.mark.parametrize("content", [single_array(), other_archive(), b"", b"text"])
def test_file_that_is_no_edges(files, content):
    """Damaged files are in `recorded/test_recordings.py`."""
    (files / "edges.npz").write_bytes(content)
    assert_refused(replay(files), "edges.npz")
    assert not (files / "out").exists()


def test_no_edge_file(files):
    (files / "edges.npz").unlink()
    assert_refused(replay(files), "edges.npz", "no such file")


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--stall", -1), ("stall = -1", "from 0 to")),
        (("--engine", "cocotb-verilator"), ("engine = 'cocotb-verilator'", "golden, sliced, verilator, icarus")),
    ],
)
def test_bad_options(files, options, words):
    assert_refused(replay(files, *options), *words)
    assert not (files / "out").exists()


@pytest.mark.parametrize("job", ["replay", "sim", "verilog"])
def test_output_below_a_file(files, job):
    more = ("--edges", files / "edges.npz") if job == "replay" else ()
    result = command(job, "--config", files / "config.toml", *more, "--out", files / "edges.npz" / "out.npz")
    assert_refused(result, "out.npz", "cannot be written")
    assert sorted(path.name for path in files.iterdir()) == ["config.toml", "edges.npz"]


def test_output_that_is_a_folder(files):
    result = command("replay", "--config", files / "config.toml", "--edges", files / "edges.npz", "--out", files)
    assert_refused(result, "is a folder")


def test_result_is_the_golden_models(files):
    assert replay(files, "--stall", 100, "--set", "threshold=1", "--set", "format=full").exit_code == 0
    config = load_config(files / "config.toml").with_settings(threshold=1).with_frame(format="full")
    expected = golden_result(config, Edges(**some_edges()), stall(100))
    with np.load(files / "out" / "result.npz") as found:
        assert not differences(dict(found), expected)
        assert np.array_equal(found["fate"], expected["fate"])
    assert [path.name for path in (files / "out").iterdir()] == ["result.npz"]


def test_same_input_same_bytes_and_an_earlier_result_stays_where_a_later_run_is_refused(files):
    path = files / "out" / "result.npz"
    replay(files)
    first = path.read_bytes()
    replay(files)
    assert path.read_bytes() == first
    assert replay(files, "--stall", -1).exit_code == 2
    np.savez(files / "edges.npz", **one("tick", -1))
    assert replay(files).exit_code == 2
    assert path.read_bytes() == first


@pytest.mark.parametrize("dtype", [np.int64, np.uint8, np.float64])
def test_empty_edge_file_is_an_empty_frame(files, dtype):
    np.savez(files / "edges.npz", **dict.fromkeys(NAMES, np.empty(0, dtype)))
    assert replay(files).exit_code == 0
    with np.load(files / "out" / "result.npz") as result:
        assert result["pulse"].shape == result["fate"].shape == (0,)
        assert result["opened"].shape == (2, 2)
        assert not result["opened"].any()


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--scene", "letter-g"), ("letter-g",)),
        (("--klux", -1), ("klux = -1",)),
        (("--klux", "nan"), ("klux = nan",)),
        (("--pulses", 0), ("pulses = 0", "from 1 to 65536")),
        (("--seed", -1), ("seed = -1", "from 0 to")),
        (("--engine", "vcs"), ("engine = 'vcs'", "golden, sliced, verilator, icarus")),
        (("--engine", "sliced", "--waves"), ("engine = 'sliced'", "waveform", "verilator and icarus")),
        (("--engine", "sliced", "--view", "async"), ("async = 'sliced'", "verilator, icarus")),
        (("--clock-mhz", 0), ("clock",)),
    ],
)
def test_bad_options_of_sim(files, options, words):
    assert_refused(command("sim", "--out", files / "out", *options), *words)
    assert not (files / "out").exists()


@pytest.mark.parametrize("number, code", [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
@pytest.mark.parametrize("inherited", [signal.SIG_DFL, signal.SIG_IGN])
def test_interrupt_leaves_nothing(files, number, code, inherited):
    """A signal is inherited as the default by a command on a terminal, and as ignored by one in the background."""
    (files / "edges.npz").unlink()
    os.mkfifo(files / "edges.npz")
    words = "-m coincid replay --config config.toml --edges edges.npz --out out/result.npz"
    with disposition(number, inherited):
        process = subprocess.Popen([sys.executable, *words.split()], cwd=files, stderr=subprocess.PIPE, text=True)
    with process, open(files / "edges.npz", "wb"):  # opens when the command does, which then waits for bytes
        process.send_signal(number)
        stderr = process.communicate(timeout=60)[1]
    assert process.returncode == code
    assert stderr == "coincid: interrupted\n"
    assert not (files / "out").exists()


@contextlib.contextmanager
def disposition(number, action):
    """Set what programs started in the block inherit for a signal."""
    before = signal.signal(number, action)
    try:
        yield
    finally:
        signal.signal(number, before)


def test_budget_for_programs_and_people():
    result = command("budget --distance-m 4 --reflectivity 0.4 --klux 50 --spectrum planck --form corrected --json")
    wanted = link_budget(4.0, 0.4, 50.0, spectrum="planck", form="corrected").json()
    assert json.loads(result.stdout) == wanted
    text = command("budget").stdout
    assert all(key in text for key in wanted)
    assert_refused(command("budget", "--form", "printed"), "form = 'printed'", "literal", "corrected")
    assert_refused(command("budget", "--reflectivity", 2), "reflectivity = 2", "from 0 to 1")


@pytest.fixture(scope="session")
def exports(tmp_path_factory):
    """Exports of the default sensor over an earlier export, and of 8 x 16 pixels: name -> {file: bytes}."""
    folder = tmp_path_factory.mktemp("rtl")
    (folder / FILE_LIST).write_text("stale.v\n")
    (folder / "stale.v").write_text("module stale; endmodule\n")
    assert command("verilog", "--out", folder).exit_code == 0
    return {"default": contents(folder), "small": contents(small_releases() / "silicon")}


def contents(folder):
    """Return the files in a folder and in its folders: path -> bytes."""
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@pytest.mark.xdist_group("exports")
def test_export_does_not_grow_with_the_array(exports):
    def size(files):
        return sum(len(files[name]) for name in files[FILE_LIST].decode().split())

    assert size(exports["default"]) <= 1.3 * size(exports["small"])


@pytest.mark.xdist_group("exports")
def test_export_has_the_files_that_its_list_names(exports):
    assert "stale.v" not in exports["default"]
    for files in exports.values():
        listed = files[FILE_LIST].decode().split()
        for_cells = files[CELLS_LIST].decode().split() if CELLS_LIST in files else []
        assert {*listed, *for_cells} == {name for name in files if name.endswith(".v") and "smoke" not in name}
        assert f"{TOP}.v" in listed


@pytest.mark.xdist_group("exports")
def test_export_names_no_place_of_this_machine(exports):
    programs = os.path.dirname(sys.executable), os.path.dirname(np.__file__)
    places = {os.getcwd(), os.path.expanduser("~"), *programs, "/tmp/", "/work/"}
    for name, data in exports["default"].items():
        assert not [place for place in places if len(place) > 1 and place.encode() in data], name


def test_export_replaces_nothing_but_an_export(tmp_path):
    (tmp_path / "thesis.tex").write_text("x")
    assert_refused(command("verilog", "--out", tmp_path), tmp_path.name, "empty")
    assert (tmp_path / "thesis.tex").exists()


@pytest.mark.xdist_group("exports")
def test_register_files_agree_with_the_register_table(exports, tmp_path):
    files, sensor = exports["default"], parse_config({}).sensor
    described = json.loads(files[JSON])
    assert {register["name"] for register in described["global"] + described["subgroup"]} == set(BY_NAME)
    for register in described["subgroup"]:
        at = described["subgroup_base"] + 3 * described["subgroup_stride"] + register["offset"]
        assert at == address(register["name"], 3)
    for name in BY_NAME:
        assert f"| {name} |".encode() in files[MARKDOWN]

    checks = []
    for name, register in BY_NAME.items():
        arguments = ["3"] * (register in BY_NAME.values() and f"COINCID_{name.upper()}(sg".encode() in files[HEADER])
        arguments += ["1"] * (register.count(sensor) > 1)
        macro = f"COINCID_{name.upper()}" + (f"({', '.join(arguments)})" if arguments else "")
        checks.append(f'_Static_assert({macro} == {address(name, 3, int(register.count(sensor) > 1))}u, "{name}");')
    source = tmp_path / "check.c"
    source.write_text(f'#include "{HEADER}"\n' + "\n".join(checks))
    (tmp_path / HEADER).write_bytes(files[HEADER])
    subprocess.run(["gcc", "-std=c11", "-Wall", "-Werror", "-fsyntax-only", source], check=True)


def lint(folder, name, view="polyphase"):
    """Return the result of the command for a sensor of `SENSORS`."""
    config = folder / "config.toml"
    sensor = "".join(f"{key} = {value}\n" for key, value in SENSORS[name].items())
    config.write_text(f"[sensor]\n{sensor}[frame]\nperiod = 100\n")
    return command("lint", "--config", config, "--view", view)


@pytest.mark.parametrize("name", ("fine", "odd"))
def test_lint_is_clean(tmp_path, name):
    """Nothing is found except waived warnings."""
    result = lint(tmp_path, name)
    assert result.exit_code == 0, result.output
    assert result.stdout.splitlines()[0] == "verilator: clean"


@pytest.mark.parametrize(
    ("view", "names", "own"), [("polyphase", ("one", "tiny"), OF_SENSOR), ("async", ("one",), OF_CELLS)]
)
def test_lint_finds_what_is_waived_and_nothing_else(tmp_path, monkeypatch, view, names, own):
    """A waiver that no sensor needs would hide future warnings. own: those of the view."""
    monkeypatch.setattr("coincid.flow.release.control_file", lambda view: "`verilator_config\n")
    needed = set()
    for name in names:
        result = lint(tmp_path, name, view)
        assert result.exit_code == 1 and "verilator: found" in result.stdout
        for rule, file, message in re.findall(r"^%Warning-(\w+): ([^:]+):[\d:]+ (.*)", result.stdout, re.MULTILINE):
            waived = {waiver for waiver in waivers(OF_SENSOR + own) if _covers(waiver, rule, file, message)}
            assert waived, (rule, file, message)
            needed |= waived
    assert needed >= {*waivers(own)}


def waivers(text):
    """Return (rule, pattern of files, pattern of messages) of every waiver in a control file."""
    found = re.findall(r'^lint_off -rule (\w+) -file "(.*)" -match "(.*)"$', text, re.MULTILINE)
    assert found
    return found


def _covers(waiver, rule, file, message):
    """Return whether a warning has the waiver's rule and fits its patterns, in which only * is special."""
    patterns = (re.escape(pattern).replace(r"\*", ".*") for pattern in waiver[1:])
    return waiver[0] == rule and all(map(re.fullmatch, patterns, (file, message)))
