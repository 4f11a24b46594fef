# SPDX-License-Identifier: Apache-2.0
"""The browser that draws the explorer for its picture and its tests: a Chromium of the system."""

import shutil

# The first one has no windows, and draws a page with two thirds of the time.
PROGRAMS = ("chromium-headless-shell", "chromium")
FLAGS = (
    "--no-sandbox",
    "--disable-gpu",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
)


def chromium() -> str | None:
    """Return the path of the first of the programs that is installed, or None."""
    return next(filter(None, map(shutil.which, PROGRAMS)), None)
