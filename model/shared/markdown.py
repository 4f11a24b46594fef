# SPDX-License-Identifier: Apache-2.0
"""Tables of generated pages."""

import textwrap
from collections.abc import Collection, Iterable, Sequence

COLUMNS = 100  # of a page


def table(
    head: Sequence[object], rows: Iterable[Iterable[object]], left: Collection[int] = (0,)
) -> list[str]:
    """Return the lines of a Markdown table. left: columns that are text, not numbers."""
    rule = ["---" if column in left else "---:" for column in range(len(head))]
    return [f"| {' | '.join(map(str, row))} |" for row in (head, rule, *rows)]


def text_table(
    head: Sequence[object], rows: Iterable[Iterable[object]], left: Collection[int] = (0,)
) -> str:
    """Return a Markdown table as text, for `tools.pages.put`."""
    return "\n".join(table(head, rows, left))


def paragraph(text: str) -> str:
    """Return a paragraph, wrapped as the pages are."""
    return textwrap.fill(text, COLUMNS, break_long_words=False, break_on_hyphens=False)
