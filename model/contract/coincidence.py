# SPDX-License-Identifier: Apache-2.0
"""The rule of coincidence: which windows become events, and what a threshold means for random
light.

The paper (III-A) compares the number of pixels in a window with a threshold; that is `AT_LEAST`.
A sensor may be built with another rule, `Sensor.rule`. The golden model and the RTL ask the rule
about each window. Whatever reasons about light (the controller's bounds, the analytic model, the
estimator of planes) reads `rises`, and nothing else of the rule.
"""

from collections.abc import Callable
from functools import cache
from typing import Any, NamedTuple, TypeVar

import numpy as np

from ..shared.errors import InputError
from ..shared.own_part import check_part

SAMPLES = 4096  # random windows from which the meaning of a rule of a user's own is estimated
SAMPLING_SEED = 1
_Share = TypeVar("_Share", float, np.ndarray)


class Rule:
    """A rule of coincidence, and the base class of a user's own; see docs/extend.md.

    At a threshold of 1, every window becomes an event, by any rule: with coincidence off, the
    threshold is 1. So a rule is only asked about thresholds from 2 on. A map that meets it must
    meet it with one more pixel, too, and with a lower threshold. Rules are equal if class, name
    and version are.

    Attributes
    ----------
    name, version : str
        See `OwnPart`.
    """

    name: str = ""
    version: str = ""

    def meets(self, maps: np.ndarray, threshold: int) -> np.ndarray:
        """bool[n]: which windows become events. maps: bool[n, rows, cols], the pixels of a
        subgroup that are in each.
        """
        raise NotImplementedError

    def least(self, threshold: int) -> int:
        """Return the lowest number of pixels with which a window may become an event."""
        return threshold

    def circuit(self, hits: Any, count: Any, threshold: Any, shape: tuple[int, int]) -> Any:
        """Return the Amaranth value that tells whether the DPCU commits a window: as `meets`, in
        less than a cycle.

        hits: bit row * cols + col is a pixel of the subgroup; count: their number; threshold: a
        signal; shape: rows and columns.
        """
        self.check_circuit()

    def check_circuit(self) -> None:
        """Raise `InputError` if the rule has no circuit."""
        if type(self).circuit is Rule.circuit:
            message = (
                f"sensor.rule = {self.name!r}: has no circuit, so only the engine golden plays it"
            )
            raise InputError(message, field="sensor.rule")

    def judged(self, maps: np.ndarray, threshold: int) -> np.ndarray:
        """bool[n]: as `meets`, for any threshold."""
        if threshold <= 1:
            return np.ones(len(maps), bool)
        return np.asarray(self.meets(maps, threshold), bool)

    def judging_circuit(self, hits: Any, count: Any, threshold: Any, shape: tuple[int, int]) -> Any:
        """Return the same as `circuit`, for any threshold."""
        return (threshold <= 1) | self.circuit(hits, count, threshold, shape)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Rule) and repr(self) == repr(other)

    def __hash__(self) -> int:
        return hash(repr(self))

    def __repr__(self) -> str:
        return f"{type(self).__qualname__}({self.name} {self.version})"


class AtLeast(Rule):
    """The paper's rule: at least as many pixels as the threshold."""

    name = "at-least"
    version = "1"

    def meets(self, maps: np.ndarray, threshold: int) -> np.ndarray:
        return np.count_nonzero(maps, axis=(1, 2)) >= threshold

    def circuit(self, hits: Any, count: Any, threshold: Any, shape: tuple[int, int]) -> Any:
        return count >= threshold

    def judging_circuit(self, hits: Any, count: Any, threshold: Any, shape: tuple[int, int]) -> Any:
        return self.circuit(hits, count, threshold, shape)


AT_LEAST = AtLeast()


def check_rule(rule: object) -> Rule:
    """Return a rule. Raises `InputError`."""
    if not isinstance(rule, Rule):
        raise InputError(
            f"sensor.rule = {rule!r}: must be a Rule of model/contract/coincidence.py",
            field="sensor.rule",
        )
    check_part("sensor.rule", rule)
    return rule


class Rise(NamedTuple):
    """A number of pixels at which the share of windows that become events rises."""

    pixels: int
    share: float  # by which it rises, of all windows with so many pixels at random places


@cache
def rises(rule: Rule, shape: tuple[int, int], threshold: int) -> tuple[Rise, ...]:
    """Return what a threshold means for light that hits the pixels of a subgroup at random; the
    shares sum to 1.

    shape: rows and columns of a subgroup. By the paper's rule, the share rises once, from 0 to 1
    at the threshold. For a rule of a user's own, `SAMPLES` random windows of every size are judged.
    """
    if threshold <= 1:
        return (Rise(1, 1.0),)
    if rule == AT_LEAST:
        return (Rise(threshold, 1.0),)
    pixels = shape[0] * shape[1]
    random = np.random.default_rng(SAMPLING_SEED)
    # the order in which pixels are hit
    place = random.permuted(np.tile(np.arange(pixels), (SAMPLES, 1)), axis=1)
    found = []
    before = 0.0
    for count in range(max(1, rule.least(threshold)), pixels + 1):
        maps = (place < count).reshape(SAMPLES, *shape)
        share = float(rule.judged(maps, threshold).mean())
        if share > before:
            found.append(Rise(count, share - before))
            before = share
        if share == 1.0:
            break
    return tuple(found)


def event_share(rising: tuple[Rise, ...], at_least: Callable[[int], _Share]) -> _Share:
    """Return the share of the windows that become events. at_least: share of those with at least
    so many pixels.
    """
    first, *others = rising or (Rise(1, 0.0),)
    total = first.share * at_least(first.pixels)
    for rise in others:
        total = total + rise.share * at_least(rise.pixels)
    return total
