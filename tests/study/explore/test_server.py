# SPDX-License-Identifier: Apache-2.0
"""The explorer's server: which requests it answers, and how it ends."""

import errno
import json
import os
import signal
import socket
import subprocess
import sys
import urllib.request
from contextlib import contextmanager
from http.client import HTTPConnection
from types import SimpleNamespace
from urllib.error import HTTPError

import numpy as np
import pytest

from coincid.model.shared.errors import InputError
from coincid.study.explore import server
from coincid.study.explore.control_values import check_settings
from coincid.study.explore.uploads import BYTES_MAX, Uploads

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
        *(
            {"Sec-Fetch-Site": "cross-site", "Sec-Fetch-Mode": "navigate", "Sec-Fetch-Dest": part}
            for part in ("iframe", "frame", "embed", "object")
        ),
        {"Origin": "http://127.0.0.1:1"},
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


@pytest.mark.parametrize("name", ["127.0.0.1", "localhost"])
def test_this_machine_is_answered_by_either_name_and_its_browser_keeps_no_page(address, name):
    """The session of a page that Back brings has ended."""
    host = f"{name}:{address.rstrip('/').rpartition(':')[2]}"
    own = {"Host": host, "Origin": f"http://{host}", "Sec-Fetch-Site": "same-origin"}
    with urllib.request.urlopen(urllib.request.Request(address, headers=own)) as page:
        assert (page.status, page.headers["Cache-Control"]) == (200, "no-store")


@pytest.mark.parametrize("name", ["127.0.0.1", "localhost"])
@pytest.mark.parametrize(("origin", "status"), [("own", 101), ("http://example.org", 403)])
def test_a_page_of_either_name_gets_its_session_and_no_other_one_does(
    address, name, origin, status
):
    host = f"{name}:{address.rstrip('/').rpartition(':')[2]}"
    headers = {
        "Host": host,
        "Origin": f"http://{host}" if origin == "own" else origin,
        "Connection": "Upgrade",
        "Upgrade": "websocket",
        "Sec-WebSocket-Key": "dGhlIHNhbXBsZSBub25jZQ==",
        "Sec-WebSocket-Version": "13",
        "Sec-WebSocket-Protocol": "bokeh, none",
    }
    client = HTTPConnection(address.removeprefix("http://").rstrip("/"), timeout=60)
    client.request("GET", "/ws", headers=headers)
    assert client.getresponse().status == status
    client.close()


def test_a_port_in_use_is_named(address):
    port = address.rstrip("/").rpartition(":")[2]
    command = [sys.executable, "-m", "coincid", "explore", "--no-browser", "--port", port]
    done = subprocess.run(command, capture_output=True, text=True, encoding="utf-8")
    assert (done.returncode, done.stdout) == (2, "")
    assert (
        done.stderr
        == f"coincid: port = {port}: in use or not allowed, must be a free port from 1024 to 65535\n"
    )


@pytest.fixture
def taken():
    """Return a port that is in use."""
    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        one.listen()
        yield one.getsockname()[1]


def port_of(asked):
    """Return the port on which a server would listen."""
    listening, port = server._sockets(asked)
    assert {one.getsockname()[1] for one in listening} == {port}
    for one in listening:
        one.close()
    return port


def test_without_a_port_it_is_the_first_free_one_of_its_own(monkeypatch, taken):
    monkeypatch.setattr(server, "PORT", taken)
    monkeypatch.setattr(server, "PORTS_TRIED", 100)
    assert taken < port_of(None) < taken + 100
    monkeypatch.setattr(server, "PORTS_TRIED", 1)
    with pytest.raises(InputError, match=f"^ports {taken} to {taken}: in use or not allowed"):
        port_of(None)


def test_port_0_is_any_free_one_and_another_is_itself(monkeypatch, taken):
    """None of the server's own, all of which may be in use."""
    monkeypatch.setattr(server, "PORT", taken)
    monkeypatch.setattr(server, "PORTS_TRIED", 1)
    free = port_of(0)
    assert free not in (0, taken)
    assert port_of(free) == free
    with pytest.raises(InputError, match=f"^port = {taken}: in use or not allowed"):
        port_of(taken)


@pytest.mark.parametrize("port", (-1, 65536))
def test_a_port_that_does_not_exist_has_its_range(port):
    with pytest.raises(InputError, match=f"port = {port}: must be an integer from 0 to 65535"):
        port_of(port)


@pytest.mark.parametrize("number", [errno.EADDRINUSE, errno.EACCES])
def test_a_port_that_the_system_refuses_is_named(monkeypatch, number):
    """In use, or for administrators only; what else goes wrong is no matter of the port."""
    tried = []

    def refused(port, address):
        tried.append(port)
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(server, "bind_sockets", refused)
    with pytest.raises(InputError, match="^port = 80: in use or not allowed"):
        port_of(80)
    with pytest.raises(InputError, match="^ports 5006 to 5025: in use or not allowed"):
        port_of(None)
    assert tried == [80, *range(5006, 5026)]
    number = errno.EMFILE
    with pytest.raises(OSError, match=os.strerror(errno.EMFILE)):
        port_of(80)


def test_the_largest_legal_file_fits_into_a_message():
    """In base64, beside the other fields of its order."""
    made, _ = server.make_server(0)
    largest = made._tornado.settings["websocket_max_message_size"]
    made.stop()
    assert largest > BYTES_MAX * 4 / 3 + 10_000


@pytest.mark.parametrize("browser", [False, True])
def test_the_browser_is_opened_at_the_address_that_is_printed_if_it_is_wanted(
    monkeypatch, capsys, browser
):
    given, done = [], []
    idle = SimpleNamespace(start=lambda: done.append("started"), stop=lambda: done.append("ended"))

    def interrupted():
        done.append("served")
        raise KeyboardInterrupt

    monkeypatch.setattr(
        server, "IOLoop", SimpleNamespace(current=lambda: SimpleNamespace(start=interrupted))
    )
    monkeypatch.setattr(
        server, "make_server", lambda *what: given.append(what) or (idle, "http://here/")
    )
    monkeypatch.setattr(server.webbrowser, "open", done.append)
    start = check_settings({})
    server.serve(7, browser=browser, start=start)
    assert given == [(7, start)]
    assert done == ["started", *["http://here/"] * browser, "served", "ended"]
    assert "http://here/" in capsys.readouterr().out


@pytest.fixture
def opened(monkeypatch):
    """Return the function that opens a page by the arguments of a link, and returns its values,
    uploads and message.
    """
    openers, pages = [], []

    class Noted(server.FunctionHandler):
        def __init__(self, opener):
            openers.append(opener)
            super().__init__(opener)

    monkeypatch.setattr(server, "FunctionHandler", Noted)
    monkeypatch.setattr(server, "_sockets", lambda port: ([], 5006))
    monkeypatch.setattr(server, "Page", lambda *given: pages.append(given))

    def opened(start, **arguments):
        server.make_server(start=start)
        given = {
            name: [b"x", text.encode("utf-8", "surrogateescape")]
            for name, text in arguments.items()
        }
        request = SimpleNamespace(arguments=given)
        openers[-1](SimpleNamespace(session_context=SimpleNamespace(request=request)))
        _, values, uploads, _, told = pages[-1]
        return values, uploads, told

    return opened


def test_a_link_changes_what_the_explorer_was_started_with(opened):
    """The last value of an argument counts; Bokeh's own arguments and unknown ones do not."""
    start = check_settings({"klux": 5.0, "threshold": 3})
    values, uploads, told = opened(start, klux="7", **{"bokeh-session-id": "x", "moon": "1"})
    assert (values["klux"], values["threshold"]) == (7, 3)
    assert uploads == start.uploads and "moon" in told
    values, uploads, told = opened(None, threshold="4", **{"bokeh-session-id": "x"})
    assert (values, uploads, told) == ({"threshold": 4}, Uploads(), "")


def test_a_link_with_bytes_that_are_no_letters_opens_the_page(opened):
    values, _, told = opened(None, threshold="4", window="\udcff")
    assert values == {"threshold": 4}
    assert told.startswith("Ignored in the link: Window")


def test_uploads_of_a_server_that_ran_before_are_gone(opened, tmp_path):
    """Those with which this one was started are there without a number."""
    np.save(tmp_path / "wall.npy", np.full((8, 8), 4.0))
    uploads = Uploads(depth=tmp_path / "wall.npy")
    start = check_settings({"scene": "upload"}, uploads)
    assert opened(start)[:2] == (start.values, uploads)
    assert opened(start, uploads="none")[1:] == (uploads, "")
    for unknown in ("7", "9" * 5000):  # also one that is no integer of Python's
        values, found, told = opened(start, uploads=unknown)
        assert found == Uploads() and values.get("scene") != "upload"
        assert told == "Scene: the file is not here any more; please choose it again."


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize("heard", [True, False])
def test_it_ends_without_a_complaint_also_where_nobody_takes_its_output(number, heard):
    with explorer(*SMALL) as (process, _):
        if not heard:
            process.stdout.close()
        process.send_signal(number)
        # the other: the signal came before the server had begun to serve
        assert process.wait(60) in (0, 128 + number)
