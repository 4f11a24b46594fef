# SPDX-License-Identifier: Apache-2.0
"""Groups of events: an independent decoder reads the same rows as formats without groups; damage
costs one group and is told.
"""

import zlib
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from coincid.host.driver import FrameAssembler
from coincid.model.contract.groups import LAST_LSB
from coincid.model.contract.packet import BEAT_BITS, KIND_BITS, KIND_LSB, Field, Packet, parts_of
from coincid.model.contract.stream import StreamError, decode_frame, packet_starts
from coincid.model.contract.ungroup import ungroup
from coincid.model.golden.frame import Golden

from .. import random_cases

SENSORS = {name: random_cases.built_sensor(table) for name, table in random_cases.SENSORS.items()}
ROWS = ("events", "hits", "offsets", "records", "entries")


def plain_events(beats, sensor, with_check=True):
    """Read the events of docs/contract.md from the beats of whole groups, sentence by sentence, as
    plain tuples.
    """
    found, group = [], []
    for beat in map(int, beats):
        if beat >> 61 != 5:
            continue
        assert (beat >> 60 & 1) == (not group)
        group.append(beat)
        if not beat >> 59 & 1:
            continue
        check = group[-1] >> 27 & 0xFFFFFFFF
        group[-1] &= ~(0xFFFFFFFF << 27)
        assert check == zlib.crc32(b"".join(each.to_bytes(8, "little") for each in group))
        payloads = [each & ((1 << 59) - 1) for each in group]
        bits = sum(each << 59 * k for k, each in enumerate(payloads))
        left = 59 * len(group) - 32

        def take(width):
            nonlocal bits, left
            value, bits, left = bits & ((1 << width) - 1), bits >> width, left - width
            return value

        pulse, _, stamp_bits, with_offsets = take(16), take(8), take(4), take(1)
        now = pulse
        while left >= 3 and (listed := take(3)):
            overrun, subgroup = take(1), take(max(1, (sensor.subgroups - 1).bit_length()))
            if not take(1):
                now = pulse - take(4)
            pixel_bits = (sensor.pixels - 1).bit_length()
            stamp, winner = take(stamp_bits), take(pixel_bits)
            hits = {winner} | {take(pixel_bits) for _ in range(listed - 1)} if listed < 7 else None
            if hits is None:
                shown = take(sensor.pixels)
                hits = {i for i in range(sensor.pixels) if shown >> i & 1}
            offsets = {}
            if with_offsets:
                hit = [g for g in range(sensor.minigroups) if hits & set(sensor.members(g))]
                while hit:
                    offsets[hit.pop(0)] = take(sensor.offset_max.bit_length())
                    if hit:
                        offsets[hit.pop()] = take(sensor.offset_max.bit_length())
            found.append(
                (
                    overrun,
                    subgroup,
                    now,
                    len(hits),
                    winner,
                    stamp,
                    frozenset(hits),
                    frozenset(offsets.items()),
                )
            )
        assert bits == 0
        group = []
    return found


def rows(frame, with_offsets):
    """Return the events of a decoded frame as `plain_events` does."""
    found = []
    for columns, hits, offsets in zip(
        frame.events[:, 1:].tolist(), frame.hits, frame.offsets.tolist(), strict=True
    ):
        pixels = frozenset(
            64 * w + i for w, word in enumerate(map(int, hits)) for i in range(64) if word >> i & 1
        )
        offsets = (
            {g: offset for g, offset in enumerate(offsets) if offset != 255} if with_offsets else {}
        )
        found.append((*columns, pixels, frozenset(offsets.items())))
    return found


def crowded(name, form, seed=1, pulses=9, **frame):
    """Return a frame of a sensor with many events of all sizes, and its configuration."""
    period = 3 * SENSORS[name].guard + 20
    config = random_cases.configured(
        random_cases.SENSORS[name],
        {"period": period, "pulses": pulses, "format": form} | frame,
        {"threshold": 1, "window": SENSORS[name].phases},
    )
    edges = random_cases.trouble(config, seed, 12.0)
    return config, Golden(config.sensor).frame(config, edges)


@pytest.mark.parametrize("name", SENSORS)
@pytest.mark.parametrize("form", ("compact", "compact-full"))
def test_another_decoder_reads_the_same_events(name, form):
    config, trace = crowded(name, form, minigroup_records=True, mg_threshold=1)
    for k, beats in enumerate(trace.beats):
        frame = decode_frame(beats, config.sensor, len(config.sensor.stream_subgroups(k))).check()
        only = _events_only(beats, config.sensor, k)
        outside = plain_events(only, config.sensor)
        assert rows(frame, form == "compact-full") == outside and len(outside) > 10
        assert np.array_equal(ungroup(only, np.arange(len(only)), config.sensor)[0], frame.events)
        for number in (1, 2):  # groups without an end, the first one from beat 0 on
            endless = only[[0] * number] & ~np.uint64(1 << LAST_LSB)
            assert ungroup(endless, np.arange(number), config.sensor)[3].tolist() == list(
                range(number)
            )


def _events_only(beats, sensor, stream):
    """Return the beats of a frame without its minigroup records, start and end, whose inner beats
    may look like anything.
    """
    kinds, starts = packet_starts(beats, sensor, len(sensor.stream_subgroups(stream)))
    return beats[starts[kinds == 5]]


@pytest.mark.parametrize("form", ("id", "full"))
def test_nothing_is_lost_in_groups(form):
    """Frames without drops have the same rows in either form, in fewer beats; in the last, the
    numbers of groups wrap.
    """
    for seed, pulses in enumerate((9, 9, 300)):
        plain, grouped = (
            crowded("default", name, seed, pulses, period=400)[1]
            for name in (form, f"compact{'-full' * (form == 'full')}")
        )
        first, second = (
            decode_frame(trace.beats[0], SENSORS["default"], 2).check()
            for trace in (plain, grouped)
        )
        order = [np.lexsort(frame.events.T[1:]) for frame in (first, second)]
        assert not plain.counters[:, 4].any() and len(second.events) == len(first.events) > 20
        for name in ("events", "hits", "offsets"):
            a, b = (
                getattr(frame, name)[each]
                for frame, each in zip((first, second), order, strict=True)
            )
            assert np.array_equal(
                a[:, 1:] if name == "events" else a, b[:, 1:] if name == "events" else b
            )
        assert len(grouped.beats[0]) < 0.75 * len(plain.beats[0])


DAMAGE = ("lost", "doubled", "wrong")


@settings(max_examples=60)
@given(
    data=st.data(),
    damage=st.sampled_from(DAMAGE),
    form=st.sampled_from(("compact", "compact-full")),
)
def test_damage_costs_one_group_and_is_told(data, damage, form):
    """A lost, doubled or wrong beat never becomes other events; at most the events of its group are
    missing.
    """
    config, trace = _of_damage(form)
    beats = trace.beats[0]
    whole = rows(decode_frame(beats, config.sensor, 2), form == "compact-full")
    ends = _last_beats(beats)
    at = data.draw(st.integers(1, ends[-1]))
    if damage == "lost":
        shown = np.delete(beats, at)
    elif damage == "doubled":
        shown = np.insert(beats, at, beats[at])
    else:
        shown = beats.copy()
        shown[at] ^= np.uint64(data.draw(st.integers(1, (1 << BEAT_BITS) - 1)))
    group = sum(end < at for end in ends)
    sizes = [len(plain_events(beats[first:end], config.sensor)) for first, end in _bounds(ends)]
    found = decode_frame(shown, config.sensor, 2)
    left = rows(found, form == "compact-full")
    begin = sum(sizes[:group])
    without = whole[:begin] + whole[begin + sizes[group] :]
    assert left in (whole, without)
    assert found.missing == len(whole) - len(left) and (len(found.damaged) or left != whole)
    with pytest.raises(StreamError, match="damaged on their way"):
        found.check()
    assembler = FrameAssembler(config.sensor)
    assembler.add(shown)
    assert len(assembler.frames) == 1 and np.array_equal(assembler.frames[0], shown)


@pytest.mark.parametrize("form", ("compact", "compact-full"))
def test_only_the_damaged_group_is_told(form):
    config, trace = _of_damage(form)
    beats = trace.beats[0]
    ends = _last_beats(beats)
    assert len(ends) > 5
    for first, _ in _bounds(ends):
        shown = beats.copy()
        shown[first] ^= np.uint64(1)
        found = decode_frame(shown, config.sensor, 2)
        assert found.damaged.tolist() == [first]
        says = (
            f"^{found.missing} events of the frame were damaged on their way, near beats {first}$"
        )
        with pytest.raises(StreamError, match=says):
            found.check()


@pytest.mark.parametrize("form", ("compact", "compact-full"))
def test_a_group_without_its_first_beat_is_told_once(form):
    """And not for each of its other beats."""
    config, trace = _of_damage(form)
    beats = trace.beats[0]
    ends = _last_beats(beats)
    long = [first for first, end in _bounds(ends) if end - first > 3]
    assert long
    for first in long:
        found = decode_frame(np.delete(beats, first), config.sensor, 2)
        assert found.damaged.tolist() == [first]
        assert found.missing > 0


def _last_beats(beats):
    """Return the numbers of the beats that end a group."""
    return [i for i in range(len(beats)) if int(beats[i]) >> 59 in (0b10101, 0b10111)]


def _bounds(ends):
    return pairwise([1, *(end + 1 for end in ends)])


_FRAMES = {}


def _of_damage(form):
    if form not in _FRAMES:
        _FRAMES[form] = crowded("default", form, pulses=12)
    return _FRAMES[form]


def test_a_reader_may_begin_anywhere():
    """From the next group on it has all events, as if it had seen everything."""
    config, trace = crowded("default", "compact")
    beats = trace.beats[0]
    whole = rows(decode_frame(beats, config.sensor, 2), False)
    for begin in range(2, len(beats) - 40, 3):
        late = decode_frame(np.concatenate([beats[:1], beats[begin:]]), config.sensor, 2)
        left = rows(late, False)
        assert whole[len(whole) - len(left) :] == left and late.missing == len(whole) - len(left)


@given(
    st.lists(
        st.tuples(st.integers(1, 90), st.integers(1, 3), st.booleans()), min_size=1, max_size=6
    )
)
def test_fields_fill_all_bits_but_the_kind(fields):
    """Also where a field crosses the kind: the parts of the fields, in their order, are the
    packet's bits in theirs.
    """
    named = {
        f"f{k}": Field(f"f{k}", width, "", n, k > 0 and new)
        for k, (width, n, new) in enumerate(fields)
    }
    packet, sensor, end, found = Packet(0, "any", tuple(named.values())), SENSORS["default"], 0, {}
    for part in parts_of(sensor, packet):
        first = part.beat * BEAT_BITS + part.lsb
        begins_anew = part.shift == 0 and named[part.field].aligned
        assert first == (
            -(-end // BEAT_BITS) * BEAT_BITS if begins_anew else end + KIND_BITS * (end == KIND_LSB)
        )
        assert (
            part.shift == found.get(part.field, 0)
            and part.shift % BEAT_BITS + part.width <= BEAT_BITS
        )
        found[part.field], end = part.shift + part.width, first + part.width
        assert part.lsb + part.width <= (BEAT_BITS if part.beat else KIND_LSB)
    assert found == {name: field.bits(sensor) for name, field in named.items()}


def test_saturated_counters_tell_of_no_missing_events():
    """A sensor with counters of 9 bits stores more than 511 events of a subgroup in this frame."""
    config = random_cases.configured(
        random_cases.LEAN, {"format": "compact", "pulses": 400}, {"threshold": 1}
    )
    edges = random_cases.random_edges(config, 8000, 1)
    trace = Golden(config.sensor).frame(config, edges)
    (beats,) = trace.beats
    read = decode_frame(beats, config.sensor, config.sensor.subgroups)
    assert np.bincount(read.events[:, 0]).max() > read.counters.max() == 511
    assert read.missing == 0 and read.check() is read
