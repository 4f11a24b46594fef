# SPDX-License-Identifier: Apache-2.0
"""Whatever ends a block also ends the programs that its thread runs, one after the other; no signal
is lost.
"""

import os
import select
import signal
import subprocess
import sys
import time
from multiprocessing import active_children

import pytest

from coincid.model.shared.interrupts import (
    PROGRAMS,
    Terminated,
    exit_code,
    in_background,
    interruptible,
    program,
    worker_processes,
)
from coincid.tools.build import execute


def test_programs_of_a_thread_end_with_the_block(tmp_path):
    began, codes = tmp_path / "began", []

    def two():
        for _ in range(2):
            codes.append(
                execute(
                    ["sh", "-c", f"touch {began}; sleep 1000"],
                    tmp_path,
                    tmp_path / "log",
                    os.environ,
                )
            )

    with pytest.raises(KeyboardInterrupt), in_background(two):
        while not began.exists():
            time.sleep(0.01)
        raise KeyboardInterrupt
    assert len(codes) == 2 and all(codes) and not PROGRAMS


def test_result_and_error_of_a_thread_reach_the_block():
    with in_background(lambda: 1) as found:
        assert found.result() == 1
    with pytest.raises(ZeroDivisionError), in_background(lambda: 1 // 0) as found:
        found.result()


IN_A_CALLBACK = """
import ctypes, os, sys, time
from coincid.model.shared.interrupts import exit_code, interruptible
interruptible()
comes = ctypes.CFUNCTYPE(None)(lambda: os.kill(os.getpid(), int(sys.argv[1])))
try:
    comes()
    time.sleep(60)
except KeyboardInterrupt as why:
    sys.exit(exit_code(why))
"""


@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_a_signal_in_a_callback_of_c_is_not_lost(number, code):
    """As in one of the compiler, which can raise nothing."""
    done = subprocess.run(
        [sys.executable, "-c", IN_A_CALLBACK, str(int(number))],
        timeout=50,
        check=False,
        capture_output=True,
        text=True,
        encoding="utf-8",
    )
    assert (done.returncode, done.stderr) == (code, "")


@pytest.fixture
def signals():
    """Let a test change what signals do, and undo it."""
    hook = sys.unraisablehook
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)
    sys.unraisablehook = hook


def test_each_signal_raises_its_own_exception_and_a_second_sigterm_none(signals):
    """Though the process that started this one ignored both. The cleaning up goes on."""
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)
    interruptible()
    for _ in range(2):
        with pytest.raises(KeyboardInterrupt) as raised:
            os.kill(os.getpid(), signal.SIGINT)
        assert exit_code(raised.value) == 130
    with pytest.raises(Terminated) as raised:
        os.kill(os.getpid(), signal.SIGTERM)
    assert exit_code(raised.value) == 143
    assert signal.getsignal(signal.SIGTERM) == signal.SIG_IGN
    os.kill(os.getpid(), signal.SIGTERM)


class _Lost:
    """Something whose end raises an error that nobody can catch."""

    def __del__(self):
        raise ValueError("of an object that is gone")


def test_an_error_that_is_lost_is_shown_and_is_no_signal(signals, capfd):
    interruptible()
    lost = _Lost()
    del lost
    assert "ValueError: of an object that is gone" in capfd.readouterr().err


def _begin_with(first, second):
    os.environ["BEGUN_WITH"] = f"{first} {second}"


def _begun():
    return os.environ.get("BEGUN_WITH"), signal.getsignal(signal.SIGINT) == signal.SIG_IGN


class _OfAnotherPool:
    """A worker that was there before."""

    was_killed = False

    def kill(self):
        self.was_killed = True


def test_workers_begin_as_they_are_told_and_are_killed_by_an_error(monkeypatch):
    """Ctrl-C is for the process that started them; other children of it live on."""
    other = subprocess.Popen(["sleep", "1000"])
    of_another = _OfAnotherPool()
    monkeypatch.setattr(
        "coincid.model.shared.interrupts.active_children",
        lambda: [*active_children(), of_another],
    )
    before = set(active_children())
    try:
        with (
            pytest.raises(ZeroDivisionError),
            worker_processes(1, _begin_with, "a", 5) as pool,
        ):
            assert pool.submit(_begun).result() == ("a 5", True)
            (worker,) = set(active_children()) - before
            pool.submit(time.sleep, 20)
            raise ZeroDivisionError
        while worker.exitcode is None:  # the pool may be the one that waits for it
            time.sleep(0.01)
        assert worker.exitcode == -signal.SIGKILL
        assert other.poll() is None
        assert not of_another.was_killed
    finally:
        other.kill()
        other.wait()


@pytest.mark.parametrize("fails", [False, True])
def test_a_program_is_known_while_it_runs_and_ends_with_an_error(fails):
    """With all that it started: here `sleep`, which the shell waits for."""
    command = ["sh", "-c", "sleep 60 & echo begun; wait" if fails else "echo begun"]
    try:
        with program(command, stdout=subprocess.PIPE, encoding="utf-8") as running:
            assert running in PROGRAMS
            assert running.stdout.readline() == "begun\n"
            if fails:
                raise ZeroDivisionError
            running.wait()
    except ZeroDivisionError:
        assert fails
    # the pipe has an end when nobody can write to it any more
    ended, _, _ = select.select([running.stdout], [], [], 30)
    assert ended and running.stdout.read() == ""
    running.stdout.close()
    assert running not in PROGRAMS
    assert running.returncode == (-signal.SIGKILL if fails else 0)


def test_an_error_behind_a_program_that_has_ended_is_told_as_it_is():
    """There is nothing left to kill."""
    with pytest.raises(ZeroDivisionError), program(["true"]) as running:
        assert running.wait() == 0
        raise ZeroDivisionError
    assert running not in PROGRAMS
