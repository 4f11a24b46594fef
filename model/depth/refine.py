# SPDX-License-Identifier: Apache-2.0
"""Times between the ticks, and their standard errors: a surface by least squares through the peaks
of the pixels around each pixel.

Near its peak, the log likelihood of a pixel is a parabola. A surface through the peaks of
neighbours, each weighted by how sharp it is, has the error that their photons allow. With few hits,
a pixel's own peak is skewed, and the mean of such peaks leans. So the surface through the peaks is
only the first of two: from it, each pixel says by the slope of its log likelihood there how far its
peak is, and these are summed without a lean (one step of Newton's method for all pixels together).

The more neighbours, the smaller this error, until the surface has another shape. So two shapes are fitted to
discs of growing size, a plane and a curved surface:

- The curved surface says how far the plane is off. What the square of this difference exceeds its
  noise by is bias of the plane; it grows with the area of the disc, so large discs tell it for small
  ones, too.
- A smaller disc says in the same way how far the curved surface is off.

Such an excess of one pixel is one sample of a random number. So the pixels around it share theirs:
negative ones count, too, and on a plane their mean is near 0.

If the peaks around a pixel scatter by more than their likelihoods tell, the variance grows as much: some
of them are of other surfaces, or the shape is another one. What is significant of this is also taken
for a distance of each pixel's own, as that of leaves or of a depth picture with noise (the nugget of
kriging; Cressie, Statistics for Spatial Data, 1993). Such a pixel is moved from its surface towards
its own peak, and its error contains what it may be off the surface.

Behind a lens, planes in space are curved from pixel to pixel (`lens.py`). Such a lens is looked for in
the peaks of the frame, and both shapes follow it.

The estimate is the one with the smallest sum of variance and squared bias. The discs grow as long as
the curved surfaces agree within their noise (Goldenshluger and Nemirovski 1997; Lepski 1991).
"""

from functools import partial
from typing import Any, NamedTuple

import numpy as np
from scipy.ndimage import uniform_filter

from ..shared.compiled import njit, part
from .curves import slope_at, through_five, through_three
from .lens import Lens, find_lens, no_lens, seen_at
from .patchmatch import HALF, Field, Planes, own_level, plane_at
from .seeds import Blocks

CLIMB = 2  # steps from the plane's time to a pixel's own peak, at most
PEAK_STEPS = 1.5  # from the highest of these to the peak of the parabola, at most
FROM_SLOPE_TICKS = 6.0  # from the first surface to a peak, at most
BESIDE_TICKS = 4.0  # from the plane to that of a neighbour on the same surface, at most
OFF_SIGMAS = 3.5  # from the plane to the peak of such a neighbour, at most
SLOPE_TICKS = 1.0  # per pixel: standard deviation of the slopes of `fit_planes`
BEND_TICKS = 2.0  # per squared pixel: standard deviation of the curvatures of surfaces
CURVED_TICKS = 1.0  # by which the plane of a pixel may miss its peak, because its surface is curved
AGREE_SIGMAS = 2.5  # of the difference of two discs' curved surfaces, at most,
AGREE_TICKS = 0.1  # and so much more
SMALLER = 2  # discs from one to the smaller one that says how far its curved surface is off
SMALLER_GROWTH = 4.0  # from the excess of this difference to the squared bias
SIDE = 7  # pixels, of the square in which they share what exceeds the noise
SHARED = 6.0  # weight of their mean; that of the pixel's own is 1
GROWTH = 1.1  # of the standard error, because the disc is chosen by the same peaks
ERROR_TICKS = 0.06  # what the likelihood leaves out, at any number of photons
MOVE_TICKS = 3.0  # by which a time changes, at most
DISCS = (0, 1, 2, 5, 10, 17, 26, 37, 50, 68)  # squared radii, pixels
ROUGH_DISC = 4  # the first disc whose scatter tells how rough the surface is, if it agrees
ROUGH_SIGMAS = 3.0  # of a scatter by chance, from which on it counts as roughness,
SURE_SIGMAS = 1.0  # and so much more, from which on it does in full
OWN_DOUBT = 2.0  # by which a pixel's own peak may be noisier than it says
SCATTER_PRIOR = 10.0  # weight of the scatter that the likelihoods tell, in peaks
TERMS = 6  # of a curved surface: three curvatures,
FLAT = 3  # and from here on those of a plane:
DOWN = 3  # its slopes,
RIGHT = 4
LEVEL = 5  # and its time

_through_three = part(through_three)
_through_five = part(through_five)
_slope_at = part(slope_at)


class Refined(NamedTuple):
    """Planes and the standard errors of their times, [rows, cols]."""

    planes: Planes
    error: np.ndarray  # float64, ticks; NaN: no peak is near


class _Peaks(NamedTuple):
    """Peak of each pixel's log likelihood near its plane, float64[rows, cols]."""

    time: np.ndarray  # ticks
    bend: np.ndarray  # of the parabola, per squared tick: inverse of the variance; 0: no peak


class _Neighbours(NamedTuple):
    """The pixels around a pixel, the nearest first, and the pixel itself."""

    step: np.ndarray  # int64[n, 2], rows and columns to them
    terms: np.ndarray  # float64[n, TERMS], terms of a curved surface there
    bounds: np.ndarray  # int64[discs], how many of them each of `DISCS` has


# What least squares add to the plane of a pixel.
_FIT = np.dtype(
    [
        ("off", np.float64),  # ticks
        ("down", np.float64),  # ticks per row
        ("right", np.float64),  # ticks per column
        ("variance", np.float64),  # of `off`, squared ticks
        ("scatter", np.float64),  # squared distances of the peaks from it, in their variances
        ("free", np.float64),  # what `scatter` is on average
        ("weight", np.float64),  # mean inverse variance of the peaks, per squared tick
    ],
    align=True,
)


class _Work(NamedTuple):
    """Workspace for a pixel; each row of the array has its own."""

    sums: np.ndarray  # float64[TERMS + 1, TERMS + 1], products of the terms and of the peaks
    left: np.ndarray  # the same, while the terms are eliminated
    peaks: np.ndarray  # float64[1], number of the peaks


class _Fits(NamedTuple):
    """The surfaces through the discs around each pixel, [rows, cols, discs]."""

    plane: np.ndarray  # _FIT
    curved: np.ndarray  # _FIT
    first: np.ndarray  # int64[rows, cols], first disc with a peak
    end: np.ndarray  # int64[rows, cols], the one after the last that agrees with the smaller ones


class _Excess(NamedTuple):
    """By how much squared differences exceed their noise, float64[rows, cols, discs], squared
    ticks; NaN: there are no two surfaces.
    """

    plane: np.ndarray  # from the plane to the curved surface of the disc
    curved: np.ndarray  # from the curved surface to that of a smaller disc


class _Chosen(NamedTuple):
    """What is added to the plane of a pixel, so that it is the surface through its disc."""

    off: float  # ticks
    down: float  # ticks per row
    right: float  # ticks per column
    square: float  # squared error of `off`; infinite: there is no peak
    disc: int  # number of the disc; -1: there is no peak


def refine(field: Field, planes: Planes, blocks: Blocks) -> Refined:
    """Return planes with times and slopes between the steps of `fit_planes`."""
    shape = planes.time.shape
    peaks = _Peaks(np.empty(shape), np.empty(shape))
    blocks(partial(_find_peaks, field, planes, peaks))
    near = _neighbours()
    surfaces = partial(_surfaces, field, peaks, near, _room_for(*shape), blocks)
    lens = no_lens(*shape)
    first = surfaces(planes, lens)
    blocks(partial(_follow_slopes, field, first.planes, peaks))
    lens = find_lens(peaks.time, peaks.bend)
    if lens.there:  # again, because the first surfaces were of another shape
        blocks(partial(_find_peaks, field, planes, peaks))
        first = surfaces(planes, lens)
        blocks(partial(_follow_slopes, field, first.planes, peaks))
    return surfaces(first.planes, lens)


class _Room(NamedTuple):
    """Memory that all fits use."""

    work: _Work
    fits: _Fits
    excess: _Excess


def _room_for(rows: int, cols: int) -> _Room:
    """Return the room for the fits of so many pixels."""
    discs = len(DISCS)
    return _Room(
        work=_Work(
            sums=np.empty((rows, TERMS + 1, TERMS + 1)),
            left=np.empty((rows, TERMS + 1, TERMS + 1)),
            peaks=np.empty((rows, 1)),
        ),
        fits=_Fits(
            plane=np.empty((rows, cols, discs), _FIT),
            curved=np.empty((rows, cols, discs), _FIT),
            first=np.empty((rows, cols), np.int64),
            end=np.empty((rows, cols), np.int64),
        ),
        excess=_Excess(np.empty((rows, cols, discs)), np.empty((rows, cols, discs))),
    )


def _surfaces(
    field: Field,
    peaks: _Peaks,
    near: _Neighbours,
    room: _Room,
    blocks: Blocks,
    planes: Planes,
    lens: Lens,
) -> Refined:
    """Return the surfaces through the peaks."""
    blocks(partial(_fit, field, planes, peaks, lens, near, room.work, room.fits))
    blocks(partial(_find_excess, room.fits, room.excess))
    excess = _Excess(*map(_with_others, room.excess))
    shape = planes.time.shape
    refined = Refined(
        planes=planes._replace(time=np.empty(shape), down=np.empty(shape), right=np.empty(shape)),
        error=np.empty(shape),
    )
    blocks(partial(_refine, planes, near, room.fits, excess, peaks, refined))
    return refined


def _with_others(own: np.ndarray) -> np.ndarray:
    """Return the excess of each pixel, and with weight `SHARED` the mean of the square around it.

    own: float64[rows, cols, discs]. NaN does not count, and stays NaN.
    """
    there = ~np.isnan(own)
    square = (SIDE, SIDE, 1)
    total = uniform_filter(np.where(there, own, 0.0), square, mode="constant")
    share = uniform_filter(there.astype(np.float64), square, mode="constant")
    mean = np.divide(total, share, out=np.full(own.shape, np.nan), where=there)
    return (own + SHARED * mean) / (1 + SHARED)


def _neighbours() -> _Neighbours:
    """Return the neighbours of a pixel, as far as the largest disc."""
    reach = np.arange(-HALF, HALF + 1)
    down = np.repeat(reach, len(reach))
    right = np.tile(reach, len(reach))
    square = down**2 + right**2
    order = np.argsort(square, kind="stable")
    bounds = np.searchsorted(square[order], DISCS, side="right")
    order = order[: bounds[-1]]
    down = down[order]
    right = right[order]
    terms = np.ones((len(order), TERMS))
    terms[:, 0] = down**2 / 2
    terms[:, 1] = down * right
    terms[:, 2] = right**2 / 2
    terms[:, DOWN] = down
    terms[:, RIGHT] = right
    return _Neighbours(step=np.stack([down, right], axis=1), terms=terms, bounds=bounds)


@njit(allocates=False)
def _find_peaks(field: Field, planes: Planes, peaks: _Peaks, begin: int, end: int) -> None:
    """Find the peaks of the pixels of some rows."""
    for r in range(begin, end):
        for c in range(planes.time.shape[1]):
            step, middle, here = own_level(field, planes, r, c, 0)
            before = own_level(field, planes, r, c, -1)[2]
            after = own_level(field, planes, r, c, 1)[2]
            at = 0
            for _ in range(CLIMB):
                if after > here and after >= before:
                    at += 1
                    before = here
                    here = after
                    after = own_level(field, planes, r, c, at + 1)[2]
                elif before > here:
                    at -= 1
                    after = here
                    here = before
                    before = own_level(field, planes, r, c, at - 1)[2]
            curve = _through_three(float(before), float(here), float(after))
            peaks.time[r, c] = middle + at * step
            peaks.bend[r, c] = 0.0
            if curve.second < 0:
                off = -curve.first / curve.second
                peaks.time[r, c] += step * min(PEAK_STEPS, max(-PEAK_STEPS, off))
                peaks.bend[r, c] = -curve.second / step**2


@njit(allocates=False)
def _follow_slopes(field: Field, planes: Planes, peaks: _Peaks, begin: int, end: int) -> None:
    """Put the peaks of the pixels of some rows where the parabolas at their planes have them.

    A peak that rules out its plane stays where it is: between two surfaces the slope is small.
    """
    for r in range(begin, end):
        for c in range(planes.time.shape[1]):
            if peaks.bend[r, c] <= 0 or _rules_out(planes, peaks, r, c):
                continue
            step, middle, here = own_level(field, planes, r, c, 0)
            before = own_level(field, planes, r, c, -1)[2]
            after = own_level(field, planes, r, c, 1)[2]
            bend = -_through_three(float(before), float(here), float(after)).second
            if bend > 0:
                peaks.bend[r, c] = bend / step**2
            two_before = own_level(field, planes, r, c, -2)[2]
            two_after = own_level(field, planes, r, c, 2)[2]
            curve = _through_five(
                float(two_before), float(before), float(here), float(after), float(two_after)
            )
            slope = _slope_at(curve, (planes.time[r, c] - middle) / step) / step
            move = slope / peaks.bend[r, c]
            move = min(FROM_SLOPE_TICKS, max(-FROM_SLOPE_TICKS, move))
            peaks.time[r, c] = planes.time[r, c] + move


@njit(allocates=False)
def _fit(
    field: Field,
    planes: Planes,
    peaks: _Peaks,
    lens: Lens,
    near: _Neighbours,
    work: _Work,
    fits: _Fits,
    begin: int,
    end: int,
) -> None:
    """Fit both surfaces to the discs around the pixels of some rows."""
    for r in range(begin, end):
        own = _Work(work.sums[r], work.left[r], work.peaks[r])
        for c in range(planes.time.shape[1]):
            _fit_discs(field, planes, peaks, lens, near, r, c, own, fits)


@njit(allocates=False)
def _find_excess(fits: _Fits, excess: _Excess, begin: int, end: int) -> None:
    """Compute the excess of the discs around the pixels of some rows."""
    excess.plane[begin:end] = np.nan
    excess.curved[begin:end] = np.nan
    for r in range(begin, end):
        for c in range(fits.first.shape[1]):
            first = fits.first[r, c]
            for disc in range(first, fits.end[r, c]):
                curved = fits.curved[r, c, disc]
                plane = fits.plane[r, c, disc]
                excess.plane[r, c, disc] = _exceeds(curved, plane)
                if disc - SMALLER >= first:
                    smaller = fits.curved[r, c, disc - SMALLER]
                    excess.curved[r, c, disc] = _exceeds(smaller, curved)


@part
def _exceeds(noisy: Any, other: Any) -> float:
    """Return by how much the squared difference of two fits exceeds its noise; the peaks of
    `noisy`, which has the larger variance, are those of the other or some of them.
    """
    off = noisy.off - other.off
    return float(off * off - max(0.0, noisy.variance - other.variance))


@njit(allocates=False)
def _refine(
    planes: Planes,
    near: _Neighbours,
    fits: _Fits,
    excess: _Excess,
    peaks: _Peaks,
    refined: Refined,
    begin: int,
    end: int,
) -> None:
    """Compute the refined planes of some rows."""
    for r in range(begin, end):
        for c in range(planes.time.shape[1]):
            best = _choose(near.bounds, fits, excess, r, c)
            rough = _roughness(fits, best.disc, r, c)
            share = _own_share(rough, peaks.bend[r, c])
            own = peaks.time[r, c] - planes.time[r, c]
            off = best.off + share * (own - best.off)
            square = (1 - share) ** 2 * (best.square + rough)
            if share > 0:
                square += share**2 / peaks.bend[r, c]
            moved = 1.0 if abs(off) <= MOVE_TICKS else 0.0
            refined.planes.time[r, c] = planes.time[r, c] + moved * off
            refined.planes.down[r, c] = planes.down[r, c] + moved * best.down
            refined.planes.right[r, c] = planes.right[r, c] + moved * best.right
            error = np.sqrt(GROWTH**2 * square + ERROR_TICKS**2)
            refined.error[r, c] = error if square < np.inf else np.nan


@part
def _fit_discs(
    field: Field,
    planes: Planes,
    peaks: _Peaks,
    lens: Lens,
    near: _Neighbours,
    r: int,
    c: int,
    own: _Work,
    fits: _Fits,
) -> None:
    """Fit both surfaces to the discs around pixel (r, c), until two of them do not agree."""
    own.sums[:] = 0
    own.peaks[0] = 0
    curved = fits.curved[r, c]
    first = 0
    done = 0
    for disc in range(len(near.bounds)):
        for k in range(done, near.bounds[disc]):
            _add_pixel(field, planes, peaks, lens, near, k, r, c, own)
        done = near.bounds[disc]
        fits.first[r, c] = first
        fits.end[r, c] = disc
        if own.sums[LEVEL, LEVEL] == 0:
            first = disc + 1
            continue
        _solve(own, FLAT, fits.plane[r, c, disc])
        _solve(own, 0, curved[disc])
        for smaller in range(first, disc):
            off = curved[disc].off - curved[smaller].off
            noise = max(0.0, curved[smaller].variance - curved[disc].variance)
            if abs(off) > AGREE_SIGMAS * np.sqrt(noise) + AGREE_TICKS:
                return
    fits.first[r, c] = first
    fits.end[r, c] = len(near.bounds)


@part
def _add_pixel(
    field: Field,
    planes: Planes,
    peaks: _Peaks,
    lens: Lens,
    near: _Neighbours,
    k: int,
    r: int,
    c: int,
    own: _Work,
) -> None:
    """Add neighbour k of pixel (r, c) to the sums, if it is on the same surface."""
    rows, cols = planes.time.shape
    rr = r + near.step[k, 0]
    cc = c + near.step[k, 1]
    if not (0 <= rr < rows and 0 <= cc < cols) or peaks.bend[rr, cc] <= 0:
        return
    there = _seen_at(field, planes, lens, r, c, near.step[k, 0], near.step[k, 1])
    here = _seen_at(field, planes, lens, rr, cc, -near.step[k, 0], -near.step[k, 1])
    # A curved surface is as far from the one plane as from the other, and on the same side.
    step = (planes.time[rr, cc] - there) - (planes.time[r, c] - here)
    if abs(step) > 2 * BESIDE_TICKS:
        return
    if _rules_out(planes, peaks, rr, cc):
        return
    weight = peaks.bend[rr, cc]
    terms = near.terms[k]
    sums = own.sums
    off = peaks.time[rr, cc] - there
    for i in range(TERMS):
        weighted = weight * terms[i]
        for j in range(i, TERMS):
            sums[i, j] += weighted * terms[j]
        sums[i, TERMS] += weighted * off
    sums[TERMS, TERMS] += weight * off * off
    own.peaks[0] += 1


@part
def _seen_at(
    field: Field, planes: Planes, lens: Lens, r: int, c: int, down: int, right: int
) -> float:
    """Return the time of the plane of pixel (r, c) so many pixels down and right."""
    time = planes.time[r, c]
    if not lens.there or time < 1:
        return plane_at(field, planes, r, c, float(down), float(right))
    return seen_at(lens, time, planes.down[r, c], planes.right[r, c], r, c, down, right)


@part
def _rules_out(planes: Planes, peaks: _Peaks, r: int, c: int) -> bool:
    """Return whether the peak of a pixel is too far from its plane to be of the same surface."""
    missed = max(0.0, abs(peaks.time[r, c] - planes.time[r, c]) - CURVED_TICKS)
    return missed * missed * peaks.bend[r, c] > OFF_SIGMAS**2


@part
def _solve(own: _Work, first: int, fit: Any) -> None:
    """Compute the fit with the terms from the `first` on.

    The terms are eliminated one after the other. The last one is the level; what is left of its
    square is the inverse of its variance. What is left of the peaks is their scatter.
    """
    left = own.left
    free = own.peaks[0] - 1
    for i in range(first, TERMS + 1):
        for j in range(i, TERMS + 1):
            left[i, j] = own.sums[i, j]
    for i in range(first, LEVEL):
        prior = 1 / (BEND_TICKS if i < FLAT else SLOPE_TICKS) ** 2
        left[i, i] += prior
        free -= 1 - prior / left[i, i]
        for k in range(i + 1, TERMS + 1):
            factor = left[i, k] / left[i, i]
            for j in range(k, TERMS + 1):
                left[k, j] -= factor * left[i, j]
    off = left[LEVEL, TERMS] / left[LEVEL, LEVEL]
    right = (left[RIGHT, TERMS] - left[RIGHT, LEVEL] * off) / left[RIGHT, RIGHT]
    of_down = left[DOWN, TERMS] - left[DOWN, RIGHT] * right - left[DOWN, LEVEL] * off
    fit.off = off
    fit.down = of_down / left[DOWN, DOWN]
    fit.right = right
    fit.variance = 1 / left[LEVEL, LEVEL]
    fit.scatter = left[TERMS, TERMS] - left[LEVEL, TERMS] * off
    fit.free = free
    fit.weight = own.sums[LEVEL, LEVEL] / own.peaks[0]


@part
def _choose(bounds: np.ndarray, fits: _Fits, excess: _Excess, r: int, c: int) -> _Chosen:
    """Return the estimate of pixel (r, c) with the smallest error, among its discs.

    An estimate is between the plane and the curved surface, the nearer to the latter the larger
    the bias of the former.
    """
    first = fits.first[r, c]
    end = fits.end[r, c]
    best = _Chosen(0.0, 0.0, 0.0, np.inf, -1)
    least = np.inf
    plane_bias = 0.0  # squared, of the plane of the disc
    pixels = 1.0  # of the disc before
    for disc in range(end - 1, first - 1, -1):
        plane = fits.plane[r, c, disc]
        curved = fits.curved[r, c, disc]
        noise = max(0.0, curved.variance - plane.variance)
        off = curved.off - plane.off
        plane_bias *= (bounds[disc] / pixels) ** 2
        plane_bias = max(plane_bias, excess.plane[r, c, disc])
        pixels = float(bounds[disc])
        share = plane_bias / (plane_bias + noise) if plane_bias > 0 else 0.0
        scatter = max(1.0, (curved.scatter + SCATTER_PRIOR) / (curved.free + SCATTER_PRIOR))
        variance = scatter * (plane.variance + share * noise)
        square = variance + share * _curved_bias(excess.curved[r, c], first, disc)
        if square < least:
            least = square
            most_bias = 0.0  # of a disc and all smaller ones: by chance, that of one may be small
            for smaller in range(first, disc + 1):
                most_bias = max(most_bias, _curved_bias(excess.curved[r, c], first, smaller))
            best = _Chosen(
                off=plane.off + share * off,
                down=plane.down + share * (curved.down - plane.down),
                right=plane.right + share * (curved.right - plane.right),
                square=variance + share * most_bias,
                disc=disc,
            )
    return best


@part
def _roughness(fits: _Fits, chosen: int, r: int, c: int) -> float:
    """Return the variance by which single pixels around a pixel are off its surface, squared ticks;
    0 if their peaks scatter by no more than they do by chance.

    chosen: disc of the surface; -1: there is none.
    """
    if chosen < 0:
        return 0.0
    fit = fits.curved[r, c, min(fits.end[r, c] - 1, max(chosen, ROUGH_DISC))]
    if fit.free <= 1:
        return 0.0
    sigmas = (fit.scatter - fit.free) / np.sqrt(2 * fit.free)
    sure = min(1.0, max(0.0, (sigmas - ROUGH_SIGMAS) / SURE_SIGMAS))
    if sure == 0:
        return 0.0
    return float(sure * (fit.scatter / fit.free - 1) / fit.weight)


@part
def _own_share(rough: float, bend: float) -> float:
    """Return how far a pixel moves from its surface to its own peak, from 0 to 1."""
    return float(rough * bend / (rough * bend + OWN_DOUBT))


@part
def _curved_bias(excess: np.ndarray, first: int, disc: int) -> float:
    """Return the squared bias of the curved surface of a disc; 0 if no smaller disc tells it.

    excess: of the curved surfaces of the pixel, float64[discs].
    """
    if disc - SMALLER < first:
        return 0.0
    return float(SMALLER_GROWTH * max(0.0, excess[disc]))
