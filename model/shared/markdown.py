# SPDX-License-Identifier: Apache-2.0
"""Tables of generated pages in Markdown."""

from collections.abc import Iterable, Sequence


def markdown_table(head: Sequence[str], rows: Iterable[Iterable[object]], words: int = 1) -> list[str]:
    """Return the lines of a table. The columns from number `words` on hold numbers."""
    marks = ["---" if column < words else "---:" for column in range(len(head))]
    return [f"| {' | '.join(map(str, row))} |" for row in (head, marks, *rows)]
