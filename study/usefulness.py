# SPDX-License-Identifier: Apache-2.0
"""Says whether a picture is of any use, and if not, what would help: each remedy is simulated."""

from collections.abc import Iterator

import numpy as np
from attrs import evolve, frozen

from ..lab.outcomes import Run
from ..lab.setup import Setup, fixed_thresholds
from ..model.contract.settings import FRAME
from ..model.light.light import NEAREST_M
from ..model.scenes.ambient import ambient_klux

USEFUL_WRONG_MAX = 0.3  # share of wrong pixels up to which a picture shows its scene; our choice
MORE_PULSES = 4
LESS_LIGHT = 0.1
NEARER = 0.5


@frozen(kw_only=True)
class Remedy:
    """A change of the experiment. wrong: share of wrong pixels with it, at the best threshold."""

    told: str
    wrong: float


def is_useful(wrong: float) -> bool:
    """Return whether a picture with this share of wrong pixels shows its scene."""
    return wrong <= USEFUL_WRONG_MAX


def useless_sentence(wrong: float, setup: Setup, window: int, workers: int = 1) -> str:
    """Return sentences about a scene of which no setting leaves a useful picture.

    wrong: share of wrong pixels at the best setting. window: in ticks, with which the remedies are
    simulated. workers: threads, which do not change the sentences.
    """
    remedies = [
        Remedy(told=told, wrong=_least_wrong(changed, window, workers))
        for told, changed in _changes(setup)
    ]
    remedies.sort(key=lambda one: one.wrong)
    found = [f"{one.told} ({one.wrong:.1%} wrong)" for one in remedies]
    if any(is_useful(one.wrong) for one in remedies):
        help_told = f"What would help: {'; '.join(found)}."
    else:
        help_told = f"None of these is enough by itself: {'; '.join(found)}."
    distance_m = setup.seen.truth_m
    low_m, middle_m, high_m = np.nanpercentile(distance_m, (0, 50, 100))
    return (
        f"No setting leaves a useful picture: at best, {wrong:.1%} of the pixels are wrong."
        f" {help_told} The distances are {low_m:.3g} to {high_m:.3g} m, {middle_m:.3g} m in the"
        " middle; if those of your scene are others, give the unit of the file (--unit)."
    )


def _changes(setup: Setup) -> Iterator[tuple[str, Setup]]:
    """Yield what could help, each with the setup that has it."""
    config, scene = setup.config, setup.seen
    setup = setup.but(
        frame={"frames": 1}, subgroup={"auto": False, "coincidence": True}, engine="golden"
    )
    pulses = min(MORE_PULSES * config.pulses, FRAME["pulses"].limits(config.sensor)[1])
    if pulses > config.pulses:
        told = f"{pulses} laser pulses per frame instead of {config.pulses}"
        yield told, setup.but(config=setup.config.with_pulses(pulses))
    klux = ambient_klux(setup.klux, scene.rows, scene.cols) * np.ones((scene.rows, scene.cols))
    if setup.light is None and klux.any():
        told = f"a tenth of the ambient light, {LESS_LIGHT * klux.mean():.2g} klux"
        yield told, setup.but(klux=LESS_LIGHT * klux)
    if setup.light is None and scene.transient is None:
        nearer_m = np.maximum(NEARER * scene.distance_m, NEAREST_M)
        told = f"half the distance, {np.nanmedian(nearer_m):.3g} m in the middle"
        yield told, setup.but(scene=evolve(scene, distance_m=nearer_m))


def _least_wrong(setup: Setup, window: int, workers: int) -> float:
    """Return the share of wrong pixels at the best fixed threshold."""
    run = Run(setup, workers=workers)
    shares = []
    config = setup.config
    # Thresholds and windows change nothing in counts.
    thresholds = [1] if config.counting else fixed_thresholds(config.sensor)
    for threshold in thresholds:
        tried = run.but(subgroup={"threshold": threshold, "window": window})
        share = tried["wrong_share"]
        shares.append(1.0 if share is None else float(share))
    return min(shares)
