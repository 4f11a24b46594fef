# SPDX-License-Identifier: Apache-2.0
"""Mutants of the RTL: how they are made, played in slices, and proven to be equivalent.

Yosys mutates cells of the emitted Verilog (`mutate`), block by block, in proportion to the size of
the block. Some 500 mutants are in one netlist, each with an input that turns it on, and are played
in slices: lane 0 is the RTL as it is, and every other lane has one mutant. A mutant is killed if
its lane shows something else than lane 0 at the ports, while one host plays all lanes
(`session.py`): frames, in which lane 0 must show what the golden model says, then accesses and
resets. A longer session, with upsets and wide numbers, too, plays what is left. A mutant that Yosys
removes, or proves to be equal to the block (`equiv_induct`), is equivalent. Three more hosts play
the rest.
"""

import itertools
import os
import re
import zlib
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from attrs import frozen

from coincid.model.contract.config import parse_config
from coincid.model.contract.parameters import TOP
from coincid.slices.library import LANES
from coincid.slices.synthesis import Design
from coincid.tb.frame_record import FrameJob
from coincid.tb.rtl import rtl, sensor_key
from coincid.tools.wheels import run_yosys

from . import random_cases
from .fates import EQUAL, Fate
from .lanes import Lanes, Shown
from .session import session, watched
from .stopwatch import Stopwatch

FIRST_SEED = 1  # of the host that plays all mutants
LAST_SEEDS = (2, 3, 4)  # more hosts notice more, and few mutants are played fast
LANES_MAX = LANES[-1] - 1  # mutants that are played together, beside lane 0
GATE = "coincid_clock_gate"  # beginning of the names of the blocks that let every edge pass
BLOCK = "block.il"  # a block
BOXES = "boxes.v"  # the ports of all other blocks
UNMUTATED = re.compile(r"-port (\w*CLK|clk|gated|Q) ")  # see `rtl_mutants`

PROOFS_TOGETHER = 6  # in one process of Yosys
PROOFS_ALONE = 8  # of a mutant; each is without the registers that the one before misses
PROOFS_IN_PART = 2  # the same, of a mutant in a part of the sensor
EQUAL_CYCLES = 3  # before the one in which a mutant is compared


@frozen
class Mutant:
    """A mutant of the RTL.

    block: where it is; what: Yosys's command without its first word; folder: has the block's RTLIL
    and the boxes.
    """

    block: str
    what: str
    folder: Path


def rtl_mutants(total: int, folder: Path, seed: int) -> list[Mutant]:
    """Return about `total` mutants, of every block in proportion to its size.

    None is of a clock, which has only one edge in slices, and none of a flip-flop's output, which
    does what one of its input does, a cycle later.
    """
    sensor = parse_config({"sensor": random_cases.SMALL}).sensor
    texts = {path.stem: path.read_text(encoding="utf-8") for path in rtl(sensor)}
    sizes = {name: len(zlib.compress(text.encode())) for name, text in texts.items()}
    mutants = []
    for name in texts:
        count = max(2, round(total * sizes[name] / sum(sizes.values())))
        mutants += _mutants_of_block(name, texts, count, folder / name, seed)
    return mutants


def _mutants_of_block(
    name: str, texts: dict[str, str], count: int, work: Path, seed: int
) -> list[Mutant]:
    """Return mutants of a block; leave its RTLIL and the boxes of all others in `work`."""
    work.mkdir(parents=True, exist_ok=True)
    (work / "block.v").write_text(texts[name], encoding="utf-8")
    # Sub-blocks stay black boxes, because the file of a block contains only their instances.
    boxes = [_boxes(text) for other, text in texts.items() if other != name]
    (work / BOXES).write_text("".join(boxes), encoding="utf-8")
    read = f"read_verilog -lib {BOXES}; read_verilog block.v; prep -top {name}"
    listed = f"mutate -list {count} -seed {seed} -o list.txt"
    run_yosys(work, f"{read}; {listed}; delete =A:blackbox; write_rtlil {BLOCK}")
    mutants = []
    for line in (work / "list.txt").read_text(encoding="utf-8").splitlines():
        if line.startswith("mutate") and not UNMUTATED.search(line):
            mutants.append(Mutant(name, line.removeprefix("mutate "), work))
    return mutants


def _boxes(text: str) -> str:
    """Return the modules of a file with only their ports."""
    boxes = []
    for module in re.findall(r"^module .*?^endmodule", text, re.MULTILINE | re.DOTALL):
        head = module[: module.index(";") + 1]
        ports = re.findall(r"^  (?:input|output) .*?;", module, re.MULTILINE)
        boxes.append("\n".join([head, *ports, "endmodule", ""]))
    return "".join(boxes)


def judged_by_lanes(
    mutants: list[Mutant], jobs: list[FrameJob], whole: bool, seed: int
) -> list[str]:
    """Return for each mutant the part of `session` that notices it, or that it is equal, or ''.

    whole, seed: of the session. All mutants are in one netlist, each with an input that turns it on
    in its own lane. If nothing reads this input any more, Yosys has found that the mutant changes
    nothing. Raises `AssertionError` if the RTL without mutation is wrong.
    """
    sensor = jobs[0].config.sensor
    inputs = [f"mutant_{k}" for k in range(len(mutants))]
    design = _design_with(mutants, inputs, sensor_key(sensor))
    emission = design.emission()
    width = next(lanes for lanes in LANES if lanes > len(mutants))
    faults = [emission.layout.inputs[name][0] for name in inputs]
    with Lanes(sensor, design, width) as lanes:
        parts = session(sensor, emission, jobs, whole, seed)
        for _, recipe in parts:
            lanes.recipe(**recipe)
        rows, differs = lanes.together(faults, watched(emission))
        assert len(rows) == len(parts), "the RTL without mutation hangs"
        for job, row in zip(jobs, rows[: len(jobs)], strict=True):  # the first parts
            assert row["outcome"] == 0
            assert_as_predicted(lanes.shown(row["shown"]), job)

    read = {net for of in (*emission.top.tables, *emission.top.flops) for net in of.inputs}
    noticed_by = []
    for name, part in zip(inputs, differs[1 : 1 + len(inputs)], strict=True):
        if part >= 0:
            noticed_by.append(parts[part][0])
        elif emission.top.inputs[name][0] not in read:
            noticed_by.append(f"{EQUAL}: removed by Yosys")
        else:
            noticed_by.append("")
    return noticed_by


def assert_as_predicted(shown: Shown, job: FrameJob) -> None:
    """Assert that a frame's beats and their cycles are those of the golden model."""
    wrong = "the RTL without mutation differs from the golden model"
    for beats, expected in zip(shown.beats, job.expected.beats, strict=True):
        assert np.array_equal(beats, expected), wrong
    for cycles, expected in zip(shown.cycles, job.expected.beat_cycle, strict=True):
        assert np.array_equal(cycles, expected), wrong


def _design_with(mutants: list[Mutant], inputs: list[str], key: str) -> Design:
    """Return the sensor with some mutants, each turned on by an input."""
    before = [f"add -global_input {name} 1" for name in inputs]
    for name, mutant in zip(inputs, mutants, strict=True):
        before.append(f"mutate -ctrl {name} 1 1 {mutant.what}")
    sources = _blocks(mutants[0].folder.parent)
    return Design(f"{key}-mutants", sources, TOP, before=[*before, "memory_map"])


def _blocks(folder: Path, *names: str) -> dict[str, str]:
    """Return the RTLIL by file name, of all blocks or of those with these names and clock gates."""
    found = {}
    for path in sorted(folder.glob(f"*/{BLOCK}")):
        block = path.parent.name
        if not names or block in names or block.startswith(GATE):
            found[f"{block}.il"] = path.read_text(encoding="utf-8")
    return found


def _inner(folder: Path, block: str) -> list[str]:
    """Return the names of the blocks that a block consists of."""
    text = (folder / block / BLOCK).read_text(encoding="utf-8")
    return sorted(set(re.findall(r"^  cell \\(\w+) ", text, re.MULTILINE)))


def _within(folder: Path, block: str) -> list[str]:
    """Return the names of a block and of all blocks in it."""
    names = [block]
    for inner in _inner(folder, block):
        names += _within(folder, inner)
    return names


def proven(mutants: list[Mutant], blocks: list[str]) -> list[bool]:
    """Return which mutants of one block Yosys proves to be equal to it.

    The block is a part of the first of `blocks`. All other blocks but clock gates are black boxes,
    whose ports count as outputs. Equal are all outputs and registers, if they have been for some
    cycles without an upset. Registers that differ are set aside, and the others are compared again,
    because what a mutant changes may stay inside.
    """
    aside: dict[int, set[str]] = {k: set() for k in range(len(mutants))}
    equal = set()
    for _ in range(PROOFS_ALONE if len(blocks) == 1 else PROOFS_IN_PART):
        if not aside:
            break
        verdicts = _unequal([mutants[k] for k in aside], list(aside.values()), blocks)
        again = {}
        for (k, known), verdict in zip(aside.items(), verdicts, strict=True):
            if verdict == set():
                equal.add(k)
            elif verdict and verdict - known:
                again[k] = known | verdict
        aside = again
    return [k in equal for k in range(len(mutants))]


def _unequal(
    mutants: list[Mutant], aside: list[set[str]], blocks: list[str]
) -> list[set[str] | None]:
    """Return for each mutant the registers that are not proven to be equal to the RTL's.

    It is None if an output is not. aside: registers that are not compared.
    """
    folder = mutants[0].folder
    files = _blocks(folder.parent, *blocks)
    files[BOXES] = (folder / BOXES).read_text(encoding="utf-8")
    with TemporaryDirectory() as scratch:
        work = Path(scratch)
        for name, text in files.items():
            (work / name).write_text(text, encoding="utf-8")
        for k, registers in enumerate(aside):
            text = "\n".join([*registers, ""])
            (work / f"aside_{k}.txt").write_text(text, encoding="utf-8")
        run_yosys(work, *_comparison(mutants, blocks[0], [name for name in files if name != BOXES]))
        listed = (work / "outputs.txt").read_text(encoding="utf-8")
        proofs = [
            (work / f"proof_{k}.txt").read_text(encoding="utf-8") for k in range(len(mutants))
        ]
    outputs = {"\\" + line.rpartition("/")[2] for line in listed.split()}
    verdicts: list[set[str] | None] = []
    for proof in proofs:
        names = set(re.findall(r"Unproven .*: (\S+)_gold", proof))
        is_whole = bool(names) != ("successfully proven" in proof)
        verdicts.append(names if names.isdisjoint(outputs) and is_whole else None)
    return verdicts


def _comparison(mutants: list[Mutant], top: str, files: list[str]) -> list[str]:
    """Return the commands that compare mutants with the RTL, and write `proof_K.txt` for each."""
    close = [
        f"hierarchy -top {top}; flatten; expose -evert c:*; memory_map; async2sync; opt_clean; dffunmap; opt_clean",
        "select -set registers t:$dff %co1:+[Q] w:* %i",
    ]
    name_as = f"rename -hide w:* @registers %d; rename {top}"
    script = [f"read_verilog -lib {BOXES}"]
    script += [f"read_rtlil -overwrite {name}" for name in files]
    script += ["design -save block", *close]
    script += [f"{name_as} gold; tee -o outputs.txt select -list o:*; design -save gold"]
    for k, mutant in enumerate(mutants):
        induction = f"equiv_simple -undef; equiv_induct -undef -seq {EQUAL_CYCLES}"
        script += [
            f"design -load block; mutate {mutant.what}",
            *close,
            f"{name_as} gate; design -stash gate",
            "design -load gold; design -copy-from gate -as gate gate",
            f"equiv_make -blacklist aside_{k}.txt gold gate both; hierarchy -top both",
            # What the mutant does not change is compared no more.
            "opt_merge -share_all; opt_clean",
            f"{induction}; tee -o proof_{k}.txt equiv_status",
        ]
    return script


class Campaign:
    """Mutants of the RTL, and by what each has been judged so far."""

    def __init__(self, mutants: list[Mutant], folder: Path, jobs: list[FrameJob]):
        self.mutants = mutants
        self.folder = folder
        self.jobs = jobs
        self.by: dict[Mutant, str] = {}

    def left(self) -> list[Mutant]:
        """Return the mutants that nothing has noticed, and that are not known to be equivalent."""
        return [mutant for mutant in self.mutants if mutant not in self.by]

    def play(self, pool: ThreadPoolExecutor, whole: bool, seeds: Sequence[int]) -> None:
        """Let hosts play what is left; whole: with upsets and wide numbers."""
        left = self.left()
        plays = []
        for begin in range(0, len(left), LANES_MAX):
            for seed in seeds:
                plays.append((left[begin : begin + LANES_MAX], seed))

        def judge(play: tuple[list[Mutant], int]) -> list[str]:
            batch, seed = play
            return judged_by_lanes(batch, self.jobs, whole, seed)

        for (batch, _), verdicts in zip(plays, pool.map(judge, plays), strict=True):
            for mutant, by in zip(batch, verdicts, strict=True):
                if by:
                    self.by[mutant] = by

    def prove(self, pool: ThreadPoolExecutor, places: dict[str, list[str]]) -> None:
        """Prove which of the mutants that are left are equal.

        places: block -> the blocks of the part in which it is proven.
        """
        proofs = []
        for block, group in itertools.groupby(self.left(), lambda mutant: mutant.block):
            if block in places:
                of_block = list(group)
                for begin in range(0, len(of_block), PROOFS_TOGETHER):
                    proofs.append((of_block[begin : begin + PROOFS_TOGETHER], places[block]))
        verdicts = pool.map(lambda proof: proven(*proof), proofs)
        for (batch, _), equal in zip(proofs, verdicts, strict=True):
            for mutant, is_equal in zip(batch, equal, strict=True):
                if is_equal:
                    self.by[mutant] = f"{EQUAL}: proven by Yosys"

    def alone(self) -> dict[str, list[str]]:
        """Return places for `prove`: each block is proven alone."""
        return {mutant.block: [mutant.block] for mutant in self.left()}

    def in_parts(self) -> dict[str, list[str]]:
        """Return places for `prove`: in the parts of the top, simple ones with the top itself."""
        parts = [_within(self.folder, name) for name in _inner(self.folder, TOP)]
        simple = [part[0] for part in parts if len(part) == 1 and not part[0].startswith(GATE)]
        places = {}
        for part in ([TOP, *simple], *(part for part in parts if len(part) > 1)):
            for name in part:
                places[name] = part
        return places


def judge_rtl(
    total: int, folder: Path, jobs: list[FrameJob], seed: int, tell: Callable[[Fate], None]
) -> list[Fate]:
    """Return the fates of about `total` mutants of the RTL; `tell` gets each."""
    clock = Stopwatch()
    mutants = rtl_mutants(total, folder, seed)
    clock.lap("mutants")
    campaign = Campaign(mutants, folder, jobs)
    with ThreadPoolExecutor(os.cpu_count() or 1) as pool:
        campaign.play(pool, False, (FIRST_SEED,))  # most show soon
        clock.lap("frames")
        campaign.play(pool, True, (FIRST_SEED,))
        clock.lap("upsets")
        campaign.prove(pool, campaign.alone())
        campaign.prove(pool, campaign.in_parts())
        clock.lap("proofs")
        campaign.play(pool, True, LAST_SEEDS)
        clock.lap("more hosts")
    fates = [Fate(mutant.block, mutant.what, campaign.by.get(mutant, "")) for mutant in mutants]
    for fate in fates:
        tell(fate)
    return fates
