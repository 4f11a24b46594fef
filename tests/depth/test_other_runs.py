# SPDX-License-Identifier: Apache-2.0
"""Depth from arrays that are not those of a run of the configuration: a sentence, no wrong number."""

from functools import cache

import numpy as np
import pytest

from coincid.lab.outcomes import Run
from coincid.lab.setup import Setup
from coincid.model.depth.estimate import estimate_depth
from coincid.model.depth.histograms import pixel_histogram
from coincid.model.shared.errors import InputError

from .equal import assert_equal_depths

METHODS = ("planes", "maximum")


@cache
def run() -> Run:
    return Run(
        Setup.of(
            "flat:5",
            sensor={"rows": 8, "cols": 8},
            frame={"pulses": 50, "link_gbps": 0},
        )
    )


@pytest.mark.parametrize(
    ("sensor", "array"),
    [
        ({"rows": 16}, "opened"),
        ({"cols": 16}, "opened"),
        ({"phases": 8, "offset_phases": 4}, "stamp"),
        ({"phases": 16}, "stamp"),
    ],
)
@pytest.mark.parametrize("method", METHODS)
def test_a_result_of_another_sensor_is_refused(sensor, array, method):
    other = run().config.with_sensor(**sensor)
    with pytest.raises(InputError, match=f"arrays: {array} .* must be that of the run"):
        estimate_depth(run().result, other, method=method)
    with pytest.raises(InputError, match=f"arrays: {array} "):
        pixel_histogram(run().result, other, 0)


def test_a_result_of_more_pulses_is_refused():
    fewer = run().setup.but(frame={"pulses": 20}).config
    with pytest.raises(InputError, match="arrays: pulse is 0 to 49, must be 0 to 19"):
        estimate_depth(run().result, fewer)


@pytest.mark.parametrize(
    ("name", "change"),
    [
        ("stamp", lambda column: column[:-1]),
        ("stamp", lambda column: column.astype(float)),
        ("stamp", lambda column: column - 10_000),
        ("count", lambda column: column + 64),
        ("winner", lambda column: column + 64),
        ("subgroup", lambda column: column + 1),
        ("pulse", lambda column: column[:, None]),
        ("hits", lambda column: column[:, 0]),
        ("hits", lambda column: column.astype(np.int64)),
        ("opened", lambda column: column[0]),
    ],
)
@pytest.mark.parametrize("method", METHODS)
def test_damaged_columns_are_named(name, change, method):
    result = run().result
    with pytest.raises(InputError, match=f"arrays: {name} ") as told:
        estimate_depth({**result, name: change(result[name])}, run().config, method=method)
    assert told.value.field == "arrays"


def test_the_order_of_the_bytes_does_not_matter():
    result = run().result
    swapped = {
        name: result[name].astype(result[name].dtype.newbyteorder(">"))
        for name in ("pulse", "subgroup", "stamp", "count", "winner", "hits")
    }
    for method in METHODS:
        one = estimate_depth(result, run().config, method=method)
        other = estimate_depth({**result, **swapped}, run().config, method=method)
        assert np.array_equal(one.depth_m, other.depth_m, equal_nan=True)


@pytest.mark.parametrize("kind", [np.uint16, np.int32, np.uint64])
@pytest.mark.parametrize("method", METHODS)
def test_the_size_of_the_integers_does_not_matter(method, kind):
    """As in a result that was kept in smaller columns."""
    result = run().result
    names = ("pulse", "subgroup", "stamp", "count", "winner")
    other = {**result, **{name: result[name].astype(kind) for name in names}}
    depths = [estimate_depth(arrays, run().config, method=method) for arrays in (result, other)]
    assert_equal_depths(*depths, ("depth_m", "confidence", "reason", "signal_per_pulse"))
