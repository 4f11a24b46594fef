# SPDX-License-Identifier: Apache-2.0
"""Seeds of arrays that are no squares: rows and columns are alike."""

import numpy as np
import pytest

from coincid.model.depth.seeds import Seeds, find_seeds, seed_scores

TIMES, WALL = 64, 30


def seeds_of(level, light):
    """Return the choices of the pixels, and their scores."""

    def blocks(work):
        work(0, len(level))

    seeds = find_seeds(level, light, blocks)
    return seeds.bin, seed_scores(level, light, seeds, blocks)


def weak_wall(rows, cols):
    """Return levels of noise with a wall that is weaker than the noise, and lights."""
    rng = np.random.default_rng(rows)
    level = rng.normal(0, 1, (rows, cols, TIMES)).astype(np.float32)
    level[:, :, WALL] += 1.5
    return level, rng.integers(3, 6, level.shape).astype(np.uint8)


@pytest.mark.parametrize(("rows", "cols"), [(6, 24), (24, 6)])
def test_neighbours_help_everywhere(rows, cols):
    level, light = weak_wall(rows, cols)
    alone = level.argmax(axis=2) == WALL
    together = np.abs(seeds_of(level, light)[0] - WALL) <= 1
    assert alone.mean() < 0.5
    for half in (
        np.s_[:, : cols // 2],
        np.s_[:, cols // 2 :],
        np.s_[: rows // 2],
        np.s_[rows // 2 :],
    ):
        assert together[half].mean() > 0.9


def test_an_array_on_its_side_has_the_same_seeds():
    level, light = weak_wall(6, 24)
    choices, scores = seeds_of(level, light)
    on_its_side = seeds_of(*(np.ascontiguousarray(one.swapaxes(0, 1)) for one in (level, light)))
    assert np.mean(choices == on_its_side[0].T) > 0.9
    assert np.mean(np.isclose(scores, on_its_side[1].T, atol=0.1)) > 0.9


def test_the_chance_of_a_seed_is_that_of_all_candidates_near_it():
    """Up to `reach` bins away, and never above 1; places without a candidate do not count."""
    bins = np.array([[[5, 7, 2, -1], [0, 1, -1, -1], [-1, -1, -1, -1]]])
    chances = np.array(
        [[[0.5, 0.25, 0.125, 0.9], [0.75, 0.5, 0.9, 0.9], [0.9, 0.9, 0.9, 0.9]]], np.float32
    )
    seeds = Seeds(bins, chances)
    for reach, expected in (
        (0, [0.5, 0.75, 0]),
        (1, [0.5, 1, 0]),
        (2, [0.75, 1, 0]),
        (3, [0.875, 1, 0]),
    ):
        assert seeds.chance(reach).tolist() == [expected]
    assert seeds.bin.tolist() == [[5, 0, -1]]
    np.testing.assert_array_equal(seeds.time(4), [[22, 2, np.nan]])


@pytest.mark.parametrize("tilt", [(0, 1), (1, 0)])
def test_a_wall_that_moves_by_a_bin_from_pixel_to_pixel_supports_its_pixels(tilt):
    """Along rows and along columns: its scores are those of a flat wall."""
    shape = rows, cols = 7, 12
    row, col = np.indices(shape)
    light = np.full((*shape, TIMES), 4, np.uint8)
    scores = []
    for down, right in ((0, 0), tilt):
        level = np.full((*shape, TIMES), -3, np.float32)
        level[row, col, WALL + down * row + right * col] = 2.0
        seeds, score = seeds_of(level, light)
        assert np.array_equal(seeds, WALL + down * row + right * col)
        scores.append(score)
    inside = np.s_[2 : rows - 2, 2 : cols - 2]
    assert scores[1][inside] == pytest.approx(scores[0][inside])
