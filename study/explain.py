# SPDX-License-Identifier: Apache-2.0
"""Explains a configuration in rows and sentences, for `coincid show` and the explorer."""

import numpy as np

from ..lab.measures import event_beats, stream_beats
from ..lab.pace import LASER_MEAN_W, pulse_energy_j
from ..model.contract.config import Config
from ..model.contract.counts import CYCLES_MAX
from ..model.contract.link import stream_gbps
from ..model.contract.packet import BEAT_BITS, COUNTS, FORMATS, WITH_MAP, layout
from ..model.shared.constants import SPEED_OF_LIGHT_M_S
from .price import um2_per_pixel, uw_per_pixel, while_measured

KLUX = 50.0  # ambient light for the power
FILLED_BY_COUNTERS = 0.1  # share of the link above which there is a warning


def meaning(config: Config) -> list[tuple[str, str]]:
    """Return (name, value with its unit) of everything that follows from a configuration."""
    sensor, tick_s = config.sensor, config.tick_s
    cycle_ns, metres_per_s = 1e3 / config.clock_mhz, SPEED_OF_LIGHT_M_S / 2
    frame_s = config.frame_cycles * cycle_ns * 1e-9
    sent_gbps = float(stream_gbps(config.clock_mhz))
    streams = f"{sensor.streams} of {sent_gbps:.4g} Gbit/s"
    link_share = f"{float(config.link_share):.1%}"
    range_m = config.period_ticks * tick_s * metres_per_s
    period_ns = config.period * cycle_ns
    cycle_cm = cycle_ns * 1e-9 * metres_per_s * 100
    tick_cm = tick_s * metres_per_s * 100
    pixels = f"{sensor.rows} x {sensor.cols} pixels"
    unpriced = ", without the part for counts" * sensor.counts
    limit = f"no window opens in the last {sensor.guard} cycles"
    if config.counting:
        limit = f"hits count in the first {min(config.period, CYCLES_MAX)} cycles"
    return [
        ("array", f"{pixels} in {sensor.subgroups} subgroups of {_size(sensor.subgroup)}"),
        ("minigroups", f"{sensor.minigroups} of {_size(sensor.minigroup)} in a subgroup"),
        ("clock", f"{config.clock_mhz:g} MHz: a cycle is {cycle_ns:.4g} ns, {cycle_cm:.4g} cm"),
        ("tick", f"{tick_s * 1e12:.4g} ps, {tick_cm:.4g} cm ({sensor.phases} per cycle)"),
        *([] if config.counting else _windows(config)),
        ("laser period", f"{config.period} cycles, {period_ns:.4g} ns: {1e6 / period_ns:.4g} kHz"),
        *_pace(config),
        ("range", f"{range_m:.4g} m; {limit}"),
        (
            "frame",
            f"{config.pulses} pulses, {frame_s * 1e6:.4g} us: {1 / frame_s:,.0f} frames per second",
        ),
        *(_counts(config) if config.counting else _events(config, frame_s)),
        ("stream", f"{streams}; the link takes {link_share} of its beats"),
        ("area", f"about {um2_per_pixel(sensor):.0f} um2 per pixel in 45 nm{unpriced}"),
        (
            "power",
            f"about {uw_per_pixel(config, KLUX) / 1e3:.3g} mW per pixel at {KLUX:g} klux{while_measured(config)}{unpriced}",
        ),
    ]


def _windows(config: Config) -> list[tuple[str, str]]:
    """Return the rows of windows and thresholds."""
    window = _span(config.window)
    threshold = _span(config.threshold)
    controlled = ""
    if config.controlled.any():
        controlled = (
            f", by the controller in {config.controlled.sum()} of {config.sensor.subgroups}"
        )
    off = ""
    if not config.coincidence.all():
        off = f"; coincidence is off in {np.sum(~config.coincidence)}"
    return [
        ("window", f"{window} ticks, {_span(config.window, config.tick_s * 1e9)} ns"),
        ("threshold", f"{threshold} pixels{controlled}{off}"),
    ]


def _events(config: Config, frame_s: float) -> list[tuple[str, str]]:
    """Return the rows of events."""
    beats = event_beats(config)
    grouped = " with three pixels" * FORMATS[config.format].grouped
    # not what the controller is told, which may be less or more
    fitting = config.with_frame(capacity=None).capacity
    events_per_us = fitting / frame_s / 1e6
    return [
        ("event", f"{config.format}: {beats:.3g} beats of {BEAT_BITS} bits{grouped}"),
        (
            "events that fit",
            f"{fitting:,} per stream and frame, {events_per_us:.4g} million per second",
        ),
    ]


def _counts(config: Config) -> list[tuple[str, str]]:
    """Return the rows of counts in gates."""
    sensor = config.sensor
    search = config.search_pulses
    beats = layout(sensor).length(COUNTS)
    bits = sensor.subgroups * sensor.minigroups * beats * BEAT_BITS
    return [
        (
            "steps",
            f"{search} pulses for regions, {search} for gates, {config.pulses - 2 * search} for counts",
        ),
        ("counts", f"{beats} beats per minigroup, {bits / 1e3:.4g} kbit per frame"),
    ]


def _pace(config: Config) -> list[tuple[str, str]]:
    """Return the rows of a frame with gaps."""
    if not config.gap:
        return []
    gap_us = config.gap / config.clock_mhz
    energy_nj = pulse_energy_j(config) * 1e9
    power = f"{LASER_MEAN_W * 1e3:g} mW of mean power"
    return [
        ("gap", f"{config.gap:,} cycles, {gap_us:.4g} us, between two periods"),
        ("laser", f"{power} are {energy_nj:.4g} nJ per pulse"),
    ]


def warnings(config: Config) -> list[str]:
    """Return a sentence for each combination of settings that wastes something or has no effect."""
    sensor, frame = config.sensor, config.frame
    counters = float(stream_beats(config, *np.zeros((2, sensor.subgroups), np.int64)).max())
    link_beats = config.frame_cycles * float(config.link_share)
    sent_gbps = float(stream_gbps(config.clock_mhz))
    coarse_bits = int(config.period - 1).bit_length()
    longest = int(config.window.max())
    pixels_on = config.mask.sum(axis=1)
    gate_end = config.gate_start + config.gate_len
    full = "-full" * (config.format == "full")

    coincidence = config.coincidence & (not config.counting)
    coincidence_on = bool(coincidence.any())
    lets_all_through = coincidence & (config.threshold == 1) & ~config.auto
    # The controller lowers the threshold after the first frame.
    stays = ~config.auto | (config.frames == 1)
    never_commits = coincidence & (config.threshold > pixels_on) & stays
    controller_idle = config.auto & ~coincidence
    controlled = bool((config.auto & coincidence).any())
    gate_given = _any_given(config, "subgroup.gate_start", "subgroup.gate_len", "frame.gate_every")
    gate_too_long = config.gating & (gate_end > config.period) & (config.gate_start > 0)
    counts_too = " and counts" * config.counting
    off = "frames have counts" if config.counting else "coincidence is off"
    records_given = _any_given(config, "frame.mg_threshold", "frame.mg_window")
    found = {
        f"streams = {sensor.streams} does not divide {sensor.subgroups} subgroups: "
        "some streams carry one subgroup more than others.": (
            sensor.subgroups % sensor.streams != 0
        ),
        f"link_gbps = {frame.link_gbps:g} is more than a stream sends, {sent_gbps:g} Gbit/s.": (
            frame.link_gbps > sent_gbps
        ),
        f"Counters{counts_too} fill {counters / link_beats:.0%} of the link: "
        "with more pulses per frame, this share falls.": (
            counters > FILLED_BY_COUNTERS * link_beats
        ),
        f"window_max = {sensor.window_max} ticks is built, "
        f"but the longest window has {longest}.": sensor.window_max > 2 * longest,
        f"coarse_bits = {sensor.coarse_bits} counts {sensor.period_max} cycles; "
        f"the period of {config.period} needs {coarse_bits} bits.": (
            sensor.coarse_bits > coarse_bits + 1
        ),
        "Coincidence is on, but threshold 1 lets every photon through, "
        "as with coincidence off.": bool(lets_all_through.any()),
        f"window is set, but has no effect: {off}.": (
            _any_given(config, "subgroup.window") and not coincidence_on
        ),
        f"The controller is on, but {off}: it has no effect.": bool(controller_idle.any()),
        "The controller is on for one frame, but needs a few frames to settle.": (
            controlled and config.frames == 1
        ),
        "The threshold is higher than the number of unmasked pixels: nothing can commit.": (
            bool(never_commits.any())
        ),
        "A gate is set, but gating is off.": gate_given and not config.gating.any(),
        "The gate moves by 0 cycles: gate_step is 0.": (
            frame.gate_every > 0 and frame.gate_step == 0
        ),
        "The gate ends after the laser period.": bool(gate_too_long.any()),
        f"format = '{config.format}' sends no map of pixels: there is no depth per pixel.": (
            config.format not in WITH_MAP and not config.counting
        ),
        f"format = '{config.format}' sends a whole map; "
        f"'compact{full}' carries the same events in fewer bits.": (
            config.format in ("id", "full")
        ),
        "mg_threshold and mg_window have no effect: minigroup_records is off.": (
            records_given and not frame.minigroup_records
        ),
        "minigroup_records has no effect: frames have counts.": (
            frame.minigroup_records and config.counting
        ),
        "search_pulses has no effect: the format is not 'counts'.": (
            _any_given(config, "frame.search_pulses") and not config.counting
        ),
        f"Hits after cycle {CYCLES_MAX - 1} of the {config.period} do not count.": (
            config.counting and config.period > CYCLES_MAX
        ),
        "dither_seed has no effect: dither_bits is 0.": (
            _any_given(config, "frame.dither_seed") and not frame.dither_bits
        ),
        "gap has no effect: a frame has one pulse.": config.gap > 0 and config.pulses == 1,
        "capacity is 0: the controller raises every threshold to the highest.": (
            controlled and config.capacity == 0
        ),
    }
    return [sentence for sentence, holds in found.items() if holds]


def _any_given(config: Config, *keys: str) -> bool:
    """Return whether the configuration sets one of these keys itself."""
    return not config.given.isdisjoint(keys)


def _size(size: tuple[int, int]) -> str:
    return f"{size[0]} x {size[1]}"


def _span(values: np.ndarray, unit: float = 1.0) -> str:
    low, high = values.min() * unit, values.max() * unit
    return f"{low:.4g}" if low == high else f"{low:.4g} to {high:.4g}"
