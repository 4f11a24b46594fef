# SPDX-License-Identifier: Apache-2.0
"""Where the gates of subgroups are in the pulses of a frame.

Ref: paper III-C (gating), and progressive gating in docs/contract.md: a gate moves from place to
place, and begins again at the first one.
"""

from typing import NamedTuple

import numpy as np

from ..contract.config import Config


def gate_moved(config: Config, pulse: np.ndarray) -> np.ndarray:
    """int64[n]: cycles by which the gate has moved in pulses of a frame, int64[n]."""
    frame = config.frame
    if not frame.gate_every:
        return np.zeros_like(pulse)
    return frame.gate_step * (pulse // frame.gate_every % frame.gate_steps)


def gate_moves(config: Config) -> np.ndarray:
    """int64[places]: cycles by which the gate has moved at each place that it reaches in a frame."""
    frame = config.frame
    if not frame.gate_every:
        return np.zeros(1, np.int64)
    reached = -(-config.pulses // frame.gate_every)
    return frame.gate_step * np.arange(min(frame.gate_steps, reached))


def open_share(config: Config, subgroup: int, pulses: range) -> np.ndarray:
    """float64[cycles]: share of some pulses of a frame in which the gate of a subgroup is open;
    without gating, it always is.
    """
    return open_pulses(config, subgroup, pulses.start, np.array(pulses.stop)) / len(pulses)


def open_share_by_tick(config: Config, subgroup: int) -> np.ndarray:
    """float64[ticks]: share of all pulses of a frame in which the gate of a subgroup is open."""
    return np.repeat(open_share(config, subgroup, range(config.pulses)), config.sensor.phases)


def open_pulses(config: Config, subgroup: int, begin: int, end: np.ndarray) -> np.ndarray:
    """int64[..., cycles]: how many pulses of a frame, from `begin` to before `end`, have the gate of
    a subgroup open in each cycle. end: int64[...].
    """
    if not config.gating[subgroup]:
        return np.repeat((end - begin)[..., None], config.period, axis=-1)
    opens = config.gate_start[subgroup] + gate_moves(config)[:, None]
    cycle = np.arange(config.period)
    is_open = (cycle >= opens) & (cycle < opens + config.gate_len[subgroup])
    number = _pulses_at_places(config, end) - _pulses_at_places(config, np.array(begin))
    return number @ is_open


class GateTurns(NamedTuple):
    """How many pulses of a frame have a gate that turns in each cycle, int64[cycles]."""

    opens: np.ndarray
    closes: np.ndarray  # that was open in the cycle before


def gate_turns(config: Config, subgroup: int) -> GateTurns:
    """Return in which cycles the gate of a subgroup opens and closes; without gating, it opens in
    the first one.
    """
    pulses = np.array([config.pulses])
    start = np.zeros(1, np.int64)
    length = config.period
    if config.gating[subgroup]:
        pulses = _pulses_at_places(config, np.array(config.pulses))
        start = config.gate_start[subgroup] + gate_moves(config)
        length = config.gate_len[subgroup]
    if not length:
        pulses = np.zeros_like(pulses)

    def by_cycle(cycle: np.ndarray) -> np.ndarray:
        inside = cycle < config.period
        number = np.zeros(config.period, np.int64)
        np.add.at(number, cycle[inside], pulses[inside])
        return number

    return GateTurns(opens=by_cycle(start), closes=by_cycle(start + length))


def _pulses_at_places(config: Config, end: np.ndarray) -> np.ndarray:
    """int64[..., places]: how many of the first pulses of a frame have the gate at each place.

    end: int64[...], number of these pulses.
    """
    every = config.frame.gate_every
    if not every:
        return end[..., None]
    turn = every * config.frame.gate_steps  # pulses until the gate begins again
    place = np.arange(len(gate_moves(config)))
    of_last_turn = np.clip(end[..., None] % turn - every * place, 0, every)
    return end[..., None] // turn * every + of_last_turn
