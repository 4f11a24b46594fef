# SPDX-License-Identifier: Apache-2.0
"""Writes `report.html`, the views of a run in one file that needs no server and no network.

The script of the page computes nothing. It only looks up data from `timeline.py` and
`frame_content.py`.
"""

import json
import re
from typing import Any

import numpy as np
from bokeh.document import Document
from bokeh.embed import file_html
from bokeh.events import DocumentReady
from bokeh.models import ColumnDataSource, CustomJS
from bokeh.resources import INLINE
from jinja2 import Environment, FileSystemLoader

from ...model.contract.pixels import pixel_table
from ...model.shared.files import FilePath, whole_file
from .assets import FILES, SHOW
from .figures import (
    CHOICE_MARKS,
    CHOSEN,
    FATE_MARKS,
    FATES,
    OTHER,
    REASON_MARKS,
    VERDICT_MARKS,
    VERDICTS,
    Views,
    commit_mark,
    map_columns,
    map_scales,
)
from .frame_content import HISTOGRAM_BIN_M, FrameView
from .timeline import Windows, gate_of
from .words import OBJECT_HEADS, number_rows, object_table, story

RANDOM_NAME = re.compile(
    r"\b[0-9a-f]{8}(?:-[0-9a-f]{4}){3}-[0-9a-f]{12}\b"
)  # names that Bokeh gives to pages and their parts
EDGES_MAX = 2_000_000  # in a report, about 10 MB; above this, only the first pulses are kept


def write_report(path: FilePath, heading: str, views: list[FrameView]) -> None:
    """Write the report of `views`, which belong to one sensor and scene, whole or not at all."""
    html = report_html(heading, views)
    with whole_file(path, "w") as file:
        file.write(html)


def report_html(heading: str, views: list[FrameView]) -> str:
    """Return the report as HTML."""
    figures, first = Views(), views[0]
    scales = map_scales(views)
    pulses = _pulses_kept(views)
    frames = [_sources(view, pulses) for view in views]
    config = first.config
    table = pixel_table(config.sensor)
    args = {
        "frames": frames,
        "pictures": figures.pictures,
        "cursor": figures.cursor,
        "around": figures.around,
        "histogram": _parts(
            figures.histogram, "bars", "returns", "truth", "figure", "subgroup_range"
        ),
        "timeline": _parts(figures.timeline, "edges", "windows", "gate", "fill", "light", "figure"),
        "sensor": {
            "rows": config.sensor.rows,
            "cols": config.sensor.cols,
            "height": config.sensor.subgroup[0],
            "width": config.sensor.subgroup[1],
            "pixels": config.sensor.pixels,
            "words": 2 * first.events.hits.shape[1],
            "period": config.period,
            "pulses": pulses,
            "tick_ns": config.tick_s * 1e9,
            "cycle_ns": config.tick_s * 1e9 * config.sensor.phases,
            "bin_m": HISTOGRAM_BIN_M,
            "bins": first.histogram_bins,
            "ns_per_m": config.period_ticks * config.tick_s * 1e9 / first.range_m,
        },
        "inside": ColumnDataSource(
            {"subgroup": table.subgroup.astype(np.int32), "inside": table.inside.astype(np.int32)}
        ),
        "fates": [FATES[fate] for fate in sorted(FATES)],
        "verdicts": [(*VERDICTS[verdict], commit_mark(verdict)) for verdict in sorted(VERDICTS)],
        "choice": {"colours": [CHOSEN, OTHER], "marks": list(CHOICE_MARKS)},
        "words": [_words(view) for view in views],
    }
    figures.show(first, scales=scales)
    figures.pick(first, config.sensor.rows // 2, config.sensor.cols // 2, 0)
    doc = Document()
    with doc.models.freeze():
        for root in figures.roots():
            doc.add_root(root)
        doc.js_on_event(
            DocumentReady, CustomJS(args=args, code="report({" + ", ".join(args) + "})")
        )
        figures.pick_in_page(CustomJS(code="picked(Math.round(cb_obj.y), Math.round(cb_obj.x))"))
    folder = Environment(loader=FileSystemLoader(SHOW))
    html = file_html(
        doc,
        INLINE,
        heading,
        template=folder.get_template("report.html"),
        template_variables={
            "heading": heading,
            "views_html": folder.get_template("views.html"),
            "css": FILES["page.css"],
            "scripts": FILES["tables.js"] + FILES["report.js"],
            "maps": [one.figure.name for one in figures.maps],
            "fates": FATE_MARKS,
            "verdicts": VERDICT_MARKS,
            "reasons": REASON_MARKS,
            "frames": [view.title for view in views],
            "sensor": config.sensor,
            "pulses": pulses,
        },
    )
    return _numbered(html)


def _numbered(html: str) -> str:
    """Return the page with numbers in place of its random names, so that the same run gives the
    same bytes.
    """
    numbers: dict[str, str] = {}
    return RANDOM_NAME.sub(lambda name: numbers.setdefault(name[0], f"name-{len(numbers)}"), html)


def _parts(figures: object, *names: str) -> dict[str, Any]:
    return {name: getattr(figures, name) for name in names}


def _pulses_kept(views: list[FrameView]) -> int:
    """Return the number of pulses whose edges fit into the report."""
    pulses = min(view.pulses_seen for view in views)
    return max(
        1, min(pulses, EDGES_MAX * pulses // max(1, sum(len(view.timeline.tick) for view in views)))
    )


def _sources(view: FrameView, pulses: int) -> dict[str, Any]:
    """Return the data of a frame for the page. A period has the number subgroup * pulses + pulse,
    counted in kept pulses.
    """
    line = view.timeline
    edges, edge_bounds = _first_pulses(line.edge_bounds, view.config.pulses, pulses)
    opened, window_bounds = _first_pulses(line.window_bounds, view.config.pulses, pulses)
    hits = np.ascontiguousarray(view.events.hits, "<u8").view(np.uint32)
    gates = [
        gate_of(view.config, s, p) or (0, view.config.period)
        for s in range(view.config.sensor.subgroups)
        for p in range(pulses)
    ]
    parts = {
        "pictures": map_columns(view),
        "edges": {
            "tick": line.tick[edges].astype(np.uint16),
            "pixel": line.pixel[edges].astype(np.uint16),
            "fate": line.fate[edges],
        },
        "windows": {
            part.name: getattr(line.windows, part.name)[opened].astype(np.int32)
            for part in Windows.__attrs_attrs__
        },
        "bounds": {
            "edges": edge_bounds.astype(np.int32),
            "windows": window_bounds.astype(np.int32),
        },
        "gates": {
            name: np.array(part, np.int32)
            for name, part in zip(("first", "end"), zip(*gates, strict=True), strict=True)
        },
        # a page has no integers of 64 bits, and a frame with gaps has more than 2^31 cycles
        "fill": {"cycle": line.fill_cycle.astype(float), "fill": line.fill.astype(np.int32)},
        "subgroups": {
            "fill": line.fill_bounds.astype(np.int32),
            "events": view.events.bounds.astype(np.int32),
        },
        "threshold": line.threshold.tolist(),
        "starts": line.start_cycles.tolist(),
        "events": {"bin": view.event_bins().astype(np.int32)},
        "hits": {"word": hits.ravel()},
        "returns": {
            "at_m": view.candidate_m.astype(np.float32).ravel(),
            "confidence": view.candidate_confidence.astype(np.float32).ravel(),
        },
    }
    return {
        name: ColumnDataSource(part) if isinstance(part, dict) else part
        for name, part in parts.items()
    }


def _first_pulses(bounds: np.ndarray, pulses: int, kept: int) -> tuple[np.ndarray, np.ndarray]:
    """Return indices and bounds of the part that belongs to the first `kept` pulses of every
    subgroup.
    """
    sizes = np.diff(bounds).reshape(-1, pulses)
    chosen = np.repeat((np.arange(sizes.size) % pulses) < kept, sizes.ravel())
    return np.flatnonzero(chosen), np.concatenate([[0], np.cumsum(sizes[:, :kept])])


def _words(view: FrameView) -> str:
    words = {"story": story(view), "heads": ["", ""], "numbers": number_rows(view)}
    return json.dumps(words | {"object_heads": list(OBJECT_HEADS), "objects": object_table(view)})
