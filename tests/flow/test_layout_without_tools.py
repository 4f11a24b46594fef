# SPDX-License-Identifier: Apache-2.0
"""What a layout computes itself, without placer and drawing program: legal sites, the size of a
block, its record, wires as SPEF, the clock tree's power, the netlist, and the shell with delays.
"""

import json
import sys
from contextlib import nullcontext
from importlib import import_module
from pathlib import Path
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest

from coincid.flow import layout
from coincid.flow.liberty import Cell, Energies, Pin
from coincid.hdl.minigroup import Minigroup

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
    nets = wired.spef.split("*D_NET ")[1:]
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


def test_the_power_of_a_clock_tree(module):
    """Of its buffers and wires; the pins of flip-flops are left out, although the buffers drive
    them.
    """
    wires = module("wires")
    buffer = wires.CLOCK_BUFFER
    energies = Energies(np.array([0.0, 100.0]), np.array([1.0, 11.0]))  # 1 fJ and 0.1 fJ per fF
    cells = {
        buffer: Cell(
            0.0, {"A": Pin(False, 3.0, None, False), "Z": Pin(True, 0.0, energies, False)}
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
