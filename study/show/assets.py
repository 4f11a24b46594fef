# SPDX-License-Identifier: Apache-2.0
"""Style and scripts of the pages, read once."""

from pathlib import Path

SHOW = Path(__file__).parent
FILES = {
    name: (SHOW / name).read_text(encoding="utf-8")
    for name in ("page.css", "tables.js", "report.js")
}
