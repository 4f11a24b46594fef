# SPDX-License-Identifier: Apache-2.0
"""Random configurations and edges that provoke trouble: ties, window and gate boundaries, guards,
overfull FIFOs.
"""

import itertools
from typing import Any

import numpy as np
from hypothesis import HealthCheck, Phase, given, seed, settings
from hypothesis import strategies as st

from coincid.model.contract.config import Config, parse_config, sensor_table
from coincid.model.contract.counts import CYCLES_MAX
from coincid.model.contract.edges import Edges
from coincid.model.contract.packet import COUNTS, built_formats
from coincid.model.contract.parameters import Sensor
from coincid.model.contract.pixels import pixel_table
from coincid.model.contract.registers import BY_NAME
from coincid.model.contract.settings import FRAME, SUBGROUP
from coincid.model.contract.table import Kind, Setting
from coincid.model.golden.frame import Golden
from coincid.tb.frame_record import FrameJob

# small ones, so that a case is fast; together they change every parameter from its default
SENSORS = {
    "default": dict(rows=8, cols=16),
    "one": dict(rows=8, cols=8),
    "coarse": dict(rows=8, cols=16, phases=8, window_max=16, rearm=2, fifo_depth=2),
    "tiny": dict(
        rows=12,
        cols=4,
        subgroup=[4, 4],
        minigroup=[1, 1],
        phases=4,
        window_max=20,
        rearm=1,
        fifo_depth=1,
        streams=3,
    ),
    "fine": dict(
        rows=16,
        cols=4,
        subgroup=[8, 4],
        minigroup=[4, 4],
        phases=64,
        coarse_bits=7,
        window_max=200,
        offset_phases=32,
        streams=2,
    ),
    "wide": dict(  # whose maps are no whole number of words
        rows=16,
        cols=10,
        subgroup=[16, 10],
        minigroup=[2, 2],
        phases=16,
        rearm=3,
        fifo_depth=5,
        offset_phases=4,
    ),
    "odd": dict(
        rows=6,
        cols=15,
        subgroup=[6, 3],
        minigroup=[2, 3],
        phases=16,
        window_max=33,
        offset_phases=8,
        streams=2,
        held=0,  # beside a controller
    ),
    "counting": dict(
        rows=4, cols=8, subgroup=[4, 4], phases=8, coarse_bits=9, window_max=20, counts=1
    ),
}
WITH_COUNTS = ("default", "wide")
# the same for tests without RTL: sensors with the format counts are among them
GOLDEN_SENSORS = SENSORS | {name: SENSORS[name] | {"counts": 1} for name in WITH_COUNTS}
LEAN = dict(
    rows=8, cols=16, offsets=0, records=0, controller=0, counter_bits=9, held=0, fifo_depth=3
)
# For fault and mutation tests, which run slow simulators many times: two subgroups of 16 pixels.
SMALL = dict(
    rows=4, cols=8, subgroup=[4, 4], phases=8, coarse_bits=9, window_max=100, rearm=1, fifo_depth=3
)


def configured(
    sensor: dict | Sensor, frame: dict | None = None, subgroup: dict | None = None, *override: dict
) -> Config:
    """Return the configuration of a file with these tables."""
    table = sensor_table(sensor) if isinstance(sensor, Sensor) else sensor
    return parse_config(
        {
            "sensor": table,
            "frame": frame or {},
            "subgroup": subgroup or {},
            "override": list(override),
        }
    )


def built_sensor(sensor: dict) -> Sensor:
    """Return the sensor of a table."""
    return parse_config({"sensor": sensor}).sensor


def legal_values(setting: Setting, sensor: Sensor) -> st.SearchStrategy:
    """Return all legal values of a setting as a file has them."""
    if setting.kind is Kind.MASK:
        return st.integers(0, (1 << sensor.pixels) - 1).map("{:x}".format)
    if setting.kind is Kind.SWITCH:
        return st.sampled_from((False, True)[: 1 + setting.limits(sensor)[1]])
    if setting.name == "format":
        return st.sampled_from(built_formats(sensor))
    return (
        st.sampled_from(setting.choices)
        if setting.choices
        else st.integers(*setting.limits(sensor))
    )


@st.composite
def configurations(draw, sensor: dict, frames_max: int = 2) -> Config:
    """Draw any legal configuration of a sensor, with settings that differ between subgroups."""
    built = built_sensor(sensor)
    period = draw(st.integers(built.guard + 1, min(built.period_max, built.guard + 60)))
    ends = [ticks for ticks in (1, built.phases, built.window_max) if ticks <= built.window_max]
    rare = {  # where few of the legal values are worth trying
        "frames": st.integers(1, frames_max),
        "period": st.just(period),
        "pulses": st.integers(1, 6),
        "clock_mhz": st.just(500.0),
        "link_gbps": st.sampled_from((0.0, 0.0, 0.0, 9.0, 24.7)),
        "mg_threshold": st.integers(1, min(3, built.minigroup_pixels)),
        "gate_step": st.integers(0, 40),
        "gate_every": st.integers(0, 3),
        "gate_steps": st.integers(1, 3),
        "gap": st.sampled_from((0, 0, 1, 2, 13, 100)),
        "dither_bits": st.integers(0, 5),
        "auto_bounds": st.lists(st.integers(0, 300), min_size=6, max_size=6).map(sorted),
        "capacity": st.integers(0, 400),
        "threshold_floor": st.sampled_from((0, 1, 1, 1, 2, 4, 7)),
        "threshold": st.integers(1, 9),  # including values above the controller's highest
        "window": st.one_of(st.integers(1, built.window_max), st.sampled_from(ends)),
        "gate_start": st.integers(0, period - 1),
        "gate_len": st.one_of(
            st.integers(0, period + 3), st.integers(0, 15).map(lambda bit: 1 << bit)
        ),
    }
    frame, of_subgroup = (
        {
            name: rare[name] if name in rare else legal_values(setting, built)
            for name, setting in table.items()
            if setting.words(built)
        }
        for table in (FRAME, SUBGROUP)
    )
    settings = st.fixed_dictionaries({}, optional=of_subgroup)
    frame = draw(st.fixed_dictionaries(frame))
    if frame["format"] == COUNTS.name:
        frame["pulses"] = draw(st.integers(3, 9))
        frame["search_pulses"] = draw(st.integers(1, (frame["pulses"] - 1) // 2))
    base = {"window": draw(rare["window"])} | draw(settings)
    overrides = [
        {"subgroups": draw(st.lists(st.integers(0, built.subgroups - 1), min_size=1, max_size=2))}
        | draw(settings)
        for _ in range(draw(st.integers(0, 2)))
    ]
    return parse_config({"sensor": sensor, "frame": frame, "subgroup": base, "override": overrides})


@st.composite
def controlled(draw, sensor: dict, frames: int) -> Config:
    """Draw frames of a sensor under the threshold controller, with a capacity that is sometimes too
    small.
    """
    built = built_sensor(sensor)
    alone = {"subgroups": draw(st.lists(st.integers(0, built.subgroups - 1), max_size=1))}
    return configured(
        sensor,
        {
            "frames": frames,
            "period": built.guard + draw(st.integers(4, 40)),
            "pulses": draw(st.integers(1, 5)),
            "format": "full" if built.offsets else "id",
            "auto_bounds": [0] + sorted(draw(st.lists(st.integers(0, 60), min_size=5, max_size=5))),
            "capacity": draw(st.integers(0, 60)) * built.subgroups,
            "threshold_floor": draw(st.integers(0, 2)),
        },
        {
            "auto": True,
            "threshold": draw(st.integers(1, 9)),
            "window": draw(st.integers(1, built.window_max)),
        },
        alone | draw(st.sampled_from(({"auto": False}, {"coincidence": False}))),
    )


def scarce(sensor: dict) -> list[Config]:
    """Return consecutive frames of a stream with changing capacity, so that budgets and thresholds
    rise and fall.
    """
    config = configured(
        sensor,
        {"period": 60, "pulses": 4, "auto_bounds": [0, 0, 3, 20, 40, 60]},
        {"auto": True, "threshold": 1},
        {"subgroups": [0], "threshold": 12},
    )
    capacities = (10, 10, 10, 6, 6, 24, 24, 24, 24, 24, 40, 40, 16, 16, 60, 60)
    return [
        config.with_frame(capacity=capacity, threshold_floor=int(capacity == 60) * 3)
        for capacity in capacities
    ]


def modes(sensor: dict) -> list[Config]:
    """Return a configuration for every mode (coincidence, gating, auto) in every format."""
    formats = built_formats(built_sensor(sensor))
    switches = itertools.product((False, True), (False, True), (False, True), formats)
    return [
        configured(
            sensor,
            dict(
                period=60,
                pulses=3,
                format=name,
                minigroup_records=True,
                auto_bounds=[4, 8, 16, 32, 64, 128],
            ),
            {
                "coincidence": coincidence,
                "gating": gating,
                "auto": auto,
                "gate_start": 8,
                "gate_len": 30,
            },
        )
        for coincidence, gating, auto, name in switches
    ]


def gate_bits(sensor: dict) -> list[Config]:
    """Return frames in which every bit of a gate's start and length decides in one subgroup or the
    other.
    """
    built = built_sensor(sensor)
    highest, length = built.period_max - 1, BY_NAME["gate_len"].high(built).bit_length()

    def gates(of_all: dict, of_second: dict) -> Config:
        return configured(
            sensor,
            {"period": built.period_max, "pulses": 1},
            {"gating": True, "threshold": 1} | of_all,
            {"subgroups": [1]} | of_second,
        )

    return [
        gates({"gate_start": 0x5555 & highest, "gate_len": 40}, {"gate_start": 0xAAAA & highest}),
        *(
            gates({"gate_start": 0, "gate_len": 1 << bit}, {"gate_len": 2 << bit})
            for bit in range(0, length, 2)
        ),
    ]


def collections(sensor: dict) -> list[Config]:
    """Return a frame for every length of a minigroup's collection, with records that need two
    pixels, if there are two.
    """
    built = built_sensor(sensor)
    register = BY_NAME["mg_window"]
    frame = dict(
        period=60, pulses=16, minigroup_records=True, mg_threshold=min(2, built.minigroup_pixels)
    )
    windows = range(register.low(built), register.high(built) + 1)
    return [configured(sensor, frame | {"mg_window": cycles}) for cycles in windows]


def dithered(sensor: dict) -> Config:
    """Return a frame whose waits between periods use every bit."""
    built = built_sensor(sensor)
    return configured(
        sensor,
        dict(
            period=built.guard + 8,
            pulses=20,
            dither_bits=BY_NAME["dither_bits"].high(built),
            dither_seed=0xACE1,
        ),
        {"threshold": 1},
    )


def apart(sensor: dict) -> list[Config]:
    """Return frames with gaps that use many bits and their carries, alone and before dither."""
    built = built_sensor(sensor)
    return [
        configured(
            sensor,
            dict(period=built.guard + 8, pulses=3, gap=gap, dither_bits=dither_bits),
            {"threshold": 1},
        )
        for gap, dither_bits in ((1, 0), (1, 1), (2, 3), (255, 0), (256, 4), (2731, 0))
    ]


def overfull(sensor: dict) -> Config:
    """Return a frame that, with a stalling stream, drops events and records, stores some again, and
    drops once more.
    """
    return configured(
        sensor,
        {"period": 60, "pulses": 8, "format": "full", "minigroup_records": True, "mg_threshold": 1},
        {"threshold": 1, "window": 4},
    )


def counting(sensor: dict) -> list[Config]:
    """Return frames of counts, the second one with so many pulses that bins become full; none for a
    sensor without them.
    """
    built = built_sensor(sensor)
    if not built.counts:
        return []
    # more wide bins than there are regions
    frame = dict(period=built.guard + 100, format=COUNTS.name)
    pulses = dict(pulses=120, search_pulses=20)
    return [configured(sensor, frame | {"pulses": 9}), configured(sensor, frame | pulses)]


def lively(sensor: dict) -> Config:
    """Return a frame with many events."""
    built = built_sensor(sensor)
    return configured(
        sensor,
        {"period": built.guard + 60, "pulses": 30},
        {"threshold": 1, "window": 1},
    )


def lengthy(sensor: dict) -> Config:
    """Return a frame with so many pulses and gate steps that counters exceed their low bits."""
    built = built_sensor(sensor)
    return configured(
        sensor,
        {
            "period": built.guard + 6,
            "pulses": 300,
            "format": "id",
            "minigroup_records": True,
            "mg_threshold": 1,
            "gate_every": 2,
            "gate_step": 1,
            "gate_steps": 40,
        },
        {"threshold": 1, "window": 2, "gating": True, "gate_start": 0, "gate_len": 3},
    )


def trouble(config: Config, seed: int, per_subgroup_period: float) -> Edges:
    """Return edges that crowd at rule boundaries, on average `per_subgroup_period` per subgroup and
    period.
    """
    rng = np.random.default_rng(seed)
    sensor, periods = config.sensor, config.frames * config.pulses
    n = rng.poisson(per_subgroup_period * sensor.subgroups * periods)
    pulse = rng.integers(0, periods, n)
    tick = rng.integers(0, config.period_ticks, n)
    if n:
        table = pixel_table(sensor)
        pixel = rng.integers(0, sensor.array_pixels, n)
        # Half of the edges are at a distance from another edge at which a rule changes.
        near = rng.random(n) < 0.5
        other = rng.integers(0, n, n)
        window = config.window[table.subgroup[pixel[other]]]
        armed = sensor.phases * (sensor.rearm + 1) - tick[other] % sensor.phases
        collected = config.frame.mg_window * sensor.phases
        steps = np.stack(
            np.broadcast_arrays(
                0, 1, window - 1, window, window + 1, sensor.phases, armed, collected
            )
        )
        tick = np.where(
            near, tick[other] + steps[rng.integers(0, len(steps), n), np.arange(n)], tick
        )
        pulse = np.where(near, pulse[other], pulse)
        neighbours = np.flatnonzero(near & (rng.random(n) < 0.8))
        members = [np.flatnonzero(table.subgroup == s) for s in range(sensor.subgroups)]
        pixel[neighbours] = [
            rng.choice(members[table.subgroup[pixel[other[k]]]]) for k in neighbours
        ]
        # Some are at the borders of gate, guard and period.
        start, guarded = config.gate_start, config.period - sensor.guard
        special = np.r_[
            0, config.period - 1, guarded, guarded - 1, start, start + config.gate_len, start - 1
        ]
        special = special.clip(0, config.period - 1)
        at_special = rng.random(n) < 0.1
        border = rng.choice(special, n) * sensor.phases + rng.choice((0, sensor.phases - 1), n)
        tick = np.where(at_special, border, tick)
        tick = tick.clip(0, config.period_ticks - 1)
    else:
        pixel = np.zeros(0, np.int64)
    return Edges(pulse.astype(np.int64), pixel.astype(np.int64), tick.astype(np.int64))


def returns(config: Config, seed: int, per_subgroup_period: float) -> Edges:
    """Return edges of one frame, most of them in two returns of each minigroup; some pixels are much
    brighter than others.
    """
    rng = np.random.default_rng(seed)
    sensor = config.sensor
    table = pixel_table(sensor)
    number = rng.poisson(per_subgroup_period * sensor.subgroups * config.pulses)
    bright = rng.random(sensor.array_pixels) ** 3
    pixel = rng.choice(sensor.array_pixels, number, p=bright / bright.sum())
    group = table.subgroup[pixel] * sensor.minigroups + table.minigroup[table.inside[pixel]]
    surfaces = rng.integers(0, config.period_ticks, (2, sensor.subgroups * sensor.minigroups))
    # often the same for neighbours, and often at the borders of the period and of its counted part
    surfaces[:, rng.random(surfaces.shape[1]) < 0.7] = surfaces[:, :1]
    borders = np.array([0, config.period_ticks - 1, sensor.phases * CYCLES_MAX])
    at_border = rng.random(surfaces.shape) < 0.1
    surfaces = np.where(at_border, rng.choice(borders, surfaces.shape), surfaces)
    tick = surfaces[rng.integers(0, 2, number), group] + rng.normal(0, sensor.phases / 2, number)
    even = rng.integers(0, config.period_ticks, number)
    tick = np.where(rng.random(number) < 0.3, even, tick).astype(np.int64)
    return Edges(
        pulse=rng.integers(0, config.pulses, number),
        pixel=pixel,
        tick=tick.clip(0, config.period_ticks - 1),
    )


def aged(sensor: dict) -> tuple[Config, Edges, np.ndarray]:
    """Return a frame, its edges and a pattern of `tready`, so that some events are as old as a
    group allows, and others too old.

    The stream stalls in rounds of 60 pulses: every other subgroup has events early in a round, and
    the others later.
    """
    period = built_sensor(sensor).guard + 6
    config = configured(
        sensor,
        {"period": period, "pulses": 600, "format": "compact"},
        {"threshold": 1, "window": 2},
    )
    edges = trouble(config, 0, 20.0)
    number, within = np.divmod(edges.pulse, 60)
    early = pixel_table(config.sensor).subgroup[edges.pixel] % 2 == 0
    edges = edges.take(np.where(early, within < 10, (within > 14 + number) & (within < 30)))
    return config, edges, np.arange(period * config.pulses) // period % 60 >= 32


def random_edges(config: Config, n: int, seed: int) -> Edges:
    """Return `n` edges of a frame, evenly distributed."""
    rng = np.random.default_rng(seed)
    highs = config.pulses, config.sensor.array_pixels, config.period_ticks
    return Edges(*(rng.integers(0, high, n) for high in highs))


def ready_pattern(seed: int, kind: str, cycles: int) -> np.ndarray:
    """Return `tready` patterns: always ready, stalled from the start, random, in bursts."""
    rng = np.random.default_rng(seed)
    if kind == "always":
        return np.zeros(0, np.uint8)
    if kind == "stalled":
        return np.zeros(int(rng.integers(1, cycles)), np.uint8)
    if kind == "random":
        return (rng.random(cycles) < rng.uniform(0.05, 0.9)).astype(np.uint8)
    return np.repeat(rng.random(cycles // 16 + 1) < 0.5, 16).astype(np.uint8)


def predicted(
    golden: Golden, config: Config, edges: Edges, ready: np.ndarray | None = None
) -> FrameJob:
    """Return a frame to play, with its prediction; the golden model goes on to the next frame."""
    ready = np.zeros(0, np.uint8) if ready is None else ready.astype(np.uint8)
    return FrameJob(config, edges, golden.frame(config, edges, ready), ready)


def generated(examples: int) -> settings:
    """Return settings with which a program draws so many examples, without pytest; with a seed, the
    same in every run.
    """
    return settings(
        max_examples=examples,
        phases=[Phase.generate],
        database=None,
        deadline=None,
        suppress_health_check=list(HealthCheck),
    )


def drawn(strategy: st.SearchStrategy[Any], number: int, of: int | None = None) -> list[Any]:
    """Return so many values. A generator begins with the simplest ones, so the later half of twice
    as many is taken.

    of: seed; None: that of pytest's run.
    """
    values: list[Any] = []

    @generated(2 * number)
    @given(strategy)
    def collect(value: Any) -> None:
        values.append(value)

    if of is not None:
        collect = seed(of)(collect)
    collect()
    return values[number : 2 * number]


READY_KINDS = ("always", "stalled", "random", "bursts")
DENSITIES = (4.0, 20.0, 0.5, 40.0, 12.0)  # of edges, per subgroup and period
