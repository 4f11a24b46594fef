# SPDX-License-Identifier: Apache-2.0
"""The explorer's server: which requests it answers, and how it ends."""

import json
import signal
import subprocess
import sys
import urllib.request
from contextlib import contextmanager
from urllib.error import HTTPError

import pytest

SMALL = ("rows=16", "cols=16", "pulses=20")


@contextmanager
def explorer(*settings, port=0):
    """Serve an explorer; return (process, address)."""
    words = [word for setting in settings for word in ("--set", setting)]
    command = [
        sys.executable,
        "-m",
        "coincid",
        "explore",
        "--port",
        str(port),
        "--no-browser",
        *words,
    ]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, encoding="utf-8")
    try:
        yield process, process.stdout.readline().split()[2]
    finally:
        process.kill()
        process.wait()
        process.stdout.close()


@pytest.fixture(scope="module")
def address():
    with explorer(*SMALL) as (_, address):
        yield address


@pytest.mark.parametrize(
    "headers",
    [
        {"Origin": "http://example.org"},
        {"Host": "example.org"},
        {"Sec-Fetch-Site": "cross-site"},
        {"Sec-Fetch-Site": "same-site", "Sec-Fetch-Mode": "no-cors"},
    ],
    ids=json.dumps,
)
def test_other_origins_are_refused(address, headers):
    with pytest.raises(HTTPError, match="403"):
        urllib.request.urlopen(urllib.request.Request(address, headers=headers))
    link = {
        "Sec-Fetch-Site": "cross-site",
        "Sec-Fetch-Mode": "navigate",
        "Sec-Fetch-Dest": "document",
    }
    with urllib.request.urlopen(urllib.request.Request(address, headers=link)) as page:
        assert page.status == 200


def test_a_port_in_use_is_named(address):
    port = address.rstrip("/").rpartition(":")[2]
    command = [sys.executable, "-m", "coincid", "explore", "--no-browser", "--port", port]
    done = subprocess.run(command, capture_output=True, text=True, encoding="utf-8")
    assert (done.returncode, done.stdout) == (2, "")
    assert (
        done.stderr
        == f"coincid: port = {port}: in use or not allowed, must be a free port from 1024 to 65535\n"
    )


def test_it_ends_without_a_complaint():
    with explorer(*SMALL) as (process, _):
        process.send_signal(signal.SIGTERM)
        # 143: the signal came before the server had installed its handler
        assert process.wait() in (0, 143)
