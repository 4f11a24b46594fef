# SPDX-License-Identifier: Apache-2.0
"""The paper's figures and an architect's questions, from the equations, Monte Carlo through the golden model, and the RTL."""

from collections.abc import Callable
from functools import partial
from pathlib import Path

from ...lab.campaign import Processes, Progress
from ...model.shared.files import FilePath
from ..plot_style import style
from . import architect, four_modes, interference, light_over_distance, reconstruction, rivals, thresholds
from .sections import Section, write_page, write_section

TITLE = "Coincid: the paper's figures, and an architect's questions"
INTRODUCTION = """Each figure is made from the equations as printed (literal), as corrected, and from a Monte Carlo of photons
through the golden model; the pictures link to SVG. docs/paper-figures.md has the assumptions, and says where they differ
from the paper, and why."""

COMPARISON = (
    rivals.background,
    rivals.bits,
    rivals.ranging,
    rivals.two_targets,
    rivals.retroreflector,
    interference.interference,
)
MODES_TITLE = "Coincid: coincidence, gating, and 100 m"
MODES_INTRODUCTION = "docs/modes.md has the assumptions, and says what these curves show."
RIVALS_TITLE = "Coincid: other schemes on the same photons"
RIVALS_INTRODUCTION = "docs/rivals.md describes the schemes, and says which of them wins where, and why."


def make(
    out_dir: FilePath,
    engine: str | None = None,
    progress: Progress = lambda done, total: None,
    workers: int | None = None,
) -> list[Path]:
    """Write all figures (PNG, SVG), their data (CSV) and `index.html` to `out_dir`; return the paths, the page last.

    engine: runs the RTL for figures 6 and 8, as of `tb.replay`; None: without RTL.
    progress(done, total) is called after each frame; `total` grows. workers: number of processes, all cores by default;
    the files do not depend on it. Each file appears whole or not at all.
    """
    return _write(
        out_dir,
        TITLE,
        INTRODUCTION,
        (
            light_over_distance.figure_2,
            light_over_distance.figure_5,
            partial(reconstruction.figure_6, engine=engine),
            thresholds.figure_7,
            partial(reconstruction.figure_8, engine=engine),
            architect.rearm_and_window,
            architect.noisy_spads,
        ),
        progress,
        workers,
    )


def compare(out_dir: FilePath, progress: Progress = lambda done, total: None, workers: int | None = None) -> list[Path]:
    """Make the comparison with other schemes and the interference of a second LiDAR; arguments as in `make`."""
    return _write(out_dir, RIVALS_TITLE, RIVALS_INTRODUCTION, COMPARISON, progress, workers)


def modes(
    out_dir: FilePath,
    engine: str | None = None,
    progress: Progress = lambda done, total: None,
    workers: int | None = None,
) -> list[Path]:
    """Make the four modes; arguments as in `make`. `engine` checks some frames of each section on the RTL."""
    families = tuple(partial(family, engine=engine) for family in four_modes.FAMILIES)
    return _write(out_dir, MODES_TITLE, MODES_INTRODUCTION, families, progress, workers)


def _write(
    out_dir: FilePath,
    title: str,
    introduction: str,
    families: tuple[Callable[[Processes], Section], ...],
    progress: Progress,
    workers: int | None,
) -> list[Path]:
    folder = Path(out_dir)
    sections = []
    with style(), Processes(workers, progress) as run:
        for family in families:
            sections.append(family(run))
            write_section(folder, sections[-1])
    write_page(folder, title, introduction, sections)
    files = [
        folder / f"{stem}.{kind}" for section in sections for stem, _, _ in section.figures for kind in ("png", "svg")
    ]
    return [*files, *(folder / f"{section.name}.csv" for section in sections), folder / "index.html"]
