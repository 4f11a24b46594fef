# SPDX-License-Identifier: Apache-2.0
"""Writes a configuration as a file that `load_config` reads as the same configuration."""

from typing import Any

import numpy as np

from ..model.contract.config import Config, toml_text


def config_text(config: Config) -> str:
    """Return a configuration file (TOML) with the keys that were written. The first subgroup's
    settings are those of all, and others have an [[override]]. A sensor's own rule of coincidence
    has no key.
    """
    document = config.written()
    own = {name: _values(config, name) for name in document["subgroup"]}
    document["subgroup"] = {name: values[0] for name, values in own.items()}
    # a file has no word for None, which is the default of keys that have it
    document["frame"] = {k: v for k, v in document["frame"].items() if v is not None}
    overrides = [toml_text({"[override]": table}) for table in _overrides(own, config)]
    return "\n".join([toml_text(document), *overrides])


def mask_text(mask: np.ndarray) -> str:
    """Return a mask as hex digits: bit i is pixel i."""
    return f"{sum(1 << int(i) for i in np.flatnonzero(mask)):x}"


def _values(config: Config, name: str) -> list[Any]:
    """Return the value of a setting in each subgroup, as a file holds it."""
    values: np.ndarray = getattr(config, name)
    return [mask_text(mask) for mask in values] if name == "mask" else values.tolist()


def _overrides(own: dict[str, list[Any]], config: Config) -> list[dict[str, Any]]:
    """Return a table for each group of subgroups that differ from the first one in the same way."""
    groups: dict[tuple[tuple[str, Any], ...], list[int]] = {}
    for s in range(config.sensor.subgroups):
        differing = [(name, values[s]) for name, values in own.items() if values[s] != values[0]]
        groups.setdefault(tuple(differing), []).append(s)
    return [
        {"subgroups": subgroups} | dict(settings)
        for settings, subgroups in groups.items()
        if settings
    ]
