# SPDX-License-Identifier: Apache-2.0
"""Written files: numbers that can be read again, and the permissions that the user asks for."""

import csv
import os
import stat

import pytest

from coincid.model.shared.files import whole_file, write_csv


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
