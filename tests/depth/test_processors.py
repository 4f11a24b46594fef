# SPDX-License-Identifier: Apache-2.0
"""The same words give the same depth on every processor. As a program, it prints the digest of some
depths.
"""

import hashlib
import os
import subprocess
import sys

import numpy as np

from coincid.lab.outcomes import Run
from coincid.lab.setup import Setup
from coincid.model.depth.methods import METHODS

SENSOR = {"rows": 16, "cols": 16}


def depth_digest() -> str:
    """Return the digest of what every estimator says about one frame, with gates."""
    gates = {"gating": True, "gate_start": 4, "gate_len": 40}
    moving = {"gate_every": 10, "gate_step": 5, "gate_steps": 4}
    run = Run(Setup.of("five-objects", klux=50, sensor=SENSOR, frame=moving, subgroup=gates))
    digest = hashlib.sha256()
    for method in METHODS:
        depth = run.depth(method, returns=2)
        digest.update(depth.depth_m.tobytes())
        digest.update(depth.confidence.tobytes())
        digest.update(depth.reason.tobytes())
    return digest.hexdigest()


def test_vector_units_do_not_change_the_depth():
    """NumPy and its linear algebra have versions for each kind of vector unit; with the oldest
    ones, the depth is the same.
    """
    found = np.show_config(mode="dicts")["SIMD Extensions"].get("found", [])
    old = {"NPY_DISABLE_CPU_FEATURES": " ".join(found), "OPENBLAS_CORETYPE": "Nehalem"}
    environment = os.environ | old
    elsewhere = subprocess.run(
        [sys.executable, __file__],
        env=environment,
        capture_output=True,
        text=True,
        encoding="utf-8",
        check=True,
    )
    assert elsewhere.stdout.strip() == depth_digest()


if __name__ == "__main__":
    print(depth_digest())
