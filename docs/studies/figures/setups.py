# SPDX-License-Identifier: Apache-2.0
"""Setups of the figures, and the outcome that a figure reads from a run."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from coincid.lab.outcomes import Run
from coincid.lab.setup import Setup, seeded

from .sections import Row

SCENE = "five-objects"
# Pulses of a frame (paper IV); a second run has MANY times as many, which shows the share of noise.
PULSES, MANY = 100, 8
OF_SENSOR = ("events", "dropped", "dropped_share", "events_per_s")
OF_DEPTH = ("wrong_share", "right_share", "found_share", "found_rms_m")


class Outcome(NamedTuple):
    """The last frame of a run.

    measures: by name; those of `OF_DEPTH` are for the first estimator, and as NAME_ESTIMATOR for
    each. NaN: no value.
    depth_m, wrong: float64[rows, cols] and bool[rows, cols], by estimator.
    """

    measures: dict[str, float]
    depth_m: dict[str, np.ndarray]
    wrong: dict[str, np.ndarray]


def outcome(run: Run) -> Outcome:
    """Return the outcome of a run; campaigns read runs with this function."""
    frames = {str(estimator): run.frame(estimator=estimator) for estimator in run.setup.estimators}
    measures = {name: run[name] for name in (OF_SENSOR + OF_DEPTH if frames else OF_SENSOR)}
    measures |= {
        f"{name}_{estimator}": frame[name]
        for estimator, frame in frames.items()
        for name in OF_DEPTH
    }
    return Outcome(
        {name: np.nan if value is None else value for name, value in measures.items()},
        {name: frame.depth_m for name, frame in frames.items()},
        {name: frame.wrong for name, frame in frames.items()},
    )


def cases(
    seeds: int = 1,
    pulses: int = PULSES,
    *,
    scene: str = SCENE,
    frame: dict[str, Any] | None = None,
    **others: Any,
) -> list[Setup]:
    """Return setups with the seeds from 1 on; only one setup if `pulses` is not `PULSES`. others:
    for `Setup.of`.
    """
    setup = Setup.of(scene, frame={"pulses": pulses} | (frame or {}), **others)
    return seeded(setup, seeds if pulses == PULSES else 1)


def mean(outcomes: Sequence[Outcome], measure: str) -> float:
    """Return the mean of a measure."""
    return float(np.mean([one.measures[measure] for one in outcomes]))


def mean_rows(
    keys: Sequence[str], measures: Sequence[str], table: Mapping[tuple[Any, ...], Sequence[Outcome]]
) -> list[Row]:
    """Return the rows of a CSV: one per key of `table`, with the means of measures. Measures that
    outcomes lack are empty.
    """
    rows: list[Row] = [(*keys, *measures)]
    for key, outcomes in table.items():
        has = outcomes[0].measures
        rows.append((*key, *(mean(outcomes, name) if name in has else "" for name in measures)))
    return rows
