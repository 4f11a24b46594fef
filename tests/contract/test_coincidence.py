# SPDX-License-Identifier: Apache-2.0
"""Rules of coincidence of a user's own: which are the same, and what they are asked."""

import numpy as np
import pytest

from coincid.model.contract.coincidence import AT_LEAST, AtLeast, Rise, Rule, event_share, rises
from coincid.model.contract.config import own_rule
from coincid.model.contract.parameters import Sensor

SHAPE = (4, 4)


class More(Rule):
    """So many pixels more than the threshold, of which the version tells."""

    name = "more"

    def __init__(self, version):
        self.version = version

    def meets(self, maps, threshold):
        assert threshold > 1
        return maps.sum(axis=(1, 2)) >= threshold + int(self.version)


class Other(More):
    """Another class of the same name."""


class Never(Rule):
    """No window at all."""

    name, version = "never", "1"

    def meets(self, maps, threshold):
        return np.zeros(len(maps), bool)


class EveryRow(Rule):
    """Light in every row, at any threshold."""

    name, version = "every row", "1"

    def meets(self, maps, threshold):
        return maps.any(axis=2).all(axis=1)


def test_random_windows_have_the_rows_and_columns_of_a_subgroup():
    """By counting: of 15 pairs of pixels in two rows of three, 9 light both rows, and of 20
    triples 18.
    """
    found = rises(EveryRow(), (2, 3), 2)
    assert [rise.pixels for rise in found] == [2, 3, 4]
    assert [rise.share for rise in found] == pytest.approx([0.6, 0.3, 0.1], abs=0.03)


def test_rules_are_the_same_if_class_name_and_version_are():
    """What is kept for a rule is not that of another version."""
    assert More("1") == More("1")
    assert hash(More("1")) == hash(More("1"))
    others = [More("2"), Other("1"), AT_LEAST, "More(more 1)"]
    assert all(More("1") != other for other in others)
    assert Sensor(rule=More("1")) != Sensor(rule=More("2"))
    assert AtLeast() == AT_LEAST
    for version in ("0", "1", "3"):
        assert rises(More(version), SHAPE, 2) == (Rise(2 + int(version), 1.0),)


def test_a_report_names_a_rule_of_ones_own_with_its_version():
    assert own_rule(Sensor()) == {}
    assert own_rule(Sensor(rule=More("7"))) == {"rule": "more 7"}


@pytest.mark.parametrize("threshold", [0, 1])
def test_at_the_lowest_threshold_every_window_is_an_event_by_any_rule(threshold):
    """And the rule is not asked."""
    maps = np.zeros((3, *SHAPE), bool)
    for rule in (More("1"), Never(), AT_LEAST):
        assert rule.judged(maps, threshold).tolist() == [True] * 3
        assert rises(rule, SHAPE, threshold) == (Rise(1, 1.0),)
    assert Never().judged(maps, 2).tolist() == [False] * 3


@pytest.mark.parametrize("threshold", [2, 3, 16])
def test_by_the_papers_rule_as_many_pixels_as_the_threshold_are_an_event(threshold):
    """Wherever they are in the subgroup."""
    rng = np.random.default_rng(threshold)
    place = rng.permuted(np.tile(np.arange(16), (17, 1)), axis=1)
    maps = (place < np.arange(17)[:, None]).reshape(17, *SHAPE)
    assert AT_LEAST.judged(maps, threshold).tolist() == [n >= threshold for n in range(17)]


def test_the_share_of_events_is_the_sum_over_all_rises():
    """Of a rule that no window meets it is 0."""
    share = {1: 0.9, 2: 0.5, 5: 0.25}.__getitem__
    assert event_share((Rise(2, 0.5), Rise(5, 0.4)), share) == pytest.approx(0.25 + 0.1)
    assert rises(Never(), SHAPE, 2) == ()
    assert event_share((), share) == 0
