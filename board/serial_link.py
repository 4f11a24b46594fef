# SPDX-License-Identifier: Apache-2.0
"""The emulator's serial link: frames, operations and status codes, for RTL and host software. All
of it is our choice.

Bytes are sent as 8N1. A frame is `FLAG`, a body, `FLAG`. Inside the body, `FLAG` and `ESCAPE` are
sent as `ESCAPE` followed by the byte XOR `FLIP`. A body ends with its CRC-32 (ISO-HDLC, as in
zlib), lowest byte first. A damaged body is dropped without an answer.

Request: sequence number, operation, count, byte address (3 bytes, lowest first), and for WRITE
`count` words, lowest byte first.

Answer: the sequence number; then, for READ, the words, and for WRITE, one byte with the number of
words written; finally the status. REFUSED means that the sensor refused an access; the accesses
before it are done.

The host sends one request at a time, and each has the next sequence number. A request with the same
number as the last
one is a repetition: a READ is executed again, a WRITE is only answered again. Any other number is
answered with SEQUENCE. After a reset, everything is answered with FRESH until a HELLO, which sets
the number. A HELLO is also answered with FRESH if nothing was read or written since the reset, so a
host that reconnects learns whether its settings are still there.
"""

import enum

BAUD = 3_000_000  # of a board's serial bridge
BAUD_TOLERANCE = 0.02
FLAG, ESCAPE, FLIP = 0x7E, 0x7D, 0x20
CRC_BYTES = 4
HEAD_BYTES = 6  # length of a request without data
ADDRESS_BYTES = 3
WORD_BYTES = 4
WRITE_WORDS_MAX = 64  # per request
READ_WORDS_MAX = 255
BODY_BYTES_MAX = HEAD_BYTES + WORD_BYTES * WRITE_WORDS_MAX + CRC_BYTES


class Operation(enum.IntEnum):
    """Operation that a request asks for."""

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
