# SPDX-License-Identifier: Apache-2.0
"""Serial transport: access to the emulator's address space; protocol in `board/serial_link.py`.

There is one request at a time, and it is repeated until its answer arrives. So lost, doubled and
damaged bytes only cost time.
"""

import time
import zlib
from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np

from ..host.transport import DeviceResetError, LinkError, RefusedError
from ..model.shared.errors import InputError, extra
from . import serial_link as link
from .serial_link import Answer, Operation

TRIES = 10
PATIENCE_S = 0.25
BODY_MIN = 2 + link.CRC_BYTES  # sequence number and status
_FLAG = bytes([link.FLAG])
_ESCAPES = {
    bytes([byte]): bytes([link.ESCAPE, byte ^ link.FLIP]) for byte in (link.ESCAPE, link.FLAG)
}


class Port(Protocol):
    """A line of bytes, with pyserial's interface."""

    def write(self, data: bytes) -> Any:
        """Send all of `data`."""

    def read(self) -> bytes:
        """Return the received bytes: at least one, unless nothing arrived for some milliseconds."""

    def now(self) -> float:
        """Return the time of this line's clock in seconds."""


def frame(body: bytes) -> bytes:
    """Return a frame around a body: flags, escapes, CRC."""
    body += zlib.crc32(body).to_bytes(link.CRC_BYTES, "little")
    for byte, escaped in _ESCAPES.items():
        body = body.replace(byte, escaped)
    return _FLAG + body + _FLAG


class Deframer:
    """Finder of bodies in a stream of bytes that is cut anywhere. dropped: number of damaged
    frames, which are dropped.
    """

    def __init__(self) -> None:
        self._inside = bytearray()
        self.dropped = 0

    def add(self, data: bytes) -> list[bytes]:
        """Return the bodies, without their CRC, that `data` completes."""
        *ended, rest = data.split(_FLAG)
        found = []
        for part in ended:
            self._inside += part
            if self._inside:
                body = self._checked(bytes(self._inside))
                self._inside.clear()
                if body is None:
                    self.dropped += 1
                else:
                    found.append(body)
        self._inside += rest
        return found

    @staticmethod
    def _checked(body: bytes) -> bytes | None:
        for byte, escaped in reversed(_ESCAPES.items()):
            body = body.replace(escaped, byte)
        content, check = body[: -link.CRC_BYTES], body[-link.CRC_BYTES :]
        right = (
            len(body) >= BODY_MIN
            and zlib.crc32(content).to_bytes(link.CRC_BYTES, "little") == check
        )
        return content if right else None


class SerialTransport:
    """Transport over a `Port`.

    tries: number of attempts per request. patience_s: time to wait for an answer to begin, or to go
    on, by the port's clock. repeats: number of repeated requests so far. Raises `LinkError` after
    `tries` attempts without a right answer, and `DeviceResetError` if the device was reset after
    the first request. In both cases, the next request greets the device again.
    """

    def __init__(self, port: Port, tries: int = TRIES, patience_s: float = PATIENCE_S):
        self.port, self.tries, self.patience_s = port, tries, patience_s
        self.repeats = 0
        self._deframer = Deframer()
        self._sequence = 0
        self._greeted, self._used = False, False
        self._read_words = (
            link.READ_WORDS_MAX
        )  # per request; fewer on a bad line, which damages long answers

    def read(self, address: int) -> int:
        """Return the word at `address`."""
        return self.read_block(address, 1)[0]

    def write(self, address: int, value: int) -> None:
        """Write `value` to `address`."""
        self.write_block(address, [value])

    def read_block(self, address: int, words: int) -> list[int]:
        """Return `words` words from `address` on."""
        found: list[int] = []
        while len(found) < words:
            at, count = (
                address + link.WORD_BYTES * len(found),
                min(words - len(found), self._read_words),
            )
            before = self.repeats
            status, content = self._request(Operation.READ, count, at)
            self._read_words = self._read_words * 2 if self.repeats == before else self._read_words
            self._read_words = min(self._read_words, link.READ_WORDS_MAX)
            whole = len(content) // link.WORD_BYTES
            if status is Answer.REFUSED and whole < words - len(found):
                raise RefusedError(f"read of {at + link.WORD_BYTES * whole:#08x}")
            if len(content) % link.WORD_BYTES or not whole:
                raise LinkError(f"read of {at:#08x}: {len(content)} bytes for {count} words")
            found += np.frombuffer(content, "<u4").tolist()
        return found[:words]

    def write_block(self, address: int, values: Sequence[int]) -> None:
        """Write `values` from `address` on."""
        for begin in range(0, len(values), link.WRITE_WORDS_MAX):
            part = values[begin : begin + link.WRITE_WORDS_MAX]
            at = address + link.WORD_BYTES * begin
            data = b"".join(int(value).to_bytes(link.WORD_BYTES, "little") for value in part)
            status, content = self._request(Operation.WRITE, len(part), at, data)
            if status is Answer.REFUSED:
                raise RefusedError(
                    f"write of {part[content[0]]:#x} to {at + link.WORD_BYTES * content[0]:#08x}"
                )
            if content != bytes([len(part)]):
                raise LinkError(f"write to {at:#08x}: {content!r} of {len(part)} words")

    def receive(self, stream: int) -> np.ndarray:
        """Return no beats; the emulator's beats wait in its buffer (`driver.py`)."""
        return np.zeros(0, np.uint64)

    def _request(
        self, operation: Operation, count: int, address: int, data: bytes = b""
    ) -> tuple[Answer, bytes]:
        """Return status (OKAY or REFUSED) and content of the answer."""
        if not self._greeted:
            status, _ = self._exchange(Operation.HELLO, 0, 0)
            self._greeted = True
            if status is Answer.FRESH and self._used:
                self._used = False
                raise DeviceResetError("the device was reset: its settings are lost")
        status, content = self._exchange(operation, count, address, data)
        if status is Answer.FRESH:
            self._greeted, self._used = False, False
            raise DeviceResetError("the device was reset: its settings are lost")
        self._used = True
        if status not in (Answer.OKAY, Answer.REFUSED):
            self._greeted = False
            raise LinkError(f"the device answers {status.name}: does another program use the port?")
        return status, content

    def _exchange(
        self, operation: Operation, count: int, address: int, data: bytes = b""
    ) -> tuple[Answer, bytes]:
        """Repeat the request until its own answer has arrived."""
        self._sequence = (self._sequence + 1) & 0xFF
        for attempt in range(self.tries):
            if attempt:
                self.repeats += 1
                if (
                    operation is Operation.READ
                ):  # an answer to an earlier try may still arrive, and has at least as many words
                    count = self._read_words = max(1, count // 2)
            head = bytes([self._sequence, operation, count]) + address.to_bytes(
                link.ADDRESS_BYTES, "little"
            )
            self.port.write(frame(head + data))
            answer = self._answer()
            if answer is not None:
                return Answer(answer[-1]), answer[1:-1]
        self._greeted = False
        raise LinkError(f"no right answer in {self.tries} tries")

    def _answer(self) -> bytes | None:
        """Return the answer to the current request, or None if it does not arrive."""
        end = self.port.now() + self.patience_s
        while self.port.now() < end:
            if data := self.port.read():
                end = self.port.now() + self.patience_s
                for body in self._deframer.add(data):
                    if body[0] == self._sequence and body[-1] in list(Answer):
                        return body
        return None


class SerialPort:
    """A serial port of this computer, by pyserial. A context manager. Raises `InputError` if it
    cannot be opened.
    """

    def __init__(self, device: str, baud: int = link.BAUD):
        with extra("board"):
            import serial
        try:
            self._serial = serial.Serial(device, baud, timeout=0.02, write_timeout=2)
        except (serial.SerialException, ValueError) as error:
            raise InputError(f"port = {device!r}: cannot be opened ({error})") from None
        self._errors = (serial.SerialException, OSError)

    def __enter__(self) -> "SerialPort":
        return self

    def __exit__(self, *_: object) -> None:
        self._serial.close()

    def write(self, data: bytes) -> None:
        """Send all of `data`. Raises `LinkError` if the port is gone."""
        try:
            self._serial.write(data)
        except self._errors as error:
            raise LinkError(f"the serial port is gone ({error})") from None

    def read(self) -> bytes:
        """Return the received bytes. Raises `LinkError` if the port is gone."""
        try:
            return self._serial.read(max(1, self._serial.in_waiting))
        except self._errors as error:
            raise LinkError(f"the serial port is gone ({error})") from None

    def now(self) -> float:
        """Seconds."""
        return time.monotonic()
