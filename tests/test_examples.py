# SPDX-License-Identifier: Apache-2.0
"""Every example runs by itself in a fresh process and draws something."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

EXAMPLES = Path(__file__).parents[1] / "examples"
FIRST = "plot_01_first_frame"
DRAWN = """
if __name__ == "__main__":
    import matplotlib.pyplot

    assert matplotlib.pyplot.get_fignums(), "no figure"
"""  # processes started by an example import it, too


def examples():
    """Return the programs; together they take long."""
    for path in sorted(EXAMPLES.glob("plot_*.py")):
        marks = [] if path.stem == FIRST else [pytest.mark.long]
        yield pytest.param(path, id=path.stem, marks=marks)


def test_every_example_is_listed():
    listed = re.findall(r"\]\((\w+\.py)\)", (EXAMPLES / "README.md").read_text(encoding="utf-8"))
    assert sorted(listed) == sorted(path.name for path in EXAMPLES.glob("*.py"))


@pytest.mark.parametrize("example", list(examples()))
def test_example_runs(example, tmp_path):
    more = {
        "MPLBACKEND": "agg",
        "TMPDIR": str(tmp_path),
        "PYTHONWARNINGS": "ignore:FigureCanvasAgg",
    }
    script = tmp_path / example.name
    script.write_text(f"{example.read_text(encoding='utf-8')}{DRAWN}", encoding="utf-8")
    command, environment = [sys.executable, script], os.environ | more
    done = subprocess.run(
        command, cwd=EXAMPLES, env=environment, capture_output=True, text=True, encoding="utf-8"
    )
    assert done.returncode == 0 and done.stdout, done.stderr
