# SPDX-License-Identifier: Apache-2.0
"""Features of the sensor and of its use, and cases in which every pair of them comes up.

A feature has a few values, its usual ones and its ends. Bugs of two features together (an abort of
a frame with dither) are found only by a case that has both, which random cases rarely have. So the
cases of a covering array are played: every pair of values of two features that is legal is in at
least one of them. `test_feature_pairs.py` counts this.
"""

import itertools
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from attrs import frozen

from coincid.model.contract.config import Config
from coincid.model.contract.counts import MINIGROUP, pause_cycles
from coincid.model.contract.edges import Edges
from coincid.model.contract.packet import COUNTS, FORMAT_NAMES, UNBUILT, layout
from coincid.model.golden.frame import Golden, Trace

from .random_cases import READY_KINDS, SENSORS, built_sensor, configured, ready_pattern, trouble

Features = Mapping[str, tuple[Any, ...]]
Choice = tuple[str, Any]  # a feature and one of its values
Pair = frozenset[Choice]
Case = dict[str, Any]  # feature -> value

# Of the sensor as built: sizes, and each switch of what is built.
BUILT: Features = {
    "sizes": ("default", "coarse", "tiny", "fine", "wide", "odd"),
    "offsets": (1, 0),
    "records": (1, 0),
    "controller": (1, 0),
    "counter_bits": (32, 9),
    "held": (1, 0),
    "counts": (0, 1),
    "fifo_depth": (16, 1, 3),
    "streams": (1, 2),
}
# Of a frame, its light and its receiver.
USED: Features = {
    "format": FORMAT_NAMES,
    "minigroup_records": (False, True),
    "mg_threshold": ("one", "two"),
    "mg_window": (2, 1, 4),
    "coincidence": (True, False, "one subgroup without"),
    "window": ("one cycle", "one tick", "longest"),
    "threshold": (1, 3),
    "auto": (False, True),
    "capacity": ("ample", "scarce"),
    "threshold_floor": (1, 0, 3),
    "auto_bounds": ("rising", "always reached"),
    "gate": ("none", "inner", "beyond the period", "empty"),
    "gate steps": ("none", "slow", "many"),
    "mask": ("all", "half", "one subgroup dark"),
    "gap": (0, 1, 2, 90),
    "dither_bits": (0, 3),
    "abort": ("none", "first period", "later", "in a gap"),
    "frames": (1, 3),
    "search_pulses": (1, 3),
    "link_gbps": (0.0, 9.0),
    "receiver": READY_KINDS,
    "light": ("some", "none", "one edge", "crowded"),
}
# What is not built cannot be used.
NO_COUNTS_WITH = tuple(
    name for name in BUILT["sizes"] if built_sensor(SENSORS[name]).minigroup != MINIGROUP
)
REFUSED: frozenset[Pair] = frozenset(
    [frozenset([("offsets", 0), ("format", name)]) for name in UNBUILT]
    + [frozenset([("counts", 0), ("format", COUNTS.name)])]
    + [frozenset([("counts", 0), ("search_pulses", 3)])]
    + [
        frozenset([used, ("sizes", name)])
        for used in (("counts", 1), ("format", COUNTS.name), ("search_pulses", 3))
        for name in NO_COUNTS_WITH
    ]
    + [frozenset([("records", 0), ("minigroup_records", True)])]
    + [frozenset([("controller", 0), ("auto", True)])]
    + [frozenset([("controller", 0), ("threshold_floor", floor)]) for floor in (0, 3)]
)
IMPOSSIBLE: frozenset[Pair] = REFUSED | {frozenset([("gap", 0), ("abort", "in a gap")])}


def impossible_of(features: Features, uncounted_views: Iterable[str] = ()) -> frozenset[Pair]:
    """Return the pairs of values of these features that cannot be built.

    uncounted_views: names of the views that know no quarters of a cycle by pixel, which counts need.
    """
    refused = {pair for pair in REFUSED if dict(pair).keys() <= features.keys()}
    uncounted = {frozenset([("view", name), ("counts", 1)]) for name in uncounted_views}
    return frozenset(refused | uncounted)


# Values with which most frames have events, in which a bug can show.
LIVELY: Features = {
    "light": ("some", "crowded"),
    "gate": ("none", "inner", "beyond the period"),
    "coincidence": (True, "one subgroup without"),
    "threshold": (1,),
}
# A lively frame has none of them: the only subgroup of the sensor would see nothing, or the frame
# ends before it counts in gates.
DARK: frozenset[Pair] = frozenset(
    [
        frozenset([("sizes", "wide"), ("mask", "one subgroup dark")]),
        frozenset([("format", COUNTS.name), ("abort", "first period")]),
        frozenset([("search_pulses", 3), ("abort", "first period")]),
        frozenset([("search_pulses", 3), ("abort", "later")]),
        frozenset([("search_pulses", 3), ("abort", "in a gap")]),
    ]
)
DENSITY = {"some": 12.0, "none": 0.0, "one edge": 0.0, "crowded": 40.0}
PULSES = 8
SEARCH_PULSES = 1  # by default
ABORTED_AFTER = {"none": PULSES, "first period": 1, "later": 5, "in a gap": 3}


def legal_pairs(features: Features, impossible: Iterable[Pair] = IMPOSSIBLE) -> set[Pair]:
    """Return every pair of values of two features that a case can have."""
    pairs = set()
    for (one, values), (other, others) in itertools.combinations(features.items(), 2):
        for value, another in itertools.product(values, others):
            pairs.add(frozenset([(one, value), (other, another)]))
    return pairs - set(impossible)


def pairs_of(case: Case) -> set[Pair]:
    """Return the pairs that a case has."""
    return {frozenset(pair) for pair in itertools.combinations(case.items(), 2)}


def paired_cases(features: Features, impossible: frozenset[Pair] = IMPOSSIBLE) -> list[Case]:
    """Return cases that have every legal pair, and cases that have every one of the lively pairs
    once more.
    """
    lively = covering_cases({**features, **LIVELY}, impossible | DARK)
    return covering_cases(features, impossible) + lively


def lively_pairs(features: Features, impossible: frozenset[Pair] = IMPOSSIBLE) -> set[Pair]:
    """Return the pairs that come up in a frame with events."""
    return legal_pairs({**features, **LIVELY}, impossible | DARK)


def cases_in_turns(features: Features, impossible: frozenset[Pair], turns: int) -> list[Case]:
    """Return cases in which every legal pair comes up in each of so many turns, beside other values."""
    names = list(features)
    cases = []
    for turn in range(turns):
        begin = turn * len(names) // turns
        order = names[begin:] + names[:begin]
        cases += covering_cases({name: features[name] for name in order}, impossible)
    return cases


def covering_cases(features: Features, impossible: frozenset[Pair]) -> list[Case]:
    """Return cases that together have every legal pair, the same in every run.

    Each case begins with a pair that is missing, and takes for one feature after the other the
    value that adds the most missing pairs. impossible: pairs that no case has; every feature needs
    a value that is in none of them.
    """
    rng = np.random.default_rng(1)
    left = legal_pairs(features, impossible)
    # in a fixed order, which that of a set is not
    waiting = sorted(left, key=lambda pair: sorted(map(repr, pair)))
    cases = []
    for first in waiting:
        if first not in left:
            continue
        case: Case = dict(first)
        others = [name for name in features if name not in case]
        for name in rng.permutation(others).tolist():
            case[name] = _best_value(name, features[name], case, left, impossible)
        case = {name: case[name] for name in features}
        left -= pairs_of(case)
        cases.append(case)
    return cases


def _best_value(
    name: str, values: tuple[Any, ...], case: Case, left: set[Pair], impossible: frozenset[Pair]
) -> Any:
    """Return the legal value of a feature that adds the most pairs of `left` to a case."""
    best = None
    most = -1
    for value in values:
        new = {frozenset([(name, value), chosen]) for chosen in case.items()}
        if new & impossible:
            continue
        if len(new & left) > most:
            best = value
            most = len(new & left)
    return best


def features_on(sensors: Mapping[str, dict[str, Any]]) -> tuple[Features, frozenset[Pair]]:
    """Return the features of frames on some sensors, by name, and the pairs that no frame has."""
    impossible = set(IMPOSSIBLE - REFUSED)
    for name, table in sensors.items():
        built = {choice for choice in ({"counts": 0} | table).items() if choice[0] in BUILT}
        for pair in REFUSED:
            if pair & built:
                (used,) = pair - built
                impossible.add(frozenset([("sensor", name), used]))
    of_sensors = [("sensor", name) for name in sensors]
    used = {
        name: tuple(
            value
            for value in values
            if any(frozenset([of, (name, value)]) not in impossible for of in of_sensors)
        )
        for name, values in USED.items()
    }
    return {"sensor": tuple(sensors)} | used, frozenset(impossible)


def sensor_of(case: Case) -> dict[str, Any]:
    """Return the [sensor] table of a case of `BUILT`."""
    table = SENSORS[case["sizes"]] | {name: case[name] for name in BUILT if name != "sizes"}
    return table | {"streams": min(case["streams"], built_sensor(SENSORS[case["sizes"]]).subgroups)}


def config_of(sensor: dict[str, Any], case: Case) -> Config:
    """Return the configuration of a case of `USED`, with the pulses of a frame that is not aborted."""
    built = built_sensor(sensor)
    period = built.guard + 24
    windows = {
        "one tick": 1,
        "one cycle": min(built.phases, built.window_max),
        "longest": built.window_max,
    }
    gates = {
        "none": {"gating": False},
        "inner": {"gating": True, "gate_start": 6, "gate_len": 15},
        "beyond the period": {"gating": True, "gate_start": 3, "gate_len": period + 9},
        "empty": {"gating": True, "gate_start": 3, "gate_len": 0},
    }
    steps = {
        "none": {},
        "slow": {"gate_step": 5, "gate_every": 2, "gate_steps": 2},
        "many": {"gate_step": 1, "gate_every": 1, "gate_steps": 40},
    }
    half = int("5" * 64, 16) & ((1 << built.pixels) - 1)
    masks = {"all": {}, "half": {"mask": f"{half:x}"}, "one subgroup dark": {}}
    of_one = {
        "one subgroup without": {"coincidence": False},
        "one subgroup dark": {"mask": "0"},
    }
    frame = {
        "period": period,
        "pulses": PULSES,
        "mg_threshold": 1 if case["mg_threshold"] == "one" else min(2, built.minigroup_pixels),
        "dither_seed": 0xACE1,
        "auto_bounds": [0, 0, 4, 8, 30, 60] if case["auto_bounds"] == "rising" else [0] * 6,
        "capacity": 1000 if case["capacity"] == "ample" else 3 * built.subgroups,
    }
    names = (
        "format",
        "minigroup_records",
        "mg_window",
        "gap",
        "dither_bits",
        "frames",
        "link_gbps",
    )
    frame |= {name: case[name] for name in names} | steps[case["gate steps"]]
    if built.controller or case["threshold_floor"] != 1:
        frame["threshold_floor"] = case["threshold_floor"]
    of_all = {
        "coincidence": case["coincidence"] is not False,
        "window": windows[case["window"]],
        "threshold": case["threshold"],
        "auto": case["auto"],
    }
    of_all |= gates[case["gate"]] | masks[case["mask"]]
    last = {"subgroups": [built.subgroups - 1]}
    last |= of_one.get(case["coincidence"], {}) | of_one.get(case["mask"], {})
    if case["search_pulses"] != SEARCH_PULSES:
        frame["search_pulses"] = case["search_pulses"]
    if not built.controller:
        for name in ("auto_bounds", "capacity"):
            del frame[name]
    return configured(sensor, frame, of_all, last)


@frozen(eq=False)
class Played:
    """A case as it is played: consecutive frames of one configuration.

    config: of a frame that is not aborted; pulses: that are played of each frame; into_gap: cycles
    of the gap after them up to the abort, 0 if that is not in a gap; frames: the edges of each
    frame; ready: `tready` of the receiver.
    """

    config: Config
    pulses: int
    into_gap: int
    frames: list[Edges]
    ready: np.ndarray

    @property
    def shorter(self) -> Config:
        """The configuration with only the pulses that are played; that of a frame of counts, whose
        steps would be others, stays as it is.
        """
        return self.config if self.config.counting else self.config.with_frame(pulses=self.pulses)

    @property
    def edges(self) -> Edges:
        """Edges of all frames, with pulses of `shorter`."""
        return Edges(
            np.concatenate([of.pulse + self.pulses * k for k, of in enumerate(self.frames)]),
            np.concatenate([of.pixel for of in self.frames]),
            np.concatenate([of.tick for of in self.frames]),
        )

    def traces(self, golden: Golden) -> list[Trace]:
        """Return the frames as the golden model predicts them."""
        pulses = None if self.pulses == self.config.pulses else self.pulses
        return [
            golden.frame(self.config, of, self.ready, pulses, self.into_gap) for of in self.frames
        ]


def played(sensor: dict[str, Any], case: Case, number: int) -> Played:
    """Return light and receiver of a case. number: seed of both."""
    config = config_of(sensor, case)
    pulses = ABORTED_AFTER[case["abort"]]
    of_light = config.with_frame(format="short") if config.counting else config
    one_frame = of_light.with_frame(pulses=pulses, frames=1)
    frames = []
    for k in range(config.frames):
        edges = trouble(one_frame, 100 * number + k, DENSITY[case["light"]])
        if case["light"] == "one edge":
            edges = trouble(one_frame, 100 * number + k, 6.0).take(slice(0, 1))
        frames.append(edges)
    end = int(config.start_cycles()[pulses - 1]) + config.period
    ready = ready_pattern(number, case["receiver"], end + _beats_of_counts(config) + 100)
    into_gap = 0
    if case["abort"] == "in a gap":
        gap = _gap_after(config, pulses)
        into_gap = (1, gap, 1 + number % gap)[number % 3]
    return Played(config, pulses, into_gap, frames, ready)


def _beats_of_counts(config: Config) -> int:
    """Return the beats of a frame's counts."""
    sensor = config.sensor
    packets = sensor.subgroups * sensor.minigroups
    return packets * layout(sensor).length(COUNTS) if config.counting else 0


def _gap_after(config: Config, pulses: int) -> int:
    """Return the cycles between period `pulses` and the next one, without dither's wait."""
    search, gates = pause_cycles(config.sensor.minigroups)
    if config.counting and pulses == config.search_pulses:
        return max(search, config.gap)
    if config.counting and pulses == 2 * config.search_pulses:
        return max(gates, config.gap)
    return config.gap
