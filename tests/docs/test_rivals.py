# SPDX-License-Identifier: Apache-2.0
"""Rivals on the same edges: each against an example by hand; their common parts; the files of the
comparison.
"""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from coincid.lab.outcomes import Run
from coincid.model.contract.edges import Edges, Fate
from coincid.model.contract.parameters import Sensor
from coincid.model.golden.frame import golden_result
from coincid.model.light.light import Light
from docs.studies import comparison, other_schemes
from docs.studies.comparison import SCHEMES, Shot, coarse_peaks, compared
from docs.studies.figures import command as figures
from docs.studies.figures import rivals as studies

from ..random_cases import configured

SENSOR = Sensor(rows=8, cols=16)
PHASES, PERIOD = 32, 250
# (pulse, pixel, tick): subgroup 0 has columns 0 to 7, subgroup 1 the others; row 1 begins at pixel
# 16.
EXAMPLE = [(0, 0, 100), (0, 1, 105), (0, 16, 112), (0, 2, 118), (0, 17, 130), (0, 3, 140)]
EXAMPLE += [(1, 5, 47), (1, 4, 47), (1, 6, 49), (0, 8, 100), (0, 9, 101)]
# Of pixels 0 and 1; the others see nothing.
OF_PIXELS = [
    *((0, 0, tick) for tick in (70, 10, 50, 30)),
    *((1, 0, tick) for tick in (20, 80, 40, 60)),
    (1, 1, 7),
]


def photons(edges=EXAMPLE, pulses=2, sensor=SENSOR):
    columns = (np.array(column, np.int64) for column in zip(*edges, strict=True))
    return other_schemes.macro_pixels(Edges(*columns), sensor, pulses)


def told(words, of):
    """[(subgroup, pulse, stamp, pixels inside)]"""
    return [
        (int(of.subgroup[a]), int(of.pulse[a] % of.pulses), int(stamp), of.inside[a:b].tolist())
        for a, b, stamp in zip(*words, strict=True)
    ]


def test_winner_takes_all_by_hand():
    """100 is in cycle 3, which ends at 127: 105 to 118 find the tree not armed; 130 is the first of
    cycle 4. Both at 47 are stamped.
    """
    words = [(0, 0, 100, [0]), (0, 0, 130, [9]), (0, 1, 47, [4, 5]), (1, 0, 100, [0])]
    assert told(other_schemes.windows(photons(), 1, PHASES), photons()) == words


def test_sliding_window_by_hand():
    """Three photons within 16 ticks: first at 112, which uses up 100 to 112; 118, 130 and 140 are
    too far apart.
    """
    first, within_24, last = (0, 0, 112, [0, 1, 8]), (0, 0, 140, [2, 9, 3]), (0, 1, 49, [4, 5, 6])
    assert told(other_schemes.sliding_window(photons(), 16, 3), photons()) == [first, last]
    assert told(other_schemes.sliding_window(photons(), 24, 3), photons()) == [
        first,
        within_24,
        last,
    ]


def test_photon_counts_by_hand():
    """Clocks of 16 ticks: 47 is in the third, 49 in the fourth; 100 and 105 in the seventh."""
    counts = other_schemes.photon_counts(photons(), 16, 500)
    # subgroup, bin, photons
    rows = [[0, 2, 2], [0, 3, 1], [0, 6, 2], [0, 7, 2], [0, 8, 2], [1, 6, 2]]
    assert np.column_stack([np.argwhere(counts), counts[counts > 0]]).tolist() == rows


def test_first_stamps_by_hand():
    of = photons(OF_PIXELS)
    stamps = [(0, 0, 10, [0]), (0, 0, 30, [0]), (0, 0, 50, [0]), (0, 1, 7, [1])]
    assert told(other_schemes.first_stamps(of, 3), of) == stamps


def test_equi_depth_by_hand():
    """Two of eight stamps per bin: boundaries at the third, fifth and seventh; without stamps at
    the period's end.
    """
    edges = other_schemes.equi_depth(photons(OF_PIXELS), 4, 100)
    assert edges[:3].tolist() == [[0, 30, 50, 70, 100], [0, 7, 7, 7, 100], [0, 100, 100, 100, 100]]


def test_zoomed_counts_by_hand():
    """The second pulse, from tick 30 on in bins of 16 ticks; one pulse counts once in a bin."""
    of = photons([*OF_PIXELS, (1, 0, 41)])
    counts = other_schemes.zoomed_counts(of, range(1, 2), np.full(128, 30), 16, 3)
    assert counts[:2].tolist() == [[1, 1, 0], [0, 0, 0]]


def test_fourier_sums_are_a_spectrum():
    sums = other_schemes.fourier_sums(photons(OF_PIXELS), 8, 100) / other_schemes.CODE_MAX
    histogram = np.bincount([tick for _, pixel, tick in OF_PIXELS if pixel == 0], minlength=100)
    assert np.allclose(sums[0, 1:], np.fft.fft(histogram)[1:5], atol=8 / other_schemes.CODE_MAX)
    assert not sums[2:].any() and not sums[:, 0].any()


def test_pixel_histograms_by_hand():
    words = other_schemes.windows(photons(), 16, PHASES)
    first, second = other_schemes.pixel_histograms(
        photons(), words, words.stamp + 0.5, SENSOR, PERIOD * PHASES
    )
    of_first = [[0, 100], [1, 100], [3, 130], [4, 47], [5, 47], [6, 47], [8, 100], [9, 130]]
    assert np.argwhere(first).tolist() == of_first and np.argwhere(second).tolist() == [
        [0, 100],
        [1, 100],
    ]
    assert first.max() == second.max() == 1


def test_readout_by_hand():
    """A FIFO of two words, two cycles per word. Cycle 3: both subgroups store one; subgroup 0 is
    served until cycle 5, subgroup 1 until 7. Cycle 4: subgroup 0 stores two words in its empty
    FIFO, and the third is lost. Subgroup 2 has a stream of its own, and loses the third word of
    cycle 3.
    """
    sensor = Sensor(rows=8, cols=24, fifo_depth=2, streams=2)
    edges = [(0, 0, 96), (0, 8, 96), (0, 1, 128), (0, 2, 129), (0, 3, 130), (0, 4, 9 * 32)]
    edges += [(0, 16 + k, 96 + k) for k in range(3)]
    of = photons(edges, 1, sensor)
    each = other_schemes.Words(np.arange(9), np.arange(9) + 1, of.tick)
    assert of.tick.tolist() == [96, 128, 129, 130, 288, 96, 96, 97, 98]
    stored = other_schemes.read_out(of, each, sensor, PHASES, PERIOD, 2)
    assert stored.tolist() == [True, True, True, False, True, True, True, True, False]


@settings(max_examples=25)
@given(
    seed=st.integers(0, 1000), window=st.sampled_from((1, 5, 16, 64)), threshold=st.integers(1, 3)
)
def test_windows_are_the_golden_models(seed, window, threshold):
    """They are equal without a full FIFO, and away from the guard at the period's end."""
    rng = np.random.default_rng(seed)
    keys = rng.choice(3 * 128 * 60, 150, replace=False)  # a pixel has at most one edge per cycle
    edges = Edges(
        keys // (128 * 60), keys // 60 % 128, keys % 60 * PHASES + rng.integers(0, PHASES, 150)
    )
    config = configured(
        {"rows": 8, "cols": 16, "fifo_depth": 512},
        {"pulses": 3, "period": 100},
        {"window": window, "threshold": threshold},
    )
    arrays = golden_result(config, edges)
    of = other_schemes.macro_pixels(edges, config.sensor, 3)
    words = other_schemes.windows(of, window, PHASES)
    distinct = np.array([len(set(of.inside[a:b])) for a, b, _ in zip(*words, strict=True)])
    words, distinct = words.chosen(distinct >= threshold), distinct[distinct >= threshold]
    found = np.stack([of.subgroup[words.start], of.pulse[words.start] % 3, words.stamp, distinct])
    golden = np.stack([arrays[name] for name in ("subgroup", "pulse", "stamp", "count")])
    assert np.array_equal(found, golden[:, np.lexsort((golden[2], golden[1], golden[0]))])
    if threshold == 1:
        inside = np.isin(arrays["fate"], (Fate.OPENING, Fate.COUNTED, Fate.DUPLICATE))
        assert sum(words.stop - words.start) == inside.sum()


def test_coarse_peaks():
    """The centre of a peak over its neighbours, above the median; then the second peak."""
    histogram = np.full((1, 40), 5)
    histogram[0, [10, 11, 30]] += [30, 10, 20]
    assert coarse_peaks(histogram, 16, 3.4)[0] == pytest.approx(
        [16 * (10.5 * 30 + 11.5 * 10) / 40, 16 * 30.5]
    )
    assert np.isnan(coarse_peaks(np.zeros((1, 40), int), 16, 3.4)).all()


@pytest.fixture(scope="module")
def wall():
    return Shot(
        Run(
            compared(
                Light(rows=16, cols=16, distance_m=6.0, signal_per_pulse=0.2, background_cps=2e3)
            )
        )
    )


@pytest.mark.parametrize("name", SCHEMES)
def test_every_scheme_finds_a_bright_wall(wall, name):
    found = SCHEMES[name](wall)
    assert found.depth_m.shape == (16, 16, 2) and found.bits > 0
    near = np.abs(found.depth_m[:, :, 0] - 6.0) < 0.15
    assert near.mean() > (0.5 if "Fourier" in name else 0.95)


def test_memory_of_a_histogram_is_bounded(wall, monkeypatch):
    assert SCHEMES["photon counts"](wall).bits <= 4 * comparison.MEMORY_BITS
    monkeypatch.setattr(comparison, "MEMORY_BITS", 6000)
    with pytest.raises(ValueError, match="6500 bits"):
        SCHEMES["photon counts"](wall)


@pytest.mark.long
def test_files_of_the_comparison(tmp_path, monkeypatch):
    small = {
        "SIDE": 16,
        "KLUX": (20.0,),
        "BITS_KLUX": (20.0,),
        "SEEDS": 1,
        "FEW_SEEDS": 1,
        "THRESHOLDS": (2, 3),
    }
    for name, value in (small | {"SEEDS_OF_PULSES": {40: 1, 20: 1}}).items():
        monkeypatch.setattr(studies, name, value)
    monkeypatch.setattr(figures, "COMPARISON", (studies.background, studies.bits))
    figures.write(figures.PAGES["compare"], tmp_path, workers=1)
    files = {
        f"rivals_{stem}.{kind}" for stem in ("background", "bits") for kind in ("csv", "png", "svg")
    }
    assert {path.name for path in tmp_path.iterdir()} == {"index.html", *files}
