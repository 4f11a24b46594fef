# SPDX-License-Identifier: Apache-2.0
"""Names of the generator become plain ones, each thing with its own."""

import pytest

from coincid.flow.plain_names import plain_verilog

# Verilog with names of the generator, and with plain ones.
PLAIN_NAMES = [
    (r"wire \$1 ;", "wire net_1;"),
    (r"assign \a.b  = a_b & \a[b] ;", "assign a_b_ = a_b & a_b__;"),
    (r"input \end ; reg \m.end ;", r"input \end ; reg m_end;"),
    (r"reg \end ; reg \end$ ; reg \$end ;", r"reg \end ; reg end_; reg net_end;"),
    (r"reg \end$ ; reg \end ; reg \end. ;", r"reg end_; reg \end ; reg end__;"),
    (r"reg a_b_; reg \a.b ; reg a_b;", "reg a_b_; reg a_b__; reg a_b;"),
    ("  (* init = 4'h0 *)\n  wire a;", "  wire a;"),
]


@pytest.mark.parametrize(("text", "plain"), PLAIN_NAMES)
def test_plain_names_are_of_one_thing_each(text, plain):
    assert plain_verilog({"a.v": text}) == {"a.v": plain}


def test_each_file_has_names_of_its_own():
    """A name that is taken in one file is free in another."""
    files = {"a.v": r"reg a_b; reg \a.b ;", "b.v": r"reg \a.b ;"}
    assert plain_verilog(files) == {"a.v": "reg a_b; reg a_b_;", "b.v": "reg a_b;"}
