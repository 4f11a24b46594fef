# SPDX-License-Identifier: Apache-2.0
"""The explorer in a real Chromium: every control, every click, and possible errors. Skipped if
there is no Chromium.
"""

import re
import signal
from itertools import pairwise
from urllib.parse import parse_qsl, urlsplit

import numpy as np
import pytest
from PIL import Image

import coincid
from coincid.model.depth.belief import SENTENCES, Reason
from coincid.study.explore.control_values import check_settings
from coincid.study.explore.controls import CONTROL, CONTROLS
from coincid.study.explore.stages import Explorer
from coincid.study.explore.tab import TRIES
from coincid.study.show.figures import (
    HistogramFigure,
    TimelineFigure,
    cursor_columns,
    histogram_columns,
    light_columns,
    period_columns,
)
from coincid.study.show.report import write_report
from coincid.study.show.words import OBJECT_HEADS, number_rows, object_table, story
from docs.studies.drawings.browser import FLAGS, chromium

from .test_server import SMALL, explorer
from .test_settings import other_value

pytestmark = [pytest.mark.needs("chromium")]
PATIENCE_MS = 240_000
STEADY_MS = 500  # without a change of the layout
SHOWN = "document.body.dataset.state === 'shown'"


@pytest.fixture(scope="module")
def address():
    with explorer(*SMALL) as (_, address):
        yield address


@pytest.fixture(scope="module")
def browser():
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=chromium(), args=FLAGS)
        yield browser
        browser.close()


@pytest.fixture
def tabs(browser):
    """Open tabs; at the end, check that no console has an error, and that no other machine was
    contacted.
    """
    context = browser.new_context(viewport={"width": 1280, "height": 800}, accept_downloads=True)
    context.set_default_timeout(PATIENCE_MS)
    errors, requests = [], []

    def new_tab(address, ready=True):
        tab = context.new_page()
        tab.on("console", lambda message: message.type == "error" and errors.append(message.text))
        tab.on("pageerror", lambda error: errors.append(str(error)))
        tab.on("request", lambda request: requests.append(request.url))
        tab.goto(address)
        if ready:
            shown(tab)
        return tab

    new_tab.forgiven = ()
    yield new_tab
    context.close()
    assert [error for error in errors if not any(text in error for text in new_tab.forgiven)] == []
    assert [
        url
        for url in requests
        if not url.startswith(("http://127.0.0.1:", "data:", "blob:", "file:"))
    ] == []


def shown(tab):
    tab.wait_for_function(SHOWN)


def wait_for_title(tab, name, test):
    """Wait until a figure's title passes `test`, a call of a method of JavaScript's strings."""
    tab.wait_for_function(f"Bokeh.documents[0].get_model_by_name('{name}').title.text.{test}")


def asks(tab, act, *given):
    """Do what makes the page ask by itself, in its own time, and wait until it has asked."""
    before = tab.evaluate("asked")
    act(*given)
    tab.wait_for_function("(before) => asked > before", arg=before)


def bring(tab, kind, path):
    """Choose a file as a user does; the page reads it before it asks."""
    asks(tab, tab.set_input_files, f"#u-{kind}", path)


def refused(tab):
    """Wait for the sentence about an illegal setting, and return it."""
    tab.wait_for_selector("#refused:not([hidden])")
    return tab.locator("#refused").text_content()


def put(tab, name, value):
    """Set a control as a user does; open its group first if it is closed."""
    field = tab.locator(f"#controls [name='{name}']")
    field.evaluate("(one) => { one.closest('details').open = true; }")
    kind = field.evaluate("(one) => one.type")
    if kind == "checkbox":
        field.set_checked(value)
    elif kind == "select-one":
        field.select_option(str(value))
    else:
        field.fill(str(value))


def number(tab, label):
    """Return the cells of a row of the numbers."""
    rows = "[...document.querySelectorAll('#numbers tbody tr')].map((r) => [...r.children].map((c) => c.textContent.trim()))"
    return next(cells[1:] for cells in tab.evaluate(rows) if cells[0] == label)


def click_map(tab, name, row, col):
    """Click a pixel of a map, once the page is laid out; Bokeh tells where the plot is inside its
    frame.
    """
    x, y = tab.evaluate(
        """async ([name, row, col, steady_ms]) => {
          const view = Bokeh.index.find_one_by_id?.(Bokeh.documents[0].get_model_by_name(name).id)
            ?? Object.values(Bokeh.index.roots ?? Bokeh.index).find((v) => v.model.name === name);
          const frame = () => new Promise(requestAnimationFrame);
          const places = () => JSON.stringify([view.el.getBoundingClientRect(), view.frame.bbox.rect]);
          for (let before = places(), since = performance.now(); performance.now() - since < steady_ms;) {
            await frame();
            if (places() !== before) { before = places(); since = performance.now(); }
          }
          const box = view.el.getBoundingClientRect();
          return [box.x + view.frame.x_scale.compute(col), box.y + view.frame.y_scale.compute(row)];
        }""",
        [f"map_{name}", row, col, STEADY_MS],
    )
    tab.mouse.click(x, y)


def figure_title(tab, name):
    return tab.evaluate("(name) => Bokeh.documents[0].get_model_by_name(name).title.text", name)


# what other controls' other values need: by themselves
LEFT_OUT = {"offsets": 0, "records": 0, "controller": 0}
COUNTED = {"counts": 1, "search_pulses": 1}  # not legal with another size of the minigroups
NEEDS_A_FILE = {"pulse"}  # other values than the default
SMALL_TOO = {"pulses": 30, "cols": 24}  # legal with the other controls' other values


def test_every_control_reaches_what_is_computed(tabs, address):
    tab = tabs(address)
    others = {
        control.name: other_value(control)
        for control in CONTROLS
        if control.name not in LEFT_OUT | COUNTED and control.name not in NEEDS_A_FILE
    } | SMALL_TOO
    for values in (others, LEFT_OUT, COUNTED):
        for name, value in values.items():
            # A field that has no effect just now keeps its value, which counts in the link.
            tab.evaluate(
                """([name, value]) => {
                  field(name).disabled = false;
                  write(name, value);
                  field(name).dispatchEvent(new Event("input", {bubbles: true}));
                }""",
                [name, value],
            )
        shown(tab)
        assert dict(parse_qsl(urlsplit(tab.url).query)) == {
            name: str(value) for name, value in values.items()
        }
        tab.click("[data-do=reset]")
        shown(tab)
        assert (
            "five-objects, 50 klux, 100 pulses, threshold 2 "
            in tab.locator("#status").text_content()
        )


def test_a_result_is_shown_only_beside_its_own_legal_settings(tabs, address):
    tab = tabs(address)
    offered = "['[data-do=rtl]', '[data-do=keep_a]', '#save'].map((one) => $(one).disabled)"
    assert tab.evaluate(offered) == [False] * 3
    state, opacity, disabled = tab.evaluate(
        """() => {
        const field = document.querySelector("#controls [name='threshold']");
        field.value = "5";
        field.dispatchEvent(new Event("input", {bubbles: true}));
        const {opacity} = getComputedStyle(document.getElementById("results"));
        return [document.body.dataset.state, opacity, OFFERED];
    }""".replace("OFFERED", offered)
    )
    assert state == "asked" and float(opacity) < 0.1  # at once, before the server has answered
    assert disabled == [True] * 3  # what they would act on is the earlier result
    for threshold in (6, 7, 3):
        put(tab, "threshold", threshold)
    shown(tab)
    assert "threshold 3" in tab.locator("#status").text_content()
    assert number(tab, "mean threshold") == ["3.00 pixels"]
    put(tab, "threshold", 999)
    assert refused(tab) == "Threshold = 999: must be an integer from 1 to 64"
    assert tab.evaluate(offered) == [True] * 3
    assert "illegal" in tab.locator("[data-control=threshold]").get_attribute("class")
    # The earlier result stays, and the page says that it is the earlier one.
    assert tab.locator("#results").evaluate("(one) => getComputedStyle(one).opacity") == "0.6"
    assert "of the settings before" in tab.locator("#status").text_content()
    put(tab, "threshold", "")
    tab.wait_for_function(
        "document.getElementById('refused').textContent.startsWith('Threshold: is empty')"
    )
    put(tab, "threshold", 2)
    shown(tab)
    assert tab.locator("#refused").is_hidden()


def test_the_threshold_and_the_dark_object(tabs, address):
    tab = tabs(address)
    for number_of_try, text in (
        (0, "found the FIFO full"),
        (2, r"[1-9]\d% of the pixels are wrong.*, 0%\."),
    ):
        tab.locator("[data-try]").nth(number_of_try).click()
        shown(tab)
        assert tab.locator("#tried").text_content() == TRIES[number_of_try][2]
        assert re.search(text, tab.locator("#story").text_content())
    rows = tab.locator("#objects tbody tr").all_text_contents()
    assert re.search(r"[1-9]\d\.\d%", rows[0]) and "0.0%" in rows[-1]
    tab.click("[data-do=reset]")
    shown(tab)
    assert tab.locator("#tried").text_content() == ""


def test_a_click_picks_a_pixel_and_its_subgroup_and_pulses_play(tabs, address):
    tab = tabs(address)
    click_map(tab, "depth_m", 3, 12)
    wait_for_title(tab, "histogram", "startsWith('row 3, column 12')")
    wait_for_title(tab, "timeline", "startsWith('subgroup 1, pulse 0')")
    edges = "Bokeh.documents[0].get_model_by_name('timeline').renderers.map((r) => Object.values(r.data_source.data)[0].length)"
    assert max(tab.evaluate(edges)) > 1
    click_map(tab, "truth_m", 9, 4)  # the second click, on another map
    wait_for_title(tab, "histogram", "startsWith('row 9, column 4')")
    tab.wait_for_function("document.querySelector('[data-look=row]').value === '9'")
    assert tab.input_value("[data-look=col]") == "4"
    click_map(tab, "depth_m", 3, 12)
    tab.wait_for_function(
        "document.getElementById('pixel').textContent.includes('row 3, column 12, subgroup 1')"
    )
    tab.fill("[data-look=pulse]", "7")
    wait_for_title(tab, "timeline", "startsWith('subgroup 1, pulse 7')")
    tab.fill("[data-look=row]", "99")
    tab.wait_for_selector("#looked:has-text('Row = 99: must be an integer from 0 to 15')")
    tab.fill("[data-look=row]", "3")
    put(tab, "frames", 3)
    put(tab, "auto", True)
    shown(tab)
    assert tab.locator("#film").is_visible()
    for name in ("pulse", "frame"):
        before = tab.evaluate(f"link.new_words.words?.look.{name} ?? link.answer.words.look.{name}")
        tab.click(f"[data-play={name}]")
        tab.wait_for_function(
            f"link.new_words.words && link.new_words.words.look.{name} !== {before}"
        )
        tab.click(f"[data-play={name}]")


def test_no_click_is_lost_however_quick_or_slow_it_is(tabs, address):
    tab = tabs(address)
    for row in (2, 9, 4, 11):
        click_map(tab, "depth_m", row, row + 1)
        tab.wait_for_timeout(60)  # a person's quick second click comes within 260 ms
    wait_for_title(tab, "histogram", "startsWith('row 11, column 12')")
    tab.mouse.down()  # on the last pixel: no second click, but a long one
    tab.wait_for_timeout(600)
    tab.mouse.up()
    click_map(tab, "depth_m", 5, 6)
    wait_for_title(tab, "histogram", "startsWith('row 5, column 6')")


def test_the_number_under_the_mouse_follows_a_change(tabs, address):
    tab = tabs(address)
    click_map(tab, "depth_m", 3, 12)
    told = "document.getElementById('pixel').textContent"
    tab.wait_for_function(f"{told}.includes('threshold 2 pixels')")
    tab.evaluate("write('threshold', 5), ask()")
    tab.wait_for_function(f"{told}.includes('threshold 5 pixels')")


def test_back_undoes_a_change_and_the_theme_stays(tabs, address):
    tab = tabs(address)
    for name, value in (("threshold", 4), ("window", 20), ("coincidence", False)):
        put(tab, name, value)
        shown(tab)
    asks(tab, tab.go_back)
    shown(tab)
    assert tab.is_checked("[name=coincidence]")
    assert tab.input_value("[name=window]") == "20"
    asks(tab, tab.go_back)
    shown(tab)
    assert tab.input_value("[name=window]") == "16" and tab.input_value("[name=threshold]") == "4"
    assert number(tab, "mean threshold") == ["4.00 pixels"]
    asks(tab, tab.go_forward)
    shown(tab)
    assert tab.input_value("[name=window]") == "20"
    theme = "document.documentElement.dataset.theme"
    before = tab.evaluate(theme)
    tab.click("#theme")
    tab.reload()
    shown(tab)
    assert tab.evaluate(theme) != before
    assert tab.input_value("[name=window]") == "20"


def test_uploads(tabs, address, tmp_path):
    tab = tabs(address)
    depth, bad = tmp_path / "depth.png", tmp_path / "<b>.png"
    Image.fromarray(np.full((64, 64), 3000, np.uint16)).save(depth)
    Image.new("L", (64, 64), 9).save(bad)
    bring(tab, "depth", bad)
    assert re.search("<b>.png.*8 bit", refused(tab))
    bring(tab, "depth", depth)
    shown(tab)
    assert "truth 3.00 m" in figure_title(tab, "histogram")
    assert "depth.png: reflectivity 0.4 everywhere" in tab.locator("#notes").text_content()
    right = (
        "[...document.querySelectorAll('.numbers')].map((one) => one.scrollWidth - one.clientWidth)"
    )
    assert tab.evaluate(right) == [0, 0]  # nothing is cut
    np.savez(tmp_path / "two.npz", near=np.full((8, 8), 2.0), far=np.full((8, 8), 6.0))
    bring(tab, "depth", tmp_path / "two.npz")
    assert "two.npz: has the arrays of two dimensions near, far" in refused(tab)
    suggested = "[...document.querySelectorAll('#parts option')].map((one) => one.value)"
    assert tab.evaluate(suggested) == ["near", "far"]
    put(tab, "channel", "far")
    shown(tab)
    assert "truth 6.00 m" in figure_title(tab, "histogram")
    put(tab, "channel", "")
    bring(tab, "depth", depth)
    shown(tab)
    opacity = "getComputedStyle(document.querySelector('[data-upload=sun]')).opacity"
    assert tab.evaluate(opacity) == "1"  # a file can be chosen
    tab.reload()
    shown(tab)
    assert "truth 3.00 m" in figure_title(tab, "histogram")
    tab.goto(f"{address}?scene=upload&uploads=99")
    shown(tab)
    assert "Scene: the file is not here any more" in tab.locator("#ignored").text_content()
    tab.go_back()
    shown(tab)
    tab.click("[data-do=reset]")
    shown(tab)
    assert tab.input_value("#u-depth") == ""
    put(tab, "scene", "upload")
    tab.wait_for_function(
        "document.getElementById('refused').textContent.includes('choose a depth picture')"
    )


def test_each_kind_of_file_is_used_as_soon_as_it_is_chosen(tabs, address, tmp_path):
    """Unless it is too large: then it does not leave the page."""
    tab = tabs(address)
    grey, pulse, large = (tmp_path / name for name in ("grey.png", "pulse.csv", "large.png"))
    Image.new("L", (64, 64), 128).save(grey)
    pulse.write_text("time_ps,density\n0,0\n250,1\n500,0\n", encoding="utf-8")
    large.write_bytes(bytes(33 << 20))
    for kind, path, using in (
        ("sun", grey, {"sun": "picture", "pulse": "Gaussian", "scene": "five-objects"}),
        ("pulse", pulse, {"sun": "picture", "pulse": "file", "scene": "five-objects"}),
    ):
        bring(tab, kind, path)
        shown(tab)
        assert {name: tab.input_value(f"[name={name}]") for name in using} == using
    assert all(word in tab.locator("#status").text_content() for word in ("picture", "file"))
    bring(tab, "colour", grey)
    assert "choose a depth picture" in refused(tab)
    tab.click("[data-do=reset]")
    shown(tab)
    ordered = tab.evaluate("orders")
    bring(tab, "depth", large)
    assert refused(tab) == "large.png: holds 33 MiB, must hold at most 32"
    tab.wait_for_timeout(1000)  # in which it would be read
    assert tab.evaluate("orders") == ordered
    assert tab.input_value("[name=scene]") == "five-objects"
    put(tab, "threshold", 4)
    shown(tab)
    assert tab.locator("#refused").is_hidden()


def test_a_slider_and_its_field_move_together_and_a_film_stops(tabs, address):
    tab = tabs(f"{address}?frames=2")
    tab.locator("[data-slides=threshold]").evaluate(
        "(one) => { one.value = 7; one.dispatchEvent(new Event('input', {bubbles: true})); }"
    )
    shown(tab)
    assert tab.input_value("[name=threshold]") == "7"
    assert number(tab, "mean threshold") == ["7.00 pixels"]
    put(tab, "threshold", 5)
    assert tab.input_value("[data-slides=threshold]") == "5"
    shown(tab)
    tab.evaluate("window.mark = 'the same page'")
    for name in ("window", "threshold"):
        tab.focus(f"[name={name}]")
        assert tab.locator("#about").text_content() == CONTROL[name].sentence
    tab.keyboard.press("Enter")
    keep = tab.locator("[data-do=keep_a]")
    keep.hover()
    assert tab.locator("#about").text_content() == keep.get_attribute("data-says")
    assert tab.evaluate("window.mark") == "the same page"
    button = tab.locator("[data-play=pulse]")
    for pressed in ("true", "false"):
        button.click()
        assert button.get_attribute("aria-pressed") == pressed
    ordered = tab.evaluate("orders")
    tab.wait_for_timeout(1000)  # two steps of a film
    assert tab.evaluate("orders") == ordered


def test_what_the_server_tells_stands_in_its_place(tabs, address):
    """Unless it is of an earlier question; a field in which somebody types keeps what was typed. So
    does its progress: its share, if that is known, and the seconds since the question.
    """
    tab = tabs(address)
    tab.focus("[data-look=pulse]")
    before = tab.input_value("[data-look=pulse]")
    told = {
        "story": "a story",
        "where": "look here",
        "a_says": "A: as before",
        "notes": ["first note", "second note"],
        "wastes": ["first waste", "second waste"],
        "meaning": [["size", "8 x 8"], ["light", "50 klux"]],
        "look": {"row": 5, "col": 6, "pulse": 7, "frame": 0, "which": "B"},
    }
    tell = "([words, age]) => { link.new_words = {number: asked - age, words: {...link.answer.words, ...words}}; }"
    tab.evaluate(tell, [told, 0])
    tab.evaluate(tell, [told | {"story": "an old story"}, 1])
    assert tab.locator("#a-says").text_content() == told.pop("a_says")
    for name in ("story", "where"):
        assert tab.locator(f"#{name}").text_content() == told[name]
    assert tab.locator("#notes").text_content() == "first note\nsecond note"
    assert tab.locator("#wastes li").all_text_contents() == told["wastes"]
    rows = "[...document.querySelectorAll('#meaning tbody tr')].map((r) => [...r.children].map((c) => c.textContent))"
    assert tab.evaluate(rows) == told["meaning"]
    heads = "(part) => [...new Set([...document.querySelectorAll(`#numbers ${part} th`)].map((one) => one.scope))]"
    assert [tab.evaluate(heads, part) for part in ("thead", "tbody")] == [["col"], ["row"]]
    look = [tab.input_value(f"[data-look={name}]") for name in ("row", "col", "pulse")]
    assert look == ["5", "6", before]
    tell = "([share, age]) => { link.progress = {number: asked - age, stage: 'depth', share}; }"
    shares = "[$('#progress').hasAttribute('value'), $('#progress').value]"
    for share, age, expected in ((0.25, 0, [True, 0.25]), (0.75, 1, [True, 0.25])):
        tab.evaluate(tell, [share, age])
        assert tab.evaluate(shares) == expected
    tab.evaluate(tell, [0, 0])
    assert tab.evaluate(shares)[0] is False  # how far it is, is not known
    tab.evaluate("state('asked'); began = performance.now() - 500_000")
    tab.wait_for_function("$('#status').textContent.startsWith('computing: depth, 5')")
    said = r"computing: depth, 5\d\d s\. Any change overtakes it\."
    assert re.fullmatch(said, tab.locator("#status").text_content())
    assert tab.locator("#progress").is_visible()
    check = "([text, bad, age]) => { link.rtl_check = {number: asked - age, text, bad}; }"
    for text, bad, age in (("RTL: 5%", False, 0), ("It differs.", True, 0), ("Old.", False, 1)):
        tab.evaluate(check, [text, bad, age])
        verdict = tab.locator("#rtl:not([hidden])")
        assert verdict.text_content() == (text if age == 0 else "It differs.")
        assert ("bad" in (verdict.get_attribute("class") or "")) == (bad or age == 1)
    tab.evaluate("document.body.removeAttribute('data-earlier')")
    tab.evaluate("link.refusal = {number: asked, message: 'not so', control: 'window'}")
    nothing = "Nothing is shown: these settings are not possible."
    assert tab.locator("#status").text_content() == nothing
    assert tab.locator(".illegal [name=window]").count() == tab.locator(".illegal").count() == 1
    put(tab, "threshold", 3)
    shown(tab)
    assert tab.locator(".illegal").count() == 0
    gone = ("#progress", "#film", "[data-do=drop_a]", "#rtl")
    assert [tab.locator(name).is_hidden() for name in gone] == [True] * 4


def test_quick_changes_of_one_control_are_one_step_of_the_browser(tabs, address):
    """Slow ones are several, and so are changes of two controls; what changes nothing is none."""
    tab = tabs(address)
    steps = [tab.evaluate("history.length")]
    quick, slow = "stepped.time = performance.now() + 1e9", "stepped.time = -1e9"
    for name, value, pace in (
        ("threshold", 3, slow),
        ("threshold", 4, quick),
        ("threshold", 5, slow),
        ("window", 20, quick),
        ("window", 20, slow),
    ):
        tab.evaluate(pace)
        tab.evaluate(
            "([name, value]) => { write(name, value); changed = name; ask(); }", [name, value]
        )
        shown(tab)
        steps.append(tab.evaluate("history.length"))
    assert [after - before for before, after in pairwise(steps)] == [1, 0, 1, 1, 0]


def test_back_forgets_a_file_that_was_refused(tabs, address, tmp_path):
    tab = tabs(address)
    depth, bad = tmp_path / "depth.png", tmp_path / "bad.png"
    Image.fromarray(np.full((64, 64), 3000, np.uint16)).save(depth)
    bad.write_bytes(b"no picture")
    bring(tab, "depth", depth)
    shown(tab)
    put(tab, "threshold", 4)
    shown(tab)
    bring(tab, "depth", bad)
    assert "bad.png" in refused(tab)
    asks(tab, tab.go_back)
    shown(tab)
    assert "truth 3.00 m" in figure_title(tab, "histogram")


def test_a_link_with_mistakes_says_so_and_the_rest_counts(tabs, address):
    tab = tabs(f"{address}?threshold=hello&window=8&moon=1&scene=mars&gating=perhaps")
    ignored = tab.locator("#ignored").text_content()
    assert "Threshold = 'hello': must be a number from 1 to 64" in ignored
    assert all(
        name in ignored
        for name in ("moon: unknown setting", "Scene = 'mars'", "Gating = 'perhaps'")
    )
    assert tab.input_value("[name=window]") == "8" and tab.input_value("[name=threshold]") == "2"
    assert "; 8 = 0.5 ns" in tab.locator("[data-control=window] small").text_content()
    assert (
        tab.locator("#ignored").is_visible() and "window 8" in tab.locator("#status").text_content()
    )


def test_settings_without_an_effect_are_disabled(tabs, address):
    tab = tabs(address)

    def enabled(*names):
        return [tab.locator(f"#controls [name={name}]").is_enabled() for name in names]

    assert enabled("threshold", "gate_start", "far_m", "shade_klux") == [True, False, False, False]
    for name, value in (("gating", True), ("scene", "two-returns"), ("sun", "left half")):
        put(tab, name, value)
    assert enabled("gate_start", "far_m", "shade_klux", "gate_step") == [True, True, True, False]
    put(tab, "gate_every", 5)
    assert enabled("gate_step", "gate_steps") == [False, True]
    put(tab, "gate_steps", 2)
    put(tab, "auto", True)
    assert enabled("gate_step", "threshold", "window") == [True, True, True]
    put(tab, "coincidence", False)
    assert enabled("auto", "threshold", "window") == [False, False, False]
    assert not tab.locator("[data-slides=threshold]").is_enabled()
    assert enabled("coincidence", "search_pulses") == [True, False]
    put(tab, "format", "counts")
    assert enabled("coincidence", "search_pulses") == [False, True]
    shown(tab)


def test_on_a_phone_the_settings_fold_away_and_in_the_dark_the_page_is_dark(tabs, address):
    tab = tabs(address)
    tab.set_viewport_size({"width": 390, "height": 844})
    wide = """() => {
      const parts = [...document.querySelectorAll('main, [data-map], .details > div')];
      return [document.documentElement.scrollWidth, ...parts.map((one) => one.getBoundingClientRect().right)];
    }"""
    assert max(tab.evaluate(wide)) <= 390
    assert tab.locator("[name=threshold]").is_hidden()
    tab.locator("#fold").focus()
    tab.keyboard.press("Enter")
    tab.fill("[name=threshold]", "4")
    shown(tab)
    assert number(tab, "mean threshold") == ["4.00 pixels"] and max(tab.evaluate(wide)) <= 390
    tab.click("#fold")
    assert tab.locator("[name=threshold]").is_hidden()
    background = "getComputedStyle(document.body).backgroundColor"
    before = tab.evaluate(background)
    tab.click("#theme")
    assert tab.evaluate(background) != before
    click_map(tab, "depth_m", 3, 12)
    wait_for_title(tab, "histogram", "startsWith('row 3, column 12')")


def test_a_phone_lays_the_pages_out_in_its_own_width(browser, address, tmp_path):
    """A phone takes a page for 980 pixels wide, and shows it small, unless the page says more."""
    view = Explorer().run(check_settings({"rows": 8, "cols": 8, "pulses": 2})).view(0)
    write_report(tmp_path / "report.html", "a run", [view])
    context = browser.new_context(viewport={"width": 390, "height": 844}, is_mobile=True)
    tab = context.new_page()
    for page in (address, f"file://{tmp_path}/report.html"):
        tab.goto(page)
        tab.wait_for_function("document.getElementById('story')?.textContent.length > 0")
        assert tab.evaluate("window.innerWidth") == 390
    context.close()


def test_two_settings_side_by_side(tabs, address):
    tab = tabs(address)
    tab.click("[data-do=keep_a]")
    tab.wait_for_selector("body[data-ab]")
    put(tab, "threshold", 5)
    shown(tab)
    assert (
        figure_title(tab, "map_a_depth_m") == "A: depth, m"
        and figure_title(tab, "map_depth_m") == "B: depth, m"
    )
    assert (
        tab.locator("[data-map=map_a_error_m]").is_visible()
        and tab.locator("[data-map=map_truth_m]").is_hidden()
    )
    assert number(tab, "mean threshold") == ["5.00 pixels", "2.00 pixels"]
    assert number(tab, "link load") == number(tab, "stream load")  # without a slower link
    tab.set_viewport_size({"width": 390, "height": 844})
    for name in ("depth_m", "error_m", "drops"):
        a, b = (
            tab.locator(f"[data-map={prefix}{name}]").bounding_box()
            for prefix in ("map_a_", "map_")
        )
        assert a["y"] == b["y"] and a["x"] < b["x"]
    tab.set_viewport_size({"width": 1280, "height": 800})
    tab.select_option("[data-look=which]", "A")
    wait_for_title(tab, "timeline", "endsWith('needs 2 pixels')")
    put(tab, "cols", 24)
    shown(tab)
    tab.fill("[data-look=col]", "20")  # A has only 16 columns
    wait_for_title(tab, "histogram", "includes('column 15')")
    tab.click("[data-do=drop_a]")
    tab.wait_for_selector("body:not([data-ab])")
    assert (
        tab.locator("[data-map=map_a_depth_m]").is_hidden()
        and tab.locator("[data-map=map_truth_m]").is_visible()
    )


def test_what_is_saved(tabs, address):
    tab = tabs(address)
    toml = ("toml", "coincid.toml", b"[sensor]")
    csv, png = ("csv", "events.csv", b"subgroup,pulse"), ("png", "depth.png", b"\x89PNG")
    for kind, name, start in (toml, toml, csv, png):
        with tab.expect_download() as download:
            tab.select_option("#save", kind)
        assert download.value.suggested_filename == name
        with open(download.value.path(), "rb") as file:
            assert file.read(16).startswith(start)
    tab.select_option("#save", "command")
    tab.wait_for_selector("#said:not([hidden])")
    assert (
        tab.locator("#said").text_content()
        == "coincid explore --set pulses=20 --set rows=16 --set cols=16"
    )


def test_a_server_that_was_killed_and_started_again(tabs):
    tabs.forgiven = ("ERR_CONNECTION", "WebSocket", "onnection")
    with explorer(*SMALL) as (process, address):
        tab = tabs(address)
        put(tab, "threshold", 4)
        shown(tab)
        process.send_signal(signal.SIGKILL)
        process.wait()
        tab.wait_for_selector("#gone:not([hidden])")
    with explorer(*SMALL, port=address.rstrip("/").rpartition(":")[2]):
        tab.wait_for_function("document.getElementById('gone')?.hidden === true && " + SHOWN)
        assert number(tab, "mean threshold") == ["4.00 pixels"]


DRAWN = """() => {
  const {histogram, timeline, cursor, around} = all;
  const sources = {cursor, around, bars: histogram.bars, returns: histogram.returns, truth: histogram.truth,
    edges: timeline.edges, windows: timeline.windows, gate: timeline.gate, fill: timeline.fill, light: timeline.light};
  const columns = ({data}) => Object.fromEntries(Object.entries(data).map(([name, values]) => [name, [...values]]));
  return Object.fromEntries(Object.entries(sources).map(([name, source]) => [name, columns(source)]));
}"""


def assert_same_columns(found, expected):
    assert found.keys() == expected.keys()
    for name, values in expected.items():
        values = np.asarray(values).tolist()
        numbers = not any(isinstance(value, str) for value in values)
        assert found[name] == (pytest.approx(values, rel=1e-6) if numbers else values), name


TOLD = (  # of a pixel below the maps: words, attribute of the view, digits, unit
    ("truth", "truth_m", 2, " m"),
    ("depth", "depth_m", 2, " m"),
    ("error", "error_m", 3, " m"),
    ("confidence", "confidence", 2, ""),
    ("threshold", "threshold", 0, " pixels"),
    ("drops of the subgroup", "drops", 0, ""),
    ("reflectivity", "reflectivity", 2, ""),
    ("signal", "signal", 3, ""),
    ("background", "background", 3, ""),
    ("estimated signal", "estimated", 3, ""),
    ("±", "estimated_error", 3, ""),
    ("lowest possible error", "bound_mm", 1, " mm"),
)


def told_of_pixel(view, row, col):
    """Return what is told of a pixel below the maps."""
    told = {}
    for words, name, digits, unit in TOLD:
        value = float(np.float32(getattr(view, name)[row, col]))
        told[words] = f"{words} {'none' if np.isnan(value) else f'{value:.{digits}f}{unit}'}"
    told["confidence"] += f" ({SENTENCES[Reason(view.reason[row, col])]})"
    told["signal"] += f" and {told.pop('background')} photons per pulse"
    told["estimated signal"] += f" {told.pop('±')}"
    where = f"row {row}, column {col}, subgroup {view.subgroup_of(row, col)}"
    return " · ".join([where, *told.values()])


def assert_pulses_play(tab, pulse, pulses):
    """Let the pulses of a report play, by a clock of our own; they begin again after the last."""
    tab.evaluate("""() => {
      window.setInterval = (step, ms) => { window.step = step; return 7; };
      window.clearInterval = (timer) => { window.ended = timer; };
    }""")
    for pressed in ("true", "false"):
        tab.click("#play")
        assert tab.get_attribute("#play", "aria-pressed") == pressed
        if pressed == "true":
            for _ in range(pulses + 1):
                pulse = (pulse + 1) % pulses
                tab.evaluate("step()")
                assert tab.input_value("[data-look=pulse]") == str(pulse)
                assert f", pulse {pulse}:" in tab.evaluate("all.timeline.figure.title.text")
    assert tab.evaluate("ended") == 7


CELLS = """(id) => [...document.getElementById(id).rows].map((row) =>
  [...row.cells].map((cell) => [cell.textContent, cell.scope]))"""


def assert_described(tab, view, row, col, subgroup, pulse):
    """Check the titles and scales of a pixel's figures, and the words and tables of its frame."""
    histogram, timeline = HistogramFigure(), TimelineFigure()
    histogram.show(view, row, col)
    timeline.show(view, subgroup, pulse)
    titles = "[all.histogram, all.timeline].map((one) => one.figure.title.text)"
    assert tab.evaluate(titles) == [one.figure.title.text for one in (histogram, timeline)]
    spans = "[all.histogram.figure.y_range, all.histogram.subgroup_range]"
    expected = [
        (one.start, one.end) for one in (histogram.figure.y_range, histogram.subgroup_range)
    ]
    for found, span in zip(
        tab.evaluate(f"{spans}.map((one) => [one.start, one.end])"), expected, strict=True
    ):
        assert found == pytest.approx(span)
    assert tab.text_content("#story") == story(view)
    tables = {
        "objects": (OBJECT_HEADS, object_table(view)),
        "numbers": (("", ""), number_rows(view)),
    }
    for name, (heads, rows) in tables.items():
        first, *others = tab.evaluate(CELLS, name)
        assert first == [[head, "col"] for head in heads]
        assert [[text for text, _ in line] for line in others] == rows
        assert [line[0][1] for line in others] == ["row"] * len(rows)


def test_a_report_looks_up_what_the_explorer_draws(tabs, tmp_path):
    """Of pixels from each 32 of a large subgroup, in any pulse and frame."""
    size = {"rows": 16, "cols": 32, "subgroup": "8x16", "fifo_depth": 2, "threshold": 1}
    gate = {"gating": True, "gate_start": 10, "gate_len": 90, "gate_every": 2}
    steps = {"gate_step": 20, "gate_steps": 3}
    values = size | gate | steps | {"pulses": 6, "frames": 2, "klux": 80.0}
    explored = Explorer().run(check_settings(values))
    views = [explored.view(number) for number in range(2)]
    write_report(tmp_path / "report.html", "a run", views)
    tab = tabs(f"file://{tmp_path}/report.html", ready=False)
    tab.wait_for_function("document.getElementById('story')?.textContent.length > 0")
    for subgroup, frame, pulse in ((0, 0, 0), (1, 1, 5), (2, 1, 3), (3, 0, 2)):
        view = views[frame]
        hits = view.events.maps(subgroup, 128).sum(axis=0)
        inside = 32 * subgroup + int(hits[32 * subgroup :][:32].argmax())
        assert hits[inside]
        row, col = subgroup // 2 * 8 + inside // 16, subgroup % 2 * 16 + inside % 16
        assert view.subgroup_of(row, col) == subgroup
        tab.select_option("[data-look=frame]", str(frame))
        for name, value in {"row": row, "col": col, "pulse": pulse}.items():
            tab.fill(f"[data-look={name}]", str(value))
        wait_for_title(tab, "timeline", f"startsWith('subgroup {subgroup}, pulse {pulse}:')")
        period = view.period(subgroup, pulse)
        assert len(period.tick) and len(period.windows.start)
        names = ["bars", "returns", "truth", "edges", "windows", "gate", "fill", "cursor", "around"]
        columns = (
            *histogram_columns(view, row, col),
            *period_columns(view, period),
            *cursor_columns(view, row, col),
        )
        expected = dict(zip(names, columns, strict=True)) | {"light": light_columns(view, subgroup)}
        found = tab.evaluate(DRAWN)
        assert found.keys() == expected.keys()
        for name, one in expected.items():
            assert_same_columns(found[name], one)
        for at in ((row, col), (7, 16), (15, 31), (0, 0)):
            tab.evaluate("([row, col]) => overMap(all.pictures, {x: col + 0.4, y: row - 0.4})", at)
            assert tab.text_content("#pixel") == told_of_pixel(view, *at)
        tab.evaluate(
            "[[0, 32], [16, 0]].map(([row, col]) => overMap(all.pictures, {x: col, y: row}))"
        )
        assert tab.text_content("#pixel").startswith("row 0, column 0, ")
        assert_described(tab, view, row, col, subgroup, pulse)
    # with all events in one bin, both scales are larger than the smallest one
    tab.evaluate("(frame) => { all.frames[frame].events.data.bin.fill(5); show(false); }", frame)
    of_subgroup = len(view.events.maps(subgroup, 128))
    assert 3 < hits[inside] < of_subgroup
    for name, most in (("figure.y_range", hits[inside]), ("subgroup_range", of_subgroup)):
        span = tab.evaluate(f"[all.histogram.{name}.start, all.histogram.{name}.end]")
        assert span == pytest.approx([-0.12 * most, 1.15 * most])
    for written, row in (("99", 15), ("-3", 0), ("2.6", 3), ("", 0)):
        tab.fill("[data-look=row]", written)
        title = tab.evaluate("all.histogram.figure.title.text")
        assert title.startswith(f"row {row}, column {col}:")
    assert_pulses_play(tab, pulse, 6)


def test_reports_and_a_notebooks_pages_need_no_server(tabs, tmp_path):
    explored = Explorer().run(
        check_settings({"rows": 16, "cols": 16, "pulses": 10, "gating": True, "frames": 2})
    )
    views = [explored.view(k) for k in range(2)]
    write_report(tmp_path / "report.html", "a <run>", views)
    tab = tabs(f"file://{tmp_path}/report.html", ready=False)
    tab.set_viewport_size({"width": 390, "height": 844})
    assert tab.evaluate("document.documentElement.scrollWidth") <= 390
    assert tab.locator("header .fill").bounding_box()["width"] > 300
    tab.set_viewport_size({"width": 1280, "height": 800})
    tab.wait_for_function("document.getElementById('story')?.textContent.length > 0")
    click_map(tab, "truth_m", 9, 4)
    wait_for_title(tab, "histogram", "startsWith('row 9, column 4')")
    tab.select_option("[data-look=frame]", "1")
    tab.fill("[data-look=pulse]", "3")
    wait_for_title(tab, "timeline", "startsWith('subgroup 2, pulse 3')")
    period = views[1].timeline.period(2, 3)
    edges, windows = tab.evaluate(
        "[all.timeline.edges.data.y.length, all.timeline.windows.data.count]"
    )
    assert edges == len(period.tick) and windows == period.windows.count.tolist()
    assert tab.evaluate("all.timeline.fill.data.fill.slice(0, -1)") == period.fill.tolist()
    assert tab.evaluate("all.histogram.bars.data.pixel") == views[1].histogram(9, 4)[0].tolist()
    coincid.simulate(None, "flat:5,0.5", rows=8, cols=8, pulses=5).timeline(0, 3).save(
        tmp_path / "period.html"
    )
    notebook = tmp_path / "notebook.html"
    run = coincid.simulate(None, "flat:5,0.5", rows=8, cols=8, pulses=5)
    notebook.write_text(run.plot()._repr_html_(), encoding="utf-8")
    tab = tabs(notebook.as_uri(), ready=False)
    for width in (1280, 700):
        tab.set_viewport_size({"width": width, "height": 800})
        tab.wait_for_function("""() => {
          const frame = document.querySelector("iframe");
          const page = frame.contentDocument;
          const shown = page.getElementById("fifo") || page.querySelector(".key");
          return shown && frame.clientHeight >= page.documentElement.scrollHeight;
        }""")
    tab = tabs(f"file://{tmp_path}/period.html", ready=False)
    tab.wait_for_function("Bokeh.documents[0]?.get_model_by_name('timeline')")
    assert figure_title(tab, "timeline") == "subgroup 0, pulse 3: a window needs 2 pixels"
