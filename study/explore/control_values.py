# SPDX-License-Identifier: Apache-2.0
"""Converts the values of the controls to checked settings, and settings back to the text of a file,
a command or a link.
"""

import re
from math import isfinite
from pathlib import Path
from typing import Any
from urllib.parse import urlencode

import numpy as np
from attrs import evolve, frozen

from ...lab.setup import Setup
from ...model.contract.config import (
    SETTINGS,
    Config,
    frame_table,
    parse_config,
    sensor_table,
    toml_text,
)
from ...model.contract.settings import SUBGROUP
from ...model.contract.table import Kind
from ...model.light.light import NEAREST_M, Light
from ...model.light.spad import Spad
from ...model.light.timing import Timing
from ...model.scenes.catalogue import load_scene
from ...model.scenes.conventions import ARCHIVES, DEPTH_FILES_TOLD
from ...model.scenes.scene import REFLECTIVITY, Scene, scene_light
from ...model.shared.errors import InputError, check_integer, out_of_range, wrong_value
from ...model.shared.pulse import Pulse
from ...model.shared.quantities import check_choice, check_real
from .controls import CONTROL, CONTROLS, DEFAULTS, SCENES, UNITS, Control, Value
from .uploads import KINDS, USED_BY, Uploads

PIXEL_PULSES_MAX = 1 << 25  # pixels x pulses x frames: some ten seconds of work
PERCENT = 100
KILO = 1000
# a key of the configuration, as messages have it
_KEY = re.compile(r"\b(?:sensor|frame|subgroup)\.(\w+)")


@frozen(eq=False)
class Settings:
    """Checked settings. values: one for each of `CONTROLS`. uploads: files for the scene and its
    light.
    """

    values: dict[str, Any]
    uploads: Uploads
    config: Config
    timing: Timing
    spad: Spad

    @property
    def changed(self) -> dict[str, Value | None]:
        """Return the values that differ from their defaults."""
        return {name: value for name, value in self.values.items() if value != DEFAULTS[name]}

    def told(self, control: Control) -> str:
        """Return range and unit of a control of the configuration. The value is added if it is a
        time, or differs from the field.
        """
        assert control.where is not None
        table, key = control.where
        config, shown = self.config, self.values[control.name]
        holder = {"sensor": config.sensor, "frame": config.frame, "subgroup": config}[table]
        value = getattr(holder, key)
        now = value if table == "frame" else np.ravel(value)[0]
        range_told = control.span(config.sensor)
        now_told = f"now {now}" if shown is not None and now != shown else ""
        ticks = {"ticks": 1, "cycles": config.sensor.phases}.get(control.unit)
        if ticks and now is not None:
            now_told = f"{now_told or now} = {now * ticks * config.tick_s * 1e9:.4g} ns"
        return f"{range_told}; {now_told}" if now_told else range_told

    def setup(self) -> Setup:
        """Return the experiment. Raises `InputError`."""
        scene = self.scene()
        return Setup(
            config=self.config,
            scene=scene,
            klux=self.klux(),
            background=self.values["background"],
            pulse=self.pulse(),
            spad=self.spad,
            spad_gate=self.values["spad_gate"],
            seed=self.values["seed"],
            estimators=(self.values["method"],),
        )

    def scene(self) -> Scene:
        """Return the scene at the sensor's size. Raises `InputError`."""
        values, sensor = self.values, self.config.sensor
        name = values["scene"]
        if name == "upload":
            if self.uploads.depth is None:
                message = f"scene = 'upload': choose a depth picture ({DEPTH_FILES_TOLD})"
                raise InputError(message, field="scene")
            source = str(self.uploads.depth)
            if values["channel"] and self._is_archive:
                source = f"{source}:{values['channel']}"
        else:
            given = ",".join(f"{values[key]:g}" for key in SCENES[name])
            source = f"{name}:{given}" if given else name
        try:
            scene = load_scene(
                source,
                sensor.rows,
                sensor.cols,
                colour=self.uploads.colour if name == "upload" else None,
                reflectivity=values["reflectivity"] if name == "upload" else REFLECTIVITY,
                range_m=self.timing.range_m,
                **self._meaning(),
            )
        except InputError as error:
            raise InputError(self.uploads.named(str(error)), field="scene") from None
        return scene if name == "upload" else self._scaled(scene)

    def _scaled(self, scene: Scene) -> Scene:
        """Return a built-in scene with its distances times the factor. Raises `InputError`."""
        nearest_m = np.nanmin(scene.distance_m)
        farthest_m = np.nanmax(scene.distance_m)
        scale = self.values["scale"]
        if scale * farthest_m >= self.timing.range_m or scale * nearest_m < NEAREST_M:
            low = max(CONTROL["scale"].low, NEAREST_M / nearest_m)
            high = min(CONTROL["scale"].high, self.timing.range_m / farthest_m)
            raise InputError(
                f"scale = {scale:g}: must be a number from {low:.3g} to {high:.3g} with this scene"
                f" (the laser period holds {self.timing.range_m:.4g} m)",
                field="scale",
                low=low,
                high=high,
            )
        return evolve(scene, distance_m=scene.distance_m * scale)

    @property
    def _is_archive(self) -> bool:
        return self.uploads.depth is not None and self.uploads.depth.suffix.lower() in ARCHIVES

    def _meaning(self) -> dict[str, Any]:
        """Return what the controls say about an uploaded depth file, as arguments of
        `load_scene`.
        """
        values = self.values
        if values["scene"] != "upload":
            return {}
        return {
            "unit": None if values["unit"] == UNITS[0] else values["unit"],
            "channel": None if self._is_archive else values["channel"] or None,
            "scale": values["scale"],
            "missing": values["missing"],
            "fov_deg": values["fov_deg"],
            "z": values["z"],
            "sky_m": values["sky_m"],
        }

    def klux(self) -> np.ndarray:
        """float64[rows, cols]: the light of sun and shade. Raises `InputError`."""
        values, sensor = self.values, self.config.sensor
        share = np.ones((sensor.rows, sensor.cols))
        if values["sun"] == "left half":
            share[:, sensor.cols // 2 :] = 0
        elif values["sun"] == "picture":
            if self.uploads.sun is None:
                message = (
                    "sun = 'picture': choose a picture of the sun (white) and the shade (black)"
                )
                raise InputError(message, field="sun")
            share = self.uploads.sun_share(sensor.rows, sensor.cols)
        klux: np.ndarray = share * values["klux"] + (1 - share) * values["shade_klux"]
        return klux

    def told_klux(self) -> str:
        """Return the light of sun and shade in words."""
        values = self.values
        sun, shade = f"{values['klux']:g} klux", f"{values['shade_klux']:g} klux"
        if values["sun"] == "left half":
            return f"{sun} on the left half, {shade} on the right"
        if values["sun"] == "picture" and self.uploads.sun is not None:
            return f"{sun} where {self.uploads.sun.name} is white, {shade} where it is black"
        return sun

    def pulse(self) -> Pulse | None:
        """Return the measured pulse; None: a Gaussian. Raises `InputError`."""
        if self.values["pulse"] != "file":
            return None
        if self.uploads.pulse is None:
            message = (
                "pulse = 'file': choose a file of the pulse (CSV with time_ps,density, or NPY)"
            )
            raise InputError(message, field="pulse")
        return Pulse.load(self.uploads.pulse)

    def light(self, scene: Scene) -> Light:
        """Return the light of `scene` in the first frame. Raises `InputError`."""
        return scene_light(
            scene, self.klux(), background=self.values["background"], pulse=self.pulse()
        )


def check_settings(values: dict[str, Any], uploads: Uploads | None = None) -> Settings:
    """Return `Settings` from values of controls; missing values get their defaults. Raises
    `InputError`.
    """
    for name in values:
        if name not in CONTROL:
            raise InputError(
                f"{name}: unknown setting, must be one of {', '.join(CONTROL)}", field=name
            )
    values = {
        control.name: _checked(control, values.get(control.name, control.default))
        for control in CONTROLS
    }
    config = parse_config(_document(values))
    work = config.sensor.array_pixels * config.pulses * config.frames
    frames_max = PIXEL_PULSES_MAX // config.sensor.array_pixels  # of a single pulse
    if config.frames > frames_max:
        why = "so many pixels here; larger: coincid sim"
        raise out_of_range("frames", config.frames, 1, frames_max, why)
    if work > PIXEL_PULSES_MAX:
        most = PIXEL_PULSES_MAX // (config.sensor.array_pixels * config.frames)
        why = "so many pixels and frames here; larger: coincid sim"
        raise out_of_range("pulses", config.pulses, 1, most, why)
    spad = Spad(
        dead_time_s=values["dead_ns"] * 1e-9,
        jitter_fwhm_s=values["jitter_ps"] * 1e-12,
        dark_cps=values["dark_kcps"] * KILO,
        crosstalk_probability=values["crosstalk_percent"] / PERCENT,
        afterpulse_probability=values["afterpulse_percent"] / PERCENT,
    )
    return Settings(values, uploads or Uploads(), config, Timing.from_config(config), spad)


def _checked(control: Control, value: Any) -> Any:
    """Return `value` in the type of its control. The parser of the configuration makes its own
    checks later.
    """
    if control.kind == "choice":
        return check_choice(control.name, value, control.choices)
    if control.kind == "switch":
        return check_choice(control.name, value, (True, False))
    if control.kind == "text":
        return str(value or "").strip()
    if value is None and control.where is None and control.default is None:
        return None
    if value is None and control.default is not None:
        message = (
            f"{control.name}: is empty, must be a number from {control.low:g} to {control.high:g}"
        )
        raise InputError(message, field=control.name, low=control.low, high=control.high)
    if control.kind == "real":
        return check_real(control.name, value, control.low, control.high)
    if isinstance(value, float) and isfinite(value) and value == int(value):
        value = int(value)
    if control.where is None or control.name in ("pulses", "frames"):
        return check_integer(control.name, value, int(control.low), int(control.high))
    return value


def _document(values: dict[str, Any]) -> dict[str, dict[str, Any]]:
    """Return the tables of the configuration file, without values that are defaults of the
    file.
    """
    document: dict[str, dict[str, Any]] = {
        "sensor": {},
        "frame": {name: values[name] for name in ("pulses", "frames")},
        "subgroup": {},
    }
    for control in CONTROLS:
        value = values[control.name]
        if control.where and (value != control.default or value != SETTINGS[control.name].default):
            table, key = control.where
            document[table][key] = (
                [int(n) for n in value.split("x")] if SETTINGS[key].kind is Kind.SIZE else value
            )
    if (
        values["format"] == "counts" or values["search_pulses"] is not None
    ):  # a part that is built only if it is asked for
        document["sensor"]["counts"] = 1
    return document


def control_of(error: InputError) -> Control | None:
    """Return the control whose value is wrong; None if the error is not about a single control."""
    if error.field is None:
        return None
    return CONTROL.get(error.field.rpartition(".")[2])


def told_by_labels(error: InputError) -> str:
    """Return the message of an error with labels of controls in place of keys of the
    configuration.
    """
    control = control_of(error)
    message = str(error) if control is None else error.renamed(control.label)
    return _KEY.sub(lambda key: CONTROL[key[1]].label if key[1] in CONTROL else key[0], message)


def config_toml(settings: Settings) -> str:
    """Return the configuration file of `settings`."""
    config = settings.config
    return toml_text(
        {
            "sensor": sensor_table(config.sensor),
            "frame": {
                name: value
                for name, value in frame_table(config.frame).items()
                if value is not None
            },
            "subgroup": {
                name: getattr(config, name)[0].item() for name in SUBGROUP if name in CONTROL
            },
        }
    )


def command(settings: Settings) -> str:
    """Return the command that opens the explorer with these settings; uploads that they use appear
    under their file names.
    """
    given = [f"{name}={value}" for name, value in settings.changed.items()]
    for kind, path in settings.uploads.files().items():
        control, asking = USED_BY[kind]
        if settings.values[control] == asking:
            given.append(f"{kind}_file={path.name}")
    return " ".join(["coincid explore", *(f"--set {_quoted(text)}" for text in given)])


def _quoted(text: str) -> str:
    return text if re.fullmatch(r"[\w.=:,-]+", text) else "'" + text.replace("'", "'\\''") + "'"


def query(settings: Settings) -> str:
    """Return the changed settings as a URL's query string."""
    return urlencode({name: str(value) for name, value in settings.changed.items()})


def given_settings(given: list[str]) -> Settings:
    """Return `Settings` from texts NAME=VALUE; NAME is a control, or the kind of an upload with
    `_file`. A file is used unless its control is given, too. Raises `InputError`.
    """
    text: dict[str, str] = {}
    uploads = Uploads()
    for one in given:
        name, equals, value = one.partition("=")
        if not equals:
            raise InputError(f"--set {one}: must be NAME=VALUE")
        if name.removesuffix("_file") in KINDS and name.endswith("_file"):
            uploads = uploads.with_path(name.removesuffix("_file"), Path(value))
        else:
            text[name] = value
    using = dict(USED_BY[kind] for kind in uploads.files())
    return check_settings(values_of_text(using | text), uploads)


def values_of_link(given: dict[str, str]) -> tuple[dict[str, Any], str]:
    """Return the values of controls from a URL, and a message about those that cannot be used."""
    values: dict[str, Any] = {}
    ignored = []
    for name, text in given.items():
        try:
            value = values_of_text({name: text})[name]
            values[name] = value if value is None else _checked(CONTROL[name], value)
        except InputError as error:
            ignored.append(told_by_labels(error))
    return values, " ".join(f"Ignored in the link: {message}." for message in ignored)


def without_lost_pictures(values: dict[str, Any], uploads: Uploads) -> tuple[dict[str, Any], str]:
    """Return values without choices of files that are not there any more, and a message about
    them.
    """
    needed = {
        "scene": ("upload", uploads.depth),
        "sun": ("picture", uploads.sun),
        "pulse": ("file", uploads.pulse),
    }
    lost = [
        name for name, (asking, path) in needed.items() if values.get(name) == asking and not path
    ]
    messages = [f"{CONTROL[name].label}: the file is not here any more" for name in lost]
    kept = {name: value for name, value in values.items() if name not in lost}
    return kept, " ".join(f"{message}; please choose it again." for message in messages)


def values_of_text(given: dict[str, str]) -> dict[str, Any]:
    """Return the values of controls from the text of a command or URL. Raises `InputError`."""
    values = {}
    for name, text in given.items():
        control = CONTROL.get(name)
        if control is None:
            raise InputError(
                f"{name}: unknown setting, must be one of {', '.join(CONTROL)}", field=name
            )
        values[name] = _from_text(control, text)
    return values


def _from_text(control: Control, text: str) -> Value | None:
    if not text.strip():
        return None
    if control.kind in ("choice", "text"):
        return text
    if control.kind == "switch":
        return {"true": True, "false": False}.get(text.lower(), text)
    try:
        number = float(text)
    except ValueError:
        legal = f"a number from {control.low:g} to {control.high:g}"
        raise wrong_value(control.name, text, legal, low=control.low, high=control.high) from None
    return (
        int(number)
        if control.kind == "integer" and isfinite(number) and number == int(number)
        else number
    )
