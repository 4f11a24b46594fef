# SPDX-License-Identifier: Apache-2.0
"""Every option of the commands that simulate changes what is done: none is read and forgotten.

The work itself is left out. Each command is called with one option after the other, and what its
work is given must differ from what it is given without the option.
"""

import re
from types import SimpleNamespace

import numpy as np
import pytest
import typer

from coincid.cli import app
from coincid.lab import setup as lab_setup
from coincid.lab.setup import Setup
from coincid.model.contract import edges as contract_edges
from coincid.model.contract import result as contract_result
from coincid.model.contract.config import Config
from coincid.model.contract.edges import Edges
from coincid.model.recorded import exchange, recordings
from coincid.model.scenes.catalogue import load_scene
from coincid.study import advise, simulate
from coincid.tb import replay

from .command import command

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
}
COMMANDS = {  # name: words without which it does not begin
    "sim": "",
    "advise": "flat:5",
    "photons": "--out a.npz",
    "edges": "a.csv --out a.npz",
    "replay": "--edges a.npz --out a.npz",
}
ARGUMENTS = {("advise", "scene"): "letter-f", ("edges", "recording"): "b.csv"}  # no options
ENGINE_OF = {"replay": "--engine sliced"}  # where the usual one is the golden model
PARAMETERS = {
    name: [one.name for one in typer.main.get_command(app).commands[name].params]
    for name in COMMANDS
}


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
    return given


def begun(work, words):
    """Return what the work is given for these words."""
    work.clear()
    result = command(words)
    assert isinstance(result.exception, DoneError), result.output
    return list(work)


@pytest.mark.parametrize(
    ("name", "parameter"), [(name, one) for name in COMMANDS for one in PARAMETERS[name]]
)
def test_every_option_changes_what_is_done(work, tmp_path, name, parameter):
    pulse = tmp_path / "pulse.csv"
    pulse.write_text("time_ps,density\n0,0\n100,1\n300,0\n", encoding="utf-8")
    usual = f"{name} {COMMANDS[name]} {SMALL}"
    if parameter == "offset_seed":
        usual += " --view async"
    if (name, parameter) in ARGUMENTS:
        changed = usual.replace(COMMANDS[name].split()[0], ARGUMENTS[name, parameter])
    elif parameter == "engine":
        changed = f"{usual} {ENGINE_OF.get(name, WORDS[parameter])}"
    else:
        changed = f"{usual} {WORDS[parameter]}"
    out = tmp_path / ("b.npz" if "a.npz" in usual else "folder")
    changed = changed.format(pulse=pulse, out=out)
    assert begun(work, changed) != begun(work, usual)
