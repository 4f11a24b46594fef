# SPDX-License-Identifier: Apache-2.0
"""The clocks of the deserialiser's flip-flops. A simulation without delays does not see a hop that
is too short for a real flip-flop, so the hops are read from the Verilog.
"""

import re

import pytest
from amaranth.back import rtlil

from coincid.hdl.deserialiser import Deserialiser
from coincid.hdl.to_verilog import to_verilog
from coincid.model.contract.parameters import Sensor

FLOP = re.compile(r"@\((pos|neg)edge (clk|clocks(?:\[\d+\])?)\)\s+(\w+) <= (\w+);")


def flops(phases):
    """Return register -> (what it takes, tick of the cycle in which it takes it)."""
    sensor = Sensor(rows=4, cols=4, subgroup=(4, 4), phases=phases)
    found = {}
    text = to_verilog({"design": rtlil.convert(Deserialiser(sensor))})["design"]
    for edge, clock, register, value in FLOP.findall(text):
        tick = 0
        if clock != "clk":  # clock j is bit j - 1
            tick = 1 + int(clock.partition("[")[2].rstrip("]") or 0)
        if edge == "neg":
            tick += phases // 2
        found[register] = value, tick
    return found, re.findall(r"assign rises_\d+ += (\w+) & ", text)


@pytest.mark.parametrize("phases", [4, 8])
def test_every_hop_between_clocks_takes_half_a_cycle_or_more(phases):
    found, _ = flops(phases)
    assert len(found) == 3 * phases  # sample, held and level of each tick, the level before
    for register, (value, tick) in found.items():
        if value != "lines":
            _, since = found[value]
            hop_ticks = (tick - since) % phases or phases
            assert hop_ticks >= phases / 2, f"{value} to {register}"


@pytest.mark.parametrize("phases", [4, 8])
def test_every_tick_is_sampled_at_its_moment_and_twice_registered(phases):
    found, compared = flops(phases)
    assert sorted(compared) == [f"level_{j}" for j in range(1, phases + 1)]
    for j in range(1, phases + 1):
        assert found[f"sample_{j}"] == ("lines", j % phases)
        chain = [f"level_{j}"]
        while chain[-1] != "lines":
            chain.append(found[chain[-1]][0])
        assert chain[-2] == f"sample_{j}"
        assert len(chain) >= 3
        assert found[f"level_{j}"][1] == 0  # of the system clock
