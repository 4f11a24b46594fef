# SPDX-License-Identifier: Apache-2.0
"""Samples of lanes: turned word by word, and as a waveform."""

import numpy as np
import pytest
from pywellen import Waveform

from coincid.slices.waves import BLOCK, by_word, write_vcd


@pytest.mark.parametrize("words", [1, 7, 64, BLOCK - 1, BLOCK, BLOCK + 1, 3 * BLOCK - 5])
@pytest.mark.parametrize("cycles", [1, 64, 71])
def test_samples_are_turned_bit_by_bit(words, cycles):
    rows = np.random.default_rng(words).integers(0, 1 << 63, (cycles, -(-words // 64)), np.uint64)
    turned = by_word(rows, words)
    word, cycle = np.indices((words, cycles))
    expected = rows[cycle, word // 64] >> (word % 64).astype(np.uint64) & np.uint64(1)
    found = turned[word, cycle // 64] >> (cycle % 64).astype(np.uint64) & np.uint64(1)
    assert turned.shape == (words, -(-cycles // 64))
    assert np.array_equal(found, expected)


class OneWord:
    """A probe of one signal, the lowest bit of the samples."""

    signals = ("bit",)

    class layout:
        words = 1

    def values(self, samples, names):
        return {"bit": samples}


def test_a_waveform_ends_with_its_longest_lane(tmp_path):
    """A lane that ends earlier keeps its last value."""
    lanes = {}
    for scope, bits in {"long": [0, 1, 0, 0, 1, 1, 1], "short": [1, 1, 0]}.items():
        lanes[scope] = np.array(bits, np.uint64)[:, None]
    write_vcd(tmp_path / "w.vcd", OneWord(), lanes, first_cycle=10, cycle_ps=2000)
    shown = {one.full_name: list(one.tv) for one in Waveform(str(tmp_path / "w.vcd")).all_vars()}
    at = {"long.bit": [(10, 0), (11, 1), (12, 0), (14, 1)], "short.bit": [(10, 1), (12, 0)]}
    for name, changes in at.items():
        assert shown[name][1:] == [(2000 * cycle, value) for cycle, value in changes]
    assert (tmp_path / "w.vcd").read_text(encoding="utf-8").split()[-1] == f"#{17 * 2000}"
