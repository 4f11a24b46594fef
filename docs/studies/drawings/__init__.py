# SPDX-License-Identifier: Apache-2.0
"""Programs that draw the documents' pictures into docs/images:
`python -m docs.studies.drawings.NAME`.
"""

from matplotlib import rc_context
from matplotlib.figure import Figure

from coincid.study.plot_style import HASH_SALT
from coincid.tools.pages import picture


def save(figure: Figure, name: str) -> None:
    """Write an SVG picture with its text as outlines; the same figure gives the same bytes."""
    with rc_context({"svg.hashsalt": HASH_SALT}):
        figure.savefig(picture(f"docs/images/{name}"), metadata={"Date": None})
