# SPDX-License-Identifier: Apache-2.0
"""The settings of a sensor that is built: keys of [frame] and [subgroup], each described in one
place.

A setting's register, legal range and reset value, its place in the file, its field on the way to
the subgroups, its control in the explorer, its axis in plots and its row in the documents follow
from here.
"""

from typing import Any

import numpy as np
from attrs import field, frozen

from .counters import EVENTS_MAX
from .dither import DITHER_BITS_MAX, GAP_MAX, LFSR_BITS
from .packet import FORMATS
from .parameters import CLOCK_MHZ, Sensor
from .table import NO_BIT, Kind, Limit, settings_of_class

AUTO_BOUNDS = 6
THRESHOLD_MAX = 1 + AUTO_BOUNDS  # highest threshold of the controller
# from frame to frame, the controller's budget may grow by these powers of 1/2 of itself
BUDGET_GROWTHS = (3, 2, 1, 0)
LIMIT_DROP = 2  # from frame to frame, its limit may fall by this power of 1/2 of itself
FRAMES_MAX = 1 << 16  # the frame number has 16 bits
LINK_GBPS_MAX = 1e6  # highest rate of the link behind a stream
GATE_BITS = 16
GATE_MAX = (1 << GATE_BITS) - 1  # highest number of a gate's cycles, pulses and steps
SEARCH_PULSES_MAX = (1 << 15) - 1  # twice as many, and one more, fit into a frame
GATE = "Progressive gating"
_FORMATS_TOLD = ", ".join(
    f"{n} {name}" + f" ({of.doc})" * bool(of.doc) for n, (name, of) in enumerate(FORMATS.items())
)


def _setting(kind: Kind, doc: str, **columns: Any) -> Any:
    return field(
        metadata={"kind": kind, "doc": doc} | columns,
        converter=_constant if kind is Kind.INTEGERS else None,
    )


def _constant(value: Any) -> tuple[int, ...] | None:
    """Return a list as a tuple."""
    return None if value is None else tuple(value)


def _integer(default: int | None, low: Limit, high: Limit, doc: str, **columns: Any) -> Any:
    return _setting(Kind.INTEGER, doc, default=default, low=low, high=high, **columns)


def _switch(default: bool, doc: str, **columns: Any) -> Any:
    return _setting(Kind.SWITCH, doc, default=default, **columns)


def _of_controller(kind: Kind, doc: str, **columns: Any) -> Any:
    return _setting(kind, f"Threshold controller: {doc}", needs="controller", **columns)


def _counted(unit: str, **columns: Any) -> dict[str, Any]:
    """Return the columns of a setting that counts something per frame, and has a default that
    depends on the others.
    """
    return {"derived": True, "unit": unit, "high": EVENTS_MAX} | columns


@frozen(kw_only=True)
class FrameSettings:
    """The settings of a frame: a value of every key of [frame]. Numbers below: default, lowest
    and highest legal value.
    """

    frames: int = _integer(1, 1, FRAMES_MAX, "Number of frames.")
    clock_mhz: float = _setting(
        Kind.REAL, "System clock.", default=CLOCK_MHZ, unit="MHz", low=1e-3, high=1e5
    )
    link_gbps: float = _setting(
        Kind.REAL,
        "Rate of the link behind each stream; 0: as fast as the stream.",
        default=0.0,
        unit="Gbit/s",
        high=LINK_GBPS_MAX,
    )
    period: int = _integer(
        250,
        1,
        "period_max",
        "Laser period in cycles. Must be above the guard G at a start.",
        unit="cycles",
        offset=0x48,
    )
    pulses: int = _integer(
        100, 1, 1 << 16, "Number of laser periods in a frame.", unit="laser pulses", offset=0x4C
    )
    format: str = _setting(
        Kind.CHOICE,
        f"Event words: {_FORMATS_TOLD}.",
        default="id",
        choices=tuple(FORMATS),
        last_choice_needs="counts",
        offset=0x50,
    )
    minigroup_records: bool = _switch(
        False,
        "1: minigroups have their own stamps, and a subgroup sends at most one record per period.",
        needs="records",
        offset=0x54,
    )
    mg_threshold: int = _integer(
        2,
        1,
        "minigroup_pixels",
        "Number of distinct pixels at which a minigroup latches.",
        unit="pixels",
        offset=0x58,
    )
    mg_window: int = _integer(
        2, 1, 4, "Cycles of a minigroup's collection.", unit="cycles", offset=0x5C
    )
    gate_step: int = _integer(
        0, 0, GATE_MAX, f"{GATE}: shift per step, in cycles.", unit="cycles", offset=0x60
    )
    gate_every: int = _integer(
        0,
        0,
        GATE_MAX,
        f"{GATE}: pulses per step; 0 turns it off.",
        unit="laser pulses",
        offset=0x64,
    )
    gate_steps: int = _integer(
        1, 1, GATE_MAX, f"{GATE}: number of steps before it starts over.", offset=0x68
    )
    gap: int = _integer(
        0,
        0,
        GAP_MAX,
        "Cycles from the end of one period to the next one, before dither's wait; 0: back to back.",
        unit="cycles",
        offset=0x94,
    )
    dither_bits: int = _integer(
        0,
        0,
        DITHER_BITS_MAX,
        "Number of LFSR bits that give the wait between two periods, in cycles; 0: no wait.",
        offset=0x84,
    )
    dither_seed: int = _integer(
        1, 1, (1 << LFSR_BITS) - 1, "State of that LFSR at the beginning of the frame.", offset=0x88
    )
    search_pulses: int | None = _integer(
        None,
        1,
        SEARCH_PULSES_MAX,
        "Counts: number of pulses in which regions are searched, and again in which gates are searched.",
        derived=True,
        unit="laser pulses",
        needs="counts",
        offset=0xAC,
        reset=20,
    )
    threshold_floor: int = _of_controller(
        Kind.INTEGER,
        "the lowest threshold; 0 has the effect of 1.",
        default=1,
        high=THRESHOLD_MAX,
        unit="pixels",
        offset=0x90,
    )
    auto_bounds: tuple[int, ...] | None = _of_controller(
        Kind.INTEGERS,
        "the threshold is at most 1 + the number of bounds that `opened` of the previous frame reaches. Must not descend.",
        **_counted("windows", reset=0, offset=0x6C),
        count=AUTO_BOUNDS,
    )
    capacity: int | None = _of_controller(
        Kind.INTEGER,
        "events that a stream carries in a frame.",
        **_counted("events", reset=EVENTS_MAX, offset=0x8C),
    )


@frozen(eq=False, kw_only=True)
class SubgroupSettings:
    """Keys of [subgroup], each with a value for every subgroup: bool or int64[subgroups]; mask:
    bool[subgroups, pixels].

    Switches come first, because they are bits of one register.
    """

    coincidence: np.ndarray = _switch(True, "0: winner takes all (window 1, threshold 1).", bit=0)
    gating: np.ndarray = _switch(False, "1: edges outside the gate are ignored.", bit=1)
    auto: np.ndarray = _switch(
        False, "1: the controller sets the threshold.", needs="controller", bit=2
    )
    threshold: np.ndarray = _integer(
        2,
        1,
        "pixels",
        "Number of distinct pixels that make a coincidence.",
        unit="pixels",
        offset=0x04,
    )
    window: np.ndarray = _integer(
        16, 1, "window_max", "Coincidence window in ticks.", unit="ticks", offset=0x08
    )
    gate_start: np.ndarray = _integer(
        0, 0, GATE_MAX, "Gate: first cycle, in cycles.", unit="cycles", offset=0x0C
    )
    gate_len: np.ndarray = _integer(
        None, 0, GATE_MAX, "Gate: length, in cycles.", follows="period", unit="cycles", offset=0x10
    )
    mask: np.ndarray = _setting(
        Kind.MASK,
        "Pixel mask: bit i of word w is pixel 32 w + i; 1 = on.",
        high="mask_word_max",
        reset="mask_word_max",
        count="mask_words",
        offset=0x14,
    )


FRAME = settings_of_class(FrameSettings, "frame")
SUBGROUP = settings_of_class(SubgroupSettings, "subgroup")
SWITCHES = {name: setting for name, setting in SUBGROUP.items() if setting.bit != NO_BIT}


def frame_defaults(sensor: Sensor) -> FrameSettings:
    """Return the settings of a frame for which nothing is written."""
    defaults = {name: setting.default_of(sensor) for name, setting in FRAME.items()}
    return FrameSettings(**defaults)
