# SPDX-License-Identifier: Apache-2.0
"""Draws async_tdc.png, the linearity of a TDC with mismatched taps, from a simulation of its
Verilog under Icarus.

python -m docs.studies.drawings.async_tdc
"""

from pathlib import Path

import numpy as np

from coincid.hdl.silicon.circuit import CELLS, ERROR_BITS, Circuit, lag_fs
from coincid.model.contract.parameters import Sensor
from coincid.model.light.code_density import code_density
from coincid.model.shared import markdown
from coincid.study.palette import GREEN, INK, LIGHT_GREY, ORANGE, VIOLET
from coincid.study.plot_style import new_figure, save_figure, style
from coincid.tb.stimulus import FS_PER_PS
from coincid.tb.stress import run_bench
from coincid.tools.pages import picture, put

IMAGE = "docs/images/async_tdc.png"
SENSOR = Sensor()
CLOCK_FS = Circuit().clock_fs
TICK_PS = CLOCK_FS / SENSOR.phases / FS_PER_PS
SIGMA_PS = 0.1 * TICK_PS  # mismatch of the border of a tap, in this example


def draw() -> None:
    """Draw DNL and INL of a TDC with mismatched taps, from a code density test, and the bias of its
    stamps.
    """
    errors = np.random.default_rng(1).normal(0, SIGMA_PS, SENSOR.phases)  # of the borders, in ps
    packed = sum(
        int(round(e * FS_PER_PS)) % (1 << ERROR_BITS) << ERROR_BITS * k
        for k, e in enumerate(errors)
    )
    half = SENSOR.phases // 2
    parameters = {"PHASES": SENSOR.phases, "CLOCK_FS": CLOCK_FS, "LAG_FS": lag_fs(SENSOR)}
    parameters |= {"ERROR_BITS": ERROR_BITS, "MISMATCH_FS": packed, "EVENTS": 40_000}
    told = run_bench(
        Path(__file__).with_name("async_tdc.v"),
        {CELLS.name: CELLS.read_text(encoding="utf-8")},
        parameters=parameters,
    )
    codes = np.array([[int(bit) for bit in line[::-1]] for line in told if set(line) <= {"0", "1"}])
    tick = np.where(codes[:, 0] == 1, codes.sum(1) - 1, half + (half - codes.sum(1)) - 1)
    found = code_density(tick, SENSOR.phases)
    truth = np.diff(np.append(errors, errors[0])) / TICK_PS
    centre = (errors + np.roll(errors, -1)) / 2
    with style():
        figure = new_figure(9, 3.2)
        left, right = figure.subplots(1, 2)
        phase = np.arange(SENSOR.phases)
        left.bar(phase, truth, color=LIGHT_GREY, label="borders as given")
        density = "DNL, code density (2 sigma)"
        left.errorbar(
            phase, found.dnl_lsb, 2 * found.sigma_lsb, fmt="o", color=GREEN, label=density
        )
        left.plot(phase, found.inl_lsb, color=ORANGE, label="INL")
        left.set(xlabel="phase", ylabel="LSB")
        left.legend()
        right.plot(phase, centre, "o-", color=VIOLET)
        right.axhline(0, color=INK, linewidth=0.8)
        right.set(xlabel="phase", ylabel="bias of the stamp in ps")
        right.set_title(f"rms {np.sqrt((centre**2).mean()):.1f} ps, {len(tick)} events")
        save_figure(figure, picture(IMAGE))
    worst = np.abs(found.dnl_lsb - truth).max()
    rms_ps = np.sqrt((centre**2).mean())
    shown = f"![DNL, INL and bias with mismatched taps]({IMAGE.removeprefix('docs/')})"
    caption = (
        f"The picture shows a code density test with {len(tick):,} events on the Verilog of the sampling line, with a "
        f"mismatch of {SIGMA_PS / TICK_PS:g} LSB rms per border. The DNL follows the given borders; the largest difference is "
        f"{worst:.3f} LSB, and the standard error of a width at most {found.sigma_lsb.max():.3f} LSB. Stamps have a bias of "
        f"{rms_ps:.1f} ps rms and at most {np.abs(centre).max():.1f} ps."
    )
    put("docs/async.md", "tdc", f"{shown}\n\n{markdown.paragraph(caption)}")


if __name__ == "__main__":
    draw()
