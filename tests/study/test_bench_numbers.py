# SPDX-License-Identifier: Apache-2.0
"""Every number of the benchmark follows from the time that its engine took, on a clock that only
the engines move.
"""

import os
from collections import Counter
from types import SimpleNamespace

import numpy as np
import pytest

from coincid.model.contract.config import parse_config
from coincid.model.contract.edges import Edges
from coincid.study import bench

CYCLES, EDGES, REPEATS = 6_000, 800, 3
FIRST_S = 1000.0  # that the first call of each engine takes longer, because it is compiled
BUSY_S = 400.0  # that its third call takes longer, because the machine has other work
PHOTONS_S = {"32x32": 2.0, "256x128": 3.0}
GOLDEN_S, TOGETHER_S = 5.0, 7.0
SLICED_S = {"32x32": 11.0, "256x128": 13.0}
MANY_S = 17.0
BUILD_S = {"32x32": (23.0, 29.0), "256x128": (31.0, 37.0)}  # the first time, and again
DEPTH_S = {  # by format and estimator
    ("id", "maximum"): 41.0,
    ("id", "matched"): 43.0,
    ("id", "planes"): 47.0,
    ("full", "planes"): 53.0,
}
CYCLES_PER_S = {"verilator": 60.0, "icarus": 70.0, "amaranth": 80.0}


class Engines:
    """Stand-ins for what is measured. Each takes its time, on the clock `now_s`."""

    def __init__(self):
        self.now_s = 0.0
        self.calls = Counter()  # in this process
        self.built = set()
        self.folders = set()
        self.played_pulses = {}
        self.checked = []

    def take(self, name, seconds):
        """Take so long, and longer for the first and the third time in this process."""
        self.calls[name] += 1
        self.now_s += seconds + {1: FIRST_S, 3: BUSY_S}.get(self.calls[name], 0.0)

    def size(self, sensor):
        return f"{sensor.cols}x{sensor.rows}"

    def setup(self, scene, *, sensor, klux, seed):
        config = parse_config({"sensor": sensor, "frame": {"pulses": 400, "period": 40}})
        size = self.size(config.sensor)

        def edges(workers):
            self.take("photons", PHOTONS_S[size])
            return Edges(np.arange(EDGES) % 400, np.zeros(EDGES, int), np.zeros(EDGES, int))

        return SimpleNamespace(config=config, photons=SimpleNamespace(edges=edges))

    def frame(self):
        return SimpleNamespace(
            beats=[], commit_subgroup=None, commit_cycle=None, cycles=CYCLES, checked=0
        )

    def golden(self, sensor):
        def one(config, edges):
            self.take("golden", GOLDEN_S)
            return self.frame()

        def several(config, edges):
            assert len(edges) == bench.MANY
            self.take("golden", TOGETHER_S)
            return [self.frame() for _ in edges]

        return SimpleNamespace(frame=one, frames_of=several)

    def sliced(self, sensor):
        engines = self

        class Sensor:
            def __enter__(self):
                return self

            def __exit__(self, *_):
                pass

            def frame(self, config, edges):
                engines.take("sliced", SLICED_S[engines.size(sensor)])
                return engines.frame()

        return Sensor()

    def side_by_side(self, chains):
        assert len(chains) == bench.MANY
        self.take("many", MANY_S)
        return [[self.frame()] for _ in chains]

    def build(self, sensor):
        size = self.size(sensor)
        seconds = BUILD_S[size][size in self.built]
        self.built.add(size)
        self.now_s += seconds

    def slow(self, name, config, edges, progress):
        """Play the beginning of a frame, after a start that does not count."""
        self.played_pulses[name] = config.pulses
        assert edges.pulse.max() == config.pulses - 1
        self.now_s += 500.0
        began_s = self.now_s
        for cycle in (100, 300, 700):
            self.now_s = began_s + (cycle - 100) / CYCLES_PER_S[name]
            progress(cycle)

    def play(self, jobs, engine, folder, *, progress):
        ((config, edges),) = ((job.config, job.edges) for job in jobs)
        self.slow(engine, config, edges, progress)

    def amaranth(self, config, edges, progress):
        self.slow("amaranth", config, edges, progress)

    def depth(self, arrays, config, *, method):
        self.take("depth", DEPTH_S[config.format, method])

    def in_new_process(self, function, *arguments, **environment):
        """Call a function as in a new process, which loads its compiled code anew."""
        before, self.calls = self.calls, Counter()
        if function is not bench._build_s:
            self.built |= set(BUILD_S)
        elif environment["COINCID_BUILD"] not in self.folders:
            self.folders.add(environment["COINCID_BUILD"])
            self.built = set()
        found = function(*arguments)
        self.calls = before
        return found

    def check(self, sensor, expected, found):
        self.checked.append(found)


@pytest.fixture
def engines(monkeypatch):
    found = Engines()
    monkeypatch.setattr(bench, "time", SimpleNamespace(perf_counter=lambda: found.now_s))
    builder = SimpleNamespace(add=lambda *_: None, arrays=dict)
    for name, stand_in in {
        "Setup": SimpleNamespace(of=found.setup),
        "Golden": found.golden,
        "SlicedSensor": found.sliced,
        "play_side_by_side": found.side_by_side,
        "build_library": found.build,
        "build_sensor": lambda *_: None,
        "play": found.play,
        "pysim": SimpleNamespace(play=found.amaranth),
        "check": found.check,
        "ResultBuilder": lambda config: builder,
        "estimate_depth": found.depth,
        "_in_new_process": found.in_new_process,
        "_versions": lambda: {key: "1" for key in bench.KEYS if key.startswith("version_")},
    }.items():
        monkeypatch.setattr(bench, name, stand_in)
    return found


@pytest.fixture
def result(engines, tmp_path):
    return bench.benchmark(tmp_path / "bench.json", repeats=REPEATS, tell=lambda line: None)


def test_rates_are_cycles_and_edges_by_their_time(result, engines):
    """Of many frames, the cycles of all; of slow engines, without their start."""
    assert result["edges"] == EDGES
    expected = {
        "photon_edges_per_s": EDGES / PHOTONS_S["32x32"],
        "golden_cycles_per_s": CYCLES / GOLDEN_S,
        "golden_many_cycles_per_s": bench.MANY * CYCLES / TOGETHER_S,
        "sliced_cycles_per_s": CYCLES / SLICED_S["32x32"],
        "sliced_many_cycles_per_s": bench.MANY * CYCLES / MANY_S,
        "golden_per_sliced": SLICED_S["32x32"] / GOLDEN_S,
        "sliced_per_cocotb_verilator": CYCLES / SLICED_S["32x32"] / CYCLES_PER_S["verilator"],
        "golden_edges_per_s": CYCLES / GOLDEN_S * EDGES / (400 * 40),
        "cocotb_verilator_cycles_per_s": CYCLES_PER_S["verilator"],
        "cocotb_icarus_cycles_per_s": CYCLES_PER_S["icarus"],
        "amaranth_cycles_per_s": CYCLES_PER_S["amaranth"],
    }
    assert {key: result[key] for key in expected} == pytest.approx(expected, rel=1e-3)
    pulses = {key.removeprefix("cocotb_"): number for key, number in bench.PULSES.items()}
    assert engines.played_pulses == pulses


def test_every_frame_of_the_fast_rtl_is_checked(result, engines):
    """One alone and many side by side, in each round and before the first."""
    assert len(engines.checked) == (1 + bench.MANY) * (REPEATS + 1)
    assert len(set(map(id, engines.checked))) == len(engines.checked)


def test_a_table_of_the_benchmark_tells_numbers_that_one_can_read():
    """Small ones in three digits, and large ones with separators; texts as they are."""
    result = dict.fromkeys(bench.KEYS, "text")
    numbers = {
        "golden_cycles_per_s": (1234567.8, "1,234,568"),
        "golden_per_sliced": (999.6, "1,000"),
        "sliced_cycles_per_s": (999.4, "999"),
        "sliced_per_cocotb_verilator": (12.345, "12.3"),
        "frame_32x32_depth_s": (0.0123456, "0.0123"),
        "edges": (1234567, "1,234,567"),
        "machine_cpu": ("a cpu", "a cpu"),
    }
    rows = bench.table(result | {key: value for key, (value, _) in numbers.items()}).splitlines()
    cells = {}
    for row in rows[2:]:
        key, *others = (cell.strip() for cell in row.strip("|").split("|"))
        cells[key.strip("`")] = others
    for key, (_, told) in numbers.items():
        assert cells[key] == [told, *bench.KEYS[key]]


def test_a_new_process_has_its_own_environment(monkeypatch):
    """Which this one keeps as it is."""
    monkeypatch.delenv("COINCID_BENCHED", raising=False)
    assert bench._in_new_process(os.getenv, "COINCID_BENCHED", COINCID_BENCHED="yes") == "yes"
    assert bench._in_new_process(os.getenv, "COINCID_BENCHED") is None
    assert "COINCID_BENCHED" not in os.environ


def test_every_stage_of_the_benchmark_is_told_with_its_round(engines, tmp_path):
    told = []
    bench.benchmark(tmp_path / "bench.json", repeats=2, tell=told.append)
    assert told == [
        "building",
        "engines: round 1 of 2",
        "engines: round 2 of 2",
        *(f"{size}: 2 frames" for size in bench.SIZES),
        *(f"photons to depth, {name}: 2 frames" for name in bench.TO_DEPTH),
        "builds: round 1 of 2",
        "builds: round 2 of 2",
    ]


UNITS = {"_cycles_per_s": "cycles/s", "_edges_per_s": "edges/s", "_s": "s", "_mib": "MiB"}


def test_the_unit_of_a_number_is_that_with_which_its_key_ends():
    """Numbers without one in their keys have none."""
    for key, (unit, _) in bench.KEYS.items():
        expected = next((told for end, told in UNITS.items() if key.endswith(end)), "")
        assert unit == expected, key


@pytest.mark.parametrize("size", bench.SIZES)
def test_the_parts_of_a_frame_are_its_whole(size, result):
    """Without the first frame, which loads compiled code, and without one of a busy machine."""
    parts = {
        "photons_s": PHOTONS_S[size],
        "sensor_s": SLICED_S[size],
        "depth_s": DEPTH_S["id", "planes"],
    }
    found = {name: result[f"frame_{size}_{name}"] for name in parts}
    assert found == pytest.approx(parts, rel=1e-3)
    assert result[f"frame_{size}_sliced_s"] == pytest.approx(sum(parts.values()), rel=1e-3)
    first_s, again_s = BUILD_S[size]
    assert (result[f"build_{size}_s"], result[f"build_{size}_warm_s"]) == (first_s, again_s)


@pytest.mark.parametrize("name", bench.TO_DEPTH)
def test_a_frame_to_depth_has_its_size_format_and_estimator(name, result):
    size, form, method = bench.TO_DEPTH[name]
    seconds = PHOTONS_S[size] + GOLDEN_S + DEPTH_S[form, method]
    assert result[f"to_depth_{name}_s"] == pytest.approx(seconds, rel=1e-3)
    told, _ = bench.KEYS[f"to_depth_{name}_s"][1].rsplit(",", 1)
    assert told.endswith(f"by {method}") and f"frame of {size} " in told


def test_the_machine_is_told_in_the_units_of_its_keys(monkeypatch):
    """24 GiB in pages of 16 KiB, four of eight cores, and the load of the last minute."""
    pages = {"SC_PAGE_SIZE": 16 << 10, "SC_PHYS_PAGES": 24 << 16}
    known = "processor : 0\nmodel name : A fast one: 3 GHz\nprocessor : 1\nmodel name : another\n"
    monkeypatch.setattr(
        bench,
        "os",
        SimpleNamespace(
            sysconf=pages.__getitem__,
            sched_getaffinity=lambda process: {0, 2, 5, 7},
            cpu_count=lambda: 8,
            getloadavg=lambda: (1.25, 2.5, 3.75),
        ),
    )
    monkeypatch.setattr(bench, "Path", lambda path: SimpleNamespace(read_text=lambda **_: known))
    found = bench._machine()
    assert found.pop("machine_cpu").strip() == "A fast one: 3 GHz"
    assert found == {
        "machine_cores": 4,
        "machine_memory_mib": 24 * 1024,
        "machine_load": 1.25,
    }
    assert [bench.KEYS[f"machine_{name}"][0] for name in ("memory_mib", "load")] == ["MiB", ""]


def test_each_version_is_that_of_its_program(monkeypatch):
    """Of what a program tells, the first line; it goes on about licences."""

    def told(command, **options):
        return SimpleNamespace(stdout=f"{' '.join(command)}: 1.2\nno warranty\n")

    monkeypatch.setattr(bench, "subprocess", SimpleNamespace(run=told))
    monkeypatch.setattr(bench, "version", lambda package: f"{package} 3")
    found = bench._versions()
    assert list(found) == [key for key in bench.KEYS if key.startswith("version_")]
    assert found.pop("version_icarus") == "iverilog -V: 1.2"
    assert found.pop("version_gxx") == "g++ --version: 1.2"
    assert found.pop("version_python").count(".") == 2
    assert found == {key: f"{key.removeprefix('version_')} 3" for key in found}
