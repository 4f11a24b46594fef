# SPDX-License-Identifier: Apache-2.0
"""What a release holds changes only on purpose."""

import pytest

from ..file_digests import expected, of_release
from ..releases import SMALL


@pytest.mark.parametrize("name", SMALL)
def test_every_file_of_a_release_stays_as_it_is(name):
    assert of_release(name) == expected()["releases"][name]
