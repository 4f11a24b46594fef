# SPDX-License-Identifier: Apache-2.0
"""The parts of AXI4-Lite and AXI4-Stream that the sensor's ports need.

Members have the bus's own names in lower case.
"""

from amaranth.lib.wiring import In, Out, Signature

from ..model.contract.packet import BEAT_BITS
from ..model.contract.registers import ADDRESS_BITS, DATA_BITS

OKAY, SLVERR = 0, 2

LITE = Signature(
    {  # members are the master's; flipped, the signature is the slave's
        "awaddr": Out(ADDRESS_BITS),
        "awprot": Out(3),
        "awvalid": Out(1),
        "awready": In(1),
        "wdata": Out(DATA_BITS),
        "wstrb": Out(DATA_BITS // 8),
        "wvalid": Out(1),
        "wready": In(1),
        "bresp": In(2),
        "bvalid": In(1),
        "bready": Out(1),
        "araddr": Out(ADDRESS_BITS),
        "arprot": Out(3),
        "arvalid": Out(1),
        "arready": In(1),
        "rdata": In(DATA_BITS),
        "rresp": In(2),
        "rvalid": In(1),
        "rready": Out(1),
    }
)

STREAM = Signature({"tdata": Out(BEAT_BITS), "tvalid": Out(1), "tready": In(1), "tlast": Out(1)})
