# SPDX-License-Identifier: Apache-2.0
"""The explorer's settings: every control reaches the simulation, and illegal values are refused
with the legal range.
"""

import errno
import io
import os
import re
import shlex
import subprocess
import sys
import tomllib
from pathlib import Path
from urllib.parse import parse_qsl

import h5py
import numpy as np
import OpenEXR
import pytest
from attrs import asdict
from PIL import Image

from coincid.lab.options import OPTIONS
from coincid.lab.outcomes import Run, StageCache
from coincid.model.contract.config import parse_config
from coincid.model.contract.parameters import Sensor
from coincid.model.light.spad import Spad
from coincid.model.scenes.ambient import ambient_klux
from coincid.model.scenes.catalogue import load_scene
from coincid.model.shared.errors import InputError
from coincid.study.explore import control_values, uploads
from coincid.study.explore.control_values import (
    check_settings,
    command,
    config_toml,
    control_of,
    given_settings,
    query,
    told_by_labels,
    values_of_link,
    without_lost_pictures,
)
from coincid.study.explore.controls import CONTROL, CONTROLS
from coincid.study.explore.uploads import BYTES_MAX, NAME_MAX, Kept, Uploads, parts_of

ORIENTATION = 274  # tag of EXIF
OTHER = dict(
    scene="two-targets",
    rows=16,
    cols=64,
    subgroup="4x8",
    minigroup="4x4",
    format="full",
    method="maximum",
    channel="Z",
    missing=7.5,
    fov_deg=60.5,
)


def other_value(control):
    """Return a legal value that is not the default: the next one that the other controls allow."""
    if control.name in OTHER:
        return OTHER[control.name]
    if control.kind == "switch":
        return not control.default
    if control.kind == "choice":
        return next(
            choice
            for choice in control.choices
            if choice not in (control.default, "picture", "upload")
        )
    default = 0 if control.default is None else control.default
    near = default + control.step, default - control.step, default // 2
    return next(value for value in near if _is_legal({control.name: value}))


def _is_legal(values):
    try:
        return bool(check_settings(values))
    except InputError:
        return False


@pytest.mark.parametrize("control", CONTROLS, ids=lambda control: control.name)
def test_every_control_has_a_sentence_and_changes_the_settings(control):
    assert control.sentence.endswith(".")
    value = other_value(control)
    settings = check_settings({control.name: value})
    assert settings.changed == {control.name: value}
    if control.where:
        table, key = control.where
        written = tomllib.loads(config_toml(settings))[table][key]
        assert written == (
            [int(n) for n in value.split("x")]
            if control.name in ("subgroup", "minigroup")
            else value
        )


WITH = {  # control: other settings with which it has an effect
    "near_m": {"scene": "flat"},
    "far_m": {"scene": "two-returns"},
    "reflectivity": {"scene": "flat"},
    "shade": {"scene": "tunnel"},
    "shade_klux": {"sun": "left half"},
    "spad_gate": {"gating": True},
}
OF_FILES = ("unit", "channel", "missing", "fov_deg", "z", "sky_m", "pulse")


@pytest.mark.parametrize(
    "control",
    [one for one in CONTROLS if one.where is None and one.name not in OF_FILES],
    ids=lambda control: control.name,
)
def test_every_control_beside_the_configuration_changes_the_experiment(control):
    before = {"rows": 8, "cols": 8} | WITH.get(control.name, {})
    changed = {control.name: other_value(control)}
    assert check_settings(before | changed).setup().key != check_settings(before).setup().key


@pytest.mark.parametrize(
    "control",
    [one for one in CONTROLS if one.where is None and one.kind in ("integer", "real")],
    ids=lambda control: control.name,
)
def test_both_ends_of_a_range_are_an_experiment_and_what_lies_beyond_is_told(control):
    """The range is that of the control, in its unit; the light takes all of it."""
    small = {"rows": 8, "cols": 8, "pulses": 2, "scene": "flat"}
    for value in (control.low, control.high):
        settings = check_settings(small | {control.name: value})
        setup = settings.setup()
        if control.group == "SPAD":
            assert len(Run(setup, cache=StageCache(1)).edges) >= 0
    told = f" from {control.low} to {control.high}"
    beyond = (control.low - 1, control.high + 1)
    if control.kind == "real":
        told = f" from {control.low:.10g} to {control.high:.10g}"
        beyond = np.nextafter((control.low, control.high), (-np.inf, np.inf)).tolist()
    for value in beyond:
        with pytest.raises(InputError, match=f"{re.escape(told)}$") as refused:
            check_settings({control.name: value})
        assert control_of(refused.value) is control


@pytest.mark.parametrize(
    "control", [one for one in CONTROLS if one.choices], ids=lambda control: control.name
)
def test_every_choice_is_legal(control):
    for choice in control.choices:
        assert check_settings({control.name: choice}).values[control.name] == choice


def test_without_a_change_it_is_the_experiment_of_the_command_line():
    settings = check_settings({})
    told = {name: OPTIONS[name].default for name in settings.values if name in OPTIONS}
    usual = {name: value for name, value in told.items() if value is not None}
    assert len(usual) > 4 and usual.items() <= settings.values.items()
    found, paper = asdict(settings.spad), asdict(Spad())
    assert found == {name: pytest.approx(value) for name, value in paper.items()}
    assert np.all(settings.klux() == 50)
    assert settings.pulse() is None


def test_numbers_in_sentences_are_those_of_the_usual_sensor():
    settings = check_settings({"scene": "flat", "klux": 50.0})
    (kcps,) = set((settings.light(settings.scene()).background_cps / 1000).round().tolist())
    assert f"50 klux give {kcps:.0f} kcps." in CONTROL["dark_kcps"].sentence
    config = check_settings({}).config
    cycle_ns = 1000 / config.clock_mhz
    metres = cycle_ns * 1e-9 * 299_792_458 / 2
    assert f"a cycle is {cycle_ns:g} ns, {metres:.1f} m." in CONTROL["gate_start"].sentence
    assert f"16 ticks are {16 * config.tick_s * 1e9:g} ns." in CONTROL["window"].sentence


# by control: its default, legal range, unit, and the change by a click
NUMBERS = {
    "near_m": (5.0, 0.05, 74.9, "m", 0.5),
    "far_m": (9.0, 0.05, 74.9, "m", 0.5),
    "reflectivity": (0.4, 0, 1, "", 0.05),
    "shade": (0.01, 0, 1, "", 0.01),
    "scale": (1.0, 0.1, 10, "", 0.1),
    "missing": (None, -1e10, 1e10, "", 1),
    "fov_deg": (None, 1e-3, 179, "degrees", 1),
    "sky_m": (10_000.0, 0.05, 10_000, "m", 5),
    "klux": (50.0, 0, 200, "klux", 5),
    "shade_klux": (5.0, 0, 200, "klux", 1),
    "pulses": (100, 1, 10_000, "", 10),
    "frames": (1, 1, 64, "", 1),
    "seed": (1, 0, 2**63 - 1, "", 1),
    "dead_ns": (8.0, 0, 1000, "ns", 1),
    "jitter_ps": (100.0, 0, 500, "ps", 50),
    "dark_kcps": (0.0, 0, 10_000, "kcps", 10),
    "crosstalk_percent": (0.0, 0, 25, "%", 1),
    "afterpulse_percent": (0.0, 0, 50, "%", 1),
}


@pytest.mark.parametrize("name", ["rows", "pulses", "seed", "threshold"])
def test_an_integer_may_be_written_as_a_real_number(name):
    """Also one of the configuration; but no part of one."""
    value = 16 if name == "rows" else 3
    settings = check_settings({"scene": "flat", name: float(value)})
    assert settings.values[name] == value and isinstance(settings.values[name], int)
    with pytest.raises(InputError, match=rf"{name} = {value}.5: must be an integer"):
        check_settings({"scene": "flat", name: value + 0.5})


def test_numbers_beside_the_configuration_have_their_own_ranges_and_units():
    """Those of the configuration have them from its tables."""
    found = {
        one.name: (one.default, one.low, one.high, one.unit, one.step)
        for one in CONTROLS
        if one.kind in ("integer", "real") and one.where is None
    }
    assert found == NUMBERS
    sliders = {one.name: one.slide for one in CONTROLS if one.slide}
    assert sliders == {"threshold": 16, "window": 64, "klux": 100}


def test_properties_of_the_detector_are_in_the_units_of_their_fields():
    spad = check_settings(
        {
            "dead_ns": 12,
            "jitter_ps": 50,
            "dark_kcps": 3,
            "crosstalk_percent": 5,
            "afterpulse_percent": 7,
        }
    ).spad
    found = (
        spad.dead_time_s,
        spad.jitter_fwhm_s,
        spad.dark_cps,
        spad.crosstalk_probability,
        spad.afterpulse_probability,
    )
    assert found == pytest.approx((12e-9, 50e-12, 3000, 0.05, 0.07))


ABOUT_A_FILE = {
    "unit": "cm",
    "channel": "Z",
    "scale": 2.0,
    "missing": 7.5,
    "fov_deg": 60.5,
    "z": True,
    "sky_m": 50.0,
}


@pytest.mark.parametrize("archive", [False, True])
def test_what_is_said_about_a_file_goes_with_the_file_alone(tmp_path, monkeypatch, archive):
    """Everything, for an upload; nothing, for a built-in scene."""
    given = []

    def noted(source, rows, cols, **options):
        given.append((source, options))
        return load_scene("flat:5", rows, cols)

    monkeypatch.setattr(control_values, "load_scene", noted)
    np.savez(tmp_path / "d.npz", Z=np.full((32, 32), 4.0))
    np.save(tmp_path / "d.npy", np.full((32, 32), 4.0))
    depth = tmp_path / ("d.npz" if archive else "d.npy")
    uploads = Uploads(depth=depth, colour=tmp_path / "c.png")
    said = ABOUT_A_FILE | {"reflectivity": 0.3}
    check_settings(said | {"scene": "upload"}, uploads).scene()
    check_settings({"scene": "upload"}, uploads).scene()
    check_settings(said | {"scene": "flat", "scale": 1.0}, uploads).scene()
    range_m = check_settings({}).timing.range_m
    of_upload = {"colour": uploads.colour, "range_m": range_m}
    named = {"channel": None} if archive else {}
    usual = {"unit": None, "channel": None, "scale": 1.0, "missing": None, "fov_deg": None}
    assert given == [
        (f"{depth}:Z" if archive else f"{depth}", {**said, **of_upload, **named}),
        (f"{depth}", {**usual, "z": False, "sky_m": 10_000.0, "reflectivity": 0.4, **of_upload}),
        ("flat:5,0.3", {"colour": None, "reflectivity": 0.4, "range_m": range_m}),
    ]


@pytest.mark.parametrize(
    "values", [{}, {"threshold": 5, "pulses": 50, "gating": True, "frames": 3, "subgroup": "4x4"}]
)
def test_the_configuration_that_is_written_is_the_one_that_is_simulated(values):
    settings = check_settings(values)
    read = parse_config(tomllib.loads(config_toml(settings)))
    assert read.sensor == settings.config.sensor and read.frame == settings.config.frame
    assert read.register_writes() == settings.config.register_writes()


def test_the_command_gives_the_same_settings_again():
    settings = check_settings(
        {"klux": 12.5, "scene": "two-targets", "gating": True, "sun": "left half"}
    )
    words = command(settings).split("--set ")[1:]
    again = given_settings([word.strip().strip("'") for word in words])
    assert again.values == settings.values
    for given in ("threshold", "threshold=many", "moon=1", "depth_file=/none.png"):
        with pytest.raises(InputError, match="must be|no such file"):
            given_settings([given])


@pytest.mark.parametrize("control", CONTROLS, ids=lambda control: control.name)
def test_command_and_link_repeat_every_control(control):
    values = {control.name: other_value(control)}
    _assert_repeated(check_settings(values))


@pytest.mark.parametrize(
    "name", ["left eye.Z", "it's", "a&b=c#d+e%20", 'say "Z"', "$HOME `x`", "ü"]
)
def test_command_and_link_repeat_every_name_of_a_channel(name):
    """As a shell reads the one, and a browser the other."""
    _assert_repeated(check_settings({"channel": name, "threshold": 3}))


def _assert_repeated(settings):
    words = shlex.split(command(settings))
    assert words[:2] == ["coincid", "explore"] and set(words[2::2]) == {"--set"}
    assert given_settings(words[3::2]).values == settings.values
    values, ignored = values_of_link(dict(parse_qsl(query(settings))))
    assert not ignored and check_settings(values).values == settings.values


def test_a_link_tells_everything_of_it_that_is_ignored_in_its_order():
    given = {"klux": "999", "threshold": "7", "moon": "1", "pulses": "many", "frames": "3"}
    values, told = values_of_link(given)
    assert values == {"threshold": 7, "frames": 3}
    ignored = re.findall(r"Ignored in the link: (.*?)\. ?(?=Ignored|$)", told)
    assert len(ignored) == told.count("Ignored") == 3
    assert ignored[0].startswith(f"{CONTROL['klux'].label} = 999.0: must be")
    assert "moon" in ignored[1]
    assert ignored[2].startswith(CONTROL["pulses"].label)
    assert values_of_link({"klux": "7"}) == ({"klux": 7}, "")


@pytest.mark.parametrize("kind", ["depth", "colour", "sun", "pulse"])
def test_a_folder_in_place_of_a_file_is_refused(kind, tmp_path):
    with pytest.raises(InputError, match=f"{tmp_path}: no such file"):
        given_settings([f"{kind}_file={tmp_path}"])


@pytest.mark.parametrize(
    "values, control, sentence",
    [
        ({"threshold": 65}, "threshold", "subgroup.threshold = 65: must be an integer from 1 to 64"),
        ({"threshold": None}, "threshold", "threshold: is empty, must be a number from 1 to 64"),
        ({"threshold": 1.5}, "threshold", "subgroup.threshold = 1.5: must be an integer from 1 to 64"),
        ({"threshold": 17, "subgroup": "4x4"}, "threshold", "subgroup.threshold = 17: must be an integer from 1 to 16"),
        ({"klux": -1}, "klux", "klux = -1: must be a number from 0 to 200"),
        ({"klux": float("nan")}, "klux", "klux = nan: must be a number from 0 to 200"),
        ({"pulses": 0}, "pulses", "pulses = 0: must be an integer from 1 to 10000"),
        ({"rows": 30}, "rows", "sensor.rows = 30: must be a multiple of 8, because of sensor.subgroup = [8, 8]"),
        ({"scene": "moon"}, "scene", "scene = 'moon': must be one of five-objects"),
        ({"gating": True, "gate_start": 300}, "gate_start", "subgroup.gate_start = 300: must be an integer from 0 to 249"),
        ({"rows": 512, "cols": 512, "pulses": 10_000}, "pulses", "pulses = 10000: must be an integer from 1 to 128"),
        ({"rows": 256, "cols": 256, "pulses": 100, "frames": 8}, "pulses", "pulses = 100: must be an integer from 1 to 64"),
        ({"colour": 1}, None, "colour: unknown setting"),
    ],
)  # fmt: skip
def test_illegal_values_name_the_control_and_what_is_legal(values, control, sentence):
    with pytest.raises(InputError) as refused:
        check_settings(values)
    assert str(refused.value).startswith(sentence)
    found = control_of(refused.value)
    assert (found and found.name) == control


@pytest.mark.parametrize("pulses", (10, 100, 1000))
def test_numbers_per_frame_are_those_of_the_frame_that_is_set(pulses):
    """Whatever a usual frame has: just below half of the pulses can be search pulses."""
    most = pulses // 2 - 1
    counting = {"format": "counts", "pulses": pulses}
    assert check_settings(counting | {"search_pulses": most}).config.search_pulses == most
    with pytest.raises(InputError, match=f"below half of frame.pulses = {pulses}"):
        check_settings(counting | {"search_pulses": most + 1})
    assert check_settings({"pulses": pulses, "capacity": 777}).config.capacity == 777


@pytest.mark.parametrize("text", ["inf", "-inf", "nan", "1e400"])
@pytest.mark.parametrize("name", ["pulses", "threshold", "seed", "klux"])
def test_a_number_that_is_none_is_refused_at_its_control(name, text):
    """Of the command, which is refused as a whole, and of a link, whose other settings count."""
    with pytest.raises(InputError) as refused:
        given_settings([f"{name}={text}"])
    assert control_of(refused.value) is CONTROL[name]
    values, ignored = values_of_link({name: text, "window": "8"})
    with pytest.raises(InputError) as refused:
        check_settings(values | {name: float(text)})
    assert control_of(refused.value) is CONTROL[name]
    assert values["window"] == 8


LARGE = {"rows": 1024, "cols": 1024, "subgroup": "16x16"}


@pytest.mark.parametrize(
    ("values", "most"),
    [
        ({"rows": 512, "cols": 512}, {"pulses": 128}),
        ({"rows": 256, "cols": 256, "frames": 8}, {"pulses": 64}),
        (LARGE | {"frames": 32}, {"pulses": 1}),
        (LARGE | {"pulses": 1}, {"frames": 32}),
    ],
)
def test_the_most_work_that_is_told_is_legal(values, most):
    """Of pulses; of frames, where not even one pulse would be left."""
    ((name, number),) = most.items()
    assert getattr(check_settings(values | most).config, name) == number
    with pytest.raises(InputError, match=f"^{name} = .* from 1 to {number} ") as refused:
        check_settings(values | {name: number + 1})
    assert control_of(refused.value) is CONTROL[name]


def test_a_lost_picture_is_said_and_the_default_counts():
    values = {"scene": "upload", "sun": "picture", "pulse": "file", "threshold": 3}
    kept, told = without_lost_pictures(values, Uploads())
    assert kept == {"threshold": 3}
    assert "Scene: the file is not here any more" in told and "The sun shines:" in told
    assert "Pulse: the file is not here any more; please choose it again." in told
    there = Uploads(depth=Path("a.png"), sun=Path("b.png"), pulse=Path("c.csv"))
    assert without_lost_pictures(values, there) == (values, "")


def test_distances_are_scaled_within_the_range():
    near, far = (check_settings({"scale": scale}).scene().truth_m for scale in (1.0, 2.0))
    assert np.allclose(far, 2 * near)
    with pytest.raises(InputError, match="scale = 9: must be a number from .* to 7.7"):
        check_settings({"scale": 9.0}).scene()


@pytest.mark.parametrize(("rows", "cols"), [(32, 32), (8, 48), (48, 8)])
def test_half_the_scene_lies_in_the_shade(rows, cols):
    size = {"rows": rows, "cols": cols}
    settings = check_settings({"scene": "flat", "sun": "left half", "shade_klux": 5.0} | size)
    background = settings.light(settings.scene()).background_cps.reshape(rows, cols)
    assert np.allclose(background[:, : cols // 2], 10 * background[:, cols // 2 :])


@pytest.mark.parametrize(
    ("distance_m", "end"),
    [
        ((0.2, 8.0), "high"),
        ((2.0, 60.0), "high"),
        ((8.0, 8.0), "high"),
        ((0.2, 8.0), "low"),
        ((0.2, 0.5), "low"),
    ],
)
def test_the_range_that_a_refused_scale_names_is_the_legal_one(distance_m, end):
    """A little within either end is legal, a little beyond is not."""
    near_m, far_m = distance_m
    scene = {"scene": "two-targets", "near_m": near_m, "far_m": far_m}
    with pytest.raises(InputError) as refused:
        check_settings(scene | {"scale": getattr(CONTROL["scale"], end)}).scene()
    for scale, inwards in ((refused.value.low, 1.001), (refused.value.high, 0.999)):
        check_settings(scene | {"scale": scale * inwards}).scene()
        with pytest.raises(InputError):
            check_settings(scene | {"scale": scale / inwards}).scene()


def uploaded(folder, kind, name, content):
    """Return uploads with a file. content: a picture, an array, or bytes."""
    file = io.BytesIO(content if isinstance(content, bytes) else b"")
    if isinstance(content, Image.Image):
        content.save(file, "PNG")
    elif isinstance(content, np.ndarray):
        np.save(file, content)
    return Uploads().with_file(kind, name, file.getvalue(), folder)


def test_an_uploaded_depth_picture_is_the_scene(tmp_path):
    depth_mm = Image.fromarray(np.full((48, 64), 4000, np.uint16))
    uploads = uploaded(tmp_path, "depth", "../../wall.png", depth_mm)
    assert uploads.depth.parent.parent == tmp_path  # a name cannot lead out of the folder
    assert np.all(check_settings({"scene": "upload"}, uploads).scene().truth_m == 4.0)


@pytest.mark.parametrize(
    "name", ["C:\\scans\\wall.png", "scans/wall.png", "..\\wall.png", "wa\nll\u202e.png"]
)
def test_the_name_of_a_picture_is_what_is_printed_of_its_last_part(tmp_path, name):
    """By the separator of any system; a line break or a letter that turns what follows is left out."""
    depth_mm = Image.fromarray(np.full((48, 64), 4000, np.uint16))
    assert uploaded(tmp_path, "depth", name, depth_mm).depth.name == "wall.png"


def test_a_file_of_the_same_name_is_another_file(tmp_path):
    """The one before stays what it was: a step back in the browser asks for it again."""
    first, second = (
        uploaded(tmp_path, "depth", "wall.npy", np.full((32, 32), metres)) for metres in (3.0, 4.0)
    )
    for settings, metres in ((first, 3.0), (second, 4.0), (first, 3.0)):
        assert np.all(check_settings({"scene": "upload"}, settings).scene().truth_m == metres)


def test_a_file_takes_the_place_of_its_kind_alone(tmp_path):
    given = {kind: tmp_path / f"{kind}.csv" for kind in uploads.KINDS}
    for kind in ("depth", "colour", "sun"):
        given[kind] = given[kind].with_suffix(".png")
        Image.new("L", (32, 32)).save(given[kind])
    given["pulse"].write_text("time_ps,density\n0,0\n250,1\n500,0\n", encoding="utf-8")
    found = Uploads()
    for kind, path in given.items():
        found = found.with_path(kind, path)
    assert found == Uploads(**given) and found.files() == given
    told = " and ".join(str(path) for path in given.values())
    assert found.named(told) == "depth.png and colour.png and sun.png and pulse.csv"


def test_a_file_of_the_largest_legal_size_is_accepted(tmp_path, monkeypatch):
    """In bytes and in samples; one more of either is not."""
    depth_m = np.full((8, 8), 4.0)
    whole = io.BytesIO()
    np.save(whole, depth_m)
    size = len(whole.getvalue())
    for bytes_max, samples_max in ((size, 64), (size - 1, 64), (size, 63)):
        monkeypatch.setattr(uploads, "BYTES_MAX", bytes_max)
        monkeypatch.setattr(uploads, "SAMPLES_MAX", samples_max)
        if (bytes_max, samples_max) == (size, 64):
            assert uploaded(tmp_path, "depth", "d.npy", depth_m).depth.is_file()
        else:
            with pytest.raises(InputError, match="^d.npy: h(olds|as) "):
                uploaded(tmp_path, "depth", "d.npy", depth_m)


@pytest.mark.parametrize("order", [1, -1])
def test_an_archive_is_as_large_as_its_largest_array(tmp_path, monkeypatch, order):
    """In whatever order they are in it."""
    monkeypatch.setattr(uploads, "SAMPLES_MAX", 99)
    arrays = [("a", np.ones((4, 4))), ("b", np.ones((10, 10))), ("c", np.ones((5, 5)))][::order]
    np.savez(tmp_path / "d.npz", **dict(arrays))
    with pytest.raises(InputError, match="^d.npz: has 10 x 10 samples"):
        Uploads().with_path("depth", tmp_path / "d.npz")


def test_a_picture_that_would_fill_the_memory_is_not_decoded(tmp_path, monkeypatch):
    monkeypatch.setattr(Image, "MAX_IMAGE_PIXELS", 100)
    Image.new("L", (32, 32)).save(tmp_path / "sun.png")
    with pytest.raises(InputError, match="^sun.png: has far too many samples, must have 1 to 16"):
        Uploads().with_path("sun", tmp_path / "sun.png")


@pytest.mark.parametrize(
    ("kind", "name", "told"),
    [
        ("sun", "sun.png", "is not a readable picture (PNG, TIFF, JPEG) ("),
        ("depth", "d.npy", "is not a readable NPY file ("),
        ("pulse", "p.csv", ""),
    ],
)
def test_a_file_that_cannot_be_read_is_told_by_its_name(tmp_path, kind, name, told):
    """Without the folder in which the server keeps it."""
    with pytest.raises(InputError) as refused:
        uploaded(tmp_path, kind, name, b"nothing")
    assert str(refused.value).startswith(f"{name}: {told}")
    assert str(tmp_path) not in str(refused.value)


@pytest.mark.parametrize("letters", [1, 56, 57, 300])
def test_a_picture_keeps_the_end_of_its_name(tmp_path, letters):
    depth_mm = Image.fromarray(np.full((48, 64), 4000, np.uint16))
    uploads = uploaded(tmp_path, "depth", letters * "a" + "wall.png", depth_mm)
    assert uploads.depth.name.endswith("wall.png")
    assert len(uploads.depth.name) <= NAME_MAX


@pytest.mark.parametrize("suffix", ["png", "tif", "tiff", "pgm", "pfm", "exr", "npy", "npz", "h5"])
def test_a_depth_file_of_every_form_can_be_uploaded(tmp_path, suffix):
    path = tmp_path / f"d.{suffix}"
    depth_m = np.full((32, 32), 4.0, np.float32)
    if suffix in ("png", "tif", "tiff", "pgm"):
        picture = Image.fromarray(np.full((32, 32), 4000, np.uint16))
        picture.save(path, "PPM" if suffix == "pgm" else None)
    elif suffix == "pfm":
        path.write_bytes(b"Pf\n32 32\n-1.0\n" + depth_m.tobytes())
    elif suffix == "exr":
        form = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
        OpenEXR.File(form, {"Z": depth_m}).write(str(path))
    elif suffix == "npy":
        np.save(path, depth_m)
    elif suffix == "npz":
        np.savez(path, depth=depth_m)
    else:
        with h5py.File(path, "w") as archive:
            archive["depth"] = depth_m
    for name in (path.name, path.name.upper()):
        used = Uploads().with_file("depth", name, path.read_bytes(), tmp_path)
        assert used.depth.name == name
        assert np.allclose(check_settings({"scene": "upload"}, used).scene().truth_m, 4.0)


@pytest.mark.parametrize("form", ["PNG", "TIFF", "JPEG"])
@pytest.mark.parametrize("kind", ["colour", "sun"])
def test_a_picture_of_every_form_can_be_uploaded(tmp_path, kind, form):
    file = io.BytesIO()
    Image.new("L", (32, 32), 255).save(file, form)
    suffixes = {"PNG": ".png", "TIFF": ".tif", "JPEG": ".jpg"}
    for name in (f"a{suffixes[form]}", f"A{suffixes[form]}".upper()):
        used = Uploads().with_file(kind, name, file.getvalue(), tmp_path)
        assert used.files()[kind].name == name and used.files()[kind].is_file()


def test_each_picture_of_an_uploaded_sequence_is_scaled(tmp_path):
    pictures_m = np.full((3, 32, 32), 3.0) + np.arange(3)[:, None, None]
    uploads = uploaded(tmp_path, "depth", "moves.npy", pictures_m)
    scene = check_settings({"scene": "upload", "frames": 3, "scale": 2.0}, uploads).scene()
    assert scene.pictures == 3
    for frame in range(3):
        assert np.all(scene.at(frame).truth_m == 2 * pictures_m[frame])


@pytest.mark.parametrize("rows", [16, 32])
def test_an_uploaded_picture_is_the_sun(tmp_path, rows):
    grey = Image.fromarray(np.repeat(np.uint8([255, 0]), 32)[:, None].repeat(64, axis=1))
    settings = check_settings(
        {"scene": "flat", "sun": "picture", "rows": rows},
        uploaded(tmp_path, "sun", "sun.png", grey),
    )
    background = settings.light(settings.scene()).background_cps.reshape(rows, 32)
    assert np.all(background[: rows // 2] == background.max())
    assert np.all(background[rows // 2 :] == background.min())


@pytest.mark.parametrize(("rows", "cols"), [(16, 16), (8, 32), (16, 8)])
@pytest.mark.parametrize(
    ("name", "grey"),
    [
        ("8 bit.png", np.uint8(np.arange(48 * 64).reshape(48, 64) % 251)),
        ("16 bit.png", np.uint16(np.arange(48 * 64).reshape(48, 64) * 21)),
        ("turned.png", np.uint8(np.arange(48 * 64).reshape(48, 64) % 251)),
    ],
)
def test_a_picture_of_the_sun_gives_the_light_of_the_command_line(tmp_path, name, grey, rows, cols):
    path = tmp_path / name
    exif = Image.Exif()
    if name == "turned.png":
        exif[ORIENTATION] = 6
    Image.fromarray(grey).save(path, exif=exif)
    size = [f"rows={rows}", f"cols={cols}"]
    settings = given_settings([f"sun_file={path}", "klux=80", "shade_klux=0", *size])
    assert settings.klux() == pytest.approx(ambient_klux(f"{path},80", rows, cols))
    assert np.ptp(settings.klux()) > 0


def test_a_picture_of_the_sun_in_colour_is_refused_by_its_name(tmp_path):
    colour = Image.new("RGB", (32, 32))
    settings = check_settings({"sun": "picture"}, uploaded(tmp_path, "sun", "sun.png", colour))
    with pytest.raises(InputError, match="^sun.png: is a picture of mode RGB, must be grey"):
        settings.klux()


def test_an_uploaded_scene_is_scaled_before_its_limits(tmp_path):
    """Both ends would lie outside of them without the factor, or with it applied later."""
    far_m, near_m = np.linspace(5.0, 140.0, 64), np.linspace(0.02, 3.0, 64)
    for sample_m, scale in ((far_m, 0.5), (near_m, 10.0)):
        path = tmp_path / "d.npy"
        np.save(path, np.tile(sample_m, (64, 1)))
        scene = given_settings([f"depth_file={path}", f"scale={scale}"]).scene()
        of_command = load_scene(str(path), 32, 32, scale=scale)
        assert np.array_equal(scene.distance_m, of_command.distance_m)
        assert not np.isnan(scene.distance_m).any()


@pytest.mark.parametrize(
    ("kind", "control", "using", "other"),
    [
        ("depth", "scene", "upload", "flat"),
        ("sun", "sun", "picture", "left half"),
        ("pulse", "pulse", "file", "Gaussian"),
    ],
)
def test_a_file_that_is_given_is_used_unless_its_control_says_otherwise(
    tmp_path, kind, control, using, other
):
    path = tmp_path / ("a.csv" if kind == "pulse" else "a.png")
    if kind == "pulse":
        path.write_text("time_ps,density\n0,0\n250,1\n500,0\n", encoding="utf-8")
    else:
        Image.fromarray(np.full((48, 64), 4000, np.uint16)).save(path)
    file = f"{kind}_file={path}"
    used = given_settings([file])
    assert used.values[control] == using and command(used).endswith(f"{kind}_file={path.name}")
    unused = given_settings([file, f"{control}={other}"])
    assert unused.values[control] == other and "_file" not in command(unused)
    assert unused.pulse() is None and unused.light(unused.scene()).pulse is None
    assert (used.light(used.scene()).pulse is not None) == (kind == "pulse")


def test_the_light_is_told_with_the_part_that_it_is_of(tmp_path):
    light = {"klux": 80.0, "shade_klux": 3.0}
    assert check_settings(light).told_klux() == "80 klux"
    half = check_settings(light | {"sun": "left half"})
    assert half.told_klux() == "80 klux on the left half, 3 klux on the right"
    uploads = uploaded(tmp_path, "sun", "sun.png", Image.new("L", (32, 32)))
    picture = check_settings(light | {"sun": "picture"}, uploads)
    assert picture.told_klux() == "80 klux where sun.png is white, 3 klux where it is black"


BAD = [
    ("depth.png", lambda: Image.new("L", (32, 32), 7), "8 bit"),
    ("depth.png", lambda: Image.new("RGB", (32, 32)), "colour or 8 bit"),
    ("depth.png", lambda: b"", "holds 0 bytes"),
    ("depth.png", lambda: bytes(BYTES_MAX + 1), "must hold 1 to"),
    (
        "depth.png",
        lambda: Image.new("I;16", (10_000, 10_000), 4000),
        "x 10000 samples, must have 1 to 16",
    ),
    ("depth.npy", lambda: np.zeros((4100, 4100), np.uint8), "4100 x 4100 samples"),
    ("depth.npy", lambda: np.zeros((0, 5)), "0 x 5 samples, must have 1 to 16 million"),
    ("depth.exe", lambda: b"MZ", "must be a depth file"),
]


def test_an_exr_picture_is_as_large_as_its_display(tmp_path):
    """However little of it the file stores."""
    window = {
        "compression": OpenEXR.ZIP_COMPRESSION,
        "type": OpenEXR.scanlineimage,
        "dataWindow": (np.int32([0, 0]), np.int32([3, 3])),
        "displayWindow": (np.int32([0, 0]), np.int32([8999, 1999])),
    }
    path = tmp_path / "wide.exr"
    OpenEXR.File(window, {"Z": np.full((4, 4), 4, np.float32)}).write(str(path))
    with pytest.raises(InputError, match="^wide.exr: has 2000 x 9000 samples, must have 1 to 16"):
        Uploads().with_path("depth", path)


@pytest.mark.parametrize("suffix", ["npz", "h5", "exr"])
@pytest.mark.parametrize("names", [["Z"], ["Z", "far"]])
def test_parts_of_a_file_are_told_if_there_is_a_choice(tmp_path, suffix, names):
    path = tmp_path / f"d.{suffix}"
    parts = {name: np.full((4, 4), 4, np.float32) for name in names}
    if suffix == "npz":
        np.savez(path, **parts, camera=np.ones(3))
    elif suffix == "h5":
        with h5py.File(path, "w") as archive:
            archive.update(parts)
            archive["camera"] = np.ones(3)
    else:
        form = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
        OpenEXR.File(form, parts).write(str(path))
    assert sorted(parts_of(path)) == (sorted(names) if len(names) > 1 else [])


def test_what_has_no_parts_has_no_choice(tmp_path):
    (tmp_path / "bad.npz").write_bytes(b"no archive")
    np.save(tmp_path / "d.npy", np.ones((4, 4)))
    for path in (None, tmp_path / "d.npy", tmp_path / "bad.npz"):
        assert parts_of(path) == []


@pytest.mark.parametrize("name, content, sentence", BAD)
def test_bad_uploads_get_a_sentence(tmp_path, name, content, sentence):
    with pytest.raises(InputError, match=sentence):
        check_settings({"scene": "upload"}, uploaded(tmp_path, "depth", name, content())).scene()


@pytest.mark.parametrize(
    ("kind", "name"),
    [("depth", "depth.npy"), ("depth", "depth.npz"), ("sun", "sun.png"), ("pulse", "pulse.csv")],
)
def test_a_refused_upload_leaves_no_file(tmp_path, kind, name):
    """One that is kept has a folder of its own."""
    good = b"time_ps,density\n0,0\n250,1\n500,0\n"
    kept = uploaded(tmp_path, "pulse", "pulse.csv", good)
    before = sorted(tmp_path.rglob("*"))
    with pytest.raises(InputError, match=name):
        kept.with_file(kind, name, b"no such file", tmp_path)
    assert sorted(tmp_path.rglob("*")) == before and kept.pulse in before


def test_an_upload_that_fills_the_disk_is_told_and_leaves_no_file(tmp_path, monkeypatch):
    def fills_it(path, content):
        with path.open("wb") as file:
            file.write(content[:1])
        raise OSError(errno.ENOSPC, "no space")

    monkeypatch.setattr(Path, "write_bytes", fills_it)
    with pytest.raises(InputError, match=r"^pulse\.csv: cannot be kept: no space$"):
        Uploads().with_file("pulse", "pulse.csv", b"0,1", tmp_path)
    assert not list(tmp_path.iterdir())
    with pytest.raises(InputError, match=r"^pulse\.csv: cannot be kept: No such file"):
        Uploads().with_file("pulse", "pulse.csv", b"0,1", tmp_path / "lost")


def test_an_upload_that_is_missing_is_asked_for():
    with pytest.raises(InputError, match="choose a depth picture"):
        check_settings({"scene": "upload"}).scene()
    settings = check_settings({"scene": "flat", "sun": "picture"})
    with pytest.raises(InputError, match="choose a picture of the sun"):
        settings.light(settings.scene())


def test_ranges_are_those_of_the_parser():
    for control in CONTROLS:
        if control.where and control.kind == "integer" and control.low is not None:
            for value in (control.low - 1, control.high + 1):
                with pytest.raises(InputError):
                    check_settings({control.name: value})
    assert CONTROL["threshold"].span(Sensor(subgroup=(4, 4))) == "1 to 16 pixels"
    assert CONTROL["klux"].span(Sensor()) == "0 to 200 klux"


def test_a_default_that_does_not_fit_says_what_counts():
    small = check_settings({"window_max": 8, "coarse_bits": 7})
    assert small.told(CONTROL["window"]) == "1 to 8 ticks; now 8 = 0.5 ns"
    assert small.told(CONTROL["period"]) == "1 to 128 cycles; now 128 = 256 ns"
    coarse = check_settings({"coarse_bits": 7, "phases": 8, "offset_phases": 8})
    assert coarse.told(CONTROL["period"]) == "1 to 128 cycles; now 128 = 256 ns"
    assert "now" not in small.told(CONTROL["rows"])
    integers = [control for control in CONTROLS if control.where and control.kind == "integer"]
    assert all("now" not in check_settings({}).told(control) for control in integers)


def test_labels_are_words_and_no_two_are_equal():
    labels = [control.label for control in CONTROLS]
    assert sorted(set(labels)) == sorted(labels)
    assert not [label for label in labels if re.search(r"_|mhz|gbps|mg |(?<!\w)max", label)]


@pytest.mark.parametrize(
    "control",
    [one for one in CONTROLS if one.kind in ("integer", "real")],
    ids=lambda one: one.name,
)
def test_a_refused_value_is_told_by_its_label(control):
    above = 2 * control.high + 1
    with pytest.raises(InputError) as refused:
        check_settings({control.name: above})
    assert control_of(refused.value) is control
    assert told_by_labels(refused.value).startswith(f"{control.label} = {above}")
    assert not re.search(r"\b(sensor|frame|subgroup)\.", told_by_labels(refused.value))


def test_all_settings_in_a_refusal_are_told_by_their_labels():
    """Of every table of the file; what has no control keeps its key."""
    text = "{} and {} do not go with {}, nor with subgroup.moon"
    keys = "sensor.rows", "frame.period", "subgroup.gate_start"
    labels = "Rows", "Laser period", "Gate start"
    assert told_by_labels(InputError(text.format(*keys))) == text.format(*labels)


def test_the_files_of_a_server_go_with_it(tmp_path):
    """A process that ends leaves no folder behind."""
    script = (
        "from coincid.study.explore.uploads import Kept, Uploads; kept = Kept();"
        "Uploads().with_file('pulse', 'p.csv', b'time_ps,density\\n0,0\\n250,1\\n500,0\\n', kept.folder);"
        "print(kept.folder.parent, len([*kept.folder.rglob('p.csv')]))"
    )
    done = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", script],
        env=os.environ | {"TMPDIR": str(tmp_path)},
        capture_output=True,
        text=True,
        encoding="utf-8",
        check=True,
    )
    assert done.stdout.split() == [str(tmp_path), "1"]
    assert [*tmp_path.iterdir()] == []


def test_uploads_are_kept_under_a_number_of_their_own():
    """Equal ones under one number; under a number that was not given are none."""
    kept = Kept()
    given = [Uploads(), *(Uploads(depth=Path(name)) for name in ("a.npy", "b.npy", "c.npy"))]
    numbers = [kept.number_of(one) for one in given]
    assert len(set(numbers)) == len(given)
    assert [kept.number_of(one) for one in reversed(given)] == numbers[::-1]
    assert [kept.get(number) for number in numbers] == given
    for unknown in (max(numbers) + 1, max(numbers) + 2, 1 << 70, -1, -2):
        assert kept.get(unknown) == Uploads()
    assert Kept().get(1) == Uploads()  # a page of a server that ran before
