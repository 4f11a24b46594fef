# SPDX-License-Identifier: Apache-2.0
"""Packages: the folders beside this file are sub-packages of `coincid`, with whatever folders they have."""

from setuptools import find_packages, setup

ROOMS = ("model", "tools", "host", "hdl", "slices", "tb", "flow", "formal", "lab", "study")
DATA = ["*.v", "*.vh", "*.cpp", "*.c", "*.h", "presets/*.toml", "ray_scenes/*.xml", "*.html", "*.css", "*.js"]

setup(
    packages=[
        "coincid",
        *(f"coincid.{name}" for room in ROOMS for name in (room, *(f"{room}.{sub}" for sub in find_packages(room)))),
    ],
    package_dir={"coincid": "coincid"} | {f"coincid.{room}": room for room in ROOMS},
    package_data={"": DATA},
)
