# SPDX-License-Identifier: Apache-2.0
"""Numbers that are hashes of a key, a purpose and a counter have the laws that they are named for,
as far out as millions of them reach.
"""

import numpy as np
import pytest
from scipy import special, stats

from coincid.model.light.counter_random import exponential, key_of, normal, uniform
from coincid.model.shared.compiled import njit

SEED, PURPOSE = 20_261_129, 3
NUMBER = 4_000_000
TAIL = 3.6541528853610088  # where the ziggurat ends
LAWS = {
    "uniform": (0, lambda x: np.clip(x, 0, 1), np.linspace(0, 1, 65)),
    "exponential": (1, lambda x: -special.expm1(-np.maximum(x, 0)), np.linspace(0, 12, 61)),
    "normal": (2, special.ndtr, np.linspace(-4.4, 4.4, 89)),
    "tails of normal": (2, special.ndtr, np.array([-4.5, -4, -TAIL, TAIL, 4, 4.5])),
}


@njit
def drawn_numbers(seed: np.uint64, number: int) -> np.ndarray:
    found = np.empty((3, number))
    for k in range(number):
        key = key_of(seed, k)
        found[0, k] = uniform(key, PURPOSE, k % 5)
        found[1, k] = exponential(key, PURPOSE + 1, k % 5)
        found[2, k] = normal(key, PURPOSE + 2, k % 5)
    return found


@pytest.fixture(scope="module")
def numbers():
    return drawn_numbers(np.uint64(SEED), NUMBER)


@pytest.mark.parametrize(("row", "share_below", "borders"), LAWS.values(), ids=LAWS)
def test_numbers_have_their_law(numbers, row, share_below, borders):
    """In every bin, and before the first one and behind the last."""
    borders = np.concatenate([[-np.inf], borders, [np.inf]])
    expected = NUMBER * np.diff(share_below(borders))
    found, _ = np.histogram(numbers[row], borders)
    possible = expected > 0
    assert not found[~possible].any()
    assert stats.chisquare(found[possible], expected[possible]).pvalue > 1e-3


def test_numbers_of_other_purposes_tell_nothing_of_each_other(numbers):
    assert np.abs(np.corrcoef(numbers) - np.eye(3)).max() < 5 / np.sqrt(NUMBER)
    assert numbers[0].min() > 0 and numbers[0].max() < 1
