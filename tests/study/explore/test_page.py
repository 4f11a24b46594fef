# SPDX-License-Identifier: Apache-2.0
"""The explorer's page as the server sends it, without a browser: every control has its words, its kind
of field and its limits; files, buttons and what can be saved are those of the tables.
"""

import json
from html.parser import HTMLParser

import pytest
from attrs import define, field
from bokeh.document import Document
from bokeh.embed import file_html
from bokeh.resources import CDN

from coincid.model.contract.parameters import Sensor
from coincid.model.scenes.conventions import DEPTH_FILES
from coincid.model.shared.pulse import PULSE_FILES
from coincid.study.explore import out
from coincid.study.explore.controls import CONTROLS, GROUPS
from coincid.study.explore.tab import LOOK_LABELS, TRIES, Page
from coincid.study.explore.uploads import USED_BY, Kept, Uploads
from coincid.study.show.figures import FATE_MARKS, REASON_MARKS, VERDICT_MARKS

EMPTY = ("input", "link", "meta", "br")  # elements without an end


@define
class Element:
    """An element of the page. text: its own, and that of the elements in it."""

    tag: str
    attributes: dict[str, str | None]
    text: str = ""
    inner: list["Element"] = field(factory=list)

    def find(self, tag, **attributes):
        """Return the elements in it of a tag, and with these attributes."""
        wanted = {name.replace("_", "-").strip("-"): value for name, value in attributes.items()}
        found = []
        for one in self.inner:
            if one.tag == tag and wanted.items() <= one.attributes.items():
                found.append(one)
            found += one.find(tag, **attributes)
        return found


class Tree(HTMLParser):
    """The elements of a page, in `root`."""

    def __init__(self, text):
        super().__init__()
        self.root = Element("page", {})
        self.open = [self.root]
        self.feed(text)

    def handle_starttag(self, tag, attributes):
        one = Element(tag, dict(attributes))
        self.open[-1].inner.append(one)
        if tag not in EMPTY:
            self.open.append(one)

    def handle_endtag(self, tag):
        assert self.open.pop().tag == tag

    def handle_data(self, data):
        for one in self.open:
            one.text += data


@pytest.fixture(scope="module")
def page():
    made = Page(Document(), {}, Uploads(), Kept())
    text = file_html(
        made.doc, CDN, template=made.doc.template, template_variables=made.doc.template_variables
    )
    made.close()
    return Tree(text).root


def test_the_key_below_the_figures_has_the_marks_of_edges_windows_and_reasons(page):
    marks = [one.text for one in page.find("span") if "data-mark" in one.attributes]
    drawn = [*FATE_MARKS, *VERDICT_MARKS, ("", "", "light expected"), *REASON_MARKS]
    assert marks == [meaning for *_, meaning in drawn]


@pytest.mark.parametrize("control", CONTROLS, ids=lambda control: control.name)
def test_a_control_has_its_words_and_the_field_of_its_kind(page, control):
    """The label belongs to the field, and the sentence describes it."""
    (part,) = page.find("div", data_control=control.name)
    (chosen,) = part.find("select" if control.kind == "choice" else "input", name=control.name)
    (label,) = part.find("label")
    unit = "" if control.kind in ("switch", "choice", "text") else control.span(Sensor())
    assert label.text.split() == f"{control.label} {unit}".split()
    assert chosen in label.inner or label.attributes["for"] == chosen.attributes["id"]
    (about,) = part.find("p", id=chosen.attributes["aria-describedby"])
    assert about.text == control.sentence
    kinds = {"switch": "checkbox", "text": "text", "choice": None}
    assert chosen.attributes.get("type") == kinds.get(control.kind, "number")
    assert [option.text for option in chosen.find("option")] == list(control.choices)
    assert json.loads(part.attributes.get("data-needs", "[]")) == control.needs


@pytest.mark.parametrize(
    "control",
    [one for one in CONTROLS if one.kind in ("integer", "real")],
    ids=lambda control: control.name,
)
def test_a_number_takes_what_is_legal_and_its_slider_ends_where_the_table_says(page, control):
    """A real number may have any digits; an arrow key changes an integer by its step."""
    (part,) = page.find("div", data_control=control.name)
    (number,) = part.find("input", type="number")
    assert number.attributes["step"] == ("any" if control.kind == "real" else f"{control.step}")
    sliders = [one.attributes for one in part.find("input", data_slides=control.name)]
    ends = [(float(one["min"]), float(one["max"]), float(one["step"])) for one in sliders]
    assert ends == [(control.low, control.slide, control.step)] * bool(control.slide)


def test_groups_stand_in_their_order_and_the_first_three_are_open(page):
    (form,) = page.find("form", id="controls")
    groups = form.find("details")
    assert [one.find("summary")[0].text for one in groups] == list(GROUPS)
    assert ["open" in one.attributes for one in groups] == [k < 3 for k in range(len(GROUPS))]
    for group in groups:
        names = [
            one.attributes["data-control"]
            for one in group.find("div", class_="control")
            if "data-control" in one.attributes
        ]
        title = group.find("summary")[0].text
        assert names == [control.name for control in CONTROLS if control.group == title]


def test_settings_to_try_are_buttons_with_their_sentences(page):
    (part,) = page.find("nav")
    found = [
        (one.text, json.loads(one.attributes["data-try"]), one.attributes["data-says"])
        for one in part.find("button")
    ]
    assert found == list(TRIES)


def test_files_that_can_be_chosen_are_those_that_are_read(page):
    accepted = {
        one.attributes["data-kind"]: one.attributes["accept"].split(",")
        for one in page.find("input", type="file")
    }
    assert accepted == {
        "depth": list(DEPTH_FILES),
        "colour": ["image/*"],
        "sun": ["image/*"],
        "pulse": list(PULSE_FILES),
    }


def test_all_that_can_be_saved_is_offered_by_its_label(page):
    (menu,) = page.find("select", id="save")
    offered = {one.attributes["value"]: one.text for one in menu.find("option")}
    assert offered.pop("") == "..."
    command = {"command": "command that repeats it"}
    assert offered == {name: save.label for name, save in out.SAVES.items()} | command


def test_a_file_is_chosen_beside_the_control_that_uses_it(page):
    """Each with its own label."""
    labels = {
        "depth": "Depth picture",
        "colour": "Colour picture",
        "sun": "Picture of the sun",
        "pulse": "File of the pulse",
    }
    (form,) = page.find("form", id="controls")
    before, found = "", {}
    for part in form.find("div", class_="control"):
        if kind := part.attributes.get("data-upload"):
            (file,) = part.find("input", type="file")
            (label,) = part.find("label")
            assert file.attributes["data-kind"] == kind
            assert label.attributes["for"] == file.attributes["id"]
            assert label.text.startswith(labels[kind])
            found[kind] = before
        else:
            before = part.attributes["data-control"]
    assert found == {kind: control for kind, (control, _) in USED_BY.items()}


def test_what_is_looked_at_and_ordered_is_named_on_the_page(page):
    (part,) = page.find("div", id="look")
    labels = {
        one.attributes["data-look"]: label.text.split()[0]
        for label in part.find("label")
        for one in (*label.find("input"), *label.find("select"))
    }
    assert labels == LOOK_LABELS | {"which": "Details"}
    orders = {one.attributes.get("data-do"): one.text for one in page.find("button")}
    assert orders.pop("reset") == "Reset all to defaults"
    assert (orders["keep_a"], orders["drop_a"]) == ("Keep as A", "Drop A")
    assert orders["rtl"] == "Check on RTL"
    plays = {one.attributes.get("data-play"): one.text for one in page.find("button")}
    assert (plays["pulse"], plays["frame"]) == ("Play pulses", "Play frames")
