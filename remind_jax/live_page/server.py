"""The live page at a local address: the standard library's server, bounded in every way.

Names in the `Host` header are checked, so that no page of another site can read this one.
"""

from __future__ import annotations

import contextlib
import ipaddress
import json
import logging
import socket
import threading
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib import resources
from typing import Any
from urllib.parse import parse_qs, urlsplit

from remind_jax.errors import OptionError, OutputError
from remind_jax.live_page.view import LiveView

DEFAULT_HOST, DEFAULT_PORT = "127.0.0.1", 8642
_MAX_PORTS = 10  # that are tried from the default one on
MAX_CLIENTS = 32  # answered at once; a browser that looks on takes two
TIMEOUT_S = 10.0
_NEWS_WITHIN_S = 2.0  # that an answer about the state may wait for news
_FILES = {
    "/": ("page.html", "text/html; charset=utf-8"),
    "/page.js": ("page.js", "text/javascript; charset=utf-8"),
    "/page.css": ("page.css", "text/css; charset=utf-8"),
}
_HEADERS = {
    "Content-Security-Policy": (
        "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data:; "
        "connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    ),
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cache-Control": "no-store",
}

_log = logging.getLogger(__name__)


class LivePage(contextlib.AbstractContextManager):
    """Serves a view while it is open.

    Attributes:
      address: Of the page; known once it is open.
    """

    def __init__(self, view: LiveView, where: bool | str = True) -> None:
        """Opens nothing yet.

        Args:
          where: `"HOST:PORT"`; True for the first free one of ten ports, which only this machine
            reaches.
        """
        self._view = view
        self._host, self._port = parse_where(where)
        self._last_port = self._port + (_MAX_PORTS - 1 if where is True else 0)
        self.address = ""

    def __enter__(self) -> LivePage:
        self._server = self._listen()
        host = f"[{self._host}]" if ":" in self._host else self._host
        self.address = f"http://{host}:{self._server.server_address[1]}/"
        threading.Thread(target=self._server.serve_forever, name="live page", daemon=True).start()
        return self

    def __exit__(self, *raised: object) -> None:
        self._view.end()
        self._server.shutdown()
        self._server.server_close()

    def _listen(self) -> _Server:
        port = self._port
        while True:
            try:
                server = _Server(self._view, self._host, port)
            except OSError as error:
                if port == self._last_port:
                    raise OutputError(
                        f"no page can be shown at '{self._host}:{port}': "
                        f"{error.strerror or error}; give another HOST:PORT, port 0 for any that "
                        "is free"
                    ) from error
                port += 1
            else:
                if port != self._port:
                    _log.warning("port %d is taken; the live page is at %d", self._port, port)
                return server


def parse_where(where: bool | str) -> tuple[str, int]:
    """Host and port of a page. Raises OptionError if it is no HOST:PORT."""
    if where is True:
        return DEFAULT_HOST, DEFAULT_PORT
    host, _, port = str(where).rpartition(":")
    host = host.removeprefix("[").removesuffix("]")
    is_port = port.isascii() and port.isdigit() and len(port) < 6 and int(port) < 1 << 16
    if not isinstance(where, str) or not is_port or not host or "/" in host:
        raise OptionError(
            f"'live' is {where!r}; give HOST:PORT, as {DEFAULT_HOST}:{DEFAULT_PORT}, or nothing "
            "for a page that only this machine sees",
            "live",
        )
    return host, int(port)


def is_known_host(header: str | None, bound: str) -> bool:
    """Whether a `Host` header names this server by an address, or by a name that it has."""
    try:
        name = (urlsplit(f"//{header}").hostname or "") if header else ""
    except ValueError:
        return False
    with contextlib.suppress(ValueError):
        ipaddress.ip_address(name)
        return True
    own = socket.gethostname().lower()
    return name.removesuffix(".") in {"localhost", bound.lower(), own, f"{own}.local"} - {""}


class _Server(ThreadingHTTPServer):
    """Answers so many clients at once and turns others away."""

    daemon_threads = True
    block_on_close = False
    request_queue_size = 16

    def __init__(self, view: LiveView, host: str, port: int) -> None:
        self.view, self.bound = view, host
        self._free = threading.BoundedSemaphore(MAX_CLIENTS)
        self.address_family = socket.AF_INET6 if ":" in host else socket.AF_INET
        super().__init__((host, port), _Handler)

    def server_bind(self) -> None:
        """Without a question to the name server."""
        self.socket.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        self.socket.bind(self.server_address)
        self.server_address = self.socket.getsockname()
        self.server_name, self.server_port = self.bound, self.server_address[1]

    def process_request(self, request: Any, client_address: Any) -> None:
        """Gives a client a thread, if there is one."""
        if not self._free.acquire(blocking=False):
            with contextlib.suppress(OSError):
                request.settimeout(0)
                request.send(b"HTTP/1.0 503 Service Unavailable\r\nRetry-After: 1\r\n\r\n")
            self.shutdown_request(request)
            return
        try:
            super().process_request(request, client_address)
        except BaseException:
            self._free.release()
            raise

    def process_request_thread(self, request: Any, client_address: Any) -> None:
        """Answers one client."""
        try:
            super().process_request_thread(request, client_address)
        finally:
            self._free.release()

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Says nothing of clients that go away."""


class _Handler(BaseHTTPRequestHandler):
    """One request: the page, its state, or a picture."""

    server: _Server  # pyright: ignore[reportIncompatibleVariableOverride]
    timeout = TIMEOUT_S
    server_version, sys_version = "remind-jax", ""
    error_message_format, error_content_type = "%(code)d %(message)s\n", "text/plain"

    def do_HEAD(self) -> None:
        """As `do_GET`, headers only."""
        self.do_GET()

    def do_GET(self) -> None:
        """Answers, or refuses."""
        if not is_known_host(self.headers.get("Host"), self.server.bound):
            why = "This machine has no such name; open it by its IP address"
            self.send_error(HTTPStatus.MISDIRECTED_REQUEST, explain=why)
            return
        if self.headers.get("Sec-Fetch-Site") == "cross-site":
            self.send_error(HTTPStatus.FORBIDDEN)
            return
        path, _, query = self.path.partition("?")
        if path in _FILES:
            name, kind = _FILES[path]
            page = resources.files("remind_jax.live_page").joinpath(name)
            self._answer(page.read_bytes(), kind)
        elif path == "/state.json":
            self._answer(self._state(query), "application/json")
        elif path == "/frame.jpg":
            self._answer(self.server.view.picture(), "image/jpeg")
        elif path.startswith("/object/"):
            key = path.removeprefix("/object/").removesuffix(".jpg")
            is_number = key.isascii() and key.isdigit() and len(key) < 10
            self._answer(self.server.view.picture_of(int(key)) if is_number else None, "image/jpeg")
        else:
            self.send_error(HTTPStatus.NOT_FOUND)

    def log_message(self, format: str, *args: Any) -> None:
        """Says nothing."""

    def _state(self, query: str) -> bytes:
        """The state, once it is newer than the version that the page has."""
        after = parse_qs(query).get("after", [""])[0]
        if after.isascii() and after.isdigit() and len(after) < 19:
            self.server.view.wait(int(after), _NEWS_WITHIN_S)
        return json.dumps(self.server.view.state(), allow_nan=False).encode()

    def _answer(self, content: bytes | None, kind: str) -> None:
        if content is None:
            self.send_error(HTTPStatus.NOT_FOUND)
            return
        self.send_response(HTTPStatus.OK)
        self.send_header("Content-Type", kind)
        self.send_header("Content-Length", str(len(content)))
        self.end_headers()
        if self.command != "HEAD":
            self.wfile.write(content)

    def end_headers(self) -> None:
        """Sends the headers, those that every answer has among them."""
        for name, value in _HEADERS.items():
            self.send_header(name, value)
        super().end_headers()
