# SPDX-License-Identifier: Apache-2.0
"""Writes the pictures and tables of docs/paper-figures.md; the figures are those of
`make figures`.
"""

import re
from typing import Any

from coincid.model.shared.markdown import text_table
from coincid.tools.pages import put

from . import light_over_distance, reconstruction, thresholds
from .page_parts import made, only, paragraphs, records, save, shown
from .setups import PULSES

PAGE = "docs/paper-figures.md"
READINGS = {
    "A": "mean rates",
    "E": "photons of a pulse, and background within the SPAD's jitter (100 ps)",
    "F": "photons of a pulse, and background after dead time in a window of 5 ns",
}
PAPER_6 = {  # panel: wrong pixels, objects that are right
    "a": ("up to 11.9 %", "1, 3, 4"),
    "b": ("no number", "1, 3, 4"),
    "c": ("no number", '2, 5 "take preference"'),
}
SIZES_8 = {"a": "(a) 16 x 16, 4 x 4", "b": "(b) 4 x 4, 2 x 2", "c": "(c) 8 x 8, 2 x 2"}
SOURCES_8 = {  # source of the page: source of the figure
    "literal": "analytic, literal",
    "corrected": "analytic, corrected",
    "maximum": "Monte Carlo, maximum",
    "matched": "Monte Carlo, matched",
    "matched, minigroup stamps": "Monte Carlo, matched/minigroup",
    "planes": "Monte Carlo, planes",
}
COLUMNS_7 = {
    "literal": "analytic, literal",
    "corrected": "analytic, corrected",
    f"Monte Carlo, {PULSES} pulses": "Monte Carlo",
    f"Monte Carlo, {8 * PULSES} pulses": "Monte Carlo, 8x",
}


def figure_2() -> None:
    """Write the distances at which signal and background are equal."""
    rows = [
        (key, told, f"{light_over_distance.zero_m('literal', key):.2f} m")
        for key, told in READINGS.items()
    ]
    put(PAGE, "fig2", text_table(("reading", "what is compared", "0 dB at"), rows, left=(0, 1)))


def figure_6() -> None:
    """Write a table and a picture for each panel."""
    section = made(reconstruction.figure_6)
    save(section, **{f"fig6{panel}": f"paper_fig6{panel}" for panel in PAPER_6})
    rows = records(section)
    for panel, paper in PAPER_6.items():
        table = [("paper", *paper)]
        for source in ("literal", "corrected"):
            table.append((source, *_judged(only(rows, panel=panel, source=source))))
        for method in reconstruction.METHODS:
            found = only(rows, panel=panel, source="Monte Carlo", pulses=PULSES, estimator=method)
            table.append((method, *_judged(found)))
        put(
            PAGE,
            f"fig6{panel}",
            paragraphs(
                text_table(
                    ("source", "wrong pixels", "objects that are right"), table, left=(0, 2)
                ),
                shown(f"Fig. 6{panel} by every estimator", f"paper_fig6{panel}"),
            ),
        )


def _judged(rows: list[dict[str, Any]]) -> tuple[str, str]:
    """Return the share of wrong pixels, and the objects with the right distance."""
    share = {row["object"]: row["wrong_share"] for row in rows}
    whole = share.pop("all")
    right = [str(label) for label in share if share[label] < reconstruction.RIGHT]
    return f"{100 * whole:.1f} %", "all" if len(right) == len(share) else ", ".join(right) or "none"


def figure_7() -> None:
    """Write picture and table."""
    section = made(thresholds.figure_7)
    save(section, fig7="paper_fig7")
    rows = []
    for one in section.comparisons:
        which, _, klux = one.quantity.partition(" threshold within 1 % of the best, ")
        rows.append((klux, which, *(one.ours[name] for name in COLUMNS_7.values())))
    alt = "Highest and lowest threshold within 1 % of the best, against activity"
    table = text_table(("background", "threshold", *COLUMNS_7), rows, left=range(6))
    put(PAGE, "fig7", paragraphs(shown(alt, "paper_fig7"), table))


def figure_8() -> None:
    """Write the table."""
    section = made(reconstruction.figure_8)
    ours = {one.quantity[1]: one.ours for one in section.comparisons}
    rows = [("paper", "worse than (c)", "worse than (c)", "7 %")]
    for name, source in SOURCES_8.items():
        cells = [
            re.sub(r"(\S+)% \(threshold (\d+)\)", r"\1 % (\2)", ours[panel][source])
            for panel in SIZES_8
        ]
        rows.append((name, cells[0], cells[1], cells[2]))
    put(PAGE, "fig8", text_table(("source", *SIZES_8.values()), rows))
