# SPDX-License-Identifier: Apache-2.0
"""Figures from the equations, from Monte Carlo through the golden model, and from the RTL, in three
pages.
"""

from collections.abc import Callable, Iterable
from functools import partial
from pathlib import Path

from attrs import frozen

from coincid.lab.campaign import Processes, Progress
from coincid.model.shared.files import FilePath
from coincid.study.plot_style import style

from . import (
    four_modes,
    interference,
    light_over_distance,
    noisy_spads,
    reconstruction,
    rivals,
    thresholds,
)
from .sections import Section, write_figures_page, write_section

COMPARISON = (
    rivals.background,
    rivals.bits,
    rivals.ranging,
    rivals.two_targets,
    rivals.retroreflector,
    interference.interference,
)


@frozen
class Page:
    """A page of figures. families: takes the engine that plays some frames as RTL; returns the
    functions that make the sections.
    """

    title: str
    introduction: str
    families: Callable[[str | None], Iterable[Callable[[Processes], Section]]]


PAGES = {  # by the targets of the Makefile that write them
    "figures": Page(
        "Coincid: the paper's figures, and noisy SPADs",
        """Each figure is made from the equations as printed (literal), as corrected, and from a Monte Carlo of photons
through the golden model; the pictures link to SVG. docs/paper-figures.md has the assumptions, and says where they differ
from the paper, and why.""",
        lambda engine: (
            light_over_distance.figure_2,
            light_over_distance.figure_5,
            partial(reconstruction.figure_6, engine=engine),
            thresholds.figure_7,
            partial(reconstruction.figure_8, engine=engine),
            noisy_spads.noisy_spads,
        ),
    ),
    "modes": Page(
        "Coincid: coincidence, gating, and 100 m",
        "docs/modes.md has the assumptions and explains the curves.",
        lambda engine: [partial(family, engine=engine) for family in four_modes.FAMILIES],
    ),
    "compare": Page(
        "Coincid: other schemes on the same photons",
        "docs/rivals.md describes the schemes and compares them.",
        lambda engine: COMPARISON,
    ),
}


def write(
    page: Page,
    out_dir: FilePath,
    engine: str | None = None,
    progress: Progress = lambda done, total: None,
    workers: int | None = None,
) -> list[Path]:
    """Write the figures of a page (PNG, SVG), their data (CSV) and `index.html` to `out_dir`;
    return the paths, the page last.

    engine: also plays some frames on the RTL, as of `tb.replay`; None: without RTL.
    progress(done, total) is called after each frame; `total` grows. workers: number of processes,
    all cores by default; the files do not depend on it. Each file appears whole or not at all.
    """
    folder = Path(out_dir)
    sections = []
    with style(), Processes(workers, progress) as run:
        for family in page.families(engine):
            sections.append(family(run))
            write_section(folder, sections[-1])
    write_figures_page(folder, page.title, page.introduction, sections)
    files = [
        folder / f"{stem}.{kind}"
        for section in sections
        for stem, _, _ in section.figures
        for kind in ("png", "svg")
    ]
    return [
        *files,
        *(folder / f"{section.name}.csv" for section in sections),
        folder / "index.html",
    ]
