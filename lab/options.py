# SPDX-License-Identifier: Apache-2.0
"""The options of an experiment in one table, which the help of the commands, the docstring of
`simulate` and the explorer share.

The settings of the configuration are in its own tables (`SETTINGS`). `Setup` holds the chosen
values. This file imports nothing that takes time, because the help of a command must appear
immediately.
"""

from collections.abc import Callable
from inspect import cleandoc, signature
from typing import Any, TypeVar

from attrs import frozen

from ..model.scenes.conventions import CONVENTIONS, DEPTH_FILES_TOLD, UNIT_FORMS
from ..model.shared.errors import SEED_MAX

_Function = TypeVar("_Function", bound=Callable[..., Any])


@frozen(kw_only=True)
class Option:
    """An option. kind: its type in documents; metavar: its value in the command's help; low, high:
    range of a number.
    """

    name: str
    doc: str
    kind: str
    metavar: str = ""
    default: Any = None
    low: float = 0
    high: float = 1


_SCENES = (
    "five-objects, letter-f, flat:METRES,REFLECTIVITY, two-targets:NEAR,FAR, two-returns:NEAR,FAR, "
    "returns:METRES@REFLECTIVITY,..., sun-and-shade, tunnel"
)
_RAYS = "ray:five-objects, ray:glass, ray:corner, ray:retroreflector, ray:fog"
_DATA_SETS = "; ".join(f"{one.name} ({one.files}: {one.told})" for one in CONVENTIONS)
_ALL = (
    Option(
        name="scene", kind="Scene, str or numpy.ndarray", metavar="SCENE", default="five-objects",
        doc=f"Built in: {_SCENES}; a depth file ({DEPTH_FILES_TOLD}; FILE:NAME for an array of the last three), "
        "with a colour picture for the reflectivities as DEPTH,COLOUR; "
        "a folder of them, or a pattern such as depth_%04d.png, for a scene that moves from frame to frame; "
        f"ray-traced: {_RAYS}, or a Mitsuba scene (XML, metres).",
    ),
    Option(
        name="unit", kind="str or None", metavar="UNIT",
        doc=f"Unit of a depth file: {UNIT_FORMS}; default: metres for floats, millimetres for integers. Data sets: {_DATA_SETS}.",
    ),
    Option(
        name="scale", kind="float", metavar="FACTOR", default=1.0, low=1e-3, high=1e3,
        doc="Factor for the distances of a depth file.",
    ),
    Option(
        name="missing", kind="float, sequence of float or None", metavar="VALUE",
        doc="A number in a depth file that means no depth, besides 0, NaN, infinity, 65504, 65535 and the limits of integers.",
    ),
    Option(
        name="sky_m", kind="float or None", metavar="DISTANCE",
        doc="Distance in a depth file, in metres before the scale, from which on there is nothing to see.",
    ),
    Option(
        name="z", kind="bool", default=False,
        doc="Distances of a depth file are along the axis (z), as of depth cameras and most renderers, not along the rays of the pixels.",
    ),
    Option(
        name="fov_deg", kind="float or None", metavar="DEGREES",
        doc="Horizontal field of view of the whole picture of a depth file. By default, the part that the sensor sees has the sensor's.",
    ),
    Option(
        name="channel", kind="str or None", metavar="NAME",
        doc="Channel of a depth picture that has several, such as an EXR file; by default the one that is called depth or Z.",
    ),
    Option(
        name="bin_ps", kind="float or None", metavar="PS",
        doc="The file holds no depth but histograms of photons, rows x cols x bins (NPY, NPZ, HDF5, MATLAB), with bins of this width in ps.",
    ),
    Option(
        name="recorded_pulses", kind="int or None", metavar="N",
        doc="Laser pulses whose photons these histograms count; default: they are scaled to the light for which the sensor is made.",
    ),
    Option(
        name="reflectivity", kind="float or numpy.ndarray", metavar="SHARE", default=0.4,
        doc="Reflectivity of all surfaces of a depth file without a colour picture, 0 to 1.",
    ),
    Option(
        name="klux", kind="float, numpy.ndarray, str or None", metavar="KLUX",
        doc="Ambient light in klux: a number; LEFT|RIGHT for the two halves of the picture; or a map, FILE.npy or PICTURE,WHITE_KLUX (grey). "
        "Default: 100 for sun-and-shade and tunnel, 0 for histograms, otherwise 50.",
    ),
    Option(
        name="background", kind="str", metavar="LAW", default="reflected",
        doc="Background light: reflected (in proportion to each surface's reflectivity) or even.",
    ),
    Option(
        name="pulse", kind="Pulse, numpy.ndarray, str or None", metavar="FILE",
        doc="Measured shape of the pulse, of laser and detector together: CSV (time_ps,density) or NPY (these two columns). "
        "Default: a Gaussian of 500 ps.",
    ),
    Option(name="seed", kind="int", default=1, high=SEED_MAX, doc="Seed of the photons."),
    Option(
        name="spad", kind="Spad or None", metavar="NAME=VALUE",
        doc="A property of the SPADs instead of the paper's value, such as dead_time_s=20e-9; the API reference lists them under Spad.",
    ),
    Option(
        name="spad_gate", kind="bool", default=False,
        doc="Gating switches the SPADs off outside the gate. By default they stay on, and their edges are ignored.",
    ),
    Option(
        name="engine", kind="str", metavar="ENGINE", default="golden",
        doc="golden (model), sliced (RTL, the fast engine), verilator, icarus (whole RTL under cocotb).",
    ),
    Option(
        name="view", kind="str", metavar="VIEW", default="polyphase",
        doc="Front end of the RTL: polyphase (synchronous), or async (asynchronous, with SPAD edges to the picosecond; verilator and icarus only).",
    ),
    Option(
        name="method", kind="str or Estimator", metavar="METHOD", default="planes",
        doc="Estimator of the distances: METHOD or METHOD/SOURCE, as in estimate_depth, or one of your own.",
    ),
)  # fmt: skip
OPTIONS = {option.name: option for option in _ALL}


def documented(function: _Function) -> _Function:
    """Replace `{options}` in a function's docstring by those of its parameters that are in the
    table.
    """
    told = (OPTIONS[name] for name in signature(function).parameters if name in OPTIONS)
    text = "\n".join(f"{option.name} : {option.kind}\n    {option.doc}" for option in told)
    function.__doc__ = cleandoc(function.__doc__ or "").replace("{options}", text)
    return function
