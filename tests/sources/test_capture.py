"""Why a camera or a stream cannot be read, in one sentence; no sentence holds a password."""

import contextlib
import functools
import socket
import threading
import traceback
from collections.abc import Iterator
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer

import cv2
import numpy as np
import pytest

import remind_jax as rj
from remind_jax.errors import SourceError, UnreadableFrame
from remind_jax.sources import capture
from remind_jax.sources.address import read_address
from remind_jax.sources.capture import Lost, Unreachable, open_capture
from tests.sources import making
from tests.sources.cameras import Camera, jpeg, number_in

pytestmark = pytest.mark.heavy

WAIT_S = 5.0


def open_url(url: str | int, wait_s: float = WAIT_S) -> capture.Capture:
    return open_capture(read_address(url), wait_s)


@contextlib.contextmanager
def listening(answers: bytes | None) -> Iterator[int]:
    """A port whose connections get some bytes and end, or nothing ever."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        kept = []

        def serve() -> None:
            with contextlib.suppress(OSError):
                while True:
                    one, _ = server.accept()
                    kept.append(one)
                    if answers is not None:
                        one.recv(4096)
                        one.sendall(answers)
                        one.close()

        threading.Thread(target=serve, daemon=True).start()
        yield server.getsockname()[1]
        server.shutdown(socket.SHUT_RDWR)
        for one in kept:
            one.close()


@pytest.fixture(scope="module")
def web(tmp_path_factory) -> Iterator[str]:
    """A server of files."""
    folder = tmp_path_factory.mktemp("www")
    (folder / "page.html").write_text("<html>no stream</html>" * 50)
    making.write_video(folder / "rooms.mp4", 20, movflags="faststart")

    class Quiet(SimpleHTTPRequestHandler):
        def log_message(self, format: str, *args: object) -> None:
            pass

    server = ThreadingHTTPServer(("127.0.0.1", 0), functools.partial(Quiet, directory=folder))
    threading.Thread(target=server.serve_forever, daemon=True).start()
    yield f"http://me:secret@127.0.0.1:{server.server_address[1]}"
    server.shutdown()
    server.server_close()


def sentence_of(url: str, wait_s: float = WAIT_S) -> str:
    with pytest.raises(SourceError) as caught:
        open_url(url, wait_s)
    said = "".join(traceback.format_exception(caught.value))
    assert "secret" not in said
    return str(caught.value)


def test_pictures_of_a_stream_come_one_by_one():
    with Camera(fps=100) as camera:
        stream = open_url(camera.url)
        numbers = []
        for _ in range(5):
            numbers.append(number_in(stream.read()().image))
        stream.close()
    assert numbers == list(range(numbers[0], numbers[0] + 5))


def test_a_picture_that_cannot_be_decoded_is_told():
    """But for those before the first good one, which may be the end of something."""

    def make(number):
        return b"\xff" * 500 if number % 2 else jpeg(number)

    with Camera(fps=100, make=make) as camera:
        stream = open_url(camera.url)
        stream.read()()
        with pytest.raises(UnreadableFrame, match="the picture is damaged"):
            stream.read()()
        stream.read()()
        stream.close()


def test_a_password_opens_a_stream():
    with Camera(password="needed") as camera:
        assert "asks for a user and a password" in sentence_of(camera.url)
        stream = open_url(camera.url.replace("//", "//me:needed@"))
        assert stream.read() is not None
        stream.close()
        assert "Authorization" in camera.asked[-1][1]


@pytest.mark.parametrize("scheme", ["http", "https", "rtsp", "rtsps"])
def test_a_refused_connection(scheme):
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
    told = f"'{scheme}://***@127.0.0.1:{port}/x' refuses the connection; is it on"
    assert sentence_of(f"{scheme}://me:secret@127.0.0.1:{port}/x").startswith(told)


@pytest.mark.parametrize("scheme", ["http", "rtsp"])
def test_a_host_that_does_not_answer(scheme):
    with listening(None) as port:
        told = sentence_of(f"{scheme}://me:secret@127.0.0.1:{port}/x", wait_s=0.5)
    assert "did not answer within 0.5 s" in told or "sends no pictures" in told


def test_a_host_that_breaks_off():
    with listening(b"HTTP/1.0 200 OK\r\nContent-Type: image/jpeg\r\n\r\n") as port:
        told = sentence_of(f"http://me:secret@127.0.0.1:{port}/x")
    assert "pictures" in told


def test_an_unknown_host():
    told = sentence_of("rtsp://me:secret@no-such-host.invalid/x")
    assert "the host 'no-such-host.invalid'" in told
    assert "is unknown; is it spelled right?" in told


@pytest.mark.parametrize(
    ("path", "told"),
    [
        ("/page.html", "sends no pictures that can be read; give the address of a video stream"),
        ("/nothing", "does not exist on that host; is the path right?"),
        ("/rooms.mp4", "is a recording of 2.0 s and no live stream; download it, and give the fil"),
    ],
)
def test_what_is_no_stream(web, path, told):
    assert told in sentence_of(web + path)


@pytest.mark.parametrize("told", [r"sent nothing for 0\.5 s", "broke off"])
def test_a_stream_that_falls_silent_or_breaks_off_is_lost(told):
    with Camera(fps=100) as camera:
        stream = open_url(camera.url, wait_s=0.5)
        assert stream.read() is not None
        if told == "broke off":
            camera.switch_off()
        camera.is_stalled = True
        with pytest.raises(Lost, match=told):
            list(iter(stream.read, None))
        stream.close()


class Device:
    """Stands in for a camera of OpenCV."""

    def __init__(self, device, backend):
        self.device, self.is_released, self.left = device, False, 2

    def isOpened(self):
        return self.device != 5

    def set(self, name, value):
        assert name == cv2.CAP_PROP_BUFFERSIZE

    def read(self):
        self.left -= 1
        blue = np.zeros((4, 6, 3), np.uint8)
        blue[..., 0] = 200
        return (True, blue) if self.left >= 0 else (False, None)

    def release(self):
        self.is_released = True


def test_pictures_of_a_camera_are_rgb_and_end_where_it_is_unplugged(monkeypatch):
    monkeypatch.setattr(cv2, "VideoCapture", Device)
    camera = open_url(0)
    assert camera.read()().image[0, 0].tolist() == [0, 0, 200]
    camera.read()
    with pytest.raises(Lost, match="gave no picture"):
        camera.read()
    camera.close()


@pytest.mark.parametrize("spec", [63, "/dev/video63"])
def test_a_camera_that_is_not_there(spec, capfd):
    with pytest.raises(
        Unreachable, match=r"there is no camera '?(63|/dev/video63)'?; this machine"
    ):
        rj.open_source(spec)
    assert capfd.readouterr() == ("", "")


def test_a_camera_that_is_in_use_or_may_not_be_read(monkeypatch):
    monkeypatch.setattr(cv2, "VideoCapture", Device)
    monkeypatch.setattr(capture.Path, "exists", lambda path: True)
    for may_read, told in (
        (True, "camera 'camera-5' cannot be opened; does another program"),
        (False, "may not be read by this user; allow it"),
    ):
        monkeypatch.setattr(capture.os, "access", lambda path, mode, may=may_read: may)
        with pytest.raises(Unreachable, match=told):
            open_url(5)
