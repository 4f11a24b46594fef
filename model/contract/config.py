# SPDX-License-Identifier: Apache-2.0
"""Configuration files: the sensor as built, the frame, and the settings of every subgroup.

Ranges and defaults come from `parameters.py` and from the register table. Combinations that make no sense are refused,
as the sensor refuses them at a start.
"""

import re
import tomllib
from collections.abc import Collection
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
from attrs import asdict, evolve, frozen

from ..shared.errors import InputError, check_integer, out_of_range
from ..shared.files import FilePath
from ..shared.quantities import check_choice, check_real
from . import registers
from .bounds import noise_bounds
from .dither import start_cycles
from .link import beats_waiting_max, check_link, link_share, takes_beats
from .packet import FORMAT_NAMES, FORMATS, Kind, layout
from .parameters import CLOCK_MHZ, CLOCK_MHZ_RANGE, LINK_GBPS_MAX, SIZE_LIMITS, Sensor
from .preset_files import PRESETS
from .registers import AUTO_BOUNDS, BY_NAME, MASK_BITS, MODE

FRAMES_MAX = 1 << 16  # the frame number has 16 bits
FRAME_REGISTERS = (  # keys of [frame] that are registers
    "period",
    "pulses",
    "format",
    "minigroup_records",
    "mg_threshold",
    "mg_window",
    "gate_step",
    "gate_every",
    "gate_steps",
    "dither_bits",
    "dither_seed",
    "threshold_floor",
)
BY_FRAME_LENGTH = (
    "auto_bounds",
    "capacity",
)  # keys of [frame] that count events per frame; None: the default follows from other settings of the frame
SUBGROUP_INTEGERS = ("threshold", "window", "gate_start", "gate_len")
MODE_BITS = tuple(bits.name for bits in MODE.bits)


SUBGROUP_KEYS = (*MODE_BITS, *SUBGROUP_INTEGERS, "mask")


@frozen(eq=False, kw_only=True)
class Config:
    """A checked configuration: the sensor as built, the frame, and the settings of every subgroup.

    `load_config` and `parse_config` make it; `with_frame` and `with_settings` make changed copies.

    Attributes
    ----------
    sensor : Sensor
        Parameters of the sensor as built.
    frame : dict
        The table [frame] of the file; every key has a value.
    coincidence, gating, auto : numpy.ndarray
        bool[subgroups].
    threshold : numpy.ndarray
        int64[subgroups], in pixels.
    window : numpy.ndarray
        int64[subgroups], in ticks.
    gate_start, gate_len : numpy.ndarray
        int64[subgroups], in cycles.
    mask : numpy.ndarray
        bool[subgroups, pixels of a subgroup], True = on.

    Raises
    ------
    InputError
        If settings make no sense together.
    """

    sensor: Sensor
    frame: dict[str, Any]
    coincidence: np.ndarray
    gating: np.ndarray
    auto: np.ndarray
    threshold: np.ndarray
    window: np.ndarray
    gate_start: np.ndarray
    gate_len: np.ndarray
    mask: np.ndarray

    def __attrs_post_init__(self) -> None:
        guard, period = self.sensor.guard, self.period
        if period <= guard:
            raise out_of_range(
                "frame.period", period, guard + 1, self.sensor.period_max, f"above the guard of {guard} cycles"
            )
        check_link(self.frame["link_gbps"], self.clock_mhz)
        if np.any(np.diff(self.auto_bounds) < 0):
            raise InputError(f"frame.auto_bounds = {self.auto_bounds.tolist()}: must not descend")
        late = np.flatnonzero(self.gating & (self.gate_start >= period))
        if len(late):
            where = f"subgroup {late[0]}: gating is on and the period has {period} cycles"
            raise out_of_range("subgroup.gate_start", int(self.gate_start[late[0]]), 0, period - 1, where)

    @property
    def frames(self) -> int:
        """Number of frames."""
        return self.frame["frames"]

    @property
    def clock_mhz(self) -> float:
        """System clock in MHz."""
        return self.frame["clock_mhz"]

    @property
    def link_share(self) -> Fraction:
        """Share of the cycles in which a stream's link takes a beat."""
        return link_share(self.frame["link_gbps"], self.clock_mhz)

    @property
    def tick_s(self) -> float:
        """A TDC LSB in seconds."""
        return 1 / (self.clock_mhz * 1e6 * self.sensor.phases)

    @property
    def period(self) -> int:
        """Laser period in cycles."""
        return self.frame["period"]

    @property
    def pulses(self) -> int:
        """Laser periods per frame."""
        return self.frame["pulses"]

    @property
    def format(self) -> str:
        """Name of the event format."""
        return self.frame["format"]

    @property
    def auto_bounds(self) -> np.ndarray:
        """int64[6]: the controller's bounds, ascending; by default, those for noise in the longest window."""
        bounds = self.frame["auto_bounds"] or noise_bounds(
            phases=self.sensor.phases,
            window_ticks=int(self.window.max()),
            rearm_cycles=self.sensor.rearm,
            period_cycles=self.period,
            pulses=self.pulses,
        )
        return np.array(bounds, np.int64)

    @property
    def capacity(self) -> int:
        """Events that a stream carries in a frame; by default, as many as its link takes."""
        given: int | None = self.frame["capacity"]
        return self.capacity_of(int(self.pulses * self.period * self.link_share)) if given is None else given

    def capacity_of(self, beats: int) -> int:
        """Return the number of events that `beats` of a stream carry in a frame.

        With minigroup records, every subgroup may send one record per pulse before its events.
        """
        parts = layout(self.sensor)
        if self.frame["minigroup_records"]:
            subgroups = max(len(self.sensor.stream_subgroups(stream)) for stream in range(self.sensor.streams))
            beats -= self.pulses * subgroups * parts.length(Kind.RECORD)
        return max(0, beats) // parts.length(FORMATS[self.format])

    @property
    def shares(self) -> np.ndarray:
        """int64[streams]: share of each subgroup in the capacity of its stream, in events."""
        return np.array([self.capacity // len(self.sensor.stream_subgroups(k)) for k in range(self.sensor.streams)])

    @property
    def controlled(self) -> np.ndarray:
        """bool[subgroups]: True where the controller sets the threshold."""
        return self.auto & self.coincidence

    def start_cycles(self) -> np.ndarray:
        """int64[pulses + 1]: cycle at which each period of a frame begins, starting at 0; the last element ends the frame."""
        starts = start_cycles(self.pulses, self.period, self.frame["dither_bits"], self.frame["dither_seed"])
        starts[-1] = starts[-2] + self.period
        return starts

    @property
    def frame_cycles(self) -> int:
        """Cycles in a frame, from the first cycle of the first period to the last cycle of the last one."""
        return int(self.start_cycles()[-1])

    @property
    def period_ticks(self) -> int:
        return self.period * self.sensor.phases

    def tready(self, receiver: np.ndarray | None = None) -> np.ndarray:
        """uint8[n]: `tready` of every stream in each cycle of a frame; 1 from cycle n on.

        It follows from the link and the receiver behind it. receiver: uint8[m], the cycles in which the receiver takes a
        beat; from cycle m on, or if it is None, it always takes one.
        """
        receiver = np.zeros(0, np.uint8) if receiver is None else np.asarray(receiver, np.uint8)
        share = self.link_share
        if share == 1:
            return receiver
        waiting = 2 * beats_waiting_max(self.sensor)
        ready = takes_beats(share, self.frame_cycles + len(receiver) + int(waiting / share))
        ready[: len(receiver)] &= receiver
        return ready

    def with_frame(self, **settings: Any) -> "Config":
        """Return a copy with other settings of the frame: keys and values of [frame].

        Raises `InputError` with the key and its range.
        """
        return evolve(self, frame=self.frame | _frame(settings, self.sensor))

    def with_settings(self, **settings: Any) -> "Config":
        """Return a copy with other settings of the subgroups: keys and values of [subgroup].

        A list or an array gives one value per subgroup; masks may also be rows of booleans. Raises `InputError` with the
        key and its range.
        """
        columns: dict[str, Any] = {}
        for name, value in _known("subgroup", settings, SUBGROUP_KEYS).items():
            where, values = f"subgroup.{name}", _plain(value)
            if not isinstance(values, list):
                columns[name] = _column(_setting(where, name, values, self.sensor), self.sensor)
            elif len(values) != self.sensor.subgroups:
                raise InputError(f"{where}: has {len(values)} values, must have one or {self.sensor.subgroups}")
            else:
                columns[name] = np.array(
                    [_setting(f"{where}[{s}]", name, one, self.sensor) for s, one in enumerate(values)]
                )
        return evolve(self, **columns)

    def with_pulses(self, pulses: int) -> "Config":
        """Return a copy with another number of pulses per frame; settings in events per frame change in proportion."""
        events = {name: self.frame[name] for name in BY_FRAME_LENGTH if self.frame[name] is not None}
        scaled = {
            name: np.minimum(np.multiply(value, pulses) // self.pulses, BY_NAME[name].high(self.sensor))
            for name, value in events.items()
        }
        return self.with_frame(pulses=pulses, **scaled)

    def register_writes(self) -> list[tuple[int, int]]:
        """Return (address, value) of every setting, as a driver writes them before a frame."""
        frame = self.frame | {"format": FORMAT_NAMES.index(self.format)}
        writes = [(registers.address(name), int(frame[name])) for name in FRAME_REGISTERS]
        writes += [(registers.address("auto_bounds", index=i), int(bound)) for i, bound in enumerate(self.auto_bounds)]
        writes.append((registers.address("capacity"), self.capacity))
        writes += [(registers.address("share", index=k), int(share)) for k, share in enumerate(self.shares)]
        mode = sum(getattr(self, name).astype(np.int64) << MODE.bit(name) for name in MODE_BITS)
        for s in range(self.sensor.subgroups):
            writes.append((registers.address("mode", s), int(mode[s])))
            writes += [(registers.address(name, s), int(getattr(self, name)[s])) for name in SUBGROUP_INTEGERS]
            bits = sum(1 << int(i) for i in np.flatnonzero(self.mask[s]))
            for w in range(-(-self.sensor.pixels // MASK_BITS)):
                writes.append((registers.address("mask", s, w), bits >> MASK_BITS * w & ((1 << MASK_BITS) - 1)))
        return writes


def load_config(path: FilePath | None = None) -> Config:
    """Read a configuration.

    Parameters
    ----------
    path : str, Path or None
        A TOML file, the name of a preset (`PRESETS`), or None for the defaults.

    Returns
    -------
    Config

    Raises
    ------
    InputError
        If the file cannot be read, or a setting is unknown or out of range; the message names the key and its range.
    """
    if path is None:
        return parse_config({})
    try:
        return parse_config(read_toml(PRESETS.get(str(path), path)))
    except InputError as error:
        raise InputError(f"{path}: {error}") from None


def read_toml(path: FilePath) -> dict[str, Any]:
    """Return the TOML document in a file. Raises `InputError` without the file's name."""
    try:
        return tomllib.loads(Path(path).read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise InputError(f"no such file (presets: {', '.join(PRESETS)})") from None
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"cannot be read ({error})") from None
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"is not TOML: {error}") from None


def parse_config(document: dict[str, Any]) -> Config:
    """Check a configuration that is given as nested dictionaries, like a parsed TOML file.

    Parameters
    ----------
    document : dict
        The tables `sensor`, `frame`, `subgroup` and `override`; every table and every key may be missing.

    Returns
    -------
    Config

    Raises
    ------
    InputError
        If a table or key is unknown, or a value is out of range.
    """
    tables = {"sensor": dict, "frame": dict, "subgroup": dict, "override": list}
    for name, value in document.items():
        if name not in tables:
            raise InputError(f"[{name}]: unknown table, must be one of {', '.join(tables)}")
        if not isinstance(value, tables[name]):
            raise InputError(f"{name}: must be written as {'[[override]]' if name == 'override' else f'[{name}]'}")
    sensor = _sensor(document.get("sensor", {}))
    frame = _frame(_frame_defaults(sensor) | document.get("frame", {}), sensor)
    default = {
        "coincidence": True,
        "gating": False,
        "auto": False,
        "threshold": 2,
        "window": 16,
        "gate_start": 0,
        "gate_len": frame["period"],
        "mask": f"{(1 << sensor.pixels) - 1:x}",
    }
    common = default | _known("subgroup", document.get("subgroup", {}), default)
    columns = {
        name: _column(_setting(f"subgroup.{name}", name, value, sensor), sensor) for name, value in common.items()
    }
    for number, override in enumerate(document.get("override", [])):
        where = f"override[{number}]"
        if not isinstance(override, dict):
            raise InputError(f"{where}: must be a table")
        values = _known(where, override, {"subgroups": None} | default)
        chosen = values.pop("subgroups", None)
        if not isinstance(chosen, list):
            raise InputError(
                f"{where}.subgroups = {chosen!r}: must be a list of integers from 0 to {sensor.subgroups - 1}"
            )
        for s in chosen:
            check_integer(f"{where}.subgroups", s, 0, sensor.subgroups - 1)
        for name, value in values.items():
            columns[name][chosen] = _setting(f"{where}.{name}", name, value, sensor)
    return Config(sensor=sensor, frame=frame, **columns)


def _known(section: str, given: dict[str, Any], legal: Collection[str]) -> dict[str, Any]:
    for name in given:
        if name not in legal:
            raise InputError(f"{section}.{name}: unknown key, must be one of {', '.join(legal)}")
    return dict(given)


def _sensor(given: dict[str, Any]) -> Sensor:
    return Sensor(**_known("sensor", given, (*SIZE_LIMITS, "subgroup", "minigroup")))


def _frame_defaults(sensor: Sensor) -> dict[str, Any]:
    return {"frames": 1, "clock_mhz": CLOCK_MHZ, "link_gbps": 0.0} | {
        **{name: BY_NAME[name].reset(sensor) for name in FRAME_REGISTERS},
        "period": 250,
        "format": "id",
        "minigroup_records": False,
        **dict.fromkeys(BY_FRAME_LENGTH),
    }


def _frame(given: dict[str, Any], sensor: Sensor) -> dict[str, Any]:
    """Return the checked values of some keys of [frame]."""
    checked: dict[str, Any] = {}
    for name, value in _known("frame", given, _frame_defaults(sensor)).items():
        where, value = f"frame.{name}", _plain(value)
        if name == "frames":
            checked[name] = check_integer(where, value, 1, FRAMES_MAX)
        elif name == "clock_mhz":
            checked[name] = check_real(where, value, *CLOCK_MHZ_RANGE)
        elif name == "link_gbps":
            checked[name] = check_real(where, value, 0, LINK_GBPS_MAX)
        elif name == "format":
            checked[name] = check_choice(where, value, FORMAT_NAMES)
        elif name == "minigroup_records":
            checked[name] = _boolean(where, value)
        elif name in BY_FRAME_LENGTH and value is None:
            checked[name] = None
        elif name == "auto_bounds":
            checked[name] = _bounds(where, value, sensor)
        else:
            checked[name] = _register_value(where, name, value, sensor)
    return checked


def _bounds(where: str, value: object, sensor: Sensor) -> list[int]:
    if not isinstance(value, list) or len(value) != AUTO_BOUNDS:
        raise InputError(f"{where} = {value!r}: must be {AUTO_BOUNDS} integers that do not descend")
    return [_register_value(where, "auto_bounds", bound, sensor) for bound in value]


def _setting(where: str, name: str, value: object, sensor: Sensor) -> np.ndarray | np.int64 | bool:
    """Return the checked value of a key of [subgroup]; the mask becomes bool[pixels]."""
    if name == "mask":
        return _mask(where, value, sensor.pixels)
    if name in MODE_BITS:
        return _boolean(where, value)
    return np.int64(_register_value(where, name, value, sensor))


def _column(value: np.ndarray | np.int64 | bool, sensor: Sensor) -> np.ndarray:
    """Return an array with the same value for every subgroup."""
    return np.repeat(np.asarray(value)[None], sensor.subgroups, axis=0)


def _plain(value: object) -> object:
    """Return a setting as a file would hold it: no NumPy types, no tuples."""
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    return list(value) if isinstance(value, tuple) else value


def _register_value(where: str, name: str, value: object, sensor: Sensor) -> int:
    register = BY_NAME[name]
    return check_integer(where, value, register.low(sensor), register.high(sensor))


def _boolean(where: str, value: object) -> bool:
    if not isinstance(value, bool):
        raise InputError(f"{where} = {value!r}: must be true or false")
    return value


def _mask(where: str, value: object, pixels: int) -> np.ndarray:
    if isinstance(value, list) and len(value) == pixels and all(isinstance(on, bool) for on in value):
        return np.array(value)
    if not isinstance(value, str) or not re.fullmatch(r"(0[xX])?[0-9a-fA-F]+", value) or int(value, 16) >> pixels:
        raise InputError(f"{where} = {value!r}: must be a string of hex digits below 2^{pixels} (bit i = pixel i)")
    return np.array([int(value, 16) >> i & 1 for i in range(pixels)], bool)


def sensor_table(sensor: Sensor) -> dict[str, Any]:
    """Return the sensor's part of a configuration file."""
    return {name: list(value) if isinstance(value, tuple) else value for name, value in asdict(sensor).items()}
