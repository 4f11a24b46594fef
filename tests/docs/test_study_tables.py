# SPDX-License-Identifier: Apache-2.0
"""Tables of studies from made-up measures, of which no two are equal: each cell has its own."""

from itertools import product
from types import SimpleNamespace

import numpy as np
import pytest

from coincid.flow.power import Power
from coincid.lab.measures import stream_beats
from coincid.lab.pace import frames_per_s
from coincid.model.contract.config import parse_config
from coincid.model.contract.packet import BEAT_BITS, EVENT_FORMATS, layout
from coincid.model.contract.parameters import CLOCK_MHZ
from coincid.model.depth.histograms import SOURCES
from coincid.model.depth.quality import TOLERANCE_M
from docs.studies import (
    advice,
    brought_files,
    choices,
    controller_rooms,
    cost,
    count_confidence,
    count_cost,
    counts,
    limit,
    power_against_light,
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


def test_the_cost_of_a_parameter_is_told_for_each_of_its_values(monkeypatch):
    """A size of two sides as the number of its pixels."""
    names = ("area_um2_per_pixel", "bits_id", "bits_full", "mevents_per_s_id", "threshold_bits")
    costs = {}

    def point(sensor):
        numbers = [1000 * len(costs) + 7 * k for k in range(len(names))]
        key = sensor.subgroup, sensor.minigroup, sensor.phases
        return costs.setdefault(key, dict(zip(names, numbers, strict=True)))

    monkeypatch.setattr(cost, "point", point)
    rows = cost.sweep()
    usual = parse_config({}).sensor
    expected = []
    for parameter, (_, values) in cost.SWEEPS.items():
        for value in values:
            sizes = [usual.subgroup, usual.minigroup, usual.phases]
            sizes[list(cost.SWEEPS).index(parameter)] = value
            one = costs[tuple(sizes)]
            told = value if isinstance(value, int) else value[0] * value[1]
            numbers = [f"{one['area_um2_per_pixel']:,}", *(str(one[name]) for name in names[1:4])]
            expected.append([parameter, told, *numbers])
    assert [cost._cells(row) for row in rows] == expected


def test_each_choice_of_parts_has_its_own_areas_and_powers(monkeypatch):
    """Of a pixel in either view; the power in the dark, in the light, and between frames."""
    monkeypatch.setattr(choices, "Subgroup", lambda sensor, view: sensor)

    def mapped(sensor, view):
        um2 = 500 if view is choices.POLYPHASE else 700
        return SimpleNamespace(area_um2=sensor.pixels * (um2 + sensor.fifo_depth))

    def measured(tell, cases, **parameters):
        assert list(cases) == [choices.DARK, choices.MIDDLE]
        depth = parameters.get("fifo_depth", 0)
        totals = [SimpleNamespace(total=SimpleNamespace(total=mw + depth)) for mw in (1.0, 2.0)]
        return totals, SimpleNamespace(total=0.5 + depth)

    monkeypatch.setattr(choices, "map_block", mapped)
    monkeypatch.setattr(choices, "measure", measured)
    monkeypatch.setattr(choices, "wrong_share", lambda sensor: sensor.fifo_depth / 1000)
    monkeypatch.setattr(choices, "CHOICES", {"usual": {}, "small": {"fifo_depth": 8}})
    usual = parse_config({}).sensor.fifo_depth
    assert [list(row.values()) for row in choices.choices()] == [
        ["usual", 500.0 + usual, 700.0 + usual, 1.0, 2.0, 0.5, usual / 10],
        ["small", 508.0, 708.0, 9.0, 10.0, 8.5, 0.8],
    ]


def test_the_energy_of_a_pulse_is_what_more_pulses_take(monkeypatch):
    """The rest of a frame is that of its searches. Power during a time is energy: mW x us = nJ."""
    asked = []

    def measured(tell, cases, **sensor):
        asked.append((sensor["counts"], cases[0].frame))
        return [SimpleNamespace(total=SimpleNamespace(total=0.5))], None

    monkeypatch.setattr(count_cost, "measure", measured)
    config = parse_config({"sensor": count_cost.QUARTER, "frame": {"pulses": 5}})
    found = count_cost._frame_nj("id", 5)
    assert found == pytest.approx(0.5 * config.frame_cycles / CLOCK_MHZ / 16)
    count_cost._frame_nj("counts", 5)
    assert asked == [(form == "counts", {"format": form, "pulses": 5}) for form in ("id", "counts")]
    monkeypatch.setattr(count_cost, "_frame_nj", lambda form, pulses: 3.0 + 0.25 * pulses)
    assert count_cost.energy("counts") == pytest.approx((0.25, 3.0))


def test_the_power_of_counts_in_the_units_of_its_heads(monkeypatch):
    """Only counts have searches, once in a frame."""
    energies = {"id": (0.002, 9.0), "counts": (0.0032, 1.5)}
    monkeypatch.setattr(count_cost, "energy", lambda form: count_cost.Energy(*energies[form]))
    assert cells_of(count_cost.power_table()) == [
        ["`id`", "2.0", "", "0.06"],
        ["`counts`", "3.2", "1.50", "0.14"],
    ]


def test_the_area_of_counts_with_and_without_macros(monkeypatch):
    """A macro takes the place of the memory of each minigroup; the slack is that of the worst path."""
    monkeypatch.setattr(count_cost, "Memory", lambda rows, bits: None)
    monkeypatch.setattr(count_cost, "Subgroup", lambda sensor: sensor)

    def mapped(block):
        um2 = 1400.0 if block is None else 64_000.0 + 32_000.0 * block.counts
        return SimpleNamespace(area_um2=um2, folder=None, name="a")

    monkeypatch.setattr(count_cost, "map_block", mapped)
    monkeypatch.setattr(count_cost, "slacks_ns", lambda *_: {"a": 0.3, "b": -0.123, "c": 0.1})
    rows = cells_of(count_cost.area_table())
    assert [row[0] for row in rows] == list(count_cost.SENSORS)
    plain = ["64,000", "1,000", "", f"{1000**0.5:.1f}", "-0.12"]
    # 16 minigroups, each smaller by 400 um2
    counting = ["96,000", "1,500", "1,400", f"{1400**0.5:.1f}", "-0.12"]
    assert [row[1:] for row in rows] == [plain, counting] * 2


ONE_SUBGROUP = {"sensor": {"rows": 4, "cols": 4, "subgroup": [4, 4]}}


def minigroups_m(config, *ticks):
    """Return distances of 4 x 4 pixels, from the ticks of each minigroup, left to right and down."""
    found = np.empty((4, 4))
    for number, own in enumerate(ticks):
        row, col = 2 * (number // 2), 2 * (number % 2)
        found[row : row + 2, col : col + 2] = np.reshape(own, (2, 2))
    return found * config.tick_m


def test_ideal_gates_begin_before_the_nearest_surface_that_no_gate_has():
    """At a step of gates, not before the period. A surface at the end of a gate gets another one."""
    config = parse_config(ONE_SUBGROUP)
    none = [np.nan] * 4
    truth_m = minigroups_m(config, [1010] * 4, [100, 2000, 100, 2000], [10, 120, 10, np.nan], none)
    start = counts.ideal_gates(truth_m, counts.RULE, config, 40)
    no = counts.NO_GATE
    # a quarter is 8 ticks, a step is 4 quarters, a gate has 16
    assert start[0].tolist() == [[120, no], [4, 244], [0, 16], [no, no]]
    assert counts._outside(truth_m, start, counts.RULE, config) == pytest.approx(5 / 16)
    for first, outside in ((126, 0.75), (127, 1.0), (111, 0.75), (110, 1.0)):
        start[:] = no
        start[0, 0, 1] = first  # the surface is at a quarter more than 126
        assert counts._outside(truth_m, start, counts.RULE, config) == pytest.approx(outside)


def test_scenes_in_counts_events_and_rivals(monkeypatch):
    """Each case has a row of its own numbers; a room may be larger than its own size."""
    monkeypatch.setattr(counts, "setup", lambda case: case)

    def campaign(setups, look, run):
        return {
            case: counts.Seen((drawn(k, 1), drawn(k, 2)), drawn(k, 3), (drawn(k, 4), drawn(k, 5)),
                              5e6 * (k + 1), (drawn(k, 6), drawn(k, 7)),
                              [(drawn(k, 8), drawn(k, 9)), (drawn(k, 10), drawn(k, 11))])
            for k, case in enumerate(setups)
        }  # fmt: skip

    monkeypatch.setattr(counts, "campaign", campaign)
    rows = list(counts.scene_rows(None))
    assert rows[0][0] == "room 41, 50 klux, 1000 pulses"
    assert "room 46 x 2, 50 klux, 1000 pulses" in [row[0] for row in rows]
    assert len({row[0] for row in rows}) == len(counts.CASES)

    def pair(k, first):
        return f"{drawn(k, first):.1%} / {drawn(k, first + 1):.1%}"

    for k, (_, *cells) in enumerate(rows):
        events = f"{pair(k, 4)} ({5 * (k + 1)} Mbit)"
        assert cells == [
            pair(k, 1),
            f"{drawn(k, 3):.1%}",
            events,
            *(pair(k, n) for n in (6, 8, 10)),
        ]


def test_what_each_part_of_the_rule_of_counts_costs(monkeypatch):
    """The rule itself first; memory is that of each rule."""
    config = parse_config({"frame": {"pulses": 1000}})
    monkeypatch.setattr(counts, "setup", lambda case: SimpleNamespace(config=config))

    def campaign(setups, divide, run):
        ways = 1 + len(counts.WAYS)
        return {
            case: [(drawn(k, way), drawn(k, way, 1)) for way in range(ways)]
            for k, case in enumerate(setups)
        }

    monkeypatch.setattr(counts, "campaign", campaign)
    rows = list(counts.loss_rows(None))
    ways = {"the rule": counts.Way(counts.RULE)} | counts.WAYS
    for number, (row, (name, way)) in enumerate(zip(rows, ways.items(), strict=True)):
        bits = counts.memory_bits(way.rule, config.sensor, 1000, config.period)
        shares = [
            f"{drawn(k, number):.1%} / {drawn(k, number, 1):.1%}"
            for k in range(len(counts.DIVIDED))
        ]
        assert list(row) == [name, f"{bits:.0f}", *shares]


def test_what_leaves_a_large_array(monkeypatch):
    """Events in proportion to the pulses; frames by the slower of sensor and link."""
    events = {name: 40.0 * (k + 1) for k, name in enumerate(counts.ARRAY_EVENTS)}
    monkeypatch.setattr(counts, "campaign", lambda setups, look, run: events)
    monkeypatch.setattr(counts, "_scene", lambda case: "flat:5")
    rows = iter(counts.array_rows(None))

    def told(number):
        return f"{number:,.0f}" if number >= 100 else f"{number:.3g}"

    for pulses in (1_000, 10_000):
        for name in (*events, "counts"):
            form = "counts" if name == "counts" else name.rpartition(" ")[2]
            config = counts._array_config(form, pulses)
            assert (config.sensor.rows, config.sensor.cols) == (128, 256)
            of_subgroup = np.full(config.sensor.subgroups, events.get(name, 0) * pulses / 1000)
            none = np.zeros_like(of_subgroup)
            bits = BEAT_BITS * float(stream_beats(config, of_subgroup, none).sum())
            own, linked = frames_per_s(config), 8e9 / bits
            head = name if name == "counts" else f"events, {name}"
            numbers = bits / 1e6, 30 * bits / 1e9, own, min(own, linked)
            assert list(next(rows)) == [f"{pulses:,}", head, *map(told, numbers)]
    assert next(rows, None) is None
    tall = [counts._told(number) for number in (0.01234, 99.96, 100.4, 12345.6)]
    assert tall == ["0.0123", "100", "100", "12,346"]


def test_events_without_a_limit_have_a_stream_for_each_subgroup():
    found = counts.unlimited(counts.Setup.of("flat:5", sensor={"rows": 16, "cols": 24}))
    config = found.config
    assert config.sensor.streams == config.sensor.subgroups == 6
    assert (config.format, config.frame.link_gbps) == ("id", 0)
    assert set(config.threshold) == {1} and set(config.window) == {16}


def test_the_answer_of_an_advice_is_quoted_whole(monkeypatch):
    """In lines of the width of the page, each of which is part of the quotation."""
    sentence = " ".join(f"{number} mm" for number in range(100, 160))
    monkeypatch.setattr(advice, "advise", lambda setup, klux: SimpleNamespace(sentence=sentence))
    pages = []
    monkeypatch.setattr(advice, "put", lambda *region: pages.append(region))
    advice.make()
    ((page, name, text),) = pages
    assert (page, name) == ("docs/advise.md", "answer")
    lines = text.splitlines()
    assert all(line.startswith("> ") and len(line) <= advice.COLUMNS for line in lines)
    assert " ".join(line.removeprefix("> ") for line in lines) == sentence


def test_what_the_reading_of_pictures_does_to_a_wall(monkeypatch):
    """Lengths in mm: the mean of all pixels, the worst one, and blocks beside each other."""
    side, block = brought_files.SIDE, brought_files.BLOCK
    read_m, truth_m, found_m = (np.full((side, side), 4.0) for _ in range(3))
    read_m[: side // 4] = 3.996  # a quarter
    truth_m[3, 5] = 4.000125
    found_m[:, side // 2 :] -= 0.0015
    found_m[:block, :block] += 0.002
    found_m[0, :12] = 4.25
    seen = iter((truth_m, found_m))
    monkeypatch.setattr(brought_files, "_seen_m", lambda samples_m: read_m)
    monkeypatch.setattr(brought_files, "_z_m", lambda depth, scene: next(seen))
    monkeypatch.setattr(brought_files, "_megabytes", lambda: 12.4)
    run = SimpleNamespace(scene=SimpleNamespace(truth_m=truth_m), depth=lambda: None)
    monkeypatch.setattr(brought_files, "simulate", lambda *given, **options: run)
    texts = []
    monkeypatch.setattr(brought_files, "put", lambda page, name, text: texts.append(text))
    brought_files.make()
    off_mm = 1000 * np.abs(found_m - 4)
    means_mm = [
        1000 * found_m[row : row + block, col : col + block].mean()
        for row in range(0, side, block)
        for col in range(0, side, block)
    ]
    assert [cells[1] for cells in cells_of(texts[0])] == [
        "moves the wall by 1.00 mm, a pixel by at most 4.0 mm",
        "25.0% of the pixels move",
        "off by at most 0.125 mm",
        f"off by {np.median(off_mm):.1f} mm in the middle pixel, 250 mm in 1 of 100;"
        f" means of 8 x 8 pixels within {max(means_mm) - min(means_mm):.1f} mm of each other",
        "12 MB",
    ]


GROUPS = [name for _, name in power_against_light.GROUPS]


def measured_power():
    """Return made-up power for all cases of the page: no two numbers are equal, and the first case
    has no events.
    """
    found = []
    for k, case in enumerate(power_against_light.CASES):
        groups = {name: Power(*(drawn(k, j, i) for i in range(5))) for j, name in enumerate(GROUPS)}
        events_cps, wired, tree = 2e6 * k, 30 + drawn(k, 98), 5 + drawn(k, 99)
        measured = power_against_light.Measured(case, 1e7 * k, events_cps, groups, wired, tree)
        found.append(measured)
    return found


def table_of(page, head):
    """Return the rows of the table of a page with a first head, by their names."""
    lines = page[page.index(f"| {head} |") :].partition("\n\n")[0]
    return {name: cells for name, *cells in cells_of(lines)}


def test_the_power_page_tells_each_number_in_its_row():
    """Those of the light by light; energies of an event where there are events."""
    found = measured_power()
    light = found[: len(power_against_light.LIGHT)]
    between = Power(0.5, 0.25, 0.125, 0.75)
    page = power_against_light.page(found, between)
    mw = [one.total.total for one in light]
    assert mw == pytest.approx(
        [
            sum(group.clock + group.internal + group.switching + group.leakage for group in groups)
            for groups in ([*one.groups.values()] for one in light)
        ]
    )

    def told(form, values):
        return [form.format(value) for value in values]

    blocks = table_of(page, "block")
    for name in GROUPS:
        assert blocks[name] == told("{:.2f}", (one.groups[name].total for one in light))
    assert blocks["**subgroup**"] == told("**{:.2f}**", mw)
    assert blocks["with wires"] == told("{:.2f}", (one.wired for one in light))
    assert blocks["and a clock tree"] == told("{:.2f}", (one.wired + one.tree for one in light))
    assert blocks["uW per pixel"] == told("{:.0f}", (1000 * one / 64 for one in mw))
    assert blocks["edges per pixel and us"] == told("{:.2f}", (10 * k for k in range(len(light))))
    users = table_of(page, "a subgroup")
    assert users["in a frame, mW"] == told("{:.2f}", mw)
    assert users["between frames, mW"] == ["1.62"] * len(light)
    for rate_hz in (30, 100):  # a frame takes 100 periods of 500 ns
        means = [1.625 + rate_hz * 50e-6 * (one - 1.625) for one in mw]
        assert users[f"mean at {rate_hz} frames/s, mW"] == told("{:.2f}", means)
    assert users["events per us"] == told("{:.1f}", (2 * k for k in range(len(light))))
    nj = [one / (2 * k) for k, one in enumerate(mw[1:], 1)]  # mW of 2 k events per us
    assert users["nJ per event, all power"] == ["", *told("{:.2f}", nj)]
    more = [(one - mw[0]) / (2 * k) for k, one in enumerate(mw[1:], 1)]
    assert users["nJ per event, more than in the dark"] == ["", *told("{:.2f}", more)]
    energies = table_of(page, "block, nJ per event")
    for name in GROUPS:
        of_group = [one.groups[name].total / (2 * k) for k, one in enumerate(light) if k]
        assert energies[name] == told("{:.2f}", of_group)
    kinds = table_of(page, "kind")
    for name, label in power_against_light.KINDS:
        assert kinds[label] == told("{:.2f}", (getattr(one.total, name) for one in light))
    assert "0.75 mW of the remaining power is leakage" in page


def test_what_settings_save_is_told_beside_the_same_light():
    """Those in saturation beside saturation; gates could save what flip-flops take in vain."""
    found = measured_power()
    page = power_against_light.page(found, Power())
    settings = table_of(page, "setting")
    by_klux = {one.case.klux: one.total.total for one in found if not one.case.subgroup}
    by_klux |= {one.case.klux: one.total.total for one in found[: len(power_against_light.LIGHT)]}
    others = found[len(power_against_light.LIGHT) :]
    assert list(settings) == [one.case.name for one in others]
    for one in others:
        usual, mw = by_klux[one.case.klux], one.total.total
        saved = usual - mw
        assert settings[one.case.name] == [f"{mw:.2f}", f"{saved:+.2f}", f"{saved / usual:+.1%}"]
    (middle,) = (one for one in found if one.case is power_against_light.MIDDLE)
    gates = [line for line in page.splitlines() if line.startswith("| ")][-len(GROUPS) - 1 :]
    for line, (name, group) in zip(gates, middle.groups.items(), strict=False):
        assert line.split("|")[1:4] == [f" {name} ", f" {group.clock:.2f} ", f" {group.idle:.2f} "]


def test_power_is_that_of_the_frames_of_a_subgroup(monkeypatch):
    """Per case: edges of a pixel and events in a second, with wires and with the clock tree."""
    config = parse_config({"sensor": {"rows": 4, "cols": 4, "subgroup": [4, 4]}})
    cases = power_against_light.LIGHT[:2]
    edges = {case.name: np.zeros(160 * k) for k, case in enumerate(cases)}
    asked = []

    def setup(case, **sensor):
        assert sensor == {"rows": 4}
        return SimpleNamespace(
            config=config, photons=SimpleNamespace(edges=lambda: edges[case.name])
        )

    def power(design, toggles, number, cycles, clock_mhz, wire_ff):
        asked.append((number, cycles, clock_mhz))
        mw = 1.0 + number
        return {
            "subgroup_0.tree": Power(mw),
            "subgroup_0.tree.fifo_0": Power(wire_ff),
            "readout": Power(99.0),
        }

    def golden(sensor):
        return SimpleNamespace(
            frame=lambda config, edges: SimpleNamespace(commit_subgroup=edges[:8])
        )

    made = {
        "setup": setup,
        "Golden": golden,
        "FrameJob": lambda config, edges, trace: SimpleNamespace(
            config=config, edges=edges, expected=trace
        ),
        "design": lambda sensor: "netlist",
        "count_toggles": lambda sensor, jobs: len(jobs),
        "power": power,
        "clock_tree_mw": lambda *given: {"subgroup_0": 0.25, "subgroup_0.tree": 0.5, "top": 9.0},
        "power_at_rest": lambda *given: {"subgroup_0": Power(0.125), "top": Power(9.0)},
    }
    for name, one in made.items():
        monkeypatch.setattr(power_against_light, name, one)
    lines = []
    measured, between = power_against_light.measure(lines.append, cases, rows=4)
    assert between == Power(0.125)
    seconds = config.frame_cycles / (config.clock_mhz * 1e6)
    for number, (one, case) in enumerate(zip(measured, cases, strict=True)):
        assert (one.case, one.groups["tree"], one.tree) == (case, Power(1.0 + number), 0.75)
        assert one.total == Power(1.0 + number)
        assert one.wired == pytest.approx(1.0 + number + power_against_light.WIRE_FF)
        assert one.edges_cps == pytest.approx(10 * number / seconds)
        assert one.events_cps == pytest.approx(8 * number / seconds)
    assert asked == [(k, config.frame_cycles, config.clock_mhz) for k in (0, 0, 1, 1)]
    assert lines[1:] == ["dark: 1.00 mW", "5 klux: 2.00 mW"]


def test_the_cells_of_a_block_of_counts_are_told_by_their_kind():
    cells = {"DFF_X1": 1000, "DFFR_X1": 30, "DLH_X1": 200, "NAND2_X1": 4000, "INV_X1": 5}
    block = SimpleNamespace(cells=cells, area_um2=12345.6)
    assert count_cost._block_row("a block", block) == (
        "a block",
        "5,235",
        "1030",
        "200",
        "12,346",
    )


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
