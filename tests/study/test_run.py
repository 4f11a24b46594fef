# SPDX-License-Identifier: Apache-2.0
"""The front door: `import coincid`, the methods of a run, and that the golden model needs no RTL
tool.
"""

import html
import subprocess
import sys
from importlib.metadata import packages_distributions, requires
from types import SimpleNamespace

import numpy as np
import pytest
from attrs import evolve
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

import coincid
from coincid.model.contract.result import EVENT_COLUMNS, differences, map_numbers
from coincid.model.depth.belief import SENTENCES
from coincid.model.depth.depth import Depth
from coincid.model.depth.histograms import subgroup_histograms
from coincid.model.depth.intensity import Intensity
from coincid.model.depth.pulse_ticks import pulse_ticks
from coincid.model.light.link_budget import Optics
from coincid.model.scenes.catalogue import load_scene
from coincid.model.scenes.scene import REFLECTIVITY
from coincid.model.scenes.view import View
from coincid.study import run as study_run
from coincid.study.point_cloud import write_ply
from coincid.study.show.assets import FILES

RTL = {
    canonicalize_name(Requirement(one).name)
    for one in requires("coincid") or ()
    if 'extra == "rtl"' in one
}
RTL_TOOLS = [
    name
    for name, wheels in packages_distributions().items()
    if RTL & set(map(canonicalize_name, wheels))
]
SMALL = {"sensor": {"rows": 16, "cols": 8}, "frame": {"pulses": 60}}


@pytest.fixture(scope="module")
def run():
    return coincid.simulate(coincid.parse_config(SMALL), "flat:5,0.5", klux=10, seed=3)


def test_a_saved_run_is_read_back(run, tmp_path):
    run.save(tmp_path / "events.npz")
    assert not differences(coincid.read_result(tmp_path / "events.npz"), run.result)


@pytest.mark.parametrize("klux", [0, 0.0, "0"], ids=repr)
def test_a_scene_in_the_dark_has_no_ambient_light(klux):
    """A light of 0 is one that is given."""
    dark = coincid.simulate(coincid.parse_config(SMALL), "flat:5,0.5", klux=klux, seed=3)
    assert dark.setup.klux == klux
    assert not dark.light.total_background_cps.any()


@pytest.mark.parametrize(
    ("write", "suffix"),
    [
        (lambda run, path: run.save(path), "npz"),
        (lambda run, path: run.save_depth(path), "npz"),
        (lambda run, path: run.edges.save(path), "npz"),
        (lambda run, path: run.depth().save(path), "npz"),
        (lambda run, path: coincid.write_result(path, run.result), "npz"),
        (lambda run, path: run.to_ply(path), "ply"),
        (lambda run, path: run.plot().save(path), "html"),
    ],
)
def test_a_file_is_what_its_name_says(run, tmp_path, write, suffix):
    with pytest.raises(coincid.InputError, match=f"out.h5: must end with .{suffix}"):
        write(run, tmp_path / "out.h5")
    assert not list(tmp_path.iterdir())
    write(run, tmp_path / f"out.{suffix}")
    assert (tmp_path / f"out.{suffix}").stat().st_size


@pytest.mark.parametrize(
    ("write", "name", "told"),
    [
        ("save_depth", "out.h5", "must end with .npz"),
        ("save_depths", "out.h5", "must end with .npz"),
        ("animate", "out.mp4", "must end with .gif or .png"),
        ("to_ply", "out.h5", "must end with .ply"),
        ("to_ply", "none/out.ply", "the folder .*none does not exist"),
        ("to_ply", "file/out.ply", "the folder .*file does not exist"),
    ],
)
def test_a_file_that_cannot_be_is_refused_before_its_depth_is_computed(
    run, monkeypatch, tmp_path, write, name, told
):
    """Which takes minutes in a large array."""
    for computes in ("depth", "frame"):
        monkeypatch.setattr(type(run), computes, lambda *given, **options: 1 / 0)
    (tmp_path / "file").touch()
    with pytest.raises(coincid.InputError, match=told):
        getattr(run, write)(tmp_path / name)


def test_one_line_says_what_a_thing_is(run):
    told = {
        run: "<Run of flat:5,0.5: 16 x 8 pixels, 1 frame of 60 pulses, engine golden>",
        run.config: "<Config: 16 x 8 pixels in 2 subgroups, 1 frame of 60 pulses, 3 keys written>",
        run.scene: "<Scene flat:5,0.5: 16 x 8 pixels, 5 to 5 m>",
    }
    for one, line in told.items():
        assert repr(one) == line
    assert repr(run.depth()).startswith("<Depth: 16 x 8 pixels, 1 return, ")
    assert repr(run.edges).startswith(f"<Edges: {len(run.edges):,}, pulses 0 to 59")
    hits = run.histogram(0)
    assert repr(hits).startswith(f"<PixelHistogram: {hits.sum()} hits in ")
    assert repr(hits[:2] + 1).startswith("PixelHistogram([")


def test_a_changed_run_has_all_methods_and_names_what_it_does_not_know(run):
    assert len(run.but(subgroup={"threshold": 3}).events()) < len(run.events())
    for change, words in {
        "threshold": r"threshold: is a setting of \[subgroup\], given as subgroup=\{",
        "rows": "rows: is a parameter of the sensor, given as config=config.with_sensor",
        "moon": "moon: unknown field, must be one of frame, subgroup, config, scene",
    }.items():
        with pytest.raises(coincid.InputError, match=words):
            run.but(**{change: 3})
    with pytest.raises(coincid.InputError, match="measure = 'foo': must be one of edges"):
        run.frame(0)["foo"]
    with pytest.raises(coincid.InputError, match="frame = 1: must be an integer from -1 to 0"):
        run.frame(1)


def test_every_integer_of_numpy_is_an_integer(run):
    given = {"rows": 16, "cols": 8, "pulses": 60, "threshold": 3, "seed": 3}
    plain = coincid.simulate(None, "flat:5,0.5", klux=10, **given)
    for kind in (np.int64, np.uint16):
        others = {name: kind(value) for name, value in given.items()}
        same = coincid.simulate(None, "flat:5,0.5", klux=10, **others)
        assert same.setup.key == plain.setup.key
        assert not differences(same.result, plain.result)
        place = kind(9), kind(5)
        assert np.array_equal(same.histogram(place), plain.histogram((9, 5)))


def test_the_table_of_events_has_the_maps(run):
    table = run.to_pandas()
    assert np.array_equal(table["hits"], run.result["hits"][:, 0])
    two_words = np.array([[1, 1 << 63], [5, 0]], np.uint64)
    assert map_numbers(two_words).tolist() == [(1 << 127) + 1, 5]


def test_histogram_of_a_pixel(run):
    of_subgroups = np.stack(
        list(subgroup_histograms(run.result, run.config, pulse_ticks(run.config)))
    )
    row, col = 9, 5  # in the second subgroup
    for pixel in (8 * row + col, (row, col)):
        assert np.array_equal(run.histogram(pixel), of_subgroups[1, 8 * (row - 8) + col])
    assert run.histogram(0)[:2]._repr_html_() is None  # a part of it has no picture
    with pytest.raises(
        coincid.InputError,
        match=r"pixel = 128: must be .* from 0 to 127 \(or \(row, column\); the number",
    ):
        run.histogram(128)
    with pytest.raises(coincid.InputError, match="row = 16: must be"):
        run.histogram((16, 0))


def test_a_run_shows_itself_in_a_notebook(run):
    assert "data:image/png;base64," in run._repr_html_() and "<td>windows</td>" in run._repr_html_()
    pages = {
        "histogram": run.histogram(77),
        "timeline": run.timeline(1, 5),
        "map_truth_m": run.plot(),
    }
    for name, shown in pages.items():
        page = shown._repr_html_()
        assert page.startswith("<iframe srcdoc=") and f"&quot;{name}&quot;" in page
        # it needs no network, and has what draws its tables
        assert "cdn.bokeh.org" not in page
        assert all(html.escape(FILES[one]) in page for one in ("page.css", "tables.js"))
    for place, says in {
        (2, 0): "subgroup = 2: .* from 0 to 1",
        (1, 60): "pulse = 60: .* from 0 to 59",
    }.items():
        with pytest.raises(coincid.InputError, match=says):
            run.timeline(*place)


@pytest.mark.parametrize(("frame", "drawn"), [(None, 0), (0, 0), (1, 1)])
def test_a_histogram_is_drawn_with_the_depth_of_its_frame(monkeypatch, frame, drawn):
    """That of all frames with the depth of the first."""
    shown = []
    monkeypatch.setattr(
        "coincid.study.show.notebook.plot_histogram", lambda *given: shown.append(given)
    )
    run = coincid.simulate(None, "flat:5", frames=2, rows=8, cols=8, pulses=30)
    run.histogram(9, frame=frame).draw()
    assert shown == [(run, 9, drawn)]


def test_the_plot_of_a_run_is_that_of_the_frame_and_the_estimator_asked_for(monkeypatch):
    run = coincid.simulate(None, "flat:5", frames=2, rows=8, cols=8, pulses=30)
    shown = []

    def noted(name, views):
        shown.extend(views)
        return ""

    monkeypatch.setattr("coincid.study.show.report.report_html", noted)
    run.plot()
    run.plot(frame=1, method="maximum")
    for view, frame, method in zip(shown, (0, 1), ("planes", "maximum"), strict=True):
        depth_m = run.depth(frame=frame, method=method).depth_m[:, :, 0]
        assert np.array_equal(view.depth_m, depth_m, equal_nan=True)


@pytest.mark.parametrize("with_pandas", [True, False])
def test_events_as_a_table(run, monkeypatch, with_pandas):
    if not with_pandas:
        monkeypatch.setitem(sys.modules, "pandas", None)
    table = run.events()
    assert len(table) == len(run.result["pulse"]) > 0
    for name in EVENT_COLUMNS:
        assert np.array_equal(np.asarray(table[name]), run.result[name])


def test_points_lie_where_their_pixels_look():
    depth_m = np.full((3, 5, 2), np.nan)
    depth_m[1, 2, 0], depth_m[0, 4, 0], depth_m[0, 4, 1] = 2.0, 4.0, 6.0
    depth = Depth(
        depth_m, np.where(np.isnan(depth_m), 0, 0.5), np.zeros(depth_m.shape[:2], np.uint8)
    )
    depth.reason[0, 4] = 3
    depth.confidence[0, 4, 1] = 0.25
    corner, behind, middle = coincid.point_cloud(depth, Optics(fov_h_deg=90, fov_v_deg=60)).tolist()
    assert (corner[3], behind[3]) == (0.5, 0.25)
    assert middle[:4] == (0, 0, 2, 0.5) and middle[6] == 0 and corner[6] == behind[6] == 3
    assert np.isnan(middle[4:6]).all()
    x, y, z = corner[:3]
    assert (x / z, y / z) == pytest.approx((0.8, -2 / 3 * np.tan(np.radians(30))))
    assert np.linalg.norm((x, y, z)) == pytest.approx(4)
    assert behind[:3] == pytest.approx((1.5 * x, 1.5 * y, 1.5 * z))


def test_points_of_a_run_lie_in_the_view_of_its_scene():
    """A view that is wider than high, unlike that of the paper."""
    wide = View(h_deg=80, v_deg=20)
    scene = evolve(load_scene("flat:5,0.8", 8, 16), view=wide)
    points = coincid.simulate(None, scene, klux=1, rows=8, cols=16, pulses=50).point_cloud()
    right, down = wide.tangents(8, 16)
    assert np.abs(points["x"] / points["z"]).max() == pytest.approx(right.max(), rel=1e-5)
    assert np.abs(points["y"] / points["z"]).max() == pytest.approx(down.max(), rel=1e-5)


def test_normals_of_a_wall_look_along_the_axis():
    """For a wall across the axis, the distance along the rays grows to the sides."""
    tangent = (2 * np.arange(9) - 8) / 9
    depth_m = 3 * np.sqrt(1 + tangent[:, None] ** 2 + tangent**2)
    slope_m = np.stack(np.gradient(depth_m, edge_order=2), axis=2)
    depth = Depth(
        depth_m[:, :, None], np.ones((9, 9, 1)), np.zeros((9, 9), np.uint8), slope_m=slope_m
    )
    points = coincid.point_cloud(depth, Optics(fov_h_deg=90, fov_v_deg=90), normals=True)
    middle = points[np.abs(points["x"]) < 2]
    assert np.stack([middle[name] for name in ("nx", "ny", "nz")], axis=1) == pytest.approx(
        np.tile([0, 0, -1], (len(middle), 1)), abs=0.03
    )
    with pytest.raises(coincid.InputError, match="method must be planes"):
        coincid.point_cloud(evolve(depth, slope_m=None), normals=True)


def test_normals_of_a_slanted_wall_in_a_view_that_is_wider_than_high():
    """The wall slants by other angles to the right and down."""
    normal = np.array([0.3, -0.5, -0.8]) / np.linalg.norm([0.3, -0.5, -0.8])
    optics = Optics(fov_h_deg=60, fov_v_deg=30)
    right, down = View(h_deg=60, v_deg=30).tangents(24, 40)
    ray = np.stack([right, down, np.ones_like(right)], axis=2)
    ray /= np.linalg.norm(ray, axis=2, keepdims=True)
    depth_m = -4.0 / (ray @ normal)
    slope_m = np.stack(np.gradient(depth_m, edge_order=2), axis=2)
    sure = np.ones((24, 40, 1))
    depth = Depth(depth_m[:, :, None], sure, np.zeros((24, 40), np.uint8), slope_m=slope_m)
    points = coincid.point_cloud(depth, optics, normals=True)
    found = np.stack([points[name] for name in ("nx", "ny", "nz")], axis=1)
    assert np.allclose(found, normal, atol=0.01)


def test_ply_holds_the_points(run, tmp_path):
    run.to_ply(tmp_path / "cloud.ply", method="maximum")
    points = run.point_cloud(method="maximum")
    assert 0 < len(points) == np.count_nonzero(~np.isnan(run.depth(method="maximum").depth_m))
    header, _, data = (tmp_path / "cloud.ply").read_bytes().partition(b"end_header\n")
    assert header.startswith(b"ply\nformat binary_little_endian 1.0\n")
    assert f"element vertex {len(points)}\n".encode() in header
    numbers = ("x", "y", "z", "confidence", "signal", "signal_error")
    fields = [*((name, "<f4") for name in numbers), ("reason", "u1")]
    assert np.array_equal(np.frombuffer(data, fields), points)
    depth = run.depth(method="maximum")
    seen = ~np.isnan(depth.depth_m)
    assert points["signal"] == pytest.approx(depth.signal_per_pulse[seen])
    assert points["signal_error"] == pytest.approx(depth.signal_error[seen])
    properties = [line for line in header.decode().splitlines() if line.startswith("property")]
    assert properties == [*(f"property float {name}" for name in numbers), "property uchar reason"]
    assert b"comment reason 1: no light" in header
    with pytest.raises(coincid.InputError, match="the folder .* does not exist"):
        run.to_ply(tmp_path / "none" / "cloud.ply")
    assert not (tmp_path / "none").exists()


def test_ply_tells_its_axes_its_units_and_the_reasons(tmp_path):
    """The axes are those of its points: the last pixel is on the right, below and in front."""
    depth_m = np.full((2, 2, 1), 3.0)
    depth = Depth(depth_m, np.ones_like(depth_m), np.zeros((2, 2), np.uint8))
    points = coincid.point_cloud(depth)
    assert min(points[-1][axis] for axis in "xyz") > 0
    write_ply(tmp_path / "cloud.ply", points)
    header = (tmp_path / "cloud.ply").read_bytes().partition(b"end_header\n")[0].decode()
    assert [line for line in header.splitlines() if line.startswith("comment")] == [
        "comment metres; x right, y down, z forward",
        "comment signal, signal_error: detected photons per laser pulse, before the dead time",
        *(f"comment reason {int(reason)}: {told}" for reason, told in SENTENCES.items()),
    ]


@pytest.mark.parametrize("preset", ["silicon", "fpga"])
def test_a_preset_measures_the_wall(preset):
    config = coincid.load_config(preset).with_frame(pulses=60)
    depth_m = coincid.simulate(config, "flat:7,0.6", klux=5).depth().depth_m
    assert np.nanmedian(depth_m) == pytest.approx(7, abs=0.1)


def test_names_of_the_front_door():
    for name in coincid.__all__:
        assert getattr(coincid, name).__doc__
    assert {name for name in dir(coincid) if not name.startswith("_")} == set(coincid.__all__)
    with pytest.raises(AttributeError, match="simulat"):
        coincid.simulat  # noqa: B018


RUN = """
import os
import coincid
print({"numpy", "numba", "scipy"} & set(sys.modules))  # importing costs nothing
from tests.command import command
os.chdir(sys.argv[1])
print(len(coincid.simulate(None, "flat:5,0.5", rows=8, cols=8, pulses=5).events()) > 0)
for words in sys.argv[2:]:
    done = command(words)
    print(done.exit_code, done.stderr.count("\\n"), "pip install 'coincid[rtl]'" in done.stderr)
"""
WITHOUT_RTL = [
    "replay --config small.toml --edges edges.npz --out result.npz --engine golden",
    "sim --config small.toml --scene flat:5,0.4 --out sim --engine golden",
    "photons --config small.toml --out photons.npz",
]
WITH_RTL = "verilog lint synth gls layout pnr formal bench".split()


def test_only_what_has_rtl_needs_its_tools(tmp_path):
    """The library and other commands run; those with RTL say in one line what is missing. All in
    one process.
    """
    np.savez(tmp_path / "edges.npz", **{name: np.arange(3) for name in ("pulse", "pixel", "tick")})
    (tmp_path / "small.toml").write_text(
        "[sensor]\nrows = 8\ncols = 8\n[frame]\npulses = 3\n", encoding="utf-8"
    )
    lack = [words.replace("golden", "sliced") for words in WITHOUT_RTL[:2]] + WITH_RTL
    block = f"import sys\nsys.modules |= dict.fromkeys({RTL_TOOLS!r})\n"
    program = [sys.executable, "-c", block + RUN, tmp_path, *WITHOUT_RTL, *lack]
    done = subprocess.run(program, capture_output=True, text=True, check=False, encoding="utf-8")
    told = ["set()", "True", *["0 0 False"] * len(WITHOUT_RTL), *["2 1 True"] * len(lack)]
    assert done.stdout.splitlines() == told, done.stderr


def test_an_array_of_distances_is_a_scene():
    far_m = np.full((16, 8), 7.0)
    run = coincid.simulate(
        None, far_m, reflectivity=0.6, klux=5, **{"rows": 16, "cols": 8, "pulses": 60}
    )
    assert np.all(run.scene.truth_m == 7) and abs(np.nanmedian(run.depth().depth_m) - 7) < 0.05
    assert coincid.simulate(scene=far_m * 2, rows=8, cols=8, pulses=3).scene.truth_m.shape == (8, 8)


@pytest.mark.parametrize(
    ("arguments", "options", "words"),
    [
        (
            ("five-objects",),
            {},
            "config = 'five-objects': is a scene; the configuration comes first",
        ),
        (("flat:5",), {}, "config = 'flat:5': is a scene"),
        ((np.ones((8, 8)),), {}, "config = ndarray: is no configuration"),
        ((None, None), {}, "scene = None: must be a Scene"),
        ((None, "flat:5"), {"thresold": 3}, "thresold: unknown argument or setting"),
        ((None, "flat:5"), {"threshold": 99}, "subgroup.threshold = 99: must be"),
        (
            (None, "flat:5"),
            {"threshold": [3, 99, 3, 9], "rows": 16, "cols": 16},
            r"^subgroup.threshold\[1\] = 99: must be",
        ),
        ((None, "flat:5"), {"scale": 3.0}, "scale = 3.0: goes with depth files only"),
        ((None, "flat:5"), {"reflectivity": 0.9}, "reflectivity: goes with depth files and arr"),
        (
            (None, load_scene("flat:5", 8, 8)),
            {"reflectivity": 0.9},
            "^reflectivity: goes with depth",
        ),
        (
            (None, load_scene("flat:5", 8, 8)),
            {"reflectivity": np.linspace(REFLECTIVITY, 0.9, 64).reshape(8, 8)},
            "^reflectivity: goes with depth",
        ),
        (
            (None, load_scene("flat:5", 8, 8)),
            {"missing": np.ones(2)},
            "^missing: goes with depth f",
        ),
        (
            (None, load_scene("flat:5", 8, 8)),
            {"fov_deg": 30},
            "^fov_deg: goes with depth files and",
        ),
        ((None, [[5.0, 5.0]]), {}, r"scene = list \(numpy.array\(scene\) makes an array"),
        ((None, "flat:5"), {"klux": 1e12}, "klux = 1000000000000.0: is too much ambient light: a"),
    ],
)
def test_what_simulate_refuses(arguments, options, words):
    with pytest.raises(coincid.InputError, match=words):
        coincid.simulate(*arguments, **options)


def test_every_doubt_about_a_scene_is_told_of_the_line_that_simulates_it(monkeypatch):
    """Before anything is computed."""
    doubts = "It is dark.", "It is far."
    seen = SimpleNamespace(doubts=doubts)
    monkeypatch.setattr(study_run, "scene_of", lambda *given, **meaning: seen)
    monkeypatch.setattr(study_run, "for_pictures", lambda config, scene: 1 / 0)
    with pytest.warns(UserWarning) as told, pytest.raises(ZeroDivisionError):
        coincid.simulate(None, "flat:5")
    assert [(str(one.message), one.filename) for one in told] == [
        (doubt, __file__) for doubt in doubts
    ]


def test_a_saved_depth_is_that_of_the_options(run, tmp_path):
    for options in ({}, {"method": "maximum"}, {"returns": 3}):
        run.save_depth(tmp_path / "depth.npz", **options)
        expected_m = run.depth(**options).depth_m
        with np.load(tmp_path / "depth.npz") as written:
            assert np.array_equal(written["depth_m"], expected_m, equal_nan=True)


def test_a_configuration_may_have_the_name_of_a_scene(tmp_path, monkeypatch):
    """If there is such a file, it is meant."""
    monkeypatch.chdir(tmp_path)
    with pytest.raises(coincid.InputError, match="config = 'flat': is a scene"):
        coincid.simulate("flat")
    (tmp_path / "flat").write_text("[sensor]\nrows = 8\ncols = 8\n", encoding="utf-8")
    assert coincid.simulate("flat", "flat:5", pulses=3).config.sensor.rows == 8


def test_settings_are_options_of_simulate():
    given = {"threshold": 3, "pulses": 30, "window_max": 32, "spad_gate": True, "method": "maximum"}
    run = coincid.simulate(coincid.parse_config(SMALL), "flat:5,0.5", **given)
    assert (run.config.threshold.max(), run.config.pulses, run.config.sensor.window_max) == (
        3,
        30,
        32,
    )
    assert (
        run.config.sensor.rows == 16
        and run.setup.spad_gate
        and run.setup.estimators == ("maximum",)
    )
    with pytest.raises(coincid.InputError, match="estimator = -1: must be METHOD.*frame=-1"):
        run.depth(-1)


TINY = {"rows": 8, "cols": 8}


@pytest.mark.parametrize(
    ("before", "after"),
    [
        ({"gating": True, "gate_start": 100}, {"period": 80, "gate_start": 20}),
        ({"gating": True, "gate_start": 20, "period": 80}, {"gate_start": 100, "period": 250}),
        ({"period": 250}, {"coarse_bits": 7, "period": 100}),
        ({"window": 40}, {"window_max": 16, "window": 16}),
        ({"counts": 1, "format": "counts"}, {"counts": 0, "format": "id"}),
        ({"counts": 1, "format": "counts"}, {"pulses": 2, "format": "id"}),
        (
            {"counts": 1, "format": "counts", "pulses": 90, "search_pulses": 20},
            {"pulses": 4, "search_pulses": 1},
        ),
    ],
)
def test_settings_that_are_legal_together_are_taken_together(before, after):
    """Though each alone is refused, or some order of them."""
    run = coincid.simulate(coincid.load_config(None, before | TINY), "flat:3", klux=0, **after)
    expected = coincid.load_config(None, before | TINY | after)
    assert run.config.sensor == expected.sensor and run.config.frame == expected.frame
    assert run.config.register_writes() == expected.register_writes()


def test_a_setting_that_does_not_go_with_the_others_is_named():
    config = coincid.load_config(None, TINY | {"gating": True, "gate_start": 100})
    with pytest.raises(coincid.InputError) as refused:
        coincid.simulate(config, "flat:3", period=80)
    told = "frame.period: does not go with the other settings (subgroup.gate_start = 100: must be"
    assert str(refused.value).startswith(told)


def test_settings_of_subgroups_stay_where_others_change():
    """And change where they are given, as one value or as one for each."""
    own = {"subgroups": [1], "threshold": 5, "mask": "ff"}
    document = SMALL | {"subgroup": {"threshold": 2}, "override": [own]}
    config = coincid.parse_config(document)
    for after, threshold in (
        ({"pulses": 30}, [2, 5]),
        ({"threshold": 3}, [3, 3]),
        ({"threshold": [3, 4]}, [3, 4]),
    ):
        changed = coincid.simulate(config, "flat:3", klux=0, **after).config
        assert changed.threshold.tolist() == threshold
        assert np.array_equal(changed.mask, config.mask)


@pytest.mark.parametrize(
    ("compiled", "told"), [(False, "coincid: compiling the models, first run only\n"), (True, "")]
)
def test_a_first_run_says_that_it_compiles(compiled, told, monkeypatch, capsys):
    monkeypatch.setattr("coincid.study.run.is_compiled", lambda module: compiled)
    coincid.simulate(None, "flat:5", rows=8, cols=8, pulses=3)
    assert capsys.readouterr() == ("", told)


def test_every_point_has_the_numbers_of_its_return():
    """Each field of a point is another one of the depth, and each return has its own."""
    shape = (2, 3, 2)
    number = np.arange(1, 13, dtype=float).reshape(shape)
    depth = Depth(
        number,
        number / 100,
        np.arange(6, dtype=np.uint8).reshape(2, 3),
        light=Intensity(number + 20, number + 40),
    )
    points = coincid.point_cloud(depth)
    metres = np.sqrt(sum(points[name].astype(float) ** 2 for name in ("x", "y", "z")))
    assert metres == pytest.approx(number.ravel(), rel=1e-6)
    assert points["confidence"] == pytest.approx(metres / 100, rel=1e-6)
    assert points["signal"] == pytest.approx(metres + 20, rel=1e-6)
    assert points["signal_error"] == pytest.approx(metres + 40, rel=1e-6)
    assert points["reason"].tolist() == np.repeat(np.arange(6), 2).tolist()


@pytest.mark.parametrize("shape", [(1, 6), (6, 1), (1, 1)])
def test_the_normals_of_a_single_row_or_column_are_not_known(shape):
    """It does not tell how the surface slants across it."""
    depth = Depth(
        np.full((*shape, 1), 3.0),
        np.ones((*shape, 1)),
        np.zeros(shape, np.uint8),
        slope_m=np.zeros((*shape, 2)),
    )
    points = coincid.point_cloud(depth, normals=True)
    assert len(points) == shape[0] * shape[1]
    for name in ("nx", "ny", "nz"):
        assert np.isnan(points[name]).all()


def test_what_has_no_normal_has_none_and_later_returns_have_none():
    """A pixel at distance 0, or without a slope."""
    depth_m = np.full((4, 4, 2), 3.0)
    depth_m[..., 1] = 5.0
    depth_m[0, 0, 0] = 0.0
    slope_m = np.zeros((4, 4, 2))
    slope_m[1, 1] = np.nan
    sure = np.ones((4, 4, 2))
    depth = Depth(depth_m, sure, np.zeros((4, 4), np.uint8), slope_m=slope_m)
    points = coincid.point_cloud(depth, Optics(fov_h_deg=40, fov_v_deg=40), normals=True)
    has_normal = ~np.isnan(points["nz"]).reshape(4, 4, 2)
    expected = np.ones((4, 4), bool)
    expected[0, 0] = expected[1, 1] = False
    assert np.array_equal(has_normal[..., 0], expected)
    assert not has_normal[..., 1].any()
    lengths = sum(points[name].astype(float) ** 2 for name in ("nx", "ny", "nz"))
    assert lengths[has_normal.ravel()] == pytest.approx(1)
    assert (points["nz"][has_normal.ravel()] < 0).all()


PLY_KINDS = {"float": "<f4", "uchar": "u1"}


def points_of(path):
    """Return the points of a PLY file, by the fields that its header names."""
    header, _, data = path.read_bytes().partition(b"end_header\n")
    lines = [line.split()[1:] for line in header.decode().splitlines() if "property" in line]
    return np.frombuffer(data, [(name, PLY_KINDS[kind]) for kind, name in lines])


def test_ply_holds_some_of_the_fields_and_floats_of_any_kind(tmp_path):
    """NumPy takes some fields of an array as one with gaps."""
    depth_m = np.linspace(3, 4, 16).reshape(4, 4, 1)
    depth = Depth(depth_m, np.ones_like(depth_m), np.zeros((4, 4), np.uint8))
    points = coincid.point_cloud(depth)
    doubles = points[["x", "reason"]].astype([("x", ">f8"), ("reason", "u1")])
    for taken in (points[["z", "x", "reason"]], points[["y"]], doubles, points[::3]):
        coincid.write_ply(tmp_path / "cloud.ply", taken)
        read = points_of(tmp_path / "cloud.ply")
        assert read.dtype.names == taken.dtype.names
        for name in taken.dtype.names:
            assert np.array_equal(read[name], taken[name].astype("f4"), equal_nan=True), name


def test_ply_holds_normals_if_the_points_have_them(tmp_path):
    depth = Depth(
        np.full((4, 4, 1), 3.0),
        np.ones((4, 4, 1)),
        np.zeros((4, 4), np.uint8),
        slope_m=np.zeros((4, 4, 2)),
    )
    points = coincid.point_cloud(depth, normals=True)
    coincid.write_ply(tmp_path / "cloud.ply", points)
    read = points_of(tmp_path / "cloud.ply")
    assert read.dtype.names[-3:] == ("nx", "ny", "nz")
    for name in points.dtype.names:
        assert np.array_equal(read[name], points[name], equal_nan=True), name
    for wrong in (
        points.reshape(4, 4),
        np.ones(3),
        np.zeros(3, [("row", "i4")]),
        np.zeros(3, [("row", "u2")]),
        np.zeros(3, []),
    ):
        with pytest.raises(coincid.InputError, match="points: must be the array of point_cloud"):
            coincid.write_ply(tmp_path / "cloud.ply", wrong)
