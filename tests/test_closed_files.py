# SPDX-License-Identifier: Apache-2.0
"""Every file that the library opens is closed by it. Python would close it, too, but warns of it,
and a user's tests may take warnings for errors.
"""

import gc
import os
import warnings

import numpy as np
import pytest
from PIL import Image

import coincid
from coincid.model.recorded.exchange import SUFFIXES, read_recording, write_edges
from coincid.model.scenes.catalogue import load_scene
from coincid.model.shared.spool import Spool
from coincid.tools.build import execute

SMALL = {"rows": 8, "cols": 8, "pulses": 5}


def pictures_of_several_pages(folder):
    pages = [Image.fromarray(np.full((8, 8), 3000 + k, np.uint16)) for k in range(3)]
    # without a suffix, so that the content tells that it is a picture
    pages[0].save(folder / "pages", "TIFF", save_all=True, append_images=pages[1:])
    return load_scene(str(folder / "pages"), 8, 8)


def a_picture_of_the_sun(folder):
    grey = [Image.new("L", (8, 8), 9 + k) for k in range(2)]
    grey[0].save(folder / "sun.tif", save_all=True, append_images=grey[1:])
    return coincid.simulate(None, "flat:5", klux=f"{folder / 'sun.tif'},100", **SMALL)


def arrays_of_an_archive(folder):
    np.savez(folder / "one.npz", depth=np.full((8, 8), 3.0))
    return load_scene(str(folder / "one.npz"), 8, 8)


def results_with_all_their_files(folder):
    run = coincid.simulate(None, "flat:5", **SMALL)
    run.depth().save(folder / "depth.npz")
    run.timeline(0, 3).save(folder / "period.html")
    return run


def recordings_of_each_kind(folder):
    run = coincid.simulate(None, "flat:5", **SMALL)
    timing = coincid.Timing.from_config(run.config)
    for suffix in SUFFIXES:
        write_edges(folder / f"edges{suffix}", run.edges, timing)
        read_recording(folder / f"edges{suffix}")


def arrays_that_do_not_fit_into_memory(folder):
    Spool().put(np.arange(3))


def a_program_whose_output_is_shown(folder):
    shown = []
    execute(["echo", "done"], folder, folder / "log", os.environ, shown.append)
    assert shown == ["done\n"]


@pytest.mark.parametrize(
    "opens",
    [
        pictures_of_several_pages,
        a_picture_of_the_sun,
        arrays_of_an_archive,
        results_with_all_their_files,
        recordings_of_each_kind,
        arrays_that_do_not_fit_into_memory,
        a_program_whose_output_is_shown,
    ],
)
def test_no_file_is_left_to_python_to_close(opens, tmp_path):
    gc.collect()  # what earlier tests have left is not told here
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always", ResourceWarning)
        opens(tmp_path)
        gc.collect()
    assert [str(one.message) for one in told if one.category is ResourceWarning] == []
