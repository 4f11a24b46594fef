# SPDX-License-Identifier: Apache-2.0
"""Circuits of the asynchronous view: its cells, macros and delays, and the structure that follows
from the re-arm gap.

The paper shows no circuit; all of this is our choice. Behaviour of the cells: `async_cells.v`;
requirements on the macros: docs/async.md.
"""

from pathlib import Path
from typing import Any

from amaranth.hdl import Const, Instance, Module, Mux, Signal, Value
from attrs import Converter, field, frozen

from ...model.contract.parameters import CLOCK_MHZ, PHASES_MAX, Sensor
from ...model.shared.errors import InputError, check_integer
from ...model.shared.quantities import integer, real
from ..logic import popcount

# For simulation: behaviour in femtoseconds. For synthesis: only the cells.
CELLS = Path(__file__).with_name("async_cells.v")
MACROS = Path(__file__).with_name("async_macros.v")  # black boxes of the macros, for synthesis
STEP_FS = (
    PHASES_MAX  # a cycle is a multiple of this, so that its ticks and its sixteenths are integers
)
FS_MHZ = 1e9  # femtoseconds in a cycle of 1 MHz
SLOWEST_MHZ = 1.0  # below it, a cycle in femtoseconds does not fit into Verilog's 32-bit integers
FASTEST_MHZ = 1000.0  # above it, the delays of the cells are too long
HIT_FS = 50_000  # from a SPAD's edge to its hit
LEVEL_FS = 25_000  # delay of one level of the OR tree
SYNCHRONISER_REARM = (
    3  # shortest re-arm gap of a single window bank: two synchronising flops are in its clear
)
ERROR_BITS = 32  # width of one boundary's mismatch in the generator's parameter
ERROR_MAX = (1 << (ERROR_BITS - 1)) - 1
GAIN_PPM_MAX = 999_999  # a line with an error of -1 million has no length


def _integers(low: int, high: int) -> Any:
    """Return an attrs field that holds integers from `low` to `high`, by default none."""

    def checked(values: Any, attribute: Any) -> tuple[int, ...]:
        return tuple(
            check_integer(f"{attribute.name}[{k}]", value, low, high)
            for k, value in enumerate(values)
        )

    return field(default=(), converter=Converter(checked, takes_field=True))


@frozen(kw_only=True)
class Circuit:
    """Circuit properties of the asynchronous view. Raises `InputError`.

    clock_mhz: system clock. banks: window banks, 1 or 2; None: one if the re-arm gap allows it.
    mismatch_fs: error of every phase boundary of the generator (`phases` integers; none: 0).
    pixel_skew_fs: extra delay of each pixel's path to the tree beyond nominal (`pixels` integers;
    none: 0). delay_line: the window is a delay line instead of counted phase boundaries; gain_ppm:
    error of the delay line.
    """

    clock_mhz: float = real(CLOCK_MHZ, SLOWEST_MHZ, FASTEST_MHZ)
    banks: int | None = integer(None, 1, 2)
    mismatch_fs: tuple[int, ...] = _integers(-ERROR_MAX, ERROR_MAX)
    pixel_skew_fs: tuple[int, ...] = _integers(0, ERROR_MAX)
    delay_line: bool = False
    gain_ppm: int = integer(0, -GAIN_PPM_MAX, GAIN_PPM_MAX)

    @property
    def clock_fs(self) -> int:
        """A cycle of the system clock in femtoseconds."""
        return clock_fs(self.clock_mhz)

    def check(self, sensor: Sensor) -> None:
        """Raise `InputError` unless the properties fit a sensor."""
        self.banks_of(sensor)
        for name, most in (("mismatch_fs", sensor.phases), ("pixel_skew_fs", sensor.pixels)):
            numbers = len(getattr(self, name))
            if numbers not in (0, most):
                raise InputError(f"{name}: has {numbers} numbers, must have none or {most}")

    def banks_of(self, sensor: Sensor) -> int:
        """Return the number of window banks.

        Raises `InputError` if a single bank cannot keep to the re-arm gap.
        """
        banks = self.banks or (1 if sensor.rearm >= SYNCHRONISER_REARM else 2)
        if banks == 1 and sensor.rearm < SYNCHRONISER_REARM:
            raise InputError(
                f"sensor.rearm = {sensor.rearm}: must be at least {SYNCHRONISER_REARM} "
                "with a single window bank"
            )
        return banks


def clock_fs(clock_mhz: float, step_fs: int = STEP_FS) -> int:
    """Return a cycle in femtoseconds, rounded to a multiple of `step_fs`."""
    return max(1, round(FS_MHZ / clock_mhz / step_fs)) * step_fs


def levels(count: int) -> int:
    """Return the number of levels of an OR tree over `count` inputs."""
    return (count - 1).bit_length()


def lag_fs(sensor: Sensor) -> int:
    """Return the delay from a SPAD's edge to the TDC's sampling flops; a replica delays the phases
    by the same time.
    """
    return HIT_FS + LEVEL_FS * (levels(sensor.minigroup_pixels) + levels(sensor.minigroups))


def hit_flop(
    m: Module, name: str, edge: Value, arm: Value, clear: Value, delay_fs: int = 0
) -> Signal:
    """Return a flop that `edge` sets while armed; it stays set until it is cleared."""
    hit = Signal(name=name)
    m.submodules[f"flop_{name}"] = Instance(
        "coincid_hit_flop", p_DELAY_FS=delay_fs, i_edge_in=edge, i_arm=arm, i_clear=clear, o_hit=hit
    )
    return hit


def sample(m: Module, name: str, event: Value, data: Value) -> Signal:
    """Return `data` as it was at the last rising edge of `event`."""
    taken = Signal(len(data), name=name)
    m.submodules[f"sample_{name}"] = Instance(
        "coincid_sample", p_WIDTH=len(data), i_event_in=event, i_d=data, o_q=taken
    )
    return taken


def johnson_number(m: Module, taps: Value, name: str) -> Value:
    """Return the part of the cycle that the taps show, counted from 0.

    One wrong tap changes it by one part.
    """
    half, first_half = len(taps), taps[0]
    # Taps that have changed since the half cycle began.
    run = Signal(range(half + 1), name=f"{name}_run")
    m.d.comb += run.eq(popcount(m, taps ^ ~first_half.replicate(half), name))
    return (Mux(first_half, 0, half) + run - 1)[: half.bit_length()]


def delayed(m: Module, name: str, signal: Value, delay_fs: int) -> Signal:
    """Return `signal` through a matched delay."""
    later = Signal(name=name)
    m.submodules[f"delay_{name}"] = Instance(
        "coincid_delay", p_DELAY_FS=delay_fs, i_a=signal, o_y=later
    )
    return later


def or_tree(m: Module, name: str, inputs: list[Value]) -> Value:
    """Return the OR, in levels of equal delay: an input without a partner is ORed with 0."""
    level = 0
    while len(inputs) > 1:
        nodes = []
        for i in range(0, len(inputs), 2):
            node = Signal(name=f"{name}_{level}_{i // 2}")
            other = inputs[i + 1] if i + 1 < len(inputs) else Const(0)
            m.submodules[f"or_{node.name}"] = Instance(
                "coincid_or2", p_DELAY_FS=LEVEL_FS, i_a=inputs[i], i_b=other, o_y=node
            )
            nodes.append(node)
        inputs, level = nodes, level + 1
    return inputs[0]


def arbiter_rows(requests: int):
    """Yield the levels of an arbiter tree over requests 0...n-1, each as ([(node, a, b)], alone).

    a, b, alone: a request, or n + a node's number. `alone` has no partner at this level; None if
    there is no such one.
    """
    row, node = list(range(requests)), 0
    while len(row) > 1:
        alone = row[-1] if len(row) % 2 else None
        partners = zip(row[:-1:2], row[1::2], strict=True)
        pairs = [(node + k, a, b) for k, (a, b) in enumerate(partners)]
        node += len(pairs)
        yield pairs, alone
        row = [requests + k for k, _, _ in pairs] + ([] if alone is None else [alone])
