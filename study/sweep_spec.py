# SPDX-License-Identifier: Apache-2.0
"""Reads the points of a sweep from its SPEC file, and checks all of them before the first one runs.

A SPEC is a configuration file with additional keys: `SETTINGS`, `config` (a file or preset that its
tables extend), and [[axis]] tables. The keys of an axis vary together. The axes are crossed, and
the first one varies slowest.
"""

import math
import os
from collections.abc import Callable, Iterable
from functools import cache
from typing import Any

import numpy as np
from attrs import frozen

from ..lab.setup import Setup, for_pictures
from ..model.contract.config import parse_config, read_toml
from ..model.contract.preset_files import PRESETS
from ..model.depth.methods import DEFAULT_METHOD, method_names
from ..model.light.light import BACKGROUNDS
from ..model.light.timing import Timing
from ..model.scenes.ambient import ambient_klux
from ..model.scenes.catalogue import load_scene
from ..model.scenes.scene import Scene
from ..model.shared.errors import SEED_MAX, InputError, check_integer, out_of_range
from ..model.shared.files import FilePath
from ..model.shared.quantities import check_choice, check_real, check_switch
from .simulate import settings_of

TABLES = ("sensor", "frame", "subgroup")  # tables of the configuration whose keys may be swept
SETTINGS = {  # of a point, in addition to its configuration, with their defaults
    "scene": "five-objects",
    "klux": 50.0,
    "background": BACKGROUNDS[0],
    "seed": 1,
    "engine": "golden",
    "method": DEFAULT_METHOD,
    "spad_gate": False,
}
# the same key; a SPEC may also write it outside its table
CLOCK, FRAME_CLOCK = "clock_mhz", "frame.clock_mhz"
ENGINES = ("golden", "sliced")
POINTS_MAX = 100_000


@frozen(kw_only=True, eq=False)
class Point:
    """One point of the grid. name, values: of the swept keys. at: its index along each axis.

    settings: everything that defines the point, as tables of a file. setup: the same, checked.
    """

    name: str
    values: dict[str, Any]
    at: tuple[int, ...]
    settings: dict[str, Any]
    setup: Setup

    @property
    def key(self) -> str:
        """Digest of everything that the measures depend on."""
        return self.setup.key


@frozen(eq=False)
class Spec:
    """A SPEC file. base: its document without the axes, `config` resolved. axes: lists of values by
    key. points: in order.
    """

    base: dict[str, Any]
    axes: list[dict[str, list[Any]]]
    points: list[Point]

    @property
    def keys(self) -> dict[str, Point]:
        """Return the points by key; points with the same content are one, and run once."""
        return {point.key: point for point in reversed(self.points)}


def read_spec(path: FilePath) -> Spec:
    """Read and check a SPEC file. Raises `InputError` with the point, its field and the legal
    range.
    """
    try:
        # a SPEC is no configuration: `read_toml` would offer the presets
        if not os.path.exists(path):
            raise InputError("no such file")
        document = read_toml(path)
        axes = _axes(document.pop("axis", []))
        _place_clock(document)
        base = _resolved(document)
        scenes = cache(load_scene)
        points = [
            _point(document, axes, at, scenes)
            for at in np.ndindex(*(_length(axis) for axis in axes))
        ]
    except InputError as error:
        raise error.within(path) from None
    return Spec(base, axes, points)


def _axes(tables: object) -> list[dict[str, list[Any]]]:
    """Return the [[axis]] tables as lists of values by key, such as `subgroup.threshold` or
    `klux`.
    """
    if not isinstance(tables, list) or not all(isinstance(table, dict) for table in tables):
        raise InputError("axis: must be written as [[axis]]")
    axes: list[dict[str, list[Any]]] = []
    for number, table in enumerate(tables):
        axis = _axis(number, table)
        if not axis:
            raise InputError(f"axis[{number}]: is empty, must name what it sweeps")
        for name, values in axis.items():
            where = f"axis[{number}].{name}"
            alone = (*SETTINGS, CLOCK, "config")
            if name not in alone and name.partition(".")[0] not in TABLES or name in TABLES:
                legal = ", ".join((*alone, *(f"{table}.KEY" for table in TABLES)))
                raise InputError(f"{where}: cannot be swept, must be one of {legal}")
            if any(
                _placed(name) in map(_placed, other)
                for other in (*axes, [one for one in axis if one != name])
            ):
                raise InputError(f"{where}: is swept by another axis")
            if not isinstance(values, list) or not values:
                raise InputError(f"{where} = {values!r}: must be a list of values")
            if len(values) != _length(axis):
                raise InputError(
                    f"{where}: has {len(values)} values, must have as many as {next(iter(axis))}: {_length(axis)}"
                )
        seen = list(map(repr, zip(*axis.values(), strict=True)))
        for i, value in enumerate(seen):
            if value in seen[:i]:
                shown = ", ".join(f"{name} = {values[i]!r}" for name, values in axis.items())
                raise InputError(f"axis[{number}]: {shown} comes twice")
        axes.append(axis)
    _check_points(math.prod(map(_length, axes)))
    return axes


def _axis(number: int, table: dict[str, Any]) -> dict[str, Any]:
    """Return what an [[axis]] table gives by key. Raises `InputError` if it gives a key twice, as
    `sensor.rows` and `"sensor.rows"`.
    """
    axis: dict[str, Any] = {}
    for name, values in table.items():
        nested = name in TABLES and isinstance(values, dict)
        inner: Iterable[tuple[str | None, Any]] = values.items() if nested else [(None, values)]
        for key, listed in inner:
            swept = f"{name}.{key}" if key else name
            if swept in axis:
                raise InputError(f"axis[{number}].{swept}: is given twice")
            axis[swept] = listed
    return axis


def _check_points(total: int) -> None:
    """Raise `InputError` if a grid has no points, or too many."""
    if not 1 <= total <= POINTS_MAX:
        raise out_of_range("points of the grid", total, 1, POINTS_MAX)


def _placed(name: str) -> str:
    """Return a key with its table."""
    return FRAME_CLOCK if name == CLOCK else name


def _place_clock(document: dict[str, Any]) -> None:
    """Move the clock of a document into its table."""
    if CLOCK in document and isinstance(frame := document.setdefault("frame", {}), dict):
        if CLOCK in frame:
            raise InputError(f"{CLOCK}: {FRAME_CLOCK} is given, too, must be one of them")
        document["frame"] = frame | {CLOCK: document.pop(CLOCK)}


def _length(axis: dict[str, list[Any]]) -> int:
    return len(next(iter(axis.values())))


def _resolved(document: dict[str, Any]) -> dict[str, Any]:
    """Return `document` with the tables of its `config`. Its own keys replace those of the file;
    its own lists follow those of the file.
    """
    document = dict(document)
    given = document.pop("config", None)
    if given is None:
        return document
    below = _configuration(given)
    for name, value in below.items():
        both = (value, document.get(name))
        if all(isinstance(part, dict) for part in both):
            document[name] = value | both[1]
        elif all(isinstance(part, list) for part in both):
            document[name] = value + both[1]
        else:
            document.setdefault(name, value)
    return document


@cache
def _configuration(given: str) -> dict[str, Any]:
    if not isinstance(given, str):
        raise InputError(
            f"config = {given!r}: must be the name of a file or one of {', '.join(PRESETS)}"
        )
    try:
        return read_toml(PRESETS.get(given, given))
    except InputError as error:
        raise error.within(f"config = {given!r}") from None


def _point(
    document: dict[str, Any],
    axes: list[dict[str, list[Any]]],
    at: tuple[int, ...],
    scenes: Callable[..., Scene],
) -> Point:
    """Return the checked point of `document` at an index along each axis. scenes: a `load_scene`
    with a cache.
    """
    document, values = (
        dict(document),
        {
            name: listed[i]
            for axis, i in zip(axes, at, strict=True)
            for name, listed in axis.items()
        },
    )
    for name, value in values.items():
        table, dot, key = _placed(name).partition(".")
        if not dot:
            document[name] = value
        elif isinstance(
            document.setdefault(table, {}), dict
        ):  # otherwise `parse_config` reports the error
            document[table] = document[table] | {key: value}
    name = " ".join(f"{name}={_shown(value)}" for name, value in values.items()) or "the only point"
    try:
        document = _resolved(document)
        settings = _settings(
            {name: document.pop(name, default) for name, default in SETTINGS.items()}
        )
        for unknown, value in document.items():
            # `parse_config` reports tables that it does not know
            if unknown not in (*TABLES, "override") and not isinstance(value, dict):
                legal = ", ".join(("config", *SETTINGS, CLOCK))
                raise InputError(
                    f"{unknown}: unknown setting, must be one of {legal}", field=unknown
                )
        config = parse_config(document)
        config.check_map()
        range_m = Timing.from_config(config).range_m
        scene = scenes(settings["scene"], config.sensor.rows, config.sensor.cols, range_m=range_m)
        config = for_pictures(config, scene)
        setup = Setup(
            config=config,
            scene=scene,
            klux=ambient_klux(settings["klux"], scene.rows, scene.cols),
            estimators=(settings["method"],),
            **{key: settings[key] for key in ("background", "spad_gate", "seed", "engine")},
        )
        setup.photons.check()
    except InputError as error:
        raise error.within(f"point {name}") from None
    settings["configuration"] = settings_of(config)
    values = values | {key: settings[key] for key in values if key in SETTINGS}
    return Point(name=name, values=values, at=at, settings=settings, setup=setup)


def _settings(given: dict[str, Any]) -> dict[str, Any]:
    """Return the checked values of `SETTINGS`, each of one type."""
    if not isinstance(given["scene"], str):
        raise InputError(f"scene = {given['scene']!r}: must be a string")
    check_switch("spad_gate", given["spad_gate"])
    return given | {
        "klux": given["klux"]
        if isinstance(given["klux"], str)
        else check_real("klux", given["klux"], 0),
        "background": check_choice("background", given["background"], BACKGROUNDS),
        "seed": check_integer("seed", given["seed"], 0, SEED_MAX),
        "engine": check_choice("engine", given["engine"], ENGINES),
        "method": check_choice("method", given["method"], method_names()),
    }


def _shown(value: object) -> str:
    return format(value, "g") if isinstance(value, float) else str(value).replace(" ", "")
