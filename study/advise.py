# SPDX-License-Identifier: Apache-2.0
"""Finds the threshold, window, format and link that suit a scene and its light: `coincid advise`.

All thresholds and windows see the same photons. Several of them leave about the fewest wrong pixels
and do not overload the link; the one of these with the fewest bits is chosen. For it, the slowest
sufficient link is advised, and the format with the fewest bits on this link. A sensor with counts
also tries the format `counts`, in which thresholds and windows have no effect; for another one, the
advice says what counts would do. If none of them leaves a useful picture, the advice says so, and
what would help.
"""

import math
import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from attrs import Factory, evolve, field, frozen

from ..lab.bound import median_light, photon_bound_mm, too_short, usual_open_share, word_bounds_mm
from ..lab.outcomes import Frame, Run
from ..lab.pace import frames_per_s, told_pace
from ..lab.setup import SETTLING, Setup
from ..model.contract.config import Config
from ..model.contract.link import SHARE_MIN, stream_gbps
from ..model.contract.packet import BEAT_BITS
from ..model.depth.pulse_ticks import pulse_ticks
from ..model.golden.frame import Golden
from ..model.light.photons import edge_chunks
from ..model.scenes.scene import Scene
from ..model.shared.errors import InputError
from ..model.shared.files import whole_file, write_csv
from ..model.shared.quantities import check_real
from .config_file import config_text
from .palette import ALARM, GREY, SERIES
from .plot_style import new_figure, save_figure, style
from .price import um2_per_pixel, uw_per_pixel, while_measured
from .progress import first_time
from .usefulness import is_useful, useless_sentence

THRESHOLDS = (1, 2, 3, 4, 5, 6)
LIMITED = (1, 2, 3)  # thresholds whose cost in millimetres is told
WINDOWS_NS = (0.5, 1.0, 2.0)
LINKS_GBPS = (1.0, 2.0, 4.0, 8.0, 16.0)
SLOW_LINKS_GBPS = (0.05, 0.1, 0.25, 0.5)  # that are tried if the pulses are apart
FIRST_LINK_GBPS = 8.0  # with which thresholds and windows are compared
FORMATS = ("compact", "id")
COUNTS = "counts"  # that is tried, too, if the sensor has it
# more wrong pixels that count as equal: as a share of all, and of the best one's wrong pixels
WORSE_MAX = 0.002, 0.1
# share of the events; a link that drops more, or has a load above 1, is overloaded
DROPPED_MAX = 0.01
# an overload is advised only if everything else leaves more than so many times as many wrong pixels
OVERLOAD_GAIN = 2
TABLE, PICTURE, SETTINGS = "advise.csv", "advise.png", "advised.toml"
HEADS = (
    "threshold",
    "window, ns",
    "format",
    "link, Gbit/s",
    "wrong pixels",
    "off by 15 cm",
    "error, mm",
    "bits per frame",
    "dropped",
    "link load",
    "frames per second",
)
Progress = Callable[[str, int, int], None]  # stage, done, in total


@frozen(kw_only=True)
class Tried:
    """A configuration, and the outcome of its last frame. With counts, there is no threshold, and
    window_ns is NaN. wrong, far: shares of pixels; error_mm:
    RMS of the pixels that are not wrong, NaN if all are; load: of the link.
    """

    config: Config
    wrong: float
    far: float
    error_mm: float
    bits: int
    dropped: float
    load: float

    @property
    def threshold(self) -> str:
        if self.config.counting:
            return "none"
        return "controller" if self.config.auto.any() else str(self.config.threshold[0])

    @property
    def window_ns(self) -> float:
        if self.config.counting:
            return math.nan
        return float(self.config.window[0] * self.config.tick_s * 1e9)

    @property
    def link_gbps(self) -> float:
        return float(self.config.frame.link_gbps or BEAT_BITS * self.config.clock_mhz / 1e3)

    @property
    def frames_per_s(self) -> float:
        """Frames per second if one begins as soon as the periods of the last one end."""
        return frames_per_s(self.config)

    @property
    def overloaded(self) -> bool:
        return self.load > 1 or self.dropped > DROPPED_MAX

    def row(self) -> tuple[Any, ...]:
        """Return the values under `HEADS`."""
        return (
            self.threshold, self.window_ns, self.config.format, self.link_gbps,
            self.wrong, self.far, self.error_mm, self.bits, self.dropped, self.load,
            self.frames_per_s,
        )  # fmt: skip


@frozen(kw_only=True)
class Advice:
    """What was tried, and what is advised.

    settings: thresholds and windows, all with the link `FIRST_LINK_GBPS`; chosen: the best of them.
    links: links and formats for `chosen`; best: the advised one. klux: the light for which the
    power is told. limit: what a threshold costs in millimetres. useless: sentences about a scene of
    which no setting leaves a useful picture; "" if one does. counts: what counts would do; "" if
    they were tried as a format. advised: the configuration that is written.
    """

    settings: list[Tried]
    chosen: Tried
    links: list[Tried]
    best: Tried
    klux: float
    limit: str = ""
    useless: str = ""
    counts: str = ""
    advised: Config = field(default=Factory(lambda self: self.best.config, takes_self=True))

    @property
    def tried(self) -> list[Tried]:
        """All configurations, in the order in which they were tried."""
        return [*self.settings, *self.links]

    @property
    def price(self) -> str:
        """Return the power and area of the sensor; thresholds, windows and links do not change
        them.
        """
        config = self.best.config
        mw = uw_per_pixel(config, self.klux) / 1e3
        return f"about {mw:.2g} mW{while_measured(config)} and {um2_per_pixel(config.sensor):.0f} um2 per pixel in 45 nm"

    @property
    def sentence(self) -> str:
        best, config = self.best, self.best.config
        threshold = "the controller" if config.auto.any() else f"threshold {best.threshold}"
        rate_gbps = (
            best.bits / config.sensor.streams / (config.frame_cycles / config.clock_mhz * 1e3)
        )
        window = int(config.window[0])
        ticks = f"{window} tick{'s' * (window > 1)}"
        start = "The least bad: take" if self.useless else "Take"
        settings = (
            ""
            if config.counting
            else f"{threshold}, a window of {best.window_ns:.3g} ns ({ticks}), "
        )
        text = (
            f"{start} {settings}the format {config.format} and a link of {best.link_gbps:g} Gbit/s: {best.wrong:.1%} of the"
            f" pixels are wrong ({best.far:.1%} by more than 15 cm), for {best.bits:,} bits per"
            f" frame ({rate_gbps:.2g} Gbit/s), and {self.price}."
        )
        return f"{text} {self._pace(rate_gbps)}{self._overload()}".strip()

    def _pace(self, rate_gbps: float) -> str:
        """Return what is to be said about a frame with gaps."""
        config = self.best.config
        if not config.gap:
            return ""
        mean = f"a stream carries {rate_gbps * 1e3:.3g} Mbit/s in the mean"
        return f"With this gap there are {told_pace(config)}, and {mean}. "

    def _overload(self) -> str:
        """Return what is to be said about an overloaded link."""
        best = self.best
        if not best.overloaded:
            return ""
        dropped = f"{best.load:.0%}, {best.dropped:.1%} of the events dropped"
        if all(one.overloaded for one in self.tried):
            return (
                f"Everything that was tried overloads its link ({dropped}). More laser pulses per"
                " frame or more streams help."
            )
        least = min(one.wrong for one in self.tried if not one.overloaded)
        return (
            f"The link is overloaded ({dropped}); what was tried without an overload leaves"
            f" {least:.1%} of the pixels wrong."
        )


def advise(
    setup: Setup, *, klux: float, progress: Progress = lambda stage, done, total: None
) -> Advice:
    """Try thresholds, windows, the controller, links and formats on a setup's scene and light.
    Raises `InputError`.

    klux: ambient light, for the power. The sensor, its clock, period and pulses are those of the
    setup.
    """
    scene = setup.seen
    asked = setup.config
    frames = scene.pictures if scene.later else SETTLING + 1
    setup = setup.but(
        frame={"frames": frames, "format": FORMATS[0], "link_gbps": FIRST_LINK_GBPS},
        estimators=("planes",),
    )
    windows = sorted(
        {
            min(setup.config.sensor.window_max, max(1, round(ns * 1e-9 / setup.config.tick_s)))
            for ns in WINDOWS_NS
        }
    )
    klux = check_real("klux", klux, 0)
    workers = os.cpu_count() or 1
    run = Run(setup, workers=workers)
    progress(first_time("photons", edge_chunks.__module__), 0, 1)
    _ = run.edges
    rows = len(windows) * (len(THRESHOLDS) + setup.config.sensor.controller)

    def tell(stage: str, found: Iterator[Tried], total: int) -> list[Tried]:
        tried: list[Tried] = []
        progress(stage, 0, total)
        for one in found:
            tried.append(one)
            progress(stage, len(tried), total)
        return tried

    stage = first_time("thresholds and windows", Golden.__module__)
    settings = tell(stage, _settings(run, windows), rows)
    chosen = cheapest(settings, lambda one: one.bits)
    rates_gbps = links_of(run.config)
    counting = _in_counts(run.config)
    has_counts = run.config.sensor.counts and counting is not None
    formats = (*FORMATS, COUNTS) if has_counts else FORMATS
    found = _links(run, chosen.config, rates_gbps, formats)
    links = tell("links and formats", found, len(rates_gbps) * len(formats))
    best = cheapest(links, lambda one: (one.link_gbps, one.bits))
    useless = ""
    least_wrong = min(one.wrong for one in (*settings, *links))
    if not is_useful(least_wrong):
        progress("what would help", 0, 1)
        last = setup.but(scene=scene.at(frames - 1))
        useless = useless_sentence(least_wrong, last, int(best.config.window[0]), workers)
    return Advice(
        settings=settings,
        chosen=chosen,
        links=links,
        best=best,
        klux=klux,
        limit=_limit(run, best.config),
        useless=useless,
        counts="" if has_counts or counting is None else _with_counts(run, counting),
        advised=_with_asked_frames(best.config, asked, scene),
    )


def _with_asked_frames(advised: Config, asked: Config, scene: Scene) -> Config:
    """Return an advised configuration with the number of frames that was asked for, else without
    one: those that were played say nothing about the user's.

    A scene that moves has a frame for each picture anyway. A controller keeps the frames in which
    it has settled.
    """
    has_own = scene.later and asked.frames == scene.pictures
    if "frame.frames" in asked.given and not has_own:
        return advised.with_frame(frames=asked.frames)
    if advised.auto.any() and not scene.later:
        return advised
    without = advised.with_frame(frames=asked.frames)
    return evolve(without, given=without.given - {"frame.frames"})


def _in_counts(config: Config) -> Config | None:
    """Return the configuration of one frame of counts, on a sensor that has them; None if its
    minigroups have another size, or the frame too few pulses.
    """
    try:
        return config.with_sensor(counts=1).with_frame(frames=1, format=COUNTS)
    except InputError:
        return None


def _with_counts(run: Run, config: Config) -> str:
    """Return a sentence about the same sensor with counts. config: that of a frame of counts."""
    counted = _tried(run.alone(-1, config=config))
    return (
        f"With counts (counts = 1, format = {COUNTS}), the sensor would send {counted.bits:,} bits per"
        f" frame, and {counted.wrong:.1%} of the pixels would be wrong ({counted.far:.1%} by more than"
        f" 15 cm), at {counted.frames_per_s:,.4g} frames per second."
    )


def _limit(run: Run, config: Config) -> str:
    """Return a sentence about the lowest possible errors at the median light, by threshold."""
    seen = run.light_of(-1)  # of the frame that is judged
    light = median_light(seen)
    if light is None:
        return "No pixel has light."
    usual = config.with_settings(coincidence=True, auto=False)
    pulse = pulse_ticks(usual, pulse=run.pulse)
    if too_short(pulse):
        return "The pulse is much shorter than a tick, so no limit of its words is told."
    lit_share = usual_open_share(usual, seen)
    of_words = []
    for threshold in LIMITED:
        lowest = word_bounds_mm(usual.with_settings(threshold=threshold), *light, pulse, lit_share)
        if math.isinf(lowest.pixel_mm):
            return "Subgroup 0 has no events of this light, so no limit of its words is told."
        of_words.append(f"{lowest.pixel_mm:.1f} mm at threshold {threshold}")
    photons_mm = photon_bound_mm(usual, *light, pulse)
    return (
        f"The limit of a pixel with the median light ({light.signal_per_pulse:.2g} photons per"
        f" pulse), without its neighbours' distances: {photons_mm:.1f} mm from all photons; from the words"
        f" {', '.join(of_words)}."
    )


def _settings(run: Run, windows: list[int]) -> Iterator[Tried]:
    for window in windows:
        for threshold in THRESHOLDS:
            yield _tried(
                run.alone(
                    -1,
                    subgroup={
                        "auto": False,
                        "coincidence": True,
                        "threshold": threshold,
                        "window": window,
                    },
                )
            )
        if run.config.sensor.controller:
            yield _tried(run.but(subgroup={"auto": True, "coincidence": True, "window": window}))


def links_of(config: Config) -> list[float]:
    """Return the rates of the links that are tried. Links may be slower if the pulses are apart."""
    slow = SLOW_LINKS_GBPS if config.gap else ()
    slowest_gbps = float(stream_gbps(config.clock_mhz) * SHARE_MIN)
    return [rate_gbps for rate_gbps in (*slow, *LINKS_GBPS) if rate_gbps >= slowest_gbps]


def _links(
    run: Run, chosen: Config, rates_gbps: list[float], formats: tuple[str, ...]
) -> Iterator[Tried]:
    """Try the links and formats for the settings of `chosen`."""
    searched = "coincidence", "auto", "threshold", "window"
    subgroup = {name: getattr(chosen, name) for name in searched}
    start = run.but(subgroup=subgroup) if chosen.auto.any() else run.alone(-1, subgroup=subgroup)
    for link_gbps in rates_gbps:
        for packets in formats:
            settings = {"link_gbps": link_gbps, "format": packets}
            if packets == COUNTS:
                yield _tried(run.alone(-1, frame=settings))
            else:
                yield _tried(start.but(frame=settings))


def _tried(run: Run) -> Tried:
    frame: Frame = run.frame()
    wrong, far, error_m = (
        frame[name] for name in ("wrong_share", "wrong_share_15cm", "right_rms_m")
    )
    return Tried(
        config=run.config,
        wrong=1.0 if wrong is None else wrong,
        far=1.0 if far is None else far,
        error_mm=math.nan if error_m is None else 1e3 * error_m,
        bits=int(frame["bits"] or 0),
        # a counter of drops that is at its end has counted too many
        dropped=frame["dropped_share"] or 0.0 if frame.knows("dropped") else 1.0,
        load=frame["link_load"] or 0.0,
    )


def cheapest(tried: list[Tried], price: Callable[[Tried], Any]) -> Tried:
    """Return the one with the lowest price among those that are about as good as the best one.

    One that is not overloaded comes first, unless all of them leave no useful picture, or more than
    `OVERLOAD_GAIN` times as many pixels wrong. Among overloaded ones, the fewest drops come first,
    not the price.
    """
    absolute, relative = WORSE_MAX
    least = min(one.wrong for one in tried)
    fitting = [one for one in tried if not one.overloaded]
    least_fitting = min((one.wrong for one in fitting), default=math.inf)
    if is_useful(least_fitting) and least_fitting <= OVERLOAD_GAIN * least + absolute:
        good = least_fitting + max(absolute, relative * least_fitting)
        return min((one for one in fitting if one.wrong <= good), key=price)
    good = least + max(absolute, relative * least)
    return min((one for one in tried if one.wrong <= good), key=lambda one: (one.dropped, one.load))


def write_advice(out: Path, advice: Advice, heading: str) -> list[Path]:
    """Write the table (CSV), the picture of the trade-off, and the advised settings; return the
    files.
    """
    files = [out / name for name in (TABLE, PICTURE, SETTINGS)]
    write_csv(files[0], [HEADS, *(one.row() for one in advice.tried)])
    _draw(files[1], advice, heading)
    with whole_file(files[2], "w") as file:
        file.write(config_text(advice.advised))
    return files


def _draw(path: Path, advice: Advice, heading: str) -> None:
    """Draw wrong pixels over bits: one line per window, the thresholds as its points."""
    with style():
        figure = new_figure(7.5, 4.5)
        axis = figure.subplots()
        windows_ns = sorted({one.window_ns for one in advice.settings})
        for colour, window_ns in zip(SERIES[1::2], windows_ns, strict=False):
            of_window = [one for one in advice.settings if one.window_ns == window_ns]
            fixed = [one for one in of_window if not one.config.auto.any()]
            axis.plot(
                [one.bits for one in fixed],
                [one.wrong for one in fixed],
                "o-",
                color=colour,
                label=f"window of {window_ns:.3g} ns",
            )
            for one in fixed:
                axis.annotate(
                    one.threshold,
                    (one.bits, one.wrong),
                    (4, 3),
                    textcoords="offset points",
                    color=colour,
                )
            own = [one for one in of_window if one.config.auto.any()]
            axis.plot(
                [one.bits for one in own],
                [one.wrong for one in own],
                "D",
                color=colour,
                markersize=7,
            )
        axis.plot([], [], "D", color=GREY, label="controller")
        axis.plot(
            advice.chosen.bits,
            advice.chosen.wrong,
            "o",
            color=ALARM,
            markersize=15,
            fillstyle="none",
            label=f"advised, with a link of {advice.best.link_gbps:g} Gbit/s",
        )
        axis.set(
            xscale="log", xlabel="bits per frame", ylabel="share of wrong pixels", ylim=(0, None)
        )
        axis.set_title(
            f"{heading}: thresholds (numbers) and windows, a link of {FIRST_LINK_GBPS:g} Gbit/s",
            loc="left",
        )
        axis.legend()
        save_figure(figure, path)
