# SPDX-License-Identifier: Apache-2.0
"""Typical human mistakes, planted one at a time: each must be caught by the regression or by a proof.

`python -m tests.planted [--all] [NAMES]` plants each bug in a copy of the sources and runs the proofs and tests that must
notice it, all of them part of `make test` or `make formal`, until one does; with `--all`, every one must.
`test_planted.py` keeps the list in step with the sources.
"""

import os
import shutil
import subprocess
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from attrs import frozen

from coincid.tb.toolchain import build_root

ROOT = Path(__file__).parents[1]
PACKAGES = ("model", "host", "hdl", "tb", "formal", "flow", "lab", "study")
GOLDEN = ("tests/golden/test_golden.py",)  # golden model against the plain one
FRAMES = ("tests/tb/test_cosim.py", "-k", "tiny-icarus or coarse-icarus")  # RTL against the golden model
PORTS = ("tests/hdl/test_ports.py", "-k", "icarus")
ORIENTATION = ("tests/scenes/test_orientation.py",)
INDEPENDENCE = ("tests/light/test_independence.py",)
ALIGNMENTS = ("tests/tb/test_cosim.py", "-k", "every_alignment")


@frozen
class Bug:
    """A planted bug: in `file`, `old` (which occurs once) becomes `new`. proofs, tests: each must notice it alone."""

    name: str
    file: str
    old: str
    new: str
    proofs: tuple[str, ...] = ()
    tests: tuple[tuple[str, ...], ...] = ()


BUGS = (
    Bug(
        "window-long",
        "hdl/tree.py",
        "self.line.phase + self.window_ticks)",
        "self.line.phase + self.window_ticks + 1)",
        ("tree",),
        (FRAMES,),
    ),
    Bug(
        "window-edge",
        "hdl/tree.py",
        "closing.eq(live & (end <= phases))",
        "closing.eq(live & (end < phases))",
        ("tree",),
        (FRAMES,),
    ),
    Bug(
        "tie-highest",
        "hdl/tree.py",
        'first_index(m, one_of, "winner")',
        '~first_index(m, one_of[::-1], "winner")',
        ("tree",),
        (FRAMES,),
    ),
    Bug("tree-not-reset", "hdl/tree.py", "window_open = Signal()", "window_open = Signal(reset_less=True)", ("tree",)),
    Bug(
        "rearm-late",
        "hdl/tree.py",
        "rearm.eq(self.sensor.rearm)",
        "rearm.eq(self.sensor.rearm + 1)",
        ("tree",),
        (FRAMES,),
    ),
    Bug(
        "hits-toggle",
        "hdl/minigroup.py",
        "hits.eq(state.hit_4 | (hits & ~self",
        "hits.eq(state.hit_4 ^ (hits & ~self",
        ("tree",),
        (FRAMES,),
    ),
    Bug(
        "mask-ignored",
        "hdl/minigroup.py",
        "root.eq(word & on.replicate(phases))",
        "root.eq(word)",
        ("minigroup_record",),
        (FRAMES,),
    ),
    Bug(
        "mg-threshold",
        "hdl/minigroup.py",
        ">= self.frame.mg_threshold",
        "> self.frame.mg_threshold",
        ("minigroup_record",),
        (FRAMES,),
    ),
    Bug(
        "tdc-lines-swapped",
        "hdl/tdc.py",
        'first_one(m, line.root, f"first_{k}")',
        'first_one(m, getattr(self, f"line_{self.lines - 1 - k}").root, f"first_{k}")',
        ("tdc",),
        (FRAMES,),
    ),
    Bug(
        "tdc-line-shared",
        "hdl/tdc.py",
        'first_one(m, line.root, f"first_{k}")',
        'first_one(m, self.line_0.root, f"first_{k}")',
        ("tdc",),
        (FRAMES,),
    ),
    Bug("overrun-dropped", "hdl/fifo.py", "event.overrun.eq(lost)", "event.overrun.eq(0)", ("event_fifo",), (FRAMES,)),
    Bug("overrun-not-reset", "hdl/fifo.py", "lost = Signal()", "lost = Signal(reset_less=True)", ("event_fifo",)),
    Bug(
        "fifo-one-short",
        "hdl/fifo.py",
        "room.eq(level != depth)",
        "room.eq(level < depth - 1)",
        ("event_fifo",),
        (FRAMES,),
    ),
    Bug(
        "record-overwritten",
        "hdl/fifo.py",
        "with m.If(comes & ~waiting):",
        "with m.If(comes):",
        ("record_buffer",),
        (FRAMES,),
    ),
    Bug(
        "settings-mid-frame",
        "hdl/settings.py",
        "with m.If(self.command.operation == bus.Operation.TAKE):",
        "with m.If(self.command.operation != bus.Operation.BEGIN):",
        ("subgroup_settings",),
        (PORTS,),
    ),
    Bug(
        "pulses-mid-frame",
        "hdl/registers.py",
        'm.d.comb += self.period.eq(state.setting["period", 0])',
        'm.d.comb += self.period.eq(state.setting["period", 0])\n        m.d.sync += self.plan.pulses.eq(state.setting["pulses", 0])',
        ("register_front",),
        (PORTS,),
    ),
    Bug(
        "threshold-above",
        "hdl/dpcu.py",
        "self.window.count >= threshold",
        "self.window.count > threshold",
        ("dpcu",),
        (FRAMES,),
    ),
    Bug(
        "lower-as-committed",
        "hdl/dpcu.py",
        "lower_threshold.eq(threshold - 1)",
        "lower_threshold.eq(threshold)",
        ("dpcu",),
        (FRAMES,),
    ),
    Bug(
        "ceiling-above",
        "hdl/dpcu.py",
        'count["opened"] >= self.data',
        'count["opened"] > self.data',
        ("dpcu",),
        (FRAMES,),
    ),
    Bug(
        "threshold-rises-early",
        "hdl/dpcu.py",
        'count["committed"] > self.data',
        'count["committed"] >= self.data',
        ("dpcu",),
        (FRAMES,),
    ),
    Bug(
        "threshold-below-floor", "hdl/dpcu.py", "Mux(bounded < floor, floor, bounded)", "bounded", ("dpcu",), (FRAMES,)
    ),
    Bug(
        "controller-keeps-others-threshold",
        "hdl/dpcu.py",
        "Mux(self.controlled & stays,",
        "Mux(self.controlled,",
        ("dpcu",),
        (FRAMES,),
    ),
    Bug("budget-of-last-stream", "hdl/subgroup.py", "number >= command.subgroup", "1", (), (FRAMES,)),
    Bug(
        "budget-beyond-capacity",
        "hdl/controller.py",
        "Mux(state.widened < state.capacity, state.widened, state.capacity)",
        "state.widened",
        ("controller",),
        (FRAMES,),
    ),
    Bug(
        "budget-below-share",
        "hdl/controller.py",
        "Mux(state.narrowed > state.share, state.narrowed, state.share)",
        "state.narrowed",
        ("controller",),
        (FRAMES,),
    ),
    Bug(
        "sums-not-cleared",
        "hdl/controller.py",
        "state.beat.eq(0), state.total.eq(0), state.more.eq(0)",
        "state.beat.eq(0), state.more.eq(0)",
        ("controller",),
        (FRAMES,),
    ),
    Bug(
        "uncontrolled-would-fall",
        "hdl/controller.py",
        "Mux(state.controlled & (state.lower <= state.wide)",
        "Mux((state.lower <= state.wide)",
        ("controller",),
        (FRAMES,),
    ),
    Bug(
        "too-much-too-late",
        "hdl/controller.py",
        "state.total > state.capacity",
        "state.total >= state.capacity",
        ("controller",),
        (FRAMES,),
    ),
    Bug("gate-late", "hdl/gating.py", "until_now == 0", "until_now <= 1", ("gating",), (FRAMES,)),
    Bug(
        "guard-short",
        "hdl/sequencer.py",
        "self.plan.period - self.sensor.guard",
        "self.plan.period - self.sensor.guard + 1",
        ("sequencer",),
        (FRAMES,),
    ),
    Bug(
        "abort-lost",
        "hdl/sequencer.py",
        "with m.If(state.aborted | self.abort_frame |",
        "with m.If(self.abort_frame |",
        ("sequencer",),
        (PORTS,),
    ),
    Bug("strobe-ignored", "hdl/registers.py", "axi.wstrb.all()", "axi.wstrb.any()", (), (PORTS,)),
    Bug(
        "answer-withdrawn",
        "hdl/registers.py",
        "with m.If(axi.bvalid & axi.bready):",
        "with m.If(axi.bvalid):",
        ("register_front",),
    ),
    Bug(
        "take-early",
        "hdl/packetizer.py",
        "at_last.eq(state.index + 1 == self._last",
        "at_last.eq(state.index + 2 >= self._last",
        ("packetizer",),
        (FRAMES,),
    ),
    Bug(
        "golden-window-long",
        "model/golden/front_end.py",
        "tick >= opening + window:",
        "tick > opening + window:",
        (),
        (GOLDEN, FRAMES),
    ),
    Bug(
        "golden-tie-highest",
        "model/golden/front_end.py",
        "hits[row, word] |= bit\n",
        "hits[row, word], winner = hits[row, word] | bit, inside if tick == opening else winner\n",
        (),
        (GOLDEN, FRAMES),
    ),
    Bug(
        "golden-not-rearmed",
        "model/golden/front_end.py",
        "last_pulse, armed_from = pulse, 0\n",
        "last_pulse = pulse\n",
        (),
        (GOLDEN,),
    ),
    Bug("golden-rearm-early", "model/contract/windows.py", "close + 1 + rearm", "close + rearm", (), (GOLDEN, FRAMES)),
    Bug(
        "golden-guard-short",
        "model/golden/shape.py",
        "config.period - sensor.guard",
        "config.period - sensor.guard + 1",
        (),
        (GOLDEN, FRAMES),
    ),
    Bug(
        "golden-gate-late",
        "model/golden/front_end.py",
        "gate_start <= cycle <",
        "gate_start < cycle <",
        (),
        (GOLDEN, FRAMES),
    ),
    Bug(
        "golden-threshold-above",
        "model/golden/front_end.py",
        "count < threshold:",
        "count <= threshold:",
        (),
        (GOLDEN, FRAMES),
    ),
    Bug(
        "golden-neighbours-stamp",
        "model/golden/front_end.py",
        "opening, count, winner\n",
        "opening ^ 1, count, winner\n",
        (),
        (GOLDEN, FRAMES),
    ),
    Bug(
        "golden-overrun-dropped", "model/golden/readout.py", "_NEVER, queue.lost", "_NEVER, False", (), (GOLDEN, FRAMES)
    ),
    Bug(
        "golden-other-settings",
        "model/golden/front_end.py",
        "settings.gate_start[s]",
        "settings.gate_start[0]",
        (),
        (GOLDEN, FRAMES),
    ),
    Bug("golden-ceiling", "model/golden/controller.py", 'side="right"', 'side="left"', (), (GOLDEN, FRAMES)),
    Bug(
        "golden-lower-as-committed",
        "model/golden/front_end.py",
        "count >= threshold - 1",
        "count >= threshold",
        (),
        (GOLDEN, FRAMES),
    ),
    Bug(
        "golden-rises-early",
        "model/golden/controller.py",
        "rises = committed > budget",
        "rises = committed >= budget",
        (),
        (GOLDEN, FRAMES),
    ),
    Bug(
        "golden-budget-below-share",
        "model/golden/controller.py",
        "return max(budget - budget // STEP, int(config.shares[stream]))",
        "return budget - budget // STEP",
        (),
        (GOLDEN, FRAMES),
    ),
    Bug(
        "golden-budget-beyond-capacity",
        "model/golden/controller.py",
        "min(budget + budget // STEP + 1, capacity)",
        "budget + budget // STEP + 1",
        (),
        (GOLDEN, FRAMES),
    ),
    Bug(
        "golden-old-budget",
        "model/golden/controller.py",
        "column[COUNTER.committed], column[COUNTER.lower]\n        budget = self.budget[self._stream]",
        "column[COUNTER.committed], column[COUNTER.lower]\n        budget = config.shares[self._stream]",
        (),
        (GOLDEN, FRAMES),
    ),
    Bug(
        "golden-record-finds-no-place",
        "model/golden/readout.py",
        "queue.place_free_at <= records",
        "queue.place_free_at < records",
        (),
        (ALIGNMENTS,),
    ),
    Bug(
        "golden-event-finds-no-place",
        "model/golden/readout.py",
        "events[queue.oldest].free_at <= event.cycle",
        "events[queue.oldest].free_at < event.cycle",
        (),
        (ALIGNMENTS,),
    ),
    Bug(
        "scene-mirrored",
        "model/scenes/planes.py",
        "(np.arange(cols) + 0.5) / cols",
        "(np.arange(cols)[::-1] + 0.5) / cols",
        (),
        (ORIENTATION,),
    ),
    Bug(
        "crosstalk-draws-shared",
        "model/light/walk.py",
        "uniform(key, CROSSTALK, 4 * fired + side)",
        "uniform(key, CROSSTALK, fired + side)",
        (),
        (INDEPENDENCE,),
    ),
    Bug("tlast-early", "hdl/readout.py", "to_end == 1)", "to_end == 2)", ("readout",), (FRAMES,)),
    Bug("register-range-short", "hdl/registers.py", "(value <= high)", "(value < high)", ("register_front",), (PORTS,)),
    Bug(
        "golden-fifo-deep",
        "model/golden/readout.py",
        "queue.level < fifo_depth",
        "queue.level <= fifo_depth",
        (),
        (FRAMES,),
    ),
    Bug(
        "serial-unchecked",
        "hdl/emulator/uart.py",
        "(count > CRC_BYTES) & crc.match_detected",
        "(count > CRC_BYTES)",
        ("deframer",),
    ),
    Bug(
        "buffer-overrun",
        "hdl/emulator/buffer.py",
        "self.s_axis.tready.eq(room)",
        "self.s_axis.tready.eq(1)",
        ("frame_buffer",),
    ),
    Bug(
        "source-dead",
        "hdl/emulator/source.py",
        "[dead.eq(common.dead), word",
        "[dead.eq(common.dead >> 1), word",
        ("photon_source",),
    ),
)


def copy_of_sources(folder: Path) -> None:
    """Copy packages and tests so that they are found before the installed ones."""
    shutil.copytree(ROOT / "coincid", folder / "coincid", ignore=shutil.ignore_patterns("__pycache__"))
    for package in PACKAGES:
        shutil.copytree(ROOT / package, folder / "coincid" / package, ignore=shutil.ignore_patterns("__pycache__"))
        (folder / package).symlink_to(folder / "coincid" / package)
    shutil.copytree(ROOT / "tests", folder / "tests", ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copy(ROOT / "pyproject.toml", folder)


def plant(bug: Bug, folder: Path) -> None:
    """Put a bug into a copy of the sources."""
    path = folder / bug.file
    text = path.read_text()
    assert text.count(bug.old) == 1, f"{bug.name}: {bug.file} has {text.count(bug.old)} times {bug.old!r}"
    path.write_text(text.replace(bug.old, bug.new))


def caught_by(bug: Bug, thorough: bool) -> dict[str, bool]:
    """Return proof or test -> whether it noticed a bug; up to the first that does, unless `thorough`."""
    with tempfile.TemporaryDirectory(prefix="coincid-planted-") as scratch:
        folder = Path(scratch)
        copy_of_sources(folder)
        plant(bug, folder)
        builds = build_root() / "planted" / bug.name
        environment = os.environ | {"PYTHONPATH": str(folder), "COINCID_BUILD": str(builds), "NUMBA_DISABLE_JIT": "1"}
        checks = [(f"proof {name}", ["coincid", "formal", name]) for name in bug.proofs]
        checks += [(test[0], ["pytest", "-x", "-q", "-p", "no:cacheprovider", *test]) for test in bug.tests]
        result = {}
        for name, command in checks:
            done = subprocess.run(
                [sys.executable, "-m", *command], cwd=folder, env=environment, capture_output=True, check=False
            )
            result[name] = done.returncode == 1
            if result[name] and not thorough:
                break
        shutil.rmtree(builds, ignore_errors=True)
    return result


def main() -> None:
    thorough, names = "--all" in sys.argv, [name for name in sys.argv[1:] if name != "--all"]
    bugs = [bug for bug in BUGS if not names or bug.name in names]
    missed = 0

    def run(bug: Bug) -> None:
        nonlocal missed
        result = caught_by(bug, thorough)
        missed += not (all if thorough else any)(result.values())
        print(
            f"{bug.name:26}",
            ", ".join(f"{what}: {'caught' if caught else 'MISSED'}" for what, caught in result.items()),
            flush=True,
        )

    with ThreadPoolExecutor(os.cpu_count() or 1) as pool:
        list(pool.map(run, bugs))
    print(f"{len(bugs) - missed} of {len(bugs)} planted bugs are caught")
    sys.exit(missed > 0)


if __name__ == "__main__":
    main()
