"""The labeling page as people use it: in a real browser, offline, with mouse and keyboard."""

import json

import pytest

from remind_jax.outputs.label_edits import (
    LABEL_PAGE_NAME,
    apply_edits,
    read_edits,
    write_label_page,
)
from remind_jax.outputs.result import Result
from tests.headless_browser import (
    ActionChains,
    Keys,
    WebDriverWait,
    asked_by,
    find,
    needs_browser,
    said_by,
    wait_for,
)
from tests.outputs.fake_run import make_run, write_run

NUM_FRAMES = 60  # odd objects are away in frames 20 to 39
SIZE = (240, 320)

pytestmark = needs_browser


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("run")
    frames, result = make_run(NUM_FRAMES, size=SIZE)
    write_run(folder, frames, result)
    write_label_page(folder)
    return folder


@pytest.fixture
def page(browser, folder):
    browser.get(f"file://{folder / LABEL_PAGE_NAME}")
    browser.execute_script("localStorage.clear()")
    browser.refresh()
    wait_for(browser, "video.readyState >= 2")
    return browser


def press(browser, *keys) -> None:
    ActionChains(browser).send_keys(*keys).perform()


def edits_of(browser) -> list[dict]:
    return json.loads(browser.execute_script("return labelFile()"))["edits"]


def labels_at(browser, position: int) -> list[int]:
    return browser.execute_script(f"return labels[{position}]")


def text_of(browser, selector: str) -> str:
    return find(browser, selector).text


def test_the_page_is_quiet_and_asks_for_nothing(page):
    said_by(page)
    asked_by(page)
    page.refresh()
    wait_for(page, "video.readyState >= 2")
    assert text_of(page, "#label-picked") == "No detection is picked."
    assert text_of(page, "#label-count") == "0 edits; identities: 6"
    assert said_by(page) == []
    assert all(url.startswith(("file://", "data:")) for url in asked_by(page))


def test_identities_are_merged_moved_and_undone_by_keyboard(page, folder, tmp_path):
    page.execute_script("seek(45)")
    press(page, "2")  # object 1, which came back at 40 and is firm from 43 on
    assert text_of(page, "#label-picked") == "cup 1: detection 1 of frame 45."
    press(page, "v")
    press(page, "new", Keys.ENTER)  # its visit is somebody else
    assert edits_of(page) == [{"edit": "move", "id": 1, "first": 43, "last": 59, "to": 6}]
    assert labels_at(page, 45)[1] == 6
    assert labels_at(page, 10)[1] == 1
    assert text_of(page, "#label-count") == "1 edit; identities: 7"
    press(page, "m", "4", Keys.ENTER)  # all of 6 is 4: twice in these frames
    assert "17 frames with an identity twice" in text_of(page, "#label-conflicts")
    press(page, "u")
    assert text_of(page, "#label-conflicts") == ""
    press(page, "f", "none", Keys.ENTER)  # from here on nobody
    press(page, "d", "1", Keys.ENTER)  # but this one
    press(page, ".")
    press(page, "2", "d", "1", Keys.ENTER)
    assert [labels_at(page, frame)[1] for frame in (43, 44, 45, 46, 47)] == [6, 6, 1, 1, -1]
    assert edits_of(page)[1:] == [
        {"edit": "move", "id": 6, "first": 45, "last": 59, "to": None},
        {"edit": "assign", "frame": 45, "detection": 1, "to": 1},
        {"edit": "assign", "frame": 46, "detection": 1, "to": 1},
    ]
    (tmp_path / "edits.json").write_text(page.execute_script("return labelFile()"))
    labeled = apply_edits(Result.load(folder), read_edits(tmp_path / "edits.json"), "e")
    for position, tracks in enumerate(labeled.tracks):
        assert tracks.object_id.tolist() == labels_at(page, position)


def test_what_nobody_could_decide_gets_an_identity_by_mouse(page):
    page.execute_script("seek(41)")
    wait_for(page, "!video.seeking")
    left, top, right, bottom = page.execute_script("return labeling.boxes[41][1]")
    canvas = find(page, "#boxes")
    page.execute_script("arguments[0].scrollIntoView({block: 'center'})", canvas)
    scale = canvas.size["width"] / SIZE[1]
    x = (left + right - SIZE[1]) / 2 * scale
    y = (top + bottom - SIZE[0]) / 2 * scale
    ActionChains(page).move_to_element_with_offset(canvas, round(x), round(y)).click().perform()
    assert text_of(page, "#label-picked") == "Nobody: detection 1 of frame 41."
    find(page, "#label-actions [data-key=d]").click()
    names = page.find_elements("css selector", "#names button")
    page.execute_script("arguments[0].scrollIntoView({block: 'center'})", names[1])
    names[1].click()
    assert edits_of(page) == [{"edit": "assign", "frame": 41, "detection": 1, "to": 1}]
    seen = page.execute_script("return run.identities.find((who) => who.id === 1).seen")
    assert seen == [[0, 19], [41, 41], [43, 59]]
    row = page.find_elements("css selector", "#seen tbody tr")[1]
    assert row.text.startswith("cup 1")


def test_the_browser_keeps_the_edits(page):
    press(page, "1", "d", "none", Keys.ENTER)
    page.refresh()
    wait_for(page, "video.readyState >= 2")
    assert edits_of(page) == [{"edit": "assign", "frame": 0, "detection": 0, "to": None}]
    assert labels_at(page, 0)[0] == -1
    ActionChains(page).key_down(Keys.CONTROL).send_keys("z").key_up(Keys.CONTROL).perform()
    assert edits_of(page) == []


def test_the_file_is_saved_by_a_download(page, tmp_path):
    press(page, "1", "d", "none", Keys.ENTER)
    page.execute_cdp_cmd(
        "Browser.setDownloadBehavior", {"behavior": "allow", "downloadPath": str(tmp_path)}
    )
    press(page, "s")
    wait_for_file = tmp_path / "edits.json"
    WebDriverWait(page, 20, 0.05).until(lambda _: wait_for_file.is_file())
    assert len(read_edits(wait_for_file).edits) == 1


def test_an_unknown_identity_is_told(page):
    press(page, "m")
    assert text_of(page, "#label-said").startswith("Pick a detection first")
    for word in ("99", "1.5", "-1", "shelf 1", ""):
        press(page, "1", "m", word, Keys.ENTER)
        assert text_of(page, "#label-said").startswith("There is no such identity"), word
        press(page, Keys.ESCAPE)
    assert edits_of(page) == []
