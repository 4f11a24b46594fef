# SPDX-License-Identifier: Apache-2.0
"""Yosys as a program. The PyPI wheel is a library, which prints, and ends its process at the
first error.

`python -P tools/yosys_program.py [-q] [-l LOG] SCRIPT` takes those options of Yosys that
SymbiYosys uses, too. The output goes to the log if one is named, and is dropped with -q; errors
go to standard error. It imports nothing of the project, so a start takes 0.05 s of CPU.
"""

import argparse
import os


def main() -> None:
    parser = argparse.ArgumentParser(prog="yosys")
    parser.add_argument("-q", dest="quiet", action="store_true", help="print errors only")
    parser.add_argument("-l", dest="log", default="", help="file for the output")
    parser.add_argument("script", help="file with commands of Yosys")
    options = parser.parse_args()
    if options.log or options.quiet:
        _send_output_to(options.log or os.devnull)
    from pyosys import libyosys

    libyosys.run_pass(f"script {options.script}", libyosys.Design())


def _send_output_to(path: str) -> None:
    """Send the standard output of this process to a file, also that of libraries that are not
    Python.
    """
    with open(path, "wb") as file:
        os.dup2(file.fileno(), 1)


if __name__ == "__main__":
    main()
