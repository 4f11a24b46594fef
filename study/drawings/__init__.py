# SPDX-License-Identifier: Apache-2.0
"""Programs that draw the documents' pictures into docs/images: `python -m coincid.study.drawings.NAME`."""

from matplotlib import rc_context
from matplotlib.figure import Figure

from ...tools.pages import picture
from ..plot_style import HASH_SALT


def save(figure: Figure, name: str) -> None:
    """Write an SVG picture with its text as outlines; the same figure gives the same bytes."""
    with rc_context({"svg.hashsalt": HASH_SALT}):
        figure.savefig(picture(f"docs/images/{name}"), metadata={"Date": None})
