# SPDX-License-Identifier: Apache-2.0
"""Values of all signals of a design, also of logic that a pass keeps nowhere, from samples of a
slice's words.

A sample is one bit of every word: a lane in one cycle. Samples come in words of 64, so the same
functions show all lanes in one cycle, or one lane in many cycles.
"""

from collections.abc import Iterable
from typing import TypeAlias

import numpy as np

from .emit import Emission
from .netlist import ONE, ZERO, Block, Memory, Read, Table

TOP = ""  # as the name of an instance
SEPARATOR = "."
ALL = np.array([-1]).view(np.uint64)  # 64 samples
Net: TypeAlias = tuple[str, int]  # instance and net in its block
Known: TypeAlias = dict[Net, np.ndarray]


class Probe:
    """Signals of a design by name: those of the top, and those of a unit's instance behind
    `instance.`.
    """

    def __init__(self, emission: Emission):
        self.layout = emission.layout
        self._blocks: dict[str, Block] = {TOP: emission.top}
        self._blocks |= {i.name: emission.blocks[i.unit] for i in emission.top.instances}
        self._producers = {block.name: _producers(block) for block in self._blocks.values()}
        self._links: dict[Net, Net] = {}  # through the ports of instances
        for instance in emission.top.instances:
            unit = emission.blocks[instance.unit]
            for port, outer in instance.nets.items():
                for inner, net in zip(unit.inputs.get(port, ()), outer, strict=False):
                    self._links[instance.name, inner] = TOP, net
                for inner, net in zip(unit.outputs.get(port, ()), outer, strict=False):
                    self._links[TOP, net] = instance.name, inner
        self.signals: dict[str, tuple[str, tuple[int, ...]]] = {}
        for scope, block in self._blocks.items():
            prefix = scope and f"{scope}{SEPARATOR}"
            known = self._places(scope).keys() | self._producers[block.name].keys() | {ZERO, ONE}
            known |= {net for at, net in self._links if at == scope}
            # Generated names have a dollar sign; the clock, and what nothing drives, has no value.
            self.signals |= {
                f"{prefix}{name}": (scope, nets)
                for name, nets in block.names.items()
                if "$" not in name and known.issuperset(nets)
            }

    def words(self, name: str) -> list[int]:
        """Return the words that hold a register or an input, lowest bit first. Raises `KeyError`
        if it is logic.
        """
        instance, nets = self.signals[name]
        places = self._places(instance)
        return [places[net] for net in nets]

    def _places(self, instance: str) -> dict[int, int]:
        return self.layout.instances[instance] if instance else self.layout.nets

    def values(self, samples: np.ndarray, names: Iterable[str]) -> dict[str, np.ndarray]:
        """Return the bits of signals in samples, by name.

        samples: uint64[words, n], 64 samples in each column. A signal's bits are uint64[bits,
        n], lowest bit first.
        """
        known: dict[Net, np.ndarray] = {}
        return {name: self._signal(samples, known, *self.signals[name]) for name in names}

    def _signal(
        self, samples: np.ndarray, known: Known, instance: str, nets: tuple[int, ...]
    ) -> np.ndarray:
        for net in nets:
            self._compute(samples, known, (instance, net))
        return np.stack([known[instance, net] for net in nets])

    def _compute(self, samples: np.ndarray, known: Known, wanted: Net) -> None:
        """Compute a net, and all on which it depends."""
        stack = [wanted]
        while stack:
            instance, net = stack[-1]
            node = self._producers[self._blocks[instance].name].get(net)
            link = self._links.get((instance, net))
            needs = [link] if link else [(instance, x) for x in node.inputs] if node else []
            missing = (
                [] if (instance, net) in known else [need for need in needs if need not in known]
            )
            if missing:
                stack += missing
                continue
            stack.pop()
            if (instance, net) in known:
                continue
            inputs = [known[need] for need in needs]
            if link:
                known[instance, net] = inputs[0]
            elif isinstance(node, Table):
                known[instance, net] = _table(node, inputs, samples.shape[1])
            elif node:
                rows = self._read(samples, node, inputs)
                known |= {
                    (instance, output): row for output, row in zip(node.outputs, rows, strict=True)
                }
            else:
                known[instance, net] = self._sampled(samples, instance, net)

    def _sampled(self, samples: np.ndarray, instance: str, net: int) -> np.ndarray:
        if net in (ZERO, ONE):
            return (ALL if net == ONE else ~ALL).repeat(samples.shape[1])
        return samples[self._places(instance)[net]]

    def _read(self, samples: np.ndarray, node: Read, address: list[np.ndarray]) -> np.ndarray:
        memory: Memory = node.memory
        first = self.layout.memories[memory.name]
        value = np.zeros((memory.width, samples.shape[1]), np.uint64)
        for row in range(memory.rows):
            value |= samples[first + row * memory.width :][: memory.width] & _chosen(
                row, address, samples.shape[1]
            )
        return value


def _producers(block: Block) -> dict[int, Table | Read]:
    """Return what computes each net, unless it is a register or a port."""
    found: dict[int, Table | Read] = {table.outputs[0]: table for table in block.tables}
    found |= {
        net: read for memory in block.memories for read in memory.reads for net in read.outputs
    }
    return found


def _table(table: Table, inputs: list[np.ndarray], n: int) -> np.ndarray:
    value = np.zeros(n, np.uint64)
    for row in range(1 << len(inputs)):
        if table.bits >> row & 1:
            value |= _chosen(row, inputs, n)
    return value


def _chosen(row: int, bits: list[np.ndarray], n: int) -> np.ndarray:
    """Return in which of 64 n samples the bits, lowest first, are the number `row`."""
    found = ALL.repeat(n)
    for k, bit in enumerate(bits):
        found &= bit if row >> k & 1 else ~bit
    return found


def numbers(bits: np.ndarray) -> list[int]:
    """Return the signal's number in each sample. bits: uint64[bits, n], as from `Probe.values`."""
    columns = np.unpackbits(np.ascontiguousarray(bits).view(np.uint8), axis=1, bitorder="little")
    packed = np.packbits(columns, axis=0, bitorder="little")
    return [int.from_bytes(column.tobytes(), "little") for column in packed.T]
