# SPDX-License-Identifier: Apache-2.0
"""The `coincid` command: one sub-command per job.

Commands check all their input before they build or simulate anything. Exit codes: 0 done; 1 the RTL differs from the
golden model, or lint found something; 2 bad input or a missing tool (one line on stderr); 130 interrupted, 143 by
SIGTERM. Each command imports the modules that it needs, so `--help` is immediate.
"""

import contextlib
import os
import sys
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.console import Console
from typer.core import TyperGroup

from coincid.lab.options import OPTIONS
from coincid.model.contract.preset_files import PRESETS
from coincid.model.shared.errors import SEED_MAX, InputError, check_integer
from coincid.model.shared.extras import extra
from coincid.model.shared.interrupts import INTERRUPTED, TERMINATED, Terminated, interruptible

if TYPE_CHECKING:
    from coincid.model.contract.config import Config
    from coincid.study.progress import Bar

BAD_INPUT, DIFFERS = 2, 1
STALL_CYCLES_MAX = 1 << 24
PULSES_MAX = 1 << 16
ASYNC_PULSES, ASYNC_FRAMES = 4, 1  # for `sim --view async`, for which Icarus needs about three minutes
FRAMES_MAX = 1000  # for the controller
LINK_GBPS = 8.0  # for `sim` if neither it nor the configuration sets the rate: what the pins of such a chip carry
LINK_FORMAT = "compact"  # for `sim` if the configuration sets no format: carries the most events behind such a link
REPEATS_MAX = 1000
BAUD_MAX = 100_000_000
WORKERS_MAX = 1 << 10

console = Console(stderr=True, highlight=False)


class Commands(TyperGroup):
    """The group of commands; turns errors that are meant for users into messages and exit codes."""

    def invoke(self, ctx: Any) -> Any:
        try:
            return super().invoke(ctx)
        except InputError as error:
            raise _failed(error, BAD_INPUT) from None
        except KeyboardInterrupt as why:
            raise _failed("interrupted", _code(why)) from None
        except (AssertionError, RuntimeError) as error:
            if not _is_simulation(error):
                raise
            raise _failed(error, DIFFERS) from None


def _is_simulation(error: Exception) -> bool:
    from coincid.host.transport import HostError
    from coincid.tb.rtl_errors import Mismatch, SimulationError

    return isinstance(error, (HostError, Mismatch, SimulationError))


def _code(why: KeyboardInterrupt) -> int:
    return TERMINATED if isinstance(why, Terminated) else INTERRUPTED


def _failed(message: object, code: int) -> typer.Exit:
    print(f"coincid: {message}", file=sys.stderr)
    return typer.Exit(code)


app = typer.Typer(
    cls=Commands,
    add_completion=False,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    help=("Open, cycle-accurate model of a SPAD direct time-of-flight sensor with coincidence detection."),
)

ConfigOption = Annotated[
    str | None, typer.Option("--config", metavar="FILE", help=f"TOML file, or a preset: {', '.join(PRESETS)}.")
]
SetOption = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        metavar="NAME=VALUE",
        help="A setting of the configuration, such as threshold=3 or format=full, instead of the file's; repeatable.",
        show_default=False,
    ),
]
ClockOption = Annotated[
    float | None,
    typer.Option(
        "--clock-mhz", help="System clock; default: the configuration's (frame.clock_mhz).", show_default=False
    ),
]


def _option(name: str, default: str = "") -> Any:
    """Return an option of the table. default: how its help ends."""
    option = OPTIONS[name]
    told = f"{option.doc.rstrip('.')}; default: {default}." if default else option.doc
    shown = option.default is not None and not default
    return typer.Option(f"--{name.replace('_', '-')}", metavar=option.metavar or None, help=told, show_default=shown)


SceneOption = Annotated[str, _option("scene")]
ScaleOption = Annotated[float, _option("scale")]
UnitOption = Annotated[str | None, _option("unit")]
ReflectivityOption = Annotated[float, _option("reflectivity")]
KluxOption = Annotated[str | None, _option("klux")]
BackgroundOption = Annotated[str, _option("background")]
SeedOption = Annotated[int, _option("seed")]
SpadOption = Annotated[list[str] | None, _option("spad")]
SpadGateOption = Annotated[bool, _option("spad_gate")]
ViewOption = Annotated[str, _option("view")]
MethodOption = Annotated[str, _option("method")]


@app.command()
def sim(
    scene: SceneOption = "sun-and-shade",
    unit: UnitOption = None,
    scale: ScaleOption = OPTIONS["scale"].default,
    reflectivity: ReflectivityOption = OPTIONS["reflectivity"].default,
    klux: KluxOption = None,
    background: BackgroundOption = OPTIONS["background"].default,
    pulses: Annotated[
        int | None,
        typer.Option(
            help=(
                "Laser pulses per frame; default: the configuration's. The controller's bounds and the photons of a frame change in proportion."
            ),
            show_default=False,
        ),
    ] = None,
    threshold: Annotated[
        int | None,
        typer.Option(
            help="One threshold for all subgroups in the frame `fixed`; default: the configuration's if it gives one, else the best of 1 to 7.",
            show_default=False,
        ),
    ] = None,
    frames: Annotated[
        int | None,
        typer.Option(help="Frames of new photons in which the controller settles; default: 8.", show_default=False),
    ] = None,
    link_gbps: Annotated[
        float | None,
        typer.Option(
            "--link-gbps",
            help="Rate of a stream's link; 0: 64 bits per cycle; default: the configuration's, else 8.",
            show_default=False,
        ),
    ] = None,
    config: ConfigOption = None,
    changes: SetOption = None,
    seed: SeedOption = OPTIONS["seed"].default,
    engine: Annotated[str | None, _option("engine", "sliced; with --waves verilator, with --view async icarus")] = None,
    out: Annotated[Path, typer.Option(metavar="DIR", help="Folder of the results.")] = Path("build/sim"),
    waves: Annotated[
        bool, typer.Option("--waves", help="Also write a waveform (FST) and views of it for GTKWave and Surfer.")
    ] = False,
    clock_mhz: ClockOption = None,
    spad: SpadOption = None,
    spad_gate: SpadGateOption = OPTIONS["spad_gate"].default,
    view: ViewOption = "polyphase",
) -> None:
    """Simulate frames of a scene and check every word against the golden model; write depth.png, events.npz and report.json."""
    from coincid.study.simulate import simulate

    settings = _config(config, changes, clock_mhz)
    if view == "async":
        engine = engine or "icarus"
        pulses = ASYNC_PULSES if pulses is None else pulses
        frames = ASYNC_FRAMES if frames is None else frames
    if pulses is not None:
        settings = settings.with_pulses(check_integer("pulses", pulses, 1, PULSES_MAX))
    if link_gbps is not None or not settings.frame["link_gbps"]:
        settings = settings.with_frame(link_gbps=LINK_GBPS if link_gbps is None else link_gbps)
    if "frame.format" not in settings.given:
        settings = settings.with_frame(format=LINK_FORMAT)
    simulate(
        scene,
        settings,
        klux=_klux(klux, scene),
        background=background,
        seed=seed,
        engine=engine or ("verilator" if waves else "sliced"),
        out=_folder(out),
        threshold=threshold,
        settling=frames if frames is None else check_integer("frames", frames, 1, FRAMES_MAX),
        waves=waves,
        spad=_spad(spad),
        spad_gate=spad_gate,
        scale=scale,
        unit=unit,
        reflectivity=reflectivity,
        console=Console(highlight=False),
        view=view,
    )


@app.command()
def advise(
    scene: Annotated[str, typer.Argument(metavar="SCENE", help=OPTIONS["scene"].doc)],
    unit: UnitOption = None,
    scale: ScaleOption = OPTIONS["scale"].default,
    reflectivity: ReflectivityOption = OPTIONS["reflectivity"].default,
    klux: KluxOption = None,
    background: BackgroundOption = OPTIONS["background"].default,
    config: ConfigOption = None,
    changes: SetOption = None,
    seed: SeedOption = OPTIONS["seed"].default,
    spad: SpadOption = None,
    out: Annotated[Path, typer.Option(metavar="DIR", help="Folder of table, picture and advised settings.")] = Path(
        "build/advise"
    ),
) -> None:
    """Try thresholds, windows, the controller, formats and links on a scene, and say which to take and what they cost."""
    import numpy as np
    from rich.table import Table

    from coincid.lab.setup import Setup, scene_of
    from coincid.model.light.spad import Spad
    from coincid.model.scenes.ambient import ambient_klux
    from coincid.study.advise import HEADS, write_advice
    from coincid.study.advise import advise as run
    from coincid.study.progress import Bar

    settings, light = _config(config, changes), _klux(klux, scene)
    looked_at = scene_of(settings, scene, scale=scale, unit=unit, reflectivity=reflectivity)
    _folder(out)
    setup = Setup(
        config=settings, scene=looked_at, klux=light, background=background, seed=seed, spad=_spad(spad) or Spad()
    )
    mean_klux = float(np.mean(ambient_klux(light, looked_at.rows, looked_at.cols) * looked_at.sunlit))
    with Bar(console, lines=True) as bar:
        stages: list[str] = []

        def progress(stage: str, done: int, total: int) -> None:
            if stage not in stages:
                stages.append(stage)
                bar.stage(stage, total)
            bar.done(done, total)

        advice = run(setup, klux=mean_klux, progress=progress)
        bar.stage("table and picture")
        files = write_advice(out, advice, looked_at.name)
    table = Table(box=None, header_style="bold", pad_edge=False)
    for head in HEADS:
        table.add_column(head, justify="right")
    for one in advice.tried:
        threshold, window_ns, packets, link_gbps, wrong, far, bits, dropped, load = one.row()
        told = f"{wrong:.1%}", f"{far:.1%}", f"{bits:,}", f"{dropped:.1%}", f"{load:.0%}"
        table.add_row(
            threshold,
            f"{window_ns:.3g}",
            packets,
            f"{link_gbps:g}",
            *told,
            style="bold" if one is advice.best else None,
        )
    shown = Console(highlight=False, width=None if sys.stdout.isatty() else 120)
    shown.print(table)
    for note in looked_at.notes:
        print(note)
    print(advice.sentence)
    print(" ".join(map(str, files)))


@app.command()
def show(
    config: Annotated[
        str | None, typer.Argument(metavar="[CONFIG]", help=f"TOML file, or a preset: {', '.join(PRESETS)}.")
    ] = None,
    changes: SetOption = None,
) -> None:
    """Print what a configuration means: sizes, rates, distances, the link's share, area and power; and what it wastes."""
    from coincid.study.explain import meaning, warnings

    settings = _config(config, changes)
    for name, value in meaning(settings):
        print(f"{name:16} {value}")
    for sentence in warnings(settings):
        print(f"* {sentence}")


@app.command()
def explore(
    port: Annotated[
        int | None, typer.Option(help="Port on this machine; default: 5006, or the next free one.", show_default=False)
    ] = None,
    no_browser: Annotated[bool, typer.Option("--no-browser", help="Only print the address.")] = False,
    settings: Annotated[
        list[str] | None,
        typer.Option(
            "--set",
            metavar="NAME=VALUE",
            help="First value of a control, or a picture: depth_file, colour_file, sun_file.",
            show_default=False,
        ),
    ] = None,
) -> None:
    """Serve the explorer, which shows the effect of every setting in the browser. It serves this machine only and sends no requests."""
    with extra("explore"):
        from coincid.study.explore.server import serve
    from coincid.study.explore.control_values import given_settings

    serve(port, browser=not no_browser, start=given_settings(settings or []))


@app.command()
def replay(
    edges: Annotated[Path, typer.Option(metavar="FILE", help="Edges (NPZ: pulse, pixel, tick).")],
    out: Annotated[Path, typer.Option(metavar="FILE", help="Result (NPZ); appears whole.")],
    config: ConfigOption = None,
    changes: SetOption = None,
    engine: Annotated[str | None, _option("engine", "golden; with --view async icarus")] = None,
    stall: Annotated[int, typer.Option(metavar="N", help="Keep tready low for the first N cycles of every frame.")] = 0,
    view: ViewOption = "polyphase",
    offset_seed: Annotated[
        int | None,
        typer.Option(
            metavar="SEED",
            help=(
                "With --view async: edges anywhere in their ticks, at random; default: the file's offset_ps, else the ticks' middles."
            ),
            show_default=False,
        ),
    ] = None,
) -> None:
    """Run an edge file through the golden model or the RTL and write what leaves the sensor."""
    from coincid.model.contract.edges import load_edges
    from coincid.model.contract.result import stall as low
    from coincid.model.contract.result import write_result
    from coincid.tb.replay import chosen_view
    from coincid.tb.replay import replay as run

    engine = engine or ("icarus" if view == "async" else "golden")
    check_integer("stall", stall, 0, STALL_CYCLES_MAX)
    settings = _config(config, changes)
    chosen_view(engine, view, settings.clock_mhz)
    pulses = settings.frames * settings.pulses
    given = load_edges(edges, pixels=settings.sensor.array_pixels, pulses=pulses, period_ticks=settings.period_ticks)
    _file(out)
    if offset_seed is not None:
        with extra("rtl"):
            from coincid.tb.stimulus import off_centre
        given = off_centre(settings, given, check_integer("offset_seed", offset_seed, 0, SEED_MAX))

    with _progress(pulses * settings.period, f"{len(given)} edges, {settings.frames} frames, {engine}") as bar:
        result = run(engine, settings, given, low(stall), bar.done, view=view)
    write_result(out, result)
    print(
        f"{out}: {len(result['pulse'])} events and {len(result['mg_pulse'])} minigroup records of {len(given)} edges, "
        f"{int(result['dropped'].sum())} events dropped"
    )


@app.command()
def sweep(
    spec: Annotated[
        Path, typer.Argument(metavar="SPEC", help="TOML file: a configuration, its scene and light, and axes to sweep.")
    ],
    out: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help=(
                "Result (Parquet); default: build/SPEC.parquet. Beside it: a plot (PNG), and the finished points, where a second start goes on."
            ),
            show_default=False,
        ),
    ] = None,
    scheduler: Annotated[
        str | None,
        typer.Option(
            metavar="ADDRESS",
            help=("Dask scheduler, such as tcp://HOST:8786; default: a cluster on this machine alone."),
            show_default=False,
        ),
    ] = None,
    workers: Annotated[
        int | None, typer.Option(help="Processes on this machine; default: one per core.", show_default=False)
    ] = None,
) -> None:
    """Run a grid of configurations, scenes and light on many processes or machines; one row per point."""
    workers = check_integer("workers", os.cpu_count() or 1 if workers is None else workers, 1, WORKERS_MAX)
    out = out or Path("build") / f"{spec.stem}.parquet"
    if out.suffix != ".parquet":
        raise InputError(f"out = {str(out)!r}: must end with .parquet")
    _file(out)
    from coincid.study.sweep_spec import read_spec

    grid = read_spec(spec)
    with extra("sweep"):
        from coincid.study.sweep import sweep as run
    with _progress(len(grid.keys), spec.name) as bar:
        summary = run(grid, out, workers=workers, scheduler=scheduler, title=spec.stem, progress=bar.done)
    for name, why in summary.failed.items():
        print(f"coincid: point {name}: {why}", file=sys.stderr)
    print(f"{out}: {summary.rows} of {len(grid.points)} points, {summary.kept} of them finished before")
    if summary.failed:
        raise typer.Exit(DIFFERS)


@app.command()
def photons(
    out: Annotated[Path, typer.Option(metavar="FILE", help="Edges: .npz, .csv, .h5 or (up to 64 pixels) .ptu.")],
    scene: SceneOption = OPTIONS["scene"].default,
    unit: UnitOption = None,
    scale: ScaleOption = OPTIONS["scale"].default,
    reflectivity: ReflectivityOption = OPTIONS["reflectivity"].default,
    klux: KluxOption = None,
    background: BackgroundOption = OPTIONS["background"].default,
    config: ConfigOption = None,
    changes: SetOption = None,
    seed: SeedOption = OPTIONS["seed"].default,
    spad: SpadOption = None,
    clock_mhz: ClockOption = None,
) -> None:
    """Write the photons of a scene, in all frames of a configuration, as edges."""
    from coincid.lab.setup import scene_of
    from coincid.model.light.photons import generate_edges
    from coincid.model.light.spad import Spad
    from coincid.model.light.timing import Timing
    from coincid.model.recorded.exchange import check_suffix, write_edges
    from coincid.model.scenes.scene import scene_light

    settings = _config(config, changes, clock_mhz)
    check_suffix(_file(out))
    timing, looked_at = (
        Timing.from_config(settings),
        scene_of(settings, scene, scale=scale, unit=unit, reflectivity=reflectivity),
    )
    pulses = settings.frames * settings.pulses
    made = generate_edges(
        scene_light(looked_at, _klux(klux, scene), background=background),
        _spad(spad) or Spad(),
        timing,
        pulses=pulses,
        seed=seed,
        workers=os.cpu_count() or 1,
    )
    write_edges(out, made, timing)
    for note in looked_at.notes:
        print(note)
    print(f"{out}: {len(made):,} edges of {pulses:,} pulses")


@app.command()
def edges(
    recording: Annotated[
        Path, typer.Argument(metavar="RECORDING", help="Photons: .ptu, .csv, .npz or .h5 (docs/recordings.md).")
    ],
    out: Annotated[Path, typer.Option(metavar="FILE", help="Edges: .npz, .csv, .h5 or (up to 64 pixels) .ptu.")],
    config: ConfigOption = None,
    changes: SetOption = None,
    channels: Annotated[
        str | None,
        typer.Option(
            metavar="MAP", help=("CHANNEL:PIXEL,... or a CSV file with these columns; default: channel k is pixel k.")
        ),
    ] = None,
    sync_channel: Annotated[
        int | None, typer.Option(metavar="N", help="Channel of the laser trigger, for recordings with absolute times.")
    ] = None,
    first_sync: Annotated[int, typer.Option(metavar="N", help="The trigger that becomes pulse 0.")] = 0,
    delay_ps: Annotated[
        float, typer.Option(metavar="PS", help="Delay between trigger and light; it is subtracted from every time.")
    ] = 0.0,
    clock_mhz: ClockOption = None,
) -> None:
    """Turn recorded photons into edges, or edges into another format; count what falls out of range."""
    from coincid.model.light.timing import Timing
    from coincid.model.recorded.exchange import check_suffix, parse_channels, read_recording, write_edges
    from coincid.model.recorded.recordings import period_note, recorded_edges, told

    settings = _config(config, changes, clock_mhz)
    check_suffix(_file(out))
    timing = Timing.from_config(settings)
    pixel_of = None if channels is None else parse_channels(channels)
    recorded = read_recording(recording, sync_channel)
    try:
        kept, lost = recorded_edges(
            recorded, settings, timing, channels=pixel_of, first_sync=first_sync, delay_ps=delay_ps
        )
    except InputError as error:
        raise InputError(f"{recording}: {error}") from None
    write_edges(out, kept, timing)
    print(f"{recording}: {recorded.kind}, {len(recorded.sync):,} photons")
    for note in filter(None, (period_note(recorded, timing), f"left out: {told(lost)}" if lost else "")):
        print(note)
    print(f"{out}: {len(kept):,} edges")


@app.command()
def verilog(
    out: Annotated[
        Path, typer.Option(metavar="DIR", help="Folder; appears whole, and replaces an earlier export.")
    ] = Path("build/rtl"),
    config: ConfigOption = None,
    changes: SetOption = None,
    view: ViewOption = "polyphase",
) -> None:
    """Export the synthesizable Verilog, one file per block, with file lists, constraints, register map and smoke test."""
    settings = _config(config, changes)
    with extra("rtl"):
        from coincid.flow.release import write_release
    files = write_release(out, settings, view)
    print(f"{out}: {len(files)} files, {sum(path.stat().st_size for path in files) / 1000:.0f} kB")


@app.command()
def synth(
    out: Annotated[Path, typer.Option(metavar="FILE", help="Markdown page with the cost of the presets.")] = Path(
        "docs/synthesis.md"
    ),
) -> None:
    """Synthesize both presets to gates, standard cells and ECP5, and write the table of their cost."""
    with extra("rtl"):
        from coincid.flow.synth import write_page
    write_page(_file(out))
    print(out)


@app.command()
def gls() -> None:
    """Simulate the netlists of a small sensor, in gates and in standard cells, against the golden model."""
    with extra("rtl"):
        from coincid.flow.gls import gate_levels
    for line in gate_levels():
        print(line, flush=True)


@app.command()
def power(
    out: Annotated[
        Path, typer.Option(metavar="FILE", help="Markdown page; the picture goes to images/ beside it.")
    ] = Path("docs/power.md"),
) -> None:
    """Measure the power of a subgroup in standard cells against the light on it, from frames that its netlist plays."""
    with extra("rtl"):
        from coincid.study.power_against_light import write_page
    write_page(_file(out), partial(print, flush=True))
    print(out)


@app.command()
def layout(
    out: Annotated[
        Path, typer.Option(metavar="FILE", help="Markdown page; the picture goes to images/ beside it.")
    ] = Path("docs/layout.md"),
) -> None:
    """Lay a minigroup out in standard cells: placed, routed, checked, timed with its wires, and simulated with their delays."""
    with extra("rtl"):
        from coincid.flow.layout.document import write_page
    write_page(_file(out), partial(print, flush=True))
    print(out)


@app.command()
def pnr(
    out: Annotated[Path, typer.Option(metavar="FILE", help="Markdown report of Fmax and resources.")] = Path(
        "docs/place-and-route.md"
    ),
) -> None:
    """Place and route a module of the FPGA preset on an ECP5, with five seeds. Exit code 1: a clock misses its goal."""
    with extra("rtl"):
        from coincid.flow import boards, pnr

    _file(out)
    board = boards.fpga_module()
    placements = pnr.place(board)
    pnr.write_page(board, placements, out)
    print(out)
    _all_met(pnr.missed(board, placements))


def _all_met(missed: list[str]) -> None:
    """Tells every goal that was missed, and ends with exit code 1 where one was."""
    for line in missed:
        print(f"coincid: {line}", file=sys.stderr)
    if missed:
        raise typer.Exit(DIFFERS)


@app.command()
def emulator(
    kind: Annotated[
        str,
        typer.Argument(
            metavar="[KIND]", help="ulx3s: Verilog and bitstream for that board; serial, axi: Verilog alone, linted."
        ),
    ] = "ulx3s",
    config: Annotated[
        str | None,
        typer.Option(
            "--config",
            metavar="FILE",
            help="TOML file or preset; default: emulator, and emulator-axi for axi.",
            show_default=False,
        ),
    ] = None,
    changes: SetOption = None,
    buffer_beats: Annotated[int, typer.Option(metavar="N", help="Of the frame buffer.")] = 8192,
    out: Annotated[Path, typer.Option(metavar="DIR", help="Folder of Verilog, register map and bitstream.")] = Path(
        "build/emulator"
    ),
    page: Annotated[Path, typer.Option(metavar="FILE", help="Of ulx3s: Markdown report of Fmax and use.")] = Path(
        "docs/emulator-board.md"
    ),
) -> None:
    """Build the emulator for a board. Exit code 1: lint found something, or a clock is missed with one of five seeds."""
    from coincid.model.contract.emulator import Emulator

    with extra("rtl"):
        from coincid.flow import boards, emulator_release, lint, pnr
    on_bus, on_board = kind == emulator_release.AXI, kind == emulator_release.BOARD
    _file(page)
    settings = _config(config or ("emulator-axi" if on_bus else "emulator"), changes)
    files = emulator_release.emulator_release(settings, kind, buffer_beats)
    written = emulator_release.write_emulator(_folder(out), files)
    print(f"{out}: {len(written)} files, {sum(path.stat().st_size for path in written) / 1000:.0f} kB")
    found = lint.lint_emulator(files, emulator_release.TOPS[kind])
    for tool, complaints in found.items():
        print(f"{tool}: {'clean' if not complaints else 'found'}")
        print(complaints, end="")
    if any(found.values()):
        raise typer.Exit(DIFFERS)
    if on_board:
        board = boards.ulx3s(settings, Emulator.of(settings, buffer_beats))
        placements = pnr.place(board)
        bitstream = out / f"{board.top}.bit"
        bitstream.write_bytes(pnr.fastest(placements).bitstream.read_bytes())
        pnr.write_page(board, placements, page)
        print(f"{bitstream}\n{page}")
        _all_met(pnr.missed(board, placements))


@app.command()
def cost(
    out: Annotated[Path, typer.Option(metavar="DIR", help="Folder of the table and the picture.")] = Path(
        "docs/images"
    ),
) -> None:
    """Draw area, bits of an event and readout rate against the paper's parameters."""
    with extra("rtl"):
        from coincid.study.cost import write_pages
    for line in write_pages(_folder(out)):
        print(line)


@app.command()
def lint(config: ConfigOption = None, changes: SetOption = None, view: ViewOption = "polyphase") -> None:
    """Check the exported Verilog with Verilator's lint, and with Icarus if it is installed."""
    settings = _config(config, changes)
    with extra("rtl"):
        from coincid.flow.lint import lint as run
        from coincid.hdl.front_end_views import view_at
    found = run(settings.sensor, view_at(view, settings.clock_mhz))
    for tool, complaints in found.items():
        print(f"{tool}: {'clean' if not complaints else 'found'}")
        print(complaints, end="")
    if any(found.values()):
        raise typer.Exit(DIFFERS)


@app.command()
def formal(
    names: Annotated[
        list[str] | None, typer.Argument(metavar="[NAMES]", help="Proofs; default: all.", show_default=False)
    ] = None,
) -> None:
    """Prove the RTL's properties for all inputs and all time; takes a few minutes."""
    with extra("rtl"):
        from coincid.formal.prove import HEAD, prove
    print(HEAD)
    verdicts = prove(names or (), tell=print)
    failed = [verdict for verdict in verdicts if verdict.reason]
    for verdict in failed:
        print(f"coincid: {verdict.proof.name}: {verdict.reason}; log: {verdict.folder / 'log'}", file=sys.stderr)
    print(f"{len(verdicts) - len(failed)} of {len(verdicts)} proofs hold")
    if failed:
        raise typer.Exit(DIFFERS)


@app.command()
def budget(
    distance_m: Annotated[float, typer.Option(help="Distance of the target in metres.")] = 4.0,
    reflectivity: Annotated[float, typer.Option(help="Reflectivity of the target, 0 to 1.")] = 0.4,
    klux: Annotated[float, typer.Option(help="Sunlight in klux.")] = 50.0,
    spectrum: Annotated[
        str | None, typer.Option(metavar="SPECTRUM", help="am15g or planck; default: am15g.", show_default=False)
    ] = None,
    form: Annotated[
        str, typer.Option(metavar="FORM", help="literal (as printed in the paper) or corrected.")
    ] = "literal",
    json: Annotated[bool, typer.Option("--json", help="Flat keys, for programs.")] = False,
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
        print(f"{name:22} {value if isinstance(value, str) else format(value, '.6g'):>12} {unit:6} {source}")


@app.command()
def figures(
    out: Annotated[Path, typer.Option(metavar="DIR", help="Folder of the figures.")] = Path("build/figures"),
    rtl: Annotated[bool, typer.Option("--rtl", help="Add the RTL as a source to figures 6 and 8.")] = False,
) -> None:
    """Draw the paper's figures from the analytic model, Monte Carlo and, on request, the RTL."""
    from coincid.study.figures import make

    _folder(out)
    with _progress(0, "frames") as bar:
        files = make(out, "sliced" if rtl else None, bar.done)
    print(files[-1])


@app.command()
def compare(
    out: Annotated[Path, typer.Option(metavar="DIR", help="Folder of the figures.")] = Path("build/compare"),
) -> None:
    """Compare the sensor with other schemes on the same photons: plots, their data (CSV) and a page."""
    from coincid.study.figures import compare as run

    _folder(out)
    with _progress(0, "photons") as bar:
        files = run(out, bar.done)
    print(files[-1])


@app.command()
def modes(
    out: Annotated[Path, typer.Option(metavar="DIR", help="Folder of the figures.")] = Path("build/modes"),
    rtl: Annotated[bool, typer.Option("--rtl", help="Check some frames on the RTL.")] = False,
) -> None:
    """Compare coincidence and gating over background and distance, behind glass and at 100 m: plots, data (CSV) and a page."""
    from coincid.study.figures import modes as run

    _folder(out)
    with _progress(0, "frames") as bar:
        files = run(out, "sliced" if rtl else None, bar.done)
    print(files[-1])


@app.command()
def bandwidth(
    klux: Annotated[
        list[float] | None, typer.Option(help="Background light in klux; repeatable.", show_default=False)
    ] = None,
    threshold: Annotated[
        list[int] | None, typer.Option(help="Coincidence threshold; repeatable.", show_default=False)
    ] = None,
    size: Annotated[
        list[str] | None, typer.Option(help="32x32, 64x64, 256x128; repeatable.", show_default=False)
    ] = None,
    out: Annotated[Path, typer.Option(metavar="DIR", help="Folder of the CSV, the table and the plot.")] = Path(
        "build/bandwidth"
    ),
) -> None:
    """Study the readout: beats per frame, streams needed, and losses with fewer, by an estimate and by the golden model."""
    from coincid.study.bandwidth import TABLE, study, write_study

    write_study(_folder(out), study(klux, threshold, size, tell=console.print))
    print((out / TABLE).read_text(), end="")


@app.command()
def emulate(
    port: Annotated[
        str | None,
        typer.Option(metavar="DEVICE", help="Serial port of the board, such as /dev/ttyUSB0.", show_default=False),
    ] = None,
    simulate: Annotated[
        bool, typer.Option("--simulate", help="Use the emulator's simulated RTL behind its serial pins instead.")
    ] = False,
    netlist: Annotated[
        bool, typer.Option("--netlist", help="With --simulate: the netlist of the FPGA of an ULX3S instead of the RTL.")
    ] = False,
    scene: Annotated[str, typer.Option(metavar="SCENE", help="As of sim.")] = "five-objects",
    klux: KluxOption = None,
    config: Annotated[
        str,
        typer.Option("--config", metavar="FILE", help="TOML file or preset; its sensor must be the one on the board."),
    ] = "emulator",
    changes: SetOption = None,
    frames: Annotated[int, typer.Option(metavar="N", help="Frames to take.")] = 20,
    pulses: Annotated[
        int | None,
        typer.Option(metavar="N", help="Laser pulses per frame; default: the configuration's.", show_default=False),
    ] = None,
    seed: Annotated[int, typer.Option(help="Of the photon source.")] = 1,
    baud: Annotated[
        int | None,
        typer.Option(
            help="Of the serial line; default: 3,000,000, and simulated as fast as it can be.", show_default=False
        ),
    ] = None,
    out: Annotated[Path, typer.Option(metavar="DIR", help="Folder of the depth picture.")] = Path("build/emulate"),
) -> None:
    """Run the emulator, on a board or simulated, and check each word from it against the golden model."""
    from coincid.host.emulator_driver import EmulatorDriver
    from coincid.host.serial_transport import SerialPort, SerialTransport
    from coincid.lab.setup import scene_of
    from coincid.model.contract.serial_link import BAUD
    from coincid.model.contract.settings import FRAMES_MAX
    from coincid.study.emulate import DEPTH
    from coincid.study.emulate import emulate as run

    if (port is None) is not simulate:
        raise InputError("port: give either --port DEVICE or --simulate")
    if netlist and not simulate:
        raise InputError("netlist: goes with --simulate only")
    check_integer("frames", frames, 1, FRAMES_MAX)
    settings = _config(config, changes)
    if pulses is not None:
        settings = settings.with_frame(pulses=pulses)
    looked_at = scene_of(settings, scene)
    if simulate:
        with extra("rtl"):
            from coincid.flow.gls import emulator_netlist
            from coincid.tb.verilated_emulator import PATIENCE_S, SIMULATED_CLOCKS_PER_BIT, SimulatedPort, simulated
        clocks = (
            SIMULATED_CLOCKS_PER_BIT
            if baud is None
            else round(settings.clock_mhz * 1e6 / check_integer("baud", baud, 1, BAUD_MAX))
        )
        built, library = (
            emulator_netlist(settings, clocks_per_bit=clocks)
            if netlist
            else (simulated(settings.sensor, clocks_per_bit=clocks), None)
        )
        line: Any = SimulatedPort(built, settings.clock_mhz, library)
        patience: dict[str, Any] = {"patience_s": PATIENCE_S * clocks / SIMULATED_CLOCKS_PER_BIT}
    else:
        line, patience = SerialPort(str(port), BAUD if baud is None else baud), {}
    with line, _progress(frames, "frames") as bar:
        driver = EmulatorDriver(SerialTransport(line, **patience))
        tally = run(
            driver,
            settings,
            looked_at,
            _folder(out),
            klux=_klux(klux, scene),
            frames=frames,
            seed=seed,
            tell=lambda so_far: bar.done(so_far.frames),
        )
        repeats = driver.transport.repeats  # type: ignore[attr-defined]
        if simulate:
            print(f"{tally.seconds_on_line / tally.frames * 1e3:.3g} ms of simulated time per frame")
    print(f"{tally.frames} frames, {tally.beats} words, all as the golden model predicts")
    print(
        f"{tally.frames / tally.seconds:.3g} frames per second; {repeats} requests repeated, {tally.recoveries} recoveries"
    )
    print(out / DEPTH)


@app.command()
def bench(
    out: Annotated[Path, typer.Option(metavar="FILE", help="JSON, flat keys; a Markdown table goes beside it.")] = Path(
        "build/bench.json"
    ),
    repeats: Annotated[int, typer.Option(metavar="N", help="Number of rounds; the results are medians.")] = 5,
) -> None:
    """Measure the speed of the model, the simulators, whole frames and builds from scratch; takes about ten minutes."""
    with extra("rtl"):
        from coincid.study.bench import benchmark, table
    check_integer("repeats", repeats, 1, REPEATS_MAX)
    print(table(benchmark(_file(out), repeats=repeats, tell=console.print)), end="")


def _klux(given: str | None, scene: str) -> str | float:
    """Return the ambient light of a scene: the given one, else the usual one for the scene."""
    from coincid.model.scenes.catalogue import usual_klux

    return usual_klux(scene) if given is None else given


def _spad(given: list[str] | None) -> Any:
    """Return the detector with properties NAME=VALUE; None if there are none."""
    if not given:
        return None
    from attrs import fields_dict

    from coincid.model.light.spad import Spad

    values: dict[str, Any] = {}
    for text in given:
        name, _, value = text.partition("=")
        if name not in fields_dict(Spad):
            raise InputError(f"--spad {text}: must be NAME=VALUE with a name of {', '.join(fields_dict(Spad))}")
        try:
            values[name] = value == "true" if isinstance(fields_dict(Spad)[name].default, bool) else float(value)
        except ValueError:
            raise InputError(f"--spad {text}: must be a number") from None
    return Spad(**values)


def _config(path: str | None, changes: list[str] | None = None, clock_mhz: float | None = None) -> "Config":
    """Return the configuration with the settings of the command line."""
    from coincid.model.contract.config import changes_of_text, load_config

    config = load_config(path, changes_of_text(changes or []))
    return config if clock_mhz is None else config.with_frame(clock_mhz=clock_mhz)


def _file(path: Path) -> Path:
    """Return `path` if a file can be made there; make nothing."""
    if path.is_dir():
        raise InputError(f"out = {str(path)!r}: is a folder, must be a file")
    _writable(path, path.parent)
    return path


def _folder(path: Path) -> Path:
    """Return `path` if it is, or can become, a folder to write to; make nothing."""
    _writable(path, path)
    return path


def _writable(path: Path, folder: Path) -> None:
    nearest = next(parent for parent in (folder, *folder.absolute().parents) if os.path.exists(parent))
    if not nearest.is_dir() or not os.access(nearest, os.W_OK | os.X_OK):
        why = "not writable" if nearest.is_dir() else "no folder"
        raise InputError(f"out = {str(path)!r}: cannot be written: {nearest} is {why}")


@contextlib.contextmanager
def _progress(cycles: int, what: str) -> "Iterator[Bar]":
    """Return a progress bar on a terminal, otherwise one that shows nothing."""
    from coincid.study.progress import Bar

    with Bar(console) as bar:
        bar.stage(what, cycles)
        yield bar


def main() -> None:
    """Entry point of the console script."""
    interruptible()
    try:
        app()
    except KeyboardInterrupt as why:
        sys.exit(_code(why))
