# SPDX-License-Identifier: Apache-2.0
"""The sensor's Verilog for simulation, emitted once for its parameters and kept."""

from pathlib import Path

from ..hdl.export import FILE_LIST, core_files, verilog_files
from ..hdl.sensor import CORE
from ..hdl.views import POLYPHASE, View
from ..model.contract.parameters import SENSOR, TOP, Sensor
from ..model.shared.folders import build_root
from ..model.shared.sources import digest, sources_digest
from . import toolchain

CORE_LIST = f"{CORE}.f"


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
    return _listed(_emitted(sensor, view), FILE_LIST)


def rtl_in_two(sensor: Sensor) -> tuple[list[Path], list[Path]]:
    """Return the files of the core (`hdl/sensor.py`), and of a module, for a program that wires the modules itself."""
    core = _listed(_emitted(sensor), CORE_LIST)
    in_core = {TOP, *(path.stem for path in core)}
    return core, [path for path in rtl(sensor) if path.stem not in in_core]


def _emitted(sensor: Sensor, view: View = POLYPHASE) -> Path:
    parts = [repr(sensor)] if view == POLYPHASE else [repr(sensor), repr(view)]
    key = digest(*parts, sources_digest("hdl", "model.contract", "model.shared"), Path(__file__).read_bytes())

    def emit(directory: Path) -> None:
        files = verilog_files(sensor, view)
        if view == POLYPHASE:
            core_text, of_core = core_files(sensor)
            files |= {f"{CORE}.v": core_text, CORE_LIST: "".join(f"{name}\n" for name in (f"{CORE}.v", *of_core))}
        for name, text in files.items():
            (directory / name).write_text(text)

    return toolchain.build_once(build_root() / "verilog" / f"{sensor_key(sensor, view)}-{key}", emit)


def _listed(directory: Path, file_list: str) -> list[Path]:
    return [directory / name for name in (directory / file_list).read_text().split()]
