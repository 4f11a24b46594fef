# SPDX-License-Identifier: Apache-2.0
"""What every proof states, assumes and covers, and digests of it.

A proof that has lost a statement, or assumes too much, still holds, so no solver tells. Its digest
does. What it is stated of is no part of the digest: a change of the RTL alone renews none.

`python -m tests.formal.statements` writes the digests again; a change that means to change a proof
does so.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Any
from unittest.mock import patch

from amaranth.hdl import Fragment, Signal

from coincid.formal.proof_bench import Proof, parts_of
from coincid.formal.prove import SCRIPT, all_proofs

from ..digests import digest, write_digests

DIGESTS = Path(__file__).with_suffix(".json")
STATED = "(assert ", "(assume ", "(cover "
FREE = "(anyseq ", "(anyconst "  # what a bench puts in place of a block's outputs


def statements_of(proof: Proof) -> list[dict[str, list[str]]]:
    """Return the statements of each part of a proof that states something or has free outputs, by
    clock domain, as Amaranth writes them, with its signals told apart.
    """
    parts = []
    for part in parts_of(Fragment.get(proof.build(), None)):
        with patch.object(Signal, "__repr__", _told_apart(part)):
            by_domain = {domain: list(map(repr, of)) for domain, of in part.statements.items()}
        texts = [text for of in by_domain.values() for text in of]
        if any(text.startswith(STATED) or any(free in text for free in FREE) for text in texts):
            parts.append(by_domain)
    return parts


def _told_apart(part: Fragment) -> Callable[[Signal], str]:
    """Return what writes the signals of a part: a name, which several may have, and a number in the
    order in which they occur. One that the part drives also has its shape, its first value, and
    whether it keeps its value in a reset.
    """
    driven = {
        id(signal)
        for of in part.statements.values()
        for statement in of
        for signal in statement._lhs_signals()
    }
    numbers: dict[int, int] = {}

    def text(signal: Signal) -> str:
        number = numbers.setdefault(id(signal), len(numbers))
        what = f"{signal.shape()} {signal.init} {signal.reset_less}" if id(signal) in driven else ""
        return f"(sig {signal.name} {number} {what})"

    return text


def digest_of(proof: Proof) -> str:
    """Return the digest of what is proven, and of how."""
    models = [path.name for path in proof.models]
    how: list[Any] = [proof.depth, proof.cover, models, proof.script]
    return digest([SCRIPT.read_text(encoding="utf-8"), how, statements_of(proof)])


if __name__ == "__main__":
    found = {name: digest_of(proof) for name, proof in sorted(all_proofs().items())}
    write_digests(DIGESTS, list(found.items()))
