# SPDX-License-Identifier: Apache-2.0
"""The messages between the explorer's page and its server: one class each, with every field that
page.js reads or writes.

Each of `MESSAGES` is a property of the model that page and server share (`tab.py: Link`), under its
name here. A side sends a message when it sets the property. `ORDERS` are what an `Order` may ask
for.
"""

from typing import Any

from attrs import asdict, frozen


@frozen(kw_only=True)
class Opened:
    """Server to page, once: what the page begins with."""

    values: dict[str, Any]  # of all controls, by name
    defaults: dict[str, Any]  # of all controls, by name; the page returns to them
    ignored: str  # what could not be used of the link with which the page was opened; "" if nothing


@frozen(kw_only=True)
class Question:
    """Page to server: what do these settings show?"""

    number: int  # one more with every change of a control; only the newest one's answer counts
    values: dict[str, str]  # text of every control, by name


@frozen(kw_only=True)
class Order:
    """Page to server: a button or a field that changes no setting."""

    number: int  # one more with every order, so that the same order again is a change
    name: str  # one of `ORDERS`
    fields: dict[str, Any]  # of its class


@frozen(kw_only=True)
class LookedAt:
    """The place that the views show in detail: one field of the page each."""

    row: int  # of the pixel, from the top
    col: int  # of the pixel, from the left
    pulse: int  # of the frame
    frame: int  # number of the frame
    which: str  # the result: "B" (newest), or "A" (kept)


@frozen(kw_only=True)
class Words:
    """Part of `Answer` and of `NewWords`: the words and numbers beside the views."""

    status: str  # the settings in short, and the time that they took
    query: str  # the changed settings as the query string of a URL; "" if none is
    uploads: int  # number of the set of uploads that counts (`uploads.Kept`)
    notes: list[str]  # what was cropped, masked or assumed of the scene, and of its light
    story: str  # what happens in the pixel and the pulse that are looked at
    where: str  # a hint where to look
    objects: list[list[str]]  # rows of the table of objects
    object_heads: list[str]  # its heads
    numbers: list[list[str]]  # rows of the table of numbers
    number_heads: list[str]  # its heads
    ab: bool  # whether A is kept and compared
    a_says: str  # the settings of A in short; "" without A
    frames: int  # number of frames
    meaning: list[list[str]]  # rows of the table that says what the sensor is: name, value
    wastes: list[str]  # sentences: what was assumed about the scene's file, which settings waste
    spans: dict[str, str]  # range, unit and present value of the controls with integers, by name
    look: LookedAt  # as the views show it now


@frozen(kw_only=True)
class Answer:
    """Server to page: the views show the settings of a question."""

    number: int  # of the question
    words: Words  # beside the views


@frozen(kw_only=True)
class Refusal:
    """Server to page: the settings of a question are not possible."""

    number: int  # of the question
    message: str  # names the control by its label, and what is legal
    control: str | None  # name of the control that is marked; None: not a single one


@frozen(kw_only=True)
class NewWords:
    """Server to page: the views show something else of the same settings, such as another pixel."""

    number: int  # of the newest question
    words: Words  # beside the views


@frozen(kw_only=True)
class Progress:
    """Server to page: how far the answer to a question is."""

    number: int  # of the question
    stage: str  # what is being done
    share: float  # of the stage that is finished, 0 to 1; 0 also if it is not known


@frozen(kw_only=True)
class RtlCheck:
    """Server to page: how far the check of the newest answer on the RTL is, or what it found."""

    number: int  # of the question
    text: str  # a sentence
    bad: bool  # whether the RTL differs, or did not run


@frozen(kw_only=True)
class CommandLine:
    """Server to page: the command that shows the same settings again."""

    number: int  # of the question
    text: str  # the command


@frozen(kw_only=True)
class LookRefusal:
    """Server to page: the place that was named is not in the views."""

    text: str  # why; "" once a place that exists was named


@frozen(kw_only=True)
class Parts:
    """Server to page: what can be chosen in the uploaded depth file."""

    names: list[str]  # of its channels or arrays; empty: nothing


@frozen(kw_only=True)
class Download:
    """Server to page: a file that the browser saves."""

    number: int  # one more with every file, so that the same file again is a change
    name: str  # of the file
    type: str  # its media type
    base64: str  # its content


MESSAGES: dict[str, type] = {
    "opened": Opened,
    "question": Question,
    "order": Order,
    "answer": Answer,
    "refusal": Refusal,
    "new_words": NewWords,
    "progress": Progress,
    "rtl_check": RtlCheck,
    "command_line": CommandLine,
    "look_refusal": LookRefusal,
    "parts": Parts,
    "download": Download,
}


@frozen(kw_only=True)
class Upload:
    """Use a file of the user's."""

    kind: str  # one of `uploads.KINDS`
    name: str  # of the file
    content: str  # of the file, in base64


@frozen(kw_only=True)
class Forget:
    """Forget all uploads."""


@frozen(kw_only=True)
class Recall:
    """Use an earlier set of uploads again."""

    number: int  # `Words.uploads` of an earlier answer


@frozen(kw_only=True)
class KeepA:
    """Keep the result as A, and compare the next ones with it."""


@frozen(kw_only=True)
class DropA:
    """Do not compare any more."""


@frozen(kw_only=True)
class Look:
    """Look at another place."""

    name: str  # field of `LookedAt`
    value: str  # its text


@frozen(kw_only=True)
class Step:
    """Go to the next pulse or frame; after the last one comes the first."""

    name: str  # "pulse" or "frame"


@frozen(kw_only=True)
class CheckOnRtl:
    """Check the words of the result on the RTL."""


@frozen(kw_only=True)
class Save:
    """Make a file of the result, or the command that shows it again."""

    kind: str  # one of `out.SAVES`, or "command"


ORDERS: dict[str, type] = {
    "upload": Upload,
    "forget": Forget,
    "recall": Recall,
    "keep_a": KeepA,
    "drop_a": DropA,
    "look": Look,
    "step": Step,
    "rtl": CheckOnRtl,
    "save": Save,
}


def sent(message: Any) -> dict[str, Any]:
    """Return a message as the dictionary that Bokeh sends."""
    return asdict(message)


def order_of(fields: dict[str, Any]) -> Any:
    """Return what the page ordered, an instance of one of `ORDERS`. fields: of an `Order`."""
    order = Order(**fields)
    return ORDERS[order.name](**order.fields)
