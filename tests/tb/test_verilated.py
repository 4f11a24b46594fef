# SPDX-License-Identifier: Apache-2.0
"""Units as object files: what is compiled how, what stays, and a failure in either half."""

from pathlib import Path

import pytest

from coincid.tb import verilated
from coincid.tools.build import ToolchainError, build_once

GENERATED = {
    "top.h": "",
    "top.mk": "",
    "top.cpp": "",
    "top_unit.cpp": "",
    "top__Slow.cpp": "",
    "top_unit__Slow.cpp": "",
}


@pytest.fixture
def compiled(tmp_path, monkeypatch):
    """Verilate a unit with made-up programs; return its folder, and what each compiler was given.

    failing: the file that does not compile.
    """

    def make_unit(failing="", **options):
        source = tmp_path / "top.v"
        source.write_text("module top;", encoding="utf-8")
        given = {}

        def run(scratch, command):
            if command[0] == "verilator":
                assert (scratch / "top.v").read_text(encoding="utf-8") == "module top;"
                for name, text in GENERATED.items():
                    (scratch / name).write_text(text, encoding="utf-8")
                return
            file, made = command[command.index("-c") + 1], command[command.index("-o") + 1]
            if file == failing:
                raise ToolchainError(f"{file} does not compile")
            included = (scratch / file).read_text(encoding="utf-8").splitlines()
            given[made] = [option for option in command if option.startswith("-O")], included
            (scratch / made).touch()

        def made_once(directory, make):
            folder = tmp_path / directory.name
            return build_once(folder, lambda scratch: make(scratch, lambda c: run(scratch, c)))

        monkeypatch.setattr(verilated.toolchain, "verilator", lambda: "verilator")
        monkeypatch.setattr(verilated, "include", list)
        monkeypatch.setattr(verilated, "compile_once", made_once)
        return verilated.verilated_unit("top", "Top", [source], **options), given

    return make_unit


def test_headers_are_those_of_the_verilator_that_made_a_unit(monkeypatch):
    monkeypatch.setattr(verilated.toolchain, "verilator", lambda: Path("root/bin/verilator"))
    assert verilated.include() == ["-Iroot/include", "-Iroot/include/vltstd"]


def test_a_unit_is_its_headers_and_an_object_file_of_each_half(compiled):
    """What only the first evaluation needs is compiled fast, everything else runs fast."""
    folder, given = compiled(optimise="-O3")
    assert given == {
        "fast.o": (["-O3"], ['#include "top.cpp"', '#include "top_unit.cpp"']),
        "slow.o": (["-O0"], ['#include "top__Slow.cpp"', '#include "top_unit__Slow.cpp"']),
    }
    assert {path.name for path in folder.iterdir()} == {"top.h", "fast.o", "slow.o"}
    objects = verilated.objects_in(folder)
    assert [path.name for path in objects] == ["fast.o", "slow.o"]


@pytest.mark.parametrize("failing", ["fast.cpp", "slow.cpp"])
def test_a_unit_of_which_one_half_does_not_compile_is_no_unit(compiled, failing, tmp_path):
    with pytest.raises(ToolchainError, match=f"{failing} does not compile"):
        compiled(failing)
    assert not [path for path in tmp_path.iterdir() if path.is_dir()]
    folder, _ = compiled()
    assert {path.name for path in verilated.objects_in(folder)} == {"fast.o", "slow.o"}


def test_a_unit_is_compiled_anew_for_another_optimisation(compiled):
    assert compiled(optimise="-O1")[0] != compiled(optimise="-O2")[0]
