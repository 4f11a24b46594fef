# SPDX-License-Identifier: Apache-2.0
"""Programs that draw the documents' pictures: `python -m coincid.study.drawings.NAME`. They write into docs/images of the checkout."""

from pathlib import Path

from ...model.shared.errors import InputError
from ...model.shared.folders import checkout


def image(name: str) -> Path:
    """Where the picture called `name` stands. Raises `InputError` where the project runs without its checkout."""
    folder = checkout()
    if folder is None:
        raise InputError("docs/images: pictures of the documents are drawn in a checkout of the project")
    return folder / "docs" / "images" / name
