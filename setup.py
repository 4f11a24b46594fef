# SPDX-License-Identifier: Apache-2.0
"""Packages: the folders beside this file are sub-packages of `coincid`, with whatever folders they have."""

import base64
import hashlib
import zipfile
from pathlib import Path

from setuptools import find_packages, setup
from setuptools.command.editable_wheel import editable_wheel

ROOMS = ("model", "tools", "host", "hdl", "slices", "tb", "flow", "formal", "lab", "study")
DATA = ["*.v", "*.vh", "*.cpp", "*.c", "*.h", "presets/*.toml", "ray_scenes/*.xml", "*.html", "*.css", "*.js"]

FIRST = (
    "; import os, sys; elsewhere = [path for path in os.environ.get('PYTHONPATH', '').split(os.pathsep)"
    " if path and os.path.isfile(os.path.join(path, 'coincid', '__init__.py'))];"
    " elsewhere or sys.meta_path.sort(key=lambda finder: getattr(finder, '__module__', '') != '{}')\n"
)


class EditableWheel(editable_wheel):
    """An editable install whose finder comes before the search of folders, unless PYTHONPATH names other sources.

    A script in the folder above the clone would otherwise find the clone's folder, `coincid` without an `__init__.py`.
    """

    def run(self):
        super().run()
        (wheel,) = Path(self.dist_dir).glob("*.whl")
        with zipfile.ZipFile(wheel) as archive:
            files = {info: archive.read(info) for info in archive.infolist()}
        for info, content in files.items():
            if info.filename.endswith(".pth"):
                finder = content.decode().removeprefix("import ").partition(";")[0]
                files[info] = changed = content.rstrip() + FIRST.format(finder).encode()
                name = info.filename
        digest = base64.urlsafe_b64encode(hashlib.sha256(changed).digest()).rstrip(b"=").decode()
        with zipfile.ZipFile(wheel, "w", zipfile.ZIP_DEFLATED) as archive:
            for info, content in files.items():
                if info.filename.endswith("RECORD"):
                    lines = content.decode().splitlines()
                    lines = [
                        f"{name},sha256={digest},{len(changed)}" if line.startswith(name) else line for line in lines
                    ]
                    content = "\n".join([*lines, ""]).encode()
                archive.writestr(info, content)


setup(
    cmdclass={"editable_wheel": EditableWheel},
    packages=[
        "coincid",
        *(f"coincid.{name}" for room in ROOMS for name in (room, *(f"{room}.{sub}" for sub in find_packages(room)))),
    ],
    package_dir={"coincid": "coincid"} | {f"coincid.{room}": room for room in ROOMS},
    package_data={"": DATA},
)
