# SPDX-License-Identifier: Apache-2.0
"""Parameters that are fixed when the sensor is built: sizes, phases, and everything that follows
from them.
"""

from typing import Any

from attrs import Factory, field, frozen

from ..shared.errors import InputError, out_of_range, wrong_value
from .coincidence import AT_LEAST, Rule, check_rule
from .counters import COUNTER_BITS, COUNTER_BITS_MIN
from .counts import MINIGROUP
from .table import Kind, Limit, number, settings_of_class

TOP = "coincid_sensor"  # the RTL's top module
STAMP_FIELD_BITS = 15  # width of the header's field; packet.py lays the fields out
MASK_BITS = 32  # pixels per register of the mask
QUARTERS = (
    4  # coarse stamps count quarters of a cycle, and a step of the offsets is at most a quarter
)
PHASES_MAX = 64
OFFSET_NONE = 255  # offset byte of a minigroup that was not hit
RECORD_BITS = (16, 32)  # an entry of a minigroup record takes the smaller size that holds it
SHORTEST_GUARD_CYCLES = (
    4  # a minigroup collection that opens as late as possible must close before the period ends
)
CLOCK_MHZ = 500.0  # system clock of the preset `silicon`, and default of a configuration
PARTS = {  # parameters that say whether a part is built, and its name
    "offsets": "coarse offsets",
    "records": "minigroup records",
    "controller": "the threshold controller",
    "counts": "counts",
}
SUBGROUPS_MAX = 4096  # the header's subgroup field has 12 bits


def bits_for(highest: int) -> int:
    """Return the number of bits that hold 0...`highest` (at least one)."""
    return max(1, int(highest).bit_length())


def guard_cycles(window_ticks: int, phases: int, rearm_cycles: int) -> int:
    """Return how long before a period's end no window of this length may open, so that the tree
    is armed at the end.
    """
    return max(SHORTEST_GUARD_CYCLES, -(-window_ticks // phases) + 1 + rearm_cycles)


def _integer(
    default: int,
    low: int,
    high: Limit,
    offset: int,
    doc: str,
    unit: str = "",
    needs: str = "",
) -> Any:
    """Return a field that holds an integer; the default is `default`, but not more than the
    fields before it allow. needs: the register exists only if this parameter is not 0.
    """

    def default_of(sensor: "Sensor") -> int:
        try:
            return min(default, number(high, sensor))
        except (TypeError, ValueError, OverflowError):  # one before it is wrong: refused later
            return default

    of_sensor = Factory(default_of, takes_self=True)
    return _field(
        Kind.INTEGER,
        of_sensor,
        default=default,
        low=low,
        high=high,
        offset=offset,
        doc=doc,
        unit=unit,
        needs=needs,
    )


def _size(default: tuple[int, int], low: int, high: int, offset: int, doc: str) -> Any:
    """Return a field that holds (rows, cols); its registers are NAME_rows and NAME_cols."""
    return _field(
        Kind.SIZE,
        default,
        default=default,
        low=low,
        high=high,
        offset=offset,
        doc=doc,
        unit="pixels",
    )


def _field(kind: Kind, made: Any, **columns: Any) -> Any:
    """Return a field. made: its default, or the factory of it; columns: of its `Setting`."""
    return field(
        default=made,
        converter=lambda value: tuple(value) if isinstance(value, list) else value,
        metadata={"kind": kind} | columns,
    )


@frozen(kw_only=True)
class Sensor:
    """Parameters of the sensor as built: the keys of [sensor]; `SENSOR` has their meanings,
    units and limits.

    rule: which windows become events; only a program can bring another one (docs/extend.md).
    Raises `InputError` with the parameter and its range. Parameters that do not fit together are
    reported under the name of one that differs from its default, because that one was chosen.
    """

    rows: int = _integer(32, 1, 4096, 0x08, "SPAD rows of the sensor.", "pixels")
    cols: int = _integer(32, 1, 4096, 0x0C, "SPAD columns of the sensor.", "pixels")
    phases: int = _integer(
        32, 4, PHASES_MAX, 0x10, "Ticks (TDC LSBs) per clock cycle.", "ticks per cycle"
    )
    coarse_bits: int = _integer(
        10, 3, "coarse_bits_max", 0x14, "Width of the TDC's coarse counter.", "bits"
    )
    window_max: int = _integer(128, 1, 1024, 0x18, "Longest coincidence window in ticks.", "ticks")
    rearm: int = _integer(0, 0, 15, 0x1C, "Re-arm gap R in cycles.", "cycles")
    fifo_depth: int = _integer(16, 1, 1024, 0x20, "Events that a subgroup's FIFO holds.", "events")
    streams: int = _integer(
        1, 1, 64, 0x24, "AXI4-Streams, which share the subgroups in the order of their numbers."
    )
    subgroup: tuple[int, int] = _size((8, 8), 16, 256, 0x28, "SPADs of a subgroup, rows x columns.")
    minigroup: tuple[int, int] = _size((2, 2), 1, 16, 0x30, "SPADs of a minigroup, rows x columns.")
    offset_phases: int = _integer(
        16, QUARTERS, "phases", 0x38, "Steps per clock cycle of the coarse offsets."
    )
    offsets: int = _integer(
        1, 0, 1, 0x3C, "1: the formats with coarse offsets are built; 0: they are not."
    )
    records: int = _integer(1, 0, 1, 0x98, "1: minigroup records are built; 0: they are not.")
    controller: int = _integer(1, 0, 1, 0x9C, "1: the threshold controller is built; 0: it is not.")
    counter_bits: int = _integer(
        COUNTER_BITS,
        COUNTER_BITS_MIN,
        COUNTER_BITS,
        0xA0,
        "Width of a subgroup's counters, which saturate.",
        "bits",
    )
    held: int = _integer(
        1,
        0,
        1,
        0xA4,
        "1: a subgroup's settings can be written during a frame, for the next one; 0: they cannot.",
    )
    counts: int = _integer(
        0, 0, 1, 0xA8, "1: the format counts is built; 0: it is not.", needs="counts"
    )
    rule: Rule = field(default=AT_LEAST)

    def __attrs_post_init__(self) -> None:
        check_rule(self.rule)
        for setting in SENSOR.values():
            value = setting.checked(setting.key, getattr(self, setting.name), self)
            object.__setattr__(self, setting.name, value)  # without types of NumPy
        for name, highest in (("phases", PHASES_MAX), ("offset_phases", self.phases)):
            steps = getattr(self, name)
            if steps & (steps - 1):
                legal = f"a power of two from {QUARTERS} to {highest}"
                raise wrong_value(f"sensor.{name}", steps, legal, low=QUARTERS, high=highest)
        for part, whole, sizes in (
            ("subgroup", ("rows", "cols"), (self.rows, self.cols)),
            ("minigroup", ("subgroup", "subgroup"), self.subgroup),
        ):
            for name, size, step in zip(whole, sizes, getattr(self, part), strict=True):
                if size % step:
                    shown = f"{' x '.join(dict.fromkeys(whole))} = {list(sizes)}"
                    blocks = f"sensor.{part} = {list(getattr(self, part))}"
                    raise self._refused(
                        (part, name),
                        {part: f"must divide {shown} without rest"},
                        f"must be a multiple of {step}, because of {blocks}",
                    )
        if self.counts and self.minigroup != MINIGROUP:
            raise wrong_value(
                "sensor.minigroup",
                list(self.minigroup),
                f"{list(MINIGROUP)}, because the sensor is built with counts (sensor.counts = 1)",
            )
        if self.offset_max >= OFFSET_NONE:
            highest = OFFSET_NONE * self.offset_ticks - self.phases + 1
            legal = (
                f"an integer from 1 to {highest} with sensor.phases = {self.phases} and sensor.offset_phases ="
                f" {self.offset_phases}, so that offsets fit 8 bits"
            )
            raise wrong_value("sensor.window_max", self.window_max, legal, low=1, high=highest)
        if self.subgroups > SUBGROUPS_MAX:
            raise self._refused(
                ("rows", "cols", "subgroup"),
                {},
                f"there are {self.subgroups} subgroups, must be at most {SUBGROUPS_MAX}",
            )
        if self.streams > self.subgroups:
            raise out_of_range("sensor.streams", self.streams, 1, self.subgroups, "the subgroups")
        if self.period_max <= self.guard:
            raise InputError(
                f"sensor.coarse_bits = {self.coarse_bits}: 2^coarse_bits must be above the guard of {self.guard} cycles",
                field="sensor.coarse_bits",
            )

    def _refused(self, names: tuple[str, ...], own: dict[str, str], why: str) -> InputError:
        """Return the error for parameters that do not fit together. At least one of them is not
        the default.

        own: what to say if the error names this parameter, instead of `why`.
        """
        chosen = next(
            name for name in names if getattr(self, name) != SENSOR[name].default_of(self)
        )
        value = getattr(self, chosen)
        shown = list(value) if isinstance(value, tuple) else value
        return InputError(
            f"sensor.{chosen} = {shown}: {own.get(chosen, why)}", field=f"sensor.{chosen}"
        )

    @property
    def coarse_bits_max(self) -> int:
        """Widest coarse counter whose stamps fit the header."""
        return STAMP_FIELD_BITS - self.phase_bits

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
        """Cycles G at the end of a period in which no window opens, so that each period is
        self-contained.
        """
        return guard_cycles(self.window_max, self.phases, self.rearm)

    @property
    def period_max(self) -> int:
        """Longest laser period in cycles, limited by the coarse counter."""
        return 1 << self.coarse_bits

    @property
    def phase_bits(self) -> int:
        return bits_for(self.phases - 1)

    @property
    def mask_words(self) -> int:
        """Registers that hold the mask of a subgroup."""
        return -(-self.pixels // MASK_BITS)

    @property
    def mask_word_max(self) -> int:
        """Highest value of such a register."""
        return (1 << min(MASK_BITS, self.pixels)) - 1

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
    def counter_max(self) -> int:
        """Value at which a subgroup's counters saturate."""
        return (1 << self.counter_bits) - 1

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
        """Bits of a coarse offset that give the step in its cycle; the bits above them count
        cycles.
        """
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


SENSOR = settings_of_class(Sensor, "sensor")
