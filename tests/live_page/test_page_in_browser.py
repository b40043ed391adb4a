"""The live page in a real browser: what it shows as frames come, and what it asks for."""

import dataclasses
from typing import Any, cast

import pytest

from remind_jax.live_page.server import LivePage
from remind_jax.live_page.view import LiveView
from remind_jax.sources.live_source import LiveSource, SourceStatus
from tests.headless_browser import asked_by, find, needs_browser, said_by, wait_for
from tests.outputs.fake_run import make_run

pytestmark = needs_browser


class Source:
    """Stands in for a live source."""

    status_now = SourceStatus("connected", "http://camera/<i>x</i>", 0.1, 40, 7)

    def status(self) -> SourceStatus:
        return self.status_now

    def age_s(self, frame: Any) -> float:
        return 0.25


@dataclasses.dataclass
class Shown:
    """A page that shows a made-up run, frame by frame."""

    source: Source
    view: LiveView
    run: Any
    browser: Any

    def show(self, *positions: int) -> None:
        frames, result = self.run
        for position in positions:
            frame = dataclasses.replace(frames[position], time_s=position / 10)
            tracks = result.tracks[position]
            self.view.show(frame, tracks)

    def text(self, selector: str) -> str:
        return find(self.browser, selector).text

    def texts(self, selector: str) -> list[str]:
        return [one.text for one in self.browser.find_elements("css selector", selector)]

    def wait_for(self, condition: str) -> None:
        wait_for(self.browser, condition)

    def wait_for_frames(self, count: int) -> None:
        self.wait_for(f"document.getElementById('frames').textContent === '{count}'")


@pytest.fixture
def shown(browser):
    said_by(browser)
    asked_by(browser)
    source = Source()
    view = LiveView("kitchen <b>", cast(LiveSource, source))
    with LivePage(view, "127.0.0.1:0") as page:
        browser.get(page.address)
        yield Shown(source, view, make_run(60, size=(240, 320)), browser)
        browser.get("about:blank")


def test_the_page_follows_the_run(shown):
    assert shown.text("#said") == "waiting for the first frame" or shown.text("#frames") == "0"
    shown.show(0)
    shown.wait_for_frames(1)
    shown.wait_for("document.getElementById('frame').naturalWidth === 320")
    first = shown.browser.find_element("css selector", "#frame").get_attribute("src")
    shown.show(1, 2)
    shown.wait_for_frames(3)
    assert shown.browser.find_element("css selector", "#frame").get_attribute("src") != first
    names = [row["name"] for row in shown.view.state()["in_view"]]
    assert shown.texts("#in-view b") == names
    assert shown.text("#missed") == "7"
    assert shown.text("h1") == "kitchen <b>"
    assert shown.text("#said") == "http://camera/<i>x</i>: connected"


def test_who_left_is_remembered_with_a_picture(shown):
    shown.show(*range(30))
    shown.wait_for_frames(30)
    remembered = shown.texts("#remembered li")
    assert any(text.startswith("cup 1\n1.0 s ago, ") for text in remembered)
    shown.wait_for("document.querySelector('#remembered img').naturalWidth > 20")
    shown.show(*range(30, 45))
    shown.wait_for_frames(45)
    assert "cup 1" not in [text.partition("\n")[0] for text in shown.texts("#remembered li")]


def test_the_timeline_shows_an_absence(shown):
    shown.show(*range(60))
    shown.wait_for_frames(60)
    lanes = shown.browser.execute_script(
        "return [...document.querySelectorAll('#lanes span')].map((name) => [name.textContent,"
        " [...name.nextSibling.children].map((bar) => [bar.offsetLeft, bar.offsetWidth])])"
    )
    bars = {name: spans for name, spans in lanes}
    whole = shown.browser.execute_script("return document.querySelector('.lane').offsetWidth")
    (left, width), (later, _) = bars["cup 1"]
    assert left == 0
    assert width == pytest.approx(1.9 / 5.9 * whole, abs=3)
    assert later == pytest.approx(4.3 / 5.9 * whole, abs=3)  # undecided until then


def test_the_age_grows_until_the_next_frame(shown):
    shown.show(0)
    shown.wait_for_frames(1)
    shown.wait_for("document.getElementById('age').textContent.endsWith(' s')")
    age = float(shown.text("#age").removesuffix(" s"))
    assert age >= 0.2
    # How soon depends on the machine, that it does not.
    shown.wait_for(f"parseFloat(document.getElementById('age').textContent) >= {age + 0.7}")


@pytest.mark.parametrize(
    ("status", "light", "said"),
    [
        (SourceStatus("lost", "rtsp://cam", 3.0, 9, 1), "lost", "connection lost 3.0 s ago, tryi"),
        (SourceStatus("connected", "rtsp://cam", 4.0, 9, 1), "silent", "be used for 4.0 s"),
    ],
)
def test_a_source_in_trouble_is_told(shown, status, light, said):
    shown.show(0)
    shown.wait_for_frames(1)
    shown.source.status_now = status
    shown.wait_for(f"document.getElementById('light').className === '{light}'")
    assert said in shown.text("#said")


def test_the_end_is_told_and_a_run_that_is_gone_is_too(browser):
    view = LiveView("kitchen", cast(LiveSource, Source()))
    shown = Shown(Source(), view, make_run(2), browser)
    with LivePage(view, "127.0.0.1:0") as page:
        browser.get(page.address)
        shown.show(0)
        shown.wait_for_frames(1)
        view.picture = lambda: None  # the page may be gone before the picture is asked for
        view.end()
        shown.wait_for("document.getElementById('said').textContent.includes('ended')")
    shown.wait_for("document.getElementById('said').textContent.includes('does not answer')")
    assert shown.text("#age") == "–"
    assert browser.execute_script("return byId('frame').naturalWidth") > 0  # the last picture stays
    browser.get("about:blank")


def test_the_page_is_quiet_and_asks_its_own_server_only(shown):
    shown.show(*range(30))
    shown.wait_for_frames(30)
    shown.wait_for("document.querySelector('#remembered img').naturalWidth > 20")
    assert said_by(shown.browser) == []
    asked = {url.partition("?")[0] for url in asked_by(shown.browser)}
    own = shown.browser.current_url
    assert {f"{own}{name}" for name in ("", "page.js", "page.css", "state.json", "frame.jpg")} <= (
        asked
    )
    assert all(url.startswith((own, "data:", "about:")) for url in asked)


def test_it_fits_a_telephone(shown):
    shown.show(*range(30))
    shown.wait_for_frames(30)
    shown.browser.execute_cdp_cmd(
        "Emulation.setDeviceMetricsOverride",
        {"width": 390, "height": 844, "deviceScaleFactor": 1, "mobile": True},
    )
    try:
        wide = shown.browser.execute_script("return document.documentElement.scrollWidth")
        assert wide <= 390
    finally:
        shown.browser.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})
