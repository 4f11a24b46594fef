# SPDX-License-Identifier: Apache-2.0
"""The golden model of the photon source: the generator's period, seeds, and the statistics of 10^7
draws.

`tests/board/test_emulator.py` shows that it equals the RTL.
"""

import numpy as np
import pytest
from attrs import evolve
from scipy import stats

from coincid.board.parameters import LEVEL_BITS, RATE_BITS, SEED_BIT, STATE_BITS, TAPS
from coincid.board.source_model import SourceSettings, _tables, advance, cipher, seeds, source_edges
from coincid.model.shared.errors import InputError

from ..random_cases import configured

# probability that a correct source fails a test; with fixed seeds, the result is always the same
LIKELY = 1e-4
FACTORS = (3, 5, 17, 257, 65537)  # of 2^32 - 1


def config(pulses: int, period: int = 40, **frame):
    return configured(
        {"rows": 8, "cols": 16, "phases": 8, "window_max": 16},
        {"period": period, "pulses": pulses} | frame,
        {"window": 2},
    )


def source(of, background=0, tick=100, level=0, **settings) -> SourceSettings:
    shape = of.sensor.subgroups, of.sensor.pixels
    return SourceSettings(
        background=np.broadcast_to(background, shape[:1]),
        tick=np.broadcast_to(tick, shape),
        level=np.broadcast_to(level, shape),
        **settings,
    )


def compose(a: list[int], b: list[int]) -> list[int]:
    """Return the matrix product of rows as integers over the field of two elements."""
    rows = []
    for row in a:
        total = 0
        for i, other in enumerate(b):
            total ^= other if row >> i & 1 else 0
        rows.append(total)
    return rows


def power(matrix: list[int], exponent: int) -> list[int]:
    result = [1 << i for i in range(STATE_BITS)]
    while exponent:
        if exponent & 1:
            result = compose(result, matrix)
        matrix, exponent = compose(matrix, matrix), exponent >> 1
    return result


def test_generators_have_the_full_period():
    matrix = [sum(1 << tap for tap in taps) for taps in TAPS]
    one, period = power(matrix, 0), (1 << STATE_BITS) - 1
    assert power(matrix, period) == one
    assert all(power(matrix, period // factor) != one for factor in FACTORS)


def test_a_step_is_that_of_the_taps():
    rng = np.random.default_rng(1)
    states = rng.integers(0, 1 << 32, 100, dtype=np.uint32)
    bits = states[:, None] >> np.arange(STATE_BITS, dtype=np.uint32) & 1
    after = sum(
        np.bitwise_xor.reduce(bits[:, list(taps)], axis=1).astype(np.uint64) << np.uint64(i)
        for i, taps in enumerate(TAPS)
    )
    assert np.array_equal(advance(states, _tables()), after.astype(np.uint32))


def test_seeds_differ_in_all_and_are_never_0():
    known = [
        seeds(seed, frame, subgroup, 64)
        for seed in (0, 1, 2)
        for frame in (0, 1)
        for subgroup in (0, 1)
    ]
    states = np.concatenate(known)
    assert len(np.unique(states)) == len(states)
    assert (states >> SEED_BIT & 1).all()
    assert np.array_equal(seeds(1, 0, 0, 16), known[4][:16])
    assert np.array_equal(seeds(1, 0, 0, 192)[:64], known[4])  # each lane has blocks of its own


def test_cipher_changes_half_of_the_bits():
    """One bit of the key, or of either half, changes each bit of a block half of the time."""
    rights = np.arange(2000)
    base = cipher(5, 7, rights)
    for changed in (
        cipher(5 ^ 1 << 31, 7, rights),
        cipher(5, 7 ^ 1 << 16, rights),
        cipher(5, 7, rights ^ 1),
    ):
        flips = (base ^ changed)[:, None] >> np.arange(64, dtype=np.uint64) & np.uint64(1)
        assert abs(flips.mean() - 0.5) < 0.01
        assert np.abs(flips.mean(axis=0) - 0.5).max() < 0.06


def test_background():
    """In 10^7 draws: the rate, uniformity over ticks, and no pixel, pulse or neighbour that stands
    out.
    """
    of = config(pulses=2000)
    rates = np.array([2000, 6000])
    edges = source_edges(of, source(of, background=rates, seed=3), 0)
    draws = 2000 * 40 * 64  # per subgroup
    assert 2 * draws >= 10**7
    subgroup = edges.pixel % 16 // 8
    for s, rate in enumerate(rates):
        mine = subgroup == s
        p = rate / (1 << RATE_BITS)
        assert stats.binomtest(int(mine.sum()), draws, p).pvalue > LIKELY
        for counts in (
            np.bincount(edges.tick[mine], minlength=320),
            np.bincount(edges.pulse[mine], minlength=2000),
            np.unique(edges.pixel[mine], return_counts=True)[1],
        ):
            assert stats.chisquare(counts).pvalue > LIKELY


def test_pixels_and_cycles_are_independent():
    """Pairs of pixels, and pairs of cycles of a pixel, by chi-square; the spectra of neighbours are
    unrelated.
    """
    of = config(pulses=2000)
    edges = source_edges(of, source(of, background=8000, seed=5), 1)
    seen = np.zeros((128, 2000 * 40), np.int8)
    seen[edges.pixel, edges.pulse * 40 + edges.tick // 8] = 1
    for first, second in [
        *((seen[:, :-apart], seen[:, apart:]) for apart in (1, 2, 3, 5, 39, 40, 41, 80, 120)),
        *((seen[:-rows], seen[rows:]) for rows in (1, 2, 15, 16, 17, 64)),
    ]:
        table = np.bincount(2 * first.ravel() + second.ravel(), minlength=4).reshape(2, 2)
        assert stats.chi2_contingency(table, correction=False).pvalue > LIKELY
    spectra = np.fft.rfft(seen - seen.mean(axis=1, keepdims=True), axis=1)[:, 1:]
    for rows in (1, 16):
        a, b = spectra[:-rows], spectra[rows:]
        coherence = np.abs((a * b.conj()).sum(axis=1)) / np.sqrt(
            (np.abs(a) ** 2).sum(axis=1) * (np.abs(b) ** 2).sum(axis=1)
        )
        assert coherence.max() < 5 / np.sqrt(spectra.shape[1])


def test_triples_of_pixels_coincide_as_chance_has_it():
    """The number of pixels of a subgroup that fire in a cycle is binomial, which matters for a
    coincidence sensor.
    """
    of = config(pulses=2000)
    edges = source_edges(of, source(of, background=3000, seed=7), 2)
    mine = edges.pixel % 16 < 8
    together = np.bincount(
        np.bincount(edges.pulse[mine] * 40 + edges.tick[mine] // 8, minlength=80_000), minlength=13
    )
    expected = stats.binom(64, 3000 / (1 << RATE_BITS)).pmf(np.arange(65)) * 80_000
    keep = expected[:13] > 10
    observed, wanted = together[:13][keep], expected[:13][keep]
    wanted *= observed.sum() / wanted.sum()
    assert keep.sum() > 8 and stats.chisquare(observed, wanted).pvalue > LIKELY


def test_echo():
    """Probability per pixel, uniform over its ticks, independent from pulse to pulse; no echo
    before the second cycle.
    """
    of = config(pulses=6000)
    levels = np.tile(np.arange(64) * 4, (2, 1))
    edges = source_edges(of, source(of, tick=101, level=levels, spread=3, seed=9), 0)
    assert set(np.unique(edges.tick)) == set(range(101, 109))
    assert stats.chisquare(np.bincount(edges.tick)[101:]).pvalue > LIKELY
    counts = np.zeros((8, 16), np.int64)
    np.add.at(counts.ravel(), edges.pixel, 1)
    for half in (counts[:, :8], counts[:, 8:]):
        p = levels[0] / (1 << LEVEL_BITS)
        z = (half.ravel() - 6000 * p)[1:] / np.sqrt(6000 * p * (1 - p))[1:]
        assert half.ravel()[0] == 0 and (z**2).sum() < stats.chi2(63).isf(LIKELY)
    seen = np.zeros((128, 6000), np.int8)
    seen[edges.pixel, edges.pulse] = 1
    of_level = seen[32:33]  # one row: pixels with an echo in half of the pulses
    table = np.bincount(2 * of_level[0, :-1] + of_level[0, 1:], minlength=4).reshape(2, 2)
    assert stats.chi2_contingency(table, correction=False).pvalue > LIKELY
    assert len(source_edges(of, source(of, tick=15, level=255), 0)) == 0
    assert source_edges(of, source(of, tick=16, level=255), 0).tick.min() == 16


def test_dead_time():
    of = config(pulses=50, dither_bits=4)
    for dead in (1, 2, 15):
        edges = source_edges(of, source(of, background=60_000, dead_cycles=dead), 0)
        at = of.start_cycles()[edges.pulse] + edges.tick // 8
        order = np.lexsort((at, edges.pixel))
        gaps = np.diff(at[order])[np.diff(edges.pixel[order]) == 0]
        assert gaps.min() == dead


def test_same_light_for_same_settings():
    of = config(pulses=5)
    first, again, other = (
        source_edges(of, source(of, background=3000, seed=4), frame) for frame in (1, 1, 2)
    )
    assert all(
        np.array_equal(getattr(first, name), getattr(again, name))
        for name in ("pulse", "pixel", "tick")
    )
    assert not np.array_equal(first.tick[:100], other.tick[:100])


@pytest.mark.parametrize(
    "bad, says",
    [
        ({"spread": 5}, "spread"),
        ({"dead_cycles": 0}, "dead_cycles"),
        ({"level": 256}, "level"),
        ({"background": -1}, "background"),
    ],
)
def test_settings_out_of_range(bad, says):
    with pytest.raises(InputError, match=says):
        source(config(pulses=1), **bad)


@pytest.mark.parametrize(
    ("name", "high"), [("background", (1 << RATE_BITS) - 1), ("level", 255), ("tick", 8191)]
)
def test_the_ends_of_the_range_of_an_array_are_settings_and_nothing_beyond(name, high):
    """Also where a single pixel is out of range. A fraction is no setting, and is not cut off."""
    of = config(pulses=1)

    def programmed(values):
        return evolve(source(of), **{name: values}).register_writes(of.sensor)

    shape = getattr(source(of), name).shape
    for legal in (0, high):
        programmed(np.full(shape, legal))
    for beyond in (-1, high + 1, 0.5, 1.0):
        values = np.zeros(shape, type(beyond))
        values.flat[-1] = beyond
        with pytest.raises(InputError, match=f"^{name}: must hold integers from 0 to {high}$"):
            programmed(values)


def test_ticks_fit_the_sensor():
    of = config(pulses=1)
    with pytest.raises(InputError, match="from 0 to 8191"):
        source(of, tick=8192).register_writes(of.sensor)
    assert len(evolve(source(of), seed=5).register_writes(of.sensor)) == 3 + 2 * 65


@pytest.mark.parametrize("kind", (np.uint8, np.int16, np.uint16, np.int32, np.uint32))
def test_settings_of_every_type_are_the_same_settings(kind):
    """Numbers of any width of a user's arrays: in the registers and in the predicted light."""
    of = config(pulses=2)
    highest = min(np.iinfo(kind).max, of.sensor.period_max * of.sensor.phases - 1)
    values = {"background": 255, "tick": highest, "level": 255}
    usual = source(of, seed=7, **values)
    typed = source(of, seed=7, **{name: kind(value) for name, value in values.items()})
    assert typed.tick.dtype == kind
    writes = typed.register_writes(of.sensor)
    assert writes == usual.register_writes(of.sensor)
    assert all(type(value) is int for _, value in writes)
    assert max(value for _, value in writes) == highest << LEVEL_BITS | 255
    light = [source_edges(of, settings, 3) for settings in (usual, typed)]
    for name in ("pulse", "pixel", "tick"):
        np.testing.assert_array_equal(*(getattr(edges, name) for edges in light))


def test_the_number_of_a_frame_has_16_bits():
    """Frame 65536 has the light of frame 0, as the sensor counts its frames."""
    of = config(2)
    settings = source(of, background=8000, seed=5)
    for frame in (0, 3):
        first = source_edges(of, settings, frame)
        again = source_edges(of, settings, frame + (1 << 16))
        assert len(first) and np.array_equal(first.tick, again.tick)
        assert np.array_equal(first.pixel, again.pixel)
