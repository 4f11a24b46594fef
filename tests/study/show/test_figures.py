# SPDX-License-Identifier: Apache-2.0
"""Figures of the views: what lies where on arrays that are no squares, and scales that all views
share.
"""

from itertools import permutations
from types import SimpleNamespace

import numpy as np
import pytest
from bokeh.models import ColumnDataSource

from coincid.model.contract.config import parse_config
from coincid.model.contract.pixels import pixel_table
from coincid.study.show.figures import (
    COUNTS,
    LIGHT,
    MAPS,
    MapFigure,
    cursor_columns,
    map_columns,
    map_scales,
)

ROWS, COLS = 12, 20
CONFIG = parse_config({"sensor": {"rows": ROWS, "cols": COLS, "subgroup": [4, 10]}})
NAMES = (*MAPS, *LIGHT)


def view_of(seed, scale=1.0):
    """Return a view whose maps are all different."""
    rng = np.random.default_rng(seed)
    maps = {name: scale * (k + rng.random((ROWS, COLS))) for k, name in enumerate(NAMES)}
    reason = rng.integers(0, 3, (ROWS, COLS), np.uint8)
    return SimpleNamespace(config=CONFIG, reason=reason, **maps)


def covered(rectangle):
    """Return the flat numbers of the pixels in a rectangle of `cursor_columns`."""
    x, y, width, height = (rectangle[name][0] for name in "xywh")
    row, col = np.indices((ROWS, COLS))
    inside = (abs(row - y) <= (height - 1) / 2) & (abs(col - x) <= (width - 1) / 2)
    return np.flatnonzero(inside)


@pytest.mark.parametrize("pixel", [0, 19, 47, 103, 139, ROWS * COLS - 1])
def test_the_cursor_frames_the_pixel_and_its_subgroup(pixel):
    at, around = cursor_columns(view_of(1), *divmod(pixel, COLS))
    assert covered(at).tolist() == [pixel]
    subgroup = pixel_table(CONFIG.sensor).subgroup
    assert covered(around).tolist() == np.flatnonzero(subgroup == subgroup[pixel]).tolist()


def test_maps_have_the_shape_of_the_array():
    view = view_of(1)
    columns = map_columns(view)
    assert (columns["dw"], columns["dh"]) == ([COLS], [ROWS])
    for name in NAMES:
        assert np.array_equal(columns[name][0], getattr(view, name).astype(np.float32))
    row, col = np.indices((ROWS, COLS))
    assert np.array_equal(columns["row"][0], row)
    assert np.array_equal(columns["col"][0], col)
    assert np.array_equal(columns["subgroup"][0].ravel(), pixel_table(CONFIG.sensor).subgroup)


def test_all_views_share_a_scale_that_holds_them_in_any_order():
    views = [view_of(1), view_of(2, scale=3.0), view_of(3, scale=0.2)]
    scales = map_scales(views)
    for order in permutations(views):
        assert map_scales([*order]) == scales
    for name in ("truth_m", *COUNTS):
        low, high = scales[name]
        assert all(low <= getattr(one, name).min() for one in views)
        assert all(getattr(one, name).max() <= high for one in views)
    assert scales["truth_m"] == scales["depth_m"]


@pytest.mark.parametrize("shows", MAPS)
def test_a_map_stands_upright_and_has_the_scale_that_it_is_given(shows):
    empty = ColumnDataSource({})
    one = MapFigure(shows, "map", ColumnDataSource(map_columns(view_of(1))), empty, empty)
    one.show(view_of(1), (0, 20.0), "A: ")
    across, down = one.figure.x_range, one.figure.y_range
    assert (across.start, across.end) == (-0.5, COLS - 0.5)
    assert (down.start, down.end) == (ROWS - 0.5, -0.5)
    assert (one.mapper.low, one.mapper.high) == (0, 20.0)
    assert one.figure.title.text == f"A: {MAPS[shows][0]}"
