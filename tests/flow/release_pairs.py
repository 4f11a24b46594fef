# SPDX-License-Identifier: Apache-2.0
"""Exports in which every pair of what can be built comes up, with views, clocks and prefixes, and
digests of all that is beside their Verilog: register map, bench, constraints, README, manifest.

`python -m tests.flow.release_pairs` writes the digests again; a change that means to change such a
file says so in CHANGELOG.md.
"""

from pathlib import Path
from unittest.mock import patch

from coincid.flow import release
from coincid.hdl.export import FILE_LIST
from coincid.hdl.front_end_views import VIEWS, view_at
from coincid.model.contract.parameters import TOP

from ..digests import write_digests
from ..feature_pairs import BUILT, Case, Features, covering_cases, impossible_of, sensor_of
from ..file_digests import MANIFEST, Digests, digests_of_files
from ..random_cases import configured

DIGESTS = Path(__file__).with_suffix(".json")
FEATURES: Features = BUILT | {
    "view": tuple(VIEWS),
    "clock_mhz": (400.0, 62.5),
    "prefix": ("", "near_"),
}
UNCOUNTED = [name for name, view in VIEWS.items() if not view.has_quarters]
CASES = covering_cases(FEATURES, impossible_of(FEATURES, UNCOUNTED))
VERILOG = {f"{TOP}.v": f"module {TOP}; endmodule\n", FILE_LIST: f"{TOP}.v\n"}


def digests_of(case: Case) -> Digests:
    """Return the digests of the files of an export, whose Verilog is an empty module; that of the
    sensor has digests of its own.
    """
    config = configured(sensor_of(case), {"clock_mhz": case["clock_mhz"], "period": 90})
    view = VIEWS[case["view"]]
    no_more = {"fpga_files": lambda sensor: {}, "cell_files": lambda sensor, view: {}}
    with patch.multiple(release, verilog_files=lambda sensor, view: dict(VERILOG), **no_more):
        files = release._contents(config, view, case["prefix"])
    manifest = f"{case['prefix']}{MANIFEST}"
    nameless = dict.fromkeys(files.keys() - {manifest}, b"")  # their digests depend on the version
    facts = release._manifest(config, nameless, view_at(view, config.clock_mhz), case["prefix"])
    return digests_of_files((files | {manifest: facts.encode()}).items())


if __name__ == "__main__":
    write_digests(DIGESTS, [digests_of(case) for case in CASES])
