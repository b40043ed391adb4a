"""The code on the pages of `docs/` runs, and its links lead somewhere."""

from __future__ import annotations

import dataclasses
import re
import sys
import types
from pathlib import Path

import jax
import numpy as np
import pytest

from remind_jax import method as methods
from remind_jax.backbone import registry
from remind_jax.explanation.plus.explanation import PlusExplanation
from remind_jax.explanation.remind.explanation import RemindExplanation
from remind_jax.masks.reduction import reduce_masks
from remind_jax.observation import FrameFeats
from tests.test_citations import addresses

DOCS = Path(__file__).parent.parent / "docs"
PAGES = sorted(DOCS.glob("*.md"))
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


INSIDE = "A rule inside REMIND"


def test_extension_points_that_need_no_compiled_remind_work(page):
    inside = code_of("extension_points.md", INSIDE)
    assert inside
    examples = [code for code in code_of("extension_points.md") if code not in inside]
    run(examples, page)
    assert page.result.complete


@pytest.mark.slow
def test_a_rule_inside_remind_works(page):
    run(code_of("extension_points.md"), page)
    assert len(page.tracks) == 2


@pytest.mark.slow
def test_settings_side_by_side_are_one_program(page):
    run(code_of("performance.md", "Many settings at once"), page)
    feats = FrameFeats(np.zeros((4, 6, 8), np.float32), np.array([64, 96], np.int32))
    whole, one = np.ones((1, 64, 96), bool), np.ones(1)
    masks = reduce_masks(whole, np.zeros(1, np.int32), one, num_slots=2, patch_px=16)
    after = jax.eval_shape(page.many, page.thresholds, page.start, feats, masks)
    assert after.decisions.outcome.shape == (16, 2)


@pytest.mark.parametrize("name", [page.name for page in PAGES])
def test_examples_are_valid_code(name):
    for example in code_of(name):
        compile(example, name, "exec")


@pytest.mark.parametrize("name", [page.name for page in PAGES])
def test_links_lead_somewhere(name):
    for target in LINK.findall((DOCS / name).read_text(encoding="utf-8")):
        if target.startswith(("https://", "http://")):
            continue
        path, _, anchor = target.partition("#")
        linked = DOCS / (path or name)
        assert linked.is_file(), f"{name} links to {target}"
        if anchor:
            assert anchor in addresses(linked.name), target


def test_every_page_is_reached_from_the_site_and_from_the_index():
    site = (DOCS / "site" / "mkdocs.yml").read_text(encoding="utf-8")
    pages = {page.name for page in PAGES}
    assert set(re.findall(r"^  - .+: (\S+\.md)$", site, re.MULTILINE)) == pages
    index = (DOCS / "index.md").read_text(encoding="utf-8")
    assert set(LINK.findall(index)) >= pages - {"index.md"}


@pytest.mark.parametrize("explanation", [PlusExplanation, RemindExplanation])
def test_every_key_of_an_explanation_is_described(explanation):
    page = (DOCS / "explain.md").read_text(encoding="utf-8")
    for field in dataclasses.fields(explanation):
        assert f"`{field.name}`" in page or f"`{field.name}[]`" in page, field.name
