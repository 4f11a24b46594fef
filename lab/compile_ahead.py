# SPDX-License-Identifier: Apache-2.0
"""Compiles the estimator in another process during a first run, while that run draws photons and
plays frames.
"""

import atexit
import sys
from functools import cache
from subprocess import DEVNULL, Popen

import numpy as np

from ..model.contract.config import Config, parse_config
from ..model.contract.counters import COUNTER_NAMES
from ..model.contract.packet import BEAT_BITS
from ..model.contract.result import EVENT_FIELDS
from ..model.depth.estimate import estimate_depth
from ..model.depth.methods import DEFAULT_METHOD
from ..model.shared.compiled import is_compiled


@cache
def compile_ahead() -> None:
    """Start to compile the estimator, unless it is compiled already. The new process ends with this
    one at the latest.
    """
    if is_compiled(estimate_depth.__module__):
        return
    command = [
        sys.executable,
        "-c",
        f"from {__name__} import estimate_anything; estimate_anything()",
    ]
    atexit.register(Popen(command, stdin=DEVNULL, stdout=DEVNULL, stderr=DEVNULL).kill)


def estimate_anything() -> None:
    """Estimate the depth of a made-up frame of four subgroups, so that the code for it is
    compiled.
    """
    config = parse_config({"sensor": {"rows": 16, "cols": 16}})
    for method in (DEFAULT_METHOD, "maximum"):
        estimate_depth(made_up(config), config, method=method, frame=0)


def made_up(config: Config) -> dict[str, np.ndarray]:
    """Return the arrays of a made-up result: in every fourth pulse, each subgroup has an event of
    two pixels.
    """
    subgroup, pulse = (
        part.ravel() for part in np.indices((config.sensor.subgroups, config.pulses // 4))
    )
    arrays: dict[str, np.ndarray] = dict.fromkeys(EVENT_FIELDS, np.zeros(len(pulse), np.int64))
    arrays |= {"subgroup": subgroup, "pulse": 4 * pulse}
    hits = np.zeros((len(pulse), -(-config.sensor.pixels // BEAT_BITS)), np.uint64)
    hits[:, 0] = 0b11
    arrays |= {"stamp": pulse * 0 + config.period_ticks // 2, "count": pulse * 0 + 2, "hits": hits}
    seen = np.full((1, config.sensor.subgroups), config.pulses)
    return arrays | dict.fromkeys(COUNTER_NAMES, seen) | {"threshold_used": seen * 0 + 1}
