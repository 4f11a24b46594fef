# SPDX-License-Identifier: Apache-2.0
"""The emulator's serial link: its frames, operations and statuses. Our choice; RTL and host software read this.

Bytes go as 8N1. A frame is `FLAG`, a body, `FLAG`; in the body `FLAG` and `ESCAPE` are sent as `ESCAPE` and the byte XOR `FLIP`. A body ends
with its CRC-32 (ISO-HDLC, as in zlib), lowest byte first. A body that is not right is dropped without a word.

Request: sequence number, operation, count, byte address (3 bytes, lowest first), and for WRITE `count` words, lowest byte first.
Answer: the sequence number, then for READ the words, for WRITE a byte with the number of words written, and last the status. REFUSED: the sensor
refused an access; those before it are done. The host has one request under way. A request carries the number after that of the one before it;
one with the same number is the same request again: a READ is done again, a WRITE only answered again. Any other number is answered with
SEQUENCE. After reset everything is answered with FRESH until a HELLO, which sets the number; a HELLO is answered with FRESH, too, where nothing
was read or written since reset, so that a host that comes back knows whether its settings are still there.
"""

import enum

BAUD = 3_000_000  # of a board's serial bridge
BAUD_TOLERANCE = 0.02
FLAG, ESCAPE, FLIP = 0x7E, 0x7D, 0x20
CRC_BYTES = 4
HEAD_BYTES = 6  # of a request
ADDRESS_BYTES = 3
WORD_BYTES = 4
WRITE_WORDS_MAX = 64  # of a request
READ_WORDS_MAX = 255
BODY_BYTES_MAX = HEAD_BYTES + WORD_BYTES * WRITE_WORDS_MAX + CRC_BYTES


class Operation(enum.IntEnum):
    """What a request asks for."""

    HELLO = 0
    READ = 1
    WRITE = 2


class Answer(enum.IntEnum):
    """Status of an answer."""

    OKAY = 0
    REFUSED = 1
    SEQUENCE = 2
    FRESH = 3
    UNKNOWN = 4  # no such operation, or the wrong length
