"""The server of the live page: what it answers, whom it refuses, and what it costs the tracker."""

import http.client
import json
import re
import socket
import time
from importlib import resources
from urllib.parse import urlsplit

import pytest

from remind_jax.errors import OptionError, OutputError
from remind_jax.live_page import server as servers
from remind_jax.live_page.server import LivePage, is_known_host, parse_where
from remind_jax.live_page.view import LiveView
from tests.outputs.fake_run import make_run

pytestmark = pytest.mark.heavy


@pytest.fixture
def view():
    frames, result = make_run(3, size=(120, 160))
    view = LiveView("room <b>1</b>")
    for frame, tracks in zip(frames, result.tracks, strict=True):
        view.show(frame, tracks)
    return view


@pytest.fixture
def page(view):
    with LivePage(view, "127.0.0.1:0") as page:
        yield page


def port_of(page: LivePage) -> int:
    return urlsplit(page.address).port or 0


def ask(page: LivePage, path: str = "/", method: str = "GET", **headers: str):
    connection = http.client.HTTPConnection("127.0.0.1", port_of(page), timeout=20)
    connection.request(method, path, headers={k.replace("_", "-"): v for k, v in headers.items()})
    answer = connection.getresponse()
    content = answer.read()
    connection.close()
    return answer, content


@pytest.mark.parametrize(
    ("path", "kind", "begins"),
    [
        ("/", "text/html; charset=utf-8", b"<!doctype html>"),
        ("/page.js", "text/javascript; charset=utf-8", b'"use strict"'),
        ("/page.css", "text/css; charset=utf-8", b":root"),
        ("/state.json", "application/json", b"{"),
        ("/state.json?after=1", "application/json", b"{"),
        ("/frame.jpg?v=3", "image/jpeg", b"\xff\xd8"),
        ("/object/0.jpg", "image/jpeg", b"\xff\xd8"),
    ],
)
def test_what_there_is(page, path, kind, begins):
    answer, content = ask(page, path)
    assert (answer.status, answer.headers["Content-Type"]) == (200, kind)
    assert content.startswith(begins)
    policy = answer.headers["Content-Security-Policy"]
    assert policy.startswith("default-src 'none';")
    assert "unsafe" not in policy
    assert "http" not in policy
    assert answer.headers["X-Content-Type-Options"] == "nosniff"
    assert answer.headers["Cross-Origin-Resource-Policy"] == "same-origin"
    assert answer.headers["Cache-Control"] == "no-store"


@pytest.mark.parametrize(
    "path",
    [
        "/x",
        "/../pyproject.toml",
        "/object/x.jpg",
        "/object/999.jpg",
        "/object/-1",
        "/x[::1",
        "/%2e%2e/",
    ],
)
def test_what_there_is_not(page, path):
    answer, content = ask(page, path)
    assert (answer.status, content) == (404, b"404 Not Found\n")
    assert answer.headers["Content-Security-Policy"]


def test_headers_alone_are_those_of_the_page(page):
    answer, content = ask(page, method="HEAD")
    assert (answer.status, content) == (200, b"")
    assert answer.headers["Content-Length"] == str(len(ask(page)[1]))


@pytest.mark.parametrize("method", ["POST", "PUT", "DELETE", "OPTIONS", "CONNECT"])
def test_nothing_can_be_changed(page, method):
    assert ask(page, method=method)[0].status == 501


def test_the_state_is_that_of_the_view(page, view):
    state = json.loads(ask(page, "/state.json")[1])
    assert (state["title"], state["frames"], state["version"]) == ("room <b>1</b>", 3, 3)
    assert [row["name"] for row in state["in_view"]] == [
        row["name"] for row in view.state()["in_view"]
    ]


def test_the_state_is_answered_when_there_is_news(page, view):
    import threading

    began = time.monotonic()
    threading.Timer(0.2, view.end).start()
    state = json.loads(ask(page, "/state.json?after=3")[1])
    assert state["version"] == 4
    assert time.monotonic() - began > 0.1


@pytest.mark.parametrize("host", [b"", b"Host: evil.example\r\n", b"Host: a b\r\n"])
def test_a_name_that_leads_here_but_is_not_ours_is_refused(page, host):
    """A page of another site whose name was made to lead here may not read this one."""
    with socket.create_connection(("127.0.0.1", port_of(page)), timeout=20) as raw:
        raw.sendall(b"GET /state.json HTTP/1.0\r\n" + host + b"\r\n")
        assert b" 421 " in raw.recv(4096)


def test_a_picture_for_another_site_is_refused(page):
    assert ask(page, "/frame.jpg", Sec_Fetch_Site="cross-site")[0].status == 403
    assert ask(page, "/frame.jpg", Sec_Fetch_Site="same-origin")[0].status == 200


@pytest.mark.parametrize(
    ("header", "bound", "known"),
    [
        ("localhost:8642", "127.0.0.1", True),
        ("127.0.0.1:8642", "127.0.0.1", True),
        ("[::1]:8642", "::1", True),
        ("10.0.0.7:8642", "0.0.0.0", True),
        ("robot:8642", "robot", True),
        ("Robot", "ROBOT", True),
        ("robot.", "robot", True),
        (f"{socket.gethostname()}.local:8642", "0.0.0.0", True),
        ("evil.example", "0.0.0.0", False),
        ("localhost.evil.example", "127.0.0.1", False),
        ("127.0.0.1.evil.example:80", "127.0.0.1", False),
        ("[::1", "127.0.0.1", False),
        (None, "127.0.0.1", False),
        ("", "", False),
    ],
)
def test_names_of_this_server(header, bound, known):
    assert is_known_host(header, bound) is known


def test_many_clients_are_bounded_and_served_again_later(page, monkeypatch):
    idle = [
        socket.create_connection(("127.0.0.1", port_of(page)), timeout=20)
        for _ in range(servers.MAX_CLIENTS)
    ]
    end = time.monotonic() + 20
    while page._server._free._value:
        assert time.monotonic() < end
        time.sleep(0.01)
    with socket.create_connection(("127.0.0.1", port_of(page)), timeout=20) as one_more:
        assert one_more.recv(100).startswith(b"HTTP/1.0 503 ")
    for one in idle:
        one.close()
    end = time.monotonic() + 20
    while True:
        try:
            if ask(page)[0].status == 200:
                break
        except OSError:
            pass
        assert time.monotonic() < end
        time.sleep(0.02)


def test_the_page_closes_at_once_whoever_looks(view):
    with LivePage(view, "127.0.0.1:0") as page:
        waiting = socket.create_connection(("127.0.0.1", port_of(page)), timeout=20)
        waiting.sendall(b"GET /state.json?after=3 HTTP/1.0\r\nHost: localhost\r\n\r\n")
        time.sleep(0.1)
        began = time.monotonic()
    assert time.monotonic() - began < 5
    waiting.close()
    with pytest.raises(OSError, match="refused"):
        socket.create_connection(("127.0.0.1", port_of(page)), timeout=20)


def test_only_this_machine_sees_it_unless_told(view, monkeypatch, caplog):
    monkeypatch.setattr(servers, "_MAX_PORTS", 2)
    with LivePage(view, "127.0.0.1:0") as other:
        monkeypatch.setattr(servers, "DEFAULT_PORT", port_of(other))
        with LivePage(view) as moved:
            assert urlsplit(moved.address).hostname == "127.0.0.1"
            assert port_of(moved) == port_of(other) + 1
            said = f"port {port_of(other)} is taken; the live page is at {port_of(moved)}"
            assert said in caplog.text
            with pytest.raises(OutputError, match="no page can be shown at"):  # the next is too
                LivePage(view).__enter__()
    with LivePage(view) as first:
        taken = urlsplit(first.address).netloc
        with pytest.raises(OutputError, match=r"no page can be shown at .*: Address already in u"):
            LivePage(view, taken).__enter__()


@pytest.mark.parametrize(
    "where", ["8642", ":8642", "host:", "host:70000", "http://host:1", "a:b", "", 5, None, False]
)
def test_what_is_no_address_of_a_page(where):
    with pytest.raises(OptionError, match="give HOST:PORT, as 127"):
        parse_where(where)


def test_addresses_of_pages():
    assert parse_where(True) == ("127.0.0.1", 8642)
    assert parse_where("0.0.0.0:0") == ("0.0.0.0", 0)
    assert parse_where("[::1]:99") == ("::1", 99)


def test_the_page_names_no_other_address_and_has_nothing_inline():
    folder = resources.files("remind_jax.live_page")
    for name in ("page.html", "page.js", "page.css"):
        text = folder.joinpath(name).read_text(encoding="utf-8")
        assert not re.search(r"https?://|//\w+\.\w|@import|url\(", text), name
    html = folder.joinpath("page.html").read_text(encoding="utf-8")
    assert not re.search(r"<script>|<style|\son\w+=|\sstyle=", html)
    assert "innerHTML" not in folder.joinpath("page.js").read_text(encoding="utf-8")
