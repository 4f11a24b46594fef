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
PACKAGES = ("model", "tools", "host", "hdl", "slices", "tb", "formal", "flow", "lab", "study")
GOLDEN = ("tests/golden/test_golden.py",)  # golden model against the plain one
FRAMES = ("tests/tb/test_cosim.py", "-k", "tiny-icarus or narrow-icarus")  # RTL against the golden model
SLICED = ("tests/tb/test_cosim.py", "-k", "tiny-sliced or coarse-sliced")  # the same on the sliced engine
UNEQUAL = ("tests/tb/test_cosim.py", "-k", "narrow-icarus")  # streams with different numbers of subgroups
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
    proofs: tuple[str, ...]
    tests: tuple[tuple[str, ...], ...]


MISTAKES: dict[tuple[str, tuple[str, ...], tuple[tuple[str, ...], ...]], dict[str, tuple[str, str]]] = {
    # (file, proofs, tests): {name: (old, new)}
    ("hdl/tree.py", ("tree",), (FRAMES, SLICED)): {
        "window-long": ("self.line.phase + self.window_ticks)", "self.line.phase + self.window_ticks + 1)"),
        "window-edge": ("closing.eq(live & (self.end <= phases))", "closing.eq(live & (self.end < phases))"),
        "tie-highest": ('lowest(m, one_of, "winner")', '~lowest(m, one_of[::-1], "winner")'),
        "rearm-late": ("rearm.eq(self.sensor.rearm)", "rearm.eq(self.sensor.rearm + 1)"),
    },
    ("hdl/tree.py", ("tree",), ()): {
        "tree-not-reset": ("window_open = Signal()", "window_open = Signal(reset_less=True)")
    },
    ("hdl/minigroup.py", ("tree",), (FRAMES, SLICED)): {
        "hits-toggle": ("hits.eq(self.hit_4 | (hits & ~self", "hits.eq(self.hit_4 ^ (hits & ~self")
    },
    ("hdl/minigroup.py", ("minigroup_record",), (FRAMES, SLICED)): {
        "mask-ignored": ("root.eq(word & on.replicate(phases))", "root.eq(word)"),
        "mg-threshold": (">= self.frame.mg_threshold", "> self.frame.mg_threshold"),
    },
    ("hdl/tdc.py", ("tdc",), (FRAMES, SLICED)): {
        "tdc-lines-swapped": (
            'first_one(m, line.root, f"first_{k}")',
            'first_one(m, getattr(self, f"line_{self.lines - 1 - k}").root, f"first_{k}")',
        ),
        "tdc-line-shared": ('first_one(m, line.root, f"first_{k}")', 'first_one(m, self.line_0.root, f"first_{k}")'),
    },
    ("hdl/fifo.py", ("event_fifo",), (FRAMES, SLICED)): {
        "overrun-dropped": ("event.overrun.eq(self.lost)", "event.overrun.eq(0)"),
        "fifo-one-short": ("room.eq(self.level != depth)", "room.eq(self.level < depth - 1)"),
    },
    ("hdl/fifo.py", ("event_fifo",), ()): {"overrun-not-reset": ("lost = Signal()", "lost = Signal(reset_less=True)")},
    ("hdl/fifo.py", ("record_buffer",), (FRAMES, SLICED)): {
        "record-overwritten": ("with m.If(comes & ~waiting):", "with m.If(comes):")
    },
    ("hdl/settings.py", ("subgroup_settings",), (PORTS,)): {
        "settings-mid-frame": (
            "with m.If(self.command.operation == bus.Operation.TAKE):",
            "with m.If(self.command.operation != bus.Operation.BEGIN):",
        )
    },
    ("hdl/registers.py", ("register_front",), (PORTS,)): {
        "pulses-mid-frame": (
            'm.d.comb += self.period.eq(self.setting["period", 0])',
            'm.d.comb += self.period.eq(self.setting["period", 0])\n        m.d.sync += self.plan.pulses.eq(self.setting["pulses", 0])',
        ),
        "register-range-short": ("(value <= high)", "(value < high)"),
    },
    ("hdl/registers.py", (), (PORTS,)): {"strobe-ignored": ("axi.wstrb.all()", "axi.wstrb.any()")},
    ("hdl/registers.py", ("register_front",), ()): {
        "answer-withdrawn": ("with m.If(axi.bvalid & axi.bready):", "with m.If(axi.bvalid):")
    },
    ("hdl/dpcu.py", ("dpcu",), (FRAMES, SLICED)): {
        "threshold-above": ("self.window.count >= self.threshold", "self.window.count > self.threshold"),
        "lower-above": ("self.window.count >= self.lower_threshold", "self.window.count > self.lower_threshold"),
        "lower-as-committed": ("lower_threshold.eq(self.threshold - 1)", "lower_threshold.eq(self.threshold)"),
        "ceiling-above": ('count["opened"] >= self.data', 'count["opened"] > self.data'),
        "threshold-rises-early": ('count["committed"] > self.data', 'count["committed"] >= self.data'),
        "threshold-below-floor": ("Mux(bounded < floor, floor, bounded)", "bounded"),
        "controller-keeps-others-threshold": ("Mux(self.controlled & self.stays,", "Mux(self.controlled,"),
    },
    ("hdl/memory.py", (), (("tests/hdl/test_memory.py",),)): {"latch-rows-swapped": ("to == {r}", "to == {r ^ 1}")},
    ("hdl/subgroup.py", ("subgroup_rests",), ()): {"sleeps-early": ("AWAKE_CYCLES = 31", "AWAKE_CYCLES = 5")},
    ("hdl/minigroup.py", ("minigroup_rests",), ()): {
        "stage-asleep": ("self.awake_1, self.awake_3, *", "self.awake_1, *")
    },
    ("hdl/tree.py", ("strobes_rest",), ()): {"strobe-asleep": ("self.timing.wrap, *self.strobes", "*self.strobes")},
    ("hdl/dpcu.py", ("dpcu_rests",), ()): {"pulse-asleep": ("| self.start | self.coming", "| self.coming")},
    ("hdl/settings.py", ("settings_rest",), ()): {
        "check-asleep": ("!= bus.Operation.IDLE) | accessed", "!= bus.Operation.IDLE)")
    },
    ("hdl/sensor.py", (), (UNEQUAL,)): {"grant-of-first": ("[sensor.stream_subgroups(stream).index(s)]", "[0]")},
    ("hdl/subgroup.py", (), (FRAMES, SLICED)): {"budget-of-last-stream": ("self.subgroup >= command.subgroup", "1")},
    ("hdl/controller.py", ("controller",), (FRAMES, SLICED)): {
        "budget-beyond-capacity": (
            "Mux(self.grown < self.capacity_taken, self.grown, self.capacity_taken)",
            "self.grown",
        ),
        "limit-below-share": ("Mux(self.dropped > self.share_taken, self.dropped, self.share_taken)", "self.dropped"),
        "sums-not-cleared": ("[one.eq(0) for one in self.sums]", "[one.eq(0) for one in self.sums[1:]]"),
        "uncontrolled-would-fall": (
            "self.controlled & ~self.slot[0] & (self.then <= self.steps[0])",
            "~self.slot[0] & (self.then <= self.steps[0])",
        ),
        "too-much-too-early": ("self.sums[-1] <= self.capacity_taken", "self.sums[-1] < self.capacity_taken"),
        "limit-stays": ("self.limit.eq(self.higher_limit)", "self.limit.eq(self.limit)"),
    },
    ("hdl/gating.py", ("gating",), (FRAMES, SLICED)): {"gate-late": ("until_now == 0", "until_now <= 1")},
    ("hdl/sequencer.py", ("sequencer",), (FRAMES, SLICED)): {
        "guard-short": ("self.plan.period - self.sensor.guard", "self.plan.period - self.sensor.guard + 1")
    },
    ("hdl/sequencer.py", ("sequencer",), (PORTS,)): {
        "abort-lost": ("with m.If(self.aborted | self.abort_frame |", "with m.If(self.abort_frame |")
    },
    ("hdl/packetizer.py", ("packetizer",), (FRAMES, SLICED)): {
        "take-early": ("at_last.eq(self.index + 1 >= self._last", "at_last.eq(self.index + 2 >= self._last")
    },
    ("hdl/coder.py", ("coder",), (FRAMES,)): {
        "age-of-another-event": ("same.eq(self.age_ahead == self.age)", "same.eq(self.age_ahead == 0)"),
        "group-too-old": ("self.fits_ahead.eq(age <= groups.AGE_MAX)", "self.fits_ahead.eq(age <= groups.AGE_MAX + 1)"),
        "pixel-twice": ("self.rest.eq(of_rest.between)", "self.rest.eq(of_rest.between | of_rest.high)"),
    },
    ("hdl/packer.py", ("packer",), (FRAMES,)): {
        "beat-one-bit-short": ("self.ready.eq(self.total >= PAYLOAD_BITS)", "self.ready.eq(self.total > PAYLOAD_BITS)"),
        "mark-of-first-lost": ("self.begins.eq(self.final)", "self.begins.eq(0)"),
    },
    ("model/golden/front_end.py", (), (GOLDEN, FRAMES)): {
        "golden-window-long": ("tick >= opening + window:", "tick > opening + window:"),
        "golden-tie-highest": (
            "hits[row, word] |= bit\n",
            "hits[row, word], winner = hits[row, word] | bit, inside if tick == opening else winner\n",
        ),
        "golden-gate-late": ("gate_start <= cycle <", "gate_start < cycle <"),
        "golden-threshold-above": ("count < threshold:", "count <= threshold:"),
        "golden-neighbours-stamp": ("opening, count, winner\n", "opening ^ 1, count, winner\n"),
        "golden-other-settings": ("settings.gate_start[s]", "settings.gate_start[0]"),
        "golden-lower-as-committed": ("count >= threshold - 1", "count >= threshold"),
    },
    ("model/golden/front_end.py", (), (GOLDEN,)): {
        "golden-not-rearmed": ("last_pulse, armed_from = pulse, 0\n", "last_pulse = pulse\n")
    },
    ("model/contract/latency.py", (), (GOLDEN, FRAMES)): {"golden-rearm-early": ("close + 1 + rearm", "close + rearm")},
    ("model/golden/shape.py", (), (GOLDEN, FRAMES)): {
        "golden-guard-short": ("config.period - sensor.guard", "config.period - sensor.guard + 1")
    },
    ("model/golden/readout.py", (), (GOLDEN, FRAMES)): {
        "golden-overrun-dropped": ("_NEVER, queue.lost", "_NEVER, False")
    },
    ("model/golden/readout.py", (), (ALIGNMENTS,)): {
        "golden-record-finds-no-place": ("queue.place_free_at <= records", "queue.place_free_at < records"),
        "golden-event-finds-no-place": (
            "events[queue.oldest].free_at <= event.cycle",
            "events[queue.oldest].free_at < event.cycle",
        ),
    },
    ("model/golden/readout.py", (), (FRAMES, SLICED)): {
        "golden-fifo-deep": ("queue.level < fifo_depth", "queue.level <= fifo_depth")
    },
    ("model/golden/controller.py", (), (GOLDEN, FRAMES)): {
        "golden-ceiling": ('side="right"', 'side="left"'),
        "golden-rises-early": ("rises = committed > self.limit", "rises = committed >= self.limit"),
        "golden-limit-below-share": ("max(share, top - (top >> LIMIT_DROP))", "top - (top >> LIMIT_DROP)"),
        "golden-budget-beyond-capacity": ("max(share, min(candidate, capacity))", "max(share, candidate)"),
        "golden-limit-not-lowered": ("max(fitting, top)", "max(fitting, limit)"),
    },
    ("model/scenes/flat_scenes.py", (), (ORIENTATION,)): {
        "scene-mirrored": ("(np.arange(cols) + 0.5) / cols", "(np.arange(cols)[::-1] + 0.5) / cols")
    },
    ("model/light/walk.py", (), (INDEPENDENCE,)): {
        "crosstalk-draws-shared": ("uniform(key, CROSSTALK, 4 * fired + side)", "uniform(key, CROSSTALK, fired + side)")
    },
    ("host/driver.py", (), (("tests/host/test_host.py", "-k", "cut_anywhere"),)): {
        "streams-alike": ("sensor.stream_subgroups(stream)", "sensor.stream_subgroups(0)")
    },
    ("study/other_schemes.py", (), (("tests/study/test_rivals.py", "-k", "by_hand"),)): {
        "rivals-streams-alike": ("sensor.stream_subgroups(stream)", "sensor.stream_subgroups(0)")
    },
    ("hdl/readout.py", ("readout",), (FRAMES, SLICED)): {"tlast-early": ("to_end == 1)", "to_end == 2)")},
    ("hdl/emulator/uart.py", ("deframer",), ()): {
        "serial-unchecked": ("(self.count > CRC_BYTES) & crc.match_detected", "(self.count > CRC_BYTES)")
    },
    ("hdl/emulator/buffer.py", ("frame_buffer",), ()): {
        "buffer-overrun": ("self.s_axis.tready.eq(room)", "self.s_axis.tready.eq(1)")
    },
    ("hdl/emulator/source.py", ("photon_source",), ()): {
        "source-dead": ("[dead.eq(common.dead), word", "[dead.eq(common.dead >> 1), word")
    },
}
BUGS = tuple(
    Bug(name, file, old, new, proofs, tests)
    for (file, proofs, tests), mistakes in MISTAKES.items()
    for name, (old, new) in mistakes.items()
)


def copy_of_sources(folder: Path) -> None:
    """Copy packages and tests so that they are found before the installed ones."""
    for name in ("coincid", "tests", *PACKAGES):
        shutil.copytree(ROOT / name, folder / name, symlinks=True, ignore=shutil.ignore_patterns("__pycache__"))
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
