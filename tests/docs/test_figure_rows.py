# SPDX-License-Identifier: Apache-2.0
"""Rows and lines of figures from made-up results, of which no two are equal.

A row is the mean over its own seeds, in the unit that its column names, and a line shows what the
rows of its scheme say.
"""

import numpy as np
import pytest

from docs.studies.comparison import RETURNS, Found
from docs.studies.figures import interference, noisy_spads, rivals
from docs.studies.figures.setups import Outcome


def drawn(*seed):
    """Return made-up numbers, for ever the same."""
    return np.random.default_rng([*seed])


def found_in(truth_m, *seed):
    """Return a result: a share of its own of the pixels is near the truth, in each return."""
    rng = drawn(*seed)
    shape = (*truth_m.shape, RETURNS)
    near_m = rng.choice([0.003, -0.02], shape)
    far_m = rng.choice([0.1, -0.3], shape)
    is_near = rng.random(shape) < rng.uniform(0.6, 0.9)
    depth_m = truth_m[:, :, None] + np.where(is_near, near_m, far_m)
    return Found(depth_m=depth_m, bits=int(rng.integers(1_000, 900_000)))


def truth_of(setup):
    """Return distances that the results of a setup are near to."""
    if setup.light is None:
        return setup.scene.truth_m
    sensor = setup.config.sensor
    return np.full((sensor.rows, sensor.cols), rivals.SIGN_M + min(rivals.BEHIND_M))


@pytest.fixture
def made(monkeypatch):
    """The results of the rivals by setup and scheme, in place of their simulations."""
    results = {}

    def grouped(groups, read, run):
        for k, (key, setups) in enumerate(groups.items()):
            results[key] = [
                {name: found_in(truth_of(setup), k, seed, n) for n, name in enumerate(rivals.SHOWN)}
                for seed, setup in enumerate(setups)
            ]
        return results

    monkeypatch.setattr(rivals, "grouped", grouped)
    return results


def table_of(section):
    """Return the rows of a section as dictionaries by column."""
    head, *rows = section.rows
    return [dict(zip(head, row, strict=True)) for row in rows]


def lines_of(axis):
    """Return (x, y) of each labelled line of a plot."""
    return {
        line.get_label(): (line.get_xdata(), line.get_ydata())
        for line in axis.get_lines()
        if not line.get_label().startswith("_")
    }


def shares_off(ones, scheme, truth_m, limit_m, returns=1):
    """Return the share of pixels without a return within a limit, by seed."""
    return [
        np.mean((np.abs(one[scheme].depth_m[:, :, :returns] - truth_m) > limit_m).all(axis=2))
        for one in ones
    ]


def striped_m(side, near_m, far_m):
    """Return distances that alternate every four columns."""
    return np.where(np.arange(side) // 4 % 2, far_m, near_m) * np.ones((side, side))


def bits_of(ones, scheme):
    return sum(one[scheme].bits for one in ones) / len(ones)


def test_rivals_against_background(made):
    drawn_section = rivals.background(None)
    rows = table_of(drawn_section)
    assert len(rows) == len(rivals.SHOWN) * len(rivals.KLUX)
    truth_m = rivals.load_scene(rivals.SCENE, rivals.SIDE, rivals.SIDE).truth_m[:, :, None]
    for row in rows:
        ones = made[row["klux"]]
        assert len(ones) == rivals.SEEDS
        shares = shares_off(ones, row["scheme"], truth_m, rivals.TOLERANCE_M)
        assert row["wrong_share"] == pytest.approx(np.mean(shares))
        spread = np.sqrt(np.mean((shares - np.mean(shares)) ** 2))
        assert spread > 0
        assert row["standard_error"] == pytest.approx(spread / np.sqrt(rivals.SEEDS))
        assert row["bits_per_frame"] == pytest.approx(bits_of(ones, row["scheme"]))
    ((_, figure, _),) = drawn_section.figures
    wrong, kbits = map(lines_of, figure.axes)
    for scheme in rivals.SHOWN:
        own = [row for row in rows if row["scheme"] == scheme]
        klux = [row["klux"] for row in own]
        for lines, values in (
            (wrong, [row["wrong_share"] for row in own]),
            (kbits, [row["bits_per_frame"] / 1e3 for row in own]),
        ):
            assert list(lines[scheme][0]) == klux
            assert lines[scheme][1] == pytest.approx(values)


def test_rivals_against_the_distance(made):
    drawn_section = rivals.ranging(None)
    rows = table_of(drawn_section)
    assert len(rows) == len(rivals.SHOWN) * len(rivals.RANGE_KLUX) * len(rivals.DISTANCES_M)
    for row in rows:
        ones = made[row["klux"], row["distance_m"]]
        assert len(ones) == rivals.FEW_SEEDS
        off_m = np.stack([one[row["scheme"]].depth_m[:, :, 0] for one in ones]) - row["distance_m"]
        near = off_m[np.abs(off_m) <= rivals.OTHER_SURFACE_M]
        assert row["detected_share"] == pytest.approx(near.size / off_m.size)
        if near.size:
            assert row["bias_m"] == pytest.approx(near.mean())
            assert row["precision_m"] == pytest.approx(near.std())
        else:
            assert np.isnan([row["bias_m"], row["precision_m"]]).all()
        wrong = np.mean(np.abs(off_m) > rivals.TOLERANCE_M)
        assert row["wrong_share"] == pytest.approx(wrong)
        assert row["bits_per_frame"] == pytest.approx(bits_of(ones, row["scheme"]))
    ((_, figure, _),) = drawn_section.figures
    axes = np.reshape(figure.axes, (3, len(rivals.RANGE_KLUX)))
    for column, klux in zip(axes.T, rivals.RANGE_KLUX, strict=True):
        assert column[0].get_title() == f"{klux:g} klux"
        for scheme in rivals.SHOWN:
            own = [row for row in rows if (row["scheme"], row["klux"]) == (scheme, klux)]
            half = [row for row in own if row["detected_share"] >= 0.5]
            assert half
            for axis, shown, name, unit in (
                (column[0], own, "detected_share", 1),
                (column[1], half, "bias_m", 100),
                (column[2], half, "precision_m", 100),
            ):
                at, values = lines_of(axis)[scheme]
                assert list(at) == [row["distance_m"] for row in shown]
                assert values == pytest.approx([unit * row[name] for row in shown])


def test_rivals_on_two_targets(made):
    drawn_section = rivals.two_targets(None)
    rows = table_of(drawn_section)
    assert len(rows) == len(rivals.SHOWN) * len(rivals.STEPS_M)
    for row in rows:
        truth_m = striped_m(rivals.SMALL, rivals.NEAR_M, rivals.NEAR_M + row["step_m"])
        for name, returns in (("wrong_share", 1), ("wrong_in_both_returns_share", RETURNS)):
            shares = [
                shares_off([one], row["scheme"], truth_m[:, :, None], rivals.TOLERANCE_M, returns)
                for one in made[row["step_m"]]
            ]
            assert row[name] == pytest.approx(np.mean(shares))
    ((_, figure, _),) = drawn_section.figures
    names = "wrong_share", "wrong_in_both_returns_share"
    for axis, name in zip(figure.axes, names, strict=True):
        assert "in cm" in axis.get_xlabel()
        for scheme in rivals.SHOWN:
            own = [row for row in rows if row["scheme"] == scheme]
            at, values = lines_of(axis)[scheme]
            assert at == pytest.approx([100 * row["step_m"] for row in own])
            assert values == pytest.approx([row[name] for row in own])


def test_rivals_beside_a_retroreflector(made):
    """The dark target and the sign are judged in pixels of their own."""
    drawn_section = rivals.retroreflector(None)
    rows = table_of(drawn_section)
    dark = np.ones((rivals.SMALL, rivals.SMALL), bool)
    dark[4:12, 4:12] = False
    for row in rows:
        ones = made[row["behind_m"], row["gain"]]
        depths_m = np.stack([one[row["scheme"]].depth_m for one in ones])
        behind_m = rivals.SIGN_M + row["behind_m"]
        wrong = np.abs(depths_m - behind_m)[:, dark] > rivals.TOLERANCE_M
        assert row["wrong_share_of_dark"] == pytest.approx(wrong[:, :, 0].mean())
        assert row["wrong_in_both_returns_share"] == pytest.approx(wrong.all(axis=2).mean())
        of_sign = np.abs(depths_m[:, ~dark, 0] - rivals.SIGN_M) > rivals.TOLERANCE_M
        assert row["wrong_share_of_sign"] == pytest.approx(of_sign.mean())
        assert row["bits_per_frame"] == pytest.approx(bits_of(ones, row["scheme"]))
    ((_, figure, _),) = drawn_section.figures
    axes = np.reshape(figure.axes, (RETURNS, len(rivals.BEHIND_M)))
    for column, behind_m in zip(axes.T, rivals.BEHIND_M, strict=True):
        names = "wrong_share_of_dark", "wrong_in_both_returns_share"
        for axis, name in zip(column, names, strict=True):
            for scheme in rivals.SHOWN:
                own = [
                    row for row in rows if (row["scheme"], row["behind_m"]) == (scheme, behind_m)
                ]
                at, values = lines_of(axis)[scheme]
                assert list(at) == [row["gain"] for row in own]
                assert values == pytest.approx([row[name] for row in own])


def test_a_second_lidar(monkeypatch):
    results = {}

    def grouped(groups, read, run):
        for k, (key, setups) in enumerate(groups.items()):
            results[key] = [
                interference.Result(
                    *(
                        {
                            name: drawn(k, seed, n, kind).uniform()
                            for n, name in enumerate(interference.SHOWN)
                        }
                        for kind in range(3)
                    )
                )
                for seed in range(len(setups))
            ]
        return results

    monkeypatch.setattr(interference, "grouped", grouped)
    monkeypatch.setattr(interference, "setup", lambda *key: key)
    drawn_section = interference.interference(None)
    rows = table_of(drawn_section)
    for row in rows:
        key = row["photons_per_pulse"], row["period_offset"], row["dither_bits"]
        ones = results[key]
        assert len(ones) == interference.SEEDS
        for name, part in (("wrong_share", 0), ("ghost_share", 1), ("bits_per_frame", 2)):
            mean = sum(one[part][row["scheme"]] for one in ones) / len(ones)
            assert row[name] == pytest.approx(mean)
    ((_, figure, _),) = drawn_section.figures
    left, middle, right = map(lines_of, figure.axes)
    wrong = {
        (row["scheme"], row["photons_per_pulse"], row["period_offset"], row["dither_bits"]): row[
            "wrong_share"
        ]
        for row in rows
    }
    at, values = left["wait of 0 to 15 cycles, this: fixed"]
    assert list(at) == list(interference.PHOTONS)
    assert values == pytest.approx([wrong["this: fixed", photons, 0.0, 4] for photons in at])
    at, values = middle["no wait, this: fixed planes"]
    assert list(at) == list(interference.OFFSETS)
    shown = interference.PHOTONS_SHOWN
    assert values == pytest.approx([wrong["this: fixed planes", shown, one, 0] for one in at])
    for scheme in interference.SHOWN:
        at, values = right[scheme]
        assert list(at) == [2**bits - 1 for bits in interference.DITHER_BITS]
        assert values == pytest.approx(
            [wrong[scheme, shown, 0.0, bits] for bits in interference.DITHER_BITS]
        )


def test_noisy_spads(monkeypatch):
    results = {}
    names = *(f"wrong_share_{method}" for method in noisy_spads.METHODS), "events_per_s"

    def grouped(groups, read, run):
        for k, (key, setups) in enumerate(groups.items()):
            results[key] = [
                Outcome({name: drawn(k, seed, n).uniform() for n, name in enumerate(names)}, {}, {})
                for seed in range(len(setups))
            ]
        return results

    monkeypatch.setattr(noisy_spads, "grouped", grouped)
    monkeypatch.setattr(noisy_spads, "cases", lambda seeds, **given: [None] * seeds)
    drawn_section = noisy_spads.noisy_spads(None)
    rows = table_of(drawn_section)
    means = {
        key: {name: sum(one.measures[name] for one in ones) / len(ones) for name in names}
        for key, ones in results.items()
    }
    assert len(rows) == len(means)
    for row in rows:
        own = means[row["study"], row["value"], row["threshold"]]
        assert {name: row[name] for name in names} == pytest.approx(own)
    ((_, figure, _),) = drawn_section.figures
    axes = np.reshape(figure.axes, (2, len(noisy_spads.SPADS)))
    for (above, below), (study, values) in zip(axes.T, noisy_spads.SPADS.items(), strict=True):
        assert below.get_xlabel() == study
        assert [text.get_text() for text in below.get_xticklabels()] == [
            f"{value:g}" for value in values
        ]
        events = [line.get_ydata() for line in below.get_lines()]
        for threshold, shown in zip(noisy_spads.THRESHOLDS, events, strict=True):
            own = [means[study, value, threshold] for value in values]
            assert 1e6 * np.array(shown) == pytest.approx([one["events_per_s"] for one in own])
            for method in noisy_spads.METHODS:
                _, wrong = lines_of(above)[f"threshold {threshold}, {method}"]
                assert wrong == pytest.approx([one[f"wrong_share_{method}"] for one in own])
