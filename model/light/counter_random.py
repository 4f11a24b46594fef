# SPDX-License-Identifier: Apache-2.0
"""Counter-based random numbers: each is a hash of (key, purpose, counter), so the order of
drawing does not matter.

The hash is the output function of SplitMix64 (Steele, Lea, Flood 2014, with Stafford's
constants); keys are chained hashes.
"""

import math
from typing import TypeAlias

import numpy as np

from ..shared.compiled import part

GOLDEN = np.uint64(0x9E3779B97F4A7C15)
Counter: TypeAlias = int | np.int64 | np.uint64
_LAYERS = 256
_LAST_X = 3.6541528853610088  # Marsaglia, Tsang 2000: beginning of the tail with 256 layers
_SHIFT_PURPOSE = np.uint64(40)


@part
def _mix(z: np.uint64) -> np.uint64:
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return z ^ (z >> np.uint64(31))


@part
def key_of(key: np.uint64, index: Counter) -> np.uint64:
    """Return the key of item `index` under `key` (uint64). Numbers of purpose 0 that are drawn
    with `key` would repeat it.
    """
    return _mix(key + (np.uint64(index) + np.uint64(1)) * GOLDEN)


@part
def _bits(key: np.uint64, purpose: int, counter: Counter) -> np.uint64:
    return _mix(key + ((np.uint64(purpose) << _SHIFT_PURPOSE) + np.uint64(counter)) * GOLDEN)


@part
def open_unit(bits: np.uint64) -> float:
    """A uniform number in (0, 1), ends excluded, from a hash: its upper 52 bits."""
    return (np.float64(bits >> np.uint64(12)) + 0.5) * 2.0**-52


@part
def uniform(key: np.uint64, purpose: int, counter: Counter) -> float:
    """A uniform number in (0, 1)."""
    return open_unit(_bits(key, purpose, counter))


@part
def exponential(key: np.uint64, purpose: int, counter: Counter) -> float:
    """An exponential number of mean 1."""
    return -math.log(uniform(key, purpose, counter))


def _ziggurat() -> tuple[np.ndarray, np.ndarray]:
    """Layer borders x and densities exp(-x^2/2) of the ziggurat for the normal law; its layers
    have equal area.
    """

    def density(x: float) -> float:
        return math.exp(-x * x / 2)

    area = _LAST_X * density(_LAST_X) + math.sqrt(math.pi / 2) * math.erfc(_LAST_X / math.sqrt(2))
    x = [area / density(_LAST_X), _LAST_X]
    while len(x) < _LAYERS:
        x.append(math.sqrt(-2 * math.log(area / x[-1] + density(x[-1]))))
    border = np.array(x + [0.0])
    return border, np.exp(-border * border / 2)


_X, _DENSITY = _ziggurat()


@part
def normal(key: np.uint64, purpose: int, counter: Counter) -> float:
    """A normal number of variance 1 (ziggurat: 98.8 % of the numbers cost one hash and one
    product).
    """
    bits = _bits(key, purpose, counter)
    layer = np.int64(bits & np.uint64(_LAYERS - 1))
    z = (2.0 * open_unit(bits) - 1.0) * _X[layer]
    if abs(z) < _X[layer + 1]:
        return z
    return _rare_normal(key_of(bits, counter), layer, z)


@part(inlined=False)
def _rare_normal(key: np.uint64, layer: np.int64, z: float) -> float:
    """The rare branches of `normal`: the tail, the wedge of a layer, or a new attempt."""
    attempt = 0
    while True:
        if layer == 0:
            x = exponential(key, 0, attempt) / _LAST_X
            while 2 * exponential(key, 1, attempt) < x * x:
                attempt += 1
                x = exponential(key, 0, attempt) / _LAST_X
            return _LAST_X + x if z > 0 else -_LAST_X - x
        if _DENSITY[layer] + uniform(key, 2, attempt) * (
            _DENSITY[layer + 1] - _DENSITY[layer]
        ) < math.exp(-z * z / 2):
            return z
        attempt += 1
        bits = _bits(key, 3, attempt)
        layer = np.int64(bits & np.uint64(_LAYERS - 1))
        z = (2.0 * open_unit(bits) - 1.0) * _X[layer]
        if abs(z) < _X[layer + 1]:
            return z
