# SPDX-License-Identifier: Apache-2.0
"""Depth files and what a user says of them, of which every pair comes up, and digests of the scenes.

`python -m tests.scenes.file_pairs` writes the digests again; a change that means to change a scene
says so in CHANGELOG.md.
"""

from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import h5py
import numpy as np
import OpenEXR
from PIL import Image
from scipy.io import savemat

from coincid.model.scenes.catalogue import load_scene
from coincid.model.scenes.conventions import DATA_SETS, PER_METRE
from coincid.model.scenes.scene import Scene
from coincid.model.shared.errors import InputError

from ..digests import digest, write_digests
from ..feature_pairs import Case, Features, cases_in_turns

DIGESTS = Path(__file__).with_suffix(".json")
INTEGERS = ("array of uint16", "png", "tiff", "pgm", "h5")
FLOATS = ("array", "npy", "npz", "pfm", "exr", "mat")
# Numbers per metre of the units that are lengths; the others have tests of their own.
LENGTHS = PER_METRE | {"1/5000": 5000.0}
LENGTHS |= {
    name: PER_METRE.get(one.stored) or float(one.stored.removeprefix("1/"))
    for name, one in DATA_SETS.items()
    if one.stored in PER_METRE or one.stored.startswith("1/")
}
DISPARITIES = {"disparity:90,0.5": (45.0, 0.0), "disparity/16:90,0.5,2": (16 * 45.0, 16 * 2.0)}
FEATURES: Features = {
    "kind": INTEGERS + FLOATS,
    "samples": ((17, 23), (8, 8), (40, 12)),
    "pixels": ((4, 6), (5, 5), (8, 4)),
    "holes": ("none", "scattered", "a row", "7"),
    "unit": (None, *LENGTHS, *DISPARITIES),
    "scale": (1.0, 0.5, 3.0),
    "missing": (None, 7, (9, 7)),
    "sky_m": (None, 5.5),
    "z": (False, True),
    "fov_deg": (None, 60.0, 120.0),
    "reflectivity": ("default", "one number", "per sample", "colour picture", "grey picture"),
    "range_m": (75.0, 6.0),
}
CASES = cases_in_turns(FEATURES, frozenset(), 2)  # no pair is refused
DECIMALS = 9  # of a float: processors differ far behind them


def samples_of(case: Case) -> np.ndarray:
    """Return the numbers of a depth picture: a slope with a step, in the unit of the case."""
    rows, cols = case["samples"]
    row, col = np.mgrid[:rows, :cols]
    depth_m = 1.5 + 0.06 * row + 0.03 * col + np.where(col > cols // 3, 2.0, 0.0)
    empty = {
        "none": np.zeros((rows, cols), bool),
        "scattered": (3 * row + 5 * col) % 11 == 0,
        "a row": row == rows - 2,
        "7": (row + col) % 7 == 3,
    }
    integers = case["kind"] in INTEGERS
    usual = 1000.0 if integers else 1.0
    if case["unit"] in DISPARITIES:
        per_metre, offset = DISPARITIES[case["unit"]]
        numbers = per_metre / depth_m - offset
    else:
        numbers = depth_m * LENGTHS.get(case["unit"], usual)
    mark = 7 if case["holes"] == "7" else 0
    marked = np.where(empty[case["holes"]], mark, numbers)
    return marked.astype(np.uint16 if integers else np.float32)


def written(folder: Path, kind: str, samples: np.ndarray) -> Any:
    """Return what `load_scene` is given: an array, or the name of a file that has it."""
    path = folder / f"depth.{kind}"
    if kind in ("array", "array of uint16"):
        return samples
    if kind == "npy":
        np.save(path, samples)
    if kind == "npz":
        np.savez(path, other=samples + 1, depth=samples)
        return f"{path}:depth"
    if kind == "mat":
        savemat(path, {"depth": samples})
    if kind == "h5":
        with h5py.File(path, "w") as file:
            file["group/depth"] = samples
    if kind in ("png", "tiff", "pgm"):
        Image.fromarray(samples).save(path)
    if kind == "pfm":
        head = f"Pf\n{samples.shape[1]} {samples.shape[0]}\n-1.0\n".encode()
        path.write_bytes(head + samples[::-1].astype("<f4").tobytes())
    if kind == "exr":
        head = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
        OpenEXR.File(head, {"Z": samples, "A": np.ones_like(samples)}).write(str(path))
    return str(path)


def reflectivity_of(folder: Path, case: Case) -> dict[str, Any]:
    """Return the arguments of `load_scene` about reflectivities."""
    rows, cols = case["samples"]
    row, col = np.mgrid[:rows, :cols]
    kind = case["reflectivity"]
    if kind == "one number":
        return {"reflectivity": 0.25}
    if kind == "per sample":
        return {"reflectivity": 0.1 + 0.8 * (row + col) / (rows + cols)}
    if kind == "default":
        return {}
    path = folder / "colour.png"
    grey = (row * 5 + col * 3) % 256
    planes = grey if kind == "grey picture" else np.dstack([grey, 255 - grey, grey // 2])
    Image.fromarray(planes.astype(np.uint8)).save(path)
    return {"colour": str(path)}


def read(case: Case, folder: Path) -> Scene | str:
    """Return the scene of a case, or why there is none."""
    names = ("unit", "scale", "missing", "sky_m", "z", "fov_deg", "range_m")
    try:
        return load_scene(
            written(folder, case["kind"], samples_of(case)),
            *case["pixels"],
            **reflectivity_of(folder, case),
            **{name: case[name] for name in names},
        )
    except InputError as error:
        return str(error)


def digest_of(case: Case) -> str:
    """Return the digest of the scene of a case, and of what it is doubted for."""
    with TemporaryDirectory() as folder:
        scene = read(case, Path(folder))
    if isinstance(scene, str):
        return digest(scene.replace(folder, ""))
    told = [one.replace(folder, "") for one in (*scene.doubts, *scene.notes)]
    arrays = (scene.distance_m, scene.reflectivity, scene.sunlit, scene.labels)
    return digest(([array.round(DECIMALS) for array in arrays], told))


if __name__ == "__main__":
    write_digests(DIGESTS, [digest_of(case) for case in CASES])
