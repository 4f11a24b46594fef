# SPDX-License-Identifier: Apache-2.0
"""Animations of the depth of a scene that moves: truth and depth of each frame, on one scale."""

import io
from collections.abc import Sequence

import numpy as np
from PIL import Image

from ..lab.outcomes import Frame
from ..model.shared.errors import InputError
from ..model.shared.files import FilePath, check_path, whole_file
from .pictures import Panel, draw_row
from .plot_style import figure_bytes

FRAME_MS = 250  # for which a frame is shown
FORMATS = {".gif": "GIF", ".png": "PNG"}  # an animated PNG


def check_animation(path: FilePath) -> str:
    """Return the format of an animation by its suffix. Raises `InputError`."""
    suffix = check_path(path).suffix.lower()
    if suffix not in FORMATS:
        raise InputError(f"{path}: must end with {' or '.join(FORMATS)}", field="path")
    return FORMATS[suffix]


def write_animation(path: FilePath, frames: Sequence[Frame], heading: str = "") -> None:
    """Write truth and depth of `frames` as an animation, GIF or animated PNG. Raises
    `InputError`.
    """
    kind = check_animation(path)
    truth_m = np.stack([frame.truth_m for frame in frames])
    span_m = float(np.nanmin(truth_m)), float(np.nanmax(truth_m))
    pictures = []
    for frame in frames:
        title = f"depth, frame {frame.number}"
        panel = Panel(title, frame.depth_m, frame.first.reason)
        figure, _ = draw_row([panel], frame.truth_m, heading, span_m=span_m)
        pictures.append(Image.open(io.BytesIO(figure_bytes(figure, "png"))).convert("RGB"))
    size = pictures[0].size  # legends differ, and their height
    same = [one if one.size == size else one.resize(size) for one in pictures]
    with whole_file(path) as file:
        same[0].save(file, kind, save_all=True, append_images=same[1:], duration=FRAME_MS, loop=0)
