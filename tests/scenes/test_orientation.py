# SPDX-License-Identifier: Apache-2.0
"""Absolute orientation: a letter F stands the same way in the scene, at the ports, in the words and
in the picture.

A scene that is mirrored or turned together with its light is self-consistent, so only a drawing can
tell. For ray-traced scenes with a camera, see `test_raytrace.py::test_users_camera`.
"""

import numpy as np
import pytest
from PIL import Image

from coincid.lab.outcomes import Run
from coincid.lab.setup import Setup
from coincid.model.contract.pixels import port_bits
from coincid.model.contract.stream import decode_frame
from coincid.model.scenes.catalogue import load_scene
from coincid.model.shared.constants import SPEED_OF_LIGHT_M_S

from ..random_cases import configured

NEAR_M, FAR_M = 5.0, 8.0
LETTER = """
........................
........................
....##############......
....##############......
....####................
....####................
....####................
....###########.........
....###########.........
....####................
....####................
....####................
....####................
........................
........................
........................
"""
LETTER = np.array([list(row) for row in LETTER.split()]) == "#"
ROWS, COLS = LETTER.shape
FRAME = {"pulses": 60, "format": "full", "minigroup_records": True, "mg_threshold": 1}
SMALL, LARGE = (  # neither pixels, nor minigroups, nor subgroups are square
    configured({"rows": ROWS, "cols": COLS} | sizes, FRAME, {"threshold": 1})
    for sizes in (
        {"subgroup": [4, 6], "minigroup": [2, 3]},
        {"subgroup": [16, 12], "minigroup": [4, 2], "streams": 2},
    )
)


def built_in(folder):
    return load_scene("letter-f", ROWS, COLS)


def picture_file(folder):
    Image.fromarray((1000 * np.where(LETTER, NEAR_M, FAR_M)).astype(np.uint16)).save(
        folder / "f.png"
    )
    return load_scene(str(folder / "f.png"), ROWS, COLS, reflectivity=0.4)


def array_file(folder):
    np.save(folder / "f.npy", np.where(LETTER, NEAR_M, FAR_M))
    return load_scene(str(folder / "f.npy"), ROWS, COLS, reflectivity=0.4)


def coloured_file(folder):
    """Write a depth file with the letter in the colour, not in the distance."""
    np.save(folder / "wall.npy", np.full(LETTER.shape, NEAR_M))
    Image.fromarray(np.where(LETTER, 200, 20).astype(np.uint8)).save(folder / "letter.png")
    return load_scene(f"{folder / 'wall.npy'},{folder / 'letter.png'}", ROWS, COLS)


@pytest.mark.parametrize(
    ("scene", "config"),
    [(built_in, SMALL), (built_in, LARGE), (picture_file, SMALL), (array_file, SMALL)],
)
def test_letter_stands_the_same_way_from_the_scene_to_the_picture(scene, config, tmp_path):
    scene, sensor = scene(tmp_path), config.sensor
    assert scene.truth_m == pytest.approx(np.where(LETTER, NEAR_M, FAR_M))
    run = Run(Setup(config=config, scene=scene, klux=0.0))
    between = round((NEAR_M + FAR_M) / SPEED_OF_LIGHT_M_S / config.tick_s)
    (rows, cols), (mg_rows, mg_cols) = sensor.subgroup, sensor.minigroup

    def assert_placed(subgroup, row, col, near, far_too=True):
        """Check the places in their subgroups, which lie in rows, as in the contract."""
        row, col = subgroup // (COLS // cols) * rows + row, subgroup % (COLS // cols) * cols + col
        assert_drawn(row[near], col[near], LETTER)
        if far_too:
            assert_drawn(row[~near], col[~near], ~LETTER)

    # At the ports.
    _, subgroup, bit = port_bits(config, run.edges)
    assert_placed(subgroup, *np.divmod(bit // sensor.phases, cols), run.edges.tick < between)

    # In the words: hit maps of the events, and maps of the minigroup records.
    of_streams = [
        decode_frame(beats, sensor, len(sensor.stream_subgroups(k)))
        for k, beats in enumerate(run.frame().trace.beats)
    ]
    events, hits, records, entries = (
        np.concatenate([getattr(words, name) for words in of_streams])
        for name in ("events", "hits", "records", "entries")
    )
    pixels = np.arange(sensor.pixels)
    event, pixel = np.nonzero(
        hits[:, pixels // 64] >> (pixels % 64).astype(np.uint64) & np.uint64(1)
    )
    assert_placed(events[event, 2], *np.divmod(pixel, cols), events[event, 6] < between)
    record, minigroup, bit = np.nonzero(
        entries[:, :, 1][:, :, None] >> np.arange(mg_rows * mg_cols) & 1
    )
    mg_row, mg_col = np.divmod(minigroup, cols // mg_cols)
    row, col = mg_row * mg_rows + bit // mg_cols, mg_col * mg_cols + bit % mg_cols
    stamp = entries[record, minigroup, 0] * (sensor.phases // 4)
    # a minigroup sees both at the border
    assert_placed(records[record, 0], row, col, stamp < between, far_too=False)

    # In the picture.
    assert np.mean(np.abs(run.frame().depth_m - np.where(LETTER, NEAR_M, FAR_M)) < 0.5) > 0.95


def test_letter_in_the_colour(tmp_path):
    scene = coloured_file(tmp_path)
    assert np.array_equal(scene.reflectivity[:, :, 0] > 0.2, LETTER)
    edges = Setup(config=SMALL.with_pulses(200), scene=scene, klux=0.0).photons.edges()
    seen = np.bincount(edges.pixel, minlength=ROWS * COLS).reshape(ROWS, COLS)
    assert seen[LETTER].min() > seen[~LETTER].max()


def assert_drawn(row, col, drawing):
    """Check that most pixels of the drawing are there, and hardly any others."""
    seen = np.zeros(drawing.shape, np.int64)
    np.add.at(seen, (row, col), 1)
    assert np.mean(seen[drawing] > 0) > 0.95
    assert seen[~drawing].sum() <= 0.02 * seen.sum()
