# SPDX-License-Identifier: Apache-2.0
"""The two views of the front end behind one interface.

Everything behind the front end is common to both.

A view provides the units of its front end and its TDC, the width of a subgroup's SPAD port, and the
Verilog that is not generated: cells (behaviour) and macros (black boxes).
"""

from pathlib import Path
from typing import ClassVar, TypeAlias

from amaranth.hdl import Value
from attrs import evolve, field, frozen

from ..model.contract.parameters import Sensor
from ..model.shared.quantities import check_choice
from . import tdc
from .gating import Gating
from .silicon import tdc as async_tdc
from .silicon.circuit import CELLS, MACROS, Circuit
from .silicon.front_end import AsyncFrontEnd
from .tree import CoincidenceTree


@frozen
class Polyphase:
    """Synchronous view: a SPAD gives one word of `phases` bits per cycle. For simulation, formal
    proof and FPGA.
    """

    name = "polyphase"
    prefix = "coincid_"
    front_end_rests = True  # its clock may stop while no strobe comes
    cells: ClassVar[tuple[Path, ...]] = ()
    macros: ClassVar[tuple[Path, ...]] = ()

    def at(self, clock_mhz: float) -> "Polyphase":
        """Return the view at a system clock.

        It depends only on cycles, so it is the same at any clock.
        """
        return self

    def spad_bits(self, sensor: Sensor) -> int:
        """Return the width of a subgroup's SPAD port."""
        return sensor.pixels * sensor.phases

    def line_signature(self, sensor: Sensor):
        return tdc.line_signature(sensor)

    def tdc(self, sensor: Sensor, lines: int):
        return tdc.Tdc(sensor, lines)

    def front_end(self, sensor: Sensor):
        return CoincidenceTree(sensor)

    def from_spads(self, words: Value, gating: Gating) -> dict[str, Value]:
        """Return drivers of the front end's inputs that depend on the view."""
        return dict(
            words=words,
            accept=gating.accept,
        )


@frozen
class Asynchronous:
    """Asynchronous view, for silicon: a SPAD is a line whose rising edges are avalanches."""

    circuit: Circuit = field(factory=Circuit)
    name = "async"
    prefix = "coincid_async_"
    front_end_rests = False  # it counts the parity of the cycles, together with the TDC
    cells: ClassVar[tuple[Path, ...]] = (CELLS,)
    macros: ClassVar[tuple[Path, ...]] = (MACROS,)

    def at(self, clock_mhz: float) -> "Asynchronous":
        """Return the view at a system clock. Raises `InputError`."""
        return evolve(self, circuit=evolve(self.circuit, clock_mhz=clock_mhz))

    def spad_bits(self, sensor: Sensor) -> int:
        """Return the width of a subgroup's SPAD port."""
        return sensor.pixels

    def line_signature(self, sensor: Sensor):
        return async_tdc.line_signature(sensor)

    def tdc(self, sensor: Sensor, lines: int):
        return async_tdc.AsyncTdc(sensor, self.circuit, lines)

    def front_end(self, sensor: Sensor):
        return AsyncFrontEnd(sensor, self.circuit)

    def from_spads(self, words: Value, gating: Gating) -> dict[str, Value]:
        """Return drivers of the front end's inputs that depend on the view."""
        return dict(
            spad=words,
            gate=gating.spad_gate,
        )


View: TypeAlias = Polyphase | Asynchronous
POLYPHASE = Polyphase()
VIEWS: dict[str, View] = {"polyphase": POLYPHASE, "async": Asynchronous()}


def view_at(view: str | View, clock_mhz: float) -> View:
    """Return a view, or the one of `VIEWS` with this name, at a system clock.

    Raises `InputError`.
    """
    return (VIEWS[check_choice("view", view, tuple(VIEWS))] if isinstance(view, str) else view).at(
        clock_mhz
    )
