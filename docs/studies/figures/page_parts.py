# SPDX-License-Identifier: Apache-2.0
"""Writes sections of figures into the pages: their pictures, and tables of their numbers."""

from collections.abc import Callable, Sequence
from typing import Any

from coincid.lab.campaign import Processes
from coincid.study.plot_style import save_figure, style
from coincid.tools.pages import counted, picture

from .sections import Section

IMAGES = "docs/images"


def made(family: Callable[[Processes], Section]) -> Section:
    """Return the section that a function makes on all cores."""
    with style(), Processes(progress=counted) as run:
        return family(run)


def save(section: Section, **names: str) -> None:
    """Write pictures of a section. names: file in docs/images without suffix, by the stem of the
    figure.
    """
    figures = {stem: figure for stem, figure, _ in section.figures}
    with style():
        for stem, name in names.items():
            save_figure(figures[stem], picture(f"{IMAGES}/{name}.png"))


def records(section: Section) -> list[dict[str, Any]]:
    """Return the rows of a section by the names in its first row."""
    head, *rows = section.rows
    return [dict(zip(map(str, head), row, strict=True)) for row in rows]


def per_cent(share: float) -> str:
    """Return a share in per cent, with one digit behind the point below 10 %."""
    value = 100 * share
    return f"{value:.1f} %" if 0 < value < 9.95 else f"{value:.0f} %"


def shown(alt: str, name: str) -> str:
    """Return the Markdown of a picture on a page in docs/."""
    return f"![{alt}](images/{name}.png)"


def paragraphs(*parts: str) -> str:
    """Return parts of a region with an empty line between them."""
    return "\n\n".join(parts)


def only(rows: Sequence[dict[str, Any]], **values: object) -> list[dict[str, Any]]:
    """Return the rows that have these values."""
    return [row for row in rows if all(row[name] == value for name, value in values.items())]
