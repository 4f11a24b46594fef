# SPDX-License-Identifier: Apache-2.0
"""Fates of mutants, and the report that counts them."""

from collections import Counter
from collections.abc import Iterable, Sequence

from attrs import frozen

EQUAL = "equal"  # how `Fate.by` begins for an equivalent mutant
GOLDEN = "golden"  # `Fate.where` of mutants of the golden model; of others it is their block


@frozen
class Fate:
    """Fate of a mutant.

    where: its block, or `GOLDEN`; what: it does; by: the bench that noticed it, `EQUAL` and the
    reason if it is equivalent, '' if it survived.
    """

    where: str
    what: str
    by: str

    @property
    def is_equal(self) -> bool:
        """Return whether the mutant is known to be equivalent."""
        return self.by.startswith(EQUAL)

    @property
    def is_killed(self) -> bool:
        """Return whether a bench noticed the mutant."""
        return bool(self.by) and not self.is_equal

    @property
    def survived(self) -> bool:
        """Return whether nothing noticed the mutant, and nothing excuses it."""
        return not self.by


@frozen
class Count:
    """Numbers of mutants."""

    all: int
    killed: int
    equal: int

    @property
    def survived(self) -> int:
        """Return how many survived."""
        return self.all - self.killed - self.equal

    @property
    def rate(self) -> float | None:
        """Return the share of the killed ones; None if all are equivalent."""
        judged = self.all - self.equal
        return self.killed / judged if judged else None


def count(fates: Sequence[Fate]) -> Count:
    """Count fates."""
    killed = sum(fate.is_killed for fate in fates)
    equal = sum(fate.is_equal for fate in fates)
    return Count(len(fates), killed, equal)


def report(fates: Sequence[Fate], seed: int) -> tuple[str, dict[str, float]]:
    """Return the report as Markdown, and the kill rates: "rtl" and "golden" -> share."""
    lines = [
        f"# Mutants, seed {seed}",
        "",
        "| where | mutants | killed | equivalent | survived |",
        "| --- | --- | --- | --- | --- |",
    ]
    rates = {}
    kinds = {
        "rtl": [fate for fate in fates if fate.where != GOLDEN],
        "golden": [fate for fate in fates if fate.where == GOLDEN],
    }
    for kind, of_kind in kinds.items():
        lines += _rows(of_kind)
        total = count(of_kind)
        if total.rate is not None:
            rates[kind] = total.rate
            lines += _killers(kind, of_kind, total)
    lines += ["## Survivors", ""]
    lines += [f"* {fate.where}: {fate.what}" for fate in fates if fate.survived]
    lines += ["", "## Equivalent", ""]
    lines += [f"* {fate.where}: {fate.what} ({fate.by})" for fate in fates if fate.is_equal]
    return "\n".join([*lines, ""]), rates


def _rows(fates: Sequence[Fate]) -> Iterable[str]:
    """Yield a row of the table for each place."""
    for where in sorted({fate.where for fate in fates}):
        here = count([fate for fate in fates if fate.where == where])
        yield f"| {where} | {here.all} | {here.killed} | {here.equal} | {here.survived} |"


def _killers(kind: str, fates: Sequence[Fate], total: Count) -> list[str]:
    """Return lines that say how many mutants each bench has killed."""
    judged = total.all - total.equal
    by = Counter(fate.by for fate in fates if fate.is_killed)
    killers = ", ".join(f"{number} by {name}" for name, number in by.most_common())
    return [
        "",
        f"{kind}: {total.rate:.1%} of {judged} that are not known to be equivalent were killed:",
        f"{killers}.",
        "",
    ]
