# SPDX-License-Identifier: Apache-2.0
"""The conventions of depth files: what their numbers mean, by data set, camera and program.

The help of `--unit`, the explorer, the table of docs/advise.md and the hints are made from
`CONVENTIONS`. All of these files have their top row first, once they are read. This file imports
nothing that takes time.
"""

import re

from attrs import frozen

from ..shared.errors import wrong_value

# depth files, which library, command line and explorer accept alike
PICTURES = (".png", ".tif", ".tiff", ".pgm", ".pfm", ".exr")
ARRAYS = (".npy",)
ARCHIVES = (".npz", ".h5", ".hdf5", ".mat")  # of which FILE:NAME names an array
DEPTH_FILES = (*PICTURES, *ARRAYS, *ARCHIVES)
DEPTH_FILES_TOLD = "PNG, TIFF, PGM, PFM, EXR, NPY, NPZ, HDF5, MATLAB"
PER_METRE = {"m": 1.0, "cm": 100.0, "mm": 1000.0}
ROTATED = "sun-rgbd"  # millimetres, whose bits are rotated
KINECT_RAW = "nyu-raw"  # the Kinect's own numbers, with swapped bytes
DISPARITY = "disparity"
Z = "z"  # along the axis of the camera
RAY = "ray"  # along the ray through the pixel
INDOORS_M = 8.0
OUTDOORS_M = 75.0


@frozen(kw_only=True)
class Convention:
    """What the numbers of a kind of files mean. 0, NaN and infinity are no depth in all of them."""

    name: str  # as in --unit
    files: str  # who writes such files
    # a key of PER_METRE, 1/N (of a metre), disparity or disparity/N (of a pixel), ROTATED or
    # KINECT_RAW
    stored: str
    along: str = Z
    missing: tuple[float, ...] = ()  # further numbers that mean "no depth", before the unit
    channel: str = ""  # last part of the name of an EXR channel, if it is not depth or Z
    far_m: float = INDOORS_M  # largest usual median

    @property
    def told(self) -> str:
        """What the numbers are, for help and documents."""
        unit = {
            ROTATED: "1/8000 m with rotated bits",
            KINECT_RAW: "the Kinect's 11 bits with swapped bytes",
            DISPARITY: "pixels of disparity, with the data set's calib.txt beside it",
        }
        if self.stored.startswith(f"{DISPARITY}/"):
            return f"disparity in {self.stored.removeprefix(DISPARITY).replace('/', '1/')} pixels"
        return unit.get(self.stored, f"{self.stored} m" if "/" in self.stored else self.stored)


CONVENTIONS = (
    Convention(name="realsense", files="RealSense, OAK, Orbbec", stored="mm", missing=(65535,)),
    Convention(name="kinect", files="Kinect v1 and v2, 7-Scenes", stored="mm", missing=(65535,)),
    Convention(name="azure", files="Azure Kinect", stored="mm"),
    Convention(name="nyu", files="NYU as PNG", stored="mm"),
    Convention(name=KINECT_RAW, files="NYU raw (PGM)", stored=KINECT_RAW, missing=(2047,)),
    Convention(name="scannet", files="ScanNet", stored="mm"),
    Convention(name=ROTATED, files="SUN RGB-D", stored=ROTATED),
    Convention(name="tum", files="TUM RGB-D, ICL-NUIM", stored="1/5000"),
    Convention(
        name="bop", files="BOP with a depth_scale of 0.1", stored="1/10000", missing=(65535,)
    ),
    Convention(
        name="2d-3d-s", files="2D-3D-S, Taskonomy, Omnidata", stored="1/512", missing=(65535,)
    ),
    Convention(name="void", files="VOID", stored="1/256"),
    Convention(name="kitti", files="KITTI depth", stored="1/256", far_m=OUTDOORS_M),
    Convention(
        name="kitti-disparity", files="KITTI stereo", stored=f"{DISPARITY}/256", far_m=OUTDOORS_M
    ),
    Convention(name="middlebury", files="Middlebury (PFM)", stored=DISPARITY),
    Convention(
        name="virtual-kitti", files="Virtual KITTI", stored="cm", missing=(65535,), far_m=OUTDOORS_M
    ),
    Convention(name="hypersim", files="Hypersim", stored="m", along=RAY),
    Convention(
        name="airsim", files="AirSim DepthPlanar", stored="m", missing=(65504,), far_m=OUTDOORS_M
    ),
    Convention(
        name="airsim-ray", files="AirSim DepthPerspective", stored="m", along=RAY, far_m=OUTDOORS_M
    ),
    Convention(
        name="blender", files="Blender", stored="m", missing=(1e10, 65504), far_m=OUTDOORS_M
    ),
    Convention(
        name="mitsuba",
        files="Mitsuba's integrator aov",
        stored="m",
        along=RAY,
        channel="T",
        far_m=OUTDOORS_M,
    ),
    Convention(name="pbrt", files="pbrt's GBufferFilm", stored="m", channel="Pz", far_m=OUTDOORS_M),
)
DATA_SETS = {one.name: one for one in CONVENTIONS}
_DISPARITIES = f"{DISPARITY}:FOCAL_PX,BASELINE_M (optionally also ,OFFSET_PX; {DISPARITY}/N: of N numbers per pixel)"
UNIT_FORMS = f"{', '.join(PER_METRE)}, 1/N (of a metre), {_DISPARITIES}, {', '.join(DATA_SETS)}"
_STORED = re.compile(
    rf"{'|'.join(PER_METRE)}|1/[1-9]\d{{0,6}}|{DISPARITY}(/[1-9]\d{{0,6}})?|{ROTATED}|{KINECT_RAW}"
)


def check_unit(unit: str) -> str:
    """Return `unit` if it is one. Raises `InputError`."""
    if not isinstance(unit, str):
        raise wrong_value("unit", unit, f"one of {UNIT_FORMS}")
    stored = stored_unit(unit)
    _, colon, _ = unit.partition(":")
    if not _STORED.fullmatch(stored) or (colon and not stored.startswith(DISPARITY)):
        raise wrong_value("unit", unit, f"one of {UNIT_FORMS}")
    return unit


def stored_unit(unit: str) -> str:
    """Return a unit without the numbers after its colon, and that of a data set instead of the
    name.
    """
    name, _, _ = unit.partition(":")
    return DATA_SETS[name].stored if name in DATA_SETS else name


def convention(unit: str | None) -> Convention | None:
    """Return the convention that a unit names, if it does."""
    if not isinstance(unit, str):
        return None
    name, _, _ = unit.partition(":")
    return DATA_SETS.get(name)


def conventions_table() -> str:
    """Return the table of docs/advise.md."""
    lines = [
        "| files | numbers | no depth, besides 0 | along | option |",
        "| --- | --- | --- | --- | --- |",
    ]
    for one in CONVENTIONS:
        missing = ", ".join(f"{value:.10g}" for value in one.missing)
        channel = f", channel `{one.channel}`" if one.channel else ""
        lines.append(
            f"| {one.files} | {one.told}{channel} | {missing} | {one.along} | `--unit {one.name}` |"
        )
    return "\n".join(lines)
