# SPDX-License-Identifier: Apache-2.0
"""What people are given appears whole or not at all: files are written with `whole_file`, except
within folders that are thrown away or take their place only when they are complete.
"""

import re
from collections import Counter

from .checkout import package_sources

WRITES = re.compile(r"\.write_(?:text|bytes)\(|\bopen\([^()\n]*[\"'][wax]b?[\"']")
PLAIN = {  # file: number of files that it writes in place, all in such folders
    "flow/gls.py": 1,
    "flow/layout/block.py": 1,
    "flow/layout/delays.py": 4,
    "flow/layout/flow.py": 7,
    "flow/lint.py": 1,
    "flow/mapped.py": 2,
    "flow/pnr.py": 2,
    "flow/register_files.py": 1,
    "flow/release.py": 1,
    "flow/silicon_report.py": 6,
    "formal/prove.py": 4,
    "hdl/to_verilog.py": 1,
    "model/shared/files.py": 2,  # the members of an archive that `whole_file` opens
    "slices/library.py": 1,
    "slices/synthesis.py": 2,
    "__main__.py": 2,  # the null device
    "study/explore/uploads.py": 1,
    "tb/cosim.py": 2,
    "tb/frame_record.py": 1,
    "tb/rtl.py": 1,
    "tb/stress.py": 1,
    "tb/toolchain.py": 3,
    "tb/verilated.py": 2,
    "tools/build.py": 1,  # a log
    "tools/locked.py": 1,  # a log
    "tools/wheels.py": 2,
    "tools/yosys_program.py": 1,
}


def test_files_for_people_are_not_written_in_place():
    found = Counter(file for file, text in package_sources() for _ in WRITES.finditer(text))
    assert found == PLAIN
