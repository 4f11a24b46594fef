# SPDX-License-Identifier: Apache-2.0
"""An argument of the wrong kind is refused in a sentence: each argument of each function that the
library exports or that a page shows, and of each method of a run, in a call that is right
otherwise.
"""

import inspect
import re
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest

import coincid
from coincid.board.parameters import Emulator
from coincid.lab.setup import Setup
from coincid.model.contract.registers import address
from coincid.model.depth.depth import Depth
from coincid.model.depth.pulse_ticks import pulse_ticks
from coincid.model.light.analytic import expected_threshold, success_by_threshold
from coincid.model.light.code_density import code_density
from coincid.model.light.light import Arrivals, Interferer
from coincid.model.light.link_budget import Laser, Optics, link_budget
from coincid.model.light.photons import edge_chunks
from coincid.model.recorded.exchange import read_recording, write_edges
from coincid.model.recorded.recordings import recorded_edges
from coincid.model.scenes.view import View
from coincid.model.shared.pulse import Pulse

SMALL = {"rows": 8, "cols": 8, "pulses": 5}
WALL_M = np.full((8, 8), 5.0)
ODD = (
    -1,
    0.5,
    1e300,
    2**2000,
    10**5000,
    float("nan"),
    1 + 2j,
    "five",
    "\0",
    (1, 2),
    {},
    np.array([1.0, 2.0]),
    np.array("x"),
    np.timedelta64(1, "s"),
    np.zeros((0, 3)),
    np.zeros(2, [("metres", "f8")]),
    [[1.0], [2.0, 3.0]],
    object(),
)
# What holds for all arguments of these names is tested elsewhere.
PATHS = {"path", "colour"}
OPTIONS = {  # that functions pass on
    "Run.depth": ("method", "source", "frame", "returns", "workers", "system_fwhm_s", "pulse"),
    "Run.histogram": ("source", "frame"),
    "Run.point_cloud": ("method", "returns"),
    "simulate": ("rows", "pulses", "threshold", "format", "gating", "mask", "clock_mhz"),
    "generate_edges": ("pulses", "seed", "pulse_start", "workers", "gate"),
    "bound": ("pulses", "threshold", "window", "coincidence"),
    "success_by_threshold": ("spad", "sensor", "scheme", "system_fwhm_s", "form", "pulses"),
    "Setup.of": ("scene", "light", "pulse", "spad", "seed", "edges", "engine", "estimators"),
}
NO_CALLS = {"Config", "InputError"}  # parse_config makes the one, checks raise the other
NOT_CHECKED = {  # (function, argument): Python's own error comes out of it
    ("Run", "setup"),
    ("Run", "cache"),
    ("Run", "workers"),
    ("Run", "watch"),
    ("Run", "light"),
    ("Run", "edges"),
    ("Run", "played"),
    ("Run", "result"),
    ("replay", "progress"),
    ("Scene", "name"),
    ("Scene", "notes"),
    ("Scene", "doubts"),
    ("Scene", "transient"),
    ("Scene", "view"),
    ("Scene", "later"),
    ("address", "subgroup"),
    ("address", "index"),
}
IN_BLOCKS_OF_OTHERS = {  # functions of pages that an estimator of one's own or a study calls
    "arrival_ticks",
    "campaign",
    "pixel_table",
    "read_measures",
    "register_estimator",
    "to_table",
}


@pytest.fixture(scope="module")
def run():
    return coincid.simulate(None, "flat:5", **SMALL)


@pytest.fixture(scope="module")
def calls(run, tmp_path_factory):
    """Return name -> (function, arguments of a call that is right)."""
    folder = tmp_path_factory.mktemp("kinds")
    np.save(folder / "wall.npy", WALL_M)
    coincid.write_result(folder / "result.npz", run.result)
    run.edges.save(folder / "edges.npz")
    depth = run.depth()
    light = {"rows": 2, "cols": 3, "distance_m": 5.0, "signal_per_pulse": 1.0}
    edges = {"pixels": 64, "pulses": 5, "period_ticks": 8000}
    of_result = {"arrays": run.result, "config": run.config}
    arguments = {
        "Light": light,
        "Spad": {},
        "Timing": {},
        "Scene": {"name": "wall", "distance_m": WALL_M, "reflectivity": 0.4 + 0 * WALL_M},
        "Run": {"setup": run.setup},
        "bound": {"trials": 2},
        "estimate_depth": of_result,
        "events_table": {"arrays": run.result},
        "generate_edges": {
            "light": coincid.Light(**light),
            "spad": coincid.Spad(),
            "timing": coincid.Timing(),
            "pulses": 2,
            "seed": 1,
        },
        "load_config": {},
        "load_edges": {"path": folder / "edges.npz", **edges},
        "load_scene": {"source": str(folder / "wall.npy"), "rows": 8, "cols": 8},
        "parse_config": {"document": {}},
        "pixel_histogram": {**of_result, "pixel": 0},
        "point_cloud": {"depth": depth},
        "read_result": {"path": folder / "result.npz"},
        "replay": {"engine": "golden", "config": run.config, "edges": run.edges},
        "scene_light": {"scene": run.scene, "klux": 10.0},
        "simulate": {"scene": "flat:5", **SMALL},
        "write_ply": {"path": folder / "points.ply", "points": coincid.point_cloud(depth)},
        "write_result": {"path": folder / "again.npz", "arrays": run.result},
    }
    assert arguments.keys() == set(coincid.__all__) - NO_CALLS
    found = {name: (getattr(coincid, name), given) for name, given in arguments.items()}
    found["Arrivals"] = Arrivals, {"first": [0, 1], "start_s": [1e-9], "photons": [1.0]}
    found["Interferer"] = Interferer, {"photons_per_pulse": 1.0}
    found["Optics"] = Optics, {}
    found["Laser"] = Laser, {}
    found["View"] = View, {"h_deg": 45.0, "v_deg": 45.0}
    found["Pulse"] = Pulse, {"time_s": [-1e-10, 0, 1e-10], "density": [0.0, 1.0, 0.0]}
    write_edges(folder / "edges.ptu", run.edges, coincid.Timing())
    recording = read_recording(folder / "edges.ptu")
    arguments = {
        address: {"name": "status"},
        code_density: {"tick": np.arange(64), "phases": 32},
        edge_chunks: arguments["generate_edges"],
        expected_threshold: {"success": np.arange(7) / 7},
        link_budget: {"distance_m": 4.0, "reflectivity": 0.4, "klux": 50},
        pulse_ticks: {"config": run.config},
        read_recording: {"path": folder / "edges.ptu"},
        recorded_edges: {
            "recording": recording,
            "config": run.config,
            "timing": coincid.Timing(),
        },
        success_by_threshold: {
            "signal_per_pulse": 0.05,
            "noise_cps": 1e6,
            "distance_m": 8.0,
            "window_ticks": 16,
            "pulses": 100,
            "form": "literal",
        },
        write_edges: {
            "path": folder / "again.ptu",
            "edges": run.edges,
            "timing": coincid.Timing(),
        },
        Setup.of: {"sensor": {"rows": 8, "cols": 8}},
        Depth.of: {"depth_m": WALL_M},
        coincid.Light.from_scene: {"distance_m": WALL_M, "reflectivity": 0.4, "klux": 50},
        Emulator.of: {"config": coincid.load_config("emulator")},
    }
    return found | {
        function.__qualname__: (function, given) for function, given in arguments.items()
    }


METHODS = {  # of a run: arguments of a call that is right
    "__getitem__": {"measure": "events"},
    "alone": {"number": 0},
    "counters": {"number": 0},
    "depth": {},
    "frame": {},
    "frame_edges": {"number": 0},
    "histogram": {"pixel": 0},
    "light_of": {"frame": 0},
    "point_cloud": {},
    "result_of": {"number": 0},
    "seen_edges": {"number": 0},
}
ROOT = Path(__file__).parents[1]
PAGES = [ROOT / "README.md", *ROOT.glob("docs/*.md"), *ROOT.glob("examples/*.py")]
SHOWN = {  # names that pages import from the rooms of models and experiments
    name
    for page in PAGES
    for names in re.findall(
        r"^from coincid\.(?:model|lab)\.\S+ import (.+)$", page.read_text(encoding="utf-8"), re.M
    )
    for name in names.split(", ")
    if name.islower()
}
CLASSES = {
    *("Arrivals", "Interferer", "Laser", "Optics", "Pulse", "View"),
    *("Depth.of", "Emulator.of", "Light.from_scene", "Setup.of"),
}
FUNCTIONS = sorted(
    set(coincid.__all__) - NO_CALLS | CLASSES | {"address"} | SHOWN - IN_BLOCKS_OF_OTHERS
)


def arguments_of(name, function):
    """Return the names of the arguments that are tested."""
    kinds = inspect.Parameter.VAR_KEYWORD, inspect.Parameter.VAR_POSITIONAL
    named = [
        one.name for one in inspect.signature(function).parameters.values() if one.kind not in kinds
    ]
    names = dict.fromkeys([*named, *OPTIONS.get(name, ())])
    return [one for one in names if one not in PATHS and (name, one) not in NOT_CHECKED]


def try_all(name, function, given):
    function(**given)
    for argument in arguments_of(name, function):
        for value in ODD:
            with suppress(coincid.InputError):
                function(**given | {argument: value})


@pytest.mark.parametrize("name", FUNCTIONS)
def test_functions_refuse_odd_arguments_in_a_sentence(name, calls):
    try_all(name, *calls[name])


@pytest.mark.parametrize("name", METHODS)
def test_methods_of_a_run_refuse_odd_arguments_in_a_sentence(name, run):
    try_all(f"Run.{name}", getattr(run, name), METHODS[name])


@pytest.mark.parametrize("name", ["counters", "frame_edges", "light_of", "result_of"])
def test_frames_are_counted_from_the_end_if_negative_and_no_further(name, run):
    method = getattr(run, name)
    method(-1)
    for number in (1, -2):
        with pytest.raises(coincid.InputError, match=f"frame = {number}: must be .* from -1 to 0"):
            method(number)
