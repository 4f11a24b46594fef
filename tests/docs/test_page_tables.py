# SPDX-License-Identifier: Apache-2.0
"""Tables of the pages from rows of figures and sweeps: made-up rows, with every case that a table
looks for.
"""

from itertools import product

import pytest

from docs.studies import sweep_tables
from docs.studies.figures import (
    four_modes,
    interference,
    modes_page,
    paper_page,
    reconstruction,
    rivals,
    rivals_page,
)
from docs.studies.figures.page_parts import per_cent
from docs.studies.figures.sections import Comparison, Section


@pytest.fixture
def written(monkeypatch):
    """Return the texts that programs give to the pages, by region, while no picture is drawn."""
    texts = {}
    for module in (modes_page, paper_page, rivals_page, sweep_tables):
        monkeypatch.setattr(
            module, "put", lambda page, name, text=None: texts.__setitem__(name, text)
        )
        if module is not sweep_tables:
            monkeypatch.setattr(module, "save", lambda section, **names: None)
    return texts


def given(monkeypatch, module, rows=(), comparisons=()):
    """Let every figure of a module have these rows; the first one has their names."""
    monkeypatch.setattr(
        module, "made", lambda family: Section("name", "title", [], rows, comparisons)
    )


def test_shares_in_per_cent():
    assert [per_cent(share) for share in (0, 0.004, 0.0995, 0.1, 0.534)] == [
        "0 %",
        "0.4 %",
        "10 %",
        "10 %",
        "53 %",
    ]


def test_bits(monkeypatch, written):
    head = (
        "scheme",
        "pulses",
        "klux",
        "threshold",
        "wrong_share",
        "off_by_15_cm_share",
        "bits_per_frame",
    )
    cells = product({*rivals_page.BITS_ROWS.values()}, rivals_page.BITS_COLUMNS)
    rows = [
        (scheme, pulses, klux, threshold, 0.053, 0, 1102400.0)
        for (scheme, threshold), (pulses, klux) in cells
    ]
    given(monkeypatch, rivals_page, [head, *rows])
    rivals_page.bits()
    assert written["bits"].count(" 5.3 % (1,102) ") == len(rivals_page.BITS_ROWS) * len(
        rivals_page.BITS_COLUMNS
    )
    assert {scheme for scheme, _ in rivals_page.BITS_ROWS.values()} <= rivals.SCHEMES.keys()


def test_schemes(monkeypatch, written):
    rows = [
        (
            "scheme",
            "klux",
            "wrong_share",
            "bits_per_frame",
            "distance_m",
            "detected_share",
            "step_m",
        )
    ]
    for scheme in rivals.SHOWN:
        rows += [
            (scheme, klux, 0.25, 1000.0 * klux, 20.0, 0.95 if klux == 100 else 0.1, 0.1)
            for klux in rivals.KLUX
        ]
    given(monkeypatch, rivals_page, rows)
    rivals_page.schemes()
    assert "| this: fixed | 25 % | 25 % | 25 % | 10 to 100 | 20 m | never |" in written["schemes"]


def test_second_lidar(monkeypatch, written):
    head = ("scheme", "photons_per_pulse", "period_offset", "dither_bits", "wrong_share")
    rows = [
        (scheme, *key, 0.5)
        for scheme, key in product(interference.SHOWN, rivals_page.OTHER_LIDAR.values())
    ]
    given(monkeypatch, rivals_page, [head, *rows])
    rivals_page.second_lidar()
    assert "| same period | 50 % | 50 % | 50 % | 50 % | 50 % |" in written["errors"]
    assert {photons for photons, _, _ in rivals_page.OTHER_LIDAR.values()} <= {
        *interference.PHOTONS
    }
    assert {bits for _, _, bits in rivals_page.OTHER_LIDAR.values()} <= {*interference.DITHER_BITS}


def test_far(monkeypatch, written):
    ours = dict(
        zip(
            four_modes.SCHEDULES.values(),
            (
                "5 nJ, threshold 2, 0.8 cm RMS",
                "more than 500 nJ",
                "2.5 nJ, coincidence off, 1.0 cm RMS",
            ),
            strict=True,
        )
    )
    given(
        monkeypatch, modes_page, (), [Comparison("least laser pulse, 10%, 1000 pulses", "-", ours)]
    )
    modes_page.far()
    assert "| 10 % | 1000 | 5 nJ, 0.8 cm | more than 500 nJ | 2.5 nJ, 1.0 cm |" in written["far"]


def test_figures_6_and_8(monkeypatch, written):
    rows = [("panel", "klux", "source", "pulses", "estimator", "object", "wrong_share")]
    for panel, source in product("abc", ("literal", "corrected", "Monte Carlo")):
        for method in reconstruction.METHODS if source == "Monte Carlo" else ("maximum",):
            shares = {1: 0.2, 2: 0.9, "all": 0.41}
            rows += [
                (panel, 5.0, source, 100, method, label, share) for label, share in shares.items()
            ]
    ours = dict.fromkeys(paper_page.SOURCES_8.values(), "9.5% (threshold 2)")
    comparisons = [Comparison(f"8{panel}: title", "7 %", ours) for panel in "abc"]
    given(monkeypatch, paper_page, rows, comparisons)
    paper_page.figure_6()
    assert (
        "| planes | 41.0 % | 1 |" in written["fig6a"]
        and "images/paper_fig6c.png" in written["fig6c"]
    )
    paper_page.figure_8()
    assert "| matched, minigroup stamps | 9.5 % (2) | 9.5 % (2) | 9.5 % (2) |" in written["fig8"]


def test_figures_2_and_7(monkeypatch, written):
    """Each reading has its own distance; each light and threshold has the numbers of every source."""
    distances_m = {key: 1.25 + k for k, key in enumerate(paper_page.READINGS)}
    monkeypatch.setattr(
        paper_page.light_over_distance,
        "zero_m",
        lambda form, key: distances_m[key] if form == "literal" else 0.0,
    )
    paper_page.figure_2()
    for key, told in paper_page.READINGS.items():
        assert f"| {key} | {told} | {distances_m[key]:.2f} m |" in written["fig2"]
    comparisons = []
    for k, (which, klux) in enumerate(product(("highest", "lowest"), ("5 klux", "50 klux"))):
        ours = {name: f"{10 * k + j}" for j, name in enumerate(paper_page.COLUMNS_7.values())}
        quantity = f"{which} threshold within 1 % of the best, {klux}"
        comparisons.append(Comparison(quantity, "-", ours))
    given(monkeypatch, paper_page, (), comparisons)
    paper_page.figure_7()
    assert "| 50 klux | highest | 10 | 11 | 12 | 13 |" in written["fig7"]
    assert "| 5 klux | lowest | 20 | 21 | 22 | 23 |" in written["fig7"]
    assert "images/paper_fig7.png" in written["fig7"]


def test_streams(monkeypatch, written):
    rows = []
    for (rows_, cols), threshold, form, records in product(
        ((32, 32), (64, 64), (128, 256)), (2, 3), sweep_tables.FORMATS, (False, True)
    ):
        for streams in (1, 2):
            lost = 30 if streams == 1 else 0
            key = {
                "sensor.rows": rows_,
                "sensor.cols": cols,
                "sensor.streams": streams,
                "frame.format": form,
            }
            key |= {"subgroup.threshold": threshold, "frame.minigroup_records": records}
            rows.append(
                key
                | {
                    "beats": 1234,
                    "events": 70,
                    "dropped": lost,
                    "mg_records": 10,
                    "mg_dropped": 10 * records,
                }
            )
    monkeypatch.setattr(sweep_tables, "rows_of", lambda name, *measures: rows)
    sweep_tables.streams()
    assert (
        "| 256x128 | 50 | 3 | id | 1,234 | 2 | 30.0% | > 2 | 30.0% | 50.0% |" in written["streams"]
    )
