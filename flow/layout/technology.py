# SPDX-License-Identifier: Apache-2.0
"""The 45 nm process and its standard cells in Coriolis: layers, routing tracks, and the cells of
a LEF file.

This runs only inside Coriolis's own process (`place_route.py`). Widths and distances are those
of the cells' LEF file.
"""

import json
import tomllib
from pathlib import Path
from typing import Any

from coriolis import CRL, Cfg
from coriolis.CRL import AllianceFramework, CellGauge, LefImport, RoutingGauge, RoutingLayerGauge
from coriolis.helpers import u
from coriolis.helpers.overlay import CfgCache, UpdateSession
from coriolis.helpers.technology import createBL, createVia, setEnclosures
from coriolis.Hurricane import (
    BasicLayer,
    Box,
    DataBase,
    DbU,
    Library,
    NetExternalComponents,
    Technology,
    Vertical,
)

SITE_UM, ROW_UM = 0.19, 1.4
SITE_NAME = "LEF.FreePDK45_38x28_10R_NP_162NW_34O"
GRID_UM = 0.01  # placement pitch for both directions; `block.snap` then moves the cells to sites
FIRST_X_UM, FIRST_Y_UM = 0.095, 0.07  # first tracks
METALS = range(1, 11)
WIDTH_UM = {1: 0.07, 2: 0.07, 3: 0.07, 4: 0.14, 5: 0.14, 6: 0.14, 7: 0.4, 8: 0.4, 9: 0.8, 10: 0.8}
CUT_SPACE_UM = {1: 0.08, 2: 0.09, 3: 0.09, 4: 0.16, 5: 0.16, 6: 0.16, 7: 0.44, 8: 0.44, 9: 0.88}
# The pitch keeps the pads of vias to the wider metal apart. Where pads would touch, only every
# second track exists.
PITCH_UM = {2: 0.19, 3: 0.14, 4: 0.30, 5: 0.30, 6: 0.30, 7: 0.84, 8: 0.84}
PAD_UM = {3: 0.14}  # wires of metal3 end in pads as wide as metal4's
TOP_METAL = "metal6"
SETTINGS = Path(__file__).with_name("coriolis.toml")
# in the GDS of the cells, metal k is on layer 9 + 2k, and the via above it on the next layer
GDS_METAL1 = 11


def set_up(lef: list[Path], strips: Path, um2_per_pin: float) -> Library:
    """Create the technology, tracks and cells. strips: JSON of `pins.strips`; um2_per_pin: least
    area of a cell per pin.
    """
    _technology()
    _gauges()
    _settings()
    return _cells(lef, json.loads(strips.read_text(encoding="utf-8")), um2_per_pin)


def _technology() -> None:
    db = DataBase.create()
    CRL.System.get()
    tech = Technology.create(db, "Nangate45")
    DbU.setPrecision(2)
    DbU.setPhysicalsPerGrid(0.0025, DbU.UnitPowerMicro)
    with CfgCache(priority=Cfg.Parameter.Priority.ConfigurationFile) as cfg:
        cfg.gdsDriver.metricDbu = 1e-10
        cfg.gdsDriver.dbuPerUu = 0.0001
    material = BasicLayer.Material
    for name, kind, size, space, layer in (
        ("pwell", material.pWell, 0.2, 0.2, 2),
        ("nwell", material.nWell, 0.2, 0.2, 3),
        ("nimplant", material.nImplant, 0.045, 0.045, 4),
        ("pimplant", material.pImplant, 0.045, 0.045, 5),
        ("active", material.active, 0.09, 0.08, 1),
        ("poly", material.poly, 0.05, 0.14, 9),
        ("contact", material.cut, 0.065, 0.075, 10),
    ):
        createBL(tech, name, kind, size=u(size), spacing=u(space), gds2Layer=layer)
    metals = {}
    for i in METALS:
        layer = GDS_METAL1 + 2 * (i - 1)
        width = WIDTH_UM[i]
        metals[i] = createBL(
            tech,
            f"metal{i}",
            material.metal,
            size=u(width),
            spacing=u(max(width, 0.065)),
            gds2Layer=layer,
        )
        if i < METALS[-1]:
            createBL(
                tech,
                f"via{i}",
                material.cut,
                size=u(WIDTH_UM[i]),
                spacing=u(CUT_SPACE_UM[i]),
                gds2Layer=layer + 1,
            )
    for i in METALS:
        metals[i].setBlockageLayer(
            createBL(tech, f"metal{i}.block", material.blockage, gds2Layer=100 + i)
        )
    for i in METALS[:-1]:
        _via(tech, metals, i)
    createBL(tech, "OVERLAP", material.other, gds2Layer=235)
    createBL(tech, "text.cell", material.other, gds2Layer=63)
    for name in ("text.instance", "SPL1", "AutoLayer"):
        createBL(tech, name, material.other)
    for name in ("gmetalh", "gcontact", "gmetalv"):
        createBL(tech, name, material.metal)


def _via(tech, metals, i) -> None:
    """Create the via above metal i. Up to metal3 its pads reach 0.035 um beyond the cut along
    the direction of the metal.
    """
    via = createVia(tech, f"VIA{i}{i + 1}", f"metal{i}", f"via{i}", f"metal{i + 1}", u(WIDTH_UM[i]))
    for j in (i, i + 1):
        along = 0.035 if i <= 3 and j <= 3 else 0.0
        if (i, j) == (3, 4):
            pad = (0.035, 0.035)
        elif j % 2 and j > 1:
            pad = (along, 0.0)
        else:
            pad = (0.0, along)
        setEnclosures(via, metals[j], tuple(map(u, pad)))


def _gauges() -> None:
    """Create the tracks. Odd metals are horizontal. Only pins of cells use metal2; metal7 and
    above stay empty.
    """
    framework, tech = AllianceFramework.get(), DataBase.getDB().getTechnology()
    gauge = RoutingGauge.create("nangate45")
    gauge.setSymbolic(False)
    for depth, i in enumerate(PITCH_UM):
        flat = i % 2 == 1
        if i == 2:
            kind = RoutingLayerGauge.PinOnly
        else:
            kind = RoutingLayerGauge.PowerSupply if i >= 7 else RoutingLayerGauge.Default
        gauge.addLayerGauge(
            RoutingLayerGauge.create(
                tech.getLayer(f"metal{i}"),
                RoutingLayerGauge.Horizontal if flat else RoutingLayerGauge.Vertical,
                kind,
                depth,
                0.0,
                u(FIRST_Y_UM if flat else FIRST_X_UM),
                u(PITCH_UM[i]),
                u(WIDTH_UM[i]),
                u(PAD_UM.get(i, WIDTH_UM[i])),
                u(WIDTH_UM[i]),
                u(0.0),
            )
        )
    framework.addRoutingGauge(gauge)
    framework.addCellGauge(CellGauge.create(SITE_NAME, "metal2", u(SITE_UM), u(ROW_UM), u(GRID_UM)))


def _settings() -> None:
    """Set all values that Coriolis asks for."""
    with CfgCache(priority=Cfg.Parameter.Priority.ConfigurationFile) as cfg:
        _set(cfg, tomllib.loads(SETTINGS.read_text(encoding="utf-8")))
        cfg.anabatic.cellGauge = SITE_NAME


def _set(section: Any, values: dict[str, Any]) -> None:
    for name, value in values.items():
        if isinstance(value, dict):
            _set(getattr(section, name), value)
        else:
            setattr(section, name, value)


def _cells(
    lef: list[Path], strips: dict[str, dict[str, list[float]]], um2_per_pin: float
) -> Library:
    framework = AllianceFramework.get()
    library = Library.create(DataBase.getDB().getRootLibrary(), "Nangate45")
    LefImport.load(str(lef[0]))
    LefImport.setMergeLibrary(library)
    for path in lef[1:]:
        LefImport.load(str(path))
    framework.wrapLibrary(library, 1)
    metal2 = DataBase.getDB().getTechnology().getLayer("metal2")
    with UpdateSession():
        for cell in library.getCells():
            for net in cell.getNets():
                strip = strips.get(cell.getName(), {}).get(net.getName())
                if strip:
                    _replace_pin(net, metal2, *strip[:3])
            _widen(cell, um2_per_pin)
    return library


def _replace_pin(net, metal2, x: float, low: float, high: float) -> None:
    """Replace the shapes of a pin by its strip, so that the router sees only the strip."""
    for shape in list(net.getComponents()):
        shape.destroy()
    NetExternalComponents.setExternal(
        Vertical.create(net, metal2, u(x), u(WIDTH_UM[2]), u(low), u(high))
    )


def _widen(cell, um2_per_pin: float) -> None:
    """Widen a cell to the right so that each pin has enough room. Filler cells later fill the
    added room.
    """
    pins = sum(1 for net in cell.getNets() if net.isExternal() and not net.isSupply())
    box, site = cell.getAbutmentBox(), u(SITE_UM)
    if not pins:
        return
    width, needed = box.getWidth(), u(pins * um2_per_pin / ROW_UM)
    if needed > width:
        width += (needed - width + site - 1) // site * site
        cell.setAbutmentBox(Box(box.getXMin(), box.getYMin(), box.getXMin() + width, box.getYMax()))
