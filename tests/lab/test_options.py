# SPDX-License-Identifier: Apache-2.0
"""The table of options: the command, the function and the explorer have the same ones, and it tells
what there is.
"""

from inspect import signature

import pytest
import typer

import coincid
from coincid.cli import app
from coincid.lab.options import OPTIONS
from coincid.model.depth.methods import DEFAULT_METHOD
from coincid.model.light.light import BACKGROUNDS
from coincid.model.scenes.catalogue import NAMES
from coincid.model.scenes.meaning import SCALES
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


@pytest.mark.parametrize(
    "name",
    ["scale", "reflectivity", "seed", "spad_gate", "method", "unit", "z", "sky_m", "background"],
)
def test_the_explorer_has_them_too(name):
    assert CONTROL[name].sentence.startswith(
        OPTIONS[name].doc.split(":")[0].split(";")[0].rstrip(".")
    )
