# SPDX-License-Identifier: Apache-2.0
"""What `coincid sim` adds to a configuration."""

import pytest

from coincid.model.contract.config import parse_config
from coincid.study.simulate import LINK_FORMAT, LINK_GBPS, with_link


@pytest.mark.parametrize(
    ("of_the_configuration", "asked", "taken"),
    [
        (None, None, LINK_GBPS),
        (None, 0.0, 0.0),  # no limit
        (None, 3.0, 3.0),
        (0.0, None, 0.0),
        (5.0, None, 5.0),
        (5.0, 0.0, 0.0),
        (5.0, 3.0, 3.0),
    ],
)
def test_the_link_is_the_one_that_was_asked_for(of_the_configuration, asked, taken):
    frame = {} if of_the_configuration is None else {"link_gbps": of_the_configuration}
    config = with_link(parse_config({"frame": frame}), asked)
    assert (config.frame.link_gbps, config.format) == (taken, LINK_FORMAT)
    chosen = parse_config({"frame": frame | {"format": "full"}})
    assert with_link(chosen, asked).format == "full"
