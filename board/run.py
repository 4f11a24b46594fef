# SPDX-License-Identifier: Apache-2.0
"""Runs the emulator: plays a scene on its photon sources, takes frames, and checks each word with
the golden model.

It runs on a board (`--port`), or simulated behind its serial pins (`--simulate`), with the same
host software.
"""

import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from attrs import define

from ..host.transport import DeviceResetError, LinkError
from ..model.contract.config import Config
from ..model.contract.pixels import pixel_table
from ..model.contract.result import ResultBuilder
from ..model.depth.depth import Depth
from ..model.depth.estimate import estimate_depth
from ..model.depth.methods import DEFAULT_METHOD
from ..model.depth.quality import OTHER_SURFACE_M
from ..model.golden.frame import Golden
from ..model.light.light import BACKGROUNDS, Light
from ..model.light.spad import Spad
from ..model.light.timing import Timing
from ..model.scenes.ambient import Ambient
from ..model.scenes.scene import Scene, scene_light
from ..model.shared.errors import InputError
from ..study.pictures import Panel, depth_row
from ..tb.rtl_errors import Mismatch
from .driver import EmulatorDriver
from .parameters import DEAD_MAX, LEVEL_BITS, RATE_BITS, SPREAD_MAX
from .source_model import SourceSettings, source_edges

DEPTH = "depth.png"
REDRAW_S = 1.0  # between two pictures
METHOD = "matched"  # of events
LEVEL_MAX = (1 << LEVEL_BITS) - 1
RATE_MAX = (1 << RATE_BITS) - 1
RECOVERIES_MAX = 5  # in a row


def source_settings(
    config: Config, scene: Scene, klux: Ambient, *, spread: int = 1, seed: int = 1
) -> SourceSettings:
    """Return the settings of the photon sources for a scene: echoes at the targets' ticks,
    background by subgroup.

    A pixel sees its nearest target. The probability of an echo is that of at least one photon, at
    most 255/256. The background of a subgroup is the mean of its pixels. Raises `InputError`.
    """
    sensor, timing = config.sensor, Timing.from_config(config)
    if scene.later:
        raise InputError(f"scene: has {scene.pictures} pictures, must have one for the emulator")
    if scene.transient is not None:
        raise InputError(
            "scene: has the shape of its light in time, must have distances for the emulator"
        )
    light = scene_light(scene, klux, background=BACKGROUNDS[0])
    distance_m, signal = _nearest_target(light)
    # As a TDC does: the tick in which the light arrives, not the nearest edge of a tick.
    ticks = np.floor(np.nan_to_num(distance_m / timing.tick_m)).astype(np.int64)
    in_range = np.isfinite(distance_m) & (ticks < config.period_ticks)
    level = np.where(
        in_range, np.minimum(np.rint((1 - np.exp(-signal)) * (1 << LEVEL_BITS)), LEVEL_MAX), 0
    )
    rate = (
        np.broadcast_to(light.background_cps, sensor.array_pixels)
        * config.sensor.phases
        * timing.tick_s
    )
    table = pixel_table(sensor)
    shape = sensor.subgroups, sensor.pixels
    tick_of, level_of, rate_of = (np.zeros(shape) for _ in range(3))
    for whole, values in (
        (tick_of, np.where(in_range, ticks, 0)),
        (level_of, level),
        (rate_of, 1 - np.exp(-rate)),
    ):
        whole[table.subgroup, table.inside] = values
    dead_cycles = int(
        np.clip(np.ceil(Spad().dead_time_s / (sensor.phases * timing.tick_s)), 1, DEAD_MAX)
    )
    return SourceSettings(
        background=np.minimum(np.rint(rate_of.mean(axis=1) * (1 << RATE_BITS)), RATE_MAX).astype(
            np.int64
        ),
        tick=tick_of.astype(np.int64),
        level=level_of.astype(np.int64),
        spread=min(spread, SPREAD_MAX),
        dead_cycles=dead_cycles,
        seed=seed,
    )


def _nearest_target(light: Light) -> tuple[np.ndarray, np.ndarray]:
    """float64[pixels] each: distance of a pixel's nearest target (NaN = none), and its signal."""
    order_m = np.where(np.isnan(light.distance_m), np.inf, light.distance_m)
    nearest = order_m.argmin(axis=1)[:, None]
    distance_m = np.take_along_axis(light.distance_m, nearest, axis=1)
    signal = np.take_along_axis(light.signal_per_pulse, nearest, axis=1)
    return distance_m[:, 0], signal[:, 0]


@define
class Tally:
    """Counts of a session: frames and beats, all as predicted; recoveries of the link; seconds
    since the first start.

    seconds: on the clock of this computer; seconds_on_line: on the clock of the line, which may be
    simulated.
    """

    frames: int = 0
    beats: int = 0
    recoveries: int = 0
    seconds: float = 0.0
    seconds_on_line: float = 0.0


class Session:
    """An emulator that is programmed once and delivers frames. They are checked as they arrive.

    Raises `InputError` if the settings do not fit the emulator's sensor.
    """

    def __init__(self, driver: EmulatorDriver, config: Config, settings: SourceSettings):
        if config.auto.any():
            raise InputError(
                "subgroup.auto = true: the emulator is checked without the controller, must be false"
            )
        # The frame buffer takes the beats as if there were no link.
        self.config = config.with_frame(link_gbps=0)
        self.driver, self.settings = driver, settings
        self.golden, self.tally = Golden(config.sensor), Tally()
        self.result = ResultBuilder(self.config)
        self._begun: tuple[float, float] | None = None
        self._stalls = 0
        driver.resume()
        self._program()

    def _program(self) -> None:
        self.driver.program(self.config)
        self.driver.write_settings(self.settings.register_writes(self.config.sensor))
        self._stalls = self.driver["stalls"]

    def frame(self) -> np.ndarray:
        """Return the beats of the next frame, uint64[n], after a check of each against the golden
        model.

        After an error of the link or a reset of the device, it recovers and may lose frames. Raises
        `Mismatch` if a word differs, and `LinkError` if the recovery fails.
        """
        self._begun = self._now() if self._begun is None else self._begun
        for _ in range(RECOVERIES_MAX):
            try:
                beats = self.driver.frame()
                stalls = self.driver["stalls"]
                break
            except (LinkError, DeviceResetError):
                self.tally.recoveries += 1
                self._recover()
        else:
            raise LinkError(f"no whole frame in {RECOVERIES_MAX} tries")
        if stalls != self._stalls:
            raise InputError(
                f"frame.pulses = {self.config.pulses}: the frame buffer of {self.driver.buffer_beats} beats was full; must be fewer"
            )
        self._check(beats)
        self.result.add([beats])
        self.tally.frames += 1
        self.tally.beats += len(beats)
        seconds, seconds_on_line = self._now()
        seconds_begun, on_line_begun = self._begun
        self.tally.seconds = seconds - seconds_begun
        self.tally.seconds_on_line = seconds_on_line - on_line_begun
        return beats

    def _now(self) -> tuple[float, float]:
        """Return the time in seconds by the clock of this computer, and by that of the line. The
        two differ if the line is simulated.
        """
        port = getattr(self.driver.transport, "port", None)
        return time.monotonic(), port.now() if port else time.monotonic()

    def _recover(self) -> None:
        for _ in range(RECOVERIES_MAX):
            try:
                self.driver.resume()
                self._program()
                return
            except (LinkError, DeviceResetError):
                continue
        raise LinkError(f"the emulator does not recover in {RECOVERIES_MAX} tries")

    def _check(self, beats: np.ndarray) -> None:
        number = int(beats[0]) >> 32 & 0xFFFF
        self.golden.frames = number
        edges = source_edges(self.config, self.settings, number)
        expected = self.golden.frame(self.config, edges).beats[0]
        if not np.array_equal(beats, expected):
            short = min(len(beats), len(expected))
            at = int(np.flatnonzero(np.append(beats[:short] != expected[:short], True))[0])
            shown, want = (
                f"{int(b[at]):#018x}" if at < len(b) else "nothing" for b in (beats, expected)
            )
            raise Mismatch(f"frame {number}, beat {at}: {shown}, golden model {want}")

    def draw(self, path: Path, scene: Scene) -> None:
        """Draw the depth from all frames together, beside the truth; the picture appears whole.

        A tick of the emulator is coarse (19 cm by default), so the paper's tolerance does not suit.
        """
        panel = Panel(f"{self.tally.frames} frames of the emulator", self.depth().depth_m[:, :, 0])
        depth_row(path, [panel], scene.truth_m, tolerance_m=OTHER_SURFACE_M)

    def depth(self) -> Depth:
        """Return the depth from all frames together."""
        method = DEFAULT_METHOD if self.config.counting else METHOD
        return estimate_depth(self.result.arrays(), self.config, method=method)


def emulate(
    driver: EmulatorDriver,
    config: Config,
    scene: Scene,
    out: Path,
    *,
    klux: Ambient,
    frames: int,
    seed: int = 1,
    tell: Callable[[Tally], None] = lambda tally: None,
) -> Tally:
    """Program a scene, take frames, check every word, and draw the depth from all frames so far
    into `out`.

    The picture is drawn again every `REDRAW_S`. tell: called after each frame. Raises `InputError`
    before the first frame if depth cannot be made of the format.
    """
    config.check_map()
    session = Session(driver, config, source_settings(config, scene, klux, seed=seed))
    out.mkdir(parents=True, exist_ok=True)
    drawn = time.monotonic()
    for _ in range(frames):
        session.frame()
        tell(session.tally)
        if session.tally.frames == frames or time.monotonic() - drawn > REDRAW_S:
            session.draw(out / DEPTH, scene)
            drawn = time.monotonic()
    return session.tally
