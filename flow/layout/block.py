# SPDX-License-Identifier: Apache-2.0
"""Placement and routing of a block in Coriolis, with a clock tree; cells move to legal sites,
and their places are recorded.

Import this module after `technology.set_up`, because Coriolis's modules create a database if
there is none.
"""

import json
from pathlib import Path
from typing import Any

from coriolis.helpers import u
from coriolis.helpers.overlay import UpdateSession
from coriolis.Hurricane import Box, DbU, Transformation
from coriolis.plugins.block.block import Block
from coriolis.plugins.block.configuration import BlockConf
from coriolis.plugins.block.spares import Spares

from .technology import ROW_UM, SITE_UM, TOP_METAL

PLACED = "placed.json"
RING_ROWS, RING_SITES = 2, 16  # the ring around the cells that stays free
SITE = u(SITE_UM)
# largest share of free area in one place; with 0 the placer widens the cells until they fill the
# block
SPREAD = 0.15


def um(length: int) -> float:
    return round(DbU.toPhysical(length, DbU.UnitPowerMicro), 4)


def build(cell, job) -> bool:
    """Place and route a block; return whether every net is routed."""
    BlockConf.toXPitch = Spares.toXPitch = to_site
    return bool(SnappedBlock(configuration(cell, job)).doPnR())


def configuration(cell, job) -> BlockConf:
    """Return Coriolis's settings for a block: its size, its clock tree, and the tracks reserved
    for the detailed router.

    Ports have no pins at the border; they stay at the pins of cells.
    """
    conf = BlockConf(cell, ioPins=[], ioPads=[])
    conf.cfg.etesian.spaceMargin = job.margin
    conf.cfg.etesian.densityVariation = SPREAD
    conf.cfg.anabatic.topRoutingLayer = TOP_METAL
    conf.cfg.anabatic.searchHalo = 4
    conf.cfg.anabatic.globalIterations = 20
    conf.cfg.katana.hTracksReservedLocal = job.tracks_reserved[0]
    conf.cfg.katana.vTracksReservedLocal = job.tracks_reserved[1]
    conf.cfg.katana.hTracksReservedMin = conf.cfg.katana.vTracksReservedMin = job.tracks_reserved[2]
    conf.cfg.katana.runRealignStage = True
    conf.cfg.block.spareSide = u(ROW_UM * 10)
    conf.useSpares = conf.useClockTree = conf.useHFNS = True
    conf.bColumns = conf.bRows = 2
    conf.useHTree(job.clock)
    width, height = core_size_um(cell, job.margin)
    conf.coreSize = u(width), u(height)
    conf.placeArea = Box(
        u(RING_SITES / 2 * SITE_UM),
        u(RING_ROWS * ROW_UM),
        u(width - RING_SITES / 2 * SITE_UM),
        u(height - RING_ROWS * ROW_UM),
    )
    return conf


def core_size_um(cell, margin: float) -> tuple[float, float]:
    """Return width and height of a block: nearly square, an even number of rows, `margin` of
    free area, and the ring.
    """
    length = sum(
        um(instance.getMasterCell().getAbutmentBox().getWidth()) for instance in cell.getInstances()
    )
    rows = int((length * ROW_UM * (1 + margin)) ** 0.5 / ROW_UM + 0.999)
    rows += rows % 2
    sites = int(length * (1 + margin) / rows / SITE_UM + 1) + RING_ROWS * RING_SITES
    return round(sites * SITE_UM, 3), (rows + 2 * RING_ROWS) * ROW_UM


def to_site(self, x: int, superior: bool = False) -> int:
    return (x + SITE - 1) // SITE * SITE if superior else x // SITE * SITE


class SnappedBlock(Block):
    """A block that Coriolis places and routes. Before routing, the cells move to sites, and
    their places are recorded.
    """

    def place(self):
        super().place()
        snap(self.conf.cell)

    def route(self):
        record(self.conf.cell)
        return super().route()


def snap(cell) -> None:
    """Move each cell to the nearest free site of its row that leaves room for the cells on its
    right.
    """
    rows: dict[int, list[Any]] = {}
    for instance in cell.getInstances():
        box = instance.getAbutmentBox()
        rows.setdefault(box.getYMin(), []).append(
            (box.getXMin(), instance.getName(), box.getWidth(), instance)
        )
    with UpdateSession():
        for row in rows.values():
            row.sort(key=lambda item: item[:2])
            limit, latest = cell.getAbutmentBox().getXMax(), []
            for _, _, width, _ in reversed(row):
                limit = (limit - width) // SITE * SITE
                latest.append(limit)
            at = 0
            for (x, name, width, instance), limit in zip(row, reversed(latest), strict=False):
                new = min(max((x + SITE // 2) // SITE * SITE, at), limit)
                if new < at:
                    raise ValueError(f"{name}: no room in its row")
                at = new + width
                if new != x:
                    old = instance.getTransformation()
                    instance.setTransformation(
                        Transformation(old.getTx() + new - x, old.getTy(), old.getOrientation())
                    )


def record(cell) -> None:
    """Write `PLACED`: the size of the block, the place, orientation and nets of every cell, and
    the direction of every port.
    """
    box = cell.getAbutmentBox()
    cells = []
    for instance in cell.getInstances():
        where = instance.getAbutmentBox()
        nets = {
            plug.getMasterNet().getName(): plug.getNet().getName()
            for plug in instance.getPlugs()
            if plug.getNet() is not None and not plug.getMasterNet().isSupply()
        }
        cells.append(
            {
                "name": instance.getName(),
                "kind": instance.getMasterCell().getName(),
                "x": um(where.getXMin()),
                "y": um(where.getYMin()),
                "flipped": str(instance.getTransformation().getOrientation()) == "6",
                "nets": nets,
            }
        )
    ports = {
        net.getName(): "output" if str(net.getDirection()) == "2" else "input"
        for net in cell.getNets()
        if net.isExternal() and not net.isSupply()
    }
    whole = {
        "width": um(box.getWidth()),
        "height": um(box.getHeight()),
        "cells": cells,
        "ports": ports,
    }
    Path(PLACED).write_text(json.dumps(whole), encoding="utf-8")
