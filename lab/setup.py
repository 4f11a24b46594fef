# SPDX-License-Identifier: Apache-2.0
"""Setups of experiments: scene, light, detector, configuration, engine and estimators. Nothing is
computed here.
"""

from collections.abc import Callable, Iterator, Mapping
from functools import cache, cached_property
from importlib.metadata import version
from types import NoneType
from typing import TYPE_CHECKING, Any

import numpy as np
from attrs import Attribute, evolve, field, fields_dict, frozen, has

from .. import __version__
from ..model.contract.config import SETTINGS, Config, parse_config
from ..model.contract.edges import Edges
from ..model.contract.parameters import SENSOR, Sensor
from ..model.contract.settings import THRESHOLD_MAX
from ..model.depth.methods import DEFAULT_METHOD, Method, check_counting, taken_along
from ..model.light.light import BACKGROUNDS, Light
from ..model.light.photons import edge_chunks, edges_at_most
from ..model.light.spad import Spad, SpadGate
from ..model.light.timing import Timing
from ..model.scenes.ambient import Ambient, ambient_klux
from ..model.scenes.catalogue import load_scene
from ..model.scenes.recorded_light import RecordedLight
from ..model.scenes.scene import Scene, scene_light
from ..model.shared.arguments import check_kind
from ..model.shared.errors import SEED_MAX, InputError
from ..model.shared.own_part import OwnPart
from ..model.shared.pulse import Pulse, pulse_of
from ..model.shared.quantities import Numbers, check_choice, check_switch, integer, shape_of
from ..model.shared.sources import digest, sources_digest
from ..tb.engines import ENGINES
from ..tb.replay import DEFAULT_VIEW

if TYPE_CHECKING:
    from ..hdl.front_end_views import View

SETTLING = 7  # frames of new photons under the controller before the one that counts
# gets stage, its finished share, and edges so far; raises to end a run
Watch = Callable[[str, float, int], None]


def unwatched(stage: str, share: float, edges: int) -> None:
    """Ignore the progress of a run."""


@frozen(kw_only=True, eq=False)
class PhotonInputs:
    """Everything that the avalanches depend on, and nothing else; for example no thresholds,
    formats and FIFOs.
    """

    light: Light
    spad: Spad
    timing: Timing
    pulses: int  # of all frames
    seed: int
    gate: SpadGate | None
    later: tuple[Light, ...] = ()  # of the frames after the first one; empty: `light` in all

    @property
    def key(self) -> str:
        """Digest of the content: equal keys mean equal edges."""
        return fingerprint(self)

    @property
    def lights(self) -> tuple[Light, ...]:
        """The light of each frame, or the one light of all frames."""
        return (self.light, *self.later)

    def _parts(self) -> Iterator[dict[str, Any]]:
        """Yield arguments of `edge_chunks`: for each light its pulses. SPADs begin each part
        ready.
        """
        pulses = self.pulses // len(self.lights)
        shared = _fields(self)
        del shared["later"]
        for number, light in enumerate(self.lights):
            own = {"light": light, "pulses": pulses, "pulse_start": number * pulses}
            yield shared | own

    def check(self) -> None:
        """Raise `InputError` if a value is out of range; generate nothing."""
        for part in self._parts():
            edge_chunks(**part)

    @property
    def edges_at_most(self) -> float:
        """Upper estimate of the number of edges."""
        return sum(
            part["pulses"]
            * edges_at_most(part["light"], part["spad"], part["timing"], part["gate"])
            for part in self._parts()
        )

    def chunks(self, workers: int = 1) -> Iterator[Edges]:
        """Generate the edges in chunks of whole pulses. workers: number of threads, which does not
        change the edges.
        """
        for part in self._parts():
            yield from edge_chunks(**part, workers=workers)

    def edges(self, workers: int = 1, watch: Watch = unwatched) -> Edges:
        """Generate all edges. workers: as in `chunks`."""
        chunks, made, done = [], 0, 0.0
        for chunk in self.chunks(workers):
            chunks.append(chunk)
            made += len(chunk)
            if len(chunk):  # a dark one does not tell how far it goes
                done = float(chunk.pulse[-1] + 1) / self.pulses
            watch("photons", done, made)
        return Edges.joined(chunks)


@frozen(kw_only=True, eq=False)
class Setup:
    """One experiment. It may begin at the scene, at the light, or at the edges.

    Attributes
    ----------
    config : Config
        The sensor, its frames and settings.
    scene : Scene or None
        The surfaces that the pixels see, and the truth with which depth is compared. If it moves,
        frame k sees its picture k.
    klux, background
        Ambient light on the scene; see `scene_light`.
    light : Light or None
        Light of every pixel, instead of `klux` and `background`.
    pulse : Pulse or None
        Measured shape of laser pulse and jitter together, instead of a Gaussian; also as an array
        or a file (`pulse_of`). Recorded histograms have the shape of their recording, so for them,
        only the estimators use it. A `light` has its own.
    spad : Spad
        The detector.
    spad_gate : bool
        Whether the gate switches the SPADs off, instead of ignoring their edges.
    seed : int
        Seed of the photons.
    edges : Edges or None
        Avalanches of all frames, instead of scene, light, detector and seed.
    engine : str
        The engine that plays the sensor; see `tb.replay`.
    view : str or View
        Front end of the RTL; see `tb.replay`.
    estimators : tuple of str or Estimator
        METHOD or METHOD/SOURCE of `estimate_depth`, or estimators of your own, which a registered name becomes here;
        measures use the first one. If empty, there is no depth. In the format `counts`, only `planes`
        and estimators of your own.
    """

    config: Config
    scene: Scene | None = None
    klux: Ambient = 50.0
    background: str = BACKGROUNDS[0]
    light: Light | None = None
    pulse: Pulse | None = field(default=None, converter=pulse_of)
    spad: Spad = field(factory=Spad)
    spad_gate: bool = False
    seed: int = integer(1, 0, SEED_MAX)
    edges: Edges | None = None
    engine: str = "golden"
    view: "str | View" = DEFAULT_VIEW
    estimators: tuple[Method, ...] = field(default=(DEFAULT_METHOD,), converter=taken_along)

    def __attrs_post_init__(self) -> None:
        if self.light is not None and self.pulse is not None:
            raise InputError("pulse: goes with a scene, a Light has its own", field="pulse")
        check_kind("config", self.config, Config)
        check_kind("scene", self.scene, Scene, NoneType)
        check_kind("light", self.light, Light, NoneType)
        check_kind("spad", self.spad, Spad)
        check_kind("edges", self.edges, Edges, NoneType)
        check_choice("engine", self.engine, ENGINES)
        check_choice("background", self.background, BACKGROUNDS)
        check_switch("spad_gate", self.spad_gate)
        if self.config.counting:
            for one in self.estimators:
                if isinstance(one, str):
                    check_counting(one.partition("/")[0])

    @classmethod
    def of(
        cls,
        scene: Scene | str | np.ndarray | None = None,
        *,
        sensor: dict[str, Any] | None = None,
        frame: dict[str, Any] | None = None,
        subgroup: dict[str, Any] | None = None,
        **fields: Any,
    ) -> "Setup":
        """Return the setup for a scene, its name or its distances, with the tables of a
        configuration file. Raises `InputError`.
        """
        config = parse_config(
            {
                "sensor": {} if sensor is None else sensor,
                "frame": {} if frame is None else frame,
                "subgroup": {} if subgroup is None else subgroup,
            }
        )
        seen = None if scene is None else scene_of(config, scene)
        if seen is not None:
            config = for_pictures(config, seen)
        return cls(config=config, scene=seen, **fields)

    def but(
        self,
        *,
        frame: dict[str, Any] | None = None,
        subgroup: dict[str, Any] | None = None,
        **fields: Any,
    ) -> "Setup":
        """Return a copy with other settings, given as tables of a configuration file, and with
        other fields. Raises `InputError`.
        """
        config: Config = fields.pop("config", self.config)
        tables = {"frame": frame or {}, "subgroup": subgroup or {}}
        for name in fields:
            if name not in fields_dict(Setup):
                raise _unknown_field(name)
        return evolve(self, config=with_tables(config, tables), **fields)

    @property
    def seen(self) -> Scene:
        """The scene, of a setup that begins there."""
        assert self.scene is not None, "a setup without a scene has no truth"
        return self.scene

    @cached_property
    def photons(self) -> PhotonInputs:
        """The photons of all frames. Raises `InputError`."""
        frames = self.config.frames
        if self.light is not None:
            lights = [self.light]
        elif self.seen.later:
            lights = [self._light_of(self.seen.at(frame)) for frame in range(frames)]
        else:
            lights = [self._light_of(self.seen)]
        return PhotonInputs(
            light=lights[0],
            later=tuple(lights[1:]),
            spad=self.spad,
            timing=Timing.from_config(self.config),
            pulses=frames * self.config.pulses,
            seed=self.seed,
            gate=SpadGate.from_config(self.config) if self.spad_gate else None,
        )

    def _light_of(self, scene: Scene) -> Light:
        shape: dict[str, Any] = {}
        if isinstance(scene.transient, RecordedLight):  # their shape is that of the recording
            shape["system_fwhm_s"] = self.spad.jitter_fwhm_s
        else:
            shape["pulse"] = self.pulse
        return scene_light(scene, self.klux, background=self.background, **shape)

    @cached_property
    def key(self) -> str:
        """Digest of everything that the outcome depends on, including the sources of the
        project.
        """
        return fingerprint(self, self._file_of_klux, versions(self.engine))

    @property
    def _file_of_klux(self) -> Numbers | None:
        """The light of a text, which may name a file whose content changes. None for numbers and
        arrays, and if it cannot be read, of which a run tells.
        """
        if not isinstance(self.klux, str) or self.scene is None:
            return None
        try:
            return ambient_klux(self.klux, self.scene.rows, self.scene.cols)
        except InputError:
            return None


def _unknown_field(name: str) -> InputError:
    """Return the error for a name that is no field of a setup; a setting is told its table."""
    if name in SENSOR:
        message = f"{name}: is a parameter of the sensor, given as config=config.with_sensor(...)"
    elif name in SETTINGS:
        table = SETTINGS[name].table
        message = f'{name}: is a setting of [{table}], given as {table}={{"{name}": ...}}'
    else:
        known = ", ".join(("frame", "subgroup", *fields_dict(Setup)))
        message = f"{name}: unknown field, must be one of {known}"
    return InputError(message, field=name)


def scene_of(config: Config, source: Scene | str | np.ndarray, **options: Any) -> Scene:
    """Return the scene that `load_scene` makes from `source` and `options` for the pixels of a
    configuration.
    """
    if isinstance(source, Scene):
        return source
    sensor = config.sensor
    return load_scene(
        source, sensor.rows, sensor.cols, range_m=Timing.from_config(config).range_m, **options
    )


def for_pictures(config: Config, scene: Scene) -> Config:
    """Return a configuration with a frame for each picture of a moving scene, unless it gives a
    number of frames.
    """
    if not scene.later or "frame.frames" in config.given:
        return config
    return config.with_frame(frames=scene.pictures)


def with_tables(config: Config, tables: Mapping[str, Mapping[str, Any]]) -> Config:
    """Return a copy of a configuration with other settings, given as tables of a configuration
    file. They are checked together. Raises `InputError`.

    A list or an array in the table `subgroup` gives one value per subgroup.
    """
    if not any(tables.values()):
        return config
    document = config.written()
    own = set(config.own_settings())
    several = {}
    for table, settings in tables.items():
        for name, value in settings.items():
            own.discard(name)
            if table == "subgroup" and shape_of(f"{table}.{name}", value):
                several[name] = value
            else:
                document[table][name] = value
    for name in (*own, *several):
        document["subgroup"].pop(name, None)
    return parse_config(document).keeping(config, own, **several)


def seeded(setup: Setup, seeds: int) -> list[Setup]:
    """Return copies of a setup, with the seeds from 1 on."""
    return [setup.but(seed=seed + 1) for seed in range(seeds)]


def fixed_thresholds(sensor: Sensor) -> range:
    """Return the thresholds among which the controller chooses."""
    return range(1, min(THRESHOLD_MAX, sensor.pixels) + 1)


@cache
def versions(engine: str) -> dict[str, str]:
    """Return the versions on which an engine's numbers depend. `code` is a digest of the sources
    that compute them.
    """
    code = sources_digest(
        "model", "lab", *(() if engine == "golden" else ("hdl", "host", "slices", "tb", "tools"))
    )
    return {"coincid": __version__, "code": code} | {
        name: version(name) for name in ("numba", "numpy", "scipy")
    }


def fingerprint(*values: Any) -> str:
    """Return a digest of the content of nested attrs classes, arrays, containers and plain values.

    A part of a user's own counts by its class, name and version, and by its fields if it is an attrs class.
    """
    parts: list[str | bytes] = []
    pending = list(values)
    while pending:
        value = pending.pop()
        if isinstance(value, np.generic):
            value = value.item()
        if isinstance(value, np.ndarray):
            parts += [f"{value.dtype} {value.shape}", np.ascontiguousarray(value).tobytes()]
            continue
        inner: list[Any] = []
        if isinstance(value, OwnPart):
            inner = [type(value).__qualname__, value.name, value.version, *_part_fields(value)]
        elif has(type(value)):
            inner = list(_fields(value).values())
        elif isinstance(value, dict):
            inner = [each for pair in sorted(value.items()) for each in pair]
        elif isinstance(value, list | tuple):
            inner = list(value)
        else:
            assert value is None or isinstance(value, bool | int | float | str), (
                f"{type(value)}: unknown content"
            )
        parts.append(f"{type(value).__qualname__} {len(inner)}" if inner else repr(value))
        pending += inner
    return digest(*parts)


def _part_fields(part: OwnPart) -> list[Any]:
    """Return the values of the fields of a part that is an attrs class."""
    return list(_fields(part).values()) if has(type(part)) else []


def _fields(value: Any) -> dict[str, Any]:
    """Return the fields that count when instances are compared."""
    attributes: tuple[Attribute[Any], ...] = type(value).__attrs_attrs__
    return {each.name: getattr(value, each.name) for each in attributes if each.eq}
