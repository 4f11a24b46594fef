# SPDX-License-Identifier: Apache-2.0
"""The comparison of results names every difference: a test that finds none has looked."""

import numpy as np
import pytest

from coincid.model.contract.gate_counts import Counts
from coincid.model.contract.result import (
    ResultBuilder,
    ResultFile,
    differences,
    read_result,
    write_result,
)
from coincid.model.contract.stream import StreamError
from coincid.model.golden.frame import Golden, golden_result

from ..random_cases import GOLDEN_SENSORS, configured, random_edges

EVENTS = configured(
    GOLDEN_SENSORS["tiny"],
    {"format": "full", "minigroup_records": True, "mg_threshold": 1, "pulses": 20},
    {"threshold": 1},
)
COUNTS = configured(
    GOLDEN_SENSORS["default"], {"format": "counts", "pulses": 20, "period": 60, "frames": 2}
)
EDGES = {EVENTS: random_edges(EVENTS, 300, 1), COUNTS: random_edges(COUNTS, 4000, 1)}
RESULTS = {config: golden_result(config, edges) for config, edges in EDGES.items()}
ARRAYS = [
    *((EVENTS, name) for name in sorted(RESULTS[EVENTS].keys() - {"fate"})),
    *((COUNTS, name) for name in Counts._fields),
]


def of_array(case):
    return case if isinstance(case, str) else case.format


@pytest.mark.parametrize(("config", "name"), ARRAYS, ids=of_array)
def test_any_changed_element_is_a_difference(config, name):
    """Also the last one, in either result."""
    result = RESULTS[config]
    assert result[name].size
    changed = result[name].copy()
    changed.flat[-1] = not changed.flat[-1] if changed.dtype == bool else changed.flat[-1] ^ 1
    last = [length - 1 for length in changed.shape]
    for one, other in ((result, changed), (changed, result)):
        results = [each if each is result else result | {name: changed} for each in (one, other)]
        (line,) = differences(*results)
        values = [of[name][tuple(last)] for of in results]
        assert line == f"{name}{last}: {values[0]} and {values[1]}"


@pytest.mark.parametrize(("config", "name"), ARRAYS, ids=of_array)
def test_another_type_another_length_and_a_missing_array_are_differences(config, name):
    result = RESULTS[config]
    shorter = result | {name: result[name][:-1]}
    wider = result | {name: result[name].astype(np.float64)}
    without = {each: array for each, array in result.items() if each != name}
    for other in (shorter, wider, without):
        for pair in ((result, other), (other, result)):
            (line,) = differences(*pair)
            assert line.startswith(f"{name}: ")


@pytest.mark.parametrize("config", RESULTS, ids=of_array)
def test_a_result_equals_itself_and_what_is_read_again(config, tmp_path):
    result = RESULTS[config]
    write_result(tmp_path / "r.npz", result)
    again = read_result(tmp_path / "r.npz")
    assert again.keys() == result.keys() and not differences(result, again)
    assert not differences(result, result | {"fate": result["fate"][:0]})  # only golden has it


@pytest.mark.parametrize("config", RESULTS, ids=of_array)
def test_a_file_of_frames_is_the_file_of_their_arrays(config, tmp_path):
    """It also has a fixed length per frame: of counts, a row of all subgroups."""
    golden = Golden(config.sensor)
    grown = ResultFile(config)
    whole = ResultBuilder(config)
    for number in range(config.frames):
        edges, _ = EDGES[config].frame(number, config.pulses)
        trace = golden.frame(config, edges)
        for result in (grown, whole):
            result.add(trace.beats, trace.commit_subgroup, trace.commit_cycle)
    grown.write(tmp_path / "grown.npz", {})
    write_result(tmp_path / "whole.npz", whole.arrays())
    assert not differences(read_result(tmp_path / "grown.npz"), whole.arrays())
    with np.load(tmp_path / "grown.npz") as one, np.load(tmp_path / "whole.npz") as other:
        assert one.files == other.files
    if config.counting:
        for name in Counts._fields:
            assert whole.arrays()[name].shape[:2] == (config.frames, config.sensor.subgroups)


def test_a_frame_of_events_is_none_of_counts():
    of_events = COUNTS.with_frame(format="id")
    trace = Golden(COUNTS.sensor).frame(of_events, EDGES[COUNTS].frame(0, COUNTS.pulses)[0])
    with pytest.raises(StreamError, match="has events in place of counts"):
        ResultBuilder(COUNTS).add(trace.beats)
