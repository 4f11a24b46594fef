# SPDX-License-Identifier: Apache-2.0
"""Tables that sweeps make, from made-up measures of the points of their own SPEC files.

Each cell is computed again from the points that belong to it, and no two measures are equal.
"""

import tomllib
from itertools import product

import numpy as np
import pytest

from docs.studies import sweep_tables

from .test_study_tables import cells_of

FORMATS = "id", "compact", "full", "compact-full"


@pytest.fixture
def written(monkeypatch):
    """Return the texts that the sweeps give to their pages, by region."""
    texts = {}
    monkeypatch.setattr(
        sweep_tables, "put", lambda page, name, text=None: texts.__setitem__(name, text)
    )
    return texts


def rows_of_spec(name):
    """Return the values of all points of docs/sweep-NAME.toml, in order, by key."""
    text = (sweep_tables.folder() / "docs" / f"sweep-{name}.toml").read_text(encoding="utf-8")
    steps = []
    for axis in tomllib.loads(text)["axis"]:
        columns = {}
        for key, part in axis.items():
            inner = part.items() if isinstance(part, dict) else [("", part)]
            columns |= {f"{key}.{name}".strip("."): values for name, values in inner}
        steps.append(
            [
                dict(zip(columns, values, strict=True))
                for values in zip(*columns.values(), strict=True)
            ]
        )
    return [
        {key: value for step in point for key, value in step.items()} for point in product(*steps)
    ]


@pytest.fixture
def points(monkeypatch):
    """Return a function: the points of a SPEC, each with its own measures."""
    scale = {"events": 9_000, "beats": 90_000, "threshold_mean": 7.0}

    def made(name, *measures):
        rng = np.random.default_rng(9)
        return [
            row | {one: scale.get(one, 1.0) * rng.uniform(0.1, 0.9) for one in measures}
            for row in rows_of_spec(name)
        ]

    monkeypatch.setattr(sweep_tables, "rows_of", made)
    return made


def chosen(rows, **values):
    """Return the rows with these values; __ in a name stands for its point."""
    return [
        row
        for row in rows
        if all(row[name.replace("__", ".")] == value for name, value in values.items())
    ]


def mean_of(rows, measure):
    assert rows
    return sum(row[measure] for row in rows) / len(rows)


def test_beats_per_event(points, written):
    sweep_tables.compact()
    rows = points("compact", "events", "beats")
    for form, (name, *cells) in zip(FORMATS, cells_of(written["beats"]), strict=True):
        assert name == f"`{form}`"
        for threshold, cell in zip((1, 2, 3), cells, strict=True):
            own = chosen(rows, subgroup__threshold=threshold, frame__format=form)
            beats = [(row["beats"] - sweep_tables.FRAME_BEATS) / row["events"] for row in own]
            assert cell == f"{np.mean(beats):.2f}"


def test_a_frame_without_events_has_the_beats_that_are_left_out():
    """A start, an end, and the counters of 16 subgroups, two in a beat."""
    counters = 11
    assert 1 + 1 + 16 * -(-counters // 2) == sweep_tables.FRAME_BEATS


def test_what_links_carry(points, written):
    sweep_tables.links()
    rows = points("links", "events", "wrong_share")
    for gbps, (name, *cells) in zip((2, 4, 8, 16, 32), cells_of(written["links"]), strict=True):
        assert name == f"{gbps}"
        told = []
        for form in FORMATS:
            own = chosen(rows, frame__link_gbps=gbps, frame__format=form)
            told += [f"{mean_of(own, 'events'):,.0f}", f"{mean_of(own, 'wrong_share'):.1%}"]
        assert cells == told


def test_how_the_controller_settles(points, written):
    sweep_tables.settling()
    rows = points("settling", "threshold_mean", "stream_load", "dropped_share")
    table, told = written["settling"].split("\n\n")
    frames = 1, 2, 3, 4, 5, 6, 8, 12
    for number, (name, *cells) in zip(frames, cells_of(table), strict=True):
        assert name == f"{number}"
        for klux, cell in zip((5, 20, 50, 100, "5|100"), cells, strict=True):
            (one,) = chosen(rows, frame__frames=number, klux=klux)
            assert cell == f"{one['threshold_mean']:.2f} ({100 * one['stream_load']:.0f} %)"
    first, *later = [
        100 * chosen(rows, frame__frames=number, klux=100)[0]["dropped_share"] for number in frames
    ]
    told = " ".join(told.split())
    assert f"the first frame drops {first:.0f} %" in told
    assert f"drop at most {max(later):.1f} %" in told


def test_the_controller_against_constants(points, written):
    sweep_tables.gains()
    rows = points("controller", "wrong_share")
    cases = [
        (side, gbps, method)
        for side, gbps in ((32, 32), (32, 8), (64, 32))
        for method in ("planes", "maximum")
    ]
    for (side, gbps, method), cells in zip(cases, cells_of(written["gains"]), strict=True):
        own = chosen(rows, sensor__rows=side, frame__link_gbps=gbps, method=method)
        scenes = {(row["scene"], row["klux"]) for row in own}
        assert len(scenes) == 9
        shares = {}
        for row in own:
            threshold = 0 if row["subgroup.auto"] else row["subgroup.threshold"]
            shares[row["scene"], row["klux"], threshold] = row["wrong_share"]
        best = {key: min(shares[*key, one] for one in range(1, 8)) for key in scenes}
        behind = {key: shares[*key, 0] - best[key] for key in scenes}
        worst = max(behind, key=behind.get)
        constants = [np.mean([shares[*key, one] for key in scenes]) for one in range(1, 8)]
        assert cells[:5] == [
            f"{side} x {side}",
            f"{gbps}",
            {"planes": "planes", "maximum": "peaks"}[method],
            f"{np.mean([*best.values()]):.1%}",
            f"{np.mean([shares[*key, 0] for key in scenes]):.1%}",
        ]
        assert cells[5] == f"{min(constants):.1%} (threshold {1 + np.argmin(constants)})"
        light = str(worst[1]).replace("|", " and ")
        assert cells[6] == f"{100 * behind[worst]:.1f} points ({worst[0]}, {light} klux)"


def test_what_fifos_drop(points, written):
    sweep_tables.fifo()
    rows = points("fifo", "dropped_share")
    settings = {
        "threshold 2, map": (2, False, "id"),
        "threshold 3, map": (3, False, "id"),
        "threshold 3, map and offsets": (3, False, "full"),
        "controller, map": (3, True, "id"),
    }
    cases = [(klux, name) for klux in (5, 50, 100) for name in settings]
    for (klux, name), (light, setting, *cells) in zip(
        cases, cells_of(written["fifo"]), strict=True
    ):
        assert (light, setting) == (f"{klux}", name)
        threshold, auto, form = settings[name]
        for depth, cell in zip((2, 4, 8, 16, 32), cells, strict=True):
            own = chosen(
                rows,
                klux=klux,
                subgroup__threshold=threshold,
                subgroup__auto=auto,
                frame__format=form,
                sensor__fifo_depth=depth,
            )
            assert len(own) == 4
            assert cell == f"{100 * mean_of(own, 'dropped_share'):.2f} %"


def test_wrong_pixels_by_two_measures(points, written):
    sweep_tables.mixed()
    rows = points("mixed", "wrong_share", "off_surface_share")
    for pulses, cells in zip((100, 400), cells_of(written["wrong"]), strict=True):
        own = chosen(rows, frame__pulses=pulses)
        measures = "wrong_share", "off_surface_share"
        told = [f"{100 * mean_of(own, name):.1f} %" for name in measures]
        assert cells == [f"{pulses}", *told]
