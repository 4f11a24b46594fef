# SPDX-License-Identifier: Apache-2.0
"""Pictures of docs/async.md: tdc, skew, window, reset.

`python -m coincid.study.drawings.async_study [NAME ...]` simulates and draws them again. They are measured on the Verilog
of the cells or of the front end, under Icarus.
"""

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from ...hdl.silicon.circuit import CELLS, ERROR_BITS, Circuit, lag_fs
from ...model.contract.parameters import Sensor
from ...model.light.code_density import code_density
from ...tb.stimulus import FS_PER_PS
from ...tb.stress import APERTURE_PS, Front, run_bench
from ..palette import GREEN, INK, LIGHT_GREY, ORANGE, PALE_GREY, PINK, VIOLET
from ..plot_style import legend_below, new_figure, save_figure, style
from . import image

SENSOR = Sensor()
CLOCK_FS = Circuit().clock_fs
TICK_PS = CLOCK_FS / SENSOR.phases / FS_PER_PS
CYCLE_PS = CLOCK_FS / FS_PER_PS
SIGMA_PS = 0.1 * TICK_PS  # of the border of a tap, in the example


def lines(picture: str, columns: int, files: dict[str, str] | None = None, **options: Any) -> np.ndarray:
    """Return the lines that the bench of a picture prints, as float64[lines, columns]. files: None: the cells alone."""
    here = Path(__file__).parent
    quiet = here / "async_quiet.vh"  # a front end in an endless frame
    given = {CELLS.name: CELLS.read_text()} if files is None else files | {quiet.name: quiet.read_text()}
    told = map(str.split, run_bench(here / f"async_{picture}.v", given, **options))
    return np.array([words for words in told if len(words) == columns], float)


@contextmanager
def drawn(picture: str, width_in: float, columns: int = 1, ylabel: str = "") -> Iterator[Any]:
    """Yield the axes of a picture, side by side, and save it."""
    with style():
        figure = new_figure(width_in, 3.2)
        axes = figure.subplots(1, columns)
        np.ravel(axes)[0].set_ylabel(ylabel)
        yield axes
        save_figure(figure, image(f"async_{picture}.png"))


def tdc() -> None:
    """Draw DNL and INL of a generator with mismatched taps, by the code density test on its line, and the stamps' bias."""
    errors = np.random.default_rng(1).normal(0, SIGMA_PS, SENSOR.phases)  # of the borders, in ps
    packed = sum(int(round(e * FS_PER_PS)) % (1 << ERROR_BITS) << ERROR_BITS * k for k, e in enumerate(errors))
    half = SENSOR.phases // 2
    parameters = {"PHASES": SENSOR.phases, "CLOCK_FS": CLOCK_FS, "LAG_FS": lag_fs(SENSOR)}
    parameters |= {"ERROR_BITS": ERROR_BITS, "MISMATCH_FS": packed, "EVENTS": 40_000}
    told = run_bench(Path(__file__).with_name("async_tdc.v"), {CELLS.name: CELLS.read_text()}, parameters=parameters)
    codes = np.array([[int(bit) for bit in line[::-1]] for line in told if set(line) <= {"0", "1"}])
    tick = np.where(codes[:, 0] == 1, codes.sum(1) - 1, half + (half - codes.sum(1)) - 1)
    found = code_density(tick, SENSOR.phases)
    truth = np.diff(np.append(errors, errors[0])) / TICK_PS
    centre = (errors + np.roll(errors, -1)) / 2
    with drawn("tdc", 9, 2, "LSB") as (left, right):
        phase = np.arange(SENSOR.phases)
        left.bar(phase, truth, color=LIGHT_GREY, label="borders as given")
        density = "DNL, code density (2 sigma)"
        left.errorbar(phase, found.dnl_lsb, 2 * found.sigma_lsb, fmt="o", color=GREEN, label=density)
        left.plot(phase, found.inl_lsb, color=ORANGE, label="INL")
        left.set_xlabel("phase")
        left.legend()
        right.plot(phase, centre, "o-", color=VIOLET)
        right.axhline(0, color=INK, linewidth=0.8)
        right.set(xlabel="phase", ylabel="bias of the stamp in ps")
        right.set_title(f"rms {np.sqrt((centre**2).mean()):.1f} ps, {len(tick)} events")
    worst = np.abs(found.dnl_lsb - truth).max()
    print(f"tdc: worst difference of DNL from the borders {worst:.3f} LSB, {len(tick)} events")


def skew() -> None:
    """Draw the stamps of pixels with different delays to the tree, and of a tree without mismatch, at uniform phases."""
    sensor = Sensor(rows=4, cols=4, subgroup=(4, 4))
    way_ps = np.round(np.random.default_rng(2).normal(0, 25, sensor.pixels)) + 80
    front = Front(sensor, Circuit(pixel_skew_fs=tuple(int(w * FS_PER_PS) for w in way_ps)))
    pixel, edge, stamp = lines("skew", 3, front.files(), parameters={"EVENTS": 30 * sensor.pixels}).T
    wrap = CYCLE_PS * (1 << sensor.coarse_bits)
    error = (stamp * TICK_PS - edge + TICK_PS / 2) % wrap
    error = error - np.median(error)
    error = (error + wrap / 2) % wrap - wrap / 2
    bias = np.array([error[pixel == i].mean() for i in range(sensor.pixels)])
    bias -= (bias - way_ps).mean()
    with drawn("skew", 8.5, 2, "bias of the stamp in ps") as (left, right):
        left.plot(way_ps, bias, "o", color=GREEN)
        left.plot([0, 150], [0, 150], color=INK, linewidth=0.8, label="as long as the way")
        left.set_xlabel("extra way to the tree in ps")
        left.legend()
        right.hist(error[pixel == 0] - error[pixel == 0].mean(), bins=20, color=VIOLET)
        right.set_xlabel("error of one pixel's stamps in ps")
        right.set_title(f"sigma {error[pixel == 0].std():.1f} ps; a tick gives {TICK_PS / np.sqrt(12):.1f} ps")
    print(f"skew: bias - way {np.std(bias - way_ps):.2f} ps rms over pixels, {len(error)} events")


def window() -> None:
    """Draw the error of a window's end, for counted borders, and for delay lines with a gain error."""
    ticks = SENSOR.window_max
    cases = (("borders counted", 0, 0), ("line, exact", 1, 0), ("line, +0.4 %", 1, 4000), ("line, +1 %", 1, 10000))
    with drawn("window", 8, ylabel="share that is counted") as axis:
        at = np.linspace(-1.5, 2, 400)
        for (name, line, ppm), colour in zip(cases, (GREEN, VIOLET, ORANGE, PINK)):
            parameters = {"LINE": line, "GAIN_PPM": ppm, "TICKS": ticks, "STARTS": 400}
            parameters |= {"PHASES": SENSOR.phases, "CLOCK_FS": CLOCK_FS}
            began, ended = lines("window", 2, parameters=parameters).T - CYCLE_PS / 2  # the first rising edge
            due = (np.floor(began / TICK_PS) + ticks) * TICK_PS
            error = (ended - CYCLE_PS / 4 - due) / TICK_PS
            axis.plot(at, [(error > x).mean() for x in at], color=colour, label=name)
            print(f"window: {name}: end {error.min():+.2f} to {error.max():+.2f} ticks off")
        axis.axvspan(-1, 1, color=PALE_GREY, zorder=0, label="a tick either way")
        axis.set_xlabel(f"edge against the end of a window of {ticks} ticks, in ticks")
        axis.legend()


def reset() -> None:
    """Draw single edges at the border of two cycles, where the banks of hit flops change; flops may fall to either side."""
    front = Front(Sensor(rows=4, cols=4, subgroup=(4, 4)), Circuit())
    offsets = np.arange(-60, 61, 5)  # ps, with the same steps as async_reset.v
    parameters = {"EVENTS": 24 * len(offsets), "OFFSETS": len(offsets)}
    index, words, wrong = lines("reset", 3, front.files(), parameters=parameters, aperture=True).T
    with drawn("reset", 8, ylabel="share of edges") as axis:
        bottom = np.zeros(len(offsets))
        for count, name, colour in ((1, "one word", GREEN), (2, "two words", ORANGE), (0, "none", LIGHT_GREY)):
            share = np.array([(words[index == k] == count).mean() for k in range(len(offsets))])
            axis.bar(offsets, share, 4.6, bottom, color=colour, label=name)
            bottom += share
        when = f"flops fall either way for {APERTURE_PS} ps after their data moved"
        axis.set_xlabel(f"edge against the border of two cycles in ps; {when}")
        axis.set_title(f"{len(words)} edges, {int(wrong.sum())} wrong words")
        legend_below(axis.figure)
    shares = f"none {np.mean(words == 0):.3f}, two {np.mean(words == 2):.3f}"
    print(f"reset: {len(words)} edges, {int(wrong.sum())} wrong words; {shares}")


PICTURES = {function.__name__: function for function in (tdc, skew, window, reset)}

if __name__ == "__main__":
    for name in sys.argv[1:] or PICTURES:
        PICTURES[name]()
