# SPDX-License-Identifier: Apache-2.0
"""What every proof states, assumes and covers, and digests of it.

A proof that has lost a statement, or assumes too much, still holds, so no solver tells. Its digest
does. What it is stated of is no part of the digest: a change of the RTL alone renews none.

`python -m tests.formal.statements` writes the digests again; a change that means to change a proof
does so.
"""

from pathlib import Path
from typing import Any

from amaranth.hdl import Fragment

from coincid.formal.proof_bench import Proof, parts_of
from coincid.formal.prove import SCRIPT, all_proofs

from ..digests import digest, write_digests

DIGESTS = Path(__file__).with_suffix(".json")
STATED = "(assert ", "(assume ", "(cover "


def statements_of(proof: Proof) -> list[dict[str, list[str]]]:
    """Return the statements of each part of a proof that states something, by clock domain, as
    Amaranth writes them.
    """
    parts = []
    for part in parts_of(Fragment.get(proof.build(), None)):
        by_domain = {domain: list(map(repr, of)) for domain, of in part.statements.items()}
        if any(text.startswith(STATED) for of in by_domain.values() for text in of):
            parts.append(by_domain)
    return parts


def digest_of(proof: Proof) -> str:
    """Return the digest of what is proven, and of how."""
    models = [path.name for path in proof.models]
    how: list[Any] = [proof.depth, proof.cover, models, proof.script]
    return digest([SCRIPT.read_text(encoding="utf-8"), how, statements_of(proof)])


if __name__ == "__main__":
    found = {name: digest_of(proof) for name, proof in sorted(all_proofs().items())}
    write_digests(DIGESTS, list(found.items()))
