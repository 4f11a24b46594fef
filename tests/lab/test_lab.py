# SPDX-License-Identifier: Apache-2.0
"""Setups, runs, measures and campaigns: stages in time, digests of content, the same outcomes from
all workers.
"""

import os
import sys
from concurrent.futures.process import BrokenProcessPool
from contextlib import nullcontext
from functools import partial

import numpy as np
import pytest
from numba.core.dispatcher import Dispatcher

from coincid.lab.campaign import FinishedFiles, Processes, campaign, grouped, read_measures
from coincid.lab.compile_ahead import estimate_anything, made_up
from coincid.lab.dask_workers import Dask
from coincid.lab.measures import MEASURES
from coincid.lab.outcomes import Run, StageCache
from coincid.lab.setup import Setup, fingerprint, seeded
from coincid.model.contract.config import parse_config
from coincid.model.contract.edges import Edges
from coincid.model.contract.packet import FORMATS, RECORD, layout
from coincid.model.depth.estimate import estimate_depth
from coincid.model.depth.quality import wrong_share
from coincid.model.golden.frame import golden_result
from coincid.model.light.spad import Spad
from coincid.model.scenes.scene import Scene
from coincid.model.shared.errors import InputError
from coincid.model.shared.interrupts import worker_processes
from coincid.model.shared.pulse import Pulse

from ..told import Told

SMALL = {
    "sensor": {"rows": 8, "cols": 24, "streams": 2},
    "frame": {"period": 60, "pulses": 20, "frames": 2},
}
BUILT = SMALL | {"sensor": {"rows": 8, "cols": 16}}  # which other tests compile, too
NAMES = ("events", "wrong_share", "events_per_s")
read = partial(read_measures, names=NAMES)


def small(**fields):
    return Setup.of("flat:5,0.4", **SMALL, **fields)


def test_a_run_is_the_golden_models_for_edges_in_any_order():
    run = Run(small(klux=20.0))
    assert run.frame().counter("stored").sum() > 0
    # a stage is computed when it is first asked for
    assert run._played_frames is not None and run._result is None
    shuffled = run.edges.take(np.random.default_rng(1).permutation(len(run.edges)))
    other = Run(run.setup.but(edges=shuffled))
    for one in (run, other):
        expected = golden_result(one.config, one.edges)
        assert all(np.array_equal(one.result[name], expected[name]) for name in expected)
        assert [one.frame(k)["events"] for k in range(2)] == expected["stored"].sum(axis=1).tolist()
    early, late = other.frame_edges(0), other.frame_edges(-1)
    assert len(early) + len(late) == len(shuffled) and late.pulse.max() < 20


@pytest.mark.parametrize("engine", ["golden", "sliced"])
def test_counters_are_those_of_the_engine_that_plays_the_frame(engine):
    """Only the golden model's come without a result."""
    run = Run(Setup.of("flat:5,0.4", **BUILT, engine=engine))
    assert run.frame().counter("stored").sum() > 0
    assert run.has_result == (engine != "golden")


def test_without_coincidence_the_threshold_is_1_whatever_is_set():
    setup = small(subgroup={"threshold": 3})
    assert Run(setup).frame().threshold.tolist() == [3, 3, 3]
    mixed = setup.but(config=setup.config.with_settings(coincidence=np.array([True, False, True])))
    assert Run(mixed).frame().threshold.tolist() == [3, 1, 3]
    assert Run(mixed)["threshold_mean"] == pytest.approx(7 / 3)


def compiled_estimators():
    """Return the kernels of the estimators and the types for which they are compiled, before and
    after a real frame.
    """

    def signatures():
        modules = [
            module
            for name, module in sorted(sys.modules.items())
            if name.startswith("coincid.model.depth.")
        ]
        found = {
            f for module in modules for f in vars(module).values() if isinstance(f, Dispatcher)
        }
        return {f.__name__: list(map(str, f.signatures)) for f in found}

    estimate_anything()
    before, run = signatures(), Run(small(klux=20.0, estimators=("planes", "maximum")))
    for name in run.setup.estimators:
        assert run.frame(estimator=name)["wrong_share"] is not None
    return before, signatures()


def test_the_made_up_frame_has_all_code_of_the_estimators_compiled():
    with worker_processes(1) as pool:
        before, after = pool.submit(compiled_estimators).result()
    assert before == after and sum(map(len, after.values())) > 10


def test_a_changed_setting_keeps_the_photons_and_another_seed_does_not():
    run = Run(small(), cache=StageCache(2))
    assert run.but(subgroup={"threshold": 3}).edges is run.edges
    assert run.but(seed=2).edges is not run.edges
    alone = run.alone(-1, subgroup={"threshold": 3})
    assert alone.config.frames == 1 and np.array_equal(alone.edges.tick, run.frame_edges(1).tick)


def test_tables_that_are_legal_together_are_taken_together():
    """Though the first of them alone is refused; values of subgroups stay."""
    own = {"gating": True, "gate_start": 50, "threshold": [2, 5, 3]}
    before = small().but(subgroup=own)
    changed = before.but(frame={"period": 40}, subgroup={"gate_start": 20}).config
    own["gate_start"] = 20
    expected = small().but(frame={"period": 40}).but(subgroup=own).config
    assert changed.register_writes() == expected.register_writes()


@pytest.mark.parametrize("kind", [list, tuple, np.array, np.uint8])
def test_values_of_subgroups_may_be_a_list_or_an_array(kind):
    changed = small().but(subgroup={"threshold": kind([2, 5, 3]), "window": 9}).config
    assert changed.threshold.tolist() == [2, 5, 3]
    assert changed.window.tolist() == [9, 9, 9]


def test_without_an_estimator_there_is_no_depth():
    run = Run(small(estimators=()))
    assert run["edges"]
    for ask in (run.depth, lambda: run["wrong_share"]):
        with pytest.raises(InputError, match="estimators: is empty, so there is no depth"):
            ask()
    assert run.depth("maximum").depth_m.shape[2] == 1


def test_a_frame_by_an_estimator_is_of_that_estimator():
    """In any order, and again."""
    run = Run(small(klux=20.0, estimators=("matched", "maximum")))
    for name in ("maximum", "matched", "maximum", "matched/subgroup"):
        expected = run.depth(name, frame=0).depth_m[:, :, 0]
        for frame in (run.frame(0, name), run.frame(0).by(name)):
            assert np.array_equal(frame.depth_m, expected, equal_nan=True)
    assert run.frame(0, "matched") is run.frame(-2, "matched")
    assert np.array_equal(run.frame(0).depth_m, run.frame(0, "matched").depth_m, equal_nan=True)


def test_the_load_is_that_of_the_busiest_stream():
    frame = Run(small(klux=20.0)).frame(0)
    busiest, other = sorted(frame.beats.tolist(), reverse=True)
    assert busiest > other > 0
    assert frame["stream_load"] == busiest / frame.config.frame_cycles
    assert frame["link_load"] == busiest / (
        frame.config.frame_cycles * float(frame.config.link_share)
    )


def test_a_cache_keeps_what_was_asked_for_last():
    made = []
    cache = StageCache(2)
    for key in "abacb":
        assert cache.get("photons", key, lambda key=key: made.append(key) or key) == key
    assert made == list("abcb")  # "a" was there, and "b" the one asked for the longest ago
    assert cache.get("frames", "a", lambda: "another stage") == "another stage"


def test_arrays_of_equal_bytes_have_keys_of_their_own():
    bits = np.array([0, 1, 2, 3], np.int64)
    alike = (bits, bits.reshape(2, 2), bits.reshape(4, 1), bits.view(np.uint64), bits.view("f8"))
    assert len({fingerprint(one) for one in alike}) == len(alike)
    assert fingerprint(bits) == fingerprint(bits.copy()) == fingerprint(np.stack([bits, bits])[0])


@pytest.mark.parametrize("holder", [list, tuple, lambda arrays: {"of": arrays}])
def test_arrays_within_containers_have_keys_of_their_own(holder):
    """Long ones, which text would abridge."""
    first = np.zeros(5000)
    other = first.copy()
    other[2500] = 1
    assert fingerprint(holder([first])) != fingerprint(holder([other]))
    assert fingerprint(holder([first])) == fingerprint(holder([first.copy()]))


def test_a_table_holds_counts_beyond_32_bits():
    from coincid.lab.outcome_table import to_table

    found = [{"photons": 1 << 40, "wrong_share": 1 / 3}, {"photons": 1, "wrong_share": None}]
    table = to_table([{"klux": 1}, {"klux": 2.5}], found)
    assert table.to_pydict() == {
        "klux": [1.0, 2.5],
        "photons": [1 << 40, 1],
        "wrong_share": [1 / 3, None],
    }


@pytest.mark.parametrize(
    ("name", "values", "expected"),
    [
        ("klux", [50, 100], [50.0, 100.0]),
        ("clock_mhz", [125, 500], [125.0, 500.0]),
        ("frame.clock_mhz", [125, 500], [125.0, 500.0]),
        ("pulses", [100, 200], [100, 200]),
        ("frame.format", ["id", "full"], ["id", "full"]),
        ("auto", [True, False], [True, False]),
    ],
)
def test_a_column_of_values_has_one_type_whatever_was_swept(name, values, expected):
    """A real setting is one also where only whole numbers are among its values."""
    from coincid.lab.outcome_table import to_table

    table = to_table([{name: value} for value in values], [{"beats": 1}] * 2)
    found = table.to_pydict()[name]
    assert found == expected
    assert [type(one) for one in found] == [type(one) for one in expected]


def test_klux_of_a_file_counts_by_its_content(tmp_path):
    """A campaign does not take what it has found in another light."""
    path = tmp_path / "sun.npy"
    keys = []
    for klux in (10.0, 90.0, 10.0):
        np.save(path, np.full((8, 8), klux))
        keys.append(small(klux=str(path)).key)
    assert keys[0] == keys[2] != keys[1]
    path.unlink()
    assert small(klux=str(path)).key not in keys


def test_equal_content_has_equal_keys_and_every_field_counts():
    setup = small()
    assert setup.key == small().key
    edges = Edges(*(np.zeros(1, np.int64) for _ in range(3)))
    changes = {
        "klux": 5.0,
        "background": "even",
        "spad": Spad(dead_time_s=9e-9),
        "spad_gate": True,
        "seed": 2,
    }
    changes |= {"engine": "sliced", "view": "async", "estimators": ("maximum",), "edges": edges}
    changes |= {
        "scene": Setup.of("flat:6,0.4", **SMALL).scene,
        "config": setup.config.with_settings(threshold=3),
    }
    changes["light"] = Run(setup).light
    changes["pulse"] = Pulse.gaussian(300e-12)
    assert changes.keys() == {field.name for field in Setup.__attrs_attrs__}
    keys = {name: setup.but(**{name: value}).key for name, value in changes.items()}
    assert len({setup.key, *keys.values()}) == 1 + len(changes)


def test_a_setup_of_light_without_a_scene_has_a_key():
    """Whatever the light of the scene that it has not."""
    whole = small()
    bare = Setup(config=whole.config, light=Run(whole).light)
    keys = {setup.key for setup in (whole, bare, bare.but(seed=2), bare.but(klux="2|100"))}
    assert len(keys) == 4
    assert bare.key == Setup(config=whole.config, light=Run(whole).light).key


def test_measures_are_those_of_the_last_frame():
    """Compute them from the result's arrays, for two frames of the controller, in full format with
    records.
    """
    frame = {
        "period": 40,
        "pulses": 10,
        "frames": 2,
        "format": "full",
        "minigroup_records": True,
        "capacity": 1,
    }
    setup = Setup.of(
        "letter-f",
        sensor={"rows": 8, "cols": 8},
        frame=frame | {"auto_bounds": [1, 2, 3, 400, 500, 600]},
    )
    run = Run(setup.but(subgroup={"auto": True, "threshold": 3}, seed=3))
    assert all(type(run[name]) in (measure.kind, type(None)) for name, measure in MEASURES.items())
    assert run["opened"] == run["committed"] + run["rejected"] and run["bits"] == 64 * run["beats"]
    assert run["stream_load"] <= run["link_load"] and run["wrong_share_15cm"] <= run["wrong_share"]
    assert run["off_surface_share"] == run["wrong_share"]  # one target per pixel
    arrays, truth_m = golden_result(run.config, run.edges), run.scene.truth_m
    assert run["threshold_mean"] == 4
    assert run["edges"] == np.sum(run.edges.pulse >= 10)
    assert run["events"] == np.sum(arrays["pulse"] >= 10) > 0
    assert run["overruns"] == np.sum(arrays["overrun"][arrays["pulse"] >= 10])
    assert run["mg_records"] == np.sum(arrays["mg_pulse"] >= 10) > 0
    assert run["committed"] == run["events"] + run["dropped"] == 10 * run["commits_per_pulse"]
    parts = layout(run.config.sensor)
    packets = run["events"] * parts.length(FORMATS["full"]) + run["mg_records"] * parts.length(
        RECORD
    )
    assert run["beats"] == packets + 2 + parts.counter_beats == 400 * run["stream_load"]
    depth_m = estimate_depth(arrays, run.config, frame=1).depth_m[:, :, 0]
    assert run["wrong_share"] == wrong_share(depth_m, truth_m)
    assert run["depth_share"] == np.mean(~np.isnan(depth_m))
    assert run["bias_m"] == pytest.approx(np.nanmean(depth_m - truth_m))
    assert run["rms_m"] == pytest.approx(np.sqrt(np.nanmean((depth_m - truth_m) ** 2)))
    assert abs(run["right_bias_m"]) <= run["right_rms_m"] < 0.035


@pytest.mark.parametrize("name", [name for name, packet in FORMATS.items() if not packet.grouped])
def test_beats_are_those_of_the_golden_model(name):
    """Of a link that drops events and records, too."""
    changes = {"format": name, "minigroup_records": True, "link_gbps": 0.5}
    with_counts = small().config.with_sensor(counts=1)
    frame = Run(small().but(config=with_counts, frame=changes)).frame()
    assert frame.counter("mg_stored").any() == (name != "counts")
    assert frame.counter("dropped").any() == (name != "counts")
    assert frame.beats.tolist() == list(map(len, frame.trace.beats))


def test_measures_know_waits_and_missing_truth():
    waits = Run(small().but(frame={"dither_bits": 6, "frames": 1}))
    assert waits["stream_load"] == pytest.approx(
        waits.frame().beats.max() / waits.config.frame_cycles
    )
    assert waits.config.frame_cycles > 20 * 60
    # of two streams
    assert waits["capacity_share"] == waits["committed"] / (2 * waits.config.capacity)
    nowhere = Run(Setup.of("letter-f", **SMALL)).but(subgroup={"mask": "0"})
    assert nowhere["dropped_share"] is None and nowhere["wrong_share"] == 1


def test_outcomes_do_not_depend_on_the_workers():
    groups = {"few": seeded(small(), 2), "off": [small().but(subgroup={"coincidence": False})]}
    found, counted = [grouped(groups, read, Dask(1))], []
    for workers in (Processes(1, lambda *done: counted.append(done)), Processes(2)):
        with workers:
            found.append(grouped(groups, read, workers))
    assert found[0] == found[1] == found[2]
    assert counted == [(1, 3), (2, 3), (3, 3)]
    assert [len(group) for group in found[0].values()] == [2, 1]


@pytest.mark.parametrize(("asked", "taken"), [(None, os.cpu_count()), (1, 1), (3, 3)])
def test_there_is_one_worker_per_core_unless_a_number_is_asked_for(asked, taken):
    assert Processes(asked).workers == taken


def test_a_campaign_continues_and_plays_equal_setups_once(tmp_path):
    finished = FinishedFiles(tmp_path, NAMES)
    asked = []

    def counted(run):
        asked.append(run.setup.seed)
        return read(run)

    with Processes(1) as workers:
        first = campaign(
            {seed: small(seed=seed) for seed in (1, 2)}, counted, workers, finished=finished
        )
        (tmp_path / f"{small(seed=2).key}.json").write_text("{", encoding="utf-8")  # spoilt
        setups = {
            "a": small(seed=1),
            "b": small(seed=2),
            "c": small(seed=3),
            "again": small(seed=3),
        }
        told = []
        second = campaign(setups, counted, workers, finished=finished, progress=told.append)
    assert asked == [1, 2, 2, 3] and told == [1, 2, 3]
    assert (second["a"], second["b"]) == (first[1], first[2]) and second["c"] == second["again"]
    assert FinishedFiles(tmp_path, NAMES[::-1]).load(small(seed=1).key) is None  # other columns


def test_setups_that_share_the_words_of_the_rtl_come_out_as_alone():
    """Setups of two scenes are played at once; one that cannot be read fails alone."""
    far, near = (
        Setup.of(wall, **BUILT, engine="sliced").but(subgroup={"auto": True})
        for wall in ("flat:5,0.4", "flat:3,0.4")
    )
    setups = {1: far.but(seed=1), 2: near.but(seed=2), 3: far.but(seed=3)}
    setups["bad"] = near.but(estimators=("guess",))
    alone = {seed: read(Run(setup)) for seed, setup in setups.items() if seed != "bad"}
    for opened in (Processes(1), nullcontext(Dask(2))):
        failed = {}
        told = []
        with opened as workers:
            found = campaign(setups, read, workers, failed=failed, progress=told.append)
            assert found == alone
            assert told == [0, 1, 2, 3, 4]  # one that fails is done, too
            with pytest.raises(InputError, match="guess"):
                campaign(setups, read, workers)
        assert failed.keys() == {"bad"} and isinstance(failed["bad"], InputError)


def _ends_its_process(run):
    """Read a run as a worker that the system stops, for example for want of memory."""
    os._exit(1)


def test_setups_of_a_worker_that_is_stopped_fail_each():
    setups = {seed: small(seed=seed) for seed in (1, 2, 3)}
    failed = {}
    told = []
    with Processes(2) as workers:
        found = campaign(setups, _ends_its_process, workers, failed=failed, progress=told.append)
    assert not found
    assert failed.keys() == setups.keys()
    assert all(isinstance(error, BrokenProcessPool) for error in failed.values())
    assert told[-1] == len(setups)


def test_pixels_without_a_truth_are_in_no_share():
    """Half of the pixels are holes, and all depths are wrong."""
    distance_m = np.full((8, 8), 5.0)
    distance_m[:, ::2] = np.nan
    scene = Scene(name="holes", distance_m=distance_m, reflectivity=np.full((8, 8), 0.4))
    setup = Setup.of(scene, sensor={"rows": 8, "cols": 8}, frame={"pulses": 5})
    run = Run(setup.but(estimators=(Told(9.0),)))
    for measure in ("off_surface_share", "wrong_share", "wrong_share_15cm"):
        assert run[measure] == 1.0, measure


def test_progress_of_several_campaigns_is_that_of_all():
    """Setups and other tasks count alike, and nothing is done more often than there is to do."""
    told = []
    with Processes(1, lambda done, total: told.append((done, total))) as workers:
        campaign({seed: small(seed=seed) for seed in (1, 2)}, counted_edges, workers)
        workers.map(abs, [-1, -2, -3])
        campaign({3: small(seed=3)}, counted_edges, workers)
    assert told == [(1, 2), (2, 2), (3, 5), (4, 5), (5, 5), (6, 6)]


def counted_edges(run):
    return run["edges"]


def test_what_follows_the_period_follows_it_in_setups_beside_an_override():
    override = {"subgroups": [1], "gate_len": 20}
    tables = {"sensor": SMALL["sensor"], "override": [override]}
    setup = Setup(config=parse_config(tables), scene=small().scene)
    longer = setup.but(frame={"period": 400})
    for changed in (longer, setup.but(frame={"pulses": 9}).but(frame={"period": 400})):
        assert changed.config.gate_len.tolist() == [400, 20, 400]
    own = setup.but(frame={"period": 400}, subgroup={"gate_len": [1, 2, 3]})
    assert own.config.gate_len.tolist() == [1, 2, 3]
    assert longer.but(subgroup={"gate_len": 7}).config.gate_len.tolist() == [7, 7, 7]


def test_klux_of_maps_among_numbers_are_texts_in_a_table():
    """A column has one type; other settings keep theirs."""
    from coincid.lab.outcome_table import to_table

    found = [{"photons": 1}, {"photons": 2}]
    found.append({"photons": 3})
    varied = [
        {"klux": 50.0, "threshold": 1},
        {"klux": "map.npy", "threshold": 2},
        {"klux": 123456.75, "threshold": 3},
    ]
    table = to_table(varied, found, error=("what went wrong", ["", "no", ""]))
    assert table.to_pydict() == {
        "klux": ["50", "map.npy", "123456.75"],
        "threshold": [1, 2, 3],
        "photons": [1, 2, 3],
        "error": ["", "no", ""],
    }
    told = [table.schema.field(name).metadata[b"meaning"].decode() for name in table.column_names]
    assert told[:2] == ["swept", "swept"] and told[3] == "what went wrong"
    assert told[2] == MEASURES["photons"].meaning
    assert to_table([], []).num_columns == 0


def test_a_made_up_frame_has_an_event_of_each_subgroup_in_every_fourth_pulse():
    config = parse_config({"sensor": {"rows": 16, "cols": 16}, "frame": {"pulses": 20}})
    arrays = made_up(config)
    places = sorted(zip(arrays["subgroup"].tolist(), arrays["pulse"].tolist(), strict=True))
    assert places == [(s, pulse) for s in range(4) for pulse in range(0, 20, 4)]
    assert set(arrays["count"].tolist()) == {2}
    assert arrays["hits"].tolist() == [[3]] * len(places)
    assert set(arrays["stamp"].tolist()) == {config.period_ticks // 2}
    assert arrays["threshold_used"].tolist() == [[1] * 4]
    assert arrays["opened"].tolist() == [[20] * 4]


def test_copies_of_a_setup_have_the_seeds_from_1_on():
    setup = small(klux=20.0)
    copies = seeded(setup, 3)
    assert [one.seed for one in copies] == [1, 2, 3]
    assert all(one.config is setup.config and one.scene is setup.scene for one in copies)
