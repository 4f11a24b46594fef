# SPDX-License-Identifier: Apache-2.0
"""The release folder by itself: it compiles, lints and passes its smoke test without this project,
and it is consistent.
"""

import errno
import hashlib
import io
import json
import os
import re
import shutil
import subprocess
import sys
from collections import Counter
from fnmatch import fnmatch
from itertools import pairwise
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from attrs import evolve

from coincid.flow import release
from coincid.flow.captured import captured_files
from coincid.flow.limits import beats_beside_cycles, largest_frame
from coincid.flow.plain_names import plain_verilog
from coincid.flow.ports import stream_words
from coincid.flow.prefix import checked_prefix
from coincid.flow.register_files import IP_XACT
from coincid.flow.release import CELLS_LIST, MANIFEST, phase_clock, write_release
from coincid.flow.release import _manifest as manifest_of
from coincid.flow.smoke import FPGA_SMOKE, SMOKE, smoke_configs, smoke_edges, smoke_test
from coincid.flow.yosys import LIBERTY, cells_folder
from coincid.hdl.deserialiser import CYCLES
from coincid.hdl.export import FILE_LIST
from coincid.hdl.front_end_views import POLYPHASE, view_at
from coincid.hdl.sensor import FPGA_TOP, SensorTop
from coincid.hdl.unit import Port
from coincid.model.contract import latency, registers
from coincid.model.contract.config import load_config, parse_config
from coincid.model.contract.counters import COUNTER_NAMES
from coincid.model.contract.counts import GATES
from coincid.model.contract.edges import Edges
from coincid.model.contract.packet import built_formats
from coincid.model.contract.parameters import TOP
from coincid.model.contract.pixels import pixel_table
from coincid.model.contract.registers import reset_values
from coincid.model.contract.stream import COLUMN, decode_frame
from coincid.model.golden.frame import Golden
from coincid.model.shared.errors import InputError
from coincid.model.shared.files import read_npz
from coincid.tb import toolchain
from coincid.tb.rtl import rtl
from coincid.tools.wheels import run_program, run_yosys

from ..exports import EXPORTS, PASSED, complaint, readme_commands, write_export
from ..random_cases import LEAN, SENSORS, built_sensor, configured, random_edges
from ..releases import CLOCK_MHZ, SMALL, config, small_releases
from .pair_rule import Pair

TOPS = [
    ("silicon", TOP, SMOKE),
    ("fpga", TOP, SMOKE),
    ("fpga", FPGA_TOP, FPGA_SMOKE),
    ("async", TOP, SMOKE),
]
ROOT = Path(__file__).parents[2]
PROGRAMS = "iverilog vvp sh dirname"
COMMANDS = ("verilator --lint-only", "verilator --binary", "iverilog", "fusesoc")  # of the README
COMPILED = ("verilator --binary", "fusesoc")  # by Verilator and g++


@pytest.fixture(scope="module")
def releases(tmp_path_factory):
    """A copy, because simulators write to it."""
    return Path(shutil.copytree(small_releases(), tmp_path_factory.mktemp("release") / "all"))


def files(folder):
    """Return the files of a folder and of the folders in it, by their names from there."""
    return {path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file()}


PHYSICAL = ".//ipxact:physicalPort/ipxact:name"


def line_of_readme(folder, pattern):
    return re.search(
        rf"^ +({pattern}.*)$", (folder / "README.md").read_text(encoding="utf-8"), re.MULTILINE
    )[1]


def simulated(folder, smoke=SMOKE, sources=f"-f {SMOKE}.f", arguments=""):
    """Return the finished smoke test of a release, on Icarus."""
    compiled = f"iverilog -g2005 -s {smoke} -o smoke.vvp {sources}"
    return alone(f"{compiled} && vvp -n smoke.vvp {arguments}", folder)


def alone(command, folder, path=""):
    """Run a shell command in `folder`, without this project's environment and without Python."""
    programs = Path(folder).parent / "programs"
    if not programs.exists():
        programs.mkdir()
        for program in PROGRAMS.split():
            (programs / program).symlink_to(shutil.which(program))
    environment = {"PATH": f"{programs}:{toolchain.verilator().parent}:{path}"}
    return subprocess.run(
        command,
        shell=True,
        cwd=folder,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
        encoding="utf-8",
    )


@pytest.mark.parametrize(("preset", "top", "smoke"), TOPS)
def test_the_readme_is_right(releases, preset, top, smoke):
    """The smoke test passes on Icarus, and Verilator's lint finds nothing, with the commands of the
    README.
    """
    folder = releases / preset
    line = line_of_readme(folder, f"iverilog .*{smoke} ").replace(
        "iverilog", "iverilog -Wall -Wno-timescale"
    )
    done = alone(line, folder)
    assert re.fullmatch(r"PASS: \d\d\d+ checks\n", done.stdout) and not done.stderr, (
        done.stdout + done.stderr
    )
    assert done.returncode == 0
    line = line_of_readme(folder, f"verilator --lint-only .*{top} ")
    assert "-Wall" in line and "-Wno" not in line
    done = alone(f"{line} --quiet-stats", folder)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")


@pytest.mark.parametrize("preset", SMALL)
def test_any_tool_reads_the_folder_and_its_lists(releases, tmp_path, preset):
    folder = releases / preset
    for sources in ("*.v", *(f"-f {path.name}" for path in sorted(folder.glob("*.f")))):
        done = alone(f"iverilog -g2012 -o all.vvp {sources}", folder)
        assert (done.returncode, done.stdout, done.stderr) == (0, "", ""), sources
    verilog = [Path(shutil.copy(path, tmp_path)).name for path in sorted(folder.glob("*.v"))]
    run_yosys(tmp_path, f"read_verilog -sv {' '.join(verilog)}", f"hierarchy -check -top {TOP}")


def test_smoke_test_passes_with_the_forms_for_cells(releases, tmp_path):
    """With the latches and the clock gates of `CELLS_LIST`: the same words in the same cycles."""
    done = simulated(releases / "silicon", sources=f"-f {CELLS_LIST} {SMOKE}.v")
    assert re.fullmatch(r"PASS: \d\d\d+ checks\n", done.stdout), done.stdout + done.stderr


@pytest.mark.parametrize("preset", SMALL)
def test_captured_streams_decode_to_their_rows(releases, preset):
    of, folder = config(preset).sensor, releases / preset / "captured"
    for name in built_formats(of):
        (text,) = folder.glob(f"*_{name}.txt")
        rows = [line.split() for line in text.read_text(encoding="utf-8").splitlines()[1:]]
        result = read_npz(text.with_suffix(".npz"), ("subgroup", "stamp", "count", "opened"))
        events = text.with_suffix(".csv").read_text(encoding="utf-8").splitlines()[1:]
        assert len(events) == len(result["subgroup"]) > 0
        for stream in range(of.streams):
            own_rows = [(int(beat, 16), last) for k, beat, last in rows if int(k) == stream]
            beats = np.array([beat for beat, _ in own_rows], np.uint64)
            assert [last for _, last in own_rows] == ["0"] * (len(beats) - 1) + ["1"]
            frame = decode_frame(beats, of, len(of.stream_subgroups(stream))).check()
            mine = np.isin(result["subgroup"], of.stream_subgroups(stream))
            assert np.array_equal(frame.events[:, COLUMN["stamp"]], result["stamp"][mine])
            assert [
                int(line.split(",")[2]) for line, own in zip(events, mine, strict=True) if own
            ] == list(result["stamp"][mine])


def of_events(name, value):
    """Return how a field of an event is written in a table."""
    if name == "hits":
        return "".join(f"{int(part):016x}" for part in value[::-1])
    return " ".join(map(str, value.tolist())) if name == "mg_offset" else str(int(value))


def test_columns_of_captured_rows_are_named_as_the_arrays(releases):
    """A reader by name finds what the whole result has."""
    for csv in sorted(releases.glob("*/captured/*.csv")):
        (head, *rows) = (line.split(",") for line in csv.read_text(encoding="utf-8").splitlines())
        result = read_npz(csv.with_suffix(".npz"), head)
        assert {"subgroup", "pulse", "stamp", "count"} <= set(head)
        for number, name in enumerate(head):
            shown = [row[number] for row in rows]
            assert shown == [of_events(name, value) for value in result[name]], (csv.name, name)
        stream = csv.with_suffix(".txt").read_text(encoding="utf-8").splitlines()[0]
        assert stream == "stream beat last"


def test_columns_of_captured_counts_are_those_of_their_gates():
    """Pixel by pixel of each subgroup, in the order of the minigroups."""
    sensor = built_sensor(SENSORS["counting"])
    made = captured_files(sensor)
    (csv,) = (name for name in made if name.endswith("_counts.csv"))
    head, *rows = (line.split(",") for line in made[csv].decode().splitlines())
    with np.load(io.BytesIO(made[csv.replace(".csv", ".npz")])) as result:
        cycles, hits = result["gate_cycle"][0], result["gate_hits"][0]
        pulses = result["count_pulses"][0]
    table = pixel_table(sensor)
    assert len(rows) == sensor.array_pixels and hits.any()
    pixels = []
    for row in rows:
        of = dict(zip(head, row, strict=True))
        s, pixel = int(of.pop("subgroup")), int(of.pop("pixel"))
        pixels.append((s, table.minigroup[pixel], table.bit[pixel]))
        assert of.pop("count_pulses") == str(pulses[s, pixel])
        for gate in range(GATES):
            assert of.pop(f"gate_cycle_{gate}") == str(cycles[s, table.minigroup[pixel], gate])
            shown = of.pop(f"gate_hits_{gate}")
            assert shown == " ".join(map(str, hits[s, pixel, gate]))
        assert not of
    assert pixels == sorted(pixels) and len(set(pixels)) == len(pixels)


@pytest.fixture(scope="module")
def smallest(tmp_path_factory):
    folder = tmp_path_factory.mktemp("smallest") / "rtl"
    write_export(folder, "smallest")
    return folder


def test_no_command_of_the_readme_is_forgotten(smallest):
    commands = readme_commands(smallest)
    assert {
        program for program in COMMANDS for command in commands if command.startswith(program)
    } == {*COMMANDS}
    assert all(command.startswith(COMMANDS) for command in commands)


@pytest.mark.parametrize(
    "program",
    [pytest.param(name, marks=[pytest.mark.long] if name in COMPILED else []) for name in COMMANDS],
)
def test_commands_of_the_readme(smallest, tmp_path, program):
    """As they stand there, in a clean folder, each for every top."""
    folder = shutil.copytree(smallest, tmp_path / "rtl")
    for command in readme_commands(folder):
        if command.startswith(program):
            assert complaint(command, folder, toolchain.verilator().parent, cheap=True) == ""


@pytest.mark.needs("verilator")
@pytest.mark.parametrize("name", ("smallest", "lean", "async", "counts"))
def test_lint_of_the_readme_on_verilator_of_the_system(tmp_path, name):
    """The waivers work in older versions, too."""
    other = shutil.which("verilator")
    write_export(tmp_path, name)
    for command in readme_commands(tmp_path):
        if command.startswith("verilator --lint-only"):
            assert complaint(command, tmp_path, Path(other).parent) == ""


SHIM = """
  // Ready follows valid, as behind an adapter; valid and what comes with it stay until then.
  reg [2:0] age = 0;
  wire aw_open, w_open, ar_open, awready, wready, arready;
  always @(posedge clk) age <= {age[1:0], s_axi_awvalid || s_axi_wvalid || s_axi_arvalid};
  assign aw_open = age[0] && s_axi_awvalid;
  assign w_open = age[2] && s_axi_wvalid;
  assign ar_open = age[1] && s_axi_arvalid;
  assign s_axi_awready = aw_open && awready;
  assign s_axi_wready = w_open && wready;
  assign s_axi_arready = ar_open && arready;
  reg [56:0] aw = 0, w = 0, ar = 0;
  wire [56:0] aw_now = {s_axi_awvalid, 36'd0, s_axi_awaddr};
  wire [56:0] w_now = {s_axi_wvalid, 20'd0, s_axi_wstrb, s_axi_wdata};
  wire [56:0] ar_now = {s_axi_arvalid, 36'd0, s_axi_araddr};
  always @(posedge clk) begin
    if (aw[56] && aw != aw_now || w[56] && w != w_now || ar[56] && ar != ar_now) $display("FAIL: let go");
    aw <= s_axi_awready ? 57'd0 : aw_now;
    w <= s_axi_wready ? 57'd0 : w_now;
    ar <= s_axi_arready ? 57'd0 : ar_now;
  end
endmodule
"""


def test_smoke_test_works_behind_an_adapter(smallest):
    """The bench does not wait for ready before it raises valid, and holds it until ready, on each
    channel for itself.
    """
    text = (smallest / f"{SMOKE}.v").read_text(encoding="utf-8")
    for channel in ("aw", "w", "ar"):
        for wire, inner in (
            (f"{channel}valid", f"{channel}_open"),
            (f"{channel}ready", f"{channel}ready"),
        ):
            assert f".s_axi_{wire}(s_axi_{wire})" in text
            text = text.replace(f".s_axi_{wire}(s_axi_{wire})", f".s_axi_{wire}({inner})")
    (smallest / "adapted.v").write_text(SHIM.join(text.rsplit("endmodule\n", 1)), encoding="utf-8")
    done = simulated(smallest, sources="-f coincid.f adapted.v")
    assert PASSED.fullmatch(done.stdout.strip()), done.stdout + done.stderr


def test_smoke_test_writes_a_waveform(smallest):
    """With the argument of the README; the wave has the start of the frame."""
    readme = (smallest / "README.md").read_text(encoding="utf-8")
    argument = re.search(r"`(\+waves=\S+)`", readme)[1]
    done = simulated(smallest, arguments=argument)
    assert any(map(PASSED.fullmatch, done.stdout.splitlines())), done.stdout + done.stderr
    wave = (smallest / argument.partition("=")[2]).read_text(encoding="utf-8")
    laser = re.search(r"^\$var wire 1 (\S+) laser \$end$", wave, re.MULTILINE)[1]
    assert f"\n1{laser}\n" in wave


INITIAL_VALUE = re.compile(r"^(  reg (?:\[\d+:\d+\] )?\S+ ?) = \d+'[hd][0-9a-f]+;$", re.MULTILINE)
INITIAL_MEMORY = re.compile(r"^  initial begin\n.*?^  end\n", re.MULTILINE | re.DOTALL)


@pytest.mark.parametrize("sources", (FILE_LIST, CELLS_LIST))
def test_smoke_test_passes_without_initial_values(smallest, tmp_path, sources):
    """Every register is undefined at power-on, and a reset defines what matters."""
    folder = shutil.copytree(smallest, tmp_path / "rtl")
    for path in (*folder.glob("coincid_*.v"), *folder.glob("cells/*.v")):
        if path.stem not in (SMOKE, FPGA_SMOKE):
            text = INITIAL_VALUE.sub(r"\1;", path.read_text(encoding="utf-8"))
            text = INITIAL_MEMORY.sub("", text)
            assert not re.search(r"^  reg .* = |^  initial begin", text, re.MULTILINE)
            path.write_text(text, encoding="utf-8")
    done = simulated(folder, sources=f"-f {sources} {SMOKE}.v")
    assert PASSED.fullmatch(done.stdout.strip()), done.stdout + done.stderr


PREFIXES = {"near_": "smallest", "far_": "lean"}


@pytest.fixture(scope="module")
def two_sensors(tmp_path_factory):
    """Return a folder with two exports, each with a prefix."""
    folder = tmp_path_factory.mktemp("two") / "rtl"
    for prefix, name in PREFIXES.items():
        tables, view = EXPORTS[name]
        write_release(folder, parse_config(tables), view, prefix)
    return folder


def test_two_sensors_with_prefixes_are_one_simulation(two_sensors):
    """Each smoke test passes with both sensors in the design."""
    lists = " ".join(f"-f {prefix}{FILE_LIST}" for prefix in PREFIXES)
    for prefix in PREFIXES:
        tops = " ".join([f"-s {prefix}{SMOKE}", *(f"-s {other}{TOP}" for other in PREFIXES)])
        sources = f"{lists} {prefix}{SMOKE}.v"
        command = f"iverilog -g2005 {tops} -o {prefix}.vvp {sources} && vvp -n {prefix}.vvp"
        done = alone(command, two_sensors)
        assert PASSED.fullmatch(done.stdout.strip()), done.stdout + done.stderr


def test_every_name_of_an_export_has_its_prefix(two_sensors):
    """Modules, macros, C symbols, files, cores and names of register maps."""
    names = re.compile(r"(?<![A-Za-z0-9_*])V?(coincid_|COINCID_)|(?<![\w.])manifest\.json")
    for prefix in PREFIXES:
        manifest = json.loads((two_sensors / f"{prefix}{MANIFEST}").read_text(encoding="utf-8"))
        for name, digest in manifest["sha256"].items():
            content = (two_sensors / name).read_bytes()
            assert hashlib.sha256(content).hexdigest() == digest, name
            assert Path(name).name.startswith(prefix)
            if not name.startswith("captured/"):
                wrong = [line for line in content.decode().splitlines() if names.search(line)]
                assert not wrong, name
        waivers = (two_sensors / f"{prefix}coincid.vlt").read_text(encoding="utf-8")
        (latches,) = re.findall(r'-rule LATCH -file "(.*?)"', waivers)
        cells = [name for name in manifest["sha256"] if name.startswith("cells/")]
        assert cells and all(fnmatch(name, latches) for name in cells)
        core = (two_sensors / f"{prefix}{TOP}.core").read_text(encoding="utf-8")
        assert f'name: "coincid:sensor:{prefix}{TOP}:' in core
        header = (two_sensors / f"{prefix}coincid_regs.h").read_text(encoding="utf-8")
        macros = re.findall(r"^#define (\w+)", header, re.MULTILINE)
        assert macros and all(name.startswith(f"{prefix.upper()}COINCID_") for name in macros)


def test_a_prefix_changes_names_only_in_the_manifest(two_sensors, smallest):
    plain, near = (
        json.loads(path.read_text(encoding="utf-8"))
        for path in (smallest / MANIFEST, two_sensors / f"near_{MANIFEST}")
    )
    assert FPGA_TOP in plain["tops"]
    assert near.pop("name") == f"near_{plain.pop('name')}"
    assert near.pop("tops") == [f"near_{top}" for top in plain.pop("tops")]
    assert len(near.pop("sha256")) == len(plain.pop("sha256"))
    assert near == plain


def test_an_export_replaces_only_that_with_its_prefix(two_sensors, tmp_path):
    folder = shutil.copytree(two_sensors, tmp_path / "rtl")
    (folder / f"near_{TOP}.v").write_text("old", encoding="utf-8")
    write_release(folder, parse_config(EXPORTS["smallest"][0]), prefix="near_")
    manifests = [folder / f"{prefix}{MANIFEST}" for prefix in PREFIXES]
    of_exports = {path.name for path in manifests}
    for path in manifests:
        of_exports |= json.loads(path.read_text(encoding="utf-8"))["sha256"].keys()
    others = files(two_sensors) - of_exports  # such as compiled simulations
    assert files(folder) == of_exports | others
    assert (folder / f"near_{TOP}.v").read_bytes() == (two_sensors / f"near_{TOP}.v").read_bytes()


@pytest.mark.parametrize("prefix", ["", "a", "A1_", "x" * 40])
def test_a_prefix_may_be_of_letters_digits_and_underscores(prefix):
    """So long as the longest that a simulator takes."""
    assert checked_prefix(prefix) == prefix
    with pytest.raises(InputError, match="at most 40 characters"):
        checked_prefix(prefix + "\n")


@pytest.mark.parametrize("prefix", ["1st_", "a-", "a b", "_a", "ä_", "x" * 41])
def test_a_prefix_that_begins_no_name_is_refused(prefix, tmp_path):
    with pytest.raises(InputError, match="prefix .*must be letters"):
        write_release(tmp_path / "rtl", parse_config(EXPORTS["smallest"][0]), prefix=prefix)
    assert not (tmp_path / "rtl").exists()


def test_the_events_of_the_asynchronous_view_are_clocks_of_inputs_only(releases):
    text = (releases / "async" / f"{TOP}.sdc").read_text(encoding="utf-8")
    (pattern,) = re.findall(r"create_clock -name spads .*\[get_ports \{(.*)\}\]", text)
    ports = SensorTop(config("async").sensor, view_at("async", 400)).ports()
    matched = {
        port.name
        for port in ports
        for one in pattern.split()
        if re.fullmatch(one.replace("[*]", r"(\[\d+\])?"), port.name)
    }
    assert matched == {port.name for port in ports if re.fullmatch(r"spad_\d+", port.name)}


# of the period: what the outside takes; an input stays a little after the edge, an output need not
SHARES = {
    ("input", "min"): 0.05,
    ("input", "max"): 0.4,
    ("output", "min"): 0.0,
    ("output", "max"): 0.4,
}


@pytest.mark.parametrize("preset, top", [(preset, top) for preset, top, _ in TOPS])
def test_constraints_have_minimum_and_maximum(releases, preset, top):
    text = (releases / preset / f"{top}.sdc").read_text(encoding="utf-8")
    for kind in ("input", "output"):
        ports = {
            bound: re.findall(rf"^set_{kind}_delay -{bound} .*get_ports (.*)\]$", text, re.M)
            for bound in ("min", "max")
        }
        assert ports["min"] == ports["max"] and len(ports["min"]) >= 8
        for bound in ports:
            shares = re.findall(
                rf"^set_{kind}_delay -{bound} \[expr (\S+) \* \$period\]", text, re.M
            )
            assert set(map(float, shares)) == {SHARES[kind, bound]}
    assert not re.search(r"^set_(input|output)_delay \[", text, re.M)


def registered_ports(sensor, top):
    """Return a netlist with the ports of a top, in which a flip-flop takes each bit of an input and
    drives each bit of an output.
    """
    ports = [Port("clk", 1, True), Port("rst", 1, True)]
    ports += SensorTop(sensor, levels=top == FPGA_TOP).ports()
    names = ", ".join(port.name for port in ports)
    lines = [f"module {top} ({names});"]
    for port in ports:
        bits = f"[{port.width - 1}:0] " if port.width > 1 else ""
        lines.append(f"  {'input' if port.is_input else 'output'} {bits}{port.name};")
    for port in ports[1:]:
        for k in range(port.width):
            bit = f"{port.name}[{k}]" if port.width > 1 else port.name
            pin = f".D({bit})" if port.is_input else f".D(rst), .Q({bit})"
            lines.append(f"  DFF_X1 {port.name}_{k} (.CK(clk), {pin});")
    return "\n".join([*lines, "endmodule", ""])


@pytest.mark.needs("cells")
@pytest.mark.parametrize(("preset", "top"), [("silicon", TOP), ("fpga", TOP), ("fpga", FPGA_TOP)])
def test_a_timing_tool_takes_the_constraints(releases, tmp_path, preset, top):
    """OpenSTA complains about nothing: every object exists, and every port has a constraint, but the
    lines of SPADs, which know no clock.
    """
    (tmp_path / "netlist.v").write_text(
        registered_ports(config(preset).sensor, top), encoding="utf-8"
    )
    shutil.copy(releases / preset / f"{top}.sdc", tmp_path / "top.sdc")
    commands = [
        f"read_liberty {cells_folder() / LIBERTY}",
        "read_verilog netlist.v",
        f"link_design {top}",
        "read_sdc top.sdc",
        "check_setup -no_clock -loops",
        "" if top == FPGA_TOP else "check_setup -no_input_delay -unconstrained_endpoints",
        'puts "PATHS"',
        "report_checks -path_delay max",
        "report_checks -path_delay min",
    ]
    (tmp_path / "check.tcl").write_text("\n".join([*commands, ""]), encoding="utf-8")
    told = run_program(["sta", "-exit", "check.tcl"], tmp_path, "sta")
    complaints, found, paths = told.partition("PATHS\n")
    assert found and not re.search(r"Warning|Error", complaints), complaints
    assert len(re.findall(r" slack \(", paths)) == 2, paths


def test_constraints_of_the_fpga_top_bound_the_skew_of_the_lines(releases):
    text = (releases / "fpga" / f"{FPGA_TOP}.sdc").read_text(encoding="utf-8")
    assert "set_false_path" not in text
    assert "set_max_delay $period -from $lines" in text
    assert re.search(r"set_bus_skew -from \$lines -to .*\[expr 0\.5 \* \$tick\]", text)


def test_constraints_of_the_fpga_top_have_a_clock_for_each_tick_of_half_a_cycle(releases):
    """Clock j rises j ticks after clk; the lines are sampled on both of its edges."""
    text = (releases / "fpga" / f"{FPGA_TOP}.sdc").read_text(encoding="utf-8")
    period_ns = float(re.search(r"set period ([\d.]+)", text)[1])
    made = re.findall(r"-name phase_(\d+) .*-waveform \{([\d.]+) ([\d.]+)\}", text)
    phases = config("fpga").sensor.phases
    assert [int(number) for number, _, _ in made] == list(range(1, phases // 2))
    for number, rise_ns, fall_ns in made:
        assert float(rise_ns) == pytest.approx(int(number) * period_ns / phases, rel=1e-4)
        assert float(fall_ns) - float(rise_ns) == pytest.approx(period_ns / 2, rel=1e-4)


@pytest.mark.parametrize("phases", (4, 8, 32))
def test_constraints_name_each_bit_of_the_phase_clocks_as_verilog_does(phases):
    """A port of one bit has no index."""
    sensor = parse_config({"sensor": {"phases": phases, "rows": 8, "cols": 8}}).sensor
    ports = {port.name: port.width for port in SensorTop(sensor, levels=True).ports()}
    width = ports["phase_clocks"]
    bits = ["phase_clocks"] if width == 1 else [f"phase_clocks[{bit}]" for bit in range(width)]
    assert [phase_clock(sensor, j) for j in range(1, phases // 2)] == bits


def test_the_smoke_test_takes_no_undefined_bit_for_a_right_one():
    """A check whose comparison is undefined would pass."""
    for line in (ROOT / "flow" / "smoke_bench.vh").read_text(encoding="utf-8").splitlines():
        if re.search(r"\bcheck\((?!input|whole)", line):
            assert "===" in line, line


@pytest.mark.parametrize("coarse_bits", (3, 4, 10))
@pytest.mark.parametrize("phases", (4, 32))
def test_edges_of_a_smoke_test_are_in_its_period(coarse_bits, phases):
    """Also in the shortest one that a sensor may have."""
    sensor = built_sensor(
        {"rows": 8, "cols": 8, "coarse_bits": coarse_bits, "phases": phases, "window_max": 8}
    )
    for of_frame in smoke_configs(sensor):
        edges = smoke_edges(of_frame)
        assert edges.tick.min() >= (CYCLES + 1) * phases
        assert edges.tick.max() < (of_frame.period - 2) * phases


@pytest.mark.long
@pytest.mark.parametrize(
    "sensor",
    [SENSORS["tiny"], SENSORS["odd"], SENSORS["counting"], LEAN],
    ids=["tiny", "odd", "counting", "lean"],
)
def test_smoke_test_of_other_sensors(sensor, tmp_path):
    folder = tmp_path / "rtl"
    write_release(folder, parse_config({"sensor": sensor, "frame": {"period": 100}}))
    for smoke in (SMOKE, FPGA_SMOKE):
        if (folder / f"{smoke}.f").exists():
            done = simulated(folder, smoke, f"-f {smoke}.f")
            assert done.stdout.startswith("PASS"), done.stdout + done.stderr


WORD, RTL, CONSTANT = (
    ("64'hc0", "64'hc1"),
    ("~ to_border", "to_border"),
    ("32'd1129269582", "32'd0"),
)


@pytest.mark.parametrize(
    "file, old, new", [(f"{SMOKE}.v", *WORD), ("coincid_tree.v", *RTL), (f"{SMOKE}.v", *CONSTANT)]
)
def test_smoke_test_finds_a_difference(releases, tmp_path, file, old, new):
    folder = Path(shutil.copytree(releases / "silicon", tmp_path / "rtl"))
    text = (folder / file).read_text(encoding="utf-8")
    assert old in text
    (folder / file).write_text(text.replace(old, new, 1), encoding="utf-8")
    done = simulated(folder)
    assert "FAIL" in done.stdout and "PASS" not in done.stdout and done.returncode != 0


def test_each_frame_of_a_smoke_test_has_its_own_settings():
    """The settings that it writes leave none of the frame before."""
    sensor = built_sensor(SENSORS["counting"])
    text = smoke_test(sensor)
    written = re.findall(r" setting\[\d+\] = \{20'h(\w+), 32'd(\d+)\};", text)
    begins = [int(at) for at in re.findall(r" setting_from\[\d+\] = (\d+);", text)]
    configs = smoke_configs(sensor)
    assert len(begins) == len(configs) + 1 == 3
    values = reset_values(sensor)
    for of_frame, (begin, end) in zip(configs, pairwise(begins), strict=True):
        values |= {int(at, 16): int(value) for at, value in written[begin:end]}
        wanted = dict(of_frame.register_writes())
        assert {at: values[at] for at in wanted} == wanted


@pytest.mark.parametrize("name", ["odd", "counting"])
def test_a_smoke_test_reads_all_constants_and_all_counters_of_three_subgroups(name):
    """Of the first, the middle and the last one, after each frame; with the golden model's values."""
    sensor = built_sensor(SENSORS[name])
    text = smoke_test(sensor)

    def table(of):
        pattern = rf" {of}\[\d+\] = \{{20'h(\w+), 32'd(\d+)\}};"
        return [(int(at, 16), int(value)) for at, value in re.findall(pattern, text)]

    built = [one for one in registers.built(registers.GLOBAL, sensor)]
    constants = [one for one in built if one.access is registers.Access.CONSTANT]
    assert table("constant") == [(one.offset, one.reset(sensor)) for one in constants]
    played = sorted({0, sensor.subgroups // 2, sensor.subgroups - 1})
    expected, golden = [], Golden(sensor)
    ready = (np.arange(300) % 4 != 0).astype(np.uint8)
    beats = []
    for of_frame in smoke_configs(sensor):
        edges = smoke_edges(of_frame)
        lit = pixel_table(sensor).subgroup[edges.pixel]
        assert set(lit.tolist()) == set(played)
        assert set(edges.pulse.tolist()) == set(range(of_frame.pulses))
        trace = golden.frame(of_frame, edges, ready)
        beats += [int(beat) for stream in trace.beats for beat in stream]
        for s in played:
            places = [registers.address(one, s) for one in COUNTER_NAMES]
            expected += zip(places, trace.counters[s].tolist(), strict=True)
    assert table("counter") == expected
    words = re.findall(r" expected\[\d+\] = 64'h(\w+);", text)
    assert [int(word, 16) for word in words] == beats
    assert "localparam STALL_CYCLES = 300;" in text and "localparam STALL_EVERY = 4;" in text


@pytest.fixture(scope="module")
def counting(tmp_path_factory):
    """Return the folder of a sensor with counts."""
    folder = tmp_path_factory.mktemp("counting") / "rtl"
    write_release(folder, parse_config({"sensor": SENSORS["counting"]}))
    return folder


def test_smoke_test_of_counts_passes_with_the_forms_for_cells(counting):
    """Clocks that stop between frames run while gates are searched, and while counts leave. Every
    answer, word and end of a word is checked.
    """
    done = simulated(counting, sources=f"-f {CELLS_LIST} {SMOKE}.v")
    text = (counting / f"{SMOKE}.v").read_text(encoding="utf-8")
    tables = Counter(re.findall(r"^ +(\w+)\[\d+\] = ", text, re.MULTILINE))
    frames = tables["counter_from"] - 1
    # Of a frame: a write that is refused and cleared, the start, two readings, and its end.
    reads = tables["constant"] + tables["counter"] + 2 * frames
    writes = tables["setting"] + 3 * frames + frames - 1
    checks = 2 * reads + writes + 2 * tables["expected"] + frames
    assert frames == 2 and done.stdout == f"PASS: {checks} checks\n", done.stdout + done.stderr


def test_smoke_test_finds_a_difference_in_counts(counting, tmp_path):
    """In the second frame of its sensor: the frame of events before it passes."""
    folder = shutil.copytree(counting, tmp_path / "rtl")
    file = folder / "coincid_gate_search.v"
    text, replaced = re.subn(
        r"set_gates <= \w+;", "set_gates <= 1'h0;", file.read_text(encoding="utf-8")
    )
    assert replaced == 1
    file.write_text(text, encoding="utf-8")
    done = simulated(folder)
    assert "FAIL" in done.stdout and "PASS" not in done.stdout and done.returncode != 0


@pytest.mark.long
def test_presets_of_one_process_do_not_mix(releases, tmp_path):
    """Each equals the export of a process of its own, with hashes of its own, and contains no file
    of another preset.
    """
    for name in list(SMALL)[1:]:  # the first has none before it in its process
        program = f"from tests.releases import release; release({str(tmp_path / name)!r}, {name!r})"
        subprocess.run(
            [sys.executable, "-c", program],
            cwd=ROOT,
            env=os.environ | {"PYTHONHASHSEED": "17"},
            check=True,
        )
        for path in files(tmp_path / name):
            assert (tmp_path / name / path).read_bytes() == (releases / name / path).read_bytes(), (
                path
            )
        parameters = json.loads((releases / name / MANIFEST).read_text(encoding="utf-8"))[
            "parameters"
        ]
        assert {key: parameters[key] for key in SMALL[name]} == SMALL[name]
    assert not list((releases / "silicon").glob(f"{FPGA_TOP}*"))


@pytest.mark.parametrize("preset", SMALL)
def test_manifest(releases, preset):
    manifest = json.loads((releases / preset / MANIFEST).read_text(encoding="utf-8"))
    for name, digest in manifest["sha256"].items():
        assert hashlib.sha256((releases / preset / name).read_bytes()).hexdigest() == digest, name
    built = {
        path
        for path in files(releases / preset)
        if not path.endswith(".vvp") and not path.startswith("obj/")
    }
    assert built == {*manifest["sha256"], MANIFEST}
    assert manifest["clock_mhz"] == CLOCK_MHZ[preset]
    period_ns = re.search(
        r"^set period (.*)$",
        (releases / preset / f"{TOP}.sdc").read_text(encoding="utf-8"),
        re.MULTILINE,
    )[1]
    assert float(period_ns) == 1000 / CLOCK_MHZ[preset]
    assert manifest["view"] == ("async" if preset == "async" else "polyphase")
    assert (
        load_config("fpga" if preset == "fpga" else "silicon").sensor.phases
        == manifest["parameters"]["phases"]
    )


@pytest.mark.parametrize("preset", SMALL)
def test_the_manifest_has_all_from_which_the_sensor_can_be_made_again(releases, preset):
    """And what follows from it: sizes, tops, and the latencies of the contract."""
    manifest = json.loads((releases / preset / MANIFEST).read_text(encoding="utf-8"))
    sensor = config(preset).sensor
    assert parse_config({"sensor": manifest["parameters"]}).sensor == sensor
    assert manifest["derived"]["subgroups"] == sensor.subgroups
    assert manifest["derived"] == {name: getattr(sensor, name) for name in manifest["derived"]}
    assert manifest["tops"] == [
        top for preset_of, top, _ in dict.fromkeys(TOPS) if preset_of == preset
    ]
    latencies = manifest["latency_cycles"]
    assert ("deserialiser" in latencies) == (FPGA_TOP in manifest["tops"])
    assert latencies.pop("deserialiser", CYCLES) == CYCLES
    told = {name.upper(): cycles for name, cycles in latencies.items()}
    assert told == {name: getattr(latency, name) for name in vars(latency) if name.isupper()}
    assert manifest["name"] == TOP


@pytest.mark.parametrize(("clock_mhz", "told"), [(400.0, "400"), (62.5, "62.5")])
def test_the_clock_of_a_manifest_is_a_whole_number_only_if_it_is_one(clock_mhz, told):
    of = config("silicon").with_frame(clock_mhz=clock_mhz)
    text = manifest_of(of, {f"a_{TOP}.sdc": b""}, POLYPHASE, "a_")
    assert f'"clock_mhz": {told},' in text
    assert json.loads(text)["tops"] == [f"a_{TOP}"]


def test_a_manifest_names_an_own_rule_and_no_other():
    """A sensor with another rule is another circuit."""
    of = config("silicon")
    own = evolve(of, sensor=evolve(of.sensor, rule=Pair()))
    plain, named = (json.loads(manifest_of(one, {}, POLYPHASE, "")) for one in (of, own))
    assert named.pop("parameters") == plain.pop("parameters") | {"rule": "pair 4"}
    assert named == plain


def test_an_export_goes_behind_a_link(monkeypatch, tmp_path):
    """The link stays one; what is told of a folder names it as it was given."""
    monkeypatch.setattr(release, "_contents", lambda *_: {FILE_LIST: b"new"})
    monkeypatch.chdir(tmp_path)
    for name in ("rtl", "other"):
        (tmp_path / "deep" / name).mkdir(parents=True)
        (tmp_path / name).symlink_to(tmp_path / "deep" / name)
    (tmp_path / "deep" / "rtl" / FILE_LIST).write_text("old", encoding="utf-8")
    (tmp_path / "deep" / "other" / "mine").touch()
    assert write_release(Path("rtl"), load_config("silicon")) == [
        tmp_path / "deep" / "rtl" / FILE_LIST
    ]
    assert (tmp_path / "rtl").is_symlink()
    assert (tmp_path / "rtl" / FILE_LIST).read_bytes() == b"new"
    with pytest.raises(InputError, match="^other: holds other things"):
        write_release(Path("other"), load_config("silicon"))


@pytest.mark.parametrize("inside", [None, "mine/deep.v"])
def test_what_is_no_export_is_not_replaced(monkeypatch, tmp_path, inside):
    """A file, or a folder with something in it; nothing is left beside it."""
    monkeypatch.setattr(release, "_contents", lambda *_: {FILE_LIST: b""})
    place = tmp_path / "rtl"
    own = place / inside if inside else place
    own.parent.mkdir(parents=True, exist_ok=True)
    own.write_text("own", encoding="utf-8")
    with pytest.raises(InputError, match=f"^{re.escape(str(place))}: holds other things"):
        write_release(place, load_config("silicon"))
    assert own.read_text(encoding="utf-8") == "own"
    assert list(tmp_path.iterdir()) == [place]


def of_core(folder):
    """Return the file sets and the targets of FuseSoC's core."""
    text = (folder / f"{TOP}.core").read_text(encoding="utf-8")
    return [
        json.loads(re.search(rf"^{key}: (\{{.*?^\}})$", text, re.M | re.S)[1])
        for key in ("filesets", "targets")
    ]


@pytest.mark.parametrize("preset", SMALL)
def test_each_target_of_the_core_has_its_top_and_all_modules_in_it(releases, preset):
    """Of a view with macros, lint has black boxes in their place."""
    sets, targets = of_core(releases / preset)
    fpga = preset == "fpga"
    kinds = {"lint": TOP, "sim": SMOKE, "verilate": SMOKE}
    tops = {"default": TOP, "cells": TOP, **kinds, "driver": None}
    if fpga:
        tops |= {"fpga": FPGA_TOP, "lint_fpga": FPGA_TOP}
        tops |= {"sim_fpga": FPGA_SMOKE, "verilate_fpga": FPGA_SMOKE}
    assert {name: target.get("toplevel") for name, target in targets.items()} == tops
    for name, target in targets.items():
        files_of = {one: sets[one]["files"] for one in target["filesets"]}
        if name == "driver":
            continue
        verilog = [file for one in files_of.values() for file in one if file.endswith(".v")]
        assert len(verilog) == len(set(verilog))
        text = "".join((releases / preset / file).read_text(encoding="utf-8") for file in verilog)
        modules = set(re.findall(r"^module (\w+)", text, re.M))
        used = set(re.findall(r"^  (coincid_\w+) (?:#\(|\w+ \()", text, re.M))
        assert target["toplevel"] in modules and used <= modules, name
        constrained = any(file.endswith(".sdc") for one in files_of.values() for file in one)
        assert constrained == (name in ("default", "cells", "fpga")), name
        waived = any(file.endswith(".vlt") for one in files_of.values() for file in one)
        assert waived == name.startswith(("lint", "verilate")), name


@pytest.mark.parametrize("preset", SMALL)
def test_targets_of_the_core_have_the_tools_the_options_and_the_files_of_the_readme(
    releases, preset
):
    sets, targets = of_core(releases / preset)
    for name, target in targets.items():
        if "flow" not in target:
            continue
        assert target["flow"] == ("lint" if name.startswith("lint") else "sim")
        of_flow = target["flow_options"]
        tool = of_flow["tool"]
        assert tool == ("icarus" if name.startswith("sim") else "verilator")
        options = of_flow["iverilog_options" if tool == "icarus" else "verilator_options"]
        pattern = {"sim": "iverilog", "lint": "verilator --lint-only"}
        begin = pattern.get(name.partition("_")[0], "verilator --binary")
        top = "-s" if tool == "icarus" else "--top-module"
        line = line_of_readme(releases / preset, f"{begin} .*{target['toplevel']} ")
        assert line.startswith(f"{begin} {' '.join(options)} {top} {target['toplevel']} "), name
        assert of_flow.get("mode") == ("binary" if "binary" in begin else None)
        listed = releases / preset / re.search(r" -f (\S+)", line)[1]
        read = [file for one in target["filesets"] for file in sets[one]["files"]]
        verilog = [file for file in read if file.endswith(".v")]
        assert sorted(verilog) == sorted(listed.read_text(encoding="utf-8").split()), name


def test_exported_verilog_is_what_the_other_tests_simulate(releases):
    """With plain names."""
    paths = rtl(config("silicon").sensor)
    simulated_files = {path.name: path.read_text(encoding="utf-8") for path in paths}
    for name, text in plain_verilog(simulated_files).items():
        assert (releases / "silicon" / name).read_text(encoding="utf-8") == text


@pytest.mark.parametrize("preset", SMALL)
def test_names_in_the_verilog_are_plain(releases, preset):
    """No dollar sign, dot or bracket in a name, and no initial value of a wire."""
    of_the_project = {path.name for path in view_at(preset_view(preset), CLOCK_MHZ[preset]).cells}
    for path in sorted((releases / preset).glob("coincid_*.v")):
        text = path.read_text(encoding="utf-8")
        if path.name in of_the_project or path.stem in (SMOKE, FPGA_SMOKE):
            continue
        escaped = set(re.findall(r"\\(\S+)", text))
        assert all(name.isidentifier() for name in escaped), path.name
        assert not re.search(r"\(\* init", text), path.name
        assert set(re.findall(r"\$\w+", text)) <= {"$signed"}, path.name


def preset_view(preset):
    return "async" if preset == "async" else "polyphase"


def test_the_folder_has_licence_and_rule_of_groups(releases):
    for preset in SMALL:
        folder = releases / preset
        assert (folder / "LICENSE").read_bytes() == (ROOT / "LICENSE").read_bytes()
        assert "A group is a packet of kind 5" in (folder / "groups.md").read_text(encoding="utf-8")


@pytest.mark.parametrize("preset", SMALL)
def test_the_example_in_c_prints_the_captured_events(releases, tmp_path, preset):
    shutil.copytree(releases / preset, tmp_path / "export")
    here = {"cwd": tmp_path / "export", "check": True}
    told = (tmp_path / "export" / "README.md").read_text(encoding="utf-8")
    build = "cc -o coincid_decode coincid_decode.c coincid.c"
    assert f"`{build}`" in told
    subprocess.run(build.split(), **here)
    streams = sorted((tmp_path / "export" / "captured").glob("*.txt"))
    for stream in streams:
        command = ["./coincid_decode", f"captured/{stream.name}"]
        printed = subprocess.run(
            command, **here, capture_output=True, text=True, encoding="utf-8"
        ).stdout
        rows = stream.with_suffix(".csv").read_text(encoding="utf-8").splitlines()[1:]
        assert printed.splitlines() == rows, stream.name
    assert streams


def test_core_has_constraints_cells_and_driver(releases):
    text = (releases / "fpga" / f"{TOP}.core").read_text(encoding="utf-8")
    sets = json.loads(re.search(r"^filesets: (\{.*?^\})$", text, re.M | re.S)[1])
    assert sets["constraints"] == {"files": [f"{TOP}.sdc"], "file_type": "SDC"}
    assert sets["constraints_fpga"]["files"] == [f"{FPGA_TOP}.sdc"]
    listed = (releases / "fpga" / CELLS_LIST).read_text(encoding="utf-8").split()
    assert sets["cells"]["files"] == listed
    assert sets["driver"]["file_type"] == "cSource"
    source, *headers = sets["driver"]["files"]
    own = {path.name for path in (releases / "fpga").glob("*.h")}
    assert source == "coincid.c" and {name for one in headers for name in one} == own
    assert all(one[name] == {"is_include_file": True} for one in headers for name in one)
    included = set(
        re.findall('#include "(.*)"', (releases / "fpga" / source).read_text(encoding="utf-8"))
    )
    assert included and included <= own
    for files_of_set in sets.values():
        for file in files_of_set["files"]:
            name = file if isinstance(file, str) else next(iter(file))
            assert (releases / "fpga" / name).exists(), name


@pytest.mark.parametrize("preset", SMALL)
def test_ip_xact_has_the_ports_and_bus_interfaces_of_the_top(releases, preset):
    root = ElementTree.parse(releases / preset / IP_XACT).getroot()
    names = {"ipxact": root.tag.partition("}")[0].strip("{")}
    verilog = (releases / preset / f"{TOP}.v").read_text(encoding="utf-8")
    declared = re.findall(r"^  (input|output) (?:\[(\d+):0\] )?(\w+);", verilog, re.M)
    found = {}
    for port in root.findall("ipxact:model/ipxact:ports/ipxact:port", names):
        wire = port.find("ipxact:wire", names)
        left = wire.findtext("ipxact:vectors/ipxact:vector/ipxact:left", "0", names)
        direction = wire.findtext("ipxact:direction", "", names)
        found[port.findtext("ipxact:name", "", names)] = (f"{direction}put", int(left))
    assert found == {name: (kind, int(high or 0)) for kind, high, name in declared}
    interfaces = root.findall("ipxact:busInterfaces/ipxact:busInterface", names)
    connected = [name.text for one in interfaces for name in one.iterfind(PHYSICAL, names)]
    buses = [name for name in found if re.match(r"s_axi_|m_axis", name)]
    assert sorted(connected) == sorted([*buses, "clk", "rst"])
    maps = root.findall("ipxact:memoryMaps/ipxact:memoryMap/ipxact:name", names)
    (referred,) = root.iterfind(".//ipxact:memoryMapRef", names)
    assert set(referred.attrib.values()) <= {name.text for name in maps}
    for one in interfaces:
        name = one.findtext("ipxact:name", "", names)
        sends = f"{name}_tvalid" in found and found[f"{name}_tvalid"][0] == "output"
        assert (one.find("ipxact:master", names) is not None) == sends
        assert (one.find("ipxact:slave", names) is None) == sends


# kind of a bus, by the beginning of its name: its name, and that of its signals at the RTL
BUS_TYPES = {
    "s_axi": ("AXI4-Lite", "AXI4-Lite_rtl"),
    "m_axis": ("AXI4Stream", "AXI4Stream_rtl"),
    "clk": ("clock", "clock_rtl"),
    "rst": ("reset", "reset_rtl"),
}


@pytest.mark.parametrize("preset", SMALL)
def test_ip_xact_maps_each_signal_of_a_bus_to_the_port_of_its_name(releases, preset):
    """Buses are of the types that tools know."""
    root = ElementTree.parse(releases / preset / IP_XACT).getroot()
    names = {"ipxact": root.tag.partition("}")[0].strip("{")}
    for one in root.findall("ipxact:busInterfaces/ipxact:busInterface", names):
        name = one.findtext("ipxact:name", "", names)
        of = one.find("ipxact:busType", names).attrib
        signals = one.find(".//ipxact:abstractionRef", names).attrib
        assert (of["name"], signals["name"]) == BUS_TYPES[re.match("[a-z_]+", name)[0]]
        assert (of["vendor"], of["library"]) == (signals["vendor"], signals["library"])
        vendor = "xilinx.com" if name in ("clk", "rst") else "amba.com"
        assert of["vendor"] == vendor
        for pair in one.iterfind(".//ipxact:portMap", names):
            logical = pair.findtext("ipxact:logicalPort/ipxact:name", "", names)
            port = pair.findtext("ipxact:physicalPort/ipxact:name", "", names)
            whole = f"{name}_{logical.lower()}"
            assert port == (name if name in ("clk", "rst") else whole)
            assert logical == logical.upper()


@pytest.mark.parametrize("preset", SMALL)
def test_ip_xact_tells_clock_and_reset_as_the_rtl_has_them(releases, preset):
    """Which buses belong to the clock, and at which level the reset resets."""
    root = ElementTree.parse(releases / preset / IP_XACT).getroot()
    names = {"ipxact": root.tag.partition("}")[0].strip("{")}
    told = {}
    for one in root.findall("ipxact:busInterfaces/ipxact:busInterface", names):
        parameters = one.findall("ipxact:parameters/ipxact:parameter", names)
        told[one.findtext("ipxact:name", "", names)] = {
            each.findtext("ipxact:name", "", names): each.findtext("ipxact:value", "", names)
            for each in parameters
        }
    buses = [name for name in told if name not in ("clk", "rst")]
    assert told["clk"]["ASSOCIATED_BUSIF"].strip('"').split(":") == buses
    assert told["clk"]["ASSOCIATED_RESET"] == '"rst"'
    verilog = "".join(path.read_text(encoding="utf-8") for path in releases.glob(f"{preset}/*.v"))
    level = {'"ACTIVE_HIGH"': r"if \(rst\)", '"ACTIVE_LOW"': r"if \([!~]rst\)"}
    of_reset = {polarity for polarity, test in level.items() if re.search(test, verilog)}
    assert of_reset == {told["rst"]["POLARITY"]}


def test_limits_hold_for_frames_of_counts():
    """The counters of all minigroups come when the last period has ended."""
    of = parse_config(
        {
            "sensor": {"rows": 128, "cols": 128, "counts": 1, "fifo_depth": 1},
            "frame": {"period": 40, "pulses": 3, "search_pulses": 1, "format": "counts"},
        }
    )
    (beats,) = Golden(of.sensor).frame(of, random_edges(of, 1_000, seed=1)).beats
    assert len(beats) <= largest_frame(of)
    assert len(beats) > largest_frame(of) / 2


def test_another_export_into_a_folder_keeps_the_files_of_others(tmp_path):
    """Also those in folders; what an earlier export has left and this one has not goes."""
    folder = tmp_path / "rtl"
    smallest = EXPORTS["smallest"][0]
    write_release(folder, parse_config(smallest))
    own = {"my_top.v": "module my_top; endmodule\n", "obj_dir/deep/a.txt": "a"}
    for name, text in own.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text, encoding="utf-8")
    manifest = folder / MANIFEST
    known = json.loads(manifest.read_text(encoding="utf-8"))
    known["sha256"]["old.v"] = "0"
    manifest.write_text(json.dumps(known), encoding="utf-8")
    (folder / "old.v").write_text("module old; endmodule\n", encoding="utf-8")
    write_release(folder, parse_config(smallest))
    for name, text in own.items():
        assert (folder / name).read_text(encoding="utf-8") == text
    assert not (folder / "old.v").exists()


@pytest.mark.parametrize("interrupted", [False, True])
@pytest.mark.parametrize("failing", ["fresh", "rtl"])
def test_an_export_that_cannot_be_put_in_place_leaves_the_earlier_one(
    monkeypatch, tmp_path, failing, interrupted
):
    """Whether the earlier one cannot be moved away, or the new one not into its place, or Ctrl-C comes
    before it is; nothing is left beside it.
    """
    folder = tmp_path / "rtl"
    folder.mkdir()
    own = {FILE_LIST: "a.v\n", "a.v": "module a; endmodule\n"}
    for name, text in own.items():
        (folder / name).write_text(text, encoding="utf-8")
    rename = Path.rename

    def refused(path, target):
        if path.name == failing:
            denied = PermissionError(errno.EACCES, os.strerror(errno.EACCES))
            raise KeyboardInterrupt if interrupted else denied
        return rename(path, target)

    monkeypatch.setattr(release, "_contents", lambda *_: {"b.v": b"new"})
    monkeypatch.setattr(release.Path, "rename", refused)
    told = f"^{re.escape(str(folder))}: cannot be written: Permission denied$"
    expected = (KeyboardInterrupt, None) if interrupted else (InputError, told)
    with pytest.raises(expected[0], match=expected[1]):
        write_release(folder, load_config("silicon"))
    assert {path.name: path.read_text(encoding="utf-8") for path in folder.iterdir()} == own
    assert list(tmp_path.iterdir()) == [folder]


@pytest.mark.parametrize("others", [[], ["old/mine.txt"], ["old/mine/deep.txt"]])
def test_a_folder_of_an_earlier_export_goes_with_its_files(others, monkeypatch, tmp_path):
    """Unless somebody has put something of his own into it, which keeps its date."""

    def of(*names):
        listed = json.dumps({"name": TOP, "sha256": dict.fromkeys(names, "")})
        return dict.fromkeys(names, b"") | {"manifest.json": listed.encode()}

    folder, config = tmp_path / "rtl", load_config("silicon")
    folder.mkdir()  # an empty one is as good as none
    for names in ((FILE_LIST, "old/a.v", "both/a.v"), (FILE_LIST, "both/b.v", "new/b.v")):
        monkeypatch.setattr(release, "_contents", lambda *_, names=names: of(*names))
        written = write_release(folder, config)
        for name in others:
            (folder / name).parent.mkdir(exist_ok=True)
            (folder / name).write_text("own", encoding="utf-8")
            os.utime(folder / name, (1e9, 1e9))
    write_release(folder, config)
    assert written == sorted(folder / name for name in of(FILE_LIST, "both/b.v", "new/b.v"))
    found = {path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file()}
    assert found == {FILE_LIST, "manifest.json", "both/b.v", "new/b.v", *others}
    assert (folder / "old").exists() == bool(others)
    for name in others:
        assert (folder / name).read_text(encoding="utf-8") == "own"
        assert (folder / name).stat().st_mtime == 1e9


@pytest.mark.parametrize(
    "content",
    [b"[" * 100_000, b"\xff\xfe", b'{"name": ["a"]}', b'{"sha256": 1}', b""],
    ids=["deep", "no_text", "other_name", "no_name", "empty"],
)
def test_a_file_that_is_only_called_a_manifest_stays(content, monkeypatch, tmp_path):
    monkeypatch.setattr(release, "_contents", lambda *_: {FILE_LIST: b""})
    folder, config = tmp_path / "rtl", load_config("silicon")
    write_release(folder, config)
    (folder / f"my_{MANIFEST}").write_bytes(content)
    write_release(folder, config)
    assert (folder / f"my_{MANIFEST}").read_bytes() == content


def test_files_of_an_export_are_returned_in_order(monkeypatch, tmp_path):
    """Those of this export only, each in its place."""
    monkeypatch.setattr(release, "_contents", lambda *_: {"b/c.v": b"2", "b.v": b"1", "a.v": b"0"})
    written = write_release(tmp_path / "new" / "rtl", load_config("silicon"))
    folder = tmp_path / "new" / "rtl"
    assert written == sorted(written)
    assert {path.relative_to(folder).as_posix(): path.read_bytes() for path in written} == {
        "a.v": b"0",
        "b.v": b"1",
        "b/c.v": b"2",
    }
    assert list((tmp_path / "new").iterdir()) == [folder]


@pytest.mark.parametrize("text", ['{"a": 1}', "[]", '{"sha256": {"not-there.v": "0"}}', "no JSON"])
def test_another_export_keeps_links_folders_and_manifests_of_others(tmp_path, text):
    folder = tmp_path / "rtl"
    smallest = EXPORTS["smallest"][0]
    write_release(folder, parse_config(smallest))
    (folder / "link").symlink_to(tmp_path, target_is_directory=True)
    (folder / "broken").symlink_to("nowhere")
    (folder / "empty" / "deep").mkdir(parents=True)
    own = {f"my_{MANIFEST}": text, "my.v": "", f"my_{FILE_LIST}": "my.v\n"}
    for name, content in own.items():
        (folder / name).write_text(content, encoding="utf-8")
    write_release(folder, parse_config(smallest))
    assert (folder / "link").readlink() == tmp_path
    assert (folder / "broken").readlink() == Path("nowhere")
    assert (folder / "empty" / "deep").is_dir()
    for name, content in own.items():
        assert (folder / name).read_text(encoding="utf-8") == content


def test_an_export_beside_one_that_lacks_files_leaves_what_is_there(tmp_path):
    folder = tmp_path / "rtl"
    smallest = parse_config(EXPORTS["smallest"][0])
    write_release(folder, smallest)
    (folder / f"{TOP}.sdc").unlink()
    written = write_release(folder, smallest, prefix="near_")
    assert all(path.exists() for path in written)
    assert (folder / f"{TOP}.v").exists() and not (folder / f"{TOP}.sdc").exists()


def test_words_of_the_stream_are_those_that_are_built():
    lean = stream_words(built_sensor({"offsets": 0, "records": 0, "counts": 0}))
    whole = stream_words(built_sensor({"offsets": 1, "records": 1, "counts": 1}))
    for told in ("format full", "Offsets", "minigroup record", "Entries", "`compact-full`"):
        assert told in whole and told not in lean
    assert "In the format `compact`, events leave" in lean


def test_limits_hold_where_every_edge_is_an_event():
    of = parse_config(
        {
            "sensor": EXPORTS["smallest"][0]["sensor"],
            "frame": {"period": 60, "pulses": 20, "format": "full", "minigroup_records": True},
            "subgroup": {"threshold": 1, "coincidence": False},
        }
    )
    edges = random_edges(of, 20_000, seed=1)
    beats_of = {}
    for form in ("full", "compact-full"):
        config_of_form = of.with_frame(format=form)
        (beats,) = Golden(of.sensor).frame(config_of_form, edges).beats
        beats_of[form] = len(beats)
        assert len(beats) <= largest_frame(config_of_form)
    assert beats_of["full"] > largest_frame(of) / 2


def test_limits_count_what_all_subgroups_hold_at_the_end():
    """The stream has moved a beat in each cycle, and then all that waits in FIFOs and for records,
    and the counters of all.
    """
    sizes = {"rows": 32, "cols": 64, "subgroup": [4, 4], "minigroup": [2, 2], "fifo_depth": 2}
    of = parse_config(
        {
            "sensor": sizes | {"phases": 4, "window_max": 8},
            "frame": {"period": 60, "pulses": 3, "format": "full", "minigroup_records": True},
            "subgroup": {"threshold": 1, "coincidence": False},
        }
    )
    (beats,) = Golden(of.sensor).frame(of, random_edges(of, 60_000, seed=1)).beats
    assert 0.9 * largest_frame(of) < len(beats) <= largest_frame(of)


# Sensors in which neither a record nor an event without a group is longer than a group of one.
LONG_GROUPS = [
    dict(subgroup=[4, 16], minigroup=[2, 4], phases=16, coarse_bits=3, window_max=13),
    dict(subgroup=[16, 6], minigroup=[2, 3], phases=16, coarse_bits=7, window_max=221),
    dict(subgroup=[8, 6], minigroup=[2, 3], phases=4, coarse_bits=5, window_max=92),
]


@pytest.mark.parametrize("sizes", LONG_GROUPS)
def test_limits_count_the_beats_of_an_event_alone_in_its_group(sizes):
    """One more place of the FIFO is room for one more such event, of all pixels."""
    rows, cols = sizes["subgroup"]
    sensor = sizes | {"rows": rows, "cols": cols, "offset_phases": sizes["phases"]}
    built = parse_config({"sensor": sensor}).sensor
    of = configured(
        built,
        {"period": built.period_max, "pulses": 1, "format": "compact-full"},
        {"threshold": 1, "window": 1},
    )
    pixels = np.arange(built.array_pixels)
    at_once = Edges(np.zeros_like(pixels), pixels, np.zeros_like(pixels))
    golden = Golden(built)
    (lit,) = golden.frame(of, at_once).beats
    (dark,) = golden.frame(of, at_once.take(slice(0))).beats
    deeper = evolve(built, fifo_depth=built.fifo_depth + 1)
    assert len(lit) - len(dark) <= beats_beside_cycles(deeper, 0) - beats_beside_cycles(built, 0)
