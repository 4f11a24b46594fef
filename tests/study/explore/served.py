# SPDX-License-Identifier: Apache-2.0
"""An explorer that is being served, for tests."""

import subprocess
import sys
from contextlib import contextmanager

SMALL = ("rows=16", "cols=16", "pulses=20")


@contextmanager
def explorer(*settings, port=0):
    """Serve an explorer; return (process, address)."""
    words = [word for setting in settings for word in ("--set", setting)]
    command = [sys.executable, "-m", "coincid", "explore", "--port", str(port), "--no-browser", *words]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    try:
        yield process, process.stdout.readline().split()[2]
    finally:
        process.kill()
        process.wait()
        process.stdout.close()
