# SPDX-License-Identifier: Apache-2.0
"""The configuration: settings by the names and values of the file, in files and in Python, and
their consequences.
"""

import re
import tomllib

import numpy as np
import pytest
from attrs import asdict

from coincid.model.contract import registers
from coincid.model.contract.config import (
    Config,
    changes_of_text,
    frame_table,
    load_config,
    parse_config,
    toml_text,
)
from coincid.model.contract.latency import armed_cycle, close_cycle
from coincid.model.contract.packet import FORMATS
from coincid.model.contract.parameters import SENSOR, Sensor
from coincid.model.contract.preset_files import PRESETS
from coincid.model.contract.registers import address
from coincid.model.light.timing import Timing
from coincid.model.shared.errors import InputError

COUNTING = {"counts": 1}  # a sensor that has every setting
FRAME = {
    "frames": 3,
    "clock_mhz": 125.5,
    "period": 300,
    "pulses": 7,
    "format": "full",
    "minigroup_records": True,
    "mg_threshold": 3,
    "mg_window": 4,
    "gate_step": 2,
    "gate_every": 1,
    "gate_steps": 5,
    "link_gbps": 4.0,
    "gap": 11,
    "dither_bits": 3,
    "dither_seed": 9,
    "auto_bounds": [1, 2, 3, 4, 5, 6],
    "capacity": 4000,
    "threshold_floor": 2,
    "search_pulses": 2,
}
SUBGROUP = dict(
    coincidence=False,
    gating=True,
    auto=True,
    threshold=3,
    window=20,
    gate_start=4,
    gate_len=9,
    mask="ff00ff",
)


def same(one, other):
    assert one.sensor == other.sensor
    assert one.frame == other.frame
    for name in SUBGROUP:
        a, b = getattr(one, name), getattr(other, name)
        assert a.dtype == b.dtype and np.array_equal(a, b), name
    assert one.register_writes() == other.register_writes()


def test_settings_in_python_are_those_of_the_file():
    written = parse_config({"sensor": COUNTING, "frame": FRAME, "subgroup": SUBGROUP})
    assert frame_table(written.frame) == FRAME
    derived = {"capacity", "auto_bounds", "search_pulses"}
    usual = frame_table(parse_config({}).frame)
    assert {name for name, value in usual.items() if value is None} == derived
    same(parse_config({"sensor": COUNTING}).with_frame(**FRAME).with_settings(**SUBGROUP), written)
    plain = {
        name: np.array([value])[0] if isinstance(value, int) else value
        for name, value in SUBGROUP.items()
    }
    same(parse_config({"sensor": COUNTING, "frame": FRAME}).with_settings(**plain), written)


def test_settings_of_every_subgroup():
    overrides = [
        {"subgroups": [s], "threshold": 1 + s, "mask": f"{1 << s:x}", "auto": bool(s % 2)}
        for s in range(16)
    ]
    written = parse_config({"override": overrides})
    lists = {name: [one[name] for one in overrides] for name in ("threshold", "mask", "auto")}
    same(parse_config({}).with_settings(**lists), written)
    same(
        parse_config({}).with_settings(**{name: getattr(written, name) for name in lists}), written
    )


@pytest.mark.parametrize(
    ("table", "settings", "words"),
    [
        ("frame", {"formt": "id"}, ("frame.formt", "format")),
        ("frame", {"format": "long"}, ("frame.format = 'long'", "short, id, full")),
        ("frame", {"format": 2}, ("frame.format = 2", "short, id, full")),
        ("frame", {"minigroup_records": 1}, ("frame.minigroup_records = 1", "true or false")),
        ("frame", {"frames": 0}, ("frame.frames = 0", "from 1 to 65536")),
        ("frame", {"pulses": 2.0}, ("frame.pulses = 2.0", "from 1 to 65536")),
        ("frame", {"pulses": None}, ("frame.pulses = None", "from 1 to 65536")),
        ("frame", {"format": None}, ("frame.format = None", "short, id, full")),
        ("frame", {"period": 3}, ("frame.period = 3", "from 6 to 1024")),
        ("frame", {"clock_mhz": 0}, ("frame.clock_mhz = 0", "from 0.001 to 100000")),
        ("frame", {"clock_mhz": 10**400}, ("frame.clock_mhz", "from 0.001 to 100000")),
        ("frame", {"clock_mhz": float("nan")}, ("frame.clock_mhz = nan", "from 0.001 to 100000")),
        ("frame", {"clock_mhz": "500"}, ("frame.clock_mhz = '500'", "from 0.001 to 100000")),
        ("frame", {"clock_mhz": True}, ("frame.clock_mhz = True", "from 0.001 to 100000")),
        ("frame", {"auto_bounds": [1, 2]}, ("frame.auto_bounds", "6 integers")),
        ("frame", {"auto_bounds": [6, 5, 4, 3, 2, 1]}, ("frame.auto_bounds", "descend")),
        ("frame", {"capacity": -1}, ("frame.capacity = -1", "from 0 to 4294967295")),
        ("frame", {"threshold_floor": 8}, ("frame.threshold_floor = 8", "from 0 to 7")),
        ("subgroup", {"treshold": 2}, ("subgroup.treshold", "threshold")),
        ("subgroup", {"threshold": 65}, ("subgroup.threshold = 65", "from 1 to 64")),
        ("subgroup", {"threshold": 2.5}, ("subgroup.threshold = 2.5", "from 1 to 64")),
        ("subgroup", {"threshold": None}, ("subgroup.threshold = None", "from 1 to 64")),
        ("subgroup", {"auto": None}, ("subgroup.auto = None", "true or false")),
        ("subgroup", {"gate_len": None}, ("subgroup.gate_len = None", "from 0 to 65535")),
        ("subgroup", {"threshold": [1] * 15 + [0]}, ("subgroup.threshold[15] = 0", "from 1 to 64")),
        ("subgroup", {"threshold": [1, 2]}, ("subgroup.threshold", "2 values", "16")),
        ("subgroup", {"coincidence": 1}, ("subgroup.coincidence = 1", "true or false")),
        ("subgroup", {"mask": 255}, ("subgroup.mask = 255", "hex digits")),
        ("subgroup", {"mask": "g"}, ("subgroup.mask = 'g'", "hex digits")),
        ("subgroup", {"mask": ""}, ("subgroup.mask = ''", "hex digits")),
        ("subgroup", {"window": -1}, ("subgroup.window = -1", "from 1 to 128")),
        ("subgroup", {"gating": True, "gate_start": 250}, ("gate_start = 250", "from 0 to 249")),
    ],
)
def test_settings_that_are_refused(table, settings, words):
    change = {"frame": Config.with_frame, "subgroup": Config.with_settings}[table]
    with pytest.raises(InputError) as error:
        change(parse_config({}), **settings)
    assert all(word in str(error.value) for word in words)
    with pytest.raises(InputError):
        parse_config({table: settings})


@pytest.mark.parametrize(
    ("frame", "told"),
    [
        ({"format": "full"}, "frame.format = 'full': must be one of short, id, compact, because"),
        ({"format": "compact-full"}, "without coarse offsets (sensor.offsets = 0)"),
        (
            {"minigroup_records": True},
            "minigroup_records: must be false, because the sensor is built without minigroup",
        ),
        (
            {"capacity": 9},
            "frame.capacity: must be left out, because the sensor is built without the threshold",
        ),
        (
            {"threshold_floor": 2},
            "must be 1, because the sensor is built without the threshold controller",
        ),
    ],
)
def test_what_is_not_built_is_refused(frame, told):
    sensor = {"offsets": 0, "records": 0, "controller": 0}
    config = parse_config({"sensor": sensor})
    assert not config.frame.minigroup_records
    assert {address("share"), address("auto_bounds")}.isdisjoint(dict(config.register_writes()))
    with pytest.raises(
        InputError,
        match=re.escape("subgroup.auto: must be false, because the sensor is built without"),
    ):
        config.with_settings(auto=True)
    with pytest.raises(InputError, match=re.escape(told)):
        parse_config({"sensor": sensor, "frame": frame})


@pytest.mark.parametrize(
    ("preset", "clock_mhz", "tick_s"),
    [(None, 500, 62.5e-12), ("silicon", 500, 62.5e-12), ("fpga", 125, 1e-9)],
)
def test_presets_have_their_clock(preset, clock_mhz, tick_s):
    config = load_config(preset)
    timing = Timing.from_config(config)
    assert (config.clock_mhz, config.tick_s) == (clock_mhz, tick_s)
    assert (timing.clock_hz, timing.tick_s) == (clock_mhz * 1e6, tick_s)
    assert timing.range_m == pytest.approx(299_792_458 / 2 * config.period_ticks * tick_s)


EIGHT_PHASES = {"phases": 8, "window_max": 16}
OF_PRESETS = {  # what is not the default: sensor, frame, subgroup
    "silicon": ({}, {}, {}),
    "lean": (
        {"offsets": 0, "records": 0, "controller": 0, "counter_bits": 16, "held": 0}
        | {"coarse_bits": 8, "fifo_depth": 8},
        {},
        {},
    ),
    "fpga": (EIGHT_PHASES, {"clock_mhz": 125, "period": 63}, {"window": 2}),
    "emulator": (
        EIGHT_PHASES | {"rows": 8, "cols": 8, "subgroup": [4, 4]},
        {"clock_mhz": 87.5, "period": 63},
        {"window": 4},
    ),
    "emulator-axi": (
        EIGHT_PHASES | {"minigroup": [4, 4]},
        {"clock_mhz": 125, "period": 63},
        {"window": 4},
    ),
}


@pytest.mark.parametrize("preset", PRESETS)
def test_numbers_of_a_preset_are_those_that_pages_tell(preset):
    """And have been so in every release: results of a preset can be made again."""
    tables = dict(zip(("sensor", "frame", "subgroup"), OF_PRESETS[preset], strict=True))
    same(load_config(preset), parse_config(tables))


@pytest.mark.parametrize(
    "sensor", [{}, {"counts": 1}, {"streams": 4}, {"subgroup": [4, 4]}], ids=str
)
def test_registers_are_in_the_order_of_their_addresses_and_none_lies_on_another(sensor):
    """As the documents, the headers and the register files list them."""
    built = parse_config({"sensor": sensor}).sensor
    for table in (registers.GLOBAL, registers.SUBGROUP):
        placed = [
            (offset, register.access) for offset, register, _ in registers.words(table, built)
        ]
        offsets = [offset for offset, _ in placed]
        assert len(set(offsets)) == len(offsets)
        assert all(offset % 4 == 0 for offset in offsets)
        for kind in {access for _, access in placed}:
            of_kind = [offset for offset, access in placed if access is kind]
            assert of_kind == sorted(of_kind)


def test_the_clock_is_no_register():
    assert (
        parse_config({}).register_writes()
        == parse_config({"frame": {"clock_mhz": 100}}).register_writes()
    )


def test_events_of_a_frame_follow_the_pulses():
    config = parse_config(
        {"frame": {"pulses": 100, "auto_bounds": [10, 20, 30, 40, 50, 60], "capacity": 1001}}
    )
    half = config.with_pulses(50)
    assert half.frame.auto_bounds == (5, 10, 15, 20, 25, 30)
    assert half.capacity == 500
    default = parse_config({}).with_pulses(50)
    same(default, parse_config({"frame": {"pulses": 50}}))


@pytest.mark.parametrize("gap", [0, 100, 8351, 8353, 13_343, 13_345, 1 << 20])
def test_a_pause_of_counts_is_no_shorter_than_the_gap(gap):
    """The gap is part of it. With ten pulses, a search has two."""
    config = parse_config(
        {
            "sensor": {"rows": 8, "cols": 8, "counts": 1},
            "frame": {"format": "counts", "pulses": 10, "gap": gap},
        }
    )
    waits = np.diff(config.start_cycles()[:-1]) - config.period
    pauses = {1: 832 * 16 + 32, 3: 520 * 16 + 32}  # of 16 minigroups
    assert waits.tolist() == [max(gap, pauses.get(pulse, 0)) for pulse in range(9)]
    assert config.frame_cycles == waits.sum() + 10 * config.period


def test_with_few_pulses_a_search_has_one():
    config = parse_config(
        {"sensor": {"counts": 1}, "frame": {"format": "counts", "search_pulses": 20}}
    )
    assert config.with_pulses(4).search_pulses == 1


def test_what_follows_the_period_follows_it_beside_an_override():
    """The subgroups that an override names keep its value, the others have the new period's."""
    override = {"subgroups": [1, 3], "gate_len": 250}
    config = parse_config({"override": [override]})
    written = parse_config({"frame": {"period": 400}, "override": [override]})
    same(config.with_frame(period=400), written)
    same(config.with_sensor(rearm=1).with_frame(period=400), written.with_sensor(rearm=1))
    with pytest.raises(InputError, match=r"subgroup\.gate_len: has 16 values, must have one or 8"):
        config.with_sensor(rows=16)
    of_all = config.with_settings(gate_len=config.gate_len)
    assert (of_all.with_frame(period=400).gate_len == 250).all()
    overrides = [override, {"subgroups": [2], "gate_len": 100}]
    two = parse_config({"override": overrides}).with_frame(period=400)
    same(two, parse_config({"frame": {"period": 400}, "override": overrides}))
    table = parse_config({"subgroup": {"gate_len": 20}, "override": [override]})
    assert (table.with_frame(period=400).gate_len == table.gate_len).all()


def test_events_of_a_frame_stay_within_their_limits():
    largest = 2**32 - 1
    bounds = [*range(5), largest]
    config = parse_config({"frame": {"pulses": 100, "auto_bounds": bounds, "capacity": largest}})
    more = config.with_pulses(200)
    assert more.frame.auto_bounds == (0, 2, 4, 6, 8, largest)
    assert more.capacity == largest


@pytest.mark.parametrize(
    ("frame", "window", "bounds"),
    [
        ({}, 16, [401, 4154, 9656, 14042, 16949, 18836]),
        ({"pulses": 50}, 16, [201, 2077, 4828, 7021, 8475, 9418]),
    ],
)
def test_default_bounds(frame, window, bounds):
    assert (
        parse_config({"frame": frame, "subgroup": {"window": window}}).auto_bounds.tolist()
        == bounds
    )


@pytest.mark.parametrize("longest", [0, 7, 15])
def test_default_bounds_are_those_of_the_longest_window(longest):
    """Whichever subgroup has it."""
    window = np.full(16, 16)
    window[longest] = 40
    bounds = parse_config({}).with_settings(window=window).auto_bounds
    assert np.array_equal(bounds, parse_config({"subgroup": {"window": 40}}).auto_bounds)


@pytest.mark.parametrize(("window", "rearm"), [(16, 0), (16, 2), (40, 0), (100, 1)])
def test_default_bounds_keep_noise_rare(window, rearm):
    """Count photon by photon: with the threshold that the bounds demand, noise commits at most
    four windows per pulse.

    With the next lower threshold, it commits more."""
    config = parse_config(
        {"sensor": {"rearm": rearm, "window_max": 100}, "subgroup": {"window": window}}
    )
    rng = np.random.default_rng(1)
    periods, counts = 400, []
    for _ in range(periods):
        arrivals = np.sort(
            rng.integers(0, config.period_ticks, rng.poisson(0.4 / window * config.period_ticks))
        )
        armed, end = 0, (config.period - config.sensor.guard) * config.sensor.phases
        while (first := np.searchsorted(arrivals, armed)) < np.searchsorted(arrivals, end):
            opening = arrivals[first]
            counts.append(np.searchsorted(arrivals, opening + window) - first)
            armed = (
                armed_cycle(close_cycle(opening, window, config.sensor.phases), rearm)
                * config.sensor.phases
            )
    needed = 1 + np.searchsorted(
        config.auto_bounds, len(counts) * config.pulses / periods, side="right"
    )
    commits = [
        np.sum(np.array(counts) >= threshold) / periods for threshold in (needed - 1, needed)
    ]
    assert commits[0] > 3.5 and commits[1] < 4.5


@pytest.mark.parametrize(
    ("sensor", "frame", "capacity", "shares"),
    [
        ({}, {}, 12_500, [781]),
        ({"streams": 4}, {}, 12_500, [3125] * 4),
        ({"rows": 8, "streams": 3}, {}, 12_500, [6250, 12_500, 12_500]),
        ({}, {"format": "short"}, 25_000, [1562]),
        ({}, {"format": "full"}, 6250, [390]),
        ({}, {"format": "compact"}, 12_500, [781]),
        # an event of six pixels has 58 bits, with offsets 100; a beat has 59
        ({}, {"format": "compact", "link_gbps": 8.0}, 6250 * 59 // 58, [397]),
        ({}, {"format": "compact-full", "link_gbps": 8.0}, 6250 * 59 // 100, [230]),
        # the last stamp of 256 cycles of 32 ticks has no more bits
        (
            {},
            {"format": "compact", "link_gbps": 8.0, "period": 256},
            6400 * 59 // 58,
            [406],
        ),
        ({}, {"minigroup_records": True}, (25_000 - 100 * 16 * 5) // 2, [531]),
        # the stream with two subgroups may send two records in a period
        (
            {"rows": 8, "streams": 3},
            {"minigroup_records": True},
            (25_000 - 100 * 2 * 5) // 2,
            [6000, 12_000, 12_000],
        ),
        ({"rows": 64, "cols": 64}, {"minigroup_records": True}, 0, [0]),
        ({}, {"capacity": 100}, 100, [6]),
        ({}, {"capacity": 0}, 0, [0]),
        ({}, {"gap": 100}, (25_000 + 99 * 100) // 2, [1090]),
        ({}, {"gap": 10_000}, 12_500 + 99 * 16 * 16, [2365]),
        ({}, {"gap": 10_000, "link_gbps": 8.0}, 3125 + 99 * 16 * 16, [1779]),
        ({"streams": 4}, {"gap": 10_000}, 12_500 + 99 * 16 * 4, [4709] * 4),
        ({"rows": 8, "streams": 3}, {"gap": 10_000}, 12_500 + 99 * 16, [7042, 14_084, 14_084]),
        # a register cannot hold more
        (
            {"rows": 256, "cols": 512, "fifo_depth": 1024},
            {"gap": 1 << 20, "pulses": 1 << 16},
            2**32 - 1,
            [(2**32 - 1) // 2048],
        ),
    ],
)
def test_capacity_of_a_stream(sensor, frame, capacity, shares):
    config = parse_config({"sensor": sensor, "frame": frame})
    assert (config.capacity, config.shares.tolist()) == (capacity, shares)
    writes = dict(config.register_writes())
    assert writes[address("capacity")] == capacity
    assert [writes[address("share", index=k)] for k in range(len(shares))] == shares


@pytest.mark.parametrize(
    ("sensor", "steps"),
    [
        ({}, 16),
        ({"phases": 8, "window_max": 16}, 8),
        ({"phases": 64, "offset_phases": 4}, 4),
        ({"window_max": 224, "offset_phases": 32}, 32),
    ],
)
def test_steps_of_a_cycle_that_offsets_count(sensor, steps):
    built = parse_config({"sensor": sensor}).sensor
    assert built.offset_phases == steps
    assert built.offset_ticks * steps == built.phases


@pytest.mark.parametrize(
    ("document", "settings"),
    [
        ({"sensor": {"window_max": 8}}, {"window": 8}),
        ({"sensor": {"coarse_bits": 7}}, {"period": 128, "gate_len": 128}),
        ({"sensor": {"minigroup": [1, 1]}}, {"mg_threshold": 1}),
        ({"frame": {"period": 100}}, {"gate_len": 100}),
        ({"sensor": {"phases": 64}}, {"coarse_bits": 9}),
    ],
)
def test_defaults_follow_what_is_written(document, settings):
    config = parse_config(document)
    found = (
        asdict(config.sensor)
        | frame_table(config.frame)
        | {name: getattr(config, name) for name in SUBGROUP}
    )
    assert all(np.all(found[name] == value) for name, value in settings.items())
    assert config.given == {
        f"{table}.{name}" for table, values in document.items() for name in values
    }


def test_what_was_written_is_known():
    config = parse_config(
        {"subgroup": {"window": 16}, "override": [{"subgroups": [3], "threshold": 2}]}
    )
    assert config.given == {"subgroup.window", "subgroup.threshold"}
    overrides = [
        {"subgroups": [3], "threshold": 2, "auto": True},
        {"subgroups": [4], "gating": True, "mask": "f"},
    ]
    assert parse_config({"override": overrides}).given == {
        "subgroup.threshold",
        "subgroup.auto",
        "subgroup.gating",
        "subgroup.mask",
    }
    assert config.with_frame(pulses=100).with_settings(auto=False).given == config.given | {
        "frame.pulses",
        "subgroup.auto",
    }


def test_settings_as_text():
    given = [
        "threshold=3",
        "format=full",
        "mask=10",
        "auto=true",
        "link_gbps=8",
        "subgroup=4x4",
        "minigroup=[2,4]",
    ]
    given += ["auto_bounds=[1, 2, 3, 4, 5, 6]"]
    config = load_config("fpga", changes_of_text(given))
    assert (config.sensor.subgroup, config.sensor.minigroup, config.period) == ((4, 4), (2, 4), 63)
    assert (config.format, config.frame.link_gbps, config.auto_bounds.tolist()) == (
        "full",
        8.0,
        [1, 2, 3, 4, 5, 6],
    )
    assert (
        np.all(config.threshold == 3)
        and np.all(config.auto)
        and np.all(config.mask[:, 4])
        and config.mask.sum() == 64
    )
    assert changes_of_text(["rows=8", "cols=9", "rows=16"]) == {"rows": 16, "cols": 9}
    for text, words in (
        ("threshold", "NAME=VALUE"),
        ("moon=1", "unknown"),
        ("threshold=many", "from 1 to 64"),
    ):
        with pytest.raises(InputError, match=words):
            load_config(None, changes_of_text([text]))


def test_defaults_of_settings_follow_other_settings():
    longer = parse_config({}).with_frame(period=1000).with_settings(gating=True)
    same_gate = parse_config({"frame": {"period": 1000}, "subgroup": {"gating": True}})
    assert longer.register_writes() == same_gate.register_writes()
    assert parse_config({"subgroup": {"gate_len": 9}}).with_frame(period=1000).gate_len.max() == 9


def test_another_sensor_keeps_what_was_written():
    config = parse_config({"frame": {"pulses": 7}, "subgroup": {"threshold": 3}})
    large = config.with_sensor(rows=64, cols=64, window_max=8)
    written = {
        "sensor": {"rows": 64, "cols": 64, "window_max": 8},
        "frame": {"pulses": 7},
        "subgroup": {"threshold": 3},
    }
    assert large.register_writes() == parse_config(written).register_writes()
    assert large.given == parse_config(written).given
    thresholds = config.with_settings(threshold=np.arange(16) % 3 + 1, mask="ff")
    assert np.array_equal(thresholds.with_sensor(streams=2).threshold, thresholds.threshold)
    assert np.array_equal(thresholds.with_sensor(streams=2).mask, thresholds.mask)
    with pytest.raises(
        InputError,
        match=r"^sensor.rows: does not go with .*threshold: has 16 values, must have one or 8",
    ):
        thresholds.with_sensor(rows=16)
    with pytest.raises(InputError, match="sensor.row: unknown key"):
        config.with_sensor(row=16)


@pytest.mark.parametrize(
    ("preset", "changes", "begins"),
    [
        (None, {"rows": 30}, "sensor.rows = 30: must be a multiple of 8"),
        (
            None,
            {"subgroup": [3, 8]},
            "sensor.subgroup = [3, 8]: must divide rows x cols = [32, 32]",
        ),
        (None, {"subgroup": [3, 8], "rows": 33}, "sensor.subgroup = [3, 8]: "),
        (None, {"cols": 4}, "sensor.cols = 4: "),
        (None, {"rows": 4096, "cols": 512}, "sensor.rows = 4096: "),
        (None, {"phases": 4, "coarse_bits": 3}, "sensor.coarse_bits = 3: "),
        (None, {"coarse_bits": 14}, "sensor.coarse_bits = 14: "),
        (None, {"phases": 12}, "sensor.phases = 12: "),
        (None, {"fifo_depth": 4000}, "sensor.fifo_depth = 4000: "),
        (None, {"offset_phases": 2}, "sensor.offset_phases = 2: must be an integer from 4 to 32"),
        (
            None,
            {"offset_phases": 12},
            "sensor.offset_phases = 12: must be a power of two from 4 to 32",
        ),
        (
            None,
            {"phases": 8, "offset_phases": 16},
            "sensor.offset_phases = 16: must be an integer from 4 to 8",
        ),
        (
            None,
            {"window_max": 225, "offset_phases": 32},
            "sensor.window_max = 225: must be an integer from 1 to 224 with sensor.phases = 32 and sensor.offset_phases = 32",
        ),
        (
            "fpga",
            {"coarse_bits": 5},
            "sensor.coarse_bits: does not go with the other settings (frame.period = 63",
        ),
        ("fpga", {"threshold": 99}, "subgroup.threshold = 99: must be"),
        (
            "fpga",
            {"rows": 16, "coarse_bits": 5},
            "sensor.rows, sensor.coarse_bits: does not go with the other settings (frame.period = 63",
        ),
        (
            None,
            {"rows": 8, "cols": 16, "streams": 3},
            "sensor.streams = 3: must be an integer from 1 to 2 (the subgroups)",
        ),
        (
            None,
            {"minigroup": [3, 2]},
            "sensor.minigroup = [3, 2]: must divide subgroup = [8, 8] without rest",
        ),
        (
            None,
            {"rows": 30, "subgroup": [5, 8]},
            "sensor.subgroup = [5, 8]: must be a multiple of 2, because of sensor.minigroup = [2, 2]",
        ),
        (
            None,
            {"counts": 1, "minigroup": [2, 4]},
            "sensor.minigroup = [2, 4]: must be [2, 2], because the sensor is built with counts"
            " (sensor.counts = 1)",
        ),
        (
            None,
            {"rows": 520, "cols": 512},
            "sensor.rows = 520: there are 4160 subgroups, must be at most 4096",
        ),
        (
            None,
            {"format": "counts"},
            "frame.format = 'counts': must be one of short, id, full, compact, compact-full, because"
            " the sensor is built without counts (sensor.counts = 0)",
        ),
        (
            None,
            {"search_pulses": 3},
            "frame.search_pulses: must be left out, because the sensor is built without counts"
            " (sensor.counts = 0)",
        ),
        (None, {"auto_bounds": [1, 2, 3, 5, 4, 6]}, "frame.auto_bounds = [1, 2, 3, 5, 4, 6]: must"),
    ],
)
def test_a_message_begins_with_the_key_that_was_written(preset, changes, begins):
    with pytest.raises(InputError) as error:
        load_config(preset, changes)
    assert str(error.value).startswith(begins)


@pytest.mark.parametrize(
    "text",
    ["a = " + "[" * 5000, "[frame]\npulses = " + "9" * 5000, "\0", "\ufeff[frame]", "x" * 10_000],
    ids=["deep lists", "digits", "NUL", "a mark of the byte order", "a long word"],
)
def test_what_no_reader_of_toml_takes_is_refused(tmp_path, text):
    (tmp_path / "odd.toml").write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match="odd.toml: "):
        load_config(tmp_path / "odd.toml")


@pytest.mark.parametrize("value", ["9" * 5000, "[" * 5000])
def test_a_value_of_the_command_line_that_no_reader_takes_is_refused(value):
    with pytest.raises(InputError, match="frame.pulses = "):
        load_config(None, changes_of_text([f"pulses={value}"]))


@pytest.mark.parametrize("subgroup", [[4, 4], [8, 8], [8, 9], [16, 16]])
def test_a_mask_ends_with_the_last_pixel(subgroup):
    rows, cols = subgroup
    sensor = {"rows": rows, "cols": cols, "subgroup": subgroup, "minigroup": [1, 1]}
    whole = (1 << rows * cols) - 1
    for mask in (0, 1, whole - 1, whole):
        read = parse_config({"sensor": sensor, "subgroup": {"mask": f"{mask:x}"}}).mask[0]
        assert sum(int(on) << i for i, on in enumerate(read)) == mask
    for mask in (whole + 1, whole + 2, whole << 1):
        with pytest.raises(InputError, match=rf"hex digits below 2\^{rows * cols} "):
            parse_config({"sensor": sensor, "subgroup": {"mask": f"{mask:x}"}})


def test_an_error_in_an_override_names_it():
    """Not the setting of all subgroups, which is right."""
    good = {"subgroups": [0], "threshold": 3}
    bad = {"subgroups": [1], "threshold": 0}
    with pytest.raises(InputError, match=r"^override\[1\]\.threshold = 0"):
        parse_config({"override": [good, bad]})


@pytest.mark.parametrize("late", [[5], [5, 7], [0, 15]])
def test_a_gate_behind_the_period_is_told_with_its_subgroup_and_its_start(late):
    """The first one of those that are on; a gate that is off may be anywhere."""
    starts = 250 + np.arange(16)
    gating = np.isin(np.arange(16), late)
    with pytest.raises(InputError) as raised:
        parse_config({}).with_settings(gate_start=starts, gating=gating)
    assert str(raised.value) == (
        f"subgroup.gate_start = {250 + late[0]}: must be an integer from 0 to 249"
        f" (subgroup {late[0]}: gating is on and the period has 250 cycles)"
    )
    assert (parse_config({}).with_settings(gate_start=starts).gate_start == starts).all()


@pytest.mark.parametrize(
    ("document", "message", "field"),
    [
        ({"moon": {}}, "[moon]: unknown table, must be one of sensor, frame, subgroup", "[moon]"),
        ({"frame": []}, "frame: must be written as [frame]", "frame"),
        ({"sensor": 3}, "sensor: must be written as [sensor]", "sensor"),
        ({"override": {}}, "override: must be written as [[override]]", "override"),
        ({"override": [3]}, "override[0]: must be a table", "override[0]"),
        (
            {"override": [{"subgroups": [0]}, {"threshold": 2}]},
            "override[1].subgroups = None: must be a list of integers from 0 to 15",
            "override[1].subgroups",
        ),
        (
            {"override": [{"subgroups": 3}]},
            "override[0].subgroups = 3: must be a list of integers from 0 to 15",
            "override[0].subgroups",
        ),
        (
            {"override": [{"subgroups": [15, 16]}]},
            "override[0].subgroups = 16: must be an integer from 0 to 15",
            "override[0].subgroups",
        ),
        (
            {"override": [{"subgroups": [0], "period": 3}]},
            "override[0].period: unknown key, must be one of subgroups, coincidence, gating,",
            "override[0].period",
        ),
    ],
)
def test_tables_of_another_form_are_refused_by_their_name(document, message, field):
    with pytest.raises(InputError) as raised:
        parse_config(document)
    assert str(raised.value).startswith(message)
    assert raised.value.field == field


@pytest.mark.parametrize("format_name", FORMATS)
def test_depth_needs_a_map_or_counts(format_name):
    """The message names the formats that have a map, and no others."""
    config = parse_config({"sensor": COUNTING, "frame": {"format": format_name}})
    if format_name != "short":
        config.check_map()
        return
    with pytest.raises(InputError) as raised:
        config.check_map()
    assert str(raised.value) == (
        "frame.format = 'short': must be id or full or compact or compact-full,"
        " because depth needs the ID map"
    )


def test_the_last_of_several_overrides_counts():
    overrides = [
        {"subgroups": [1, 2], "threshold": 3},
        {"subgroups": [2, 4], "threshold": 5, "window": 9},
    ]
    config = parse_config({"subgroup": {"threshold": 4}, "override": overrides})
    assert config.threshold[:6].tolist() == [4, 3, 5, 4, 5, 4]
    assert config.window[:6].tolist() == [16, 16, 9, 16, 9, 16]


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("[frame]\npulses = = 3\n", r"a\.toml: is not TOML: .*line 2"),
        ("[frame]\npulses = 3\npulses = 4\n", r"a\.toml: is not TOML: .*line 3"),
    ],
)
def test_a_file_that_is_no_toml_is_told_with_the_place(tmp_path, text, told):
    path = tmp_path / "a.toml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=told):
        load_config(path)
    path.write_bytes(b"[frame]\n# 5 \xb5s\n")  # in an encoding of its own
    with pytest.raises(InputError, match=r"a\.toml: cannot be read \(.*utf-8"):
        load_config(path)
    with pytest.raises(InputError, match=r"none\.toml: no such file \(presets: .*silicon.*\)$"):
        load_config(tmp_path / "none.toml")
    with pytest.raises(InputError, match=r"cannot be read \(.*Is a directory"):
        load_config(tmp_path)


def test_tables_come_back_from_their_text_without_the_empty_ones():
    tables = {
        "sensor": {"rows": 8, "subgroup": [4, 8]},
        "frame": {},
        "subgroup": {"auto": [True, False], "mask": "ff", "window": 7},
    }
    text = toml_text(tables)
    assert tomllib.loads(text) == {name: of for name, of in tables.items() if of}
    assert "[frame]" not in text


@pytest.mark.parametrize("mask", ["0xff", "0XFF", "FF", "ff", "00ff"])
def test_a_mask_is_written_as_any_hex_digits(mask):
    assert np.flatnonzero(parse_config({"subgroup": {"mask": mask}}).mask[0]).tolist() == [
        *range(8)
    ]


@pytest.mark.parametrize("mask", ["0x", "x", "-1", "f f", "f_f", "ff\n", [True] * 63, [1] * 64])
def test_what_is_no_mask_is_refused(mask):
    with pytest.raises(InputError, match=r"^subgroup\.mask = .*: must be a string of hex digits"):
        parse_config({"subgroup": {"mask": mask}})


@pytest.mark.parametrize(
    ("name", "value", "legal"),
    [
        ("subgroup", [4, 4], True),
        ("subgroup", [16, 16], True),
        ("subgroup", [5, 3], False),
        ("subgroup", [16, 17], False),
        ("subgroup", [-4, -4], False),
        ("subgroup", [8], False),
        ("subgroup", [8, 8, 1], False),
        ("subgroup", [8, 8.0], False),
        ("subgroup", 64, False),
        ("minigroup", [1, 1], True),
        ("minigroup", [4, 4], True),
        ("minigroup", [1, 17], False),
    ],
)
def test_sizes_of_parts_of_the_sensor_have_their_range(name, value, legal):
    given = {"rows": 80, "cols": 16 * 17, "minigroup": [1, 1], name: value}
    if legal:
        assert list(getattr(parse_config({"sensor": given}).sensor, name)) == value
        return
    ends = {"subgroup": "16 to 256", "minigroup": "1 to 16"}[name]
    told = re.escape(f"sensor.{name} = {value}: must be [rows, cols] of {ends} pixels")
    with pytest.raises(InputError, match=f"^{told}$"):
        parse_config({"sensor": given})


@pytest.mark.parametrize("wrong", ["many", 2.5, [3], {}], ids=repr)
@pytest.mark.parametrize("name", SENSOR)
def test_a_parameter_of_another_kind_is_told_by_its_own_name(name, wrong):
    """Not by that of another one whose range it sets."""
    with pytest.raises(InputError) as raised:
        Sensor(**{name: wrong})
    assert raised.value.field == f"sensor.{name}"
    assert str(raised.value).startswith(f"sensor.{name} = {wrong!r}: must be ")


GATED = {"gating": True}
COUNTED = {"counts": 1, "format": "counts"}


@pytest.mark.parametrize(
    ("others", "name", "last", "wrong"),
    [
        ({}, "period", 6, 5),  # the guard has 5 cycles
        ({"rearm": 3}, "period", 9, 8),
        ({}, "period", 1024, 1025),
        ({"coarse_bits": 6}, "period", 64, 65),
        (GATED, "gate_start", 249, 250),
        (GATED | {"period": 100}, "gate_start", 99, 100),
        (COUNTED | {"pulses": 21}, "search_pulses", 10, 11),
        (COUNTED | {"pulses": 20}, "search_pulses", 9, 10),
        ({"rows": 8, "cols": 16}, "streams", 2, 3),
        ({"rows": 512}, "cols", 512, 520),
        ({}, "window_max", 479, 480),  # offsets of two ticks each, up to 254
        ({"rearm": 3}, "coarse_bits", 4, 3),  # the guard has 8 cycles
        ({}, "coarse_bits", 10, 11),
        ({"phases": 64}, "coarse_bits", 9, 10),
        ({"phases": 4, "offset_phases": 4, "window_max": 4}, "coarse_bits", 3, 2),
        ({"phases": 8}, "offset_phases", 8, 16),
        ({"minigroup": [1, 2]}, "mg_threshold", 2, 3),
        ({"subgroup": [4, 4]}, "threshold", 16, 17),
        ({"window_max": 20}, "window", 20, 21),
    ],
)
def test_the_last_legal_value_beside_the_others_is_taken_and_the_next_is_not(
    others, name, last, wrong
):
    """Whichever other setting or parameter sets the end."""
    load_config(None, others | {name: last})
    with pytest.raises(InputError, match=rf"^\w+\.{name} = {wrong}: |there are \d+ subgroups"):
        load_config(None, others | {name: wrong})


def test_what_was_written_is_told_as_a_file_has_it():
    """A list where subgroups differ, else one value; nothing that was not written."""
    threshold = [1 + s % 3 for s in range(16)]
    frame = {"pulses": 7, "auto_bounds": [1, 2, 3, 4, 5, 6]}
    config = parse_config({"frame": frame, "subgroup": {"window": 9}})
    found = config.with_settings(threshold=threshold, auto=True).written()
    subgroup = {"threshold": threshold, "window": 9, "auto": True}
    assert found == {"sensor": {}, "frame": frame, "subgroup": subgroup}


@pytest.mark.parametrize("counts", [0, 1])
def test_the_register_of_the_format_takes_what_is_built(counts):
    sensor = parse_config({"sensor": {"counts": counts}}).sensor
    last = list(FORMATS)[registers.BY_NAME["format"].high(sensor)]
    assert last == ("counts" if counts else "compact-full")
