# SPDX-License-Identifier: Apache-2.0
"""Tables of generated pages."""

from collections.abc import Collection, Iterable, Sequence


def table(head: Sequence[object], rows: Iterable[Iterable[object]], left: Collection[int] = (0,)) -> list[str]:
    """Return the lines of a Markdown table. left: columns that are text, not numbers."""
    rule = ["---" if column in left else "---:" for column in range(len(head))]
    return [f"| {' | '.join(map(str, row))} |" for row in (head, rule, *rows)]
