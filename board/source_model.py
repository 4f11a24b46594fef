# SPDX-License-Identifier: Apache-2.0
"""Golden model of the emulator's photon source (`board/rtl/source.py`): the same edges, bit by bit.

The light of a frame is a function of the settings, the seed and the frame number. In every cycle of
a period, each pixel steps its generator and draws; `board/parameters.py` names the bits of a draw.
"""

from functools import cache
from typing import Any, NamedTuple

import numpy as np
from attrs import frozen

from ..model.contract.config import Config
from ..model.contract.edges import Edges
from ..model.contract.parameters import Sensor
from ..model.contract.pixels import pixel_table
from ..model.shared.compiled import njit, part
from ..model.shared.errors import InputError
from ..model.shared.quantities import integer
from . import parameters as chip

MASK = (1 << chip.STATE_BITS) - 1


@frozen(eq=False, kw_only=True)
class SourceSettings:
    """Settings of the photon source. Raises `InputError`."""

    background: np.ndarray  # int64[subgroups], photons per pixel and cycle, in 2^-16
    tick: np.ndarray  # int64[subgroups, pixels of one], earliest tick of a pixel's echo
    level: np.ndarray  # int64[subgroups, pixels of one], probability of an echo, in 2^-8
    spread: int = integer(0, 0, chip.SPREAD_MAX)  # an echo is up to 2^spread - 1 ticks late
    # from an edge to the earliest next edge of its pixel
    dead_cycles: int = integer(1, 1, chip.DEAD_MAX)
    seed: int = integer(1, 0, MASK)  # 32 bits

    def __attrs_post_init__(self) -> None:
        _check_integers("background", self.background, (1 << chip.RATE_BITS) - 1)
        _check_integers("level", self.level, (1 << chip.LEVEL_BITS) - 1)

    def register_writes(self, sensor: Sensor) -> list[tuple[int, int]]:
        """Return (address, value) of every setting, as seen by the emulator's host.

        Raises `InputError` for late ticks.
        """
        _check_integers("tick", self.tick, sensor.period_max * sensor.phases - 1)
        writes = [
            (chip.own_address("seed"), self.seed),
            (chip.own_address("spread"), self.spread),
            (chip.own_address("dead_cycles"), self.dead_cycles),
        ]
        for s in range(sensor.subgroups):
            writes.append((chip.background_address(s), int(self.background[s])))
            echoes = self.tick[s].astype(np.int64) << chip.LEVEL_BITS | self.level[s]
            for i, echo in enumerate(echoes):
                writes.append((chip.echo_address(s, i), int(echo)))
        return writes


def _check_integers(name: str, values: np.ndarray, high: int) -> None:
    """Raise `InputError` if some value is no integer from 0 to `high`."""
    integers = np.issubdtype(values.dtype, np.integer)
    if not integers or (values.size and not 0 <= values.min() <= values.max() <= high):
        raise InputError(f"{name}: must hold integers from 0 to {high}")


class _Source(NamedTuple):
    """The source of a subgroup, for its kernel."""

    states: np.ndarray  # uint32[pixels], of the generators at the start of the frame
    tables: np.ndarray  # of `_tables`
    starts: np.ndarray  # int64[pulses + 1], cycles at which the periods start
    period: int  # cycles
    phases: int
    background: int  # of `SourceSettings`, as all that follow
    tick: np.ndarray  # int64[pixels]
    level: np.ndarray  # int64[pixels]
    spread: int  # ticks by which an echo may be late: a mask of random bits
    dead_cycles: int


def source_edges(config: Config, settings: SourceSettings, frame: int) -> Edges:
    """Return the edges of frame number `frame` since the sensor's reset.

    Pulses count from the frame's start.
    """
    sensor = config.sensor
    starts = config.start_cycles()
    table = pixel_table(sensor)
    # Number of a subgroup's pixel in the array.
    pixel_of = np.empty((sensor.subgroups, sensor.pixels), np.int64)
    pixel_of[table.subgroup, table.inside] = np.arange(sensor.array_pixels)
    pulses = []
    pixels = []
    ticks = []
    for s in range(sensor.subgroups):
        source = _Source(
            states=seeds(settings.seed, frame & 0xFFFF, s, sensor.pixels),
            tables=_tables(),
            starts=starts,
            period=config.period,
            phases=sensor.phases,
            background=int(settings.background[s]),
            tick=settings.tick[s].astype(np.int64),
            level=settings.level[s].astype(np.int64),
            spread=(1 << settings.spread) - 1,
            dead_cycles=settings.dead_cycles,
        )
        found = _walk(source)
        pulses.append(found[:, 0])
        pixels.append(pixel_of[s][found[:, 1]])
        ticks.append(found[:, 2])
    return Edges(np.concatenate(pulses), np.concatenate(pixels), np.concatenate(ticks))


def seeds(seed: int, frame: int, subgroup: int, pixels: int) -> np.ndarray:
    """uint32[pixels]: states of a subgroup's generators at the start of a frame, none of them 0."""
    lanes = -(-pixels // chip.LANE_PIXELS)
    blocks = cipher(seed, frame | subgroup << 16, np.arange(lanes * chip.STATE_BITS))
    states = np.zeros(pixels, np.uint32)
    tables = _tables()
    pixel_bit = np.arange(chip.LANE_PIXELS, dtype=np.uint64)
    for step in range(chip.STATE_BITS):
        of_lanes = blocks[step :: chip.STATE_BITS]  # one block per lane
        lane_bits = of_lanes[:, None] >> pixel_bit & np.uint64(1)
        bits = lane_bits.ravel()[:pixels].astype(np.uint32)
        states = advance(states, tables) ^ bits << np.uint32(chip.SEED_BIT)
    return states | np.uint32(1 << chip.SEED_BIT)


def cipher(seed: int, left: int, right: np.ndarray) -> np.ndarray:
    """uint64[n]: the blocks (left, right[k]) encrypted with the key `seed`.

    The right half is in the low bits.
    """
    y: np.ndarray = right.astype(np.uint32)
    x: np.ndarray = np.full_like(y, left)
    key = seed & MASK
    for _ in range(chip.ROUNDS):
        x = ((x >> chip.ROTATE_RIGHT | x << (32 - chip.ROTATE_RIGHT)) + y) ^ np.uint32(key)
        y = (y << chip.ROTATE_LEFT | y >> (32 - chip.ROTATE_LEFT)) ^ x
        key = (key + chip.KEY_STEP) & MASK
    return x.astype(np.uint64) << np.uint64(32) | y.astype(np.uint64)


def advance(states: np.ndarray, tables: np.ndarray) -> np.ndarray:
    """uint32[n]: generators one step later."""
    parts = [tables[k][states >> np.uint32(8 * k) & np.uint32(0xFF)] for k in range(4)]
    return parts[0] ^ parts[1] ^ parts[2] ^ parts[3]


@cache
def _tables() -> np.ndarray:
    """uint32[4, 256]: contribution of each byte of a generator's state to the next state."""
    # Bit j of the state -> bits of the next state that depend on it.
    columns = np.zeros(chip.STATE_BITS, np.uint32)
    for i, taps in enumerate(chip.TAPS):
        for j in taps:
            columns[j] |= np.uint32(1 << i)
    tables = np.zeros((4, 256), np.uint32)
    for k in range(4):
        for bit in range(8):
            is_set = np.arange(256) >> bit & 1 != 0
            tables[k][is_set] ^= columns[8 * k + bit]
    return tables


@njit
def _walk(source: _Source) -> np.ndarray:
    """int64[n, 3]: pulse, pixel in the subgroup, and tick of its edges, by pixel and time."""
    phases = source.phases
    found = np.empty((1024, 3), np.int64)
    n = 0
    for i in range(len(source.states)):
        state = source.states[i]
        hit = False  # does the pixel have an echo in this pulse?
        arrival = np.int64(0)  # tick of that echo
        free = np.int64(0)  # first cycle in which the pixel is not dead
        for pulse in range(len(source.starts) - 1):
            for cycle in range(source.period):
                phase = _background(state, source)
                if cycle == 0:
                    hit = _has_echo(state, source.level[i])
                elif cycle == 1:
                    arrival = source.tick[i] + (np.int64(state) & source.spread)
                elif hit and arrival // phases == cycle and cycle >= chip.ECHO_FROM:
                    phase = min(phase, arrival % phases)
                at = source.starts[pulse] + cycle
                if phase < phases and at >= free:
                    if n == len(found):
                        found = np.concatenate((found, np.empty_like(found)))
                    found[n, 0] = pulse
                    found[n, 1] = i
                    found[n, 2] = cycle * phases + phase
                    n += 1
                    free = at + source.dead_cycles
                state = _next(state, source.tables)
    return found[:n]


@part
def _background(state: np.uint32, source: _Source) -> Any:
    """Return the phase of a cycle's background photon, or the number of phases if there is none."""
    if np.int64(state >> np.uint32(chip.RATE_LSB)) < source.background:
        return np.int64(state >> np.uint32(chip.PHASE_LSB)) & (source.phases - 1)
    return source.phases


@part
def _has_echo(state: np.uint32, level: int) -> Any:
    """Return whether the draw of a pulse's first cycle gives the pixel an echo."""
    drawn = np.int64(state >> np.uint32(chip.LEVEL_LSB)) & ((1 << chip.LEVEL_BITS) - 1)
    return drawn < level


@part
def _next(state: np.uint32, tables: np.ndarray) -> Any:
    """Return the state of a generator one step later, as `advance` does."""
    byte = np.uint32(0xFF)
    return (
        tables[0, state & byte]
        ^ tables[1, state >> np.uint32(8) & byte]
        ^ tables[2, state >> np.uint32(16) & byte]
        ^ tables[3, state >> np.uint32(24)]
    )
