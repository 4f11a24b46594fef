# SPDX-License-Identifier: Apache-2.0
"""Driver of the emulator: the sensor's driver, settings of the photon sources, and frames from the
frame buffer.
"""

import time

import numpy as np

from ..host.driver import WAIT_SECONDS, Driver, Key, Word
from ..host.transport import HostError, Transport, read_block
from ..model.contract.parameters import Sensor
from .parameters import BUFFER_BASE, EMULATOR_ID, EMULATOR_VERSION, OWN_BY_NAME, own_address

WORDS_PER_BEAT = 2


class EmulatorDriver(Driver):
    """An emulator as its software sees it: a sensor with its own light, and further registers by
    name.

    transport, sensor, fresh: as of `Driver`. Raises `HostError` where what answers is no emulator
    that this driver knows.
    """

    def __init__(self, transport: Transport, sensor: Sensor | None = None, *, fresh: bool = False):
        found = transport.read(own_address("emulator_id"))
        if found != EMULATOR_ID:
            raise HostError(f"no emulator: its ID is {found:#010x}, must be {EMULATOR_ID:#010x}")
        version = transport.read(own_address("emulator_version"))
        if version >> 16 != EMULATOR_VERSION >> 16:
            raise HostError(
                f"emulator's registers of version {version >> 16}: this driver knows {EMULATOR_VERSION >> 16}"
            )
        self.buffer_beats = transport.read(own_address("buffer_beats"))
        super().__init__(transport, sensor, fresh=fresh)

    def _word(self, key: Key) -> Word:
        """Return the word of the emulator's or of the sensor's register map that `key` names.
        Raises `InputError`.
        """
        if not isinstance(key, str) or key not in OWN_BY_NAME:
            return super()._word(key)
        return Word(key, own_address(key), OWN_BY_NAME[key], self.sensor)

    def waiting(self) -> np.ndarray:
        """Remove the waiting beats (uint64) from the frame buffer, and return them."""
        level = self["buffer_level"]  # there may be more by now
        first = self["buffer_first"]
        beats = np.zeros(0, np.uint64)
        while level:
            run = min(level, self.buffer_beats - first)  # up to the end of the ring buffer
            words = read_block(
                self.transport, BUFFER_BASE + 4 * WORDS_PER_BEAT * first, WORDS_PER_BEAT * run
            )
            beats = np.concatenate([beats, np.array(words, "<u4").view("<u8")])
            self["buffer_take"] = run
            first, level = (first + run) % self.buffer_beats, level - run
        return beats

    def _beats(self, stream: int) -> np.ndarray:
        return self.waiting()

    def frame(self, seconds: float = WAIT_SECONDS) -> np.ndarray:
        """Start a frame, wait for it, and return its beats (uint64[n])."""
        self.start()
        (beats,) = self.receive(seconds)
        self.finish(seconds)
        return beats

    def resume(self, seconds: float = WAIT_SECONDS) -> None:
        """Bring the emulator to rest after an error: end a running frame, and drop what waits.
        Settings must be programmed anew.

        Raises `HostError` if the frame does not end within `seconds`.
        """
        self.programmed.clear()
        self._drop_unfinished()
        self._joined.clear()
        if self.status().busy:
            self.abort()
        end = time.monotonic() + seconds
        while self.status().busy:
            self.waiting()
            if time.monotonic() > end:
                raise HostError(f"the sensor is still busy {seconds:g} s after an abort")
        self.waiting()
        self.clear()
