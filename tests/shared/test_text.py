# SPDX-License-Identifier: Apache-2.0
"""Text is read and written as UTF-8, whatever the locale of the machine."""

import ast
import json
import os
import subprocess
import sys

from coincid.study.simulate import PAGE, REPORT

from ..checkout import ROOT, project_files

# what does not open a file of text, such as a member of a ZIP archive
OTHER_OPENERS = {
    "Image.open",
    "OpenImageIO.ImageInput.open",
    "archive.open",
    "os.open",
    "webbrowser.open",
}
PROCESSES = {"run", "Popen", "check_output", "program"}
ASCII_LOCALE = {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}


def test_every_text_file_and_pipe_names_its_encoding():
    found = []
    sources = [path for path in project_files() if path.suffix == ".py"]
    assert len(sources) > 300
    for path in sources:
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Call) and _depends_on_the_locale(node):
                found.append(f"{path.relative_to(ROOT)}:{node.lineno}: {ast.unparse(node)}")
    assert not found


def _depends_on_the_locale(call: ast.Call) -> bool:
    """Return whether the call reads or writes text without saying how it is encoded."""
    named = {keyword.arg for keyword in call.keywords}
    name = call.func.attr if isinstance(call.func, ast.Attribute) else getattr(call.func, "id", "")
    if "encoding" in named:
        return False
    if name in {"read_text", "write_text"}:
        return True
    if name in {"open", "fdopen"}:
        return ast.unparse(call.func) not in OTHER_OPENERS and not _is_binary(call)
    return name in PROCESSES and not named.isdisjoint({"text", "universal_newlines"})


def _is_binary(call: ast.Call) -> bool:
    """Return whether one of the arguments is a mode such as "rb"."""
    given = [*call.args, *(keyword.value for keyword in call.keywords)]
    modes = [argument.value for argument in given if isinstance(argument, ast.Constant)]
    return any(
        isinstance(mode, str) and "b" in mode and set(mode) <= set("rwxab+") for mode in modes
    )


def test_a_run_under_a_locale_of_ascii(tmp_path):
    """`report.html` has characters that ASCII lacks; it is the same page, and the lines of the
    console can be printed.
    """
    (tmp_path / "small.toml").write_text(
        "# \N{MICRO SIGN}\n[sensor]\nrows = 8\ncols = 8\n", encoding="utf-8"
    )
    options = "sim --engine golden --scene flat:5,0.4 --pulses 4 --config small.toml --out out"
    command = [sys.executable, "-m", "coincid", *options.split()]
    done = subprocess.run(
        command, cwd=tmp_path, env=os.environ | ASCII_LOCALE, capture_output=True, check=False
    )
    assert done.returncode == 0, done.stderr.decode()
    page = (tmp_path / "out" / PAGE).read_text(encoding="utf-8")
    assert '<meta charset="utf-8">' in page
    assert not page.isascii()
    assert json.loads((tmp_path / "out" / REPORT).read_text(encoding="utf-8"))["mismatches"] == 0
