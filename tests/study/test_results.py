# SPDX-License-Identifier: Apache-2.0
"""Digests of results, one for each way from a scene to numbers: the same input, parameters and seed
give the same result.

A change that means to change a result says so in CHANGELOG.md and renews the digests:
`python -m tests.study.test_results` prints them.
"""

import json
import sys
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest

import coincid
from coincid.lab.campaign import Processes
from coincid.lab.outcomes import Run
from coincid.study.explore.control_values import check_settings
from coincid.study.explore.stages import Explorer
from coincid.study.plot_style import style
from docs.studies import surfaces
from docs.studies.figures import four_modes, interference, noisy_spads, reconstruction

from ..command import command
from ..digests import digest

SMALL = {"sensor": {"rows": 8, "cols": 16}, "frame": {"period": 60, "pulses": 40}}
TIMES = ("cycles_per_s", "seconds")  # of the report
SWEEP = """
scene = "flat:5,0.4"
[sensor]
rows = 8
cols = 16
[frame]
period = 60
pulses = 40
[[axis]]
klux = [5, 50]
[[axis]]
subgroup.threshold = [1, 3]
"""


def library(folder: Path) -> Any:
    config = coincid.parse_config(SMALL | {"subgroup": {"auto": True}}).with_frame(
        frames=2, format="full"
    )
    run = coincid.simulate(config, "five-objects", klux=20, seed=3)
    depth = run.depth(frame=1)
    return (
        run.result,
        run.edges.pulse,
        run.edges.pixel,
        run.edges.tick,
        depth.depth_m,
        depth.confidence,
    )


def sim(folder: Path) -> Any:
    done = command(
        f"sim --engine golden --set rows=8 --set cols=16 --pulses 40 --frames 2 --out {folder}"
    )
    assert done.exit_code == 0, done.output
    report = json.loads((folder / "report.json").read_text(encoding="utf-8"))
    with np.load(folder / "events.npz") as events:
        return {name: value for name, value in report.items() if name not in TIMES}, dict(events)


def sweep(folder: Path) -> Any:
    spec, out = folder / "spec.toml", folder / "out.parquet"
    spec.write_text(SWEEP, encoding="utf-8")
    done = command(f"sweep {spec} --out {out} --workers 1")
    assert done.exit_code == 0, done.output
    return pq.read_table(out).drop_columns(["point"]).to_pydict()


def explorer(folder: Path) -> Any:
    view = (
        Explorer()
        .run(check_settings({"rows": 16, "cols": 16, "pulses": 40, "klux": 20.0, "threshold": 3}))
        .view()
    )
    return view.numbers, view.depth_m, view.threshold, [one.wrong_share for one in view.objects]


def section(function: Callable[..., Any], **constants: Any) -> Callable[[Path], Any]:
    """Return the rows of a figure, with other constants of its module."""

    def rows(folder: Path) -> Any:
        with pytest.MonkeyPatch.context() as patch, style(), Processes(1) as run:
            module = sys.modules[function.__module__]
            for name, value in constants.items():
                patch.setattr(module, name, value)
            return list(function(run).rows)

    return rows


def surface(folder: Path) -> Any:
    setup = surfaces.setup(surfaces.analytic_scenes()["roof"], "id").but(seed=2)
    dropped, *shares = surfaces.look(Run(setup))
    return dropped, dict(zip(surfaces.METHODS, (shares[:2], shares[2:]), strict=True))


DARK = {"dark": {1e6: {"spad": coincid.Spad(dark_cps=1e6)}}}
INTERFERENCE = dict(
    PHOTONS=(0.0, 0.2), OFFSETS=(0.0, 1e-3), BITS_SHOWN=(0, 2), DITHER_BITS=(0, 2), SEEDS=1
)
RESULTS: dict[str, tuple[Callable[[Path], Any], str]] = {
    "library": (library, "3b359193304cb412"),
    "sim": (sim, "e8b5ef8f920d74cb"),
    "sweep": (sweep, "e8ecf2b562fd07d7"),
    "explorer": (explorer, "d21e76f8101f00ad"),
    "surfaces": (surface, "aa50220de1a3e5ed"),
    "noisy SPADs": (section(noisy_spads.noisy_spads, SPADS=DARK, SEEDS=1), "43f117d06fcdbcec"),
    "modes": (
        section(four_modes.background, KLUX=(10.0, 50.0), DISTANCES_M=(5.0,), SEEDS=1),
        "ddc638dac1cba6cb",
    ),
    "figure 8": (
        section(reconstruction.figure_8, THRESHOLDS_8=(2, 3), SEEDS=1, MANY=1),
        "da7992655edd0764",
    ),
    "interference": (section(interference.interference, **INTERFERENCE), "16a5ab28decf3176"),
}


@pytest.mark.parametrize("name", RESULTS)
def test_same_result(name, tmp_path):
    make, expected = RESULTS[name]
    assert digest(make(tmp_path)) == expected


if __name__ == "__main__":
    for name, (make, _) in RESULTS.items():
        with TemporaryDirectory() as folder:
            print(f"{name}: {digest(make(Path(folder)))}", flush=True)
