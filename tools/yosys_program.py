# SPDX-License-Identifier: Apache-2.0
"""Yosys as a program. The PyPI wheel is a library, which prints, and ends its process at the
first error.

`python -P tools/yosys_program.py [-q] [-l LOG] SCRIPT...` takes those options of Yosys that
SymbiYosys uses, too. The output goes to the log if one is named, and is dropped with -q; errors
go to standard error. It imports nothing of the project, so a start takes 0.05 s of CPU. Of several
scripts each one has a Yosys of its own, without a start of its own.
"""

import argparse
import os
import sys
from collections.abc import Callable, Sequence


def main() -> None:
    parser = argparse.ArgumentParser(prog="yosys")
    parser.add_argument("-q", dest="quiet", action="store_true", help="print errors only")
    parser.add_argument("-l", dest="log", default="", help="file for the output")
    parser.add_argument("scripts", nargs="+", metavar="SCRIPT", help="file with commands of Yosys")
    options = parser.parse_args()
    if options.log or options.quiet:
        _send_output_to(options.log or os.devnull)
    from pyosys import libyosys

    def run(script: str) -> None:
        libyosys.run_pass(f"script {script}", libyosys.Design())
        libyosys.log_flush()  # the end of a fork drops what is not written

    if len(options.scripts) == 1:
        run(options.scripts[0])
    else:
        sys.exit(_run_in_forks(run, options.scripts))


def _run_in_forks(run: Callable[[str], None], scripts: Sequence[str]) -> int:
    """Run each script in a fork of this process, which has loaded Yosys but has not used it; as
    many at a time as there are processors. Return 0, or 1 if one fails.
    """
    waiting = list(scripts)
    running = 0
    code = 0
    while waiting or running:
        if waiting and running < (os.cpu_count() or 1):
            script = waiting.pop(0)
            if os.fork() == 0:
                run(script)
                os._exit(0)
            running += 1
        else:
            _, status = os.wait()
            running -= 1
            code = code or int(status != 0)
    return code


def _send_output_to(path: str) -> None:
    """Send the standard output of this process to a file, also that of libraries that are not
    Python.
    """
    with open(path, "wb") as file:
        os.dup2(file.fileno(), 1)


if __name__ == "__main__":
    main()
