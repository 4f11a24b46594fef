# SPDX-License-Identifier: Apache-2.0
"""The explorer's controls: one table of all settings, each with its unit, range and a sentence.

Settings of the configuration file have the range, and by default also the default value and the sentence, of the
configuration's own tables, whose parser checks them (`settings.py`). The other settings have their range here. Settings
of the file that are not described here come last, automatically.
"""

from collections.abc import Iterable
from typing import Any, TypeAlias

from attrs import frozen

from ...model.contract.config import FRAME_REGISTERS, MODE_BITS, SUBGROUP_INTEGERS, parse_config
from ...model.contract.packet import FORMAT_NAMES
from ...model.contract.parameters import SIZE_LIMITS, Sensor
from ...model.contract.registers import BY_NAME, MODE
from ...model.depth.estimate import DEFAULT_METHOD, METHODS
from ...model.light.light import NEAREST_M
from ...model.light.timing import RANGE_M
from ...model.scenes.catalogue import BUILT_IN
from ...model.scenes.daylight import SHADE
from ...model.shared.errors import SEED_MAX

SIZES = ("4x4", "4x8", "8x4", "8x8", "8x16", "16x8", "16x16")
MINIGROUP_SIZES = ("1x1", "1x2", "2x1", "2x2", "2x4", "4x2", "4x4")
PARAMETERS = {
    "DISTANCE": "near_m",
    "NEAR": "near_m",
    "FAR": "far_m",
    "REFLECTIVITY": "reflectivity",
    "SHADE": "shade",
}  # of built-in scenes
SCENES = {  # name: controls that are the scene's parameters
    name: tuple(PARAMETERS[what] for what, _ in parameters) for name, (parameters, _) in BUILT_IN.items()
} | {"upload": ("reflectivity",)}
SUN = ("everywhere", "left half", "picture")
SLIDERS = {"klux": 100, "threshold": 16, "window": 64}  # control: upper end of its slider
PULSES_MAX, FRAMES_MAX, KLUX_MAX = 10_000, 64, 200
FURTHER = "Further"  # group of the settings that are not described here

Value: TypeAlias = int | float | str | bool


@frozen(kw_only=True)
class Control:
    """A setting of the explorer.

    kind: "integer", "real", "choice" or "switch"; choices: of a choice. default: None if it may be empty. low, high:
    legal range, for a register that of the default sensor. where: table and key of the configuration file, or None if it
    is not in the file. step: of a click or an arrow key.
    """

    name: str
    group: str
    label: str
    sentence: str
    kind: str
    default: Value | None
    unit: str = ""
    low: float = 0
    high: float = 0
    step: float = 1
    choices: tuple[str, ...] = ()
    where: tuple[str, str] | None = None

    def span(self, sensor: Sensor) -> str:
        """Return range and unit."""
        low, high = self.low, self.high
        if self.of_register:
            low, high = BY_NAME[self.name].low(sensor), BY_NAME[self.name].high(sensor)
        return f"{low:.10g} to {high:.10g} {self.unit}".strip()

    @property
    def of_register(self) -> bool:
        """Return whether it is an integer register, whose range depends on the sensor."""
        return self.kind == "integer" and self.where is not None and self.where[0] != "sensor"

    @property
    def slide(self) -> float:
        """Return the upper end of its slider; 0: it has none."""
        return SLIDERS.get(self.name, 0)


_DEFAULTS = parse_config({})


def _integer(
    name: str, group: str, label: str, default: int, low: int, high: int, sentence: str, step: int = 1
) -> Control:
    return Control(
        name=name,
        group=group,
        label=label,
        default=default,
        low=low,
        high=high,
        sentence=sentence,
        step=step,
        kind="integer",
    )


def _real(
    name: str, group: str, label: str, default: float, low: float, high: float, unit: str, step: float, sentence: str
) -> Control:
    return Control(
        name=name,
        group=group,
        label=label,
        default=default,
        low=low,
        high=high,
        unit=unit,
        step=step,
        sentence=sentence,
        kind="real",
    )


def _choice(
    name: str, group: str, label: str, choices: Iterable[str], sentence: str, default: str = "", table: str = ""
) -> Control:
    chosen = tuple(choices)
    return Control(
        name=name,
        group=group,
        label=label,
        default=default or chosen[0],
        sentence=sentence,
        kind="choice",
        choices=chosen,
        where=(table, name) if table else None,
    )


def _size(name: str, group: str = FURTHER, label: str = "", unit: str = "", sentence: str = "") -> Control:
    """Return the control of a key of [sensor]."""
    default, low, high = SIZE_LIMITS[name]
    return Control(
        name=name,
        group=group,
        label=label or _label(name),
        default=default,
        low=low,
        high=high,
        unit=unit,
        sentence=sentence or BY_NAME[name].doc,
        kind="integer",
        where=("sensor", name),
    )


def _switch(name: str, group: str = FURTHER, label: str = "", sentence: str = "") -> Control:
    """Return the control of a key of [subgroup] or [frame] that is true or false."""
    table, default = _in_file(name)
    doc = next((bits.doc for bits in MODE.bits if bits.name == name), "") or BY_NAME[name].doc
    return Control(
        name=name,
        group=group,
        label=label or _label(name),
        default=default,
        sentence=sentence or doc,
        kind="switch",
        where=(table, name),
    )


def _register(
    name: str, group: str = FURTHER, label: str = "", unit: str = "", sentence: str = "", default: int | None = None
) -> Control:
    """Return the control of a key of [subgroup] or [frame] that is an integer register."""
    (table, value), register, sensor = _in_file(name), BY_NAME[name], _DEFAULTS.sensor
    return Control(
        name=name,
        group=group,
        label=label or _label(name),
        default=value if default is None else default,
        low=register.low(sensor),
        high=register.high(sensor),
        unit=unit,
        sentence=(sentence or register.doc) + ("" if value is not None else " Empty: derived from the other settings."),
        kind="integer",
        where=(table, name),
    )


def _in_file(name: str) -> tuple[str, Any]:
    """Return (table of the configuration file, default) of a key of [subgroup] or [frame]."""
    if name in _DEFAULTS.frame:
        return "frame", _DEFAULTS.frame[name]
    return "subgroup", getattr(_DEFAULTS, name)[0].item()


def _label(name: str) -> str:
    return name.replace("_", " ").capitalize()


def _known(name: str) -> Control:
    """Return the control of a key of the configuration file that is not described here."""
    if name in SIZE_LIMITS:
        return _size(name)
    return _switch(name) if isinstance(_in_file(name)[1], bool) else _register(name)


_DESCRIBED: tuple[Control, ...] = (
    _switch("coincidence", "Threshold", "Coincidence",
            "On: photons count only if enough pixels of a subgroup fire within a window. Off: every photon is an event."),
    _register("threshold", "Threshold", "Threshold", "pixels",
              "Pixels that must fire within a window. Low lets sunlight through, high loses dark and far objects."),
    _switch("auto", "Threshold", "Controller", "Sets every subgroup's threshold anew after each frame; watch it over several frames."),
    _register("window", "Threshold", "Window", "ticks", "How long the tree waits for more pixels after a first photon; 16 ticks are 1 ns."),
    _choice("scene", "Scene", "Scene", SCENES, "What the sensor looks at: planes that face it, or your own depth picture."),
    _real("near_m", "Scene", "Distance, near", 5.0, NEAREST_M, round(RANGE_M, 1), "m", 0.5, "For the scenes flat, two-targets and two-returns."),
    _real("far_m", "Scene", "Distance, far", 9.0, NEAREST_M, round(RANGE_M, 1), "m", 0.5, "Farther surface of two-targets and two-returns."),
    _real("reflectivity", "Scene", "Reflectivity", 0.4, 0, 1, "", 0.05,
          "For the same scenes, and for a depth picture without a colour picture. Black velvet: 0.01, asphalt: 0.1, white wall: 0.8."),
    _real("shade", "Scene", "Light in the shade", SHADE, 0, 1, "", 0.01, "For the scenes sun-and-shade and tunnel: share of the sun's light."),
    _real("scale", "Scene", "Distances times", 1.0, 0.1, 10, "", 0.1, "All distances of the scene are multiplied by this."),
    _real("klux", "Light", "Sunlight", 50.0, 0, KLUX_MAX, "klux", 5,
          "Background light where the sun shines. Full sun: 100 klux, a lit room: 0.5 klux."),
    _choice("sun", "Light", "The sun shines", SUN, "Everywhere, on the left half only, or by an uploaded picture: white is sun, black is shade."),
    _real("shade_klux", "Light", "Shade", 5.0, 0, KLUX_MAX, "klux", 1, "Background light where the sun does not shine."),
    _integer("pulses", "Light", "Laser pulses", 100, 1, PULSES_MAX, "Per frame. More pulses give more light and a longer frame.", step=10),
    _integer("frames", "Light", "Frames", 1, 1, FRAMES_MAX, "One after the other, to show how the controller's thresholds settle."),
    _integer("seed", "Light", "Seed", 1, 0, SEED_MAX, "For all random numbers: the same seed gives the same photons."),
    _size("rows", "Sensor", "Rows", "SPADs", "SPADs of the array from top to bottom."),
    _size("cols", "Sensor", "Columns", "SPADs", "SPADs of the array from left to right."),
    _choice("subgroup", "Sensor", "Subgroup", SIZES, "SPADs that share a coincidence tree and a threshold, rows x columns.", "8x8", "sensor"),
    _choice("minigroup", "Sensor", "Minigroup", MINIGROUP_SIZES,
          "SPADs that share a coarse time stamp of their own, rows x columns.", "2x2", "sensor"),
    _size("fifo_depth", "Sensor", "FIFO depth", "events", "Events of a subgroup that can wait for the stream; more are dropped."),
    _size("streams", "Sensor", "Streams", "", "Outputs of the sensor, which share the subgroups."),
    _choice("format", "Sensor", "Format", [name for name in FORMAT_NAMES if name != "short"],
            "Content of an event: id: which pixels fired; full: also the minigroups' time stamps. Depth needs the pixels.", "id", "frame"),
    _switch("gating", "Gate", "Gating", "Light outside the gate is ignored."),
    _register("gate_start", "Gate", "Gate start", "cycles", "First cycle of the gate; a cycle is 2 ns, 0.3 m.", 20),
    _register("gate_len", "Gate", "Gate length", "cycles", "Length of the gate.", 60),
    Control(name="spad_gate", group="Gate", label="SPADs off outside", default=False, kind="switch",
            sentence="The gate keeps the SPADs themselves off, so that none is dead when it opens."),
    _register("gate_step", "Gate", "Progressive: step", "cycles", "The gate moves later by this many cycles ..."),
    _register("gate_every", "Gate", "Progressive: every", "pulses", "... after every so many pulses (0: never) ..."),
    _register("gate_steps", "Gate", "Progressive: positions", "", "... and returns to the start after so many positions."),
    _real("dead_ns", "SPAD", "Dead time", 8.0, 0, 1000, "ns", 1, "Time for which a SPAD is blind after an avalanche."),
    _real("jitter_ps", "SPAD", "Jitter", 100.0, 0, 500, "ps", 50,
          "Width (FWHM) of an avalanche's delay; combined with the laser pulse, it is 500 ps."),
    _real("dark_kcps", "SPAD", "Dark counts", 0.0, 0, 10_000, "kcps", 10, "Avalanches per second without light; 50 klux give 1226 kcps."),
    _real("crosstalk_percent", "SPAD", "Crosstalk", 0.0, 0, 25, "%", 1, "Probability that an avalanche fires a given neighbour."),
    _real("afterpulse_percent", "SPAD", "Afterpulsing", 0.0, 0, 50, "%", 1,
          "Probability that an avalanche traps a carrier, which fires the SPAD later."),
    _choice("method", "Depth", "Estimator", METHODS,
          f"From events to depth: {'; '.join(f'{name}: {what}' for name, what in METHODS.items())}.", DEFAULT_METHOD),
)  # fmt: skip
_NAMES = {control.name for control in _DESCRIBED}
_EMPTY = [
    name for name, value in _DEFAULTS.frame.items() if value is None and BY_NAME[name].count(_DEFAULTS.sensor) == 1
]
_IN_FILE = (*MODE_BITS, *SUBGROUP_INTEGERS, *FRAME_REGISTERS, *_EMPTY, *SIZE_LIMITS)
CONTROLS = (*_DESCRIBED, *(_known(name) for name in _IN_FILE if name not in _NAMES))
CONTROL = {control.name: control for control in CONTROLS}
GROUPS = tuple(dict.fromkeys(control.group for control in CONTROLS))
DEFAULTS = {control.name: control.default for control in CONTROLS}
