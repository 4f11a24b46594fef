# SPDX-License-Identifier: Apache-2.0
"""The emulator on an ULX3S, placed and routed."""

from ..flow.pnr import Board, place, write_placement_page
from ..hdl.export import instantiated
from ..hdl.subgroup import Subgroup
from ..model.contract.config import Config, load_config
from .parameters import BUFFER_BEATS, Emulator
from .rtl.top import EMULATOR_LIST, EmulatorTop
from .rtl.ulx3s import BOARD_TOP, OSCILLATOR_MHZ, board_files, board_pins

# The router stops when it meets its goal, so its goal is a faster clock than that of the emulator.
RESERVE = 1.02


def ulx3s(config: Config, emulator: Emulator | None = None, options: str = "") -> Board:
    """Return the emulator of a configuration's sensor at its clock, on an ULX3S.

    emulator: None: the one of `Emulator.of`. options: of the synthesis. Raises `InputError`.
    """
    emulator = emulator or Emulator.of(config)
    files = board_files(emulator, config.clock_mhz)
    del files[EMULATOR_LIST]
    sensor = config.sensor
    return Board(
        title="The emulator on an ULX3S",
        page="docs/emulator-board.md",
        command="make emulator",
        what=(
            f"the emulator of {sensor.rows} x {sensor.cols} pixels in {sensor.subgroups} subgroups, "
            f"{sensor.phases} phases, with photon source, a frame buffer of "
            f"{emulator.buffer_beats} beats, serial line and a PLL"
        ),
        chip="ECP5 LFE5U-85F, CABGA381, speed grade 6",
        top=BOARD_TOP,
        files=files,
        pins=board_pins(RESERVE * OSCILLATOR_MHZ),
        device=tuple(
            "--85k --package CABGA381 --speed 6 --placer static --router router2 --tmg-ripup".split()
        ),
        goal_mhz=config.clock_mhz,
        options=options,
        apart=tuple(sorted({*instantiated(EmulatorTop(emulator)), Subgroup(sensor).unit_name})),
    )


def place_emulator() -> None:
    """Place the emulator of the preset `emulator`, and write its page. Raises `ToolchainError`."""
    config = load_config("emulator")
    board = ulx3s(config, Emulator.of(config, BUFFER_BEATS))
    write_placement_page(board, place(board))
