# SPDX-License-Identifier: Apache-2.0
"""Describes a frame in sentences and tables, for the explorer and `report.html`."""

from collections.abc import Callable
from typing import TypeAlias

from .frame_content import FrameView

_Form: TypeAlias = Callable[[float], str]
_COUNT, _SHARE = "{:,.0f}".format, "{:.1%}".format
NUMBERS: tuple[tuple[str, str, _Form], ...] = (  # label, name in `FrameView.numbers`, format
    ("edges", "edges", _COUNT),
    ("windows", "opened", _COUNT),
    ("rejected", "rejected", _COUNT),
    ("events", "events", _COUNT),
    ("  with sunlight only", "sun_share", _SHARE),
    ("drops", "dropped", _COUNT),
    ("data per frame", "bits", "{:,.0f} bits".format),
    ("stream load", "stream_load", _SHARE),
    ("link load", "link_load", _SHARE),
    ("mean threshold", "threshold_mean", "{:.2f} pixels".format),
    ("wrong, above 3.4 cm", "wrong_share", _SHARE),
    ("wrong, above 15 cm", "wrong_share_15cm", _SHARE),
)
# Of frames in the format `counts`, which has neither windows nor thresholds.
COUNT_NUMBERS = (
    ("edges", "edges", _COUNT),
    ("counted hits", "counted", _COUNT),
    *(row for row in NUMBERS if row[1] in ("bits", "stream_load", "link_load")),
    *(row for row in NUMBERS if row[1] in ("wrong_share", "wrong_share_15cm")),
)
OBJECT_HEADS = ("", "reflects", "distance", "photons per pulse", "wrong")


def number_rows(*views: FrameView) -> list[list[str]]:
    """Return one row per number: label, then the value of each view."""
    counting = all(view.numbers.get("counted") is not None for view in views)
    return [
        [label, *(_said(view.numbers[name], form) for view in views)]
        for label, name, form in (COUNT_NUMBERS if counting else NUMBERS)
    ]


def _said(value: float | None, form: _Form) -> str:
    return "not known" if value is None else form(value)


def object_table(*views: FrameView) -> list[list[str]]:
    """Return one row per object of the first view: name, reflectivity, distance, signal, and its
    wrong share in each view.
    """
    wrong = [{one.name: one.wrong_share for one in view.objects} for view in views]
    return [
        [
            one.name,
            f"{one.reflectivity:.0%}",
            f"{one.distance_m:.1f} m",
            f"{one.signal:.2f}",
            *(_said(shares.get(one.name), _SHARE) for shares in wrong),
        ]
        for one in views[0].objects
    ]


def where_to_look(view: FrameView) -> str:
    """Return a sentence on the position of the darkest object; empty for a scene without
    objects.
    """
    if len(view.objects) < 2:
        return ""
    dark = view.objects[0]
    row, col = dark.middle
    return f"The darkest part, {dark.name}, is around row {row}, column {col}."


def _words_sent(view: FrameView) -> str:
    """Return a sentence about the words of a frame."""
    numbers = view.numbers
    if numbers.get("counted") is not None:
        bits = f"{numbers['bits']:,} bits left the sensor"
        return f"The pixels counted {numbers['counted']:,} hits in their gates; {bits}."
    dropped = ""
    if any(numbers[name] is None for name in ("opened", "committed", "dropped")):
        return "The numbers of windows and drops are not known, because counters are at their end."
    if numbers["dropped"]:
        dropped = f", and {numbers['dropped']:,} found the FIFO full and were dropped"
    return (
        f"Of {numbers['opened']:,} windows {numbers['committed']:,} met their threshold{dropped}."
    )


def story(view: FrameView) -> str:
    """Return some sentences about the frame."""
    numbers = view.numbers
    text = _words_sent(view)
    if numbers["sun_share"] is not None:
        text += f" {numbers['sun_share']:.0%} of the events contain only sunlight."
    if len(view.objects) > 1:
        dark, bright = view.objects[0], view.objects[-1]
        text += (
            f" In the darkest part, {dark.name} ({dark.signal:.2f} photons per pixel and pulse), {dark.wrong_share:.0%} of the"
            f" pixels are wrong; in the brightest, {bright.name} ({bright.signal:.2f}), {bright.wrong_share:.0%}."
        )
    mean_gbps = numbers["mean_gbps"]
    if view.config.gap and mean_gbps is not None:
        text += (
            f" At {numbers['frames_per_s']:.4g} frames per second, the busiest link carries"
            f" {mean_gbps * 1e3:.4g} Mbit/s in the mean."
        )
    return text
