# SPDX-License-Identifier: Apache-2.0
"""Digests of results, and the files that keep them for tests: a result changes only on purpose."""

import hashlib
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np


def digest(result: Any) -> str:
    """Return the digest of a result of dicts, lists, arrays, numbers and texts.

    Floats count to six digits, because processors differ in the last one.
    """
    return hashlib.sha256(json.dumps(plain(result), sort_keys=True).encode()).hexdigest()[:16]


def plain(value: Any) -> Any:
    """Return a result in JSON's types, with floats to six digits."""
    if isinstance(value, dict):
        return {str(name): plain(each) for name, each in value.items()}
    if isinstance(value, np.ndarray):
        return [str(value.dtype), plain(value.tolist())]
    if isinstance(value, list | tuple):
        return [plain(each) for each in value]
    return f"{value:.6g}" if isinstance(value, float) else value


def read_digests(path: Path) -> list[Any]:
    """Return the digests of the cases of a file."""
    return json.loads(path.read_text(encoding="utf-8"))


def write_digests(path: Path, found: Sequence[Any]) -> None:
    """Write the digests of cases, a line for each."""
    lines = ",\n".join(json.dumps(one) for one in found)
    path.write_text(f"[\n{lines}\n]\n", encoding="utf-8")
