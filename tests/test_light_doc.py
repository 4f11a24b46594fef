# SPDX-License-Identifier: Apache-2.0
"""The page on light: its code runs, and prints what the page says."""

import contextlib
import io
import re
from pathlib import Path

PAGE = Path(__file__).parents[1] / "docs" / "light.md"


def test_code_of_the_page_prints_what_the_page_says():
    text, printed = PAGE.read_text(encoding="utf-8"), io.StringIO()
    names = {}
    with contextlib.redirect_stdout(printed):
        for code in re.findall(r"```python\n(.*?)```", text, re.DOTALL):
            exec(code, names)
    said = re.sub(r"```python\n.*?```", "", text, flags=re.DOTALL)
    lines = printed.getvalue().splitlines()
    assert len(lines) > 10
    assert [line for line in lines if line not in said] == []
