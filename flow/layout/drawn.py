# SPDX-License-Identifier: Apache-2.0
"""The layout of a block in KLayout: cells and wires together; checks of connections and rules;
and a picture.
"""

from collections import defaultdict
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import klayout.db as db
import klayout.lay as lay

from .pins import Strip

DBU_UM = 0.0005
HALF_WIRE_UM, PAD_UM = 0.035, 0.07
ROW_UM, SITE_UM = 1.4, 0.19
FILLERS = ("FILLCELL_X32", "FILLCELL_X16", "FILLCELL_X8", "FILLCELL_X4", "FILLCELL_X1")
OUTLINE, TEXT_OF_CELLS = 235, 63  # layers of the cells' GDS that are not masks
ROUTED = range(2, 7)  # metals that the router uses; metal2 has the strips of the pins
# least widths of metals, and least distances
WIDTH_UM = {1: 0.065, 2: 0.07, 3: 0.07, 4: 0.14, 5: 0.14, 6: 0.14}
CUT_SPACE_UM = {1: 0.08, 2: 0.09, 3: 0.09, 4: 0.16, 5: 0.16}
# metal must reach so far beyond the cut of these vias on two opposite sides
END_UM, ENDED_VIAS = (0.035, (1, 2, 3))
COLOURS = {
    3: 0xC8B878,
    1: 0x2E8B57,
    9: 0xD04040,
    11: 0x4A6FE3,
    13: 0xD33F6A,
    15: 0x11C638,
    17: 0xEF9708,
    19: 0x8D4FD0,
    21: 0x0FCFC0,
}
PICTURE_PIXELS = 1100
REPAIRS = 4  # rounds of repairs, because a repair may cause another one
Placed = dict[str, Any]  # a placed block, as `block.record` writes it
Strips = Mapping[str, Mapping[str, Strip]]


def metal(i: int) -> int:
    """Return the GDS layer of a metal. The via above this metal is on the next layer."""
    return 9 + 2 * i


def database(um: float) -> int:
    return round(um / DBU_UM)


def box(left: float, bottom: float, right: float, top: float) -> db.Box:
    return db.Box(*map(database, (left, bottom, right, top)))


def draw(
    routed: Path,
    cells_gds: Path,
    placed: Placed,
    strips: Strips,
    widths_um: Mapping[str, float],
    top: str,
) -> db.Layout:
    """Return the layout of a block: cells with the strips of their pins, fillers, routed wires,
    and a text at each port.
    """
    layout = db.Layout()
    layout.dbu = DBU_UM
    cells = _library(layout, cells_gds, strips)
    whole = layout.create_cell(top)
    rows: dict[float, list[tuple[float, float]]] = defaultdict(list)
    for one in placed["cells"]:
        if not one["kind"].startswith("FILL"):
            _put(whole, cells[one["kind"]], one["x"], one["y"], one["flipped"])
            rows[round(one["y"], 3)].append((one["x"], widths_um[one["kind"]]))
    for number in range(round(placed["height"] / ROW_UM)):
        y = round(number * ROW_UM, 3)
        for name, x in _fillers(rows[y], placed["width"], widths_um):
            _put(whole, cells[name], x, y, number % 2 == 1)
    _wires(layout, whole, routed)
    unnamed = set(placed["ports"])
    for net, _, _, x, y in pin_places(placed, strips):
        if net in unnamed:  # the first pin of its net
            whole.shapes(layout.layer(metal(2), 0)).insert(db.Text(net, database(x), database(y)))
            unnamed.remove(net)
    whole.shapes(layout.layer(OUTLINE, 0)).insert(box(0, 0, placed["width"], placed["height"]))
    return layout


def _library(layout: db.Layout, gds: Path, strips: Strips) -> dict[str, db.Cell]:
    """Return the standard cells, flattened, with the strips of their pins."""
    source = db.Layout()
    source.read(str(gds))
    scale, cells = db.ICplxTrans(source.dbu / layout.dbu), {}
    for cell in source.each_cell():
        cells[cell.name] = copy = layout.create_cell(cell.name)
        for index in source.layer_indexes():
            info = source.get_info(index)
            if info.layer not in (OUTLINE, TEXT_OF_CELLS):
                region = db.Region(cell.begin_shapes_rec(index)).transformed(scale)
                copy.shapes(layout.layer(info.layer, info.datatype)).insert(region)
        for strip in strips.get(cell.name, {}).values():
            spans = {
                metal(1) + 1: (strip.via - HALF_WIRE_UM, strip.via + HALF_WIRE_UM),
                metal(2): (strip.low, strip.high),
            }
            if not strip.fits:
                spans[metal(1)] = strip.via - PAD_UM, strip.via + PAD_UM
            for layer, (low, high) in spans.items():
                shape = box(strip.x - HALF_WIRE_UM, low, strip.x + HALF_WIRE_UM, high)
                copy.shapes(layout.layer(layer, 0)).insert(shape)
    return cells


def _put(whole: db.Cell, cell: db.Cell, x: float, y: float, flipped: bool) -> None:
    where = (
        db.Trans(db.Trans.M0, database(x), database(y + ROW_UM))
        if flipped
        else db.Trans(database(x), database(y))
    )
    whole.insert(db.CellInstArray(cell.cell_index(), where))


def _fillers(
    row: list[tuple[float, float]], width: float, widths_um: Mapping[str, float]
) -> Iterator[tuple[str, float]]:
    """Yield (cell, x) of the fillers for the gaps of a row. row: (x, width) of its cells."""
    at = 0.0
    for x, wide in [*sorted(row), (width, 0.0)]:
        sites = round((x - at) / SITE_UM)
        for name in FILLERS:
            size = round(widths_um[name] / SITE_UM)
            while sites >= size:
                yield name, at
                at, sites = at + widths_um[name], sites - size
        at = x + wide


def _wires(layout: db.Layout, whole: db.Cell, routed: Path) -> None:
    """Copy the wires from the routed GDS, and widen metal4 to its full width at vias from
    metal3.
    """
    source = db.Layout()
    source.read(str(routed))
    top = source.cell(whole.name) or source.cell(f"{whole.name}_r") or source.top_cell()
    scale = db.ICplxTrans(source.dbu / layout.dbu)
    for index in source.layer_indexes():
        info = source.get_info(index)
        if info.datatype == 0 and metal(1) <= info.layer <= metal(10):
            for shape in top.shapes(index).each():
                if shape.is_box() or shape.is_polygon() or shape.is_path():
                    whole.shapes(layout.layer(info.layer, 0)).insert(
                        shape.polygon.transformed(scale)
                    )
    for shape in list(whole.shapes(layout.layer(metal(3) + 1, 0)).each()):
        whole.shapes(layout.layer(metal(4), 0)).insert(
            shape.bbox().enlarged(database(HALF_WIRE_UM))
        )


def pin_places(placed: Placed, strips: Strips) -> Iterator[tuple[str, str, str, float, float]]:
    """Yield (net, cell's name, pin, x, y) of every pin's via, in um."""
    for one in placed["cells"]:
        for pin, net in one["nets"].items():
            strip = strips.get(one["kind"], {}).get(pin)
            if strip:
                via = ROW_UM - strip.via if one["flipped"] else strip.via
                yield net, one["name"], pin, one["x"] + strip.x, one["y"] + via


class Wires:
    """The connected parts of a block's metal2 to metal6 and their vias, when this object is
    made.
    """

    def __init__(self, layout: db.Layout, top: str):
        whole = layout.cell(top)
        self._flat = db.Layout()
        self._flat.dbu = layout.dbu
        self._cell = self._flat.create_cell(top)
        numbers = range(metal(ROUTED[0]), metal(ROUTED[-1]) + 1)
        self._layers = {n: self._flat.layer(n, 0) for n in numbers}
        for n, layer in self._layers.items():
            self._cell.shapes(layer).insert(
                db.Region(whole.begin_shapes_rec(layout.layer(n, 0))).merged()
            )
        self._nets = db.LayoutToNetlist(db.RecursiveShapeIterator(self._flat, self._cell, []))
        self._regions = {
            n: self._nets.make_layer(layer, f"layer{n}") for n, layer in self._layers.items()
        }
        for n, region in self._regions.items():
            self._nets.connect(region)
            if n % 2 == 0:
                self._nets.connect(region, self._regions[n - 1])
                self._nets.connect(region, self._regions[n + 1])
        self._nets.extract_netlist()

    def part(self, layer: int, x: float, y: float) -> int | None:
        """Return the number of the connected part with metal at a place, or None."""
        at = db.Point(round(x), round(y))
        if self._cell.begin_shapes_rec_overlapping(
            self._layers[layer], db.Box(at, at).enlarged(1)
        ).at_end():
            return None
        found = self._nets.probe_net(self._regions[layer], at)
        return found.cluster_id if found else None

    def beside(self, layer: int, edge: db.Edge) -> int | None:
        """Return the connected part beside an edge, or None."""
        x, y = (edge.x1 + edge.x2) / 2, (edge.y1 + edge.y2) / 2
        for step in (-4, 4):
            for dx, dy in ((step, 0), (0, step), (step, step)):
                found = self.part(layer, x + dx, y + dy)
                if found is not None:
                    return found
        return None


def connect(
    layout: db.Layout, top: str, placed: Placed, strips: Strips
) -> tuple[int, list[str], list[list[str]], list[str]]:
    """Repair vias that are too close and gaps that are too narrow, and compare the wires with
    the netlist.

    Returns the number of nets; the nets in several parts; the nets that share a part; and the
    nets of pins without metal.
    """
    for _ in range(REPAIRS):
        gone = _thin_cuts(layout, top, Wires(layout, top))
        if not gone + _close_gaps(layout, top, Wires(layout, top)):
            break
    wires = Wires(layout, top)
    parts: dict[str, set[int]] = defaultdict(set)
    nets: dict[int, set[str]] = defaultdict(set)
    off = []
    for net, _, _, x, y in pin_places(placed, strips):
        found = wires.part(metal(2), database(x), database(y))
        if found is None:
            off.append(net)
        else:
            parts[net].add(found)
            nets[found].add(net)
    opens = sorted(net for net, found in parts.items() if len(found) > 1)
    shorts = sorted(sorted(found) for found in nets.values() if len(found) > 1)
    return len(parts), opens, shorts, off


def _close_gaps(layout: db.Layout, top: str, wires: Wires) -> int:
    """Fill gaps within a net that are narrower than the rule; return their number."""
    closed = 0
    for i in ROUTED[1:]:
        drawn = db.Region(layout.cell(top).begin_shapes_rec(layout.layer(metal(i), 0)))
        for edges in drawn.space_check(database(WIDTH_UM[i])).each():
            ends = [wires.beside(metal(i), edge) for edge in (edges.first, edges.second)]
            if ends[0] is not None and ends[0] == ends[1]:
                layout.cell(top).shapes(layout.layer(metal(i), 0)).insert(edges.polygon(0))
                closed += 1
    return closed


def _thin_cuts(layout: db.Layout, top: str, wires: Wires) -> int:
    """Replace one of two vias of a net that are too close by metal to the other; return the
    number of replaced vias.
    """
    gone = 0
    for i in ROUTED[:-1]:
        shapes = layout.cell(top).shapes(layout.layer(metal(i) + 1, 0))
        for edges in db.Region(shapes).space_check(database(CUT_SPACE_UM[i])).each():
            ends = [edges.first.bbox().center(), edges.second.bbox().center()]
            near = [
                [shape for shape in shapes.each() if shape.bbox().enlarged(1).contains(end)]
                for end in ends
            ]
            if not all(near):
                continue  # one via was just replaced
            boxes = [found[0].bbox() for found in near]
            nets = {wires.part(metal(i) + 1, one.center().x, one.center().y) for one in boxes}
            if len(nets) == 1 and None not in nets:
                for level in (i, i + 1):
                    layout.cell(top).shapes(layout.layer(metal(level), 0)).insert(
                        boxes[0] + boxes[1]
                    )
                for shape in near[1]:
                    shapes.erase(shape)
                gone += 1
    return gone


def check_rules(layout: db.Layout, top: str) -> list[tuple[str, int]]:
    """Return (rule, violations) for widths and distances of metal1 to metal6 and of their vias,
    and for metal around vias.
    """
    whole = layout.cell(top)

    def region(layer: int) -> db.Region:
        return db.Region(whole.begin_shapes_rec(layout.layer(layer, 0))).merged()

    found = []
    for i in WIDTH_UM:
        wires = region(metal(i))
        found.append((f"metal{i}: width", wires.width_check(database(WIDTH_UM[i])).count()))
        found.append((f"metal{i}: distance", wires.space_check(database(WIDTH_UM[i])).count()))
    for i in CUT_SPACE_UM:
        cuts, below, above = region(metal(i) + 1), region(metal(i)), region(metal(i + 1))
        found.append((f"via{i}: distance", cuts.space_check(database(CUT_SPACE_UM[i])).count()))
        found.append(
            (f"via{i}: covered by both metals", (cuts - below).count() + (cuts - above).count())
        )
        if i in ENDED_VIAS:
            found.append(
                (
                    f"via{i}: metal beyond it on two sides",
                    sum(_ends(cuts, wires) for wires in (below, above)),
                )
            )
    return found


def _ends(cuts: db.Region, wires: db.Region) -> int:
    """Return the number of cuts with too little metal both horizontally and vertically."""
    covered: set[tuple[int, int]] = set()
    for dx, dy in ((database(END_UM), 0), (0, database(END_UM))):
        grown = db.Region([polygon.bbox().enlarged(dx, dy) for polygon in cuts.each()])
        grown.merged_semantics = False
        covered |= {(p.bbox().center().x, p.bbox().center().y) for p in grown.inside(wires).each()}
    return sum((p.bbox().center().x, p.bbox().center().y) not in covered for p in cuts.each())


def draw_picture(gds: Path, png: Path) -> None:
    """Draw the block from above: wells, gates and metals."""
    view = lay.LayoutView()
    view.load_layout(str(gds), True)
    view.max_hier()
    for name, value in (
        ("background-color", "#ffffff"),
        ("grid-visible", "false"),
        ("text-visible", "false"),
    ):
        view.set_config(name, value)
    layers = view.begin_layers()
    while not layers.at_end():
        layer = layers.current()
        colour = COLOURS.get(layer.source_layer)
        layer.visible = colour is not None
        if colour is not None:
            layer.fill_color = layer.frame_color = colour
            layer.dither_pattern = (
                5 if layer.source_layer < metal(1) else 9 if layer.source_layer % 4 == 1 else 4
            )
            layer.width, layer.transparent = 1, True
        layers.next()
    view.zoom_fit()
    view.save_image(str(png), PICTURE_PIXELS, PICTURE_PIXELS)
