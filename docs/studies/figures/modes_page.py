# SPDX-License-Identifier: Apache-2.0
"""Writes the pictures and the table of docs/modes.md; the figures are those of `make modes`."""

import re

from coincid.model.shared.markdown import text_table
from coincid.tools.pages import put

from . import four_modes
from .page_parts import made, save

PAGE = "docs/modes.md"


def background() -> None:
    """Write the picture of the modes over distance."""
    save(made(four_modes.background), modes="modes")
    put(PAGE, "modes")


def glass() -> None:
    """Write the picture of a target behind a pane."""
    save(made(four_modes.glass), modes_glass="modes_glass")
    put(PAGE, "glass")


def far() -> None:
    """Write picture and table of a target at 100 m."""
    section = made(four_modes.far)
    save(section, modes_far="modes_far")
    put(PAGE, "far picture")
    rows = []
    for one in section.comparisons:
        reflectivity, pulses = (
            one.quantity.removeprefix("least laser pulse, ").removesuffix(" pulses").split(", ")
        )
        needs = [one.ours[four_modes.SCHEDULES[name]] for name in ("none", "scan", "known")]
        cells = [re.sub(r"^(\S+ nJ), .*, (\S+ cm) RMS$", r"\1, \2", need) for need in needs]
        rows.append((reflectivity.replace("%", " %"), pulses, *cells))
    head = "target", "pulses", "no gate", "progressive gate", "gate around the target"
    put(PAGE, "far", text_table(head, rows, left=(0, 2, 3, 4)))
