"""A generated RTSP camera on the loopback interface: H.264 in MPEG-TS in RTP, over one connection.

What it says follows RFC 2326 (RTSP), RFC 3550 (RTP) and RFC 2250 (MPEG-TS in RTP).
"""

import contextlib
import io
import socketserver
import struct
import time
from typing import Any

import av

from tests.sources.cameras import Switched, shown_at

_FPS = 20
_PACKET = 7 * 188  # bytes of MPEG-TS in one packet of RTP
_SDP = (
    "v=0\r\no=- 0 0 IN IP4 127.0.0.1\r\ns=camera\r\nc=IN IP4 127.0.0.1\r\nt=0 0\r\n"
    "m=video 0 RTP/AVP 33\r\na=rtpmap:33 MP2T/90000\r\na=control:track\r\n"
)


class _Pipe(io.RawIOBase):
    """What is written to it can be taken out."""

    def __init__(self) -> None:
        self.content = bytearray()

    def writable(self) -> bool:
        return True

    def write(self, data: Any) -> int:
        self.content += data
        return len(data)

    def take(self) -> bytes:
        taken, self.content = bytes(self.content), bytearray()
        return taken


class RtspCamera(Switched):
    """A camera that plays to whoever asks."""

    def __init__(self) -> None:
        super().__init__()
        self.num_sent = 0

    @property
    def url(self) -> str:
        return f"rtsp://127.0.0.1:{self.port}/main"

    def handler(self) -> type[socketserver.StreamRequestHandler]:
        camera = self

        class Handler(socketserver.StreamRequestHandler):
            def handle(self) -> None:
                with contextlib.suppress(OSError):
                    camera._talk(self)

        return Handler

    def _talk(self, handler: socketserver.StreamRequestHandler) -> None:
        """Answers until it is asked to play."""
        while line := handler.rfile.readline().decode():
            verb, headers = line.partition(" ")[0], {}
            while (header := handler.rfile.readline().decode().strip()) != "":
                name, _, value = header.partition(":")
                headers[name.lower()] = value.strip()
            answer, body = {"CSeq": headers["cseq"]}, ""
            if verb == "OPTIONS":
                answer["Public"] = "OPTIONS, DESCRIBE, SETUP, PLAY"
            elif verb == "DESCRIBE":
                answer["Content-Type"], body = "application/sdp", _SDP
                answer["Content-Length"] = str(len(body))
            elif verb == "SETUP":
                answer["Transport"] = "RTP/AVP/TCP;unicast;interleaved=0-1"
                answer["Session"] = "1"
            lines = "".join(f"{name}: {value}\r\n" for name, value in answer.items())
            handler.wfile.write(f"RTSP/1.0 200 OK\r\n{lines}\r\n{body}".encode())
            if verb == "PLAY":
                self._play(handler)
                return

    def _play(self, handler: socketserver.StreamRequestHandler) -> None:
        pipe, sequence = _Pipe(), 0
        with av.open(pipe, "w", format="mpegts") as container:
            stream: Any = container.add_stream("libx264", rate=_FPS)
            stream.height, stream.width = shown_at(0)[0].shape[:2]
            stream.pix_fmt = "yuv420p"
            stream.options = {"preset": "ultrafast", "tune": "zerolatency", "g": "10", "crf": "18"}
            due = time.monotonic()
            while not self._over.is_set():
                frame = av.VideoFrame.from_ndarray(shown_at(self.num_sent)[0], format="rgb24")
                container.mux(stream.encode(frame))
                content = pipe.take()
                for start in range(0, len(content), _PACKET):
                    ticks = round(90_000 * time.monotonic()) & 0xFFFFFFFF
                    head = struct.pack(">BBHII", 0x80, 33, sequence & 0xFFFF, ticks, 1)
                    packet = head + content[start : start + _PACKET]
                    handler.wfile.write(struct.pack(">BBH", 0x24, 0, len(packet)) + packet)
                    sequence += 1
                self.num_sent += 1
                due += 1 / _FPS
                self._over.wait(max(0.0, due - time.monotonic()))
