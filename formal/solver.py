# SPDX-License-Identifier: Apache-2.0
"""Bitwuzla as a program: the PyPI wheel is a library, but yosys-smtbmc needs a process that speaks
SMT-LIB.

`python -m coincid.formal.solver --lang smt2` reads commands from standard input and answers each at
once.
"""

import re
import sys
from collections.abc import Iterable, Iterator

HELP = "usage: bitwuzla --lang smt2"  # yosys-smtbmc searches it for the option's name
TOKEN = re.compile(r"\|[^|]*\||;.*|[()]")


def commands(lines: Iterable[str]) -> Iterator[str]:
    """Yield the commands in a text: lines until the parentheses outside of |symbols| and comments
    are balanced.
    """
    command, depth = [], 0
    for line in lines:
        command.append(line)
        for token in TOKEN.findall(line):
            depth += (token == "(") - (token == ")")
        if not depth:
            yield "".join(command)
            command = []


def main() -> None:
    """Answer commands until the input ends, or until `(exit)`."""
    if "--help" in sys.argv:
        print(HELP)
        return
    from bitwuzla import Option, Options, Parser, TermManager

    options = Options()
    options.set(Option.PRODUCE_MODELS, True)
    parser = Parser(TermManager(), options)
    for command in commands(sys.stdin):
        words = command.split(";")[0].replace("(", " ").replace(")", " ").split()
        if words[:1] == ["exit"]:
            return
        if words[:1] in (["push"], ["pop"]):  # in the parser, the binding miscounts the levels
            getattr(parser.bitwuzla(), words[0])(int(words[1]) if len(words) > 1 else 1)
        elif words:
            parser.parse(command, False, False)
        sys.stdout.flush()


if __name__ == "__main__":
    main()
