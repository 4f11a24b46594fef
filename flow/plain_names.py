# SPDX-License-Identifier: Apache-2.0
"""Plain names in exported Verilog: letters, digits and underscores.

The generator's own names contain `$`, dots and brackets. Verilog allows them, but waveform viewers
take a dot for a hierarchy and brackets for a bit of a bus. Names that are keywords of Verilog stay
escaped.
"""

import re
from collections.abc import Mapping

ESCAPED = re.compile(r"\\(\S+) ")
PLAIN = re.compile(r"(?<![\w$\\])[A-Za-z_]\w*")
INTERNAL = "net_"  # how names without a meaning begin
# The initial value of a wire is that of a register in another module.
WIRE_INIT = re.compile(r"^ *\(\* init = \S+ \*\)\n", re.MULTILINE)


def plain_verilog(files: Mapping[str, str]) -> dict[str, str]:
    """Return Verilog files with plain names, and without initial values of wires.

    files: name -> text. A name with a meaning beyond its file must be plain already.
    """
    return {name: _with_plain_names(WIRE_INIT.sub("", text)) for name, text in files.items()}


def _with_plain_names(text: str) -> str:
    escaped = dict.fromkeys(ESCAPED.findall(text))
    stays_escaped = {name for name in escaped if name.isidentifier()}
    taken = set(PLAIN.findall(text)) | stays_escaped
    plain: dict[str, str] = {}
    for name in escaped:
        if name not in stays_escaped:
            plain[name] = _free(_plain(name), taken)
            taken.add(plain[name])

    def replaced(found: re.Match[str]) -> str:
        return plain[found[1]] if found[1] in plain else found[0]

    return ESCAPED.sub(replaced, text)


def _plain(name: str) -> str:
    """Return a name with an underscore in place of every other character."""
    words = re.sub(r"\W+", "_", name).strip("_")
    return words if re.match(r"[A-Za-z]", name) else f"{INTERNAL}{words}"


def _free(name: str, taken: set[str]) -> str:
    """Return a name, with underscores behind it if it is taken."""
    while name in taken:
        name += "_"
    return name
