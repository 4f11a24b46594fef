# SPDX-License-Identifier: Apache-2.0
"""Tables of studies from made-up measures, of which no two are equal: each cell has its own."""

from itertools import product
from types import SimpleNamespace

import numpy as np
import pytest

from coincid.model.contract.config import parse_config
from coincid.model.contract.packet import BEAT_BITS, EVENT_FORMATS, layout
from coincid.model.contract.parameters import CLOCK_MHZ
from coincid.model.depth.histograms import SOURCES
from coincid.model.depth.quality import TOLERANCE_M
from docs.studies import (
    choices,
    controller_rooms,
    cost,
    count_confidence,
    limit,
    pulses_apart,
    returns,
    surfaces,
)


@pytest.fixture
def written(monkeypatch):
    """Return the texts that the study of rooms gives to its page, by region."""
    texts = {}
    monkeypatch.setattr(
        controller_rooms, "put", lambda page, name, text: texts.__setitem__(name, text)
    )
    return texts


def cells_of(text):
    """Return the cells of a Markdown table by row, without its head."""
    rows = [line.strip("|").split("|") for line in text.strip().splitlines()]
    return [[cell.strip() for cell in row] for row in rows[2:]]


def drawn(*seed, low=0.02, high=0.9):
    """Return made-up numbers, for ever the same."""
    return np.random.default_rng(seed).uniform(low, high)


def test_the_controller_in_rooms(monkeypatch, written):
    monkeypatch.setattr(
        controller_rooms,
        "kept_measures",
        lambda page, setups, names: {
            key: {name: drawn(k) for name in names} for k, key in enumerate(setups)
        },
    )
    monkeypatch.setattr(controller_rooms.Case, "setup", lambda case: None)
    found = controller_rooms.shares()
    assert len({*found.values()}) == len(found)
    controller_rooms.make()
    rows = cells_of(written["rooms"])
    for pulses, row in zip(controller_rooms.PULSES, rows, strict=True):
        scenes = [*product(controller_rooms.ROOMS, controller_rooms.KLUX)]
        shape = len(scenes), len(controller_rooms.CONSTANTS)
        of_constants = np.array(
            [
                found[room, klux, pulses, one]
                for (room, klux), one in product(scenes, controller_rooms.CONSTANTS)
            ]
        ).reshape(shape)
        controlled = np.array([found[room, klux, pulses, 0] for room, klux in scenes])
        best = of_constants.min(axis=1)
        means = of_constants.mean(axis=0)
        behind = controlled - best
        worst = np.argmax(behind)
        room, klux = scenes[worst]
        assert row == [
            f"{pulses:,}",
            f"{best.mean():.1%}",
            f"{controlled.mean():.1%}",
            f"{means.min():.1%} (threshold {controller_rooms.CONSTANTS[means.argmin()]})",
            f"{100 * behind.max():.1f} points (room {room}, {klux:g} klux: {best[worst]:.1%})",
            f"{np.sum(behind > controller_rooms.FAR_BEHIND)} of {len(scenes)}",
        ]


def made_up(apart, link_gbps):
    """Return measures of all cases of pulses apart or back to back."""
    cases = pulses_apart.cases(apart, link_gbps)
    return {
        case: {
            name: drawn(k, number, int(apart)) for number, name in enumerate(pulses_apart.MEASURES)
        }
        for k, case in enumerate(cases)
    }


def means_over_rooms(found, klux, pulses, measure, form, factor=1):
    told = []
    for threshold in pulses_apart.THRESHOLDS:
        values = [
            measures[measure]
            for case, measures in found.items()
            if case.klux == klux and case.pulses == pulses and case.threshold == threshold
        ]
        assert len(values) == len(pulses_apart.ROOMS)
        told.append(form.format(factor * sum(values) / len(values)))
    return " / ".join(told)


def test_pulses_apart(monkeypatch):
    monkeypatch.setattr(pulses_apart, "_energy_j", lambda found, pulses: 1e-6 / pulses)
    apart = made_up(apart=True, link_gbps=0.0)
    together = made_up(apart=False, link_gbps=0.5)
    rows = cells_of(pulses_apart.pulses_table(apart))
    linked = cells_of(pulses_apart.link_table(together, apart))
    keys = [*product(pulses_apart.KLUX, pulses_apart.PULSES)]
    for (klux, pulses), row, of_link in zip(keys, rows, linked, strict=True):
        at = klux, pulses
        wrong = means_over_rooms(apart, *at, "wrong_share", "{:.1%}")
        assert row == [
            f"{klux:g} klux",
            f"{pulses:,}",
            f"{1e3 / pulses:,.0f} nJ",
            wrong,
            means_over_rooms(apart, *at, "dropped_share", "{:.0%}"),
            means_over_rooms(apart, *at, "mean_gbps", "{:.1f}", 256 * 128 / 32**2),
        ]
        back = means_over_rooms(together, *at, "wrong_share", "{:.1%}")
        assert of_link == [*row[:2], back, wrong]


def test_the_laser_has_the_same_mean_power_however_its_pulses_are_spread():
    """The light of a second is that of its pulses, all of them."""
    seconds = set()
    for pulses, apart in ((100, True), (3_000, True), (3_000, False)):
        case = pulses_apart.Case(40, 10.0, pulses, apart, 0.0, 1)
        seen = case.setup()
        assert seen.config.pulses == pulses
        assert (seen.config.gap > 0) == apart
        in_a_frame = pulses * float(np.nansum(seen.light.signal_per_pulse))
        seconds.add(round(in_a_frame * pulses_apart.RATE_PER_S))
    assert max(seconds) == pytest.approx(min(seconds), rel=1e-3)


def test_the_cost_of_a_format_is_that_of_its_packets(monkeypatch):
    monkeypatch.setattr(cost, "area_per_pixel_um2", lambda sensor: 7.0 * sensor.pixels)
    for sizes in ({"subgroup": [4, 8]}, {"phases": 8}):
        sensor = parse_config({"sensor": sizes}).sensor
        row = cost.point(sensor)
        assert row["area_um2_per_pixel"] == 7 * sensor.pixels
        for name, packet in EVENT_FORMATS.items():
            beats = layout(sensor).length(packet)
            assert row[f"mevents_per_s_{name}"] == round(CLOCK_MHZ / beats, 1)
            if not packet.grouped:
                assert row[f"bits_{name}"] == BEAT_BITS * beats
        assert row["bits_compact"] < row["bits_id"]
        assert row["bits_compact"] < row["bits_compact-full"] < row["bits_full"]


def test_parts_that_a_sensor_may_leave_out():
    keys = ("choice", "um2", "async", "dark", "lit", "between", "wrong")
    rows = [{key: drawn(row, k) for k, key in enumerate(keys)} for row in range(3)]
    for number, row in enumerate(rows):
        row["choice"] = f"choice {number}"
    forms = ("{:.1f}", "{:.1f}", "{:.2f}", "{:.2f}", "{:.2f}", "{:.2f} %")
    for row, cells in zip(rows, cells_of(choices.text(rows)), strict=True):
        numbers = [*row.values()][1:]
        told = [form.format(number) for form, number in zip(forms, numbers, strict=True)]
        assert cells == [row["choice"], *told]


def test_surfaces_one_behind_the_other(monkeypatch):
    """Every cell is the mean of its own setups, for each source of histograms."""
    asked = {}

    def grouped(groups, read, run):
        asked.update(groups)
        return {
            key: [{source: drawn(k, one, s) for s, source in enumerate(SOURCES)} for one in (0, 1)]
            for k, key in enumerate(groups)
        }

    monkeypatch.setattr(returns, "grouped", grouped)
    rows = [*returns.found_rows(None)]
    shares = grouped(asked, None, None)
    for key, setups in asked.items():
        step_m, pulses, (threshold, ticks), klux, photons = key
        distances = [np.unique(one.scene.distance_m) for one in setups]
        assert [d[0] for d in distances] == [pytest.approx(m) for m in returns.NEAREST_M]
        for one, distance_m in zip(setups, distances, strict=True):
            assert np.allclose(np.diff(distance_m), step_m)
            assert (one.config.pulses, one.klux) == (pulses, klux)
            assert one.config.coincidence.all() == (threshold > 0)
            assert one.config.window[0] == ticks
        of_row = f"{100 * step_m:.0f} cm", str(pulses), returns._window(key[2]), f"{klux:g}"
        row = next(cells for cells in rows if tuple(cells[:4]) == of_row)
        told = [
            f"{100 * (shares[key][0][source] + shares[key][1][source]) / 2:.0f}"
            for source in SOURCES
        ]
        assert row[4 + returns.LIGHTS.index(photons)] == " / ".join(told)


def test_the_least_energy_for_a_point_far_away(monkeypatch):
    """At 2 nJ, just enough measurements are right; with less one is not, or too many are not."""
    enough = int(np.ceil(returns.FOUND_SHARE * returns.POINTS))

    def errors_m(energy_nj):
        right = enough if energy_nj >= 2 else enough - 1
        return [0.01] * right + [10 * TOLERANCE_M] * (returns.POINTS - right)

    monkeypatch.setattr(returns, "seeded", lambda setup, number: [setup] * number)
    monkeypatch.setattr(
        returns, "grouped", lambda groups, read, run: {key: errors_m(key[-1]) for key in groups}
    )
    for row in returns.far_rows(None):
        assert {*row[3:]} == {"2 nJ, 1.0 cm"}
    monkeypatch.setattr(
        returns, "grouped", lambda groups, read, run: {key: errors_m(0) for key in groups}
    )
    for row in returns.far_rows(None):
        assert {*row[3:]} == {"more than 10 nJ"}


def test_errors_on_surfaces(monkeypatch):
    """Of each method two shares; the dropped ones stand last."""

    def grouped(groups, read, run):
        return {
            key: [[drawn(k, seed, part) for part in range(5)] for seed in range(3)]
            for k, key in enumerate(groups)
        }

    monkeypatch.setattr(surfaces, "grouped", grouped)
    for k, (_, _, matched, planes, dropped) in enumerate(surfaces.rows(None)):
        means = [sum(drawn(k, seed, part) for seed in range(3)) / 3 for part in range(5)]
        assert matched == f"{means[1]:.1%} / {means[2]:.1%}"
        assert planes == f"{means[3]:.1%} / {means[4]:.1%}"
        assert dropped == f"{means[0]:.0%}"


def test_bounds_of_walls(monkeypatch):
    class Made:
        def __init__(self, *key):
            self.key = [round(1000 * part) for part in key]

        def __getattr__(self, name):
            return drawn(*self.key, len(name), high=9)

    monkeypatch.setattr(limit, "of_wall", Made)
    for (distance_m, reflectivity), row in zip(limit.WALLS, limit.bound_rows(), strict=True):
        walls = [Made(distance_m, reflectivity, one, limit.PULSES) for one in limit.THRESHOLDS]
        assert row == (
            f"{distance_m:g} m, {reflectivity:.0%}",
            f"{walls[0].photons_mm:.2f}",
            " / ".join(f"{one.bound_mm:.2f}" for one in walls),
            f"{walls[0].wall_photons_mm:.2f}",
            " / ".join(f"{one.wall_bound_mm:.2f}" for one in walls),
        )


def test_errors_of_estimators_beside_the_bound(monkeypatch):
    """An error is from the truth, not from its own mean, and of the pixels near the truth."""
    truth_m = np.full((2, 3), 4.0)
    off_mm = {
        "maximum": [10, 30, 10, 30, 10, 30],
        "matched": [-20, -20, -20, -20, -20, 5_000],
        "background": [0, 0, 0, 60, -5_000, 5_000],
        "planes": [5_000] * 6,
    }
    asked = []

    class Played:
        def __init__(self, setup, **given):
            asked.append((setup.scene.name, setup.config.pulses))
            self.scene = SimpleNamespace(truth_m=truth_m)

        def frame(self, estimator):
            off_m = np.array(off_mm[estimator]).reshape(2, 3) / 1e3
            return SimpleNamespace(depth_m=truth_m + off_m)

    monkeypatch.setattr(limit, "Run", Played)
    monkeypatch.setattr(
        limit,
        "of_wall",
        lambda *wall: SimpleNamespace(bound_mm=wall[0] / wall[-1], wall_bound_mm=wall[1]),
    )
    told = ["22.4 (0.0%)", "20.0 (16.7%)", "30.0 (33.3%)", "nan (100.0%)"]
    rows = [*limit.estimator_rows()]
    for (wall, pulses), row in zip(product(limit.SIMULATED, (100, 1000)), rows, strict=True):
        distance_m, reflectivity = wall
        assert row == (
            f"{distance_m:g} m, {reflectivity:.0%}",
            f"{pulses}",
            f"{distance_m / pulses:.1f}",
            f"{reflectivity:.2f}",
            *told,
        )
    assert asked == [
        (f"flat:{wall[0]:g},{wall[1]:g}", pulses)
        for wall, pulses in product(limit.SIMULATED, (100, 1000))
    ]


def test_scenes_for_the_confidence_of_counts_have_the_pulses_of_their_names():
    of_rooms = count_confidence.rooms_of(range(3, 5))
    assert [*of_rooms] == [*product((3, 4), count_confidence.PULSES)]
    for (seed, pulses), setup in of_rooms.items():
        assert setup.seed == seed
        assert setup.config.pulses == pulses
    random = count_confidence.setups_of(range(6))
    assert [setup.config.pulses for setup in random.values()] == [200, 200, 400, 400, 1000, 1000]
    for setup in (*of_rooms.values(), *random.values()):
        assert setup.config.counting
        assert setup.config.frames == 1
        assert setup.config.frame.link_gbps == 0
