# SPDX-License-Identifier: Apache-2.0
"""Which of a pin's tables of energies count, by their conditions in the liberty file."""

import pytest

from coincid.flow.liberty import cell_areas, read_cells, supply_v

# pin: (its other values, energies in fJ by condition, energy that counts)
PINS = {
    "data of a flip-flop, while its clock is low": ("D", "", {"CK": 9.0, "!CK": 2.0}, 2.0),
    "data of a latch, while it is closed": ("D", "", {"G": 9.0, "!G": 3.0}, 3.0),
    "data, without conditions": ("D", "", {"": 4.0}, 4.0),
    "data, with and without a condition": ("D", "", {"CK": 9.0, "": 4.0}, 4.0),
    "clock, while the data stay": (
        "CK",
        "clock : true;",
        {"!D & !Q": 1.0, "!D & Q": 9.0, "D & !Q": 9.0, "D & Q": 3.0},
        2.0,
    ),
    "clock, without conditions": ("CK", "clock : true;", {"": 5.0}, 5.0),
    "clock, with and without a condition": ("CK", "clock : true;", {"!D & Q": 9.0, "": 5.0}, 5.0),
    "clock of a gate, while the gate is closed": (
        "CK",
        'clock_gate_clock_pin : "true";',
        {"!E & !GCK": 1.5, "E & !GCK": 9.0},
        1.5,
    ),
    "clock of a latch, while the data stay": ("G", "", {"!D & Q": 9.0, "D & Q": 3.0}, 3.0),
    "the same of one that is open while it is low": ("GN", "", {"!D & Q": 9.0, "D & Q": 3.0}, 3.0),
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


def of_tables(path, *tables):
    """Return the energies of a pin with these tables of a rise."""
    powers = "".join(f"internal_power () {{ rise_power (one) {{ {text} }} }}\n" for text in tables)
    path.write_text(
        f"cell (TOY) {{\n cell_leakage_power : 1;\n pin (Z) {{ direction : output;\n{powers} }}\n}}\n",
        encoding="utf-8",
    )
    return read_cells(path, {"TOY"})["TOY"].pins["Z"].energies


def test_an_edge_that_does_not_occur_has_no_part_in_the_mean(tmp_path):
    path = tmp_path / "toy.lib"
    assert of_tables(path, 'values ("0.0");', 'values ("3.0");').at(1.0) == 3.0
    assert of_tables(path, 'values ("0.0");') is None
    with_loads = 'index_1 ("0.0"); index_2 ("1.0,2.0"); values ("0.0,4.0");'
    assert of_tables(path, with_loads, 'values ("3.0");').fj.tolist() == [1.5, 3.5]


def test_the_mean_of_tables_with_different_loads(tmp_path):
    """A table with one load holds for all. Rows are slews, columns loads."""
    rows = 'index_1 ("0.0,0.08"); index_2 ("1.0,2.0,4.0"); values ("1,2,4", "9,14,32");'
    path = tmp_path / "toy.lib"
    found = of_tables(path, rows, 'values ("7.0");')
    assert of_tables(path, 'values ("7.0");', rows).fj.tolist() == found.fj.tolist()
    assert found.loads_ff.tolist() == [1.0, 2.0, 4.0]
    # a quarter of the way between the slews, before the mean with 7
    assert found.fj == pytest.approx([(3 + 7) / 2, (5 + 7) / 2, (11 + 7) / 2])
    assert found.at(3.0) == pytest.approx(7.5)


def test_a_name_is_the_same_with_quotes(tmp_path):
    """Of cells, pins and tables, as other writers of such files have them."""
    path = tmp_path / "toy.lib"
    table = '("one") { values ( "2.0" ); }'
    path.write_text(
        "cell (TOY) {\n cell_leakage_power : 4.5;\n"
        f' pin ( "Z" ) {{ direction : "output"; internal_power () {{ rise_power {table} }} }}\n'
        ' pin ("A") { direction : input; capacitance : "1.5"; }\n}\n',
        encoding="utf-8",
    )
    cell = read_cells(path, {"TOY"})["TOY"]
    assert cell.leakage_nw == 4.5
    assert set(cell.pins) == {"Z", "A"}
    assert (cell.pins["Z"].output, cell.pins["A"].output) == (True, False)
    assert cell.pins["Z"].energies.at(1.0) == 2.0
    assert cell.pins["A"].capacitance_ff == 1.5


def test_areas_of_all_cells():
    text = """\
  cell (ONE) {
    drive : 2; scaled_area : 7.5;
    area : 1.25;
    pin (A) { capacitance : 9.5; }
  }
  cell (TWO) {
    area : 3.5;
  }
"""
    assert cell_areas(text) == {"ONE": 1.25, "TWO": 3.5}


def test_the_supply_of_a_library(tmp_path):
    path = tmp_path / "toy.lib"
    path.write_text("nom_process : 1.5;\nnom_voltage : 0.95;\n", encoding="utf-8")
    assert supply_v(path) == 0.95
    path.write_text("", encoding="utf-8")
    with pytest.raises(ValueError, match="toy.lib: no nom_voltage"):
        supply_v(path)
