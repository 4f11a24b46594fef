# SPDX-License-Identifier: Apache-2.0
"""What a layout computes itself, without placer and drawing program: legal sites, the size of a
block, its record, wires as SPEF, the clock tree's power, the netlist, and the shell with delays.
"""

import json
import sys
import tomllib
from contextlib import nullcontext
from importlib import import_module
from pathlib import Path
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest

from coincid.flow import layout
from coincid.flow.layout import tools as layout_tools
from coincid.flow.liberty import Cell, Energies, Pin
from coincid.hdl.minigroup import Minigroup
from coincid.model.shared.errors import InputError

from .sensors import SMALL

TOOLS = (
    "klayout",
    "klayout.db",
    "klayout.lay",
    "coriolis",
    "coriolis.helpers",
    "coriolis.CRL",
    "coriolis.Hurricane",
    "coriolis.helpers.overlay",
    "coriolis.helpers.technology",
    "coriolis.plugins",
    "coriolis.plugins.block",
    "coriolis.plugins.block.block",
    "coriolis.plugins.block.configuration",
    "coriolis.plugins.block.spares",
)
UNITS_PER_UM = 1000
SITE = 190  # 0.19 um
ROW = 1400
LEF = """\
LAYER metal3
  WIDTH 0.07 ;
  CPERSQDIST 0.0001 ;
  EDGECAPACITANCE 0.00002 ;
  RPERSQ 0.21 ;
END metal3
LAYER via3
  WIDTH 0.07 ;
END via3
LAYER metal10
  WIDTH 0.8 ;
  CPERSQDIST 0.00005 ;
  EDGECAPACITANCE 0.00001 ;
  RPERSQ 0.04 ;
END metal10
"""


class Tool(ModuleType):
    """A module that stands for a tool's: any name in it is a class of its own."""

    __path__: list[str] = []

    def __getattr__(self, name):
        return type(name, (), {})


class Physical:
    """Lengths of the database."""

    UnitPowerMicro = None

    @staticmethod
    def toPhysical(length, _):
        return length / UNITS_PER_UM


class Moved:
    """Where an instance is, and how it is turned."""

    def __init__(self, tx, ty, orientation):
        self.tx, self.ty, self.orientation = tx, ty, orientation

    def getTx(self):
        return self.tx

    def getTy(self):
        return self.ty

    def getOrientation(self):
        return self.orientation


@pytest.fixture
def module(monkeypatch):
    """Import a module of the layout beside stand-ins of its tools; all are forgotten again."""
    for name in TOOLS:
        tool = Tool(name)
        monkeypatch.setitem(sys.modules, name, tool)
        parent, _, last = name.rpartition(".")
        if parent:
            setattr(sys.modules[parent], last, tool)
    monkeypatch.setattr(
        sys.modules["coriolis.helpers"], "u", lambda um: round(um * UNITS_PER_UM), raising=False
    )
    monkeypatch.setattr(
        sys.modules["coriolis.helpers.overlay"], "UpdateSession", nullcontext, raising=False
    )
    for name, stand_in in (("DbU", Physical), ("Transformation", Moved)):
        monkeypatch.setattr(sys.modules["coriolis.Hurricane"], name, stand_in, raising=False)
    prefix = f"{layout.__name__}."
    known = {name: kept for name, kept in sys.modules.items() if name.startswith(prefix)}
    attributes = dict(vars(layout))
    for name in known:
        del sys.modules[name]
    yield lambda name: import_module(prefix + name)
    for name in [name for name in sys.modules if name.startswith(prefix)]:
        del sys.modules[name]
    sys.modules.update(known)
    vars(layout).clear()
    vars(layout).update(attributes)


class Extent:
    """A rectangle of the database."""

    def __init__(self, x, y, width, height=ROW):
        self.corner, self.size = (x, y), (width, height)

    def getXMin(self):
        return self.corner[0]

    def getYMin(self):
        return self.corner[1]

    def getXMax(self):
        return self.corner[0] + self.size[0]

    def getWidth(self):
        return self.size[0]

    def getHeight(self):
        return self.size[1]


class Instance:
    """A cell in a block. Its origin is not its corner, as in a turned one."""

    def __init__(self, name, x, y, width, orientation="0", kind="INV", plugs=()):
        self.name, self.width, self.y = name, width, y
        self.kind, self.plugs = kind, plugs
        self.offset = 7
        self.moved = Moved(x + self.offset, y, orientation)

    def getName(self):
        return self.name

    def getAbutmentBox(self):
        return Extent(self.moved.tx - self.offset, self.y, self.width)

    def getTransformation(self):
        return self.moved

    def setTransformation(self, moved):
        assert (moved.ty, moved.orientation) == (self.moved.ty, self.moved.orientation)
        self.moved = moved

    def getMasterCell(self):
        box = Extent(0, 0, self.width)
        return SimpleNamespace(getName=lambda: self.kind, getAbutmentBox=lambda: box)

    def getPlugs(self):
        return [plug_of(pin, net) for pin, net in self.plugs]


def net_of(name, direction="1", external=False):
    return SimpleNamespace(
        getName=lambda: name,
        isSupply=lambda: name in ("VDD", "VSS"),
        getDirection=lambda: direction,
        isExternal=lambda: external,
    )


def plug_of(pin, net):
    found = net_of(net) if net else None
    return SimpleNamespace(getMasterNet=lambda: net_of(pin), getNet=lambda: found)


def block_of(instances, width, height=ROW, nets=()):
    return SimpleNamespace(
        getInstances=lambda: instances,
        getAbutmentBox=lambda: Extent(0, 0, width, height),
        getNets=lambda: nets,
    )


def places(instances):
    return {one.name: one.getAbutmentBox().getXMin() for one in instances}


def test_a_cell_moves_to_the_nearest_site(module):
    cells = [
        Instance("low", SITE + SITE // 2 - 1, 0, 2 * SITE),
        Instance("high", 6 * SITE + SITE // 2 + 1, 0, 2 * SITE, "6"),
        Instance("legal", 20 * SITE, 0, SITE),
    ]
    module("block").snap(block_of(cells, 40 * SITE))
    assert places(cells) == {"low": SITE, "high": 7 * SITE, "legal": 20 * SITE}


def test_cells_of_a_row_do_not_overlap_and_rows_are_independent(module):
    """They stay in the order of their places, whatever the order of the instances."""
    cells = [
        Instance("third", 4 * SITE, 0, SITE),
        Instance("first", 0, 0, 3 * SITE),
        Instance("second", SITE, 0, 2 * SITE),
        Instance("other", SITE, ROW, SITE),
    ]
    module("block").snap(block_of(cells, 40 * SITE))
    assert places(cells) == {"first": 0, "second": 3 * SITE, "third": 5 * SITE, "other": SITE}


@pytest.mark.parametrize("beyond", [0, 1, SITE - 1])
def test_cells_leave_room_for_those_on_their_right(module, beyond):
    """Up to the last whole site of the block."""
    cells = [
        Instance("first", 8 * SITE, 0, 2 * SITE),
        Instance("second", 9 * SITE, 0, 3 * SITE),
    ]
    module("block").snap(block_of(cells, 10 * SITE + beyond))
    assert places(cells) == {"first": 5 * SITE, "second": 7 * SITE}


def test_a_row_that_is_too_full_is_an_error(module):
    cells = [Instance("first", 0, 0, 6 * SITE), Instance("second", 0, 0, 6 * SITE)]
    with pytest.raises(ValueError, match="first: no room in its row"):
        module("block").snap(block_of(cells, 10 * SITE))


@pytest.mark.parametrize(("x", "down", "up"), [(0, 0, 0), (1, 0, SITE), (SITE, SITE, SITE)])
def test_sites_below_and_above_a_place(module, x, down, up):
    to_site = module("block").to_site
    assert to_site(None, x) == down
    assert to_site(None, x, superior=True) == up


@pytest.mark.parametrize("margin", [0.0, 0.45])
def test_a_block_is_nearly_square_with_room_for_cells_margin_and_ring(module, margin):
    cells = [Instance(f"u{k}", 0, 0, (2 + k % 5) * SITE) for k in range(400)]
    block = module("block")
    width_um, height_um = block.core_size_um(block_of(cells, 0), margin)
    rows = height_um / 1.4 - 2 * block.RING_ROWS
    inner_um = width_um - block.RING_ROWS * block.RING_SITES * 0.19
    wanted_um = sum(cell.width for cell in cells) / UNITS_PER_UM * (1 + margin)
    assert rows % 2 == pytest.approx(0)
    assert -1e-9 < inner_um - wanted_um / rows < 0.19 + 1e-9
    assert 0.7 < inner_um / (rows * 1.4) < 1.3
    assert width_um / 0.19 == pytest.approx(round(width_um / 0.19))


def test_the_record_of_a_block(module, monkeypatch, tmp_path):
    """Supplies and open pins are in no list."""
    monkeypatch.chdir(tmp_path)
    cells = [
        Instance("u1", 2 * SITE, ROW, SITE, "6", "INV", [("A", "a"), ("ZN", None), ("VDD", "VDD")]),
        Instance("u2", 0, 0, SITE, "0", "BUF", [("A", "b"), ("Z", "a")]),
    ]
    nets = [
        net_of("b", "1", external=True),
        net_of("a", "2", external=True),
        net_of("n"),
        net_of("VDD", "1", external=True),
    ]
    block = module("block")
    block.record(block_of(cells, 10 * SITE, 2 * ROW, nets))
    assert json.loads(Path(block.PLACED).read_text(encoding="utf-8")) == {
        "width": 1.9,
        "height": 2.8,
        "ports": {"b": "input", "a": "output"},
        "cells": [
            {"name": "u1", "kind": "INV", "x": 0.38, "y": 1.4, "flipped": True, "nets": {"A": "a"}},
            {
                "name": "u2",
                "kind": "BUF",
                "x": 0.0,
                "y": 0.0,
                "flipped": False,
                "nets": {"A": "b", "Z": "a"},
            },
        ],
    }


@pytest.fixture
def lef(tmp_path):
    path = tmp_path / "tech.lef"
    path.write_text(LEF, encoding="utf-8")
    return path


def test_a_wire_has_the_capacitance_of_its_area_and_both_edges(module, lef):
    """In fF and ohms of a micrometre of least width."""
    found = module("wires").metals(lef)
    assert set(found) == {3, 10}
    assert found[3] == pytest.approx((0.047, 3.0))
    assert found[10] == pytest.approx((0.06, 0.05))


def placed_of(*cells, **ports):
    """Return a placed block of (name, kind, x, nets)."""
    return {
        "ports": ports,
        "cells": [
            {"name": name, "kind": kind, "x": x, "y": 0.0, "flipped": name == "u2", "nets": nets}
            for name, kind, x, nets in cells
        ],
    }


def strips_of(module, **kinds):
    strip = module("pins").Strip
    return {
        kind: {pin: strip(0.1 * k, 0.3, 1.1, 0.5, True) for k, pin in enumerate(pins)}
        for kind, pins in kinds.items()
    }


def test_wires_are_stars_around_their_drivers(module, lef):
    """A way to a pin has the mean resistance of the net's metals, and vias; a flipped cell has its
    pins at other heights.
    """
    placed = placed_of(
        ("u1", "INV", 0.0, {"A": "a", "ZN": "n"}),
        ("u2", "MUX2", 2.0, {"S": "n", "Z": "y"}),
        a="input",
        y="output",
    )
    strips = strips_of(module, INV=("A", "ZN"), MUX2=("S", "Z"))
    lengths = {"n": {3: 3.0, 10: 1.0}, "a": {3: 2.0}}
    wired = module("wires").wired("top", placed, strips, lengths, lef)
    assert wired.length_um == 6.0
    assert wired.sinks == 2
    assert wired.farads == pytest.approx(
        {"n": 3 * 0.047 + 0.06 + 0.1, "a": 2 * 0.047 + 0.05, "y": 0.05}
    )
    head, *nets = wired.spef.split("*D_NET ")
    units = {"*T_UNIT 1 NS", "*C_UNIT 1 FF", "*R_UNIT 1 OHM"}
    assert units < set(head.splitlines()) and '*DESIGN "top"' in head
    assert [net.split()[0] for net in nets] == ["a", "n", "y"]
    way_um = (2.0 - 0.1) + (1.4 - 0.5 - 0.5)
    ohm_per_um = (3 * 3.0 + 0.05) / 4
    assert nets[1].splitlines() == [
        "n 0.3010",
        "*CONN",
        "*I u1:ZN O",
        "*I u2:S I",
        "*CAP",
        "1 u1:ZN 0.15050",
        "2 u2:S 0.15050",
        "*RES",
        f"1 u1:ZN u2:S {way_um * ohm_per_um + 20:.2f}",
        "*END",
        "",
    ]
    assert nets[0].splitlines()[2:4] == ["*P a I", "*I u1:A I"]
    assert nets[2].splitlines()[2:4] == ["*P y O", "*I u2:Z O"]
    # Ports have no place: they are a micrometre away.
    half_ff = 2 * 0.047 / 2 + 0.05 / 2
    assert nets[0].splitlines()[4:] == [
        "*CAP",
        f"1 a {half_ff:.5f}",
        f"2 u1:A {half_ff:.5f}",
        "*RES",
        "1 a u1:A 23.00",
        "*END",
        "",
    ]
    assert nets[2].splitlines()[4:8] == ["*CAP", "1 u2:Z 0.02500", "2 y 0.02500", "*RES"]
    assert nets[2].splitlines()[8:] == ["1 u2:Z y 23.00", "*END", ""]


def test_the_power_of_a_clock_tree(module):
    """Of its buffers and wires; the pins of flip-flops are left out, although the buffers drive
    them. The pin of an output is no load.
    """
    wires = module("wires")
    buffer = wires.CLOCK_BUFFER
    energies = Energies(np.array([0.0, 100.0]), np.array([1.0, 11.0]))  # 1 fJ and 0.1 fJ per fF
    cells = {
        buffer: Cell(
            0.0, {"A": Pin(False, 3.0, None, False), "Z": Pin(True, 7.0, energies, False)}
        ),
        "DFF": Cell(0.0, {"CK": Pin(False, 2.0, None, True), "D": Pin(False, 5.0, None, False)}),
    }
    placed = placed_of(
        ("b1", buffer, 0.0, {"A": "clk", "Z": "c1"}),
        ("b2", buffer, 0.0, {"A": "c1", "Z": "c2"}),
        ("f1", "DFF", 0.0, {"CK": "c2", "D": "d"}),
        ("f2", "DFF", 0.0, {"CK": "c2", "D": "d"}),
        clk="input",
    )
    of_nets = wires.Wired("", 0.0, {"clk": 10.0, "c1": 20.0, "c2": 30.0, "d": 9.0}, 0)
    buffers_fj = 2 * (1 + 0.1 * (20 + 3)) + 2 * (1 + 0.1 * (30 + 4))
    wires_fj = 4 * (10 + 3 + 20 + 3 + 30)  # at 2 V
    found_mw = wires.clock_tree_mw(placed, of_nets, cells, 2.0, 500.0)
    assert found_mw == pytest.approx((buffers_fj + wires_fj) * 1e-15 * 500e6 * 1e3)


def test_the_netlist_has_ports_wires_and_all_cells_but_fillers(module):
    placed = placed_of(
        ("u1", "INV", 0.0, {"A": "a", "ZN": "n"}),
        ("fill", "FILLCELL_X1", 0.0, {}),
        ("u2", "INV", 0.0, {"A": "n", "ZN": "y"}),
        a="input",
        y="output",
    )
    assert module("wires").netlist("top", placed).splitlines() == [
        "module top (a, y);",
        "  input a;",
        "  output y;",
        "  wire n;",
        "  INV u1 (.A(a), .ZN(n));",
        "  INV u2 (.A(n), .ZN(y));",
        "endmodule",
    ]


def test_the_shell_of_a_routed_block_has_late_inputs_and_every_kept_bit(module):
    """The clock is not late; names have single underscores, as the router has them."""
    delays = module("delays")
    unit = Minigroup(SMALL)
    ports = {port.name: port for port in unit.ports()}
    some_input = next(p for p in ports.values() if p.is_input and p.width > 1)
    some_output = next(p for p in ports.values() if not p.is_input and p.width > 1)
    kept = ["clk", f"{some_input.name}_1", f"{some_output.name}_0"]
    text = delays.shell(unit, kept, Path("one.sdf"))
    assert text.startswith(f"`timescale 1ns/1ps\nmodule {unit.unit_name} (")
    high = some_input.width - 1
    late = f"late_{some_input.name}"
    assert f"  wire [{high}:0] {late};" in text
    assert f"  assign #0.4 {late} = \\{some_input.name} ;" in text
    assert "late_clk" not in text
    routed = text.split("_routed routed (\n")[1].split("  );")[0].split(",\n")
    assert [pin.strip() for pin in routed] == [
        ".clk(\\clk [0])",
        f".{some_input.name}_1({late}[1])".replace("__", "_", 1),
        f".{some_output.name}_0(\\{some_output.name} [0])".replace("__", "_", 1),
    ]
    assert '$sdf_annotate("one.sdf", routed);' in text


@pytest.mark.parametrize(
    ("low", "joined"),
    [(60, [(0, 50), (60, 90)]), (50, [(0, 90)]), (20, [(0, 90)])],
)
def test_touching_spans_of_metal_are_one(module, low, joined):
    assert module("pins")._joined([(low, 90), (0, 50)]) == joined


def test_a_pin_is_its_strip_alone(module, monkeypatch):
    """From its low end to its high one, on metal2, so wide as a wire there; the shapes that it had
    before are gone.
    """
    technology = module("technology")
    shapes = [SimpleNamespace(destroy=lambda k=k: destroyed.append(k)) for k in range(3)]
    destroyed, created, external = [], [], []
    net = SimpleNamespace(
        getComponents=lambda: (one for k, one in enumerate(shapes) if k not in destroyed)
    )
    monkeypatch.setattr(technology.Vertical, "create", lambda *given: given, raising=False)
    monkeypatch.setattr(
        technology.NetExternalComponents, "setExternal", external.append, raising=False
    )
    technology._replace_pin(net, "metal2", 0.285, 0.31, 1.05)
    assert sorted(destroyed) == [0, 1, 2] and not created
    assert external == [(net, "metal2", 285, 70, 310, 1050)]


@pytest.mark.parametrize(
    ("um2_per_pin", "width"),
    [(0.2, 4 * SITE), (0.35, 4 * SITE), (0.36, 5 * SITE), (0.44, 5 * SITE), (0.5, 6 * SITE)],
)
def test_a_cell_gets_whole_sites_on_its_right_until_its_pins_have_room(
    module, monkeypatch, um2_per_pin, width
):
    """Three pins in a row of 1.4 um; supplies and inner nets are no pins."""
    technology = module("technology")
    monkeypatch.setattr(technology, "Box", lambda *corners: corners)
    kinds = [(True, False)] * 3 + [(True, True), (False, False)]
    nets = [
        SimpleNamespace(isExternal=lambda of=of: of[0], isSupply=lambda of=of: of[1])
        for of in kinds
    ]
    box = Extent(100, 20, 4 * SITE)
    boxes = [(100, 20, 100 + 4 * SITE, 20 + ROW)]
    box.getYMax = lambda: 20 + ROW
    cell = SimpleNamespace(
        getNets=lambda: nets, getAbutmentBox=lambda: box, setAbutmentBox=boxes.append
    )
    technology._widen(cell, um2_per_pin)
    assert boxes[-1] == (100, 20, 100 + width, 20 + ROW)


def test_a_cell_without_pins_stays_as_it_is(module):
    """A filler has supplies only."""
    net = SimpleNamespace(isExternal=lambda: True, isSupply=lambda: True)
    cell = SimpleNamespace(getNets=lambda: [net], getAbutmentBox=lambda: Extent(0, 0, SITE))
    module("technology")._widen(cell, 10.0)


def test_each_fact_of_a_layout_stands_beside_its_name(module):
    found = {
        "width_um": 50.04,
        "height_um": 20.06,
        "cells": 1234,
        "cell_area_um2": 753.4,
        "buffers": 17,
        "clock_tree_mw": 0.125,
        "nets": 1300,
        "wire_um": 6543.0,
        "sinks": 2600,
        "wire_ff": 910.0,
    }
    assert module("document").facts(found, 1720.6) == [
        ("cells before layout, um2", "1,721"),
        ("cells with the clock tree", "1234"),
        ("their area, um2", "753"),
        ("buffers of the clock tree", "17"),
        ("power of the clock tree, without the flip-flops' pins, mW", "0.12"),
        ("block, um", "50.0 x 20.1"),
        ("block, um2", "1,004"),
        ("share of the block that cells cover", "75%"),
        ("nets", "1300"),
        ("wire, mm", "6.54"),
        ("wire for each input that it reaches, um", "2.5"),
        ("capacitance of the wires, fF", "910"),
        ("capacitance for each such input, fF", "0.35"),
    ]


def test_each_slack_of_a_layout_stands_beside_its_name(module):
    found = {"slack_ns": 0.125, "hold_ns": -0.03}
    assert [value for _, value in module("document").slacks(found, 0.5)] == [
        "+0.50",
        "+0.12",
        "-0.03",
    ]


@pytest.fixture
def flow(module, monkeypatch, tmp_path):
    """Return the module of the flow, for a folder with a BLIF file of three kinds of cells."""
    flow = module("flow")
    blif = ".model top\n.gate INV A=a ZN=n\n.subckt DFF D=n Q=y\n.gate INV A=y ZN=b\n.end\n"
    (tmp_path / flow.BLIF).write_text(blif, encoding="utf-8")
    strip = flow.Strip(0.1, 0.3, 1.1, 0.5, True)

    def strips(lef, kinds):
        assert lef == Path("cells") / "stdcells.lef"
        return {kind: {"A": strip} for kind in sorted(kinds)}

    monkeypatch.setattr(flow, "strips", strips)
    return flow


@pytest.mark.parametrize("routed_by", [0, 1, 3])
def test_attempts_get_more_room_in_turn_until_one_routes_every_net(
    flow, monkeypatch, tmp_path, routed_by
):
    """Each has its own job, with all cells that the block or its clock tree has."""
    jobs, told = [], []

    def run_coriolis(folder):
        jobs.append(json.loads((folder / flow.JOB).read_text(encoding="utf-8")))
        return len(jobs) > routed_by

    monkeypatch.setattr(flow, "run_coriolis", run_coriolis)
    flow.route("top", Path("cells"), tmp_path, told.append)
    assert len(jobs) == routed_by + 1
    for job, attempt, line in zip(jobs, flow.ATTEMPTS, told, strict=False):
        assert (job["margin"], job["um2_per_pin"]) == (attempt.margin, attempt.um2_per_pin)
        assert job["tracks_reserved"] == list(attempt.tracks_reserved)
        assert job["clock"] == "clk" and job["blif"] == "mapped"
        assert job["lef"] == ["cells/rtk-tech.lef", "cells/stdcells.lef"]
        assert line == f"top: placing and routing, {attempt.margin:.0%} of the area free"
    stored = json.loads((tmp_path / jobs[0]["strips"]).read_text(encoding="utf-8"))
    kinds = {"INV", "DFF", "BUF_X4", "BUF_X1", "LOGIC0_X1", "LOGIC1_X1"}
    assert stored == {kind: {"A": [0.1, 0.3, 1.1, 0.5, True]} for kind in kinds}
    margins = [(one.margin, one.um2_per_pin) for one in flow.ATTEMPTS]
    assert margins == sorted(margins) and len(set(margins)) == len(margins)


def test_a_block_that_no_attempt_routes_is_an_error_with_the_end_of_the_log(
    flow, monkeypatch, tmp_path
):
    monkeypatch.setattr(flow, "run_coriolis", lambda folder: False)
    lines = [f"line {k}" for k in range(50)]
    (tmp_path / flow.LOG).write_text("\n".join(lines), encoding="utf-8")
    with pytest.raises(flow.ToolchainError) as failed:
        flow.route("top", Path("cells"), tmp_path, print)
    first, *others = str(failed.value).splitlines()
    assert first == f"top: {len(flow.ATTEMPTS)} attempts did not route every net"
    assert others == lines[-flow.TAIL_LINES :]


@pytest.mark.parametrize(("code", "routed"), [(0, True), (3, False), (1, None), (-11, None)])
def test_an_attempt_that_fails_otherwise_than_in_routing_is_an_error(
    flow, monkeypatch, tmp_path, code, routed
):
    """What it says is added to the log, and its hashes do not vary."""

    def run(command, *, cwd, stdout, stderr, timeout, check, env):
        assert command[-1] == flow.JOB and cwd == tmp_path and timeout == flow.LIMIT_S
        assert env["PYTHONHASHSEED"] == "0" and stdout is stderr
        stdout.write("words\n")
        return SimpleNamespace(returncode=code)

    monkeypatch.setattr(flow.subprocess, "run", run)
    (tmp_path / flow.LOG).write_text("before\n", encoding="utf-8")
    if routed is None:
        with pytest.raises(flow.ToolchainError, match="Coriolis failed in .*\nbefore\nwords$"):
            flow.run_coriolis(tmp_path)
    else:
        assert flow.run_coriolis(tmp_path) is routed
    assert (tmp_path / flow.LOG).read_text(encoding="utf-8") == "before\nwords\n"


def test_an_attempt_that_takes_too_long_has_not_routed(flow, monkeypatch, tmp_path):
    def run(command, **_):
        raise flow.subprocess.TimeoutExpired(command, 1)

    monkeypatch.setattr(flow.subprocess, "run", run)
    assert flow.run_coriolis(tmp_path) is False


TIMED = """\
FLOPS
   0.40   slack (MET)
LATCHES
OPENING
ENABLES
  -0.20   slack (VIOLATED)
SHORTEST
   0.07   slack (MET)
   0.03   slack (MET)
"""


def test_slacks_of_a_routed_block_are_those_with_its_wires(flow, monkeypatch, tmp_path):
    """The longest path of every kind of end, and the shortest of all; the delays have a middle."""
    asked = []

    def timing_report(folder, top, netlist, clock_ns, commands):
        asked.append((folder, top, netlist, clock_ns))
        assert f"read_spef {flow.SPEF}" in commands and "propagated" in commands
        longest, shortest = commands.split('puts "SHORTEST"')
        assert longest.count("-path_delay max") == longest.count("report_checks") > 0
        assert "report_checks -path_delay min" in shortest
        assert f"write_sdf {flow.SDF}" in shortest
        (folder / flow.SDF).write_text(
            "(IOPATH A Z (0.010::0.030) (-0.02::0.04))", encoding="utf-8"
        )
        return reports.pop(0)

    monkeypatch.setattr(flow, "timing_report", timing_report)
    longest, shortest = TIMED.split("SHORTEST")
    without = [f"{longest}SHORTEST\nNo paths found.\n", f"FLOPS\nSHORTEST{shortest}"]
    reports = [TIMED, *without]
    assert flow.time_wires("top", 400.0, tmp_path) == (-0.2, 0.03)
    assert asked == [(tmp_path, "top", flow.VERILOG, 2.5)]
    delays = (tmp_path / flow.SDF).read_text(encoding="utf-8")
    assert delays == "(IOPATH A Z (0.010:0.030:0.030) (-0.02:0.04:0.04))"
    for _ in without:
        with pytest.raises(flow.ToolchainError, match="^sta: no timing of top: "):
            flow.time_wires("top", 400.0, tmp_path)


def test_a_block_with_opens_shorts_or_bare_pins_has_no_files(flow, monkeypatch, tmp_path):
    """They are told, up to five of each kind."""
    for name in (flow.PLACED, flow.STRIPS):
        (tmp_path / name).write_text("{}", encoding="utf-8")
    monkeypatch.setattr(flow, "cell_widths_um", lambda lef: {})
    monkeypatch.setattr(flow.drawn, "draw", lambda *_: None)
    before = sorted(tmp_path.iterdir())
    many = [f"n{k}" for k in range(9)]
    for opens, shorts, off in ((many, [], []), ([], [["a", "b"]], []), ([], [], ["p"])):
        found = (20, opens, shorts, off)
        monkeypatch.setattr(flow.drawn, "connect", lambda *_, found=found: found)
        told = f"top: open nets {opens[:5]}, shorts {shorts[:5]}, pins without metal of {off[:5]}"
        with pytest.raises(flow.ToolchainError) as failed:
            flow.finish("top", Path("cells"), 500.0, tmp_path)
        assert str(failed.value) == told
    assert sorted(tmp_path.iterdir()) == before


def test_delays_that_have_no_effect_are_a_mismatch(module, monkeypatch):
    """A layout must fail with delays that are much too long, and pass with its own."""
    document = module("document")
    unit, played, told = Minigroup(SMALL), [], []

    def play_with_delays(sensor, of, folder, factor, view):
        assert (sensor, of, folder, view) == (document.SMALL, unit, Path("a"), "a view")
        played.append(factor)
        if factor in failing:
            raise document.Mismatch(f"with {factor}")
        return 123, 4567

    monkeypatch.setattr(document, "play_with_delays", play_with_delays)
    given = unit, "a view", Path("a"), told.append
    failing = {document.TOO_SLOW}
    assert document.played_with_delays(*given) == [
        ("words and commits", "123"),
        ("cycles", "4567"),
        ("mismatches", "0"),
    ]
    assert played == [1.0, document.TOO_SLOW] and unit.unit_name in told[0]
    failing = {1.0, document.TOO_SLOW}
    with pytest.raises(document.Mismatch, match="^with 1.0$"):
        document.played_with_delays(*given)
    failing = set()
    with pytest.raises(document.Mismatch, match="delays 6 times as long, so the delays have no"):
        document.played_with_delays(*given)


def test_a_simulation_that_cannot_run_shows_no_effect_of_delays(module, monkeypatch):
    """Only words that differ do."""
    document = module("document")

    def play_with_delays(sensor, of, folder, factor, view):
        if factor == document.TOO_SLOW:
            raise OSError("no space")
        return 123, 4567

    monkeypatch.setattr(document, "play_with_delays", play_with_delays)
    with pytest.raises(OSError, match="no space"):
        document.played_with_delays(Minigroup(SMALL), "a view", Path("a"), str)


def test_a_block_with_delays_takes_the_place_of_its_rtl(module, monkeypatch, tmp_path):
    """In a folder for each factor, with the delays times the factor; the rest of the sensor stays."""
    delays = module("delays")
    unit, view = Minigroup(SMALL), SimpleNamespace(by_words=False)
    name = unit.unit_name
    bit = next(port.name for port in unit.ports() if port.width == 1 and port.is_input)
    (tmp_path / delays.VERILOG).write_text(
        f"module {name} (clk, {bit});\n  input clk;\n  input {bit};\nendmodule\n", encoding="utf-8"
    )
    (tmp_path / delays.SDF).write_text("(0.010:0.020:0.030)", encoding="utf-8")
    rtl = [tmp_path / f"{stem}.v" for stem in (name, "coincid_tree", "coincid_sensor")]
    built = []

    def build(simulator, sources, top, key, options):
        built.append((simulator, sources, top, key, options))
        return "a build"

    monkeypatch.setattr(delays, "rtl", lambda sensor, of: rtl)
    monkeypatch.setattr(delays, "sensor_key", lambda sensor, of: "small")
    monkeypatch.setattr(delays.toolchain, "build", build)
    monkeypatch.setattr(delays, "random_frames", lambda sensor, frames: [sensor, frames])
    monkeypatch.setattr(delays, "cell_models", lambda: "models")
    monkeypatch.setattr(delays, "played", lambda *given, lines: (given, lines))
    for factor in (1.0, 2.5):
        given, lines = delays.play_with_delays(SMALL, unit, tmp_path, factor, view)
        key = f"routed-small-{factor:g}"
        assert given == ("a build", [SMALL, delays.FRAMES], key) and lines
        simulator, sources, top, built_key, options = built[-1]
        assert (simulator, top, built_key) == ("icarus", delays.TOP, key)
        assert options == ["-gspecify"]
        folder = tmp_path / f"delays-{factor:g}"
        own = [folder / f"{name}.v", folder / "routed.v", folder / "cells.v"]
        assert sources == [*rtl[1:], *own]
        sdf = (folder / delays.SDF).read_text(encoding="utf-8")
        scaled = ":".join(f"{factor * ns:.4f}" for ns in (0.01, 0.02, 0.03))
        assert sdf == f"({scaled})"
        shell, routed, cells = (path.read_text(encoding="utf-8") for path in own)
        assert f'$sdf_annotate("{folder / delays.SDF}", routed)' in shell
        assert f".{bit}(late_{bit}[0])" in shell and ".clk(" in shell
        assert routed.startswith(f"`timescale 1ns/1ps\nmodule {name}_routed (clk, ")
        assert cells == "models"


def test_facts_of_a_layout_count_its_cells_and_its_wires(flow, monkeypatch, tmp_path):
    """Fillers are no cells. Width and area are in um, slacks as they are timed."""
    cells = [
        {"name": f"u{k}", "kind": kind, "nets": {}}
        for k, kind in enumerate(["INV", "DFF", "INV", flow.CLOCK_BUFFER, "FILLCELL_X4"])
    ]
    placed = {"width": 30.4, "height": 22.4, "cells": cells, "ports": {}}
    strip = [0.1, 0.3, 1.1, 0.5, True]
    stored = {flow.PLACED: placed, flow.STRIPS: {"INV": {"A": strip}}}
    for name, content in stored.items():
        (tmp_path / name).write_text(json.dumps(content), encoding="utf-8")
    widths_um = {"INV": 0.38, "DFF": 3.23, flow.CLOCK_BUFFER: 1.33, "FILLCELL_X4": 0.76}
    places = {"INV": {"A": flow.Strip(*strip)}}
    drawing = SimpleNamespace(write=lambda path: Path(path).write_bytes(b"gds"))
    wired = flow.wires.Wired("spef", 123.5, {"a": 2.0, "b": 3.5}, 7)

    def draw(routed, gds, of, strips, widths, top):
        assert (routed, gds) == (tmp_path / "top.gds", Path("cells") / flow.GDS)
        assert (of, strips, widths, top) == (placed, places, widths_um, "top")
        return drawing

    def read_cells(path, kinds):
        assert path == tmp_path / flow.LIBERTY
        assert kinds == {"INV", "DFF", flow.CLOCK_BUFFER}
        return "a library"

    def clock_tree_mw(of, wires, library, volts, clock_mhz):
        assert (of, wires, library, volts, clock_mhz) == (placed, wired, "a library", 1.1, 400.0)
        return 0.25

    monkeypatch.setattr(flow, "cell_widths_um", lambda lef: widths_um)
    monkeypatch.setattr(flow.drawn, "draw", draw)
    monkeypatch.setattr(flow.drawn, "connect", lambda *_: (11, [], [], []))
    monkeypatch.setattr(flow.drawn, "draw_picture", lambda gds, png: png.write_bytes(b"png"))
    monkeypatch.setattr(flow.drawn, "check_rules", lambda *_: [("metal1: width", 2)])
    monkeypatch.setattr(flow.wires, "lengths_um", lambda routed: routed.name)
    monkeypatch.setattr(flow.wires, "wired", lambda *_: wired)
    monkeypatch.setattr(flow.wires, "netlist", lambda *_: "verilog")
    monkeypatch.setattr(flow.wires, "clock_tree_mw", clock_tree_mw)
    monkeypatch.setattr(flow, "time_wires", lambda *_: (0.125, -0.5))
    monkeypatch.setattr(flow, "read_cells", read_cells)
    monkeypatch.setattr(flow, "supply_v", lambda path: 1.1)
    assert flow.finish("top", Path("cells"), 400.0, tmp_path) == {
        "cells": 4,
        "cell_area_um2": pytest.approx((2 * 0.38 + 3.23 + 1.33) * 1.4),
        "width_um": 30.4,
        "height_um": 22.4,
        "buffers": 1,
        "nets": 11,
        "slack_ns": 0.125,
        "hold_ns": -0.5,
        "clock_tree_mw": 0.25,
        "wire_um": 123.5,
        "wire_ff": 5.5,
        "sinks": 7,
        "rules": [("metal1: width", 2)],
    }
    left = {flow.SPEF: "spef", flow.VERILOG: "verilog", flow.FINAL: "gds", "top.png": "png"}
    for name, text in left.items():
        assert (tmp_path / name).read_text(encoding="utf-8") == text


def test_a_layout_is_made_once_for_its_clock_and_the_code_that_makes_it(
    flow, monkeypatch, tmp_path
):
    """Not for the code behind it. Its facts are those that were left in its folder."""
    asked, routed = [], []
    view = SimpleNamespace(cells=(tmp_path / "own_cell.v",), macros=(tmp_path / "macro.v",))
    for path in (*view.cells, *view.macros):
        path.write_text(f"// {path.name}", encoding="utf-8")

    def yosys_once(place, files, script, state, then):
        asked.append((place.name, files, script, list(state)))
        then(tmp_path)
        return tmp_path

    monkeypatch.setattr(flow, "layout_cells", lambda: Path("cells"))
    monkeypatch.setattr(flow, "units_files", lambda units, cells: {"unit.v": f"{cells}"})
    monkeypatch.setattr(flow, "library_files", lambda: {"lib": "cells"})
    monkeypatch.setattr(flow, "yosys_once", yosys_once)
    monkeypatch.setattr(flow, "route", lambda top, cells, folder, tell: routed.append(top))
    monkeypatch.setattr(flow, "finish", lambda top, cells, mhz, folder: {"mhz": mhz})
    unit = SimpleNamespace(unit_name="unit")
    folder, facts = flow.lay_out(unit, 400.0, print, view)
    assert (folder, facts, routed) == (tmp_path, {"mhz": 400.0}, ["unit"])
    assert json.loads((tmp_path / flow.FACTS).read_text(encoding="utf-8")) == facts
    flow.lay_out(unit, 500.0, print, view)
    (name, files, script, state), (_, _, _, other) = asked
    assert name == "unit" and state != other and state[1:] == other[1:]
    assert files == {
        "unit.v": "True",
        "own_cell.v": "// own_cell.v",
        "macro.v": "// macro.v",
        "lib": "cells",
    }
    assert script[0] == "read_verilog -sv unit.v own_cell.v macro.v"
    assert script[-1] == f"write_blif -buf BUF_X1 A Z {flow.BLIF}"
    own = Path(flow.__file__).parent
    texts = {
        path.name: path.read_text(encoding="utf-8") for path in own.iterdir() if path.is_file()
    }
    counted = {name for name, text in texts.items() if text in state}
    without = {"document.py", "delays.py", "page.md"}
    assert counted == texts.keys() - without


def test_the_page_of_layouts_has_a_column_and_a_picture_for_each_view(
    module, monkeypatch, tmp_path
):
    """In the order of the views, at the clock of the preset, and each with its own numbers."""
    from PIL import Image

    document = module("document")
    clock_mhz = document.load_config("silicon").clock_mhz
    numbers, pictured = {}, []

    def lay_out(unit, mhz, tell, view):
        assert mhz == clock_mhz
        own = numbers.setdefault(unit.unit_name, len(numbers) + 1)
        folder = tmp_path / unit.unit_name
        folder.mkdir(exist_ok=True)
        Image.new("RGB", (own, 1)).save(folder / f"{unit.unit_name}.png")
        found = {
            "width_um": 10.0 * own,
            "height_um": 20.0,
            "cells": 1000 + own,
            "cell_area_um2": 100.0 * own,
            "buffers": own,
            "clock_tree_mw": 0.5,
            "nets": 2000 + own,
            "wire_um": 3000.0 * own,
            "sinks": 500,
            "wire_ff": 250.0,
            "slack_ns": 0.1 * own,
            "hold_ns": -0.1 * own,
            "rules": [("metal1: width", own), ("via1: distance", 0)],
        }
        return folder, found

    def map_block(unit, view, gated):
        assert not gated  # the layout has no gates, either
        return SimpleNamespace(folder=None, name=unit.unit_name, area_um2=70.0)

    def slacks_ns(folder, name, clock_ns):
        assert clock_ns == 1000 / clock_mhz
        return {"FLOPS": 0.75, "LATCHES": 0.25}

    def played(unit, view, folder, tell):
        assert folder.name == unit.unit_name
        return [("words and commits", str(10 * numbers[unit.unit_name]))]

    monkeypatch.setattr(document, "lay_out", lay_out)
    monkeypatch.setattr(document, "map_block", map_block)
    monkeypatch.setattr(document, "slacks_ns", slacks_ns)
    monkeypatch.setattr(document, "played_with_delays", played)
    page = tmp_path / "out" / "page.md"
    document.write_layout_page(page, print)
    text = page.read_text(encoding="utf-8")
    rows = [line for line in text.splitlines() if line.startswith("| ")]
    for row in (
        "| cells with the clock tree | 1001 | 1002 |",
        "| cells before layout, um2 | 70 | 70 |",
        "| metal1: width | 1 | 2 |",
        "| via1: distance | 0 | 0 |",
        "| longest, before layout: no wires, ideal clock | +0.25 | +0.25 |",
        "| longest, with wires and clock tree | +0.10 | +0.20 |",
        "| words and commits | 10 | 20 |",
    ):
        assert row in rows
    assert f"at a cycle of {1000 / clock_mhz:g} ns" in " ".join(text.split())
    for unit, number in numbers.items():
        name = f"layout-{unit.removeprefix('coincid_')}.png"
        assert f"(images/{name})" in text
        with Image.open(page.parent / "images" / name) as shown:
            pictured.append(shown.size == (number, 1))
    assert pictured == [True, True]
    # Without another place, the page and the pictures are those of the project, and the page that
    # shows them is renewed.
    renewed = []
    monkeypatch.setattr(document, "picture", lambda folder: tmp_path / folder)
    for name in ("put_page", "put"):
        monkeypatch.setattr(
            document, name, lambda *given, name=name: renewed.append((name, *given))
        )
    document.write_layout_page(tell=print)
    whole = "put_page", "docs/layout.md", "layout"
    (*told, own, out), other = renewed
    assert (tuple(told), own.split(), out) == (whole, text.split(), None)
    assert other == ("put", "docs/silicon.md", "layout")
    assert len(list((tmp_path / "docs" / "images").iterdir())) == 2


@pytest.mark.parametrize("margin", [0.45, 0.6])
def test_a_job_is_told_to_the_placer_and_the_router(module, monkeypatch, margin):
    """Its clock, its free area, and the tracks that it reserves in each direction. Cells stay out of
    the ring of the block.
    """
    block = module("block")
    clocks = []

    class Conf(SimpleNamespace):
        def __init__(self, cell, ioPins, ioPads):
            sections = ("etesian", "anabatic", "katana", "block")
            cfg = SimpleNamespace(**{name: SimpleNamespace() for name in sections})
            super().__init__(cell=cell, pins=ioPins, pads=ioPads, cfg=cfg, useHTree=clocks.append)

    monkeypatch.setattr(block, "BlockConf", Conf)
    monkeypatch.setattr(block, "Box", lambda *corners: corners)
    cell = block_of([Instance(f"u{k}", 0, 0, 3 * SITE) for k in range(300)], 0)
    job = SimpleNamespace(clock="own_clk", margin=margin, tracks_reserved=[4, 6, 3])
    conf = block.configuration(cell, job)
    assert (conf.cell, conf.pins, conf.pads, clocks) == (cell, [], [], ["own_clk"])
    assert conf.cfg.etesian.spaceMargin == margin
    katana = conf.cfg.katana
    assert (katana.hTracksReservedLocal, katana.vTracksReservedLocal) == (4, 6)
    assert (katana.hTracksReservedMin, katana.vTracksReservedMin) == (3, 3)
    assert conf.useClockTree and conf.useHFNS and conf.useSpares
    width, height = (round(um * UNITS_PER_UM) for um in block.core_size_um(cell, margin))
    assert conf.coreSize == (width, height)
    left, bottom, right, top = conf.placeArea
    assert (left, width - right) == (8 * SITE, 8 * SITE)
    assert (bottom, height - top) == (2 * ROW, 2 * ROW)


def test_cells_are_on_sites_before_they_are_recorded_and_routed(module, monkeypatch):
    block = module("block")
    happened = []
    base = block.SnappedBlock.__mro__[1]
    conf = SimpleNamespace(cell="a cell")
    monkeypatch.setattr(base, "place", lambda self: happened.append("place"), raising=False)
    monkeypatch.setattr(
        base, "route", lambda self: happened.append("route") or "routed", raising=False
    )
    for name in ("snap", "record"):
        monkeypatch.setattr(block, name, lambda cell, name=name: happened.append((name, cell)))
    one = block.SnappedBlock()
    one.conf = conf
    one.place()
    assert one.route() == "routed"
    assert happened == ["place", ("snap", "a cell"), ("record", "a cell"), "route"]


def test_a_via_reaches_beyond_its_cut_along_each_of_its_narrow_metals(module, monkeypatch):
    """Up to metal3; at metal4 it has a square pad on both, and none above."""
    technology = module("technology")
    made = []

    def create(tech, *given):
        return given

    def enclose(via, metal, reach):
        made.append((via[:4], via[4], metal, reach))

    monkeypatch.setattr(technology, "createVia", create)
    monkeypatch.setattr(technology, "setEnclosures", enclose)
    metals = {i: f"metal{i}" for i in technology.METALS}
    for i in range(1, 10):
        technology._via(None, metals, i)
    along = {1: (0, 35), 2: (0, 35), 3: (35, 0)}  # pins of metal1 stand upright
    expected = []
    for i in range(1, 10):
        via = f"VIA{i}{i + 1}", f"metal{i}", f"via{i}", f"metal{i + 1}"
        side = round(1000 * technology.WIDTH_UM[i])
        for j in (i, i + 1):
            reach = (35, 35) if (i, j) == (3, 4) else along.get(j, (0, 0)) if i < 4 else (0, 0)
            expected.append((via, side, f"metal{j}", reach))
    assert made == expected


def test_each_metal_and_each_via_has_its_layer_its_width_and_its_distance(module, monkeypatch):
    """Layers of the GDS of the cells: from metal1 on, metals and vias take turns."""
    technology = module("technology")
    made = {}

    def create(tech, name, kind, size=0, spacing=0, gds2Layer=None):
        made[name] = kind, size, spacing, gds2Layer
        return SimpleNamespace(setBlockageLayer=lambda layer: None)

    kinds = {"nWell", "pWell", "nImplant", "pImplant", "active", "poly", "other", "blockage"}
    material = SimpleNamespace(**{kind: kind for kind in kinds | {"metal", "cut"}})
    anything = SimpleNamespace(create=lambda *_: None, get=lambda: None)
    unit = SimpleNamespace(UnitPowerMicro=None, setPrecision=lambda _: None)
    unit.setPhysicalsPerGrid = lambda *_: None
    file, files = SimpleNamespace(gdsDriver=SimpleNamespace()), SimpleNamespace(ConfigurationFile=0)
    for name, stand_in in (
        ("BasicLayer", SimpleNamespace(Material=material)),
        ("CRL", SimpleNamespace(System=anything)),
        ("CfgCache", lambda priority: nullcontext(file)),
        ("DataBase", anything),
        ("DbU", unit),
        ("Technology", anything),
        ("Cfg", SimpleNamespace(Parameter=SimpleNamespace(Priority=files))),
        ("createBL", create),
        ("_via", lambda *_: None),
    ):
        monkeypatch.setattr(technology, name, stand_in)
    technology._technology()
    for i, um in technology.WIDTH_UM.items():
        width = round(1000 * um)
        assert made[f"metal{i}"] == ("metal", width, width, 9 + 2 * i)
        if i in technology.CUT_SPACE_UM:
            space = round(1000 * technology.CUT_SPACE_UM[i])
            assert made[f"via{i}"] == ("cut", width, space, 10 + 2 * i)
    assert made.keys() >= {f"via{i}" for i in range(1, 10)} and "via10" not in made
    layers = [layer for *_, layer in made.values() if layer is not None]
    assert len(set(layers)) == len(layers)


def test_tracks_alternate_and_only_the_lower_metals_are_routed(module, monkeypatch):
    """Metal2 has the pins only; metal7 and above are for supplies."""
    technology = module("technology")
    made, gauges = [], []
    gauge = SimpleNamespace(setSymbolic=lambda on: None, addLayerGauge=made.append)
    layers = SimpleNamespace(
        Horizontal="flat",
        Vertical="upright",
        PinOnly="pins",
        PowerSupply="supply",
        Default="wires",
        create=lambda *given: given,
    )
    tech = SimpleNamespace(getLayer=lambda name: name)
    database = SimpleNamespace(getTechnology=lambda: tech)
    framework = SimpleNamespace(addRoutingGauge=lambda of: None, addCellGauge=lambda of: None)
    for name, stand_in in (
        ("AllianceFramework", SimpleNamespace(get=lambda: framework)),
        ("DataBase", SimpleNamespace(getDB=lambda: database)),
        ("RoutingGauge", SimpleNamespace(create=lambda name: gauges.append(name) or gauge)),
        ("CellGauge", SimpleNamespace(create=lambda *given: given)),
        ("RoutingLayerGauge", layers),
    ):
        monkeypatch.setattr(technology, name, stand_in)
    technology._gauges()
    kinds = {2: "pins", 3: "wires", 4: "wires", 5: "wires", 6: "wires", 7: "supply", 8: "supply"}
    assert [of[:4] for of in made] == [
        (f"metal{i}", "flat" if i % 2 else "upright", kind, depth)
        for depth, (i, kind) in enumerate(kinds.items())
    ]
    for (_, way, _, _, _, first, pitch, width, pad, *_), i in zip(made, kinds, strict=True):
        assert first == (70 if way == "flat" else 95)
        assert width == round(1000 * technology.WIDTH_UM[i]) <= pad < pitch or i == 3
        assert pitch == round(1000 * technology.PITCH_UM[i])
    settings = tomllib.loads(technology.SETTINGS.read_text(encoding="utf-8"))
    assert gauges == [settings["anabatic"]["routingGauge"]]


def test_cells_and_supplies_of_the_settings_are_those_of_the_flow(module):
    """Of the power of the clock tree, of the constants that Yosys puts in, and of the fillers."""
    flow, pins = module("flow"), module("pins")
    settings = tomllib.loads(module("technology").SETTINGS.read_text(encoding="utf-8"))
    assert settings["clockTree"]["buffer"] == settings["spares"]["buffer"] == flow.CLOCK_BUFFER
    crlcore, etesian = settings["crlcore"], settings["etesian"]
    assert (crlcore["powerName"], crlcore["groundName"]) == pins.SUPPLIES
    assert etesian["cell"] == {"zero": "LOGIC0_X1", "one": "LOGIC1_X1"}
    feeds = etesian["feedNames"].split(",")
    assert etesian["defaultFeed"] == feeds[0] == "FILLCELL_X1"
    assert feeds == [f"FILLCELL_X{sites}" for sites in (1, 2, 4, 8, 16)]


def test_every_setting_of_the_file_is_set_at_its_place(module):
    """In sections within sections; what is there besides stays."""
    technology = module("technology")
    inner = SimpleNamespace(other=1)
    config = SimpleNamespace(katana=SimpleNamespace(inner=inner), etesian=SimpleNamespace())
    values = {"katana": {"a": 2, "inner": {"b": "c"}}, "etesian": {"d": [3]}}
    technology._set(config, values)
    assert (config.katana.a, vars(inner), config.etesian.d) == (2, {"other": 1, "b": "c"}, [3])


def test_the_settings_of_the_file_come_with_the_sites_of_the_cells(module, monkeypatch):
    """They are set where settings of a file are, and every value of the file among them."""
    technology = module("technology")
    config, priorities = SimpleNamespace(anabatic=SimpleNamespace()), []
    files = SimpleNamespace(ConfigurationFile="of a file")
    monkeypatch.setattr(
        technology, "Cfg", SimpleNamespace(Parameter=SimpleNamespace(Priority=files))
    )
    monkeypatch.setattr(
        technology, "CfgCache", lambda priority: priorities.append(priority) or nullcontext(config)
    )
    given = []
    monkeypatch.setattr(technology, "_set", lambda *what: given.append(what))
    technology._settings()
    assert given == [(config, tomllib.loads(technology.SETTINGS.read_text(encoding="utf-8")))]
    assert config.anabatic.cellGauge == technology.SITE_NAME
    assert priorities == ["of a file"]


def test_a_technology_is_there_before_its_cells(module, monkeypatch, tmp_path):
    """The cells are those of all LEF files, with the strips of a file and room for their pins."""
    technology = module("technology")
    happened = []
    for step in ("technology", "gauges", "settings"):
        monkeypatch.setattr(technology, f"_{step}", lambda step=step: happened.append(step))
    monkeypatch.setattr(technology, "_cells", lambda *given: happened.append(given) or "library")
    (tmp_path / "strips").write_text('{"INV": {"A": [1, 2, 3, 4, true]}}', encoding="utf-8")
    assert technology.set_up(["a.lef"], tmp_path / "strips", 0.75) == "library"
    strips = {"INV": {"A": [1, 2, 3, 4, True]}}
    assert happened == ["technology", "gauges", "settings", (["a.lef"], strips, 0.75)]


def test_every_cell_gets_its_strips_and_the_room_of_its_pins(module, monkeypatch):
    """The file of the technology is read first. A pin without a strip, as of a supply, stays; so
    does the metal of a cell that is not used, which gets its room all the same.
    """
    technology = module("technology")
    done = []

    def cell(name, *pins):
        nets = [SimpleNamespace(getName=lambda pin=pin: pin) for pin in pins]
        return SimpleNamespace(getName=lambda: name, getNets=lambda: nets)

    cells = [cell("INV", "A", "VDD", "ZN"), cell("OTHER", "A")]
    library = SimpleNamespace(getCells=lambda: cells)
    monkeypatch.setattr(technology, "LefImport", SimpleNamespace())
    technology.LefImport.load = lambda path: done.append(("load", path))
    technology.LefImport.setMergeLibrary = lambda of: done.append(("into", of is library))
    framework = SimpleNamespace(wrapLibrary=lambda of, _: done.append(("wrap", of is library)))
    database = SimpleNamespace(
        getRootLibrary=lambda: "root",
        getTechnology=lambda: SimpleNamespace(getLayer=lambda name: f"layer {name}"),
    )
    for name, stand_in in (
        ("AllianceFramework", SimpleNamespace(get=lambda: framework)),
        ("DataBase", SimpleNamespace(getDB=lambda: database)),
        ("Library", SimpleNamespace(create=lambda *_: library)),
        ("_replace_pin", lambda net, *given: done.append((net.getName(), *given))),
        ("_widen", lambda of, um2_per_pin: done.append((of.getName(), um2_per_pin))),
    ):
        monkeypatch.setattr(technology, name, stand_in)
    strips = {"INV": {"A": [1.0, 2.0, 3.0, 2.5, True], "ZN": [4.0, 5.0, 6.0, 5.5, False]}}
    assert technology._cells([Path("tech"), Path("b"), Path("c")], strips, 0.75) is library
    assert done[:2] == [("load", "tech"), ("into", True)]
    assert done[2:5] == [("load", "b"), ("load", "c"), ("wrap", True)]
    assert done[5:] == [
        ("A", "layer metal2", 1.0, 2.0, 3.0),
        ("ZN", "layer metal2", 4.0, 5.0, 6.0),
        ("INV", 0.75),
        ("OTHER", 0.75),
    ]


@pytest.mark.parametrize("routed", [True, False])
def test_a_block_is_built_on_sites(module, monkeypatch, routed):
    """Coriolis would put spare cells and the buffers of the clock tree on its own pitch."""
    block = module("block")
    monkeypatch.setattr(block, "configuration", lambda *given: given)
    built = []
    monkeypatch.setattr(
        block,
        "SnappedBlock",
        lambda conf: SimpleNamespace(doPnR=lambda: built.append(conf) or int(routed)),
    )
    assert block.build("a cell", "a job") is routed
    assert built == [("a cell", "a job")]
    assert block.BlockConf.toXPitch is block.Spares.toXPitch is block.to_site


@pytest.mark.parametrize(("routed", "code"), [(True, 0), (False, 3)])
def test_the_program_of_a_job_saves_the_block_and_tells_whether_it_is_routed(
    module, monkeypatch, tmp_path, routed, code
):
    """Only the port of the clock is one, not a net inside with its name. A block that is not routed
    is saved too, so that one can look at it.
    """
    technology, block = module("technology"), module("block")
    program = module("place_route")
    done = []

    def net(name, is_port):
        return SimpleNamespace(
            getName=lambda: name,
            isExternal=lambda: is_port,
            setType=lambda kind: done.append((name, is_port, kind)),
        )

    nets = [net("rst", True), net("own_clk", False), net("own_clk", True)]
    cell = SimpleNamespace(getNets=lambda: nets)
    coriolis = SimpleNamespace(
        Blif=SimpleNamespace(load=lambda name: done.append(name) or cell),
        Gds=SimpleNamespace(save=lambda of: done.append(("gds", of is cell))),
        DefExport=SimpleNamespace(drive=lambda of, _: done.append(("def", of is cell))),
    )
    monkeypatch.setattr(sys.modules["coriolis"], "CRL", coriolis)
    kinds = SimpleNamespace(Type=SimpleNamespace(CLOCK="clock"))
    monkeypatch.setattr(sys.modules["coriolis.Hurricane"], "Net", kinds, raising=False)
    monkeypatch.setattr(technology, "set_up", lambda *given: done.append(given))
    monkeypatch.setattr(
        block, "build", lambda of, job: done.append((of is cell, job.margin)) or routed
    )
    job = {"lef": ["a.lef", "b.lef"], "strips": "strips.json", "um2_per_pin": 0.75}
    job |= {"blif": "mapped", "clock": "own_clk", "margin": 0.5}
    (tmp_path / "job").write_text(json.dumps(job), encoding="utf-8")
    assert program.main(str(tmp_path / "job")) == code
    assert done == [
        ([Path("a.lef"), Path("b.lef")], Path("strips.json"), 0.75),
        "mapped",
        ("own_clk", True, "clock"),
        (True, 0.5),
        ("gds", True),
        ("def", True),
    ]


@pytest.mark.parametrize("missing", ["cells", "coriolis", "klayout", None])
def test_each_tool_of_a_layout_that_is_missing_is_told_with_what_installs_it(monkeypatch, missing):
    there = Path("cells")
    monkeypatch.setattr(layout_tools, "find_spec", lambda name: None if name == missing else name)
    monkeypatch.setattr(layout_tools, "cells_folder", lambda: None if missing == "cells" else there)
    if missing is None:
        assert layout_tools.layout_cells() == there
        return
    with pytest.raises(InputError, match="not installed; run: scripts/setup cells layout$"):
        layout_tools.layout_cells()
