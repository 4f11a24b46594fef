# SPDX-License-Identifier: Apache-2.0
"""The cases that tests of golden model, RTL, host and decoders play have every pair of features."""

import pytest

from coincid.model.contract.parameters import SENSOR
from coincid.model.contract.settings import FRAME, SUBGROUP
from coincid.model.shared.errors import InputError

from .feature_pairs import (
    BUILT,
    IMPOSSIBLE,
    PULSES,
    REFUSED,
    USED,
    config_of,
    features_on,
    legal_pairs,
    paired_cases,
    pairs_of,
    played,
    sensor_of,
)
from .tb.test_cosim import PAIRED, SENSORS, SWITCHES

# Without a rule that depends on others: the same in all cases, or only a scale.
NOT_VARIED = {"clock_mhz", "dither_seed"}


def assert_all_pairs(features, impossible):
    legal = legal_pairs(features, impossible)
    found = set()
    for case in paired_cases(features, impossible):
        assert case.keys() == features.keys()
        found |= pairs_of(case)
    assert found == legal
    return len(legal)


def test_every_pair_of_features_comes_up():
    assert assert_all_pairs(BUILT | USED, IMPOSSIBLE) == 3625


def test_every_pair_of_features_comes_up_in_the_rtl():
    built = {name: SENSORS[name] for name in PAIRED}
    assert assert_all_pairs(*features_on(built)) > 1400


def test_sensors_of_the_rtl_have_every_pair_of_switches():
    tables = SENSORS.values()
    for one in SWITCHES:
        for other in SWITCHES:
            found = {(table.get(one, 1), table.get(other, 1)) for table in tables}
            assert len(found) == (2 if one == other else 4), (one, other)


def test_what_is_left_out_is_not_legal():
    """Every pair that no case has is refused with a sentence."""
    usual = {name: values[0] for name, values in (BUILT | USED).items()}
    for pair in REFUSED:
        case = usual | dict(pair)
        with pytest.raises(InputError):
            config_of(sensor_of(case), case)


def test_every_setting_and_parameter_varies():
    """Also those that come with a later version."""
    seen = {name: set() for name in (*SENSOR, *FRAME, *SUBGROUP)}
    for case in paired_cases(BUILT | USED):
        config = config_of(sensor_of(case), case)
        for name in SENSOR:
            seen[name].add(getattr(config.sensor, name))
        for name in FRAME:
            seen[name].add(getattr(config.frame, name))
        for name in SUBGROUP:
            seen[name].add(getattr(config, name).tobytes())
    seen["pulses"] = {PULSES, played(sensor_of(case), case | {"abort": "later"}, 0).pulses}
    for name, values in seen.items():
        assert len(values) > 1 or name in NOT_VARIED, name
