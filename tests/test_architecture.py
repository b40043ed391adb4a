"""The map of the code names what is there, and all of it."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PAGES = ("docs/architecture.md", "CONTRIBUTING.md")
PLACE = re.compile(r"`((?:remind_jax|tests|docs|configs|benchmarks|weights_convert|\.ci)/[\w./]*)`")

pytestmark = pytest.mark.prose


def test_places_that_pages_name_are_there():
    for page in PAGES:
        places = PLACE.findall((ROOT / page).read_text(encoding="utf-8"))
        assert places, page
        assert [place for place in places if not (ROOT / place).exists()] == []


def test_every_room_has_a_line_on_the_map():
    named = set(PLACE.findall((ROOT / PAGES[0]).read_text(encoding="utf-8")))
    package = ROOT / "remind_jax"
    rooms = {f"remind_jax/{path.parent.name}/" for path in package.glob("*/__init__.py")}
    loose = {f"remind_jax/{path.name}" for path in package.glob("*.py")} - {
        "remind_jax/__init__.py"
    }
    assert rooms | loose <= named
    assert {f"{path.parent.name}/" for path in (package / "remind").glob("*/__init__.py")} <= {
        *re.findall(r"\w+/", (ROOT / PAGES[0]).read_text(encoding="utf-8"))
    }
