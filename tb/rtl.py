# SPDX-License-Identifier: Apache-2.0
"""The sensor's Verilog for simulation, emitted once for its parameters and kept."""

from collections.abc import Callable
from functools import partial
from pathlib import Path

from ..hdl.export import FILE_LIST, units_files, verilog_files
from ..hdl.module import SensorModule, Slice
from ..hdl.sensor import front_part, stream_part
from ..hdl.unit import Unit
from ..hdl.views import POLYPHASE, View
from ..model.contract.parameters import SENSOR, Sensor
from ..model.shared.folders import build_root
from ..model.shared.sources import digest, sources_digest
from ..tools.build import build_once


def sensor_key(sensor: Sensor, view: View = POLYPHASE) -> str:
    """Return a readable name for a build: the size, then the view and the parameters that differ from the defaults."""
    default = Sensor()
    parts = [f"{sensor.rows}x{sensor.cols}"]
    for name in SENSOR:
        value = getattr(sensor, name)
        if name not in ("rows", "cols") and value != getattr(default, name):
            parts.append(name + ("x".join(map(str, value)) if isinstance(value, tuple) else str(value)))
    return "-".join(parts + [view.name] * (view != POLYPHASE))


def rtl(sensor: Sensor, view: View = POLYPHASE) -> list[Path]:
    """Return the sensor's Verilog files in a view, emitted once for its parameters and the state of the sources."""
    folder = _emitted(sensor_key(sensor, view), repr((sensor, view)), lambda: verilog_files(sensor, view))
    return [folder / name for name in (folder / FILE_LIST).read_text().split()]


def rtl_in_parts(sensor: Sensor) -> dict[str, list[Path]]:
    """Return the files of the sensor's parts, for a program that wires them: top module -> files.

    The parts are the front, a stream of each size if there are several (`hdl/sensor.py`), and the slice (`hdl/module.py`). With it comes the
    module, for the proof that it is two slices.
    """
    sizes = sorted({len(sensor.stream_subgroups(k)) for k in range(sensor.streams) if sensor.streams > 1})
    parts: list[list[Unit]] = [
        [front_part(sensor)],
        *([stream_part(sensor, n)] for n in sizes),
        [Slice(sensor), SensorModule(sensor)],
    ]
    found = {}
    for units in parts:
        name = f"{sensor_key(sensor)}-{units[0].unit_name}"
        found[units[0].unit_name] = sorted(_emitted(name, repr(sensor), partial(units_files, units)).iterdir())
    return found


def _emitted(name: str, parameters: str, files: Callable[[], dict[str, str]]) -> Path:
    """Return the folder with the `files`, called `name` and keyed by the parameters and the state of the sources."""
    key = digest(name, parameters, sources_digest("hdl", "model.contract", "model.shared"), Path(__file__).read_bytes())

    def emit(directory: Path) -> None:
        for file, text in files().items():
            (directory / file).write_text(text)

    return build_once(build_root() / "verilog" / f"{name}-{key}", emit)
