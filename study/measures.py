# SPDX-License-Identifier: Apache-2.0
"""One frame in numbers: measures by which an architect compares sensors.

Our choice; `wrong_share` is that of the paper's Fig. 7.
"""

import numpy as np

from ..model.contract.config import Config
from ..model.contract.packet import FORMATS, Kind, layout
from ..model.depth.quality import TOLERANCE_M, range_error, wrong_pixels, wrong_share
from ..model.shared.constants import SUCCESS_TOLERANCE_S

MEASURES = {  # name: (type, meaning); all are of one frame
    "edges": (int, "avalanches of all SPADs"),
    "opened": (int, "coincidence windows"),
    "committed": (int, "windows that met their threshold"),
    "rejected": (int, "windows that did not meet their threshold"),
    "events": (int, "committed windows that were stored and left the sensor"),
    "dropped": (int, "committed windows that found their FIFO full"),
    "overruns": (int, "events with the overrun flag: gaps in a subgroup's events"),
    "blind_cycles": (int, "cycles with an edge between a window's end and the re-arming, over all subgroups"),
    "photons": (int, "sum of the counts of all windows"),
    "mg_records": (int, "minigroup records that left the sensor"),
    "mg_dropped": (int, "minigroup records that were dropped"),
    "threshold_mean": (float, "threshold in pixels, mean of the subgroups"),
    "commits_per_pulse": (float, "committed windows of the sensor per laser pulse"),
    "dropped_share": (float, "share of the committed windows that were dropped"),
    "beats": (int, "beats of all streams"),
    "stream_load": (float, "beats of the busiest stream per cycle of the frame"),
    "wrong_share": (
        float,
        f"share of pixels without depth, or off by more than {SUCCESS_TOLERANCE_S * 1e12:.0f} ps ({TOLERANCE_M * 100:.1f} cm)",
    ),
    "depth_share": (float, "share of pixels with depth"),
    "bias_m": (float, "mean error of range, pixels with depth"),
    "rms_m": (float, "RMS error of range, pixels with depth"),
    "right_bias_m": (float, "mean error of range, pixels that are not wrong"),
    "right_rms_m": (float, "RMS error of range, pixels that are not wrong"),
}
COUNTED = {  # measure: counter that it is the sum of
    "events": "stored",
    "blind_cycles": "blind",
    "mg_records": "mg_stored",
} | {name: name for name in ("opened", "committed", "rejected", "dropped", "photons", "mg_dropped")}


def measures(
    config: Config, arrays: dict[str, np.ndarray], frame: int, edges: int, depth_m: np.ndarray, truth_m: np.ndarray
) -> dict[str, int | float | None]:
    """Return `MEASURES` of a frame; None if there is nothing to divide by.

    arrays: of a result (`result.py`). edges: number of edges of the frame. depth_m, truth_m: float64[rows, cols], NaN =
    none; shares of pixels are relative to those with a truth.
    """
    counts = {name: int(arrays[counter][frame].sum()) for name, counter in COUNTED.items()}
    of_frame = arrays["pulse"] // config.pulses == frame
    beats = stream_beats(config, arrays["stored"][frame], arrays["mg_stored"][frame])
    threshold = np.where(config.coincidence, arrays["threshold_used"][frame], 1)
    known = ~np.isnan(truth_m)
    right = known & ~wrong_pixels(depth_m, truth_m)
    found: dict[str, int | float | None] = {
        **counts,
        "edges": edges,
        "overruns": int(arrays["overrun"][of_frame].sum()),
        "threshold_mean": float(threshold.mean()),
        "commits_per_pulse": counts["committed"] / config.pulses,
        "dropped_share": _share(counts["dropped"], counts["committed"]),
        "beats": int(beats.sum()),
        "stream_load": float(beats.max()) / (config.pulses * config.period),
        "wrong_share": wrong_share(depth_m, truth_m) if known.any() else None,
        "depth_share": _share(int(np.sum(known & ~np.isnan(depth_m))), int(known.sum())),
    }
    for prefix, pixels in (("", known), ("right_", right)):
        bias_m, rms_m = range_error(depth_m[pixels], truth_m[pixels])
        found |= {f"{prefix}bias_m": _number(bias_m), f"{prefix}rms_m": _number(rms_m)}
    return {name: found[name] for name in MEASURES}


def stream_beats(config: Config, events: np.ndarray, records: np.ndarray) -> np.ndarray:
    """Number[streams]: beats of a frame, including its start, end and counters.

    events, records: number[subgroups], events and minigroup records that leave the sensor.
    """
    sensor = config.sensor
    payload, counter_beats = payload_beats(config, events, records), layout(sensor).counter_beats
    subgroups = [sensor.stream_subgroups(stream) for stream in range(sensor.streams)]
    return np.array([2 + payload[of_stream].sum() + len(of_stream) * counter_beats for of_stream in subgroups])


def payload_beats(config: Config, events: np.ndarray, records: np.ndarray) -> np.ndarray:
    """Number[subgroups]: the beats of events and minigroup records alone; arguments as in `stream_beats`."""
    parts = layout(config.sensor)
    return events * parts.length(FORMATS[config.format]) + records * parts.length(Kind.RECORD)


def _share(part: int, whole: int) -> float | None:
    return part / whole if whole else None


def _number(value: float) -> float | None:
    return None if np.isnan(value) else value
