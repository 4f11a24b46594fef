# SPDX-License-Identifier: Apache-2.0
"""What the examples print and draw, as `drawn_examples.json` has it.

`python -m tests.drawn_examples` writes it again; a change that means to change an example, or the
numbers that it shows, does so.
"""

import contextlib
import io
import json
import os
import runpy
import subprocess
import sys
import warnings
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).parents[1]
EXAMPLES = ROOT / "examples"
RECORD = Path(__file__).with_suffix(".json")
AREAS_MAX = 50  # a colour bar has hundreds
# what follows an example: one line about its figures, below what it has printed
ENDS = """
if __name__ == "__main__":  # processes started by an example import it, too
    from tests.drawn_examples import figures as drawn

    print(__import__("json").dumps(drawn()))
"""

Drawn = dict[str, Any]


def _span(values: Iterable[Any]) -> str:
    """Return how many numbers there are, and least, mean and greatest of them."""
    array = np.ma.filled(np.ma.asarray(values).astype(float), np.nan).ravel()
    known = array[np.isfinite(array)]
    told = (known.min(), known.mean(), known.max()) if len(known) else ()
    return " ".join([str(len(array)), *(f"{float(value):.4g}" for value in told)])


def _axis(axis: Any) -> Iterator[tuple[str, Any]]:
    """Yield what stands on axes, and what is drawn in them."""
    from matplotlib.colors import to_hex

    yield "words", [axis.get_title(), axis.get_xlabel(), axis.get_ylabel()]
    yield "scales", f"{axis.get_xscale()} {axis.get_yscale()}"
    yield "limits", " ".join(f"{limit:.4g}" for limit in (*axis.get_xlim(), *axis.get_ylim()))
    yield (
        "lines",
        [
            f"{line.get_label()} {to_hex(line.get_color())}: {_span(line.get_xdata())}; {_span(line.get_ydata())}"
            for line in axis.lines
        ],
    )
    yield "images", [f"{_span(one.get_array())}; {_span(one.get_clim())}" for one in axis.images]
    bars = [edge for one in axis.patches for edge in one.get_extents().extents]
    yield "bars", _span(bars) if bars else ""
    areas = [path.vertices for one in axis.collections for path in one.get_paths()]
    yield "areas", [_span(area) for area in areas[:AREAS_MAX]]
    legend = axis.get_legend()
    yield "legend", [text.get_text() for text in legend.get_texts()] if legend else []


def figures() -> list[list[Drawn]]:
    """Return all open figures: each of their axes by what is there."""
    from matplotlib import pyplot

    numbered = map(pyplot.figure, pyplot.get_fignums())
    return [
        [{name: there for name, there in _axis(axis) if there} for axis in figure.axes]
        for figure in numbered
    ]


def _record(lines: list[str], drawn: list[list[Drawn]]) -> Drawn:
    return {"prints": lines, "draws": drawn}


def played_here(example: Path) -> Drawn:
    """Return what an example prints and draws in this process."""
    import matplotlib
    from matplotlib import pyplot

    pyplot.close("all")
    text = io.StringIO()
    # `plt.show` warns where there is no window
    with contextlib.redirect_stdout(text), warnings.catch_warnings(), matplotlib.rc_context():
        warnings.simplefilter("ignore")
        matplotlib.use("agg")
        runpy.run_path(str(example), run_name="__main__")
        drawn = figures()
    pyplot.close("all")
    return _record(text.getvalue().splitlines(), drawn)


def played_alone(example: Path, folder: Path) -> Drawn:
    """Return what an example prints and draws in a new process. folder: for its files."""
    more = {
        "MPLBACKEND": "agg",
        "TMPDIR": str(folder),
        "PYTHONWARNINGS": "ignore:FigureCanvasAgg",
        "PYTHONPATH": os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")]),
    }
    script = folder / example.name
    script.write_text(f"{example.read_text(encoding='utf-8')}{ENDS}", encoding="utf-8")
    done = subprocess.run(
        [sys.executable, script],
        cwd=EXAMPLES,
        env=os.environ | more,
        capture_output=True,
        text=True,
        encoding="utf-8",
    )
    assert done.returncode == 0, done.stderr
    *lines, drawn = done.stdout.splitlines()
    return _record(lines, json.loads(drawn))


def recorded() -> dict[str, Drawn]:
    """Return what is written down, by example."""
    return json.loads(RECORD.read_text(encoding="utf-8"))


if __name__ == "__main__":
    import tempfile

    with tempfile.TemporaryDirectory() as place:
        found = {
            name: played_alone(EXAMPLES / f"{name}.py", Path(place)) for name in sorted(recorded())
        }
    RECORD.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
