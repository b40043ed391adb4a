"""The code on the pages of `docs/` runs, and its links lead somewhere."""

import dataclasses
import re
import sys
import types
from pathlib import Path

import jax
import numpy as np
import pytest

import remind_jax as rj
from remind_jax import method as methods
from remind_jax.backbone import registry
from remind_jax.explanation.plus import PlusExplanation
from remind_jax.explanation.remind.explanation import RemindExplanation
from remind_jax.masks.reduction import reduce_masks
from remind_jax.observation import FrameFeats
from tests.sources.published import sam_masks, ultralytics_results
from tests.test_citations import addresses

DOCS = Path(__file__).parent.parent / "docs"
PAGES = sorted(DOCS.glob("*.md"))
LAB_BOOKS = sorted((DOCS.parent / "benchmarks").glob("*.md"))  # what was measured, not on the site
FENCE = re.compile(r"^( *)```python\n(.*?)^\1```$", re.DOTALL | re.MULTILINE)
LINK = re.compile(r"!?\[[^\]]*\]\(([^)\s]+)\)")


def code_of(page: str, section: str = "") -> list[str]:
    """Python examples of a page, or of one of its sections."""
    text = (DOCS / page).read_text(encoding="utf-8")
    if section:
        start = text.index(f"## {section}\n")
        end = text.find("\n## ", start + 1)
        text = text[start : end if end > 0 else None]
    return [
        re.sub(rf"^{found[1]}", "", found[2], flags=re.MULTILINE) for found in FENCE.finditer(text)
    ]


def run(examples: list[str], module: types.ModuleType) -> None:
    for example in examples:
        exec(compile(example, module.__name__, "exec"), module.__dict__)


@pytest.fixture
def page(monkeypatch):
    """A module for the examples of a page; what they register is gone afterwards."""
    monkeypatch.setattr(methods, "_methods", dict(methods._methods))
    monkeypatch.setattr(registry, "_factories", dict(registry._factories))
    module = types.ModuleType("examples_of_a_page")
    monkeypatch.setitem(sys.modules, module.__name__, module)
    return module


INSIDE = "A rule inside a tracker"


def test_extension_points_that_need_no_compiled_remind_work(page):
    inside = code_of("extension_points.md", INSIDE)
    assert inside
    examples = [code for code in code_of("extension_points.md") if code not in inside]
    run(examples, page)
    assert page.result.complete


def test_recipes_for_detectors_work_with_what_they_publish(page, monkeypatch):
    pytest.importorskip("supervision")

    def colorful(rgb):
        return np.ptp(rgb.astype(int), axis=-1) > 50

    class YOLO:
        def __init__(self, weights):
            assert weights.endswith("-seg.pt")

        def __call__(self, bgr, verbose=True):
            assert (bgr[colorful(bgr)] == (40, 40, 200)).all()  # as Ultralytics wants it
            rows, columns = np.nonzero(colorful(bgr))
            box = [columns.min(), rows.min(), columns.max() + 1, rows.max() + 1]
            planes = np.zeros((1, 128, 128), np.float32)  # bars of 16 pixels above and below
            planes[0, 16:112] = colorful(bgr)
            return [ultralytics_results(bgr.shape[:2], [box], planes)]

    class RFDETRSegNano:
        def predict(self, rgb, threshold):
            assert threshold == 0.5
            return types.SimpleNamespace(
                xyxy=np.zeros((1, 4), np.float32),
                mask=colorful(rgb)[None],
                confidence=np.array([0.9], np.float32),
                class_id=np.array([47]),
                data={"class_name": np.array(["cup"], dtype=object)},
            )

    class SamAutomaticMaskGenerator:
        def __init__(self, model, min_mask_region_area):
            assert model == "SAM"

        def generate(self, rgb):
            return sam_masks([colorful(rgb), ~colorful(rgb)], [1.01, 0.9])

    stand_ins = {
        "ultralytics": {"YOLO": YOLO},
        "rfdetr": {"RFDETRSegNano": RFDETRSegNano},
        "segment_anything": {
            "SamAutomaticMaskGenerator": SamAutomaticMaskGenerator,
            "sam_model_registry": {"vit_b": lambda checkpoint: "SAM"},
        },
    }
    for name, content in stand_ins.items():
        module = types.ModuleType(name)
        module.__dict__.update(content)
        monkeypatch.setitem(sys.modules, name, module)
    names = {}
    for section in ("YOLO", "RF-DETR", "SAM", "Boxes alone", "What comes back"):
        run(code_of("detectors.md")[:1] + code_of("detectors.md", section), page)
        names[section] = [page.tracks.display_name(row) for row in range(len(page.tracks))]
    assert names == {
        "YOLO": ["cup 0"],
        "RF-DETR": ["cup 0"],
        "SAM": ["object 0", "object 1"],
        "Boxes alone": ["mug 0"],
        "What comes back": ["mug 0"],
    }
    assert [frame.object_id.tolist() for frame in page.result.tracks] == [[0]] * 3
    assert page.result.tracks[0].areas.tolist() == [32 * 32]
    assert page.found.tracker_id.tolist() == [0]
    assert (page.picture == rj.draw(page.image, page.tracks)).all()


@pytest.mark.slow
def test_a_rule_inside_a_tracker_works(page):
    run(code_of("extension_points.md"), page)
    assert len(page.tracks) == 2


@pytest.mark.slow
def test_settings_side_by_side_are_one_program(page):
    run(code_of("performance.md", "Many settings at once"), page)
    feats = FrameFeats(np.zeros((4, 6, 8), np.float32), np.array([64, 96], np.int32))
    whole, one = np.ones((1, 64, 96), bool), np.ones(1)
    masks = reduce_masks(whole, np.zeros(1, np.int32), one, num_slots=2, patch_px=16)
    after = jax.eval_shape(page.many, page.thresholds, page.start, feats, masks)
    assert after.decisions.option_id.shape[:2] == (16, 2)


@pytest.mark.prose
def test_examples_are_valid_code():
    for page in PAGES:
        for example in code_of(page.name):
            compile(example, page.name, "exec")


@pytest.mark.prose
def test_links_lead_somewhere():
    for page in (*PAGES, *LAB_BOOKS):
        for target in LINK.findall(page.read_text(encoding="utf-8")):
            if target.startswith(("https://", "http://")):
                continue
            path, _, anchor = target.partition("#")
            linked = page.parent / path if path else page
            assert linked.is_file(), f"{page.name} links to {target}"
            if anchor:
                assert anchor in addresses(linked), target


@pytest.mark.prose
def test_every_page_is_reached_from_the_site_and_from_the_index():
    site = (DOCS / "site" / "mkdocs.yml").read_text(encoding="utf-8")
    pages = {page.name for page in PAGES}
    assert set(re.findall(r"^  - .+: (\S+\.md)$", site, re.MULTILINE)) == pages
    index = (DOCS / "index.md").read_text(encoding="utf-8")
    assert set(LINK.findall(index)) >= pages - {"index.md"}


@pytest.mark.prose
def test_every_key_of_an_explanation_is_described():
    page = (DOCS / "explain.md").read_text(encoding="utf-8")
    for field in (*dataclasses.fields(PlusExplanation), *dataclasses.fields(RemindExplanation)):
        assert f"`{field.name}`" in page or f"`{field.name}[]`" in page, field.name
