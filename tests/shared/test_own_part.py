# SPDX-License-Identifier: Apache-2.0
"""Names and versions of a user's own parts."""

from types import SimpleNamespace

import pytest

from coincid.model.shared.errors import InputError
from coincid.model.shared.own_part import OwnPart, check_part


def part(name="mine", version="1"):
    return SimpleNamespace(name=name, version=version)


@pytest.mark.parametrize("name", ["m", "Mine", "m2", "my-own_part.2"])
def test_a_name_has_letters_digits_and_three_signs(name):
    assert isinstance(part(name), OwnPart)
    check_part("part", part(name))


@pytest.mark.parametrize("name", ["a/b", "a b", "2a", "-a", ".a", "_a", "a\n", "a,"])
def test_another_name_is_refused(name):
    """A slash would separate it from a source."""
    with pytest.raises(InputError, match=r"^part = .*: must be a name of letters, digits") as told:
        check_part("part", part(name))
    assert told.value.field == "part"


@pytest.mark.parametrize("attribute", ["name", "version"])
@pytest.mark.parametrize("value", ["", None, 3])
def test_a_name_and_a_version_are_texts(attribute, value):
    """An empty version would be that of every other part without one."""
    message = rf"^part: SimpleNamespace\.{attribute} = {value!r}, must be a text$"
    with pytest.raises(InputError, match=message) as told:
        check_part("part", part(**{attribute: value}))
    assert told.value.field == "part"
    with pytest.raises(InputError, match=rf"{attribute} = None"):
        check_part("part", SimpleNamespace(**{"name": "a", "version": "1"} | {attribute: None}))
    lacks = part()
    delattr(lacks, attribute)
    with pytest.raises(InputError, match=rf"{attribute} = None"):
        check_part("part", lacks)
