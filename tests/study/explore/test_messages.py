# SPDX-License-Identifier: Apache-2.0
"""The messages between page and server: page.js and page.html read and write the fields that
messages.py describes.
"""

import inspect
import re
from pathlib import Path

import attrs
import pytest

from coincid.study.explore import messages
from coincid.study.explore.messages import MESSAGES, ORDERS, LookedAt, Words
from coincid.study.explore.tab import Link
from coincid.study.explore.uploads import BYTES_MAX

ROOM = Path(inspect.getfile(messages)).parent
SCRIPT = (ROOM / "page.js").read_text(encoding="utf-8")
TEMPLATE = (ROOM / "page.html").read_text(encoding="utf-8")
SENT_BY_THE_PAGE = {"question", "order"}
READ = re.compile(r"const \{([\w, ]+)\} = link\.(\w+);")
SENT = re.compile(r"link\.(\w+) = \{([^}]*)\}")
ORDERED = re.compile(r'order\("(\w+)"(?:, \{([^}]*)\})?\)')


def fields(message: type) -> set[str]:
    return {field.name for field in attrs.fields(message)}


def keys(text: str) -> set[str]:
    """Return the keys of the text of an object in JavaScript; a shorthand is its key."""
    return {part.partition(":")[0].strip() for part in text.split(",") if part.strip()}


def test_page_and_server_share_the_messages():
    assert set(Link.properties()) - set(Link.__base__.properties()) == set(MESSAGES)
    assert set(re.findall(r"\blink\.(\w+)", SCRIPT)) - {"properties"} == set(MESSAGES)


def test_the_page_reads_every_field_of_what_the_server_sends():
    read = {name: keys(of) for of, name in READ.findall(SCRIPT)}
    # these fields only make the same message a change
    told_apart_by_bokeh = {"download": {"number"}}
    expected = {
        name: fields(of) - told_apart_by_bokeh.get(name, set()) for name, of in MESSAGES.items()
    }
    assert read == {name: of for name, of in expected.items() if name not in SENT_BY_THE_PAGE}
    assert len(READ.findall(SCRIPT)) == len(read)
    # Every other message is heard: a change of its property calls a function.
    assert set(re.findall(r'\bon\("(\w+)",', SCRIPT)) == set(read) - {"opened"}


def test_the_page_sends_every_field_that_the_server_reads():
    sent = {name: keys(of) for name, of in SENT.findall(SCRIPT)}
    assert sent == {name: fields(MESSAGES[name]) for name in SENT_BY_THE_PAGE}


def test_the_page_shows_every_word():
    assert set(re.findall(r"\bwords\.(\w+)", SCRIPT)) == fields(Words)


def test_the_page_has_a_field_for_everything_that_is_looked_at():
    assert set(re.findall(r'data-look="(\w+)"', TEMPLATE)) == fields(LookedAt)


def test_the_page_orders_what_the_server_does():
    ordered = {name: keys(of) for name, of in ORDERED.findall(SCRIPT)}
    # the page itself resets, and orders `forget`
    buttons = set(re.findall(r'data-do="(\w+)"', TEMPLATE)) - {"reset"}
    assert ordered | {name: set() for name in buttons} == {
        name: fields(of) for name, of in ORDERS.items()
    }
    assert set(re.findall(r'data-play="(\w+)"', TEMPLATE)) == {"pulse", "frame"}


@pytest.mark.parametrize("classes", [MESSAGES, ORDERS])
def test_every_field_has_its_comment(classes):
    described = [*classes.values(), *([Words, LookedAt] if classes is MESSAGES else [])]
    for of in described:
        assert of.__doc__
        lines = inspect.getsource(of).splitlines()
        for name in fields(of):
            line = next(line for line in lines if line.startswith(f"    {name}: "))
            assert "  # " in line


def test_the_page_sends_files_up_to_the_size_that_the_server_takes():
    (bytes_max,) = re.findall(r"\bUPLOAD_BYTES_MAX = (\d+) << (\d+)", SCRIPT)
    assert int(bytes_max[0]) << int(bytes_max[1]) == BYTES_MAX


def test_an_order_comes_as_its_class():
    order = messages.order_of(
        {"number": 3, "name": "look", "fields": {"name": "row", "value": "7"}}
    )
    assert order == messages.Look(name="row", value="7")
    with pytest.raises(TypeError, match="valu"):
        messages.order_of({"number": 3, "name": "look", "fields": {"name": "row", "valu": "7"}})
