# SPDX-License-Identifier: Apache-2.0
"""Writes the answer of `coincid advise` for the five objects into docs/advise.md."""

import textwrap

from coincid.lab.setup import Setup
from coincid.model.shared.markdown import COLUMNS
from coincid.study.advise import advise
from coincid.tools.pages import put

SCENE, KLUX = "five-objects", 50.0


def make() -> None:
    """Write the answer into its page."""
    sentence = advise(Setup.of(SCENE, klux=KLUX), klux=KLUX).sentence
    put(
        "docs/advise.md",
        "answer",
        textwrap.fill(sentence, COLUMNS, initial_indent="> ", subsequent_indent="> "),
    )
