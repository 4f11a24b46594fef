# SPDX-License-Identifier: Apache-2.0
"""A prefix for the names of an export, so that several sensors fit on one chip.

Two sensors use the same names for different modules. With a prefix, every name of an export that
others can see begins with it: files, modules, macros, C symbols, FuseSoC's core, the names in VLNV
and SystemRDL. Ports, registers and targets keep their names, because they belong to one module or
core.
"""

import re
from pathlib import PurePosixPath

from ..model.shared.errors import InputError

LONGEST = 40  # characters; simulators limit the length of a name
FORM = re.compile(rf"([A-Za-z][A-Za-z0-9_]{{0,{LONGEST - 1}}})?")
# All modules, C symbols and macros of an export begin like this.
# Verilator's programs have a V in front of the module, and patterns of file names have a star behind.
SYMBOL = re.compile(r"(?:(?<!\w)|(?<=/V))coincid_(?=[\w*])")
MACRO = re.compile(r"(?<!\w)COINCID_(?=\w)")
ADDRESS_MAP = re.compile(r"(?<=\baddrmap )coincid(?= \{)")
VERILOG = (".v", ".vh")
# Names of files in texts that are not those of a text of the export.
OTHER_FILES = ("registers.*", "manifest.json")


def checked_prefix(prefix: str) -> str:
    """Return a prefix. Raises `InputError` if it cannot begin a name of Verilog and C."""
    if FORM.fullmatch(prefix):
        return prefix
    raise InputError(
        f"prefix {prefix!r}: must be letters, digits and underscores, begin with a letter, and have"
        f" at most {LONGEST} characters"
    )


def prefixed_name(name: str, prefix: str) -> str:
    """Return the name of a file, which may be in a folder, with a prefix."""
    path = PurePosixPath(name)
    return str(path.with_name(f"{prefix}{path.name}"))


def prefixed_files(files: dict[str, str], prefix: str) -> dict[str, str]:
    """Return the files of an export with the prefix in their names and texts.

    files: name -> text.
    """
    if not prefix:
        return files
    others = [PurePosixPath(name).name for name in files if not SYMBOL.search(name)]
    mentioned = "|".join(re.escape(name) for name in (*others, *OTHER_FILES))
    file_name = re.compile(rf"(?<![\w.])({mentioned})(?!\w)")

    def renamed(name: str, text: str) -> str:
        text = SYMBOL.sub(f"{prefix}coincid_", text)
        text = MACRO.sub(f"{prefix.upper()}COINCID_", text)
        text = ADDRESS_MAP.sub(f"{prefix}coincid", text)
        if not name.endswith(VERILOG):
            text = file_name.sub(rf"{prefix}\1", text)
        return text

    return {prefixed_name(name, prefix): renamed(name, text) for name, text in files.items()}
