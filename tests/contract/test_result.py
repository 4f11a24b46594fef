# SPDX-License-Identifier: Apache-2.0
"""The comparison of results names every difference: a test that finds none has looked."""

import sys

import numpy as np
import pytest

from coincid.model.contract.counters import COUNTER_NAMES
from coincid.model.contract.gate_counts import Counts
from coincid.model.contract.packet import EVENT_FORMATS, FORMATS, FRAME_END, layout
from coincid.model.contract.result import (
    EVENT_COLUMNS,
    RECORD_COLUMNS,
    ResultBuilder,
    ResultFile,
    checked_events,
    differences,
    events_table,
    known_counters,
    map_numbers,
    read_result,
    write_result,
)
from coincid.model.contract.stream import StreamError
from coincid.model.golden.frame import Golden, golden_result
from coincid.model.shared.errors import InputError

from ..random_cases import GOLDEN_SENSORS, configured, random_edges

EVENTS = configured(
    GOLDEN_SENSORS["tiny"],
    {"format": "full", "minigroup_records": True, "mg_threshold": 1, "pulses": 10, "frames": 2},
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
    assert grown.events == len(whole.arrays()["pulse"])
    grown.write(tmp_path / "grown.npz", {"more": np.arange(3)})
    write_result(tmp_path / "whole.npz", whole.arrays())
    assert not differences(read_result(tmp_path / "grown.npz"), whole.arrays())
    with np.load(tmp_path / "grown.npz") as one, np.load(tmp_path / "whole.npz") as other:
        assert one.files == [*other.files, "more"]
    if config.counting:
        for name in Counts._fields:
            assert whole.arrays()[name].shape[:2] == (config.frames, config.sensor.subgroups)


@pytest.mark.parametrize("threshold", [1, 3])
@pytest.mark.parametrize("link_gbps", [0.0, 2.0])
def test_counters_at_their_end_follow_from_words_and_sums(threshold, link_gbps):
    """As far as those of drops and of rejected windows are not at their end, too."""
    of_frame = {"pulses": 60, "period": 60, "link_gbps": link_gbps}
    of_frame |= {"minigroup_records": True, "mg_threshold": 1}
    wide = configured(GOLDEN_SENSORS["default"], of_frame, {"threshold": threshold, "window": 4})
    edges = random_edges(wide, 40_000, 1)
    exact = golden_result(wide, edges)
    narrow = wide.with_sensor(counter_bits=9)
    found = known_counters(golden_result(narrow, edges), narrow)
    for name in COUNTER_NAMES:
        known = found.known[name]
        assert np.array_equal(found.least[name][known], exact[name][known]), name
        assert (found.least[name] <= exact[name]).all()
    assert found.known["stored"].all() and found.known["mg_stored"].all()
    of_committed = (exact["committed"] < 511) | (exact["dropped"] < 511)
    assert np.array_equal(found.known["committed"], of_committed)
    assert np.array_equal(found.known["opened"], of_committed & (exact["rejected"] < 511))
    assert exact["opened"].min() > 511
    assert known_counters(exact, wide).known["opened"].all()


TWO_STREAMS = configured(
    GOLDEN_SENSORS["default"] | {"streams": 2},
    {"pulses": 20, "period": 60, "minigroup_records": True},
    {"threshold": 1},
)


def beats_of(config):
    edges, _ = EDGES[COUNTS].frame(0, config.pulses)
    return Golden(config.sensor).frame(config, edges).beats


@pytest.mark.parametrize("format", FORMATS)
@pytest.mark.parametrize("other", FORMATS)
def test_a_frame_of_another_format_is_refused(format, other):
    """Its events would lack their map or their offsets, or there would be none."""
    beats = beats_of(TWO_STREAMS.with_frame(format=format))
    result = ResultBuilder(TWO_STREAMS.with_frame(format=other))
    if format == other:
        result.add(beats)
        return
    told = "in place of" if "counts" in (format, other) else f"another format than {other}"
    with pytest.raises(StreamError, match=told):
        result.add(beats)


@pytest.mark.parametrize("place", ["first", "last"])
@pytest.mark.parametrize("format", ["short", "id", "full"])
@pytest.mark.parametrize("other", ["short", "id", "full"])
def test_a_single_event_of_another_format_is_refused(format, other, place):
    first, second = beats_of(TWO_STREAMS.with_frame(format=format, minigroup_records=False))
    strange, _ = beats_of(TWO_STREAMS.with_frame(format=other, minigroup_records=False))
    lengths = layout(TWO_STREAMS.sensor)
    event = strange[1 : 1 + lengths.length(EVENT_FORMATS[other])]
    at = (
        1
        if place == "first"
        else -lengths.length(FRAME_END, len(TWO_STREAMS.sensor.stream_subgroups(0)))
    )
    result = ResultBuilder(TWO_STREAMS.with_frame(format=format, minigroup_records=False))
    beats = [np.insert(first, at, event), second]
    if format == other:
        result.add(beats)
        return
    with pytest.raises(StreamError, match=f"another format than {format}"):
        result.add(beats)


@pytest.mark.parametrize("format", FORMATS)
def test_streams_in_another_order_are_refused(format):
    config = TWO_STREAMS.with_frame(format=format)
    first, second = beats_of(config)
    result = ResultBuilder(config)
    with pytest.raises(StreamError, match="stream 0 has words of subgroup 1 of another stream"):
        result.add([second, first])
    with pytest.raises(StreamError, match="beats of 1 streams, not of 2"):
        result.add([first])
    with pytest.raises(StreamError, match="beats of 3 streams, not of 2"):
        result.add([first, second, second])
    result.add([first, second])


def test_records_alone_tell_that_streams_are_in_another_order():
    """No window meets the threshold here."""
    config = TWO_STREAMS.with_settings(threshold=64).with_frame(mg_threshold=1)
    first, second = beats_of(config)
    result = ResultBuilder(config)
    with pytest.raises(StreamError, match="stream 0 has words of subgroup 1 of another stream"):
        result.add([second, first])
    result.add([first, second])
    arrays = result.arrays()
    assert len(arrays["pulse"]) == 0 < len(arrays["mg_pulse"])


def test_streams_of_different_frames_are_refused():
    golden = Golden(TWO_STREAMS.sensor)
    edges, _ = EDGES[COUNTS].frame(0, TWO_STREAMS.pulses)
    first, later = golden.frame(TWO_STREAMS, edges), golden.frame(TWO_STREAMS, edges)
    with pytest.raises(StreamError, match=r"frames of different numbers: \[0, 1\]"):
        ResultBuilder(TWO_STREAMS).add([first.beats[0], later.beats[1]])


def test_records_that_are_off_are_refused():
    with pytest.raises(StreamError, match="minigroup records, which are off"):
        ResultBuilder(TWO_STREAMS.with_frame(minigroup_records=False)).add(beats_of(TWO_STREAMS))


@pytest.mark.parametrize("with_pandas", [True, False])
@pytest.mark.parametrize("words", [0, 1, 2])
def test_a_table_of_events_has_every_column_and_maps_of_any_width(words, with_pandas, monkeypatch):
    """As they are, with the highest pixel of the subgroup."""
    if not with_pandas:
        monkeypatch.setitem(sys.modules, "pandas", None)
    arrays = {name: np.array([3, 1, 2]) + 10 * k for k, name in enumerate(EVENT_COLUMNS)}
    if words:
        arrays["hits"] = np.array([[1] * words, [0] * words, [1 << 63] * words], np.uint64)
    table = events_table(arrays | {"opened": np.zeros((1, 2))})
    for name in EVENT_COLUMNS:
        assert np.asarray(table[name]).tolist() == arrays[name].tolist(), name
    expected = {0: None, 1: [1, 0, 1 << 63], 2: [(1 << 64) + 1, 0, (1 << 127) + (1 << 63)]}[words]
    names = list(table) if with_pandas else list(table.dtype.names)
    assert names == [*EVENT_COLUMNS, *["hits"] * bool(words)]
    assert not words or np.asarray(table["hits"]).tolist() == expected


def test_arrays_that_are_no_result_are_neither_a_table_nor_a_file(tmp_path):
    without = {name: array for name, array in RESULTS[EVENTS].items() if name != "winner"}
    for use in (events_table, lambda arrays: write_result(tmp_path / "r.npz", arrays)):
        with pytest.raises(InputError, match="arrays: winner is missing"):
            use(without)
        with pytest.raises(InputError, match=r"arrays = \[1, 2\]: must be Mapping"):
            use([1, 2])
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("name", [*EVENT_COLUMNS, *RECORD_COLUMNS, *COUNTER_NAMES])
def test_a_file_of_a_result_has_every_column(name, tmp_path):
    """Of events, of minigroup records, and of counters; a table of events needs no others."""
    without = {other: array for other, array in RESULTS[EVENTS].items() if other != name}
    with pytest.raises(InputError, match=f"arrays: {name} is missing"):
        write_result(tmp_path / "r.npz", without)
    assert not list(tmp_path.iterdir())
    if name in EVENT_COLUMNS:
        with pytest.raises(InputError, match=f"arrays: {name} is missing"):
            events_table(without)
    else:
        assert len(events_table(without)) == len(RESULTS[EVENTS]["pulse"])


@pytest.mark.parametrize("dropped, opened_known", [(0, True), (511, False)])
def test_a_sum_is_known_if_the_sums_that_it_holds_are(dropped, opened_known):
    """Counters of 9 bits at their end, in two frames of 20 pulses."""
    narrow = configured(
        GOLDEN_SENSORS["default"] | {"rows": 8, "cols": 16, "counter_bits": 9},
        {"pulses": 20, "frames": 2},
    )
    arrays = {name: np.zeros((2, 2), np.int64) for name in COUNTER_NAMES}
    for name in ("opened", "committed", "stored"):
        arrays[name] += 511
    arrays["dropped"] += dropped
    arrays["rejected"] += 3
    stored = np.array([[520, 530], [540, 550]])
    frame, subgroup = (index.ravel() for index in np.indices(stored.shape))
    arrays["pulse"] = np.repeat(20 * frame + 7, stored.ravel())
    arrays["subgroup"] = np.repeat(subgroup, stored.ravel())
    arrays["mg_pulse"], arrays["mg_subgroup"] = np.array([39]), np.array([1])
    found = known_counters(arrays, narrow)
    np.testing.assert_array_equal(found.least["stored"], stored)
    np.testing.assert_array_equal(found.least["committed"], stored + dropped)
    np.testing.assert_array_equal(found.least["opened"], stored + dropped + 3)
    assert found.known["opened"].all() == found.known["committed"].all() == opened_known
    assert found.least["mg_stored"].tolist() == [[0, 0], [0, 1]]


@pytest.mark.parametrize("words", [1, 2, 4])
def test_a_map_is_one_number_whose_bits_are_the_pixels(words):
    hits = np.zeros((3, words), np.uint64)
    pixels = [0], [64 * words - 1, 5], range(0, 64 * words, 3)
    for row, of_event in zip(hits, pixels, strict=True):
        for pixel in of_event:
            row[pixel // 64] |= np.uint64(1) << np.uint64(pixel % 64)
    assert [int(number) for number in map_numbers(hits)] == [
        sum(1 << pixel for pixel in of_event) for of_event in pixels
    ]


OF_EVENTS = configured({"rows": 8, "cols": 16}, {"pulses": 20, "period": 60, "frames": 2})
ENDS = {"pulse": 40, "subgroup": 2, "stamp": 60 * 32, "count": 65, "winner": 64}


@pytest.mark.parametrize("name", ENDS)
def test_a_column_of_events_ends_with_the_last_legal_number(name):
    """Of all frames, subgroups, ticks and pixels. The next one is of another configuration."""
    arrays = {one: np.zeros(3, np.uint16) for one in ENDS} | {"opened": np.zeros((2, 2), int)}
    last = ENDS[name] - 1
    arrays[name] = np.array([0, last, 1])
    assert checked_events(arrays, OF_EVENTS)[name].tolist() == arrays[name].tolist()
    arrays[name] += 1
    told = f"^arrays: {name} is 1 to {last + 1}, must be 0 to {last}; the configuration must be"
    with pytest.raises(InputError, match=told):
        checked_events(arrays, OF_EVENTS)
    arrays[name] -= 2
    with pytest.raises(InputError, match=f"^arrays: {name} is -1 to {last - 1}, must be 0 to"):
        checked_events(arrays, OF_EVENTS)
