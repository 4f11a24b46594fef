# SPDX-License-Identifier: Apache-2.0
"""Layout: wires of a DEF file, pins that a router reaches, what the checks find, and a small block from Verilog to a checked GDS."""

import json
from collections import Counter, defaultdict

import pytest

from coincid.flow.yosys import cells_folder

pya = pytest.importorskip("klayout.db", reason="the layout tools (scripts/setup layout) are not installed")

from coincid.flow.layout import buffers, drawn, hierarchy, pins, wires  # noqa: E402
from coincid.flow.layout.delays import scaled  # noqa: E402

DEF = """\
UNITS DISTANCE MICRONS 1000 ;
COMPONENTS 1 ;
- u1 INV + PLACED ( 0 0 ) N ;
END COMPONENTS
SPECIALNETS 1 ;
   - clk ( u1 A )
      + ROUTED metal6 140 ( 0 0 ) ( 2000 * ) ;
END SPECIALNETS
NETS 2 ;
   - a ( u1 A )  ;
   - b ( u1 ZN )  ( u2 A )
      + ROUTED metal4 ( 100 0 ) ( * 700 )
         NEW metal3 ( 100 700 ) ( 1100 * )
         NEW metal3 ( 100 700 ) VIA34 ;
END NETS
"""
LEF = """\
MACRO TWO
  PIN A
    LAYER metal1 ;
      RECT 0.05 0.3 0.2 0.9 ;
  END A
  PIN Z
    LAYER metal1 ;
      RECT 0.4 0.3 0.54 0.9 ;
  END Z
  PIN VDD
    LAYER metal1 ;
      RECT 0 1.3 0.6 1.5 ;
  END VDD
END TWO
"""


def test_lengths_of_wires(tmp_path):
    path = tmp_path / "routed.def"
    path.write_text(DEF)
    lengths = {net: dict(on) for net, on in wires.lengths_um(path).items()}
    assert lengths == {"clk": {6: 2.0}, "a": {}, "b": {4: 0.7, 3: 1.0}}


def test_strips_stand_on_their_pins(tmp_path):
    path = tmp_path / "two.lef"
    path.write_text(LEF)
    found = pins.strips(path, {"TWO"})["TWO"]
    assert {pin: (strip.x, strip.fits) for pin, strip in found.items()} == {"A": (0.095, True), "Z": (0.475, True)}
    assert all(0.3 < strip.via < 0.9 and strip.low < strip.via < strip.high for strip in found.values())


def test_delays_scale():
    assert scaled("(IOPATH A ZN (0.010:0.010:0.010) (0.020:0.020:0.020))", 3) == (
        "(IOPATH A ZN (0.0300:0.0300:0.0300) (0.0600:0.0600:0.0600))"
    )


def two_cells(shapes):
    """A layout of two pins at (0.1, 0.5) and (1.1, 0.5) of nets a and `net`, with shapes (layer, box in um)."""
    layout = pya.Layout()
    layout.dbu = drawn.DBU_UM
    top = layout.create_cell("top")
    for layer, corners in shapes:
        top.shapes(layout.layer(layer, 0)).insert(drawn.box(*corners))
    strips = {"C": {"P": pins.Strip(0.1, 0.3, 0.7, 0.5, True)}}
    cells = [
        {"name": name, "kind": "C", "x": x, "y": 0.0, "flipped": False, "nets": {"P": net}}
        for name, x, net in (("one", 0.0, "a"), ("other", 1.0, "a"))
    ]
    return layout, {"cells": cells, "ports": {}}, strips


PINS = [(13, (0.065, 0.3, 0.135, 0.7)), (13, (1.065, 0.3, 1.135, 0.7))]
VIAS = [(14, (0.065, 0.465, 0.135, 0.535)), (14, (1.065, 0.465, 1.135, 0.535))]
WIRE = [(15, (0.03, 0.465, 1.17, 0.535))]


def test_opens_and_shorts_are_found():
    whole = drawn.connect(*_named(two_cells(PINS + VIAS + WIRE)))
    assert (whole.opens, whole.shorts, whole.off) == ([], [], 0)
    assert drawn.connect(*_named(two_cells(PINS + VIAS[:1] + WIRE))).opens == ["a"]
    assert drawn.connect(*_named(two_cells(PINS[:1] + VIAS + WIRE))).off == 1
    layout, placed, strips = two_cells(PINS + VIAS + WIRE)
    placed["cells"][1]["nets"]["P"] = "b"
    assert drawn.connect(layout, "top", placed, strips).shorts == [["a", "b"]]


def test_rules_are_checked():
    layout, _, _ = two_cells(PINS + VIAS + WIRE)
    assert not any(found for _, found in drawn.check_rules(layout, "top"))
    layout, _, _ = two_cells(PINS + VIAS + [(15, (0.065, 0.465, 1.17, 0.505)), (15, (0.5, 0.55, 0.6, 0.62))])
    broken = {rule for rule, found in drawn.check_rules(layout, "top") if found}
    assert broken == {
        "metal3: width",
        "metal3: distance",
        "via2: covered by both metals",
        "via2: metal beyond it on two sides",
    }


def test_a_cut_too_near_its_neighbour_goes():
    near = [(14, (0.065, 0.565, 0.135, 0.635)), (15, (0.03, 0.565, 1.17, 0.635))]
    layout, placed, strips = two_cells(PINS + VIAS + WIRE + near)
    found = drawn.connect(layout, "top", placed, strips)
    assert (found.cuts, found.opens, found.shorts) == (1, [], [])
    assert not any(violations for _, violations in drawn.check_rules(layout, "top"))


def _named(given):
    layout, placed, strips = given
    return layout, "top", placed, strips


def test_macros_meet_sites_and_rows_alike_and_do_not_touch():
    plan = hierarchy.floorplan("M", 60.42, 61.6, 16)
    for name, step in (("x", 0.19), ("dx", 0.19), ("x", 0.3), ("dx", 0.3), ("y", 2.8), ("dy", 2.8), ("y", 0.3)):
        assert plan[name] / step == pytest.approx(round(plan[name] / step))
    assert plan["dx"] >= 60.42 + hierarchy.CHANNEL_UM and plan["dy"] >= 61.6 + hierarchy.CHANNEL_UM
    assert plan["width"] == pytest.approx(2 * plan["x"] + 3 * plan["dx"] + 60.42)


def test_unused_inputs_are_no_ports_of_a_macro():
    netlist = "module m (a, b, z);\n  input a;\n  input b;\n  output z;\n  INV_X1 u1 (.A(b), .ZN(z));\nendmodule\n"
    assert hierarchy.used_ports(netlist) == {"b": "input", "z": "output"}


def test_a_block_with_macros_becomes_flat():
    strips = {"INV": {"A": pins.Strip(0.1, 0.2, 0.9, 0.5, True), "ZN": pins.Strip(0.3, 0.2, 0.9, 0.5, True)}}

    def inverter(name, x, a, zn):
        return {"name": name, "kind": "INV", "x": x, "y": 0.0, "flipped": False, "nets": {"A": a, "ZN": zn}}

    inner = {"cells": [inverter("u1", 1.0, "in", "n1"), inverter("u2", 2.0, "n1", "out")]}
    macro_pins = {"in": pins.Strip(1.1, 0.2, 0.9, 0.5, True), "out": pins.Strip(2.3, 0.2, 0.9, 0.5, True)}
    macro = hierarchy.Macro("M", inner, strips, {"n1": {4: 0.9}, "out": {3: 0.2}}, macro_pins)
    placed = {
        "cells": [
            {"name": "one", "kind": "M", "x": 10.0, "y": 0.0, "flipped": False, "nets": {"in": "a", "out": "b"}},
            inverter("u1", 0.0, "b", "a"),
        ]
    }
    cells = {one["name"]: (one["x"], one["nets"]) for one in hierarchy.flat(placed, macro)["cells"]}
    assert cells == {
        "u1": (0.0, {"A": "b", "ZN": "a"}),
        "m0_u1": (11.0, {"A": "a", "ZN": "m0_n1"}),
        "m0_u2": (12.0, {"A": "m0_n1", "ZN": "b"}),
    }
    reach = hierarchy.estimates_um(placed, strips | {"M": macro_pins})
    assert reach == pytest.approx({"a": hierarchy.DETOUR * 10.8, "b": hierarchy.DETOUR * 12.2})
    lengths = hierarchy.lengths_um(placed, macro, {"b": 8.0})
    assert {net: dict(on) for net, on in lengths.items()} == {"b": {3: 2.2, 4: 2.0, 5: 2.0, 6: 2.0}, "m0_n1": {4: 0.9}}


def test_buffers_stand_between_a_net_and_its_many_cells():
    strips = {
        "BUF_X4": {"A": pins.Strip(0.1, 0.2, 0.9, 0.5, True)},
        "DFF_X1": {"CK": pins.Strip(0.1, 0.2, 0.9, 0.5, True)},
    }
    flops = [
        dict(name=f"f{k}", kind="DFF_X1", x=3.8 * (k % 10), y=1.4 * (k // 10), flipped=False, nets={"CK": "clk"})
        for k in range(100)
    ]
    placed = {"cells": flops, "ports": {"clk": "input"}, "width": 38.0, "height": 14.0}
    found = buffers.grow(placed, "clk", strips, {"DFF_X1": 1.9, "BUF_X4": 0.95}, "macro", [], 0.0)
    assert hierarchy.drivers_lost(found) == []
    below = Counter(one["nets"]["CK"] for one in found["cells"] if one["kind"] == "DFF_X1")
    assert max(below.values()) <= buffers.SINKS_MAX and sum(below.values()) == 100
    added = [one for one in found["cells"] if one["kind"] == "BUF_X4"]
    assert 0 < sum(one["nets"]["A"] == "clk" for one in added) <= buffers.BUFFERS_MAX
    rows = defaultdict(list)
    for one in found["cells"]:
        rows[one["y"]].append((one["x"], one["x"] + (0.95 if one["kind"] == "BUF_X4" else 1.9)))
    for row in map(sorted, rows.values()):
        assert all(left[1] <= right[0] + 1e-9 for left, right in zip(row, row[1:]))


@pytest.mark.skipif(cells_folder() is None, reason="standard cells (scripts/setup cells) are not installed")
def test_a_small_minigroup_is_routed_and_its_tree_placed():
    from coincid.flow.layout.flow import PLACED, lay_out
    from coincid.hdl.minigroup import Minigroup
    from coincid.hdl.tree import CoincidenceTree
    from coincid.model.contract.parameters import Sensor

    small = Sensor(rows=4, cols=4, subgroup=(4, 4), minigroup=(1, 2), phases=4, window_max=8, fifo_depth=1)
    layout = lay_out(Minigroup(small), 500.0, print)
    assert not any(found for _, found in layout.rules)
    assert layout.cell_area_um2 < layout.width_um * layout.height_um
    assert layout.slack_ns < 2.0
    placed = json.loads((layout.folder / PLACED).read_text())
    real = [one for one in placed["cells"] if not one["kind"].startswith("FILL")]
    assert len(real) == layout.cells
    assert {one["x"] % 0.19 < 1e-6 or 0.19 - one["x"] % 0.19 < 1e-6 for one in real} == {True}
    tree = hierarchy.lay_out(CoincidenceTree(small), Minigroup(small), layout, 500.0, print)
    assert tree.macros == small.minigroups and tree.buffers
    assert tree.cell_area_um2 + tree.macros * layout.width_um * layout.height_um < tree.width_um * tree.height_um
    assert 0 < tree.slack_ns < layout.slack_ns + 0.1
