# SPDX-License-Identifier: Apache-2.0
"""Tables and paragraphs of generated pages."""

from coincid.model.shared.markdown import COLUMNS, paragraph, table, text_table

ROWS = [["a", 1, 2.5], ["b", 20, None]]


def test_numbers_stand_on_the_right_and_texts_on_the_left():
    """By default, the first column is the text."""
    lines = table(["name", "events", "share"], ROWS)
    assert lines == [
        "| name | events | share |",
        "| --- | ---: | ---: |",
        "| a | 1 | 2.5 |",
        "| b | 20 | None |",
    ]
    assert table(["name", "events", "share"], ROWS, left=(1, 2))[1] == "| ---: | --- | --- |"
    assert table(["name", "events", "share"], iter(ROWS), left=())[1:3] == [
        "| ---: | ---: | ---: |",
        "| a | 1 | 2.5 |",
    ]


def test_a_table_as_text_is_its_lines():
    for left in ((0,), (0, 2), ()):
        assert text_table("abc", ROWS, left) == "\n".join(table("abc", ROWS, left))


def test_a_paragraph_is_as_wide_as_a_page_and_breaks_no_word():
    """Neither at a hyphen nor within a word that is wider than the page."""
    words = ["time-of-flight", "x" * (COLUMNS + 20), *["cycle-accurate"] * 30]
    lines = paragraph(" ".join(words)).split("\n")
    assert " ".join(lines).split(" ") == words
    assert max(len(line) for line in lines if not line.startswith("x")) <= COLUMNS
    for behind, number in ((COLUMNS - 50, 1), (COLUMNS - 49, 2)):
        assert len(paragraph(f"{'a' * 49} {'b' * behind}").split("\n")) == number
