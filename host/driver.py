# SPDX-License-Identifier: Apache-2.0
"""Driver of the sensor: registers by name, configurations, and whole frames, over any transport."""

import time
from collections.abc import Callable, Sequence
from typing import Any, TypeAlias

import numpy as np
from attrs import frozen

from ..model.contract import registers
from ..model.contract.config import Config
from ..model.contract.packet import FRAME_END, FRAME_START, HEADER, header_field, layout
from ..model.contract.parameters import SENSOR, Sensor
from ..model.contract.registers import (
    ID_VALUE,
    VERSION_VALUE,
    VERSION_WITH_COUNTS,
    WRITABLE,
    Access,
    Register,
)
from ..model.contract.stream import NO_HEADER, StreamError, is_grouped, kind_of
from ..model.contract.table import Kind, Setting
from ..model.shared.errors import InputError, check_integer
from ..model.shared.quantities import check_choice
from .transport import (
    ERRORS,
    STATUS,
    HostError,
    RefusedError,
    Transport,
    changes,
    errors_in,
    runs,
    write_block,
)

Key: TypeAlias = str | tuple[str | int, ...]
WAIT_SECONDS = 10.0  # per frame; the longest frame takes 2^16 periods of 2^13 cycles


@frozen
class Word:
    """A word of the register map. name: as shown in messages."""

    name: str
    address: int
    register: Register
    sensor: Sensor

    def checked(self, value: object) -> int:
        """Return `value` if the sensor accepts it. Raises `InputError` with register and range."""
        if self.register.access not in WRITABLE:
            raise InputError(f"{self.name}: is read-only ({self.register.access.value})")
        number = (
            int(value) if hasattr(value, "__index__") and not isinstance(value, bool) else value
        )
        return check_integer(
            self.name, number, self.register.low(self.sensor), self.register.high(self.sensor)
        )


def find(sensor: Sensor, key: Key) -> Word:
    """Return the word that `key` names: a register's name and, if it has them, the subgroup and
    the index in its array.

    Examples: `"period"`; `("auto_bounds", 2)`; `("threshold", 3)` of subgroup 3;
    `("mask", 3, 1)`, word 1 of subgroup 3's mask. A missing index is 0. Raises `InputError` with
    the wrong part and the legal range.
    """
    name, *numbers = key if isinstance(key, tuple) and key else (key,)
    register = registers.BY_NAME.get(str(name))
    if register is None:
        raise InputError(f"register {name!r}: must be one of {', '.join(registers.BY_NAME)}")
    if not register.count(sensor):
        raise InputError(f"register {name!r}: the sensor is built without it")
    subgroup = index = 0
    if of_subgroup := register in registers.SUBGROUP:
        if not numbers:
            raise InputError(
                f"register {name!r}: is one per subgroup, must be written as [{name!r}, subgroup]"
            )
        subgroup = check_integer(f"{name}: subgroup", numbers.pop(0), 0, sensor.subgroups - 1)
    if numbers:
        index = check_integer(f"{name}: index", numbers.pop(0), 0, register.count(sensor) - 1)
    if numbers:
        raise InputError(f"register {name!r}: {key!r} has too many indices")
    shown = [subgroup] * of_subgroup + [index] * (register.count(sensor) > 1)
    return Word(
        f"{name}{shown or ''}", registers.address(register.name, subgroup, index), register, sensor
    )


class FrameAssembler:
    """Cuts a stream into frames by its headers, because transports do not carry `tlast`.

    stream: its number in the sensor. frames: whole frames (uint64[n] each) that have not been
    taken yet.
    """

    def __init__(self, sensor: Sensor, stream: int = 0):
        self.stream = stream
        self.frames: list[np.ndarray] = []
        self._lengths = layout(sensor).lengths(len(sensor.stream_subgroups(stream)))
        self._beats = np.zeros(0, np.uint64)
        self._at = 0  # place of the next header in them

    def add(self, beats: np.ndarray) -> None:
        """Append beats (uint64[n]) to the stream. If they cannot be a frame, drop them and raise
        `StreamError`.
        """
        self._beats = np.concatenate([self._beats, np.asarray(beats, np.uint64)])
        while self._at < len(self._beats):
            kind = kind_of(self._beats[self._at], self._at > 0 and is_grouped(self._beats[0]))
            length = int(self._lengths[kind])
            if length == 0 or (kind == FRAME_START.code) != (self._at == 0):
                at = self._at
                self.forget()
                raise StreamError(f"beat {at} of a frame: {NO_HEADER}")
            if self._at + length > len(self._beats):
                return
            self._at += length
            if kind == FRAME_END.code:
                self.frames.append(self._beats[: self._at].copy())
                self._beats, self._at = self._beats[self._at :], 0

    def forget(self) -> None:
        """Drop an incomplete frame, because the stream begins anew."""
        self._beats, self._at = np.zeros(0, np.uint64), 0


@frozen
class Status:
    """State of the sensor. errors: names of the sticky error bits that are set."""

    busy: bool
    done: bool
    errors: tuple[str, ...] = ()


class Driver:
    """A sensor as its software sees it. Raises `HostError` if no sensor with a known register
    map answers.

    transport: connection to the sensor. sensor: its parameters as built; None: they are read
    from it. fresh: the sensor was just reset, so the values of its settings are known.
    programmed: byte address -> value of the settings whose values are known, so that only
    changes are written.

        driver["threshold", 3] = 2  # of subgroup 3; checked against the table before anything is
        sent driver["opened", 3]
        driver.program(config)
        driver.start()
    """

    def __init__(self, transport: Transport, sensor: Sensor | None = None, *, fresh: bool = False):
        self.transport = transport
        self.sensor = sensor or read_sensor(transport)
        self.programmed = registers.reset_values(self.sensor) if fresh else {}
        self._assemblers = [FrameAssembler(self.sensor, k) for k in range(self.sensor.streams)]
        self._joined: list[list[np.ndarray]] = []  # frames that all streams have sent

    def __getitem__(self, key: Key) -> int:
        """Read a register. Raises `InputError` if there is none of that name."""
        return self.transport.read(self._word(key).address)

    def __setitem__(self, key: Key, value: int) -> None:
        """Write a register. Raises `InputError` before anything is sent, or `RefusedError`."""
        word = self._word(key)
        number = word.checked(value)
        if word.register.access is Access.SETTING:
            self._write_settings(word.address, [number])
        else:
            self._write(word.address, number)

    def _word(self, key: Key) -> Word:
        """Return the word of the register map that `key` names. Raises `InputError`."""
        return find(self.sensor, key)

    def program(self, config: Config) -> int:
        """Write the settings of `config` that differ from the known ones, and return the number
        of words written.
        """
        if config.sensor != self.sensor:
            raise InputError(
                f"sensor: the configuration is for {config.sensor}, the sensor is {self.sensor}"
            )
        return self.write_settings(config.register_writes())

    def write_settings(self, writes: list[tuple[int, int]]) -> int:
        """Write those of (address, value) that change something, and return the number of words
        written.
        """
        pending = changes(writes, self.programmed)
        for address, values in runs(pending):
            self._write_settings(address, values)
        return len(pending)

    def _write_settings(self, address: int, values: Sequence[int]) -> None:
        """Write consecutive settings. They are not known if the write fails on its way."""
        written = {address + 4 * i: value for i, value in enumerate(values)}
        for one in written:
            self.programmed.pop(one, None)
        self._write(address, *values)
        self.programmed |= written

    def start(self) -> None:
        """Begin a frame. Raises `RefusedError` with the reasons if the sensor's checks refuse
        it.
        """
        self._write(*registers.control("start"))

    def abort(self) -> None:
        """Make the running period the last one of the frame; in a gap, end the frame."""
        self._write(*registers.control("abort"))

    def reset(self) -> None:
        """Reset the sensor, whatever it is doing: its frame ends at once, and its settings have
        their first values. Frames that all streams have sent stay; beats of an unfinished frame
        that come later are the caller's to drop.
        """
        self._write(*registers.control("reset"))
        self.programmed = registers.reset_values(self.sensor)
        self._drop_unfinished()

    def _drop_unfinished(self) -> None:
        """Drop the beats of frames that not all streams have sent."""
        self._join()
        for assembler in self._assemblers:
            assembler.forget()
            assembler.frames.clear()

    def status(self) -> Status:
        """Read the status without clearing anything."""
        word = self["status"]
        busy, done = (bool(word >> STATUS.bit(name) & 1) for name in ("busy", "done"))
        return Status(busy, done, errors_in(word))

    def clear(self, *names: str) -> None:
        """Clear sticky bits of the status, by name; without names, all of them. Raises `InputError`
        for another name.
        """
        sticky = "done", *ERRORS
        chosen = [check_choice("bit of the status", name, sticky) for name in names or sticky]
        self.transport.write(
            registers.address("status"), sum(1 << STATUS.bit(name) for name in chosen)
        )

    def finish(
        self, seconds: float = WAIT_SECONDS, meanwhile: Callable[[], None] = lambda: None
    ) -> None:
        """Wait until the frame has been delivered, and clear `done`. meanwhile: called between
        two polls.

        Raises `HostError` after `seconds`.
        """
        end = time.monotonic() + seconds
        while not self.status().done:
            meanwhile()
            if time.monotonic() > end:
                raise HostError(f"no frame end after {seconds:g} s")
        self.clear("done")

    def receive(self, seconds: float = WAIT_SECONDS) -> list[np.ndarray]:
        """Return the next whole frame: beats (uint64) per stream, for `model/contract/stream.py`
        to decode.

        Raises `HostError` after `seconds` without further beats, and `StreamError` if the beats
        are not a frame. A frame that one stream has lost is dropped from the others.
        """
        end = time.monotonic() + seconds
        while not self._joined:
            waiting = [assembler for assembler in self._assemblers if not assembler.frames]
            for assembler in waiting:
                beats = self._beats(assembler.stream)
                if len(beats):
                    assembler.add(beats)
                    end = time.monotonic() + seconds
            self._join()
            if not self._joined and time.monotonic() > end:
                silent = next(each for each in self._assemblers if not each.frames)
                raise HostError(
                    f"stream {silent.stream}: nothing more came for {seconds:g} s; the frame is not whole"
                )
        return self._joined.pop(0)

    def _join(self) -> None:
        """Join the streams' frames of the same number."""
        while all(assembler.frames for assembler in self._assemblers):
            heads = [assembler.frames[0][0] for assembler in self._assemblers]
            ahead = [_frames_between(heads[0], head) for head in heads]
            lone = [
                assembler
                for assembler, frames in zip(self._assemblers, ahead, strict=True)
                if frames < max(ahead)
            ]
            for assembler in lone:
                del assembler.frames[0]  # a stream that is ahead has lost it
            if not lone:
                self._joined.append([assembler.frames.pop(0) for assembler in self._assemblers])

    def _beats(self, stream: int) -> np.ndarray:
        """Return the beats of a stream that have come since the last call."""
        return self.transport.receive(stream)

    def _write(self, address: int, *values: int) -> None:
        """Write words. A refusal is raised with the sticky bits that explain it, which are
        cleared.
        """
        try:
            write_block(self.transport, address, values)
        except RefusedError as error:
            reasons = error.reasons or self.status().errors
            if reasons:
                self.clear(*reasons)
            raise RefusedError(error.message, reasons) from None


def _frames_between(first: np.uint64, second: np.uint64) -> int:
    """Return by how many frames the second head is ahead of the first one; their numbers wrap."""
    _, bits = HEADER["pulse"]
    numbers = 1 << bits
    ahead = int(header_field(second, "pulse")) - int(header_field(first, "pulse"))
    return (ahead + numbers // 2) % numbers - numbers // 2


def read_sensor(transport: Transport) -> Sensor:
    """Return the parameters of the connected sensor. Raises `HostError` if it is not one that
    this driver knows.
    """

    def constant(name: str) -> int:
        return transport.read(registers.address(name))

    if (found := constant("id")) != ID_VALUE:
        raise HostError(f"no sensor: its ID is {found:#010x}, must be {ID_VALUE:#010x}")
    if (found := constant("version")) >> 16 != VERSION_VALUE >> 16:
        raise HostError(
            f"register map of version {found >> 16}: this driver knows {VERSION_VALUE >> 16}"
        )

    def parameter(setting: Setting) -> int | tuple[int, int]:
        name = setting.name
        return (
            (constant(f"{name}_rows"), constant(f"{name}_cols"))
            if setting.kind is Kind.SIZE
            else constant(name)
        )

    values: dict[str, Any] = {
        name: parameter(setting)
        for name, setting in SENSOR.items()
        if not setting.needs or found >= VERSION_WITH_COUNTS
    }
    return Sensor(**values)
