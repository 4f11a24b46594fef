# SPDX-License-Identifier: Apache-2.0
"""Written files: numbers that can be read again, and the permissions that the user asks for."""

import csv
import os
import stat

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from coincid.model.shared import spool
from coincid.model.shared.errors import InputError
from coincid.model.shared.files import GrowingNpz, read_npz, whole_file, write_csv, write_npz


def test_a_table_has_six_digits_of_small_and_large_numbers(tmp_path):
    numbers = [1.23456789e-9, -0.000123456789, 12.3456789, 9.87654321e12]
    write_csv(tmp_path / "table.csv", [["a", 1, True], numbers])
    with (tmp_path / "table.csv").open(encoding="utf-8", newline="") as file:
        names, values = csv.reader(file)
    assert names == ["a", "1", "True"]
    assert [float(value) for value in values] == pytest.approx(numbers, rel=5e-6)
    assert max(len(value.strip("-0.").partition("e")[0]) for value in values) <= 7


@pytest.mark.parametrize(("umask", "mode"), [(0o022, 0o644), (0o077, 0o600), (0o002, 0o664)])
def test_a_file_has_the_permissions_of_the_users_mask(tmp_path, umask, mode):
    before = os.umask(umask)
    try:
        with whole_file(tmp_path / "a", "w") as file:
            file.write("a")
        assert os.umask(umask) == umask
    finally:
        os.umask(before)
    assert stat.S_IMODE((tmp_path / "a").stat().st_mode) == mode


@pytest.mark.parametrize("end", [KeyboardInterrupt, ValueError, SystemExit])
def test_nothing_is_left_beside_a_file_whose_writing_ends_early(tmp_path, end):
    (tmp_path / "a").write_text("before", encoding="utf-8")
    with pytest.raises(end), whole_file(tmp_path / "a", "w") as file:
        file.write("half")
        raise end
    assert [path.name for path in tmp_path.iterdir()] == ["a"]
    assert (tmp_path / "a").read_text(encoding="utf-8") == "before"


ROWS = hnp.arrays(
    st.sampled_from([np.int64, np.uint64, np.uint16, np.uint8, bool]),
    hnp.array_shapes(min_dims=1, max_dims=3, min_side=0, max_side=7),
)


@given(rows=ROWS, cuts=st.sets(st.integers(0, 7)), piece_rows=st.integers(1, 9))
def test_an_npz_that_grows_has_the_bytes_of_one_written_at_once(
    rows, cuts, piece_rows, tmp_path_factory
):
    folder = tmp_path_factory.mktemp("npz")
    other = {"other": np.arange(3)}
    write_npz(folder / "whole.npz", {"rows": rows, "twice": rows, **other})
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(spool, "PIECE_ROWS", piece_rows)
        growing = GrowingNpz()
        for part in np.split(rows, sorted(cut for cut in cuts if cut <= len(rows))):
            growing.append({"rows": part, "twice": part})
        growing.write(folder / "grown.npz", other)
    assert (folder / "grown.npz").read_bytes() == (folder / "whole.npz").read_bytes()


def test_folders_of_a_file_are_made(tmp_path):
    with whole_file(tmp_path / "a" / "b" / "c", "w") as file:
        file.write("c")
    assert (tmp_path / "a" / "b" / "c").read_text(encoding="utf-8") == "c"


def test_an_npz_is_read_as_it_was_written(tmp_path):
    path = tmp_path / "a.npz"
    write_npz(path, {"rows": np.arange(6).reshape(2, 3), "more": np.array([True]), "other": 1.5})
    arrays = read_npz(path, ("rows",), ("more", "absent"))
    assert arrays.keys() == {"rows", "more"}
    assert arrays["rows"].tolist() == [[0, 1, 2], [3, 4, 5]]
    assert arrays["more"].tolist() == [True]
    with pytest.raises(InputError, match="has no array 'absent', must have rows, absent"):
        read_npz(path, ("rows", "absent"))


def test_what_is_no_npz_is_told(tmp_path):
    (tmp_path / "text").write_text("rows", encoding="utf-8")
    with pytest.raises(InputError, match="is not an NPZ file, must hold the arrays rows, more"):
        read_npz(tmp_path / "text", ("rows", "more"))
    np.save(tmp_path / "single.npy", np.arange(3))
    with pytest.raises(InputError, match="is a single array, must be an NPZ file"):
        read_npz(tmp_path / "single.npy", ("rows",))
    write_npz(tmp_path / "whole.npz", {"rows": np.arange(1000)})
    whole = (tmp_path / "whole.npz").read_bytes()
    (tmp_path / "half.npz").write_bytes(whole[: len(whole) // 2])
    with pytest.raises(InputError, match="half.npz"):
        read_npz(tmp_path / "half.npz", ("rows",))
    with pytest.raises(InputError, match="missing.npz"):
        read_npz(tmp_path / "missing.npz", ("rows",))
