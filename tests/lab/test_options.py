# SPDX-License-Identifier: Apache-2.0
"""The table of options: the command, the function and the explorer have the same ones, and it tells
what there is.
"""

import re
from inspect import signature

import pytest
import typer
from attrs import fields_dict

import coincid
from coincid.cli import app
from coincid.lab.options import OPTIONS
from coincid.model.depth.arrivals import SYSTEM_FWHM_S
from coincid.model.depth.methods import DEFAULT_METHOD
from coincid.model.light.light import BACKGROUNDS
from coincid.model.light.spad import Spad
from coincid.model.scenes.catalogue import DAYLIGHT_KLUX, NAMES, USUAL_KLUX, usual_klux
from coincid.model.scenes.conventions import CONVENTIONS
from coincid.model.scenes.meaning import MARKS, SCALES
from coincid.model.scenes.ray_scene import SCENES
from coincid.model.scenes.scene import REFLECTIVITY
from coincid.study.explore.controls import CONTROL

OF_FILES = {"config", "changes", "out", "waves"}  # what only a command has
SETTINGS = {"pulses", "threshold", "frames", "link_gbps", "clock_mhz"}  # of the configuration


def test_the_command_and_the_function_have_the_same_options():
    command = {one.name: one for one in typer.main.get_command(app).commands["sim"].params}
    function = signature(coincid.simulate).parameters
    # all estimators are compared
    assert set(command) - OF_FILES - SETTINGS == set(OPTIONS) - {"method"}
    assert set(OPTIONS) == set(function) - {"config", "settings"}
    for name, option in OPTIONS.items():
        assert (
            f"{name} : {option.kind}" in coincid.simulate.__doc__
            and option.doc in coincid.simulate.__doc__
        )
        assert (
            name in ("spad", "engine", "view", "klux", "unit")
            or function[name].default == option.default
        )
        assert name == "method" or option.doc.rstrip(".") in command[name].help


def test_the_table_knows_what_there_is():
    assert all(
        name in OPTIONS["scene"].doc
        for name in (*NAMES, *(f"ray:{path.stem}" for path in SCENES.glob("*.xml")))
    )
    assert (
        OPTIONS["reflectivity"].default == REFLECTIVITY
        and OPTIONS["method"].default == DEFAULT_METHOD
    )
    assert OPTIONS["background"].default == BACKGROUNDS[0] and all(
        law in OPTIONS["background"].doc for law in BACKGROUNDS
    )
    assert (OPTIONS["scale"].low, OPTIONS["scale"].high) == SCALES


def test_the_table_tells_the_numbers_that_there_are():
    """Defaults that depend on other options, marks of no depth, ranges, and names of properties."""
    klux = f"Default: {DAYLIGHT_KLUX['tunnel']:g} for {' and '.join(DAYLIGHT_KLUX)},"
    klux += f" {usual_klux('', 100.0):g} for histograms, otherwise {USUAL_KLUX:g}."
    assert len(set(DAYLIGHT_KLUX.values())) == 1
    marks = f"besides 0, NaN, infinity, {', '.join(map(str, sorted(MARKS)))} and the limits of"
    share = OPTIONS["reflectivity"]
    for name, told in {
        "klux": klux,
        "pulse": f"Default: a Gaussian of {SYSTEM_FWHM_S * 1e12:g} ps.",
        "missing": marks,
        "reflectivity": f"without a colour picture, {share.low:g} to {share.high:g}.",
        "background": f"{BACKGROUNDS[0]} (in proportion to each surface's reflectivity) or",
    }.items():
        assert told in OPTIONS[name].doc
    (name,) = re.findall(r"such as (\w+)=", OPTIONS["spad"].doc)
    assert name in fields_dict(Spad)
    assert [f"{one.name} (" for one in CONVENTIONS] == re.findall(
        "|".join(re.escape(f"{one.name} (") for one in CONVENTIONS),
        OPTIONS["unit"].doc.partition("Data sets: ")[2],
    )


@pytest.mark.parametrize(
    "name",
    ["scale", "reflectivity", "seed", "spad_gate", "method", "unit", "z", "sky_m", "background"],
)
def test_the_explorer_has_them_too(name):
    assert CONTROL[name].sentence.startswith(
        OPTIONS[name].doc.split(":")[0].split(";")[0].rstrip(".")
    )
