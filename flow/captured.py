# SPDX-License-Identifier: Apache-2.0
"""Captured streams with their decoded rows, with which a decoder can be tested without a simulator.

The streams come from the golden model, with which the RTL agrees word by word. There is one
frame for each format, and the settings vary.
"""

import io

import numpy as np

from ..model.contract.counts import GATES
from ..model.contract.packet import built_formats
from ..model.contract.parameters import Sensor
from ..model.contract.pixels import pixel_table
from ..model.contract.result import EVENT_FIELDS, ResultBuilder
from ..model.golden.frame import Golden
from .gls import random_frames

FOLDER = "captured"
MAP_DIGITS = 16  # hexadecimal digits of a beat of the map


def captured_files(sensor: Sensor) -> dict[str, bytes]:
    """Return the files by name: for each format the beats (text), the events or counts (CSV), and
    the whole result (NPZ).
    """
    files: dict[str, bytes] = {}
    golden, formats = Golden(sensor), built_formats(sensor)
    for number, (name, job) in enumerate(
        zip(formats, random_frames(sensor, len(formats)), strict=True)
    ):
        config = job.config.with_settings(threshold=1)  # so that there are events
        assert config.format == name
        trace, result = golden.frame(config, job.edges, job.ready), ResultBuilder(config)
        result.add(trace.beats)
        arrays = result.arrays()
        beats = [
            f"{stream} {beat:016x} {int(k == len(of_stream) - 1)}"
            for stream, of_stream in enumerate(trace.beats)
            for k, beat in enumerate(of_stream)
        ]
        npz = io.BytesIO()
        np.savez_compressed(npz, **arrays)  # type: ignore[arg-type]  # no array is called allow_pickle
        files |= {
            f"{FOLDER}/{number}_{name}.txt": _lines(["stream beat last", *beats]),
            f"{FOLDER}/{number}_{name}.csv": _lines(
                _rows_of_counts(arrays, sensor) if config.counting else _rows(arrays)
            ),
            f"{FOLDER}/{number}_{name}.npz": npz.getvalue(),
        }
    return files


def _rows(arrays: dict[str, np.ndarray]) -> list[str]:
    """Return one line per event. The map is in hexadecimal, with the highest pixel first."""
    names = [name for name in (*EVENT_FIELDS, "hits", "mg_offset") if name in arrays]
    rows = [",".join(names)]
    for i in range(len(arrays["subgroup"])):
        cells = []
        for name in names:
            value = arrays[name][i]
            if name == "hits":
                cells.append("".join(f"{int(part):0{MAP_DIGITS}x}" for part in value[::-1]))
            elif name == "mg_offset":
                cells.append(" ".join(map(str, value)))
            else:
                cells.append(str(int(value)))
        rows.append(",".join(cells))
    return rows


def _rows_of_counts(arrays: dict[str, np.ndarray], sensor: Sensor) -> list[str]:
    """Return one line per pixel, in the order of the minigroups."""
    table = pixel_table(sensor)
    columns = ["subgroup", "pixel", "count_pulses"]
    for gate in range(GATES):
        columns += [f"gate_cycle_{gate}", f"gate_hits_{gate}"]
    rows = [",".join(columns)]
    for s in range(sensor.subgroups):
        for i in np.lexsort((table.bit, table.minigroup)).tolist():
            cells = [s, i, arrays["count_pulses"][0, s, i]]
            for gate in range(GATES):
                hits = arrays["gate_hits"][0, s, i, gate]
                cells += [arrays["gate_cycle"][0, s, table.minigroup[i], gate]]
                cells += [" ".join(map(str, hits))]
            rows.append(",".join(map(str, cells)))
    return rows


def _lines(lines: list[str]) -> bytes:
    return "".join(f"{line}\n" for line in lines).encode()
