# SPDX-License-Identifier: Apache-2.0
"""Which of a pin's tables of energies count, by their conditions in the liberty file."""

import pytest

from coincid.flow.liberty import read_cells

# pin: (its other values, energies in fJ by condition, energy that counts)
PINS = {
    "data of a flip-flop, while its clock is low": ("D", "", {"CK": 9.0, "!CK": 2.0}, 2.0),
    "data of a latch, while it is closed": ("D", "", {"G": 9.0, "!G": 3.0}, 3.0),
    "data, without conditions": ("D", "", {"": 4.0}, 4.0),
    "clock, while the data stay": (
        "CK",
        "clock : true;",
        {"!D & !Q": 1.0, "!D & Q": 9.0, "D & !Q": 9.0, "D & Q": 3.0},
        2.0,
    ),
    "clock, without conditions": ("CK", "clock : true;", {"": 5.0}, 5.0),
    "clock of a gate, while the gate is closed": (
        "CK",
        'clock_gate_clock_pin : "true";',
        {"!E & !GCK": 1.5, "E & !GCK": 9.0},
        1.5,
    ),
    "any other pin, the mean": ("A", "", {"B": 1.0, "!B": 3.0}, 2.0),
}


@pytest.mark.parametrize("what", PINS)
def test_the_energy_of_a_pin_is_that_of_its_condition(what, tmp_path):
    name, values, energies_fj, expected_fj = PINS[what]
    powers = ""
    for when, energy_fj in energies_fj.items():
        condition = f'when : "{when}";' if when else ""
        table = f'(one) {{ values ("{energy_fj}"); }}'
        powers += f"internal_power () {{ {condition} rise_power {table} fall_power {table} }}\n"
    path = tmp_path / "toy.lib"
    path.write_text(
        f"cell (TOY) {{\n cell_leakage_power : 1;\n pin ({name}) {{ direction : input; {values}\n{powers} }}\n}}\n",
        encoding="utf-8",
    )
    pin = read_cells(path, {"TOY"})["TOY"].pins[name]
    assert pin.energies.at(1.0) == pytest.approx(expected_fj)
