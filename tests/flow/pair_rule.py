# SPDX-License-Identifier: Apache-2.0
"""A rule of coincidence that is not the sensor's own, for what a flow says and asks of it."""

from coincid.model.contract.coincidence import Rule


class Pair(Rule):
    """Two pixels, at any threshold."""

    name, version = "pair", "4"

    def meets(self, maps, threshold):
        return maps.sum(axis=(1, 2)) >= 2
