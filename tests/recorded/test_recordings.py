# SPDX-License-Identifier: Apache-2.0
"""Recorded photons: PTU files and tables become edges; edges survive a round trip through every
format; errors are reported.
"""

import re
import struct

import h5py
import numpy as np
import ptufile
import pytest
from attrs import evolve
from hypothesis import given, settings
from hypothesis import strategies as st

from coincid.model.contract.config import load_config, parse_config
from coincid.model.contract.edges import NAMES, Edges, load_edges
from coincid.model.contract.result import differences
from coincid.model.light.timing import Timing
from coincid.model.recorded.exchange import (
    SUFFIXES,
    offsets_note,
    parse_channels,
    read_recording,
    write_edges,
)
from coincid.model.recorded.photon_hdf5 import is_photon_hdf5
from coincid.model.recorded.recordings import (
    Recording,
    period_note,
    recorded_edges,
    since_sync,
    told,
)
from coincid.model.shared.errors import InputError
from coincid.tb.replay import replay

from ..command import assert_refused, command
from ..random_cases import SENSORS

CONFIG = parse_config({"sensor": {"rows": 8, "cols": 8}, "frame": {"pulses": 20, "frames": 2}})
TIMING = Timing.from_config(CONFIG)
GENERIC_T2, HYDRAHARP_T2, PICOHARP_T2 = 0x00010207, 0x00010204, 0x00010203


def edges_of(path, *, config=CONFIG, timing=TIMING, sync_channel=None, **options):
    edges, lost = recorded_edges(read_recording(path, sync_channel), config, timing, **options)
    return [
        tuple(edge) for edge in np.stack([getattr(edges, name) for name in NAMES], axis=1).tolist()
    ], lost


def edges(*rows):
    return Edges(*(np.array(column, np.int64) for column in zip(*rows, strict=True)))


def ptu(path, records, *, mode=2, kind=GENERIC_T2, clock_s=1e-12, bin_s=1e-12, **more):
    """Write a minimal PTU file."""
    tags = {
        "Measurement_Mode": mode,
        "Measurement_SubMode": 1,
        "MeasDesc_GlobalResolution": clock_s,
        "MeasDesc_Resolution": bin_s,
        "TTResultFormat_TTTRRecType": kind,
        "TTResultFormat_BitsPerRecord": 32,
        "TTResult_NumberOfRecords": len(records),
    } | more
    data = b"PQTTTR\0\0" + b"1.0.00\0\0"
    for name, value in tags.items():
        real = isinstance(value, float)
        data += struct.pack(
            "<32siI", name.encode(), -1, 0x20000008 if real else 0x10000008
        ) + struct.pack("<d" if real else "<q", value)
    data += struct.pack("<32siIq", b"Header_End", -1, 0xFFFF0008, 0)
    path.write_bytes(data + np.array(records, "<u4").tobytes())
    return path


def t2(special, channel, time):
    return special << 31 | channel << 25 | time


def t3(special, channel, dtime, nsync):
    return special << 31 | channel << 25 | dtime << 10 | nsync


def test_t3_by_hand(tmp_path):
    """Bins of 125 ps are two ticks; the middle of a bin is in the later one. An overflow is 1024
    syncs.
    """
    records = [
        t3(0, 3, 0, 1),
        t3(0, 3, 100, 2),
        t3(1, 1, 0, 9),
        t3(0, 9, 4000, 3),
        t3(0, 4, 7, 39),
        t3(0, 4, 7, 40),
        t3(1, 63, 0, 1),
        t3(0, 5, 8, 6),
    ]
    path = ptu(tmp_path / "a.ptu", records, mode=3, kind=0x00010307, clock_s=500e-9, bin_s=125e-12)
    found, lost = edges_of(path)
    assert found == [(1, 3, 1), (2, 3, 201), (39, 4, 15)]
    assert lost == {
        "after sync 39, the last of 2 x 20 pulses": 2,
        "beyond the laser period of 8000 ticks": 1,
    }
    found, lost = edges_of(path, first_sync=1024, channels={5: 60})
    assert found == [(6, 60, 17)]
    assert sum(lost.values()) == 5
    found, lost = edges_of(path, first_sync=1)
    assert "after sync 40, the last of 2 x 20 pulses" in lost
    found, lost = edges_of(path, channels={3: 0, 4: 63}, delay_ps=125)
    assert found == [(2, 0, 199), (39, 63, 13)]
    assert (
        lost["in channels without a pixel"] == 1 and lost["before the trigger, by the delay"] == 1
    )
    assert not period_note(read_recording(path), TIMING)
    assert "frame.period = 250 would fit" in period_note(
        read_recording(path), Timing(period_cycles=100)
    )


@pytest.mark.parametrize(("kind", "wrap"), [(GENERIC_T2, 1 << 25), (HYDRAHARP_T2, 33552000)])
def test_t2_by_hand(tmp_path, kind, wrap):
    """Input 0 is not the sync input; a photon belongs to the last sync, even across an overflow of
    the clock.
    """
    sync = 500_000
    records = [
        t2(0, 0, 10),
        t2(1, 0, sync),
        t2(0, 0, sync),
        t2(0, 1, sync + 62),
        t2(0, 1, sync + 63),
        t2(1, 0, 2 * sync),
        t2(1, 4, 2 * sync + 5),
        t2(1, 63, 1),
        t2(0, 2, 3 * sync),
    ]
    found, lost = edges_of(ptu(tmp_path / "a.ptu", records, kind=kind))
    assert found == [(0, 0, 0), (0, 1, 0), (0, 1, 1)]
    assert lost == {"before the first sync": 1, "beyond the laser period of 8000 ticks": 1}
    records = [t2(0, 7, 100), t2(1, 63, 1), t2(0, 3, 100)]
    found, lost = edges_of(
        ptu(tmp_path / "a.ptu", records, kind=kind, clock_s=float(wrap) ** -1 * 1e-7),
        sync_channel=7,
    )
    assert found == [(0, 3, 1600)]  # one wrap of the clock is 100 ns


def test_t2_of_the_picoharp(tmp_path):
    """4 bits of channel, with 0 as the sync input; 4 ps."""
    records = [0 << 28 | 1000, 1 << 28 | 1000 + 16, 2 << 28 | 1000 + 32]
    path = ptu(tmp_path / "a.ptu", records, kind=PICOHARP_T2, clock_s=4e-12)
    found, lost = edges_of(path)
    assert found == [(0, 0, 1), (0, 1, 2)] and not lost
    found, lost = edges_of(path, sync_channel=0)  # a trigger on an input
    assert found == [(0, 1, 1)] and not lost
    with pytest.raises(InputError, match=r"on input 2: .*\(inputs with events: 0, 1\)"):
        edges_of(path, sync_channel=2)


@pytest.mark.parametrize("lines", [5, 6])
@pytest.mark.parametrize("both_ways", [False, True])
def test_scan_by_another_writer(tmp_path, both_ways, lines):
    """ptufile's own writer makes an image from histograms: each position has its photons, each with
    a pulse of its own. Every image begins in the same direction, also after an odd number of lines.
    """
    rng = np.random.default_rng(3)
    # images, lines, positions, channels, bins
    counts = rng.poisson(0.02, (2, lines, 5, 1, 100)).astype(np.uint16)
    path = tmp_path / "scan.ptu"
    with ptufile.PtuWriter(
        path, counts.shape, 500e-9, 62.5e-12, 20 * 500e-9, tags={"File_GUID": "x"}
    ) as writer:
        writer.write(counts)
    if both_ways:
        data = path.read_bytes()
        at = data.index(b"ImgHdr_BiDirect") + 40
        path.write_bytes(data[:at] + struct.pack("<q", 1) + data[at + 8 :])
    recording = read_recording(path)
    assert recording.grid == (lines, 5) and "20 syncs each, 2 image(s)" in recording.kind
    found, lost = edges_of(path)
    seen = np.zeros((2, 8, 8, 100), int)
    for pulse, pixel, tick in found:
        seen[pulse // 20, pixel // 8, pixel % 8, tick] += 1
    expected = counts[:, :, :, 0].astype(int)
    if both_ways:
        expected[:, 1::2] = expected[:, 1::2, ::-1]
    assert np.array_equal(seen[:, :lines, :5], expected) and not lost
    assert len({(pulse, pixel) for pulse, pixel, _ in found}) == len(found)
    with pytest.raises(InputError, match="positions are the pixels"):
        edges_of(path, channels={0: 0})


def test_tables_by_hand(tmp_path):
    (tmp_path / "syncs.csv").write_text(
        "# a lab\n\nSync;time_ns;note;channel\n0;0.0625;1;5\n3;499.99;2;6\n1;500;3;6\n0;0.0624;4;7\n",
        encoding="utf-8",
    )
    found, lost = edges_of(tmp_path / "syncs.csv")
    assert found == [(0, 7, 0), (0, 5, 1), (3, 6, 7999)]
    assert lost == {"beyond the laser period of 8000 ticks": 1}
    times = {"channel": [9, 1, 9, 2, 1, 9], "time_ps": [1000, 1125, 501000, 501000, 900, 1001000]}
    np.savez(tmp_path / "times.npz", **times)
    with h5py.File(tmp_path / "times.h5", "w") as archive:
        archive.update(times)
    for name in ("times.npz", "times.h5"):
        found, lost = edges_of(tmp_path / name, sync_channel=9, channels={1: 11, 2: 12})
        assert found == [(0, 11, 2), (1, 12, 0)] and lost == {"before the first sync": 1}
        assert not period_note(read_recording(tmp_path / name, 9), TIMING)
        with pytest.raises(InputError, match=r"has no events on channel 7 \(--sync-channel\)"):
            read_recording(tmp_path / name, 7)


@pytest.mark.parametrize(("high", "wide"), [(8, 8), (8, 16), (24, 8)])
def test_an_image_larger_than_the_sensor_loses_its_borders(high, wide):
    """A position beyond the last column is no pixel of the next row."""
    config = parse_config({"sensor": {"rows": high, "cols": wide}, "frame": {"pulses": 20}})
    rows, cols = high + 1, wide + 2
    places = np.arange(rows * cols)
    whole = np.zeros(len(places), np.int64)
    image = Recording(sync=whole, channel=places, time_ps=whole + 1.0, grid=(rows, cols), kind="")
    found, lost = recorded_edges(image, config, TIMING)
    row, col = np.divmod(places, cols)
    assert sorted(found.pixel.tolist()) == list(range(high * wide))
    assert sum(lost.values()) == np.count_nonzero((row >= high) | (col >= wide))


@pytest.mark.parametrize(("rows", "cols"), [(8, 8), (8, 16), (24, 8)])
def test_a_channel_is_the_pixel_of_its_number(rows, cols):
    """Row by row, in an array of any shape; others have no pixel."""
    config = parse_config({"sensor": {"rows": rows, "cols": cols}, "frame": {"pulses": 20}})
    channel = np.arange(-3, rows * cols + 3)
    whole = np.zeros(len(channel), np.int64)
    photons = Recording(sync=whole, channel=channel, time_ps=whole + 1.0, kind="")
    found, lost = recorded_edges(photons, config, TIMING)
    assert found.pixel.tolist() == list(range(rows * cols))
    assert lost == {"in channels without a pixel": 6}


@pytest.mark.parametrize("unit_ps", {"ps": 1, "ns": 10**3, "us": 10**6, "s": 10**12}.items())
def test_times_have_the_unit_of_their_column(tmp_path, unit_ps):
    """Beside a sync, and as absolute times."""
    unit, ps = unit_ps
    lines = ["sync,channel,time_" + unit]
    lines += [f"{pulse},{pulse},{62.5 * tick / ps!r}" for pulse, tick in ((0, 1.5), (3, 4000.5))]
    (tmp_path / "syncs.csv").write_text("\n".join(lines), encoding="utf-8")
    found, lost = edges_of(tmp_path / "syncs.csv")
    assert (found, lost) == ([(0, 0, 1), (3, 3, 4000)], {})
    times_ps = {9: 0.0, 5: 62.5 * 4000.5, 8: 500_000.0}
    lines = ["channel,time_" + unit]
    lines += [f"{9 if channel == 8 else channel},{at / ps!r}" for channel, at in times_ps.items()]
    (tmp_path / "times.csv").write_text("\n".join(lines), encoding="utf-8")
    found, lost = edges_of(tmp_path / "times.csv", sync_channel=9)
    assert (found, lost) == ([(0, 5, 4000)], {})


FORMATS = (".npz", ".csv", ".h5", ".hdf5", ".ptu")  # of docs/recordings.md

some_edges = st.lists(
    st.tuples(st.integers(0, 39), st.integers(0, 63), st.integers(0, TIMING.period_ticks - 1)),
    min_size=1,
    max_size=40,
)


def test_no_format_is_missing_here():
    assert set(FORMATS) == set(SUFFIXES)


@settings(max_examples=20)
@given(rows=some_edges)
@pytest.mark.parametrize("suffix", FORMATS)
def test_edges_come_back_from_every_format(tmp_path_factory, suffix, rows):
    path = tmp_path_factory.mktemp("edges") / f"edges{suffix}"
    write_edges(path, edges(*rows), TIMING)
    first = path.read_bytes()
    assert edges_of(path) == (sorted(rows, key=lambda row: (row[0], row[2], row[1])), {})
    write_edges(path, edges(*rows), TIMING)
    assert path.read_bytes() == first


def test_written_tables_are_those_that_other_programs_read(tmp_path):
    """A line of names without any mark and a line for each edge; a dataset for each column."""
    placed = evolve(edges((0, 3, 5), (1, 4, 6)), offset_ps=np.array([0.25, 62.0]))
    write_edges(tmp_path / "a.csv", placed, TIMING)
    assert (
        tmp_path / "a.csv"
    ).read_bytes() == b"pulse,pixel,tick,offset_ps\n0,3,5,0.25\n1,4,6,62\n"
    write_edges(tmp_path / "a.h5", placed, TIMING)
    with h5py.File(tmp_path / "a.h5") as file:
        columns = {name: (column.dtype.name, column[()].tolist()) for name, column in file.items()}
    assert columns == {
        "pulse": ("int64", [0, 1]),
        "pixel": ("int64", [3, 4]),
        "tick": ("int64", [5, 6]),
        "offset_ps": ("float64", [0.25, 62.0]),
    }


@pytest.mark.parametrize("suffix", FORMATS)
def test_a_suffix_in_capitals_is_the_same_format(tmp_path, suffix):
    """As cameras and other systems write it, for reading, writing, and what is left out."""
    small, capital = tmp_path / f"a{suffix}", tmp_path / f"b{suffix.upper()}"
    for path in (small, capital):
        write_edges(path, edges((0, 3, 5), (1, 4, 6)), TIMING)
    assert capital.read_bytes() == small.read_bytes()
    assert edges_of(capital) == edges_of(small) == ([(0, 3, 5), (1, 4, 6)], {})
    assert offsets_note(capital, PLACED) == offsets_note(small, PLACED)


def test_a_suffix_that_is_none_of_a_recording_is_told_with_those_that_are(tmp_path):
    with pytest.raises(
        InputError, match=r"a\.txt: must end with one of \.npz, \.csv, \.h5, \.hdf5, \.ptu$"
    ):
        write_edges(tmp_path / "a.txt", edges((0, 3, 5)), TIMING)


def test_a_written_ptu_file_is_that_of_its_device(tmp_path):
    """As another reader sees it: periods, bins and numbers in the header, records in time."""
    timing = Timing(clock_hz=400e6, phases=16, period_cycles=100)
    rows = [(2, 3, 1500), (0, 5, 40), (2, 1, 1501), (0, 60, 7), (2, 7, 3), (1500, 4, 0)]
    write_edges(tmp_path / "a.ptu", edges(*rows), timing)
    with ptufile.PtuFile(tmp_path / "a.ptu") as file:
        assert file.is_t3
        assert file.global_resolution == pytest.approx(250e-9)
        assert file.tcspc_resolution == pytest.approx(1 / (400e6 * 16))
        assert file.tags["TTResult_SyncRate"] == 4_000_000
        records = file.decode_records()
        assert file.number_records == len(file.read_records())
    photons = records[records["channel"] >= 0]
    found = [(int(one["time"]), int(one["channel"]), int(one["dtime"])) for one in photons]
    assert found == sorted(rows, key=lambda row: (row[0], row[2]))


@pytest.mark.parametrize(("period_cycles", "sync_hz"), [(240, 1_666_667), (280, 1_428_571)])
def test_the_rate_of_a_written_ptu_file_is_the_nearest_whole_one(tmp_path, period_cycles, sync_hz):
    timing = Timing(clock_hz=400e6, period_cycles=period_cycles)
    write_edges(tmp_path / "a.ptu", edges((0, 5, 40)), timing)
    with ptufile.PtuFile(tmp_path / "a.ptu") as file:
        assert file.tags["TTResult_SyncRate"] == sync_hz


@pytest.mark.parametrize("suffix", FORMATS)
@pytest.mark.parametrize("offset_ps", [None, np.zeros(0)], ids=["", "offsets"])
def test_a_file_of_no_edges_is_written_and_read(tmp_path, suffix, offset_ps):
    """As of a scene in the dark."""
    none = np.zeros(0, np.int64)
    path = tmp_path / f"none{suffix}"
    write_edges(path, Edges(none, none, none, offset_ps), TIMING)
    assert len(read_recording(path).sync) == 0
    with pytest.raises(InputError, match="^the recording holds no photons$"):
        edges_of(path)


@given(pulses=st.lists(st.integers(0, 3 << 20), min_size=1, max_size=20))
def test_syncs_of_a_long_recording(tmp_path_factory, pulses):
    """The records' sync counter wraps at 1024, and the counter of wraps does, too."""
    path = tmp_path_factory.mktemp("edges") / "long.ptu"
    write_edges(path, edges(*((pulse, 63, 1) for pulse in pulses)), TIMING)
    assert read_recording(path).sync.tolist() == sorted(pulses)


@pytest.mark.parametrize("wraps", [1022, 1023, 1024, 2 * 1023, 2 * 1023 + 1])
def test_gaps_that_just_fill_a_count_of_wraps(tmp_path, wraps):
    """A record counts 1,023 wraps of 1,024 pulses at most."""
    pulses = [7, 7 + 1024 * wraps]
    write_edges(tmp_path / "gap.ptu", edges(*((pulse, 63, 1) for pulse in pulses)), TIMING)
    assert read_recording(tmp_path / "gap.ptu").sync.tolist() == pulses


BAD_TABLES = {
    "no columns": ("", "must have pulse, pixel, tick"),
    "no times": ("sync,channel\n1,1\n", "must have pulse, pixel, tick"),
    "two times": (
        "sync,channel,time_ns,time_ps\n1,1,1,1000\n",
        "has the columns time_ps, time_ns; must have one of them",
    ),
    "no channels": ("sync,time_ps\n1,1\n", "must have pulse, pixel, tick"),
    "text": ("sync,channel,time_ps\n1,one,1\n", "could not convert"),
    "short line": ("sync,channel,time_ps\n1,2,3\n1,1\n", "row 2"),
    "fraction of a sync": (
        "sync,channel,time_ps\n1,2,3\n1.5,2,3\n",
        r"sync\[1\] = 1.5: must be an integer",
    ),
    "negative time": (
        "sync,channel,time_ps\n1,2,-3\n",
        r"time_ps\[0\] = -3: must be a number of at least 0",
    ),
    "negative time in its unit": (
        "sync,channel,time_us\n1,2,3\n1,2,-4\n",
        r"time_us\[1\] = -4: must be a number of at least 0",
    ),
    "column twice": ("sync,channel,time_ps,sync\n1,2,3,4\n", "has 2 columns sync, must have one"),
    "negative sync": ("sync,channel,time_ps\n-1,2,3\n", r"sync\[0\] = -1"),
    "no number": ("sync,channel,time_ps\n1,2,nan\n", r"time_ps\[0\] = nan"),
    "huge": ("sync,channel,time_ps\n1e300,2,1\n", r"sync\[0\] = 1e\+300"),
    "no sync": ("channel,time_ps\n1,5\n", "--sync-channel must name"),
    "nothing": ("sync,channel,time_ps\n", "holds no photons"),
    "nothing behind a comment": ("# sync,channel,time_ps\n", "holds no photons"),
    "fraction of a tick": ("pulse,pixel,tick\n1,2,3.5\n", r"tick\[0\] = 3.5"),
    "all late": ("sync,channel,time_ps\n700,1,5\n900,1,5\n", "its syncs are 700 to 900"),
}


def test_a_file_without_columns_says_so(tmp_path):
    np.savez(tmp_path / "a.npz")
    with h5py.File(tmp_path / "a.h5", "w") as archive:
        archive["group/time_ps"] = [1, 2]
    for name in ("a.npz", "a.h5"):
        with pytest.raises(InputError, match=f"{name}: has the columns none; must have pulse"):
            read_recording(tmp_path / name)


@pytest.mark.parametrize("name", BAD_TABLES)
def test_bad_tables(tmp_path, name):
    text, words = BAD_TABLES[name]
    (tmp_path / "bad.csv").write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=words):
        edges_of(tmp_path / "bad.csv")


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_damaged_files(tmp_path, suffix):
    """A file that is cut anywhere, or has a changed byte, is read or refused with a message."""
    rng = np.random.default_rng(1)
    path = tmp_path / f"edges{suffix}"
    write_edges(path, edges(*((pulse, pulse, 50 * pulse) for pulse in range(40))), TIMING)
    whole = path.read_bytes()
    refused = 0
    for number in range(60):
        data = bytearray(whole)
        if number % 2:
            del data[rng.integers(len(data)) :]
        else:
            data[rng.integers(len(data))] ^= 255
        path.write_bytes(data)
        try:
            edges_of(path)
        except InputError:
            refused += 1
    assert refused >= (20 if suffix == ".csv" else 30)
    path.unlink()
    with pytest.raises(InputError, match="no such file"):
        edges_of(path)


@pytest.mark.parametrize(
    ("columns", "kind"),
    [
        ("pulse,pixel,tick\n0,0,1\n", "table of edges"),
        ("pulse,pixel,tick,offset_ps\n0,0,1,5\n", "table of edges"),
        ("sync,channel,time_ps\n0,0,1\n", "table of syncs"),
    ],
)
def test_tables_without_triggers_are_told_by_their_kind(tmp_path, columns, kind):
    path = tmp_path / "a.csv"
    path.write_text(columns, encoding="utf-8")
    with pytest.raises(InputError, match=f"is a {kind}, which has no triggers"):
        edges_of(path, sync_channel=9)


def test_bad_ptu(tmp_path):
    path = ptu(tmp_path / "a.ptu", [t2(0, 3, 5), t2(0, 4, 5)])
    with pytest.raises(InputError, match="no events on the sync input.*events: 3, 4"):
        edges_of(path)
    with pytest.raises(InputError, match="no events on input 5"):
        edges_of(path, sync_channel=5)
    path.write_bytes(path.read_bytes()[:-2])
    with pytest.raises(InputError, match="truncated: 1 whole records of 2"):
        edges_of(path)
    path.write_bytes(b"not a recording at all, but long enough for a header")
    with pytest.raises(InputError, match="not a readable PTU file"):
        edges_of(path)
    with pytest.raises(InputError, match="T3 recording"):
        edges_of(ptu(path, [t3(0, 1, 1, 1)], mode=3, kind=0x00010307, clock_s=5e-7), sync_channel=0)
    for clock_s in (0.0, float("inf")):
        with pytest.raises(InputError, match=f"MeasDesc_GlobalResolution = {clock_s:g}: must be"):
            edges_of(ptu(tmp_path / "b.ptu", [t2(1, 0, 5), t2(0, 3, 9)], clock_s=clock_s))
    with pytest.raises(InputError, match="MeasDesc_Resolution"):
        edges_of(ptu(path, [t3(0, 1, 1, 1)], mode=3, kind=0x00010307, clock_s=5e-7, bin_s=0.0))
    write_edges(path, edges((0, 63, (1 << 15) - 1)), TIMING)
    last = read_recording(path)
    assert last.channel.tolist() == [63] and last.time_ps // 62.5 == [(1 << 15) - 1]
    for row, words in (
        ((0, 64, 0), "pixel = 64: must be from 0 to 63"),
        ((0, 0, 1 << 15), "tick = 32768"),
    ):
        with pytest.raises(InputError, match=words):
            write_edges(path, edges(row), TIMING)


def test_channel_maps(tmp_path):
    (tmp_path / "map.csv").write_text("channel,pixel\n4,1\n5,0\n", encoding="utf-8")
    assert parse_channels(str(tmp_path / "map.csv")) == parse_channels("4:1, 5:0") == {4: 1, 5: 0}
    assert parse_channels("-" + "9" * 18 + ":" + "9" * 18) == {-(10**18) + 1: 10**18 - 1}
    (tmp_path / "map.csv").rename(tmp_path / "MAP.CSV")
    assert parse_channels(str(tmp_path / "MAP.CSV")) == {4: 1, 5: 0}
    (tmp_path / "none.csv").write_text("channel,pixel\n", encoding="utf-8")
    (tmp_path / "half.csv").write_text("channel,pixel\n4,1\n5.5,0\n", encoding="utf-8")
    for columns in ("channel,place", "detector,pixel", "tick"):
        (tmp_path / f"{columns}.csv").write_text(f"{columns}\n4,1\n", encoding="utf-8")
    for text, words in (
        (str(tmp_path / "none.csv"), "none.csv: names no channel"),
        (str(tmp_path / "half.csv"), r"half.csv: channel\[1\] = 5.5: must be an integer"),
        (str(tmp_path / "channel,place.csv"), "has the columns channel, place; must have channel"),
        (str(tmp_path / "detector,pixel.csv"), "columns detector, pixel; must have channel, pixel"),
        (str(tmp_path / "tick.csv"), "tick.csv: has the columns tick; must have channel, pixel"),
        ("4-1", "must be CHANNEL:PIXEL"),
        ("9" * 5000 + ":1", f"^channels = '{'9' * 99} ...: must be CHANNEL:PIXEL"),
        ("1:" + "9" * 19, "must be CHANNEL:PIXEL"),
        ("4:1,4:2", "channel 4 comes twice"),
        ("4:1,5:1", "pixel 1 comes twice"),
        ("0:1,0:2", "channel 0 comes twice"),
        ("4:0,5:0", "pixel 0 comes twice"),
        ("4:1,5:2,5:3,4:4", "channel 4 comes twice"),  # the first of them
        ("4:1,4:2,5:3,5:4", "channel 4 comes twice"),
    ):
        with pytest.raises(InputError, match=words):
            parse_channels(text)
    (tmp_path / "a.csv").write_text("sync,channel,time_ps\n0,4,5\n", encoding="utf-8")
    for channels, words in (
        ({5: 0}, "channel 5 is not in the recording, must be one of 4"),
        ({4: 64}, "pixel of channel 4 = 64"),
    ):
        with pytest.raises(InputError, match=words):
            edges_of(tmp_path / "a.csv", channels=channels)


def test_the_span_of_a_recording_without_use_is_that_of_its_syncs(tmp_path):
    """Without photons before the first one, which have no sync."""
    times = {"channel": [3, 9, 3, 9], "time_ps": [5, 100, 600_000, 500_100]}
    np.savez(tmp_path / "a.npz", **times)
    told = "no photon is left: 1 before the first sync; 1 before sync 2 .*; its syncs are 1 to 1$"
    with pytest.raises(InputError, match=told):
        edges_of(tmp_path / "a.npz", sync_channel=9, first_sync=2)


def test_photons_that_are_lost_are_told_by_reason():
    assert told({"before": 1_234_567, "never": 0, "after": 2}) == "1,234,567 before; 2 after"


@pytest.mark.parametrize("ratio", [1e-4, 0.4, 0.998, 1.002, 2.5])
def test_another_laser_period_is_told_whichever_is_longer(ratio):
    """With both periods, and the setting that fits the recording, which is at least a cycle."""
    none = np.zeros(0, np.int64)
    frame = Timing(clock_hz=400e6, period_cycles=1000)
    found = Recording(sync=none, channel=none, time_ps=none, kind="", period_ps=ratio * 2.5e6)
    assert period_note(found, frame) == (
        f"laser period: {2500 * ratio:g} ns in the recording, 2500 ns in the frame"
        f" (frame.period = {max(1, round(1000 * ratio))} would fit)"
    )
    for near in (0.9995, 1.0, 1.0005):
        assert not period_note(evolve(found, period_ps=near * 2.5e6), frame)
    assert not period_note(evolve(found, period_ps=None), frame)


@pytest.mark.parametrize(
    ("last", "told"), [(18, ", ".join(map(str, range(3, 19)))), (20, r"3, 4, .*, 18, \.\.\. 20")]
)
def test_of_many_channels_the_first_and_the_last_are_told(last, told, tmp_path):
    """16 of them, and the last one."""
    lines = [f"0,{channel},5\n" for channel in range(3, last + 1)]
    (tmp_path / "a.csv").write_text("sync,channel,time_ps\n" + "".join(lines), encoding="utf-8")
    with pytest.raises(InputError, match=f"channel 2 is not .* one of {told}$"):
        edges_of(tmp_path / "a.csv", channels={2: 0})


@pytest.mark.long
def test_recording_replays_alike_through_model_and_rtl(tmp_path):
    """From a scene's photons to a recording and back to edges, on the command line."""
    sensor = "".join(f"{key} = {value}\n" for key, value in SENSORS["tiny"].items())
    (tmp_path / "small.toml").write_text(
        f"[sensor]\n{sensor}[frame]\npulses = 20\nframes = 2\n", encoding="utf-8"
    )

    def run(*words):
        result = command(*words, "--config", tmp_path / "small.toml")
        assert result.exit_code == 0, result.output
        return result.stdout

    told = run("photons --scene flat:4,0.4 --klux 20 --out", tmp_path / "recorded.ptu")
    run("photons --scene flat:4,0.4 --klux 20 --out", tmp_path / "photons.npz")
    read = run("edges", tmp_path / "recorded.ptu", "--out", tmp_path / "edges.npz").splitlines()[-1]
    assert told.split()[1] == read.split()[1]
    assert (tmp_path / "edges.npz").read_bytes() == (tmp_path / "photons.npz").read_bytes()
    config = load_config(tmp_path / "small.toml")
    loaded = load_edges(
        tmp_path / "edges.npz", pixels=48, pulses=40, period_ticks=config.period_ticks
    )
    assert not differences(replay("golden", config, loaded), replay("sliced", config, loaded))


def test_offsets_inside_a_tick(tmp_path):
    """An offset of 0 is legal and comes back; a negative one is refused."""
    zero, limits = np.zeros(1, np.int64), {"pixels": 1, "pulses": 1, "period_ticks": 1}
    for offset_ps in (0.0, -1.0):
        Edges(zero, zero, zero, np.array([offset_ps])).save(tmp_path / f"{offset_ps}.npz")
    assert load_edges(tmp_path / "0.0.npz", **limits).offset_ps == [0]
    with pytest.raises(InputError, match=r"offset_ps\[0\] = -1"):
        load_edges(tmp_path / "-1.0.npz", **limits)


def test_errors_at_the_command_line(tmp_path):
    (tmp_path / "a.csv").write_text("sync,channel,time_ps\n0,4,5\n", encoding="utf-8")
    for arguments, words in (
        (("--out", tmp_path / "out.txt"), "must end with one of .npz"),
        (("--out", tmp_path / "out.npz", "--channels", "7:0"), "a.csv: channels: channel 7 is not"),
        (("--out", tmp_path / "out.npz", "--first-sync", "-1"), "first-sync = -1"),
    ):
        assert_refused(command("edges", tmp_path / "a.csv", *arguments), words)
    assert [path.name for path in tmp_path.iterdir()] == ["a.csv"]


def test_the_command_tells_what_was_read_what_was_lost_and_what_is_left(tmp_path):
    """A line each, in this order; nothing is said of what did not happen."""
    channel = [9, 3, 70, 9, 3, 9, 5]
    time_ps = [0, 1000, 2000, 400_000, 401_000, 800_000, 801_000]
    np.savez(tmp_path / "a.npz", channel=channel, time_ps=time_ps)
    size = "--set rows=8 --set cols=8 --set pulses=2"
    recorded, out = tmp_path / "a.npz", tmp_path / "b.npz"
    result = command(f"edges {recorded} --out {out} --sync-channel 9 {size}")
    assert result.stdout.splitlines() == [
        f"{recorded}: table of absolute times, 4 photons",
        "laser period: 400 ns in the recording, 500 ns in the frame (frame.period = 200 would fit)",
        "left out: 1 after sync 1, the last of 1 x 2 pulses; 1 in channels without a pixel",
        f"{out}: 2 edges",
    ]
    again = command(f"edges {out} --out {tmp_path / 'c.csv'} {size}")
    assert again.stdout.splitlines() == [
        f"{out}: table of edges, 2 photons",
        f"{tmp_path / 'c.csv'}: 2 edges",
    ]


def test_times_keep_their_picoseconds(tmp_path):
    """Taggers count for months; float64 holds no integer above 2^53 (Photon-HDF5 keeps
    timestamps as int64 for it).
    """
    ps = np.array([0, 1000, 1062, 1063, 500_000, 507_777]) + 30 * 86_400 * 10**12
    channel = np.array([0, 1, 1, 1, 0, 2])
    expected = [(0, 1, 16), (0, 1, 16), (0, 1, 17), (1, 2, 124)]
    np.savez(tmp_path / "a.npz", channel=channel, time_ps=ps)
    np.savetxt(
        tmp_path / "a.csv",
        np.stack([channel, ps], axis=1),
        "%d",
        ",",
        header="channel,time_ps",
        comments="",
    )
    for name in ("a.npz", "a.csv"):
        assert edges_of(tmp_path / name, sync_channel=0)[0] == expected
    epoch_ns = np.array([0, 50, 100, 500, 630]) + 1_700_000_000_000_000_000
    np.savez(tmp_path / "b.npz", channel=[0, 1, 1, 0, 2], time_ns=epoch_ns)
    assert edges_of(tmp_path / "b.npz", sync_channel=0)[0] == [
        (0, 1, 800),
        (0, 1, 1600),
        (1, 2, 2080),
    ]
    np.savez(tmp_path / "c.npz", channel=channel, time_ps=ps.astype(float))
    with pytest.raises(InputError, match="below 2.53 in a column of floats"):
        edges_of(tmp_path / "c.npz", sync_channel=0)
    for last, is_exact in ((2.0**53 - 1, True), (2.0**53, False)):
        np.savez(tmp_path / "d.npz", channel=[0, 1], time_ps=[0.0, last])
        if is_exact:
            assert read_recording(tmp_path / "d.npz", 0).time_ps.tolist() == [last]
            continue
        with pytest.raises(InputError, match=r"time_ps\[1\] = 9007199254740992.0: must be below"):
            read_recording(tmp_path / "d.npz", 0)


@pytest.mark.parametrize("wrong", [-1.0, np.inf, np.nan])
@pytest.mark.parametrize("since_trigger", [True, False])
def test_times_are_finite_and_not_negative(tmp_path, since_trigger, wrong):
    table = {"channel": [0, 1], "time_ns": [5.0, wrong]}
    np.savez(tmp_path / "a.npz", **table | ({"sync": [0, 0]} if since_trigger else {}))
    says = re.escape(f"a.npz: time_ns[1] = {wrong}: must be a number of at least 0")
    with pytest.raises(InputError, match=says):
        read_recording(tmp_path / "a.npz", None if since_trigger else 0)


@pytest.mark.parametrize(
    "column, since_trigger", [("sync", True), ("channel", True), ("channel", False)]
)
def test_numbers_of_triggers_and_channels_are_exact_or_refused(tmp_path, column, since_trigger):
    """Integers of any size are; floats are up to 2^53. Channels also beside absolute times."""
    table = {"sync": [0, 1, 2], "channel": [3, 3, 3], "time_ps": [5, 6, 7]}

    def read(numbers):
        if since_trigger:
            np.savez(tmp_path / "a.npz", **table | {column: numbers})
            return getattr(read_recording(tmp_path / "a.npz"), column).tolist()
        np.savez(tmp_path / "a.npz", channel=[*numbers, numbers[2]], time_ps=[5, 6, 7, 4])
        read = read_recording(tmp_path / "a.npz", int(numbers[2]))
        return [*read.channel.tolist(), int(numbers[2])]

    for whole in ([0, 2**62 + 1, 1], [0, 2**63 - 1, 1]):
        assert read(np.array(whole)) == read(np.array(whole, np.uint64)) == whole
    with pytest.raises(InputError, match=f"{column}: holds {2**63}, must be below 2\\^63"):
        read(np.array([0, 2**63, 1], np.uint64))
    for kind in (np.uint8, np.float32):
        assert read(np.array([0, 200, 1], kind)) == [0, 200, 1]
    assert read(np.array([0.0, 2.0**53 - 1, 1.0])) == [0, 2**53 - 1, 1]
    for wrong in (2.0**53, -(2.0**53), -0.5, 0.5, np.nan, np.inf, -np.inf):
        says = re.escape(
            f"a.npz: {column}[1] = {wrong}: must be an integer, below 2^53 in a column"
        )
        with pytest.raises(InputError, match=says):
            read(np.array([0.0, wrong, 1.0]))


def scan(tmp_path, records, rows, cols, **more):
    """Read a PTU file of a scan whose bins have 125 ps; return the recording, and its bins.

    Markers are bits: frame 4, line start 1, line stop 2. more: further tags.
    """
    tags = {
        "Measurement_SubMode": 3,
        "ImgHdr_Dimensions": 3,
        "ImgHdr_PixX": cols,
        "ImgHdr_PixY": rows,
        "ImgHdr_LineStart": 1,
        "ImgHdr_LineStop": 2,
        "ImgHdr_Frame": 3,
        "ImgHdr_Ident": 1,
        "ImgHdr_BiDirect": 0,
    } | more
    path = ptu(
        tmp_path / "a.ptu", records, mode=3, kind=0x00010307, clock_s=500e-9, bin_s=125e-12, **tags
    )
    read = read_recording(path)
    return read, (read.time_ps // 125).astype(int)


@pytest.mark.parametrize("marked", [1, 2])
def test_a_scan_that_begins_within_a_frame(tmp_path, marked):
    """`ptufile.decode_image` leaves out what is before the first frame marker, because its rows
    are unknown. marked: the first frame with a marker; whole frames before it are counted back.
    """
    rows, cols, dwell = 4, 4, 5
    records, at = [], 10
    for frame in range(3):
        if frame >= marked:
            records.append(t3(1, 4, 0, at))
            at += 3
        for row in range(rows if frame else 2):
            row += 0 if frame else 2
            records.append(t3(1, 1, 0, at))
            records += [t3(0, 0, row * 16 + col, at + col * dwell + 2) for col in range(cols)]
            at += cols * dwell
            records.append(t3(1, 2, 0, at))
            at += 4
    read, bins = scan(tmp_path, records, rows, cols)
    placed = read.sync >= 0
    assert placed.sum() == 2 * rows * cols and "2 image(s)" in read.kind
    assert np.array_equal((bins // 16 * cols + bins % 16)[placed], read.channel[placed])
    assert set(read.sync[~placed].tolist()) == {-1}, "they belong to no sync of the image"


def test_a_line_of_a_scan_whose_positions_are_not_equally_long(tmp_path):
    """Ten syncs for three positions: the first position has one more than the others, which is left
    out, and each of the others begins with its own first sync.
    """
    cols, syncs = 3, 10
    records = [t3(1, 1, 0, 20)]
    records += [t3(0, 0, sync, 20 + sync) for sync in range(syncs)]
    records += [t3(1, 2, 0, 20 + syncs), t3(0, 0, syncs, 20 + syncs)]  # no longer in the line
    read, sync_in_line = scan(tmp_path, records, 1, cols)
    placed = read.sync >= 0
    found = zip(sync_in_line[placed], read.channel[placed], read.sync[placed], strict=True)
    expected = [(sync, 0, sync) for sync in (0, 1, 2)]
    expected += [(sync, 1, sync - 4) for sync in (4, 5, 6)]
    expected += [(sync, 2, sync - 7) for sync in (7, 8, 9)]
    assert sorted(found) == expected


@pytest.mark.parametrize("longer", [0, 1, 2])
def test_positions_of_a_scan_last_as_long_as_in_most_of_its_lines(tmp_path, longer):
    """What is left of a line that takes longer is lost, and told as such."""
    cols, at, records = 4, 0, []
    for row in range(3):
        syncs = 80 if row == longer else 40
        records.append(t3(1, 1, 0, at))
        records += [t3(0, 0, 1, at + sync) for sync in range(syncs)]
        at += syncs
        records.append(t3(1, 2, 0, at))
        at += 2
    read, _ = scan(tmp_path, records, 3, cols)
    assert "scan of 3 x 4 positions, 10 syncs each, 1 image(s)" in read.kind
    placed = read.sync >= 0
    assert np.bincount(read.channel[placed]).tolist() == [10] * 12
    config = parse_config({"sensor": {"rows": 8, "cols": 8}, "frame": {"pulses": 20}})
    _, lost = recorded_edges(read, config, TIMING)
    assert lost == {"between the positions of the scan": 40}


def test_lines_of_a_scan_without_an_end_do_not_shorten_its_positions(tmp_path):
    cols, syncs, records = 4, 40, []
    for row in range(3):
        records.append(t3(1, 1, 0, row * 50))
        records += [t3(0, 0, 1, row * 50 + sync) for sync in range(syncs)]
        if row == 1:
            records.append(t3(1, 2, 0, row * 50 + syncs))
    read, _ = scan(tmp_path, records, 3, cols)
    assert "scan of 3 x 4 positions, 10 syncs each" in read.kind
    assert np.bincount(read.channel[read.sync >= 0]).tolist() == [0] * cols + [10] * cols


@pytest.mark.parametrize(
    ("tags", "words"),
    [
        ({"ImgHdr_SinCorrection": 1}, "is a sinusoidal scan, must be one of constant speed"),
        ({"ImgHdr_PixX": 0}, "is an image without its size or its line markers"),
        ({"ImgHdr_PixY": 0}, "is an image without its size or its line markers"),
        ({"ImgHdr_LineStart": 5}, "holds no whole line between its markers"),
        ({"ImgHdr_LineStop": 5}, "holds no whole line between its markers"),
    ],
)
def test_a_scan_that_cannot_be_placed_is_refused(tmp_path, tags, words):
    records = [t3(1, 1, 0, 0), t3(0, 0, 1, 5), t3(1, 2, 0, 10)]
    read, _ = scan(tmp_path, records, 1, 2)
    assert read.channel.tolist() == [1]
    with pytest.raises(InputError, match=words):
        scan(tmp_path, records, 1, 2, **tags)


def test_triggers_that_are_missing_do_not_change_the_period():
    period_ps = 500_000
    triggers = np.delete(np.arange(100), [20, 21, 22, 50]) * period_ps
    recording = since_sync(triggers + 1000, np.zeros(len(triggers)), triggers, 1.0, "times")
    assert recording.period_ps == period_ps


def test_tables_of_other_programs(tmp_path):
    """NumPy's `savetxt` writes names as a comment; spreadsheets quote everything; some add bytes
    after the last record.
    """
    np.savetxt(
        tmp_path / "a.csv", [[0, 3, 100], [1, 3, 200]], "%d", ",", header="sync,channel,time_ps"
    )
    assert edges_of(tmp_path / "a.csv")[0] == [(0, 3, 1), (1, 3, 3)]
    (tmp_path / "b.csv").write_text('"sync","channel","time_ps"\n"0","3","100"\n', encoding="utf-8")
    assert edges_of(tmp_path / "b.csv")[0] == [(0, 3, 1)]
    path = ptu(
        tmp_path / "c.ptu", [t3(0, 3, 0, 1)], mode=3, kind=0x00010307, clock_s=500e-9, bin_s=125e-12
    )
    path.write_bytes(path.read_bytes() + bytes(2))
    assert edges_of(path)[0] == [(1, 3, 1)]
    assert parse_channels("-2:0, 2:1") == {-2: 0, 2: 1}


# A laser of 25 ns whose triggers are divided by 4: photons in its pulses 4, 5, 7 and 8.
DIVIDED_PS = np.array([100_000, 200_000])
PHOTONS_PS = np.array([103_000, 128_000, 178_000, 203_000])


def divided_table(path):
    channel = np.r_[np.zeros(2), np.full(4, 3)].astype(int)
    np.savez(path, channel=channel, time_ps=np.r_[DIVIDED_PS, PHOTONS_PS])
    return path


def test_a_divided_sync_among_absolute_times(tmp_path):
    path = divided_table(tmp_path / "a.npz")
    found = read_recording(path, 0, 4)
    assert found.sync.tolist() == [0, 1, 3, 4]
    assert found.time_ps.tolist() == [3000] * 4 and found.period_ps == 25_000
    whole = read_recording(path, 0)
    assert whole.time_ps.tolist() == [3000, 28_000, 78_000, 3000]


def test_photons_before_the_first_divided_trigger_belong_to_none(tmp_path):
    np.savez(tmp_path / "a.npz", channel=[3, 0, 0, 3], time_ps=[20_000, 100_000, 200_000, 203_000])
    assert read_recording(tmp_path / "a.npz", 0, 4).sync.tolist() == [-1, 4]
    recording = read_recording(tmp_path / "a.npz", 0, 4)
    _, lost = recorded_edges(recording, CONFIG, TIMING)
    assert lost == {"before the first sync": 1}


def divided_ptu(path, *, special, channel):
    """Write the same as T2, with the divider in the header; special, channel: of the triggers."""
    events = sorted(
        [(time, t2(special, channel, time)) for time in DIVIDED_PS.tolist()]
        + [(time, t2(0, 3, time)) for time in PHOTONS_PS.tolist()]
    )
    return ptu(path, [record for _, record in events], HWSync_Divider=4)


def test_a_divided_sync_in_the_header_of_t2(tmp_path):
    """A divider in T2 removes syncs (MultiHarp 150, manual, WARNING_DIVIDER_GREATER_ONE)."""
    path = divided_ptu(tmp_path / "a.ptu", special=1, channel=0)
    found = read_recording(path)
    assert found.sync.tolist() == [0, 1, 3, 4] and "sync divider 4" in found.kind
    assert read_recording(path, sync_divider=1).sync.tolist() == [0, 0, 0, 1]


def test_a_trigger_on_an_input_is_not_divided(tmp_path):
    """The divider of the header is that of the sync input."""
    path = divided_ptu(tmp_path / "a.ptu", special=0, channel=7)
    found = read_recording(path, 7)
    assert found.sync.tolist() == [0, 0, 0, 1] and "divider" not in found.kind


def test_a_divided_sync_in_the_header_of_t3(tmp_path):
    """The device numbers the laser's pulses; times may go beyond the period of the laser."""
    records = [t3(0, 3, 3, 4), t3(0, 3, 28, 4), t3(0, 3, 78, 4), t3(0, 3, 3, 8)]
    form = {"mode": 3, "kind": 0x00010307, "clock_s": 25e-9, "bin_s": 1e-9}
    divided = read_recording(ptu(tmp_path / "a.ptu", records, HWSync_Divider=4, **form))
    assert divided.sync.tolist() == [4, 5, 7, 8]
    assert divided.time_ps == pytest.approx([3500] * 4)
    plain = read_recording(ptu(tmp_path / "b.ptu", records, **form))
    assert plain.sync.tolist() == [4, 4, 4, 8]
    halved = read_recording(tmp_path / "b.ptu", sync_divider=2)
    assert halved.period_ps == pytest.approx(12_500) and halved.sync.tolist() == [8, 10, 14, 16]


def test_a_divider_needs_a_period(tmp_path):
    np.savez(tmp_path / "a.npz", sync=[0, 1], channel=[3, 3], time_ps=[5, 6])
    with pytest.raises(InputError, match="sync-divider = 4: goes with T2, T3"):
        read_recording(tmp_path / "a.npz", sync_divider=4)
    with pytest.raises(InputError, match="sync-divider = 0"):
        read_recording(divided_table(tmp_path / "b.npz"), 0, 0)


def photon_hdf5(path, **datasets):
    with h5py.File(path, "w") as archive:
        for name, values in datasets.items():
            archive[f"photon_data/{name.replace('__', '/')}"] = values
    return path


SYNCED = {
    "timestamps": np.array([4, 5, 7]),
    "detectors": np.array([3, 3, 2], np.uint8),
    "nanotimes": np.array([10, 20, 30], np.uint16),
    "timestamps_specs__timestamps_unit": 25e-9,
    "nanotimes_specs__tcspc_unit": 100e-12,
}


def test_photon_hdf5(tmp_path):
    found = read_recording(photon_hdf5(tmp_path / "a.h5", **SYNCED))
    assert found.sync.tolist() == [4, 5, 7] and found.channel.tolist() == [3, 3, 2]
    assert found.time_ps == pytest.approx([1050, 2050, 3050])
    assert found.period_ps == pytest.approx(25_000)


def test_hdf5_that_cannot_be_read_is_refused_by_its_name(tmp_path):
    """By what asks for its kind, too."""
    path = tmp_path / "a.h5"
    path.write_bytes(b"no HDF5")
    with pytest.raises(InputError, match=r"a\.h5: is not a readable HDF5 file"):
        is_photon_hdf5(path)


def test_photon_hdf5_of_a_laser_with_another_rate(tmp_path):
    """Whole ratios are a sync divider; otherwise the number of a pulse follows from its time."""
    rate = "measurement_specs__laser_repetition_rate"
    four = read_recording(photon_hdf5(tmp_path / "a.h5", **SYNCED, **{rate: 160e6}))
    assert four.sync.tolist() == [16, 20, 28] and four.period_ps == pytest.approx(6250)
    slow = read_recording(photon_hdf5(tmp_path / "b.h5", **SYNCED, **{rate: 10e6}))
    assert slow.sync.tolist() == [1, 1, 1] and slow.period_ps == pytest.approx(100_000)


def test_a_rate_of_the_laser_that_is_nearly_whole_is_a_divider(tmp_path):
    """Up to a thousandth, as clocks differ; the triggers keep their period."""
    rate = "measurement_specs__laser_repetition_rate"
    for nearly in (0.9995, 1.0005):
        path = photon_hdf5(tmp_path / f"{nearly}.h5", **SYNCED, **{rate: nearly * 160e6})
        found = read_recording(path)
        assert found.sync.tolist() == [16, 20, 28]
        assert found.period_ps == pytest.approx(6250, rel=1e-9)


def test_photons_of_a_file_without_detectors_are_those_of_detector_0(tmp_path):
    alone = {name: values for name, values in SYNCED.items() if name != "detectors"}
    found = read_recording(photon_hdf5(tmp_path / "a.h5", **alone))
    assert found.channel.tolist() == [0, 0, 0] and found.sync.tolist() == [4, 5, 7]


def test_pulses_that_cannot_be_counted_are_refused(tmp_path):
    """Their numbers would wrap, to negative syncs or to small ones."""
    rate = "measurement_specs__laser_repetition_rate"
    fast = photon_hdf5(tmp_path / "a.h5", **SYNCED, **{rate: 40e6 * 70_000})
    with pytest.raises(InputError, match="laser_repetition_rate: is 70000 .* at most 65536"):
        read_recording(fast)
    late = SYNCED | {"timestamps": np.array([4, 5, 1 << 48])}
    for pulses, is_exact in ((31.5, True), (32.5, False)):
        path = photon_hdf5(tmp_path / "c.h5", **late, **{rate: 40e6 * pulses})
        if is_exact:
            assert read_recording(path).sync.tolist() == [126, 157, round(pulses * 2**48)]
            continue
        told = "timestamps: holds 281474976710656, which is pulse 9.14794e.15 .* below 2.53$"
        with pytest.raises(InputError, match=told):
            read_recording(path)
        first = late | {"timestamps": late["timestamps"][::-1]}
        with pytest.raises(InputError, match=told):
            read_recording(photon_hdf5(tmp_path / "d.h5", **first, **{rate: 40e6 * pulses}))
    path = photon_hdf5(tmp_path / "b.h5", **late)
    assert read_recording(path, sync_divider=1 << 14).sync.max() >> 14 == 1 << 48
    with pytest.raises(InputError, match=r"sync-divider = 32768: sync 281474976710656 .*710654$"):
        read_recording(path, sync_divider=1 << 15)


def test_a_trigger_may_stand_for_as_many_pulses_as_messages_tell(tmp_path):
    """By the header, by the rate of the laser, and by the user's word."""
    most = 1 << 16
    records = [t2(1, 0, 5), t2(0, 3, 9), t2(1, 0, 10)]
    rate = {"measurement_specs__laser_repetition_rate": 40e6 * most}
    plain = photon_hdf5(tmp_path / "a.h5", **SYNCED)
    for found in (
        read_recording(ptu(tmp_path / "a.ptu", records, HWSync_Divider=most)),
        read_recording(photon_hdf5(tmp_path / "b.h5", **SYNCED, **rate)),
        read_recording(plain, sync_divider=most),
    ):
        assert found.kind.endswith("sync divider 65536")
    with pytest.raises(
        InputError, match="sync-divider = 65537: must be an integer from 1 to 65536"
    ):
        read_recording(plain, sync_divider=most + 1)


PHOTONS = {"channel": [3, 2, 3, 5], "time_ps": [1050, 501_100, 502_050, 1_503_050]}
TRIGGERS = {"channel": [9, 9, 9], "time_ps": [0, 500_000, 1_500_000]}
ABSOLUTE = {name: TRIGGERS[name] + PHOTONS[name] for name in PHOTONS}
UNIT = {"timestamps_specs__timestamps_unit": 500e-9}


@pytest.mark.parametrize(
    ("columns", "more", "sync_channel"),
    [
        (PHOTONS | {"sync": [0, 1, 1, 3], "time_ps": [1050, 1100, 2050, 3050]}, {}, None),
        (ABSOLUTE, {}, 9),
        ({"pulse": [0, 1, 1, 3], "pixel": [3, 2, 3, 5], "tick": [16, 17, 32, 48]}, {}, None),
        (
            {"detectors": [3, 2, 3, 5], "timestamps": [0, 1, 1, 3], "nanotimes": [20, 21, 40, 60]},
            UNIT | {"nanotimes_specs__tcspc_unit": 50e-12},
            None,
        ),
        (
            {"detectors": ABSOLUTE["channel"], "timestamps": ABSOLUTE["time_ps"]},
            {"timestamps_specs__timestamps_unit": 1e-12},
            9,
        ),
    ],
)
def test_photons_of_a_file_may_be_in_any_order(tmp_path, columns, more, sync_channel):
    expected = [(0, 3, 16), (1, 2, 17), (1, 3, 32), (3, 5, 48)]
    if sync_channel is not None:  # a trigger that nobody recorded is no pulse
        expected[-1] = (2, 5, 48)
    order = np.arange(len(next(iter(columns.values()))))
    for shuffled in (order, order[::-1], np.roll(order, 2), np.roll(order[::-1], 1)):
        table = {name: np.array(column)[shuffled] for name, column in columns.items()}
        path = tmp_path / "a.npz"
        if more:
            path = photon_hdf5(tmp_path / "a.h5", **table, **more)
        else:
            np.savez(path, **table)
        assert edges_of(path, sync_channel=sync_channel) == (expected, {})


def test_photon_hdf5_without_nanotimes(tmp_path):
    absolute = {
        "timestamps": np.r_[DIVIDED_PS, PHOTONS_PS],
        "detectors": np.array([0, 0, 3, 3, 3, 3]),
        "timestamps_specs__timestamps_unit": 1e-12,
    }
    path = photon_hdf5(tmp_path / "a.h5", **absolute)
    assert read_recording(path, 0, 4).sync.tolist() == [0, 1, 3, 4]
    with pytest.raises(
        InputError, match=r"on a detector of .*--sync-channel must name it .*: 0, 3\)"
    ):
        read_recording(path)
    with pytest.raises(InputError, match="no events on a detector 7 of the laser's trigger"):
        read_recording(path, 7)


def recordings_of_every_kind(folder):
    """Return what the kind of a recording must be, beside the recording."""
    absolute = {
        "timestamps": np.array([0, 100, 500, 600]),
        "detectors": np.array([9, 3, 9, 3]),
        "timestamps_specs__timestamps_unit": 2e-9,
    }
    t3_file = ptu(
        folder / "t3.ptu", [t3(0, 3, 0, 1)], mode=3, kind=0x00010307, clock_s=5e-7, bin_s=125e-12
    )
    t2_file = ptu(folder / "t2.ptu", [t2(1, 0, 5), t2(0, 3, 9)], clock_s=4e-12)
    rate = {"measurement_specs__laser_repetition_rate": 10e6}
    return [
        ("T3, bins of 125 ps", read_recording(t3_file)),
        ("T2, clock of 4 ps", read_recording(t2_file)),
        (
            "Photon-HDF5, bins of 100 ps",
            read_recording(photon_hdf5(folder / "bins.h5", **SYNCED)),
        ),
        (
            "Photon-HDF5, bins of 100 ps, syncs by the laser's rate",
            read_recording(photon_hdf5(folder / "rate.h5", **SYNCED, **rate)),
        ),
        (
            "Photon-HDF5, clock of 2000 ps",
            read_recording(photon_hdf5(folder / "clock.h5", **absolute), 9),
        ),
        (
            "table of absolute times, sync divider 4",
            read_recording(divided_table(folder / "times.npz"), 0, 4),
        ),
    ]


def test_the_kind_of_a_recording_has_the_unit_of_its_times(tmp_path):
    """As `coincid edges` prints it beside the number of photons."""
    for kind, found in recordings_of_every_kind(tmp_path):
        assert found.kind == kind


def test_photon_hdf5_that_cannot_be_used(tmp_path):
    lacking = {name: values for name, values in SYNCED.items() if "tcspc" not in name}
    with pytest.raises(InputError, match="has no photon_data/nanotimes_specs/tcspc_unit"):
        read_recording(photon_hdf5(tmp_path / "a.h5", **lacking))
    for first in ("photon_data", "photon_data0"):
        with h5py.File(tmp_path / "b.h5", "w") as archive:
            archive[f"{first}/timestamps"] = [1]
            archive["photon_data1/timestamps"] = [1]
        with pytest.raises(InputError, match=f"has {first}, photon_data1, must have one"):
            read_recording(tmp_path / "b.h5")
    with pytest.raises(InputError, match="sync-channel = 3"):
        read_recording(photon_hdf5(tmp_path / "c.h5", **SYNCED), 3)


@pytest.mark.parametrize("delay_ps", [float("nan"), float("-inf")])
def test_a_delay_that_is_not_finite(tmp_path, delay_ps):
    path = tmp_path / "a.csv"
    path.write_text("pulse,pixel,tick\n0,3,100\n", encoding="utf-8")
    with pytest.raises(InputError, match=f"delay-ps = {delay_ps}: must be a number that is finite"):
        edges_of(path, delay_ps=delay_ps)


def test_a_delay_is_subtracted_from_ticks_too(tmp_path):
    """A table of edges has ticks already; the delay is in picoseconds."""
    path = tmp_path / "a.csv"
    path.write_text("pulse,pixel,tick\n0,3,100\n1,4,1\n", encoding="utf-8")
    assert edges_of(path)[0] == [(0, 3, 100), (1, 4, 1)]
    tick_ps = TIMING.tick_s * 1e12
    found, lost = edges_of(path, delay_ps=2 * tick_ps)
    assert found == [(0, 3, 98)]
    assert lost == {"before the trigger, by the delay": 1}


def test_a_dataset_of_hdf5_without_numbers(tmp_path):
    """A kind of its own, which is no array, not even one of length 0."""
    path = tmp_path / "a.h5"
    with h5py.File(path, "w") as file:
        file["channel"] = file["time_ps"] = h5py.Empty("f8")
    with pytest.raises(InputError, match=r"channel: holds .*, must hold numbers in one dimension"):
        read_recording(path, sync_channel=1)


DAMAGED_PHOTONS = {
    "few detectors": ({"detectors": np.zeros(2, int)}, "lengths differ: timestamps 3, detectors 2"),
    "few bins": ({"nanotimes": np.zeros(2, int)}, "lengths differ.* nanotimes 2"),
    "one timestamp": ({"timestamps": 5}, r"timestamps: holds int64\[\]"),
    "negative": ({"timestamps": np.array([-5, 5, 7])}, r"timestamps\[0\] = -5"),
    "no bin": ({"nanotimes": np.array([1, np.nan, 2])}, r"nanotimes\[1\] = nan"),
    "large": (
        {"timestamps": np.array([1, 2, 2**63 + 5], np.uint64)},
        "timestamps: holds 9223372036854775813, must be below 2.63",
    ),
    "unit in words": ({"timestamps_specs__timestamps_unit": "x"}, "unit: holds .* one number"),
    "endless unit": ({"timestamps_specs__timestamps_unit": np.inf}, "unit = inf: must be above 0"),
    "bins of no width": ({"nanotimes_specs__tcspc_unit": 0.0}, "unit = 0: must be above 0"),
    "two rates": (
        {"measurement_specs__laser_repetition_rate": np.array([1e7, 2e7])},
        r"laser_repetition_rate: holds float64\[2\], must hold one number",
    ),
}


@pytest.mark.parametrize("name", DAMAGED_PHOTONS)
def test_damaged_photon_hdf5(tmp_path, name):
    changed, words = DAMAGED_PHOTONS[name]
    path = photon_hdf5(tmp_path / "a.h5", **(SYNCED | changed))
    with pytest.raises(InputError, match=words):
        read_recording(path)


def test_a_number_of_photon_hdf5_may_be_an_array_of_one(tmp_path):
    unit = {"timestamps_specs__timestamps_unit": np.array([25e-9])}
    found = read_recording(photon_hdf5(tmp_path / "a.h5", **(SYNCED | unit)))
    assert found.period_ps == pytest.approx(25_000)


PLACED = Edges(np.array([1, 0]), np.array([4, 3]), np.array([7, 100]), np.array([62.5, 0.1]))


@pytest.mark.parametrize("offset_ps", [(62.5, 100 / 3), (0.0, 0.0), (0.0, 1.5)], ids=str)
@pytest.mark.parametrize("suffix", [".npz", ".csv", ".h5"])
def test_offsets_come_back(tmp_path, suffix, offset_ps):
    """In the order of their edges, to the last digit, also those at the beginning of a tick."""
    path = tmp_path / f"edges{suffix}"
    offset_ps = np.array(offset_ps)
    write_edges(path, evolve(PLACED, offset_ps=offset_ps), TIMING)
    found, _ = recorded_edges(read_recording(path), CONFIG, TIMING)
    assert found.tick.tolist() == [100, 7] and found.offset_ps.tolist() == [*offset_ps[::-1]]


def test_a_delay_moves_offsets(tmp_path):
    """By a fraction of a tick of 62.5 ps."""
    write_edges(tmp_path / "a.npz", PLACED, TIMING)
    found, _ = recorded_edges(read_recording(tmp_path / "a.npz"), CONFIG, TIMING, delay_ps=10.0)
    assert found.tick.tolist() == [99, 7]
    assert found.offset_ps == pytest.approx([52.6, 52.5])


def test_a_delay_up_to_the_beginning_of_a_tick_leaves_no_negative_offset(tmp_path):
    """Rounding errors of the delay are none of the photon's, which stays in its tick."""
    write_edges(tmp_path / "a.npz", PLACED, TIMING)
    delay_ps = PLACED.offset_ps[1] + 1e-5
    found, _ = recorded_edges(read_recording(tmp_path / "a.npz"), CONFIG, TIMING, delay_ps=delay_ps)
    assert found.tick[0] == 100 and found.offset_ps[0] == 0


def test_edges_are_in_order_of_pulse_tick_and_pixel(tmp_path):
    """Whatever the order of the photons in the file."""
    path = tmp_path / "a.csv"
    edges = [(0, 2, 5), (0, 3, 5), (0, 1, 6), (1, 4, 2), (1, 7, 2), (1, 0, 9)]
    for order in (edges, edges[::-1], edges[1::2] + edges[::2]):
        lines = ("pulse,pixel,tick", *(",".join(map(str, edge)) for edge in order))
        path.write_text("\n".join(lines), encoding="utf-8")
        assert edges_of(path) == (edges, {})


def test_offsets_that_a_file_cannot_hold_are_told(tmp_path):
    write_edges(tmp_path / "a.npz", PLACED, TIMING)
    for name, is_told in (("b.ptu", True), ("b.npz", False)):
        result = command("edges", tmp_path / "a.npz", "--out", tmp_path / name)
        assert result.exit_code == 0, result.output
        assert ("left out: offset_ps" in result.stdout) == is_told


def test_offsets_are_numbers_of_at_least_0(tmp_path):
    (tmp_path / "a.csv").write_text("pulse,pixel,tick,offset_ps\n0,3,5,-1\n", encoding="utf-8")
    with pytest.raises(InputError, match=r"offset_ps\[0\] = -1"):
        read_recording(tmp_path / "a.csv")


@pytest.mark.parametrize("delay_ps", [0.0, 10.0, -30.0])
def test_offsets_of_whole_picoseconds_are_numbers_as_all_others(tmp_path, delay_ps):
    """A table may have integers there; a delay may be negative."""
    lines = "pulse,pixel,tick,offset_ps\n0,3,100,5\n1,4,7,62\n"
    (tmp_path / "whole.csv").write_text(lines, encoding="utf-8")
    (tmp_path / "real.csv").write_text(lines.replace("62", "62.0"), encoding="utf-8")
    whole, real = (
        recorded_edges(read_recording(tmp_path / name), CONFIG, TIMING, delay_ps=delay_ps)[0]
        for name in ("whole.csv", "real.csv")
    )
    assert whole.offset_ps.dtype == np.float64
    assert whole.offset_ps.tolist() == real.offset_ps.tolist()
    at_ps = whole.tick * 62.5 + whole.offset_ps
    assert at_ps == pytest.approx(np.array([100, 7]) * 62.5 + [5, 62] - delay_ps)


def test_triggers_that_come_twice_are_one_pulse():
    triggers = np.repeat(np.arange(4) * 500_000, 2)
    found = since_sync(np.array([1000, 501_000]), np.zeros(2), triggers, 1.0, "times")
    assert found.period_ps == 500_000 and found.sync.tolist() == [0, 1]


@pytest.mark.parametrize("divider", [-1, (1 << 16) + 1])
def test_a_divider_of_the_header_out_of_range(tmp_path, divider):
    path = ptu(tmp_path / "a.ptu", [t2(1, 0, 5), t2(0, 3, 9)], HWSync_Divider=divider)
    with pytest.raises(InputError, match=f"HWSync_Divider = {divider}: must be from 0 to 65536"):
        read_recording(path)


def test_a_divider_of_0_in_the_header_is_none(tmp_path):
    path = ptu(tmp_path / "a.ptu", [t2(1, 0, 5), t2(0, 3, 9)], HWSync_Divider=0)
    assert read_recording(path).divider == 1


@pytest.mark.parametrize(
    "head",
    [
        "Sync,Channel,Time_ps",
        "SYNC,CHANNEL,TIME_PS",
        '"sync","channel","time_ps"',
        " sync , channel , time_ps ",
        "# Sync,Channel,Time_ps",
        "# Sync,Channel,Time_ps\n",
        "\n# of a laboratory\n\n# Sync,Channel,Time_ps\n\n",
        "\ufeffSync,Channel,Time_ps",
        "\ufeff# Sync,Channel,Time_ps",
    ],
)
@pytest.mark.parametrize("numbers", ["3,3,250031.25", '"3","3","250031.25"'])
@pytest.mark.parametrize("separator", [",", ";", "\t"])
def test_names_of_columns_as_programs_write_them(tmp_path, head, separator, numbers):
    """In capitals, in quotes, with spaces, as the last comment, behind the mark of a byte order, before
    empty lines; with numbers in quotes.
    """
    path = tmp_path / "a.csv"
    lines = [head, numbers]
    path.write_text("\n".join(lines).replace(",", separator) + "\n", encoding="utf-8")
    assert edges_of(path) == ([(3, 3, 4000)], {})
