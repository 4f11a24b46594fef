# SPDX-License-Identifier: Apache-2.0
"""The proofs of the sensor's blocks; importing this module registers them."""

from . import async_front as async_front
from . import clock_gate as clock_gate
from . import controller as controller
from . import counts as counts
from . import dpcu as dpcu
from . import fifo as fifo
from . import gate_search as gate_search
from . import groups as groups
from . import idle as idle
from . import readout as readout
from . import registers as registers
from . import soft_reset as soft_reset
from . import timing as timing
from . import tree as tree
