# SPDX-License-Identifier: Apache-2.0
"""The exported C driver, compiled as it leaves the project: it drives the RTL (as a library) and
decodes its frames.
"""

import ctypes
import re
import subprocess
import tempfile
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from coincid.flow.c_driver import EXAMPLE, c_driver
from coincid.flow.captured import captured_files
from coincid.flow.register_files import HEADER, register_files
from coincid.host.driver import Driver
from coincid.host.transport import RefusedError
from coincid.model.contract.counters import COUNTER_NAMES
from coincid.model.contract.gate_counts import Counts
from coincid.model.contract.packet import (
    COUNTS,
    EVENT_FORMATS,
    FORMATS,
    FRAME_END,
    FRAME_START,
    GROUP_KIND,
    RECORD,
    WITH_COUNTS,
    header_field,
    layout,
)
from coincid.model.contract.parameters import Sensor
from coincid.model.contract.registers import BY_NAME, GLOBAL, Access, address
from coincid.model.contract.stream import decode_frame
from coincid.model.golden.frame import Golden
from coincid.model.shared.errors import InputError
from coincid.tb.sliced import SlicedSensor

from .. import random_cases
from ..feature_pairs import BUILT, USED, paired_cases, played, sensor_of
from ..random_cases import configured, random_edges

SENSOR = Sensor(rows=8, cols=16)
COMMANDS = {"coincid_start": "start", "coincid_abort": "abort", "coincid_reset": "reset"}
WARNINGS = ["-Wall", "-Wextra", "-Wconversion", "-Wsign-conversion", "-pedantic", "-Werror"]
FLAGS = ["-std=c99", *WARNINGS, "-O1"]
U32 = ctypes.c_uint32
READ = ctypes.CFUNCTYPE(ctypes.c_int, ctypes.c_void_p, U32, ctypes.POINTER(U32))
WRITE = ctypes.CFUNCTYPE(ctypes.c_int, ctypes.c_void_p, U32, U32)
EVENT_KINDS = {packet.code for packet in EVENT_FORMATS.values()}
REFUSED, NO_SENSOR, TIMEOUT, BAD_STREAM = -1, -2, -3, -4


class Bus(ctypes.Structure):
    _fields_ = [("context", ctypes.c_void_p), ("read", READ), ("write", WRITE)]


def structure(name):
    """Return a struct of coincid.h as a class."""
    text = re.sub(r"/\*.*?\*/", "", c_driver()["coincid.h"], flags=re.DOTALL)
    fields = []
    for kind, names in re.findall(
        r"(?:const )?(\w+) ([^;]+);", re.search(rf"{{([^{{}}]*)}} {name};", text)[1]
    ):
        for star, field, length in re.findall(r"(\*?)(\w+)(?:\[(\d+)\])?", names):
            one = ctypes.c_void_p if star else getattr(ctypes, f"c_{kind.removesuffix('_t')}")
            fields.append((field, one * int(length) if length else one))
    return type(name, (ctypes.Structure,), {"_fields_": fields})


Info, Packet, Group = map(structure, ("coincid_sensor_info", "coincid_packet", "coincid_group"))


def compiled_driver(sensor) -> ctypes.CDLL:
    """The C driver and the register header of a sensor, as a library."""
    with tempfile.TemporaryDirectory(prefix="coincid-") as name:
        folder = Path(name)
        for file, text in (c_driver() | {HEADER: register_files(sensor)[HEADER]}).items():
            (folder / file).write_text(text, encoding="utf-8")
        subprocess.run(
            ["cc", *FLAGS, "-shared", "-fPIC", "-o", "driver.so", "coincid.c"],
            cwd=folder,
            check=True,
        )
        loaded = ctypes.CDLL(str(folder / "driver.so"))
    of_packets = "counter", "offset", "gate", "pulses", "gate_hits", "pixel"
    for name in of_packets:
        getattr(loaded, f"coincid_{name}").restype = ctypes.c_uint32
    return loaded


def compile_example(sensor, folder):
    """Write the driver's files into a folder, and compile the example there as `decode`."""
    for file, text in (c_driver() | {HEADER: register_files(sensor)[HEADER]}).items():
        (folder / file).write_text(text, encoding="utf-8")
    command = ["cc", *FLAGS, "-o", "decode", EXAMPLE, "coincid.c"]
    subprocess.run(command, cwd=folder, check=True)


def test_the_driver_is_also_cpp_without_warnings(tmp_path):
    for file, text in (c_driver() | {HEADER: register_files(SENSOR)[HEADER]}).items():
        (tmp_path / file).write_text(text, encoding="utf-8")
    command = ["c++", "-x", "c++", "-std=c++17", *WARNINGS, "-fsyntax-only", "coincid.c"]
    subprocess.run(command, cwd=tmp_path, check=True)


@pytest.fixture(scope="module")
def library():
    """One for all sensors: the driver asks a sensor for its parameters."""
    return compiled_driver(SENSOR)


def probed(library, sensor) -> Info:
    """Return what the driver finds out about a sensor."""
    info = Info()
    constants = {
        each.offset: each.reset(sensor) for each in GLOBAL if each.access is Access.CONSTANT
    }
    bus = bus_of(SimpleNamespace(read=constants.__getitem__, write=None))
    assert library.coincid_probe(ctypes.byref(bus), ctypes.byref(info)) == 0
    return info


def refusing(access):
    """Return a function of a bus, which answers 1 where the sensor refuses the access."""

    def call(_, address, value):
        try:
            access(address, value)
        except RefusedError:
            return 1
        return 0

    return call


def bus_of(transport) -> Bus:
    def read(address, value):
        value[0] = transport.read(address)

    return Bus(None, READ(refusing(read)), WRITE(refusing(transport.write)))


def packets(library, info, beats):
    """Return every packet of a frame as plain tuples, decoded beside the C structure."""
    at, raw = 0, np.ascontiguousarray(beats)
    while at < len(raw):
        packet = Packet()
        start = ctypes.c_void_p(raw.ctypes.data + 8 * at)
        left, sensor = ctypes.c_size_t(len(raw) - at), ctypes.byref(info)
        length = library.coincid_decode(sensor, info.subgroups, start, left, ctypes.byref(packet))
        assert length > 0
        if packet.kind == FRAME_START.code:
            info.grouped = packet.count
        yield packet
        at += length


def event(library, info, packet):
    """Return an event: the columns of a decoded frame, the map's words, and the offsets."""
    columns = [
        getattr(packet, name)
        for name in ("overrun", "subgroup", "pulse", "count", "winner", "stamp")
    ]
    words = [0] * -(-info.pixels // 64)
    if packet.map:  # a short event has none
        words = (ctypes.c_uint64 * len(words)).from_address(packet.map)
    offsets = (library.coincid_offset(ctypes.byref(packet), g) for g in range(info.minigroups))
    return columns, list(words), list(offsets) if packet.offsets else [255] * info.minigroups


def events_of_frame(frame):
    """Return the same of a frame that Python has decoded."""
    return list(
        zip(frame.events[:, 1:].tolist(), frame.hits.tolist(), frame.offsets.tolist(), strict=True)
    )


def test_a_group_has_room_for_an_event_of_the_largest_subgroup():
    """With a bit for each pixel, and a byte for the offset of each minigroup."""
    shape = 16, 16
    with pytest.raises(InputError, match="sensor.subgroup .* 16 to 256 pixels"):
        Sensor(rows=16, cols=17, subgroup=(16, 17))
    largest = Sensor(rows=16, cols=16, subgroup=shape, minigroup=(1, 1))
    room = {name: ctypes.sizeof(kind) for name, kind in Group._fields_}
    assert 8 * room["map"] == largest.pixels
    assert room["offsets"] == largest.minigroups


@pytest.mark.parametrize("polls", (0, 1, 3))
@pytest.mark.parametrize("done_at", (1, 3, 4))
def test_a_wait_polls_as_often_as_it_is_told(library, polls, done_at):
    status = BY_NAME["status"]
    done = 1 << status.bit("done")
    reads = []
    written = []

    def read(at):
        reads.append(at)
        return done * (len(reads) == done_at) | 1 << status.bit("busy")

    bus = bus_of(SimpleNamespace(read=read, write=lambda at, value: written.append((at, value))))
    answer = library.coincid_wait(ctypes.byref(bus), polls)
    assert answer == (0 if done_at <= polls else TIMEOUT)
    assert reads == [address("status")] * min(polls, done_at)
    assert written == [(address("status"), done)] * (answer == 0)


@pytest.mark.parametrize(("call", "command"), COMMANDS.items())
def test_a_command_is_the_write_of_its_bit(library, call, command):
    written = []
    bus = bus_of(SimpleNamespace(read=None, write=lambda at, value: written.append((at, value))))
    assert getattr(library, call)(ctypes.byref(bus)) == 0
    assert written == [(address("control"), 1 << BY_NAME["control"].bit(command))]


class Words(dict):
    """A sensor of which some words are known; `refused` are places that it does not let read or
    write. asked: what was read.
    """

    def __init__(self, words, refused=()):
        super().__init__(words)
        self.refused, self.asked = refused, []

    def read(self, place):
        self.asked.append(place)
        if place in self.refused:
            raise RefusedError("read")
        return self[place]

    def write(self, place, value):
        if place in self.refused:
            raise RefusedError("write")


CONSTANTS = {one.offset: one.reset(SENSOR) for one in GLOBAL if one.access is Access.CONSTANT}


def test_no_sensor_is_found_where_one_constant_cannot_be_read(library):
    """Whichever it is; nothing is computed of what is not there."""
    whole = Words(CONSTANTS)
    assert library.coincid_probe(ctypes.byref(bus_of(whole)), ctypes.byref(Info())) == 0
    assert {address("id"), address("version"), address("phases")} < {*whole.asked}
    for place in whole.asked:
        bus = bus_of(Words(CONSTANTS, [place]))
        assert library.coincid_probe(ctypes.byref(bus), ctypes.byref(Info())) == NO_SENSOR, place


@pytest.mark.parametrize(
    ("name", "more", "found"),
    [("id", 1, NO_SENSOR), ("version", 1 << 16, NO_SENSOR), ("version", 1, 0)],
    ids=["other ID", "other version", "later map of the version"],
)
def test_a_sensor_is_known_by_its_id_and_the_version_of_its_map(library, name, more, found):
    bus = bus_of(Words(CONSTANTS | {address(name): CONSTANTS[address(name)] + more}))
    assert library.coincid_probe(ctypes.byref(bus), ctypes.byref(Info())) == found


def test_what_the_sensor_refuses_is_told_by_every_call(library):
    """Also where only the end of a frame cannot be cleared."""
    control, status = address("control"), address("status")
    done = {status: 1 << BY_NAME["status"].bit("done")}
    for call in COMMANDS:
        bus = bus_of(Words({}, [control]))
        assert getattr(library, call)(ctypes.byref(bus)) == REFUSED
    assert library.coincid_wait(ctypes.byref(bus_of(Words(done, [status]))), 3) == REFUSED
    frame_done = Words(done)
    frame_done.write = Words(done, [status]).write
    assert library.coincid_wait(ctypes.byref(bus_of(frame_done)), 3) == REFUSED


WIDE = random_cases.GOLDEN_SENSORS["wide"]  # more than 64 pixels in a subgroup, and counts
UNEVEN = random_cases.SENSORS["tiny"] | {"rows": 16}  # four subgroups on three streams


@pytest.mark.parametrize(
    ("table", "pixels", "uneven"), [(WIDE, 160, False), (UNEVEN, 16, True)], ids=["wide", "uneven"]
)
def test_the_example_prints_every_event_as_captured(tmp_path, table, pixels, uneven):
    sensor = random_cases.built_sensor(table)
    assert sensor.pixels == pixels
    assert (sensor.subgroups % sensor.streams > 0) == uneven
    compile_example(sensor, tmp_path)
    captured = captured_files(sensor)
    (tmp_path / "captured").mkdir()
    for name, content in captured.items():
        if name.endswith(".txt"):
            (tmp_path / name).write_bytes(content)
            printed = subprocess.run(
                ["./decode", name], cwd=tmp_path, check=True, capture_output=True
            ).stdout
            _, rows = captured[name.replace(".txt", ".csv")].split(b"\n", 1)
            assert len(rows) > 100
            assert printed == rows, name


DIGITS_OF_GROUP = f"{GROUP_KIND << 1:x}", f"{(GROUP_KIND << 1) + 1:x}"  # first digits of a beat


def end_of_stream_0(beats):
    """Return the places of the first stream's first beat of the frame end, and behind its last."""
    sensor = random_cases.built_sensor(UNEVEN)
    end = sum(one[0] == "0" for one in beats)
    return end - 1 - layout(sensor).counter_beats * len(sensor.stream_subgroups(0)), end


def ended_twice(beats):
    begin, end = end_of_stream_0(beats)
    return [*beats[:end], *beats[begin:end], *beats[end:]]


def with_one_more_stored(beats, index):
    """Return the beats, of which the counters of a subgroup have one stored event more."""
    begin, end = end_of_stream_0(beats)
    beat, half = divmod(COUNTER_NAMES.index("stored"), 2)
    of_subgroup = range(begin + 1, end)[
        index * layout(random_cases.built_sensor(UNEVEN)).counter_beats :
    ][beat]
    stream, value, last = beats[of_subgroup].split()
    more = int(value, 16) + (1 << 32 * half)
    return [*beats[:of_subgroup], f"{stream} {more:016x} {last}", *beats[of_subgroup + 1 :]]


@pytest.fixture(scope="module")
def example(tmp_path_factory):
    """Return a folder with the compiled example for a sensor of several streams."""
    folder = tmp_path_factory.mktemp("example")
    compile_example(random_cases.built_sensor(UNEVEN), folder)
    return folder


@pytest.mark.parametrize(
    ("damage", "told"),
    [
        (lambda beats: [], "stream 0: is no whole frame"),
        (lambda beats: beats[:-1], "stream 2: is no whole frame"),
        (lambda beats: beats[1:], "stream 0: is no whole frame"),
        (lambda beats: [one for one in beats if one[0] != "0"], "stream 0: is no whole frame"),
        (lambda beats: [one for one in beats if one[0] != "1"], "stream 1: is missing"),
        (lambda beats: [one for one in beats if one[0] != "2"], "stream 2: is missing"),
        (lambda beats: [beats[0], *beats], "stream 0: is no whole frame"),
        (lambda beats: [one for one in beats if one[2] not in DIGITS_OF_GROUP], "stream 0: is no"),
        (lambda beats: with_one_more_stored(beats, 0), "stream 0: is no whole frame"),
        (lambda beats: with_one_more_stored(beats, 1), "stream 0: is no whole frame"),
        (ended_twice, "stream 0: is no whole frame"),
    ],
    ids=["nothing", "last beat", "start", "stream 0", "stream 1", "stream 2", "starts", "groups"]
    + ["an event of the first subgroup", "one of the last", "ends"],
)
def test_the_example_refuses_what_is_no_whole_frame(example, damage, told):
    """A frame without its groups, or without one event, looks whole, except for its counters."""
    sensor = random_cases.built_sensor(UNEVEN)
    assert sensor.streams == 3 and len(sensor.stream_subgroups(0)) == 2
    ((name, content),) = [
        (name, content)
        for name, content in captured_files(sensor).items()
        if name.endswith("_compact.txt")
    ]
    heading, *beats = content.decode().splitlines()
    damaged = damage(beats)
    assert damaged != beats
    (example / "damaged.txt").write_text("\n".join([heading, *damaged, ""]), encoding="utf-8")
    done = subprocess.run(
        ["./decode", "damaged.txt"],
        cwd=example,
        check=False,
        capture_output=True,
        text=True,
        encoding="utf-8",
    )
    assert done.returncode == 1, name
    assert told in done.stderr


@pytest.mark.parametrize("names", [[], ["none.txt"], ["empty.txt"], ["empty.txt", "empty.txt"]])
def test_the_example_tells_its_use_if_it_is_not_given_a_file(example, names):
    (example / "empty.txt").write_text("", encoding="utf-8")
    done = subprocess.run(
        ["./decode", *names],
        cwd=example,
        check=False,
        capture_output=True,
        text=True,
        encoding="utf-8",
    )
    told = "usage: coincid_decode captured/NAME.txt\n"
    assert (done.returncode, done.stdout, done.stderr) == (2, "", told)


def test_the_driver_drives_and_decodes(library):
    golden, info = Golden(SENSOR), Info()
    of = configured(
        SENSOR,
        {"period": 80, "pulses": 6, "format": "full", "minigroup_records": True, "mg_threshold": 1},
    )
    with SlicedSensor(SENSOR) as rtl:
        bus = bus_of(rtl)
        assert library.coincid_probe(ctypes.byref(bus), ctypes.byref(info)) == 0
        found = (
            info.subgroups,
            info.pixels,
            info.minigroups,
            info.record_bits,
            info.record_stamp_bits,
        )
        assert found == (SENSOR.subgroups, 64, 16, SENSOR.record_bits, SENSOR.record_stamp_bits)
        assert library.coincid_wait(ctypes.byref(bus), 3) == TIMEOUT
        Driver(rtl, SENSOR)["period"] = SENSOR.guard
        assert library.coincid_start(ctypes.byref(bus)) == REFUSED
        rtl.driver.programmed.clear()
        edges = random_edges(of, 700, seed=1)
        rtl.frame(of, edges)
        (beats,) = rtl.driver.receive()
        assert library.coincid_reset(ctypes.byref(bus)) == 0
        assert rtl.driver["period"] == BY_NAME["period"].reset(SENSOR)
        assert rtl.driver["pulses"] == BY_NAME["pulses"].reset(SENSOR)
    assert np.array_equal(beats, golden.frame(of, edges).beats[0])
    assert_decoded(library, info, beats, SENSOR)


def assert_decoded(library, info, beats, sensor, first=0):
    """Check that a frame has the events, records, counts and counters that the decoder in Python
    finds; return how many events and records, and whether there are hits in gates. first: subgroup
    of the stream.
    """
    frame = decode_frame(beats, sensor, info.subgroups)
    events, records, counters = [], [], []
    counts = None
    if frame.counts is not None:
        counts = Counts(*(np.full(array.shape, -1) for array in frame.counts))
    group = -1
    for packet in packets(library, info, beats):
        where = ctypes.byref(packet)
        if packet.kind == GROUP_KIND:
            events += events_of_group(library, info, packet)
            group += 1
            assert packet.number == group % 256
        elif packet.kind in EVENT_KINDS:
            events.append(event(library, info, packet))
            if packet.map:
                assert hits_of(library, where, info) == events[-1][1]
        elif packet.kind == COUNTS.code:
            put_counts(library, info, packet, counts, packet.subgroup - first)
        elif packet.kind == RECORD.code:
            entries = [entry(library, info, where, g) for g in range(info.minigroups)]
            records.append(((packet.subgroup, packet.pulse), entries))
        elif packet.kind == FRAME_END.code:
            counters = [
                [library.coincid_counter(where, s, k) for k in range(len(COUNTER_NAMES))]
                for s in range(info.subgroups)
            ]
    assert events == events_of_frame(frame)
    expected = zip(map(tuple, frame.records.tolist()), frame.entries.tolist(), strict=True)
    assert records == [(of, list(map(tuple, entries))) for of, entries in expected]
    assert counters == frame.counters.tolist()
    if counts is not None:
        for found, expected in zip(counts, frame.counts, strict=True):
            assert np.array_equal(found, expected)
    has_hits = counts is not None and counts.gate_hits.any()
    return len(events), len(records), int(has_hits)


def put_counts(library, info, packet, counts, subgroup):
    """Put the counts of a minigroup into arrays, as the driver answers one by one."""
    where = ctypes.byref(packet)
    for gate in range(2):
        counts.gate_cycle[subgroup, packet.minigroup, gate] = library.coincid_gate(where, gate)
    for j in range(4):
        pixel = library.coincid_pixel(ctypes.byref(info), where, j)
        counts.count_pulses[subgroup, pixel] = library.coincid_pulses(where, j)
        for gate, quarter in np.ndindex(2, 16):
            hits = library.coincid_gate_hits(where, gate, j, quarter)
            counts.gate_hits[subgroup, pixel, gate, quarter] = hits


def hits_of(library, where, info):
    """Return the map of an event as words, as the driver answers pixel by pixel."""
    words = [0] * -(-info.pixels // 64)
    for pixel in range(info.pixels):
        words[pixel // 64] |= library.coincid_hit(where, pixel) << pixel % 64
    return words


def entry(library, info, where, minigroup):
    """Return stamp and map of a minigroup in a record."""
    stamp = ctypes.c_uint32()
    hit_map = ctypes.c_uint32()
    outputs = ctypes.byref(stamp), ctypes.byref(hit_map)
    library.coincid_entry(ctypes.byref(info), where, minigroup, *outputs)
    return stamp.value, hit_map.value


def events_of_group(library, info, packet):
    group, one = Group(), Packet()
    library.coincid_group_begin(ctypes.byref(packet), ctypes.byref(group))
    while library.coincid_group_event(ctypes.byref(info), ctypes.byref(group), ctypes.byref(one)):
        yield event(library, info, one)


def test_every_pair_of_features_is_decoded(library):
    """Of sensors as built, of frames, light and receivers: the same rows as in Python."""
    found = []
    for number, case in enumerate(paired_cases(BUILT | USED)):
        frames = played(sensor_of(case), case, number)
        sensor = frames.config.sensor
        info = probed(library, sensor)
        assert info.record_bits == sensor.record_bits
        for trace in frames.traces(Golden(sensor)):
            for stream, beats in enumerate(trace.beats):
                info.subgroups = len(sensor.stream_subgroups(stream))
                first = sensor.stream_subgroups(stream).start
                of_frame = assert_decoded(library, info, beats, sensor, first)
                found.append((info.record_bits, *of_frame))
    wide, events, records, with_counts = np.array(found).T
    assert with_counts.sum() > 5
    assert events.sum() > 3000
    assert records[wide == 16].sum() > 20
    assert records[wide == 32].sum() > 20


@pytest.mark.parametrize("form", ("full", "compact-full"))
def test_events_of_the_largest_subgroup_are_decoded(library, form):
    """Its map fills four words, and each of its pixels has an offset of its own."""
    table = {"rows": 16, "cols": 16, "subgroup": [16, 16], "minigroup": [1, 1]}
    sensor = random_cases.built_sensor(table)
    of = configured(table, {"period": 60, "pulses": 6, "format": form}, {"threshold": 1})
    (beats,) = Golden(sensor).frame(of, random_edges(of, 600, seed=1)).beats
    hits = decode_frame(beats, sensor, 1).hits
    assert len(hits) > 20
    assert (hits != 0).any(axis=0).all() and (hits == 0).any(axis=0).all()
    assert_decoded(library, probed(library, sensor), beats, sensor)


def test_groups_are_numbered_from_0_on_again_after_255(library):
    """By these numbers a receiver sees that groups are lost."""
    table = {"rows": 8, "cols": 8}
    sensor = random_cases.built_sensor(table)
    frame = {"period": 120, "pulses": 300, "format": "compact"}
    of = configured(table, frame, {"threshold": 1})
    (beats,) = Golden(sensor).frame(of, random_edges(of, 6_000, seed=1)).beats
    info = probed(library, sensor)
    numbers = [one.number for one in packets(library, info, beats) if one.kind == GROUP_KIND]
    assert numbers == [number % 256 for number in range(len(numbers))]
    assert len(numbers) > 256


def test_what_was_in_a_place_before_is_not_in_what_is_found(library):
    """As on a stack: each field is set, also those of what a sensor or a packet does not have."""
    constants = bus_of(Words(CONSTANTS))
    start = ctypes.c_uint64(FRAME_START.code << 61)
    for_one = ctypes.byref(start), ctypes.c_size_t(1)
    found = []
    for byte in (0x00, 0xFF):
        info, packet = Info(), Packet()
        for place in (info, packet):
            ctypes.memset(ctypes.byref(place), byte, ctypes.sizeof(place))
        assert library.coincid_probe(ctypes.byref(constants), ctypes.byref(info)) == 0
        assert library.coincid_decode(ctypes.byref(info), 2, *for_one, ctypes.byref(packet)) == 1
        found.append([getattr(one, name) for one in (info, packet) for name, _ in one._fields_])
    assert found[0] == found[1]


@pytest.mark.parametrize("form", FORMATS)
def test_a_part_of_a_packet_is_not_decoded_yet(library, form):
    """Whatever packet it is, and however many of its beats have come."""
    sensor = Sensor(rows=8, cols=16, counts=1)
    info, packet = probed(library, sensor), Packet()
    of = configured(
        {"rows": 8, "cols": 16, "counts": 1},
        {"period": 80, "pulses": 6, "format": form, "minigroup_records": True, "mg_threshold": 1},
        {"threshold": 1},
    )
    (beats,) = Golden(sensor).frame(of, random_edges(of, 300, seed=1)).beats
    at, lengths = 0, set()
    while at < len(beats):
        start = ctypes.c_void_p(beats.ctypes.data + 8 * at)

        def decoded(n, start=start):
            given = ctypes.byref(info), info.subgroups, start, ctypes.c_size_t(n)
            return library.coincid_decode(*given, ctypes.byref(packet))

        length = decoded(len(beats) - at)
        assert length > 0
        assert [decoded(n) for n in range(length)] == [0] * length
        assert decoded(length) == length
        if packet.kind == FRAME_START.code:
            info.grouped = packet.count
        lengths.add((packet.kind, length))
        at += length
    assert any(length > 1 for kind, length in lengths if kind != FRAME_END.code)


@pytest.mark.parametrize("name", random_cases.SENSORS)
@pytest.mark.parametrize("form", ("compact", "compact-full"))
def test_of_damaged_groups_the_driver_finds_what_python_finds(library, name, form):
    sensor, rng = random_cases.built_sensor(random_cases.SENSORS[name]), np.random.default_rng(1)
    info = probed(library, sensor)
    of = configured(
        random_cases.SENSORS[name],
        {
            "period": 2 * sensor.guard + 40,
            "pulses": 8,
            "format": form,
            "minigroup_records": True,
            "mg_threshold": 1,
        },
        {"threshold": 1, "window": sensor.phases},
    )
    for trial in range(11):
        trace = Golden(sensor).frame(of, random_cases.trouble(of, trial, 12.0))
        for stream, beats in enumerate(trace.beats):
            info.subgroups = len(sensor.stream_subgroups(stream))
            tail = layout(sensor).length(FRAME_END, info.subgroups)
            at = rng.choice(np.flatnonzero(header_field(beats[:-tail], "kind") == GROUP_KIND))
            wrong = beats.copy()
            wrong[at] ^= np.uint64(rng.integers(1, 1 << 63))
            shown = (np.delete(beats, at), np.insert(beats, at, beats[at]), wrong)[trial % 3]
            assert events_of(library, info, shown) == events_of_frame(
                decode_frame(shown, sensor, info.subgroups)
            )


def events_of(library, info, beats):
    """Return the events of all groups of a frame."""
    found, number = [], -1
    for packet in packets(library, info, beats):
        if packet.kind == GROUP_KIND and packet.number != number:
            found += events_of_group(library, info, packet)
            number = packet.number
    assert len(found) > 5
    return found


def test_what_is_no_packet(library):
    info, packet, beats = Info(2, 64, 16, 16, 12), Packet(), np.zeros(20, np.uint64)
    info.minigroup_pixels = 4
    end = (6, 1, 1), (7, 12, 0), (7, 13, 13)
    of_events = (0, 1, BAD_STREAM), (5, 1, BAD_STREAM), (2, 1, 0), (2, 2, 2), *end, (1, 0, 0)
    of_counts = (0, 10, 10), (0, 9, 0), (1, 1, BAD_STREAM), (4, 20, BAD_STREAM), (5, 1, BAD_STREAM)
    cases = [(0, case) for case in of_events]
    cases += [(WITH_COUNTS, case) for case in (*of_counts, *end)]
    for info.grouped, (kind, n, expected) in cases:
        beats[0] = np.uint64(kind << 61)
        start, length = ctypes.c_void_p(beats.ctypes.data), ctypes.c_size_t(n)
        done = library.coincid_decode(ctypes.byref(info), 2, start, length, ctypes.byref(packet))
        assert done == expected, (info.grouped, kind, n)
