# SPDX-License-Identifier: Apache-2.0
"""Build the documentation site into build/docs/; `make docs` runs this program.

The pages lie in the same places as on a Git host, so a link leads to the same page in both.
Copies of the pages, the API reference and the gallery go into build/docs-source/. Every warning
is an error, such as a dead link, a missing heading or an example that fails.
"""

import sys
from pathlib import Path

from sphinx.cmd.build import build_main

ROOT = Path(__file__).parents[1]
SOURCE, SITE, DOCTREES = (
    ROOT / "build" / name for name in ("docs-source", "docs", "docs-doctrees")
)
TOP = ("README.md", "CONTRIBUTING.md", "CHANGELOG.md", "CITATION.cff", "LICENSE", "NOTICE")
PAGES = {".md", ".toml", ".svg", ".png", ".csv"}  # of docs/, without
STUDIES = ROOT / "docs" / "studies"  # the programs that make pages
MODULES = {  # page: title, modules
    "model.contract": (
        "Contract: configuration, registers, words, files",
        ("config", "parameters", "pixels", "edges", "result", "registers", "packet", "stream", "link", "latency"),
    ),
    "model.golden": ("Golden model", ("frame", "readout", "controller", "shape")),
    "model.light": (
        "Light",
        ("light", "spad", "timing", "photons", "link_budget", "spectrum", "analytic", "code_density"),
    ),
    "model.scenes": (
        "Scenes",
        ("catalogue", "scene", "flat_scenes", "depth_file", "recorded_light", "ambient", "daylight", "transient", "ray_scene"),
    ),
    "model.depth": ("Depth", ("estimate", "histograms", "arrivals", "quality", "peaks", "planes")),
    "model.recorded": ("Recorded photons", ("exchange", "recordings", "ptu", "photon_hdf5", "columns")),
    "hdl": (
        "RTL",
        (
            "sensor", "subgroup_pair", "subgroup", "minigroup", "tree", "tdc", "dpcu", "gating", "fifo", "readout", "packetizer",
            "controller", "registers", "settings", "sequencer", "deserialiser", "axi", "export", "front_end_views",
        ),
    ),
    "slices": ("Bit slices of any netlist", ("slices", "synthesis", "probe", "waves", "netlist")),
    "tb": ("Simulators and benches", ("replay", "play", "frame_record", "sliced", "cosim", "scoreboard", "stimulus", "toolchain")),
    "flow": ("Release, synthesis, place and route", ("release", "async_constraints", "register_files", "synth", "pnr", "gls")),
}  # fmt: skip
GALLERY = """Examples
========

Short programs, each with a picture. They run while this site is built, so what they show is what they do.
"""
FORWARD = """<!doctype html>
<html lang="en"><meta charset="utf-8"><title>Coincid</title>
<meta http-equiv="refresh" content="0; url=docs/index.html">
<p><a href="docs/index.html">Coincid</a></p></html>
"""


def pages() -> dict[str, bytes]:
    """Return the content of each source of the site, by its path."""
    files = [ROOT / name for name in TOP]
    for path in (ROOT / "docs").rglob("*"):
        if path.suffix in PAGES and STUDIES not in path.parents:
            files.append(path)
    files += [*(ROOT / "examples").glob("*.py"), ROOT / "examples" / "README.md"]
    made = {str(path.relative_to(ROOT)): path.read_bytes() for path in files}
    # The gallery's programs lie in a folder of their own, whose header is not the README of the
    # examples.
    made |= {
        f"programs/{path.name}": path.read_bytes() for path in (ROOT / "examples").glob("*.py")
    }
    made["programs/GALLERY_HEADER.rst"] = GALLERY.encode()
    made["extra/index.html"] = FORWARD.encode()
    return made | {name: text.encode() for name, text in api().items()}


def api() -> dict[str, str]:
    """Return the pages of the API reference, by their paths."""
    import coincid

    names = [name for name in coincid.__all__ if name != "InputError"]
    front = [heading("The front door: coincid"), (coincid.__doc__ or "").partition("\n")[0], ""]
    for name in [*names, "InputError"]:
        kind = "function" if not isinstance(getattr(coincid, name), type) else "class"
        front += [
            f".. auto{kind}:: coincid.{name}",
            *(["   :members:"] if kind == "class" else []),
            "",
        ]
    made = {"api/coincid.rst": "\n".join(front)}
    for room, (title, modules) in MODULES.items():
        lines = [heading(f"{title}: coincid.{room}")]
        for module in modules:
            name = f"coincid.{room}.{module}"
            lines += [heading(module, "-"), f".. automodule:: {name}", "   :members:", ""]
        made[f"api/{room}.rst"] = "\n".join(lines)
    rooms = "".join(f"   {room}\n" for room in ("coincid", *MODULES))
    return made | {
        "api/index.rst": f"{heading('API reference')}\n.. toctree::\n   :maxdepth: 1\n\n{rooms}"
    }


def heading(text: str, line: str = "=") -> str:
    return f"{text}\n{line * len(text)}\n"


def lay_out(files: dict[str, bytes]) -> None:
    """Update the sources to `files`. Unchanged files keep their time and are not built again;
    the gallery's files stay.
    """
    for name, content in files.items():
        path = SOURCE / name
        if not path.exists() or path.read_bytes() != content:
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(content)
    for path in SOURCE.rglob("*"):
        name = path.relative_to(SOURCE)
        if path.is_file() and name.parts[0] != "gallery" and str(name) not in files:
            path.unlink()


def main() -> int:
    lay_out(pages())
    places = ["-c", ROOT / "docs", "-d", DOCTREES, SOURCE, SITE]
    return build_main([*"-W --keep-going -q -b html".split(), *map(str, places), *sys.argv[1:]])


if __name__ == "__main__":
    sys.exit(main())
