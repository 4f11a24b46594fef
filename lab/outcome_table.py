# SPDX-License-Identifier: Apache-2.0
"""Outcomes of a campaign as one labelled table (Arrow; `.to_pandas()` for notebooks). Needs the
extra `sweep`.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import pyarrow as pa

from ..model.shared.errors import told_number
from .measures import MEASURES, Number

COLUMN_TYPES = {int: pa.int64(), float: pa.float64()}
REAL_SETTINGS = ("klux", "clock_mhz", "frame.clock_mhz")  # an integer among their values is a float


def to_table(
    varied: Sequence[Mapping[str, Any]],
    found: Sequence[Mapping[str, Number]],
    **texts: tuple[str, list[str]],
) -> pa.Table:
    """Return one row per setup: the values that vary, then its measures. The metadata of each
    column has its meaning.

    varied, found: one mapping per setup, all with the same names; those of `found` are names of
    `MEASURES`. A measure without a value is null, so counts stay integers. texts: further columns
    by name, each as (meaning, values).
    """
    columns, fields = [], []
    for name in varied[0] if varied else ():
        columns.append(_varied([values[name] for values in varied], real=name in REAL_SETTINGS))
        fields.append(pa.field(name, columns[-1].type, metadata={"meaning": "swept"}))
    for name in found[0] if found else ():
        columns.append(
            pa.array([outcome[name] for outcome in found], COLUMN_TYPES[MEASURES[name].kind])
        )
        fields.append(
            pa.field(name, columns[-1].type, metadata={"meaning": MEASURES[name].meaning})
        )
    for name, (meaning, values) in texts.items():
        columns.append(pa.array(values, pa.string()))
        fields.append(pa.field(name, pa.string(), metadata={"meaning": meaning}))
    return pa.table(columns, schema=pa.schema(fields))


def _varied(values: list[Any], real: bool) -> pa.Array:
    """Return a column of values. real: numbers become floats; if some values are texts (light
    maps), all become texts.
    """
    if real and any(isinstance(value, str) for value in values):
        return pa.array(
            [value if isinstance(value, str) else told_number(value) for value in values],
            pa.string(),
        )
    return pa.array(values, pa.float64() if real else None)
