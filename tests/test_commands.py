# SPDX-License-Identifier: Apache-2.0
"""Each command that pages, docstrings and messages name is run by something, and `commands.toml`
says by what.
"""

import ast
import re
import subprocess
import tomllib

import pytest

from .commands import (
    BLOCK,
    MAKEFILE,
    PAGES,
    ROOT,
    all_commands,
    in_blocks,
    in_code,
    in_docstring,
    in_message,
    pattern_of,
    played_lines,
    sources,
    table,
    uncovered,
)
from .imports import distributions_of, imported, others_behind, packages_of, source_of

LISTS = ("explorer", "cluster", "extras")
ENTRIES = ("test", "called", "ci", "pages", "by_hand")
DO = "add it to tests/commands.toml, best as a step of a session, which tests/test_documented.py plays"
CI = (ROOT / ".ci" / "run").read_text(encoding="utf-8")
PROGRAMS_OF_PAGES = ROOT / "docs" / "pages.toml"


@pytest.fixture(scope="module")
def named():
    return all_commands()


def in_table():
    """Return all commands of the table."""
    kinds = table()
    found = []
    for session in kinds["session"].values():
        found += [step["command"] for step in session["step"]]
    for kind in LISTS:
        found += kinds[kind]["commands"]
    for kind in ENTRIES:
        for entry in kinds[kind]:
            found += entry["commands"]
    return found


def test_the_table_has_its_kinds_and_no_command_twice():
    assert set(table()) == {"session", *LISTS, *ENTRIES}
    commands = in_table()
    assert sorted(commands) == sorted(set(commands))


def test_every_command_is_run(named):
    lines = [line for command in in_table() for line in played_lines(command)]
    for command in uncovered(named, lines):
        pytest.fail(
            f"{', '.join(sorted(named[command]))} names `{command}`, and nothing runs it; {DO}"
        )


def test_every_command_of_the_table_is_named(named):
    for command in in_table():
        lines = played_lines(command)
        assert len(uncovered(named, lines)) < len(named), (
            f"nothing names `{command}`; remove it from commands.toml"
        )


@pytest.mark.parametrize("entry", table()["test"], ids=lambda entry: entry["test"])
def test_tests_of_the_table_run_the_command(entry):
    path, _, name = entry["test"].partition("::")
    source = (ROOT / path).read_text(encoding="utf-8")
    (function,) = [
        node
        for node in ast.walk(ast.parse(source))
        if isinstance(node, ast.FunctionDef) and node.name == name
    ]
    assert entry["has"] in ast.get_source_segment(source, function), (entry["test"], entry["has"])


@pytest.mark.parametrize("entry", table()["ci"], ids=lambda entry: entry["line"])
def test_lines_of_ci_run_the_command(entry):
    (line,) = [line for line in CI.splitlines() if line.startswith(entry["line"])]
    for command in entry["commands"]:
        if command.startswith("scripts/setup "):
            assert set(command.split()) <= set(line.split()), command
        elif "Try it" in line:
            _, _, section = (ROOT / "README.md").read_text(encoding="utf-8").partition("## Try it")
            assert command in in_blocks(section), command
        elif command != "make raytrace":
            assert line.startswith(command.removesuffix('"')), command


@pytest.mark.parametrize("entry", table()["called"], ids=lambda entry: entry["by"])
def test_programs_are_called(entry):
    assert entry["has"] in (ROOT / entry["by"]).read_text(encoding="utf-8")


def test_programs_of_pages_have_the_commands():
    """They are the targets that the Makefile lists so, studies and drawings; `docs/pages.toml`
    names each, if it is there.
    """
    commands = [command for entry in table()["pages"] for command in entry["commands"]]
    for command in commands:
        line = re.search(rf"^{command.removeprefix('make ')}: ## (.*)", MAKEFILE, re.MULTILINE)
        assert line or source_of(command.removeprefix("python -m ")), command
        assert not line or line[1].startswith("[numbers of pages]"), command
    if PROGRAMS_OF_PAGES.exists():
        programs = tomllib.loads(PROGRAMS_OF_PAGES.read_text(encoding="utf-8")).values()
        assert set(commands) <= {program.get("command") for program in programs}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_a_block_that_is_not_for_a_shell_has_a_language(page):
    """The commands in a block without a language are read; a block in the language of a shell would
    be left out.
    """
    found = {language for language, _ in BLOCK.findall(page.read_text(encoding="utf-8"))}
    assert found <= {"", "html", "python", "text", "toml", "verilog"}


def test_what_is_run_by_hand_has_a_reason():
    for entry in table()["by_hand"]:
        assert entry["why"] and entry["commands"]


PAGE = """
`make sim SCALE=3` and `coincid
show my.toml`, but not `coincid.show`, `verilator` or `makes`.

```
coincid edges a.ptu \\
    --out b.npz   # a comment
```

```python
coincid = "coincid sim"
```
"""


def test_commands_are_found():
    assert list(in_code(PAGE)) == ["make sim SCALE=3", "coincid show my.toml"]
    assert list(in_blocks(PAGE)) == ["coincid edges a.ptu --out b.npz"]
    docstring = "Draws.\n\n    python -m coincid.study.x [NAME ...]\n\nNeeds `make raytrace`. They make sense."
    assert sorted(in_docstring(docstring)) == [
        "make raytrace",
        "python -m coincid.study.x [NAME ...]",
    ]
    message = "x is not installed; run: make raytrace (elsewhere: pip install 'coincid[x]'), or use coincid sim"
    assert sorted(in_message(message)) == [
        "coincid sim",
        "make raytrace",
        "pip install 'coincid[x]'",
    ]


def test_ci_begins_with_the_commands_that_readme_tells_first():
    """Those of the first block of its section, as a stranger types them."""
    program = re.search(r"^awk '.*?' README\.md", CI, re.MULTILINE)[0]
    done = subprocess.run(["bash", "-c", program], cwd=ROOT, capture_output=True, encoding="utf-8")
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    (_, block), *_ = BLOCK.findall(text.partition("\n## Try it\n")[2])
    assert done.stdout == block
    assert [line.split()[:2] for line in block.splitlines()] == [["make", "sim"], ["make", "test"]]


@pytest.mark.parametrize(
    ("named", "line", "fits"),
    [
        ("coincid sweep", "coincid sweep a.toml", True),
        ("coincid sweep SPEC.toml", "coincid sweep a.toml", False),
        ("make sim", "make sim WAVES=1", False),
        ("python -m tests.soak [--frames N]", "python -m tests.soak --frames 3", True),
        ("python -m docs.studies.NAME", "python -m docs.studies.returns", True),
        ("python -m coincid.tb.stress EDGES [SEED]", "python -m coincid.tb.stress 100", True),
        ("python -m coincid.tb.stress EDGES [SEED]", "python -m coincid.tb.stress", False),
        ("pip install 'coincid[{}]'", "pip install 'coincid[rtl]'", True),
        ("pip install 'coincid[rtl]'", "pip install 'coincid[flow]'", False),
    ],
)
def test_a_command_is_played_by_what_it_means(named, line, fits):
    assert bool(pattern_of(named).fullmatch(line)) is fits


def imported_under_extras():
    """Return extra -> modules that are imported in a block `with extra(...)`."""
    found = {}
    for path in sources():
        for block in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(block, ast.With) and (name := extra_of(block)):
                found.setdefault(name, set()).update(imported(ast.walk(block), path))
    return found


def extra_of(block):
    """Return X of `with extra("X")`, or None."""
    for item in block.items:
        call = item.context_expr
        if isinstance(call, ast.Call) and ast.unparse(call.func) == "extra":
            return call.args[0].value
    return None


def test_an_extra_brings_what_its_block_imports():
    """Otherwise a missing package would be told with the name of an extra that does not install
    it.
    """
    extras = imported_under_extras()
    assert extras
    for extra, modules in extras.items():
        brought = packages_of(extra)
        for module in others_behind(modules):
            names = distributions_of(module)
            assert not names or names & brought, (
                f"{module} comes with {names}, not with coincid[{extra}]"
            )
