# SPDX-License-Identifier: Apache-2.0
"""Writes the tables that sweeps make into their pages, from the SPEC files in docs/.

Only the measures of the table are computed. Finished points are kept in the build folder, so a run
that was interrupted continues.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from coincid.lab.measures import SWEPT
from coincid.model.shared.markdown import paragraph, text_table
from coincid.study.sweep_plot import write_plot
from coincid.study.sweep_spec import Spec, read_spec
from coincid.tools.pages import folder, picture, put

from .kept_measures import kept_measures

FORMATS = "id", "compact", "full", "compact-full"
FRAME_BEATS = 98  # beats of a frame besides its events: start, end, and counters of 16 subgroups
Row = dict[str, Any]  # a point's values by key, and its measures by name


def points(name: str, measures: Sequence[str]) -> tuple[Spec, dict[str, Row]]:
    """Return the SPEC docs/sweep-NAME.toml, and the measures of its points by their keys."""
    spec = read_spec(folder() / "docs" / f"sweep-{name}.toml")
    setups = {key: point.setup for key, point in spec.keys.items()}
    return spec, kept_measures(f"sweep-{name}", setups, measures)


def rows_of(name: str, *measures: str) -> list[Row]:
    """Return a row for each point of docs/sweep-NAME.toml, in order."""
    spec, found = points(name, measures)
    return [point.values | found[point.key] for point in spec.points]


def only(rows: Sequence[Row], **values: Any) -> list[Row]:
    """Return the rows that have these values; in the names of keys, __ stands for the point."""
    wanted = {name.replace("__", "."): value for name, value in values.items()}
    return [row for row in rows if all(row[key] == value for key, value in wanted.items())]


def mean(rows: Sequence[Row], measure: str) -> float:
    """Return the mean of a measure, in which None counts as 0."""
    return float(np.mean([row[measure] or 0 for row in rows]))


def example() -> None:
    """Draw the plot of docs/sweeps.md."""
    spec, found = points("example", SWEPT)
    write_plot(picture("docs/images/sweep.png"), "sweep-example", spec, found)
    put("docs/sweeps.md", "plot")


def compact() -> None:
    """Write the beats per event of each format."""
    rows = rows_of("compact", "events", "beats")
    cells = []
    for form in FORMATS:
        beats = []
        for threshold in (1, 2, 3):
            some = only(rows, subgroup__threshold=threshold, frame__format=form)
            beats.append(
                f"{np.mean([(row['beats'] - FRAME_BEATS) / row['events'] for row in some]):.2f}"
            )
        cells.append((f"`{form}`", *beats))
    put(
        "docs/compact.md",
        "beats",
        text_table(("form", "threshold 1", "threshold 2", "threshold 3"), cells),
    )


def links() -> None:
    """Write what a link carries in each format."""
    rows = rows_of("links", "events", "wrong_share")
    cells = []
    for gbps in (2, 4, 8, 16, 32):
        line = [str(gbps)]
        for form in FORMATS:
            some = only(rows, frame__link_gbps=gbps, frame__format=form)
            line += [f"{mean(some, 'events'):,.0f}", f"{mean(some, 'wrong_share'):.1%}"]
        cells.append(line)
    head = [text for form in FORMATS for text in (f"events, `{form}`", f"wrong, `{form}`")]
    put("docs/compact.md", "links", text_table(("link, Gbit/s", *head), cells, left=()))


def settling() -> None:
    """Write how the controller settles with new photons in every frame."""
    rows = rows_of("settling", "threshold_mean", "stream_load", "dropped_share")
    lights = {5: "5 klux", 20: "20 klux", 50: "50 klux", 100: "100 klux", "5|100": "5 and 100 klux"}
    frames = sorted({row["frame.frames"] for row in rows})
    cells = []
    for number in frames:
        some = [only(rows, frame__frames=number, klux=klux)[0] for klux in lights]
        cells.append(
            (
                number,
                *(
                    f"{one['threshold_mean']:.2f} ({100 * one['stream_load']:.0f} %)"
                    for one in some
                ),
            )
        )
    dropped = [
        100 * only(rows, frame__frames=number, klux=100)[0]["dropped_share"] for number in frames
    ]
    told = f"At 100 klux the first frame drops {dropped[0]:.0f} % of its events, and later frames drop at most "
    told += f"{max(dropped[1:]):.1f} %."
    table = text_table(("frame", *lights.values()), cells, left=())
    put("docs/controller.md", "settling", f"{table}\n\n{paragraph(told)}")


def gains() -> None:
    """Write the controller against constant thresholds."""
    rows = rows_of("controller", "wrong_share")
    scenes = list(dict.fromkeys((row["scene"], row["klux"]) for row in rows))
    cells = []
    for side, gbps in ((32, 32), (32, 8), (64, 32)):
        for method, name in (("planes", "planes"), ("maximum", "peaks")):
            some = only(rows, sensor__rows=side, frame__link_gbps=gbps, method=method)
            constant = only(some, subgroup__auto=False)
            best = {}
            controlled = {}
            for scene, klux in scenes:
                best[scene, klux] = min(
                    row["wrong_share"] for row in only(constant, scene=scene, klux=klux)
                )
                controlled[scene, klux] = only(some, scene=scene, klux=klux, subgroup__auto=True)[
                    0
                ]["wrong_share"]
            by_threshold = {
                t: mean(only(constant, subgroup__threshold=t), "wrong_share") for t in range(1, 8)
            }
            one = min(by_threshold, key=lambda threshold: by_threshold[threshold])
            behind = max(scenes, key=lambda key: controlled[key] - best[key])
            lost = 100 * (controlled[behind] - best[behind])
            scene, klux = behind
            light = klux.replace("|", " and ") if isinstance(klux, str) else f"{klux:g}"
            where = f"{scene}, {light} klux"
            means = np.mean(list(best.values())), np.mean(list(controlled.values()))
            cells.append(
                (
                    f"{side} x {side}",
                    gbps,
                    name,
                    f"{means[0]:.1%}",
                    f"{means[1]:.1%}",
                    f"{by_threshold[one]:.1%} (threshold {one})",
                    f"{lost:.1f} points ({where})",
                )
            )
    head = [
        "pixels",
        "link, Gbit/s",
        "estimator",
        "best of each scene",
        "controller",
        "one constant for all",
    ]
    table = text_table((*head, "controller behind the best, at most"), cells, left=(0, 2, 6))
    put("docs/controller.md", "gains", table)


def fifo() -> None:
    """Write the share of events that FIFOs of several depths drop."""
    rows = rows_of("fifo", "dropped_share")
    settings = {
        "threshold 2, map": (2, False, "id"),
        "threshold 3, map": (3, False, "id"),
        "threshold 3, map and offsets": (3, False, "full"),
        "controller, map": (3, True, "id"),
    }
    depths = (2, 4, 8, 16, 32)
    cells = []
    for klux in (5, 50, 100):
        for name, (threshold, auto, form) in settings.items():
            some = only(
                rows,
                klux=klux,
                subgroup__threshold=threshold,
                subgroup__auto=auto,
                frame__format=form,
            )
            shares = [
                mean(only(some, sensor__fifo_depth=depth), "dropped_share") for depth in depths
            ]
            cells.append((klux, name, *(f"{100 * share:.2f} %" for share in shares)))
    head = ("klux", "setting", *(f"{depth} places" for depth in depths))
    put("docs/silicon.md", "fifo", text_table(head, cells, left=(1,)))


def streams() -> None:
    """Write how many streams an array needs."""
    rows = rows_of(
        "streams", "beats", "events", "dropped", "dropped_share", "mg_records", "mg_dropped"
    )
    cells = []
    for side in ((32, 32), (64, 64), (128, 256)):
        for threshold in (2, 3):
            for form in FORMATS:
                some = only(
                    rows, sensor__rows=side[0], subgroup__threshold=threshold, frame__format=form
                )
                plain = only(some, frame__minigroup_records=False)
                recorded = only(some, frame__minigroup_records=True)
                enough = next((row for row in plain if not row["dropped"]), plain[-1])
                cells.append(
                    (
                        f"{side[1]}x{side[0]}",
                        50,
                        threshold,
                        form,
                        f"{enough['beats']:,}",
                        _needed(plain),
                        _share(plain[0]["dropped"], plain[0]["events"]),
                        _needed(recorded),
                        _share(recorded[0]["dropped"], recorded[0]["events"]),
                        _share(recorded[0]["mg_dropped"], recorded[0]["mg_records"]),
                    )
                )
    head = ["size", "klux", "threshold", "format", "beats per frame", "streams", "lost with one"]
    head += ["streams with records", "events lost with one", "records lost with one"]
    put("docs/performance.md", "streams", text_table(head, cells, left=(0, 3)))


def _needed(rows: Sequence[Row]) -> str:
    """Return the lowest number of streams with which nothing is lost; rows: by their number."""
    for row in rows:
        if not row["dropped"] and not row["mg_dropped"]:
            return str(row["sensor.streams"])
    return f"> {rows[-1]['sensor.streams']}"


def _share(lost: int, kept: int) -> str:
    return f"{lost / (lost + kept):.1%}" if lost else "0"


def mixed() -> None:
    """Write the wrong pixels of a ray-traced scene, by two measures."""
    rows = rows_of("mixed", "wrong_share", "off_surface_share")
    cells = []
    for pulses in (100, 400):
        some = only(rows, frame__pulses=pulses)
        cells.append(
            (
                pulses,
                *(
                    f"{100 * mean(some, name):.1f} %"
                    for name in ("wrong_share", "off_surface_share")
                ),
            )
        )
    put(
        "docs/two-surfaces.md",
        "wrong",
        text_table(("pulses", "wrong", "on none of its surfaces"), cells, left=()),
    )
