# SPDX-License-Identifier: Apache-2.0
"""Coriolis places and routes a block: the program that `flow.py` starts in a folder of its own, with a time limit.

`python -m coincid.flow.layout.place_route JOB.json`. The job names BLIF file, LEF files, pin strips and settings; the result is TOP.gds,
TOP_export.def and placed.json, the placed cells with the nets at their pins. Exit code 0: routed whole; `NOT_ROUTED`: not every net.
"""

import json
import sys
from pathlib import Path
from types import SimpleNamespace

from coincid.flow.layout import technology

NOT_ROUTED = 3


def main(path: str) -> int:
    job = SimpleNamespace(**json.loads(Path(path).read_text()))
    technology.set_up([Path(lef) for lef in job.lef], Path(job.strips), job.um2_per_pin)
    from coriolis import CRL, Cfg
    from coriolis.helpers.overlay import CfgCache
    from coriolis.Hurricane import Net

    from coincid.flow.layout import block

    with CfgCache(priority=Cfg.Parameter.Priority.UserFile) as cfg:
        for name in ("catchCore", "info", "paranoid", "bug"):
            setattr(cfg.misc, name, False)
        for name in ("logMode", "verboseLevel1", "verboseLevel2"):
            setattr(cfg.misc, name, True)
    cell = CRL.Blif.load(job.blif)
    for net in cell.getNets():
        if net.isExternal() and net.getName() == job.clock:
            net.setType(Net.Type.CLOCK)
    routed = block.build(cell, job)
    CRL.Gds.save(cell)
    CRL.DefExport.drive(cell, 0)
    return 0 if routed else NOT_ROUTED


if __name__ == "__main__":
    sys.exit(main(sys.argv[1]))
