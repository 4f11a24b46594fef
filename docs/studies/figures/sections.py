# SPDX-License-Identifier: Apache-2.0
"""Sections of a page of figures, with pictures, data and our numbers next to the paper's; and
functions that write them.
"""

import html
from collections.abc import Sequence
from pathlib import Path
from typing import TypeAlias

from attrs import frozen
from matplotlib.figure import Figure

from coincid.model.shared.files import whole_file, write_csv
from coincid.study.plot_style import save_figure

Row: TypeAlias = Sequence[object]  # of a CSV


@frozen
class Comparison:
    """One number of the paper, as text, and the same number from each of our sources."""

    quantity: str
    paper: str
    ours: dict[str, str]


@frozen(eq=False)
class Section:
    """A part of the page. name: stem of its files. figures: (stem, figure, caption). rows: of the
    CSV, header first.
    """

    name: str
    title: str
    figures: Sequence[tuple[str, Figure, str]]
    rows: Sequence[Row]
    comparisons: Sequence[Comparison] = ()
    text: str = ""


def section(
    name: str,
    title: str,
    figure: Figure,
    caption: str,
    rows: Sequence[Row],
    *comparisons: Comparison,
    text: str = "",
) -> Section:
    """Return a section with one figure, which has the name of the section."""
    return Section(name, title, [(name, figure, caption)], rows, comparisons, text)


def write_section(out_dir: Path, section: Section) -> None:
    """Write PNG and SVG of every figure, and the CSV."""
    for stem, figure, _ in section.figures:
        save_figure(figure, out_dir / f"{stem}.png", out_dir / f"{stem}.svg")
    write_csv(out_dir / f"{section.name}.csv", section.rows)


def write_figures_page(
    out_dir: Path, title: str, introduction: str, sections: Sequence[Section]
) -> None:
    """Write `index.html` for sections whose files are written already."""
    body = "\n".join(_section_html(section) for section in sections)
    links = " · ".join(
        f'<a href="#{section.name}">{html.escape(section.title)}</a>' for section in sections
    )
    page = f"""<!doctype html>
<html lang="en">
<meta charset="utf-8">
<title>{html.escape(title)}</title>
<style>
body {{ font: 15px/1.5 sans-serif; max-width: 75rem; margin: 2rem auto; padding: 0 1rem; color: #222; }}
img {{ max-width: 100%; }}
figure {{ margin: 1rem 0; }}
figcaption {{ color: #555; }}
table {{ border-collapse: collapse; margin: 1rem 0; }}
td {{ border: 1px solid #ccc; padding: .3rem .6rem; text-align: left; vertical-align: top; }}
tr:first-child {{ background: #f3f3f3; font-weight: bold; }}
</style>
<h1>{html.escape(title)}</h1>
<p>{html.escape(introduction)}</p>
<p>{links}</p>
{body}
</html>
"""
    with whole_file(out_dir / "index.html") as file:
        file.write(page.encode())


def _section_html(section: Section) -> str:
    text = f"<p>{html.escape(section.text)}</p>" if section.text else ""
    figures = "\n".join(
        f'<figure><a href="{stem}.svg"><img src="{stem}.png" alt="{html.escape(caption)}"></a>'
        f"<figcaption>{html.escape(caption)}</figcaption></figure>"
        for stem, _, caption in section.figures
    )
    return (
        f'<h2 id="{section.name}">{html.escape(section.title)}</h2>\n{text}\n{figures}\n'
        f'{_comparison_html(section.comparisons)}<p>Data: <a href="{section.name}.csv">{section.name}.csv</a></p>'
    )


def _comparison_html(comparisons: Sequence[Comparison]) -> str:
    sources = list(
        dict.fromkeys(source for comparison in comparisons for source in comparison.ours)
    )
    table = [("quantity", "paper", *sources)] if comparisons else []
    table += [
        (one.quantity, one.paper, *(one.ours.get(source, "") for source in sources))
        for one in comparisons
    ]
    cells = ("".join(f"<td>{html.escape(text)}</td>" for text in row) for row in table)
    return (
        "<table>\n" + "".join(f"<tr>{row}</tr>\n" for row in cells) + "</table>\n" if table else ""
    )
