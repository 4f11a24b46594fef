# SPDX-License-Identifier: Apache-2.0
"""The netlist of the board's FPGA behind its pins, as a library for `SimulatedPort`."""

from pathlib import Path

from ..flow.pnr import NETLIST_VERILOG, synthesize
from ..model.contract.config import Config
from ..tools.wheels import YOSYS, wheel_folder
from .lint import PLL_MODEL
from .parameters import Emulator
from .place import ulx3s
from .simulated import SIMULATED_CLOCKS_PER_BIT, build_line, simulated

BENCH = Path(__file__).with_name("ulx3s_bench.v")
FPGA_CELLS = "share/lattice/cells_sim_ecp5.v"
# For Verilator: accept the `initial` blocks, times and includes of the published models.
NETLIST_OPTIONS = "-Wno-INITIALDLY", "-Wno-SPECIFYIGN", "-Wno-UNOPTFLAT", "-DNO_INCLUDES"
NETLIST_OPTIMISE = "-O0"  # because a netlist takes long to compile, and its simulation is short
NETLIST_BEATS = 256  # size of the frame buffer, which consists of LUTs


def emulator_netlist(
    config: Config,
    buffer_beats: int = NETLIST_BEATS,
    clocks_per_bit: int = SIMULATED_CLOCKS_PER_BIT,
) -> tuple[Emulator, Path]:
    """Return an emulator and the library of its netlist in the FPGA's cells, compiled once.

    Memories consist of LUTs, because the published models have no block RAM. The netlist starts as
    the FPGA does: with initial values and without a reset.
    """
    emulator = simulated(config.sensor, buffer_beats, clocks_per_bit)
    netlist = synthesize(ulx3s(config, emulator, "-nobram"))
    cells = wheel_folder(YOSYS) / FPGA_CELLS
    sources = [netlist / NETLIST_VERILOG, BENCH, PLL_MODEL, cells]
    options = [*NETLIST_OPTIONS, f"-I{cells.parent}"]
    return emulator, build_line(sources, BENCH.stem, options, NETLIST_OPTIMISE)
