# SPDX-License-Identifier: Apache-2.0
"""The sensor's Verilog for simulation, emitted once for its parameters and kept."""

from collections.abc import Callable
from pathlib import Path

from attrs import evolve

from ..hdl.export import FILE_LIST, units_files, verilog_files
from ..hdl.front_end_views import POLYPHASE, View
from ..hdl.sensor import Core
from ..hdl.subgroup_pair import SensorModule, Slice
from ..hdl.unit import Unit
from ..model.contract.coincidence import AT_LEAST
from ..model.contract.parameters import SENSOR, Sensor
from ..model.shared.folders import build_root
from ..model.shared.sources import digest, sources_digest
from ..tools.build import build_once


def sensor_key(sensor: Sensor, view: View = POLYPHASE) -> str:
    """Return a readable name for a build: the size, then the view and the parameters that differ
    from the defaults.
    """
    default = Sensor()
    parts = [f"{sensor.rows}x{sensor.cols}"]
    for name in SENSOR:
        value = getattr(sensor, name)
        if name not in ("rows", "cols") and value != getattr(default, name):
            parts.append(
                name + ("x".join(map(str, value)) if isinstance(value, tuple) else str(value))
            )
    if sensor.rule != AT_LEAST:
        parts.append(sensor.rule.name)
    if not view.is_default:
        parts.append(view.name)
    return "-".join(parts)


def rtl(sensor: Sensor, view: View = POLYPHASE) -> list[Path]:
    """Return the sensor's Verilog files in a view, emitted once for its parameters and the state
    of the sources.
    """
    sensor.rule.check_circuit()
    folder = emitted(
        sensor_key(sensor, view),
        repr((sensor, view, view.version)),
        lambda: verilog_files(sensor, view),
    )
    return listed(folder / FILE_LIST)


def rtl_in_two(sensor: Sensor) -> tuple[list[Path], list[Path]]:
    """Return the files of the core (`hdl/sensor.py`), and those of slice and module
    (`hdl/subgroup_pair.py`).

    `sliced.cpp` wires slices to the core; `slice_proof.py` proves that the module is two slices.
    Arrays of any size have the same slices.
    """

    sensor.rule.check_circuit()

    def files(of: Sensor, *units: Unit) -> list[Path]:
        name = f"{sensor_key(of)}-{units[0].unit_name}"
        return sorted(emitted(name, repr(of), lambda: units_files(list(units))).iterdir())

    one = of_one_subgroup(sensor)
    return files(sensor, Core(sensor)), files(one, Slice(one), SensorModule(one))


def of_one_subgroup(sensor: Sensor) -> Sensor:
    """Return the smallest sensor whose subgroups are those of `sensor`."""
    rows, cols = sensor.subgroup
    return evolve(sensor, rows=rows, cols=cols, streams=1)


def emitted(name: str, parameters: str, files: Callable[[], dict[str, str]], *rooms: str) -> Path:
    """Return the folder with the `files`, called `name` and keyed by the parameters and the
    state of the sources.

    rooms: those that the files are made from, besides the RTL's and the contract.
    """
    sources = sources_digest("hdl", "model.contract", "model.shared", *rooms)
    key = digest(name, parameters, sources, Path(__file__).read_bytes())

    def emit(directory: Path) -> None:
        for file, text in files().items():
            (directory / file).write_text(text, encoding="utf-8")

    return build_once(build_root() / "verilog" / f"{name}-{key}", emit)


def listed(path: Path) -> list[Path]:
    """Return the files that a file list names, which lie beside it."""
    return [path.with_name(name) for name in path.read_text(encoding="utf-8").split()]
