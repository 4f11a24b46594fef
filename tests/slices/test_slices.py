# SPDX-License-Identifier: Apache-2.0
"""Slices of designs that are not ours, against Amaranth's simulator, in every lane and for every
kind of word.
"""

import platform
import random
from pathlib import Path
from types import SimpleNamespace
from typing import NamedTuple

import numpy as np
import pytest
from amaranth.back import rtlil
from amaranth.hdl import Elaboratable, Module, Signal, Value
from amaranth.lib.crc.catalog import CRC16_CCITT
from amaranth.lib.fifo import SyncFIFO, SyncFIFOBuffered
from amaranth.sim import Simulator
from pywellen import Waveform

from coincid.hdl.to_verilog import to_verilog
from coincid.model.shared.errors import InputError
from coincid.slices.emit import DarkInput
from coincid.slices.library import HERE, LANES, PLAIN, PROCESSOR, library, widest
from coincid.slices.netlist import NetlistError
from coincid.slices.slices import Slices
from coincid.slices.synthesis import Design
from coincid.slices.waves import write_vcd

CYCLES = 150
# made for the widths of its ports
pytestmark = pytest.mark.filterwarnings("ignore::amaranth.hdl.UnusedElaboratable")
# Words of SIMD registers, of older ones, and of none.
PROCESSORS = [PROCESSOR] + (
    ["-march=x86-64-v3", "-march=x86-64"] if platform.machine() == "x86_64" else []
)


class Counters(Elaboratable):
    """Registers with and without enable and reset, of both initial values; a wide one that loads
    rarely.
    """

    def __init__(self):
        self.enable, self.clear, self.value = Signal(), Signal(), Signal(24)
        self.kept, self.sum, self.odd = Signal(24, init=0x5A5A5A), Signal(8, init=255), Signal()

    def elaborate(self, platform):
        m = Module()
        m.d.comb += self.odd.eq(self.sum[0] ^ self.value[0])
        with m.If(self.clear):
            m.d.sync += self.kept.eq(0xF0F0F0)
        with m.Elif(self.enable & (self.value[:4] == 3)):
            m.d.sync += self.kept.eq(self.kept + self.value)
        m.d.sync += self.sum.eq(self.sum + self.kept[:8] + 1)
        return m


class Stops(Elaboratable):
    """Registers whose enable is one of them: they stop together, and none of them a cycle early."""

    def __init__(self):
        self.stop, self.step, self.count, self.run = Signal(), Signal(4), Signal(40), Signal(init=1)

    def elaborate(self, platform):
        m = Module()
        with m.If(self.run):
            m.d.sync += [
                self.count.eq(self.count + self.step),
                self.run.eq(~(self.stop & (self.step == 5))),
            ]
        return m


class Rows:
    """The ports of four equal counters with a dark input and a common one, in a module each: a unit
    that repeats.
    """

    def __init__(self):
        self.edges, self.shared, self.out = Signal(32), Signal(3), Signal(20)

    @staticmethod
    def expected(given, lane):
        """Return the output in every cycle, by hand."""
        values, out, seen = [9] * 4, 0, []
        for cycle in given:
            seen.append({"out": out})
            edges, shared = cycle["edges"][lane], cycle["shared"][lane]
            of_rows = [edges >> 8 * k & 0xFF for k in range(4)]
            first = [max(0, (row & -row).bit_length() - 1) for row in of_rows]
            before = [shared, *(value & 7 for value in values)]
            out = sum((values[k] ^ first[k] + before[k]) << 5 * k for k in range(4))
            values = [
                value + f + shared & 31 if row else value
                for value, f, row in zip(values, first, of_rows, strict=True)
            ]
        return seen


DESIGNS = {
    "fifo": (  # of 64 words, so that a sample is whole words
        lambda: SyncFIFO(width=6, depth=6),
        ["w_data", "w_en", "r_en"],
        ["w_rdy", "r_data", "r_rdy", "level"],
    ),
    "buffered": (
        lambda: SyncFIFOBuffered(width=9, depth=10),
        ["w_data", "w_en", "r_en"],
        ["w_rdy", "r_data", "r_rdy", "level"],
    ),
    "crc": (lambda: CRC16_CCITT(8).create(), ["start", "data", "valid"], ["crc", "match_detected"]),
    "counters": (Counters, ["enable", "clear", "value"], ["kept", "sum", "odd"]),
    "stops": (Stops, ["stop", "step"], ["count", "run"]),
    "rows": (Rows, ["edges", "shared"], ["out"]),
}


def signals(design, names):
    return {name: Value.cast(getattr(design, name)) for name in names}


ROWS = """
module row(input clk, input rst, input [7:0] edges, input [2:0] shared, before, output reg [4:0] value, output [4:0] logic_);
  wire [2:0] first = edges[0] ? 0 : edges[1] ? 1 : edges[2] ? 2 : edges[3] ? 3 : edges[4] ? 4 : edges[5] ? 5 : edges[6] ? 6 : edges[7] ? 7 : 0;
  initial value = 9;
  assign logic_ = first + before;
  always @(posedge clk) if (rst) value <= 9; else if (|edges) value <= value + first + shared;
endmodule

module rows(input clk, input rst, input [31:0] edges, input [2:0] shared, output reg [19:0] out);
  wire [19:0] value, logic_;
  initial out = 0;
  row row_0(.clk(clk), .rst(rst), .edges(edges[7:0]), .shared(shared), .before(shared), .value(value[4:0]), .logic_(logic_[4:0]));
  row row_1(.clk(clk), .rst(rst), .edges(edges[15:8]), .shared(shared), .before(value[2:0]), .value(value[9:5]), .logic_(logic_[9:5]));
  row row_2(.clk(clk), .rst(rst), .edges(edges[23:16]), .shared(shared), .before(value[7:5]), .value(value[14:10]), .logic_(logic_[14:10]));
  row row_3(.clk(clk), .rst(rst), .edges(edges[31:24]), .shared(shared), .before(value[12:10]), .value(value[19:15]), .logic_(logic_[19:15]));
  always @(posedge clk) if (rst) out <= 0; else out <= value ^ logic_;
endmodule
"""


def sliced(name: str) -> Design:
    make, inputs, outputs = DESIGNS[name]
    if name == "rows":
        return Design(name, {"rows.v": ROWS}, name, ["row"], [DarkInput("row", "edges", 4)])
    design = make()
    ports = {port: (value, None) for port, value in signals(design, inputs + outputs).items()}
    text = rtlil.convert(design, name=name, ports=ports)
    return Design(name, {f"{name}.v": to_verilog({name: text})[name]}, name)


def stimulus(name: str, lanes: int, seed: int) -> list[dict[str, list[int]]]:
    """Return for every cycle the inputs of every lane."""
    make, inputs, _ = DESIGNS[name]
    rng = random.Random(seed)
    design = make()
    widths = {port: len(value) for port, value in signals(design, inputs).items()}

    def one(width: int) -> int:
        return rng.getrandbits(width) if rng.random() < 0.6 else 0

    return [
        {port: [one(width) for _ in range(lanes)] for port, width in widths.items()}
        for _ in range(CYCLES)
    ]


def expected(name: str, given: list[dict[str, list[int]]], lane: int) -> list[dict[str, int]]:
    """Return the outputs of a lane in every cycle, by Amaranth's simulator where the design is in
    Amaranth.
    """
    make, inputs, outputs = DESIGNS[name]
    if make is Rows:
        return Rows.expected(given, lane)
    design, seen = make(), []
    simulator = Simulator(design)
    simulator.add_clock(1e-6)
    to, of = signals(design, inputs), signals(design, outputs)

    async def bench(ctx):
        for cycle in given:
            for port, value in to.items():
                ctx.set(value, cycle[port][lane])
            await ctx.delay(1e-9)
            seen.append({port: ctx.get(value) for port, value in of.items()})
            await ctx.tick()

    simulator.add_testbench(bench)
    simulator.run()
    return seen


def play(
    slices: Slices, name: str, given: list[dict[str, list[int]]]
) -> list[dict[str, list[int]]]:
    seen = []
    for cycle in given:
        for port, values in cycle.items():
            slices.set(port, values)
        slices.step(0)
        seen.append({port: slices.get(port) for port in DESIGNS[name][2]})
        slices.step()
    return seen


@pytest.mark.parametrize("name", DESIGNS)
def test_every_lane_is_a_design_of_its_own(name):
    given = stimulus(name, 64, 1)
    with Slices(sliced(name), 64) as slices:
        seen = play(slices, name, given)
    for lane in (0, 1, 31, 62, 63):
        assert [
            {port: values[lane] for port, values in cycle.items()} for cycle in seen
        ] == expected(name, given, lane)


@pytest.mark.parametrize("bit", range(8))
def test_a_single_bit_of_a_single_lane_is_light(bit):
    """Also if the other bits of its field are dark in all lanes."""
    lane = 5
    one = [1 << bit if k == lane else 0 for k in range(64)]
    given = [
        {"edges": [value << 8 * row for value in one], "shared": [3] * 64} for row in (0, 3, 1, 1)
    ]
    given.append({"edges": [0] * 64, "shared": [0] * 64})
    with Slices(sliced("rows"), 64) as slices:
        seen = play(slices, "rows", given)
    for k in (0, lane):
        found = [{port: values[k] for port, values in cycle.items()} for cycle in seen]
        assert found == Rows.expected(given, k)


@pytest.mark.parametrize("flag", PROCESSORS)
@pytest.mark.parametrize("lanes", LANES)
def test_any_word_on_any_processor_gives_the_same_bits(lanes, flag):
    """Lane k of a wider word has the stimuli of lane k % 64."""
    name = "counters"
    given = stimulus(name, 64, 2)
    with Slices(design := sliced(name), 64) as slices:
        plain = play(slices, name, given)
    wide = [{port: values * (lanes // 64) for port, values in cycle.items()} for cycle in given]
    with Slices(design, lanes, flag) as slices:
        assert play(slices, name, wide) == [
            {p: v * (lanes // 64) for p, v in cycle.items()} for cycle in plain
        ]


def test_registers_can_be_read_and_written():
    with Slices(sliced("counters")) as slices:
        assert slices.peek("kept") == [0x5A5A5A] * 64
        written = [0x123400 + lane for lane in range(64)]  # no two bytes of a number are alike
        slices.poke("kept", written)
        assert slices.peek("kept") == written
        slices.set("value", 1)
        slices.step()
        assert slices.peek("sum") == [lane for lane in range(64)]  # 255 + kept's lowest byte + 1
        # logic that nothing keeps
        assert slices.peek("odd") == [lane % 2 ^ 1 for lane in range(64)]
        with pytest.raises(KeyError):
            slices.poke("no such register", 0)


def test_numbers_and_names_that_do_not_fit_are_refused():
    """Bits that a port does not have would vanish."""
    with Slices(sliced("counters")) as slices:
        for act, name, bits in ((slices.set, "enable", 1), (slices.poke, "kept", 24)):
            most = (1 << bits) - 1
            for wrong in (most + 1, -1, 2.5):
                with pytest.raises(InputError, match=f"{name} = .*0 to {most}"):
                    act(name, wrong)
            for number in (63, 65):
                with pytest.raises(InputError, match=f"{name}: has {number} numbers"):
                    act(name, [0] * number)
            act(name, np.full(64, most))
        for act in (slices.get, lambda port: slices.set(port, 0)):
            with pytest.raises(InputError, match="port = 'nothing'"):
                act("nothing")
        for lane in (-1, 64):
            with pytest.raises(InputError, match=f"lane = {lane}: must be an integer from 0 to 63"):
                slices.record(lane)
    with pytest.raises(InputError, match="lanes = 100: must be one of 64, 128"):
        Slices(sliced("counters"), 100)


def test_registers_with_a_reset_value_and_no_first_one_are_reset_in_all_lanes():
    value = 0xA5A5_5A5A_F00F_0FF0
    text = f"""module resets(input clk, input rst, input [63:0] d, output reg [63:0] q);
      always @(posedge clk) if (rst) q <= 64'h{value:x}; else q <= d ^ (q << 1);
    endmodule
    """
    with Slices(Design("resets", {"resets.v": text}, "resets")) as slices:
        some = [lane % 2 for lane in range(64)]
        for resets in (some, [1] * 64):
            slices.set("rst", resets)
            slices.set("d", 7)
            slices.step()
            after = slices.peek("q")
            assert {after[lane] for lane in range(64) if resets[lane]} == {value}


def test_waveform_of_a_lane_is_what_amaranth_shows(tmp_path):
    """All signals by name, registers and logic, cycle by cycle."""
    name, lane = "fifo", 5
    given = stimulus(name, 64, 3)
    times = {"first_cycle": 7, "cycle_ps": 10}
    with Slices(sliced(name)) as slices:
        rows = []
        for cycle in given:
            for port, values in cycle.items():
                slices.set(port, values)
            rows.append(slices.record(lane)[0])
        write_vcd(tmp_path / "wave.vcd", slices.probe, {"lane": np.array(rows)}, **times)
    wave = {
        variable.full_name: variable.signal
        for variable in Waveform(str(tmp_path / "wave.vcd")).all_vars()
    }
    for port in (*DESIGNS[name][1], *DESIGNS[name][2]):
        shown = [int(wave[f"lane.{port}"].value_at(10 * (7 + cycle))) for cycle in range(CYCLES)]
        wanted = [cycle[port][lane] for cycle in given] if port in DESIGNS[name][1] else None
        assert shown == (wanted or [cycle[port] for cycle in expected(name, given, lane)]), port


SEVERAL_WRITES = """
module several(input clk, input [2:0] at_0, at_1, at_2, shown, input [3:0] data_0, data_1, data_2,
               input write_0, write_1, write_2, output [3:0] row);
  reg [3:0] rows [0:7];
  always @(posedge clk) begin
    if (write_0) rows[at_0] <= data_0;
    if (write_1) rows[at_1] <= data_1;
    if (write_2) rows[at_2] <= data_2;
  end
  assign row = rows[shown];
endmodule
"""
WRITES = range(3)


def test_of_several_writes_to_a_row_the_last_one_stays():
    widths = {"shown": 3}
    for k in WRITES:
        widths |= {f"at_{k}": 3, f"data_{k}": 4, f"write_{k}": 1}
    rng = random.Random(2)
    rows = [[0] * 8 for _ in range(64)]
    with Slices(Design("several", {"several.v": SEVERAL_WRITES}, "several"), 64) as slices:
        for _ in range(CYCLES):
            given = {port: [rng.getrandbits(width) for _ in rows] for port, width in widths.items()}
            for port, values in given.items():
                slices.set(port, values)
            slices.step(0)
            assert slices.get("row") == [
                of[at] for of, at in zip(rows, given["shown"], strict=True)
            ]
            slices.step()
            for lane, of in enumerate(rows):
                for k in WRITES:
                    if given[f"write_{k}"][lane]:
                        of[given[f"at_{k}"][lane]] = given[f"data_{k}"][lane]


def test_what_slices_cannot_play_is_said():
    two = "module two(input clk, input other, input d, output reg q); always @(posedge other) q <= d; endmodule\n"
    with pytest.raises(NetlistError, match="a clock other than its port clk"):
        Design("two", {"two.v": two}, "two")
    loop = "module loop(input clk, input d, output q); assign q = ~(q & d); endmodule\n"
    with pytest.raises(NetlistError, match="a loop of logic without a register"):
        Design("loop", {"loop.v": loop}, "loop")
    inout = "module inner(input clk, input a, output b, output c); reg r; always @(posedge clk) r <= a; assign b = r ^ a; assign c = r; endmodule\n"
    through = inout + (
        "module through(input clk, input d, output q); wire x; inner i(.clk(clk), .a(x & d), .b(x), .c(q)); endmodule\n"
    )
    with pytest.raises(NetlistError, match="an output leads to an input without a register"):
        Design("through", {"through.v": through}, "through", ["inner"])
    turn = (
        inout.replace("inner", "other")
        + inout
        + (
            "module turn(input clk, input d, output reg q); wire x, y, z;"
            " inner i(.clk(clk), .a(z ^ d), .b(x)); other o(.clk(clk), .a(x), .b(z), .c(y));"
            " always @(posedge clk) q <= y; endmodule\n"
        )
    )
    with pytest.raises(NetlistError, match="an output leads to an input without a register"):
        Design("turn", {"turn.v": turn}, "turn", ["inner", "other"])


UNIT = "module {}(input clk, input [1:0] a, input d, output q);{} endmodule\n"
KEEPS_ROWS = (
    "reg [3:0] row; reg rows [0:3]; always @(posedge clk) rows[a] <= d; assign q = rows[a];"
)
HAS_UNITS = "inner one(.clk(clk), .a(a), .d(d), .q(q));"
REGISTER = "reg r; always @(posedge clk) r <= d ^ a[0]; assign q = r ^ a[1];"


@pytest.mark.parametrize(
    ("outer", "inner"), [(HAS_UNITS, KEEPS_ROWS), (KEEPS_ROWS, REGISTER), (HAS_UNITS, REGISTER)]
)
def test_a_unit_has_neither_rows_nor_units_of_its_own(outer, inner):
    text = UNIT.format("inner", inner) + UNIT.format("outer", outer)
    text += UNIT.format("whole", "outer one(.clk(clk), .a(a), .d(d), .q(q));")
    told = "^outer: a unit with a memory of rows, or with units of its own$"
    with pytest.raises(NetlistError, match=told):
        Design("whole", {"whole.v": text}, "whole", ["outer", "inner"])


class _Folder(NamedTuple):
    """A design as `library` sees it."""

    folder: Path


def test_no_library_is_taken_for_another(monkeypatch, tmp_path):
    """Everything from which one is compiled is in the name of its folder."""
    monkeypatch.setattr("coincid.slices.library.compile_once", lambda directory, make: directory)
    program = tmp_path / "plain.cpp"
    program.write_text("// as the usual one", encoding="utf-8")
    usual = {
        "design": _Folder(tmp_path / "a"),
        "lanes": 64,
        "program": PLAIN,
        "header": "",
        "include": (),
        "objects": (),
        "flag": PROCESSOR,
    }
    others = {
        "design": _Folder(tmp_path / "b"),
        "lanes": 128,
        "program": program,
        "header": "#define WIRES 1",
        "include": (tmp_path,),
        "objects": (tmp_path / "own.o",),
    }
    if platform.machine() == "x86_64":
        others["flag"] = "-march=x86-64"
    found = [library(**usual), *(library(**usual | {name: others[name]}) for name in others)]
    for changed in ("lanes.h", "word.h"):
        own = tmp_path / f"with another {changed}"
        own.mkdir()
        for header in ("lanes.h", "word.h"):
            text = (HERE / header).read_text(encoding="utf-8")
            (own / header).write_text(text + "//" * (header == changed), encoding="utf-8")
        monkeypatch.setattr("coincid.slices.library.HERE", own)
        found.append(library(**usual))
    monkeypatch.setattr("coincid.slices.library.COMPILER", ("-O3",))
    found.append(library(**usual))
    assert len(set(found)) == len(found)


@pytest.mark.parametrize(
    ("macros", "bits"),
    [
        ("#define __SSE2__ 1\n", 128),
        ("#define __AVX__ 1\n#define __AVX2__ 1\n", 256),
        ("#define __AVX2__ 1\n#define __AVX512F__ 1\n", 256),
        ("#define __AVX2__ 1\n#define __AVX512VL__ 1\n", 512),
    ],
)
def test_the_longest_word_is_that_of_the_processor(macros, bits, monkeypatch):
    """And one that slices can have."""
    asked = []

    def run(command, **_):
        asked.append(command)
        return SimpleNamespace(stdout=macros)

    monkeypatch.setattr("coincid.slices.library.subprocess", SimpleNamespace(run=run))
    flag = f"-march={bits}-of-{len(macros)}"  # one that has not been asked for before
    assert widest(flag) == widest(flag) == bits and bits in LANES
    assert asked == [["g++", flag, "-dM", "-E", "-x", "c++", "/dev/null"]]


def test_edges_that_are_recorded_together_are_those_one_after_the_other():
    """A sample is the lane's state before an edge."""
    name, lane, edges = "fifo", 9, 5
    (cycle,) = stimulus(name, 64, 3)[:1]
    with Slices(sliced(name)) as one, Slices(sliced(name)) as other:
        for slices in (one, other):
            for port, values in cycle.items():
                slices.set(port, values)
        together = one.record(lane, edges)
        assert one.words.shape[0] == 64 and together.shape == (edges, 1)
        assert np.array_equal(together, np.concatenate([other.record(lane) for _ in range(edges)]))
        assert np.array_equal(one.words, other.words)


def test_a_library_is_compiled_from_all_that_it_is_made_of(monkeypatch, tmp_path):
    """The slice and its program for the same word and the same processor."""
    commands, texts = [], {}

    def compile_once(directory, make):
        make(tmp_path, commands.append)
        texts.update({path.name: path.read_text(encoding="utf-8") for path in tmp_path.iterdir()})
        return directory

    monkeypatch.setattr("coincid.slices.library.compile_once", compile_once)
    monkeypatch.setattr("coincid.slices.library.processor", lambda flag: f"of{flag}")
    folder, own = tmp_path.parent / "a", tmp_path.parent / "own"
    flag, objects = "-march=x86-64-v3", [own / "one.o", own / "two.a"]
    library(_Folder(folder), 256, PLAIN, "#define A 1", [own, own / "more"], objects, flag)
    of_slice, of_program = commands
    for command in commands:
        assert command[0] == "g++" and {flag, "-DLANES=256", f"-I{folder}"} < {*command}
    assert str(folder / "slice.cpp") in of_slice and "-shared" not in of_slice
    assert "-shared" in of_program and {f"-I{own}", f"-I{own / 'more'}", "-I."} < {*of_program}
    (made,) = (item for item in of_program if item.endswith("slice.o"))
    assert "-256-" in made and flag in made
    assert of_program[of_program.index(str(PLAIN)) + 1 :] == [made, *map(str, objects)]
    assert texts == {"wiring.h": "#define A 1"}


def test_a_design_is_read_by_the_kind_of_its_files_and_changed_before_it_is_flat(monkeypatch):
    asked = []
    monkeypatch.setattr(
        "coincid.slices.synthesis.yosys_once",
        lambda folder, files, script, *_: asked.append(script),
    )
    texts = {"a.v": "", "b.il": "", "c.v": ""}
    Design("mixed", texts, "top", ["one", "two"], before=["own 1", "own 2"])
    (script,) = asked
    assert script[:8] == [
        "read_verilog a.v",
        "read_rtlil b.il",
        "read_verilog c.v",
        "hierarchy -check -top top",
        "setattr -mod -set keep_hierarchy 1 one",
        "setattr -mod -set keep_hierarchy 1 two",
        "own 1",
        "own 2",
    ]
    assert "flatten" in script[8:]
