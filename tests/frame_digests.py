# SPDX-License-Identifier: Apache-2.0
"""A program that prints digests of the words and of the depth of one frame, for any Python that has
the package.
"""

import hashlib

from coincid.lab.outcomes import Run
from coincid.lab.setup import Setup

SMALL = {"rows": 8, "cols": 8}


def digests() -> list[str]:
    """Return the digests of the beats and of the depth of one frame."""
    run = Run(Setup.of("five-objects", klux=20, sensor=SMALL, frame={"pulses": 50}))
    words = hashlib.sha256()
    for trace in run.traces:
        for beats in trace.beats:
            words.update(beats.tobytes())
    depth = hashlib.sha256(run.depth("planes").depth_m.tobytes())
    return [words.hexdigest(), depth.hexdigest()]


if __name__ == "__main__":
    print(*digests())
