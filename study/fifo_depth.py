# SPDX-License-Identifier: Apache-2.0
"""Effect of the FIFO depth of a subgroup: share of the committed events that full FIFOs drop.

`python -m coincid.study.fifo_depth` prints the table of `docs/silicon.md`. It uses the golden model, 32 x 32 pixels, and
one stream with a beat per cycle. The longer the packets, the later a place becomes free again. The controller (`auto`)
shares the stream among the subgroups and first gets frames to settle.
"""

from collections.abc import Iterator

from ..model.contract.config import Config, parse_config
from ..model.contract.edges import Edges
from ..model.golden.frame import Golden
from ..model.golden.shape import COUNTER
from ..model.light.photons import generate_edges
from ..model.light.spad import Spad
from ..model.light.timing import Timing
from ..model.scenes.catalogue import load_scene
from ..model.scenes.scene import scene_light

SCENE, SEED = "five-objects", 1
DEPTHS = (2, 4, 8, 16, 32)
KLUX = (5.0, 50.0, 100.0)
SETTLING, WATCHED = 6, 4  # frames
SETTINGS = (
    ("threshold 2, map", {"threshold": 2}, "id"),
    ("threshold 3, map", {"threshold": 3}, "id"),
    ("threshold 3, map and offsets", {"threshold": 3}, "full"),
    ("controller, map", {"auto": True}, "id"),
)


def dropped_share(config: Config, edges: Edges) -> float:
    """Return the share of the committed events that full FIFOs drop, over `WATCHED` frames."""
    golden, committed, dropped = Golden(config.sensor), 0, 0
    for number in range(SETTLING + WATCHED):
        counters = golden.frame(config, edges.frame(number, config.pulses)[0]).counters
        if number >= SETTLING:
            committed += int(counters[:, COUNTER.committed].sum())
            dropped += int(counters[:, COUNTER.dropped].sum())
    return dropped / committed if committed else 0.0


def table(backgrounds: tuple[float, ...] = KLUX) -> Iterator[str]:
    """Yield the rows of a Markdown table: one for each light and setting, with one column for each depth."""
    yield f"| klux | setting | {' | '.join(f'{depth} places' for depth in DEPTHS)} |"
    yield "| ---: | --- |" + " ---: |" * len(DEPTHS)
    plain = parse_config({})
    sensor, frames = plain.sensor, SETTLING + WATCHED
    for klux in backgrounds:
        light = scene_light(load_scene(SCENE, sensor.rows, sensor.cols), klux)
        edges = generate_edges(light, Spad(), Timing.from_config(plain), pulses=plain.pulses * frames, seed=SEED)
        for name, subgroup, form in SETTINGS:
            shares = []
            for depth in DEPTHS:
                given = {"sensor": {"fifo_depth": depth}, "frame": {"format": form}, "subgroup": subgroup}
                shares.append(dropped_share(parse_config(given), edges))
            yield f"| {klux:g} | {name} | {' | '.join(f'{100 * share:.2f} %' for share in shares)} |"


if __name__ == "__main__":
    for line in table():
        print(line, flush=True)
