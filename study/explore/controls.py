# SPDX-License-Identifier: Apache-2.0
"""The controls of the explorer: a table of all settings, each with unit, range and a sentence.

Settings of the configuration file take their range and unit from the tables of the configuration,
and also their default and sentence unless this file gives others. The parser of the configuration
checks them (`control_values.py`). The other settings have their range here. Settings of the file
that are not described here follow automatically at the end.
"""

from collections.abc import Iterable
from typing import Any, TypeAlias

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
from ...model.scenes.conventions import DATA_SETS, PER_METRE
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
    name: tuple(PARAMETERS[what] for what, _ in parameters)
    for name, (parameters, _) in BUILT_IN.items()
} | {"upload": ("reflectivity",)}
UNITS = ("of its kind", *PER_METRE, *DATA_SETS)
NUMBER_MAX = 1e10  # in a depth file
SKY_MAX_M = 10_000.0  # beyond the range of every laser period
SUN = ("everywhere", "left half", "picture")
PULSE_SHAPES = ("Gaussian", "file")
SLIDERS = {"klux": 100, "threshold": 16, "window": 64}  # control: upper end of its slider
PULSES_MAX, FRAMES_MAX, KLUX_MAX = 10_000, 64, 200
_OWN = ("flat", "two-targets", "two-returns")  # scenes whose surfaces have controls
_EVENTS: "Need" = {"format": WITH_MAP}  # there are none in the format `counts`
_COINCIDENT: "Needs" = (_EVENTS | {"coincidence": (True,)},)
_CONTROLLED: "Needs" = (_EVENTS | {"coincidence": (True,), "auto": (True,)},)
_GATED: "Needs" = ({"gating": (True,)},)
_RECORDS: "Needs" = (_EVENTS | {"minigroup_records": (True,)},)
NEEDS: dict[str, "Needs"] = {  # conditions under which a control has an effect
    "coincidence": (_EVENTS,),
    "auto": _COINCIDENT,
    "threshold": _COINCIDENT,  # also of the controller, which begins with it
    "window": _COINCIDENT,
    "minigroup_records": (_EVENTS,),
    "search_pulses": ({"format": ("counts",)},),
    "threshold_floor": _CONTROLLED,
    "capacity": _CONTROLLED,
    "near_m": ({"scene": _OWN},),
    "far_m": ({"scene": ("two-targets", "two-returns")},),
    "reflectivity": ({"scene": (*_OWN, "upload")},),
    "unit": ({"scene": ("upload",)},),
    "channel": ({"scene": ("upload",)},),
    "missing": ({"scene": ("upload",)},),
    "fov_deg": ({"scene": ("upload",)},),
    "z": ({"scene": ("upload",)},),
    "sky_m": ({"scene": ("upload",)},),
    "shade": ({"scene": ("sun-and-shade", "tunnel")},),
    "shade_klux": ({"sun": ("left half", "picture")},),
    "gate_start": _GATED,
    "gate_len": _GATED,
    "spad_gate": _GATED,
    "gate_every": _GATED,
    "gate_step": ({"gating": (True,), "gate_every": 0, "gate_steps": 1},),
    "gate_steps": ({"gating": (True,), "gate_every": 0},),
    "dither_seed": ({"dither_bits": 0},),
    "mg_threshold": _RECORDS,
    "mg_window": _RECORDS,
    "offset_phases": ({"format": ("full", "compact-full")},),
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
# Legal values of other controls, which must all hold; a number: every value above it.
Need: TypeAlias = "dict[str, tuple[Value, ...] | int]"
Needs: TypeAlias = "tuple[Need, ...]"  # alternatives


@frozen(kw_only=True)
class Control:
    """A setting of the explorer."""

    name: str  # its key
    group: str  # under which it stands on the page
    label: str  # what a user calls it
    sentence: str  # what it does
    kind: str  # "integer", "real", "choice", "switch" or "text"
    default: Value | None  # None: the field may be empty
    unit: str = ""
    low: float = 0  # legal range; for a key of the file, that of the default sensor
    high: float = 0
    step: float = 1  # change by a click or an arrow key
    choices: tuple[str, ...] = ()  # legal values of a choice
    # table and key of the configuration file; None if it is not in the file
    where: tuple[str, str] | None = None

    def span(self, sensor: Sensor) -> str:
        """Return range and unit."""
        low, high = SETTINGS[self.name].limits(sensor) if self.where else (self.low, self.high)
        return f"{low:.10g} to {high:.10g} {self.unit}".strip()

    @property
    def needs(self) -> list[dict[str, list[str] | int]]:
        """Return its `NEEDS` with the texts of the page's fields; empty: it always has an
        effect.
        """
        return [
            {name: _texts(values) for name, values in one.items()}
            for one in NEEDS.get(self.name, ())
        ]

    @property
    def slide(self) -> float:
        """Return the upper end of its slider; 0: there is no slider."""
        return SLIDERS.get(self.name, 0)


def _told(name: str) -> str:
    return OPTIONS[name].doc


def _texts(values: tuple[Value, ...] | int) -> list[str] | int:
    """Return values as texts of a field."""
    if isinstance(values, int):
        return values
    return [str(value).lower() if isinstance(value, bool) else str(value) for value in values]


_DEFAULTS = parse_config({})


def _integer(**described: Any) -> Control:
    """Return the control of an integer that is not in the configuration file."""
    return Control(kind="integer", **described)


def _real(**described: Any) -> Control:
    """Return the control of a real number that is not in the configuration file."""
    return Control(kind="real", **described)


def _choice(
    *, name: str, choices: Iterable[str], default: str = "", table: str = "", **described: Any
) -> Control:
    """Return the control of a choice. table: of the configuration file in which it is, if it is
    there.
    """
    legal = tuple(choices)
    where = (table, name) if table else None
    return Control(
        name=name,
        kind="choice",
        default=default or legal[0],
        choices=legal,
        where=where,
        **described,
    )


def _key(
    name: str, group: str = FURTHER, label: str = "", sentence: str = "", default: int | None = None
) -> Control:
    """Return the control of a key of the configuration file that is an integer, a real number or a
    switch.
    """
    setting = SETTINGS[name]
    if default is None:
        default = setting.default_of(_DEFAULTS.sensor, _DEFAULTS.frame)
    label = label or FURTHER_LABELS.get(name) or name.replace("_", " ").capitalize()
    sentence = (
        sentence or setting.doc
    ) + " Empty: derived from the other settings." * setting.derived
    low, high = setting.limits(_DEFAULTS.sensor)
    return Control(
        name=name,
        group=group,
        label=label,
        sentence=sentence,
        kind=setting.kind.value,
        default=default,
        unit=setting.unit,
        low=low,
        high=high,
        where=(setting.table, name),
    )


_DESCRIBED: tuple[Control, ...] = (
    _key(
        name="coincidence",
        group="Threshold",
        label="Coincidence",
        sentence="On: a detection counts only if enough pixels of a subgroup fire within a window. Off: every photon is an event.",
    ),
    _key(
        name="threshold",
        group="Threshold",
        label="Threshold",
        sentence="Pixels that must fire within a window. Low lets sunlight through, high loses dark and far objects. The controller starts from it.",
    ),
    _key(
        name="auto",
        group="Threshold",
        label="Controller",
        sentence="Sets every subgroup's threshold anew after each frame; watch it over several frames.",
    ),
    _key(
        name="window",
        group="Threshold",
        label="Window",
        sentence="How long the tree waits for more pixels after a first photon; 16 ticks are 1 ns.",
    ),
    _choice(
        name="scene",
        group="Scene",
        label="Scene",
        choices=SCENES,
        sentence="What the sensor looks at: planes that face it, or your own depth picture.",
    ),
    _real(
        name="near_m",
        group="Scene",
        label="Distance, near",
        default=5.0,
        low=NEAREST_M,
        high=round(RANGE_M, 1),
        unit="m",
        step=0.5,
        sentence="For the scenes flat, two-targets and two-returns.",
    ),
    _real(
        name="far_m",
        group="Scene",
        label="Distance, far",
        default=9.0,
        low=NEAREST_M,
        high=round(RANGE_M, 1),
        unit="m",
        step=0.5,
        sentence="Farther surface of two-targets and two-returns.",
    ),
    _real(
        name="reflectivity",
        group="Scene",
        label="Reflectivity",
        default=0.4,
        low=0,
        high=1,
        unit="",
        step=0.05,
        sentence=f"{_told('reflectivity')} It also applies to these three scenes. Black velvet: 0.01, asphalt: 0.1, white wall: 0.8.",
    ),
    _real(
        name="shade",
        group="Scene",
        label="Light in the shade",
        default=SHADE,
        low=0,
        high=1,
        unit="",
        step=0.01,
        sentence="For the scenes sun-and-shade and tunnel: share of the sun's light.",
    ),
    _real(
        name="scale",
        group="Scene",
        label="Distances times",
        default=1.0,
        low=0.1,
        high=10,
        unit="",
        step=0.1,
        sentence=f"{_told('scale')} In the explorer it applies to all scenes.",
    ),
    _choice(
        name="unit", group="Scene", label="Unit of the file", choices=UNITS, sentence=_told("unit")
    ),
    Control(
        name="channel",
        group="Scene",
        label="Channel or array",
        default="",
        kind="text",
        sentence=f"{_told('channel')} Of an NPZ, HDF5 or MATLAB file: the name of the array.",
    ),
    _real(
        name="missing",
        group="Scene",
        label="No depth",
        default=None,
        low=-NUMBER_MAX,
        high=NUMBER_MAX,
        sentence=_told("missing"),
    ),
    _real(
        name="fov_deg",
        group="Scene",
        label="Field of view of the file",
        default=None,
        low=1e-3,
        high=179,
        unit="degrees",
        sentence=_told("fov_deg"),
    ),
    Control(
        name="z",
        group="Scene",
        label="Along the axis (z)",
        default=False,
        kind="switch",
        sentence=_told("z"),
    ),
    _real(
        name="sky_m",
        group="Scene",
        label="Nothing from",
        default=SKY_MAX_M,
        low=NEAREST_M,
        high=SKY_MAX_M,
        unit="m",
        step=5,
        sentence=_told("sky_m"),
    ),
    _real(
        name="klux",
        group="Light",
        label="Sunlight",
        default=50.0,
        low=0,
        high=KLUX_MAX,
        unit="klux",
        step=5,
        sentence="Background light where the sun shines. Full sun: 100 klux, a lit room: 0.5 klux.",
    ),
    _choice(
        name="sun",
        group="Light",
        label="The sun shines",
        choices=SUN,
        sentence="Everywhere, on the left half only, or where an uploaded picture is white; black is shade.",
    ),
    _real(
        name="shade_klux",
        group="Light",
        label="Shade",
        default=5.0,
        low=0,
        high=KLUX_MAX,
        unit="klux",
        step=1,
        sentence="Background light where the sun does not shine.",
    ),
    _choice(
        name="pulse",
        group="Light",
        label="Pulse",
        choices=PULSE_SHAPES,
        sentence="Shape of laser pulse and jitter together: a Gaussian of 500 ps, or an uploaded measurement.",
    ),
    _integer(
        name="pulses",
        group="Light",
        label="Laser pulses",
        default=100,
        low=1,
        high=PULSES_MAX,
        sentence="Per frame. More pulses give more light and a longer frame.",
        step=10,
    ),
    _integer(
        name="frames",
        group="Light",
        label="Frames",
        default=1,
        low=1,
        high=FRAMES_MAX,
        sentence="Frames in sequence; they show how the controller's thresholds settle.",
    ),
    _integer(
        name="seed",
        group="Light",
        label="Seed",
        default=1,
        low=0,
        high=SEED_MAX,
        sentence=f"{_told('seed')} The same seed gives the same photons.",
    ),
    _choice(
        name="background",
        group="Light",
        label="Background",
        choices=BACKGROUNDS,
        sentence=_told("background"),
    ),
    _key(
        name="rows", group="Sensor", label="Rows", sentence="SPADs of the array from top to bottom."
    ),
    _key(
        name="cols",
        group="Sensor",
        label="Columns",
        sentence="SPADs of the array from left to right.",
    ),
    _choice(
        name="subgroup",
        group="Sensor",
        label="Subgroup",
        choices=SIZES,
        sentence="SPADs that share a coincidence tree and a threshold, rows x columns.",
        default="8x8",
        table="sensor",
    ),
    _choice(
        name="minigroup",
        group="Sensor",
        label="Minigroup",
        choices=MINIGROUP_SIZES,
        sentence="SPADs that share a coarse time stamp of their own, rows x columns.",
        default="2x2",
        table="sensor",
    ),
    _key(
        name="fifo_depth",
        group="Sensor",
        label="FIFO depth",
        sentence="Number of events of a subgroup that can wait for the stream; further ones are dropped.",
    ),
    _key(
        name="streams",
        group="Sensor",
        label="Streams",
        sentence="Outputs of the sensor; each one carries a part of the subgroups.",
    ),
    _choice(
        name="format",
        group="Sensor",
        label="Format",
        choices=(*WITH_MAP, "counts"),
        sentence=(
            "Content of an event: id: which pixels fired; full: also the minigroups' time stamps. Depth"
            " needs the pixels. counts: no events, but counts in gates that the sensor finds itself."
        ),
        default="id",
        table="frame",
    ),
    _key(
        name="gating", group="Gate", label="Gating", sentence="Light outside the gate is ignored."
    ),
    _key(
        name="gate_start",
        group="Gate",
        label="Gate start",
        sentence="First cycle of the gate; a cycle is 2 ns, 0.3 m.",
        default=20,
    ),
    _key(
        name="gate_len",
        group="Gate",
        label="Gate length",
        sentence="Length of the gate.",
        default=60,
    ),
    Control(
        name="spad_gate",
        group="Gate",
        label="SPADs off outside",
        default=False,
        kind="switch",
        sentence=f"{_told('spad_gate')} No SPAD is dead when the gate opens.",
    ),
    _key(
        name="gate_step",
        group="Gate",
        label="Progressive: step",
        sentence="The gate moves later by this many cycles ...",
    ),
    _key(
        name="gate_every",
        group="Gate",
        label="Progressive: every",
        sentence="... after every so many pulses (0: never) ...",
    ),
    _key(
        name="gate_steps",
        group="Gate",
        label="Progressive: positions",
        sentence="... and returns to the start after so many positions.",
    ),
    _real(
        name="dead_ns",
        group="SPAD",
        label="Dead time",
        default=8.0,
        low=0,
        high=1000,
        unit="ns",
        step=1,
        sentence="Time after an avalanche in which a SPAD detects nothing.",
    ),
    _real(
        name="jitter_ps",
        group="SPAD",
        label="Jitter",
        default=100.0,
        low=0,
        high=500,
        unit="ps",
        step=50,
        sentence="Width (FWHM) of the SPAD's timing jitter. The laser pulse is set so that both together have 500 ps.",
    ),
    _real(
        name="dark_kcps",
        group="SPAD",
        label="Dark counts",
        default=0.0,
        low=0,
        high=10_000,
        unit="kcps",
        step=10,
        sentence="Avalanches per second without light; 50 klux give 1226 kcps.",
    ),
    _real(
        name="crosstalk_percent",
        group="SPAD",
        label="Crosstalk",
        default=0.0,
        low=0,
        high=25,
        unit="%",
        step=1,
        sentence="Probability that an avalanche fires a given neighbour.",
    ),
    _real(
        name="afterpulse_percent",
        group="SPAD",
        label="Afterpulsing",
        default=0.0,
        low=0,
        high=50,
        unit="%",
        step=1,
        sentence="Probability that an avalanche traps a carrier, which fires the SPAD later.",
    ),
    _choice(
        name="method",
        group="Depth",
        label="Estimator",
        choices=METHODS,
        sentence=f"{_told('method')} {'; '.join(f'{name}: {what}' for name, what in METHODS.items())}.",
        default=DEFAULT_METHOD,
    ),
)
_NAMES = {control.name for control in _DESCRIBED}
_SIMPLE = (Kind.INTEGER, Kind.REAL, Kind.SWITCH)
_FURTHER = [
    name for name, setting in (SUBGROUP | FRAME | SENSOR).items() if setting.kind in _SIMPLE
]
CONTROLS = (*_DESCRIBED, *(_key(name) for name in _FURTHER if name not in _NAMES))
CONTROL = {control.name: control for control in CONTROLS}
GROUPS = tuple(dict.fromkeys(control.group for control in CONTROLS))
DEFAULTS = {control.name: control.default for control in CONTROLS}
