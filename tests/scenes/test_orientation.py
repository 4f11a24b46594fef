# SPDX-License-Identifier: Apache-2.0
"""Absolute orientation: a letter F stands the same way in the scene, at the ports, in the words and in the picture.

A scene that is mirrored or turned together with its light is self-consistent, so only a drawing can tell. For ray-traced
scenes with a camera, see `test_raytrace.py::test_users_camera`.
"""

import numpy as np
import pytest
from PIL import Image

from coincid.lab.outcomes import Run
from coincid.lab.setup import Setup
from coincid.model.contract.spad_ports import port_bits
from coincid.model.contract.stream import decode_frame
from coincid.model.scenes.catalogue import load_scene
from coincid.model.shared.constants import SPEED_OF_LIGHT_M_S

from ..random_cases import configured

NEAR_M, FAR_M = 5.0, 8.0
LETTER = """
................
................
...#########....
...#########....
...##...........
...##...........
...##...........
...#######......
...#######......
...##...........
...##...........
...##...........
...##...........
................
................
................
"""
LETTER = np.array([list(row) for row in LETTER.split()]) == "#"
ROWS, COLS = LETTER.shape
CONFIG = configured(
    {"rows": ROWS, "cols": COLS},
    {"pulses": 60, "format": "full", "minigroup_records": True, "mg_threshold": 1},
    {"threshold": 1},
)


def built_in(folder):
    return load_scene("letter-f", ROWS, COLS)


def picture_file(folder):
    Image.fromarray((1000 * np.where(LETTER, NEAR_M, FAR_M)).astype(np.uint16)).save(folder / "f.png")
    return load_scene(str(folder / "f.png"), ROWS, COLS, reflectivity=0.4)


def array_file(folder):
    np.save(folder / "f.npy", np.where(LETTER, NEAR_M, FAR_M))
    return load_scene(str(folder / "f.npy"), ROWS, COLS, reflectivity=0.4)


def coloured_file(folder):
    """Write a depth file with the letter in the colour, not in the distance."""
    np.save(folder / "wall.npy", np.full(LETTER.shape, NEAR_M))
    Image.fromarray(np.where(LETTER, 200, 20).astype(np.uint8)).save(folder / "letter.png")
    return load_scene(f"{folder / 'wall.npy'},{folder / 'letter.png'}", ROWS, COLS)


@pytest.mark.parametrize("scene", [built_in, picture_file, array_file])
def test_letter_stands_the_same_way_from_the_scene_to_the_picture(scene, tmp_path):
    scene = scene(tmp_path)
    assert scene.truth_m == pytest.approx(np.where(LETTER, NEAR_M, FAR_M))
    run = Run(Setup(config=CONFIG, scene=scene, klux=0.0))
    config, edges, between = run.config, run.edges, round((NEAR_M + FAR_M) / SPEED_OF_LIGHT_M_S / CONFIG.tick_s)
    near = edges.tick < between

    # At the ports: subgroups of 8 x 8 in rows, and pixels in rows inside them, as in the contract.
    at = port_bits(config, edges)
    pixel = at.bit // config.sensor.phases
    row, col = at.subgroup // 2 * 8 + pixel // 8, at.subgroup % 2 * 8 + pixel % 8
    assert_drawn(row[near], col[near], LETTER)
    assert_drawn(row[~near], col[~near], ~LETTER)

    # In the words: hit maps of the events, and maps of the minigroup records.
    (beats,) = run.frame().trace.beats
    words = decode_frame(beats, config.sensor, config.sensor.subgroups)
    subgroup, stamp = words.events[:, 2], words.events[:, 6]
    hits = words.hits[:, 0][:, None] >> np.arange(64, dtype=np.uint64) & np.uint64(1)
    event, pixel = np.nonzero(hits)
    row, col = subgroup[event] // 2 * 8 + pixel // 8, subgroup[event] % 2 * 8 + pixel % 8
    early = stamp[event] < between
    assert_drawn(row[early], col[early], LETTER)
    assert_drawn(row[~early], col[~early], ~LETTER)
    record, minigroup, bit = np.nonzero(words.entries[:, :, 1][:, :, None] >> np.arange(4) & 1)
    where = words.records[record, 0]
    row = where // 2 * 8 + minigroup // 4 * 2 + bit // 2
    col = where % 2 * 8 + minigroup % 4 * 2 + bit % 2
    early = words.entries[record, minigroup, 0] * (config.sensor.phases // 4) < between
    assert_drawn(row[early], col[early], LETTER)

    # In the picture.
    assert np.mean(np.abs(run.frame().depth_m - np.where(LETTER, NEAR_M, FAR_M)) < 0.5) > 0.95


def test_letter_in_the_colour(tmp_path):
    scene = coloured_file(tmp_path)
    assert np.array_equal(scene.reflectivity[:, :, 0] > 0.2, LETTER)
    edges = Setup(config=CONFIG.with_pulses(200), scene=scene, klux=0.0).photons.edges()
    seen = np.bincount(edges.pixel, minlength=ROWS * COLS).reshape(ROWS, COLS)
    assert seen[LETTER].min() > seen[~LETTER].max()


def assert_drawn(row, col, drawing):
    """Check that most pixels of the drawing are there, and hardly any others."""
    seen = np.zeros(drawing.shape, np.int64)
    np.add.at(seen, (row, col), 1)
    assert np.mean(seen[drawing] > 0) > 0.95
    assert seen[~drawing].sum() <= 0.02 * seen.sum()
