# SPDX-License-Identifier: Apache-2.0
"""The `coincid` command: one sub-command per job.

Commands check all their input before they build or simulate anything. Each command imports the modules that it needs, so
`--help` appears immediately. Exit codes: 0 for success; 1 if the RTL differs from the golden model or lint found something;
2 for bad input or a missing tool (one line on stderr); 130 after an interruption, 143 after SIGTERM, and 141 if nobody
reads the output any more.
"""

import contextlib
import math
import os
import sys
from collections.abc import Callable, Iterable, Iterator
from functools import partial
from inspect import Parameter, Signature, getdoc, signature
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeAlias

import typer
from rich.console import Console
from rich.markup import escape
from typer.core import TyperGroup

import coincid
from coincid.lab.options import OPTIONS
from coincid.model.contract.preset_files import PRESETS
from coincid.model.shared.errors import SEED_MAX, InputError, check_integer, extra
from coincid.model.shared.interrupts import exit_code

if TYPE_CHECKING:
    from coincid.lab.setup import Setup
    from coincid.model.contract.config import Config
    from coincid.model.light.spad import Spad
    from coincid.study.progress import Bar

BAD_INPUT = 2
DIFFERS = 1
STALL_CYCLES_MAX = 1 << 24
PULSES_MAX = 1 << 16
# for `sim --view async`; Icarus takes about three minutes for them
ASYNC_PULSES, ASYNC_FRAMES = 4, 1
FRAMES_MAX = 1000  # for the controller
REPEATS_MAX = 1000
PROCESSES_MAX = 1 << 10
SWITCHES = {"true": True, "false": False}

console = Console(stderr=True, highlight=False)


class Commands(TyperGroup):
    """The group of commands. It turns errors that are meant for users into messages and exit codes."""

    def make_context(self, *names: Any, **options: Any) -> Any:
        """Read the words of a command. Typer imports its parser for that, which takes long enough
        for an interrupt.
        """
        try:
            return super().make_context(*names, **options)
        except KeyboardInterrupt as why:
            raise _failed("interrupted", exit_code(why)) from None

    def invoke(self, ctx: Any) -> Any:
        try:
            return super().invoke(ctx)
        except InputError as error:
            raise _failed(error, BAD_INPUT) from None
        except KeyboardInterrupt as why:
            raise _failed("interrupted", exit_code(why)) from None
        except (AssertionError, RuntimeError) as error:
            if not _is_simulation(error):
                raise
            raise _failed(error, DIFFERS) from None


def _is_simulation(error: Exception) -> bool:
    from coincid.host.transport import HostError
    from coincid.tb.rtl_errors import Mismatch, SimulationError

    return isinstance(error, (HostError, Mismatch, SimulationError))


def _failed(message: object, code: int) -> typer.Exit:
    print(f"coincid: {message}", file=sys.stderr)
    return typer.Exit(code)


app = typer.Typer(
    cls=Commands,
    add_completion=False,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    help=(
        "Open, cycle-accurate model of a SPAD direct time-of-flight sensor with coincidence detection."
    ),
)


def _print_version(asked: bool) -> None:
    if asked:
        print(f"coincid {coincid.__version__}")
        raise typer.Exit()


@app.callback()
def _options(
    _version: Annotated[
        bool,
        typer.Option(
            "--version", help="Print the version and exit.", is_eager=True, callback=_print_version
        ),
    ] = False,
) -> None: ...


def option(help: str, metavar: str | None = None, flag: str | None = None) -> Any:
    """Return the description of an option. flag: of a switch, and of an option that its parameter does not name.

    Square brackets in texts are no markup.
    """
    flags = [] if flag is None else [flag]
    return typer.Option(*flags, metavar=metavar, help=escape(help))


def argument(help: str, metavar: str) -> Any:
    """Return the description of an argument."""
    return typer.Argument(metavar=metavar, help=escape(help))


def command(function: Callable[..., None]) -> Callable[..., None]:
    """Make a function a command of its name. Its parameters are options and arguments, its docstring is the help.

    A parameter `described` stands for the options of `DESCRIBING`, and gets their values.
    """
    parameters = signature(function).parameters
    if "described" in parameters:
        function = _with_described(function)
    # square brackets are no markup
    return app.command(help=escape(getdoc(function) or ""))(function)


def _with_described(function: Callable[..., None]) -> Callable[..., None]:
    """Return a function that has the options of `DESCRIBING` in place of the parameter
    `described`.
    """
    options = [
        Parameter(name, Parameter.KEYWORD_ONLY, default=OPTIONS[name].default, annotation=kind)
        for name, kind in DESCRIBING.items()
    ]
    own = list(signature(function).parameters.values())
    at = [parameter.name for parameter in own].index("described")
    own[at : at + 1] = options

    def run(**given: Any) -> None:
        described = {name: given.pop(name) for name in DESCRIBING}
        function(described=described, **given)

    run.__name__ = function.__name__
    run.__doc__ = function.__doc__
    run.__signature__ = Signature(own)  # type: ignore[attr-defined]  # read by `inspect`
    run.__annotations__ = {parameter.name: parameter.annotation for parameter in own}
    return run


def tabled(name: str, flag: str | None = None, default: str | None = None) -> Any:
    """Return the description of an option of lab/options.py. default: told instead of its default there."""
    one = OPTIONS[name]
    help = one.doc if default is None else f"{one.doc.rstrip('.')}; default: {default}."
    return option(help, one.metavar or None, flag)


SceneOption = Annotated[str, tabled("scene")]
SceneArgument = Annotated[str, argument(OPTIONS["scene"].doc, "SCENE")]
# what `load_scene` is told about a file, by the name of its argument
Described: TypeAlias = dict[str, Any]
DESCRIBING = {
    "unit": Annotated[str | None, tabled("unit")],
    "scale": Annotated[float, tabled("scale")],
    "missing": Annotated[list[float] | None, tabled("missing", "--missing")],
    "sky_m": Annotated[float | None, tabled("sky_m", "--sky")],
    "z": Annotated[bool, tabled("z", "--z")],
    "fov_deg": Annotated[float | None, tabled("fov_deg", "--fov")],
    "channel": Annotated[str | None, tabled("channel")],
    "bin_ps": Annotated[float | None, tabled("bin_ps")],
    "recorded_pulses": Annotated[int | None, tabled("recorded_pulses")],
    "reflectivity": Annotated[float, tabled("reflectivity")],
}
KluxOption = Annotated[str | None, tabled("klux")]
BackgroundOption = Annotated[str, tabled("background")]
PulseOption = Annotated[str | None, tabled("pulse")]
SeedOption = Annotated[int, tabled("seed")]
SpadOption = Annotated[list[str] | None, tabled("spad")]
ViewOption = Annotated[str, tabled("view")]
CONFIG_DOC = f"TOML file, or a preset: {', '.join(PRESETS)}."
ConfigOption = Annotated[str | None, option(CONFIG_DOC, "FILE")]
ChangesOption = Annotated[
    list[str] | None,
    option(
        "Set a key of the configuration, such as threshold=3 or format=full; overrides the file; repeatable.",
        "NAME=VALUE",
        "--set",
    ),
]
ClockOption = Annotated[
    float | None, option("System clock; default: the configuration's (frame.clock_mhz).")
]
EdgesOutOption = Annotated[
    Path, option("Edges: .npz, .csv, .h5 or (up to 64 pixels) .ptu.", "FILE")
]


@command
def sim(
    *,
    scene: SceneOption = "sun-and-shade",
    described: Described,
    klux: KluxOption = None,
    background: BackgroundOption = "reflected",
    pulse: PulseOption = None,
    pulses: Annotated[
        int | None,
        option(
            "Laser pulses per frame; default: the configuration's. The controller's bounds change in proportion."
        ),
    ] = None,
    threshold: Annotated[
        int | None,
        option(
            "Threshold of all subgroups in the frame `fixed`; "
            "default: the configuration's if it gives one, otherwise the best of 1 to 7."
        ),
    ] = None,
    frames: Annotated[
        int | None,
        option(
            "Frames of new photons in which the controller settles; "
            "default: 8, or one for each picture of a scene that moves."
        ),
    ] = None,
    link_gbps: Annotated[
        float | None,
        option(
            "Rate of a stream's link in Gbit/s; 0: 64 bits per cycle; default: the configuration's, otherwise 8."
        ),
    ] = None,
    config: ConfigOption = None,
    changes: ChangesOption = None,
    seed: SeedOption = 1,
    engine: Annotated[
        str | None,
        tabled("engine", default="sliced; with --waves verilator, with --view async icarus"),
    ] = None,
    out: Annotated[Path, option("Folder of the results.", "DIR")] = Path("build/sim"),
    waves: Annotated[
        bool,
        option(
            "Also write a waveform (FST) and views of it for GTKWave and Surfer.", flag="--waves"
        ),
    ] = False,
    clock_mhz: ClockOption = None,
    spad: SpadOption = None,
    spad_gate: Annotated[bool, tabled("spad_gate", "--spad-gate")] = False,
    view: ViewOption = "polyphase",
) -> None:
    """Simulate frames of a scene and check every word against the golden model; write depth.png, events.npz and report.json."""
    from coincid.study.simulate import simulate_to_folder, with_link
    from coincid.tb.replay import DEFAULT_VIEW, chosen_view

    settings = _config(config, changes, clock_mhz)
    if view != DEFAULT_VIEW:
        engine = engine or "icarus"
        pulses = ASYNC_PULSES if pulses is None else pulses
        frames = ASYNC_FRAMES if frames is None else frames
    if pulses is not None:
        settings = settings.with_pulses(check_integer("pulses", pulses, 1, PULSES_MAX))
    settings = with_link(settings, link_gbps)
    engine = engine or ("verilator" if waves else "sliced")
    chosen_view(engine, view, settings.clock_mhz, waves)
    simulate_to_folder(
        _setup(
            settings,
            scene,
            klux=klux,
            described=described,
            background=background,
            pulse=pulse,
            seed=seed,
            spad=_spad(spad),
            spad_gate=spad_gate,
            engine=engine,
            view=view,
        ),
        out=_folder(out),
        threshold=threshold,
        settling=frames if frames is None else check_integer("frames", frames, 1, FRAMES_MAX),
        waves=waves,
        console=Console(highlight=False),
        scale=described["scale"],
        unit=described["unit"],
    )


@command
def advise(
    *,
    scene: SceneArgument,
    described: Described,
    klux: KluxOption = None,
    background: BackgroundOption = "reflected",
    pulse: PulseOption = None,
    config: ConfigOption = None,
    changes: ChangesOption = None,
    seed: SeedOption = 1,
    spad: SpadOption = None,
    out: Annotated[Path, option("Folder of table, picture and advised settings.", "DIR")] = Path(
        "build/advise"
    ),
) -> None:
    """Try thresholds, windows, the controller, formats and links on a scene; recommend one combination and state its cost."""
    import numpy as np
    from rich.table import Table

    from coincid.model.scenes.ambient import ambient_klux
    from coincid.study.advise import HEADS, write_advice
    from coincid.study.advise import advise as run
    from coincid.study.progress import Bar

    setup = _setup(
        _config(config, changes),
        scene,
        klux=klux,
        described=described,
        background=background,
        pulse=pulse,
        seed=seed,
        spad=_spad(spad),
    )
    looked_at = setup.seen
    _folder(out)
    mean_klux = float(
        np.mean(ambient_klux(setup.klux, looked_at.rows, looked_at.cols) * looked_at.sunlit)
    )
    with Bar(console, lines=True) as bar:
        advice = run(setup, klux=mean_klux, progress=bar.at)
        bar.stage("table and picture")
        files = write_advice(out, advice, looked_at.name)
    table = Table(box=None, header_style="bold", pad_edge=False)
    for head in HEADS:
        table.add_column(head, justify="right")
    for one in advice.tried:
        window = "none" if math.isnan(one.window_ns) else f"{one.window_ns:.3g}"
        setting = one.threshold, window, one.config.format, f"{one.link_gbps:g}"
        shares = f"{one.wrong:.1%}", f"{one.far:.1%}"
        prices = f"{one.error_mm:.1f}", f"{one.bits:,}", f"{one.dropped:.1%}", f"{one.load:.0%}"
        rate = f"{one.frames_per_s:,.0f}"
        style = "bold" if one is advice.best else None
        table.add_row(*setting, *shares, *prices, rate, style=style)
    shown = Console(highlight=False, width=None if sys.stdout.isatty() else 150)
    if advice.useless:
        print(advice.useless)
    shown.print(table)
    print(f"Every row: {advice.price}. The error is the RMS of the pixels that are not wrong.")
    for note in looked_at.notes:
        print(note)
    print(advice.limit)
    if advice.counts:
        print(advice.counts)
    print(advice.sentence)
    print(" ".join(map(str, files)))


@command
def show(
    *,
    config: Annotated[str | None, argument(CONFIG_DOC, "CONFIG")] = None,
    changes: ChangesOption = None,
) -> None:
    """Print what follows from a configuration: sizes, rates, distances, share of the link, area, power; and warn of waste."""
    from coincid.study.explain import meaning, warnings

    settings = _config(config, changes)
    for name, value in meaning(settings):
        print(f"{name:16} {value}")
    for sentence in warnings(settings):
        print(f"* {sentence}")


@command
def explore(
    *,
    port: Annotated[
        int | None, option("Port on this machine; default: 5006, or the next free one.")
    ] = None,
    no_browser: Annotated[bool, option("Only print the address.", flag="--no-browser")] = False,
    changes: Annotated[
        list[str] | None,
        option(
            "Initial value of a control, or a file: depth_file, colour_file, sun_file, pulse_file.",
            "NAME=VALUE",
            "--set",
        ),
    ] = None,
) -> None:
    """Serve the explorer, which shows the effect of every setting in the browser. It serves this machine only and sends no requests."""
    with extra("explore"):
        from coincid.study.explore.server import serve
    from coincid.study.explore.control_values import given_settings

    serve(port, browser=not no_browser, start=given_settings(changes or []))


@command
def replay(
    *,
    edges: Annotated[Path, option("Edges (NPZ: pulse, pixel, tick).", "FILE")],
    out: Annotated[Path, option("Result (NPZ).", "FILE")],
    config: ConfigOption = None,
    changes: ChangesOption = None,
    engine: Annotated[
        str | None, tabled("engine", default="golden; with --view async icarus")
    ] = None,
    stall: Annotated[
        int, option("Keep tready low for the first N cycles of every frame.", "N")
    ] = 0,
    view: ViewOption = "polyphase",
    offset_seed: Annotated[
        int | None,
        option(
            "With --view async: seed of random positions of the edges within their ticks; "
            "default: the file's offset_ps, otherwise the middle of the tick.",
            "SEED",
        ),
    ] = None,
) -> None:
    """Run an edge file through the golden model or the RTL and write what leaves the sensor."""
    from coincid.model.contract.counts import NO_GATE
    from coincid.model.contract.edges import load_edges
    from coincid.model.contract.result import stall as low
    from coincid.model.contract.result import write_result
    from coincid.model.shared.files import check_suffix
    from coincid.tb.replay import DEFAULT_VIEW, chosen_view
    from coincid.tb.replay import replay as run

    engine = engine or ("golden" if view == DEFAULT_VIEW else "icarus")
    stall = check_integer("stall", stall, 0, STALL_CYCLES_MAX)
    settings = _config(config, changes)
    chosen_view(engine, view, settings.clock_mhz)
    pulses = settings.frames * settings.pulses
    loaded = load_edges(
        edges,
        pixels=settings.sensor.array_pixels,
        pulses=pulses,
        period_ticks=settings.period_ticks,
    )
    check_suffix(_file(out), ".npz")
    if offset_seed is not None:
        if view == DEFAULT_VIEW:
            raise InputError(
                f"offset_seed = {offset_seed}: goes with --view async, which has positions within a tick"
            )
        with extra("rtl"):
            from coincid.tb.stimulus import off_centre
        loaded = off_centre(
            settings, loaded, check_integer("offset_seed", offset_seed, 0, SEED_MAX)
        )

    cycles = settings.frames * settings.frame_cycles
    with _progress(cycles, f"{len(loaded)} edges, {settings.frames} frames, {engine}") as bar:
        result = run(engine, settings, loaded, low(stall), bar.done, view=view)
    write_result(out, result)
    if settings.counting:
        gates = int((result["gate_cycle"] != NO_GATE).sum())
        hits = int(result["gate_hits"].sum())
        print(f"{out}: {hits} hits in {gates} gates, of {len(loaded)} edges")
        return
    print(
        f"{out}: {len(result['pulse'])} events and {len(result['mg_pulse'])} minigroup records of {len(loaded)} edges, "
        f"{int(result['dropped'].sum())} events dropped"
    )


@command
def sweep(
    *,
    spec: Annotated[
        Path,
        argument("TOML file: a configuration, its scene and light, and axes to sweep.", "SPEC"),
    ],
    out: Annotated[
        Path | None,
        option(
            "Result (Parquet); default: build/SPEC.parquet. "
            "Beside it: a plot (PNG), and the finished points, which a second start reuses.",
            "FILE",
        ),
    ] = None,
    scheduler: Annotated[
        str | None,
        option(
            "Dask scheduler, such as tcp://HOST:8786; default: a cluster on this machine alone.",
            "ADDRESS",
        ),
    ] = None,
    workers: Annotated[
        int | None, option("Processes on this machine; default: one per core.")
    ] = None,
) -> None:
    """Run a grid of configurations, scenes and light on many processes or machines; the table has one row per point."""
    workers = check_integer(
        "workers", os.cpu_count() or 1 if workers is None else workers, 1, PROCESSES_MAX
    )
    out = out or Path("build") / f"{spec.stem}.parquet"
    if out.suffix != ".parquet":
        raise InputError(f"out = {str(out)!r}: must end with .parquet")
    _file(out)
    from coincid.study.sweep_spec import read_spec

    grid = read_spec(spec)
    with extra("sweep"):
        from coincid.study.sweep import sweep as run
    with _progress(len(grid.keys), spec.name) as bar:
        summary = run(
            grid, out, workers=workers, scheduler=scheduler, title=spec.stem, progress=bar.done
        )
    print(
        f"{out}: {summary.rows} of {len(grid.points)} points, {summary.finished_before} of them finished before"
    )
    _all_met(f"point {name}: {why}" for name, why in summary.failed.items())


@command
def photons(
    *,
    out: EdgesOutOption,
    scene: SceneOption = "five-objects",
    described: Described,
    klux: KluxOption = None,
    background: BackgroundOption = "reflected",
    pulse: PulseOption = None,
    config: ConfigOption = None,
    changes: ChangesOption = None,
    seed: SeedOption = 1,
    spad: SpadOption = None,
    clock_mhz: ClockOption = None,
) -> None:
    """Write the photons of a scene, in all frames of a configuration, as edges."""
    from coincid.model.light.timing import Timing
    from coincid.model.recorded.exchange import check_suffix, write_edges

    settings = _config(config, changes, clock_mhz)
    check_suffix(_file(out))
    setup = _setup(
        settings,
        scene,
        klux=klux,
        described=described,
        background=background,
        pulse=pulse,
        seed=seed,
        spad=_spad(spad),
    )
    made = setup.photons.edges(os.cpu_count() or 1)
    write_edges(out, made, Timing.from_config(settings))
    for note in setup.seen.notes:
        print(note)
    pulses = setup.config.frames * setup.config.pulses
    print(f"{out}: {len(made):,} edges of {pulses:,} pulses")


@command
def edges(
    *,
    recording: Annotated[
        Path, argument("Photons: .ptu, .csv, .npz or .h5 (docs/recordings.md).", "RECORDING")
    ],
    out: EdgesOutOption,
    config: ConfigOption = None,
    changes: ChangesOption = None,
    channels: Annotated[
        str | None,
        option(
            "CHANNEL:PIXEL,... or a CSV file with these columns; default: channel k is pixel k.",
            "MAP",
        ),
    ] = None,
    sync_channel: Annotated[
        int | None, option("Channel of the laser trigger, for recordings with absolute times.", "N")
    ] = None,
    sync_divider: Annotated[
        int | None,
        option("Laser pulses per recorded trigger; default: as the file says, or 1.", "N"),
    ] = None,
    first_sync: Annotated[int, option("The trigger that becomes pulse 0.", "N")] = 0,
    delay_ps: Annotated[
        float, option("Delay between trigger and light; it is subtracted from every time.", "PS")
    ] = 0.0,
    clock_mhz: ClockOption = None,
) -> None:
    """Convert recorded photons into edges, or edges into another format; count the photons that are out of range."""
    from coincid.model.light.timing import Timing
    from coincid.model.recorded.exchange import (
        check_suffix,
        offsets_note,
        parse_channels,
        read_recording,
        write_edges,
    )
    from coincid.model.recorded.recordings import period_note, recorded_edges, told

    settings = _config(config, changes, clock_mhz)
    check_suffix(_file(out))
    timing = Timing.from_config(settings)
    pixel_of = None if channels is None else parse_channels(channels)
    recorded = read_recording(recording, sync_channel, sync_divider)
    try:
        converted, lost = recorded_edges(
            recorded, settings, timing, channels=pixel_of, first_sync=first_sync, delay_ps=delay_ps
        )
    except InputError as error:
        raise error.within(recording) from None
    write_edges(out, converted, timing)
    print(f"{recording}: {recorded.kind}, {len(recorded.sync):,} photons")
    notes = (
        period_note(recorded, timing),
        f"left out: {told(lost)}" if lost else "",
        offsets_note(out, converted),
    )
    for note in filter(None, notes):
        print(note)
    print(f"{out}: {len(converted):,} edges")


@command
def verilog(
    *,
    out: Annotated[Path, option("Folder of the export; replaces an earlier one.", "DIR")] = Path(
        "build/rtl"
    ),
    config: ConfigOption = None,
    changes: ChangesOption = None,
    view: ViewOption = "polyphase",
    prefix: Annotated[
        str,
        option(
            "Beginning of all names of the export, such as near_; so several sensors fit on one chip.",
            "NAME",
        ),
    ] = "",
) -> None:
    """Export the synthesizable Verilog, one file per block, with file lists, constraints, register map and smoke test."""
    settings = _config(config, changes)
    with extra("rtl"):
        from coincid.flow.release import write_release
    files = write_release(out, settings, view, prefix)
    print(f"{out}: {len(files)} files, {sum(path.stat().st_size for path in files) / 1000:.0f} kB")


@command
def synth(
    *,
    out: Annotated[
        Path | None,
        option("Markdown page with the cost of the presets; default: docs/synthesis.md.", "FILE"),
    ] = None,
) -> None:
    """Synthesize the presets silicon and fpga to gates, standard cells and ECP5, and write the table of their cost."""
    with extra("rtl"):
        from coincid.flow.synth import write_synthesis_page
    write_synthesis_page(out and _file(out))
    print(out or "docs/synthesis.md")


@command
def gls() -> None:
    """Simulate the netlists of a small sensor, in gates and in standard cells, against the golden model."""
    with extra("rtl"):
        from coincid.flow.gls import gate_levels
    for line in gate_levels():
        print(line, flush=True)


@command
def layout(
    *,
    out: Annotated[
        Path | None,
        option(
            "Markdown page; the pictures go to images/ beside it; default: docs/layout.md.", "FILE"
        ),
    ] = None,
) -> None:
    """Lay out a minigroup in standard cells: place, route, check, time with its wires, and simulate with their delays."""
    with extra("rtl"):
        from coincid.flow.layout.tools import layout_cells
    layout_cells()
    from coincid.flow.layout.document import write_layout_page

    write_layout_page(out and _file(out), partial(print, flush=True))
    print(out or "docs/layout.md")


@command
def pnr(
    *,
    out: Annotated[
        Path | None,
        option("Markdown report of Fmax and resources; default: docs/place-and-route.md.", "FILE"),
    ] = None,
) -> None:
    """Place and route a module of the FPGA preset on an ECP5, with five seeds. Exit code 1: a clock misses its goal."""
    with extra("rtl"):
        from coincid.flow import pnr
        from coincid.flow.fpga_module import fpga_module

    if out is not None:
        _file(out)
    board = fpga_module()
    placements = pnr.place(board)
    pnr.write_placement_page(board, placements, out)
    print(out or board.page)
    for line in pnr.skewed(board, placements):
        print(f"coincid: warning: {line}", file=sys.stderr)
    _all_met(pnr.missed(board, placements))


@command
def emulator(
    *,
    kind: Annotated[
        str,
        argument(
            "ulx3s: Verilog and bitstream for that board; serial, axi: Verilog alone, linted.",
            "KIND",
        ),
    ] = "ulx3s",
    config: Annotated[
        str | None,
        option("TOML file or preset; default: emulator, and emulator-axi for axi.", "FILE"),
    ] = None,
    changes: ChangesOption = None,
    buffer_beats: Annotated[int, option("Size of the frame buffer in beats.", "N")] = 8192,
    out: Annotated[Path, option("Folder of Verilog, register map and bitstream.", "DIR")] = Path(
        "build/emulator"
    ),
    page: Annotated[
        Path | None,
        option(
            "With ulx3s: Markdown report of Fmax and resources; default: docs/emulator-board.md.",
            "FILE",
        ),
    ] = None,
) -> None:
    """Build the emulator for a board. Exit code 1: lint found something, or one of five seeds misses a clock."""
    from coincid.board.parameters import Emulator
    from coincid.model.shared.files import whole_file

    with extra("rtl"):
        from coincid.board import release
        from coincid.board.lint import lint_emulator
        from coincid.board.place import ulx3s
        from coincid.flow import pnr
    on_board = kind == release.BOARD
    if page is not None:
        _file(page)
    usual = "emulator-axi" if kind == release.AXI else "emulator"
    settings = _config(config or usual, changes)
    folder = _folder(out)  # before what takes seconds
    files = release.emulator_release(settings, kind, buffer_beats)
    written = release.write_emulator(folder, files)
    print(
        f"{out}: {len(written)} files, {sum(path.stat().st_size for path in written) / 1000:.0f} kB"
    )
    _all_clean(lint_emulator(files, release.TOPS[kind]))
    if on_board:
        board = ulx3s(settings, Emulator.of(settings, buffer_beats))
        placements = pnr.place(board)
        bitstream = out / f"{board.top}.bit"
        with whole_file(bitstream) as file:
            file.write(pnr.fastest(placements).bitstream.read_bytes())
        pnr.write_placement_page(board, placements, page)
        print(f"{bitstream}\n{page or board.page}")
        _all_met(pnr.missed(board, placements))


@command
def lint(
    *, config: ConfigOption = None, changes: ChangesOption = None, view: ViewOption = "polyphase"
) -> None:
    """Check the exported Verilog with Verilator's lint, and with Icarus if it is installed."""
    settings = _config(config, changes)
    with extra("rtl"):
        from coincid.flow.lint import lint as run
        from coincid.hdl.front_end_views import view_at
    _all_clean(run(settings, view_at(view, settings.clock_mhz)))


@command
def formal(
    *, names: Annotated[list[str] | None, argument("Proofs; default: all.", "NAMES")] = None
) -> None:
    """Prove the RTL's properties for all inputs and all time; takes some 20 minutes."""
    with extra("rtl"):
        from coincid.formal.prove import HEAD, prove
    print(HEAD)
    verdicts = prove(names or (), tell=print)
    failed = [verdict for verdict in verdicts if verdict.reason]
    print(f"{len(verdicts) - len(failed)} of {len(verdicts)} proofs hold", flush=True)
    _all_met(
        f"{verdict.proof.name}: {verdict.reason}; log: {verdict.folder / 'log'}"
        for verdict in failed
    )


@command
def budget(
    *,
    distance_m: Annotated[float, option("Distance of the target in metres.")] = 4.0,
    reflectivity: Annotated[float, option("Reflectivity of the target, 0 to 1.")] = 0.4,
    klux: Annotated[float, option("Sunlight in klux.")] = 50.0,
    spectrum: Annotated[
        str | None, option("am15g, am15d, am0 or planck; default: am15g.", "SPECTRUM")
    ] = None,
    form: Annotated[
        str, option("literal (as printed in the paper) or corrected.", "FORM")
    ] = "literal",
    json: Annotated[
        bool, option("Print JSON with flat keys, for programs.", flag="--json")
    ] = False,
) -> None:
    """Print the link budget, equations (1) and (2) of the paper, line by line."""
    from json import dumps

    from coincid.model.light.link_budget import link_budget

    given: dict[str, Any] = {} if spectrum is None else {"spectrum": spectrum}
    result = link_budget(distance_m, reflectivity, klux, form=form, **given)
    if json:
        print(dumps(result.json(), indent=2))
        return
    for name, value, unit, source in result.rows():
        print(
            f"{name:22} {value if isinstance(value, str) else format(value, '.6g'):>12} {unit:6} {source}"
        )


@command
def emulate(
    *,
    port: Annotated[
        str | None, option("Serial port of the board, such as /dev/ttyUSB0.", "DEVICE")
    ] = None,
    simulate: Annotated[
        bool,
        option(
            "Use the emulator's simulated RTL behind its serial pins instead.", flag="--simulate"
        ),
    ] = False,
    netlist: Annotated[
        bool,
        option(
            "With --simulate: the netlist of the FPGA of an ULX3S instead of the RTL.",
            flag="--netlist",
        ),
    ] = False,
    scene: Annotated[str, option("Scene, as in coincid sim.", "SCENE")] = "five-objects",
    klux: KluxOption = None,
    config: Annotated[
        str, option("TOML file or preset; its sensor must be the one on the board.", "FILE")
    ] = "emulator",
    changes: ChangesOption = None,
    frames: Annotated[int, option("Frames to take.", "N")] = 20,
    pulses: Annotated[
        int | None, option("Laser pulses per frame; default: the configuration's.", "N")
    ] = None,
    seed: Annotated[int, option("Seed of the photon source.")] = 1,
    baud: Annotated[
        int | None,
        option(
            "Baud rate of the serial line; default: 3,000,000 on a board, the fastest possible in simulation."
        ),
    ] = None,
    out: Annotated[Path, option("Folder of the depth picture.", "DIR")] = Path("build/emulate"),
) -> None:
    """Run the emulator, on a board or in simulation, and check each of its words against the golden model."""
    from coincid.board.driver import EmulatorDriver
    from coincid.board.run import DEPTH
    from coincid.board.run import emulate as run
    from coincid.board.serial_link import BAUD
    from coincid.board.serial_transport import SerialPort, SerialTransport
    from coincid.model.contract.settings import FRAMES_MAX

    if (port is None) is not simulate:
        raise InputError("port: give either --port DEVICE or --simulate")
    if netlist and not simulate:
        raise InputError("netlist: goes with --simulate only")
    frames = check_integer("frames", frames, 1, FRAMES_MAX)
    _folder(out)
    settings = _config(config, changes)
    if pulses is not None:
        settings = settings.with_frame(pulses=pulses)
    setup = _setup(settings, scene, klux=klux)
    patience: dict[str, Any] = {}
    if simulate:
        with extra("rtl"):
            from coincid.board.netlist import emulator_netlist
            from coincid.board.simulated import (
                PATIENCE_S,
                SIMULATED_CLOCKS_PER_BIT,
                SimulatedPort,
                clocks_at,
                simulated,
            )
        clocks = SIMULATED_CLOCKS_PER_BIT
        if baud is not None:
            clocks = clocks_at(baud, settings.clock_mhz)
        built, library = (
            emulator_netlist(settings, clocks_per_bit=clocks)
            if netlist
            else (simulated(settings.sensor, clocks_per_bit=clocks), None)
        )
        line: Any = SimulatedPort(built, settings.clock_mhz, library)
        patience["patience_s"] = PATIENCE_S * clocks / SIMULATED_CLOCKS_PER_BIT
    else:
        line = SerialPort(str(port), BAUD if baud is None else baud)
    with line, _progress(frames, "frames") as bar:
        transport = SerialTransport(line, **patience)
        tally = run(
            EmulatorDriver(transport),
            settings,
            setup.seen,
            out,
            klux=setup.klux,
            frames=frames,
            seed=seed,
            tell=lambda so_far: bar.done(so_far.frames),
        )
        if simulate:
            print(
                f"{tally.seconds_on_line / tally.frames * 1e3:.3g} ms of simulated time per frame"
            )
    print(f"{tally.frames} frames, {tally.beats} words, all as the golden model predicts")
    rate = f"{tally.frames / tally.seconds:.3g} frames per second"
    print(
        f"{rate}; {transport.repeats} requests repeated, {tally.recoveries} recoveries\n{out / DEPTH}"
    )


@command
def bench(
    *,
    out: Annotated[
        Path, option("JSON, flat keys; a Markdown table goes beside it.", "FILE")
    ] = Path("build/bench.json"),
    repeats: Annotated[int, option("Number of rounds; the results are medians.", "N")] = 5,
) -> None:
    """Measure the speed of the model, the simulators, whole frames and builds from scratch; takes about ten minutes."""
    with extra("rtl"):
        from coincid.study.bench import benchmark, table
    repeats = check_integer("repeats", repeats, 1, REPEATS_MAX)
    if out.suffix == ".md":
        raise InputError(f"out = {str(out)!r}: must not end with .md, as the table beside it does")
    print(table(benchmark(_file(out), repeats=repeats, tell=console.print)), end="")


def _setup(
    config: "Config",
    scene: str,
    *,
    klux: str | None,
    described: Described | None = None,
    **fields: Any,
) -> "Setup":
    """Return the `Setup` of a scene, whose file `described` explains, with further `fields`.

    Doubts about the file are told at once, before any work.
    """
    from coincid.lab.setup import Setup, for_pictures, scene_of
    from coincid.model.scenes.catalogue import usual_klux

    given = {name: value for name, value in (described or {}).items() if value != []}
    surfaces = scene_of(config, scene, **given)
    for doubt in surfaces.doubts:
        print(f"Check this first: {doubt}", flush=True)
    ambient = usual_klux(scene, given.get("bin_ps")) if klux is None else klux
    return Setup(config=for_pictures(config, surfaces), scene=surfaces, klux=ambient, **fields)


def _spad(given: Iterable[str] | None) -> "Spad":
    """Return the detector with properties NAME=VALUE."""
    from attrs import fields_dict

    from coincid.model.light.spad import Spad

    values: dict[str, Any] = {}
    for text in given or ():
        name, _, value = text.partition("=")
        if name not in fields_dict(Spad):
            raise InputError(
                f"--spad {text}: must be NAME=VALUE with a name of {', '.join(fields_dict(Spad))}"
            )
        if isinstance(fields_dict(Spad)[name].default, bool):
            if value not in SWITCHES:
                raise InputError(f"--spad {text}: must be {' or '.join(SWITCHES)}")
            values[name] = SWITCHES[value]
            continue
        try:
            values[name] = float(value)
        except ValueError:
            raise InputError(f"--spad {text}: must be a number") from None
    return Spad(**values)


def _config(
    config: str | None, changes: list[str] | None, clock_mhz: float | None = None
) -> "Config":
    """Return the configuration of a file or preset with the changes of the command line."""
    from coincid.model.contract.config import changes_of_text, load_config

    loaded = load_config(config, changes_of_text(changes or []))
    return loaded if clock_mhz is None else loaded.with_frame(clock_mhz=clock_mhz)


def _file(path: Path) -> Path:
    """Return `path` if a file can be written there. Nothing is written yet."""
    from coincid.model.shared.files import check_replaceable

    if os.path.isdir(path):
        raise InputError(f"out = {str(path)!r}: is a folder, must be a file")
    check_replaceable(path)
    _writable(path, path.parent)
    return path


def _folder(path: Path) -> Path:
    """Return `path` if it is a writable folder, or can become one. Nothing is made yet."""
    _writable(path, path)
    return path


def _writable(path: Path, folder: Path) -> None:
    nearest = next(
        parent for parent in (folder, *folder.absolute().parents) if os.path.exists(parent)
    )
    if not os.path.isdir(nearest) or not os.access(nearest, os.W_OK | os.X_OK):
        why = "not writable" if os.path.isdir(nearest) else "no folder"
        raise InputError(f"out = {str(path)!r}: cannot be written: {nearest} is {why}")


@contextlib.contextmanager
def _progress(cycles: int, what: str) -> "Iterator[Bar]":
    """Return a progress bar. It shows nothing if there is no terminal."""
    from coincid.study.progress import Bar

    with Bar(console) as bar:
        bar.stage(what, cycles)
        yield bar


def _all_clean(found: dict[str, str]) -> None:
    """Print what each lint tool found, and end with exit code 1 if any of them found something."""
    for tool, complaints in found.items():
        print(f"{tool}: {'found' if complaints else 'clean'}\n{complaints}", end="")
    if any(found.values()):
        raise typer.Exit(DIFFERS)


def _all_met(missed: Iterable[str]) -> None:
    """Print the failures; if there are any, end with exit code 1."""
    told = [f"coincid: {line}" for line in missed]
    if told:
        print("\n".join(told), file=sys.stderr)
        raise typer.Exit(DIFFERS)
