"""Edges as the words that stand at the sensor's ports."""

import numpy as np

from ..model.config import Config
from ..model.edges import Edges
from ..model.golden import pixel_table


def port_words(config: Config, edges: Edges) -> dict[int, list[tuple[int, int]]]:
    """Cycle of the frame -> [(subgroup, word)] of the subgroups with an edge in it; bit i * phases + k is phase k of pixel i."""
    phases = config.sensor.phases
    table = pixel_table(config.sensor)
    cycle = edges.pulse * config.period + edges.tick // phases
    subgroup = table.subgroup[edges.pixel]
    bit = table.inside[edges.pixel] * phases + edges.tick % phases
    order = np.lexsort((subgroup, cycle))
    words: dict[int, list[tuple[int, int]]] = {}
    last = None
    for c, s, b in zip(cycle[order].tolist(), subgroup[order].tolist(), bit[order].tolist()):
        at = words.setdefault(c, [])
        if last == (c, s):
            at[-1] = (s, at[-1][1] | 1 << b)
        else:
            at.append((s, 1 << b))
        last = c, s
    return words
