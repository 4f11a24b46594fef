# SPDX-License-Identifier: Apache-2.0
"""Runs in which every pair of features of scene, light, SPADs, sensor, frame and estimator comes up,
and digests of what each of their stages gives.

`python -m tests.lab.result_pairs` writes the digests again; a change that means to change a result
says so in CHANGELOG.md.
"""

from pathlib import Path
from typing import Any

import numpy as np
from attrs import asdict, evolve, frozen

from coincid.lab.measures import MEASURES
from coincid.lab.outcomes import Run
from coincid.lab.setup import Setup
from coincid.model.contract.packet import COUNTS, FORMAT_NAMES, UNBUILT, WITH_MAP
from coincid.model.depth.depth import SAVED, Depth
from coincid.model.depth.estimate import PEAKS
from coincid.model.depth.histograms import SOURCES
from coincid.model.depth.methods import DEFAULT_SOURCE
from coincid.model.light.spad import Spad
from coincid.model.scenes.scene import Scene
from coincid.model.shared.pulse import Pulse

from ..digests import digest, write_digests
from ..feature_pairs import Case, Features, Pair, cases_in_turns
from ..random_cases import built_sensor, configured

DIGESTS = Path(__file__).with_suffix(".json")
PERIOD_CYCLES = 60
SENSORS: dict[str, dict[str, Any]] = {
    "default": dict(rows=8, cols=16, counts=1),
    "coarse": dict(rows=16, cols=8, phases=8, window_max=16, rearm=2, fifo_depth=2, counts=1),
    "single minigroups": dict(rows=12, cols=8, subgroup=[4, 4], minigroup=[1, 1], streams=3),
    "large minigroups": dict(
        rows=16, cols=8, subgroup=[8, 4], minigroup=[4, 4], phases=64, coarse_bits=7
    ),
}
SPADS = {
    "simple": Spad(),
    "noisy": Spad(dark_cps=2e6, afterpulse_probability=0.1, crosstalk_probability=0.05),
    "late": Spad(jitter_tail_fraction=0.2, jitter_tail_s=4e-10, dead_time_s=2e-8),
    "paralyzable": Spad(paralyzable=True, dead_time_s=4e-8, jitter_fwhm_s=3e-10),
}
TAIL_S = 2.5e-10
# Settings of the last subgroup that differ from those of the others.
LAST_SUBGROUP: dict[str, dict[str, Any]] = {
    "alike": {},
    "wider window": {"window": 16, "threshold": 2},
    "no coincidence": {"coincidence": False},
    "later gate": {"gating": True, "gate_start": 20, "gate_len": 30},
    "never gated": {"gating": False},
    "nearly dark": {"mask": "6"},
}
FEATURES: Features = {
    "sensor": tuple(SENSORS),
    "scene": ("wall", "tilted", "steps", "pane", "holes", "moving"),
    "klux": (0.0, 10.0, 80.0),
    "background": ("reflected", "even"),
    "pulse": ("Gaussian", "with a tail"),
    "spad": tuple(SPADS),
    "spad_gate": (False, True),
    "format": FORMAT_NAMES,
    "minigroup_records": (False, True),
    "mg_threshold": (1, 2),
    "threshold": (1, 2, 3, "no coincidence"),
    "auto": (False, True),
    "window": (16, 3, 1),
    "gate": ("none", "inner", "moving", "moving slowly"),
    "mask": ("all", "half"),
    "last subgroup": tuple(LAST_SUBGROUP),
    "link_gbps": (0.0, 0.4),
    "gap": (0, 7),
    "dither_bits": (0, 3),
    "frames": (1, 2),
    "frame": (None, "first", "last"),
    "pulses": (40, 160),
    "method": PEAKS,
    "source": tuple(SOURCES),
    "returns": (1, 2, 3),
}
NO_COUNTS = tuple(name for name, table in SENSORS.items() if not table.get("counts"))
COUNTED = ("format", COUNTS.name)
REFUSED: frozenset[Pair] = frozenset(frozenset([COUNTED, ("sensor", name)]) for name in NO_COUNTS)
CASES = cases_in_turns(FEATURES, REFUSED, 3)
DECIMALS = 9  # of a float: processors differ far behind them


@frozen
class Made:
    """What the stages of a case give."""

    edges: Any
    words: Any
    planes: Any  # depth by the estimator that is usual,
    peaks: Any  # and by that of the case; None: the format has none
    measures: Any


def scene_of(kind: str, rows: int, cols: int) -> Scene:
    """Return a small scene whose surfaces are 2 to 8 m away."""
    down, right = np.mgrid[:rows, :cols]
    far = right >= cols // 2
    distance_m = np.full((rows, cols), 5.0)
    reflectivity = np.full((rows, cols), 0.4)
    if kind == "tilted":
        distance_m = 3 + 0.21 * right + 0.08 * down
        reflectivity = np.where(down % 3 == 0, 0.2, 0.6)
    if kind in ("steps", "holes", "moving"):
        distance_m = np.where(far, 7.5, 2.5)
        reflectivity = np.where(far, 0.8, 0.1)
    if kind == "holes":
        distance_m[1::4, 2::5] = np.nan
        reflectivity[2::4, ::3] = 0.0
    if kind == "pane":
        distance_m = np.stack([distance_m, distance_m + 2.2], axis=2)
        reflectivity = np.stack([0.2 * reflectivity, reflectivity], axis=2)
    later = ()
    if kind == "moving":
        later = (Scene(name="later", distance_m=distance_m + 0.5, reflectivity=reflectivity),)
    return Scene(name=kind, distance_m=distance_m, reflectivity=reflectivity, later=later)


def with_tail() -> Pulse:
    """Return a pulse whose light falls off slowly."""
    time_s = np.arange(-40, 160) * 1e-11
    rise = np.maximum(0.0, 1 + time_s / 3e-10)
    tail = 1 / (1 + np.maximum(0.0, time_s) / TAIL_S) ** 2
    return Pulse(time_s=time_s, density=np.where(time_s < 0, rise, tail))


def setup_of(case: Case, number: int) -> Setup:
    """Return the setup of a case. number: seed of its photons. Raises `InputError`."""
    table = SENSORS[case["sensor"]]
    early = {"gating": True, "gate_start": 2, "gate_len": 25}
    gates: dict[str, dict[str, Any]] = {
        "none": {},
        "inner": {"gating": True, "gate_start": 8, "gate_len": 40},
        "moving": early,
        "moving slowly": early,
    }
    steps: dict[str, dict[str, int]] = {
        "moving": {"gate_step": 6, "gate_every": 5, "gate_steps": 4},
        "moving slowly": {"gate_step": 9, "gate_every": 30, "gate_steps": 8},  # not all in a frame
    }
    frame = {
        "period": PERIOD_CYCLES,
        "format": case["format"],
        "minigroup_records": case["minigroup_records"],
        "mg_threshold": min(case["mg_threshold"], np.prod(table.get("minigroup", [2, 2]))),
        "link_gbps": case["link_gbps"],
        "gap": case["gap"],
        "dither_bits": case["dither_bits"],
        "frames": case["frames"],
        "pulses": case["pulses"],
    }
    frame |= steps.get(case["gate"], {})
    without = case["threshold"] == "no coincidence"
    subgroup = {
        "window": case["window"],
        "threshold": 1 if without else case["threshold"],
        "coincidence": not without,
        "auto": case["auto"],
        **gates[case["gate"]],
    }
    if case["mask"] == "half":
        subgroup["mask"] = "5a3c"
    last = LAST_SUBGROUP[case["last subgroup"]]
    override = [{"subgroups": [built_sensor(table).subgroups - 1], **last}] if last else []
    config = configured(table, frame, subgroup, *override)
    spad = SPADS[case["spad"]]
    pulse = None
    if case["pulse"] == "with a tail":
        pulse = with_tail()
        spad = evolve(spad, jitter_tail_fraction=0.0)  # the pulse has the jitter in it
    return Setup(
        config=config,
        scene=scene_of(case["scene"], config.sensor.rows, config.sensor.cols),
        klux=case["klux"],
        background=case["background"],
        pulse=pulse,
        spad=spad,
        spad_gate=case["spad_gate"],
        seed=number,
    )


def source_of(case: Case) -> str:
    """Return the source of histograms of a case, or the usual one where it has no such stamps."""
    no_stamps = case["format"] not in UNBUILT and not case["minigroup_records"]
    if case["source"] == "minigroup" and (no_stamps or case["pulse"] == "with a tail"):
        return DEFAULT_SOURCE
    return str(case["source"])


def play(case: Case, number: int) -> Made:
    """Return what a case gives."""
    run = Run(setup_of(case, number))
    number_of = {None: None, "first": 0, "last": case["frames"] - 1}
    asked = {"frame": number_of[case["frame"]], "returns": case["returns"]}
    peaks = None
    if case["format"] in WITH_MAP:
        peaks = _arrays(run.depth(f"{case['method']}/{source_of(case)}", **asked))
    frame = run.frame(case["frames"] - 1)
    return Made(
        edges=(run.edges.pulse, run.edges.pixel, run.edges.tick),
        words=run.result,
        planes=_arrays(run.depth("planes", **asked)),
        peaks=peaks,
        measures={name: frame[name] for name in MEASURES},
    )


def _arrays(depth: Depth) -> dict[str, np.ndarray]:
    """Return the arrays of a depth that there are."""
    arrays = {name: getattr(depth, name) for name in SAVED}
    return {name: _rounded(array) for name, array in arrays.items() if array is not None}


def _rounded(array: np.ndarray) -> np.ndarray:
    return array.round(DECIMALS) if array.dtype.kind == "f" else array


def digests_of(case: Case, number: int) -> dict[str, str]:
    """Return the digest of each stage of a case."""
    return {name: digest(part) for name, part in asdict(play(case, number)).items()}


def told(case: Case) -> str:
    """Return the features of a case in a line."""
    return ", ".join(f"{name} {value}" for name, value in case.items())


if __name__ == "__main__":
    write_digests(DIGESTS, [digests_of(case, number) for number, case in enumerate(CASES)])
