# SPDX-License-Identifier: Apache-2.0
"""The explorer's server: it serves this machine only, and accepts requests only from its own
pages.
"""

import errno
import logging
import webbrowser
from socket import socket
from typing import Any

from bokeh.application import Application
from bokeh.application.handlers.function import FunctionHandler
from bokeh.document import Document
from bokeh.resources import Resources
from bokeh.server.server import BaseServer
from bokeh.server.tornado import BokehTornado
from tornado.httpserver import HTTPServer
from tornado.httputil import HTTPHeaders, HTTPMessageDelegate, HTTPServerRequest
from tornado.ioloop import IOLoop
from tornado.netutil import bind_sockets
from tornado.web import ErrorHandler, OutputTransform

from ...model.shared.errors import InputError, check_integer
from .control_values import Settings, values_of_link, without_lost_pictures
from .tab import UPLOADS, Page
from .uploads import Kept, Uploads

ADDRESS, PORT = "127.0.0.1", 5006
PORTS_TRIED = 20  # from `PORT` on, if none is given
DIGITS_MAX = 20  # no number of uploads has so many
MESSAGE_BYTES_MAX = 64 << 20  # an upload in base64, with room to spare


class Guarded(BokehTornado):  # type: ignore[misc]  # Bokeh comes with an extra
    """Answers requests that its own pages send to its own address, and refuses all others, whatever
    host name they use.
    """

    hosts: frozenset[str] = frozenset()

    def resources(self, absolute_url: str | bool | None = None) -> Resources:
        """Leave out the libraries of Bokeh whose models the page does not have: they are two thirds
        of all bytes.
        """
        return super().resources(absolute_url).clone(components=["bokeh"])

    def find_handler(self, request: HTTPServerRequest, **kwargs: Any) -> HTTPMessageDelegate:
        if self.allowed(request.host, request.headers):
            return super().find_handler(request, **kwargs)
        return self.get_handler_delegate(request, ErrorHandler, {"status_code": 403})

    def allowed(self, host: str, headers: HTTPHeaders) -> bool:
        origin, site = headers.get("Origin"), headers.get("Sec-Fetch-Site", "none")
        own = host in self.hosts and (
            origin is None or origin.removeprefix("http://") in self.hosts
        )
        opened = (
            headers.get("Sec-Fetch-Mode") == "navigate"
            and headers.get("Sec-Fetch-Dest") == "document"
        )
        # a link on another site may open the page
        return own and (site in ("none", "same-origin") or opened)


class Unkept(OutputTransform):
    """Tells the browser to keep no page: the session of a page that Back brings has ended."""

    def transform_first_chunk(
        self, status_code: int, headers: HTTPHeaders, chunk: bytes, finishing: bool
    ) -> tuple[int, HTTPHeaders, bytes]:
        if headers.get("Content-Type", "").startswith("text/html"):
            headers["Cache-Control"] = "no-store"
        return status_code, headers, chunk


def make_server(port: int | None = None, start: Settings | None = None) -> tuple[BaseServer, str]:
    """Return a listening server and its address. start: first settings of a page. Raises
    `InputError` for a bad port.
    """
    sockets, port = _sockets(port)
    hosts = frozenset(f"{name}:{port}" for name in (ADDRESS, "localhost"))
    kept = Kept()

    def new_page(doc: Document) -> None:
        arguments = {
            name: values[-1].decode("utf-8", "replace")
            for name, values in doc.session_context.request.arguments.items()
        }
        number = arguments.pop(UPLOADS, "")
        given, ignored = values_of_link(
            {name: text for name, text in arguments.items() if not name.startswith("bokeh-")}
        )
        values = (start.values if start else {}) | given
        if number.isdecimal():
            # one of thousands of digits, which Python converts to no integer, is that of no set
            uploads = kept.get(int(number) if len(number) < DIGITS_MAX else -1)
        else:
            uploads = start.uploads if start else Uploads()
        values, lost = without_lost_pictures(values, uploads)
        Page(doc, values, uploads, kept, " ".join(filter(None, (ignored, lost))))

    tornado = Guarded(
        {"/": Application(FunctionHandler(new_page))},
        extra_websocket_origins=sorted(hosts),
        websocket_max_message_size_bytes=MESSAGE_BYTES_MAX,
        use_index=False,
    )
    tornado.hosts = hosts
    tornado.add_transform(Unkept)
    http = HTTPServer(tornado)
    http.add_sockets(sockets)
    return BaseServer(IOLoop.current(), tornado, http), f"http://{ADDRESS}:{port}/"


def _sockets(port: int | None) -> tuple[list[socket], int]:
    """Return listening sockets and their port: the given one, or the first free one."""
    if port is not None:
        port = check_integer("port", port, 0, 65535)
    for tried in [port] if port is not None else range(PORT, PORT + PORTS_TRIED):
        try:
            sockets = bind_sockets(tried, ADDRESS)
            return sockets, sockets[0].getsockname()[1]
        except OSError as error:
            if error.errno not in (errno.EADDRINUSE, errno.EACCES):
                raise
    named = f"port = {port}" if port is not None else f"ports {PORT} to {PORT + PORTS_TRIED - 1}"
    raise InputError(f"{named}: in use or not allowed, must be a free port from 1024 to 65535")


def serve(port: int | None, *, browser: bool, start: Settings) -> None:
    """Serve until Ctrl-C or SIGTERM.

    Bokeh's own way prints at the end, and goes on serving if nobody takes the output any more.
    """
    server, address = make_server(port, start)
    server.start()
    # keeps closed tabs and refused requests out of the terminal
    for name in ("bokeh", "tornado.access"):
        logging.getLogger(name).setLevel(logging.ERROR)
    print(f"Coincid explorer: {address} (Ctrl-C ends it)", flush=True)
    if browser:
        webbrowser.open(address)
    try:
        IOLoop.current().start()
    except KeyboardInterrupt:
        server.stop()
