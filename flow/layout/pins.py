# SPDX-License-Identifier: Apache-2.0
"""Access to the pins of the standard cells: a via on the metal1 of the pin, and a vertical strip
of metal2 on a track above it.

The router cannot connect to the metal1 shapes of the library. So every pin gets a strip of
metal2, which is as long as the cell allows, and wires begin at metal3. Lengths are in units of
the layout database.
"""

import itertools
import re
from collections.abc import Collection
from pathlib import Path

import klayout.db as db
from attrs import frozen

UNITS_PER_UM = 2000
TRACK, FIRST_TRACK = 380, 190  # vertical tracks of metal2
STEP = 10  # between two heights that are tried for a via
HALF = 70  # half a wire of metal2, and half a via's side
PAD_HALF = 140  # half the length of metal1 that a via needs
LOWEST, HIGHEST = 280, 2520  # ends of a strip: clear of the supply rails
END_GAP = 70  # half the distance between two strips on one track
SUPPLIES = ("VDD", "VSS")
COMBINATIONS_MAX = 200_000
CHOICES = 6  # tracks tried for a pin
# Costs: two pins on one track, too close to each other; the same, far enough apart; a via that
# its metal does not enclose.
SHARED, NEAR, SHORT = (1000.0, 10.0, 1.0)


@frozen
class Strip:
    """The metal2 of a pin from `low` to `high` on the track at `x`, and the height of its via,
    in um from the corner of the cell.

    fits: the pin's own metal1 encloses the via.
    """

    x: float
    low: float
    high: float
    via: float
    fits: bool


@frozen
class Place:
    """A place for the via of a pin: the track, the height, and whether the metal of the pin
    encloses the via.
    """

    x: int
    y: int
    fits: bool


def pin_metal(lef: Path) -> dict[str, dict[str, db.Region]]:
    """Return cell -> pin -> metal1 from a LEF file, without supply pins."""
    layout, options = db.Layout(), db.LoadLayoutOptions()
    options.lefdef_config.dbu = 1 / UNITS_PER_UM
    options.lefdef_config.pin_property_name = "pin"
    options.lefdef_config.produce_obstructions = False
    layout.read(str(lef), options)
    cells: dict[str, dict[str, db.Region]] = {}
    for cell in layout.each_cell():
        pins = cells.setdefault(cell.name, {})
        for shape in (
            shape for index in layout.layer_indexes() for shape in cell.shapes(index).each()
        ):
            pin = shape.property("pin")
            if pin and pin not in SUPPLIES:
                pins.setdefault(pin, db.Region()).insert(shape.polygon)
    return cells


def cell_widths_um(lef: Path) -> dict[str, float]:
    """Return cell -> width from a LEF file."""
    found = re.findall(
        r"^MACRO (\w+).*?SIZE ([\d.]+) BY",
        lef.read_text(encoding="utf-8"),
        re.MULTILINE | re.DOTALL,
    )
    return {name: float(width) for name, width in found}


def strips(lef: Path, cells: Collection[str]) -> dict[str, dict[str, Strip]]:
    """Return cell -> pin -> strip, for some cells of a LEF file."""
    return {
        cell: _cell_strips(pins)
        for cell, pins in sorted(pin_metal(lef).items())
        if pins and cell in cells
    }


def _cell_strips(pins: dict[str, db.Region]) -> dict[str, Strip]:
    places = {pin: _places(metal) for pin, metal in pins.items()}
    choices = itertools.islice(itertools.product(*places.values()), COMBINATIONS_MAX)
    best = min(choices, key=_cost)
    return {
        pin: _strip(place, [other for other in best if other is not place])
        for pin, place in zip(places, best, strict=True)
    }


def _places(metal: db.Region) -> list[Place]:
    """Return the places for a via on the metal of a pin, the best first."""
    box, found = metal.bbox(), []
    for k in range((box.left - FIRST_TRACK) // TRACK, box.right // TRACK + 2):
        x = FIRST_TRACK + TRACK * k
        column = db.Region(db.Box(x - HALF, box.bottom, x + HALF, box.top)) & metal
        spans = [
            (piece.bbox().bottom, piece.bbox().top)
            for polygon in column.merged().each()
            for piece in (db.Polygon(shape) for shape in polygon.decompose_trapezoids())
            if piece.bbox().width() == 2 * HALF
        ]
        for low, high in _joined(spans):
            if high - low >= 2 * HALF:
                middle = (low + high) // 20 * 10
                heights = range(-(-(low + HALF) // STEP) * STEP, high - HALF + 1, STEP)
                y = min(
                    (y for y in heights if _fits(metal, x, y)),
                    key=lambda y: abs(y - middle),
                    default=None,
                )
                found.append((high - low, Place(x, middle if y is None else y, y is not None)))
    found.sort(key=lambda item: (not item[1].fits, -item[0], item[1].x))
    if not found:
        raise ValueError(f"no track crosses the pin at {box}")
    return [place for _, place in found[:CHOICES]]


def _fits(metal: db.Region, x: int, y: int) -> bool:
    """Return whether metal reaches beyond a via on two opposite sides."""
    pads = (PAD_HALF, HALF), (HALF, PAD_HALF)
    return any(
        (db.Region(db.Box(x - dx, y - dy, x + dx, y + dy)) - metal).is_empty() for dx, dy in pads
    )


def _joined(spans: list[tuple[int, int]]) -> list[tuple[int, int]]:
    """Return the spans, with touching ones joined."""
    joined: list[tuple[int, int]] = []
    for low, high in sorted(spans):
        if joined and low <= joined[-1][1]:
            joined[-1] = joined[-1][0], max(high, joined[-1][1])
        else:
            joined.append((low, high))
    return joined


def _cost(chosen: tuple[Place, ...]) -> float:
    cost = sum(0.0 if place.fits else SHORT for place in chosen)
    for one, other in itertools.combinations(chosen, 2):
        if one.x == other.x:
            cost += NEAR if abs(one.y - other.y) > 2 * (PAD_HALF + END_GAP) else SHARED
        elif abs(one.x - other.x) == TRACK:
            cost += 0.1
    return cost


def _strip(place: Place, others: list[Place]) -> Strip:
    low, high = LOWEST, HIGHEST
    for other in others:
        if other.x == place.x:
            middle = (other.y + place.y) // 2
            if other.y > place.y:
                high = min(high, middle // 10 * 10 - END_GAP)
            else:
                low = max(low, -(-middle // 10) * 10 + END_GAP)
    low, high = min(low, place.y - PAD_HALF), max(high, place.y + PAD_HALF)
    x, low_um, high_um, via = (value / UNITS_PER_UM for value in (place.x, low, high, place.y))
    return Strip(x, low_um, high_um, via, place.fits)
