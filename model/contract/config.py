# SPDX-License-Identifier: Apache-2.0
"""Configuration files: the sensor as built, the frame, and the settings of every subgroup.

Keys, ranges and defaults come from the tables of `parameters.py` and `settings.py`. Combinations
that make no sense are refused, as the sensor refuses them at a start.
"""

import json
import tomllib
from collections.abc import Callable, Collection, Mapping
from fractions import Fraction
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from attrs import asdict, evolve, field, frozen

from ..shared.constants import SPEED_OF_LIGHT_M_S
from ..shared.errors import InputError, check_integer, out_of_range, wrong_value
from ..shared.files import FilePath
from . import registers
from .coincidence import AT_LEAST, Rule
from .counters import EVENTS_MAX
from .counts import SEARCH_SHARE, with_pauses
from .dither import start_cycles
from .groups import LARGE_PIXELS, PAYLOAD_BITS, group_widths
from .link import beats_waiting_max, check_link, link_share, takes_beats
from .noise_bounds import noise_bounds
from .packet import COUNTS, FORMATS, RECORD, WITH_MAP, built_formats, layout
from .parameters import MASK_BITS, PARTS, SENSOR, Sensor
from .preset_files import PRESETS
from .registers import MODE
from .settings import FRAME, SUBGROUP, SWITCHES, FrameSettings, SubgroupSettings, frame_defaults
from .table import Kind, Setting

TABLES = {"sensor": SENSOR, "frame": FRAME, "subgroup": SUBGROUP}
SETTINGS = SENSOR | FRAME | SUBGROUP  # every key of a table stands in one table only
PER_FRAME = tuple(name for name, setting in FRAME.items() if setting.derived)


@frozen(eq=False, kw_only=True)
class Config(SubgroupSettings):
    """A checked configuration: the sensor as built, the frame, and the settings of every subgroup.

    `load_config` and `parse_config` make it; `with_sensor`, `with_frame` and `with_settings`
    make changed copies. given: the keys that were written, such as `subgroup.threshold`; all
    others have their defaults. overridden: bool[subgroups] by setting that was written in an
    [[override]] only, the subgroups that it named; the others have the default. Raises
    `InputError` if settings make no sense together.
    """

    sensor: Sensor
    frame: FrameSettings
    given: frozenset[str] = field(default=frozenset(), eq=False)  # it changes no result
    overridden: Mapping[str, np.ndarray] = field(factory=dict, eq=False)

    def __attrs_post_init__(self) -> None:
        guard, period = self.sensor.guard, self.period
        if period <= guard:
            raise out_of_range(
                "frame.period",
                period,
                guard + 1,
                self.sensor.period_max,
                f"above the guard of {guard} cycles",
            )
        if self.format not in (built := built_formats(self.sensor)):
            part = "counts" if self.counting else "offsets"
            legal = (
                f"one of {', '.join(built)}, because the sensor is built without {PARTS[part]}"
                f" (sensor.{part} = 0)"
            )
            raise wrong_value("frame.format", self.format, legal)
        for name, setting in (FRAME | SUBGROUP).items():
            value = getattr(self.frame if name in FRAME else self, name)
            if not setting.built(self.sensor) and np.any(value != setting.default):
                legal = {None: "left out", False: "false"}.get(setting.default, setting.default)
                raise InputError(
                    f"{setting.key}: must be {legal}, because the sensor is built without {PARTS[setting.needs]}"
                    f" (sensor.{setting.needs} = 0)",
                    field=setting.key,
                )
        check_link(self.frame.link_gbps, self.clock_mhz)
        if np.any(np.diff(self.auto_bounds) < 0):
            raise InputError(
                f"frame.auto_bounds = {self.auto_bounds.tolist()}: must not descend",
                field="frame.auto_bounds",
            )
        if self.counting and 2 * self.search_pulses >= self.pulses:
            raise InputError(
                f"frame.search_pulses = {self.search_pulses}: must be below half of frame.pulses ="
                f" {self.pulses}, so that pulses are left to count in",
                field="frame.search_pulses",
            )
        late = np.flatnonzero(self.gating & (self.gate_start >= period))
        if len(late):
            where = f"subgroup {late[0]}: gating is on and the period has {period} cycles"
            raise out_of_range(
                "subgroup.gate_start", int(self.gate_start[late[0]]), 0, period - 1, where
            )

    def __repr__(self) -> str:
        """Return one line: size, frames, and how many keys were written."""
        sensor = self.sensor
        size = f"{sensor.rows} x {sensor.cols} pixels in {sensor.subgroups} subgroups"
        frames = f"{self.frames} frame{'s' * (self.frames > 1)} of {self.pulses} pulses"
        return f"<Config: {size}, {frames}, {len(self.given)} keys written>"

    @property
    def frames(self) -> int:
        """Number of frames."""
        return self.frame.frames

    @property
    def clock_mhz(self) -> float:
        """System clock in MHz."""
        return self.frame.clock_mhz

    @property
    def link_share(self) -> Fraction:
        """Share of the cycles in which a stream's link takes a beat."""
        return link_share(self.frame.link_gbps, self.clock_mhz)

    @property
    def tick_s(self) -> float:
        """A TDC LSB in seconds."""
        return 1 / (self.clock_mhz * 1e6 * self.sensor.phases)

    @property
    def tick_m(self) -> float:
        """Distance that light has travelled, there and back, within a TDC LSB, in metres."""
        return self.tick_s * SPEED_OF_LIGHT_M_S / 2

    @property
    def period(self) -> int:
        """Laser period in cycles."""
        return self.frame.period

    @property
    def gap(self) -> int:
        """Cycles from the end of one period to the next one, without dither's wait."""
        return self.frame.gap

    @property
    def pulses(self) -> int:
        """Laser periods per frame."""
        return self.frame.pulses

    @property
    def format(self) -> str:
        """Name of the event format."""
        return self.frame.format

    @property
    def counting(self) -> bool:
        """Whether frames have counts in place of events."""
        return self.format == COUNTS.name

    @property
    def search_pulses(self) -> int:
        """Pulses of step 1 of a frame of counts, and of its step 2."""
        given: int | None = self.frame.search_pulses
        return given if given is not None else max(1, self.pulses // SEARCH_SHARE)

    def check_map(self) -> None:
        """Raise `InputError` if depth cannot be made of the format: it needs events with a map, or
        counts.
        """
        if not self.counting and self.format not in WITH_MAP:
            legal = " or ".join(WITH_MAP)
            raise wrong_value(
                "frame.format", self.format, f"{legal}, because depth needs the ID map"
            )

    @property
    def auto_bounds(self) -> np.ndarray:
        """int64[6]: the controller's bounds, ascending; by default, those for noise in the
        longest window.
        """
        bounds = self.frame.auto_bounds or noise_bounds(
            self.sensor,
            window_ticks=int(self.window.max()),
            period_cycles=self.period,
            pulses=self.pulses,
        )
        return np.array(bounds, np.int64)

    @property
    def capacity(self) -> int:
        """Events that a stream carries in a frame; by default, as many as its link takes.

        In the gaps it takes no more than what the FIFOs hold at the end of a period.
        """
        given: int | None = self.frame.capacity
        if given is not None:
            return given
        waiting_cycles = (self.pulses - 1) * self.gap
        held_events = (self.pulses - 1) * self.sensor.fifo_depth * self._fewest_subgroups
        all_cycles = self._capacity_in(self.pulses * self.period + waiting_cycles)
        in_periods = self._capacity_in(self.pulses * self.period)
        return min(all_cycles, in_periods + held_events, EVENTS_MAX)

    def _capacity_in(self, cycles: int) -> int:
        """Return the number of events that a stream's link takes in `cycles` of a frame.

        With minigroup records, every subgroup may send one record per pulse before its events.
        """
        beats = int(cycles * self.link_share)
        parts = layout(self.sensor)
        packet = FORMATS[self.format]
        if self.frame.minigroup_records:
            subgroups = max(
                len(self.sensor.stream_subgroups(stream)) for stream in range(self.sensor.streams)
            )
            beats -= self.pulses * subgroups * parts.length(RECORD)
        if packet.grouped:
            bits = group_widths(self.sensor).listed_bits(packet, self.period_ticks, LARGE_PIXELS)
            return min(max(0, beats) * PAYLOAD_BITS // bits, cycles // parts.length(packet))
        return max(0, beats) // parts.length(packet)

    @property
    def shares(self) -> np.ndarray:
        """int64[streams]: share of each subgroup in the capacity of its stream, in events."""
        return np.array(
            [
                self.capacity // len(self.sensor.stream_subgroups(k))
                for k in range(self.sensor.streams)
            ]
        )

    @property
    def _fewest_subgroups(self) -> int:
        """Subgroups of the smallest stream."""
        return self.sensor.subgroups // self.sensor.streams

    @property
    def controlled(self) -> np.ndarray:
        """bool[subgroups]: True where the controller sets the threshold."""
        return self.auto & self.coincidence

    def start_cycles(self) -> np.ndarray:
        """int64[pulses + 1]: cycle at which each period of a frame begins, starting at 0; the
        last element ends the frame.
        """
        starts = start_cycles(
            self.pulses, self.period, self.frame.dither_bits, self.frame.dither_seed, self.gap
        )
        if self.counting:
            starts = with_pauses(starts, self.search_pulses, self.sensor.minigroups, self.gap)
        starts[-1] = starts[-2] + self.period
        return starts

    @property
    def frame_cycles(self) -> int:
        """Cycles in a frame, from the first cycle of the first period to the last cycle of the
        last one.
        """
        return int(self.start_cycles()[-1])

    @property
    def period_ticks(self) -> int:
        return self.period * self.sensor.phases

    def tready(self, receiver: np.ndarray | None = None) -> np.ndarray:
        """uint8[n]: `tready` of every stream in each cycle of a frame; 1 from cycle n on.

        It follows from the link and the receiver behind it. receiver: uint8[m], the cycles in
        which the receiver takes a beat; from cycle m on, or if it is None, it always takes one.
        """
        receiver = np.zeros(0, np.uint8) if receiver is None else np.asarray(receiver, np.uint8)
        share = self.link_share
        if share == 1:
            return receiver
        waiting = 2 * beats_waiting_max(self.sensor)
        ready = takes_beats(share, self.frame_cycles + len(receiver) + int(waiting / share))
        ready[: len(receiver)] &= receiver != 0
        return ready

    def with_frame(self, **settings: Any) -> "Config":
        """Return a copy with other settings of the frame: keys and values of [frame].

        Raises `InputError` with the key and its range.
        """
        frame = evolve(self.frame, **_frame(settings, self.sensor))
        given = self.given | _keys("frame", settings)
        followers: dict[str, Any] = {}
        for name, setting in SUBGROUP.items():
            if setting.follows in settings:
                default = _column(setting, setting.default_of(self.sensor, frame), self.sensor)
                own = self.overridden.get(name, setting.key in given)
                followers[name] = np.where(own, getattr(self, name), default)
        return evolve(self, frame=frame, given=given, **followers)

    def with_sensor(self, **parameters: Any) -> "Config":
        """Return a copy with another sensor: keys and values of [sensor].

        Settings that were written stay, the others get the new sensor's defaults. Raises
        `InputError` with the key and its range, or if subgroups have settings of their own and
        their number changes.
        """
        document = self.written()
        document["sensor"] |= _known("sensor", parameters, SENSOR)
        own = self.own_settings()
        for name in own:
            del document["subgroup"][name]
        return _blaming(
            _keys("sensor", parameters), lambda: parse_config(document).keeping(self, own)
        )

    def with_rule(self, rule: Rule) -> "Config":
        """Return a copy whose sensor has another rule of coincidence (docs/extend.md). Raises
        `InputError`.
        """
        return evolve(self, sensor=evolve(self.sensor, rule=rule))

    def own_settings(self) -> list[str]:
        """Return the settings that were written of some subgroups only, or with different values."""
        return [name for name in SUBGROUP if self._differs(name)]

    def keeping(self, old: "Config", own: Collection[str], **given: Any) -> "Config":
        """Return a copy with some settings of the subgroups of `old`, its rule of coincidence, and
        other settings, as in `with_settings`.

        own: names of `own_settings`. Where an override left a subgroup at its default, it gets the
        default of this configuration. Raises `InputError`.
        """
        settings = {name: getattr(old, name) for name in own} | given
        overridden = {}
        if self.sensor.subgroups == old.sensor.subgroups:
            overridden = {name: named for name, named in old.overridden.items() if name in own}
        for name, named in overridden.items():
            settings[name] = getattr(self, name).copy()
            settings[name][named] = getattr(old, name)[named]
        changed = self.with_settings(**settings).with_rule(old.sensor.rule)
        return evolve(changed, overridden=overridden)

    def _differs(self, name: str) -> bool:
        """Return whether the subgroups have different values of a setting that was written, or
        an override was written of some.
        """
        values = getattr(self, name)
        differs = name in self.overridden or bool(np.any(values != values[0]))
        return SUBGROUP[name].key in self.given and differs

    def written(self) -> dict[str, dict[str, Any]]:
        """Return the tables of a configuration file with the keys that were written; lists where
        subgroups differ.
        """
        document: dict[str, dict[str, Any]] = {table: {} for table in TABLES}
        for name, setting in SETTINGS.items():
            if setting.key not in self.given:
                continue
            of = {"sensor": self.sensor, "frame": self.frame}.get(setting.table, self)
            value = getattr(of, name)
            if setting.table == "subgroup":
                value = value.tolist() if self._differs(name) else value[0].tolist()
            document[setting.table][name] = list(value) if isinstance(value, tuple) else value
        return document

    def with_settings(self, **settings: Any) -> "Config":
        """Return a copy with other settings of the subgroups: keys and values of [subgroup].

        A list or an array gives one value per subgroup; masks may also be rows of booleans.
        Raises `InputError` with the key and its range.
        """
        columns: dict[str, Any] = {}
        for name, value in _known("subgroup", settings, SUBGROUP).items():
            setting = SUBGROUP[name]
            if not isinstance(value, list | tuple) and not np.ndim(value):
                columns[name] = _column(setting, value, self.sensor)
            elif len(value) != self.sensor.subgroups:
                raise InputError(
                    f"{setting.key}: has {len(value)} values, must have one or {self.sensor.subgroups}",
                    field=setting.key,
                )
            else:
                values = [
                    setting.checked(f"{setting.key}[{s}]", one, self.sensor)
                    for s, one in enumerate(value)
                ]
                columns[name] = np.array(values)
        given = self.given | _keys("subgroup", settings)
        overridden = {name: own for name, own in self.overridden.items() if name not in settings}
        return evolve(self, **columns, given=given, overridden=overridden)

    def with_pulses(self, pulses: int) -> "Config":
        """Return a copy with another number of pulses per frame; settings in events per frame
        change in proportion.
        """
        scaled: dict[str, Any] = {}
        for name in PER_FRAME:
            events = getattr(self.frame, name)
            if events is not None:
                low, high = FRAME[name].limits(self.sensor)
                scaled[name] = np.clip(np.multiply(events, pulses) // self.pulses, low, high)
        return self.with_frame(pulses=pulses, **scaled)

    def register_writes(self) -> list[tuple[int, int]]:
        """Return (address, value) of every setting, as a driver writes them before a frame."""
        writes = []
        derived = {
            "auto_bounds": self.auto_bounds,
            "capacity": self.capacity,
            "search_pulses": self.search_pulses,
        }
        for name, setting in FRAME.items():
            value: Any = derived[name] if name in derived else getattr(self.frame, name)
            if setting.offset is not None and setting.words(self.sensor):
                words = np.atleast_1d(setting.choices.index(value) if setting.choices else value)
                writes += [
                    (registers.address(name, index=i), int(word)) for i, word in enumerate(words)
                ]
        if self.sensor.controller:
            writes += [
                (registers.address("share", index=k), int(share))
                for k, share in enumerate(self.shares)
            ]
        mode = sum(
            getattr(self, name).astype(np.int64) << switch.bit for name, switch in SWITCHES.items()
        )
        numbers = [
            name
            for name, of in SUBGROUP.items()
            if of.offset is not None and of.kind is not Kind.MASK
        ]
        for s in range(self.sensor.subgroups):
            writes.append((registers.address(MODE.name, s), int(mode[s])))
            writes += [
                (registers.address(name, s), int(getattr(self, name)[s])) for name in numbers
            ]
            bits = sum(1 << int(i) for i in np.flatnonzero(self.mask[s]))
            for w in range(self.sensor.mask_words):
                writes.append(
                    (
                        registers.address("mask", s, w),
                        bits >> MASK_BITS * w & ((1 << MASK_BITS) - 1),
                    )
                )
        return writes


def load_config(path: FilePath | None = None, changes: Mapping[str, Any] | None = None) -> Config:
    """Read a configuration.

    Parameters
    ----------
    path : str, Path or None
        A TOML file, the name of a preset (`PRESETS`), or None for the defaults.
    changes : dict or None
        Values by key of `SETTINGS`, such as {"window_max": 8}, which replace those of the file's
        tables.

    Returns
    -------
    Config

    Raises
    ------
    InputError
        If the file cannot be read, or a setting is unknown or out of range; the message names
        the key and its range.
    """
    if path is not None and not isinstance(path, str | PathLike):
        message = f"config = {type(path).__name__}: must be a TOML file or a preset"
        raise InputError(f"{message}; parse_config takes tables", field="config")
    if changes is not None and not isinstance(changes, Mapping):
        message = f"changes = {type(changes).__name__}: must be a dict of values by key"
        raise InputError(message, field="changes")
    for name in changes or {}:
        if name not in SETTINGS:
            message = f"{name}: unknown setting, must be one of {', '.join(SETTINGS)}"
            raise InputError(message, field=name)
    document: dict[str, Any] = {}
    try:
        if path is not None:
            document = read_toml(PRESETS.get(str(path), path))
            parse_config(document)
    except InputError as error:
        raise error.within(path) from None
    for name, value in (changes or {}).items():
        table = SETTINGS[name].table
        document[table] = document.get(table, {}) | {name: value}
    return _blaming([SETTINGS[name].key for name in changes or {}], lambda: parse_config(document))


def _blaming(keys: Collection[str], make: Callable[[], Config]) -> Config:
    """Return what `make` returns. An error in another field begins with the keys of the change
    that led to it.
    """
    try:
        return make()
    except InputError as error:
        if not keys or error.field in keys:
            raise
        changed = ", ".join(keys)
        message = f"{changed}: does not go with the other settings ({error})"
        raise InputError(message, field=changed) from None


def changes_of_text(given: Collection[str]) -> dict[str, Any]:
    """Return values by key from texts NAME=VALUE, as a command line has them. Raises `InputError`.

    A VALUE is written as in a file, but needs no quotes.
    """
    changes = {}
    for text in given:
        name, equals, value = text.partition("=")
        if not equals:
            raise InputError(f"--set {text}: must be NAME=VALUE")
        if name not in SETTINGS:
            raise InputError(f"--set {text}: unknown setting, must be one of {', '.join(SETTINGS)}")
        changes[name] = SETTINGS[name].of_text(value)
    return changes


def read_toml(path: FilePath) -> dict[str, Any]:
    """Return the TOML document in a file. Raises `InputError` without the file's name."""
    try:
        return tomllib.loads(Path(path).read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise InputError(f"no such file (presets: {', '.join(PRESETS)})") from None
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"is not TOML: {error}") from None
    except RecursionError:
        raise InputError(
            "is not TOML that can be read: its lists lie too deep in each other"
        ) from None
    except (OSError, ValueError) as error:  # bytes that are no UTF-8, or a NUL in the name
        raise InputError(f"cannot be read ({error})") from None


def toml_text(document: Mapping[str, Mapping[str, object]]) -> str:
    """Return tables of numbers, texts, switches and lists of them as a TOML document, without
    the empty tables.
    """
    tables = [
        "".join(
            [f"[{name}]\n", *(f"{key} = {json.dumps(value)}\n" for key, value in values.items())]
        )
        for name, values in document.items()
        if values
    ]
    return "\n".join(tables)


def parse_config(document: dict[str, Any]) -> Config:
    """Check a configuration that is given as nested dictionaries, like a parsed TOML file.
    Raises `InputError`.

    document: the tables `sensor`, `frame`, `subgroup` and `override`; every table and every key
    may be missing.
    """
    if not isinstance(document, dict):
        message = f"document = {type(document).__name__}: must be a dict of tables"
        raise InputError(f"{message}; load_config reads files and presets", field="document")
    tables = {"sensor": dict, "frame": dict, "subgroup": dict, "override": list}
    for name, value in document.items():
        if name not in tables:
            raise InputError(
                f"[{name}]: unknown table, must be one of {', '.join(tables)}", field=f"[{name}]"
            )
        if not isinstance(value, tables[name]):
            form = "[[override]]" if name == "override" else f"[{name}]"
            raise InputError(f"{name}: must be written as {form}", field=name)
    written = {
        table: _known(table, document.get(table, {}), settings)
        for table, settings in TABLES.items()
    }
    sensor = Sensor(**written["sensor"])
    frame = evolve(frame_defaults(sensor), **_frame(written["frame"], sensor))
    columns = {
        name: _column(
            setting, written["subgroup"].get(name, setting.default_of(sensor, frame)), sensor
        )
        for name, setting in SUBGROUP.items()
    }
    given = frozenset().union(*(_keys(table, keys) for table, keys in written.items()))
    overridden: dict[str, np.ndarray] = {}
    for number, override in enumerate(document.get("override", [])):
        where = f"override[{number}]"
        if not isinstance(override, dict):
            raise InputError(f"{where}: must be a table", field=where)
        values = _known(where, override, ("subgroups", *SUBGROUP))
        chosen = values.pop("subgroups", None)
        if not isinstance(chosen, list):
            last = sensor.subgroups - 1
            raise wrong_value(
                f"{where}.subgroups",
                chosen,
                f"a list of integers from 0 to {last}",
                low=0,
                high=last,
            )
        chosen = [check_integer(f"{where}.subgroups", s, 0, sensor.subgroups - 1) for s in chosen]
        for name, value in values.items():
            columns[name][chosen] = SUBGROUP[name].checked(f"{where}.{name}", value, sensor)
            if name not in written["subgroup"]:
                own = overridden.setdefault(name, np.zeros(sensor.subgroups, bool))
                own[chosen] = True
        given |= _keys("subgroup", values)
    return Config(sensor=sensor, frame=frame, given=given, overridden=overridden, **columns)


def _known(section: str, given: dict[str, Any], legal: Collection[str]) -> dict[str, Any]:
    for name in given:
        if name not in legal:
            key = f"{section}.{name}"
            raise InputError(f"{key}: unknown key, must be one of {', '.join(legal)}", field=key)
    return dict(given)


def _keys(table: str, names: Collection[str]) -> frozenset[str]:
    return frozenset(f"{table}.{name}" for name in names)


def _frame(given: dict[str, Any], sensor: Sensor) -> dict[str, Any]:
    """Return the checked values of some keys of [frame]."""
    settings = {FRAME[name]: value for name, value in _known("frame", given, FRAME).items()}
    return {
        setting.name: setting.checked(setting.key, value, sensor)
        for setting, value in settings.items()
    }


def _column(setting: Setting, value: Any, sensor: Sensor) -> np.ndarray:
    """Return an array with the same checked value for every subgroup."""
    return np.repeat(
        np.asarray(setting.checked(setting.key, value, sensor))[None], sensor.subgroups, axis=0
    )


def sensor_table(sensor: Sensor) -> dict[str, Any]:
    """Return the sensor's part of a configuration file, which has no rule of coincidence."""
    return _lists({name: getattr(sensor, name) for name in SENSOR})


def own_rule(sensor: Sensor) -> dict[str, str]:
    """Return name and version of a rule of coincidence of a user's own, for reports; nothing for
    the paper's rule.
    """
    return {} if sensor.rule == AT_LEAST else {"rule": f"{sensor.rule.name} {sensor.rule.version}"}


def frame_table(frame: FrameSettings) -> dict[str, Any]:
    """Return the frame's part of a configuration file, including keys whose value is None."""
    return _lists(asdict(frame))


def _lists(table: dict[str, Any]) -> dict[str, Any]:
    return {
        name: list(value) if isinstance(value, tuple) else value for name, value in table.items()
    }
