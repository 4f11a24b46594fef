# SPDX-License-Identifier: Apache-2.0
"""Release folders of small sensors, written once for the state of the sources, for all tests that
look at them.
"""

from importlib.metadata import version
from pathlib import Path

from coincid.flow.release import write_release
from coincid.hdl.front_end_views import POLYPHASE, VIEWS
from coincid.model.contract.config import parse_config
from coincid.model.shared.folders import build_root
from coincid.model.shared.sources import digest, sources_digest
from coincid.tools.build import build_once

SMALL = {  # the presets' circuits, one module of each
    "silicon": {"rows": 8, "cols": 16},
    "fpga": {"rows": 8, "cols": 8, "phases": 8, "window_max": 16},
    "async": {"rows": 8, "cols": 16},
}
CLOCK_MHZ = {"silicon": 500, "fpga": 125, "async": 400}


def config(name):
    return parse_config({"sensor": SMALL[name], "frame": {"clock_mhz": CLOCK_MHZ[name]}})


def release(folder, name):
    write_release(Path(folder), config(name), VIEWS.get(name, POLYPHASE))


def small_releases() -> Path:
    """Return a folder with one release per name in `SMALL`, written one after the other in one
    process.
    """

    def make(folder):
        for name in SMALL:
            release(folder / name, name)

    key = digest(
        repr((SMALL, CLOCK_MHZ, version("coincid"))),
        sources_digest("hdl", "flow", "model.contract", "model.shared"),
    )
    return build_once(build_root() / "releases" / key, make)
