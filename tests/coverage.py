# SPDX-License-Identifier: Apache-2.0
"""Coverage of the regression: how often each situation of the contract occurs in its random frames;
fails below a goal.

Situations are counted on the golden model's traces, which equal those of RTL and plain model beat
by beat and fate by fate. So one table covers all engines and needs no simulator, while
cocotb-coverage would count in only one of them.
"""

import argparse
import collections
import itertools
import sys

import numpy as np
from hypothesis import strategies as st

from coincid.model.contract.config import Config
from coincid.model.contract.counters import COUNTER_NAMES
from coincid.model.contract.counts import COUNT_MOST, GATE_CYCLES, NO_GATE
from coincid.model.contract.edges import Fate
from coincid.model.contract.gate_counts import Counts
from coincid.model.contract.latency import armed_cycle, close_cycle
from coincid.model.contract.packet import EVENT_FORMATS, HEADER
from coincid.model.contract.pixels import pixel_table
from coincid.model.contract.stream import decode_frame
from coincid.model.golden.frame import Golden, Trace

from . import random_cases

SEED, EXAMPLES = 1, 120  # frames per sensor
MODES = [f"coincidence={c} gating={g} auto={a}" for c, g, a in itertools.product((0, 1), repeat=3)]
COUNTED = dict(  # by counters
    dropped="events dropped",
    rejected="window rejected",
    mg_stored="record stored",
    mg_dropped="record dropped",
)
SITUATIONS = {  # name -> required number
    **{f"{mode}, {name}": 10 for mode in MODES for name in EVENT_FORMATS},
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
    "minigroup without a gate": 20,
    "minigroup with two gates": 20,
    "two gates side by side": 5,
    "pixel with a full bin": 20,
}


def situations(
    config: Config, edges, trace: Trace, ready: str, counts: collections.Counter
) -> None:
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
        frame = decode_frame(beats, sensor, len(sensor.stream_subgroups(stream)))
        counts["overrun flag"] += int(frame.events[:, list(HEADER).index("overrun")].sum())
        if frame.counts is not None:
            gates(frame.counts, counts)
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
            counts["opening in the last cycle before the guard"] += (
                at == config.period - sensor.guard - 1
            )
        counts["edge at a window's last tick is counted"] += (
            fate == Fate.COUNTED and tick == end - 1
        )
        counts["edge a tick after a window's end"] += tick == end and fate not in (
            Fate.MASKED,
            Fate.GATED,
        )
        counts["two edges at the opening tick"] += fate == Fate.COUNTED and tick == opened
        counts["blind in the guard's first cycle"] += (
            fate == Fate.BLIND and at == config.period - sensor.guard
        )
        if config.gating[s] and not config.frame.gate_every and fate != Fate.MASKED:
            start, length = int(config.gate_start[s]), int(config.gate_len[s])
            counts["edge in the gate's first cycle"] += at == start and length > 0
            counts["edge in the cycle before the gate"] += at == start - 1
            counts["edge in the gate's last cycle"] += at == start + length - 1 and length > 0
            counts["edge in the cycle after the gate"] += at == start + length


def gates(of_frame: Counts, counts: collections.Counter) -> None:
    """Count what happened to the minigroups and pixels of a stream in a frame of counts."""
    first, second = of_frame.gate_cycle.astype(int).transpose(2, 0, 1)
    both = second != NO_GATE
    counts["minigroup without a gate"] += int((first == NO_GATE).sum())
    counts["minigroup with two gates"] += int(both.sum())
    counts["two gates side by side"] += int((both & (abs(second - first) == GATE_CYCLES)).sum())
    full = of_frame.gate_hits == COUNT_MOST
    counts["pixel with a full bin"] += int(full.any(axis=(2, 3)).sum())


def steps(config: Config, before: Trace, after: Trace, counts: collections.Counter) -> None:
    """Count what the threshold controller did between two frames."""
    used = COUNTER_NAMES.index("threshold_used")
    threshold = (after.counters[:, used] - before.counters[:, used])[config.controlled]
    for name, step in (("threshold", threshold), ("budget", after.budget - before.budget)):
        counts[f"{name} up"] += int((step > 0).sum())
        counts[f"{name} down"] += int((step < 0).sum())


def main() -> None:
    argparse.ArgumentParser(description="Coverage of the contract in random frames").parse_args()
    counts: collections.Counter = collections.Counter()
    for name in ("default", "tiny", "coarse", "odd"):
        sensor = random_cases.GOLDEN_SENSORS[name]
        configs = random_cases.drawn(
            random_cases.configurations(sensor, frames_max=1), EXAMPLES, SEED
        )
        seeds = random_cases.drawn(st.integers(0, 2**32 - 1), EXAMPLES, SEED)
        kinds = itertools.cycle(random_cases.READY_KINDS)
        for config, seed, kind in zip(configs, seeds, kinds, strict=False):
            edges, golden = random_cases.trouble(config, seed, 12.0), Golden(config.sensor)
            ready = random_cases.ready_pattern(seed, kind, config.pulses * config.period + 100)
            for _ in range(2):  # the controller acts in the second
                situations(config, edges, golden.frame(config, edges, ready), kind, counts)
        golden = Golden(random_cases.built_sensor(sensor))
        for number, config in enumerate(
            config for config in random_cases.modes(sensor) for _ in range(2)
        ):
            kind = random_cases.READY_KINDS[number % len(random_cases.READY_KINDS)]
            edges, ready = (
                random_cases.trouble(config, number, 12.0),
                random_cases.ready_pattern(number, kind, 400),
            )
            situations(config, edges, golden.frame(config, edges, ready), kind, counts)
        for config in random_cases.counting(sensor):
            edges = random_cases.returns(config, 0, 60.0)
            situations(config, edges, golden.frame(config, edges), "always", counts)
        golden = Golden(golden.sensor)
        traces = [
            (config, golden.frame(config, random_cases.trouble(config, 0, 25.0)))
            for config in random_cases.scarce(sensor)
        ]
        for (_, before), (config, after) in itertools.pairwise(traces):
            steps(config, before, after, counts)
        print(f"{name} done", flush=True)
    for name, goal in SITUATIONS.items():
        if counts[name] < goal:
            print(f"situation {name!r}: {counts[name]} times, goal {goal}")
    covered = sum(counts[name] >= goal for name, goal in SITUATIONS.items())
    print(f"{covered} of {len(SITUATIONS)} situations")
    sys.exit(int(covered < len(SITUATIONS)))


if __name__ == "__main__":
    main()
