# SPDX-License-Identifier: Apache-2.0
"""Sensors in which every pair of what can be built comes up, and digests of the blocks of each.

Frames show what a block does; they hardly show a register without a reset, a clock that runs for
too long, or a block that another sensor would need. Digests do.

`python -m tests.hdl.circuit_pairs` writes the digests again; a change that means to change a circuit
says so in CHANGELOG.md.
"""

import hashlib
from pathlib import Path
from typing import Any
from unittest.mock import patch

from amaranth.hdl._nir import Netlist

from coincid.hdl.export import _garbage_left, _text, elaborated
from coincid.hdl.front_end_views import POLYPHASE, VIEWS, Asynchronous, View
from coincid.hdl.sensor import SensorTop
from coincid.hdl.silicon.circuit import Circuit
from coincid.hdl.unit import Unit

from ..digests import write_digests
from ..feature_pairs import BUILT, Features, covering_cases, impossible_of, sensor_of
from ..random_cases import built_sensor

DIGESTS = Path(__file__).with_suffix(".json")
OF_VIEWS: dict[str, View] = {
    "polyphase": POLYPHASE,
    "async": VIEWS["async"],
    "delay line": Asynchronous(Circuit(delay_line=True, gain_ppm=2000, banks=2)),
}
FEATURES: Features = BUILT | {"view": tuple(OF_VIEWS)}
UNCOUNTED = [name for name, view in OF_VIEWS.items() if not view.has_quarters]
CASES = covering_cases(FEATURES, impossible_of(FEATURES, UNCOUNTED))
# All that is counted is one more than a power of two: 9 subgroups of 5 minigroups, ... A register
# that is a bit too narrow is too narrow here.
ABOVE = dict(
    rows=6,
    cols=30,
    subgroup=[2, 10],
    minigroup=[2, 2],
    phases=8,
    window_max=33,
    rearm=5,
    fifo_depth=5,
    offset_phases=4,
    streams=3,
    counts=1,
)


TOPS = [*((sensor_of(case), OF_VIEWS[case["view"]]) for case in CASES), (ABOVE, POLYPHASE)]


def digests_of(sensor: dict[str, Any], view: View) -> dict[str, str]:
    """Return the digests of all blocks of a sensor, by name."""
    return digests_of_blocks(SensorTop(built_sensor(sensor), view))


def digests_of_blocks(top: Unit, room: str = "") -> dict[str, str]:
    """Return the digests of a unit and of all that it instantiates, by name. room: of a room only,
    by the name of its package.
    """
    # A loop without a register would change the digest, too. The search for loops takes half of the
    # time; every export has it.
    with _garbage_left(), patch.object(Netlist, "check_comb_cycles"):
        texts = {
            block.unit.unit_name: _text(block)
            for block in elaborated([top], lambda unit: type(unit).__module__.startswith(room))
        }
    return {name: hashlib.sha256(texts[name].encode()).hexdigest()[:12] for name in sorted(texts)}


if __name__ == "__main__":
    write_digests(DIGESTS, [digests_of(*top) for top in TOPS])
