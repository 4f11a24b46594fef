# SPDX-License-Identifier: Apache-2.0
"""Mutation test of the regression: bugs are put into RTL and golden model, one at a time, and the regression must notice.

`python -m tests.mutation [--seed N] [--rtl N] [--golden N]` writes build/mutation/report.md and fails below
`GOAL`.

* RTL: Yosys mutates cells of the emitted Verilog (`mutate`), block by block, in proportion to the size of the block. The
  regression consists of frames against the golden model in Icarus; then, for the survivors, of the cocotb tests of ports and
  faults. Survivors that Yosys proves to be equal to the block (`equiv_induct`) are equivalent; so are those of
  `EQUIVALENT`, each with its reason.
* Golden model: its syntax tree is mutated here. mutmut and cosmic-ray would start a test run for every mutant, and Numba
  would compile all functions again. Without Numba, and compared with recorded beats and fates of the same frames, a
  mutant takes a second; survivors go through the tests of the golden model.
* Planted bugs are typical human mistakes, by name: `planted.py`.
"""

import argparse
import ast
import json
import os
import re
import subprocess
import sys
import zlib
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
from attrs import frozen
from hypothesis import given, seed
from hypothesis import strategies as st

from coincid.model.contract.config import parse_config
from coincid.model.contract.packet import FORMAT_NAMES
from coincid.model.contract.parameters import TOP
from coincid.model.golden.frame import Golden
from coincid.model.shared.sources import digest, room_files
from coincid.tb import toolchain
from coincid.tb.frames import FrameJob, save_job
from coincid.tb.rtl import rtl
from coincid.tools.build import ToolchainError
from coincid.tools.wheels import run_yosys

from . import cases
from .benches import bench_environment

GOAL = 0.95
FRAMES = 60
CASES_SEED = 2026
SECONDS_MAX = 240  # for a mutant in one bench: a design that hangs is also noticed
RTL_MUTANTS, GOLDEN_MUTANTS = 120, 120  # number in the sampled mode
GOLDEN_SOURCES = {  # module -> file, for everything that the golden model uses for its computation
    f"coincid.model.{path.parent.name}.{path.stem}": path
    for path in room_files("model.golden", "model.contract")
    if path.suffix == ".py" and (path.parent.name == "golden" or path.stem in ("pixels", "windows"))
}
# Mutants that no test can notice, with the reason: those of a block by a part of Yosys's description, and those of the
# golden model by a part of the line. A block's are of the Verilog with this digest; another version has other names.
EQUIVALENT: dict[tuple[str, str], dict[str, str]] = {
    ("coincid_gating", "bed553bc9403"): {
        "$procmux$59 -port B": "reset value of the cycles until the gate opens, which a period's start loads before use"
    },
    ("coincid_module", "42d2fe762421"): {
        "$procdff$11 -port Q -portbit 0 -wire resets": (
            "reset of the TDC: a period's start sets it, and no window opens before"
        )
    },
    ("coincid_readout_2", "af2d0fa141b1"): {
        "$procmux$1026 -port Y": (
            "postpones the calm that repairs the space after an upset; a frame's beginning repairs it, too"
        ),
        "$procmux$1897 -port B -portbit 3 -ctrlbit 12": (
            "a code that is no state leads to another one, and that one on: an upset heals a cycle later"
        ),
        "$procmux$1973 -port S": (
            "room at a frame's beginning: there is always some after a frame's end, and the calm repairs it after an upset"
        ),
    },
    ("coincid_tree", "f8268e1ce8e6"): {
        "$procmux$407 -port B -portbit 0 -ctrlbit 1 ": (
            "which one of a pair is first, if none of the pair is: another pair is chosen then"
        )
    },
    ("golden", ""): {
        "t, pointer = latency.FRAME_START + 1, 0": "nothing is committed so early that it could be granted then",
        "bounds = np.zeros(subgroups + 1, np.int64)`: 1: one more": "a bound that nobody reads",
        "armed_from = _NEVER, _NEVER, 0`: 0: one more": "the first edge of the first pulse sets it",
        "beats += (queue.end_record": "room for more beats, which is cut off",
        "beats += (queue.end_event": "room for more beats, which is cut off",
    },
}


@frozen
class Fate:
    """Fate of a mutant. by: the bench that noticed it, 'equal' if it is equivalent, '' if it survived."""

    where: str
    what: str
    by: str


def excuse(where: str, what: str, version: str = "") -> str:
    """Return why a mutant is known to be equivalent, or ''. version: digest of the block's Verilog."""
    return next((f"equal: {why}" for part, why in EQUIVALENT.get((where, version), {}).items() if part in what), "")


def frames(sensor: dict = cases.SMALL) -> list[FrameJob]:
    """Return the regression's frames for a sensor, the same in every run."""
    jobs: list[FrameJob] = []
    golden = Golden(parse_config({"sensor": sensor}).sensor)

    @seed(CASES_SEED)
    @cases.generated(FRAMES)
    @given(config=cases.configurations(sensor, frames_max=1), draw=st.integers(0, 2**32 - 1))
    def collect(config, draw):
        k = len(jobs)
        if k >= FRAMES:
            return
        config = config.with_frame(pulses=2 + k % 4, format=FORMAT_NAMES[k % len(FORMAT_NAMES)])
        edges = cases.trouble(config, draw, (4.0, 12.0, 25.0, 1.0)[k % 4])
        kind = cases.READY_KINDS[k % len(cases.READY_KINDS)]
        ready = cases.ready_pattern(draw, kind, config.pulses * config.period + 100)
        jobs.append(FrameJob(config, edges, golden.frame(config, edges, ready), ready))

    collect()
    always, late = np.zeros(0, np.uint8), np.arange(480) // 80 == 3
    for config, density, ready in (
        *((config, 300.0, always) for config in cases.gate_bits(sensor)),
        *((config, 6.0, always) for config in cases.collections(sensor)),
        (cases.dithered(sensor), 6.0, always),
        (cases.overfull(sensor), 40.0, late),
        (cases.lengthy(sensor), 2.0, always),
        *((config, 25.0, always) for config in cases.scarce(sensor)),
    ):
        edges = cases.trouble(config, 0, density)
        jobs.append(FrameJob(config, edges, golden.frame(config, edges, ready), ready.astype(np.uint8)))
    return jobs


def sample(total: int, items: list, rng: np.random.Generator) -> list:
    """Return `total` of the items in their order, or all of them if there are fewer."""
    chosen = rng.choice(len(items), min(total, len(items)), replace=False)
    return [items[k] for k in sorted(chosen)]


class Mutator(ast.NodeTransformer):
    """Applies the mutation with a given number, or counts them."""

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
    }

    def __init__(self, source: str, apply: int = -1):
        self.lines, self.apply, self.count, self.done = source.splitlines(), apply, 0, ""

    def _turn(self, node, text: str) -> bool:
        self.count += 1
        if self.count - 1 == self.apply:
            self.done = f"`{self.lines[node.lineno - 1].strip()}`: {text} (line {node.lineno})"
            return True
        return False

    def visit_FunctionDef(self, node):
        node.args.defaults, node.decorator_list, kept = [], [], (node.args.defaults, node.decorator_list)
        self.generic_visit(node)
        node.args.defaults, node.decorator_list = kept
        return node

    def visit_Compare(self, node):
        self.generic_visit(node)
        for k, op in enumerate(node.ops):
            if type(op) in self.COMPARE and self._turn(node, f"{ast.unparse(node)}: {type(op).__name__}"):
                node.ops[k] = self.COMPARE[type(op)]()
        return node

    def _arithmetic(self, node):
        self.generic_visit(node)
        if type(node.op) in self.ARITHMETIC and self._turn(node, f"{ast.unparse(node)}: {type(node.op).__name__}"):
            node.op = self.ARITHMETIC[type(node.op)]()
        return node

    visit_BinOp = visit_AugAssign = _arithmetic

    def visit_BoolOp(self, node):
        self.generic_visit(node)
        if self._turn(node, f"{ast.unparse(node)}: {type(node.op).__name__}"):
            node.op = ast.Or() if isinstance(node.op, ast.And) else ast.And()
        return node

    def visit_UnaryOp(self, node):
        self.generic_visit(node)
        if isinstance(node.op, ast.Not) and self._turn(node, f"{ast.unparse(node)}: no not"):
            return node.operand
        return node

    def visit_AnnAssign(self, node):  # an annotation does nothing
        node.value = node.value and self.visit(node.value)
        return node

    def visit_Constant(self, node):
        if type(node.value) is int and self._turn(node, f"{node.value}: one more"):
            return ast.copy_location(ast.Constant(node.value + 1), node)
        if type(node.value) is bool and self._turn(node, f"{node.value}: not"):
            return ast.copy_location(ast.Constant(not node.value), node)
        return node

    def visit_Assign(self, node):
        self.generic_visit(node)
        # A reset of a loop's variables is where a forgotten assignment would do harm.
        if node.col_offset > 4 and self._turn(node, f"{ast.unparse(node)}: left out"):
            return ast.copy_location(ast.Pass(), node)
        return node

    def visit_Continue(self, node):
        return ast.copy_location(ast.Pass(), node) if self._turn(node, "continue: left out") else node


def _mutated(path: Path, number: int = -1) -> tuple[ast.Module, Mutator]:
    """Return a file's syntax tree with one mutation, and the transformer."""
    source = path.read_text()
    tree, mutator = ast.parse(source), Mutator(source, number)
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef):
            mutator.visit(node)
    return tree, mutator


def golden_mutant(number: int) -> tuple[str, str, str]:
    """Return module, source and description of a mutant of the golden model; all are empty if there are no more."""
    for module, path in GOLDEN_SOURCES.items():
        tree, mutator = _mutated(path, number)
        if mutator.done:
            return module, ast.unparse(ast.fix_missing_locations(tree)), f"{path.stem}: {mutator.done}"
        number -= mutator.count
    return "", "", ""


def golden_mutants() -> int:
    """Return the number of mutants of the golden model."""
    return sum(_mutated(path)[1].count for path in GOLDEN_SOURCES.values())


def run_golden(module: str, source: Path, jobs: Path) -> bool:
    """Return whether frames and tests of the golden model pass with `source` in the place of a module."""
    command = [sys.executable, "-m", "tests.judge", module, str(source), str(jobs)]
    environment = os.environ | {"NUMBA_DISABLE_JIT": "1", "PYTHONWARNINGS": "ignore"}
    try:
        done = subprocess.run(command, env=environment, timeout=SECONDS_MAX, capture_output=True, check=False)
    except subprocess.TimeoutExpired:
        return False
    return done.returncode == 0


def mutate_golden(numbers: list[int], folder: Path, jobs: Path, tell) -> list[Fate]:
    """Return fates of mutants of the golden model. Raises if the unchanged model does not pass."""
    module, path = next(iter(GOLDEN_SOURCES.items()))
    if not run_golden(module, path, jobs):
        raise SystemExit("the golden model without mutation fails")

    def run(mutant: tuple[str, str, str], number: int) -> Fate:
        module, text, what = mutant
        source = folder / f"golden_{number}.py"
        source.write_text(text)
        fate = Fate("golden", what, excuse("golden", what) if run_golden(module, source, jobs) else "tests")
        tell(fate)
        return fate

    with ThreadPoolExecutor(os.cpu_count() or 1) as pool:
        # The mutants are made here, because threads must not parse.
        return list(pool.map(run, [golden_mutant(number) for number in numbers], numbers))


def rtl_mutants(total: int, folder: Path, seed_: int) -> list[tuple[str, str, Path]]:
    """Return (block, Yosys's description, file) of mutants of every block, in proportion to its size."""
    files = {path.stem: path for path in rtl(parse_config({"sensor": cases.SMALL}).sensor) if path.stem != TOP}
    sizes = {name: len(zlib.compress(path.read_bytes())) for name, path in files.items()}
    mutants = []
    for name, path in files.items():
        count = max(2, round(total * sizes[name] / sum(sizes.values())))
        work = folder / name
        work.mkdir(parents=True, exist_ok=True)
        (work / "block.v").write_bytes(path.read_bytes())
        # Sub-blocks stay black boxes, because the file of a block contains only their instances.
        modules = [other.read_text() for stem, other in files.items() if stem != name]
        (work / "boxes.v").write_text("".join(_box(text, seen) for text in modules for seen in [set()]))
        used = "read_verilog -lib boxes.v; " if re.search(r"^  coincid_\w+ ", path.read_text(), re.MULTILINE) else ""
        load = f"{used}read_verilog block.v; prep -top {name}; "
        run_yosys(work, f"{load}mutate -list {count} -seed {seed_} -o list.txt; write_rtlil block.il")
        lines = [line for line in (work / "list.txt").read_text().splitlines() if line.startswith("mutate")]
        clean = "opt_clean; pmuxtree; delete =A:blackbox; write_verilog -noattr"
        script = [f"design -reset; read_rtlil block.il; {clean} whole.v"]
        script += [f"design -reset; read_rtlil block.il; {line}; {clean} mutant_{k}.v" for k, line in enumerate(lines)]
        run_yosys(work, *script)
        mutants += [(name, line.removeprefix("mutate "), work / f"mutant_{k}.v") for k, line in enumerate(lines)]
    return mutants


def _box(text: str, seen: set) -> str:
    """Return the modules of a file with only their ports."""
    boxes = []
    for module in re.findall(r"^module .*?^endmodule", text, re.MULTILINE | re.DOTALL):
        head = module[: module.index(";") + 1]
        ports = re.findall(r"^  (?:input|output) .*?;", module, re.MULTILINE)
        boxes.append("\n".join([head, *ports, "endmodule", ""]))
    return "".join(boxes)


def icarus(sources: list[Path], folder: Path) -> Path:
    """Compile Verilog with Icarus, uncached, because a mutant is used only once."""
    folder.mkdir(parents=True, exist_ok=True)
    command = ["iverilog", "-g2012", "-o", "sim.vvp", "-s", TOP, *map(str, sources)]
    (folder / "timescale.f").write_text(f"+timescale+{toolchain.TIMESCALE}\n")
    command[2:2] = ["-f", "timescale.f"]
    subprocess.run(command, cwd=folder, check=True, capture_output=True)
    return folder


SIMULATE = """\
import json, pathlib, sys
from coincid.model.shared.interrupts import interruptible
from coincid.tb.toolchain import Build
top, folder, module, env = json.loads(sys.argv[1])
interruptible()  # so that the simulator ends with this process
Build("icarus", top, pathlib.Path(folder), False).run(module, env=env, out_dir=folder, seed=1)
"""


def simulate(folder: Path, module: str, env: dict) -> bool:
    """Return whether the cocotb tests of `module` pass; a simulation that takes too long has failed."""
    command = [sys.executable, "-c", SIMULATE, json.dumps([TOP, str(folder), module, env])]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        return process.wait(SECONDS_MAX) == 0
    except subprocess.TimeoutExpired:
        return False
    finally:
        process.terminate()
        process.wait()


def run_rtl(sources: list[Path], folder: Path, jobs: list[FrameJob]) -> str:
    """Return the bench that notices a difference in the sensor of these files, or ''."""
    try:
        icarus(sources, folder)
    except subprocess.CalledProcessError:
        return "compiler"
    if not simulate(folder, "coincid.tb.cosim", save_job(folder / "job", jobs)):
        return "frames"
    env = bench_environment(cases.SMALL, sources)
    benches = {"ports": "sensor_bench", "faults": "fault_bench"}
    return next((by for by, bench in benches.items() if not simulate(folder, bench, env)), "")


def is_equal(mutant: Path) -> bool:
    """Return whether Yosys proves that a mutated block equals the block."""
    name, work = mutant.parent.name, mutant.parent
    boxes = "read_verilog -lib boxes.v; " if (work / "boxes.v").stat().st_size else ""
    script = (
        f"{boxes}read_verilog whole.v; rename {name} gold; read_verilog {mutant.name}; rename {name} gate; proc; "
        "equiv_make gold gate both; hierarchy -top both; flatten; memory_map; opt_clean; async2sync; opt -full; "
        "equiv_simple -undef; equiv_induct -undef; equiv_status -assert"
    )
    scratch = work / f"equal_{mutant.stem}"
    scratch.mkdir(exist_ok=True)
    for path in (work / "boxes.v", work / "whole.v", mutant):
        (scratch / path.name).write_bytes(path.read_bytes())
    try:
        run_yosys(scratch, script)
    except ToolchainError:
        return False
    return True


def mutate_rtl(total: int, folder: Path, jobs: list[FrameJob], seed_: int, tell) -> list[Fate]:
    """Return fates of mutants of the RTL. Raises if the unchanged blocks do not pass after the same treatment."""
    mutants = rtl_mutants(total, folder, seed_)
    original = rtl(parse_config({"sensor": cases.SMALL}).sensor)
    whole = [folder / path.stem / "whole.v" if path.stem != TOP else path for path in original]
    if by := run_rtl(whole, folder / "baseline", jobs):
        raise SystemExit(f"the RTL without mutation fails in {by}: see {folder / 'baseline'}")

    def run(k: int) -> Fate:
        block, what, path = mutants[k]
        sources = [path if source.stem == block else source for source in original]
        by = run_rtl(sources, folder / f"run_{k}", jobs)
        if not by:
            version = digest((path.parent / "block.v").read_text())
            by = excuse(block, what, version) or ("equal: proven by Yosys" if is_equal(path) else "")
        fate = Fate(block, what, by)
        tell(fate)
        return fate

    with ThreadPoolExecutor(os.cpu_count() or 1) as pool:
        return list(pool.map(run, range(len(mutants))))


def report(fates: list[Fate], seed_: int) -> tuple[str, float]:
    """Return the report as Markdown, and the lower kill rate of RTL and golden model."""
    lines = [f"# Mutants, seed {seed_}", "", "| where | mutants | killed | equivalent | survived |"]
    lines += ["| --- | --- | --- | --- | --- |"]
    rates = []
    for kind in ("rtl", "golden"):
        of = [fate for fate in fates if (fate.where == "golden") == (kind == "golden")]
        for where in sorted({fate.where for fate in of}):
            mine = [fate for fate in of if fate.where == where]
            equal = sum(fate.by.startswith("equal") for fate in mine)
            killed = sum(bool(fate.by) for fate in mine) - equal
            lines.append(f"| {where} | {len(mine)} | {killed} | {equal} | {len(mine) - killed - equal} |")
        equal = sum(fate.by.startswith("equal") for fate in of)
        if len(of) > equal:
            rates.append((sum(bool(fate.by) for fate in of) - equal) / (len(of) - equal))
            lines += ["", f"{kind}: {rates[-1]:.1%} of {len(of) - equal} that are not equivalent were killed.", ""]
    lines += ["## Survivors", "", *(f"* {fate.where}: {fate.what}" for fate in fates if not fate.by), ""]
    lines += ["## Equivalent", ""]
    lines += [f"* {fate.where}: {fate.what} ({fate.by})" for fate in fates if fate.by.startswith("equal")]
    return "\n".join([*lines, ""]), min(rates, default=1.0)


def main() -> None:
    parser = argparse.ArgumentParser(description="Mutation test of RTL and golden model")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--rtl", type=int, default=RTL_MUTANTS, help="mutants of the RTL, about")
    parser.add_argument("--golden", type=int, default=GOLDEN_MUTANTS, help="mutants of the golden model, of some 500")
    given_ = parser.parse_args()
    folder = toolchain.build_root() / "mutation"
    subprocess.run(["rm", "-rf", str(folder)], check=True)
    folder.mkdir(parents=True)
    print(f"seed {given_.seed}: --seed repeats or changes the choice")
    jobs = frames()
    # The second sensor has five subgroups and two streams.
    save_job(folder / "jobs", [*jobs, *frames(cases.SENSORS["odd"])])
    rng = np.random.default_rng(given_.seed)

    def tell(fate: Fate) -> None:
        print(f"{fate.where:26} {fate.by or 'SURVIVED':24} {fate.what[:150]}", flush=True)

    numbers = sample(given_.golden, list(range(golden_mutants())), rng)
    fates = mutate_golden(numbers, folder, folder / "jobs", tell)
    if given_.rtl:
        fates += mutate_rtl(given_.rtl, folder / "rtl", jobs, given_.seed, tell)
    text, rate = report(fates, given_.seed)
    (folder / "report.md").write_text(text)
    print(text)
    if rate < GOAL:
        sys.exit(f"kill rate {rate:.1%}: must be at least {GOAL:.0%}")


if __name__ == "__main__":
    main()
