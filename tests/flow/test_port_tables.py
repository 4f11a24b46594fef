# SPDX-License-Identifier: Apache-2.0
"""Information for integrators: the table of ports, an instance, the words, the cycle that `laser`
marks, and the diagrams.
"""

import re
import subprocess
from pathlib import Path

import attrs
import pytest
from amaranth.hdl import ClockDomain, Module
from amaranth.sim import Simulator

from coincid.flow.contract_tables import counts_table
from coincid.flow.ip_xact import AFTER_MAPS, BEFORE_MAPS, with_interfaces
from coincid.flow.limits import beats_beside_cycles
from coincid.flow.ports import EXAMPLE, UNDEFINED, instantiation, pages, port_rows, stream_words
from coincid.flow.release import README, release_files
from coincid.flow.release import _readme as readme
from coincid.hdl.export import FILE_LIST
from coincid.hdl.front_end_views import POLYPHASE, view_at
from coincid.hdl.registers import read_cycles_max, write_cycles_max
from coincid.hdl.sensor import FPGA_TOP, SensorTop
from coincid.model.contract.latency import BEAT_TO_PORT, COMMIT, GRANT_TO_BEAT, STORE_TO_GRANT
from coincid.model.contract.packet import FORMATS, header_field
from coincid.model.contract.parameters import TOP
from coincid.tools.pages import regions
from docs.studies.drawings import timing_diagrams

from ..random_cases import configured
from ..releases import config, small_releases

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"


@pytest.mark.parametrize("page", pages())
def test_the_page_has_what_tables_and_rtl_say(page):
    shown = {
        region.name: region.text
        for region in regions(page, (ROOT / page).read_text(encoding="utf-8"))
    }
    assert {name: text.strip("\n") for name, text in pages()[page].items()}.items() <= shown.items()


@pytest.mark.parametrize("name, top", [("silicon", TOP), ("fpga", FPGA_TOP)])
def test_rows_are_the_ports_of_the_verilog(name, top):
    folder = small_releases() / name
    check_rows(
        config(name).sensor,
        top,
        POLYPHASE,
        lambda file: (folder / file).read_text(encoding="utf-8"),
    )


def test_rows_are_the_ports_of_several_streams_and_cells():
    of, view = (
        configured({"rows": 8, "cols": 24, "streams": 3}, {"clock_mhz": 400}),
        view_at("async", 400),
    )
    check_rows(of.sensor, TOP, view, release_files(of, view).__getitem__)


def test_each_stream_is_a_bus_of_the_ip_xact():
    """In the order of their numbers, and all of them belong to the clock."""
    sensor = attrs.evolve(EXAMPLE, cols=24, streams=3)
    text = with_interfaces(BEFORE_MAPS + AFTER_MAPS, sensor, POLYPHASE)
    buses = ["s_axi", "m_axis0", "m_axis1", "m_axis2"]
    named = re.findall(r"<ipxact:busInterface>\s*<ipxact:name>(\w+)<", text)
    assert named == [*buses, "clk", "rst"]
    assert f'"{":".join(buses)}"' in text
    ports = [row.name for row in port_rows(sensor) if row.name.startswith("m_axis")]
    connected = re.findall(r"<ipxact:physicalPort>\s*<ipxact:name>(m_axis\w+)<", text)
    assert sorted(connected) == sorted(ports)


def check_rows(sensor, top, view, text):
    """Check the rows against the release whose files `text` returns by name."""
    found = re.findall(r"^  (input|output) (?:\[(\d+):0\] )?(\w+);", text(f"{top}.v"), re.MULTILINE)
    rows = port_rows(sensor, top, view)
    assert sorted((row.name, row.width, row.direction) for row in rows) == sorted(
        (name, int(high or 0) + 1, {"input": "in", "output": "out"}[kind])
        for kind, high, name in found
    )
    assert instantiation(sensor, top, view) in text(README)
    assert all(row.meaning and bool(row.reset) == (row.direction == "out") for row in rows)


CLOCKLESS = {"polyphase": "line_", "async": "spad_"}  # beginnings of the ports without a clock


@pytest.mark.parametrize(
    ("view", "top"), [("polyphase", TOP), ("polyphase", FPGA_TOP), ("async", TOP)]
)
def test_every_port_has_the_clock_by_which_it_is_sampled(view, top):
    """Lines of SPADs have none; words of edges and all others have the system's."""
    rows = port_rows(EXAMPLE, top, view_at(view, 400))
    told = {row.name: row.clock for row in rows}
    assert told.pop("clk") == "is one" and told.pop("phase_clocks", "is one") == "is one"
    without = {name for name, clock in told.items() if clock == "none"}
    lines = {name for name in told if re.fullmatch(rf"{CLOCKLESS[view]}\d+", name)}
    assert without == lines and bool(lines) == (view == "async" or top == FPGA_TOP)
    assert {told[name] for name in told.keys() - lines} == {"clk"}
    light = [row.meaning for row in rows if re.match(r"(spad|line)_\d", row.name)]
    kinds = {"async": "lines of", "polyphase": "levels of" if top == FPGA_TOP else "edge words of"}
    assert len(light) == EXAMPLE.subgroups
    for number, meaning in enumerate(light):
        assert meaning.startswith(kinds[view]) and f"subgroup {number}:" in meaning


def test_the_readme_has_the_limits_of_its_sensor():
    """Of the stream that has the most subgroups."""
    table = {"rows": 8, "cols": 24, "streams": 2}
    of = configured(table, {"pulses": 7, "period": 90, "gap": 5, "clock_mhz": 400})
    write, read = write_cycles_max(of.sensor), read_cycles_max(of.sensor)
    beside = [beats_beside_cycles(of.sensor, stream) for stream in range(2)]
    assert write != read and beside[0] != beside[1]
    text = readme(of, {TOP: [f"{TOP}.v"]}, POLYPHASE)
    for told in (
        f"A write is answered at most {write} cycles after its address and its data were taken",
        f"a read at most {read} cycles after its address was.",
        f"(cycles of gaps and dither) + {max(beside)} beats on a stream:",
        f": {7 * 90 + 6 * 5 + max(beside)} with 7 pulses of 90 cycles.",
        "8 x 24",
        "400 MHz",
    ):
        assert told in text, told


def test_outputs_after_a_reset_are_as_told():
    top, sensor, seen = Module(), SensorTop(EXAMPLE), []
    top.domains.sync = domain = ClockDomain()
    top.submodules.sensor = sensor
    outputs = [row for row in port_rows(EXAMPLE) if row.direction == "out"]
    rows = [row for row in outputs if row.reset != UNDEFINED]
    undefined = {row.name for row in outputs} - {row.name for row in rows}
    assert undefined == {"m_axis_tdata", "m_axis_tlast"}

    async def bench(ctx):
        ctx.set(sensor.s_axi.awvalid, 1)  # an access and beats in progress are dropped
        await ctx.tick().repeat(5)
        ctx.set(sensor.s_axi.awvalid, 0)
        ctx.set(domain.rst, 1)
        await ctx.tick()
        ctx.set(domain.rst, 0)
        for _ in range(3):
            seen.append({row.name: ctx.get(sensor.flat_ports()[row.name][1]) for row in rows})
            await ctx.tick()

    simulator = Simulator(top)
    simulator.add_clock(2e-9)
    simulator.add_testbench(bench)
    simulator.run()
    for row in rows:
        told = re.fullmatch(r"(\d+)(?:; (?:1|all ones) (one cycle|two cycles) later)?", row.reset)
        assert told, row.name
        cycles = {None: len(seen), "one cycle": 1, "two cycles": 2}[told[2]]
        all_ones = (1 << row.width) - 1
        expected = [int(told[1])] * cycles + [all_ones] * (len(seen) - cycles)
        assert [values[row.name] for values in seen] == expected, row.name


def test_the_instance_compiles(tmp_path):
    folder = small_releases() / "silicon"
    files = [
        str(folder / name) for name in (folder / FILE_LIST).read_text(encoding="utf-8").split()
    ]
    (tmp_path / "user.v").write_text(
        f"module user;\n{instantiation(EXAMPLE)}endmodule\n", encoding="utf-8"
    )
    command = ["iverilog", "-g2005", "-Wall", "-s", "user", "-o", "user.vvp", *files, "user.v"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, encoding="utf-8")
    assert done.returncode == 0 and "port" not in done.stderr, done.stderr


def test_the_diagrams_show_what_the_page_says():
    trace = timing_diagrams.traced("id")
    rows = [dict(zip(trace, values, strict=True)) for values in zip(*trace.values(), strict=True)]
    frame = timing_diagrams.frame_of(trace)
    taken = [
        (cycle - frame, row["m_axis_tdata"])
        for cycle, row in enumerate(rows)
        if row["m_axis_tvalid"] and row["m_axis_tready"]
    ]
    events = [
        (cycle, beat) for cycle, beat in taken if header_field(beat, "kind") == FORMATS["id"].code
    ]
    (at, first), (stalled, second) = events
    assert header_field(first, "stamp") == 22  # the edges at the ports while `laser` was high
    assert header_field(second, "stamp") == 10 * timing_diagrams.PHASES + 1
    close = (22 + 16 - 1) // timing_diagrams.PHASES
    assert at == close + COMMIT + STORE_TO_GRANT + GRANT_TO_BEAT + BEAT_TO_PORT == close + 17
    assert stalled == timing_diagrams.STALLED.stop
    offered = [rows[frame + cycle] for cycle in range(27, timing_diagrams.STALLED.stop)]
    assert {(row["m_axis_tvalid"], row["m_axis_tdata"]) for row in offered} == {(1, second)}
    refused = next(row for row in rows if row["s_axi_bvalid"] and row["s_axi_bresp"])
    assert refused["s_axi_bresp"] == 2
    for picture in timing_diagrams.PICTURES.values():
        assert picture(trace if picture.form == "id" else timing_diagrams.traced(picture.form)).axes


def test_words_of_a_sensor_with_counts():
    """Beat by beat, as docs/contract.md places the fields; a sensor without counts has none."""
    shown = stream_words(attrs.evolve(EXAMPLE, counts=1))
    assert "| 0 | counts of a minigroup | 10 | the pulses of its pixels, then its rows |" in shown
    rows = [line.split(" | ")[:3] for line in shown.splitlines() if line.startswith("| 2 to 9")]
    assert rows == [["| 2 to 9", "63:0", "`rows`"]]
    in_first = [line for line in counts_table().splitlines() if line.startswith("| 0 |")]
    bits = [re.search(r"(\d+):(\d+) \| `(\w+)`", line).groups() for line in in_first]
    expected = [("63", "61", "kind"), ("59", "48", "subgroup"), ("47", "16", "minigroup")]
    assert bits == [*expected, ("15", "0", "gates")]
    assert "counts" not in stream_words(EXAMPLE)
