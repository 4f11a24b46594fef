# SPDX-License-Identifier: Apache-2.0
"""The estimator is compiled in another process, if it is not compiled yet."""

import subprocess
import sys
from types import SimpleNamespace

import pytest

from coincid.lab import compile_ahead as ahead
from coincid.lab import outcomes
from coincid.lab.setup import Setup
from coincid.model.contract.config import parse_config
from coincid.model.contract.result import checked_events


@pytest.mark.parametrize("compiled", [True, False])
def test_another_process_compiles_only_what_is_not_compiled_yet(compiled, monkeypatch):
    """It says nothing, and ends with this one at the latest."""
    asked, started, at_end = [], [], []

    class Started:
        def __init__(self, command, **options):
            started.append((command, options))

        def kill(self):
            started.append("killed")

    monkeypatch.setattr(ahead, "is_compiled", lambda module: asked.append(module) or compiled)
    monkeypatch.setattr(ahead, "Popen", Started)
    monkeypatch.setattr(ahead, "atexit", SimpleNamespace(register=at_end.append))
    ahead.compile_ahead.__wrapped__()
    assert asked == ["coincid.model.depth.estimate"]
    if compiled:
        assert not started and not at_end
        return
    ((command, options),) = started
    assert command[:2] == [sys.executable, "-c"]
    called = []
    monkeypatch.setattr(ahead, "estimate_anything", lambda: called.append(True))
    exec(command[2], {})
    assert called == [True]
    assert options == dict.fromkeys(("stdin", "stdout", "stderr"), subprocess.DEVNULL)
    (end,) = at_end
    end()
    assert started[1:] == ["killed"]


@pytest.mark.parametrize(
    ("workers", "estimators", "asked"),
    [
        (2, ("planes",), 1),
        (2, ("maximum", "planes"), 1),
        (1, ("planes",), 0),
        (2, ("maximum",), 0),
        (2, (), 0),
    ],
)
def test_a_run_compiles_ahead_if_it_has_a_core_to_spare_and_a_use_for_it(
    workers, estimators, asked, monkeypatch
):
    """Once, while photons are drawn: not before, and not if they are there already."""
    calls = []
    monkeypatch.setattr(outcomes, "compile_ahead", lambda: calls.append(True))
    sensor = {"rows": 8, "cols": 8}
    setup = Setup.of("flat:5", sensor=sensor, frame={"pulses": 2}, estimators=estimators)
    run = outcomes.Run(setup, workers=workers)
    assert not calls
    edges = run.edges
    assert run.edges is edges
    assert len(calls) == asked
    assert outcomes.Run(setup, workers=workers, edges=edges).edges is edges
    assert len(calls) == asked


@pytest.mark.parametrize("sensor", [{}, {"subgroup": [16, 16]}, {"subgroup": [4, 4], "cols": 64}])
def test_a_made_up_frame_may_come_from_a_run(sensor):
    config = parse_config({"sensor": {"rows": 16, "cols": 16} | sensor})
    found = checked_events(ahead.made_up(config), config)
    assert len(found["pulse"]) == config.sensor.subgroups * 25
    assert found["hits"].shape[1] == -(-config.sensor.pixels // 64)
