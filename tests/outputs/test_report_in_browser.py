"""The report page as people use it: in a real browser, offline, with mouse and keyboard."""

import base64
import dataclasses
import itertools

import cv2
import numpy as np
import pytest

from remind_jax.outputs import report
from tests.headless_browser import (
    ActionChains,
    Keys,
    Select,
    asked_by,
    find,
    needs_browser,
    said_by,
    wait_for,
)
from tests.outputs.fake_run import make_run, write_run
from tests.outputs.traced_run import UNDECIDED, make_plus_run, make_traced_run

NUM_FRAMES = 60
FPS = 10.0

pytestmark = needs_browser


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("run")
    frames, result = make_run(NUM_FRAMES, size=(240, 320))
    write_run(folder, frames, result)
    return folder


@pytest.fixture
def page(browser, folder):
    browser.get(f"file://{folder / report.REPORT_NAME}")
    wait_for(browser, "video.readyState >= 2")
    return browser


def settled_position(browser) -> int:
    """The frame that the video shows once it has found it."""
    wait_for(browser, "!video.seeking && !isBehind && video.readyState >= 2")
    # At its end a browser reports the duration, one frame beyond the last.
    return min(int(browser.execute_script("return video.currentTime") * FPS), NUM_FRAMES - 1)


def click_timeline(browser, position: int) -> None:
    track = find(browser, "#track")
    browser.execute_script("arguments[0].scrollIntoView({block: 'center'})", track)
    width = track.size["width"]
    # Offsets count from the middle of the element.
    x = round((position + 0.5) / NUM_FRAMES * width - width / 2)
    ActionChains(browser).move_to_element_with_offset(track, x, 0).click().perform()


def test_ticks_stand_at_round_numbers(page):
    def chosen(script: str) -> list[float]:
        return page.execute_script(f"return {script}")

    assert chosen("[0.03, 1, 7, 300, 1000].map(roundStep)") == [0.05, 1, 10, 500, 1000]
    assert chosen("[0.3, 20, 21, 70, 130].map(timeStep)") == [0.5, 20, 60, 120, 300]
    frames = chosen("[...byId('ticks').children].map((one) => Number(one.textContent))")
    assert frames == list(range(0, NUM_FRAMES, frames[1]))
    assert frames[1] in (2, 5, 10)
    assert chosen("byId('times').firstChild.textContent.slice(0, 4)") == "0:00"


def test_the_video_plays_in_the_page(page):
    assert page.execute_script("return [video.videoWidth, video.videoHeight]") == [320, 240]
    assert page.execute_script("return video.duration") == pytest.approx(NUM_FRAMES / FPS, abs=0.11)
    page.execute_script("video.play()")
    wait_for(page, "video.currentTime > 0.35")
    wait_for(page, "shown >= 3")
    page.execute_script("video.pause()")


@pytest.mark.parametrize("position", [0, 17, 42, 59])
def test_a_click_on_the_timeline_seeks_the_video(page, position):
    click_timeline(page, position)
    assert settled_position(page) == position
    assert find(page, "#clock").text.startswith(f"frame {position} of 59")
    assert find(page, "#track").get_attribute("aria-valuenow") == str(position)


def picture_of(browser, position: int) -> np.ndarray:
    """What the video shows after a seek; a page from a file may not read its own video back."""
    browser.execute_script(f"video.controls = false; seek({position})")
    settled_position(browser)
    browser.execute_async_script("requestAnimationFrame(() => requestAnimationFrame(arguments[0]))")
    png = base64.b64decode(find(browser, "#video").screenshot_as_base64)
    return cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_COLOR).astype(int)


def test_the_frame_shown_is_the_frame_asked_for(page):
    """Three objects come back at frame 40: that step changes the picture far more than others."""
    pictures = [picture_of(page, position) for position in (37, 38, 39, 40)]
    changes = [np.abs(b - a).mean() for a, b in itertools.pairwise(pictures)]
    assert changes[2] > 2 * max(changes[:2])


def test_the_timeline_works_by_keyboard(page):
    track = find(page, "#track")
    page.execute_script("arguments[0].focus()", track)
    for key, position in (
        (Keys.ARROW_RIGHT, 1),
        (Keys.PAGE_UP, 7),
        (Keys.ARROW_LEFT, 6),
        (Keys.END, 59),
        (Keys.ARROW_RIGHT, 59),
        (Keys.HOME, 0),
    ):
        track.send_keys(key)
        assert settled_position(page) == position
        assert track.get_attribute("aria-valuenow") == str(position)


def test_the_player_works_by_keyboard_without_focus(page):
    def press(*keys: str) -> None:
        ActionChains(page).send_keys(*keys).perform()

    page.execute_script("document.activeElement.blur(); seek(0)")
    press(Keys.ARROW_RIGHT, Keys.ARROW_RIGHT, Keys.ARROW_RIGHT, Keys.ARROW_LEFT)
    assert settled_position(page) == 2
    press(Keys.SPACE)
    wait_for(page, "!video.paused")
    press(Keys.SPACE)
    wait_for(page, "video.paused")
    page.execute_script("seek(5); document.getElementById('filter-name').focus()")
    press(Keys.ARROW_RIGHT, Keys.SPACE)
    assert settled_position(page) == 5
    assert page.execute_script("return video.paused")


def shown_names(page) -> list[list[str]]:
    """Identities in the timeline, the gallery and the table, each as `cup 0`."""
    return page.execute_script(
        """return [lanes.filter((lane) => !lane.marks).map((lane) => lane.name),
          [...document.querySelectorAll("#cards h3")].map((head) => head.firstChild.textContent),
          [...document.querySelectorAll("#identities td.name")].map((cell) => cell.textContent)]"""
    )


def test_the_timeline_names_what_people_named(browser, tmp_path):
    frames, result = make_run(NUM_FRAMES, size=(240, 320))
    named = [dataclasses.replace(tracks, names={1: "my <b>mug</b>"}) for tracks in result.tracks]
    write_run(tmp_path, frames, dataclasses.replace(result, tracks=tuple(named)))
    browser.get(f"file://{tmp_path / report.REPORT_NAME}")
    lanes = "return [...document.querySelectorAll('#names button')].map((one) => one.textContent)"
    assert browser.execute_script(lanes)[:2] == ["cup\u00a00", "my <b>mug</b>\u00a01"]


def test_what_is_shown_can_be_filtered(page):
    name = find(page, "#filter-name")
    name.send_keys("Cup ")
    for names in shown_names(page):
        assert names == ["cup 0", "cup 1"]
    name.clear()
    name.send_keys(" ")
    Select(find(page, "#filter-class")).select_by_visible_text("book")
    for names in shown_names(page):
        assert names == ["book 2"]
    Select(find(page, "#filter-class")).select_by_value("")
    outcomes = Select(find(page, "#filter-outcome"))
    assert [one.text for one in outcomes.options] == [
        *("all outcomes", "match", "new", "ambiguous", "provisional new")
    ]
    outcomes.select_by_visible_text("ambiguous")
    for names in shown_names(page):
        assert names == ["cup 0", "cup 1"]  # it could be either
    assert find(page, "#filter-count").text == "3 detections in 3 frames"
    page.execute_script("seek(0)")
    for position in (40, 41, 42, 40):
        find(page, "#filter-next").click()
        assert settled_position(page) == position
    outlines = page.find_elements("css selector", "#seen tr.open:not(.dim)")
    assert [row.text.partition("?")[0] for row in outlines] == ["cup 1 or 0"]


def test_a_clock_that_jumps_is_told_apart_from_the_video(browser, tmp_path):
    result = make_plus_run()
    late = [
        dataclasses.replace(t, time_s=t.time_s + 180 * (t.frame_index > 1)) for t in result.tracks
    ]
    for tracks, said in ((result.tracks, "0:00.3, "), (late, "0:00.3 in the video, 3:00.3 by")):
        one = dataclasses.replace(result, tracks=tuple(tracks))
        report.write_report(tmp_path, one, [])
        browser.get(f"file://{tmp_path / report.REPORT_NAME}")
        browser.execute_script("seek(3)")
        assert said in find(browser, "#clock").text


def test_a_comparison_with_the_truth_is_shown(browser, tmp_path):
    row = ("returns", "16", "17", "back in view")
    report.write_report(tmp_path, dataclasses.replace(make_plus_run(), comparison=(row,)), [])
    browser.get(f"file://{tmp_path / report.REPORT_NAME}")
    assert find(browser, "#comparison tbody").text == "returns 16 17 back in view"


def test_rows_show_scores_where_there_are_some_and_candidates(page):
    for position, place, text in (
        (0, 0, "cup 0 new"),
        (1, 0, "cup 0 match 0.90 0.80"),
        (41, 1, "cup 1 or 0? ambiguous"),
    ):
        page.execute_script(f"seek({position})")
        row = page.find_elements("css selector", "#seen tbody tr")[place]
        assert row.text.startswith(text)
    assert "candidates 1: 0.82, 0: 0.79" in row.get_attribute("title")
    heads = [cell.text for cell in page.find_elements("css selector", "#seen th")]
    assert heads == ["Detection", "Outcome", "Score with context", "Confidence"]


def test_crops_and_absences_seek(page):
    start = find(page, '#cards .chip[data-position="43"]')  # object 1 decides at frame 43
    assert start.text == "back at 43"
    page.execute_script("arguments[0].click()", start)
    assert settled_position(page) == 43
    crop = start.find_element("xpath", "preceding-sibling::button")
    assert "cup 1" in crop.find_element("css selector", "img").get_attribute("alt")
    pictured = int(crop.get_attribute("data-position"))
    assert pictured >= 43
    assert crop.text == f"frame {pictured}"
    page.execute_script("arguments[0].click()", crop)
    assert settled_position(page) == pictured
    absence = find(page, '#identities td:last-child button[data-position="40"]')
    assert absence.text == "20–39"
    page.execute_script("arguments[0].click()", absence)
    assert settled_position(page) == 40


def test_the_table_sorts_by_any_column(page):
    def names() -> list[str]:
        cells = page.find_elements("css selector", "#identities tbody td:first-child")
        return [cell.text for cell in cells]

    def sort_by(title: str) -> None:
        for button in page.find_elements("css selector", "#identities th button"):
            if button.text.startswith(title):
                page.execute_script("arguments[0].click()", button)
                return

    assert names()[0] == "cup 0"
    sort_by("Identity")
    assert names()[0] == "chair 5"
    heading = find(page, '#identities th[aria-sort="descending"]')
    assert heading.text.startswith("Identity")
    sort_by("Class")
    assert names() == ["book 2", "chair 5", "cup 0", "cup 1", "potted plant 3", "teddy bear 4"]
    sort_by("Longest absence")
    sort_by("Longest absence")
    assert names()[0] == "cup 1"


def test_the_page_is_quiet_and_asks_for_nothing(browser, folder):
    said_by(browser)
    asked_by(browser)
    browser.get(f"file://{folder / report.REPORT_NAME}")
    wait_for(browser, "video.readyState >= 2")
    assert said_by(browser) == []
    assert all(url.startswith(("file://", "data:")) for url in asked_by(browser))


def is_closed(browser) -> bool:
    return browser.execute_script("return document.getElementById('why').hidden")


def test_without_trace_a_detection_shows_whom_it_may_be(page):
    open_row(page, 41, 1)
    assert find(page, "#why-title").text == "Why cup 1 or 0? (frame 41, detection 1)"
    assert "--trace" in find(page, "#why-body p code").text
    cards = page.find_elements("css selector", "#why .card h3")
    assert [card.text for card in cards] == ["cup 10.82", "cup 00.79"]
    click_timeline(page, 20)
    assert is_closed(page)


def test_a_large_video_is_played_from_beside_the_page(browser, folder, monkeypatch):
    monkeypatch.setattr(report, "MAX_EMBEDDED_VIDEO_BYTES", 1)
    from remind_jax.outputs.writer import render_again

    render_again(folder)
    browser.get(f"file://{folder / report.REPORT_NAME}")
    wait_for(browser, "video.readyState >= 2")
    click_timeline(browser, 33)
    assert settled_position(browser) == 33
    (folder / "overlay.mp4").rename(folder / "elsewhere.mp4")
    browser.get(f"file://{folder / report.REPORT_NAME}")
    wait_for(browser, "!document.getElementById('video-missing').hidden")


@pytest.fixture(scope="module")
def traced(tmp_path_factory):
    folder = tmp_path_factory.mktemp("traced")
    frames, result = make_traced_run()
    write_run(folder, frames, result)
    return folder, result


@pytest.fixture
def traced_page(browser, traced):
    browser.get(f"file://{traced[0] / report.REPORT_NAME}")
    wait_for(browser, "video.readyState >= 2")
    return browser


def open_row(browser, position: int, row: int) -> None:
    browser.execute_script(f"seek({position})")
    browser.find_elements("css selector", "#seen tbody tr")[row].click()
    wait_for(browser, "!document.getElementById('why').hidden")


def shown_reasons(browser) -> list[str]:
    return [item.text for item in browser.find_elements("css selector", "#why ol li")]


def test_a_click_on_a_detection_explains_it(traced_page, traced):
    said_by(traced_page)  # what earlier pages said
    open_row(traced_page, UNDECIDED, 0)
    explanation = traced[1].explain(UNDECIDED, 0)
    assert find(traced_page, "#why-title").text == (
        f"Why mug 0 or 1? (frame {UNDECIDED}, detection 0)"
    )
    assert shown_reasons(traced_page) == list(explanation.why)
    rows = traced_page.find_elements("css selector", "#why table")[0].text.splitlines()
    assert rows[1].startswith("mug 0 confirmed 0.80 x 0.60")
    assert rows[2].startswith("mug 1 confirmed 0.79 x 0.60")
    assert "Of 2 objects of class mug it looks most like mug 0" in (
        find(traced_page, "#why-body").text
    )
    assert traced_page.execute_script("return document.activeElement.id") == "why"
    find(traced_page, "#why-close").click()
    assert is_closed(traced_page)
    assert said_by(traced_page) == []


def test_a_decision_of_plus_shows_the_evidence(browser, tmp_path):
    result = make_plus_run()
    report.write_report(tmp_path, result, [])
    browser.get(f"file://{tmp_path / report.REPORT_NAME}")
    said_by(browser)
    open_row(browser, 3, 0)
    assert find(browser, "#why-title").text == "Why mug 0? (frame 3, detection 0)"
    assert shown_reasons(browser) == list(result.explain(3, 0).why)
    rows = find(browser, "#why table").text.splitlines()
    kinds = "Looks Lead Background Place Class name Mobile Rivals Held Layout Companions Moved"
    assert rows[0] == f"Candidate {kinds} Sum Probability"
    assert rows[1] == "* mug 0 +1.50 - - - - - - - +0.75 - - +2.25 0.75"
    assert rows[2] == "mug 1 +1.25 - - -2.00 - - - - - - - -0.75 0.12"
    assert rows[3] == "mug 5, new - - - - - - - - - - - +0.50 0.12"
    assert find(browser, "#why tr.decided").text.startswith("* mug 0")
    browser.execute_script("seek(4)")
    wait_for(browser, "document.getElementById('why-title').textContent.includes('frame 4,')")
    assert shown_reasons(browser) == list(result.explain(4, 0).why)
    assert browser.find_elements("css selector", "#why table") == []
    assert said_by(browser) == []


def test_a_return_leads_to_the_frame_that_decided_it(browser, tmp_path):
    report.write_report(tmp_path, make_plus_run(14, back_at=9), [])
    browser.get(f"file://{tmp_path / report.REPORT_NAME}")
    link = find(browser, '#identities .chip[data-position="11"]')
    assert link.text == "decided at 11"
    link.click()
    wait_for(browser, "!document.getElementById('why').hidden")
    assert find(browser, "#why-title").text == "Why mug 0? (frame 11, detection 0)"


def test_the_explanation_works_by_keyboard(traced_page):
    traced_page.execute_script("seek(3)")
    button = traced_page.find_elements("css selector", "#seen tbody button")[0]
    assert button.get_attribute("aria-expanded") == "false"
    button.send_keys(Keys.ENTER)
    wait_for(traced_page, "!document.getElementById('why').hidden")
    opened = traced_page.find_elements("css selector", "#seen tbody button")[0]
    assert opened.get_attribute("aria-expanded") == "true"
    traced_page.switch_to.active_element.send_keys(Keys.ESCAPE)
    assert is_closed(traced_page)
