# SPDX-License-Identifier: Apache-2.0
"""Serves one browser tab of the explorer: the page sends settings, a thread computes, the views
show the newest result.

The script of the page sends a numbered request at every keystroke, and shows an answer only if it
has the number of the newest request.
"""

import base64
import json
from collections.abc import Callable
from functools import cache, partial
from pathlib import Path
from typing import Any

from attrs import evolve
from bokeh.core.properties import Any as AnyValue
from bokeh.core.properties import Dict, String
from bokeh.document import Document
from bokeh.events import DocumentReady
from bokeh.model import DataModel
from bokeh.models import CustomJS
from jinja2 import Environment, FileSystemLoader, Template

from ...model.contract.parameters import Sensor
from ...model.scenes.conventions import DEPTH_FILES, DEPTH_FILES_TOLD
from ...model.shared.errors import InputError, check_integer
from ..explain import meaning, warnings
from ..show.assets import FILES, SHOW
from ..show.figures import FATE_MARKS, REASON_MARKS, VERDICT_MARKS, Views
from ..show.frame_content import FrameView
from ..show.words import OBJECT_HEADS, number_rows, object_table, story, where_to_look
from . import messages, out
from .control_values import (
    Settings,
    check_settings,
    command,
    control_of,
    query,
    told_by_labels,
    values_of_text,
)
from .controls import CONTROL, CONTROLS, DEFAULTS, GROUPS
from .messages import LookedAt, Words, sent
from .stages import Explored, Explorer, Runner, check_on_rtl
from .uploads import USED_BY, Kept, Uploads, parts_of

UPLOADS = "uploads"  # in the address of a page: number of its uploads (`Kept`)
FIRST_LOOK = LookedAt(row=14, col=10, pulse=0, frame=0, which="B")
# of its fields on the page
LOOK_LABELS = {"row": "Row", "col": "Column", "pulse": "Pulse", "frame": "Frame"}
TRIES = (  # name, settings, what to look for
    ("1 Every photon", {"coincidence": False}, "Without coincidence, sunlight fills the FIFOs, and later events are dropped."),
    ("2 Threshold 2", {"threshold": 2}, "Two pixels must fire within 1 ns: most sunlight is gone, dark objects are still there."),
    ("3 Threshold 5", {"threshold": 5}, "Nearly all sunlight is gone, but many pixels of the dark object are wrong: it seldom fires five pixels."),
    ("4 Controller", {"auto": True, "frames": 8}, "Every subgroup gets its own threshold. Play the frames to see how the thresholds settle."),
    ("5 Peaks only", {"threshold": 2, "method": "maximum"},
     "The same events, but depth is the highest bin of each pixel's histogram, as in the paper."),
)  # fmt: skip


class Link(DataModel):  # type: ignore[misc]  # Bokeh comes with an extra
    """What page and server share: the newest message of each kind (`messages.py`)."""

    opened = Dict(String, AnyValue)
    question = Dict(String, AnyValue)
    order = Dict(String, AnyValue)
    answer = Dict(String, AnyValue)
    refusal = Dict(String, AnyValue)
    new_words = Dict(String, AnyValue)
    progress = Dict(String, AnyValue)
    rtl_check = Dict(String, AnyValue)
    command_line = Dict(String, AnyValue)
    look_refusal = Dict(String, AnyValue)
    parts = Dict(String, AnyValue)
    download = Dict(String, AnyValue)


@cache
def _template() -> Template:
    here = Path(__file__).parent
    return Environment(loader=FileSystemLoader([here, SHOW]), autoescape=False).get_template(
        "page.html"
    )


class Page:
    """The page in one browser tab."""

    def __init__(
        self,
        doc: Document,
        start: dict[str, Any],
        uploads: Uploads,
        kept: Kept,
        ignored: str = "",
    ) -> None:
        """Make the page of a document.

        start: values that differ from their defaults. uploads: with which it begins; kept: those of
        all pages. ignored: message about the link with which the page was opened.
        """
        self.doc = doc
        self.views = Views(compared=True)
        opened = messages.Opened(values=DEFAULTS | start, defaults=DEFAULTS, ignored=ignored)
        self.link = Link(opened=sent(opened))
        self.uploads = uploads
        self._tell_parts()
        self._kept = kept
        self.bad_uploads: dict[str, str] = {}  # error of each bad file, by kind
        self.look = FIRST_LOOK
        self._shown: Explored | None = None
        self.a: Explored | None = None
        self.number = 0  # of the newest question
        self._downloads = 0
        self._explorer = Explorer()
        self._runner = Runner(lambda *what: self._soon(self._computed, *what))
        self._checker = Runner(lambda *what: self._soon(self._checked, *what))
        self._run: int | None = None  # number of the run that answers the newest question
        self.views.on_pick(self._picked)
        self.link.on_change(
            "question", lambda attribute, old, new: self._asked(messages.Question(**new))
        )
        self.link.on_change(
            "order", lambda attribute, old, new: self._ordered(messages.order_of(new))
        )
        self.views.histogram.figure.tags = [self.link]  # so that the link is a part of the document
        with doc.models.freeze():
            for root in self.views.roots():
                doc.add_root(root)
        doc.title = "Coincid explorer"
        doc.template = _template()
        doc.template_variables.update(_variables(self.views))
        doc.config.notify_connection_status = False
        doc.config.reconnect_session = False
        doc.js_on_event(DocumentReady, CustomJS(args={"link": self.link}, code="explorer(link)"))
        doc.js_on_event("connection_lost", CustomJS(code="gone()"))
        doc.on_session_destroyed(lambda context: self.close())

    def close(self) -> None:
        self._runner.close()
        self._checker.close()

    def _soon(self, call: Callable[..., None], *what: object) -> None:
        """Call in the document's thread."""
        self.doc.add_next_tick_callback(partial(call, *what))

    @property
    def shown(self) -> Explored:
        """Return the result in the views. Use it only when there is one."""
        assert self._shown is not None
        return self._shown

    # Settings

    def _asked(self, question: messages.Question) -> None:
        self.number = question.number
        self._checker.cancel()
        try:
            self._check_uploads(question.values)
            settings = check_settings(values_of_text(question.values), self.uploads)
        except InputError as error:
            self._runner.cancel()
            self._run = None  # the outcome of the run before may be on its way
            self._refuse(error)
            return
        self._run = self._runner.start(lambda progress: self._explorer.run(settings, progress))

    def _check_uploads(self, values: dict[str, str]) -> None:
        """Raise `InputError` if `values` need a file that was refused."""
        for kind, (control, asking) in USED_BY.items():
            if kind in self.bad_uploads and values[control] == asking:
                raise InputError(self.bad_uploads[kind], field=control)

    def _refuse(self, error: InputError) -> None:
        control = control_of(error)
        name = None if control is None else control.name
        self.link.refusal = sent(
            messages.Refusal(number=self.number, message=told_by_labels(error), control=name)
        )

    def _computed(self, run: int, kind: str, outcome: Any) -> None:
        if run != self._run:
            return
        if kind == "progress":
            stage, share = outcome
            self.link.progress = sent(
                messages.Progress(number=self.number, stage=stage, share=share)
            )
        elif kind == "done":
            self._shown = outcome
            config = outcome.settings.config
            self.look = evolve(
                self.look,
                frame=config.frames - 1,
                row=min(self.look.row, config.sensor.rows - 1),
                col=min(self.look.col, config.sensor.cols - 1),
                pulse=min(self.look.pulse, config.pulses - 1),
            )
            self._show()
            self.link.answer = sent(messages.Answer(number=self.number, words=self._words()))
        elif isinstance(outcome, InputError):
            self._refuse(outcome)
        else:
            self._refuse(
                InputError(f"this could not be computed ({type(outcome).__name__}: {outcome})")
            )

    # Views

    def _show(self) -> None:
        self.views.show(self.shown.view(self.look.frame), self._a_view())
        self._point()

    def _a_view(self) -> FrameView | None:
        """Return the frame of A with the current number, or its last one; None without A."""
        return (
            None
            if self.a is None
            else self.a.view(min(self.look.frame, self.a.settings.config.frames - 1))
        )

    def _point(self) -> None:
        """Show the pixel and pulse of `look`; if A has fewer of them, show its last one."""
        look = self.look
        view = (self._a_view() if look.which == "A" else None) or self.shown.view(look.frame)
        row = min(look.row, view.config.sensor.rows - 1)
        col = min(look.col, view.config.sensor.cols - 1)
        pulse = min(look.pulse, view.config.pulses - 1)
        self.views.pick(view, row, col, pulse)

    def _picked(self, row: int, col: int) -> None:
        if self._shown is None:
            return
        sensor = self.shown.settings.config.sensor
        if 0 <= row < sensor.rows and 0 <= col < sensor.cols:
            self.look = evolve(self.look, row=row, col=col)
            self._point()
            self._tell()

    def _tell(self) -> None:
        self.link.look_refusal = sent(messages.LookRefusal(text=""))
        self.link.new_words = sent(messages.NewWords(number=self.number, words=self._words()))

    def _notes(self) -> list[str]:
        """Return what was assumed about uploaded files, and left out of them."""
        uploads = self.shown.settings.uploads
        scene = self.shown.run.scene
        return [uploads.named(told) for told in (*scene.doubts, *scene.notes)]

    def _words(self) -> Words:
        settings = self.shown.settings
        view = self.shown.view(self.look.frame)
        a_view = self._a_view()
        views, heads = ([view], [""]) if a_view is None else ([view, a_view], ["B", "A"])
        run = self.shown.run
        number = self._kept.number_of(settings.uploads)
        changed = query(settings)
        return Words(
            status=f"{_summary(settings)} · {self.shown.seconds:.2f} s, golden model",
            query="&".join(filter(None, (changed, f"{UPLOADS}={number}" if number else ""))),
            uploads=number,
            notes=[*self._notes(), *map(settings.uploads.named, run.light.notes())],
            story=story(view),
            where=where_to_look(view),
            objects=object_table(*views),
            object_heads=[*OBJECT_HEADS[:-1], f"{OBJECT_HEADS[-1]} {heads[0]}".strip(), *heads[1:]],
            numbers=number_rows(*views),
            number_heads=["", *heads],
            ab=self.a is not None,
            a_says=f"A: {_summary(self.a.settings)}" if self.a is not None else "",
            frames=settings.config.frames,
            meaning=[list(row) for row in meaning(settings.config)],
            wastes=[*self._notes(), *warnings(settings.config)],
            spans={c.name: settings.told(c) for c in CONTROLS if c.where and c.kind == "integer"},
            look=self.look,
        )

    # Orders of buttons and fields

    def _ordered(self, order: object) -> None:
        match order:
            case messages.Upload():
                self._upload(order)
                self._tell_parts()
                return
            case messages.Forget():
                self.uploads = Uploads()
                self.bad_uploads = {}
                self._tell_parts()
                return
            case messages.Recall(number=number):
                self.uploads = self._kept.get(number)
                self.bad_uploads = {}
                self._tell_parts()
                return
        if self._shown is None:
            return  # what follows needs a result
        match order:
            case messages.KeepA():
                self._keep_a()
            case messages.DropA():
                self._drop_a()
            case messages.Look(name=name, value=value):
                self._look(name, value)
            case messages.Step(name=name):
                self._step(name)
            case messages.CheckOnRtl():
                self._check()
            case messages.Save(kind=kind):
                self._save(kind)

    def _upload(self, upload: messages.Upload) -> None:
        self.bad_uploads.pop(upload.kind, None)
        content = base64.b64decode(upload.content)
        try:
            self.uploads = self.uploads.with_file(
                upload.kind, upload.name, content, self._kept.folder
            )
        except InputError as error:
            self.bad_uploads[upload.kind] = str(error)

    def _tell_parts(self) -> None:
        self.link.parts = sent(messages.Parts(names=parts_of(self.uploads.depth)))

    def _keep_a(self) -> None:
        self.a = self.shown
        self._show()
        self._tell()

    def _drop_a(self) -> None:
        self.a = None
        self.look = evolve(self.look, which="B")
        self._show()
        self._tell()

    def _look(self, name: str, value: str) -> None:
        config = self.shown.settings.config
        most = {
            "row": config.sensor.rows,
            "col": config.sensor.cols,
            "pulse": config.pulses,
            "frame": config.frames,
        }
        try:
            number: object = int(value)
        except ValueError:  # no number, or one of thousands of digits
            number = value
        try:
            checked: Any = check_integer(name, number, 0, most[name] - 1) if name in most else value
            self.look = evolve(self.look, **{name: checked})
            self._show() if name == "frame" else self._point()
            self._tell()
        except InputError as error:
            self.link.look_refusal = sent(
                messages.LookRefusal(text=error.renamed(LOOK_LABELS[name]))
            )

    def _step(self, name: str) -> None:
        """Go to the next pulse (`name` "pulse") or frame; after the last one comes the first."""
        config = self.shown.settings.config
        if name == "pulse":
            following = (self.look.pulse + 1) % config.pulses
        else:
            following = (self.look.frame + 1) % config.frames
        self._look(name, str(following))

    def _check(self) -> None:
        explored = self.shown
        self._tell_of_rtl("The RTL is being compiled and run; the first time takes about a minute.")
        self._checker.start(lambda progress: check_on_rtl(explored, progress))

    def _checked(self, run: int, kind: str, outcome: Any) -> None:
        if run != self._checker.newest:
            return
        if kind == "progress":
            stage, share = outcome
            self._tell_of_rtl(f"{stage}: {share:.0%}")
        else:
            failed = kind == "failed"
            text = f"The check did not run: {outcome}" if failed else outcome
            self._tell_of_rtl(text, bad=failed or "differ" in text)

    def _tell_of_rtl(self, text: str, bad: bool = False) -> None:
        self.link.rtl_check = sent(messages.RtlCheck(number=self.number, text=text, bad=bad))

    def _save(self, kind: str) -> None:
        if kind == "command":
            told = messages.CommandLine(number=self.number, text=command(self.shown.settings))
            self.link.command_line = sent(told)
            return
        save = out.SAVES[kind]
        self._downloads += 1
        text = base64.b64encode(save.content(self.shown, self.look.frame)).decode()
        file = messages.Download(
            number=self._downloads, name=save.name, type=save.media_type, base64=text
        )
        self.link.download = sent(file)


def _summary(settings: Settings) -> str:
    """Return the most important settings, and all others that differ from their defaults."""
    values = settings.values
    first = [values["scene"], f"{values['klux']:g} klux", f"{values['pulses']} pulses"]
    if values["coincidence"]:
        first.append("controller" if values["auto"] else f"threshold {values['threshold']}")
    else:
        first.append("coincidence off")
    said = ("scene", "klux", "pulses", "coincidence", "auto", "threshold")
    rest = [
        f"{_inside(CONTROL[name].label)} {value}"
        for name, value in settings.changed.items()
        if name not in said
    ]
    return ", ".join(first + rest)


def _inside(label: str) -> str:
    """Return a label as it stands inside a sentence."""
    return label if label[:2].isupper() else label[:1].lower() + label[1:]


def _variables(views: Views) -> dict[str, Any]:
    """Return the variables of the template."""
    return {
        "views_html": Environment(loader=FileSystemLoader(SHOW)).get_template("views.html"),
        "css": FILES["page.css"] + Path(__file__).with_name("page.css").read_text(encoding="utf-8"),
        "tables_js": FILES["tables.js"],
        "page_js": Path(__file__).with_name("page.js").read_text(encoding="utf-8"),
        "maps": [one.figure.name for one in (*views.a_maps, *views.maps)],
        "fates": FATE_MARKS,
        "verdicts": VERDICT_MARKS,
        "reasons": REASON_MARKS,
        "sensor": Sensor(),
        "groups": {group: [c for c in CONTROLS if c.group == group] for group in GROUPS},
        "tries": [(name, json.dumps(values), sentence) for name, values, sentence in TRIES],
        "depth_suffixes": ",".join(DEPTH_FILES),
        "depth_files": DEPTH_FILES_TOLD,
        "saves": {name: one.label for name, one in out.SAVES.items()}
        | {"command": "command that repeats it"},
    }
