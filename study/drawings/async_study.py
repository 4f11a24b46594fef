# SPDX-License-Identifier: Apache-2.0
"""Pictures of docs/async.md: timing, tdc, skew, window, metastability, reset.

`python -m coincid.study.drawings.async_study [NAME ...]` simulates and draws them again. All pictures except the first are
measured on the Verilog of the cells or of the front end, under Icarus.
"""

import sys
from pathlib import Path

import numpy as np

from ...hdl.silicon.circuit import CELLS, ERROR_BITS, Circuit, lag_fs
from ...model.contract.parameters import Sensor
from ...model.light.code_density import code_density
from ...model.shared.quantities import Numbers
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
TAU_PS, APERTURE_WINDOW_PS = 20.0, 20.0  # resolution time constant and aperture of a flop: assumed values
EDGES_CPS, WINDOWS_CPS = 64e6, 16e6  # of a subgroup in full sunlight, approximate


def bench(picture: str) -> Path:
    """Return the bench that measures the content of a picture."""
    return Path(__file__).with_name(f"async_{picture}.v")


def quiet() -> dict[str, str]:
    """Return the files that benches of a front end in an endless frame include."""
    path = Path(__file__).with_name("async_quiet.vh")
    return {path.name: path.read_text()}


def cells() -> dict[str, str]:
    return {CELLS.name: CELLS.read_text()}


def taps(seed: int) -> np.ndarray:
    """Return the errors of an example generator's borders, in ps; those of a tap's rise and fall are independent."""
    return np.random.default_rng(seed).normal(0, SIGMA_PS, SENSOR.phases)


def timing() -> None:
    """Draw two windows in two banks: one that closes in its own cycle, and the next one."""
    lag = lag_fs(SENSOR) / CLOCK_FS
    rows: list[tuple[str, list[tuple[float, float]], str]] = [  # name, when it is high, colour
        ("clk", [(k, k + 0.5) for k in range(5)], INK),
        ("phases[0]", [(k + lag, k + lag + 0.5) for k in range(5)], INK),
        ("SPAD a", [(0.55, 0.6)], ORANGE),
        ("SPAD b", [(0.8, 0.85)], ORANGE),
        ("SPAD c (next window)", [(1.05, 1.1)], PINK),
        ("hits, even cycles", [(0.57, 1.75)], GREEN),
        ("hits, odd cycles", [(1.07, 2.75)], GREEN),
        ("root, even", [(0.55 + lag, 1.77)], VIOLET),
        ("root, odd", [(1.05 + lag, 2.77)], VIOLET),
        ("bank 0 ended (picture)", [(1.0 + lag + 0.25, 1.78)], "#365c8d"),
        ("bank 1 open (listened from cycle 1 on)", [(1.05 + lag, 4.9)], "#365c8d"),
        ("mark", [(k + lag + 0.25 + 1 / 64, k + lag + 0.75) for k in range(5)], "#888888"),
        ("wipe", [(k + 0.75, k + 0.9375) for k in range(5)], "#888888"),
        ("current bank is 1", [(1.5, 5)], "#b8860b"),
        ("stage 2 holds cycle 0", [(2, 3)], "#b8860b"),
    ]
    with style():
        figure = new_figure(9, 4.6)
        axis = figure.subplots()
        for y, (_, spans, colour) in enumerate(rows):
            axis.broken_barh([(a, b - a) for a, b in spans], (-y, 0.6), color=colour)
            axis.axhline(-y, color=colour, linewidth=0.5)
        axis.set_yticks([0.3 - y for y in range(len(rows))], [name for name, *_ in rows])
        axis.set_xlim(0, 5)
        axis.set_xlabel("time in clock cycles")
        save_figure(figure, image("async_timing.svg"))


def tdc() -> None:
    """Draw DNL and INL of a generator with mismatched taps, by the code density test on its line, and the stamps' bias."""
    errors, events = taps(1), 40_000
    packed = sum(int(round(e * FS_PER_PS)) % (1 << ERROR_BITS) << ERROR_BITS * k for k, e in enumerate(errors))
    half = SENSOR.phases // 2
    parameters = {
        "PHASES": SENSOR.phases,
        "CLOCK_FS": CLOCK_FS,
        "LAG_FS": lag_fs(SENSOR),
        "ERROR_BITS": ERROR_BITS,
        "MISMATCH_FS": packed,
        "EVENTS": events,
    }
    lines = run_bench(bench("tdc"), cells(), parameters=parameters)
    codes = np.array([[int(bit) for bit in line[::-1]] for line in lines if set(line) <= {"0", "1"}])
    tick = np.where(codes[:, 0] == 1, codes.sum(1) - 1, half + (half - codes.sum(1)) - 1)
    found = code_density(tick, SENSOR.phases)
    truth = np.diff(np.append(errors, errors[0])) / TICK_PS
    centre = (errors + np.roll(errors, -1)) / 2
    with style():
        figure = new_figure(9, 3.2)
        left, right = figure.subplots(1, 2)
        left.bar(np.arange(SENSOR.phases), truth, color=LIGHT_GREY, label="borders as given")
        left.errorbar(
            np.arange(SENSOR.phases),
            found.dnl_lsb,
            2 * found.sigma_lsb,
            fmt="o",
            color=GREEN,
            label="DNL, code density (2 sigma)",
        )
        left.plot(np.arange(SENSOR.phases), found.inl_lsb, color=ORANGE, label="INL")
        left.set_xlabel("phase")
        left.set_ylabel("LSB")
        left.legend()
        right.plot(np.arange(SENSOR.phases), centre, "o-", color=VIOLET)
        right.axhline(0, color=INK, linewidth=0.8)
        right.set_xlabel("phase")
        right.set_ylabel("bias of the stamp in ps")
        right.set_title(f"rms {np.sqrt((centre**2).mean()):.1f} ps, {len(tick)} events")
        save_figure(figure, image("async_tdc.png"))
    print(
        f"tdc: worst difference of DNL from the borders {np.abs(found.dnl_lsb - truth).max():.3f} LSB, {len(tick)} events"
    )


def skew() -> None:
    """Draw the stamps of pixels with different delays to the tree, and of a tree without mismatch, at uniform phases."""
    sensor = Sensor(rows=4, cols=4, subgroup=(4, 4))
    way_ps = np.round(np.random.default_rng(2).normal(0, 25, sensor.pixels)) + 80
    front = Front(sensor, Circuit(pixel_skew_fs=tuple(int(w * FS_PER_PS) for w in way_ps)))
    events = 30
    lines = run_bench(bench("skew"), front.files() | quiet(), parameters={"EVENTS": events * sensor.pixels})
    pixel, edge, stamp = np.array([line.split() for line in lines if len(line.split()) == 3], float).T
    wrap = CYCLE_PS * (1 << sensor.coarse_bits)
    error = (stamp * TICK_PS - edge + TICK_PS / 2) % wrap
    error = error - np.median(error)
    error = (error + wrap / 2) % wrap - wrap / 2
    bias = np.array([error[pixel == i].mean() for i in range(sensor.pixels)])
    bias -= (bias - way_ps).mean()
    with style():
        figure = new_figure(8.5, 3.2)
        left, right = figure.subplots(1, 2)
        left.plot(way_ps, bias, "o", color=GREEN)
        left.plot([0, 150], [0, 150], color=INK, linewidth=0.8, label="as long as the way")
        left.set_xlabel("extra way to the tree in ps")
        left.set_ylabel("bias of the stamp in ps")
        left.legend()
        right.hist(error[pixel == 0] - error[pixel == 0].mean(), bins=20, color=VIOLET)
        right.set_xlabel("error of one pixel's stamps in ps")
        right.set_title(f"sigma {error[pixel == 0].std():.1f} ps; a tick gives {TICK_PS / np.sqrt(12):.1f} ps")
        save_figure(figure, image("async_skew.png"))
    print(f"skew: bias - way {np.std(bias - way_ps):.2f} ps rms over pixels, {len(error)} events")


def window() -> None:
    """Draw the error of a window's end, for counted borders, and for delay lines with a gain error."""
    cases = (("borders counted", 0, 0), ("line, exact", 1, 0), ("line, +0.4 %", 1, 4000), ("line, +1 %", 1, 10000))
    starts, ticks = 400, SENSOR.window_max
    results = {}
    for name, line, ppm in cases:
        parameters = {"LINE": line, "GAIN_PPM": ppm, "TICKS": ticks, "STARTS": starts}
        parameters |= {"PHASES": SENSOR.phases, "CLOCK_FS": CLOCK_FS}
        lines = run_bench(bench("window"), cells(), parameters=parameters)
        began, ended = np.array([line.split() for line in lines if len(line.split()) == 2], float).T
        began, ended = began - CYCLE_PS / 2, ended - CYCLE_PS / 2  # the first rising edge
        due = (np.floor(began / TICK_PS) + ticks) * TICK_PS
        results[name] = (ended - CYCLE_PS / 4 - due) / TICK_PS
    with style():
        figure = new_figure(8, 3.2)
        axis = figure.subplots()
        at = np.linspace(-1.5, 2, 400)
        for (name, error), colour in zip(results.items(), (GREEN, VIOLET, ORANGE, PINK)):
            axis.plot(at, [(error > x).mean() for x in at], color=colour, label=name)
        axis.axvspan(-1, 1, color=PALE_GREY, zorder=0, label="a tick either way")
        axis.set_xlabel(f"edge against the end of a window of {ticks} ticks, in ticks")
        axis.set_ylabel("share that is counted")
        axis.legend()
        save_figure(figure, image("async_window.png"))
    for name, error in results.items():
        print(f"window: {name}: end {error.min():+.2f} to {error.max():+.2f} ticks off")


def metastability() -> None:
    """Draw the mean time between failures against the time to resolve (formula), and the flops of the design."""
    lag = lag_fs(SENSOR) / CLOCK_FS
    points = {  # cycles to resolve in, events per second, borders per cycle that they can meet
        "hit at a cycle's border, read at mid-cycle": (0.5, EDGES_CPS, 1),
        "sampled phase, read by the clock": (1 - lag, WINDOWS_CPS, SENSOR.phases),
        "picture, read by the clock": (1 - lag - 0.25, WINDOWS_CPS, SENSOR.phases),
        "window's own phase (costs a tick, no word)": (0.25, WINDOWS_CPS, SENSOR.phases),
    }
    given = np.linspace(0, 1, 200)

    def years(cycles: Numbers, rate: float, borders: int) -> Numbers:
        met = APERTURE_WINDOW_PS * borders / CYCLE_PS  # share of events that meet a border
        return np.exp(cycles * CYCLE_PS / TAU_PS) / (met * rate) / (365 * 86400)

    with style():
        figure = new_figure(8, 3.4)
        axis = figure.subplots()
        for borders, line in ((1, "-"), (SENSOR.phases, "--")):
            label = f"borders that an event can meet in a cycle: {borders}"
            axis.semilogy(given, years(given, WINDOWS_CPS, borders), line, color=INK, label=label)
        for (name, point), colour in zip(points.items(), (GREEN, ORANGE, VIOLET, PINK)):
            axis.plot(point[0], years(*point), "o", color=colour, label=name)
            print(f"metastability: {name}: {point[0] * CYCLE_PS:.0f} ps, {years(*point):.1e} years a subgroup")
        axis.set_title(f"tau {TAU_PS:g} ps, aperture {APERTURE_WINDOW_PS:g} ps: assumed")
        axis.set_xlabel("time to resolve in clock cycles")
        axis.set_ylabel("years between failures")
        axis.legend()
        save_figure(figure, image("async_metastability.png"))


def reset() -> None:
    """Draw single edges at the border of two cycles, where the banks of hit flops change; flops may fall to either side."""
    sensor = Sensor(rows=4, cols=4, subgroup=(4, 4))
    front = Front(sensor, Circuit())
    offsets = np.arange(-60, 61, 5)  # ps, with the same steps as async_reset.v
    trials = 24
    parameters = {"EVENTS": len(offsets) * trials, "OFFSETS": len(offsets)}
    lines = run_bench(bench("reset"), front.files() | quiet(), parameters=parameters, aperture=True)
    index, words, wrong = np.array([line.split() for line in lines if len(line.split()) == 3], int).T
    with style():
        figure = new_figure(8, 3.2)
        axis = figure.subplots()
        bottom = np.zeros(len(offsets))
        for count, name, colour in ((1, "one word", GREEN), (2, "two words", ORANGE), (0, "none", LIGHT_GREY)):
            share = np.array([(words[index == k] == count).mean() for k in range(len(offsets))])
            axis.bar(offsets, share, 4.6, bottom, color=colour, label=name)
            bottom += share
        axis.set_xlabel(
            f"edge against the border of two cycles in ps; flops fall either way for {APERTURE_PS} ps after their data moved"
        )
        axis.set_ylabel("share of edges")
        axis.set_title(f"{len(words)} edges, {int(wrong.sum())} wrong words")
        legend_below(figure)
        save_figure(figure, image("async_reset.png"))
    print(
        f"reset: {len(words)} edges, {int(wrong.sum())} wrong words; none {np.mean(words == 0):.3f}, two {np.mean(words == 2):.3f}"
    )


PICTURES = {function.__name__: function for function in (timing, tdc, skew, window, metastability, reset)}

if __name__ == "__main__":
    for name in sys.argv[1:] or PICTURES:
        PICTURES[name]()
