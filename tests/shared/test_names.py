# SPDX-License-Identifier: Apache-2.0
"""Names that no file can have get a sentence from everything that reads or writes files."""

import numpy as np
import pytest

from coincid.model.contract.config import load_config
from coincid.model.contract.edges import load_edges
from coincid.model.contract.result import read_result
from coincid.model.scenes.ambient import ambient_klux
from coincid.model.scenes.catalogue import load_scene
from coincid.model.shared.errors import InputError
from coincid.model.shared.files import write_csv, write_npz

NAMES = {"too long": "x" * 300, "NUL": "a\0b", "a folder too long": f"{'x' * 300}/a"}
SHAPE = 8, 8
READERS = {
    "scene": lambda name: load_scene(name, *SHAPE),
    "array": lambda name: load_scene(f"{name}.npy", *SHAPE),
    "picture": lambda name: load_scene(f"{name}.png", *SHAPE),
    "archive": lambda name: load_scene(f"{name}.npz", *SHAPE),
    "ray tracer's scene": lambda name: load_scene(f"{name}.xml", *SHAPE),
    "colours": lambda name: load_scene(np.full(SHAPE, 5.0), *SHAPE, colour=f"{name}.png"),
    "klux": lambda name: ambient_klux(name, *SHAPE),
    "klux in an array": lambda name: ambient_klux(f"{name}.npy", *SHAPE),
    "klux in a picture": lambda name: ambient_klux(f"{name}.png,5", *SHAPE),
    "klux of two halves": lambda name: ambient_klux(f"1|{name}", *SHAPE),
    "configuration": load_config,
    "configuration with suffix": lambda name: load_config(f"{name}.toml"),
    "result": lambda name: read_result(f"{name}.npz"),
    "edges": lambda name: load_edges(f"{name}.npz", pixels=4, pulses=4, period_ticks=4),
    "edges as table": lambda name: load_edges(f"{name}.csv", pixels=4, pulses=4, period_ticks=4),
}
WRITERS = {
    "NPZ": lambda path: write_npz(f"{path}.npz", {"a": np.zeros(1)}),
    "CSV": lambda path: write_csv(f"{path}.csv", [[1]]),
}


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("reader", READERS)
def test_a_reader_says_what_is_wrong(reader, name):
    with pytest.raises(InputError):
        READERS[reader](NAMES[name])


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("writer", WRITERS)
def test_a_writer_says_what_is_wrong_and_leaves_nothing(writer, name, tmp_path):
    with pytest.raises(InputError):
        WRITERS[writer](tmp_path / NAMES[name])
    assert not list(tmp_path.rglob("*"))
