"""The sensor's Verilog for simulation: emitted once for its parameters, and kept."""

from pathlib import Path

from ..hdl.export import FILE_LIST, verilog_files
from ..model.parameters import Sensor
from . import toolchain


def sensor_key(sensor: Sensor) -> str:
    """Names a build for people: the parameters that differ from the defaults come after the size."""
    default = Sensor()
    parts = [f"{sensor.rows}x{sensor.cols}"]
    for name in ("phases", "coarse_bits", "window_max", "rearm", "fifo_depth", "streams", "subgroup", "minigroup"):
        value = getattr(sensor, name)
        if value != getattr(default, name):
            parts.append(name + ("x".join(map(str, value)) if isinstance(value, tuple) else str(value)))
    return "-".join(parts)


def rtl(sensor: Sensor) -> list[Path]:
    """The sensor's Verilog files, emitted once for its parameters and the state of the sources."""
    sources = [path for folder in ("hdl", "model") for path in sorted((Path(__file__).parents[1] / folder).glob("*.py"))]
    key = toolchain.digest(repr(sensor), *(path.read_bytes() for path in sources))

    def emit(directory: Path) -> None:
        for name, text in verilog_files(sensor).items():
            (directory / name).write_text(text)

    directory = toolchain.build_once(toolchain.build_root() / "verilog" / f"{sensor_key(sensor)}-{key}", emit)
    return [directory / name for name in (directory / FILE_LIST).read_text().split()]
