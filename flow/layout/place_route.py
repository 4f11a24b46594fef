# SPDX-License-Identifier: Apache-2.0
"""Program that places and routes a block with Coriolis:
`python -m coincid.flow.layout.place_route JOB.json`.

`flow.py` starts it in a separate folder with a time limit. The job names the BLIF file, the LEF
files, the strips of the pins, and settings. The program writes TOP.gds, TOP_export.def, and
placed.json with the placed cells and their nets. The exit code is 0 if every net is routed, and
`NOT_ROUTED` otherwise.
"""

import json
import sys
from pathlib import Path
from types import SimpleNamespace

from coincid.flow.layout import technology

NOT_ROUTED = 3


def main(path: str) -> int:
    job = SimpleNamespace(**json.loads(Path(path).read_text(encoding="utf-8")))
    technology.set_up([Path(lef) for lef in job.lef], Path(job.strips), job.um2_per_pin)
    from coriolis import CRL
    from coriolis.Hurricane import Net

    from coincid.flow.layout import block

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
