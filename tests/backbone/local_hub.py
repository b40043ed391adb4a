"""A server on this machine that speaks as the Hugging Face hub does, and can misbehave.

Files of a repository are answered by a redirect to another path, with the headers `X-Repo-Commit`,
`X-Linked-Etag` (sha256) and `X-Linked-Size`; there, ranges are served.
"""

from __future__ import annotations

import dataclasses
import hashlib
import http.server
import re
import threading
import time

_RANGE = re.compile(r"bytes=(\d+)-")


@dataclasses.dataclass
class Behavior:
    """What the server does; everything in order if nothing is set."""

    token: str | None = None  # needed to get anything
    is_gated: bool = False
    missing: str = ""  # answers 404 with this error code
    cuts_after: int | None = None  # bytes of a body, then the connection is closed
    delay_s: float = 0.0  # before every kilobyte or so


class LocalHub:
    """Serves files at `/{repository}/resolve/{revision}/{file}` and at plain paths.

    Attributes:
      requests: Method, path, range, whether a token came along; in order.
    """

    def __init__(self, files: dict[str, bytes], revision: str) -> None:
        self.files, self.revision, self.behavior = files, revision, Behavior()
        self.requests: list[tuple[str, str, str, bool]] = []
        hub = self

        class Handler(_Handler):
            owner = hub

        self._server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        self._server.daemon_threads = True
        self._thread = threading.Thread(target=self._server.serve_forever, args=(0.01,))

    @property
    def address(self) -> str:
        """What HF_ENDPOINT is set to."""
        return f"http://127.0.0.1:{self._server.server_address[1]}"

    @property
    def bodies(self) -> list[tuple[str, str]]:
        """Path and range of each request for bytes of a file; the library asks other things too."""
        asked = [(path, span) for kind, path, span, _ in self.requests if kind == "GET"]
        return [(path, span) for path, span in asked if not path.startswith("/api/")]

    def __enter__(self) -> LocalHub:
        self._thread.start()
        return self

    def __exit__(self, *raised: object) -> None:
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()


class _Handler(http.server.BaseHTTPRequestHandler):
    owner: LocalHub
    protocol_version = "HTTP/1.1"

    def do_HEAD(self) -> None:
        self._answer(has_body=False)

    def do_GET(self) -> None:
        self._answer(has_body=True)

    def log_message(self, format: str, *words: object) -> None:
        """Nothing."""

    def _answer(self, has_body: bool) -> None:
        hub, can = self.owner, self.owner.behavior
        span, token = self.headers.get("Range", ""), self.headers.get("Authorization")
        hub.requests.append((self.command, self.path, span, token is not None))
        if self.path.startswith("/cdn/"):
            return self._send_bytes(hub.files[self.path.removeprefix("/cdn/")], span, has_body)
        if self.path.lstrip("/") in hub.files:
            return self._send_bytes(hub.files[self.path.lstrip("/")], span, has_body)
        if can.token is not None and token != f"Bearer {can.token}":
            code = {"X-Error-Code": "GatedRepo"} if can.is_gated else {}
            return self._refuse(401, **code)
        repository, _, rest = self.path.strip("/").partition("/resolve/")
        revision, _, name = rest.partition("/")
        key = f"{repository}/{name}"
        if can.missing or key not in hub.files or revision != hub.revision:
            return self._refuse(404, **{"X-Error-Code": can.missing or "EntryNotFound"})
        content = hub.files[key]
        headers = {
            "X-Repo-Commit": hub.revision,
            "X-Linked-Etag": f'"{hashlib.sha256(content).hexdigest()}"',
            "X-Linked-Size": str(len(content)),
            "ETag": '"of the redirect"',
        }
        return self._redirect(f"{hub.address.replace('127.0.0.1', 'localhost')}/cdn/{key}", headers)

    def _redirect(self, place: str, headers: dict[str, str]) -> None:
        self.send_response(302)
        for name, value in {**headers, "Location": place, "Content-Length": "0"}.items():
            self.send_header(name, value)
        self.end_headers()

    def _refuse(self, status: int, **headers: str) -> None:
        self.send_response(status)
        for name, value in {**headers, "Content-Length": "0"}.items():
            self.send_header(name, value)
        self.end_headers()

    def _send_bytes(self, content: bytes, span: str, has_body: bool) -> None:
        can = self.owner.behavior
        found = _RANGE.fullmatch(span)
        start = int(found[1]) if found else 0
        if found and start >= len(content):
            return self._refuse(416)
        body = content[start:]
        self.send_response(206 if found else 200)
        self.send_header("Content-Length", str(len(body)))
        self.send_header("Accept-Ranges", "bytes")
        self.send_header("ETag", '"cdn"')
        if found:
            self.send_header("Content-Range", f"bytes {start}-{len(content) - 1}/{len(content)}")
        self.end_headers()
        if not has_body:
            return None
        if can.cuts_after is not None:
            body = body[: can.cuts_after]
            self.close_connection = True
        try:
            for begin in range(0, len(body), 1 << 16):
                time.sleep(can.delay_s)
                self.wfile.write(body[begin : begin + (1 << 16)])
        except OSError:  # the reader went away
            self.close_connection = True
        return None
