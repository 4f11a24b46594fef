# SPDX-License-Identifier: Apache-2.0
"""The emulator on an ULX3S (ECP5 LFE5U-85F): its clock out of a PLL, a button as reset, the USB
bridge's serial line, and lights.

The board's pins are those of its published constraints (emard/ulx3s, version 2.0 and later).
"""

from pathlib import Path
from string import Template

from amaranth.hdl import Cat, Const, Module, Signal
from amaranth.lib.cdc import FFSynchronizer
from amaranth.lib.wiring import In, Out
from attrs import asdict, frozen

from ...hdl.export import units_files
from ...hdl.unit import Unit
from ...model.shared.errors import InputError
from ...model.shared.licence import SPDX
from ..parameters import Emulator
from .top import EMULATOR_LIST, SERIAL_TOP, emulator_files

BOARD_TOP = "coincid_emulator_ulx3s"
TEMPLATE = Path(__file__).with_name("ulx3s.v.template")
OSCILLATOR_MHZ = 25
VCO_MHZ = 400, 800  # of the PLL's oscillator
DETECTOR_MHZ = 3.125  # at the PLL's phase detector, at least
REFERENCE_MAX, FEEDBACK_MAX, OUTPUT_MAX = 8, 80, 128  # the largest dividers that are tried
# port: (sites, from the lowest bit on; further attributes of its buffers)
PINS = {
    "clk_25mhz": (("G2",), "PULLMODE=NONE"),
    "btn_fire1": (("R1",), "PULLMODE=DOWN"),
    "ftdi_txd": (("M1",), "PULLMODE=UP"),
    "ftdi_rxd": (("L4",), "PULLMODE=UP DRIVE=4"),
    "led": (("B2", "C2", "C1", "D2", "D1", "E2", "E1", "H3"), "PULLMODE=NONE DRIVE=4"),
    "wifi_gpio0": (("L2",), "PULLMODE=NONE DRIVE=4"),
}


@frozen
class Pll:
    """Dividers of the PLL: of its input, of its output on the way back, and of its oscillator."""

    reference: int
    feedback: int
    output: int


def pll(clock_mhz: float) -> Pll:
    """Return dividers that make this clock, with the PLL's oscillator near the middle of its range.

    Raises `InputError` if none do.
    """
    middle = sum(VCO_MHZ) / 2
    for reference in range(1, REFERENCE_MAX + 1):
        feedback = clock_mhz * reference / OSCILLATOR_MHZ
        output = round(middle / clock_mhz)
        possible = (
            feedback == int(feedback)
            and 1 <= feedback <= FEEDBACK_MAX
            and 1 <= output <= OUTPUT_MAX
        )
        low, high = VCO_MHZ
        if (
            possible
            and low <= clock_mhz * output <= high
            and OSCILLATOR_MHZ / reference >= DETECTOR_MHZ
        ):
            return Pll(reference, int(feedback), output)
    raise InputError(
        f"frame.clock_mhz = {clock_mhz:g}: the board's PLL does not make it of "
        f"{OSCILLATOR_MHZ} MHz; 80, 100 and 125 are possible"
    )


class Lights(Unit):
    """Lights that show what goes on.

    Ports
    -----
    laser : in; rx, tx : in, the serial line; led : out

    led[0] blinks: the clock runs. The next three are on for `2^HOLD_BITS` cycles after a laser
    pulse, a byte from the host, a byte to the host. Reset puts them out.
    """

    unit_name = "coincid_lights"
    HOLD_BITS, BLINK_BITS = 22, 26

    def __init__(self):
        super().__init__(laser=In(1), rx=In(1), tx=In(1), led=Out(8))

    def elaborate(self, platform):
        m = Module()
        line = Signal(init=1)
        m.submodules.synchronizer = FFSynchronizer(self.rx, line, init=1)
        count = Signal(self.HOLD_BITS)
        turn = Signal()
        blocks = Signal(self.BLINK_BITS - self.HOLD_BITS)
        now = Signal(3)
        seen = Signal(3)
        shown = Signal(3)
        m.d.sync += [
            Cat(count, turn).eq(count + 1),
            blocks.eq(blocks + turn),
            now.eq(Cat(self.laser, ~line, ~self.tx)),
            seen.eq(seen & (~turn).replicate(3) | now),
        ]
        with m.If(turn):
            m.d.sync += shown.eq(seen)
        m.d.comb += self.led.eq(Cat(blocks[-1], shown, Const(0, 4)))
        return m


def board_verilog(emulator: Emulator, clock_mhz: float) -> str:
    """Return the board's top: PLL, emulator, lights, and a reset that the button or an unlocked PLL
    holds. Raises `InputError`.
    """
    dividers = pll(clock_mhz)
    return Template(TEMPLATE.read_text(encoding="utf-8")).substitute(
        licence=SPDX,
        oscillator_mhz=OSCILLATOR_MHZ,
        clock_mhz=f"{clock_mhz:g}",
        top=BOARD_TOP,
        emulator=SERIAL_TOP,
        lights=Lights.unit_name,
        phase=dividers.output - 1,
        **asdict(dividers),
    )


def board_files(emulator: Emulator, clock_mhz: float) -> dict[str, str]:
    """Return the emulator's Verilog for the board by file name, with a file list.

    Raises `InputError`.
    """
    board = board_verilog(emulator, clock_mhz)  # first, because it may refuse the clock
    files = emulator_files(emulator)
    del files[EMULATOR_LIST]
    files |= units_files([Lights()]) | {f"{BOARD_TOP}.v": board}
    return files | {EMULATOR_LIST: "".join(f"{name}\n" for name in files)}


def board_pins(oscillator_mhz: float = OSCILLATOR_MHZ) -> str:
    """Return the board's pins and its oscillator as constraints (LPF)."""
    lines = [f'FREQUENCY PORT "clk_25mhz" {oscillator_mhz:g} MHZ;']
    for port, (sites, buffer) in PINS.items():
        for k, site in enumerate(sites):
            bit = f"{port}[{k}]" if len(sites) > 1 else port
            lines += [
                f'LOCATE COMP "{bit}" SITE "{site}";',
                f'IOBUF PORT "{bit}" IO_TYPE=LVCMOS33 {buffer};',
            ]
    return "\n".join([f"# {SPDX}", *lines, ""])
