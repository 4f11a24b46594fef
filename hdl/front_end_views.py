# SPDX-License-Identifier: Apache-2.0
"""The views of the front end behind one interface: `View`.

Everything behind the front end is common to all of them, and nothing else asks which view it has:
it reads the view's attributes.
"""

from pathlib import Path
from typing import Any, ClassVar

from amaranth.hdl import Value
from attrs import evolve, field, frozen

from ..model.contract.parameters import Sensor
from ..model.shared.errors import wrong_value
from ..model.shared.own_part import check_part
from ..model.shared.quantities import check_choice
from . import tdc
from .gating import Gating
from .minigroup import Minigroup, Recorder
from .silicon import tdc as async_tdc
from .silicon.circuit import CELLS, MACROS, Circuit
from .silicon.front_end import AsyncFrontEnd
from .silicon.minigroup import AsyncMinigroup
from .tree import CoincidenceTree, FrontEnd
from .unit import Unit


@frozen
class View:
    """A view of the front end, and the base class of a user's own; see docs/extend.md.

    Attributes
    ----------
    name, version : str
        See `OwnPart`.
    prefix : str
        Begins the Verilog names of the blocks that depend on the view.
    by_words : bool
        A SPAD gives one word of `phases` bits per cycle. False: it is a line whose rising edges are
        avalanches, at any time, and benches drive it to the femtosecond.
    has_quarters : bool
        It gives the quarter of the cycle of each pixel's edge, which counts need.
    front_end_rests : bool
        Its clock may stop while no strobe comes.
    cells, macros : tuple of Path
        Verilog that is not generated: cells (behaviour) and macros (black boxes).
    circuit : Circuit or None
        Properties of its circuits; a view of lines has one. None: it depends on cycles only.
    """

    name: ClassVar[str]
    prefix: ClassVar[str]
    by_words: ClassVar[bool]
    front_end_rests: ClassVar[bool]
    has_quarters: ClassVar[bool] = False
    version: ClassVar[str] = "1"
    cells: ClassVar[tuple[Path, ...]] = ()
    macros: ClassVar[tuple[Path, ...]] = ()
    circuit: Circuit | None = field(default=None, init=False)

    @property
    def is_default(self) -> bool:
        """Whether it is used where no view is named.

        The top for FPGAs, the sliced engine and the golden model have this view only.
        """
        return self == POLYPHASE

    def at(self, clock_mhz: float) -> "View":
        """Return the view at a system clock. Raises `InputError`."""
        raise NotImplementedError

    def check(self, sensor: Sensor) -> None:
        """Raise `InputError` for a sensor that this view does not have."""
        if sensor.counts and not self.has_quarters:
            raise wrong_value(
                "sensor.counts",
                sensor.counts,
                f"0 in the view {self.name}, which knows no quarters of a cycle by pixel",
            )

    def spad_bits(self, sensor: Sensor) -> int:
        """Return the width of a subgroup's SPAD port."""
        raise NotImplementedError

    def line_signature(self, sensor: Sensor) -> Any:
        """Return the signature of a TDC sampling line."""
        raise NotImplementedError

    def tdc(self, sensor: Sensor, lines: int) -> Unit:
        """Return the TDC of as many lines."""
        raise NotImplementedError

    def front_end(self, sensor: Sensor) -> FrontEnd:
        """Return the front end of a subgroup."""
        raise NotImplementedError

    def minigroup(self, sensor: Sensor) -> Recorder:
        """Return a leaf of the front end."""
        raise NotImplementedError

    def from_spads(self, words: Value, gating: Gating) -> dict[str, Value]:
        """Return drivers of the front end's inputs that depend on the view."""
        raise NotImplementedError


@frozen
class Polyphase(View):
    """Synchronous view: a SPAD gives one word of `phases` bits per cycle. For simulation, formal
    proof and FPGA.
    """

    name = "polyphase"
    prefix = "coincid_"
    by_words = True
    front_end_rests = True
    has_quarters = True

    def at(self, clock_mhz: float) -> "Polyphase":
        """Return the view at a system clock.

        It depends only on cycles, so it is the same at any clock.
        """
        return self

    def spad_bits(self, sensor: Sensor) -> int:
        return sensor.pixels * sensor.phases

    def line_signature(self, sensor: Sensor) -> Any:
        return tdc.line_signature(sensor)

    def tdc(self, sensor: Sensor, lines: int) -> Unit:
        return tdc.Tdc(sensor, lines)

    def front_end(self, sensor: Sensor) -> FrontEnd:
        return CoincidenceTree(sensor)

    def minigroup(self, sensor: Sensor) -> Recorder:
        return Minigroup(sensor)

    def from_spads(self, words: Value, gating: Gating) -> dict[str, Value]:
        return dict(
            words=words,
            accept=gating.accept,
        )


@frozen
class Asynchronous(View):
    """Asynchronous view, for silicon: a SPAD is a line whose rising edges are avalanches."""

    circuit: Circuit = field(factory=Circuit)
    name = "async"
    prefix = "coincid_async_"
    by_words = False
    front_end_rests = False  # it counts the parity of the cycles, together with the TDC
    cells = (CELLS,)
    macros = (MACROS,)

    def at(self, clock_mhz: float) -> "Asynchronous":
        return evolve(self, circuit=evolve(self.circuit, clock_mhz=clock_mhz))

    def check(self, sensor: Sensor) -> None:
        super().check(sensor)
        self.circuit.check(sensor)

    def spad_bits(self, sensor: Sensor) -> int:
        return sensor.pixels

    def line_signature(self, sensor: Sensor) -> Any:
        return async_tdc.line_signature(sensor)

    def tdc(self, sensor: Sensor, lines: int) -> Unit:
        return async_tdc.AsyncTdc(sensor, self.circuit, lines)

    def front_end(self, sensor: Sensor) -> FrontEnd:
        return AsyncFrontEnd(sensor, self.circuit)

    def minigroup(self, sensor: Sensor) -> Recorder:
        return AsyncMinigroup(sensor)

    def from_spads(self, words: Value, gating: Gating) -> dict[str, Value]:
        return dict(
            spad=words,
            gate=gating.spad_gate,
        )


POLYPHASE = Polyphase()
VIEWS: dict[str, View] = {"polyphase": POLYPHASE, "async": Asynchronous()}


def view_at(view: str | View, clock_mhz: float) -> View:
    """Return a view, or the one of `VIEWS` with this name, at a system clock.

    Raises `InputError`.
    """
    if isinstance(view, str):
        return VIEWS[check_choice("view", view, tuple(VIEWS))].at(clock_mhz)
    if not isinstance(view, View):
        raise wrong_value("view", view, f"one of {', '.join(VIEWS)}, or a View")
    check_part("view", view)
    if view.name in VIEWS and type(view) is not type(VIEWS[view.name]):
        raise wrong_value("view", view.name, "another name: it is that of a built-in view")
    return view.at(clock_mhz)
