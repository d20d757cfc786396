"""The server: one address of this machine, one page, every file of it from this machine."""

from __future__ import annotations

import errno
import logging
import socket
from pathlib import Path

from bokeh.application import Application
from bokeh.application.handlers.function import FunctionHandler
from bokeh.document import Document
from bokeh.server.server import BaseServer
from bokeh.server.tornado import BokehTornado
from bokeh.server.views.ws import WSHandler
from tornado.httpserver import HTTPServer
from tornado.ioloop import IOLoop
from tornado.web import StaticFileHandler

from workbench.errors import InvalidValue
from workbench.ui.document import open_page
from workbench.ui.load import Loaded
from workbench.ui.page import LARGEST_UPLOAD

__all__ = ["PORT", "UiServer", "start"]

STATIC = Path(__file__).parent / "static"
PORT = 5006  # taken where it is free
LOOPBACK = ("127.0.0.1", "localhost")
EVERYWHERE = "0.0.0.0"  # noqa: S104 - only compared with: what a user asked for
SESSION_CHECK, SESSION_LIFE = 5_000, 15_000  # ms: a closed tab's session, its files and worker go then


class _Static(StaticFileHandler):
    """Our own files, which a new version of the program may change."""

    def set_extra_headers(self, path: str) -> None:  # noqa: ARG002 - tornado's signature
        self.set_header("Cache-Control", "no-cache")
        self.set_header("X-Content-Type-Options", "nosniff")


class _Socket(WSHandler):  # type: ignore[misc]
    """A websocket whose messages, which go out in several small pieces, do not wait for each to be acknowledged."""

    def open(self) -> None:
        """Take the connection."""
        super().open()
        self.set_nodelay(True)


class UiServer(BaseServer):  # type: ignore[misc]
    """A server under way at an address and port; `run_until_shutdown` serves until it is interrupted."""

    def __init__(self, loop: IOLoop, application: BokehTornado, http: HTTPServer, address: str, port: int) -> None:
        super().__init__(loop, application, http)
        self._place = address, port

    @property
    def port(self) -> int:
        """The port that is listened on."""
        return self._place[1]

    @property
    def url(self) -> str:
        """Where the page is."""
        return f"http://{LOOPBACK[0] if self._place[0] == EVERYWHERE else self._place[0]}:{self.port}/"


def start(
    loaded: Loaded | None = None, address: str = LOOPBACK[0], port: int | None = None, data: Path | None = None
) -> UiServer:
    """Start serving.

    loaded: what a new session shows; data: a record that each session reads first. port: `PORT` by default, or
    a free one where that is taken; 0 for a free one. Websockets are taken from pages of this address alone. Raises
    `InvalidValue` for an address or port that cannot be had.
    """

    def make(document: Document) -> None:
        open_page(document, loaded, data)

    listening = _bound(address, port)
    taken = int(listening.getsockname()[1])
    names: tuple[str, ...] = LOOPBACK if address in LOOPBACK else (address,)
    if address == EVERYWHERE:
        names = (*LOOPBACK, socket.gethostname(), socket.getfqdn())
    logging.getLogger("tornado.access").setLevel(logging.ERROR)
    application = BokehTornado(
        {"/": Application(FunctionHandler(make))},
        extra_websocket_origins=[f"{name}:{taken}" for name in names],
        extra_patterns=[(r"/assets/(.*)", _Static, {"path": str(STATIC)})],
        websocket_max_message_size_bytes=2 * LARGEST_UPLOAD,  # a file in base64, and some
        check_unused_sessions_milliseconds=SESSION_CHECK,
        unused_session_lifetime_milliseconds=SESSION_LIFE,
    )
    for route in application.wildcard_router.rules:
        if route.target is WSHandler:
            route.target = _Socket
    http = HTTPServer(application)
    http.add_socket(listening)
    server = UiServer(IOLoop.current(), application, http, address, taken)
    server.start()
    return server


def _bound(address: str, port: int | None) -> socket.socket:
    """Return a listening socket, at a free port where none was asked for and the usual one is taken."""
    if not address.strip():  # which a socket takes for every address that this machine has
        raise InvalidValue("--address", repr(address), "must be an address or a name of this machine")
    for wanted in (PORT, 0) if port is None else (port,):
        try:
            made = socket.create_server((address, wanted), backlog=128)
        except (OSError, OverflowError, UnicodeError) as error:
            if port is None and wanted == PORT and getattr(error, "errno", None) == errno.EADDRINUSE:
                continue
            reason = (getattr(error, "strerror", None) or str(error)).partition(" (while attempting")[0]
            where = f"{address}:{wanted}"
            raise InvalidValue("--address and --port", where, f"cannot be served here ({reason})") from None
        made.setblocking(False)
        return made
    raise AssertionError("one of the ports is taken or raises")
