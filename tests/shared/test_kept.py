# SPDX-License-Identifier: Apache-2.0
"""What is kept for later: digests of sources, arrays in a temporary file, and the latest result."""

import weakref

import numpy as np
import pytest

from coincid.model.shared.latest import Latest
from coincid.model.shared.sources import digest, packages_digest, room_files, sources_digest
from coincid.model.shared.spool import PIECE_ROWS, Spool


@pytest.fixture
def digest_of(tmp_path, monkeypatch):
    """Return a function that returns the digest of a new package with some files."""
    monkeypatch.syspath_prepend(str(tmp_path))

    def of(name, **files):
        folder = tmp_path / name
        for path, text in ({"__init__.py": ""} | files).items():
            (folder / path).parent.mkdir(parents=True, exist_ok=True)
            (folder / path).write_text(text, encoding="utf-8")
        return packages_digest(name)

    return of


def test_a_digest_depends_on_names_and_contents_of_all_files(digest_of):
    files = {"kernel.py": "A = 1\n", "data/table.txt": "2\n"}
    first = digest_of("kept_as_it_is", **files)
    assert digest_of("kept_elsewhere", **files) == first
    others = [
        digest_of("kept_changed", **files | {"kernel.py": "A = 2\n"}),
        digest_of("kept_with_other_data", **files | {"data/table.txt": "3\n"}),
        digest_of("kept_renamed", **{"kernels.py": "A = 1\n", "data/table.txt": "2\n"}),
        digest_of("kept_with_more", **files, **{"data/more.txt": ""}),
    ]
    assert len({first, *others}) == 5


def test_code_that_python_keeps_changes_no_digest(digest_of):
    files = {"kernel.py": "A = 1\n"}
    compiled = {"__pycache__/kernel.pyc": "x", "__pycache__/kernel.pyc.1234": "half"}
    assert digest_of("kept_alone", **files) == digest_of("kept_compiled", **files, **compiled)


def test_a_digest_knows_the_borders_and_the_order_of_its_parts():
    assert digest("ab", "c") == digest(b"ab", b"c")
    assert len({digest("ab", "c"), digest("a", "bc"), digest("c", "ab"), digest("abc")}) == 4


def test_every_room_changes_the_digest_of_rooms():
    alone = sources_digest("model.shared"), sources_digest("model.golden")
    both = sources_digest("model.shared", "model.golden")
    assert len({*alone, both}) == 3
    assert set(room_files("model.shared")) < set(room_files("model.shared", "model.golden"))


@pytest.mark.parametrize("shape", [(), (3,), (2, 2)])
def test_arrays_of_a_spool_come_back_joined_and_in_pieces(shape):
    rng = np.random.default_rng(1)
    lengths = 5, 0, PIECE_ROWS + 3
    arrays = [rng.integers(0, 1000, (rows, *shape)).astype(np.int32) for rows in lengths]
    spool = Spool()
    blocks = [spool.put(array) for array in arrays]
    np.testing.assert_array_equal(spool.joined(blocks), np.concatenate(arrays))
    np.testing.assert_array_equal(spool.joined(blocks[:1]), arrays[0])
    for array, block in zip(arrays, blocks, strict=True):
        pieces = list(spool.pieces(block))
        assert all(0 < len(piece) <= PIECE_ROWS for piece in pieces)
        np.testing.assert_array_equal(np.concatenate([array[:0], *pieces]), array)


def test_arrays_of_other_orders_and_types_come_back_from_a_spool():
    columns = np.arange(12.0).reshape(3, 4)
    spool = Spool()
    blocks = [spool.put(columns.T), spool.put(columns[:, ::2] > 3)]
    for array, block in zip((columns.T, columns[:, ::2] > 3), blocks, strict=True):
        found = spool.joined([block])
        assert found.dtype == array.dtype
        np.testing.assert_array_equal(found, array)


def test_a_spool_takes_arrays_between_reads():
    """Also between the pieces of an array: what was read last does not matter."""
    first, second, third = (np.arange(k, k + PIECE_ROWS + 2) for k in (0, 10, 20))
    spool = Spool()
    blocks = [spool.put(first), spool.put(second)]
    np.testing.assert_array_equal(spool.joined(blocks[:1]), first)
    found = []
    for piece in spool.pieces(blocks[0]):
        found.append(piece)
        blocks.append(spool.put(third))
    np.testing.assert_array_equal(np.concatenate(found), first)
    arrays = [first, second, third, third]
    np.testing.assert_array_equal(spool.joined(blocks), np.concatenate(arrays))


def test_the_latest_result_is_made_once_for_each_key_in_a_row():
    made = []

    def making(value):
        return lambda: made.append(value) or value

    latest = Latest()
    assert [latest.get("a", making(0)), latest.get("a", making(1))] == [0, 0]
    assert latest.get("b", making(2)) == 2
    assert latest.get("a", making(3)) == 3
    latest.forget()
    assert latest.get("a", making(4)) == 4
    assert made == [0, 2, 3, 4]


def test_the_latest_result_is_gone_before_another_is_made():
    """Two of them do not fit into memory."""

    class Result:
        pass

    latest = Latest()
    first = weakref.ref(latest.get("a", Result))
    assert first() is latest.get("a", Result)
    there = []
    latest.get("b", lambda: there.append(first()) or Result())
    assert there == [None]
    second = weakref.ref(latest.get("b", Result))
    latest.forget()
    assert second() is None
