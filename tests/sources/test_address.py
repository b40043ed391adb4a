"""What is an address, and what of it is shown."""

from pathlib import Path

import numpy as np
import pytest

from remind_jax.errors import SourceError
from remind_jax.sources.address import Address, hide_secrets, read_address


def test_numbers_and_devices_are_cameras(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for spec in (0, np.int64(0), "0"):
        assert read_address(spec) == Address("camera", 0, "camera-0", "camera-0")
    path = "/dev/video3"
    for spec in (path, Path(path)):
        assert read_address(spec) == Address("camera", path, path, "camera-video3")
    (tmp_path / "7").touch()  # a file that is called like a camera is a file
    assert read_address("7") is None
    assert read_address(7) == Address("camera", 7, "camera-7", "camera-7")


def test_all_else_is_no_address():
    for spec in ("rooms.mp4", "frames/", "C:/x.mp4", "/dev/null", True, None, [1], 1.0):
        assert read_address(spec) is None
    assert hide_secrets("frames/a@b:c") == "frames/a@b:c"


@pytest.mark.parametrize(
    ("url", "shown", "name"),
    [
        ("rtsp://cam/main", "rtsp://cam/main", "cam-main"),
        ("rtsps://cam:322/a/b", "rtsps://cam:322/a/b", "cam-a-b"),
        ("http://me:pass%40word@cam:8080/v.mjpg", "http://***@cam:8080/v.mjpg", "cam-v.mjpg"),
        ("https://cam/live?token=secret#word", "https://cam/live?***", "cam-live"),
        ("rtsp://[::1]:554/x", "rtsp://[::1]:554/x", "1-x"),
        ("RTSP://Cam/", "rtsp://cam/", "cam"),
    ],
)
def test_streams_are_shown_without_secrets(url, shown, name):
    address = read_address(url)
    opened = url.replace("RTSP:", "rtsp:")  # FFmpeg knows no other spelling
    assert (address.target, address.shown, address.name) == (opened, shown, name)
    for secret in ("pass", "secret", "word"):
        assert secret not in repr(address)


@pytest.mark.parametrize(
    ("spec", "told"),
    [
        (-1, "camera -1 cannot be; cameras are numbered from 0 to 63"),
        ("64", "camera 64 cannot be"),
        ("ftp://me:secret@host/x", "'ftp://***@host/x' is of scheme 'ftp', which is not read"),
        ("file:///etc/passwd", "is of scheme 'file', which is not read"),
        ("rtsp://", "'rtsp://' names no host; give rtsp://HOST[:PORT]/PATH"),
        ("rtsp://me:secret@host:port/x", "'rtsp://***' names no host with a port"),
        ("http://host/a b", "is no address; give at most 2000 letters, without spaces"),
        ("http://host/\x1b[2J", "is no address"),
        ("http://host/" + 3000 * "a", "is no address; give at most 2000 letters"),
    ],
)
def test_addresses_that_cannot_be_read(spec, told):
    with pytest.raises(SourceError) as caught:
        read_address(spec)
    assert told in str(caught.value)
    assert "secret" not in str(caught.value)
