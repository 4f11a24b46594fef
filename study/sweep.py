# SPDX-License-Identifier: Apache-2.0
"""Sweeps: a grid of points on Dask workers, each from photons to depth, into one Parquet file.

Finished points are kept beside the result, in a small file each, under the digest of everything that the point depends
on. So a sweep that was killed continues where it stopped, a changed SPEC only runs its new points, and the result has
the same bytes either way.
"""

import contextlib
import json
import logging
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, TypeAlias

import dask
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from attrs import frozen
from distributed import Client, Future, LocalCluster, as_completed
from distributed.client import FutureCancelledError
from distributed.comm.addressing import parse_address, parse_host_port
from distributed.comm.registry import backends
from distributed.scheduler import KilledWorker
from filelock import FileLock, Timeout

from ..model.contract.config import parse_config
from ..model.depth.estimate import estimate_depth
from ..model.light.photons import generate_edges
from ..model.scenes.scene import Scene
from ..model.shared.errors import InputError
from ..model.shared.files import whole_file
from ..model.shared.quantities import Numbers
from ..tb.errors import SimulationError
from ..tb.replay import replay
from .measures import MEASURES, measures
from .sweep_plot import write_plot
from .sweep_spec import CLOCK, FRAME_CLOCK, Point, Spec, photons_of, versions

LOOPBACK = "127.0.0.1"
CONNECT_S = 10
DEAF_TO_CTRL_C = "import signal\nsignal.signal(signal.SIGINT, signal.SIG_IGN)"  # for a worker: the sweep ends it
LOST_WORKERS_MAX = 20  # workers that a point may lose; after that, the point is assumed to kill them
LOCK = "lock"
Found: TypeAlias = dict[str, int | float | None]  # `MEASURES` of a point
COLUMN_TYPES = {int: pa.int64(), float: pa.float64()}
REAL_SETTINGS = ("klux", CLOCK, FRAME_CLOCK)
METADATA = "coincid"  # key of the Parquet file's metadata


class SchedulerLost(SimulationError):
    """The scheduler was lost during a sweep."""


@frozen
class Summary:
    """Summary of a sweep. rows: of the result. kept: points finished before. failed: reason by the point's name."""

    rows: int
    kept: int
    failed: dict[str, str]


def sweep(
    spec: Spec,
    out: Path,
    *,
    workers: int,
    title: str,
    scheduler: str | None = None,
    progress: Callable[[int], None] = lambda done: None,
) -> Summary:
    """Run the points of `spec` that are not finished, and write the table and its plot (`out` with .png).

    workers: number of processes of a cluster on this machine, unless `scheduler` is the address of another. progress:
    called with the number of points done. A point that fails has no row, and runs again next time. Raises `InputError`
    (another sweep writes `out`; nothing answers at `scheduler`) and `SchedulerLost`.
    """
    plot = out.with_suffix(".png")
    with Finished(out) as finished:
        found = {key: kept for key in spec.keys if (kept := finished.load(key)) is not None}
        before, failed = len(found), {}
        progress(before)
        todo = [point for key, point in spec.keys.items() if key not in found]
        if todo:
            with cluster(min(workers, len(todo)), scheduler) as client:
                for point, result, why in results(todo, client):
                    if result is None:
                        failed[point.name] = why
                    else:
                        finished.keep(point.key, result)
                        found[point.key] = result
                    progress(len(found) + len(failed))
        if found:
            write_table(out, spec, found)
            write_plot(plot, title, spec, found)
        else:  # no result of an earlier sweep is left that could be taken for this one's
            out.unlink(missing_ok=True)
            plot.unlink(missing_ok=True)
    return Summary(sum(point.key in found for point in spec.points), before, dict(sorted(failed.items())))


def run_point(
    settings: dict[str, Any], document: dict[str, Any], scene: Scene, klux: Numbers, expected: dict[str, str]
) -> Found:
    """Return a point's `MEASURES` of its last frame: photons, engine, depth. Runs on a worker.

    Raises `RuntimeError` if `versions` are not as `expected`, because the worker would give different numbers.
    """
    if (own := versions(settings["engine"])) != expected:
        raise RuntimeError(f"the worker's versions are not the sweep's: {own}, {expected}")
    config = parse_config(document)
    edges = generate_edges(**photons_of(settings, config, scene, klux))
    arrays, last = replay(settings["engine"], config, edges), config.frames - 1
    depth = estimate_depth(arrays, config, method=settings["method"], frame=last)
    seen = int(np.sum(edges.pulse // config.pulses == last))
    return measures(config, arrays, last, seen, depth.depth_m[:, :, 0], scene.truth_m)


class Finished:
    """Finished points of a result file, in a folder beside it; a context manager that only one sweep can enter at a time."""

    def __init__(self, out: Path):
        self.folder = out.with_name(f"{out.name}.points")
        self._lock = FileLock(self.folder / LOCK)
        self._out = out

    def __enter__(self) -> "Finished":
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            self._lock.acquire(timeout=0)
        except Timeout:
            raise InputError(f"out = {str(self._out)!r}: another sweep is writing it") from None
        except OSError as error:
            raise InputError(f"out = {str(self._out)!r}: cannot be written: {error.strerror}") from None
        for path in self.folder.glob(".*"):  # from a sweep that was killed while it wrote
            path.unlink()
        return self

    def __exit__(self, *_: object) -> None:
        self._lock.release()

    def load(self, key: str) -> Found | None:
        """Return the measures kept under `key`, or None if there are none that can be read."""
        try:
            kept = json.loads(self._path(key).read_text())
        except (OSError, ValueError):
            return None
        return kept if isinstance(kept, dict) and list(kept) == list(MEASURES) else None

    def keep(self, key: str, found: Found) -> None:
        with whole_file(self._path(key), "w") as file:
            file.write(json.dumps(found, indent=1) + "\n")

    def _path(self, key: str) -> Path:
        return self.folder / f"{key}.json"


@contextlib.contextmanager
def cluster(workers: int, scheduler: str | None = None) -> Iterator[Client]:
    """Return a client of the scheduler at an address, or of a cluster of `workers` processes that ends with the block."""
    with contextlib.ExitStack() as stack:
        if scheduler is not None:
            _check_address(scheduler)
        else:
            stack.enter_context(dask.config.set({"distributed.scheduler.allowed-failures": LOST_WORKERS_MAX}))
            # Loopback only. Even without a dashboard, the scheduler serves its health page, on any free port.
            scheduler = stack.enter_context(
                LocalCluster(
                    n_workers=workers,
                    threads_per_worker=1,
                    host=LOOPBACK,
                    memory_limit=None,
                    silence_logs="CRITICAL",
                    preload=DEAF_TO_CTRL_C,
                    dashboard_address=None,
                    scheduler_kwargs={"dashboard": False, "dashboard_address": f"{LOOPBACK}:0"},
                )
            )
        logging.getLogger("distributed.client").setLevel(
            logging.CRITICAL
        )  # a lost scheduler is reported by `SchedulerLost`
        try:
            client = Client(scheduler, timeout=CONNECT_S, set_as_default=False)
        except OSError as error:
            raise InputError(f"scheduler = {scheduler!r}: no Dask scheduler answers ({error})") from None
        yield stack.enter_context(client)


def _check_address(scheduler: str) -> None:
    """Check an address before a client is made, because a client with an invalid address does not end."""
    try:
        scheme, place = parse_address(scheduler, strict=True)
        parse_host_port(place)
        if scheme not in backends:
            raise ValueError(f"{scheme}: none of {', '.join(backends)}")
    except ValueError as error:
        raise InputError(f"scheduler = {scheduler!r}: must be an address such as tcp://HOST:8786 ({error})") from None


def results(points: list[Point], client: Client) -> Iterator[tuple[Point, Found | None, str]]:
    """Run points on the client's workers; yield each with its measures, or with None and a reason. Raises `SchedulerLost`."""
    scenes: dict[int, Future[Any]] = {}
    running: dict[Future[Any], Point] = {}
    for point in points:
        # A task of its own: sent once, and computed again if the worker that held it is lost.
        scene = scenes.get(id(point.scene)) or client.submit(_itself, point.scene, pure=False)
        scenes[id(point.scene)] = scene
        given = (point.settings, point.document, scene, point.klux, versions(point.settings["engine"]))
        running[client.submit(run_point, *given, pure=False)] = point
    for task in as_completed(list(running), loop=client.loop):
        point = running.pop(task)
        try:
            found, why = task.result(), ""  # which runs again if the worker that held it is lost
        except FutureCancelledError:
            raise SchedulerLost("the Dask scheduler is gone; finished points are kept: start the sweep again") from None
        except Exception as error:
            found, why = None, _reason(error)
        yield point, found, why


def _itself(scene: Scene) -> Scene:
    return scene


def _reason(error: BaseException) -> str:
    if isinstance(error, KilledWorker):
        return "every worker that ran it was lost"
    text = " ".join(str(error).split())
    return text if isinstance(error, InputError) else f"{type(error).__name__}: {text}"


def _swept(values: list[Any], real: bool) -> pa.Array:
    """Return a column of swept values. real: numbers are floats; if some values are texts (light maps), all are texts."""
    if real and any(isinstance(value, str) for value in values):
        return pa.array([value if isinstance(value, str) else f"{value:g}" for value in values], pa.string())
    return pa.array(values, pa.float64() if real else None)


def write_table(path: Path, spec: Spec, found: dict[str, Found]) -> None:
    """Write a row for each point of `spec` that `found` has by key; the bytes depend only on these two.

    Columns: the swept values, `MEASURES`, the point's whole configuration as JSON, and its key. The file's metadata,
    under `METADATA`: base, axes and versions as JSON.
    """
    points = [point for point in spec.points if point.key in found]
    columns, fields = [], []
    for name in points[0].values if points else ():
        column = _swept([point.values[name] for point in points], real=name in REAL_SETTINGS)
        columns.append(column)
        fields.append(pa.field(name, column.type, metadata={"meaning": "swept"}))
    for name, (kind, meaning) in MEASURES.items():
        columns.append(pa.array([found[point.key][name] for point in points], COLUMN_TYPES[kind]))
        fields.append(pa.field(name, columns[-1].type, metadata={"meaning": meaning}))
    for name, meaning, text in (
        ("settings", "everything that was set, as JSON", lambda point: json.dumps(point.settings)),
        ("point", "name of the point's file", lambda point: point.key),
    ):
        columns.append(pa.array(map(text, points), pa.string()))
        fields.append(pa.field(name, pa.string(), metadata={"meaning": meaning}))
    engines = sorted({point.settings["engine"] for point in points})
    described = json.dumps(
        {"base": spec.base, "axes": spec.axes, "versions": {engine: versions(engine) for engine in engines}}
    )
    table = pa.table(columns, schema=pa.schema(fields, metadata={METADATA: described}))
    with whole_file(path) as file:
        pq.write_table(table, file)
