# SPDX-License-Identifier: Apache-2.0
"""Verilog export: one file per block, stable names, same bytes for same parameters."""

import gc
import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import lru_cache

from amaranth.back import rtlil
from amaranth.hdl import Fragment
from amaranth.hdl._ir import Design, PortDirection
from amaranth.lib.wiring import In, Out
from attrs import frozen

from ..model.contract.parameters import Sensor
from ..model.shared.licence import SPDX
from .front_end_views import POLYPHASE
from .sensor import SensorTop
from .to_verilog import to_verilog
from .unit import Export, Unit, check_drivers

FILE_LIST = "coincid.f"
DIRECTIONS = {In: PortDirection.Input, Out: PortDirection.Output}
SENSORS_KEPT = 8  # in memory, because an export, its netlists and its tests use the same sensor
Wanted = Callable[[Unit], bool]
START = r"""  reg \1 ;
  /* verilator lint_off INITIALDLY */
  initial \1 <= 0;
  /* verilator lint_on INITIALDLY */"""


def _always(_unit: Unit) -> bool:
    return True


def verilog_files(sensor: Sensor, view=POLYPHASE, cells: bool = False) -> dict[str, str]:
    """Return the Verilog by file name: one file per block, and a file list.

    It depends only on the parameters.

    A view's cells come as behavioural models. cells: with memories of latches and with gating clock
    gates, for standard cells.
    """
    return _sensor_blocks(sensor, view).chosen(cells)


def cell_files(sensor: Sensor, view=POLYPHASE) -> dict[str, str]:
    """Return those of the `verilog_files` that are different for standard cells: memories and clock
    gates.
    """
    return dict(_sensor_blocks(sensor, view).cells)


@frozen
class _Blocks:
    """Verilog by file name.

    cells: the other form of those blocks that have one for standard cells.
    """

    files: dict[str, str]
    cells: dict[str, str]

    def chosen(self, cells: bool) -> dict[str, str]:
        """Return a copy of the files, with or without the forms for standard cells."""
        return self.files | (self.cells if cells else {})


@lru_cache(maxsize=SENSORS_KEPT)
def _sensor_blocks(sensor: Sensor, view) -> _Blocks:
    blocks = _emitted([SensorTop(sensor, view)])
    files = blocks.files | {path.name: path.read_text(encoding="utf-8") for path in view.cells}
    return _Blocks(files | {FILE_LIST: "".join(f"{name}\n" for name in files)}, blocks.cells)


def fpga_files(sensor: Sensor) -> dict[str, str]:
    """Return the top for an FPGA by file name, and the blocks that `verilog_files` lacks."""
    return dict(_fpga_blocks(sensor))


@lru_cache(maxsize=SENSORS_KEPT)
def _fpga_blocks(sensor: Sensor) -> dict[str, str]:
    there = verilog_files(sensor)
    top = SensorTop(sensor, levels=True)
    return _emitted([top], lambda unit: f"{unit.unit_name}.v" not in there).files


def units_files(units: list[Unit], cells: bool = False) -> dict[str, str]:
    """Return the files of some blocks and of all that they instantiate.

    cells: as in `verilog_files`.
    """
    return _emitted(units).chosen(cells)


def instantiated(unit: Unit) -> list[str]:
    """Return the names of the units that a unit instantiates."""
    platform = Export()
    Fragment.get(unit, platform)
    return sorted(platform.units)


@frozen
class Elaborated:
    """A unit with its circuit. placed: the units inside it, by their names there."""

    unit: Unit
    design: Design
    placed: dict[str, Unit]


def _emitted(units: list[Unit], wanted: Wanted = _always) -> _Blocks:
    """Return the files of these units and of all that they instantiate.

    wanted: as in `elaborated`.

    Raises `ConnectionError`.
    """
    texts = {}
    cells = {}
    with _garbage_left():
        for block in elaborated(units, wanted):
            name = block.unit.unit_name
            texts[name] = _text(block)
            if form := block.unit.for_cells():
                cells[f"{name}.v"] = _licensed(form)
    converted = to_verilog(texts)
    files = {f"{name}.v": _licensed(_stable(converted[name])) for name in sorted(converted)}
    return _Blocks(files, cells)


def elaborated(units: list[Unit], wanted: Wanted = _always) -> Iterator[Elaborated]:
    """Yield these units and all that they instantiate, each once.

    wanted: whether a unit is among them. One that is not is left out, with what only it
    instantiates.

    Raises `ConnectionError` for a dead wire.
    """
    pending = {unit.unit_name: unit for unit in units}
    done: set[str] = set()
    while pending:
        name, unit = pending.popitem()
        if name not in done and wanted(unit):
            done.add(name)
            platform = Export()
            block = _elaborated(unit, platform)
            check_drivers(unit, block.design, block.placed)
            yield block
            pending |= platform.units


def _elaborated(unit: Unit, platform: Export) -> Elaborated:
    fragment = Fragment.get(unit, platform)
    ports = {}
    for port, (flow, value) in unit.flat_ports().items():
        ports[port] = (platform.pads.get(port, value), DIRECTIONS[flow])
    design = fragment.prepare(ports=ports, hierarchy=(unit.unit_name,))
    return Elaborated(unit, design, platform.placed)


def _text(block: Elaborated) -> str:
    """Return a unit in Yosys's own language."""
    return rtlil.convert_fragment(block.design, name=block.unit.unit_name, emit_src=False)[0]


@contextmanager
def _garbage_left() -> Iterator[None]:
    """Turn garbage collection off.

    Amaranth makes millions of objects that are all needed; searching them takes half of its time.
    """
    was_enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_enabled:
            gc.enable()


def _licensed(text: str) -> str:
    return f"// {SPDX}\n{text}"


def _stable(text: str) -> str:
    """Return the text without the generator's version line, and with blocks that simulators
    evaluate at time 0.

    The generator makes every `always @*` depend on a variable of its own, initialised at its
    declaration. Under SystemVerilog rules that variable never changes, so a block whose inputs do
    not change would stay undefined. The variable changes if an initial block assigns it.
    """
    text = re.sub(r"\A/\* Generated by .*?\*/\n", "", text)
    text = re.sub(r"^  reg (\\\$auto\$verilog_backend\S+)  = 0;$", START, text, flags=re.MULTILINE)
    return re.sub(r"\\\$auto\$verilog_backend\S+", r"\\$start", text)
