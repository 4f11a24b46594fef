# SPDX-License-Identifier: Apache-2.0
"""Waveforms of lanes: from samples of their words, one per clock cycle, to a VCD file with all
signals.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from vcd import VCDWriter

from ..model.shared.files import whole_file
from .probe import SEPARATOR, Probe

BLOCK = 1024  # words that are transposed at once


def by_word(rows: np.ndarray, words: int) -> np.ndarray:
    """Return samples as `Probe` takes them, uint64[words, n]. rows: uint64[cycles, m], the bits
    of all words in a cycle.

    The last column is filled with zeros.
    """
    cycles = len(rows)
    turned = np.zeros((words, -(-cycles // 64) * 8), np.uint8)
    bytes_ = np.ascontiguousarray(rows).view(np.uint8).reshape(cycles, 8 * rows.shape[1])
    for first in range(0, words, BLOCK):
        bits = np.unpackbits(
            bytes_[:, first // 8 : (first + BLOCK) // 8], axis=1, bitorder="little"
        )
        bits = bits[:, : words - first]
        turned[first : first + bits.shape[1], : -(-cycles // 8)] = np.packbits(
            bits.T, axis=1, bitorder="little"
        )
    return turned.view(np.uint64)


def write_vcd(
    path: Path,
    probe: Probe,
    lanes: Mapping[str, np.ndarray],
    *,
    names: Sequence[str] | None = None,
    first_cycle: int = 0,
    cycle_ps: int = 1000,
) -> None:
    """Write the waveform of some lanes.

    lanes: scope -> uint64[cycles, m], as the library records them. names: of signals; None: all
    that the Verilog names.
    first_cycle: number of the first sample. A signal's value in a cycle is the one before the
    edge that ends it.
    """
    chosen = sorted(names if names is not None else probe.signals)
    changes: list[tuple[int, int, int]] = []  # cycle, variable, value
    with whole_file(path, "w") as file, VCDWriter(file, timescale="1 ps") as writer:
        variables = []
        for scope, rows in lanes.items():
            values = probe.values(by_word(rows, probe.layout.words), chosen)
            for name in chosen:
                inner, _, last = name.rpartition(SEPARATOR)
                width = len(values[name])
                full_scope = f"{scope}{SEPARATOR}{inner}".rstrip(SEPARATOR)
                variables.append(writer.register_var(full_scope, last, "wire", size=width))
                changes += [
                    (cycle, len(variables) - 1, value)
                    for cycle, value in _changes(values[name], len(rows))
                ]
        changes.sort()
        for cycle, number, value in changes:
            writer.change(variables[number], (first_cycle + cycle) * cycle_ps, value)
        longest = max(map(len, lanes.values()), default=0)
        writer.close(timestamp=(first_cycle + longest) * cycle_ps)


def _changes(bits: np.ndarray, cycles: int) -> list[tuple[int, int]]:
    """Return (cycle, value) of a signal at the beginning and wherever it changes."""
    if not cycles:
        return []
    each = np.unpackbits(
        np.ascontiguousarray(bits).view(np.uint8), axis=1, bitorder="little", count=cycles
    )
    at = np.flatnonzero(np.concatenate([[True], (each[:, 1:] != each[:, :-1]).any(axis=0)]))
    packed = np.packbits(each[:, at], axis=0, bitorder="little")
    return [
        (int(cycle), int.from_bytes(column.tobytes(), "little"))
        for cycle, column in zip(at, packed.T, strict=True)
    ]
