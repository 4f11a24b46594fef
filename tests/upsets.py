# SPDX-License-Identifier: Apache-2.0
"""Recovery from single upsets: every flip-flop of a small sensor is flipped, without a reset, and the sensor recovers.

`python -m tests.upsets [--instants N] [--seed S] [--only TEXT]` flips every flip-flop of two sensors N times. A trial has
three frames. One flip-flop flips in the first frame, in its start, or in between. The third frame, the second one that is
started after the flip, must show every word in its cycle, and laser and gates as usual. Every access of the register bus
is answered, and every frame ends.

The host does what a host can do: if a start is refused or the status shows an error, it clears the status, writes all its
settings again and continues. It never resets the sensor, and writes nothing unless the sensor shows an error.

Two things need not recover: the frame number, which continues from its value, and thresholds and budgets of the
controller, whose loop continues from its state. Frames with the controller are judged by the golden model with the
thresholds that they show. A write whose address flips between port and register may change another setting, which only
a host that reads back would notice; such trials are counted apart.

Every trial is a lane of the sensor in slices, and begins in the same state.
"""

import argparse
import random
import re
import sys
from collections import Counter
from collections.abc import Sequence
from functools import cache
from pathlib import Path

import numpy as np
from attrs import define, evolve, field, frozen

from coincid.model.contract.config import Config
from coincid.model.contract.counters import COUNTER_NAMES
from coincid.model.contract.packet import FRAME_END, FRAME_START, HEADER
from coincid.model.contract.parameters import TOP, Sensor
from coincid.model.contract.settings import THRESHOLD_MAX
from coincid.model.contract.stream import decode_frame
from coincid.model.golden.frame import Golden
from coincid.slices.netlist import ZERO
from coincid.slices.synthesis import Design
from coincid.tb.rtl import rtl, sensor_key

from .lanes import AFTER, FRAMES, OUTCOMES, Lanes, Shown
from .random_cases import configured, trouble

WAITS = ("the bus waits", "never done")  # outcomes that no upset may have
INSTANTS = 4  # at which every flip-flop flips
FRONT = "registers."  # what stands between the bus and the settings
USED = COUNTER_NAMES.index("threshold_used")
# Every register stays as it is: Yosys would merge equal ones, and remove others. Constant ones, it removes all the same.
KEPT = ("proc", "opt_clean", "simplemap t:$dff", "setattr -set keep 1 t:$_DFF_P_")

SMALL = dict(
    rows=12,
    cols=4,
    subgroup=[4, 4],
    minigroup=[2, 2],
    phases=4,
    offset_phases=4,
    window_max=8,
    coarse_bits=6,
    fifo_depth=2,
    streams=2,
)
REGISTER = re.compile(r"^  reg (?:\[(\d+):0\] )?\\?(\S+)\s+= \d+'", re.MULTILINE)
MEMORY = re.compile(r"^  reg \[(\d+):0\] \\?(\S+)\s+\[(\d+):0\];", re.MULTILINE)
INSTANCE = re.compile(r"^  (coincid_\w+|\\coincid_\S+ ) ?\\?(\S+)\s+\(", re.MULTILINE)
MODULE = re.compile(r"^module (\\?\S+)\s*\(.*?^endmodule", re.MULTILINE | re.DOTALL)


def cases() -> dict[str, Config]:
    """Return the sensor's settings, by name: together they cover every kind of packet, gating, dither, the controller."""
    frame = {
        "period": 24,
        "pulses": 4,
        "format": "full",
        "minigroup_records": True,
        "mg_threshold": 1,
    }
    return {
        "steps": configured(
            SMALL,
            frame | {"gate_step": 2, "gate_every": 1, "gate_steps": 3},
            {"threshold": 2, "window": 6},
            {"subgroups": [1], "gating": True, "gate_start": 3, "gate_len": 9, "threshold": 1},
        ),
        "led": configured(
            SMALL,
            frame
            | {
                "format": "id",
                "dither_bits": 3,
                "dither_seed": 9,
                "capacity": 20,
                "auto_bounds": [0, 1, 4, 6, 9, 12],
            },
            {"threshold": 2, "window": 6, "auto": True},
            {"subgroups": [2], "coincidence": False, "auto": False},
        ),
    }


@frozen
class Flop:
    """A bit of a register or of a memory's row. register: its name in the flat design; word: of the slice, which holds it."""

    register: str
    bit: int
    word: int

    def __str__(self) -> str:
        return f"{self.register} bit {self.bit}"


def registers_of(sources: Sequence[Path]) -> dict[str, int]:
    """Return every register and every memory's row of the design, and its bits."""
    modules = {
        module[1].lstrip("\\"): module[0]
        for path in sources
        for module in MODULE.finditer(path.read_text(encoding="utf-8"))
    }
    found, todo = {}, [("", TOP)]
    while todo:
        at, name = todo.pop()
        found |= {
            f"{at}{register}": int(top or 0) + 1
            for top, register in REGISTER.findall(modules[name])
        }
        for top, memory, last in MEMORY.findall(modules[name]):
            found |= {f"{at}{memory}[{row}]": int(top) + 1 for row in range(int(last) + 1)}
        todo += [
            (f"{at}{inner}.", of.strip().lstrip("\\"))
            for of, inner in INSTANCE.findall(modules[name])
        ]
    return dict(sorted(found.items()))


@cache
def design(sensor: Sensor) -> Design:
    """Return the whole sensor in slices."""
    sources = {path.name: path.read_text(encoding="utf-8") for path in rtl(sensor)}
    return Design(f"{sensor_key(sensor)}-flops", sources, TOP, before=KEPT)


@cache
def flops(sensor: Sensor) -> tuple[list[Flop], Counter]:
    """Return every flip-flop of the sensor, and how many bits of the Verilog's registers are constant and have none."""
    emission = design(sensor).emission()
    layout, names = emission.layout, emission.top.names
    words = {flop.output: layout.nets[flop.output] for flop in emission.top.flops}
    rows = {
        f"{memory.name}[{row}]": layout.memories[memory.name] + row * memory.width
        for memory in emission.top.memories
        for row in range(memory.rows)
    }
    found, absent = [], Counter()
    for register, bits in registers_of(rtl(sensor)).items():
        nets = names.get(register, (ZERO,) * bits)
        for bit in range(bits):
            word = rows[register] + bit if register in rows else words.pop(nets[bit], None)
            if word is None:
                absent[register] += 1
            else:
                found.append(Flop(register, bit, word))
    # A memory's read register has no name of its own in the Verilog.
    found += [
        Flop(name, bit, words.pop(net))
        for name, nets in names.items()
        for bit, net in enumerate(nets)
        if net in words
    ]
    assert not words
    return found, absent


@frozen
class Failure:
    """A trial after which the sensor did not recover."""

    flop: Flop
    cycle: int
    why: str

    def __str__(self) -> str:
        return f"{self.flop} in cycle {self.cycle}: {self.why}"


@define
class Report:
    """Counts of a campaign. trials: flips made; changed: those whose first frame shows them (without the controller).

    failures: trials without recovery. misled: those in which a write was upset on its way and may have reached another
    register. outcomes: number of frames with each outcome during and after the flip, by name.
    """

    trials: int = 0
    changed: int = 0
    failures: list[Failure] = field(factory=list)
    misled: list[Failure] = field(factory=list)
    outcomes: Counter = field(factory=Counter)


class Campaign:
    """A sensor with one setting, three frames to play, and their expected records. A context manager.

    span: cycles from the beginning of a frame to the next one.
    """

    def __init__(self, config: Config, seed: int = 0):
        self.config, self.sensor = config, config.sensor
        self.flops, self.absent = flops(self.sensor)
        self.edges = [trouble(config, seed + k, 9.0) for k in range(3)]
        self.ready = [
            (np.random.default_rng(k).random(200) < 0.7).astype(np.uint8) for k in range(2)
        ]
        self.ready.append(np.zeros(0, np.uint8))
        self._lanes = Lanes(self.sensor, design(self.sensor))
        for edges, ready in zip(self.edges, self.ready, strict=True):
            self._lanes.recipe(config, edges, ready)
        rows = self._lanes.warm_up()
        assert not rows["outcome"].any()
        self.span = int(rows["cycles"][-1])
        self.expected = [self._lanes.shown(number) for number in rows["shown"][:3]]
        # Most trials show the same frames.
        self._difference = cache(
            lambda shown, frame: self.difference(self._lanes.shown(shown), self.expected[frame])
        )
        golden = Golden(self.sensor)
        for edges, ready, shown in zip(
            self.edges, self.ready, self.expected, strict=True
        ):  # the sensor itself is right
            for one, other in zip(
                shown.beats, golden.frame(config, edges, ready).beats, strict=True
            ):
                assert np.array_equal(one, other)

    def __enter__(self) -> "Campaign":
        return self

    def __exit__(self, *_: object) -> None:
        self._lanes.__exit__()

    def trials(
        self, instants: int = INSTANTS, seed: int = 0, only: str = ""
    ) -> list[tuple[Flop, int]]:
        """Return flip-flops whose register's name contains `only`, each at some moments, as `run` takes them."""
        rng = random.Random(seed)
        targets = [flop for flop in self.flops if only in flop.register]
        return [(flop, rng.randrange(self.span)) for flop in targets for _ in range(instants)]

    def run(self, trials: Sequence[tuple[Flop, int]]) -> Report:
        """Flip flip-flops, each in a cycle of the first frame, and judge the second frame that is started after it."""
        report = Report(len(trials))
        rows = self._lanes.run([(flop.word, cycle) for flop, cycle in trials])
        ends = np.searchsorted(rows["trial"], np.arange(1, len(trials)))
        for (flop, cycle), of in zip(trials, np.split(rows, ends), strict=True):
            if why := self._judge(of, report):
                misled = flop.register.startswith(FRONT) and of["write"][-1] and why not in WAITS
                (report.misled if misled else report.failures).append(Failure(flop, cycle, why))
        return report

    def _judge(self, rows: np.ndarray, report: Report) -> str:
        """Count what a trial shows, and return why the sensor did not recover, or ''."""
        why = ""
        for row, after in zip(rows, [*rows[1:], None], strict=True):
            frame, outcome = row["frame"], OUTCOMES[row["outcome"]]
            if frame == AFTER:
                return why or "a setting reads otherwise" * (outcome != "fine")
            report.outcomes[f"{FRAMES[frame]} frame: {outcome}"] += 1
            if outcome in WAITS:
                return outcome
            if after["frame"] == frame:  # a refused start, which is tried again
                continue
            if frame == 0 and not self.config.controlled.any():  # else thresholds may differ anyway
                report.changed += outcome != "fine" or bool(self._difference(row["shown"], 0))
            if frame == 2:
                why = outcome if outcome != "fine" else self._difference(row["shown"], 2)
        return why

    def difference(self, shown: Shown, expected: Shown) -> str:
        """Return how a frame differs from the expected one, or ''."""
        if shown.lasers.tolist() != expected.lasers.tolist():
            return "laser"
        if shown.gates != expected.gates:
            return "gates"
        wanted, wanted_cycles = expected.beats, expected.cycles
        if self.config.controlled.any():
            used = [
                counters[:, USED]
                for counters in map(self._counters, shown.beats, range(self.sensor.streams))
            ]
            threshold = np.concatenate(used)
            if (
                len(threshold) != self.sensor.subgroups
                or threshold.min() < 1
                or threshold.max() > THRESHOLD_MAX
            ):
                return f"thresholds {threshold.tolist()}"
            led = evolve(self.config, threshold=threshold, auto=np.zeros_like(self.config.auto))
            trace = Golden(self.sensor).frame(led, self.edges[2], self.ready[2])
            wanted, wanted_cycles = trace.beats, trace.beat_cycle
        for stream, (one, other) in enumerate(zip(shown.beats, wanted, strict=True)):
            one, other = without_number(one), without_number(other)
            if len(one) != len(other):
                return f"{len(one)} beats on stream {stream}, not {len(other)}"
            if (one != other).any():
                k = int(np.flatnonzero(one != other)[0])
                return f"beat {k} of stream {stream} is {one[k]:#x}, not {other[k]:#x}"
        for stream, (cycles, others) in enumerate(zip(shown.cycles, wanted_cycles, strict=True)):
            if (cycles != others).any():
                return f"cycles of stream {stream}"
        return ""

    def _counters(self, beats: np.ndarray, stream: int) -> np.ndarray:
        """Return the counters of a frame, int64[subgroups of the stream, counters]; empty if there is no whole frame."""
        try:
            return decode_frame(
                beats, self.sensor, len(self.sensor.stream_subgroups(stream))
            ).counters
        except ValueError:
            return np.zeros((0, len(COUNTER_NAMES)), np.int64)


def without_number(beats: np.ndarray) -> np.ndarray:
    """Return the beats of a frame with the frame number in its first and last header cleared."""
    lowest, width = HEADER["pulse"]
    kind, _ = HEADER["kind"]
    kinds = beats >> np.uint64(kind)
    own = (kinds == FRAME_START.code) | (kinds == FRAME_END.code)
    return np.where(own, beats & ~np.uint64(((1 << width) - 1) << lowest), beats)


def main(arguments: list[str]) -> int:
    parser = argparse.ArgumentParser(
        prog="python -m tests.upsets", description=__doc__.splitlines()[0]
    )
    parser.add_argument(
        "--instants", type=int, default=INSTANTS, help="moments at which each flip-flop flips"
    )
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", default="", help="only flip-flops whose path contains this")
    parser.add_argument("--case", choices=cases(), help="only this setting of the sensor")
    options = parser.parse_args(arguments)
    bad = 0
    for name, config in cases().items():
        if options.case not in (None, name):
            continue
        with Campaign(config) as campaign:
            absent = ", ".join(
                f"{bits} of {register}" for register, bits in campaign.absent.items()
            )
            print(
                f"{name}: {len(campaign.flops)} flip-flops, {campaign.span} cycles; constant bits, without one: {absent}"
            )
            report = campaign.run(campaign.trials(options.instants, options.seed, options.only))
        unhealed = len(report.failures)
        print(
            f"{name}: {report.trials} trials, {report.changed} seen in their frame, {unhealed} did not heal"
        )
        print(f"  writes that were upset on their way, with consequences: {len(report.misled)}")
        for outcome, count in sorted(report.outcomes.items()):
            print(f"  {outcome}: {count}")
        by_register = Counter(failure.flop.register for failure in report.failures)
        first = {failure.flop.register: failure for failure in reversed(report.failures)}
        for register, count in by_register.most_common():
            print(f"  {count:4} {first[register]}")
        bad += unhealed
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
