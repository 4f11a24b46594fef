# SPDX-License-Identifier: Apache-2.0
"""The exported emulator: Verilog, file list, waivers, the sensor's register map, and the C driver.

There are three kinds: for an ULX3S with its pins (`ulx3s`), with a serial line for another board
(`serial`), and with an AXI4-Lite slave (`axi`).
"""

from pathlib import Path

from ..flow.c_driver import c_driver
from ..flow.register_files import register_files
from ..flow.waivers import CONTROL_FILE, control_file
from ..hdl.front_end_views import POLYPHASE
from ..model.contract.config import Config
from ..model.shared.errors import InputError
from ..model.shared.files import whole_file
from .parameters import Emulator
from .rtl.top import BUS_TOP, SERIAL_TOP, emulator_files
from .rtl.ulx3s import BOARD_TOP, board_files, board_pins

BOARD, SERIAL, AXI = "ulx3s", "serial", "axi"
TOPS = {BOARD: BOARD_TOP, SERIAL: SERIAL_TOP, AXI: BUS_TOP}
PINS = f"{BOARD_TOP}.lpf"
WAIVERS = Path(__file__).with_name("waivers.vlt")  # besides those of a sensor


def emulator_release(config: Config, kind: str, buffer_beats: int) -> dict[str, str]:
    """Return the files of an emulator by name. Equal parameters give equal bytes. Raises
    `InputError`.
    """
    if kind not in TOPS:
        raise InputError(f"kind = {kind!r}: must be one of {', '.join(TOPS)}")
    if kind == AXI:  # has no serial line, so any clock will do
        files = emulator_files(
            Emulator(sensor=config.sensor, buffer_beats=buffer_beats), serial=False
        )
    else:
        emulator = Emulator.of(config, buffer_beats)
        files = (
            board_files(emulator, config.clock_mhz) if kind == BOARD else emulator_files(emulator)
        )
    files = files | register_files(config.sensor) | c_driver()
    files |= {CONTROL_FILE: control_file(POLYPHASE) + WAIVERS.read_text(encoding="utf-8")}
    return files | ({PINS: board_pins()} if kind == BOARD else {})


def write_emulator(folder: Path, files: dict[str, str]) -> list[Path]:
    """Write the files, each whole, and return their paths."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, text in files.items():
        with whole_file(folder / name, "w") as file:
            file.write(text)
    return [folder / name for name in files]
