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
thresholds that they show.
"""

import argparse
import ctypes
import random
import re
import sys
from collections import Counter
from functools import cache
from pathlib import Path

import numpy as np
from attrs import define, evolve, field, frozen

from coincid.model.contract import registers
from coincid.model.contract.config import Config
from coincid.model.contract.counters import COUNTER_NAMES
from coincid.model.contract.packet import FRAME_END, FRAME_START, HEADER
from coincid.model.contract.parameters import TOP, Sensor
from coincid.model.contract.ports import port_bits
from coincid.model.contract.settings import THRESHOLD_MAX
from coincid.model.contract.stream import decode_frame
from coincid.model.golden.frame import Golden
from coincid.model.shared.folders import build_root
from coincid.model.shared.sources import digest
from coincid.tb import toolchain
from coincid.tb.frames import cycle_limit
from coincid.tb.rtl import rtl, sensor_key
from coincid.tools.build import build_once, compile_in

from .cases import configured, trouble

SOURCE = Path(__file__).with_suffix(".cpp")
LIBRARY = "libupsets.so"
VERILATOR = ("--cc", *toolchain.VERILATOR_OPTIONS, toolchain.NOT_INLINED, "--vpi", "-CFLAGS", "-fPIC")
COMPILER = ("-std=gnu++20", "-O2", "-fPIC")
MAKE_OPTIONS = ("OPT_FAST=-O1", "OPT_SLOW=-O0", "OPT_GLOBAL=-O1")
OUTCOMES = ("fine", "the bus waits", "never done", "start refused", "no laser", "no tlast", "error told")
WAITS = (1, 2)  # outcomes that no upset may have
GAP = 30  # idle cycles between a trial's frames
USED = COUNTER_NAMES.index("threshold_used")

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
FLOP = re.compile(r"^  reg (?:\[(\d+):0\] )?\\?(\S+)\s+= \d+'", re.MULTILINE)
MEMORY = re.compile(r"^  reg \[(\d+):0\] \\?(\S+)\s+\[(\d+):0\];", re.MULTILINE)
INSTANCE = re.compile(r"^  (coincid_\w+|\\coincid_\S+ ) ?\\?(\S+)\s+\(", re.MULTILINE)
MODULE = re.compile(r"^module (\\?\S+)\s*\(.*?^endmodule", re.MULTILINE | re.DOTALL)


def cases() -> dict[str, Config]:
    """Return the sensor's settings, by name: together they cover every kind of packet, gating, dither, the controller."""
    frame = {"period": 24, "pulses": 4, "format": "full", "minigroup_records": True, "mg_threshold": 1}
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
            | {"format": "id", "dither_bits": 3, "dither_seed": 9, "capacity": 20, "auto_bounds": [0, 1, 4, 6, 9, 12]},
            {"threshold": 2, "window": 6, "auto": True},
            {"subgroups": [2], "coincidence": False, "auto": False},
        ),
    }


@frozen
class Flop:
    """A register of an instance, or a memory of some words. path: of the instance in the Verilog."""

    path: str
    name: str
    bits: int
    words: int = 1
    memory: bool = False

    def __str__(self) -> str:
        return f"{self.path}.{self.name}"


def flops_of_modules(sources: list[Path]) -> tuple[dict[str, list[Flop]], dict[str, list[tuple[str, str]]]]:
    """Return by module its own flip-flops, and the modules that it instantiates with the instances' names."""
    found: dict[str, list[Flop]] = {}
    instances = {}
    for path in sources:
        for module in MODULE.finditer(path.read_text()):
            text, name = module[0], module[1].lstrip("\\")
            kept = [(top, register) for top, register in FLOP.findall(text) if not register.startswith("$")]
            found[name] = [Flop("", register, int(top or 0) + 1) for top, register in kept]
            found[name] += [
                Flop("", memory, int(top) + 1, int(last) + 1, True) for top, memory, last in MEMORY.findall(text)
            ]
            instances[name] = [(of.strip().lstrip("\\"), inner) for of, inner in INSTANCE.findall(text)]
    return found, instances


def flops(sources: list[Path]) -> list[Flop]:
    """Return every flip-flop of the design."""
    found, instances = flops_of_modules(sources)
    result, todo = [], [("", TOP)]
    while todo:
        at, name = todo.pop()
        result += [evolve(flop, path=at) for flop in found[name]]
        todo += [(f"{at}.{inner}".lstrip("."), of) for of, inner in instances[name]]
    return sorted(result, key=str)


def ports_header(sensor: Sensor) -> str:
    """Return the header that describes a sensor to `upsets.cpp`."""
    axes = [
        f"    visit({k}, {', '.join(f'top.{sensor.stream_name(k)}_{wire}' for wire in ('tdata', 'tvalid', 'tready', 'tlast'))});"
        for k in range(sensor.streams)
    ]
    control = registers.BY_NAME["control"]
    lines = [
        "#pragma once",
        f"constexpr int STREAMS = {sensor.streams};",
        f"constexpr uint32_t CONTROL = {registers.address('control')}, START = {1 << control.bit('start')};",
        f"constexpr uint32_t STATUS = {registers.address('status')};",
        "template <class Visit> void for_each_stream(Vtop& top, Visit visit) {",
        *axes,
        "}",
        "template <class Visit> void spads(Vtop& top, Visit visit) {",
        *(f"    visit({s}, top.spad_{s});" for s in range(sensor.subgroups)),
        "}",
        "",
    ]
    return "\n".join(lines)


def _archives(sensor: Sensor) -> Path:
    """Return the sensor's Verilated model with writable flip-flops: headers and archives, compiled once."""
    program, sources = toolchain.verilator(), rtl(sensor)
    contents = [part for path in sources for part in (path.name, path.read_text())]
    key = digest(str(program), *VERILATOR, *COMPILER, *MAKE_OPTIONS, *contents)
    directory = build_root() / "upsets" / f"{sensor_key(sensor)}-{key}"

    def make(scratch: Path) -> None:
        log = directory.with_name(f"{directory.name}.log")
        log.unlink(missing_ok=True)
        public = [
            f'public_flat_rw -module "{module}" -var "{flop.name}"'
            for module, own in flops_of_modules(sources)[0].items()
            for flop in own
        ]
        (scratch / "public.vlt").write_text("\n".join(["`verilator_config", *public, ""]))
        names = ["--top-module", TOP, "--prefix", "Vtop", "--Mdir", ".", "public.vlt", *map(str, sources)]
        compile_in(scratch, log, [str(program), *VERILATOR, *names])
        targets = ["libVtop.a", "libverilated.a"]
        compile_in(scratch, log, ["make", "-s", "-j", "2", "-f", "Vtop.mk", *MAKE_OPTIONS, *targets])

    return build_once(directory, make)


@cache
def library(sensor: Sensor) -> ctypes.CDLL:
    """Compile the sensor with its host, once."""
    include, header, archives = toolchain.verilator().parents[1] / "include", ports_header(sensor), _archives(sensor)
    directory = build_root() / "upsets" / f"host-{digest(str(archives), *COMPILER, header, SOURCE.read_text())}"

    def make(scratch: Path) -> None:
        log = directory.with_name(f"{directory.name}.log")
        log.unlink(missing_ok=True)
        (scratch / "ports.h").write_text(header)
        command = ["g++", "-shared", *COMPILER, "-o", LIBRARY, str(SOURCE), "-I.", f"-I{archives}", f"-I{include}"]
        objects = [str(archives / name) for name in ("libVtop.a", "libverilated.a")]
        compile_in(scratch, log, [*command, f"-I{include / 'vltstd'}", *objects, "-lpthread", "-latomic"])

    result = ctypes.CDLL(str(build_once(directory, make) / LIBRARY))
    pointer, i64, u32 = ctypes.c_void_p, ctypes.c_int64, ctypes.c_uint32
    for name, answer, arguments in (
        ("new", pointer, []),
        ("delete", None, [pointer]),
        ("reset", None, [pointer]),
        ("find", ctypes.c_int, [pointer, ctypes.c_char_p, ctypes.c_char_p]),
        ("setting", None, [pointer, u32, u32]),
        ("recipe", None, [pointer, i64, pointer, pointer, pointer, pointer, i64, i64, i64]),
        ("program", ctypes.c_int, [pointer]),
        ("frame", ctypes.c_int, [pointer, ctypes.c_int]),
        ("check_settings", ctypes.c_int, [pointer]),
        ("upset", None, [pointer, ctypes.c_int, i64, ctypes.c_int, i64]),
        ("idle", None, [pointer, i64]),
        ("now", i64, [pointer]),
        ("beats", i64, [pointer, ctypes.c_int, ctypes.POINTER(pointer)]),
        ("lasers", i64, [pointer, ctypes.POINTER(pointer)]),
        ("gates", ctypes.c_uint64, [pointer]),
    ):
        function = getattr(result, f"upsets_{name}")
        function.restype, function.argtypes = answer, arguments
    return result


@define
class Shown:
    """Record of a frame: per stream its beats and their cycles, the laser's cycles, and a digest of the gates."""

    beats: list[np.ndarray]
    cycles: list[np.ndarray]
    lasers: list[int]
    gates: int

    def equals(self, other: "Shown") -> bool:
        """Return whether everything is the same, except the frame number."""
        return (self.lasers, self.gates) == (other.lasers, other.gates) and all(
            np.array_equal(without_number(a), without_number(b)) for a, b in zip(self.beats, other.beats)
        )


@frozen
class Failure:
    """A trial after which the sensor did not recover."""

    flop: Flop
    bit: int
    cycle: int
    why: str

    def __str__(self) -> str:
        return f"{self.flop} bit {self.bit} in cycle {self.cycle}: {self.why}"


@define
class Report:
    """Counts of a campaign. trials: flips made; changed: those whose first frame shows them (without the controller).

    failures: trials without recovery. outcomes: number of frames with each outcome during and after the flip, by name."""

    trials: int = 0
    changed: int = 0
    failures: list[Failure] = field(factory=list)
    outcomes: Counter = field(factory=Counter)


class Campaign:
    """A sensor with one setting, three frames to play, and their expected records."""

    def __init__(self, config: Config, seed: int = 0):
        self.config, self.sensor = config, config.sensor
        self._library = library(config.sensor)
        self._host = self._library.upsets_new()
        for address, value in config.register_writes():
            self._library.upsets_setting(self._host, address, value)
        self.edges = [trouble(config, seed + k, 9.0) for k in range(3)]
        self.ready = [(np.random.default_rng(k).random(200) < 0.7).astype(np.uint8) for k in range(2)]
        self.ready.append(np.zeros(0, np.uint8))
        for edges, ready in zip(self.edges, self.ready):
            self._recipe(edges, ready)
        self._indices: dict[Flop, int] = {}
        self.refresh()
        self.expected = [self.play(k) for k in range(3)]
        begin = self._library.upsets_now(self._host)
        self.play(0)
        self.span = self._library.upsets_now(self._host) - begin + GAP
        golden = Golden(self.sensor)
        for number in range(4):  # the sensor itself is right
            trace = golden.frame(config, self.edges[number % 3], self.ready[number % 3])
            if number < 3:
                for one, other in zip(self.expected[number].beats, trace.beats):
                    assert np.array_equal(one, other)

    def close(self) -> None:
        self._library.upsets_delete(self._host)

    def _recipe(self, edges, ready) -> None:
        cycle, subgroup, bit = port_bits(self.config, edges)
        order = np.argsort(cycle, kind="stable")
        columns = [
            np.ascontiguousarray(column[order], kind)
            for column, kind in ((cycle, np.int64), (subgroup, np.int32), (bit, np.int32))
        ]
        # A period or a frame that an upset makes longer lasts until the end of its counter.
        longest = 2 * self.config.pulses * 2 * self.sensor.period_max
        limit = 2 * cycle_limit(self.config, len(ready)) + longest
        pointers = [column.ctypes.data for column in columns]
        self._library.upsets_recipe(
            self._host, len(order), *pointers, ready.ctypes.data, len(ready), self.config.frame_cycles, limit
        )

    def refresh(self) -> None:
        """Reset the sensor, and write all settings."""
        self._library.upsets_reset(self._host)
        assert self._library.upsets_program(self._host) == 0

    def index(self, flop: Flop) -> int:
        """Return the library's number of a flip-flop, or -1 if Verilator has removed it as unused."""
        if flop not in self._indices:
            parts = ["TOP", TOP, *filter(None, flop.path.split("."))]
            scope = ".".join(map(as_verilog, parts))
            self._indices[flop] = self._library.upsets_find(self._host, scope.encode(), as_verilog(flop.name).encode())
        return self._indices[flop]

    def play(self, recipe: int) -> Shown:
        """Play a frame that must be right."""
        outcome = self._library.upsets_frame(self._host, recipe)
        assert outcome == 0, OUTCOMES[outcome]
        return self.shown()

    def shown(self) -> Shown:
        beats, cycles = [], []
        pointer = ctypes.c_void_p()
        for stream in range(self.sensor.streams):
            n = self._library.upsets_beats(self._host, stream, ctypes.byref(pointer))
            rows = (
                np.ctypeslib.as_array(ctypes.cast(pointer, ctypes.POINTER(ctypes.c_uint64)), (n, 2)).copy()
                if n
                else np.zeros((0, 2), np.uint64)
            )
            beats.append(rows[:, 0])
            cycles.append(rows[:, 1].astype(np.int64))
        n = self._library.upsets_lasers(self._host, ctypes.byref(pointer))
        lasers = np.ctypeslib.as_array(ctypes.cast(pointer, ctypes.POINTER(ctypes.c_int64)), (n,)).tolist() if n else []
        return Shown(beats, cycles, lasers, self._library.upsets_gates(self._host))

    def trial(self, flop: Flop, word: int, bit: int, cycle: int, report: Report) -> None:
        """Flip a flip-flop `cycle` cycles after the beginning of a frame, and judge the second frame that is started after."""
        width = 8 if flop.bits <= 8 else 16 if flop.bits <= 16 else 32 * -(-flop.bits // 32)
        width = 64 if 32 < flop.bits <= 64 else width
        self._library.upsets_upset(self._host, self.index(flop), word * width // 8, bit, cycle)
        report.trials += 1
        why, frames, tries = "", 0, 0
        while frames < 3 and not why:
            outcome = self._library.upsets_frame(self._host, frames)
            self._library.upsets_idle(self._host, GAP)
            report.outcomes[f"{('upset', 'first', 'second')[frames]} frame: {OUTCOMES[outcome]}"] += 1
            if outcome in WAITS:
                why = f"{OUTCOMES[outcome]} ({('upset', 'first', 'second')[frames]} frame)"
            elif OUTCOMES[outcome] == "start refused" and tries < 2:
                tries += 1
            else:
                if frames == 0 and not self.config.controlled.any():  # else thresholds may differ anyway
                    report.changed += outcome != 0 or not self.shown().equals(self.expected[0])
                if frames == 2:
                    why = OUTCOMES[outcome] if outcome else self.difference(self.shown(), self.expected[2])
                frames += 1
        if not why and self._library.upsets_check_settings(self._host):
            why = "a setting reads otherwise"
        if why:
            report.failures.append(Failure(flop, word * flop.bits + bit, cycle, why))
            self.refresh()

    def difference(self, shown: Shown, expected: Shown) -> str:
        """Return how a frame differs from the expected one, or ''."""
        if shown.lasers != expected.lasers:
            return "laser"
        if shown.gates != expected.gates:
            return "gates"
        wanted, wanted_cycles = expected.beats, expected.cycles
        if self.config.controlled.any():
            used = [counters[:, USED] for counters in map(self._counters, shown.beats, range(self.sensor.streams))]
            threshold = np.concatenate(used)
            if len(threshold) != self.sensor.subgroups or threshold.min() < 1 or threshold.max() > THRESHOLD_MAX:
                return f"thresholds {threshold.tolist()}"
            led = evolve(self.config, threshold=threshold, auto=np.zeros_like(self.config.auto))
            trace = Golden(self.sensor).frame(led, self.edges[2], self.ready[2])
            wanted, wanted_cycles = trace.beats, trace.beat_cycle
        for stream, (one, other) in enumerate(zip(shown.beats, wanted)):
            one, other = without_number(one), without_number(other)
            if len(one) != len(other):
                return f"{len(one)} beats on stream {stream}, not {len(other)}"
            if (one != other).any():
                k = int(np.flatnonzero(one != other)[0])
                return f"beat {k} of stream {stream} is {one[k]:#x}, not {other[k]:#x}"
        for stream, (cycles, others) in enumerate(zip(shown.cycles, wanted_cycles)):
            if (cycles != others).any():
                return f"cycles of stream {stream}"
        return ""

    def _counters(self, beats: np.ndarray, stream: int) -> np.ndarray:
        """Return the counters of a frame, int64[subgroups of the stream, counters]; empty if there is no whole frame."""
        try:
            return decode_frame(beats, self.sensor, len(self.sensor.stream_subgroups(stream))).counters
        except ValueError:
            return np.zeros((0, len(COUNTER_NAMES)), np.int64)


def as_verilog(name: str) -> str:
    """Return a name as Verilog escapes it, if necessary."""
    return f"\\{name} " if "$" in name else name


def without_number(beats: np.ndarray) -> np.ndarray:
    """Return the beats of a frame with the frame number in its first and last header cleared."""
    lowest, width = HEADER["pulse"]
    kind, _ = HEADER["kind"]
    kinds = beats >> np.uint64(kind)
    own = (kinds == FRAME_START.code) | (kinds == FRAME_END.code)
    return np.where(own, beats & ~np.uint64(((1 << width) - 1) << lowest), beats)


def every_bit(campaign: Campaign, only: str = "") -> list[tuple[Flop, int, int]]:
    """Return (flip-flop, word, bit) for all in the model whose path contains `only`."""
    return [
        (flop, word, bit)
        for flop in flops(rtl(campaign.sensor))
        if only in str(flop) and campaign.index(flop) >= 0
        for word in range(flop.words)
        for bit in range(flop.bits)
    ]


def main(arguments: list[str]) -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.upsets", description=__doc__.splitlines()[0])
    parser.add_argument("--instants", type=int, default=4, help="moments at which each flip-flop flips (default 4)")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", default="", help="only flip-flops whose path contains this")
    parser.add_argument("--case", choices=cases(), help="only this setting of the sensor")
    options = parser.parse_args(arguments)
    bad = 0
    for name, config in cases().items():
        if options.case not in (None, name):
            continue
        campaign = Campaign(config)
        report = Report()
        rng = random.Random(options.seed)
        lost = [str(flop) for flop in flops(rtl(config.sensor)) if campaign.index(flop) < 0]
        targets = every_bit(campaign, options.only)
        absent = ", ".join(lost) or "none"
        print(f"{name}: {len(targets)} flip-flops, {campaign.span} cycles; not in the model: {absent}")
        for flop, word, bit in targets:
            for _ in range(options.instants):
                campaign.trial(flop, word, bit, rng.randrange(campaign.span), report)
        campaign.close()
        unhealed = len(report.failures)
        print(f"{name}: {report.trials} trials, {report.changed} seen in their frame, {unhealed} did not heal")
        for outcome, count in sorted(report.outcomes.items()):
            print(f"  {outcome}: {count}")
        by_flop = Counter(str(failure.flop) for failure in report.failures)
        first = {str(failure.flop): failure for failure in reversed(report.failures)}
        for flop, count in by_flop.most_common():
            print(f"  {count:4} {first[flop]}")
        bad += unhealed
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
