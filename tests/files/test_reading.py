"""Where files that can be obtained again are kept; reading that comes to an end."""

import os
import stat
import sys
from pathlib import Path
from unittest import mock

import pytest

from remind_jax.errors import OutputError, SourceError
from remind_jax.files import (
    as_path,
    read_bytes,
    read_text,
    reading,
    saving,
    say_no_file,
    user_cache_folder,
)


def test_cache_folder_follows_the_system(monkeypatch, tmp_path):
    for system, variable in (("linux", "XDG_CACHE_HOME"), ("win32", "LOCALAPPDATA")):
        monkeypatch.setattr(saving.sys, "platform", system)
        monkeypatch.setenv(variable, str(tmp_path / system))
        assert user_cache_folder() == tmp_path / system / "remind-jax"
    monkeypatch.setattr(saving.sys, "platform", "darwin")
    assert user_cache_folder() == Path.home() / "Library" / "Caches" / "remind-jax"


def test_a_user_whom_the_system_does_not_know_has_a_cache_folder_that_keeps_nothing(monkeypatch):
    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    monkeypatch.setattr(saving.sys, "platform", "linux")
    monkeypatch.setattr(saving.Path, "home", mock.Mock(side_effect=RuntimeError))
    assert user_cache_folder() == Path("/nonexistent/.cache/remind-jax")


@pytest.mark.parametrize("read", [read_bytes, read_text])
def test_what_never_ends_is_not_read(tmp_path, read):
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "zero").symlink_to("/dev/zero")
    for name in ("pipe", "zero"):
        with pytest.raises(OSError, match="it is a pipe, a device or a socket; give a file"):
            read(tmp_path / name)


def test_text_in_another_encoding_is_refused_by_name_and_a_byte_order_mark_is_none(tmp_path):
    for data, said in (
        ("mug".encode("utf-16"), "its text is UTF-16"),
        (b"m\0u\0g\0", "its text is UTF-16"),
        (b"{\0}\0", "its text is UTF-16"),
        (b"caf\xe9", r"not UTF-8 \(byte 3\)"),
    ):
        (tmp_path / "words.txt").write_bytes(data)
        with pytest.raises(OSError, match=said):
            read_text(tmp_path / "words.txt")
    (tmp_path / "words.txt").write_bytes(b"\xef\xbb\xbfcaf\xc3\xa9")
    assert read_text(tmp_path / "words.txt") == "caf\u00e9"


@pytest.mark.parametrize("read", [read_bytes, read_text])
def test_what_is_too_large_is_not_read(tmp_path, read):
    with (tmp_path / "large").open("wb") as file:
        file.truncate(10 << 30)  # takes no room on the disk
    with pytest.raises(OSError, match="it has 10 GiB, at most 512 MiB are read; split it"):
        read(tmp_path / "large")
    (tmp_path / "small").write_bytes(b"12")
    with pytest.raises(OSError, match="it has 2 bytes, at most 1 bytes"):
        read(tmp_path / "small", max_bytes=1)


@pytest.mark.skipif(sys.platform != "linux", reason="needs files that the system makes up")
def test_a_file_that_does_not_say_its_size_is_read_up_to_the_limit():
    own = Path("/proc/self/maps")
    assert own.stat().st_size == 0
    assert b"libc" in read_bytes(own)
    with pytest.raises(OSError, match="it has over 3 MiB, which are not read"):
        read_bytes("/proc/self/pagemap", max_bytes=3 << 20)


def test_a_file_that_grows_is_read_whole(tmp_path, monkeypatch):
    (tmp_path / "log").write_bytes(b"x" * 100)
    grown = os.stat_result((stat.S_IFREG, *[0] * 5, 40, *[0] * 3))
    monkeypatch.setattr(os, "fstat", lambda number: grown)
    assert read_bytes(tmp_path / "log") == b"x" * 100


def test_a_path_that_may_not_be_reached_is_refused(tmp_path, monkeypatch):
    def refuse(path):
        raise PermissionError(13, "Permission denied", path)

    with monkeypatch.context() as patched:
        patched.setattr(os, "lstat", refuse)
        with pytest.raises(OutputError, match="the file 'd/x' lies in a folder that this user may"):
            as_path("d/x", "the file", OutputError)
    assert as_path(tmp_path / "none" / "x", "the file", OutputError) == tmp_path / "none" / "x"


def test_why_there_is_no_file_is_said(tmp_path):
    (tmp_path / "file").write_text("")
    os.mkfifo(tmp_path / "pipe")
    os.symlink("circle", tmp_path / "circle")
    said = {name: say_no_file(tmp_path / name) for name in ("file", "pipe", "circle", "none", ".")}
    assert said == {
        "file": "",
        "pipe": "cannot be read (it is a pipe, a device or a socket; give a file)",
        "circle": "cannot be read (Too many levels of symbolic links)",
        "none": "does not exist",
        ".": "is a folder",
    }


def test_no_file_takes_the_place_of_a_device(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(OutputError, match="it is a pipe, a device or a socket; name a file"):
        saving.replace_file(tmp_path / "pipe", b"x")
    assert stat.S_ISFIFO((tmp_path / "pipe").stat().st_mode)
    with pytest.raises(OutputError, match=r"it is a folder; name a file"):
        saving.replace_file(tmp_path, b"x")
    with pytest.raises(OutputError, match=r"there is no folder '.*none'; make it, or name another"):
        saving.replace_file(tmp_path / "none" / "file", b"x")


def test_whatever_a_library_raises_becomes_a_sentence():
    for error in (OSError(2, "gone"), ValueError("odd\nrow"), KeyError("x"), MemoryError()):
        with pytest.raises(SourceError, match=r"'a\.bin', row 3"), reading("a.bin", place="row 3"):
            raise error
    with pytest.raises(OutputError, match="mine"), reading("a.bin"):
        raise OutputError("mine")
