# SPDX-License-Identifier: Apache-2.0
"""Layout: wires of a DEF file, pins that a router reaches, what the checks find, and a small block
from Verilog to a checked GDS.
"""

import itertools
import json
import re

import numpy as np
import pytest
from matplotlib.image import imread

from coincid.flow.yosys import LIBERTY, cells_folder

from ..needs import imported

pytestmark = pytest.mark.needs("layout")
db = imported("layout", "klayout.db")
delays = imported("layout", "coincid.flow.layout.delays")
drawn = imported("layout", "coincid.flow.layout.drawn")
pins = imported("layout", "coincid.flow.layout.pins")
wires = imported("layout", "coincid.flow.layout.wires")

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
  SIZE 0.57 BY 1.4 ;
  PIN A
    PORT
      LAYER metal1 ;
        RECT 0.05 0.3 0.2 0.9 ;
    END
  END A
  PIN Z
    PORT
      LAYER metal1 ;
        RECT 0.4 0.3 0.54 0.9 ;
    END
  END Z
  PIN VDD
    PORT
      LAYER metal1 ;
        RECT 0 1.3 0.6 1.5 ;
    END
  END VDD
END TWO
"""


def test_lengths_of_wires(tmp_path):
    path = tmp_path / "routed.def"
    path.write_text(DEF, encoding="utf-8")
    lengths = {net: dict(on) for net, on in wires.lengths_um(path).items()}
    assert lengths == {"clk": {6: 2.0}, "a": {}, "b": {4: 0.7, 3: 1.0}}


@pytest.mark.parametrize("lacking", ["UNITS", "NETS"])
def test_a_file_of_wires_without_units_or_nets_is_told_by_its_name(tmp_path, lacking):
    path = tmp_path / "routed.def"
    path.write_text(DEF.replace(lacking, "OTHER"), encoding="utf-8")
    with pytest.raises(ValueError, match="^routed.def: no units, or no nets$"):
        wires.lengths_um(path)


def test_a_pin_that_no_track_crosses_is_told_with_its_place(tmp_path):
    with pytest.raises(ValueError, match=r"^no track crosses the pin at \(280,600;480,1800\)$"):
        strips_of(tmp_path, A="0.14 0.3 0.24 0.9")


def test_strips_stand_on_their_pins(tmp_path):
    path = tmp_path / "two.lef"
    path.write_text(LEF, encoding="utf-8")
    found = pins.strips(path, {"TWO"})["TWO"]
    assert {pin: (strip.x, strip.fits) for pin, strip in found.items()} == {
        "A": (0.095, True),
        "Z": (0.475, True),
    }
    assert all(
        0.3 < strip.via < 0.9 and strip.low < strip.via < strip.high for strip in found.values()
    )


def test_strips_are_of_the_cells_that_were_asked_for(tmp_path):
    """In the order of their names. A cell without pins has none, and the others need no place."""
    path = tmp_path / "four.lef"
    nothing = "MACRO NONE\n  SIZE 0.19 BY 1.4 ;\nEND NONE\n"
    thin = LEF[: LEF.index("  PIN Z")].replace("0.05 0.3 0.2 0.9", "0.1 0.3 0.101 0.9")
    others = [LEF.replace("TWO", "BUF"), thin.replace("TWO", "THIN") + "END THIN\n"]
    path.write_text("".join([nothing, LEF, *others]), encoding="utf-8")
    found = pins.strips(path, {"TWO", "NONE", "BUF"})
    assert {cell: list(strips) for cell, strips in found.items()} == {
        "BUF": ["A", "Z"],
        "TWO": ["A", "Z"],
    }
    assert list(found) == ["BUF", "TWO"]


def test_widths_are_those_of_all_cells_of_a_file(tmp_path):
    """Not their heights, and whether or not a cell has pins."""
    path = tmp_path / "three.lef"
    fill = "MACRO FILL\n  CLASS CORE SPACER ;\n  SIZE 0.19 BY 1.4 ;\nEND FILL\n"
    path.write_text(fill + LEF + LEF.replace("TWO", "X4").replace("0.57", "1.33"), encoding="utf-8")
    assert pins.cell_widths_um(path) == {"FILL": 0.19, "TWO": 0.57, "X4": 1.33}


@pytest.mark.parametrize("low", [400, 405, 410])
def test_a_via_fits_metal_that_is_just_as_high(low):
    """At the only height, if that is one that is tried."""
    x = pins.FIRST_TRACK
    metal = db.Region(db.Box(x - pins.PAD_HALF, low, x + pins.PAD_HALF, low + 2 * pins.HALF))
    (place, *_) = pins._places(metal)
    middle = low + pins.HALF
    assert (place.x, place.fits) == (x, middle % pins.STEP == 0)
    assert place.y == middle // pins.STEP * pins.STEP


def test_outputs_are_those_of_the_library():
    text = (cells_folder() / LIBERTY).read_text(encoding="utf-8")
    _, *parts = re.split(r"^\s*cell \((\w+)\) \{", text, flags=re.MULTILINE)
    pin = re.compile(r"^\s*pin ?\((\w+)\) ?\{.*?^\s*direction\s*:\s*\"?(\w+)", re.M | re.S)
    told = {
        (kind, name): way == "output"
        for kind, cell in zip(parts[::2], parts[1::2], strict=True)
        for name, way in pin.findall(cell)
    }
    assert len(told) > 100
    assert {(kind, name): wires.is_output(kind, name) for kind, name in told} == told


def test_a_pin_is_all_of_its_shapes(tmp_path):
    """Its strip stands on the longest of them, wherever that is in the file."""
    path = tmp_path / "two.lef"
    first = "RECT 0.05 0.3 0.2 0.9 ;"
    others = "RECT 0.05 0.3 0.5 0.37 ;\n    END\n    PORT\n      LAYER metal1 ;\n        RECT 0.4 0.3 0.54 0.5 ;"
    text = LEF.replace(first, f"{first}\n        {others}", 1)
    path.write_text(text[: text.index("  PIN Z")] + "END TWO\n", encoding="utf-8")
    strip = pins.strips(path, {"TWO"})["TWO"]["A"]
    assert (strip.x, strip.via, strip.fits) == (0.095, 0.6, True)


def strips_of(tmp_path, **rectangles):
    """Return the strips of a cell with these pins, a rectangle of metal each."""
    path = tmp_path / "own.lef"
    ports = [
        f"  PIN {pin}\n    PORT\n      LAYER metal1 ;\n        RECT {corners} ;\n    END\n  END {pin}\n"
        for pin, corners in rectangles.items()
    ]
    path.write_text(f"MACRO OWN\n  SIZE 0.57 BY 1.4 ;\n{''.join(ports)}END OWN\n", encoding="utf-8")
    return pins.strips(path, {"OWN"})["OWN"]


def test_pins_that_can_take_tracks_of_their_own_do_so(tmp_path):
    """Also where the best place of each is on the same track; and not side by side if there is a
    third track.
    """
    for right, tracks_um in ((0.4, [0.095, 0.285]), (0.55, [0.095, 0.475])):
        wide = strips_of(tmp_path, A=f"0.02 0.3 {right} 0.5", Z=f"0.02 0.7 {right} 0.9")
        assert sorted(strip.x for strip in wide.values()) == pytest.approx(tracks_um)
        assert len({(strip.low, strip.high) for strip in wide.values()}) == 1


@pytest.mark.parametrize("order", ["AZ", "ZA"])
def test_strips_of_pins_on_one_track_do_not_touch(tmp_path, order):
    """The lower pin's strip ends below that of the upper one, whatever their order in the file."""
    places = {"A": "0.05 0.25 0.15 0.5", "Z": "0.05 0.8 0.15 1.1"}
    found = strips_of(tmp_path, **{pin: places[pin] for pin in order})
    assert found["A"].x == found["Z"].x == pytest.approx(0.095)
    assert found["A"].low < found["A"].via < found["A"].high
    assert found["A"].high + 0.07 <= found["Z"].low < found["Z"].via < found["Z"].high


def test_a_pin_takes_the_place_that_is_far_enough_from_another_on_its_track(tmp_path):
    """Though the other place is longer; their strips would touch there."""
    near, far = "0.05 0.5 0.15 0.72", "0.05 0.2 0.15 0.4"
    found = strips_of(tmp_path, A=f"{near} ; RECT {far}", Z="0.05 0.74 0.15 0.9")
    assert (found["A"].via, found["Z"].via) == pytest.approx((0.3, 0.82))
    assert found["A"].high + 0.07 <= found["Z"].low


def test_a_via_that_its_metal_encloses_is_worth_a_neighbour(tmp_path):
    """Rather than one on a track further away, where the metal is too short."""
    short = "0.43 0.3 0.52 0.4"
    found = strips_of(tmp_path, A="0.05 0.3 0.14 0.9", Z=f"0.24 0.3 0.33 0.9 ; RECT {short}")
    assert {pin: (strip.x, strip.fits) for pin, strip in found.items()} == {
        "A": (0.095, True),
        "Z": (0.285, True),
    }


def test_delays_scale():
    assert delays.scaled("(IOPATH A ZN (0.010:0.010:0.010) (0.020:0.020:0.020))", 3) == (
        "(IOPATH A ZN (0.0300:0.0300:0.0300) (0.0600:0.0600:0.0600))"
    )


def two_cells(shapes):
    """A layout of two pins at (0.1, 0.5) and (1.1, 0.5) of nets a and `net`, with shapes (layer,
    box in um).
    """
    layout = db.Layout()
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


SITE_UM, ROW_UM = 0.19, 1.4
FILLER_SITES = {1: 1, 4: 4, 8: 8, 16: 16, 32: 32}  # the number in its name -> its sites
LIBRARY_SITES = {f"FILLCELL_X{k}": sites for k, sites in FILLER_SITES.items()} | {"C": 3}
ROW_SITES = 71


def written(path, **cells):
    """Write a GDS file of cells, each with its metal1 (boxes in um); return its path. Its unit is
    not that of a drawn layout.
    """
    layout = db.Layout()
    layout.dbu = 2 * drawn.DBU_UM
    metal1 = layout.layer(drawn.metal(1), 0)
    for name, boxes in cells.items():
        shapes = layout.create_cell(name).shapes(metal1)
        for corners in boxes:
            shapes.insert(db.DBox(*corners))
    layout.write(str(path))
    return path


@pytest.fixture
def drawn_rows(tmp_path):
    """Return a function: sites of the cells of each row -> layout of these rows."""
    library = {name: [(0, 0, sites * SITE_UM, 0.1)] for name, sites in LIBRARY_SITES.items()}
    gds = written(tmp_path / "cells.gds", **library)
    routed = written(tmp_path / "routed.gds", top=[])
    widths_um = {name: sites * SITE_UM for name, sites in LIBRARY_SITES.items()}

    def draw(rows):
        cells = [
            {"name": "u", "kind": "C", "x": site * SITE_UM, "y": number * ROW_UM}
            | {"flipped": number % 2 == 1, "nets": {}}
            for number, sites in enumerate(rows)
            for site in sites
        ]
        placed = {"width": ROW_SITES * SITE_UM, "height": len(rows) * ROW_UM}
        placed |= {"cells": cells, "ports": {}}
        return drawn.draw(routed, gds, placed, {}, widths_um, "top")

    return draw


def row_of(layout, number):
    """Return the (kind, first site, turned upside down) of the cells of a row, from the left."""
    found = []
    for one in layout.cell("top").each_inst():
        box_um = one.bbox().to_dtype(layout.dbu)
        flipped = one.trans.is_mirror()
        base_um = box_um.top - ROW_UM if flipped else box_um.bottom
        if round(base_um / ROW_UM) == number:
            found.append((one.cell.name, round(box_um.left / SITE_UM), flipped))
    return sorted(found, key=lambda cell: cell[1])


@pytest.mark.parametrize(
    "sites",
    [[], [0], [ROW_SITES - 3], [5, 8, 12], [40, 1], [33, 20, 68]],
    ids=["empty", "at_the_left", "at_the_right", "touching", "in_any_order", "at_both_sides"],
)
def test_fillers_close_a_row_from_its_left_end_to_its_right_one(drawn_rows, sites):
    """Without a gap and without an overlap, each gap with the widest fillers first; an odd row has
    all of its cells upside down.
    """
    layout = drawn_rows([[10], sites])
    row = row_of(layout, 1)
    at = 0
    for kind, site, flipped in row:
        assert (site, flipped) == (at, True)
        at += LIBRARY_SITES[kind]
    assert at == ROW_SITES
    assert [site for kind, site, _ in row if kind == "C"] == sorted(sites)
    for (kind, _, _), (behind, _, _) in itertools.pairwise(row):
        if "C" not in (kind, behind):
            assert LIBRARY_SITES[kind] >= LIBRARY_SITES[behind]
    assert [kind for kind, _, _ in row_of(layout, 0)] == [
        "FILLCELL_X8",
        "FILLCELL_X1",
        "FILLCELL_X1",
        "C",
        "FILLCELL_X32",
        "FILLCELL_X16",
        "FILLCELL_X8",
        "FILLCELL_X1",
        "FILLCELL_X1",
    ]


def boxes_um(layout, cell, layer):
    """Return the boxes on a layer of a cell, without those of the cells in it, in um."""
    shapes = layout.cell(cell).shapes(layout.layer(layer, 0))
    found = []
    for shape in shapes.each():
        if not shape.is_text():
            box_um = shape.bbox().to_dtype(layout.dbu)
            sides = box_um.left, box_um.bottom, box_um.right, box_um.top
            found.append(tuple(round(side, 4) for side in sides))
    return sorted(found)


def texts_of(layout, cell, layer):
    shapes = layout.cell(cell).shapes(layout.layer(layer, 0))
    return {
        shape.text_string: (
            round(shape.text.x * layout.dbu, 4),
            round(shape.text.y * layout.dbu, 4),
        )
        for shape in shapes.each()
        if shape.is_text()
    }


@pytest.fixture
def one_block(tmp_path):
    """Return the layout of a block of two cells with two pins each, of which the second one is
    upside down; and its wires.
    """
    library = written(tmp_path / "cells.gds", C=[(0, 0, 0.57, 0.1)], FILLCELL_X1=[])
    source = db.Layout()
    source.read(str(library))
    for layer in (drawn.OUTLINE, drawn.TEXT_OF_CELLS):
        source.cell("C").shapes(source.layer(layer, 0)).insert(db.DBox(0, 0, 0.57, 1.4))
    source.write(str(library))
    wires_of = db.Layout()
    wires_of.dbu = 0.001
    shapes = {15: (0.5, 0.2, 1.5, 0.27), 16: (0.5, 0.2, 0.57, 0.27)}
    top = wires_of.create_cell("top")
    path = db.DPath([db.DPoint(0.535, 0), db.DPoint(0.535, 1.4)], 0.07)
    top.shapes(wires_of.layer(17, 0)).insert(path)
    for layer, corners in (*shapes.items(), (9, (0, 0, 5, 5)), (31, (0, 0, 5, 5))):
        top.shapes(wires_of.layer(layer, 0)).insert(db.DBox(*corners))
    top.shapes(wires_of.layer(15, 1)).insert(db.DBox(0, 0, 5, 5))
    wires_of.write(str(tmp_path / "routed.gds"))
    strips = {
        "C": {
            "A": pins.Strip(0.095, 0.14, 1.26, 0.5, True),
            "Z": pins.Strip(0.475, 0.2, 1.2, 0.9, False),
        }
    }
    cells = [
        {"name": "u1", "kind": "C", "x": 0.19, "y": 0.0, "flipped": False}
        | {"nets": {"A": "a", "Z": "n"}},
        {"name": "u2", "kind": "C", "x": 0.38, "y": 1.4, "flipped": True}
        | {"nets": {"A": "n", "Z": "y"}},
    ]
    ports = {"n": "output", "a": "input", "y": "output"}
    placed = {"width": 0.95, "height": 2.8, "cells": cells, "ports": ports}
    widths_um = dict.fromkeys(drawn.FILLERS, 9.0) | {"FILLCELL_X1": 0.19, "C": 0.57}
    return drawn.draw(tmp_path / "routed.gds", library, placed, strips, widths_um, "top")


def test_a_cell_is_drawn_with_a_via_and_a_strip_for_each_pin(one_block):
    """Also with metal1, where that of the pin does not enclose the via. Outlines and texts are no
    masks.
    """
    metal1, via1, metal2 = drawn.metal(1), drawn.metal(1) + 1, drawn.metal(2)
    assert boxes_um(one_block, "C", via1) == [
        (0.06, 0.465, 0.13, 0.535),
        (0.44, 0.865, 0.51, 0.935),
    ]
    assert boxes_um(one_block, "C", metal2) == [(0.06, 0.14, 0.13, 1.26), (0.44, 0.2, 0.51, 1.2)]
    assert boxes_um(one_block, "C", metal1) == [(0, 0, 0.57, 0.1), (0.44, 0.83, 0.51, 0.97)]
    for layer in (drawn.OUTLINE, drawn.TEXT_OF_CELLS):
        assert boxes_um(one_block, "C", layer) == []
    assert boxes_um(one_block, "top", drawn.OUTLINE) == [(0, 0, 0.95, 2.8)]


def test_each_port_is_named_once_at_the_first_pin_of_its_net(one_block):
    """At the via of the pin, also in a cell that is upside down."""
    assert texts_of(one_block, "top", drawn.metal(2)) == {
        "a": (0.285, 0.5),
        "n": (0.665, 0.9),
        "y": (0.855, 1.9),
    }


def test_routed_wires_are_drawn_and_metal4_is_wide_at_vias_from_metal3(one_block):
    """Of masks of metals and vias only, whether they are boxes or paths."""
    via, wide = (0.5, 0.2, 0.57, 0.27), (0.465, 0.165, 0.605, 0.305)
    assert boxes_um(one_block, "top", drawn.metal(3)) == [(0.5, 0.2, 1.5, 0.27)]
    assert boxes_um(one_block, "top", drawn.metal(3) + 1) == [via]
    assert boxes_um(one_block, "top", drawn.metal(4)) == sorted([wide, (0.5, 0, 0.57, 1.4)])
    for layer in (9, 31):
        assert boxes_um(one_block, "top", layer) == []


PINS = [(13, (0.065, 0.3, 0.135, 0.7)), (13, (1.065, 0.3, 1.135, 0.7))]
VIAS = [(14, (0.065, 0.465, 0.135, 0.535)), (14, (1.065, 0.465, 1.135, 0.535))]
WIRE = [(15, (0.03, 0.465, 1.17, 0.535))]


def found_in(shapes, other_net="a"):
    """The layout with these shapes after repairs, and what `connect` finds."""
    layout, placed, strips = two_cells(shapes)
    placed["cells"][1]["nets"]["P"] = other_net
    return layout, drawn.connect(layout, "top", placed, strips)


def broken_rules(layout):
    return {rule for rule, found in drawn.check_rules(layout, "top") if found}


def test_opens_and_shorts_are_found():
    for shapes, other_net, expected in (
        (PINS + VIAS + WIRE, "a", ([], [], [])),
        (PINS + VIAS[:1] + WIRE, "a", (["a"], [], [])),
        (PINS[:1] + VIAS + WIRE, "a", ([], [], ["a"])),
        (PINS + VIAS + WIRE, "b", ([], [["a", "b"]], [])),
    ):
        _, found = found_in(shapes, other_net)
        assert found[1:] == expected


def test_rules_are_checked():
    layout, _, _ = two_cells(PINS + VIAS + WIRE)
    assert not broken_rules(layout)
    layout, _, _ = two_cells(
        PINS + VIAS + [(15, (0.065, 0.465, 1.17, 0.505)), (15, (0.5, 0.55, 0.6, 0.62))]
    )
    assert broken_rules(layout) == {
        "metal3: width",
        "metal3: distance",
        "via2: covered by both metals",
        "via2: metal beyond it on two sides",
    }


LEAST_UM = {1: 0.065, 2: 0.07, 3: 0.07, 4: 0.14, 5: 0.14, 6: 0.14}  # of a metal, and between two
CUTS_UM = {1: 0.08, 2: 0.09, 3: 0.09, 4: 0.16, 5: 0.16}  # between two cuts
STEP_UM, CUT_UM, PLATE_UM = 0.005, 0.14, (-1.0, -1.0, 2.0, 2.0)


def rules_broken_by(*shapes):
    return broken_rules(two_cells(shapes)[0])


@pytest.mark.parametrize("i", LEAST_UM)
def test_a_metal_that_is_just_wide_and_far_enough_breaks_no_rule(i):
    """Less of either is told, of this metal only."""
    for length_um, broken in ((LEAST_UM[i], False), (LEAST_UM[i] - STEP_UM, True)):
        wire = (drawn.metal(i), (0.0, 0.0, 1.0, length_um))
        assert rules_broken_by(wire) == ({f"metal{i}: width"} if broken else set())
        apart = [(drawn.metal(i), (x, 0.0, x + 1.0, 1.0)) for x in (0.0, 1.0 + length_um)]
        assert rules_broken_by(*apart) == ({f"metal{i}: distance"} if broken else set())


@pytest.mark.parametrize("i", CUTS_UM)
def test_cuts_that_are_just_far_enough_and_covered_break_no_rule(i):
    """Less is told, of this via only, whichever of its metals is missing or too short: on no two
    opposite sides does it reach far enough.
    """
    below, via, above = drawn.metal(i), drawn.metal(i) + 1, drawn.metal(i + 1)
    plates = [(below, PLATE_UM), (above, PLATE_UM)]
    cut = (via, (0.0, 0.0, CUT_UM, CUT_UM))
    for gap_um, broken in ((CUTS_UM[i], False), (CUTS_UM[i] - STEP_UM, True)):
        left_um = CUT_UM + gap_um
        other = (via, (left_um, 0.0, left_um + CUT_UM, CUT_UM))
        found = rules_broken_by(*plates, cut, other)
        assert found == ({f"via{i}: distance"} if broken else set())
    ends = {f"via{i}: metal beyond it on two sides"} if i < 4 else set()
    for plate in plates:
        assert rules_broken_by(plate, cut) == {f"via{i}: covered by both metals"} | ends
        other = below + above - plate[0]
        for (left, bottom, right, top), broken in (
            ((0.035, 0.0, 0.035, 0.0), False),
            ((0.0, 0.035, 0.0, 0.035), False),
            ((0.03, 0.03, 0.035, 0.035), True),
            ((0.035, 0.0, 0.03, 0.0), True),
        ):
            short = (other, (-left, -bottom, CUT_UM + right, CUT_UM + top))
            assert rules_broken_by(plate, cut, short) == (ends if broken else set())


def test_a_cut_too_near_its_neighbour_goes():
    near = [(14, (0.065, 0.565, 0.135, 0.635)), (15, (0.03, 0.565, 1.17, 0.635))]
    assert "via2: distance" in broken_rules(two_cells(PINS + VIAS + WIRE + near)[0])
    layout, found = found_in(PINS + VIAS + WIRE + near)
    assert found[1:] == ([], [], []) and not broken_rules(layout)


ROUTED_METALS = (3, 4, 5, 6)
SLOT_SIDES_UM = ((0.0, 0.0, 2.0, 1.0), (0.0, 1.0, 2.0, 2.0))  # without the slot between them
JOINT_UM = (0.0, 0.5, 0.5, 1.5)


def slotted(i, slot_um, joined, turned):
    """A layout of two plates of metal `i` with a slot between them; `joined`: one net."""
    layout, _, _ = two_cells([])
    low, high = SLOT_SIDES_UM
    corners = [low, (high[0], high[1] + slot_um, high[2], high[3] + slot_um)]
    if joined:
        corners.append(JOINT_UM)
    for left, bottom, right, top in corners:
        place = (bottom, left, top, right) if turned else (left, bottom, right, top)
        layout.cell("top").shapes(layout.layer(drawn.metal(i), 0)).insert(drawn.box(*place))
    return layout


def metal_um2(layout, i):
    drawn_on = layout.cell("top").begin_shapes_rec(layout.layer(drawn.metal(i), 0))
    return db.Region(drawn_on).merged().area() * layout.dbu**2


@pytest.mark.parametrize("turned", [False, True], ids=["horizontal", "vertical"])
@pytest.mark.parametrize("i", ROUTED_METALS)
def test_a_slot_of_a_net_is_filled_where_it_is_too_narrow(i, turned):
    """On every metal of the router, and nothing else is drawn; nets that are apart stay so."""
    rule_um = {3: 0.07, 4: 0.14, 5: 0.14, 6: 0.14}[i]
    nothing = {"cells": [], "ports": {}}
    for slot_um, joined, filled in (
        (rule_um - 0.02, True, True),
        (rule_um, True, False),
        (rule_um - 0.02, False, False),
    ):
        layout = slotted(i, slot_um, joined, turned)
        before_um2 = metal_um2(layout, i)
        too_narrow = slot_um < rule_um
        assert broken_rules(layout) == ({f"metal{i}: distance"} if too_narrow else set())
        again = slotted(i, slot_um, joined, turned)
        assert drawn._close_gaps(again, "top", drawn.Wires(again, "top")) == filled
        assert drawn.connect(layout, "top", nothing, {}) == (0, [], [], [])
        assert (f"metal{i}: distance" in broken_rules(layout)) is (too_narrow and not filled)
        added_um2 = metal_um2(layout, i) - before_um2
        assert added_um2 == pytest.approx(1.5 * slot_um if filled else 0, abs=1e-9)
        others = [k for k in ROUTED_METALS if k != i]
        assert not any(metal_um2(layout, k) for k in others)


@pytest.mark.parametrize("i", [2, 3, 4, 5])
def test_of_two_cuts_of_a_net_that_are_too_near_one_stays(i):
    """Between any two metals of the router; those that are far enough, or of two nets, both stay."""
    space_um = {2: 0.09, 3: 0.09, 4: 0.16, 5: 0.16}[i]
    side_um = 0.14
    for gap_um, one_net, left in (
        (space_um - 0.02, True, 1),
        (space_um, True, 2),
        (space_um - 0.02, False, 2),
    ):
        layout, _, _ = two_cells([])
        cuts = [(k * (side_um + gap_um), 0.0) for k in (0, 1)]
        for x, y in cuts:
            square = drawn.box(x, y, x + side_um, y + side_um)
            for layer in (drawn.metal(i), drawn.metal(i) + 1, drawn.metal(i + 1)):
                layout.cell("top").shapes(layout.layer(layer, 0)).insert(square)
        if one_net:
            wire = drawn.box(0, 0, 2 * side_um + gap_um, side_um)
            layout.cell("top").shapes(layout.layer(drawn.metal(i), 0)).insert(wire)
        drawn.connect(layout, "top", {"cells": [], "ports": {}}, {})
        kept = layout.cell("top").begin_shapes_rec(layout.layer(drawn.metal(i) + 1, 0))
        assert db.Region(kept).merged().count() == left, (gap_um, one_net)


@pytest.mark.parametrize(
    ("cuts", "gaps", "rounds"),
    [([0], [0], 1), ([2, 0], [0, 0], 2), ([0, 0, 0], [1, 3, 0], 3), ([1] * 9, [0] * 9, 4)],
)
def test_repairs_go_on_while_something_is_repaired(monkeypatch, cuts, gaps, rounds):
    """A repair may cause another one, but not for ever."""
    left = {"_thin_cuts": list(cuts), "_close_gaps": list(gaps)}
    for name, counts in left.items():
        monkeypatch.setattr(drawn, name, lambda *_, counts=counts: counts.pop(0))
    layout, _, _ = two_cells([])
    drawn.connect(layout, "top", {"cells": [], "ports": {}}, {})
    assert [len(counts) for counts in left.values()] == [len(cuts) - rounds, len(gaps) - rounds]


def test_the_picture_shows_the_whole_block_in_the_colours_of_its_metals(monkeypatch, tmp_path):
    """From corner to corner, without its outline; what has no colour is not there."""
    layout = db.Layout()
    layout.dbu = drawn.DBU_UM
    top = layout.create_cell("top")
    shown = {drawn.metal(3): (0, 0, 20, 20), drawn.metal(6): (80, 80, 100, 100)}
    hidden = {drawn.OUTLINE: (0, 0, 100, 100), drawn.metal(7): (0, 80, 20, 100)}
    for layer, corners in (shown | hidden).items():
        top.shapes(layout.layer(layer, 0)).insert(drawn.box(*corners))
    gds, png = tmp_path / "block.gds", tmp_path / "block.png"
    layout.write(str(gds))
    monkeypatch.setattr(drawn, "PICTURE_PIXELS", 200)
    drawn.draw_picture(gds, png)
    pixels = imread(png)
    height, width = pixels.shape[:2]
    assert (height, width) == (200, 200)
    rgb = np.rint(255 * pixels[:, :, :3]).astype(int) @ [1 << 16, 1 << 8, 1]
    below, right = np.mgrid[:height, :width] > 100
    for layer, corner in ((drawn.metal(3), below & ~right), (drawn.metal(6), ~below & right)):
        of_layer = rgb == drawn.COLOURS[layer]
        assert of_layer.any() and not (of_layer & ~corner).any()
    assert (rgb[~below & ~right] == 0xFFFFFF).all()


def test_the_pattern_of_a_picture_tells_wells_and_gates_from_metals_along_rows_and_columns(
    monkeypatch, tmp_path
):
    """Layers whose wires cross or cover each other have different patterns."""
    layout = db.Layout()
    layout.dbu = drawn.DBU_UM
    top = layout.create_cell("top")
    layers = (3, 9, *map(drawn.metal, range(1, 5)))
    for k, layer in enumerate(layers):
        top.shapes(layout.layer(layer, 0)).insert(
            drawn.box(40 * k, 40 * k, 40 * k + 32, 40 * k + 32)
        )
    gds, png = tmp_path / "block.gds", tmp_path / "block.png"
    layout.write(str(gds))
    monkeypatch.setattr(drawn, "PICTURE_PIXELS", 480)
    drawn.draw_picture(gds, png)
    rgb = np.rint(255 * imread(png)[:, :, :3]).astype(int) @ [1 << 16, 1 << 8, 1]
    patterns = []
    for layer in layers:
        down, right = np.nonzero(rgb == drawn.COLOURS[layer])
        filled = rgb[down.min() : down.max(), right.min() : right.max()] == drawn.COLOURS[layer]
        density = round(10 * filled[9:-9, 9:-9].mean())
        falling = (filled[:-1, :-1] & filled[1:, 1:]).sum()
        rising = (filled[:-1, 1:] & filled[1:, :-1]).sum()
        patterns.append((density, bool(falling > rising)))
    wells, gates, *metals = patterns
    assert wells == gates
    assert metals[:2] == metals[2:]
    assert len({wells, *metals}) == 3


@pytest.mark.needs("cells")
def test_a_small_minigroup_is_routed():
    from coincid.flow.layout.flow import PLACED, lay_out
    from coincid.hdl.minigroup import Minigroup
    from coincid.model.contract.parameters import Sensor

    small = Sensor(
        rows=4, cols=4, subgroup=(4, 4), minigroup=(1, 2), phases=4, window_max=8, fifo_depth=1
    )
    folder, layout = lay_out(Minigroup(small), 500.0, print)
    assert not any(found for _, found in layout["rules"])
    assert layout["cell_area_um2"] < layout["width_um"] * layout["height_um"]
    assert layout["slack_ns"] < 2.0
    placed = json.loads((folder / PLACED).read_text(encoding="utf-8"))
    real = [one for one in placed["cells"] if not one["kind"].startswith("FILL")]
    assert len(real) == layout["cells"]
    assert {one["x"] % 0.19 < 1e-6 or 0.19 - one["x"] % 0.19 < 1e-6 for one in real} == {True}
