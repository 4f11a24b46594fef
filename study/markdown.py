# SPDX-License-Identifier: Apache-2.0
"""Tables of the documents' pages."""

from collections.abc import Iterable, Sequence


def table(head: Sequence[object], rows: Iterable[Sequence[object]], left: Sequence[int] = (0,)) -> list[str]:
    """Return the lines of a Markdown table. left: columns that are text, not numbers."""
    rule = ["---" if column in left else "---:" for column in range(len(head))]
    return [f"| {' | '.join(map(str, row))} |" for row in (head, rule, *rows)]
