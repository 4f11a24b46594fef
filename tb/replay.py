# SPDX-License-Identifier: Apache-2.0
"""Runs frames through an engine: the golden model, or the RTL in a simulator.

The golden model needs no RTL tool: no part of the RTL is imported before an engine is requested
that runs it.
"""

import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..model.contract.config import Config
from ..model.contract.edges import NAMES, Edges, checked_edges
from ..model.contract.result import ResultBuilder
from ..model.golden.frame import golden_result
from ..model.shared.arguments import check_kind
from ..model.shared.errors import InputError, extra, wrong_value
from ..model.shared.quantities import check_choice
from .engines import ENGINES, SIMULATORS
from .frame_record import FrameJob, Recorded

if TYPE_CHECKING:
    from ..hdl.front_end_views import View

DEFAULT_VIEW = "polyphase"


def chosen_view(
    engine: str, view: "str | View", clock_mhz: float, waves: bool = False
) -> "View | None":
    """Return the view from `hdl/front_end_views.py` that `engine` runs, at a system clock; None
    for the golden model.

    view: its name, or a view of a custom circuit. waves: a waveform of the whole sensor is
    wanted. Raises `InputError`, also if the engine cannot do it, or if the tools of the RTL are
    missing.
    """
    check_choice("engine", engine, ENGINES)
    if waves and engine not in SIMULATORS:
        raise InputError(
            f"engine = {engine!r}: has no waveform of the whole sensor; {' and '.join(SIMULATORS)} have one"
        )
    if engine == "golden" and isinstance(view, str) and view == DEFAULT_VIEW:
        return None
    with extra("rtl"):
        from ..hdl.front_end_views import view_at
        from . import play  # noqa: F401, its dependencies are there
    found = view_at(view, clock_mhz)
    if not found.is_default:
        check_choice(f"engine of the view {found.name}", engine, SIMULATORS)
    return None if engine == "golden" else found


def replay(
    engine: str,
    config: Config,
    edges: Edges,
    ready: np.ndarray | None = None,
    progress: Callable[[int], None] | None = None,
    view: "str | View" = DEFAULT_VIEW,
) -> dict[str, np.ndarray]:
    """Play all frames of a configuration through an engine.

    Parameters
    ----------
    engine : str
        `golden`, `sliced`, `verilator` or `icarus`.
    config : Config
    edges : Edges
        The SPAD avalanches of all frames.
    ready : numpy.ndarray or None
        uint8[n]: whether the receiver takes a beat in each of the first n cycles of a frame;
        None: always.
    progress : callable or None
        Called with the number of cycles done.
    view : str or View
        `polyphase`, `async`, or a view of your own; see `chosen_view`.

    Returns
    -------
    dict of str to numpy.ndarray
        The arrays of the result file.

    Raises
    ------
    InputError
        If an argument is illegal, or the tools of the RTL are missing.
    """
    check_kind("config", config, Config)
    edges = checked_for(config, edges)
    chosen = chosen_view(engine, view, config.clock_mhz)
    ready = np.zeros(0, np.uint8) if ready is None else _checked_ready(ready)
    if chosen is None:
        done = progress or (lambda cycles: None)
        return golden_result(
            config, edges, ready, lambda frames: done(frames * config.frame_cycles)
        )
    from .play import play
    from .sliced import play_side_by_side
    from .stimulus import check_offsets

    if not chosen.by_words:
        check_offsets(config, edges)
    frames = [
        FrameJob(config, edges.frame(number, config.pulses)[0], ready=ready)
        for number in range(config.frames)
    ]
    if engine == "sliced" and not config.controlled.any():  # then no frame depends on those before
        return _result(
            config, [record for (record,) in play_side_by_side([[job] for job in frames], progress)]
        )
    with tempfile.TemporaryDirectory(prefix="coincid-") as folder:
        records, _ = play(frames, engine, Path(folder), progress=progress, view=chosen)
    return _result(config, records)


def replay_together(
    jobs: Sequence[tuple[Config, Edges]], threads: int = 1
) -> list[dict[str, np.ndarray]]:
    """Play configurations of one sensor through the sliced engine side by side; return the
    result of each as `replay` does.

    Raises `InputError` as `replay` does.
    """
    for config, _ in jobs:
        chosen_view("sliced", DEFAULT_VIEW, config.clock_mhz)
    from .sliced import play_side_by_side

    chains = []
    for config, given in jobs:
        edges = checked_for(config, given)
        frames = range(config.frames)
        chains.append([FrameJob(config, edges.frame(k, config.pulses)[0]) for k in frames])
    return [
        _result(config, records)
        for (config, _), records in zip(
            jobs, play_side_by_side(chains, threads=threads), strict=True
        )
    ]


def checked_for(config: Config, edges: Edges) -> Edges:
    """Return the edges if the sensor can have them. Raises `InputError`.

    The engines would read beyond their arrays, or disagree.
    """
    check_kind("edges", edges, Edges)
    arrays = {name: np.asanyarray(getattr(edges, name)) for name in NAMES}
    if edges.offset_ps is not None:
        arrays["offset_ps"] = np.asanyarray(edges.offset_ps)
    return checked_edges(
        arrays,
        pixels=config.sensor.array_pixels,
        pulses=config.frames * config.pulses,
        period_ticks=config.period_ticks,
        source="edges: ",
    )


def _checked_ready(ready: np.ndarray) -> np.ndarray:
    """Return the levels of `tready` by cycle, 0 or 1. Raises `InputError` if they are something
    else.
    """
    check_kind("ready", ready, np.ndarray)
    if ready.ndim != 1 or ready.dtype.kind not in "biu":
        raise InputError(
            f"ready: has shape {ready.shape} and dtype {ready.dtype}, must be one row of integers"
        )
    wrong = np.flatnonzero((ready != 0) & (ready != 1))
    if len(wrong):
        raise wrong_value(f"ready[{wrong[0]}]", ready[wrong[0]].item(), "0 or 1", low=0, high=1)
    return ready


def _result(config: Config, records: list[Recorded]) -> dict[str, np.ndarray]:
    result = ResultBuilder(config)
    for record in records:
        result.add(record.beats, record.commit_subgroup, record.commit_cycle)
    return result.arrays()
