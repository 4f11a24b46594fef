# SPDX-License-Identifier: Apache-2.0
"""Coincid: an open, cycle-accurate model of a SPAD direct time-of-flight sensor.

This package has the names that a notebook needs, and imports each of them on its first use: `simulate` and the `Run` that
it returns; the configuration, scene and light from which a run is made; and functions for its result. Everything else is
in the rooms, each of which imports only earlier ones: `coincid.model` (contract, golden model, light, scenes, depth; no
HDL), `coincid.hdl` (RTL in Amaranth), `coincid.tb` (simulators, cocotb, scoreboards), `coincid.flow`, `coincid.formal`,
`coincid.study`, `coincid.board` (the emulator on an FPGA board). The command line is `coincid.cli`.
"""

import os as _os
from importlib import import_module as _import_module

# Only what is light is imported here: a command cannot handle an interrupt before.
if not _os.path.isdir(_os.path.join(_os.path.dirname(__file__), "model")):
    raise ImportError(
        "src/coincid has no links to the rooms (model, hdl and so on); clone with Git where it may make symbolic links "
        "(git config --global core.symlinks true), or install the wheel"
    )

__version__: str  # of the installation; see `__getattr__`

_PLACES = {
    "lab.bound": ("bound",),
    "model.contract.config": ("Config", "load_config", "parse_config"),
    "model.contract.edges": ("load_edges",),
    "model.contract.result": ("events_table", "read_result", "write_result"),
    "model.depth.estimate": ("estimate_depth",),
    "model.depth.histograms": ("pixel_histogram",),
    "model.light.light": ("Light",),
    "model.light.photons": ("generate_edges",),
    "model.light.spad": ("Spad",),
    "model.light.timing": ("Timing",),
    "model.scenes.catalogue": ("load_scene",),
    "model.scenes.scene": ("Scene", "scene_light"),
    "model.shared.errors": ("InputError",),
    "study.point_cloud": ("point_cloud", "write_ply"),
    "study.run": ("Run", "simulate"),
    "tb.replay": ("replay",),
}
_PLACE_OF = {name: place for place, names in _PLACES.items() for name in names}
__all__ = sorted(_PLACE_OF)


def __getattr__(name: str) -> object:
    if name == "__version__":
        from importlib.metadata import version

        return version("coincid")
    if name not in _PLACE_OF:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    found = getattr(_import_module(f"{__name__}.{_PLACE_OF[name]}"), name)
    globals()[name] = found
    return found


def __dir__() -> list[str]:
    own = {name for name in globals() if name.startswith("__")}
    return sorted(own | {"__version__"} | {*__all__})
