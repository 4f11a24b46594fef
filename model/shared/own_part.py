# SPDX-License-Identifier: Apache-2.0
"""Parts of a user's own, such as an estimator or a rule of coincidence: how messages and kept
results know them.
"""

import re
from typing import Protocol, runtime_checkable

from .errors import InputError, wrong_value

NAME = r"[A-Za-z][\w.-]*"  # no slash, which separates a method from its source


@runtime_checkable
class OwnPart(Protocol):
    """A part that a user may replace. docs/extend.md has one of each kind.

    Attributes
    ----------
    name : str
        How messages, results and files call it: letters, digits, and `_.-`.
    version : str
        Another one whenever the part would give other results: kept results depend on it.
    """

    @property
    def name(self) -> str: ...
    @property
    def version(self) -> str: ...


def check_part(field: str, part: OwnPart) -> None:
    """Raise `InputError` if a part for `field` has no usable name or no version."""
    for attribute in ("name", "version"):
        value = getattr(part, attribute, None)
        if not isinstance(value, str) or not value:
            raise InputError(
                f"{field}: {type(part).__name__}.{attribute} = {value!r}, must be a text",
                field=field,
            )
    if not re.fullmatch(NAME, part.name):
        raise wrong_value(
            field, part.name, "a name of letters, digits and _.- that begins with a letter"
        )
