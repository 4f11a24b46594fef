# SPDX-License-Identifier: Apache-2.0
"""The page of a tab without a browser: what stands where when two results are compared, and what
the fields to look at accept.
"""

import base64
import io
import re
from itertools import count
from pathlib import Path

import numpy as np
import pytest
from attrs import evolve
from bokeh.document import Document

from coincid.model.shared.errors import InputError
from coincid.study.explain import meaning
from coincid.study.explore import messages, out, tab
from coincid.study.explore.control_values import check_settings, command, query
from coincid.study.explore.controls import CONTROL, DEFAULTS
from coincid.study.explore.stages import Explorer
from coincid.study.explore.tab import TRIES, Page, _summary
from coincid.study.explore.uploads import Kept, Uploads
from coincid.study.show.figures import map_columns
from coincid.study.show.words import number_rows, object_table, story, where_to_look

SMALL = {"rows": 8, "cols": 16, "pulses": 20, "frames": 3}
EXPLORER = Explorer()


@pytest.fixture
def page():
    made = Page(Document(), {}, Uploads(), Kept())
    yield made
    made.close()


def answered(page, **values):
    """Show the result of settings, as if the page had asked for it."""
    explored = EXPLORER.run(check_settings(SMALL | values))
    page._computed(page._run, "done", explored)
    return explored


def look(page, name, value):
    page._ordered(messages.Look(name=name, value=str(value)))
    return page.link.look_refusal["text"]


@pytest.mark.parametrize(
    ("frames_of_a", "frames_of_b", "frame", "frame_of_a"),
    [(3, 1, 0, 0), (1, 3, 2, 0), (2, 3, 1, 1), (2, 3, 2, 1), (3, 3, 1, 1)],
)
def test_beside_a_frame_stands_that_of_a_or_its_last(
    page, frames_of_a, frames_of_b, frame, frame_of_a
):
    a = answered(page, frames=frames_of_a)
    page._ordered(messages.KeepA())
    b = answered(page, frames=frames_of_b, threshold=3)
    assert look(page, "frame", frame) == ""
    edges = [a.view(number).numbers["edges"] for number in range(frames_of_a)]
    assert len(set(edges)) == frames_of_a
    words = page.link.new_words["words"]
    expected = number_rows(b.view(frame), a.view(frame_of_a))
    assert [list(row) for row in words["numbers"]] == [list(row) for row in expected]
    assert words["number_heads"] == ["", "B", "A"] and words["ab"]
    assert words["frames"] == frames_of_b
    page._ordered(messages.DropA())
    assert page.link.new_words["words"]["number_heads"] == ["", ""]


def test_the_words_are_those_of_b_and_the_objects_stand_side_by_side(page):
    """At the frame that is looked at."""
    a = answered(page, threshold=5, scene="five-objects")
    words = page.link.answer["words"]
    assert words["object_heads"] == ["", "reflects", "distance", "photons per pulse", "wrong"]
    page._ordered(messages.KeepA())
    b = answered(page, threshold=1, scene="five-objects")
    for frame in (1, 2):
        assert look(page, "frame", frame) == ""
        words, of_b, of_a = page.link.new_words["words"], b.view(frame), a.view(frame)
        assert words["objects"] == object_table(of_b, of_a)
        assert len({tuple(row) for row in words["objects"]}) > 1
        assert words["object_heads"][-2:] == ["wrong B", "A"]
        assert (words["story"], words["where"]) == (story(of_b), where_to_look(of_b))
        assert story(of_b) != story(of_a)
        assert words["meaning"] == [list(row) for row in meaning(b.settings.config)]


def test_at_first_a_pixel_of_the_dark_object_is_looked_at():
    """It is the one that the page shows before there is a result."""
    page = Path(tab.__file__).with_name("page.html").read_text(encoding="utf-8")
    shown = dict(re.findall(r'data-look="(\w+)" min="0" value="(\d+)"', page))
    first = {name: int(value) for name, value in shown.items()}
    assert messages.LookedAt(**first, which="B") == tab.FIRST_LOOK
    dark, *_ = EXPLORER.run(check_settings({})).view().objects
    assert abs(dark.middle[0] - tab.FIRST_LOOK.row) <= 4
    assert abs(dark.middle[1] - tab.FIRST_LOOK.col) <= 4


def test_the_tab_has_its_title_and_tells_a_lost_server_in_its_own_words(page):
    """Not in those of the library, which would go on as if nothing had happened."""
    assert page.doc.title == "Coincid explorer"
    assert not page.doc.config.notify_connection_status
    assert not page.doc.config.reconnect_session
    codes = {
        name: [callback.code for callback in callbacks]
        for name, callbacks in page.doc.callbacks._js_event_callbacks.items()
    }
    assert codes["document_ready"] == ["explorer(link)"]
    assert codes["connection_lost"] == ["gone()"]


def test_what_is_kept_as_a_stands_beside_itself_at_once(page):
    """In the tables, in the words about A, and in the pictures, before anything else is asked."""
    kept = answered(page, threshold=2)
    alone = page.views.histogram.figure.title.text
    page._ordered(messages.KeepA())
    words = page.link.new_words["words"]
    expected = number_rows(kept.view(2), kept.view(2))
    assert [list(row) for row in words["numbers"]] == [list(row) for row in expected]
    assert words["number_heads"] == ["", "B", "A"] and words["ab"]
    assert words["a_says"].removeprefix("A: ") in words["status"]
    assert page.views.histogram.figure.title.text == alone


def test_a_that_is_smaller_shows_its_last_pixel_and_pulse(page):
    """As long as it is looked at; B keeps its own."""
    answered(page, pulses=5)
    page._ordered(messages.KeepA())
    answered(page, rows=24, cols=40)
    for name, value in {"row": 21, "col": 37, "pulse": 18}.items():
        assert look(page, name, value) == ""
    title = page.views.histogram.figure.title
    assert title.text.startswith("row 21, column 37:")
    assert look(page, "which", "A") == ""
    assert title.text.startswith("row 7, column 15:")
    assert look(page, "which", "B") == ""
    assert title.text.startswith("row 21, column 37:")
    page._picked(3, 9)
    assert title.text.startswith("row 3, column 9:")
    for corner in ((0, 0), (23, 39)):
        page._picked(*corner)
        assert title.text.startswith("row {}, column {}:".format(*corner))
    page._picked(3, 9)
    for beside in ((9, 40), (24, 9), (-1, 9), (9, -1)):
        page._picked(*beside)
        assert title.text.startswith("row 3, column 9:")
    assert look(page, "which", "A") == ""
    page._ordered(messages.DropA())
    assert title.text.startswith("row 3, column 9:")
    words = page.link.new_words["words"]
    assert (words["look"]["which"], words["ab"]) == ("B", False)


def test_a_is_what_was_kept_last_and_is_gone_once_dropped(page):
    """A second one takes the place of the first; a new result changes B alone."""
    results = []
    for threshold in (1, 2, 3):
        page._ordered(messages.KeepA())
        results.append(answered(page, threshold=threshold, frames=1))
    first, second, third = (number_rows(result.view(0)) for result in results)
    beside = [[*row, kept[1]] for row, kept in zip(third, second, strict=True)]
    words = page.link.answer["words"]
    assert [list(row) for row in words["numbers"]] == beside
    assert second != first
    assert "threshold 2" in words["a_says"] and "threshold 3" in words["status"]
    for _ in range(2):  # the second time, nothing is left to drop
        page._ordered(messages.DropA())
        assert [list(row) for row in page.link.new_words["words"]["numbers"]] == third


@pytest.mark.parametrize(("name", "last"), [("row", 7), ("col", 15), ("pulse", 19), ("frame", 2)])
def test_what_is_looked_at_is_in_the_result(page, name, last):
    """The error tells the range; a step behind the last one goes to the first."""
    answered(page)
    for value in (0, last):
        assert look(page, name, value) == ""
        assert page.link.new_words["words"]["look"][name] == value
    for value in (-1, last + 1, "1.5", "", "--5", "9" * 5000):
        assert f"0 to {last}" in look(page, name, value)
        assert page.look == messages.LookedAt(**page.link.new_words["words"]["look"])
    if name in ("pulse", "frame"):
        page._ordered(messages.Step(name=name))
        assert getattr(page.look, name) == 0
        page._ordered(messages.Step(name=name))
        assert getattr(page.look, name) == 1


def test_the_maps_are_those_of_the_frame_that_is_looked_at(page):
    """Which another pixel or pulse does not change."""
    explored = answered(page)
    frames = range(SMALL["frames"])
    confidences = [map_columns(explored.view(frame))["confidence"][0] for frame in frames]

    def drawn():
        shown = page.views.pictures.data["confidence"][0]
        return [np.array_equal(shown, one, equal_nan=True) for one in confidences].index(True)

    assert drawn() == 2
    for name, value, frame in (("frame", 1, 1), ("row", 2, 1), ("frame", 0, 0), ("pulse", 3, 0)):
        look(page, name, value)
        assert drawn() == frame
    page._ordered(messages.Step(name="frame"))
    assert drawn() == 1


def test_after_a_result_the_last_frame_is_looked_at_inside_the_array(page):
    """As the page is told, too."""
    answered(page, rows=24, cols=40, pulses=20)
    for name, value in {"row": 21, "col": 37, "pulse": 18, "frame": 0}.items():
        assert look(page, name, value) == ""
    answered(page, pulses=5, frames=2)
    expected = messages.LookedAt(row=7, col=15, pulse=4, frame=1, which="B")
    assert page.look == expected
    assert messages.LookedAt(**page.link.answer["words"]["look"]) == expected


def test_each_file_that_is_saved_is_new_and_of_the_frame_that_is_looked_at(page, monkeypatch):
    saved = out.Save("a file", "a.bin", "a/b", lambda explored, frame: b"frame %d" % frame)
    monkeypatch.setitem(out.SAVES, "png", saved)
    answered(page)
    for number, frame in enumerate((2, 0, 1, 1), start=1):
        assert look(page, "frame", frame) == ""
        page._ordered(messages.Save(kind="png"))
        file = page.link.download
        assert (file["number"], file["name"], file["type"]) == (number, "a.bin", "a/b")
        assert base64.b64decode(file["base64"]) == b"frame %d" % frame


def test_the_address_of_a_page_repeats_its_settings_and_its_uploads(page):
    """Without uploads, there is no word of them."""
    uploads = Uploads(sun=Path("sun.png"))
    for given, suffix in ((Uploads(), ""), (uploads, "&uploads=1"), (Uploads(), "")):
        explored = EXPLORER.run(check_settings(SMALL | {"threshold": 3}, given))
        page._computed(page._run, "done", explored)
        words = page.link.answer["words"]
        assert words["query"] == query(explored.settings) + suffix
        assert words["uploads"] == bool(suffix)
    page.uploads = uploads  # of the next question, not of what is shown
    look(page, "row", 1)
    assert page.link.new_words["words"]["query"] == query(explored.settings)
    default = EXPLORER.run(check_settings({"scene": "flat"}))
    page._computed(page._run, "done", evolve(default, settings=check_settings({})))
    assert page.link.answer["words"]["query"] == ""


def test_a_refused_file_stays_refused_until_another_one_takes_its_place(page):
    """One of another kind does not; all are forgotten together."""
    page.bad_uploads |= {"sun": "sun.png: is bad", "pulse": "a.csv: is bad"}
    content = base64.b64encode(b"time_ps,density\n0,0\n250,1\n500,0\n").decode()
    page._ordered(messages.Upload(kind="pulse", name="b.csv", content=content))
    assert page.bad_uploads == {"sun": "sun.png: is bad"}
    page._ordered(messages.Upload(kind="depth", name="b.exe", content=content))
    assert list(page.bad_uploads) == ["sun", "depth"]
    page._ordered(messages.Forget())
    assert not page.bad_uploads and page.uploads == Uploads()


def test_an_order_to_check_begins_with_what_is_shown_and_says_so(page, monkeypatch):
    """Each check is one of the result that is shown then, not of A, and of the newest question."""
    checked, begun = [], []
    answered(page, threshold=1)
    page._ordered(messages.KeepA())
    monkeypatch.setattr(tab, "check_on_rtl", lambda *given: checked.append(given))
    monkeypatch.setattr(page._checker, "start", begun.append)
    for number, threshold in ((4, 2), (5, 3)):
        shown = answered(page, threshold=threshold)
        page.number = number
        page._ordered(messages.CheckOnRtl())
        begun[-1]("progress")
        assert checked[-1] == (shown, "progress")
        told = page.link.rtl_check
        assert (told["number"], told["bad"]) == (number, False)
        assert told["text"].startswith("The RTL is being compiled and run;")
    assert len(begun) == 2


def test_an_order_to_save_the_command_tells_it_and_saves_no_file(page):
    answered(page, threshold=1)
    page._ordered(messages.KeepA())
    page.number = 9
    shown = answered(page, threshold=3)
    page._ordered(messages.Save(kind="command"))
    assert page.link.command_line == {"number": 9, "text": command(shown.settings)}
    assert not page.link.download


def test_what_a_thread_tells_is_heard_in_the_thread_of_the_document(page, monkeypatch):
    """Bokeh takes changes of a document there alone."""
    ticks, heard = [], []
    monkeypatch.setattr(page.doc, "add_next_tick_callback", ticks.append)
    page._soon(lambda *what: heard.append(what), 1, "done", "answer")
    assert not heard
    (tick,) = ticks
    tick()
    assert heard == [(1, "done", "answer")]


def test_the_check_on_the_rtl_tells_its_share_and_its_verdict(page):
    answered(page)
    page._checker._deliver = lambda *what: None
    run = page._checker.start(lambda progress: None)
    for kind, outcome, text, bad in (
        ("progress", ("RTL", 0.25), "RTL: 25%", False),
        ("done", "Every word agrees", "Every word agrees", False),
        ("done", "The RTL and the golden model differ: a", "The RTL and the golden model differ: a", True),
        ("failed", "no tool", "The check did not run: no tool", True),
    ):  # fmt: skip
        page._checked(run, kind, outcome)
        assert (page.link.rtl_check["text"], page.link.rtl_check["bad"]) == (text, bad)


def test_a_file_of_parts_tells_them_when_it_comes_goes_and_comes_again(page):
    file = io.BytesIO()
    np.savez(file, near=np.full((8, 8), 2.0), far=np.full((8, 8), 6.0))
    content = base64.b64encode(file.getvalue()).decode()
    page._ordered(messages.Upload(kind="depth", name="two.npz", content=content))
    assert sorted(page.link.parts["names"]) == ["far", "near"]
    number = page._kept.number_of(page.uploads)
    page._ordered(messages.Forget())
    assert page.link.parts["names"] == []
    page._ordered(messages.Recall(number=number))
    assert sorted(page.link.parts["names"]) == ["far", "near"]
    assert Page(Document(), {}, page.uploads, page._kept).link.parts == page.link.parts


def test_what_is_doubted_about_an_uploaded_file_is_told_by_its_name(page, tmp_path):
    """First of all, and without the folder in which the server keeps it."""
    floor = np.linspace(900, 1500, 64 * 64).reshape(64, 64).astype(np.uint16) * 5
    np.save(tmp_path / "floor.npy", floor)
    uploads = Uploads(depth=tmp_path / "floor.npy")
    values = SMALL | {"rows": 16, "scene": "upload", "klux": 1.0}
    explored = EXPLORER.run(check_settings(values, uploads))
    page._computed(page._run, "done", explored)
    words = page.link.answer["words"]
    for told in (words["notes"], words["wastes"]):
        assert told[0].startswith("floor.npy: the samples look like TUM")
        assert not any(str(tmp_path) in one for one in told)


def asked(page, number, **values):
    """Ask as the page does, with the text of every control, and return the refusal."""
    texts = {name: "" if value is None else str(value) for name, value in DEFAULTS.items()}
    page._asked(messages.Question(number=number, values=texts | values))
    return page.link.refusal


@pytest.mark.parametrize(
    ("values", "control", "told"),
    [
        ({"mg_threshold": "99"}, "mg_threshold", "{} = 99: must be an integer from 1 to 4"),
        ({"klux": "-1"}, "klux", "{} = -1.0: must be a number from 0 to 200"),
        ({"rows": "30"}, "rows", "{} = 30: must be a multiple of 8, because of"),
        ({"threshold": ""}, "threshold", "{}: is empty, must be a number from 1 to 64"),
    ],
)
def test_a_refusal_answers_its_question_and_names_the_control_as_the_page_does(
    page, values, control, told
):
    for number in (3, 8):
        refusal = asked(page, number, **values)
        assert (refusal["number"], refusal["control"]) == (number, control)
        assert refusal["message"].startswith(told.format(CONTROL[control].label))
        assert not re.search(r"\b(sensor|frame|subgroup)\.", refusal["message"])


@pytest.mark.parametrize("name", ["sun.png", "sun-1.png", "sun 1.png", "sunny.png", "other.png"])
def test_a_bad_upload_is_refused_at_the_control_that_asks_for_it_by_its_own_name(page, name):
    """Also if it begins with the name of the control."""
    page.bad_uploads["sun"] = f"{name}: is no picture"
    refusal = asked(page, 4, sun="picture")
    assert (refusal["number"], refusal["control"]) == (4, "sun")
    assert refusal["message"] == page.bad_uploads["sun"]


@pytest.mark.parametrize(
    ("values", "told"),
    [
        ({"auto": True, "threshold": 4}, "controller"),
        ({"auto": False, "threshold": 4}, "threshold 4"),
        ({"coincidence": False, "auto": True}, "coincidence off"),
    ],
)
def test_the_summary_tells_each_setting_once(values, told):
    """The most important ones first, then all others that are changed."""
    first = {"scene": "flat", "klux": 2.5, "pulses": 20}
    head = f"flat, 2.5 klux, 20 pulses, {told}"
    assert _summary(check_settings(first | values)) == head
    label = CONTROL["rows"].label
    others = f"{label[:1].lower()}{label[1:]} 16"
    assert _summary(check_settings(first | values | {"rows": 16})) == f"{head}, {others}"


@pytest.mark.parametrize(
    ("kind", "control", "asking", "other"),
    [
        ("depth", "scene", "upload", "flat"),
        ("colour", "scene", "upload", "flat"),
        ("sun", "sun", "picture", "left half"),
        ("pulse", "pulse", "file", "Gaussian"),
    ],
)
def test_a_bad_upload_matters_only_to_settings_that_use_it(
    page, monkeypatch, kind, control, asking, other
):
    monkeypatch.setattr(page._runner, "start", lambda work: 1)
    page.bad_uploads[kind] = "a file: is bad"
    assert asked(page, 4, **{control: asking})["message"] == "a file: is bad"
    assert asked(page, 5, **{control: other})["number"] == 4  # not refused


def test_a_result_is_told_only_as_the_answer_to_its_own_question(page, monkeypatch):
    """Not if it is late, and another question was asked or refused before it came."""
    explored = EXPLORER.run(check_settings(SMALL))
    numbers = count(1)
    monkeypatch.setattr(page._runner, "start", lambda work: next(numbers))
    outcomes = ("progress", ("depth", 0.5)), ("done", explored), ("failed", InputError("bad"))
    for number, values in ((7, {}), (8, {"threshold": "3"}), (9, {"threshold": ""})):
        asked(page, number, **values)
        refusal = page.link.refusal
        for kind, outcome in outcomes if number > 7 else ():
            page._computed(number - 7, kind, outcome)
        assert not page.link.answer and not page.link.progress and page.link.refusal == refusal
    assert page.link.refusal["number"] == 9
    asked(page, 10)
    page._computed(3, "progress", ("depth", 0.5))
    assert page.link.progress == {"number": 10, "stage": "depth", "share": 0.5}
    page._computed(3, "done", explored)
    assert page.link.answer["number"] == 10


def test_a_refused_question_ends_the_work_on_the_one_before(page):
    before = page._runner.newest
    asked(page, 3, threshold="")
    assert page._runner.newest > before


@pytest.mark.parametrize(
    ("error", "told", "control"),
    [
        (InputError("klux = 999: must be lower", field="klux"), "Sunlight = 999: must be lower", "klux"),
        (InputError("edges: too many"), "edges: too many", None),
        (MemoryError("5 GB"), "this could not be computed (MemoryError: 5 GB)", None),
    ],
)  # fmt: skip
def test_work_that_fails_tells_why(page, error, told, control):
    page.number = 6
    page._computed(page._run, "failed", error)
    assert page.link.refusal == {"number": 6, "message": told, "control": control}


def test_before_the_first_result_clicks_and_orders_do_nothing(page):
    page._picked(3, 4)
    for order in (
        messages.KeepA(),
        messages.DropA(),
        messages.Look(name="row", value="3"),
        messages.Step(name="frame"),
        messages.CheckOnRtl(),
        messages.Save(kind="png"),
        messages.Save(kind="command"),
    ):
        page._ordered(order)
    sent = page.link.new_words, page.link.rtl_check, page.link.download, page.link.command_line
    assert not any(sent)


def test_work_of_a_tab_ends_when_the_tab_is_closed(page):
    runners = page._runner, page._checker
    before = [runner.newest for runner in runners]
    for closed in page.doc.callbacks.session_destroyed_callbacks:
        closed(None)
    for runner, number in zip(runners, before, strict=True):
        assert runner.newest > number
        with pytest.raises(RuntimeError, match="after shutdown"):
            runner.start(lambda progress: None)


@pytest.mark.parametrize(("name", "values", "sentence"), TRIES)
def test_settings_to_try_are_legal_and_their_sentence_is_one(name, values, sentence):
    assert check_settings(values).changed.keys() <= values.keys()
    assert re.match(r"\d \w", name) and sentence.endswith(".")
