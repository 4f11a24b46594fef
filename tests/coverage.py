# SPDX-License-Identifier: Apache-2.0
"""Coverage of the regression: situations of the contract, lines and toggles of the RTL, lines of Python; fails below a goal.

`python -m tests.coverage [functional] [rtl] [python]` (default: all).

Situations are counted on the golden model's traces, which equal those of RTL and plain model beat by beat and fate by
fate. So one table covers all engines and needs no simulator, while cocotb-coverage would count in only one of them.
"""

import collections
import itertools
import os
import re
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
from hypothesis import given, seed
from hypothesis import strategies as st

from coincid.hdl.export import verilog_files
from coincid.model.contract.config import Config, parse_config
from coincid.model.contract.counters import COUNTER_NAMES
from coincid.model.contract.edges import Fate
from coincid.model.contract.latency import armed_cycle, close_cycle
from coincid.model.contract.packet import FORMAT_NAMES, HEADER
from coincid.model.contract.parameters import TOP
from coincid.model.contract.pixels import pixel_table
from coincid.model.contract.registers import reset_values
from coincid.model.contract.stream import decode_frame
from coincid.model.golden.frame import Golden, Trace
from coincid.tb import toolchain
from coincid.tb.frame_record import save_job
from coincid.tb.rtl import rtl

from . import random_cases
from .benches import bench_environment
from .mutation import frames

SEED, EXAMPLES = 1, 120  # frames per sensor
LINE_GOAL, TOGGLE_GOAL = 0.99, 0.83  # for the RTL
# Not counted as toggles: the generator's own nets; high bits of counters, which fault_bench.py forces; constants of an
# instance; signals of AXI4-Lite that the sensor does not use.
NO_TOGGLE = re.compile(
    r"__024|_next\b|^counters|^number|^subgroup\[|prot|^(opened|committed|rejected|stored|dropped|blind|photons|mg_stored|mg_dropped|lower)\w*\["
)
PYTHON_GOALS = {  # share of lines; the others are refusals that other tests provoke through the command line
    "model/golden": 1.0,
    "model/contract": 0.9,
    "hdl": 0.9,
}
ELSEWHERE = "hdl/emulator/*", "hdl/silicon/*", "hdl/deserialiser.py"  # with tests of their own
MODES = [f"coincidence={c} gating={g} auto={a}" for c, g, a in itertools.product((0, 1), repeat=3)]
COUNTED = dict(  # by counters
    dropped="events dropped", rejected="window rejected", mg_stored="record stored", mg_dropped="record dropped"
)
SITUATIONS = {  # name -> required number
    **{f"{mode}, {name}": 10 for mode in MODES for name in FORMAT_NAMES},
    **{f"fate {fate.name.lower()}": 100 for fate in Fate},
    **{f"stream {kind}": 10 for kind in random_cases.READY_KINDS},
    "edge at a window's last tick is counted": 20,
    "edge a tick after a window's end": 20,
    "window of a single tick": 20,
    "window ends with a cycle": 20,
    "window goes over a cycle's end": 20,
    "two edges at the opening tick": 20,
    "edge in the gate's first cycle": 10,
    "edge in the cycle before the gate": 10,
    "edge in the gate's last cycle": 10,
    "edge in the cycle after the gate": 10,
    "opening in the last cycle before the guard": 10,
    "blind in the guard's first cycle": 10,
    "opening in the first cycle after re-arming": 10,
    "opening in cycle 0": 10,
    "events dropped": 10,
    "overrun flag": 10,
    "record stored": 10,
    "record dropped": 5,
    "threshold up": 10,
    "threshold down": 10,
    "budget up": 10,
    "budget down": 5,
    "window rejected": 10,
    "masked pixel": 10,
}


def situations(config: Config, edges, trace: Trace, ready: str, counts: collections.Counter) -> None:
    """Count what happened in a frame."""
    sensor, table = config.sensor, pixel_table(config.sensor)
    c = {name: trace.counters[:, k] for k, name in enumerate(COUNTER_NAMES)}
    for s in range(sensor.subgroups):
        mode = MODES[4 * config.coincidence[s] + 2 * config.gating[s] + config.auto[s]]
        counts[f"{mode}, {config.format}"] += c["opened"][s] > 0
        counts["masked pixel"] += not config.mask[s].all()
    for fate in Fate:
        counts[f"fate {fate.name.lower()}"] += int((trace.fate == fate).sum())
    counts[f"stream {ready}"] += 1
    for name, happened in COUNTED.items():
        counts[happened] += int((c[name] > 0).sum())
    for stream, beats in enumerate(trace.beats):
        events = decode_frame(beats, sensor, len(sensor.stream_subgroups(stream))).events
        counts["overrun flag"] += int(events[:, list(HEADER).index("overrun")].sum())
    subgroup, cycle = table.subgroup[edges.pixel], edges.tick // sensor.phases
    order = np.lexsort((edges.tick, edges.pulse, subgroup))
    end, last, armed_from = -1, (-1, -1), -1
    opened = -1
    for e in order.tolist():
        s, fate, tick, at = int(subgroup[e]), trace.fate[e], int(edges.tick[e]), int(cycle[e])
        window = int(config.window[s]) if config.coincidence[s] else 1
        if (s, int(edges.pulse[e])) != last:
            last, end, armed_from, opened = (s, int(edges.pulse[e])), -1, -1, -1
        if fate == Fate.OPENING:
            counts["opening in the first cycle after re-arming"] += at == armed_from
            end, opened = tick + window, tick
            close = close_cycle(tick, window, sensor.phases)
            armed_from = armed_cycle(close, sensor.rearm)
            counts["window of a single tick"] += window == 1
            counts["window ends with a cycle"] += end % sensor.phases == 0
            counts["window goes over a cycle's end"] += close > at
            counts["opening in cycle 0"] += at == 0
            counts["opening in the last cycle before the guard"] += at == config.period - sensor.guard - 1
        counts["edge at a window's last tick is counted"] += fate == Fate.COUNTED and tick == end - 1
        counts["edge a tick after a window's end"] += tick == end and fate not in (Fate.MASKED, Fate.GATED)
        counts["two edges at the opening tick"] += fate == Fate.COUNTED and tick == opened
        counts["blind in the guard's first cycle"] += fate == Fate.BLIND and at == config.period - sensor.guard
        if config.gating[s] and not config.frame["gate_every"] and fate != Fate.MASKED:
            start, length = int(config.gate_start[s]), int(config.gate_len[s])
            counts["edge in the gate's first cycle"] += at == start and length > 0
            counts["edge in the cycle before the gate"] += at == start - 1
            counts["edge in the gate's last cycle"] += at == start + length - 1 and length > 0
            counts["edge in the cycle after the gate"] += at == start + length


def steps(config: Config, before: Trace, after: Trace, counts: collections.Counter) -> None:
    """Count what the threshold controller did between two frames."""
    used = COUNTER_NAMES.index("threshold_used")
    threshold = (after.counters[:, used] - before.counters[:, used])[config.controlled]
    for name, step in (("threshold", threshold), ("budget", after.budget - before.budget)):
        counts[f"{name} up"] += int((step > 0).sum())
        counts[f"{name} down"] += int((step < 0).sum())


def functional() -> list[str]:
    """Return the situations that were not covered."""
    counts: collections.Counter = collections.Counter()
    for name in ("default", "tiny", "coarse", "odd"):
        sensor = random_cases.SENSORS[name]

        @seed(SEED)
        @random_cases.generated(EXAMPLES)
        @given(
            random_cases.configurations(sensor, frames_max=1),
            st.integers(0, 2**32 - 1),
            st.sampled_from(random_cases.READY_KINDS),
        )
        def count(config, draw, kind):
            edges = random_cases.trouble(config, draw, 12.0)
            golden = Golden(config.sensor)
            ready = random_cases.ready_pattern(draw, kind, config.pulses * config.period + 100)
            for _ in range(2):  # the controller acts in the second
                situations(config, edges, golden.frame(config, edges, ready), kind, counts)

        count()
        golden = None
        for number, config in enumerate(config for config in random_cases.modes(sensor) for _ in range(2)):
            golden = golden or Golden(config.sensor)
            kind = random_cases.READY_KINDS[number % len(random_cases.READY_KINDS)]
            edges, ready = random_cases.trouble(config, number, 12.0), random_cases.ready_pattern(number, kind, 400)
            situations(config, edges, golden.frame(config, edges, ready), kind, counts)
        golden, before = Golden(config.sensor), None
        for config in random_cases.scarce(sensor):
            trace = golden.frame(config, random_cases.trouble(config, 0, 25.0))
            if before:
                steps(config, before, trace, counts)
            before = trace
        print(f"functional: {name} done", flush=True)
    missing = [
        f"situation {name!r}: {counts[name]} times, goal {goal}"
        for name, goal in SITUATIONS.items()
        if counts[name] < goal
    ]
    print(f"functional: {len(SITUATIONS) - len(missing)} of {len(SITUATIONS)} situations")
    return missing


def rtl_coverage() -> list[str]:
    """Return uncovered lines and toggles of the RTL, after the frames of the mutation test and the tests of the ports."""
    sensor = parse_config({"sensor": random_cases.SMALL}).sensor
    options, public = ["--coverage-line", "--coverage-toggle"], [f"{TOP}.stored_of_*"]
    build = toolchain.build("verilator", rtl(sensor), TOP, key="coverage", public=public, options=options)
    points: collections.Counter = collections.Counter()
    with tempfile.TemporaryDirectory(prefix="coincid-") as scratch:
        benches = {
            "coincid.tb.cosim": save_job(Path(scratch) / "job", frames()),
            "sensor_bench": bench_environment(random_cases.SMALL),
        }
        for module, env in benches.items():
            folder = Path(scratch) / module
            build.run(module, env=env, out_dir=folder, seed=1)
            counted = (folder / "coverage.dat").read_text(errors="replace")
            for key, count in re.findall(r"^C '(.*)' (\d+)$", counted, re.MULTILINE):
                points[key] += int(count)
    holes = []
    for kind, goal in (("line", LINE_GOAL), ("toggle", TOGGLE_GOAL)):
        blocks: dict[str, list[tuple[str, int]]] = collections.defaultdict(list)
        for key, count in points.items():
            fields = dict(part.split("\x02", 1) for part in key.split("\x01") if "\x02" in part)
            if fields.get("page", "").startswith(f"v_{kind}") or fields.get("t") == kind:
                what = f"line {fields.get('l', '?')}" if kind == "line" else fields.get("o", "?")
                if kind == "toggle" and NO_TOGGLE.search(what):
                    continue
                blocks[fields.get("page", "/").split("/")[-1]].append((what, count))
        hit = sum(count > 0 for of in blocks.values() for _, count in of)
        total = sum(map(len, blocks.values()))
        print(f"rtl: {kind} {hit} of {total}, {hit / max(total, 1):.1%}")
        for block, of in sorted(blocks.items()):
            missed = [what for what, count in of if not count]
            first = f", first holes: {', '.join(missed[:4])}" if missed else ""
            print(f"  {block:26} {len(of) - len(missed)} of {len(of)}{first}")
        if not total or hit < goal * total:
            holes.append(f"RTL {kind} coverage {hit} of {total}: goal {goal:.0%}; blocks and holes are listed above")
    return holes


def python_coverage() -> list[str]:
    """Return uncovered lines of Python: golden model (without Numba, because coverage.py cannot see it) and RTL emission."""
    root = Path(__file__).parents[1]
    with tempfile.TemporaryDirectory(prefix="coincid-") as scratch:
        environment = os.environ | {"COVERAGE_FILE": f"{scratch}/data", "NUMBA_DISABLE_JIT": "1"}
        run = [sys.executable, "-m", "coverage", "run", "--append", "--source=model,hdl"]
        tests = [*run, "-m", "pytest", "-q", "-p", "no:cacheprovider", "-x", "tests/golden/test_golden.py"]
        for command in (tests, [*run, "-m", "tests.coverage", "emit"]):
            subprocess.run(command, cwd=root, env=environment, check=True)
        holes = []
        for name, goal in PYTHON_GOALS.items():
            print(f"python: {name}, goal {goal:.0%}", flush=True)
            report = [sys.executable, "-m", "coverage", "report", "--show-missing", "--skip-covered"]
            report += [f"--include={name}/*", f"--omit={','.join(ELSEWHERE)}", f"--fail-under={100 * goal:g}"]
            if subprocess.run(report, cwd=root, env=environment, check=False).returncode:
                holes.append(f"{name}: fewer lines than {goal:.0%}; those that are never run are listed above")
    return holes


def emit() -> list[str]:
    """Emit every sensor of the regression, to cover its lines."""
    for sensor in random_cases.SENSORS.values():
        built = random_cases.built_sensor(sensor)
        verilog_files(built)
        reset_values(built)
    return []


PARTS = {"functional": functional, "rtl": rtl_coverage, "python": python_coverage, "emit": emit}


def main() -> None:
    names = sys.argv[1:] or ["functional", "rtl", "python"]
    if unknown := [name for name in names if name not in PARTS]:
        sys.exit(f"{unknown[0]}: must be one of {', '.join(PARTS)}")
    holes = [hole for name in names for hole in PARTS[name]()]
    print(*holes, sep="\n")
    sys.exit(bool(holes))


if __name__ == "__main__":
    main()
