# SPDX-License-Identifier: Apache-2.0
"""Emulators in which every pair of what can be built comes up, and digests of their blocks beside
the sensor: link, buffer, registers and photon sources.

`python -m tests.board.circuit_pairs` writes the digests again; a change that means to change a
circuit says so in CHANGELOG.md.
"""

from pathlib import Path

from coincid.board.parameters import Emulator
from coincid.board.rtl.top import EmulatorTop

from ..digests import write_digests
from ..feature_pairs import BUILT, Case, Features, covering_cases, impossible_of, sensor_of
from ..hdl.circuit_pairs import digests_of_blocks
from ..random_cases import built_sensor

DIGESTS = Path(__file__).with_suffix(".json")
SIZES = {"sizes": BUILT["sizes"], "counts": BUILT["counts"], "held": BUILT["held"]}
FEATURES: Features = SIZES | {
    "serial": (True, False),
    "buffer_beats": (64, 8192),
    "clocks_per_bit": (4, 33),
}
CASES = covering_cases(FEATURES, impossible_of(FEATURES))
USUAL = {name: values[0] for name, values in BUILT.items()}
ROOM = Emulator.__module__.rpartition(".")[0]


def digests_of(case: Case) -> dict[str, str]:
    """Return the digests of all blocks of an emulator that are of this room, by name."""
    sensor = built_sensor(sensor_of(USUAL | {name: case[name] for name in SIZES}))
    emulator = Emulator(
        sensor=sensor,
        buffer_beats=case["buffer_beats"],
        clocks_per_bit=case["clocks_per_bit"],
    )
    return digests_of_blocks(EmulatorTop(emulator, case["serial"]), ROOM)


if __name__ == "__main__":
    write_digests(DIGESTS, [digests_of(case) for case in CASES])
