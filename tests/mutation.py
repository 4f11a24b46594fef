# SPDX-License-Identifier: Apache-2.0
"""Mutation test of the regression: bugs are put into RTL and golden model, one at a time, and the
regression must notice.

`python -m tests.mutation [--seed N] [--rtl N] [--golden N]` writes build/mutation/report.md and
fails below `GOALS`, or if an excuse of a mutant has no surviving mutant.

* RTL: `rtl_mutants.py`, played in slices by the host of `session.py`.
* Golden model: `golden_mutants.py`, judged by `judge.py`. The excuses of mutants that no test can
  notice stand in the source.
* Planted bugs are typical human mistakes, by name: `planted.py`.
"""

import argparse
import itertools
import shutil
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from hypothesis import given, seed
from hypothesis import strategies as st

from coincid.model.contract.config import Config, parse_config
from coincid.model.contract.packet import EVENT_FORMATS
from coincid.model.golden.frame import Golden
from coincid.tb import toolchain
from coincid.tb.frame_record import FrameJob, save_job

from . import random_cases
from .fates import Fate, report
from .golden_mutants import golden_mutants, judge_golden, unneeded_excuses
from .rtl_mutants import judge_rtl
from .stopwatch import Stopwatch

GOALS = {"rtl": 0.99, "golden": 0.95}  # shares of the mutants that are not known to be equivalent
RTL_MUTANTS = 2250
GOLDEN_MUTANTS = 120
FRAMES = 60  # with random settings, of each sensor
DEFAULT_FRAMES = 12  # the same, of the default sensor, whose frames take longer
FRAMES_IN_LANES = 600
CASES_SEED = 2026
EVENTS = tuple(EVENT_FORMATS)
DENSITIES = (4.0, 12.0, 25.0, 1.0)  # of edges, by turns
LATE = np.arange(480) // 80 == 3  # a receiver that takes nothing for long


def frames(sensor: dict = random_cases.SMALL, drawn: int = FRAMES) -> list[FrameJob]:
    """Return the regression's frames for a sensor, the same in every run.

    drawn: how many of them have random settings.
    """
    golden = Golden(parse_config({"sensor": sensor}).sensor)
    jobs = _drawn_frames(golden, sensor, drawn)
    for config, density, ready in _chosen_frames(sensor):
        light = random_cases.returns if config.counting else random_cases.trouble
        edges = light(config, 0, density)
        jobs.append(random_cases.predicted(golden, config, edges, ready))
    jobs.append(random_cases.predicted(golden, *random_cases.aged(sensor)))
    return jobs


def _drawn_frames(golden: Golden, sensor: dict, drawn: int) -> list[FrameJob]:
    """Return frames with random settings; formats, densities and back-pressure take turns."""
    jobs: list[FrameJob] = []

    @seed(CASES_SEED)
    @random_cases.generated(drawn)
    @given(config=random_cases.configurations(sensor, frames_max=1), draw=st.integers(0, 2**32 - 1))
    def collect(config, draw):
        k = len(jobs)
        if k >= drawn:
            return
        form = EVENTS[k % len(EVENTS)]
        config = config.with_frame(pulses=2 + k % 4, format=form)
        edges = random_cases.trouble(config, draw, DENSITIES[k // 4 % len(DENSITIES)])
        kind = random_cases.READY_KINDS[k % len(random_cases.READY_KINDS)]
        cycles = config.pulses * config.period + 100
        ready = random_cases.ready_pattern(draw, kind, cycles)
        jobs.append(random_cases.predicted(golden, config, edges, ready))

    collect()
    return jobs


def _chosen_frames(sensor: dict) -> Iterator[tuple[Config, float, np.ndarray | None]]:
    """Yield settings for rare situations, with density and back-pressure (None: always ready)."""
    for config, form in zip(random_cases.gate_bits(sensor), itertools.cycle(EVENTS)):
        yield config.with_frame(format=form), 300.0, None
    for config in random_cases.collections(sensor):
        yield config, 6.0, None
    yield random_cases.dithered(sensor), 6.0, None
    for form in EVENTS:
        yield random_cases.overfull(sensor).with_frame(format=form), 40.0, LATE
    yield random_cases.lengthy(sensor), 2.0, None
    for config in random_cases.counting(sensor):
        yield config, 60.0, None
    for config in random_cases.scarce(sensor):
        yield config, 25.0, None


def sample(total: int, items: list, rng: np.random.Generator) -> list:
    """Return `total` of the items in their order, or all of them if there are fewer."""
    chosen = rng.choice(len(items), min(total, len(items)), replace=False)
    return [items[k] for k in sorted(chosen)]


def _tell(fate: Fate) -> None:
    print(f"{fate.where:26} {fate.by or 'SURVIVED':24} {fate.what[:150]}", flush=True)


def try_golden(total: int, seed_: int, folder: Path) -> tuple[list[Fate], list[str]]:
    """Return the fates of `total` mutants of the golden model, and complaints about excuses."""
    # The second sensor has five subgroups and two streams, the third one maps of more bits than a
    # half word, and counts.
    jobs = [
        *frames(),
        *frames(random_cases.SENSORS["odd"]),
        *frames(random_cases.GOLDEN_SENSORS["default"], DEFAULT_FRAMES),
    ]
    save_job(folder / "jobs", jobs)
    mutants = sample(total, golden_mutants(), np.random.default_rng(seed_))
    fates = judge_golden(mutants, folder, folder / "jobs", _tell)
    complaints = []
    for excuse in unneeded_excuses(mutants, fates):
        where = f"{excuse.module}, line {excuse.line}"
        complaints.append(f"excuse without a surviving mutant: {where}: {excuse.reason}")
    return fates, complaints


def main() -> None:
    parser = argparse.ArgumentParser(description="Mutation test of RTL and golden model")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--rtl", type=int, default=RTL_MUTANTS, help="mutants of the RTL, about")
    parser.add_argument(
        "--golden",
        type=int,
        default=GOLDEN_MUTANTS,
        help="mutants of the golden model, of some 800",
    )
    options = parser.parse_args()
    folder = toolchain.build_root() / "mutation"
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    print(f"seed {options.seed}: --seed repeats or changes the choice")
    clock = Stopwatch()
    fates: list[Fate] = []
    complaints: list[str] = []
    if options.golden:
        fates, complaints = try_golden(options.golden, options.seed, folder)
        clock.lap("golden model")
    if options.rtl:
        jobs = frames(drawn=FRAMES_IN_LANES)
        fates += judge_rtl(options.rtl, folder / "rtl", jobs, options.seed, _tell)
        clock.lap("RTL")
    text, rates = report(fates, options.seed)
    (folder / "report.md").write_text(text, encoding="utf-8")
    print(text)
    for kind, rate in rates.items():
        if rate < GOALS[kind]:
            complaints.append(f"kill rate: {kind} {rate:.1%}, not {GOALS[kind]:.0%}")
    if complaints:
        sys.exit("\n".join(complaints))


if __name__ == "__main__":
    main()
