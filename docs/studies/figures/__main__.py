# SPDX-License-Identifier: Apache-2.0
"""Draws figures with their data (CSV) and a page:
`python -m docs.studies.figures PAGE [--rtl] [--out DIR]`.
"""

import argparse
import sys
from pathlib import Path

from rich.console import Console

from coincid.model.shared.errors import InputError
from coincid.study.progress import Bar

from .command import COMPARISON, PAGES, write

ENGINE = "sliced"  # plays some frames on the RTL


def main() -> int:
    parser = argparse.ArgumentParser(description="Draw figures with their data (CSV) and a page.")
    parser.add_argument("page", choices=PAGES, metavar="PAGE", help=f"one of {', '.join(PAGES)}")
    parser.add_argument(
        "--rtl", action="store_true", help="play some frames of figures and modes on the RTL, too"
    )
    parser.add_argument(
        "--out", type=Path, metavar="DIR", help="folder of the figures; default: build/PAGE"
    )
    given = parser.parse_args()
    page = PAGES[given.page]
    engine = ENGINE if given.rtl else None
    if engine and page.families(engine) is COMPARISON:
        parser.error(f"--rtl: no frame of {given.page} is played on the RTL")
    out = given.out or Path("build") / given.page
    try:
        out.mkdir(parents=True, exist_ok=True)
        with Bar(Console(stderr=True, highlight=False)) as bar:
            bar.stage("frames", 0)
            files = write(page, out, engine, bar.done)
    except (InputError, OSError) as error:
        print(f"figures: {error}", file=sys.stderr)
        return 2
    print(files[-1])
    return 0


if __name__ == "__main__":
    sys.exit(main())
