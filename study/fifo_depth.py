# SPDX-License-Identifier: Apache-2.0
"""Effect of the FIFO depth of a subgroup: share of the committed events that full FIFOs drop.

`python -m coincid.study.fifo_depth` prints the table of `docs/silicon.md`. It uses the golden model, 32 x 32 pixels, and
one stream with a beat per cycle. The longer the packets, the later a place becomes free again. The controller (`auto`)
shares the stream among the subgroups and first gets frames to settle.
"""

from collections.abc import Iterator

from ..lab.outcomes import Kept, Run
from ..lab.setup import SETTLING, Setup
from .markdown import table

SCENE, SEED = "five-objects", 1
DEPTHS = (2, 4, 8, 16, 32)
KLUX = (5.0, 50.0, 100.0)
HEAD = "klux", "setting", *(f"{depth} places" for depth in DEPTHS)
WATCHED = 4  # frames, after the controller has settled
SETTINGS = (
    ("threshold 2, map", {"threshold": 2}, "id"),
    ("threshold 3, map", {"threshold": 3}, "id"),
    ("threshold 3, map and offsets", {"threshold": 3}, "full"),
    ("controller, map", {"auto": True}, "id"),
)


def dropped_share(run: Run) -> float:
    """Return the share of the committed events that full FIFOs drop, over `WATCHED` frames."""
    dropped, committed = (
        sum(int(frame.counter(name).sum()) for frame in map(run.frame, range(-WATCHED, 0)))
        for name in ("dropped", "committed")
    )
    return dropped / committed if committed else 0.0


def rows(backgrounds: tuple[float, ...] = KLUX) -> Iterator[tuple[str, ...]]:
    """Yield the rows of the table: one for each light and setting, with one column for each depth."""
    for klux in backgrounds:
        kept = Kept()
        for name, subgroup, form in SETTINGS:
            frame = {"format": form, "frames": SETTLING + WATCHED}
            setups = [
                Setup.of(SCENE, sensor={"fifo_depth": depth}, frame=frame, subgroup=subgroup, klux=klux, seed=SEED)
                for depth in DEPTHS
            ]
            shares = [dropped_share(Run(setup, kept=kept)) for setup in setups]
            yield f"{klux:g}", name, *(f"{100 * share:.2f} %" for share in shares)


if __name__ == "__main__":
    print("\n".join(table(HEAD, rows(), left=(1,))))
