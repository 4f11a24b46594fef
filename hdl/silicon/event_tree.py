# SPDX-License-Identifier: Apache-2.0
"""Event tree of the asynchronous view: passes the first edge of a cycle on to the TDC and the
minigroups.

The paper (III-A): the tree is "modelled to propagate events"; the propagated event is "passed to a
shared TDC to sample the internal states", and every minigroup "provides a coarse timestamp". An
arbiter tree beside it records which edge came first. The circuits are our choice.
"""

from amaranth.hdl import Cat, Const, Instance, Module
from amaranth.lib.wiring import In, Out

from ...model.contract.parameters import Sensor
from ..unit import Unit
from .circuit import HIT_FS, LEVEL_FS, arbiter_rows, delayed, lag_fs, levels, or_tree, sample


def code_bits(sensor: Sensor) -> int:
    """Return the number of bits that an event samples: phases, and the Gray count twice."""
    return sensor.phases // 2 + 2 * sensor.coarse_bits


def mark_bits(sensor: Sensor) -> int:
    """Return the number of bits that a minigroup samples: one tap per step of the coarse offsets,
    and `half`.
    """
    return sensor.offset_phases // 2 + 1


class EventTree(Unit):
    """Tree over one bank of hit flops, which collects the edges of one cycle.

    Ports
    -----
    hits : in, pixels; phases, gray_a, gray_b, half : in, from the TDC
    root : out, some pixel was hit
    code : out, `code_bits` as the first hit sampled them: phases, gray_a, gray_b
    marks : out, `mark_bits` per minigroup, as its first hit sampled them
    later_first : out, one bit per node of the arbiter tree (`arbiter_rows`): the request of the
        higher index came first

    The tree has no clock. Clearing `hits` returns it to its initial state.
    """

    unit_name = "coincid_async_tree"
    clocked = False

    def __init__(self, sensor: Sensor):
        self.sensor = sensor
        super().__init__(
            hits=In(sensor.pixels),
            phases=In(sensor.phases // 2),
            gray_a=In(sensor.coarse_bits),
            gray_b=In(sensor.coarse_bits),
            half=In(1),
            root=Out(1),
            code=Out(code_bits(sensor)),
            marks=Out(mark_bits(sensor) * sensor.minigroups),
            later_first=Out(sensor.pixels - 1),
        )

    def elaborate(self, platform):
        m = Module()
        sensor = self.sensor
        mark = Cat(*self.phases[:: sensor.offset_ticks], self.half)
        leaves = []
        marks = []
        for g in range(sensor.minigroups):
            leaf = or_tree(m, f"minigroup_{g}", [self.hits[i] for i in sensor.members(g)])
            later = delayed(
                m,
                f"event_{g}",
                leaf,
                lag_fs(sensor) - HIT_FS - LEVEL_FS * levels(sensor.minigroup_pixels),
            )
            leaves.append(leaf)
            marks.append(sample(m, f"mark_{g}", later, mark))
        m.d.comb += [self.root.eq(or_tree(m, "tree", leaves)), self.marks.eq(Cat(marks))]
        m.d.comb += self.code.eq(
            sample(m, "line", self.root, Cat(self.phases, self.gray_a, self.gray_b))
        )

        requests = dict(enumerate(self.hits))
        for level, (pairs, alone) in enumerate(arbiter_rows(sensor.pixels)):
            for k, a, b in pairs:
                m.submodules[f"mutex_{k}"] = Instance(
                    "coincid_mutex", i_a=requests[a], i_b=requests[b], o_second=self.later_first[k]
                )
                requests[sensor.pixels + k] = or_tree(m, f"request_{k}", [requests[a], requests[b]])
            if alone is not None:  # with the same delay as the others of its level
                requests[alone] = or_tree(m, f"wait_{level}", [requests[alone], Const(0)])
        return m
