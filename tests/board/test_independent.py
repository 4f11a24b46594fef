# SPDX-License-Identifier: Apache-2.0
"""A client that is written from the documents alone, and the numbers of the documents.

The client takes nothing from the project: framing and addresses of docs/emulator-protocol.md, registers of
registers.md, words of docs/contract.md are spelled out here, so that a page that says too little,
or another thing than the RTL does, is found.
"""

import re
import struct
from pathlib import Path
from zlib import crc32

import numpy as np

from coincid.board import parameters as chip
from coincid.board import serial_link as link
from coincid.board.simulated import SimulatedPort
from coincid.board.source_model import SourceSettings, source_edges
from coincid.model.contract.registers import Access
from coincid.model.golden.frame import Golden

from ..random_cases import configured
from .test_emulator import EMULATOR, SENSOR

FRAMES = 12
PERIOD, PULSES, WINDOW, THRESHOLD = 50, 5, 4, 2
SEED, SPREAD, DEAD, BACKGROUNDS, ECHO_TICK, ECHO_LEVEL = 77, 2, 3, (1500, 4000), 130, 200


PAGE = (Path(__file__).parents[2] / "docs" / "emulator-protocol.md").read_text(encoding="utf-8")
TOLD_ACCESS = {
    Access.CONSTANT: "read",
    Access.COUNTER: "read",
    Access.SETTING: "setting",
    Access.PULSE: "write",
}


def test_the_page_has_each_register_of_the_emulator_as_it_is_built():
    """Its address, range, and value after a reset; and where the regions begin."""
    rows = re.findall(r"^\| `(0x\w+)` \| `(\w+)` \| (\w+) \| (.*?) ?\| (.*) \|$", PAGE, re.M)
    assert [name for _, name, *_ in rows] == [register.name for register in chip.OWN]
    for (address, name, access, span, meaning), register in zip(rows, chip.OWN, strict=True):
        assert int(address, 16) == chip.own_address(name)
        assert access == TOLD_ACCESS[register.access], name
        if register.access is Access.SETTING:
            low, high = register.low(SENSOR), register.high(SENSOR)
            assert span.replace("2^32 - 1", str((1 << 32) - 1)) == f"{low} to {high}", name
            assert f"{register.reset(SENSOR)} after reset" in meaning, name
    assert f"`{chip.EMULATOR_ID:#010x}`" in PAGE
    assert f"this page is of major {chip.EMULATOR_VERSION >> 16}" in PAGE
    places = re.findall(r"^\| `(0x\w+)(?: \+ (0x\w+) s)?` \| the", PAGE, re.M)
    bases = chip.SENSOR_BASE, chip.OWN_BASE, chip.SOURCE_BASE, chip.BUFFER_BASE
    assert [int(place, 16) for place, _ in places] == list(bases)
    assert [int(stride, 16) for _, stride in places if stride] == [chip.SOURCE_STRIDE]
    for subgroup in (0, 3):
        background = chip.SOURCE_BASE + chip.SOURCE_STRIDE * subgroup
        assert chip.background_address(subgroup) == background
        assert chip.echo_address(subgroup, 5) == background + 0x400 + 4 * 5
    assert "from `+0x400` on" in PAGE and f"<< {chip.LEVEL_BITS}) + its probability" in PAGE


def test_the_page_has_the_numbers_of_the_line():
    """Special bytes, lengths, operations, and the status of an answer."""
    flag, escape = link.FLAG, link.ESCAPE
    assert f"`{flag:#x}` is sent as `{escape:#x} {flag ^ link.FLIP:#x}`" in PAGE
    assert f"`{escape:#x}` as `{escape:#x} {escape ^ link.FLIP:#x}`" in PAGE
    assert f"Bytes go at {link.BAUD / 1e6:g} Mbaud" in PAGE
    lengths = f"1 to {link.READ_WORDS_MAX} for a read, 1 to {link.WRITE_WORDS_MAX} for a write"
    assert lengths in PAGE
    operations = ", ".join(f"{one.value} {one.name.lower()}" for one in link.Operation)
    assert f"| {operations} |" in PAGE
    status = re.search(r"^\| status \| 1 \| (.*) \|$", PAGE, re.M)[1]
    words = ["done", "refused", "wrong number", "not greeted", "no such operation"]
    answers = ["OKAY", "REFUSED", "SEQUENCE", "FRESH", "UNKNOWN"]
    assert [one.name for one in link.Answer] == answers
    for answer, word in zip(link.Answer, words, strict=True):
        assert f"{answer.value} {word}" in status


class Client:
    """Speaks docs/emulator-protocol.md over anything that writes and reads bytes."""

    def __init__(self, line):
        self.line, self.number, self.heard = line, 0, b""
        status, _ = self.ask(0, 0, 0)
        assert status in (0, 3)

    def ask(self, operation, count, address, words=()):
        """Status and content of the answer."""
        body = struct.pack(
            f"<BBBBH{len(words)}I",
            self.number,
            operation,
            count,
            address & 0xFF,
            address >> 8,
            *words,
        )
        body += struct.pack("<I", crc32(body))  # of Ethernet: polynomial 0x04c11db7
        body = body.replace(b"\x7d", b"\x7d\x5d").replace(b"\x7e", b"\x7d\x5e")
        self.line.write(b"\x7e" + body + b"\x7e")
        answer = self.answer()
        assert answer[0] == self.number
        self.number = (self.number + 1) % 256
        return answer[-1], answer[1:-1]

    def answer(self):
        for _ in range(3000):  # reads, each of a byte at least
            self.heard += self.line.read()
            parts = self.heard.split(b"\x7e")
            for inside in parts[1:-1]:
                body = inside.replace(b"\x7d\x5e", b"\x7e").replace(b"\x7d\x5d", b"\x7d")
                if len(body) > 5 and crc32(body[:-4]) == int.from_bytes(body[-4:], "little"):
                    self.heard = b""
                    return body[:-4]
        raise AssertionError("no answer")

    def read(self, address, count=1):
        status, content = self.ask(1, count, address)
        assert status == 0
        return struct.unpack(f"<{count}I", content)

    def write(self, address, *values):
        assert self.ask(2, len(values), address, values) == (0, bytes([len(values)]))

    def program(self):
        assert self.read(0x000000) == (0x434F494E,)  # COIN
        assert self.read(0x100000) == (0x454D554C,)  # EMUL
        self.write(0x48, PERIOD, PULSES, 1)  # period, pulses, format: id
        for subgroup, background in enumerate(BACKGROUNDS):
            self.write(0x1000 + 0x80 * subgroup + 4, THRESHOLD, WINDOW)
            self.write(0x200000 + 0x800 * subgroup, background)
            self.write(0x200400 + 0x800 * subgroup, *[ECHO_TICK << 8 | ECHO_LEVEL] * 16)
        self.write(0x10000C, SEED, SPREAD, DEAD)

    def frame(self):
        """The beats of a frame, header by header until the frame end packet is whole."""
        (places,) = self.read(0x100008)
        self.write(0x40, 1)
        beats = []
        for _ in range(1000):
            if self.ended(beats):
                break
            level, first = self.read(0x100018, 2)
            if not level:
                continue
            run = min(level, places - first, 127)
            words = self.read(0x300000 + 8 * first, 2 * run)
            beats += [low | high << 32 for low, high in zip(words[::2], words[1::2], strict=True)]
            self.write(0x100020, run)
        assert self.read(0x44) == (2,)  # done
        self.write(0x44, 2)
        return beats

    @staticmethod
    def ended(beats):
        at = 0
        while at < len(beats) and beats[at] >> 61 != 7:
            at += {6: 1, 2: 2}[beats[at] >> 61]  # frame start; header and map of 16 pixels
        return len(beats) - at == 1 + 2 * 6  # two subgroups' 11 counters, two per beat


FRAME = {"period": PERIOD, "pulses": PULSES, "clock_mhz": 100, "format": "id"}
CONFIG = configured(SENSOR, FRAME, {"threshold": THRESHOLD, "window": WINDOW})
ECHOES = {"tick": np.full((2, 16), ECHO_TICK), "level": np.full((2, 16), ECHO_LEVEL)}
SETTINGS = SourceSettings(
    background=np.array(BACKGROUNDS), spread=SPREAD, dead_cycles=DEAD, seed=SEED, **ECHOES
)


def test_the_documented_client_reads_the_golden_models_frame_and_follows_the_rules_of_the_line():
    """So many frames that the buffer's ring is read across its end.

    A repeated write is answered, not done again; a wrong number is told; a reset is noticed."""
    golden = Golden(SENSOR)
    expected = [
        golden.frame(CONFIG, source_edges(CONFIG, SETTINGS, k)).beats[0].tolist()
        for k in range(FRAMES)
    ]
    assert sum(map(len, expected)) > EMULATOR.buffer_beats
    with SimulatedPort(EMULATOR, 100) as line:
        client = Client(line)
        client.program()
        assert [client.frame() for _ in expected] == expected
        client.number = (client.number - 1) % 256  # of the write to status
        assert client.ask(2, 1, 0x44, [2]) == (0, b"\x01")
        client.number = (client.number + 7) % 256
        assert client.ask(1, 1, 0) == (2, b"")
        line.reset()
        assert client.ask(1, 1, 0) == (3, b"")
        again = Client(line)
        again.program()
        assert again.frame() == expected[0]
        assert again.ask(1, 2, 0x0C0000) == (1, b"")
        assert again.ask(2, 3, 0x100010, [4, 16, 5]) == (1, b"\x01")
        assert again.ask(5, 1, 0) == (4, b"")
