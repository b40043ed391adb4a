"""A real browser without a window, for the tests of pages; `needs_browser` marks them."""

import contextlib
import json
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

webdriver = pytest.importorskip("selenium.webdriver", reason="selenium is not installed")
from selenium.webdriver import ActionChains as ActionChains  # noqa: E402  (may be absent)
from selenium.webdriver import Keys as Keys  # noqa: E402
from selenium.webdriver.support.ui import Select as Select  # noqa: E402
from selenium.webdriver.support.ui import WebDriverWait  # noqa: E402

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
CHROMEDRIVER = shutil.which("chromedriver")

needs_browser = [
    pytest.mark.browser,
    pytest.mark.heavy,
    pytest.mark.skipif(
        not (CHROMIUM and CHROMEDRIVER), reason="chromium or chromedriver is not installed"
    ),
]


@contextlib.contextmanager
def open_browser(profile: Path) -> Iterator[Any]:
    """Chromium with a profile of its own; it keeps what pages say and what they ask for."""
    options = webdriver.ChromeOptions()
    options.binary_location = str(CHROMIUM)
    for argument in (
        "--headless",
        "--no-sandbox",
        "--disable-gpu",
        "--disable-quic",
        "--no-first-run",
        "--disable-background-networking",
        "--disable-component-update",
        "--disable-sync",
        "--window-size=1360,1000",
        f"--user-data-dir={profile}",
    ):
        options.add_argument(argument)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
    service = webdriver.ChromeService(executable_path=CHROMEDRIVER)
    browser = webdriver.Chrome(options=options, service=service)
    browser.set_script_timeout(20)
    try:
        yield browser
    finally:
        browser.quit()


def wait_for(browser: Any, condition: str) -> None:
    """Until an expression of the page is true."""
    script = f"return Boolean({condition})"
    WebDriverWait(browser, 30, 0.05).until(lambda b: b.execute_script(script))


def find(browser: Any, selector: str) -> Any:
    """The first element of the page that fits."""
    return browser.find_element("css selector", selector)


def said_by(browser: Any) -> list[str]:
    """What pages complained of since this was asked last."""
    return [entry["message"] for entry in browser.get_log("browser")]


def asked_by(browser: Any) -> list[str]:
    """The addresses that pages asked for since this was asked last."""
    entries = browser.get_log("performance")
    messages = [json.loads(entry["message"])["message"] for entry in entries]
    return [
        message["params"]["request"]["url"]
        for message in messages
        if message["method"] == "Network.requestWillBeSent"
    ]
