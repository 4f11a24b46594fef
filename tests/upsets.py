# SPDX-License-Identifier: Apache-2.0
"""Recovery from single upsets: a small sensor recovers from the flip of any flip-flop.

`python -m tests.upsets [--instants N] [--seed S] [--only TEXT]` flips every flip-flop of two
sensors N times. A trial has three frames. One flip-flop flips in the first frame, in its start, or
in between. The third frame, the second one that is started after the flip, must show every word in
its cycle, and laser and gates as usual. Every access of the register bus is answered, and every
frame ends.

The host does what a host can do: if a start is refused or the status shows an error, it clears the
status, writes all its settings again and continues. It never resets the sensor, and writes nothing
unless the sensor shows an error.

Two things need not recover: the frame number, which continues from its value, and thresholds and
budgets of the controller, whose loop continues from its state. Frames with the controller are
judged by the golden model with the thresholds that they show. A write whose address flips between
port and register may change another setting, which only a host that reads back would notice; such
trials are counted apart.

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
# Every register stays as it is: Yosys would merge equal ones, and remove others. Constant ones, it
# removes all the same.
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
    """Return the sensor's settings, by name.

    Together they cover every kind of packet, gating, dither, and the controller.
    """
    frame = {
        "period": 24,
        "pulses": 4,
        "format": "full",
        "minigroup_records": True,
        "mg_threshold": 1,
    }
    gate_in_steps = {"gate_step": 2, "gate_every": 1, "gate_steps": 3}
    gated = {"subgroups": [1], "gating": True, "gate_start": 3, "gate_len": 9, "threshold": 1}
    steps = configured(SMALL, frame | gate_in_steps, {"threshold": 2, "window": 6}, gated)

    dithered = {"format": "id", "dither_bits": 3, "dither_seed": 9}
    controller = {"capacity": 20, "auto_bounds": [0, 1, 4, 6, 9, 12]}
    without = {"subgroups": [2], "coincidence": False, "auto": False}
    led = configured(
        SMALL, frame | dithered | controller, {"threshold": 2, "window": 6, "auto": True}, without
    )
    return {"steps": steps, "led": led}


@frozen
class Flop:
    """A bit of a register or of a memory's row."""

    register: str  # its name in the flat design
    bit: int
    word: int  # of the slice, which holds it

    def __str__(self) -> str:
        return f"{self.register} bit {self.bit}"


def registers_of(sources: Sequence[Path]) -> dict[str, int]:
    """Return every register and every memory's row of the design, and its bits."""
    modules = {}
    for path in sources:
        for module in MODULE.finditer(path.read_text(encoding="utf-8")):
            modules[module[1].lstrip("\\")] = module[0]
    found = {}
    pending = [("", TOP)]
    while pending:
        at, name = pending.pop()
        text = modules[name]
        for highest, register in REGISTER.findall(text):
            found[f"{at}{register}"] = int(highest or 0) + 1
        for highest, memory, last in MEMORY.findall(text):
            for row in range(int(last) + 1):
                found[f"{at}{memory}[{row}]"] = int(highest) + 1
        for module, instance in INSTANCE.findall(text):
            pending.append((f"{at}{instance}.", module.strip().lstrip("\\")))
    return dict(sorted(found.items()))


@cache
def design(sensor: Sensor) -> Design:
    """Return the whole sensor in slices."""
    sources = {path.name: path.read_text(encoding="utf-8") for path in rtl(sensor)}
    return Design(f"{sensor_key(sensor)}-flops", sources, TOP, before=KEPT)


@cache
def flops(sensor: Sensor) -> tuple[list[Flop], Counter]:
    """Return every flip-flop of the sensor, and the bits of the Verilog's registers without one.

    These bits are constant; they are counted by register.
    """
    emission = design(sensor).emission()
    places = emission.layout.nets
    names = emission.top.names
    unnamed = {flop.output: places[flop.output] for flop in emission.top.flops}
    rows = {}
    for memory in emission.top.memories:
        for row in range(memory.rows):
            begin = emission.layout.memories[memory.name] + row * memory.width
            rows[f"{memory.name}[{row}]"] = begin
    found = []
    absent: Counter = Counter()
    for register, bits in registers_of(rtl(sensor)).items():
        nets = names.get(register, (ZERO,) * bits)
        for bit in range(bits):
            word = rows[register] + bit if register in rows else unnamed.pop(nets[bit], None)
            if word is None:
                absent[register] += 1
            else:
                found.append(Flop(register, bit, word))
    # A memory's read register has no name of its own in the Verilog.
    for name, nets in names.items():
        for bit, net in enumerate(nets):
            if net in unnamed:
                found.append(Flop(name, bit, unnamed.pop(net)))
    assert not unnamed
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
    """Counts of a campaign."""

    trials: int = 0  # flips made
    changed: int = 0  # those whose first frame shows them; not counted with the controller
    failures: list[Failure] = field(factory=list)  # trials without recovery
    # Those in which a write was upset on its way, and may have reached another register.
    misled: list[Failure] = field(factory=list)
    outcomes: Counter = field(factory=Counter)  # of frames during and after the flip, by name


class Campaign:
    """A sensor with one setting, three frames to play, and their expected records.

    A context manager. span: cycles from the beginning of a frame to the next one.
    """

    def __init__(self, config: Config, seed: int = 0):
        self.config = config
        self.sensor = config.sensor
        self.flops, self.absent = flops(self.sensor)
        self.edges = [trouble(config, seed + k, 9.0) for k in range(3)]
        self.ready = [(np.random.default_rng(k).random(200) < 0.7).astype(np.uint8) for k in (0, 1)]
        self.ready.append(np.zeros(0, np.uint8))
        self._lanes = Lanes(self.sensor, design(self.sensor))
        for edges, ready in zip(self.edges, self.ready, strict=True):
            self._lanes.recipe(config, edges, ready)
        rows = self._lanes.warm_up()
        assert not rows["outcome"].any()
        self.span = int(rows["cycles"][-1])
        self.expected = [self._lanes.shown(number) for number in rows["shown"][:3]]
        self._difference = cache(self._difference_of_record)  # most trials show the same frames
        self._assert_right_without_upset()

    def _assert_right_without_upset(self) -> None:
        """Assert that the sensor itself shows what the golden model says."""
        golden = Golden(self.sensor)
        for edges, ready, shown in zip(self.edges, self.ready, self.expected, strict=True):
            predicted = golden.frame(self.config, edges, ready)
            for beats, others in zip(shown.beats, predicted.beats, strict=True):
                assert np.array_equal(beats, others)

    def __enter__(self) -> "Campaign":
        return self

    def __exit__(self, *_: object) -> None:
        self._lanes.__exit__()

    def trials(
        self, instants: int = INSTANTS, seed: int = 0, only: str = ""
    ) -> list[tuple[Flop, int]]:
        """Return flip-flops, each at some moments, as `run` takes them.

        only: those whose register's name contains this text.
        """
        rng = random.Random(seed)
        chosen = []
        for flop in self.flops:
            if only in flop.register:
                chosen += [(flop, rng.randrange(self.span)) for _ in range(instants)]
        return chosen

    def run(self, trials: Sequence[tuple[Flop, int]]) -> Report:
        """Flip flip-flops, each in a cycle of the first frame, and judge what they show."""
        report = Report(len(trials))
        rows = self._lanes.run([(flop.word, cycle) for flop, cycle in trials])
        ends = np.searchsorted(rows["trial"], np.arange(1, len(trials)))
        for (flop, cycle), of_trial in zip(trials, np.split(rows, ends), strict=True):
            why = self._judge(of_trial, report)
            if why:
                write_upset = flop.register.startswith(FRONT) and of_trial["write"][-1]
                misled = write_upset and why not in WAITS
                failed = report.misled if misled else report.failures
                failed.append(Failure(flop, cycle, why))
        return report

    def _judge(self, rows: np.ndarray, report: Report) -> str:
        """Count what a trial shows, and return why the sensor did not recover, or ''."""
        why = ""
        for row, after in zip(rows, [*rows[1:], None], strict=True):
            frame = row["frame"]
            outcome = OUTCOMES[row["outcome"]]
            if frame == AFTER:
                if not why and outcome != "fine":
                    why = "a setting reads otherwise"
                return why
            report.outcomes[f"{FRAMES[frame]} frame: {outcome}"] += 1
            if outcome in WAITS:
                return outcome
            refused_and_tried_again = after["frame"] == frame
            if refused_and_tried_again:
                continue
            # With the controller, thresholds may differ anyway.
            if frame == 0 and not self.config.controlled.any():
                report.changed += outcome != "fine" or bool(self._difference(row["shown"], 0))
            if frame == 2:
                why = outcome if outcome != "fine" else self._difference(row["shown"], 2)
        return why

    def _difference_of_record(self, shown: int, frame: int) -> str:
        """Return how the record with a number differs from the expected frame, or ''."""
        return self.difference(self._lanes.shown(shown), self.expected[frame])

    def difference(self, shown: Shown, expected: Shown) -> str:
        """Return how a frame differs from the expected one, or ''."""
        if shown.lasers.tolist() != expected.lasers.tolist():
            return "laser"
        if shown.gates != expected.gates:
            return "gates"
        if not self.config.controlled.any():
            return difference_of_streams(shown, expected.beats, expected.cycles)
        threshold = self._thresholds(shown)
        complete = len(threshold) == self.sensor.subgroups
        if not complete or threshold.min() < 1 or threshold.max() > THRESHOLD_MAX:
            return f"thresholds {threshold.tolist()}"
        uncontrolled = np.zeros_like(self.config.auto)
        with_thresholds = evolve(self.config, threshold=threshold, auto=uncontrolled)
        predicted = Golden(self.sensor).frame(with_thresholds, self.edges[2], self.ready[2])
        return difference_of_streams(shown, predicted.beats, predicted.beat_cycle)

    def _thresholds(self, shown: Shown) -> np.ndarray:
        """Return the thresholds that a frame shows, int64[subgroups]; fewer if it is not whole."""
        used = []
        for stream, beats in enumerate(shown.beats):
            used.append(self._counters(beats, stream)[:, USED])
        return np.concatenate(used)

    def _counters(self, beats: np.ndarray, stream: int) -> np.ndarray:
        """Return the counters of a frame, int64[subgroups of the stream, counters].

        It is empty if there is no whole frame.
        """
        subgroups = len(self.sensor.stream_subgroups(stream))
        try:
            return decode_frame(beats, self.sensor, subgroups).counters
        except ValueError:
            return np.zeros((0, len(COUNTER_NAMES)), np.int64)


def difference_of_streams(
    shown: Shown, wanted: Sequence[np.ndarray], wanted_cycles: Sequence[np.ndarray]
) -> str:
    """Return how beats or their cycles differ from the wanted ones, or ''.

    wanted, wanted_cycles: of each stream. Frame numbers are not compared.
    """
    for stream, (beats, others) in enumerate(zip(shown.beats, wanted, strict=True)):
        one = without_number(beats)
        other = without_number(others)
        if len(one) != len(other):
            return f"{len(one)} beats on stream {stream}, not {len(other)}"
        if (one != other).any():
            k = int(np.flatnonzero(one != other)[0])
            return f"beat {k} of stream {stream} is {one[k]:#x}, not {other[k]:#x}"
    for stream, (cycles, other) in enumerate(zip(shown.cycles, wanted_cycles, strict=True)):
        if (cycles != other).any():
            return f"cycles of stream {stream}"
    return ""


def without_number(beats: np.ndarray) -> np.ndarray:
    """Return the beats of a frame with the frame number in its first and last header cleared."""
    lowest, width = HEADER["pulse"]
    kind, _ = HEADER["kind"]
    kinds = beats >> np.uint64(kind)
    own = (kinds == FRAME_START.code) | (kinds == FRAME_END.code)
    return np.where(own, beats & ~np.uint64(((1 << width) - 1) << lowest), beats)


def _print_report(name: str, report: Report) -> None:
    """Print the counts of a campaign, and one failure of every register that has some."""
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


def main(arguments: list[str]) -> int:
    """Run the campaign of the command line; return 1 if a trial did not heal, else 0."""
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
    chosen = {name: config for name, config in cases().items() if options.case in (None, name)}
    unhealed = 0
    for name, config in chosen.items():
        with Campaign(config) as campaign:
            absent = ", ".join(
                f"{bits} of {register}" for register, bits in campaign.absent.items()
            )
            print(
                f"{name}: {len(campaign.flops)} flip-flops, {campaign.span} cycles; "
                f"constant bits, without one: {absent}"
            )
            report = campaign.run(campaign.trials(options.instants, options.seed, options.only))
        _print_report(name, report)
        unhealed += len(report.failures)
    return 1 if unhealed else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
