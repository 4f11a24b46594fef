# SPDX-License-Identifier: Apache-2.0
"""Compiled slices: the C++ of a design, with a program around it, as a library that is built
once.
"""

import os
import subprocess
from collections.abc import Sequence
from functools import cache
from pathlib import Path

from ..model.shared.folders import build_root
from ..model.shared.sources import digest
from ..tools.build import Compile, compile_once, require_programs
from .synthesis import SOURCE, Design

HERE = Path(__file__).parent
PLAIN = HERE / "plain.cpp"
LIBRARY, OBJECT = "libslice.so", "slice.o"
LANES = (64, 128, 256, 512)  # bits of a word
COMPILER = ("-std=gnu++20", "-fPIC", "-Wno-psabi")
# of a pass, which is straight code: a higher level takes longer to compile and gains nothing
OPTIMISE = "-O1"
PROCESSOR = "-march=native"


@cache
def processor(flag: str = PROCESSOR) -> str:
    """Return a key for the kind of processor: code for one kind may have instructions that
    another lacks.
    """
    require_programs({"g++": "g++"})
    return digest(
        subprocess.run(["g++", flag, "-Q", "--help=target"], capture_output=True, check=True).stdout
    )


@cache
def widest(flag: str = PROCESSOR) -> int:
    """Return the bits of the longest word that this processor handles at once, or 128."""
    command = ["g++", flag, "-dM", "-E", "-x", "c++", os.devnull]
    macros = subprocess.run(
        command, capture_output=True, text=True, check=True, encoding="utf-8"
    ).stdout
    return 512 if "__AVX512VL__" in macros else 256 if "__AVX2__" in macros else 128


def compiled(design: Design, lanes: int, flag: str = PROCESSOR) -> Path:
    """Return the object of a design's pass for words of so many bits, compiled once for this
    kind of processor.
    """
    directory = design.folder.with_name(f"{design.folder.name}-{lanes}-{processor(flag)}")

    def make(_: Path, run: Compile) -> None:
        include = [f"-I{design.folder}", f"-I{HERE}"]
        command = ["g++", *COMPILER, flag, OPTIMISE, f"-DLANES={lanes}", *include]
        run([*command, "-c", str(design.folder / SOURCE), "-o", OBJECT])

    return compile_once(directory, make) / OBJECT


def library(
    design: Design,
    lanes: int,
    program: Path = PLAIN,
    header: str = "",
    include: Sequence[Path] = (),
    objects: Sequence[Path] = (),
    flag: str = PROCESSOR,
) -> Path:
    """Return the library of a design with the C++ `program` that plays it, compiled once.

    header: text of its "wiring.h". include: further folders of headers. objects: further objects
    and archives.
    """
    slice_object = compiled(design, lanes, flag)
    contents = (
        path.read_text(encoding="utf-8") for path in (program, HERE / "lanes.h", HERE / "word.h")
    )
    key = digest(*COMPILER, str(slice_object), *contents, header, *map(str, (*include, *objects)))
    directory = build_root() / "slices" / f"{program.stem}-{key}"

    def make(scratch: Path, run: Compile) -> None:
        (scratch / "wiring.h").write_text(header, encoding="utf-8")
        folders = [f"-I{folder}" for folder in (".", design.folder, HERE, *include)]
        command = [
            "g++",
            "-shared",
            *COMPILER,
            flag,
            "-O2",
            f"-DLANES={lanes}",
            *folders,
            "-o",
            LIBRARY,
            str(program),
        ]
        run([*command, str(slice_object), *map(str, objects)])

    return compile_once(directory, make) / LIBRARY
