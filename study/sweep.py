# SPDX-License-Identifier: Apache-2.0
"""Runs a sweep: a grid of points on Dask workers, each from photons to depth, into one Parquet
file.

Each finished point is stored beside the result, in a small file that is named by a digest of
everything that the point depends on. A sweep that was killed therefore continues where it stopped,
a changed SPEC only runs its new points, and the result has the same bytes in both cases.
"""

import json
from collections.abc import Callable
from functools import partial
from pathlib import Path

import pyarrow.parquet as pq
from attrs import frozen
from filelock import FileLock, Timeout

from ..lab.campaign import FinishedFiles, campaign, read_measures
from ..lab.dask_workers import Dask, reason
from ..lab.measures import SWEPT, Number
from ..lab.outcome_table import to_table
from ..lab.setup import versions
from ..model.shared.errors import InputError
from ..model.shared.files import whole_file
from .sweep_plot import write_plot
from .sweep_spec import Spec

LOCK = "lock"
METADATA = "coincid"  # key of the Parquet file's metadata


@frozen
class Summary:
    """Summary of a sweep."""

    rows: int  # of the result
    finished_before: int  # points that an earlier sweep finished
    failed: dict[str, str]  # reason by name of the point


def sweep(
    spec: Spec,
    out: Path,
    *,
    workers: int,
    title: str,
    scheduler: str | None = None,
    progress: Callable[[int], None] = lambda done: None,
) -> Summary:
    """Run the points of `spec` that are not finished, and write the table and its plot (`out` with
    .png).

    workers: number of processes of a cluster on this machine, unless `scheduler` is the address of
    another cluster. progress: called with the number of finished points. A point that fails has no
    row, and runs again next time. Raises `InputError` (another sweep writes `out`, or nothing
    answers at `scheduler`) and `SchedulerLost`.
    """
    plot = out.with_suffix(".png")
    points, failed = spec.keys, dict[str, BaseException]()
    with Finished(out) as finished:
        before = sum(finished.load(key) is not None for key in points)
        found = campaign(
            {key: point.setup for key, point in points.items()},
            partial(read_measures, names=SWEPT),
            Dask(workers, scheduler),
            finished=finished,
            failed=failed,
            progress=progress,
        )
        if found:
            write_table(out, spec, found)
            write_plot(plot, title, spec, found)
        else:  # a result of an earlier sweep could be taken for the result of this one
            out.unlink(missing_ok=True)
            plot.unlink(missing_ok=True)
    reasons = {points[key].name: reason(error) for key, error in failed.items()}
    return Summary(
        sum(point.key in found for point in spec.points), before, dict(sorted(reasons.items()))
    )


class Finished(FinishedFiles):
    """Finished points of a result file, in a folder beside it; a context manager that only one
    sweep can enter at a time.
    """

    def __init__(self, out: Path):
        super().__init__(out.with_name(f"{out.name}.points"), SWEPT)
        self._lock = FileLock(self.folder / LOCK)
        self._out = out

    def __enter__(self) -> "Finished":
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            self._lock.acquire(timeout=0)
        except Timeout:
            raise InputError(f"out = {str(self._out)!r}: another sweep is writing it") from None
        except OSError as error:
            raise InputError(
                f"out = {str(self._out)!r}: cannot be written: {error.strerror}"
            ) from None
        for path in self.folder.glob(".*.json.*"):  # from a sweep that was killed while it wrote
            path.unlink()
        return self

    def __exit__(self, *_: object) -> None:
        self._lock.release()


def write_table(path: Path, spec: Spec, found: dict[str, dict[str, Number]]) -> None:
    """Write a row for each point of `spec` whose key is in `found`; the bytes depend only on these
    two.

    Columns: the swept values, `SWEPT`, the point's settings as JSON, and its key. The file's
    metadata, under `METADATA`: base, axes and versions as JSON.
    """
    points = [point for point in spec.points if point.key in found]
    table = to_table(
        [point.values for point in points],
        [found[point.key] for point in points],
        settings=(
            "everything that was set, as JSON",
            [json.dumps(point.settings) for point in points],
        ),
        point=("name of the point's file", [point.key for point in points]),
    )
    engines = sorted({point.setup.engine for point in points})
    described = json.dumps(
        {
            "base": spec.base,
            "axes": spec.axes,
            "versions": {engine: versions(engine) for engine in engines},
        }
    )
    table = table.replace_schema_metadata({METADATA: described})
    with whole_file(path) as file:
        pq.write_table(table, file)
