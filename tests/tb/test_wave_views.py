# SPDX-License-Identifier: Apache-2.0
"""Views of a waveform name its signals as their programs do, and begin with the first laser pulse."""

import re
from types import SimpleNamespace
from typing import Any, NamedTuple

import pytest

from coincid.model.contract.parameters import TOP
from coincid.tb import wave_views
from coincid.tb.rtl import rtl

from ..random_cases import SENSORS, built_sensor

BLOCKS = (
    ("first", "", "laser word none"),
    ("second part", "part", "bit word"),
    ("none", "no", "x"),
)


class Variable(NamedTuple):
    """A signal, as of `pywellen`."""

    full_name: str
    bitwidth: int
    tv: Any = ()


@pytest.fixture
def written(monkeypatch, tmp_path):
    """Return the lines of both views of a waveform."""
    variables = [
        Variable(f"bench.{TOP}.laser", 1, [(0, 0), (70, 1), (80, 0), (90, 1)]),
        Variable(f"bench.{TOP}.word", 16),
        Variable(f"bench.{TOP}.part.bit", 1),
        Variable(f"bench.{TOP}.part.word", 2),
    ]

    class Waveform:
        def __init__(self, path):
            pass

        def all_vars(self):
            return variables

    monkeypatch.setattr(wave_views, "Waveform", Waveform)
    paths = wave_views.views(tmp_path / "a.fst", BLOCKS)
    assert [path.name for path in paths] == ["a.gtkw", "a.sucl"]
    return [path.read_text(encoding="utf-8").splitlines() for path in paths]


def test_gtkwave_finds_every_signal(written):
    """A bus is known with its bits, and a bit without."""
    assert written[0][:2] == ['[dumpfile] "a.fst"', "[timestart] 70"]
    assert written[0][3:] == [
        "@200",
        "-first",
        "@28",
        f"bench.{TOP}.laser",
        "@22",
        f"bench.{TOP}.word[15:0]",
        "@200",
        "-second part",
        "@28",
        f"bench.{TOP}.part.bit",
        "@22",
        f"bench.{TOP}.part.word[1:0]",
    ]


def test_surfer_finds_every_signal(written):
    assert written[1] == [
        "divider_add first",
        f"variable_add bench.{TOP}.laser",
        f"variable_add bench.{TOP}.word",
        "divider_add second_part",
        f"variable_add bench.{TOP}.part.bit",
        f"variable_add bench.{TOP}.part.word",
        "zoom_fit",
    ]


def test_each_title_is_one_word_of_a_command_of_surfer():
    lines = wave_views._surfer([(title, []) for title, *_ in wave_views.BLOCKS]).splitlines()
    titles = [line.split(" ") for line in lines[:-1]]
    assert [words[0] for words in titles] == ["divider_add"] * len(wave_views.BLOCKS)
    assert {len(words) for words in titles} == {2}


@pytest.mark.parametrize("changes", [None, [], [(0, 0)]])
def test_a_waveform_without_a_laser_pulse_is_shown_from_its_beginning(
    changes, monkeypatch, tmp_path
):
    lasers = [] if changes is None else [Variable(f"bench.{TOP}.laser", 1, changes)]
    waveform = SimpleNamespace(all_vars=lambda: [Variable(f"bench.{TOP}.word", 16), *lasers])
    monkeypatch.setattr(wave_views, "Waveform", lambda path: waveform)
    gtkwave, _ = wave_views.views(tmp_path / "a.fst", BLOCKS)
    assert "[timestart] 0" in gtkwave.read_text(encoding="utf-8").splitlines()


def scopes_of(files, module, scope=""):
    """Yield the scopes of a module in Verilog, and its text."""
    yield scope, files[module]
    for inner, name in re.findall(r"^  (coincid_\w+) \\?(\w+) +?\(", files[module], re.MULTILINE):
        yield from scopes_of(files, inner, f"{scope}.{name}".lstrip("."))


def test_views_name_signals_that_the_sensor_has():
    """Every one in its block, by the name in the Verilog."""
    files = rtl(built_sensor(SENSORS["one"]))
    texts = {
        path.stem: re.sub(r"\\(\S+) ", r"\1 ", path.read_text(encoding="utf-8")) for path in files
    }
    scopes = dict(scopes_of(texts, TOP))
    for title, scope, signals in wave_views.BLOCKS:
        declared = r"^  (?:input|output|wire|reg)(?: \[\d+:0\])? {}(?: = .*)?;"
        for name in signals.split():
            pattern = declared.format(re.escape(name))
            assert re.search(pattern, scopes[scope], re.MULTILINE), (title, name)
    assert len({title for title, *_ in wave_views.BLOCKS}) == len(wave_views.BLOCKS)
