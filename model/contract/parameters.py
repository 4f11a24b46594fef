# SPDX-License-Identifier: Apache-2.0
"""Parameters that are fixed when the sensor is built: sizes, phases, and everything that follows from them."""

from collections.abc import Callable

from attrs import Factory, field, frozen

from ..shared.errors import InputError, check_integer

TOP = "coincid_sensor"  # the RTL's top module
STAMP_FIELD_BITS = 15  # width of the header's field; packet.py lays the fields out
QUARTERS = 4  # coarse stamps count quarters of a cycle, and a step of the offsets is at most a quarter
OFFSET_NONE = 255  # offset byte of a minigroup that was not hit
RECORD_BITS = (16, 32)  # an entry of a minigroup record takes the smaller size that holds it
SHORTEST_GUARD_CYCLES = 4  # a minigroup collection that opens as late as possible must close before the period ends
SIZE_LIMITS = {  # key: (default, lowest, highest)
    "rows": (32, 1, 4096),
    "cols": (32, 1, 4096),
    "phases": (32, 4, 64),
    "coarse_bits": (10, 3, 13),
    "window_max": (128, 1, 1024),
    "rearm": (0, 0, 15),
    "fifo_depth": (16, 1, 1024),
    "streams": (1, 1, 64),
    "offset_phases": (16, QUARTERS, 64),
}
CLOCK_MHZ = 500.0  # system clock of the preset `silicon`, and default of a configuration
CLOCK_MHZ_RANGE = (1e-3, 1e5)
LINK_GBPS_MAX = 1e6  # per stream
SUBGROUP_PIXELS = (16, 256)
MINIGROUP_PIXELS = (1, 16)
SUBGROUPS_MAX = 4096  # the header's subgroup field has 12 bits


def _limited(name: str, fits: Callable[["Sensor"], int] | None = None) -> int:
    """Return a field with default and range of `SIZE_LIMITS`. fits: highest default that the fields before it allow."""
    highest_default, low, high = SIZE_LIMITS[name]
    default = Factory(lambda self: min(highest_default, fits(self)), takes_self=True) if fits else highest_default
    size: int = field(
        default=default,
        validator=lambda _, attribute, value: check_integer(f"sensor.{attribute.name}", value, low, high),
    )
    return size


def _pair(default: tuple[int, int]) -> tuple[int, int]:
    pair: tuple[int, int] = field(
        default=default, converter=lambda value: tuple(value) if isinstance(value, list) else value
    )
    return pair


def bits_for(highest: int) -> int:
    """Return the number of bits that hold 0...`highest` (at least one)."""
    return max(1, int(highest).bit_length())


def guard_cycles(window_ticks: int, phases: int, rearm_cycles: int) -> int:
    """Return how long before a period's end no window of this length may open, so that the tree is armed at the end."""
    return max(SHORTEST_GUARD_CYCLES, -(-window_ticks // phases) + 1 + rearm_cycles)


def _integer(value: object) -> int:
    """Return `value`, or 0 if it is not an integer, because defaults that depend on it are made before it is checked."""
    return value if type(value) is int else 0


@frozen(kw_only=True)
class Sensor:
    """Parameters of the sensor as built. Raises `InputError` with the parameter and its range.

    rows, cols: SPADs. phases: ticks (TDC LSBs) of a clock cycle, a power of two. coarse_bits: width of the TDC's coarse
    counter (default: 10, or what fits a stamp beside the phases). window_max: longest coincidence window in ticks.
    rearm: cycles R between the close cycle of a window and the re-arming of the tree. fifo_depth: events that a
    subgroup's FIFO holds. streams: number of AXI4-Streams. subgroup, minigroup: rows x cols in SPADs. offset_phases:
    steps per cycle of the minigroups' coarse offsets, a power of two from 4 to `phases` (default: 16, or `phases` if
    that is less).
    """

    rows: int = _limited("rows")
    cols: int = _limited("cols")
    phases: int = _limited("phases")
    coarse_bits: int = _limited("coarse_bits", fits=lambda self: STAMP_FIELD_BITS - bits_for(_integer(self.phases) - 1))
    window_max: int = _limited("window_max")
    rearm: int = _limited("rearm")
    fifo_depth: int = _limited("fifo_depth")
    streams: int = _limited("streams")
    subgroup: tuple[int, int] = _pair((8, 8))
    minigroup: tuple[int, int] = _pair((2, 2))
    offset_phases: int = _limited("offset_phases", fits=lambda self: _integer(self.phases))

    def __attrs_post_init__(self) -> None:
        for name, highest in (("phases", SIZE_LIMITS["phases"][2]), ("offset_phases", self.phases)):
            steps = getattr(self, name)
            if steps & (steps - 1) or steps > highest:
                raise InputError(f"sensor.{name} = {steps}: must be a power of two from {QUARTERS} to {highest}")
        for name, outer, outer_name, (low, high) in (
            ("subgroup", (self.rows, self.cols), "rows x cols", SUBGROUP_PIXELS),
            ("minigroup", self.subgroup, "subgroup", MINIGROUP_PIXELS),
        ):
            size = getattr(self, name)
            legal = isinstance(size, tuple) and len(size) == 2 and all(type(n) is int and n > 0 for n in size)
            if not legal or not low <= size[0] * size[1] <= high:
                raise InputError(f"sensor.{name} = {size!r}: must be [rows, cols] of {low} to {high} pixels")
            if outer[0] % size[0] or outer[1] % size[1]:
                raise InputError(f"sensor.{name} = {list(size)}: must divide {outer_name} = {list(outer)} without rest")
        if self.stamp_bits > STAMP_FIELD_BITS:
            highest = STAMP_FIELD_BITS - self.phase_bits
            raise InputError(
                f"sensor.coarse_bits = {self.coarse_bits}: must be an integer from 3 to {highest} with {self.phases} phases"
            )
        if self.offset_max >= OFFSET_NONE:
            highest = OFFSET_NONE * self.offset_ticks - self.phases + 1
            raise InputError(
                f"sensor.window_max = {self.window_max}: must be an integer from 1 to {highest} with sensor.phases ="
                f" {self.phases} and sensor.offset_phases = {self.offset_phases}, so that offsets fit 8 bits"
            )
        if self.subgroups > SUBGROUPS_MAX:
            raise InputError(
                f"sensor.rows, sensor.cols: make {self.subgroups} subgroups, must be at most {SUBGROUPS_MAX}"
            )
        if self.streams > self.subgroups:
            raise InputError(
                f"sensor.streams = {self.streams}: must be an integer from 1 to {self.subgroups} (the subgroups)"
            )
        if self.period_max <= self.guard:
            raise InputError(
                f"sensor.coarse_bits = {self.coarse_bits}: 2^coarse_bits must be above the guard of {self.guard} cycles"
            )

    @property
    def pixels(self) -> int:
        """SPADs of a subgroup."""
        return self.subgroup[0] * self.subgroup[1]

    @property
    def minigroup_pixels(self) -> int:
        return self.minigroup[0] * self.minigroup[1]

    @property
    def minigroups(self) -> int:
        """Minigroups of a subgroup."""
        return self.pixels // self.minigroup_pixels

    @property
    def array_pixels(self) -> int:
        return self.rows * self.cols

    @property
    def subgroups(self) -> int:
        return self.array_pixels // self.pixels

    @property
    def quarter_ticks(self) -> int:
        return self.phases // QUARTERS

    @property
    def offset_ticks(self) -> int:
        """Ticks per step of the coarse offsets."""
        return self.phases // self.offset_phases

    @property
    def guard(self) -> int:
        """Cycles G at the end of a period in which no window opens, so that each period is self-contained."""
        return guard_cycles(self.window_max, self.phases, self.rearm)

    @property
    def period_max(self) -> int:
        """Longest laser period in cycles, limited by the coarse counter."""
        return 1 << self.coarse_bits

    @property
    def phase_bits(self) -> int:
        return bits_for(self.phases - 1)

    @property
    def stamp_bits(self) -> int:
        return self.coarse_bits + self.phase_bits

    @property
    def count_bits(self) -> int:
        return bits_for(self.pixels)

    @property
    def winner_bits(self) -> int:
        return bits_for(self.pixels - 1)

    @property
    def window_bits(self) -> int:
        return bits_for(self.window_max)

    @property
    def offset_max(self) -> int:
        """Largest coarse offset (steps from the start of the opening cycle) inside a window."""
        return (self.phases - 1 + self.window_max - 1) // self.offset_ticks

    @property
    def offset_bits(self) -> int:
        return bits_for(self.offset_max)

    @property
    def step_bits(self) -> int:
        """Bits of a coarse offset that give the step in its cycle; the bits above them count cycles."""
        return bits_for(self.offset_phases - 1)

    @property
    def elapsed_bits(self) -> int:
        """Bits that count the cycles of a window after its opening cycle (at least one)."""
        return max(1, self.offset_bits - self.step_bits)

    @property
    def record_stamp_bits(self) -> int:
        return self.coarse_bits + 2

    @property
    def record_bits(self) -> int:
        """Bits of a minigroup's entry in a record."""
        small, large = RECORD_BITS
        return small if self.record_stamp_bits + self.minigroup_pixels <= small else large

    def members(self, minigroup: int) -> list[int]:
        """Return a subgroup's pixels that belong to a minigroup, in the minigroup's order."""
        (_, sc), (mr, mc) = self.subgroup, self.minigroup
        row, col = divmod(minigroup, sc // mc)
        return [(row * mr + r) * sc + col * mc + c for r in range(mr) for c in range(mc)]

    def stream_of(self, subgroup: int) -> int:
        """Return the stream that carries the words of `subgroup`."""
        return subgroup * self.streams // self.subgroups

    def stream_subgroups(self, stream: int) -> range:
        """Return the subgroups whose words `stream` carries; they are always contiguous."""
        n = self.subgroups
        return range(-(-stream * n // self.streams), -(-(stream + 1) * n // self.streams))

    def stream_name(self, stream: int) -> str:
        """Return the prefix of the stream's ports."""
        return "m_axis" if self.streams == 1 else f"m_axis{stream}"
