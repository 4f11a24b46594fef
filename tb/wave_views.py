# SPDX-License-Identifier: Apache-2.0
"""Views of a waveform, block by block, for GTKWave and Surfer."""

from pathlib import Path
from typing import Any, TypeAlias

from pywellen import Waveform

from ..model.contract.parameters import TOP
from ..model.shared.files import whole_file

# Signals worth seeing in each block, in the order of a photon's path; names are those of the
# Verilog.
Block: TypeAlias = tuple[str, str, str]  # title, scope below the top, signals
BLOCKS: tuple[Block, ...] = (
    ("sensor", "", "clk rst laser spad_gate m_axis_tvalid m_axis_tready m_axis_tlast m_axis_tdata"),
    (
        "registers",
        "registers",
        "s_axi__awvalid s_axi__awaddr s_axi__wdata s_axi__bvalid s_axi__bresp start_frame done",
    ),
    ("sequencer", "sequencer", "frame_begin timing finish number done"),
    ("subgroup 0: edges", "module_0.subgroup_0", "words"),
    ("subgroup 0: gate", "module_0.subgroup_0.gating", "accept spad_gate"),
    (
        "subgroup 0: tree",
        "module_0.subgroup_0.tree",
        "line__root line__any line__phase line__coarse opening window_open left closing blind hits closed",
    ),
    ("TDC of module 0", "module_0.tdc", "start coarse"),
    (
        "subgroup 0: DPCU",
        "module_0.subgroup_0.dpcu",
        "window_ticks threshold closed enough commit pulse photons",
    ),
    ("subgroup 0: FIFO", "module_0.subgroup_0.fifo", "stored dropped level take"),
    ("subgroup 0: packets", "module_0.subgroup_0.packetizer", "grant valid beat"),
    ("readout 0", "readout_0", "stored grant valid beat space"),
    ("controller 0", "controller_0", "fits done budget limit"),
)

# GTKWave shows 2**ZOOM picoseconds per screen pixel: some 40 cycles of 2 ns across a window.
ZOOM = 6.3

Group: TypeAlias = tuple[str, list[tuple[str, int]]]  # title; path and width in bits of its signals


def views(fst: Path, blocks: tuple[Block, ...] = BLOCKS) -> list[Path]:
    """Write views of `fst` beside it, for GTKWave (.gtkw) and Surfer (.sucl), and return their
    paths.

    Signals that are not in the waveform (because the sensor lacks the block) are left out.
    """
    variables = Waveform(str(fst)).all_vars()
    # path below the top module, in whatever scope a simulator puts the top
    known: dict[str, tuple[str, int]] = {}
    for variable in variables:
        known.setdefault(
            variable.full_name.partition(f"{TOP}.")[2], (variable.full_name, variable.bitwidth)
        )
    groups = []
    for title, scope, signals in blocks:
        found = [
            known[path]
            for path in (f"{scope}.{name}".lstrip(".") for name in signals.split())
            if path in known
        ]
        if found:
            groups.append((title, found))
    start = _first_pulse(variables)
    written = []
    for suffix, text in ((".gtkw", _gtkwave(fst, groups, start)), (".sucl", _surfer(groups))):
        written.append(fst.with_suffix(suffix))
        with whole_file(written[-1], "w") as file:
            file.write(text)
    return written


def _first_pulse(variables: list[Any]) -> int:
    """Return the time at which `laser` rises first, in units of the waveform; 0 if it never does."""
    for variable in variables:
        if variable.full_name.endswith(f"{TOP}.laser"):
            return next((time for time, value in variable.tv if value == 1), 0)
    return 0


def _gtkwave(fst: Path, groups: list[Group], start: int) -> str:
    """Return a view that begins with the first laser pulse, behind the reset and the settings."""
    lines = [f'[dumpfile] "{fst.name}"', f"[timestart] {start}", f"*-{ZOOM} {start}"]
    for title, signals in groups:
        lines += ["@200", f"-{title}"]
        for path, width in signals:
            lines += ["@22", f"{path}[{width - 1}:0]"] if width > 1 else ["@28", path]
    return "\n".join(lines) + "\n"


def _surfer(groups: list[Group]) -> str:
    lines = []
    for title, signals in groups:
        lines.append("divider_add " + title.replace(" ", "_"))  # the command takes only one word
        lines += [f"variable_add {path}" for path, _ in signals]
    return "\n".join([*lines, "zoom_fit"]) + "\n"
