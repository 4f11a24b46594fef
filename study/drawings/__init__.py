# SPDX-License-Identifier: Apache-2.0
"""Programs that draw the documents' pictures into docs/images: `python -m coincid.study.drawings.NAME`."""

from pathlib import Path

from ...model.shared.errors import InputError
from ...model.shared.folders import checkout


def image(name: str) -> Path:
    """Return the path of the picture called `name`. Raises `InputError` if the project runs without its checkout."""
    folder = checkout()
    if folder is None:
        raise InputError("docs/images: the pictures of the documents can only be drawn in a checkout of the project")
    return folder / "docs" / "images" / name
