# SPDX-License-Identifier: Apache-2.0
"""Mutation test of the regression: bugs are put into RTL and golden model, one at a time, and the regression must notice.

`python -m tests.mutation [--seed N] [--rtl N] [--golden N]` writes build/mutation/report.md and fails below
`GOALS`.

* RTL: Yosys mutates cells of the emitted Verilog (`mutate`), block by block, in proportion to the size of the block. Some
  500 mutants are in one netlist, each with an input that turns it on, and are played in slices: lane 0 is the RTL as it is,
  and every other lane has one mutant. A mutant is killed if its lane shows something else than lane 0 at the ports, while one
  host plays all lanes (`session.py`): frames, in which lane 0 must show what the golden model says, then accesses and
  resets. A longer session, with upsets and wide numbers, too, plays what is left. A mutant that Yosys removes, or proves to
  be equal to the block (`equiv_induct`), is equivalent. Three more hosts play the rest.
* Golden model: its syntax tree is mutated here. mutmut and cosmic-ray would start a test run for every mutant, and Numba
  would compile all functions again. Without Numba, and compared with recorded beats and fates of the same frames, a
  mutant takes a second; survivors go through the tests of the golden model.
* Planted bugs are typical human mistakes, by name: `planted.py`.
"""

import argparse
import ast
import copy
import itertools
import os
import re
import subprocess
import sys
import zlib
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from attrs import frozen
from hypothesis import given, seed
from hypothesis import strategies as st

from coincid.model.contract.config import parse_config
from coincid.model.contract.packet import FORMAT_NAMES
from coincid.model.contract.parameters import TOP
from coincid.model.golden.frame import Golden
from coincid.model.shared.sources import room_files
from coincid.slices.library import LANES
from coincid.slices.synthesis import Design
from coincid.tb import toolchain
from coincid.tb.frame_record import FrameJob, save_job
from coincid.tb.rtl import rtl, sensor_key
from coincid.tools.wheels import run_yosys

from . import random_cases
from .lanes import Lanes
from .session import session, watched

GOALS = {"rtl": 0.99, "golden": 0.95}  # shares of the mutants that are not known to be equivalent
FRAMES, DEFAULT_FRAMES, FRAMES_IN_LANES = 60, 12, 600
CASES_SEED = 2026
FIRST_SEED, LAST_SEEDS = 1, (2, 3, 4)  # of hosts: more of them notice more, and few mutants are played fast
SECONDS_MAX = 240  # for a mutant of the golden model: one that hangs is also noticed
RTL_MUTANTS, GOLDEN_MUTANTS = 2250, 120
PROOFS_TOGETHER = 6  # in one process of Yosys
GATE = "coincid_clock_gate"  # beginning of the names of the blocks that let every edge pass
PROOFS, PROOFS_IN_PART = 8, 2  # of a mutant, each without the registers that the one before misses
EQUAL_CYCLES = 3  # before the one in which a mutant is compared
BLOCK, BOXES = "block.il", "boxes.v"  # of a block, and the ports of all others
GOLDEN_SOURCES = {  # module -> file, for everything that the golden model uses for its computation
    f"coincid.model.{path.parent.name}.{path.stem}": path
    for path in room_files("model.golden", "model.contract")
    if path.suffix == ".py" and (path.parent.name == "golden" or path.stem in ("pixels", "windows"))
}
UNUSED = ("pixel_number", "subgroup_image")  # functions in these files that the golden model does not use
# Mutants of the golden model that no test can notice, by a part of the line, with the reason.
EQUIVALENT = {
    "t, pointer = latency.FRAME_START + 1, 0": "nothing is committed so early that it could be granted then",
    "bounds = np.zeros(subgroups + 1, np.int64)`: 1: one more": "a bound that nobody reads",
    "armed_from = _NEVER, _NEVER, 0`: 0: one more": "the first edge of the first pulse sets it",
    "np.zeros(shape.subgroups + 1, np.int64), np.empty(most, _RECORD)": "a bound that nobody reads, or room for more records",
    "most = len(key), 0": "room for more edges",
    "most = max(most, bounds[s + 1] - bounds[s])": "room for more edges",
    "state = np.zeros(1, _STATE)": "a row that nobody reads",
    "most = 3 * most": "room for more beats",
    "_encode(beats[done : done + 1], _FRAME_END, values, shape.frame_parts)`: 1: one more": "the next beat is written later",
    "self._counters = np.empty((0,": "a frame ends before anything reads it",
    "last = np.full(subgroups, -1": "any number below all keys will do",
    "if packer.begins < 0": "no group begins with the frame's first beat",
    "packer.begins >= 0: GtE": "no group begins with the frame's first beat",
    "packer.begins >= 0:`: 0: one more": "no group begins with the frame's first beat",
    "packer.begins >= 0 and not 0 <= packer.pulse - event.pulse <= groups.AGE_MAX:`: 0: one more": "no group begins with the frame's first beat",
    "beats = 2 + len(queues) * shape.counter_beats`: 2: one more": "room for more beats, which is cut off",
    "begins = state[0].formed = -1`: 1: one more": "any negative number says that no group is open",
    "(k - groups.FIRST_PIXELS + 1) % groups.PER_PART == 0:`: k - groups.FIRST_PIXELS": "the remainder of 2",
    "(k + 1) % groups.PER_PART == 0:`: k + 1: Add": "the remainder of 2",
    "beats += (queue.end_record": "room for more beats, which is cut off",
    "beats += (queue.end_event": "room for more beats, which is cut off",
}


@frozen
class Fate:
    """Fate of a mutant. by: the bench that noticed it, 'equal' if it is equivalent, '' if it survived."""

    where: str
    what: str
    by: str


class Stopwatch:
    """CPU time of this process and of all that it has waited for."""

    def __init__(self):
        self._last = self._now()

    @staticmethod
    def _now() -> float:
        return sum(os.times()[:4])

    def lap(self, name: str) -> None:
        """Print the CPU time since the last lap."""
        now = self._now()
        print(f"CPU time of {name}: {now - self._last:.0f} s", flush=True)
        self._last = now


def excuse(what: str) -> str:
    """Return why a mutant of the golden model is known to be equivalent, or ''."""
    return next((f"equal: {why}" for part, why in EQUIVALENT.items() if part in what), "")


def frames(sensor: dict = random_cases.SMALL, drawn: int = FRAMES) -> list[FrameJob]:
    """Return the regression's frames for a sensor, the same in every run. drawn: how many of them have random settings."""
    jobs: list[FrameJob] = []
    golden = Golden(parse_config({"sensor": sensor}).sensor)

    @seed(CASES_SEED)
    @random_cases.generated(drawn)
    @given(config=random_cases.configurations(sensor, frames_max=1), draw=st.integers(0, 2**32 - 1))
    def collect(config, draw):
        k = len(jobs)
        if k >= drawn:
            return
        config = config.with_frame(pulses=2 + k % 4, format=FORMAT_NAMES[k % len(FORMAT_NAMES)])
        edges = random_cases.trouble(config, draw, (4.0, 12.0, 25.0, 1.0)[k // 4 % 4])
        kind = random_cases.READY_KINDS[k % len(random_cases.READY_KINDS)]
        ready = random_cases.ready_pattern(draw, kind, config.pulses * config.period + 100)
        jobs.append(random_cases.predicted(golden, config, edges, ready))

    collect()
    gates = random_cases.gate_bits(sensor)
    always, late = None, np.arange(480) // 80 == 3
    for config, density, ready in (
        *(
            (config.with_frame(format=name), 300.0, always)
            for config, name in zip(gates, itertools.cycle(FORMAT_NAMES))
        ),
        *((config, 6.0, always) for config in random_cases.collections(sensor)),
        (random_cases.dithered(sensor), 6.0, always),
        *((random_cases.overfull(sensor).with_frame(format=name), 40.0, late) for name in FORMAT_NAMES),
        (random_cases.lengthy(sensor), 2.0, always),
        *((config, 25.0, always) for config in random_cases.scarce(sensor)),
    ):
        jobs.append(random_cases.predicted(golden, config, random_cases.trouble(config, 0, density), ready))
    return [*jobs, random_cases.predicted(golden, *random_cases.aged(sensor))]


def sample(total: int, items: list, rng: np.random.Generator) -> list:
    """Return `total` of the items in their order, or all of them if there are fewer."""
    chosen = rng.choice(len(items), min(total, len(items)), replace=False)
    return [items[k] for k in sorted(chosen)]


COMPARE = {ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt, ast.Eq: ast.NotEq, ast.NotEq: ast.Eq}
ARITHMETIC = {
    ast.Add: ast.Sub,
    ast.Sub: ast.Add,
    ast.Mult: ast.Add,
    ast.FloorDiv: ast.Mult,
    ast.Mod: ast.FloorDiv,
    ast.LShift: ast.RShift,
    ast.RShift: ast.LShift,
    ast.BitOr: ast.BitAnd,
    ast.BitAnd: ast.BitOr,
    ast.And: ast.Or,
    ast.Or: ast.And,
}


def mutations(node: ast.AST) -> Iterator[tuple[str, ast.AST]]:
    """Yield what can become of a part of a syntax tree: a description, and what takes its place."""
    match node:
        case ast.Compare(left, ops, others):
            for k, op in enumerate(ops):
                if type(op) in COMPARE:
                    new = [*ops[:k], COMPARE[type(op)](), *ops[k + 1 :]]
                    yield f"{ast.unparse(node)}: {type(op).__name__}", ast.Compare(left, new, others)
        case ast.BinOp() | ast.AugAssign() | ast.BoolOp() if type(node.op) in ARITHMETIC:
            new = copy.copy(node)
            new.op = ARITHMETIC[type(node.op)]()
            yield f"{ast.unparse(node)}: {type(node.op).__name__}", new
        case ast.UnaryOp(ast.Not(), operand):
            yield f"{ast.unparse(node)}: no not", operand
        case ast.Constant(bool(value)):
            yield f"{value}: not", ast.Constant(not value)
        case ast.Constant(int(value)):
            yield f"{value}: one more", ast.Constant(value + 1)
        case ast.Assign() if node.col_offset > 4:  # where a forgotten reset of a loop's variables would do harm
            yield f"{ast.unparse(node)}: left out", ast.Pass()
        case ast.Continue():
            yield "continue: left out", ast.Pass()


class Mutator(ast.NodeTransformer):
    """Applies the mutation with a given number, or counts them."""

    def __init__(self, source: str, apply: int = -1):
        self.lines, self.apply, self.count, self.done = source.splitlines(), apply, 0, ""

    def visit(self, node):
        self.generic_visit(node)
        for what, new in mutations(node):
            self.count += 1
            if self.count - 1 == self.apply:
                self.done = f"`{self.lines[node.lineno - 1].strip()}`: {what} (line {node.lineno})"
                return ast.copy_location(new, node)
        return node

    def generic_visit(self, node):
        """Visit what is computed when a function is called: neither its defaults and decorators, nor annotations."""
        if isinstance(node, ast.FunctionDef):
            node.body = [self.visit(statement) for statement in node.body]
        elif isinstance(node, ast.AnnAssign):
            node.value = node.value and self.visit(node.value)
        else:
            super().generic_visit(node)


def _mutated(path: Path, number: int = -1) -> tuple[ast.Module, Mutator]:
    """Return a file's syntax tree with one mutation, and the transformer."""
    source = path.read_text(encoding="utf-8")
    tree, mutator = ast.parse(source), Mutator(source, number)
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef) and node.name not in UNUSED:
            mutator.visit(node)
    return tree, mutator


def golden_mutants() -> list[tuple[str, int]]:
    """Return module and number of every mutant of the golden model."""
    return [(module, k) for module, path in GOLDEN_SOURCES.items() for k in range(_mutated(path)[1].count)]


def golden_mutant(module: str, number: int) -> tuple[str, str, str]:
    """Return module, source and description of a mutant of the golden model."""
    tree, mutator = _mutated(GOLDEN_SOURCES[module], number)
    name = GOLDEN_SOURCES[module].stem
    return module, ast.unparse(ast.fix_missing_locations(tree)), f"{name}: {mutator.done}"


def run_golden(module: str, source: Path, jobs: Path, only_frames: bool = False) -> bool:
    """Return whether frames and, if wanted, tests of the golden model pass with `source` in the place of a module."""
    command = [sys.executable, "-m", "tests.judge", module, str(source), str(jobs)]
    command += ["frames"] if only_frames else []
    environment = os.environ | {"NUMBA_DISABLE_JIT": "1", "PYTHONWARNINGS": "ignore"}
    try:
        done = subprocess.run(command, env=environment, timeout=SECONDS_MAX, capture_output=True, check=False)
    except subprocess.TimeoutExpired:
        return False
    return done.returncode == 0


def mutate_golden(mutants: list[tuple[str, int]], folder: Path, jobs: Path, tell) -> list[Fate]:
    """Return fates of mutants of the golden model. Raises if the unchanged model does not pass."""
    module, path = next(iter(GOLDEN_SOURCES.items()))
    if not run_golden(module, path, jobs):
        raise SystemExit("the golden model without mutation fails")

    def run(mutant: tuple[str, str, str], number: int) -> Fate:
        module, text, what = mutant
        source = folder / f"golden_{number}.py"
        source.write_text(text, encoding="utf-8")
        reason = excuse(what)
        passes = run_golden(module, source, jobs, only_frames=bool(reason))
        fate = Fate("golden", what, reason if passes else "tests")
        tell(fate)
        return fate

    with ThreadPoolExecutor(os.cpu_count() or 1) as pool:
        # The mutants are made here, because threads must not parse.
        return list(pool.map(run, [golden_mutant(*mutant) for mutant in mutants], range(len(mutants))))


@frozen
class Mutant:
    """A mutant of the RTL: the block, Yosys's command without its first word, and the folder with the block's RTLIL and boxes."""

    block: str
    what: str
    folder: Path


def rtl_mutants(total: int, folder: Path, seed_: int) -> list[Mutant]:
    """Return mutants of every block, in proportion to its size.

    None is of a clock, which has only one edge in slices, and none of a flip-flop's output, which does what one of its
    input does, a cycle later.
    """
    files = {
        path.stem: path.read_text(encoding="utf-8") for path in rtl(parse_config({"sensor": random_cases.SMALL}).sensor)
    }
    sizes = {name: len(zlib.compress(text.encode())) for name, text in files.items()}
    mutants = []
    for name, text in files.items():
        count = max(2, round(total * sizes[name] / sum(sizes.values())))
        work = folder / name
        work.mkdir(parents=True, exist_ok=True)
        (work / "block.v").write_text(text, encoding="utf-8")
        # Sub-blocks stay black boxes, because the file of a block contains only their instances.
        (work / BOXES).write_text(
            "".join(_boxes(other) for stem, other in files.items() if stem != name), encoding="utf-8"
        )
        read = f"read_verilog -lib {BOXES}; read_verilog block.v; prep -top {name}"
        listed = f"mutate -list {count} -seed {seed_} -o list.txt"
        run_yosys(work, f"{read}; {listed}; delete =A:blackbox; write_rtlil {BLOCK}")
        lines = [
            line for line in (work / "list.txt").read_text(encoding="utf-8").splitlines() if line.startswith("mutate")
        ]
        mutants += [
            Mutant(name, line.removeprefix("mutate "), work)
            for line in lines
            if not re.search(r"-port (\w*CLK|clk|gated|Q) ", line)
        ]
    return mutants


def _boxes(text: str) -> str:
    """Return the modules of a file with only their ports."""
    boxes = []
    for module in re.findall(r"^module .*?^endmodule", text, re.MULTILINE | re.DOTALL):
        head = module[: module.index(";") + 1]
        ports = re.findall(r"^  (?:input|output) .*?;", module, re.MULTILINE)
        boxes.append("\n".join([head, *ports, "endmodule", ""]))
    return "".join(boxes)


def judged_by_lanes(mutants: list[Mutant], jobs: list[FrameJob], whole: bool, seed_: int) -> list[str]:
    """Return for each mutant the part of `session` that notices it, or that it is equal, or ''. whole, seed_: as there.

    All mutants are in one netlist, each with an input that turns it on in its own lane. If nothing reads this input any
    more, Yosys has found that the mutant changes nothing. Raises if the RTL without mutation is wrong.
    """
    sensor = jobs[0].config.sensor
    sources = _blocks(mutants[0].folder.parent)
    inputs = [f"mutant_{k}" for k in range(len(mutants))]
    before = [f"add -global_input {name} 1" for name in inputs]
    before += [f"mutate -ctrl {name} 1 1 {mutant.what}" for name, mutant in zip(inputs, mutants, strict=True)]
    design = Design(f"{sensor_key(sensor)}-mutants", sources, TOP, before=[*before, "memory_map"])
    emission = design.emission()
    read = {net for of in (*emission.top.tables, *emission.top.flops) for net in of.inputs}
    width = next(lanes for lanes in LANES if lanes > len(mutants))
    with Lanes(sensor, design, width) as lanes:
        parts = session(sensor, emission, jobs, whole, seed_)
        for _, recipe in parts:
            lanes.recipe(**recipe)
        rows, differs = lanes.together([emission.layout.inputs[name][0] for name in inputs], watched(emission))
        assert len(rows) == len(parts), "the RTL without mutation hangs"
        for job, row in zip(jobs, rows, strict=True):
            shown = lanes.shown(row["shown"])
            assert row["outcome"] == 0
            for kind in ((shown.beats, job.expected.beats), (shown.cycles, job.expected.beat_cycle)):
                assert all(map(np.array_equal, *kind)), "the RTL without mutation differs from the golden model"
    gone = {name for name in inputs if emission.top.inputs[name][0] not in read}
    return [
        parts[k][0] if k >= 0 else "equal: removed by Yosys" * (name in gone)
        for name, k in zip(inputs, differs[1:], strict=True)
    ]


def _blocks(folder: Path, *names: str) -> dict[str, str]:
    """Return the RTLIL of all blocks, or of those with these names and of the clock gates, by file name."""
    paths = sorted(folder.glob(f"*/{BLOCK}"))
    kept = [path for path in paths if not names or path.parent.name in names or path.parent.name.startswith(GATE)]
    return {f"{path.parent.name}.il": path.read_text(encoding="utf-8") for path in kept}


def _inner(folder: Path, block: str) -> list[str]:
    """Return the names of the blocks that a block consists of."""
    return sorted(
        set(re.findall(r"^  cell \\(\w+) ", (folder / block / BLOCK).read_text(encoding="utf-8"), re.MULTILINE))
    )


def _within(folder: Path, block: str) -> list[str]:
    """Return the names of a block and of all blocks in it."""
    return [block, *(name for one in _inner(folder, block) for name in _within(folder, one))]


def proven(mutants: list[Mutant], blocks: list[str]) -> list[bool]:
    """Return which mutants of one block Yosys proves to be equal to it, as a part of the first of some blocks.

    All other blocks but clock gates are black boxes, whose ports count as outputs. Equal are all outputs and registers, if
    they have been for some cycles without an upset. Registers that differ are set aside, and the others are compared again,
    because what a mutant changes may stay inside.
    """
    aside: dict[int, set[str]] = {k: set() for k in range(len(mutants))}
    equal = set()
    for _ in range(PROOFS if len(blocks) == 1 else PROOFS_IN_PART):
        verdicts = _unequal([mutants[k] for k in aside], list(aside.values()), blocks) if aside else []
        equal |= {k for k, verdict in zip(aside, verdicts, strict=True) if verdict == set()}
        aside = {
            k: known | verdict
            for (k, known), verdict in zip(aside.items(), verdicts, strict=True)
            if verdict and verdict - known
        }
    return [k in equal for k in range(len(mutants))]


def _unequal(mutants: list[Mutant], aside: list[set[str]], blocks: list[str]) -> list[set[str] | None]:
    """Return for each mutant the registers that are not proven to be equal to the RTL's, or None if an output is not."""
    folder, top = mutants[0].folder, blocks[0]
    files = _blocks(folder.parent, *blocks)
    close = [
        f"hierarchy -top {top}; flatten; expose -evert c:*; memory_map; async2sync; opt_clean; dffunmap; opt_clean"
    ]
    close += ["select -set registers t:$dff %co1:+[Q] w:* %i", f"rename -hide w:* @registers %d; rename {top}"]
    script = [f"read_verilog -lib {BOXES}", *(f"read_rtlil -overwrite {name}" for name in files), "design -save block"]
    script += [*close[:-1], f"{close[-1]} gold; tee -o outputs.txt select -list o:*; design -save gold"]
    with TemporaryDirectory() as scratch:
        work = Path(scratch)
        for name, text in (files | {BOXES: (folder / BOXES).read_text(encoding="utf-8")}).items():
            (work / name).write_text(text, encoding="utf-8")
        for k, mutant in enumerate(mutants):
            (work / f"aside_{k}.txt").write_text("\n".join([*aside[k], ""]), encoding="utf-8")
            script += [
                f"design -load block; mutate {mutant.what}",
                *close[:-1],
                f"{close[-1]} gate; design -stash gate",
                "design -load gold; design -copy-from gate -as gate gate",
                f"equiv_make -blacklist aside_{k}.txt gold gate both; hierarchy -top both",
                "opt_merge -share_all; opt_clean",  # what the mutant does not change is compared no more
                f"equiv_simple -undef; equiv_induct -undef -seq {EQUAL_CYCLES}; tee -o proof_{k}.txt equiv_status",
            ]
        run_yosys(work, *script)
        outputs = {
            "\\" + line.rpartition("/")[2] for line in (work / "outputs.txt").read_text(encoding="utf-8").split()
        }
        proofs = [(work / f"proof_{k}.txt").read_text(encoding="utf-8") for k in range(len(mutants))]
    unequal = [set(re.findall(r"Unproven .*: (\S+)_gold", proof)) for proof in proofs]
    return [
        names if names.isdisjoint(outputs) and bool(names) != ("successfully proven" in proof) else None
        for names, proof in zip(unequal, proofs, strict=True)
    ]


def mutate_rtl(total: int, folder: Path, jobs: list[FrameJob], seed_: int, tell) -> list[Fate]:
    """Return fates of mutants of the RTL."""
    clock = Stopwatch()
    mutants = rtl_mutants(total, folder, seed_)
    clock.lap("mutants")
    by: dict[Mutant, str] = {}
    with ThreadPoolExecutor(os.cpu_count() or 1) as pool:

        def play(whole: bool, seeds: tuple[int, ...]) -> None:
            left = [mutant for mutant in mutants if mutant not in by]
            batches = [left[k : k + LANES[-1] - 1] for k in range(0, len(left), LANES[-1] - 1)]
            plays = [(batch, jobs, whole, session_seed) for batch in batches for session_seed in seeds]
            for (batch, *_), found in zip(plays, pool.map(lambda play: judged_by_lanes(*play), plays), strict=True):
                by.update((mutant, one) for mutant, one in zip(batch, found, strict=True) if one)

        play(False, (FIRST_SEED,))  # most show soon
        clock.lap("frames")
        play(True, (FIRST_SEED,))
        clock.lap("upsets")
        left = [mutant for mutant in mutants if mutant not in by]
        alone = {mutant.block: [mutant.block] for mutant in left}
        parts = [_within(folder, name) for name in _inner(folder, TOP)]
        simple = [TOP, *(name for name, *others in parts if not others and not name.startswith(GATE))]
        parts = [simple, *(part for part in parts if len(part) > 1)]
        for places in (alone, {name: part for part in parts for name in part}):
            proofs = [
                (of[k : k + PROOFS_TOGETHER], places[block])
                for block, group in itertools.groupby(left, lambda mutant: mutant.block)
                if block in places
                for of in [list(group)]
                for k in range(0, len(of), PROOFS_TOGETHER)
            ]
            for (of, _), found in zip(proofs, pool.map(lambda job: proven(*job), proofs), strict=True):
                by.update((mutant, "equal: proven by Yosys") for mutant, yes in zip(of, found, strict=True) if yes)
            left = [mutant for mutant in left if mutant not in by]
        clock.lap("proofs")
        play(True, LAST_SEEDS)
        clock.lap("more hosts")
    fates = [Fate(mutant.block, mutant.what, by.get(mutant, "")) for mutant in mutants]
    for fate in fates:
        tell(fate)
    return fates


def report(fates: list[Fate], seed_: int) -> tuple[str, dict[str, float]]:
    """Return the report as Markdown, and the kill rates of RTL and golden model."""
    lines = [f"# Mutants, seed {seed_}", "", "| where | mutants | killed | equivalent | survived |"]
    lines += ["| --- | --- | --- | --- | --- |"]
    rates = {}
    for kind in GOALS:
        of = [fate for fate in fates if (fate.where == "golden") == (kind == "golden")]
        for where in sorted({fate.where for fate in of}):
            mine = [fate for fate in of if fate.where == where]
            equal = sum(fate.by.startswith("equal") for fate in mine)
            killed = sum(bool(fate.by) for fate in mine) - equal
            lines.append(f"| {where} | {len(mine)} | {killed} | {equal} | {len(mine) - killed - equal} |")
        equal = sum(fate.by.startswith("equal") for fate in of)
        if len(of) > equal:
            rates[kind] = (sum(bool(fate.by) for fate in of) - equal) / (len(of) - equal)
            by = Counter(fate.by for fate in of if fate.by and not fate.by.startswith("equal"))
            lines += [
                "",
                f"{kind}: {rates[kind]:.1%} of {len(of) - equal} that are not known to be equivalent were killed:",
            ]
            lines += [f"{', '.join(f'{count} by {name}' for name, count in by.most_common())}.", ""]
    lines += ["## Survivors", "", *(f"* {fate.where}: {fate.what}" for fate in fates if not fate.by), ""]
    lines += ["## Equivalent", ""]
    lines += [f"* {fate.where}: {fate.what} ({fate.by})" for fate in fates if fate.by.startswith("equal")]
    return "\n".join([*lines, ""]), rates


def main() -> None:
    parser = argparse.ArgumentParser(description="Mutation test of RTL and golden model")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--rtl", type=int, default=RTL_MUTANTS, help="mutants of the RTL, about")
    parser.add_argument("--golden", type=int, default=GOLDEN_MUTANTS, help="mutants of the golden model, of some 800")
    given_ = parser.parse_args()
    folder = toolchain.build_root() / "mutation"
    subprocess.run(["rm", "-rf", str(folder)], check=True)
    folder.mkdir(parents=True)
    print(f"seed {given_.seed}: --seed repeats or changes the choice")
    clock = Stopwatch()
    fates: list[Fate] = []

    def tell(fate: Fate) -> None:
        print(f"{fate.where:26} {fate.by or 'SURVIVED':24} {fate.what[:150]}", flush=True)

    if given_.golden:
        # The second sensor has five subgroups and two streams, the third one maps of more bits than a half word.
        others = frames(random_cases.SENSORS["odd"]) + frames(random_cases.SENSORS["default"], DEFAULT_FRAMES)
        save_job(folder / "jobs", [*frames(), *others])
        rng = np.random.default_rng(given_.seed)
        fates += mutate_golden(sample(given_.golden, golden_mutants(), rng), folder, folder / "jobs", tell)
        clock.lap("golden model")
    if given_.rtl:
        fates += mutate_rtl(given_.rtl, folder / "rtl", frames(drawn=FRAMES_IN_LANES), given_.seed, tell)
        clock.lap("RTL")
    text, rates = report(fates, given_.seed)
    (folder / "report.md").write_text(text, encoding="utf-8")
    print(text)
    if low := [f"{kind} {rate:.1%}, not {GOALS[kind]:.0%}" for kind, rate in rates.items() if rate < GOALS[kind]]:
        sys.exit(f"kill rate: {'; '.join(low)}")


if __name__ == "__main__":
    main()
