# SPDX-License-Identifier: Apache-2.0
"""Samples of lanes: turned word by word, and as a waveform."""

from types import SimpleNamespace

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


class Numbers:
    """A probe of numbers of any width: each begins at a word of its own."""

    def __init__(self, **widths):
        self.signals = dict(widths)
        self.layout = SimpleNamespace(words=sum(widths.values()))

    def values(self, samples, names):
        firsts = dict(zip(self.signals, np.cumsum([0, *self.signals.values()]), strict=False))
        return {name: samples[firsts[name] :][: self.signals[name]] for name in names}


def samples_of(probe, cycles):
    """Return the samples of a lane whose signals have these numbers."""
    rows = []
    for numbers in cycles:
        bits = "".join(f"{numbers[name]:0{width}b}"[::-1] for name, width in probe.signals.items())
        words = [bits[k : k + 64][::-1] for k in range(0, len(bits), 64)]
        rows.append([int(word, 2) for word in words])
    return np.array(rows, np.uint64)


PROBE = Numbers(wide=70, bit=1, **{"unit.inner.bit": 1, "unit.word": 9})
SHOWN = [
    {"wide": 1 << 69 | 5, "bit": 1, "unit.inner.bit": 0, "unit.word": 300},
    {"wide": 1 << 69 | 5, "bit": 0, "unit.inner.bit": 1, "unit.word": 300},
    {"wide": 1 << 64, "bit": 0, "unit.inner.bit": 1, "unit.word": 511},
]


@pytest.mark.parametrize(
    "names", [None, ["unit.word"], ["wide", "unit.inner.bit", "bit"], ["unit.inner.bit"]]
)
def test_a_waveform_has_the_signals_that_are_named(names, tmp_path):
    """Each in the scope of its unit, with its width and every change; all, if none are named."""
    path = tmp_path / "w.vcd"
    write_vcd(path, PROBE, {"lane": samples_of(PROBE, SHOWN)}, names=names, cycle_ps=10)
    found = {one.full_name: one for one in Waveform(str(path)).all_vars()}
    assert found.keys() == {f"lane.{name}" for name in names or PROBE.signals}
    for name in names or PROBE.signals:
        one = found[f"lane.{name}"]
        assert one.bitwidth == PROBE.signals[name]
        for cycle, numbers in enumerate(SHOWN):
            for at in (10 * cycle, 10 * cycle + 9):
                assert int(one.signal.value_at(at)) == numbers[name], (name, cycle)


def test_a_waveform_of_no_signal_is_empty(tmp_path):
    """It lasts as long as any: a nanosecond per cycle, if nothing else is asked for."""
    write_vcd(tmp_path / "w.vcd", PROBE, {"lane": samples_of(PROBE, SHOWN)}, names=[])
    text = (tmp_path / "w.vcd").read_text(encoding="utf-8")
    assert "$var" not in text
    assert text.split()[-1] == f"#{1000 * len(SHOWN)}"


@pytest.mark.parametrize("lanes", [{}, {"lane": samples_of(PROBE, SHOWN)[:0]}], ids=len)
def test_a_waveform_of_no_cycle_ends_where_it_begins(lanes, tmp_path):
    """Of nothing that was recorded, or not for a single cycle yet."""
    write_vcd(tmp_path / "w.vcd", PROBE, lanes, first_cycle=3, cycle_ps=10)
    text = (tmp_path / "w.vcd").read_text(encoding="utf-8")
    assert text.count("$var") == len(lanes) * len(PROBE.signals)
    assert text.split()[-1] == "#30"


def test_a_waveform_that_fails_leaves_no_file(tmp_path):
    with pytest.raises(KeyError, match="nothing"):
        write_vcd(
            tmp_path / "w.vcd", PROBE, {"lane": samples_of(PROBE, SHOWN)}, names=["bit", "nothing"]
        )
    assert not list(tmp_path.iterdir())
