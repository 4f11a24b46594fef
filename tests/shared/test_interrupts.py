# SPDX-License-Identifier: Apache-2.0
"""Whatever ends a block also ends the programs that its thread runs, one after the other; no signal
is lost.
"""

import os
import signal
import subprocess
import sys
import time

import pytest

from coincid.model.shared.interrupts import PROGRAMS, in_background
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
