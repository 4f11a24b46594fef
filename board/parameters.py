# SPDX-License-Identifier: Apache-2.0
"""The emulator, a sensor with photon sources on the same chip: parameters, registers, and
arithmetic of a source.

The paper has no such thing; all of it is our choice. The emulator's address space holds the
registers of the sensor at `SENSOR_BASE`, its own at `OWN_BASE`, the settings of subgroup s's source
at `SOURCE_BASE + SOURCE_STRIDE * s`, and the beats of the frame buffer from `BUFFER_BASE` on.
"""

from attrs import frozen

from ..model.contract.config import Config
from ..model.contract.parameters import Sensor
from ..model.contract.registers import CONSTANT, COUNTER, PULSE, SETTING, Register
from ..model.shared.arguments import check_kind
from ..model.shared.errors import InputError, out_of_range, wrong_value
from ..model.shared.quantities import integer
from .serial_link import BAUD, BAUD_TOLERANCE

ADDRESS_BITS = 24
REGION_BITS = 20  # bits of an address inside a region; the bits above select the region
SENSOR_BASE, OWN_BASE, SOURCE_BASE, BUFFER_BASE = 0x000000, 0x100000, 0x200000, 0x300000
SOURCE_STRIDE = 0x800
BUFFER_BEATS, BUFFER_BEATS_MAX = 8192, 1 << 16  # size of the frame buffer: default and maximum
CLOCKS_PER_BIT = 4, 1 << 16  # of the serial link: the fewest and the most
SUBGROUPS_MAX = 1 << 8
EMULATOR_ID = 0x454D554C  # "EMUL"
EMULATOR_VERSION = 0x00010000

# The photon source. Every pixel has a linear generator of 32 bits. Its next bit i is the XOR of the
# bits `TAPS[i]`, and its period is 2^32 - 1.
STATE_BITS = 32
TAPS = (
    (9, 18, 22), (17, 23, 28), (1, 2, 28), (3, 6, 30), (1, 12, 24), (1, 6, 8), (5, 21, 27), (18, 24, 31),
    (11, 23, 31), (1, 7, 31), (4, 11, 12), (3, 6, 25), (8, 14, 15), (8, 12, 17), (4, 6, 20), (21, 27),
    (16, 19, 27), (2, 8, 9), (4, 18, 26), (19, 21, 22), (3, 4, 8), (12, 13, 22), (11, 30, 31), (11, 14, 20),
    (4, 13, 27), (11, 23, 26), (0, 14, 22), (10, 25, 29), (5, 16, 27), (19, 21, 24), (7, 21, 28), (12, 29, 31),
)  # fmt: skip
SEED_BIT = 15  # bit of a generator at which its seed is shifted in
# In a period's first cycle, these bits of the state decide whether there is an echo; in the second,
# the low ones decide when.
LEVEL_LSB, LEVEL_BITS = 0, 8
PHASE_LSB = 8  # bits of the state that give the phase of a background photon
RATE_LSB, RATE_BITS = 16, 16  # bits of the state that decide whether there is a background photon
SPREAD_MAX = 4
DEAD_MAX = 15
ECHO_FROM = 2  # first cycle of a period in which its echo can arrive

# Seeds come from a block cipher: rounds of Speck64 (Beaulieu et al., 2013), whose keys count
# upwards from the seed.
ROUNDS = 20
KEY_STEP = 0x9E3779B9
ROTATE_RIGHT, ROTATE_LEFT = 8, 3
LANE_PIXELS = 64  # pixels that share a block of the cipher, one bit each


@frozen(kw_only=True)
class Emulator:
    """An emulator as built. Raises `InputError`.

    sensor: the emulated sensor, with one stream. buffer_beats: size of the frame buffer, a power of
    two. clocks_per_bit: clock cycles per bit of the serial link.
    """

    sensor: Sensor
    buffer_beats: int = integer(BUFFER_BEATS, 64, BUFFER_BEATS_MAX)
    clocks_per_bit: int = integer(33, *CLOCKS_PER_BIT)  # 3 Mbaud at 100 MHz

    def __attrs_post_init__(self) -> None:
        if self.sensor.streams != 1:
            raise wrong_value("sensor.streams", self.sensor.streams, "1 in an emulator")
        if self.sensor.subgroups > SUBGROUPS_MAX:
            raise out_of_range("sensor.subgroups", self.sensor.subgroups, 1, SUBGROUPS_MAX)
        if self.buffer_beats & (self.buffer_beats - 1):
            legal = f"a power of two from 64 to {BUFFER_BEATS_MAX}"
            raise wrong_value(
                "buffer_beats", self.buffer_beats, legal, low=64, high=BUFFER_BEATS_MAX
            )

    @classmethod
    def of(cls, config: Config, buffer_beats: int = BUFFER_BEATS) -> "Emulator":
        """Return the emulator of a configuration's sensor, with a line of `BAUD`. Raises
        `InputError` if its clock cannot make that.
        """
        check_kind("config", config, Config)
        clocks = config.clock_mhz * 1e6 / BAUD
        if clocks < 4 or abs(clocks / round(clocks) - 1) > BAUD_TOLERANCE:
            message = f"frame.clock_mhz = {config.clock_mhz:g}: does not make {BAUD} baud to {BAUD_TOLERANCE:.0%}"
            raise InputError(message, field="frame.clock_mhz")
        return cls(sensor=config.sensor, buffer_beats=buffer_beats, clocks_per_bit=round(clocks))

    @property
    def lanes(self) -> int:
        """Blocks of the cipher that one step of a subgroup's seeding takes."""
        return -(-self.sensor.pixels // LANE_PIXELS)


OWN: tuple[Register, ...] = (
    Register("emulator_id", 0x00, CONSTANT, "EMUL in ASCII.", reset=EMULATOR_ID),
    Register(
        "emulator_version",
        0x04,
        CONSTANT,
        "Version of this map: major << 16 | minor.",
        reset=EMULATOR_VERSION,
    ),
    Register("buffer_beats", 0x08, CONSTANT, "Beats that the frame buffer holds."),
    Register("seed", 0x0C, SETTING, "Seed of the photon source.", high=0xFFFF_FFFF, reset=1),
    Register(
        "spread",
        0x10,
        SETTING,
        "An echo is up to 2^spread - 1 ticks late, all equally likely.",
        high=SPREAD_MAX,
    ),
    Register(
        "dead_cycles",
        0x14,
        SETTING,
        "Dead time of a pixel in cycles.",
        low=1,
        high=DEAD_MAX,
        reset=1,
    ),
    Register(
        "buffer_level",
        0x18,
        COUNTER,
        "Number of beats in the frame buffer that have not been taken.",
    ),
    Register("buffer_first", 0x1C, COUNTER, "Place of the first of them in the buffer."),
    Register(
        "buffer_take",
        0x20,
        PULSE,
        "Takes so many beats out of the buffer, at most buffer_level.",
        high=1 << 16,
    ),
    # A frame in which a beat waited may not be as predicted.
    Register(
        "stalls", 0x24, COUNTER, "Cycles since reset in which a beat waited for the full buffer."
    ),
    Register("link_errors", 0x28, COUNTER, "Frames of the serial link that arrived damaged."),
    # Accesses to the sensor wait while the source prepares the next frame.
    Register("seeding", 0x2C, COUNTER, "1 while the source prepares the next frame."),
)
ECHO_OFFSET = 0x400  # from a subgroup's background to its pixels' echoes, in bytes
OWN_BY_NAME = {register.name: register for register in OWN}


def own_address(name: str) -> int:
    """Return the byte address of one of the emulator's own registers."""
    return OWN_BASE + OWN_BY_NAME[name].offset


def background_address(subgroup: int) -> int:
    """Return the byte address of a subgroup's background."""
    return SOURCE_BASE + SOURCE_STRIDE * subgroup


def echo_address(subgroup: int, pixel: int) -> int:
    """Return the byte address of the echo of a subgroup's pixel."""
    return background_address(subgroup) + ECHO_OFFSET + 4 * pixel
