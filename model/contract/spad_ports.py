# SPDX-License-Identifier: Apache-2.0
"""SPAD ports of the polyphase view: the cycle, the subgroup's port and the bit of an edge."""

from typing import NamedTuple

import numpy as np

from .config import Config
from .edges import Edges
from .pixels import pixel_table


class PortBits(NamedTuple):
    """Places of edges, int64[n] each: cycle of the frame, subgroup whose port it is, and bit in the word of the port."""

    cycle: np.ndarray
    subgroup: np.ndarray
    bit: np.ndarray


def port_bits(config: Config, edges: Edges) -> PortBits:
    """Return the places of a frame's edges, in the order of `edges`; bit i * phases + k is phase k of pixel i."""
    table = pixel_table(config.sensor)
    cycle_in_period, phase = np.divmod(edges.tick, config.sensor.phases)
    return PortBits(
        cycle=config.start_cycles()[edges.pulse] + cycle_in_period,
        subgroup=table.subgroup[edges.pixel],
        bit=table.inside[edges.pixel] * config.sensor.phases + phase,
    )
