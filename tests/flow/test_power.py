# SPDX-License-Identifier: Apache-2.0
"""Power: what a liberty file and a VCD say, and the sum of both for a few cells that one can add up
by hand.
"""

import json
from io import BytesIO
from types import SimpleNamespace

import numpy as np
import pytest
from attrs import evolve

from coincid.flow import power as power_of
from coincid.flow.liberty import Cell, Energies, Pin, read_cells, supply_v
from coincid.flow.power import (
    Design,
    Instance,
    Power,
    clock_tree_mw,
    power,
    power_at_rest,
    transitions,
)
from coincid.flow.synth import CELLS
from coincid.flow.yosys import CLOCK_BUFFER, LIBERTY, cells_folder
from coincid.model.contract.config import load_config
from coincid.tb.frame_record import FrameJob
from coincid.tools.build import ToolchainError
from docs.studies.power_against_light import group_of

from .sensors import SMALL

LIBRARY = """
library (toy) {
  nom_voltage : 1.00;
  cell (BUF) {
    cell_leakage_power : 7.5;
    pin (A) { direction : input; capacitance : 2.0; }
    pin (Z) {
      direction : output;
      internal_power () { related_pin : "A";
        rise_power(t) { index_1 ("0.01,0.03"); index_2 ("1.0,3.0"); values ("1.0,2.0", \\
          "3.0,4.0"); }
        fall_power(t) { index_1 ("0.01,0.03"); index_2 ("1.0,3.0"); values ("3.0,4.0", "5.0,6.0"); }
      }
    }
  }
  cell (OTHER) { cell_leakage_power : 1; }
}
"""

VCD = b"""\
$timescale 1ps $end
$scope module top $end
$var wire 1 ! laser $end $var wire 1 $ rst $end $var wire 2 " bus [1:0] $end
$scope module inner $end $var wire 1 # net $end $upscope $end
$upscope $end
$enddefinitions $end
#0 x! x$ b0 " 0#
#200 1! 1$
#400 0!
#600 1!
#800 0! 0$
#1000 1# b11 "
#2000 1! b1 "
#3000 0! 0#
#6000 b10 " 1! 1#
#9000 0#
"""


PER_FJ = 1e-6 * 100.0 / 10  # mW, of ten cycles at 100 MHz


def always(fj):
    """Return energies that depend on no load."""
    return Energies(np.zeros(1), np.full(1, fj))


CLOCK = Pin(False, 1.0, always(3.0), True)


def test_liberty_at_its_slew_and_load(tmp_path):
    path = tmp_path / "toy.lib"
    path.write_text(LIBRARY, encoding="utf-8")
    cell = read_cells(path, {"BUF"})["BUF"]
    assert supply_v(path) == 1.0
    assert cell.leakage_nw == 7.5
    assert cell.pins["A"] == Pin(False, 2.0, None, False)
    # mean of rise and fall, halfway between the slews
    assert cell.pins["Z"].energies.at(1.0) == pytest.approx(3.0)
    assert cell.pins["Z"].energies.at(2.0) == pytest.approx(3.5)
    assert cell.pins["Z"].energies.at(100.0) == pytest.approx(4.0)
    with pytest.raises(ValueError, match="toy.lib: no cell NAND"):
        read_cells(path, {"NAND"})


def test_numbers_with_exponents_are_the_same_numbers(tmp_path):
    path = tmp_path / "toy.lib"
    path.write_text(LIBRARY.replace('"3.0,4.0"', '"3.0e+00,40e-1"'), encoding="utf-8")
    cell = read_cells(path, {"BUF"})["BUF"]
    assert cell.pins["Z"].energies.at(1.0) == pytest.approx(3.0)
    assert cell.pins["Z"].energies.at(100.0) == pytest.approx(4.0)


def test_transitions_of_frames_only():
    """The laser's first rises are those of its random state before the reset."""
    toggles = transitions(BytesIO(VCD), 1, [3, 2], 1000)
    assert toggles["laser"].tolist() == [[2], [1]]
    assert toggles["inner.net"].tolist() == [[1], [1]]  # not what came before a frame, nor after it
    assert toggles["bus"].tolist() == [[0, 1], [1, 1]]
    with pytest.raises(ToolchainError, match="2 frames of 3"):
        transitions(BytesIO(VCD), 1, [3, 2, 2], 1000)


@pytest.mark.parametrize("lengths", [[3, 1], [1, 3], [2, 3]])
def test_frames_of_unequal_lengths_count_their_own_cycles(lengths):
    """A net changes once in each cycle, from the beginning of a frame to long after its end."""
    header, _, _ = VCD.partition(b"#0 ")
    changes = [b"#0 0! 1$ 0#", b"#500 0$"]
    for frame in range(2):
        begin = 1000 + 10_000 * frame
        changes.append(b"#%d 1! 1#" % begin)
        changes += [b"#%d %d#" % (begin + 1000 * k, (k + 1) % 2) for k in range(1, 8)]
        changes.append(b"#%d 0!" % (begin + 7500))
    toggles = transitions(BytesIO(header + b"\n".join(changes) + b"\n"), 1, lengths, 1000)
    assert toggles["inner.net"][:, 0].tolist() == lengths


@pytest.mark.parametrize("pulses", [1, 2, 3])
def test_a_frame_begins_with_the_first_of_its_pulses(pulses):
    """A net changes in the cycle of that pulse only."""
    header, _, _ = VCD.partition(b"#0 ")
    changes = [b"#0 0! 1$ 0#", b"#500 0$"]
    for frame in range(2):
        for pulse in range(pulses):
            begin = 1000 + 10_000 * frame + 2000 * pulse
            net = b" %d#" % (1 - frame) if pulse == 0 else b""
            changes += [b"#%d 1!%s" % (begin, net), b"#%d 0!" % (begin + 1000)]
    vcd = BytesIO(header + b"\n".join(changes) + b"\n")
    toggles = transitions(vcd, pulses, [2 * pulses] * 2, 1000)
    assert toggles["inner.net"].tolist() == [[1], [1]]
    assert toggles["laser"].tolist() == [[2 * pulses]] * 2


def test_changes_at_the_end_of_a_simulation_count():
    """The simulation ends in the last cycle of its last frame, with no later time in its file."""
    header, _, _ = VCD.partition(b"#0 ")
    changes = b"#0 0! 1$ 0#\n#500 0$\n#1000 1!\n#2000 0! 1#\n"
    toggles = transitions(BytesIO(header + changes), 1, [2], 1000)
    assert toggles["inner.net"].tolist() == [[1]]


def test_sum_by_hand():
    """clk clocks a flip-flop, whose output drives a buffer that drives nothing."""
    output = Pin(True, 0.0, always(1.0), False)
    library = {
        "DFF": Cell(1000.0, {"CK": CLOCK, "Q": output, "QN": output}),
        "BUF": Cell(0.0, {"A": Pin(False, 4.0, None, False), "Z": output}),
    }
    instances = [Instance("a", "DFF", {"CK": 2, "Q": 3}), Instance("a.b", "BUF", {"A": 3, "Z": 4})]
    names = {2: [("clk", 0)], 3: [("q", 0), ("a.q", 0)], 4: [("a.z", 1)]}
    design = Design(["", "a", "a.b"], instances, names, library, 2.0)
    toggles = {"clk": np.array([[20]]), "a.q": np.array([[5]]), "a.z": np.array([[0, 5]])}
    of = power(design, toggles, 0, 10, 100.0)
    assert of["a"].clock == pytest.approx(PER_FJ * (20 * 3.0 + 20 * 2.0 * 1.0))
    assert of["a"].internal == pytest.approx(PER_FJ * (5 * 1.0 + 5 * 1.0))  # Q, and QN with it
    assert of["a"].switching == pytest.approx(PER_FJ * 5 * 2.0 * 4.0)
    assert of["a"].leakage == pytest.approx(1e-3)
    assert of["a"].idle == pytest.approx(of["a"].clock / 2)
    assert of["a.b"].total == pytest.approx(PER_FJ * 5 * 1.0)
    frames = {name: np.stack([7 * of_frame[0], of_frame[0]]) for name, of_frame in toggles.items()}
    assert power(design, frames, 1, 10, 100.0) == of
    assert power(design, frames, 0, 10, 100.0)["a"].clock == pytest.approx(7 * of["a"].clock)
    assert power(design, toggles, 0, 20, 100.0)["a"].clock == pytest.approx(of["a"].clock / 2)
    wired = power(design, toggles, 0, 10, 100.0, wire_ff=4.0)
    assert wired["a"].switching == pytest.approx(2 * of["a"].switching)
    assert wired["a"].clock - of["a"].clock == pytest.approx(PER_FJ * 20 * 2.0 * 4.0)
    with pytest.raises(ToolchainError, match="does not show a.z"):
        power(design, {"clk": toggles["clk"], "q": toggles["a.q"]}, 0, 10, 100.0)


@pytest.mark.parametrize("order", [("CK", "D", "Q"), ("Q", "D", "CK"), ("D", "Q", "CK")])
def test_an_output_without_a_net_changes_as_the_other_output(order):
    """Not as another pin of its cell, in whatever order a netlist has them."""
    output = Pin(True, 0.0, always(1.0), False)
    library = {
        "DFF": Cell(
            0.0, {"CK": CLOCK, "D": Pin(False, 0.0, None, False), "Q": output, "QN": output}
        )
    }
    nets = {"CK": 2, "D": 3, "Q": 4}
    instances = [Instance("", "DFF", {pin: nets[pin] for pin in order})]
    names = {2: [("clk", 0)], 3: [("d", 0)], 4: [("q", 0)]}
    toggles = {"clk": np.array([[20]]), "d": np.array([[9]]), "q": np.array([[5]])}
    of = power(Design([""], instances, names, library, 2.0), toggles, 0, 10, 100.0)
    assert of[""].internal == pytest.approx(PER_FJ * 2 * 5 * 1.0)


def test_a_gated_flip_flop_by_hand():
    """clk clocks a gate, which clocks a flip-flop in two of ten cycles; the flip-flop changes in
    one of them.
    """
    library = {
        "GATE": Cell(
            0.0,
            {"CK": Pin(False, 4.0, always(2.0), True), "GCK": Pin(True, 0.0, always(5.0), True)},
        ),
        "DFF": Cell(0.0, {"CK": CLOCK, "Q": Pin(True, 0.0, None, False)}),
    }
    instances = [
        Instance("gate", "GATE", {"CK": 2, "GCK": 3}),
        Instance("flop", "DFF", {"CK": 3, "Q": 4}),
    ]
    names = {2: [("clk", 0)], 3: [("gated", 0)], 4: [("q", 0)]}
    toggles = {"clk": np.array([[20]]), "gated": np.array([[4]]), "q": np.array([[1]])}
    of = power(Design([""], instances, names, library, 2.0), toggles, 0, 10, 100.0)
    assert (
        of["gate"].total
        == of["gate"].clock
        == pytest.approx(PER_FJ * (16 * 2.0 + 4 * 5.0 + 20 * 2.0 * 4.0))
    )
    assert of["flop"].total == of["flop"].clock == pytest.approx(PER_FJ * (4 * 3.0 + 4 * 2.0 * 1.0))
    assert of["flop"].idle == pytest.approx(of["flop"].clock / 2)
    assert of["gate"].idle == 0


def test_a_latch_that_changes_more_often_than_its_clock_has_no_idle_power():
    """An open latch passes all changes of its data; the idle part is not below 0."""
    latch = Cell(0.0, {"G": CLOCK, "Q": Pin(True, 0.0, None, False)})
    names = {2: [("clk", 0)], 3: [("q", 0)]}
    design = Design([""], [Instance("", "DLH", {"G": 2, "Q": 3})], names, {"DLH": latch}, 2.0)
    toggles = {"clk": np.array([[20]]), "q": np.array([[13]])}
    of = power(design, toggles, 0, 10, 100.0)[""]
    assert of.clock > 0 == of.idle


def test_at_rest_only_the_clock_moves():
    """Twice in a cycle: not the nets behind a closed gate, nor data. Leakage stays."""
    library = {
        "GATE": Cell(
            500.0,
            {"CK": Pin(False, 4.0, always(2.0), True), "GCK": Pin(True, 0.0, always(5.0), True)},
        ),
        "DFF": Cell(300.0, {"CK": CLOCK, "Q": Pin(True, 0.0, always(7.0), False)}),
    }
    instances = [
        Instance("gate", "GATE", {"CK": 2, "GCK": 3}),
        Instance("gated", "DFF", {"CK": 3, "Q": 4}),
        Instance("free", "DFF", {"CK": 2, "Q": 5}),
    ]
    names = {4: [("q", 0)], 3: [("gated", 0)], 2: [("root", 0), ("clk", 0)], 5: [("clk", 1)]}
    of = power_at_rest(Design([""], instances, names, library, 3.0), 100.0, wire_ff=0.5)
    fj_mhz = 1e-6 * 100.0  # mW, of one cycle at 100 MHz
    assert of["gate"].clock == pytest.approx(fj_mhz * 2 * (2.0 + 4.5 * 4.5))
    assert of["free"].clock == of["free"].idle == pytest.approx(fj_mhz * 2 * (3.0 + 4.5 * 1.5))
    assert of["gated"] == Power(leakage=pytest.approx(300e-6))
    assert of["gate"].total - of["gate"].clock == pytest.approx(500e-6)


def test_powers_add_part_by_part():
    """The idle part belongs to the clock's, so it does not count twice."""
    added = Power(1.0, 2.0, 4.0, 8.0, 0.5) + Power(16.0, 32.0, 64.0, 128.0, 0.25)
    assert added == Power(17.0, 34.0, 68.0, 136.0, 0.75)
    assert added.total == 255.0


def test_a_clock_tree_by_hand():
    """Two buffers drive ten flip-flops each; a wire goes to each pin."""
    buffer = {"A": Pin(False, 4.0, None, False), "Z": Pin(True, 0.0, always(7.0), False)}
    library = {"DFF": Cell(0.0, {"CK": CLOCK}), CLOCK_BUFFER: Cell(0.0, buffer)}
    instances = [Instance("a" if k < 15 else "b", "DFF", {"CK": 2}) for k in range(20)]
    of = Design(["", "a", "b"], instances, {2: [("clk", 0)]}, library, 2.0)
    tree = clock_tree_mw(of, {"clk": np.array([[20]])}, 0, 10, 100.0, wire_ff=0.5)
    assert tree["a"] == pytest.approx(3 * tree["b"])
    assert sum(tree.values()) == pytest.approx(
        PER_FJ * 20 * (22 * 2.0 * 0.5 + 2 * (7.0 + 2.0 * 4.0))
    )


def test_a_clock_tree_reaches_the_inputs_of_a_gated_clock_and_not_its_gate():
    """The gate is one pin of the tree in front of it, and drives the tree behind it."""
    gate = {"CK": Pin(False, 4.0, None, True), "GCK": Pin(True, 0.0, None, True)}
    buffer = {"A": Pin(False, 4.0, None, False), "Z": Pin(True, 0.0, always(7.0), False)}
    library = {"GATE": Cell(0.0, gate), "DFF": Cell(0.0, {"CK": CLOCK})}
    library[CLOCK_BUFFER] = Cell(0.0, buffer)
    instances = [Instance("gate", "GATE", {"CK": 2, "GCK": 3})]
    instances += [Instance("a", "DFF", {"CK": 3}) for _ in range(4)]
    of = Design(["", "a", "gate"], instances, {2: [("clk", 0)], 3: [("gated", 0)]}, library, 2.0)
    toggles = {"clk": np.array([[20]]), "gated": np.array([[6]])}
    tree = clock_tree_mw(of, toggles, 0, 10, 100.0, wire_ff=0.5)
    wire_fj = 2.0 * 0.5
    assert tree == {
        "gate": pytest.approx(PER_FJ * 20 * wire_fj),
        "a": pytest.approx(PER_FJ * 6 * 4 * wire_fj),
    }


def test_a_buffer_of_a_clock_tree_drives_its_own_loads():
    """Its energy is that at an equal share of the pins and wires behind it."""
    energies = Energies(np.array([0.0, 1000.0]), np.array([7.0, 2007.0]))  # and 2 fJ per fF
    buffer = {"A": Pin(False, 4.0, None, False), "Z": Pin(True, 0.0, energies, False)}
    library = {"DFF": Cell(0.0, {"CK": CLOCK}), CLOCK_BUFFER: Cell(0.0, buffer)}
    instances = [Instance("a", "DFF", {"CK": 2}) for _ in range(20)]
    of = Design(["", "a"], instances, {2: [("clk", 0)]}, library, 2.0)
    tree = clock_tree_mw(of, {"clk": np.array([[20]])}, 0, 10, 100.0, wire_ff=0.5)
    of_one_ff = 10 * (1.0 + 0.5)
    fj = 22 * 2.0 * 0.5 + 2 * (7.0 + 2.0 * of_one_ff + 2.0 * 4.0)
    assert tree == {"a": pytest.approx(PER_FJ * 20 * fj)}


@pytest.mark.parametrize(
    ("sinks", "wires", "buffers"),
    [(1, 1, 0), (16, 16, 0), (17, 19, 2), (256, 272, 16), (257, 276, 19)],
)
def test_a_clock_tree_has_as_many_levels_as_it_needs(sinks, wires, buffers):
    """A buffer, like the clock itself, drives up to 16 loads, so 257 need two levels. The power is
    that of the transitions of a frame.
    """
    buffer = {"A": Pin(False, 4.0, None, False), "Z": Pin(True, 0.0, always(7.0), False)}
    library = {"DFF": Cell(0.0, {"CK": CLOCK}), CLOCK_BUFFER: Cell(0.0, buffer)}
    instances = [Instance("a", "DFF", {"CK": 2}) for _ in range(sinks)]
    of = Design(["", "a"], instances, {2: [("clk", 0)]}, library, 2.0)
    for frame, moves in enumerate((20, 60, 10)):
        toggles = {"clk": np.array([[20], [60], [10]])}
        tree = clock_tree_mw(of, toggles, frame, 10, 100.0, wire_ff=0.5)
        fj = wires * 2.0 * 0.5 + buffers * (7.0 + 2.0 * 4.0)
        assert tree == {"a": pytest.approx(PER_FJ * moves * fj)}


def test_blocks_of_the_table():
    rows = {"tree.minigroup_3.stamp": "minigroups (16)", "fifo.storage": "FIFO"}
    assert {name: group_of(f"module_0.subgroup_0.{name}") for name in rows} == rows
    assert group_of("module_0.subgroup_0") == "ports' registers"
    assert group_of("module_0.tdc") is group_of("readout_0") is None


class Synthesized:
    """A made-up netlist, whose folder holds what `synthesize` leaves there."""

    def __init__(self, folder):
        self.folder = folder


def flattened(cells, nets):
    """Return a flattened module as Yosys writes it. cells: name -> type and nets of its pins."""
    made = {name: {"type": kind, "connections": pins} for name, (kind, pins) in cells.items()}
    named = {name: {"bits": bits} for name, bits in nets.items()}
    return {"modules": {power_of.TOP: {"cells": made, "netnames": named}}}


@pytest.fixture
def netlist(monkeypatch, tmp_path):
    """Yosys answers with a made-up flat netlist: a buffer in `a.b`, a scope without cells, a pin
    at a constant and one that is open.
    """
    cells = {
        "a.b.first": ("BUF", {"A": [2], "Z": [3]}),
        "second": ("BUF", {"A": ["1"], "Z": []}),
        "a.c": ("$scopeinfo", {}),
    }
    flat = flattened(cells, {"clk": [2], "a.b.in": [2], "bus": ["0", 3]})
    sensor, made = tmp_path / "sensor", tmp_path / "flat"
    for folder in (sensor, made):
        folder.mkdir()
    library = LIBRARY.replace("(OTHER)", f"({CLOCK_BUFFER})")
    for path in (sensor / LIBERTY, made / LIBERTY):
        path.write_text(library, encoding="utf-8")
    (sensor / "netlist.v").write_text("module m;", encoding="utf-8")
    (made / power_of.FLAT).write_text(json.dumps(flat), encoding="utf-8")
    got = []
    monkeypatch.setattr(power_of, "synthesize", lambda sensor_, target: Synthesized(sensor))
    monkeypatch.setattr(power_of, "yosys_once", lambda *given: got.append(given) or made)
    return got


def test_a_netlist_is_read_with_its_scopes_its_pins_and_all_names_of_its_nets(netlist):
    of = power_of.design(SMALL)
    assert of.scopes == ["", "a.b", "a.c"]
    assert of.instances == [
        Instance("a.b", "BUF", {"A": 2, "Z": 3}),
        Instance("", "BUF", {}),
    ]
    assert of.names == {2: [("clk", 0), ("a.b.in", 0)], 3: [("bus", 1)]}
    assert of.library.keys() == {"BUF", CLOCK_BUFFER} and of.supply_v == 1.0
    (_, files, script) = netlist[0]
    assert files == {LIBERTY: files[LIBERTY], "netlist.v": "module m;"}
    assert script[:2] == (f"read_liberty -lib {LIBERTY}", "read_verilog netlist.v")
    assert script[-2:] == ("flatten", f"write_json {power_of.FLAT}")


def test_frames_are_played_with_every_scope_dumped_and_counted_by_their_cycles(
    netlist, monkeypatch, tmp_path
):
    """Each frame has its own number of cycles; the time of a cycle is that of the clock."""
    compiled, counted = [], []
    config = load_config().with_sensor(rows=8, cols=8).with_frame(period=100, pulses=3)
    longer = config.with_frame(gap=7)

    def play_in(build, frames, out):
        out.mkdir(parents=True)
        (out / f"{power_of.TOP}.vcd").write_bytes(b"dump")

    def transitions(vcd, pulses, cycles, cycle_ps):
        counted.append((vcd.read(), pulses, cycles, cycle_ps))
        return {}

    monkeypatch.setattr(power_of, "build_root", lambda: tmp_path / "build")
    monkeypatch.setattr(power_of, "netlist_build", lambda *given: compiled.append(given))
    monkeypatch.setattr(power_of, "play_in", play_in)
    monkeypatch.setattr(power_of, "transitions", transitions)
    frames = [SimpleNamespace(config=one) for one in (config, longer)]
    assert power_of.count_toggles(config.sensor, frames) == {}
    scopes = [power_of.TOP, f"{power_of.TOP}.a.b", f"{power_of.TOP}.a.c"]
    assert compiled == [(config.sensor, CELLS, scopes)]
    cycle_ps = round(1e6 / config.clock_mhz)
    assert counted == [(b"dump", 3, [300, 314], cycle_ps)]


def test_transitions_are_counted_in_all_blocks_over_the_cycles_of_the_clock(
    netlist, monkeypatch, tmp_path
):
    """The clock's cycle is 2.5 ns, and the frame ends with the last cycle of its last period."""
    config = evolve(load_config("silicon"), sensor=SMALL)
    config = config.with_frame(clock_mhz=400.0, period=60, pulses=1, frames=1)
    dumped = []

    def build(sensor, target, scopes):
        dumped.append((target, list(scopes)))

    def play(build, frames, out):
        out.mkdir(parents=True)
        end_ps = 5000 + config.frame_cycles * 2500
        lines = [
            f"$scope module {power_of.TOP} $end $var wire 1 ! laser $end $var wire 1 $ rst $end",
            "$var wire 1 # net $end $upscope $end $enddefinitions $end",
            "#0 0! 1$ 0#",
            "#2500 0$",
            "#5000 1! 1#",
            "#7500 0! 0#",
            f"#{end_ps - 1} 1#",
            f"#{end_ps} 0#",
        ]
        (out / f"{power_of.TOP}.vcd").write_text("\n".join([*lines, ""]), encoding="utf-8")

    monkeypatch.setattr(power_of, "netlist_build", build)
    monkeypatch.setattr(power_of, "play_in", play)
    monkeypatch.setattr(power_of, "build_root", lambda: tmp_path / "root")
    toggles = power_of.count_toggles(SMALL, [FrameJob(config, None)])
    assert dumped == [(CELLS, [power_of.TOP, f"{power_of.TOP}.a.b", f"{power_of.TOP}.a.c"])]
    assert {name: int(counts.sum()) for name, counts in toggles.items()} == {
        "laser": 2,
        "rst": 0,
        "net": 3,
    }
    assert all(isinstance(counts, np.ndarray) for counts in toggles.values())


@pytest.mark.needs("cells")
def test_cells_of_the_library():
    """Energies that stand in the file. A flip-flop's clock pin: of data at rest, between its
    tables' second and third slew.

    A clock gate's clock pin: closed, its own; open, those of its output."""
    cells = read_cells(cells_folder() / LIBERTY, {"DFF_X1", "CLKGATE_X1"})
    flop, gate = cells["DFF_X1"], cells["CLKGATE_X1"].pins
    assert flop.pins["CK"].clock and gate["CK"].clock and gate["GCK"].clock and not gate["E"].clock
    assert flop.pins["CK"].energies.at(0) == pytest.approx(
        (2.434 + 4.495 + 2.623 + 4.264) / 4, abs=0.01
    )
    assert flop.leakage_nw == pytest.approx(79.11, abs=0.01)
    assert gate["CK"].energies.at(0) == pytest.approx((3.615 + 1.301) / 2, abs=0.01)
    assert gate["GCK"].energies.at(0) > gate["CK"].energies.at(0)
