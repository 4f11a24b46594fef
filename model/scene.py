"""Scenes: for every pixel of the sensor the distance and reflectivity of what it looks at.

Built-in ones are planes that face the sensor; depth files are resampled to it. Ref: paper IV, Fig. 4; the numbers of the
built-in scenes and the rules of the resampling are our choice.
"""

from pathlib import Path

import numpy as np
from attrs import field, frozen
from PIL import Image

from .errors import InputError, check_integer
from .light import NEAREST_M, SPEED_OF_LIGHT_M_S, Light, Timing
from .quantities import check_real, real_array
from .transient import Transient

RANGE_M = SPEED_OF_LIGHT_M_S * Timing().period_s / 2  # what the laser period of the preset can tell apart
REFLECTIVITY = 0.4                   # where a file says nothing about it: the paper's flat target
DARKEST, BRIGHTEST = 0.05, 0.8       # reflectivities that black and white of a colour picture stand for
WRONG_SHARE_MAX = 0.1                # of a depth file's samples beyond the range or negative: more is another unit
VALID_SHARE_MIN = 0.1                # of the sensor's pixels
STRIPE_PIXELS = 4                    # of the scene `two-targets`: both surfaces in every subgroup of 8 columns
NO_OBJECT = 0
MM_PER_M = 1000


@frozen(kw_only=True, eq=False)
class Scene:
    """What rows x cols pixels look at.

    distance_m, reflectivity: float64[rows, cols, targets] (two-dimensional input: one target); distance NaN = no target,
    and a pixel without any is invalid. labels: int64[rows, cols], number of the object, `NO_OBJECT` where that means
    nothing. notes: sentences that the user should read (what was cropped, masked, assumed). transient: of a ray-traced scene,
    whose light it is then; distance and reflectivity are what is looked for, not where the light comes from.
    Raises `InputError` for distances below `NEAREST_M` and reflectivities outside 0 to 1.
    """

    name: str
    distance_m: np.ndarray = field()
    reflectivity: np.ndarray
    labels: np.ndarray = NO_OBJECT
    notes: tuple[str, ...] = ()
    transient: Transient | None = None

    def __attrs_post_init__(self):
        distance_m = np.asarray(self.distance_m, np.float64)
        reflectivity = np.asarray(self.reflectivity, np.float64)
        if distance_m.ndim == 2:
            distance_m = distance_m[:, :, None]
            reflectivity = reflectivity[:, :, None] if reflectivity.ndim == 2 else reflectivity
        if distance_m.ndim != 3:
            raise InputError(f"distance_m: has {distance_m.ndim} dimensions, must have 2 or 3: rows, cols, targets")
        shape = distance_m.shape
        object.__setattr__(self, "distance_m", real_array("distance_m", distance_m, shape, NEAREST_M, nan=True))
        object.__setattr__(self, "reflectivity", real_array("reflectivity", reflectivity, shape, 0, 1))
        object.__setattr__(self, "labels", np.broadcast_to(np.asarray(self.labels, np.int64), shape[:2]))

    @property
    def rows(self) -> int:
        return self.distance_m.shape[0]

    @property
    def cols(self) -> int:
        return self.distance_m.shape[1]

    @property
    def valid(self) -> np.ndarray:
        """bool[rows, cols]: pixels with a target."""
        return ~np.isnan(self.distance_m).all(axis=2)

    @property
    def truth_m(self) -> np.ndarray:
        """float64[rows, cols]: the nearest target's distance, NaN where a pixel is invalid."""
        return np.fmin.reduce(self.distance_m, axis=2)


def scene_light(scene: Scene, klux: float, **others) -> Light:
    """The light of `scene` under `klux` of background, by the presets of `light.py`; `others` are fields of `Light`."""
    if scene.transient is not None:
        return scene.transient.light(klux, **others)
    return Light.from_scene(scene.distance_m, scene.reflectivity, klux, **others)


def load_scene(source: str, rows: int, cols: int, *, colour=None, reflectivity: float = REFLECTIVITY,
               range_m: float = RANGE_M) -> Scene:
    """The scene that `source` names, at rows x cols.

    source: a built-in one (`five-objects`, `letter-f`, `flat:DISTANCE,REFLECTIVITY`, `two-targets:NEAR,FAR`: stripes,
    `two-returns:NEAR,FAR`: both in every pixel; metres), a file (`depth_scene`): `DEPTH` or `DEPTH,COLOUR`, or one for the ray
    tracer (`ray_scene`): `ray:NAME`, or a Mitsuba scene that ends with .xml.
    colour: picture for the reflectivity of a file, else the constant `reflectivity`. range_m: what the laser period holds.
    Raises `InputError`.
    """
    check_integer("rows", rows, 1, 4096)
    check_integer("cols", cols, 1, 4096)
    from .ray_scene import is_ray_scene, ray_scene  # which builds a `Scene`

    if is_ray_scene(source):
        return ray_scene(source, rows, cols, range_m=range_m)
    name, _, values = str(source).partition(":")
    if name in BUILT_IN and not Path(source).exists():
        defaults, build = BUILT_IN[name]
        return build(rows, cols, f"{source}", *_numbers(name, values, defaults, range_m))
    depth = str(source)
    if "," in depth and not Path(depth).exists():
        depth, _, beside = depth.rpartition(",")
        if colour is not None:
            raise InputError(f"scene {source!r}: names a colour picture, and another one is given: {colour}")
        colour = beside
    return depth_scene(depth, rows, cols, colour=colour, reflectivity=reflectivity, range_m=range_m)


def _numbers(name: str, text: str, defaults: tuple[tuple[str, float], ...], range_m: float) -> list[float]:
    """The comma-separated numbers after a built-in scene's name, the rest by default."""
    given = text.split(",") if text else []
    if len(given) > len(defaults):
        form = ",".join(what for what, _ in defaults)
        raise InputError(f"scene {name}:{text}: must be {name}{':' if form else ''}{form}")
    values = []
    for i, (what, default) in enumerate(defaults):
        low, high = (0.0, 1.0) if what == "REFLECTIVITY" else (NEAREST_M, range_m)
        try:
            value = float(given[i]) if i < len(given) else default
        except ValueError:
            value = given[i]
        values.append(check_real(f"scene {name}: {what}", value, low, high))
    return values


@frozen
class Plane:
    """A rectangle that faces the sensor; its borders in shares of the picture, rows from the top, columns from the left."""

    label: int
    distance_m: float
    reflectivity: float
    top: float = 0.0
    bottom: float = 1.0
    left: float = 0.0
    right: float = 1.0


# Like the paper's Fig. 4: numbers and kinds of the objects, nearest and farthest distance are the paper's, the rest ours.
# Borders stand in 1/32, off the borders of subgroups of 8 x 8, so that surfaces share subgroups.
FIVE_OBJECTS = (
    Plane(1, 9.7, 0.60),                                       # white wall
    Plane(2, 7.2, 0.08, 9 / 32, 21 / 32, 2 / 32, 13 / 32),     # dark object
    Plane(3, 8.4, 0.55, 0, 1, 18 / 32, 23 / 32),               # white pillar
    Plane(4, 4.3, 0.45, 17 / 32, 30 / 32, 21 / 32, 30 / 32),   # aluminium bin
    Plane(5, 6.1, 0.10, 23 / 32, 1, 6 / 32, 17 / 32),          # dark object
)
LETTER_F = (
    Plane(1, 8.0, 0.4),
    Plane(2, 5.0, 0.4, 4 / 32, 27 / 32, 6 / 32, 11 / 32),      # stem
    Plane(2, 5.0, 0.4, 4 / 32, 9 / 32, 6 / 32, 24 / 32),       # upper arm
    Plane(2, 5.0, 0.4, 14 / 32, 18 / 32, 6 / 32, 20 / 32),     # lower arm, shorter
)


def planes_scene(planes: tuple[Plane, ...], rows: int, cols: int, name: str) -> Scene:
    """The nearest of `planes` at each pixel's centre; no target where there is none."""
    y, x = (np.arange(rows)[:, None] + 0.5) / rows, (np.arange(cols) + 0.5) / cols
    distance_m = np.full((rows, cols), np.nan)
    reflectivity, labels = np.zeros((rows, cols)), np.full((rows, cols), NO_OBJECT)
    for plane in planes:
        inside = (plane.top <= y) & (y < plane.bottom) & (plane.left <= x) & (x < plane.right)
        seen = inside & ~(distance_m <= plane.distance_m)
        distance_m[seen], reflectivity[seen], labels[seen] = plane.distance_m, plane.reflectivity, plane.label
    return Scene(name=name, distance_m=distance_m, reflectivity=reflectivity, labels=labels)


def _flat(rows: int, cols: int, name: str, distance_m: float, reflectivity: float) -> Scene:
    return planes_scene((Plane(1, distance_m, reflectivity),), rows, cols, name)


def _two_targets(rows: int, cols: int, name: str, near_m: float, far_m: float, reflectivity: float) -> Scene:
    """Stripes of `STRIPE_PIXELS` columns, the near surface first."""
    far = np.broadcast_to(np.arange(cols) // STRIPE_PIXELS % 2, (rows, cols))
    distance_m = np.where(far, far_m, near_m)
    return Scene(name=name, distance_m=distance_m, reflectivity=reflectivity, labels=1 + far)


def _two_returns(rows: int, cols: int, name: str, near_m: float, far_m: float, reflectivity: float) -> Scene:
    """A mesh before a wall: each gets half of every pixel's light."""
    distance_m = np.broadcast_to([near_m, far_m], (rows, cols, 2))
    return Scene(name=name, distance_m=distance_m, reflectivity=reflectivity / 2, labels=1)


_TWO = (("NEAR", 5.0), ("FAR", 9.0), ("REFLECTIVITY", REFLECTIVITY))
BUILT_IN = {  # name: parameters with their defaults, and the function that builds it
    "five-objects": ((), lambda rows, cols, name: planes_scene(FIVE_OBJECTS, rows, cols, name)),
    "letter-f": ((), lambda rows, cols, name: planes_scene(LETTER_F, rows, cols, name)),
    "flat": ((("DISTANCE", 10.0), ("REFLECTIVITY", REFLECTIVITY)), _flat),
    "two-targets": (_TWO, _two_targets),
    "two-returns": (_TWO, _two_returns),
}


def depth_scene(depth, rows: int, cols: int, *, colour=None, reflectivity: float = REFLECTIVITY,
                range_m: float = RANGE_M) -> Scene:
    """A scene from a depth file: a 16-bit picture (PNG, TIFF) in millimetres, or NPY in metres (floats) or millimetres (integers).

    The picture is cropped around its centre to the sensor's aspect ratio. A pixel of the sensor takes the nearest of the
    samples it covers, with the reflectivity at that very sample: nothing is averaged across an edge. Samples that are 0,
    NaN or negative, or at or beyond `range_m`, are left out, and noted.
    colour: a picture of the same view; its luminance (linear light) stands for `DARKEST` to `BRIGHTEST`.
    Raises `InputError` for a file that cannot be read, a colour picture as depth, and depth that is mostly unusable.
    """
    check_real("reflectivity", reflectivity, 0, 1)
    sample_m = _read_depth_m(depth)
    height, width = sample_m.shape
    top, left, crop_height, crop_width = _centre_crop(height, width, rows, cols)
    sample_m = sample_m[top:top + crop_height, left:left + crop_width]
    notes = []
    if (crop_height, crop_width) != (height, width):
        notes.append(f"{depth}: cropped to the middle {crop_height} x {crop_width} of {height} x {width} samples")
    sample_m, masked = _usable(depth, sample_m, range_m)
    notes += masked
    row, col = _nearest_surface(sample_m, rows, cols)
    distance_m = sample_m[row, col]
    valid_share = np.mean(~np.isnan(distance_m))
    if valid_share < VALID_SHARE_MIN:
        raise InputError(f"{depth}: {valid_share:.1%} of the sensor's pixels have a usable depth, must be at least {VALID_SHARE_MIN:.0%}")
    if valid_share < 1:
        notes.append(f"{depth}: {np.isnan(distance_m).sum()} of {rows * cols} pixels without depth are masked")
    if colour is None:
        notes.append(f"{depth}: reflectivity {reflectivity:g} everywhere, as no colour picture is given")
        surface = np.full((rows, cols), float(reflectivity))
    else:
        albedo = _read_reflectivity(colour)
        surface = albedo[(2 * (top + row) + 1) * albedo.shape[0] // (2 * height), (2 * (left + col) + 1) * albedo.shape[1] // (2 * width)]
    return Scene(name=Path(depth).name, distance_m=distance_m, reflectivity=surface, notes=tuple(notes))


def _centre_crop(height: int, width: int, rows: int, cols: int) -> tuple[int, int, int, int]:
    """(top, left, height, width) of the largest centred part with the sensor's aspect ratio."""
    crop_height = max(1, min(height, round(width * rows / cols)))
    crop_width = max(1, min(width, round(height * cols / rows)))
    return (height - crop_height) // 2, (width - crop_width) // 2, crop_height, crop_width


def _usable(depth, sample_m: np.ndarray, range_m: float) -> tuple[np.ndarray, list[str]]:
    """`sample_m` with NaN where it is unusable, and what was."""
    missing = np.isnan(sample_m) | (sample_m == 0)
    negative = sample_m < 0
    far = sample_m >= range_m
    near = (sample_m > 0) & (sample_m < NEAREST_M)
    notes = []
    if missing.all():
        raise InputError(f"{depth}: every sample is 0 or NaN, must hold distances above 0 and below {range_m:.4g} m")
    for what, bad in (("negative", negative), (f"at or beyond the laser period's range of {range_m:.4g} m", far),
                      (f"below {NEAREST_M:g} m", near)):
        share = bad.sum() / (~missing).sum()
        if share > WRONG_SHARE_MAX:
            worst = float(sample_m[bad].flat[0])
            raise InputError(f"{depth}: {share:.0%} of the samples are {what} (such as {worst:.6g} m), must be above 0 and below "
                             f"{range_m:.4g} m; floats are metres, integers millimetres")
        if bad.any():
            notes.append(f"{depth}: {bad.sum()} samples {what} left out")
    if missing.any():
        notes.append(f"{depth}: {missing.sum()} of {missing.size} samples hold no depth (0 or NaN)")
    return np.where(missing | negative | far | near, np.nan, sample_m), notes


def _nearest_surface(sample_m: np.ndarray, rows: int, cols: int) -> tuple[np.ndarray, np.ndarray]:
    """For each pixel of the sensor (row, col) of the nearest sample that it covers; int64[rows, cols] each.

    A picture with fewer samples than the sensor has pixels is repeated. NaN counts as farthest.
    """
    height, width = sample_m.shape
    row = np.arange(max(height, rows)) * height // max(height, rows)
    col = np.arange(max(width, cols)) * width // max(width, cols)
    cell = np.arange(len(row))[:, None] * rows // len(row) * cols + np.arange(len(col)) * cols // len(col)
    far_first = np.argsort(-sample_m[np.ix_(row, col)].ravel(), kind="stable")
    far_first = np.roll(far_first, np.isnan(sample_m[np.ix_(row, col)]).sum())  # NaN sorts last, must be written first
    chosen = np.empty(rows * cols, np.int64)
    chosen[cell.ravel()[far_first]] = far_first  # of several writes the last one stays: the nearest
    at_row, at_col = np.divmod(chosen, len(col))
    return row[at_row].reshape(rows, cols), col[at_col].reshape(rows, cols)


def _read_depth_m(path) -> np.ndarray:
    """float64[height, width] in metres; what is not a depth map is an `InputError`."""
    suffix = Path(path).suffix.lower()
    if suffix == ".exr":
        raise InputError(f"{path}: EXR is not read, must be a 16-bit PNG in millimetres or an NPY file in metres")
    samples = _read_npy(path) if suffix == ".npy" else _read_grey(path)
    if samples.ndim == 3 and samples.shape[2] == 1:
        samples = samples[:, :, 0]
    if samples.ndim != 2 or not samples.size or samples.dtype.kind not in "iuf":
        raise InputError(f"{path}: holds {samples.dtype}{list(samples.shape)}, must hold numbers in two dimensions (rows, cols)")
    return samples.astype(np.float64) / (1 if samples.dtype.kind == "f" else MM_PER_M)


def _read_npy(path) -> np.ndarray:
    try:
        samples = np.load(path, allow_pickle=False)
    except FileNotFoundError:
        raise InputError(f"{path}: no such file") from None
    except (OSError, ValueError, EOFError) as error:
        raise InputError(f"{path}: is not a readable NPY file ({error})") from None
    if not isinstance(samples, np.ndarray):
        raise InputError(f"{path}: is an NPZ archive, must be a single array (NPY)")
    return samples


def _read_grey(path) -> np.ndarray:
    """A picture's samples; colour and 8 bit are refused: they cannot be depth in millimetres."""
    with _picture(path) as picture:
        if picture.mode != "F" and not picture.mode.startswith("I"):
            raise InputError(f"{path}: is a picture of mode {picture.mode} (colour or 8 bit), "
                             "must be depth: one channel of 16 bits, in millimetres")
        return np.array(picture)


def _read_reflectivity(path) -> np.ndarray:
    """float64[height, width]: linear luminance (sRGB primaries) between `DARKEST` and `BRIGHTEST`."""
    with _picture(path) as picture:
        srgb = np.asarray(picture.convert("RGB"), np.float64) / 255
    linear = np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)  # IEC 61966-2-1
    return DARKEST + (BRIGHTEST - DARKEST) * (linear @ [0.2126, 0.7152, 0.0722])


def _picture(path) -> Image.Image:
    """An opened and decoded picture."""
    try:
        picture = Image.open(path)
        picture.load()
        return picture
    except FileNotFoundError:
        known = ", ".join(BUILT_IN)
        raise InputError(f"{path}: no such file (built-in scenes: {known})") from None
    except (OSError, SyntaxError, ValueError, Image.DecompressionBombError) as error:
        raise InputError(f"{path}: is not a readable picture ({error})") from None
