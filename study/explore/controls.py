# SPDX-License-Identifier: Apache-2.0
"""The controls of the explorer: a table of all settings, each with unit, range and a sentence.

Settings of the configuration file take their range and unit from the tables of the configuration, and also their default
and sentence unless this file gives others. The parser of the configuration checks them (`control_values.py`). The other
settings have their range here. Settings of the file that are not described here follow automatically at the end.
"""

from collections.abc import Iterable
from typing import TypeAlias

from attrs import frozen

from ...lab.options import OPTIONS
from ...model.contract.config import SETTINGS, parse_config
from ...model.contract.packet import WITH_MAP
from ...model.contract.parameters import SENSOR, Sensor
from ...model.contract.settings import FRAME, SUBGROUP
from ...model.contract.table import Kind
from ...model.depth.methods import DEFAULT_METHOD, METHODS
from ...model.light.light import BACKGROUNDS, NEAREST_M
from ...model.light.timing import RANGE_M
from ...model.scenes.catalogue import BUILT_IN
from ...model.scenes.daylight import SHADE
from ...model.scenes.depth_units import DATA_SETS, PER_METRE
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
UNITS = ("of its kind", *PER_METRE, *DATA_SETS)
SUN = ("everywhere", "left half", "picture")
SLIDERS = {"klux": 100, "threshold": 16, "window": 64}  # control: upper end of its slider
PULSES_MAX, FRAMES_MAX, KLUX_MAX = 10_000, 64, 200
_OWN = ("flat", "two-targets", "two-returns")  # scenes whose surfaces have controls
_CONTROLLED: "Needs" = ({"coincidence": (True,), "auto": (True,)},)
_GATED: "Needs" = ({"gating": (True,)},)
_STEPPED: "Needs" = ({"gating": (True,), "gate_every": None},)
_RECORDS: "Needs" = ({"minigroup_records": (True,)},)
_STAMPED: "Needs" = (*_RECORDS, {"format": ("full", "compact-full")})
NEEDS: dict[str, "Needs"] = {  # conditions under which a control has an effect
    "auto": ({"coincidence": (True,)},),
    "threshold": ({"coincidence": (True,), "auto": (False,)},),
    "window": ({"coincidence": (True,)},),
    "threshold_floor": _CONTROLLED,
    "capacity": _CONTROLLED,
    "near_m": ({"scene": _OWN},),
    "far_m": ({"scene": ("two-targets", "two-returns")},),
    "reflectivity": ({"scene": (*_OWN, "upload")},),
    "unit": ({"scene": ("upload",)},),
    "shade": ({"scene": ("sun-and-shade", "tunnel")},),
    "shade_klux": ({"sun": ("left half", "picture")},),
    "gate_start": _GATED,
    "gate_len": _GATED,
    "spad_gate": _GATED,
    "gate_every": _GATED,
    "gate_step": _STEPPED,
    "gate_steps": _STEPPED,
    "dither_seed": ({"dither_bits": None},),
    "mg_threshold": _RECORDS,
    "mg_window": _RECORDS,
    "offset_phases": _STAMPED,
}
FURTHER = "Further"  # group of the settings that are not described here
FURTHER_LABELS = {  # of those whose key is not a label
    "clock_mhz": "System clock",
    "link_gbps": "Rate of the link",
    "period": "Laser period",
    "mg_threshold": "Minigroup threshold",
    "mg_window": "Minigroup window",
    "threshold_floor": "Lowest threshold",
    "phases": "Phases of the TDC",
    "window_max": "Longest window",
    "rearm": "Re-arm gap",
    "offset_phases": "Steps of the offsets",
    "offsets": "Offsets built",
    "records": "Records built",
    "controller": "Controller built",
    "held": "Settings held",
}

Value: TypeAlias = int | float | str | bool
# Alternatives. Each gives values of other controls that must all hold; None: any value except 0.
Needs: TypeAlias = "tuple[dict[str, tuple[Value, ...] | None], ...]"


@frozen
class Control:
    """A setting of the explorer.

    kind: "integer", "real", "choice" or "switch"; choices: legal values of a choice. default: None if the field may be empty.
    low, high: legal range; for a key of the file, that of the default sensor. where: table and key of the configuration
    file, or None if it is not in the file. step: change by a click or an arrow key.
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
        low, high = SETTINGS[self.name].limits(sensor) if self.where else (self.low, self.high)
        return f"{low:.10g} to {high:.10g} {self.unit}".strip()

    @property
    def needs(self) -> list[dict[str, list[str] | None]]:
        """Return its `NEEDS` with the texts of the page's fields; empty: it always has an effect."""
        return [{name: _texts(values) for name, values in one.items()} for one in NEEDS.get(self.name, ())]

    @property
    def slide(self) -> float:
        """Return the upper end of its slider; 0: there is no slider."""
        return SLIDERS.get(self.name, 0)


def _told(name: str) -> str:
    return OPTIONS[name].doc


def _texts(values: tuple[Value, ...] | None) -> list[str] | None:
    """Return values as texts of a field."""
    if values is None:
        return None
    return [str(value).lower() if isinstance(value, bool) else str(value) for value in values]


_DEFAULTS = parse_config({})


def _integer(
    name: str, group: str, label: str, default: int, low: int, high: int, sentence: str, step: int = 1
) -> Control:
    return Control(name, group, label, sentence, "integer", default, "", low, high, step)


def _real(
    name: str, group: str, label: str, default: float, low: float, high: float, unit: str, step: float, sentence: str
) -> Control:
    return Control(name, group, label, sentence, "real", default, unit, low, high, step)


def _choice(
    name: str, group: str, label: str, choices: Iterable[str], sentence: str, default: str = "", table: str = ""
) -> Control:
    chosen, where = tuple(choices), (table, name) if table else None
    return Control(name, group, label, sentence, "choice", default or chosen[0], choices=chosen, where=where)


def _key(name: str, group: str = FURTHER, label: str = "", sentence: str = "", default: int | None = None) -> Control:
    """Return the control of a key of the configuration file that is an integer, a real number or a switch."""
    setting = SETTINGS[name]
    if default is None:
        default = setting.default_of(_DEFAULTS.sensor, _DEFAULTS.frame)
    label = label or FURTHER_LABELS.get(name) or name.replace("_", " ").capitalize()
    sentence = (sentence or setting.doc) + " Empty: derived from the other settings." * setting.derived
    limits, where = setting.limits(_DEFAULTS.sensor), (setting.table, name)
    return Control(name, group, label, sentence, setting.kind.value, default, setting.unit, *limits, where=where)


_DESCRIBED: tuple[Control, ...] = (
    _key("coincidence", "Threshold", "Coincidence",
         "On: a detection counts only if enough pixels of a subgroup fire within a window. Off: every photon is an event."),
    _key("threshold", "Threshold", "Threshold",
         "Pixels that must fire within a window. Low lets sunlight through, high loses dark and far objects. The controller starts from it."),
    _key("auto", "Threshold", "Controller", "Sets every subgroup's threshold anew after each frame; watch it over several frames."),
    _key("window", "Threshold", "Window", "How long the tree waits for more pixels after a first photon; 16 ticks are 1 ns."),
    _choice("scene", "Scene", "Scene", SCENES, "What the sensor looks at: planes that face it, or your own depth picture."),
    _real("near_m", "Scene", "Distance, near", 5.0, NEAREST_M, round(RANGE_M, 1), "m", 0.5, "For the scenes flat, two-targets and two-returns."),
    _real("far_m", "Scene", "Distance, far", 9.0, NEAREST_M, round(RANGE_M, 1), "m", 0.5, "Farther surface of two-targets and two-returns."),
    _real("reflectivity", "Scene", "Reflectivity", 0.4, 0, 1, "", 0.05,
          f"{_told('reflectivity')} It also applies to these three scenes. Black velvet: 0.01, asphalt: 0.1, white wall: 0.8."),
    _real("shade", "Scene", "Light in the shade", SHADE, 0, 1, "", 0.01, "For the scenes sun-and-shade and tunnel: share of the sun's light."),
    _real("scale", "Scene", "Distances times", 1.0, 0.1, 10, "", 0.1, f"{_told('scale')} In the explorer it applies to all scenes."),
    _choice("unit", "Scene", "Unit of the file", UNITS, _told("unit")),
    _real("klux", "Light", "Sunlight", 50.0, 0, KLUX_MAX, "klux", 5,
          "Background light where the sun shines. Full sun: 100 klux, a lit room: 0.5 klux."),
    _choice("sun", "Light", "The sun shines", SUN, "Everywhere, on the left half only, or where an uploaded picture is white; black is shade."),
    _real("shade_klux", "Light", "Shade", 5.0, 0, KLUX_MAX, "klux", 1, "Background light where the sun does not shine."),
    _integer("pulses", "Light", "Laser pulses", 100, 1, PULSES_MAX, "Per frame. More pulses give more light and a longer frame.", step=10),
    _integer("frames", "Light", "Frames", 1, 1, FRAMES_MAX, "Frames in sequence; they show how the controller's thresholds settle."),
    _integer("seed", "Light", "Seed", 1, 0, SEED_MAX, f"{_told('seed')} The same seed gives the same photons."),
    _choice("background", "Light", "Background", BACKGROUNDS, _told("background")),
    _key("rows", "Sensor", "Rows", "SPADs of the array from top to bottom."),
    _key("cols", "Sensor", "Columns", "SPADs of the array from left to right."),
    _choice("subgroup", "Sensor", "Subgroup", SIZES, "SPADs that share a coincidence tree and a threshold, rows x columns.", "8x8", "sensor"),
    _choice("minigroup", "Sensor", "Minigroup", MINIGROUP_SIZES,
          "SPADs that share a coarse time stamp of their own, rows x columns.", "2x2", "sensor"),
    _key("fifo_depth", "Sensor", "FIFO depth", "Number of events of a subgroup that can wait for the stream; further ones are dropped."),
    _key("streams", "Sensor", "Streams", "Outputs of the sensor; each one carries a part of the subgroups."),
    _choice("format", "Sensor", "Format", WITH_MAP,
            "Content of an event: id: which pixels fired; full: also the minigroups' time stamps. Depth needs the pixels.", "id", "frame"),
    _key("gating", "Gate", "Gating", "Light outside the gate is ignored."),
    _key("gate_start", "Gate", "Gate start", "First cycle of the gate; a cycle is 2 ns, 0.3 m.", 20),
    _key("gate_len", "Gate", "Gate length", "Length of the gate.", 60),
    Control(name="spad_gate", group="Gate", label="SPADs off outside", default=False, kind="switch",
            sentence=f"{_told('spad_gate')} No SPAD is dead when the gate opens."),
    _key("gate_step", "Gate", "Progressive: step", "The gate moves later by this many cycles ..."),
    _key("gate_every", "Gate", "Progressive: every", "... after every so many pulses (0: never) ..."),
    _key("gate_steps", "Gate", "Progressive: positions", "... and returns to the start after so many positions."),
    _real("dead_ns", "SPAD", "Dead time", 8.0, 0, 1000, "ns", 1, "Time after an avalanche in which a SPAD detects nothing."),
    _real("jitter_ps", "SPAD", "Jitter", 100.0, 0, 500, "ps", 50,
          "Width (FWHM) of the SPAD's timing jitter. The laser pulse is set so that both together have 500 ps."),
    _real("dark_kcps", "SPAD", "Dark counts", 0.0, 0, 10_000, "kcps", 10, "Avalanches per second without light; 50 klux give 1226 kcps."),
    _real("crosstalk_percent", "SPAD", "Crosstalk", 0.0, 0, 25, "%", 1, "Probability that an avalanche fires a given neighbour."),
    _real("afterpulse_percent", "SPAD", "Afterpulsing", 0.0, 0, 50, "%", 1,
          "Probability that an avalanche traps a carrier, which fires the SPAD later."),
    _choice("method", "Depth", "Estimator", METHODS,
          f"{_told('method')} {'; '.join(f'{name}: {what}' for name, what in METHODS.items())}.", DEFAULT_METHOD),
)  # fmt: skip
_NAMES = {control.name for control in _DESCRIBED}
_SIMPLE = (Kind.INTEGER, Kind.REAL, Kind.SWITCH)
_FURTHER = [name for name, setting in (SUBGROUP | FRAME | SENSOR).items() if setting.kind in _SIMPLE]
CONTROLS = (*_DESCRIBED, *(_key(name) for name in _FURTHER if name not in _NAMES))
CONTROL = {control.name: control for control in CONTROLS}
GROUPS = tuple(dict.fromkeys(control.group for control in CONTROLS))
DEFAULTS = {control.name: control.default for control in CONTROLS}
