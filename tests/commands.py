# SPDX-License-Identifier: Apache-2.0
"""The commands that this project tells people to type, read from where it tells them.

`python -m tests.commands` lists them with the places that name them. `tests/commands.toml` says for
each command what runs it.
"""

import ast
import os
import re
import shlex
import subprocess
import tomllib
from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence
from functools import cache
from pathlib import Path

from typer.main import get_command

from coincid.cli import app

ROOT = Path(__file__).parents[1]
TABLE = Path(__file__).with_name("commands.toml")
ROOMS = (
    "src",
    "model",
    "tools",
    "host",
    "hdl",
    "slices",
    "tb",
    "flow",
    "formal",
    "lab",
    "study",
    "board",
)
SWEEPS = sorted((ROOT / "docs").glob("sweep-*.toml"))
PAGES = [
    ROOT / "README.md",
    ROOT / "CONTRIBUTING.md",
    ROOT / "NOTICE",
    ROOT / "examples" / "README.md",
    *sorted((ROOT / "docs").glob("*.md")),
]

COMMANDS = set(get_command(app).commands)  # of `coincid`
MAKEFILE = (ROOT / "Makefile").read_text(encoding="utf-8")
NEEDS = re.search(
    r'^needs="([^"]*)"', (ROOT / "scripts" / "setup").read_text(encoding="utf-8"), re.MULTILINE
)[1].split()
TARGETS = set(re.findall(r"^([a-z]+):", MAKEFILE, re.MULTILINE))
PROGRAMS = "apt-get cd dask fujprog fusesoc git gtkwave iverilog openFPGALoader pip printf surfer uv verilator vvp"
# What a command begins with. The name of a program alone is no command.
BEGINS = re.compile(
    rf"""
    make\ [a-z]           # a target
    | coincid\ [a-z]
    | python3?\ (-m\ \w|\S+\.py)
    | \.venv/bin/\w
    | scripts/\w+($|\ )
    | (SCENE|UNIT|SCALE|MISSING|SKY|CHANNEL|Z|FOV|REFLECTIVITY|KLUX|PULSE|PULSES|FRAMES|SIM|VIEW|WAVES|CONFIG)=  # an option of `make sim`
    | echo\ .*>           # a setting of the system
    | ({PROGRAMS.replace(" ", "|")})\ \S
    """,
    re.VERBOSE,
)
BLOCK = re.compile(r"^ *```(\w*)\n(.*?)^ *```$", re.DOTALL | re.MULTILINE)  # fenced: language, text
CODE = re.compile(r"(`+)([^`]+)\1")
# Recommendations in a message that has no backticks.
TOLD = re.compile(
    rf"""
    (?<=run:\ )[^()\n]*[^()\n ,;]
    | \bmake\ ({"|".join(sorted(TARGETS))})\b(\ [A-Z_]+=[^\s)]+)*
    | \bcoincid\ ({"|".join(sorted(COMMANDS))})\b(\ --[\w-]+(=\S+)?)*
    | \bpython\ -m\ (coincid|docs|tests)(\.\w+)*
    | \bscripts/setup(\ ({"|".join(NEEDS)})\b)+
    | \bpip\ install\ '[^']*'
    """,
    re.VERBOSE,
)


def _words(text: str) -> str:
    """Return the text with single spaces."""
    return " ".join(text.split())


def in_blocks(text: str) -> Iterator[str]:
    """Yield the commands of the fenced blocks without a language; a block of other text has one."""
    for language, block in BLOCK.findall(text):
        if language:
            continue
        for line in block.replace("\\\n", " ").splitlines():
            if command := _words(re.sub(r"(^|\s)#.*", "", line)):
                yield command


def in_code(text: str) -> Iterator[str]:
    """Yield the commands in inline code. Options of make stand for themselves: `SCALE=3`."""
    for _, code in CODE.findall(BLOCK.sub("", text)):
        if BEGINS.match(_words(code)):
            yield _words(code)


def of_pages() -> dict[str, set[str]]:
    """Return command -> pages, and specifications of sweeps, that name it."""
    found = defaultdict(set)
    for page in PAGES:
        text = page.read_text(encoding="utf-8")
        for command in (*in_blocks(text), *in_code(text)):
            found[command].add(str(page.relative_to(ROOT)))
    for path in SWEEPS:
        for command in re.findall(
            r"^# (coincid sweep \S+): ", path.read_text(encoding="utf-8"), re.MULTILINE
        ):
            found[command].add(str(path.relative_to(ROOT)))
    return dict(found)


def in_docstring(text: str) -> Iterator[str]:
    """Yield the commands in backticks, and those that are a line of their own."""
    yield from in_code(text)
    for line in text.splitlines():
        if re.match(r" *python -m \S+", line):
            yield _words(line)


def in_message(text: str) -> Iterator[str]:
    """Yield what a string of the program recommends: in backticks, after `run:`, or by the names of
    known commands.
    """
    yield from in_code(text)
    for found in TOLD.finditer(CODE.sub("", text)):
        if found[0] != "{}":  # a constant, whose string is looked at, too
            yield _words(found[0])


def _strings(tree: ast.Module) -> Iterator[tuple[bool, str]]:
    """Yield whether it is a docstring, and the text, of every string; `{}` stands for a value in
    it.
    """
    parts = set()
    documented = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)
    for node in ast.walk(tree):
        if isinstance(node, documented) and (text := ast.get_docstring(node)):
            parts.add(node.body[0].value)
            yield True, text
        elif isinstance(node, ast.JoinedStr):
            parts |= set(node.values)
            yield (
                False,
                "".join(
                    part.value if isinstance(part, ast.Constant) else "{}" for part in node.values
                ),
            )
        elif isinstance(node, ast.Constant) and isinstance(node.value, str) and node not in parts:
            yield False, node.value


def sources() -> Iterator[Path]:
    """Yield the Python files of the rooms, the examples, and the programs and helpers of the pages
    and tests.
    """
    for room in (*ROOMS, "examples"):
        for path in sorted((ROOT / room).rglob("*.py")):
            yield path
    yield from sorted((ROOT / "docs" / "studies").rglob("*.py"))
    yield ROOT / "docs" / "build.py"
    for path in sorted((ROOT / "tests").glob("*.py")):
        if not path.name.startswith("test_") and path != Path(__file__):
            yield path


def ofsources() -> dict[str, set[str]]:
    """Return command -> files whose docstrings, messages or comments for `make help` name it."""
    found = defaultdict(set)
    for path in sources():
        for is_docstring, text in _strings(ast.parse(path.read_text(encoding="utf-8"))):
            for command in in_docstring(text) if is_docstring else in_message(text):
                found[command].add(str(path.relative_to(ROOT)))
    for name in ("Makefile", "scripts/setup", "study/explore/page.html"):
        for line in (ROOT / name).read_text(encoding="utf-8").splitlines():
            said = re.search(r"## .*|#.*: .*|echo .*|>.*", line)
            for command in in_message(said[0]) if said else ():
                found[command].add(name)
    return dict(found)


def lines_of_make(words: Sequence[str]) -> list[str]:
    """Return the command lines that `make` would run with these words. Neither options nor
    variables of a make that runs these tests reach it.
    """
    printed = subprocess.run(
        ["make", "--no-print-directory", "-n", *words],
        cwd=ROOT,
        env={name: os.environ[name] for name in ("PATH", "HOME") if name in os.environ},
        capture_output=True,
        encoding="utf-8",
        check=True,
    )
    return printed.stdout.replace("\\\n", " ").splitlines()


@cache
def commands_of_make(line: str) -> list[str]:
    """Return the command lines that a target consists of, without `scripts/setup`."""
    lines = lines_of_make(shlex.split(line)[1:])
    return [_words(one) for one in lines if not one.startswith("scripts/setup")]


def all_commands() -> dict[str, set[str]]:
    """Return command -> places that name it."""
    found = of_pages()
    for command, places in ofsources().items():
        found[command] = found.get(command, set()) | places
    return dict(sorted(found.items()))


def pattern_of(named: str) -> re.Pattern[str]:
    """Return what the commands look like that a page means by one: optional words may be missing,
    capitals and `{}` differ.

    The name of a program alone, such as `coincid sweep`, means any of its commands.
    """
    required = re.sub(r" \[[^\]]*\]| \.\.\.$", "", named)
    escaped = re.escape(required)
    escaped = re.sub(r"\\{\\}", r"[\\w-]+", escaped)
    escaped = re.sub(r"(?<![\w/])[A-Z]{3,}(\\\.){0,3}(?=\\ |$)(?<!NAME)", r".+", escaped)
    escaped = re.sub(r"NAME$", r"\\w+", escaped)
    alone = r"coincid [a-z]+|python -m [\w.]+"
    return re.compile(
        escaped + (r"( .*)?" if required != named or re.fullmatch(alone, named) else "")
    )


def played_lines(command: str) -> list[str]:
    """Return a command, and those that it consists of if it is a target, without the folder of the
    environment.
    """
    lines = [command, *(commands_of_make(command) if command.startswith("make ") else ())]
    return [line.removeprefix(".venv/bin/") for line in lines]


def is_option(named: str) -> bool:
    """Return whether it is an option of make alone, such as `SCALE=3`."""
    return re.fullmatch(r"[A-Z]+=\S*", named) is not None


def uncovered(named: Iterable[str], lines: Iterable[str]) -> list[str]:
    """Return the commands that none of the played lines is."""
    lines = list(lines)
    words = {word for line in lines if line.startswith("make ") for word in line.split()}
    missing = []
    for command in named:
        if is_option(command):
            covered = any(word.startswith(command) for word in words)
        elif re.match(r"make [a-z]+ [A-Z_]+=", command):  # further options may be there
            covered = any(set(command.split()) <= set(line.split()) for line in lines)
        else:
            pattern = pattern_of(command.removeprefix(".venv/bin/"))
            covered = any(pattern.fullmatch(line) for line in lines)
        if not covered:
            missing.append(command)
    return missing


def table() -> dict:
    """Return the table of what runs each command."""
    return tomllib.loads(TABLE.read_text(encoding="utf-8"))


if __name__ == "__main__":
    for told, places in all_commands().items():
        print(f"{told:70} {', '.join(sorted(places))}")
