# SPDX-License-Identifier: Apache-2.0
"""The Makefile: what `make` is given arrives in the commands of its target, each value under its own
option. Nothing of it is run.
"""

import re
import shlex
import subprocess

import pytest

from .commands import MAKEFILE, ROOT, lines_of_make

OF_SIM = {  # option of `make sim`: value, words of the command
    "SIM": ("golden", "--engine golden"),
    "SCENE": ("a b.png,it's.jpg", """--scene "a b.png,it's.jpg" """),
    "SCALE": ("3", "--scale 3"),
    "UNIT": ("mm", "--unit mm"),
    "MISSING": ("7", "--missing 7"),
    "SKY": ("80", "--sky 80"),
    "CHANNEL": ("left eye.Z", "--channel 'left eye.Z'"),
    "Z": ("1", "--z"),
    "FOV": ("90", "--fov 90"),
    "REFLECTIVITY": ("0.4", "--reflectivity 0.4"),
    "THRESHOLD": ("2", "--threshold 2"),
    "FRAMES": ("8", "--frames 8"),
    "LINK_GBPS": ("0", "--link-gbps 0"),
    "KLUX": ("2|100", "--klux '2|100'"),
    "PULSE": ("pulse.csv", "--pulse pulse.csv"),
    "PULSES": ("100", "--pulses 100"),
    "CONFIG": ("fpga", "--config fpga"),
    "SEED": ("5", "--seed 5"),
    "GAP": ("1000", "--set gap=1000"),
    "VIEW": ("async", "--view async"),
    "WAVES": ("1", "--waves"),
}
OF_EMULATE = {name: OF_SIM[name] for name in "SCENE KLUX PULSES FRAMES CONFIG SEED".split()}
FIXED = {"sim": "--out build/sim", "verilog": "--out build/rtl", "emulate": "--simulate"}
OTHERS = [  # target, its options, its command
    ("explore", {"PORT": "7"}, "coincid explore --port 7"),
    ("emulate", {"PORT": "/dev/a b"}, "coincid emulate --port '/dev/a b'"),
    ("verilog", {"CONFIG": "a b", "VIEW": "async"}, "coincid verilog --config 'a b' --view async --out build/rtl"),
    ("emulator", {"CONFIG": "own.toml"}, "coincid emulator --config own.toml"),
    ("formal", {"NAMES": "tdc tree"}, "coincid formal tdc tree"),
    ("pages", {"NAMES": "depth controller"}, "python docs/pages.py depth controller"),
    ("pages", {"STALE": "1"}, "python docs/pages.py --stale"),
    ("pages", {"STALE": "0", "ONLY": "stale"}, "python docs/pages.py --only-stale"),
    ("soak", {"ARGS": "--frames 3"}, "python -m tests.soak --frames 3"),
    ("upsets", {"ARGS": "--help"}, "python -m tests.upsets --help"),
    ("coverage", {"ARGS": "--help"}, "python -m tests.coverage --help"),
    ("mutation", {"ARGS": "--help"}, "python -m tests.mutation --help"),
    ("test", {"PYTEST_ARGS": "-k fifo -x"}, "python -m pytest -n logical --maxprocesses 6 --dist loadgroup -k fifo -x"),
]  # fmt: skip

PLAIN = {  # target: what it sets up, and each of its commands, without options
    "setup": ("test lint",),
    "sim": ("rtl explore", "coincid sim --out build/sim"),
    "explore": ("rtl explore", "coincid explore"),
    "check": (
        "test lint icarus",
        "ruff check .",
        "ruff format --check .",
        "python -m pytest -n logical --maxprocesses 6 --dist loadgroup @tests/quick.txt",
    ),
    "emulate": ("rtl explore", "coincid emulate --simulate"),
    "test": ("test icarus", "python -m pytest -n logical --maxprocesses 6 --dist loadgroup"),
    "formal": ("formal", "coincid formal"),
    "upsets": ("test", "python -m tests.upsets"),
    "soak": ("test", "python -m tests.soak"),
    "mutation": (
        "mutants icarus",
        "python -m tests.mutation",
        "python -m tests.planted",
        "python -m tests.python_mutants",
    ),
    "coverage": ("test", "python -m tests.coverage"),
    "verilog": ("rtl", "coincid verilog --out build/rtl"),
    "synth": ("cells", "coincid synth"),
    "gls": ("icarus cells", "coincid gls"),
    "power": ("icarus cells", "python -m docs.studies.power_against_light"),
    "layout": ("icarus cells layout", "coincid layout"),
    "pnr": ("flow", "coincid pnr"),
    "emulator": ("flow", "coincid emulator"),
    "cost": ("cells", "python -m docs.studies.cost", "python -m docs.studies.choices"),
    "lint": ("lint", "ruff check .", "ruff format --check .", "scripts/types", "coincid lint"),
    "docs": ("docs icarus", "python docs/build.py"),
    "figures": ("rtl explore", "python -m docs.studies.figures figures"),
    "compare": ("rtl", "python -m docs.studies.figures compare"),
    "modes": ("rtl", "python -m docs.studies.figures modes --rtl"),
    "pages": ("flow icarus cells", "python docs/pages.py"),
    "release": ("rtl explore", "python docs/pages.py --release"),
    "raytrace": ("rtl explore raytrace",),
    "bench": ("rtl explore icarus", "coincid bench"),
}


def made(target, given):
    """Return the words of each command that `make` would run, without the folder of programs."""
    lines = lines_of_make([target, *(f"{name}={value}" for name, value in given.items())])
    return [shlex.split(line.removeprefix(".venv/bin/")) for line in lines]


def options(words):
    """Return the options of a command, each with its value, in any order."""
    return sorted("\0".join(words).split("\0--")[1:])


@pytest.mark.parametrize(("target", "known"), [("sim", OF_SIM), ("emulate", OF_EMULATE)])
def test_each_option_of_a_target_arrives_under_its_own_name(target, known):
    """Alone and beside all others; a value may have blanks and quotes."""
    for names in ([], *([name] for name in known), list(known)):
        *_, words = made(target, {name: known[name][0] for name in names})
        expected = shlex.split(" ".join([FIXED[target], *(known[name][1] for name in names)]))
        assert words[:2] == ["coincid", target]
        assert options(words) == options(["", *expected])


def test_a_switch_of_make_is_off_at_zero():
    for name in ("Z", "WAVES"):
        assert made("sim", {name: "0"}) == made("sim", {})


@pytest.mark.parametrize(("target", "given", "command"), OTHERS)
def test_a_target_runs_its_command_with_what_is_given(target, given, command):
    assert shlex.split(command) in made(target, given)


@pytest.mark.parametrize(
    ("target", "given", "needs"),
    [
        ("sim", {"SIM": "icarus"}, "rtl explore icarus"),
        ("sim", {"VIEW": "async"}, "rtl explore icarus"),
        ("sim", {"VIEW": "async", "SIM": "verilator"}, "rtl explore"),
        ("emulate", {"PORT": "/dev/ttyUSB0"}, "rtl explore board"),
    ],
)
def test_a_target_sets_up_what_its_options_need(target, given, needs):
    """Before its command."""
    assert made(target, given)[0] == ["scripts/setup", *needs.split()]


def test_a_target_sets_up_its_needs_and_runs_all_its_commands_in_their_order():
    """Also where a file has its name, such as the folder `docs`."""
    targets = re.findall(r"^([a-z]+):", MAKEFILE, re.MULTILINE)
    assert {*PLAIN, "help", "clean"} == set(targets)
    for target, (needs, *commands) in PLAIN.items():
        expected = [f"scripts/setup {needs}", *commands]
        assert made(target, {}) == [line.split() for line in expected], target
    assert made("clean", {}) == [["rm", "-rf", "build"]]
    phony = re.search(r"^\.PHONY: (.*)", MAKEFILE, re.MULTILINE)[1].split()
    assert sorted(phony) == sorted(targets)


def test_help_names_every_target_and_every_option_of_sim():
    done = subprocess.run(["make", "help"], cwd=ROOT, capture_output=True, encoding="utf-8")
    listed = re.findall(r"^  ([a-z]+) +\S", done.stdout, re.MULTILINE)
    lists = re.findall(r"^[a-z][^:]*: ([a-z ]+)$", done.stdout, re.MULTILINE)
    targets = re.findall(r"^([a-z]+):", MAKEFILE, re.MULTILINE)
    assert sorted([*listed, *" ".join(lists).split()]) == sorted(set(targets) - {"help"})
    assert set(OF_SIM) <= set(re.findall(r"([A-Z_]+)=", done.stdout))
