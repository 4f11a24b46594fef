# SPDX-License-Identifier: Apache-2.0
"""Gate-level simulation: the netlist after synthesis passes the same cocotb test and scoreboard
as the RTL.

Flip-flops and latches start with random values and take a random value for an unknown input, as
in silicon. So a netlist that agrees with the golden model does not rely on initial values. The
simulation does not start with X, because optimised gates turn one unknown value into many.
"""

import re
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from ..model.contract.config import Config, parse_config, sensor_table
from ..model.contract.edges import Edges
from ..model.contract.packet import built_formats
from ..model.contract.parameters import TOP, Sensor
from ..model.golden.frame import Golden
from ..model.shared.errors import InputError
from ..model.shared.folders import build_root
from ..tb import toolchain
from ..tb.frame_record import FrameJob
from ..tb.play import play_in
from ..tb.rtl import sensor_key
from ..tools.wheels import YOSYS, wheel_folder
from .synth import CELLS, GATES, synthesize
from .yosys import CELL_MODELS, cells_folder

SENSOR = Sensor(rows=8, cols=8)
FRAMES = 6
FLOPS = Path(__file__).with_name("random_flops.v")
PULSES = 8
EDGES_A_CYCLE = 0.4  # mean number in each subgroup


def netlist_build(sensor: Sensor, target: str, scopes: Sequence[str] = ()) -> toolchain.Build:
    """Compile the netlist of a sensor, in gates or standard cells, with Icarus and the cells'
    models; `scopes` as in `toolchain.build`.
    """
    synthesized = synthesize(sensor, target)
    with tempfile.TemporaryDirectory(prefix="coincid-") as folder:
        models = Path(folder) / f"{target}.v"
        models.write_text(cell_models(target), encoding="utf-8")
        return toolchain.build(
            "icarus",
            [synthesized.folder / "netlist.v", models],
            TOP,
            key=f"{target}-{sensor_key(sensor)}",
            scopes=scopes,
        )


def cell_models(target: str = CELLS) -> str:
    """Return the published models of the cells, with those of `FLOPS` in place of the published
    ones.
    """
    if target == GATES:
        source = wheel_folder(YOSYS) / "share" / "simcells.v"
    else:
        folder = cells_folder()
        if folder is None:
            raise InputError("the standard cells are not installed; run: scripts/setup cells")
        source = folder / CELL_MODELS
    own = FLOPS.read_text(encoding="utf-8")
    text = source.read_text(encoding="utf-8")
    for name in re.findall(r"^(?:module |`CLOCK_GATE\()([^\s)]+)", own, flags=re.MULTILINE):
        text = re.sub(
            rf"^module {re.escape(name)}\s*\(.*?^endmodule",
            "",
            text,
            count=1,
            flags=re.DOTALL | re.MULTILINE,
        )
    return text + own


def random_frames(sensor: Sensor, frames: int, seed: int = 1) -> list[FrameJob]:
    """Return random frames in every format. Coincidence, gating, controller, records and a
    stalled stream vary.
    """
    rng, golden, jobs, formats = (
        np.random.default_rng(seed),
        Golden(sensor),
        [],
        built_formats(sensor),
    )
    scarce = {"auto_bounds": [0, 0, 0, 20, 40, 80], "capacity": 20} if sensor.controller else {}
    for n in range(frames):
        shortest = 2 * sensor.guard + 10
        period = min(int(rng.integers(shortest, max(60, shortest + 1))), sensor.period_max)
        config = parse_config(
            {
                "sensor": sensor_table(sensor),
                "frame": {
                    "period": period,
                    "pulses": PULSES,
                    "format": formats[n % len(formats)],
                    "minigroup_records": bool(sensor.records) and n % 2 == 1,
                    "mg_threshold": min(1 + n % 2, sensor.minigroup_pixels),
                }
                | scarce,
                "subgroup": {
                    "coincidence": n % 4 != 3,
                    "gating": n % 2 == 0,
                    "auto": bool(sensor.controller) and n > 3,
                    "threshold": 1 + n % 3,
                    "gate_start": 2,
                    "gate_len": max(period - 8, 1),
                    "window": int(rng.integers(1, sensor.window_max + 1)),
                },
            }
        ).with_rule(sensor.rule)
        edges = _random_edges(config, rng)
        ready = (
            (rng.random(period * PULSES) < 0.6).astype(np.uint8) if n % 2 else np.zeros(0, np.uint8)
        )
        jobs.append(FrameJob(config, edges, golden.frame(config, edges, ready), ready))
    return jobs


def _random_edges(config: Config, rng: np.random.Generator) -> Edges:
    n = int(EDGES_A_CYCLE * config.sensor.subgroups * PULSES * config.period)
    highs = PULSES, config.sensor.array_pixels, config.period_ticks
    return Edges(*(rng.integers(0, high, n) for high in highs))


def gate_level(sensor: Sensor, target: str, frames: int = FRAMES, seed: int = 1) -> tuple[int, int]:
    """Play random frames through the netlist; return (words and commits checked, cycles). Raises
    `Mismatch`.
    """
    build, jobs = netlist_build(sensor, target), random_frames(sensor, frames, seed)
    return played(build, jobs, f"{target}-{sensor_key(sensor)}")


def played(
    build: toolchain.Build, jobs: list[FrameJob], name: str, lines: bool = False
) -> tuple[int, int]:
    """Play frames in the folder `name`; return the same as `gate_level`. lines: as in `play_in`.
    Raises `Mismatch`.
    """
    records, _ = play_in(build, jobs, build_root() / "gls" / name, lines=lines)
    return sum(record.checked for record in records), sum(record.cycles for record in records)


def gate_levels() -> Iterator[str]:
    """Check both netlists of a small sensor in turn; yield one line about each."""
    for target in (GATES, CELLS):
        checked, cycles = gate_level(SENSOR, target)
        yield f"{target}: {checked} words and commits in {cycles} cycles, 0 mismatches"
