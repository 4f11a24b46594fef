# SPDX-License-Identifier: Apache-2.0
"""The asynchronous view: equal to golden model and polyphase view at tick centres, elsewhere within
a tick, no wrong words.
"""

import json
import re

import numpy as np
import pytest
from attrs import evolve

from coincid.flow.async_constraints import async_constraints
from coincid.flow.silicon_report import Domain, domains, latches, netlist
from coincid.hdl.export import units_files
from coincid.hdl.front_end_views import Asynchronous, Polyphase, view_at
from coincid.hdl.silicon.circuit import (
    HIT_FS,
    LEVEL_FS,
    SYNCHRONISER_REARM,
    Circuit,
    clock_fs,
    lag_fs,
    levels,
)
from coincid.model.contract.config import parse_config
from coincid.model.contract.counters import COUNTER_NAMES
from coincid.model.contract.edges import Edges
from coincid.model.contract.parameters import QUARTERS, Sensor
from coincid.model.contract.pixels import pixel_table
from coincid.model.contract.result import differences
from coincid.model.golden.frame import Golden
from coincid.model.shared.errors import InputError
from coincid.tb.play import build_sensor, play
from coincid.tb.replay import replay
from coincid.tb.stimulus import off_centre
from coincid.tb.stress import BENCH, INCLUDE, Front, run_bench, stress

from ..benches import bench_environment
from ..random_cases import SENSORS, SMALL, configured, predicted, trouble
from ..tb.test_cosim import assert_all_checked, frames

SKEW_FS = tuple(range(0, 64 * 300, 300))  # of the pixels of a subgroup

TINIEST = dict(
    rows=4,
    cols=4,
    subgroup=[4, 4],
    phases=4,
    window_max=20,
    fifo_depth=1,
    offsets=0,
    records=0,
    controller=0,
)
WINDOWS = COUNTER_NAMES.index("opened")
LONG = "fine", "odd", "wide"  # sensors that take long to compile, or to simulate
FULL = {"format": "full", "minigroup_records": True, "mg_threshold": 1}


def test_a_circuit_at_another_clock_is_the_same_circuit():
    circuit = Circuit(
        clock_mhz=500.0,
        banks=2,
        mismatch_fs=(10, 20),
        pixel_skew_fs=(5,),
        delay_line=True,
        gain_ppm=300,
    )
    view = Asynchronous(circuit=circuit)
    assert view.at(400.0).circuit == evolve(circuit, clock_mhz=400.0)
    assert view_at(view, 400.0) == view.at(400.0)


def test_a_view_of_words_at_another_clock_is_the_same_view():
    """Also one of a user."""
    for view in (Polyphase(), type("Own", (Polyphase,), {"name": "own"})()):
        assert view.at(400.0) is view
        assert view_at(view, 400.0) is view


def cells_of(circuit: Circuit, sensor: Sensor) -> dict[str, list[dict[str, int]]]:
    """Return the numbers that a front end and its TDC give to their cells, by kind of cell."""
    view = Asynchronous(circuit=circuit)
    text = "".join(units_files([view.front_end(sensor), view.tdc(sensor, 1)]).values())
    cells: dict[str, list[dict[str, int]]] = {}
    for kind, given in re.findall(r"^  coincid_(\w+) #\((.*?)\n  \) ", text, re.M | re.S):
        numbers = re.findall(r"\.(\w+)\((-?)\d+'s?([dh])(\w+)\)", given)
        cells.setdefault(kind, []).append(
            {
                name: int(sign + digits, {"d": 10, "h": 16}[base])
                for name, sign, base, digits in numbers
            }
        )
    return cells


def test_every_property_of_a_circuit_reaches_its_cells():
    sensor = Sensor(**TINIEST | {"subgroup": (4, 4), "rearm": SYNCHRONISER_REARM})
    mismatch_fs, skew_fs = (7, -8, 9, -10), tuple(range(0, 160, 10))
    circuit = Circuit(
        clock_mhz=400.0,
        banks=2,
        mismatch_fs=mismatch_fs,
        pixel_skew_fs=skew_fs,
        delay_line=True,
        gain_ppm=-300,
    )
    cells = cells_of(circuit, sensor)
    cycle = {"PHASES": sensor.phases, "CLOCK_FS": clock_fs(400.0)}
    window = cycle | {"BITS": sensor.window_bits, "LINE": 1, "GAIN_PPM": -300}
    assert cells["window"] == [window, window]
    (phases,) = cells["phases"]
    errors = phases.pop("MISMATCH_FS")
    assert phases == cycle | {"LAG_FS": lag_fs(sensor)}
    found = [
        np.uint32(errors >> 32 * k & 0xFFFF_FFFF).astype(np.int32) for k in range(sensor.phases)
    ]
    assert tuple(found) == mismatch_fs
    delays = [cell["DELAY_FS"] for cell in cells["delay"]]
    assert sorted(delay for delay in delays if delay in skew_fs) == list(skew_fs[1:])
    # Each minigroup's event is as late as the root; each hit, in both banks, as the window's end.
    others = sorted(delay for delay in delays if delay not in skew_fs)
    event = lag_fs(sensor) - HIT_FS - LEVEL_FS * levels(sensor.minigroup_pixels)
    shown = lag_fs(sensor) + clock_fs(400.0) // QUARTERS - HIT_FS
    assert others == [event] * sensor.minigroups + [shown] * 2 * sensor.pixels


def config(window=12, pulses=8, **subgroup):
    """Return settings at another clock than the usual one."""
    return configured(
        SENSORS["one"],
        {"period": 40, "pulses": pulses, "clock_mhz": 400.0} | FULL,
        {"window": window, "threshold": 1} | subgroup,
    )


@pytest.mark.parametrize(
    "sensor", ["tiny", *(pytest.param(name, marks=pytest.mark.long) for name in LONG)]
)
def test_random_frames_at_tick_centres(sensor, tmp_path):
    jobs = frames(SENSORS[sensor], 6)
    records, _ = play(jobs, "icarus", tmp_path, view=Asynchronous())
    assert_all_checked(records, jobs)


@pytest.mark.parametrize("rearm", [SYNCHRONISER_REARM, SYNCHRONISER_REARM + 2])
def test_a_single_bank_keeps_to_the_re_arm_gap(rearm, tmp_path):
    """Under light so dense that windows follow each other as soon as they may."""
    table = TINIEST | {"rearm": rearm, "offsets": 1, "records": 1, "offset_phases": 4}
    settings = configured(table, {"period": 90, "pulses": 6} | FULL, {"window": 7, "threshold": 1})
    golden = Golden(settings.sensor)
    jobs = [predicted(golden, settings, trouble(settings, seed, 60.0)) for seed in range(3)]
    view = Asynchronous(Circuit(banks=1))
    records, _ = play(jobs, "icarus", tmp_path, view=view)
    assert_all_checked(records, jobs)
    windows = sum(int(job.expected.counters[0, WINDOWS]) for job in jobs)
    assert windows > 60


def bursts(settings, seed, ticks):
    """Return one burst per period, of about every third pixel."""
    rng = np.random.default_rng(seed)
    pulse, pixel = np.nonzero(rng.random((settings.pulses, settings.sensor.array_pixels)) < 0.3)
    start = rng.integers(0, 20 * settings.sensor.phases, settings.pulses)
    return Edges(pulse, pixel, start[pulse] + rng.integers(0, ticks, len(pulse)))


def assert_within_a_tick(settings, edges, golden, found):
    """Check that stamps differ by at most a tick, that only pixels within a tick of a window's end
    may be in or out of it, and that the winner came within a tick of t0.

    This holds for a period's first window: an edge that is in one and out of the other may open the
    next.
    """

    def first_windows(result):
        index = np.unique(result["pulse"], return_index=True)[1]
        return {name: result[name][index] for name in ("pulse", "stamp", "hits", "count", "winner")}

    golden, found = first_windows(golden), first_windows(found)
    assert np.array_equal(golden["pulse"], found["pulse"])
    assert np.abs(golden["stamp"] - found["stamp"]).max() <= 1
    inside = pixel_table(settings.sensor).inside
    for e in range(len(golden["pulse"])):
        of_period = edges.pulse == golden["pulse"][e]
        last_to_first = sorted(
            zip(edges.tick[of_period], edges.pixel[of_period], strict=True), reverse=True
        )
        first = {int(inside[pixel]): tick for tick, pixel in last_to_first}
        end = golden["stamp"][e] + settings.window[0]
        for pixel, tick in first.items():
            same = not (golden["hits"][e, 0] ^ found["hits"][e, 0]) >> np.uint64(pixel) & np.uint64(
                1
            )
            assert same or end - 1 <= tick <= end, (pixel, tick, end)
        assert found["count"][e] == bin(found["hits"][e, 0]).count("1")
        assert found["hits"][e, 0] >> np.uint64(found["winner"][e]) & np.uint64(1)
        assert abs(first[found["winner"][e]] - golden["stamp"][e]) <= 1


@pytest.mark.parametrize(
    "circuit",
    (
        Circuit(),
        pytest.param(Circuit(delay_line=True), marks=pytest.mark.long),
        pytest.param(
            Circuit(mismatch_fs=tuple((-12000, 9000, 14000, -5000) * 8)), marks=pytest.mark.long
        ),
        Circuit(pixel_skew_fs=SKEW_FS),
    ),
    ids=("nominal", "delay line", "taps", "skew"),
)
def test_edges_anywhere_in_their_ticks(circuit):
    settings = config(window=20, pulses=20)
    edges = off_centre(settings, bursts(settings, 3, 40), 4)
    golden = replay("golden", settings, edges)
    assert_within_a_tick(
        settings, edges, golden, replay("icarus", settings, edges, view=Asynchronous(circuit))
    )


def test_a_skew_takes_edges_across_the_border_of_a_tick():
    """All edges come as long before a border as the skew of the middle pixel; so those of later
    pixels are counted one tick later.
    """
    settings = config(pulses=8)
    pixel = np.arange(0, 64, 8)
    middle_ps = (SKEW_FS[31] + SKEW_FS[32]) / 2e3
    edges = Edges(
        pulse=np.arange(8),
        pixel=pixel,
        tick=np.full(8, 100),
        offset_ps=np.full(8, settings.tick_s * 1e12 - middle_ps),
    )
    found = replay("icarus", settings, edges, view=Asynchronous(Circuit(pixel_skew_fs=SKEW_FS)))
    assert found["stamp"].tolist() == np.where(pixel < 32, 100, 101).tolist()


def test_nominal_circuits_keep_the_ticks_of_dense_edges():
    """With exact borders, only the winner may differ, because the arbiter knows who came first in a
    tick.
    """
    settings = config()
    edges = off_centre(settings, trouble(settings, 5, 20.0), 6)
    found = replay("icarus", settings, edges, view=Asynchronous())
    assert {
        line.split("[")[0] for line in differences(replay("golden", settings, edges), found)
    } <= {"winner"}


@pytest.mark.long
def test_verilator_agrees():
    # Delays take long to compile.
    settings = configured(TINIEST, {"period": 40, "pulses": 3}, {"window": 12, "threshold": 1})
    edges = trouble(settings, 7, 20.0)
    assert not differences(
        replay("golden", settings, edges), replay("verilator", settings, edges, view=Asynchronous())
    )


def test_resets_in_the_middle_of_frames(tmp_path):
    """Run the tests of `async_bench.py`."""
    sensor = parse_config({"sensor": SMALL}).sensor
    build = build_sensor(sensor, "icarus", view=Asynchronous())
    build.run("async_bench", env=bench_environment(SMALL), out_dir=tmp_path)


def test_a_single_bank_needs_its_gap():
    tight = Sensor(rows=8, cols=8, rearm=SYNCHRONISER_REARM - 1)
    assert Circuit().banks_of(tight) == 2
    assert Circuit().banks_of(evolve(tight, rearm=SYNCHRONISER_REARM)) == 1
    with pytest.raises(InputError, match="sensor.rearm = 2: must be at least 3"):
        Circuit(banks=1).banks_of(tight)


@pytest.mark.parametrize("rearm", (0, 3))
def test_no_edge_pattern_makes_a_wrong_word_or_locks_up(rearm):
    """Short form of `python -m coincid.tb.stress 10000000`."""
    found = stress(60_000, seed=rearm + 1, sensor=Sensor(rows=8, cols=8, rearm=rearm))
    assert found["wrong"] == found["locked"] == 0
    assert (
        found["edges"] >= 60_000
        and found["windows"] > 50
        and found["records"] > 0
        and found["resets"] > 0
    )


@pytest.fixture(scope="module")
def front():
    """Return the files of a small front end, of which a test may change one."""
    sensor = Sensor(**TINIEST | {"subgroup": (4, 4)})
    return Front(sensor, Circuit()).files()


@pytest.mark.parametrize(
    ("old", "new", "bad"),
    [
        (r"\.closed\(closed\)", ".closed(closed)", ()),
        (r"( count = .*);", r"\1 + 1;", ("wrong",)),
        (r"( winner = )(.*);", r"\1\2 + 1;", ("wrong", "locked")),
        (r"( hits = .*);", r"\1 & 0;", ("wrong", "locked")),
        (r"( stamp = .*);", r"\1 / 0;", ("wrong",)),
        (r"\.closed\(closed\)", ".closed()", ("locked",)),
    ],
    ids=("right", "count", "winner", "map", "stamp", "silent"),
)
def test_a_front_end_that_is_wrong_does_not_stand_its_stress_test(old, new, bad, front):
    text, changes = re.subn(old, new, front[INCLUDE])
    assert changes == 1
    files = front | {INCLUDE: text}
    arguments = ["+edges=3000", "+seed=3"]
    found = json.loads(run_bench(BENCH, files, arguments=arguments, aperture=True)[-1])
    assert found["edges"] >= 3000
    assert (found["windows"] > 20) == ("closed()" not in new)
    assert [name for name in ("wrong", "locked") if found[name]] == [*bad]


def test_domains_are_those_meant(tmp_path):
    """Every flop has an intended clock or event; there is no latch; clears only reach hit and
    opening flops.
    """
    sensor = Sensor(rows=4, cols=4, subgroup=(4, 4))
    _, module = netlist(sensor, Circuit(), tmp_path)
    assert not latches(module)
    found = {(d.clock.split(".")[-1], d.falling): d for d in domains(module)}
    assert {clock for clock, _ in found} == {
        "clk",
        "mark",
        "ended_*",
        "root",
        "event_*",
        "phases[*]",
        "words_*[*]",
    }
    assert sum(d.flops for d in domains(module) if d.clock == "words_*[*]") == 2 * 16
    assert {d.reset.split(".")[-1] for d in domains(module)} == {"", "clear_*", "clear_window_*"}
    assert not any(d.reset for d in domains(module) if d.clock == "clk")
    for name in re.findall(
        r"\*(generator|window_|or_tree_|delay_event_|sample_picture_)",
        async_constraints(sensor, Circuit()),
    ):
        assert any(
            name in cell or name in net
            for cell in module["cells"]
            for net in (cell, *module["netnames"])
        ), name


@pytest.mark.parametrize("inverters", range(4))
@pytest.mark.parametrize("rises", (True, False))
def test_a_clock_behind_inverters_is_that_before_them(inverters, rises):
    """Each turns its edge."""
    cells = {
        f"not_{k}": {"type": "$_NOT_", "connections": {"A": [2 + k], "Y": [3 + k]}}
        for k in range(inverters)
    }
    cells["flop"] = {
        "type": "$dff",
        "parameters": {"CLK_POLARITY": f"{int(rises):032b}"},
        "connections": {"CLK": [2 + inverters], "D": [100, 101], "Q": [102, 103]},
    }
    module = {"netnames": {"clk": {"bits": [2]}}, "cells": cells}
    falls = rises == bool(inverters % 2)
    assert domains(module) == [Domain("clk", falls, "", 2)]
