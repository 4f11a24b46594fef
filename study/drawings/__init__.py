# SPDX-License-Identifier: Apache-2.0
"""Programs that draw the documents' pictures into docs/images: `python -m coincid.study.drawings.NAME`."""

from pathlib import Path

from matplotlib import rc_context
from matplotlib.figure import Figure

from ...model.shared.errors import InputError
from ...model.shared.folders import checkout
from ..plot_style import HASH_SALT


def image(name: str) -> Path:
    """Return the path of a picture of the documents. Raises `InputError` if the project is not run from a checkout."""
    folder = checkout()
    if folder is None:
        raise InputError("docs/images: the pictures of the documents can only be drawn in a checkout of the project")
    return folder / "docs" / "images" / name


def save(figure: Figure, name: str) -> None:
    """Write an SVG picture with its text as outlines; the same figure gives the same bytes."""
    with rc_context({"svg.hashsalt": HASH_SALT}):
        figure.savefig(image(name), metadata={"Date": None})
