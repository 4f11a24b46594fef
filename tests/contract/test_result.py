# SPDX-License-Identifier: Apache-2.0
"""The comparison of results names every difference: a test that finds none has looked."""

import numpy as np
import pytest

from coincid.model.contract.result import differences, read_result, write_result
from coincid.model.golden.frame import golden_result

from ..random_cases import SENSORS, configured, random_edges

CONFIG = configured(
    SENSORS["tiny"],
    {"format": "full", "minigroup_records": True, "mg_threshold": 1, "pulses": 20},
    {"threshold": 1},
)
RESULT = golden_result(CONFIG, random_edges(CONFIG, 300, 1))
NAMES = sorted(RESULT.keys() - {"fate"})


@pytest.mark.parametrize("name", NAMES)
def test_any_changed_element_is_a_difference(name):
    """Also the last one, in either result."""
    assert RESULT[name].size
    changed = RESULT[name].copy()
    changed.flat[-1] = not changed.flat[-1] if changed.dtype == bool else changed.flat[-1] ^ 1
    last = [length - 1 for length in changed.shape]
    for one, other in ((RESULT, changed), (changed, RESULT)):
        results = [each if each is RESULT else RESULT | {name: changed} for each in (one, other)]
        (line,) = differences(*results)
        values = [result[name][tuple(last)] for result in results]
        assert line == f"{name}{last}: {values[0]} and {values[1]}"


@pytest.mark.parametrize("name", NAMES)
def test_another_type_another_length_and_a_missing_array_are_differences(name):
    shorter = RESULT | {name: RESULT[name][:-1]}
    wider = RESULT | {name: RESULT[name].astype(np.float64)}
    without = {each: array for each, array in RESULT.items() if each != name}
    for other in (shorter, wider, without):
        for pair in ((RESULT, other), (other, RESULT)):
            (line,) = differences(*pair)
            assert line.startswith(f"{name}: ")


def test_a_result_equals_itself_and_what_is_read_again(tmp_path):
    write_result(tmp_path / "r.npz", RESULT)
    again = read_result(tmp_path / "r.npz")
    assert again.keys() == RESULT.keys() and not differences(RESULT, again)
    assert not differences(RESULT, RESULT | {"fate": RESULT["fate"][:0]})  # only golden has it
