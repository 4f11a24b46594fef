# SPDX-License-Identifier: Apache-2.0
"""Written files: numbers that can be read again, and the permissions that the user asks for."""

import ast
import csv
import errno
import os
import re
import stat
import zipfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from coincid.model.shared import spool
from coincid.model.shared.errors import InputError
from coincid.model.shared.files import (
    SAID_MAX,
    GrowingNpz,
    read_npz,
    reading,
    whole_file,
    write_csv,
    write_npz,
)


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


def test_a_suffix_may_have_any_case(tmp_path):
    """Another suffix is refused by both ways of writing, before anything is written."""
    rows = {"rows": np.arange(3)}
    growing = GrowingNpz()
    growing.append(rows)
    for name in ("a.npz", "b.NPZ", "c.Npz"):
        write_npz(tmp_path / name, rows)
        growing.write(tmp_path / f"grown-{name}", {})
        for found in (name, f"grown-{name}"):
            assert read_npz(tmp_path / found, ("rows",))["rows"].tolist() == [0, 1, 2]
    before = sorted(tmp_path.iterdir())
    for name in ("a.npy", "npz", "a.npz.gz", "a"):
        for write in (write_npz, growing.write):
            with pytest.raises(InputError, match=f"{name}: must end with .npz") as raised:
                write(tmp_path / name, {})
            assert raised.value.field == "path"
    assert sorted(tmp_path.iterdir()) == before


def test_a_full_disk_is_told_with_the_name_of_the_file(tmp_path):
    """Not with that of the file beside it, of which nothing is left."""
    path = tmp_path / "a"
    path.write_text("before", encoding="utf-8")
    with (
        pytest.raises(
            InputError,
            match=rf"^{re.escape(str(path))}: cannot be written: No space left on device$",
        ),
        whole_file(path, "w") as file,
    ):
        file.write("half")
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    assert [one.name for one in tmp_path.iterdir()] == ["a"]
    assert path.read_text(encoding="utf-8") == "before"


@pytest.mark.parametrize(
    ("name", "told"),
    [
        ("file/a", "cannot be written: (Not a directory|File exists)"),
        ("folder", "cannot be written: is a folder, must be a file"),
        ("/dev/null", "cannot be written: is a device or a pipe, must be a file"),
    ],
)
def test_a_place_where_no_file_can_be_is_told(name, told, tmp_path):
    (tmp_path / "file").touch()
    (tmp_path / "folder").mkdir()
    with (
        pytest.raises(InputError, match=f"^{re.escape(str(tmp_path / name))}: {told}$"),
        whole_file(tmp_path / name),
    ):
        raise AssertionError("the block is not entered")
    assert sorted(one.name for one in tmp_path.rglob("*")) == ["file", "folder"]


def test_a_whole_file_takes_the_place_of_another_at_its_end(tmp_path):
    """Until then, readers see the old one; a file of bytes is the default."""
    path = tmp_path / "a"
    path.write_bytes(b"before")
    with whole_file(path) as file:
        file.write(b"\xff new")
        file.flush()
        assert path.read_bytes() == b"before"
    assert path.read_bytes() == b"\xff new"
    with whole_file(str(path), "w") as file:
        file.write("\N{MICRO SIGN}\n")
    assert path.read_bytes() == "\N{MICRO SIGN}\n".encode()


def test_a_link_stays_and_what_it_leads_to_is_written(tmp_path):
    """Also if there is nothing yet, or only the link's folder exists."""
    (tmp_path / "runs").mkdir()
    link = tmp_path / "newest.txt"
    link.symlink_to(Path("runs") / "one.txt")
    for text in ("first", "second"):
        with whole_file(link, "w") as file:
            file.write(text)
        assert link.is_symlink()
        assert (tmp_path / "runs" / "one.txt").read_text(encoding="utf-8") == text
    assert len([*tmp_path.rglob("*")]) == 3


def test_a_table_has_a_comma_between_two_values_and_a_line_for_each_row(tmp_path):
    """With quotes only where a text needs them."""
    write_csv(tmp_path / "a.csv", iter([("a", "b,c"), (1, 2.5), (np.float64(1 / 3), None)]))
    assert (tmp_path / "a.csv").read_bytes() == b'a,"b,c"\n1,2.5\n0.333333,None\n'


def test_members_of_an_archive_that_are_no_arrays_are_named(tmp_path):
    with zipfile.ZipFile(tmp_path / "a.npz", "w") as archive:
        archive.writestr("rows", b"text")
    with pytest.raises(InputError, match=r"a\.npz: rows is no array$"):
        read_npz(tmp_path / "a.npz", ("rows",))
    np.savez(tmp_path / "b.npz", rows=np.array([{}], object), more=np.arange(2))
    with pytest.raises(InputError, match=r"b\.npz: is not a readable NPZ file \(.*pickle"):
        read_npz(tmp_path / "b.npz", ("rows",))
    # what nobody asks for is not read
    assert read_npz(tmp_path / "b.npz", ("more",))["more"].tolist() == [0, 1]


def test_what_a_library_says_of_a_file_is_one_short_line():
    """A sentence of our own is told as it is."""
    with pytest.raises(InputError) as raised, reading("a.x", "X file"):
        raise RuntimeError("wrong\nbyte " + "ab " * SAID_MAX)
    told = str(raised.value)
    assert told.startswith("a.x: is not a readable X file (wrong byte ab ab")
    assert told.endswith(" ...)")
    assert len(told) <= len("a.x: is not a readable X file ()") + SAID_MAX
    with pytest.raises(InputError, match="^a.x: no such file$"), reading("a.x", "X file"):
        raise FileNotFoundError("another one")
    own = InputError("mine", field="x")
    with pytest.raises(InputError) as raised, reading("a.x", "X file"):
        raise own
    assert raised.value is own
    for passed in (KeyboardInterrupt, SystemExit):
        with pytest.raises(passed), reading("a.x", "X file"):
            raise passed


ROOT = Path(__file__).parents[2]
# Rooms whose files are a user's; those of the others are in folders of their own.
OF_USERS = ("model", "lab", "study", "host", "board", "src/coincid/cli.py")
WRITERS = {"write_text", "write_bytes"}
# with the reason
NOT_WHOLE = {
    "model/shared/files.py": "members of an archive, which is whole",
    "study/explore/uploads.py": "in a temporary folder",
}


def begins_to_write(call):
    """Return whether a call opens a file for writing, or writes one, where it will be read."""
    function = call.func
    if isinstance(function, ast.Attribute) and function.attr in WRITERS:
        return True
    name = function.id if isinstance(function, ast.Name) else getattr(function, "attr", "")
    given = [*call.args, *(word.value for word in call.keywords if word.arg == "mode")]
    modes = [one.value for one in given if isinstance(one, ast.Constant)]
    return name == "open" and any(re.fullmatch("[wax+][bt+]*", str(mode)) for mode in modes)


def test_every_file_of_a_user_is_written_beside_and_then_renamed():
    """So it appears whole or not at all, and an earlier one stays after an interrupt."""
    found = {}
    for room in OF_USERS:
        for path in [ROOT / room] if room.endswith(".py") else sorted((ROOT / room).rglob("*.py")):
            for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
                if isinstance(node, ast.Call) and begins_to_write(node):
                    found.setdefault(str(path.relative_to(ROOT)), []).append(ast.unparse(node))
    assert {name: calls for name, calls in found.items() if name not in NOT_WHOLE} == {}
    assert set(NOT_WHOLE) <= set(found)
