# SPDX-License-Identifier: Apache-2.0
"""Excuses of mutants in the golden model's source: `golden_mutants.py` has their form.

That the excused mutants survive, only the campaign (`make mutation`) can show.
"""

from pathlib import Path

import pytest

from .. import golden_mutants
from ..golden_mutants import GOLDEN_SOURCES, excuses


def test_every_excuse_has_a_mutant_on_its_line():
    mutants = golden_mutants.golden_mutants()
    known = excuses()
    assert len(known) > 8
    for (module, line), of_line in known.items():
        what = [mutant.what for mutant in mutants if (mutant.module, mutant.line) == (module, line)]
        for excuse in of_line:
            assert any(excuse.part in each for each in what), excuse


@pytest.mark.parametrize(
    "comment",
    [
        "# equivalent",
        "# equivalent:",
        "# equivalent (1: one more)",
        "# equivalent (): no part",
        "most = 1  # equivalent: at the end of a line",
    ],
)
def test_another_form_of_an_excuse_is_refused(monkeypatch, tmp_path: Path, comment):
    source = tmp_path / "source.py"
    source.write_text(f"{comment}\nmost = 2\n", encoding="utf-8")
    monkeypatch.setitem(GOLDEN_SOURCES, next(iter(GOLDEN_SOURCES)), source)
    with pytest.raises(ValueError, match=r"source\.py, line 1"):
        excuses()
