# SPDX-License-Identifier: Apache-2.0
"""Edges as words at the sensor's ports, or as levels of SPAD lines."""

import numpy as np
from attrs import evolve

from ..hdl.silicon.circuit import clock_fs
from ..model.contract.config import Config
from ..model.contract.edges import Edges
from ..model.contract.pixels import pixel_table, port_bits
from ..model.shared.errors import InputError

FS_PER_PS = 1000


def port_words(config: Config, edges: Edges) -> dict[int, list[tuple[int, int]]]:
    """Return cycle of the frame -> [(subgroup, word)] for subgroups with an edge in it;
    `port_bits` numbers the bits.
    """
    cycle, subgroup, bit = port_bits(config, edges)
    order = np.lexsort((subgroup, cycle))
    words: dict[int, dict[int, int]] = {}
    for c, s, b in zip(
        cycle[order].tolist(), subgroup[order].tolist(), bit[order].tolist(), strict=True
    ):
        at = words.setdefault(c, {})
        at[s] = at.get(s, 0) | 1 << b
    return {c: list(at.items()) for c, at in words.items()}


def tick_ps(config: Config) -> float:
    """Return the length of a tick in the circuits of the asynchronous view."""
    return clock_fs(config.clock_mhz) / config.sensor.phases / FS_PER_PS


def check_offsets(config: Config, edges: Edges) -> None:
    """Raise `InputError` if an edge's offset lies outside its tick."""
    if edges.offset_ps is not None:
        bad = np.flatnonzero(edges.offset_ps > tick_ps(config))
        if len(bad):
            raise InputError(
                f"offset_ps[{bad[0]}] = {edges.offset_ps[bad[0]]}: must be a number from 0 to {tick_ps(config):g}"
            )


def off_centre(config: Config, edges: Edges, seed: int) -> Edges:
    """Return the same edges at random positions in their ticks."""
    offset = np.random.default_rng(seed).uniform(0, tick_ps(config), len(edges))
    return evolve(edges, offset_ps=offset)


def line_toggles(config: Config, edges: Edges) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the changes of the SPAD lines: (time in fs from the frame's start, subgroup, line),
    int64[n], by time.

    A line rises at its edge and stays high for a quarter of a tick, or until half the time to
    its next edge if that is less. An offset at the border of a tick counts as one femtosecond
    inside, in agreement with the integer tick.
    """
    sensor = config.sensor
    cycle_fs = clock_fs(config.clock_mhz)
    tick_fs = cycle_fs // sensor.phases
    table = pixel_table(sensor)
    offset = (
        np.full(len(edges), tick_fs // 2)
        if edges.offset_ps is None
        else np.rint(edges.offset_ps * FS_PER_PS).astype(np.int64)
    )
    rise = (
        config.start_cycles()[edges.pulse] * cycle_fs
        + edges.tick * tick_fs
        + offset.clip(1, tick_fs - 1)
    )
    rise, pixel = np.unique(np.stack([rise, edges.pixel]), axis=1)
    order = np.lexsort((rise, pixel))
    rise, pixel = rise[order], pixel[order]
    high = np.full(len(rise), max(1, tick_fs // 4))
    same = pixel[1:] == pixel[:-1]
    high[:-1][same] = np.minimum(high[:-1], np.diff(rise) // 2)[same]
    alone = high > 0  # an edge one femtosecond before the next one on its line is dropped
    rise, pixel, high = rise[alone], pixel[alone], high[alone]
    time, subgroup, line = (
        np.concatenate([rise, rise + high]),
        table.subgroup[pixel],
        table.inside[pixel],
    )
    order = np.lexsort((np.tile(subgroup, 2), time))
    return time[order], np.tile(subgroup, 2)[order], np.tile(line, 2)[order]


def line_levels(config: Config, edges: Edges) -> tuple[list[int], list[int], list[int]]:
    """Return the levels: (time in fs from the frame's start, subgroup, word on its lines from
    then on), by time.
    """
    levels = [0] * config.sensor.subgroups
    at: list[tuple[int, int, int]] = []
    for t, s, line in zip(
        *(column.tolist() for column in line_toggles(config, edges)), strict=True
    ):
        levels[s] ^= 1 << line
        if at and at[-1][:2] == (t, s):
            at.pop()
        at.append((t, s, levels[s]))
    return [t for t, _, _ in at], [s for _, s, _ in at], [word for _, _, word in at]
