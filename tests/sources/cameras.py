"""A generated camera on the loopback interface, MJPEG over HTTP, and a detector that knows it."""

import contextlib
import functools
import socketserver
import threading
import time
from collections.abc import Callable
from http.server import BaseHTTPRequestHandler
from typing import Any, Self

import numpy as np
import pytest

from remind_jax.sources.feed import Feed
from tests.cli.scenes import CLASSES, picture
from tests.sources.making import encode_image

BOUNDARY = b"frame"


_BITS, _BIT_PX, _CODE_PX = 16, 16, 8  # of the number that stands below the objects


@functools.cache
def _scene(step: int, ids: tuple[int, ...]) -> np.ndarray:
    return picture(step, ids)[0]


def ids_at(number: int) -> tuple[int, ...]:
    """The objects in view: three for some seconds, then one of them and another, and so on."""
    return (1, 2, 3) if number // 90 % 2 == 0 else (1, 4)


def shown_at(number: int) -> tuple[np.ndarray, np.ndarray]:
    """Picture and instance map of a number: objects that drift, and the number itself in bits."""
    step, ids = min(number % 90, 12), ids_at(number)
    image = _scene(step, ids).copy()
    for bit in range(_BITS):
        left = bit * _BIT_PX
        image[-_CODE_PX:, left : left + _BIT_PX] = 255 * (number >> bit & 1)
    return image, picture(step, ids)[1]


def jpeg(number: int) -> bytes:
    """The picture of a number, with few losses."""
    return encode_image(".jpg", shown_at(number)[0])


def number_in(image: np.ndarray) -> int:
    """The number that stands in a picture."""
    code = image[-_CODE_PX // 2, _BIT_PX // 2 :: _BIT_PX].mean(axis=-1) > 128
    return int(sum(1 << bit for bit, is_set in enumerate(code) if is_set))


def detect(image: np.ndarray) -> dict[str, Any]:
    """A detector that is always right: it reads which picture it sees."""
    number = number_in(image)
    labels, ids = shown_at(number)[1], ids_at(number)
    return {
        "masks": np.stack([labels == instance for instance in ids]),
        "labels": [CLASSES[instance] for instance in ids],
    }


class Switched(contextlib.AbstractContextManager):
    """A server on the loopback interface that is switched off and on, at the same port."""

    def __init__(self) -> None:
        self.port = 0
        self._over = threading.Event()
        self._server: socketserver.BaseServer | None = None

    @property
    def is_on(self) -> bool:
        """Off, connections are dropped, and refused from then on."""
        return self._server is not None

    def __exit__(self, *raised: object) -> None:
        self.switch_off()

    def __enter__(self) -> Self:
        self.switch_on()
        return self

    def handler(self) -> type[socketserver.BaseRequestHandler]:
        """What answers a connection."""
        raise NotImplementedError

    def switch_on(self) -> None:
        """Listens."""
        self._over.clear()

        class Server(socketserver.ThreadingTCPServer):
            daemon_threads = allow_reuse_address = True

            def handle_error(self, request: Any, client_address: Any) -> None:
                pass  # clients go away

        self._server = server = Server(("127.0.0.1", self.port), self.handler())
        self.port = server.server_address[1]
        serve = server.serve_forever
        threading.Thread(target=serve, kwargs={"poll_interval": 0.02}, daemon=True).start()

    def switch_off(self) -> None:
        """Drops all connections and listens no more."""
        self._over.set()
        if self._server is not None:
            self._server.shutdown()
            self._server.server_close()
            self._server = None


class Camera(Switched):
    """A camera that sends pictures at a rate to whoever asks, until it is switched off.

    Attributes:
      is_stalled: Connections stay, but nothing is sent.
      num_sent: Pictures sent so far, over all connections.
      asked: Paths and headers of the requests.
    """

    def __init__(
        self,
        fps: float = 30.0,
        make: Callable[[int], bytes] = jpeg,
        *,
        most: int | None = None,
        password: str | None = None,
    ) -> None:
        super().__init__()
        self.fps, self.num_sent, self.is_stalled = fps, 0, False
        self.asked: list[tuple[str, dict[str, str]]] = []
        self._make, self._most, self._password = make, most, password

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self.port}/stream.mjpg"

    def handler(self) -> type[BaseHTTPRequestHandler]:
        camera = self

        class Handler(BaseHTTPRequestHandler):
            def do_GET(self) -> None:
                camera._serve(self)

            def log_message(self, format: str, *args: Any) -> None:
                pass

        return Handler

    def _serve(self, handler: BaseHTTPRequestHandler) -> None:
        self.asked.append((handler.path, dict(handler.headers)))
        if self._password is not None and "Authorization" not in handler.headers:
            handler.send_response(401)
            handler.send_header("WWW-Authenticate", 'Basic realm="camera"')
            handler.send_header("Content-Length", "0")
            handler.end_headers()
            return
        handler.send_response(200)
        boundary = BOUNDARY.decode()
        handler.send_header("Content-Type", f"multipart/x-mixed-replace; boundary={boundary}")
        handler.end_headers()
        due = time.monotonic()
        while not self._over.is_set() and (self._most is None or self.num_sent < self._most):
            if self.is_stalled:
                self._over.wait(0.02)
                due = time.monotonic()
                continue
            part = self._make(self.num_sent)
            head = b"--%s\r\nContent-Type: image/jpeg\r\nContent-Length: %d\r\n\r\n"
            handler.wfile.write(head % (BOUNDARY, len(part)) + part + b"\r\n")
            self.num_sent += 1
            due += 1 / self.fps
            self._over.wait(max(0.0, due - time.monotonic()))
        handler.close_connection = True


def patience_ends_with(camera: Camera, monkeypatch: pytest.MonkeyPatch) -> None:
    """Sources count as lost for too long as soon as the camera is off, however busy the machine."""
    silent_s = property(lambda feed: 0.0 if camera.is_on else float("inf"))
    monkeypatch.setattr(Feed, "silent_s", silent_s)
