# SPDX-License-Identifier: Apache-2.0
"""Every argument of the library's functions has an effect: another value gives another result. No
function of any room leaves an argument unread, and none takes the setting of the first subgroup for
that of all.

An argument that a function takes and forgets gives no error. `test_option_words.py` does the same
for the command line.
"""

import ast
from functools import cache
from inspect import signature
from pathlib import Path

import numpy as np
import pytest
from attrs import astuple, has

import coincid
from coincid.model.contract.settings import SUBGROUP
from coincid.model.light.link_budget import Optics
from coincid.model.light.photons import edge_chunks
from coincid.model.light.spad import SpadGate
from coincid.model.shared.pulse import Pulse

SHAPE = (8, 8)
SIZE = {"rows": 8, "cols": 8}
SETTINGS = SIZE | {"pulses": 40}
LATE = Pulse(time_s=[-1e-10, 0, 1e-10, 3e-9], density=[0, 1, 1, 0])
# Arguments with tests of their own: engines, views, workers and chunks leave the result as it is, and
# channels and colours are those of files, which tests/scenes/test_brought_files.py makes.
ELSEWHERE = {
    "simulate": {"engine", "view", "channel"},
    "load_scene": {"channel", "colour"},
    "estimate_depth": {"workers"},
    "generate_edges": {"workers", "chunk_pulses"},
}
# The one whose arguments a function passes on.
FUNCTIONS = {"generate_edges": edge_chunks}


def picture():
    """Return distances of which one is what some cameras write for `no depth`, and one is far."""
    distance_m = np.tile(np.linspace(4, 6, 8), (8, 1))
    distance_m[2, 3] = 7.0
    distance_m[5, 1] = 60.0
    return distance_m


def scene(nearer_m=0.0):
    return coincid.load_scene(picture() - nearer_m, *SHAPE)


def recorded():
    """Return histograms, int64[rows, cols, bins], each with a peak."""
    counts = np.ones((*SHAPE, 200), np.int64)
    counts[:, :, 60] = 400
    return counts


@cache
def run():
    """Return a run of two frames with minigroup records."""
    return coincid.simulate(
        scene="five-objects", frames=2, minigroup_records=True, klux=20.0, **SETTINGS
    )


def result():
    """Return the arguments that say what an estimator reads."""
    return {"arrays": run().result, "config": run().config}


def scene_arguments(source):
    """Return, for each argument that says what a scene is, a call without it and one with it."""
    array = {source: picture()}
    counts = {source: recorded(), "bin_ps": 500.0, "recorded_pulses": 500}
    return {
        source: (array, {source: picture() + 1}),
        "scale": (array, {"scale": 2.0}),
        "unit": (array, {"unit": "1/2"}),
        "missing": (array, {"missing": 7.0}),
        "sky_m": (array, {"sky_m": 50.0}),
        "z": (array, {"z": True}),
        "fov_deg": (array | {"z": True}, {"fov_deg": 80.0}),
        "reflectivity": (array, {"reflectivity": 0.1}),
        "bin_ps": (counts, {"bin_ps": 250.0}),
        "recorded_pulses": (counts, {"recorded_pulses": 5000}),
    }


def simulate_arguments():
    array = {"scene": picture()}
    return scene_arguments("scene") | {
        "config": (
            array,
            {"config": coincid.parse_config({"sensor": SIZE | {"phases": 16}})},
        ),
        "klux": (array, {"klux": 90.0}),
        "background": (array | {"reflectivity": 0.1}, {"background": "even"}),
        "pulse": (array, {"pulse": LATE}),
        "seed": (array, {"seed": 2}),
        "spad": (array, {"spad": coincid.Spad(dead_time_s=1e-6)}),
        "spad_gate": (
            array | {"gating": True, "gate_start": 10, "gate_len": 20},
            {"spad_gate": True},
        ),
        "method": (array, {"method": "maximum"}),
        "settings": (array, {"threshold": 3}),
    }


def depth_arguments():
    at = result()
    later = run().result | {"stamp": run().result["stamp"] + 5}
    return {
        "arrays": (at, {"arrays": later}),
        "config": (at, {"config": run().config.with_frame(clock_mhz=400.0)}),
        "frame": (at, {"frame": 1}),
        "system_fwhm_s": (at, {"system_fwhm_s": 2e-9}),
        "pulse": (at, {"pulse": LATE}),
    }


def light_arguments():
    at = {
        "light": coincid.scene_light(scene(), 20.0),
        "spad": coincid.Spad(),
        "timing": coincid.Timing(),
        "pulses": 20,
        "seed": 1,
    }
    gate = SpadGate(start_cycles=10, len_cycles=20)
    return {
        "light": (at, {"light": coincid.scene_light(scene(), 90.0)}),
        "spad": (at, {"spad": coincid.Spad(dead_time_s=1e-6)}),
        "timing": (at, {"timing": coincid.Timing(phases=16)}),
        "pulses": (at, {"pulses": 21}),
        "seed": (at, {"seed": 2}),
        "pulse_start": (at, {"pulse_start": 5}),
        "gate": (at, {"gate": gate}),
    }


def load_arguments():
    at = {"source": "five-objects"}
    return scene_arguments("source") | {
        "rows": (at, {"rows": 16}),
        "cols": (at, {"cols": 16}),
        "range_m": ({"source": picture()}, {"range_m": 20.0}),
    }


def estimate_arguments():
    at = result()
    return depth_arguments() | {
        "method": (at, {"method": "matched"}),
        "source": (at | {"method": "maximum"}, {"source": "minigroup"}),
        "returns": (at, {"returns": 2}),
    }


def histogram_arguments():
    at = result()
    return depth_arguments() | {
        "pixel": (at, {"pixel": 9}),
        "source": (at, {"source": "minigroup"}),
    }


def bound_arguments():
    wall = {"klux": 20.0, "trials": 100}
    return {
        "config": (wall, {"config": run().config.with_settings(threshold=3)}),
        "distance_m": (wall, {"distance_m": 4.0}),
        "reflectivity": (wall, {"reflectivity": 0.1}),
        "klux": (wall, {"klux": 90.0}),
        "system_fwhm_s": (wall, {"system_fwhm_s": 1e-9}),
        "pulse": (wall, {"pulse": LATE}),
        "trials": (wall | {"distance_m": 30.0, "pulses": 10}, {"trials": 200}),
        "settings": (wall, {"threshold": 3}),
    }


def cloud_arguments():
    at = {"depth": run().depth()}
    return {
        "depth": (at, {"depth": run().depth("maximum")}),
        "optics": (at, {"optics": Optics(fov_h_deg=90.0)}),
        "normals": (at, {"normals": True}),
    }


def scene_light_arguments():
    at = {"scene": scene(), "klux": 20.0}
    return {
        "scene": (at, {"scene": scene(nearer_m=1.0)}),
        "klux": (at, {"klux": 9.0}),
        "others": (at, {"system_fwhm_s": 1e-9}),
    }


# For each function, its arguments with two calls each: only the second has the argument, or it has
# another value.
ARGUMENTS = {
    "simulate": simulate_arguments,
    "load_scene": load_arguments,
    "estimate_depth": estimate_arguments,
    "pixel_histogram": histogram_arguments,
    "generate_edges": light_arguments,
    "bound": bound_arguments,
    "point_cloud": cloud_arguments,
    "scene_light": scene_light_arguments,
}
# What each call has besides.
ALWAYS = {
    "simulate": SETTINGS,
    "load_scene": SIZE,
    "pixel_histogram": {"pixel": 3},
}


def of_run(run):
    return [*run.result.values(), *of_depth(run.depth()), *of_light(run.light)]


def of_scene(scene):
    return [scene.distance_m, *of_light(coincid.scene_light(scene, 20.0))]


def of_depth(depth):
    return [depth.depth_m, depth.signal_per_pulse, depth.confidence]


def of_edges(edges):
    return [edges.pulse, edges.pixel, edges.tick]


def of_light(light):
    return [light.distance_m, light.total_signal, light.background_cps, light.system_fwhm_s]


# The parts of a result that an argument may change.
PARTS = {
    "simulate": of_run,
    "load_scene": of_scene,
    "estimate_depth": of_depth,
    "pixel_histogram": lambda counts: [counts],
    "generate_edges": of_edges,
    "bound": astuple,
    "point_cloud": lambda points: [points],
    "scene_light": of_light,
}


def shown(name, result):
    """Return the result of a function as the shapes and bytes of its parts."""
    return [(np.shape(part), np.ascontiguousarray(part).tobytes()) for part in PARTS[name](result)]


def outcome(name, arguments):
    """Return the result of a call, as the shapes and bytes of its parts."""
    return shown(name, getattr(coincid, name)(**arguments))


@pytest.mark.parametrize("name", ARGUMENTS)
def test_each_argument_has_two_calls(name):
    of_function = set(signature(FUNCTIONS.get(name, getattr(coincid, name))).parameters)
    assert of_function - ELSEWHERE.get(name, set()) == set(ARGUMENTS[name]())


def arrays_in(value):
    """Yield the arrays of a value, of its elements and fields."""
    if isinstance(value, np.ndarray):
        yield value
    elif isinstance(value, dict):
        yield from arrays_in(list(value.values()))
    elif isinstance(value, list | tuple):
        for element in value:
            yield from arrays_in(element)
    elif has(type(value)):
        yield from arrays_in(astuple(value, recurse=False))


def overwrite(array):
    """Change an array, unless it is read-only."""
    if array.flags.writeable:
        zeros = np.zeros_like(array)
        array[...] = 1 if array.tobytes() == zeros.tobytes() else zeros


def alone(name, arguments):
    """Return the outcome of a call after which the caller overwrites its result. What was given must
    be as before, and so must be what the next call will return.
    """
    given = [array.tobytes() for array in arrays_in(arguments)]
    result = getattr(coincid, name)(**arguments)
    first = shown(name, result)
    for array in arrays_in([PARTS[name](result), result]):
        overwrite(array)
    assert given == [array.tobytes() for array in arrays_in(arguments)], "an argument has changed"
    return first


@pytest.mark.parametrize("name", ARGUMENTS)
def test_a_result_depends_on_each_argument_and_on_nothing_else(name):
    for argument, (usual, other) in ARGUMENTS[name]().items():
        usual = ALWAYS.get(name, {}) | usual
        one = alone(name, usual)
        assert one == outcome(name, usual), f"{argument}: not the same twice"
        assert one != outcome(name, usual | other), f"{argument}: has no effect"


ROOT = Path(__file__).parents[1]
ROOMS = "board flow formal hdl host lab model slices study tb tools src/coincid".split()
# Arguments that others prescribe, by the name of the function.
PRESCRIBED = {
    "elaborate": {"platform"},  # Amaranth
    "at": {"clock_mhz"},  # another view needs it
    "receive": {"stream"},  # transports without streams of their own
    "circuit": {"hits", "count", "threshold", "shape"},  # rules of coincidence
    "read_alone": {"number"},  # a sequence has more pictures than one
    "signs": {"threads"},  # of what is found in events
    "light": {"workers"},
    "_beats": {"stream"},  # the emulator has one stream
    "__array_finalize__": {"other"},  # NumPy
    "sample": {"ctx", "sample1"},  # Mitsuba
    "eval_pdf": {"ctx"},
    "_terminate": {"number", "frame"},  # of a signal
    "transform_first_chunk": {"finishing"},  # Tornado
    "counts_csv": {"frame"},  # what the explorer saves
    "events_csv": {"frame"},  # what the explorer saves
    "_library": {"root"},  # a part of the key under which it is kept
    "board_verilog": {"emulator"},  # a board
}


def is_empty(function):
    """Return whether a function only says what others do: its body has nothing but texts, `...`, and
    errors.
    """
    return all(
        isinstance(one, ast.Raise | ast.Pass)
        or (isinstance(one, ast.Expr) and isinstance(one.value, ast.Constant))
        for one in function.body
    )


def unread_arguments(function):
    """Return the names of a function's arguments that nothing in it reads."""
    given = function.args
    names = {one.arg for one in (*given.posonlyargs, *given.args, *given.kwonlyargs)}
    names |= {one.arg for one in (given.vararg, given.kwarg) if one is not None}
    read = {one.id for part in function.body for one in ast.walk(part) if isinstance(one, ast.Name)}
    return {name for name in names - read - {"self", "cls"} if not name.startswith("_")}


def code_of(room):
    """Yield the nodes of the syntax of a room's files, each with the name of its file."""
    for path in sorted((ROOT / room).rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            yield str(path.relative_to(ROOT)), node


@pytest.mark.parametrize("room", ROOMS)
def test_no_function_leaves_an_argument_unread(room):
    unread = [
        f"{file}: {node.name}({name})"
        for file, node in code_of(room)
        if isinstance(node, ast.FunctionDef) and not is_empty(node)
        for name in unread_arguments(node) - PRESCRIBED.get(node.name, set())
    ]
    assert not unread


CHECKS = {"check_integer", "check_real"}


def test_what_a_check_returns_is_used():
    """A number of NumPy becomes one of Python there, with which sums and products do not wrap."""
    dropped = {
        f"{file}: {ast.unparse(node)}"
        for room in ROOMS
        for file, node in code_of(room)
        if isinstance(node, ast.Expr)
        and isinstance(node.value, ast.Call)
        and isinstance(node.value.func, ast.Name)
        and node.value.func.id in CHECKS
    }
    assert not dropped


# Where all subgroups have the same settings.
ALIKE = {"lab/bound.py", "study/advise.py"}


def test_no_function_takes_the_setting_of_the_first_subgroup_for_that_of_all():
    found = {
        file
        for room in ROOMS
        for file, node in code_of(room)
        if isinstance(node, ast.Subscript)
        and isinstance(node.value, ast.Attribute)
        and node.value.attr in SUBGROUP
        and isinstance(node.slice, ast.Constant)
    }
    assert found == ALIKE
