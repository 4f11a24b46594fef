# SPDX-License-Identifier: Apache-2.0
"""Sets the law of confidence (`model/depth/belief.py`) on random scenes, and tries it on others.

`python -m docs.studies.confidence` prints the weights of the law, and writes tables for scenes that
were not used to set them, and a picture, into docs/depth.md. It needs the extra `raytrace`. Half of
the random scenes have one distance per pixel, like a depth file. In the other half a pixel sees
many points, as it does behind a lens, so surfaces mix at their edges, and slanted surfaces widen
the pulse. Further rooms have a floor, a ceiling, walls and boxes, seen in perspective.
"""

from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import numpy as np

from coincid.lab.campaign import Processes, campaign
from coincid.lab.outcomes import Run
from coincid.lab.setup import SETTLING, Setup
from coincid.model.depth.arrivals import SYSTEM_FWHM_S
from coincid.model.depth.belief import LAW, chance_of_right
from coincid.model.depth.estimate import find_returns
from coincid.model.depth.methods import METHODS
from coincid.model.depth.quality import off_surfaces, wrong_pixels
from coincid.model.scenes.scene import Scene
from coincid.model.scenes.transient import dominant_surface_m
from coincid.model.shared.markdown import text_table
from coincid.model.shared.threads import Threads
from coincid.study.palette import GREY
from coincid.study.plot_style import new_figure, save_figure, style
from coincid.tools.pages import counted, picture, put

from .surfaces import analytic_scenes

SIDE, POINTS = 32, 4  # pixels of the array, and points per pixel where surfaces mix, both per side
SET, TRIED = range(33, 193), range(1, 33)  # seeds of random scenes
BUILT_IN = (
    ("five-objects", 50.0),
    ("five-objects", 100.0),
    ("sun-and-shade", 100.0),
    ("letter-f", 50.0),
    ("flat:25,0.3", 20.0),
)
ANALYTIC_KLUX = 50.0
# Runs that also set the law: scene, klux, frame, threshold.
REAL: tuple[tuple[str, float, dict[str, float], int], ...] = (
    *(
        ("ray:five-objects", klux, {"link_gbps": link}, 2)
        for klux in (10.0, 50.0)
        for link in (0.0, 8.0)
    ),
    ("ray:five-objects", 50.0, {"pulses": 400}, 2),
    ("ray:glass", 50.0, {}, 2),
    ("tunnel", 100.0, {}, 2),
    ("tunnel", 100.0, {"link_gbps": 8.0}, 3),
)
REAL_SEEDS, REAL_COUNT = (1, 2, 3), 2  # each of these runs counts twice
RAY_TRACED, RAY_KLUX, RAY_SEEDS = ("five-objects", "glass", "fog"), 50.0, range(101, 104)  # tried
# Rooms in perspective that also set the law, each with these thresholds and numbers of pulses.
SEEN_SEEDS, SEEN_THRESHOLDS, SEEN_PULSES = range(20, 26), (1, 2, 3), (100, 1000)
HALF_VIEW_DEG = 22.5
EASE = 1e-3  # weight of the prior, which draws all weights of the law to 0
ROUNDS = 30
NINETY = (0.85, 0.95)  # range of confidences that count as 90 %
BINS, PIXELS_MIN = (0.0, 0.3, 0.5, 0.7, 0.85, 0.95, 0.98, 1.01), 100  # of the picture
PICTURE = "docs/images/depth_confidence.png"


class Seen(NamedTuple):
    """The pixels of a run with depth and truth, by method. features: of the law, float64[n,
    features]. right: bool[n].

    on_surface: bool[n], whether the depth is on any surface that the pixel sees.
    """

    features: dict[str, np.ndarray]
    right: dict[str, np.ndarray]
    on_surface: dict[str, np.ndarray]


def random_setup(seed: int) -> Setup:
    """Return a random room under random settings."""
    rng = np.random.default_rng(seed)
    points = POINTS if seed % 2 else 1
    side = SIDE * points
    y, x = (np.mgrid[:side, :side] + 0.5) / side
    slanted = rng.choice([0.0, 0.5, 1.0])
    distance_m, reflectivity = _surface(rng, x, y, rng.uniform(5, 9), slanted)
    for _ in range(rng.integers(0, 8)):
        top, left, high, wide = *rng.uniform(0, 0.9, 2), *rng.uniform(0.08, 0.45, 2)
        inside = (y > top) & (y < top + high) & (x > left) & (x < left + wide)
        near_m, albedo = _surface(rng, x, y, rng.uniform(2.5, 6), slanted)
        inside &= near_m < distance_m
        distance_m, reflectivity = (
            np.where(inside, near_m, distance_m),
            np.where(inside, albedo, reflectivity),
        )
    distance_m, reflectivity = (
        part.reshape(SIDE, points, SIDE, points).swapaxes(1, 2).reshape(SIDE, SIDE, points**2)
        for part in (distance_m * rng.choice([1.0, 1.5, 3.0]), reflectivity)
    )
    threshold, auto = int(rng.choice([0, 1, 2, 2, 3])), bool(rng.random() < 0.2)
    return Setup.of(
        Scene(name=f"room {seed}", distance_m=distance_m, reflectivity=reflectivity / points**2),
        sensor={"rows": SIDE, "cols": SIDE},
        frame={
            "frames": SETTLING + 1 if auto else 1,
            "pulses": int(rng.choice([50, 100, 200, 400])),
            "link_gbps": float(rng.choice([0, 8])),
            "format": str(rng.choice(["id", "id", "full"])),
        },
        subgroup={"coincidence": threshold > 0, "threshold": max(1, threshold), "auto": auto},
        klux=float(rng.choice([1, 10, 50, 100])),
        seed=seed,
        estimators=(),
    )


def perspective_setup(seed: int, threshold: int, pulses: int) -> Setup:
    """Return a random room in perspective, at its own size or three times as large."""
    larger = 3.0 if (seed + threshold) % 2 else 1.0
    return Setup.of(
        scene_in_perspective(seed, larger),
        sensor={"rows": SIDE, "cols": SIDE},
        frame={"pulses": pulses, "format": "compact", "link_gbps": 0},
        subgroup={"threshold": threshold},
        klux=(50.0, 10.0)[(seed // 2 + threshold) % 2],
        seed=seed,
        estimators=(),
    )


def scene_in_perspective(seed: int, larger: float = 1.0) -> Scene:
    """Return a random room in perspective, so many times as large as a room for people."""
    distance_m, reflectivity = _room_in_perspective(seed)
    return Scene(name=f"view {seed}", distance_m=distance_m * larger, reflectivity=reflectivity)


def _room_in_perspective(seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Return distance and reflectivity, float64[SIDE, SIDE], of a room with boxes on its floor."""
    rng = np.random.default_rng(1000 + seed)
    view = np.tan(np.radians(HALF_VIEW_DEG)) * (2 * (np.arange(SIDE) + 0.5) / SIDE - 1)
    right, down = np.meshgrid(view, view)
    floor_m = rng.uniform(1, 2.5)
    wall_m = rng.uniform(2, 5)
    back_m = rng.uniform(5, 16)
    ceiling_m = rng.uniform(1.5, 4)
    z_m = np.full(right.shape, back_m)
    reflectivity = np.full(right.shape, rng.uniform(0.1, 0.8))
    planes = (
        (floor_m, down, (0.05, 0.6)),
        (ceiling_m, -down, (0.3, 0.8)),
        (wall_m, -right, (0.1, 0.8)),
        (wall_m, right, (0.1, 0.8)),
    )
    for away_m, towards, albedos in planes:
        there_m = away_m / np.maximum(towards, 1e-9)
        albedo = rng.uniform(*albedos)
        seen = (towards > 0) & (there_m < z_m)
        z_m[seen] = there_m[seen]
        reflectivity[seen] = albedo
    for _ in range(rng.integers(2, 7)):
        near_m = rng.uniform(2.5, back_m - 0.3)
        middle_m = rng.uniform(-wall_m, wall_m)
        wide_m = rng.uniform(0.2, 1.5)
        high_m = rng.uniform(0.3, 2)
        albedo = rng.uniform(0.05, 0.9)
        box_m = near_m / (1 - rng.uniform(-0.8, 0.8) * right)  # its face is turned
        inside = (np.abs(right * box_m - middle_m) < wide_m / 2) & (down * box_m > floor_m - high_m)
        seen = inside & (box_m < z_m) & (box_m > 1.5)
        z_m[seen] = box_m[seen]
        reflectivity[seen] = albedo
    return z_m * np.sqrt(1 + right**2 + down**2), reflectivity


def _surface(
    rng: np.random.Generator, x: np.ndarray, y: np.ndarray, distance_m: float, slanted: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return distance and reflectivity of a plane. It is slanted with the probability `slanted`,
    and sometimes has patches.
    """
    slopes = rng.normal(0, 1.5, 2) * (rng.random() < slanted)
    plane_m = np.maximum(distance_m + slopes[0] * (x - 0.5) + slopes[1] * (y - 0.5), 1.0)
    albedo = np.exp(rng.uniform(np.log(0.05), np.log(0.8)))
    if rng.random() < 0.3:
        patches = np.exp(rng.uniform(np.log(0.05), np.log(0.8), (8, 8)))
        return plane_m, patches[(y * 8).astype(int), (x * 8).astype(int)]
    return plane_m, np.full(x.shape, albedo)


def truth_m(scene: Scene) -> np.ndarray:
    """float64[rows, cols]: the surface that most points of a pixel see, in metres; NaN = none."""
    if scene.distance_m.shape[2] == 1:
        return scene.truth_m
    return dominant_surface_m(scene.distance_m.reshape(-1, scene.distance_m.shape[2])).reshape(
        scene.truth_m.shape
    )


def look(run: Run) -> Seen:
    """Return the pixels of the last frame as the law sees them."""
    right_m, frame = truth_m(run.scene), run.config.frames - 1
    tick_m = run.config.tick_m
    features, right, on_surface = {}, {}, {}
    for method in METHODS:
        with Threads(1) as alone:
            found = find_returns(
                run.result,
                run.config,
                method,
                "map",
                frame,
                returns=1,
                threads=alone,
                system_fwhm_s=SYSTEM_FWHM_S,
            )
            signs = found.signs(run.config, alone)
        known = signs.known & ~np.isnan(right_m)
        features[method] = signs.features[known]
        depth_m = found.ticks[:, :, 0] * tick_m
        right[method] = ~wrong_pixels(depth_m, right_m)[known]
        on_surface[method] = ~off_surfaces(depth_m, run.scene.surfaces_m)[known]
    return Seen(features, right, on_surface)


def law(seen: Sequence[Seen], method: str) -> np.ndarray:
    """float64[features + 1]: the weights and the constant with the highest likelihood; every scene
    has the same weight.
    """
    seen = [one for one in seen if len(one.right[method])]
    x = np.concatenate([one.features[method] for one in seen])
    x = np.column_stack([x, np.ones(len(x))])
    right = np.concatenate([one.right[method] for one in seen])
    count = np.concatenate(
        [np.full(len(one.right[method]), 1 / len(one.right[method])) for one in seen]
    )
    scale = np.maximum(x.std(axis=0), 1e-9)
    scale[-1] = 1
    x, weights = x / scale, np.zeros(x.shape[1])
    for _ in range(ROUNDS):
        chance = 1 / (1 + np.exp(-np.clip(x @ weights, -30, 30)))
        slope = x.T @ (count * (right - chance)) - EASE * weights
        bend = (x * (count * chance * (1 - chance))[:, None]).T @ x + EASE * np.eye(len(weights))
        weights = weights + np.linalg.solve(bend, slope)
    return weights / scale


def rows(seen: Mapping[str, Sequence[Seen]]) -> Iterator[Sequence[str]]:
    """Yield the rows of a table: for pixels with a confidence of 90 %, the share that is right, and
    their number.
    """
    for name, runs in seen.items():
        cells = []
        for method in METHODS:
            sure = np.concatenate(
                [chance_of_right(one.features[method], LAW[method]) for one in runs]
            )
            chosen = (sure >= NINETY[0]) & (sure < NINETY[1])
            right = np.concatenate([one.right[method] for one in runs])[chosen]
            enough = len(right) >= PIXELS_MIN
            cells.append(
                f"{right.mean():.0%} of {len(right)}" if enough else f"({len(right)} pixels)"
            )
        yield name, *cells


def ray_rows(seen: Mapping[str, Sequence[Seen]]) -> Iterator[Sequence[str]]:
    """Yield rows for `planes`: of the pixels with a confidence of 90 %, the shares right, and on
    any surface of the pixel.
    """
    method = "planes"
    for name, runs in seen.items():
        sure = np.concatenate([chance_of_right(one.features[method], LAW[method]) for one in runs])
        chosen = (sure >= NINETY[0]) & (sure < NINETY[1])
        right = np.concatenate([one.right[method] for one in runs])[chosen]
        on_surface = np.concatenate([one.on_surface[method] for one in runs])[chosen]
        yield name, f"{right.mean():.0%}", f"{on_surface.mean():.0%}"


def draw(seen: Sequence[Seen], path: Path) -> None:
    """Draw the share of right pixels against their confidence, by method."""
    with style():
        figure = new_figure(4.6, 4.2)
        axis = figure.add_subplot()
        axis.plot([0, 100], [0, 100], color=GREY, linewidth=0.8)
        for method, mark in zip(METHODS, "sv^o", strict=True):
            sure = np.concatenate(
                [chance_of_right(one.features[method], LAW[method]) for one in seen]
            )
            right = np.concatenate([one.right[method] for one in seen])
            bins = [(sure >= low) & (sure < high) for low, high in pairwise(BINS)]
            points = [
                (sure[one].mean(), right[one].mean()) for one in bins if one.sum() >= PIXELS_MIN
            ]
            axis.plot(*(100 * np.array(points).T), f"-{mark}", label=method)
        axis.set(
            xlabel="confidence in %",
            ylabel="pixels within 3.45 cm in %",
            xlim=(0, 101),
            ylim=(0, 101),
        )
        axis.legend()
        save_figure(figure, path)


def real_setups() -> list[Setup]:
    """Return the setups of `REAL`."""
    return [
        Setup.of(
            scene,
            klux=klux,
            frame=frame,
            subgroup={"threshold": threshold},
            seed=seed,
            estimators=(),
        )
        for scene, klux, frame, threshold in REAL
        for seed in REAL_SEEDS
    ]


def perspective_setups() -> dict[tuple[int, int, int], Setup]:
    """Return the setups of the rooms in perspective, by seed, threshold and pulses."""
    return {
        (seed, threshold, pulses): perspective_setup(seed, threshold, pulses)
        for seed in SEEN_SEEDS
        for threshold in SEEN_THRESHOLDS
        for pulses in SEEN_PULSES
    }


def tried() -> dict[str, list[Setup]]:
    """Return setups that are not used to set the law, by their name in the table; their sensor is
    the default.
    """
    scenes = analytic_scenes().values()
    return {
        "random, one distance per pixel": [random_setup(seed) for seed in TRIED if seed % 2 == 0],
        "random, mixed": [random_setup(seed) for seed in TRIED if seed % 2],
        "analytic": [Setup.of(scene, klux=ANALYTIC_KLUX, estimators=()) for scene in scenes],
        **{
            f"{name}, {klux:g} klux": [Setup.of(name, klux=klux, estimators=())]
            for name, klux in BUILT_IN
        },
    }


def ray_traced() -> dict[str, list[Setup]]:
    """Return setups of ray-traced scenes, whose pixels see several surfaces, by their name in the
    table.
    """
    return {
        f"ray:{name}": [
            Setup.of(f"ray:{name}", klux=RAY_KLUX, seed=seed, estimators=()) for seed in RAY_SEEDS
        ]
        for name in RAY_TRACED
    }


def make() -> None:
    """Print the law; write tables and picture into their page."""
    with Processes(progress=counted) as run:
        looked = list(campaign({seed: random_setup(seed) for seed in SET}, look, run).values())
        looked += list(campaign(perspective_setups(), look, run).values())
        looked += REAL_COUNT * list(campaign(dict(enumerate(real_setups())), look, run).values())
        unseen, rays = (
            {
                name: list(campaign(dict(enumerate(group)), look, run).values())
                for name, group in groups.items()
            }
            for groups in (tried(), ray_traced())
        )
    for method in METHODS:
        print(f'    "{method}": ({", ".join(f"{weight:.3g}" for weight in law(looked, method))}),')
    everything = [one for group in unseen.values() for one in group]
    put(
        "docs/depth.md",
        "confidence",
        text_table(("scene", *METHODS), rows(unseen | {"all of them": everything})),
    )
    head = "ray-traced scene", "right", "on one of the pixel's surfaces"
    put("docs/depth.md", "confidence in rays", text_table(head, ray_rows(rays)))
    set_by = {"all scenes of the fit": looked}
    put("docs/depth.md", "confidence of the fit", text_table(("scene", *METHODS), rows(set_by)))
    draw(everything, picture(PICTURE))
    put("docs/depth.md", "confidence picture")


if __name__ == "__main__":
    make()
