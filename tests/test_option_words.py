# SPDX-License-Identifier: Apache-2.0
"""Every option of every command changes what is done: none is read and forgotten.

The work itself is left out. Each command is called with one option after the other, and what its
work is given, or what it prints, must differ from that without the option.
"""

import os
import re
from contextlib import nullcontext
from types import SimpleNamespace

import numpy as np
import pytest
import typer

from coincid.board import driver, netlist, serial_link, serial_transport, simulated
from coincid.board import release as board_release
from coincid.board import run as board_run
from coincid.cli import app
from coincid.flow import fpga_module, lint, pnr, release, synth
from coincid.flow.layout import tools as layout_tools
from coincid.formal import prove
from coincid.lab import setup as lab_setup
from coincid.lab.setup import SETTLING, Setup, fixed_thresholds
from coincid.model.contract import edges as contract_edges
from coincid.model.contract import result as contract_result
from coincid.model.contract.config import Config
from coincid.model.contract.edges import Edges
from coincid.model.contract.packet import BEAT_BITS
from coincid.model.contract.parameters import Sensor
from coincid.model.depth.arrivals import SYSTEM_FWHM_S
from coincid.model.light.spectrum import SPECTRA
from coincid.model.recorded import exchange, recordings
from coincid.model.scenes.catalogue import load_scene, usual_klux
from coincid.study import advise, bench, simulate, sweep, sweep_spec
from coincid.study.explore import server
from coincid.tb import replay

from .command import command
from .needs import imported

document = imported("layout", "coincid.flow.layout.document")
SMALL = "--set rows=8 --set cols=8 --set pulses=4 --set period=60"
NONE = np.zeros(0, np.int64)
NO_EDGES = Edges(NONE, NONE, NONE)
WORDS = {  # name of the parameter: words that differ from its default
    "scene": "--scene letter-f",
    "unit": "--unit cm",
    "scale": "--scale 2",
    "missing": "--missing 7",
    "sky_m": "--sky 50",
    "z": "--z",
    "fov_deg": "--fov 30",
    "channel": "--channel Z",
    "bin_ps": "--bin-ps 50",
    "recorded_pulses": "--recorded-pulses 9",
    "reflectivity": "--reflectivity 0.3",
    "klux": "--klux 7",
    "background": "--background even",
    "pulse": "--pulse {pulse}",
    "pulses": "--pulses 5",
    "threshold": "--threshold 3",
    "frames": "--frames 3",
    "link_gbps": "--link-gbps 0",
    "config": "--config fpga",
    "changes": "--set threshold=5",
    "seed": "--seed 7",
    "engine": "--engine golden",
    "out": "--out {out}",
    "waves": "--waves",
    "clock_mhz": "--clock-mhz 400",
    "spad": "--spad dead_time_s=2e-9",
    "spad_gate": "--spad-gate",
    "view": "--view async",
    "channels": "--channels 5:6",
    "sync_channel": "--sync-channel 3",
    "sync_divider": "--sync-divider 4",
    "first_sync": "--first-sync 2",
    "delay_ps": "--delay-ps 11",
    "stall": "--stall 12",
    "offset_seed": "--offset-seed 4",
    "edges": "--edges other.npz",
    "prefix": "--prefix near_",
    "distance_m": "--distance-m 5",
    "spectrum": "--spectrum planck",
    "form": "--form corrected",
    "json": "--json",
    "scheduler": "--scheduler tcp://a:8786",
    "workers": "--workers 3",
    "port": "--port 5007",
    "no_browser": "--no-browser",
    "repeats": "--repeats 2",
    "buffer_beats": "--buffer-beats 4096",
    "page": "--page page.md",
    "baud": "--baud 9600",
    "netlist": "--netlist",
}
COMMANDS = {  # name: words without which it does not begin
    "sim": "",
    "advise": "flat:5",
    "photons": "--out a.npz",
    "edges": "a.csv --out a.npz",
    "replay": "--edges a.npz --out a.npz",
    "show": "silicon",
    "explore": "",
    "sweep": "a.toml",
    "verilog": "--out a",
    "synth": "",
    "layout": "",
    "pnr": "",
    "emulator": "serial",
    "lint": "",
    "formal": "tree",
    "budget": "",
    "emulate": "--simulate",
    "bench": "",
}
PLAIN = {"sweep", "synth", "layout", "pnr", "formal", "budget", "bench", "explore"}  # without --set
ARGUMENTS = {  # no options
    ("advise", "scene"): "letter-f",
    ("edges", "recording"): "b.csv",
    ("show", "config"): "fpga",
    ("sweep", "spec"): "b.toml",
    ("emulator", "kind"): "axi",
    ("formal", "names"): "sequencer",
    ("emulate", "port"): "--port a",
    ("emulate", "simulate"): "--port a",
}
NEEDS = {"layout": "layout"}  # name: what it needs beside `make test`
ELSEWHERE = {("emulator", "page")}  # behind a placement
OTHERS = {  # words of a command that differ from those of `WORDS`
    ("replay", "engine"): "--engine sliced",  # the usual one is the golden model
    ("sweep", "out"): "--out b.parquet",
    ("explore", "changes"): "--set klux=9",
    ("emulate", "config"): "--config emulator-axi",
    ("emulator", "config"): "--config emulator-axi",
}
ALL = typer.main.get_command(app).commands
PARAMETERS = {name: [one.name for one in ALL[name].params] for name in COMMANDS}


class DoneError(Exception):
    """The work begins."""


def told(value):
    """Return a text that tells all of a value."""
    if isinstance(value, Setup):
        return value.key
    if isinstance(value, Config):
        return repr((value.register_writes(), value.sensor, value.frame, value.given))
    if isinstance(value, Edges):
        return repr((len(value), value.offset_ps))
    return re.sub(r" at 0x\w+", "", repr(value))  # wherever in memory it is


@pytest.fixture
def work(monkeypatch, tmp_path):
    """Return what the work of a command was given, in texts; it is not done."""
    given = []

    def note(*values, **named):
        given.extend(map(told, values))
        given.extend(f"{name}={told(value)}" for name, value in sorted(named.items()))

    def begin(*values, **named):
        note(*values, **named)
        raise DoneError

    def scene_of(config, source, **described):
        note(source, **described)
        return load_scene("flat:5", config.sensor.rows, config.sensor.cols)

    def noted_then(result):
        def work(*values, **named):
            note(*values, **named)
            return result

        return work

    def photons(setup):
        note(setup)
        return SimpleNamespace(edges=lambda workers: NO_EDGES)

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(os, "cpu_count", lambda: 2)
    monkeypatch.setattr(lab_setup, "scene_of", scene_of)
    monkeypatch.setattr(Setup, "photons", property(photons))
    monkeypatch.setattr(simulate, "simulate_to_folder", begin)
    monkeypatch.setattr(advise, "advise", noted_then("an advice"))
    monkeypatch.setattr(advise, "write_advice", begin)
    monkeypatch.setattr(exchange, "write_edges", begin)
    recorded = SimpleNamespace(kind="a table", sync=NONE)
    monkeypatch.setattr(exchange, "read_recording", noted_then(recorded))
    monkeypatch.setattr(recordings, "recorded_edges", noted_then((NO_EDGES, {})))
    monkeypatch.setattr(contract_edges, "load_edges", noted_then(NO_EDGES))
    monkeypatch.setattr(replay, "replay", noted_then("a result"))
    monkeypatch.setattr(contract_result, "write_result", begin)
    monkeypatch.setattr(server, "serve", begin)
    monkeypatch.setattr(sweep_spec, "read_spec", noted_then(SimpleNamespace(keys=())))
    monkeypatch.setattr(sweep, "sweep", begin)
    monkeypatch.setattr(release, "write_release", begin)
    monkeypatch.setattr(synth, "write_synthesis_page", begin)
    monkeypatch.setattr(layout_tools, "layout_cells", noted_then(None))
    if document:
        monkeypatch.setattr(document, "write_layout_page", begin)
    monkeypatch.setattr(fpga_module, "fpga_module", noted_then("a board"))
    monkeypatch.setattr(pnr, "place", noted_then(()))
    monkeypatch.setattr(pnr, "write_placement_page", begin)
    monkeypatch.setattr(board_release, "emulator_release", noted_then({}))
    monkeypatch.setattr(board_release, "write_emulator", begin)
    monkeypatch.setattr(lint, "lint", begin)
    monkeypatch.setattr(prove, "prove", begin)
    monkeypatch.setattr(bench, "benchmark", begin)
    monkeypatch.setattr(simulated, "simulated", noted_then("RTL"))
    monkeypatch.setattr(netlist, "emulator_netlist", noted_then(("netlist", "library")))
    monkeypatch.setattr(simulated, "SimulatedPort", noted_then(nullcontext("a simulation")))
    monkeypatch.setattr(serial_transport, "SerialPort", noted_then(nullcontext("a line")))
    monkeypatch.setattr(serial_transport, "SerialTransport", noted_then("a transport"))
    monkeypatch.setattr(driver, "EmulatorDriver", noted_then("a driver"))
    monkeypatch.setattr(board_run, "emulate", begin)
    return given


def begun(work, words):
    """Return what the work is given for these words, or what is printed instead of any work."""
    work.clear()
    result = command(words)
    assert result.exit_code == 0 or isinstance(result.exception, DoneError), result.output
    return [*work, result.output]


def test_every_command_with_options_is_here():
    assert {name for name, one in ALL.items() if one.params} == set(COMMANDS)


@pytest.mark.parametrize(
    ("name", "parameter"),
    [
        pytest.param(name, one, marks=[pytest.mark.needs(NEEDS[name])] if name in NEEDS else [])
        for name in COMMANDS
        for one in PARAMETERS[name]
        if (name, one) not in ELSEWHERE
    ],
)
def test_every_option_changes_what_is_done(work, tmp_path, name, parameter):
    usual, changed = words_of(name, parameter, tmp_path)
    assert begun(work, changed) != begun(work, usual)


def words_of(name, parameter, tmp_path):
    """Return the words of a command without an option and with it."""
    pulse = tmp_path / "pulse.csv"
    pulse.write_text("time_ps,density\n0,0\n100,1\n300,0\n", encoding="utf-8")
    usual = f"{name} {COMMANDS[name]}{'' if name in PLAIN else f' {SMALL}'}"
    if parameter == "offset_seed":
        usual += " --view async"
    if (name, parameter) in ARGUMENTS:
        changed = usual.replace(COMMANDS[name].split()[0], ARGUMENTS[name, parameter])
    else:
        changed = f"{usual} {OTHERS.get((name, parameter), WORDS[parameter])}"
    out = tmp_path / ("b.npz" if "a.npz" in usual else "folder")
    return usual, changed.format(pulse=pulse, out=out)


OF_FILES = {  # of a file of a scene: what is told without the option, and with that of `WORDS`
    "unit": ("unit=None", "unit='cm'"),
    "scale": ("scale=1.0", "scale=2.0"),
    "missing": ("missing=None", "missing=[7.0]"),
    "sky_m": ("sky_m=None", "sky_m=50.0"),
    "z": ("z=False", "z=True"),
    "fov_deg": ("fov_deg=None", "fov_deg=30.0"),
    "channel": ("channel=None", "channel='Z'"),
    "bin_ps": ("bin_ps=None", "bin_ps=50.0"),
    "recorded_pulses": ("recorded_pulses=None", "recorded_pulses=9"),
    "reflectivity": ("reflectivity=0.4", "reflectivity=0.3"),
}
ARRIVING = {
    (name, one): told for name in ("sim", "advise", "photons") for one, told in OF_FILES.items()
} | {
    ("sim", "threshold"): ("threshold=None", "threshold=3"),
    ("sim", "frames"): ("settling=None", "settling=3"),
    ("sim", "waves"): ("waves=False", "waves=True"),
    ("explore", "port"): ("None", "5007"),
    ("explore", "no_browser"): ("browser=True", "browser=False"),
    ("replay", "engine"): ("'golden'", "'sliced'"),
    ("replay", "view"): ("view='polyphase'", "view='async'"),
    ("sweep", "scheduler"): ("scheduler=None", "scheduler='tcp://a:8786'"),
    ("sweep", "workers"): ("workers=2", "workers=3"),
    ("edges", "first_sync"): ("first_sync=0", "first_sync=2"),
    ("edges", "delay_ps"): ("delay_ps=0.0", "delay_ps=11.0"),
    ("edges", "channels"): ("channels=None", "channels={5: 6}"),
    ("verilog", "view"): ("'polyphase'", "'async'"),
    ("verilog", "prefix"): ("''", "'near_'"),
    ("formal", "names"): ("['tree']", "['sequencer']"),
    ("emulate", "frames"): ("frames=20", "frames=3"),
    ("emulate", "seed"): ("seed=1", "seed=7"),
    ("emulator", "buffer_beats"): ("8192", "4096"),
    ("bench", "repeats"): ("repeats=5", "repeats=2"),
}


@pytest.mark.parametrize(("name", "parameter"), ARRIVING)
def test_the_value_of_an_option_arrives_as_it_was_typed(work, tmp_path, name, parameter):
    """A switch is not turned round, and a default is the one that is told."""
    for words, told in zip(
        words_of(name, parameter, tmp_path), ARRIVING[name, parameter], strict=True
    ):
        given = begun(work, words)
        alike = told.partition("=")[0]
        assert told in given, [one for one in given if one.startswith(alike)] or given


def test_the_trigger_of_a_recording_is_told_with_its_channel_before_its_divider(work):
    """Each may be given without the other one."""
    usual = f"edges a.csv --out a.npz {SMALL}"
    for words, told in (
        ("--sync-channel 3", ["3", "None"]),
        ("--sync-divider 4", ["None", "4"]),
        ("--sync-channel 3 --sync-divider 4", ["3", "4"]),
    ):
        given = begun(work, f"{usual} {words}")
        at = given.index("PosixPath('a.csv')")
        assert given[at + 1 : at + 3] == told


KLUX = [usual_klux(*of) for of in (("tunnel",), ("a.npy", 50.0), ("flat:5",))]
DEFAULTS = {  # what is said to be done without an option
    ("sim", "threshold"): f"the best of 1 to {fixed_thresholds(Sensor())[-1]}.",
    ("sim", "frames"): f"default: {SETTLING + 1}, or one for each picture",
    ("sim", "link_gbps"): f"0: {BEAT_BITS} bits per cycle; default: the configuration's, "
    f"otherwise {simulate.LINK_GBPS:g}.",
    ("sim", "klux"): "Default: {:g} for sun-and-shade and tunnel, {:g} for histograms, "
    "otherwise {:g}.".format(*KLUX),
    ("sim", "pulse"): f"Default: a Gaussian of {SYSTEM_FWHM_S * 1e12:g} ps.",
    ("sim", "engine"): "; default: sliced; with --waves verilator, with --view async icarus.",
    ("replay", "engine"): "; default: golden; with --view async icarus.",
    ("explore", "port"): f"default: {server.PORT}, or the next free one.",
    ("emulate", "baud"): f"default: {serial_link.BAUD:,} on a board",
    ("budget", "spectrum"): f"{', '.join(SPECTRA[:-1])} or {SPECTRA[-1]}; default: {SPECTRA[0]}.",
}


@pytest.mark.parametrize(("name", "parameter"), DEFAULTS)
def test_help_tells_the_defaults_that_hold(name, parameter):
    (told,) = [one.help for one in ALL[name].params if one.name == parameter]
    assert DEFAULTS[name, parameter] in told
