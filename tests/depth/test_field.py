# SPDX-License-Identifier: Apache-2.0
"""Planes through levels that are known exactly: parabolas around the times of a plane, on arrays that
are no squares.
"""

import numpy as np
import pytest

from coincid.model.depth.patchmatch import (
    HALF,
    PART,
    SLOPE,
    SLOPE_COST,
    Field,
    fit_planes,
    level_on,
)
from coincid.model.depth.refine import refine
from coincid.model.depth.surfaces import Fitter
from coincid.model.shared.threads import Threads

BINS = 32
SIGMA_TICKS = 2.0  # of a pixel's time
DOWN, RIGHT = 0.7, -1.3  # ticks per pixel
SHAPES = [(5, 18), (18, 5)]


def in_blocks(rows):
    def blocks(work):
        for begin in range(0, rows, 4):
            work(begin, min(rows, begin + 4))

    return blocks


def plane_ticks(rows, cols):
    """float64[rows, cols]: the times of a plane."""
    row, col = np.mgrid[:rows, :cols]
    return 300.3 + DOWN * row + RIGHT * col


def field_of(time, sigma_ticks=SIGMA_TICKS):
    """Return the field of parabolas around some times, and its levels."""
    first = np.floor(time).astype(np.int64) - BINS // 2
    middle = first[:, :, None] + np.arange(BINS) + 0.5
    off = (middle - time[:, :, None]) / np.broadcast_to(sigma_ticks, time.shape)[:, :, None]
    levels = (5.0 - off**2 / 2).astype(np.float32)
    return Field.of([levels], [first], 4.0, in_blocks(len(time))), levels


@pytest.mark.parametrize("shape", SHAPES)
def test_a_field_has_the_levels_of_its_pixels_and_nothing_around_them(shape):
    time = plane_ticks(*shape)
    field, levels = field_of(time)
    assert field.best == pytest.approx(levels.max(axis=2))
    assert field.peak[0] == pytest.approx(time, abs=0.501)
    rows, cols = shape
    places = np.s_[HALF : HALF + rows, HALF : HALF + cols]
    own = field.own[0].reshape(rows + 2 * HALF, cols + 2 * HALF, BINS)
    assert own[places] == pytest.approx(levels - levels.max(axis=2, keepdims=True), abs=1e-5)
    first = field.first[0].reshape(own.shape[:2])
    assert np.isfinite(first).sum() == np.isfinite(first[places]).sum() == rows * cols


@pytest.mark.parametrize("shape", SHAPES)
def test_what_neighbours_may_still_add_is_the_sum_of_the_most_of_each(shape):
    """At every pixel and after every part of the taps: with less, a plane is given up too early."""
    rng = np.random.default_rng(5)
    field, _ = field_of(plane_ticks(*shape), rng.choice([0.8, 3.0, 5.0, 11.0], shape))
    rows, cols = shape
    assert len(np.unique(field.reach)) > 1
    most = field.other[0].max(axis=1).reshape(rows + 2 * HALF, cols + 2 * HALF)
    for r, c in np.ndindex(shape):
        reach = field.reach[r, c]
        taps = field.taps[reach, : field.number[reach]]
        at = r + HALF + taps["down"].astype(int), c + HALF + taps["right"].astype(int)
        adds = taps["weight"] * most[at]
        expected = [adds[part:].sum() for part in range(0, len(taps), PART)]
        assert field.left[r, c, : len(expected)] == pytest.approx(expected, rel=1e-4)


@pytest.mark.parametrize("shape", SHAPES)
def test_every_pixel_of_a_plane_has_its_time_slopes_and_error(shape):
    time = plane_ticks(*shape)
    field, levels = field_of(time)
    planes = fit_planes(field, in_blocks(len(time)))
    assert level_on(field, planes) == pytest.approx(levels.max(axis=2), abs=0.5)
    # each off by another part of a tick, so that no surface is like one that was found before
    off = np.random.default_rng(shape[0]).uniform(-0.5, 0.5, shape)
    planes = planes._replace(time=planes.time + off)
    refined = refine(field, planes, in_blocks(len(time)))
    assert refined.planes.time == pytest.approx(time, abs=0.02)
    assert refined.planes.down == pytest.approx(np.full(shape, DOWN), abs=0.02)
    assert refined.planes.right == pytest.approx(np.full(shape, RIGHT), abs=0.02)
    assert np.all((refined.error > 0) & (refined.error < SIGMA_TICKS / 2))


@pytest.mark.parametrize("shape", SHAPES)
def test_a_plane_has_the_score_of_all_pixels_at_its_times(shape):
    """At every pixel: its own level and those of its neighbours, less what the slopes cost."""
    field, _ = field_of(plane_ticks(*shape))
    planes = fit_planes(field, in_blocks(shape[0]))
    rarity = (1 + (planes.down / SLOPE) ** 2) * (1 + (planes.right / SLOPE) ** 2)
    # The neighbours of an exact plane all have their most on it, except for what is between their
    # bins.
    most = field.left[:, :, 0] - SLOPE_COST * np.log(rarity)
    assert most.min() > 3.0
    assert planes.score == pytest.approx(most, rel=0.03)


@pytest.mark.parametrize("rows", [1, 3, 4, 5, 8, 9, 18])
def test_each_row_is_in_one_block(rows):
    """Also where the last block is shorter than the others, or the only one."""
    taken = []
    with Threads(2) as threads:
        fitter = Fitter.of(SIGMA_TICKS, 1000, 100, rows, threads)
        fitter.blocks(lambda begin, end: taken.extend(range(begin, end)))
    assert sorted(taken) == list(range(rows))
