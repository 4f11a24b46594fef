# SPDX-License-Identifier: Apache-2.0
"""Golden model of the emulator's photon source (`board/rtl/source.py`): the same edges, bit by bit.

The light of a frame is a function of the settings, the seed and the frame number. In every cycle of
a period, each pixel steps its generator and draws; `board/parameters.py` names the bits of a draw.
"""

from functools import cache
from typing import Any

import numpy as np
from attrs import field, frozen

from ..model.contract.config import Config
from ..model.contract.edges import Edges
from ..model.contract.parameters import Sensor
from ..model.contract.pixels import pixel_table
from ..model.shared.compiled import njit
from ..model.shared.errors import InputError, check_integer
from . import parameters as chip

MASK = (1 << chip.STATE_BITS) - 1


@frozen(eq=False, kw_only=True)
class SourceSettings:
    """Settings of the photon source. Raises `InputError`.

    background: int64[subgroups], probability of a photon per pixel and cycle, in 2^-16. tick,
    level: int64[subgroups, pixels of one], earliest tick of a pixel's echo, and its probability in
    2^-8. spread: an echo is up to 2^spread - 1 ticks late. dead_cycles: from an edge to the
    earliest next edge of its pixel. seed: 32 bits.
    """

    background: np.ndarray
    tick: np.ndarray
    level: np.ndarray
    spread: int = field(default=0)
    dead_cycles: int = field(default=1)
    seed: int = field(default=1)

    def __attrs_post_init__(self) -> None:
        check_integer("spread", self.spread, 0, chip.SPREAD_MAX)
        check_integer("dead_cycles", self.dead_cycles, 1, chip.DEAD_MAX)
        check_integer("seed", self.seed, 0, MASK)
        for name, high in (
            ("background", (1 << chip.RATE_BITS) - 1),
            ("level", (1 << chip.LEVEL_BITS) - 1),
        ):
            values = getattr(self, name)
            if values.size and not 0 <= values.min() <= values.max() <= high:
                raise InputError(f"{name}: must hold integers from 0 to {high}")

    def register_writes(self, sensor: Sensor) -> list[tuple[int, int]]:
        """Return (address, value) of every setting, as seen by the emulator's host. Raises
        `InputError` for late ticks.
        """
        ticks = sensor.period_max * sensor.phases
        if self.tick.size and not 0 <= self.tick.min() <= self.tick.max() < ticks:
            raise InputError(f"tick: must hold integers from 0 to {ticks - 1}")
        writes = [
            (chip.own_address(name), getattr(self, name))
            for name in ("seed", "spread", "dead_cycles")
        ]
        for s in range(sensor.subgroups):
            writes.append((chip.background_address(s), int(self.background[s])))
            echoes = self.tick[s].astype(np.int64) << chip.LEVEL_BITS | self.level[s]
            writes += [(chip.echo_address(s, i), int(echo)) for i, echo in enumerate(echoes)]
        return writes


def source_edges(config: Config, settings: SourceSettings, frame: int) -> Edges:
    """Return the edges of frame number `frame` since the sensor's reset; pulses count from the
    frame's start.
    """
    sensor = config.sensor
    starts, table = config.start_cycles(), pixel_table(sensor)
    # Row and place of a subgroup's pixel in the array, for every subgroup and pixel.
    pixel_of = np.empty((sensor.subgroups, sensor.pixels), np.int64)
    pixel_of[table.subgroup, table.inside] = np.arange(sensor.array_pixels)
    parts = []
    for s in range(sensor.subgroups):
        states = seeds(settings.seed, frame & 0xFFFF, s, sensor.pixels)
        tick, level = settings.tick[s].astype(np.int64), settings.level[s].astype(np.int64)
        light = (
            int(settings.background[s]),
            tick,
            level,
            (1 << settings.spread) - 1,
            settings.dead_cycles,
        )
        parts.append(_walk(states, _tables(), starts, config.period, sensor.phases, *light))
    rows = np.concatenate(
        [
            np.column_stack([part[:, :1], pixel_of[s][part[:, 1]], part[:, 2]])
            for s, part in enumerate(parts)
        ]
    )
    return Edges(*(np.ascontiguousarray(column) for column in rows.T))


def seeds(seed: int, frame: int, subgroup: int, pixels: int) -> np.ndarray:
    """uint32[pixels]: states of a subgroup's generators at the start of a frame, none of them 0."""
    lanes = -(-pixels // chip.LANE_PIXELS)
    blocks = cipher(seed, frame | subgroup << 16, np.arange(lanes * chip.STATE_BITS))
    states = np.zeros(pixels, np.uint32)
    tables = _tables()
    for step in range(chip.STATE_BITS):
        lane_bits = [
            blocks[lane * chip.STATE_BITS + step] >> np.arange(chip.LANE_PIXELS, dtype=np.uint64)
            & np.uint64(1)
            for lane in range(lanes)
        ]
        bits = np.concatenate(lane_bits)[:pixels].astype(np.uint32)
        states = advance(states, tables) ^ bits << np.uint32(chip.SEED_BIT)
    return states | np.uint32(1 << chip.SEED_BIT)


def cipher(seed: int, left: int, right: np.ndarray) -> np.ndarray:
    """uint64[n]: the blocks (left, right[k]) encrypted with the key `seed`; the right half is in
    the low bits.
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
    columns = np.zeros(
        chip.STATE_BITS, np.uint32
    )  # bit j of the state -> bits of the next state that depend on it
    for i, taps in enumerate(chip.TAPS):
        for j in taps:
            columns[j] |= np.uint32(1 << i)
    tables = np.zeros((4, 256), np.uint32)
    for k in range(4):
        for bit in range(8):
            tables[k] ^= np.where(np.arange(256) >> bit & 1, columns[8 * k + bit], 0).astype(
                np.uint32
            )
    return tables


@njit
def _walk(
    states: np.ndarray,
    tables: np.ndarray,
    starts: np.ndarray,
    period: int,
    phases: int,
    background: int,
    tick: np.ndarray,
    level: np.ndarray,
    spread: int,
    dead_cycles: int,
) -> np.ndarray:
    """int64[n, 3]: pulse, pixel in the subgroup, and tick of its edges, pixel by pixel in the order
    of time.
    """
    found = np.empty((1024, 3), np.int64)
    n = 0
    pulses = len(starts) - 1
    for i in range(len(states)):
        state = states[i]
        hit = False
        arrival = np.int64(0)
        free = np.int64(0)  # first cycle in which the pixel is not dead
        for pulse in range(pulses):
            for cycle in range(period):
                phase: Any = phases
                if np.int64(state >> np.uint32(chip.RATE_LSB)) < background:
                    phase = np.int64(state >> np.uint32(chip.PHASE_LSB)) & (phases - 1)
                if cycle == 0:
                    hit = (
                        np.int64(state >> np.uint32(chip.LEVEL_LSB)) & ((1 << chip.LEVEL_BITS) - 1)
                    ) < level[i]
                elif cycle == 1:
                    arrival = tick[i] + (np.int64(state) & spread)
                elif hit and arrival // phases == cycle and cycle >= chip.ECHO_FROM:
                    phase = min(phase, arrival % phases)
                at = starts[pulse] + cycle
                if phase < phases and at >= free:
                    if n == len(found):
                        found = np.concatenate((found, np.empty_like(found)))
                    found[n, 0], found[n, 1], found[n, 2] = pulse, i, cycle * phases + phase
                    n += 1
                    free = at + dead_cycles
                state = (
                    tables[0, state & np.uint32(0xFF)]
                    ^ tables[1, state >> np.uint32(8) & np.uint32(0xFF)]
                    ^ tables[2, state >> np.uint32(16) & np.uint32(0xFF)]
                    ^ tables[3, state >> np.uint32(24)]
                )
    return found[:n]
