"""Rules are found from code and code from rules: every address that is cited is there."""

import dataclasses
import importlib
import re
from pathlib import Path
from typing import Any

import pytest

from remind_jax.config.config import Input
from remind_jax.plus.thresholds import PlusThresholds
from remind_jax.remind.switches import Switches
from remind_jax.remind.thresholds import Thresholds
from remind_jax.static import Static

ROOT = Path(__file__).parent.parent
DOCS = ROOT / "docs"
# What ships, and what it is tested and measured by. Left out: generated notebooks and data.
SHIPPED = ("remind_jax", "weights_convert", "configs", "tests", "benchmarks", "docs", "notebooks")
SUFFIXES = {".py", ".md", ".yaml", ".yml", ".toml", ".js", ".html"}
METHODS = {"method.md": Thresholds(), "method_plus.md": PlusThresholds()}
RULE_PAGES = (*METHODS, "backbones.md", "evaluation.md")

CITATION = re.compile(r"\b(\w+\.md)#([\w-]+)")
RULE = re.compile(r'<a id="([\w-]+)"></a>\n(#+) (.*)')
HEADING = re.compile(r"^#+ (.+)$", re.MULTILINE)
MODULE = re.compile(r"`((?:remind_jax|weights_convert)/[\w/]+\.py)`")
MEASURED = re.compile(r"`(benchmarks/\w+\.\w+)`")


def texts(*folders: str) -> dict[str, str]:
    """What was written by hand, by path from the root."""
    paths = [path for folder in folders for path in (ROOT / folder).rglob("*")]
    paths += [ROOT / name for name in ("README.md", "CHANGELOG.md", "Makefile", "pyproject.toml")]
    return {
        path.relative_to(ROOT).as_posix(): path.read_text(encoding="utf-8")
        for path in sorted(paths)
        if path.is_file() and (path.suffix in SUFFIXES or path.name == "Makefile")
    }


def address_of(heading: str) -> str:
    """As GitHub and the site make it."""
    return re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-")


def addresses(page: str | Path) -> set[str]:
    """What can be cited of a page of `docs/`, or of another one by its whole path."""
    text = (DOCS / page).read_text(encoding="utf-8")
    made = {address_of(heading) for heading in HEADING.findall(text)}
    return made | {name for name, _, _ in RULE.findall(text)}


def rules(page: str) -> dict[str, str]:
    """The text of every rule of a page, by its address."""
    text = (DOCS / page).read_text(encoding="utf-8")
    found = list(RULE.finditer(text))
    ends = [match.start() for match in found[1:]] + [len(text)]
    return {match[1]: text[match.start() : end] for match, end in zip(found, ends, strict=True)}


ALL_TEXTS = texts(*SHIPPED)
PYTHON = {name: text for name, text in ALL_TEXTS.items() if name.endswith(".py")}
CITED: dict[tuple[str, str], set[str]] = {}  # modules by page and address
for _name, _text in PYTHON.items():
    for _found in CITATION.findall(_text):
        CITED.setdefault(_found, set()).add(_name)

pytestmark = pytest.mark.prose


def test_what_code_cites_is_there():
    for page in {page for page, _ in CITED}:
        assert (DOCS / page).is_file(), page
        wanted = {address for cited, address in CITED if cited == page}
        assert wanted <= addresses(page), sorted(wanted - addresses(page))


def test_addresses_are_given_once():
    for page in RULE_PAGES:
        text = (DOCS / page).read_text(encoding="utf-8")
        given = [name for name, _, _ in RULE.findall(text)]
        assert sorted(given) == sorted(set(given)), page
        assert len(given) == text.count("<a id="), "an address stands right above its heading"


def test_every_rule_is_cited_where_it_lives():
    for page in RULE_PAGES:
        for address, rule in rules(page).items():
            cited = CITED.get((page, address), set())
            assert cited, f"no code cites {page}#{address}"
            named = MODULE.findall(rule)
            assert not named or set(named) & cited, f"{named} do not cite {address}; {cited} do"


def test_ten_decisions_are_where_the_table_says():
    text = (DOCS / "method.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| .+ \| \[.+\]\(#([\w-]+)\) \| (`remind_jax/.+`) \|$", text, re.MULTILINE)
    assert len(rows) == 10
    for address, modules in rows:
        lacking = set(MODULE.findall(modules)) - CITED[("method.md", address)]
        assert not lacking, f"{lacking} do not cite method.md#{address}"


def test_every_rule_names_its_modules():
    homeless = {
        address
        for page in METHODS
        for address, text in rules(page).items()
        if "\nCode: " not in text and not _is_chapter(text)
    }
    assert not homeless


def _is_chapter(text: str) -> bool:
    """A numbered chapter of several rules, or a worked example."""
    return bool(re.search(r'"></a>\n(## \d|### Example )', text))


def test_modules_that_pages_name_exist():
    for page in DOCS.glob("*.md"):
        text = page.read_text(encoding="utf-8")
        named = {*MODULE.findall(text), *MEASURED.findall(text)}
        assert not {name for name in named if not (ROOT / name).is_file()}, page


def settings(page: str) -> dict[str, Any]:
    """Published values of all settings that a page may name."""
    fixed = (*dataclasses.fields(Static), *dataclasses.fields(Switches))
    values = {f"static.{field.name}": field.default for field in fixed}
    values |= {f"input.{field.name}": field.default for field in dataclasses.fields(Input)}
    for group in dataclasses.fields(METHODS[page]):
        of_group = getattr(METHODS[page], group.name)
        for field in dataclasses.fields(of_group):
            values[f"{group.name}.{field.name}"] = getattr(of_group, field.name)
    return values


@pytest.mark.parametrize("page", METHODS)
def test_rules_name_every_threshold_by_its_key(page):
    text = MODULE.sub("", (DOCS / page).read_text(encoding="utf-8"))
    known = settings(page)
    groups = "|".join({key.partition(".")[0] for key in known})
    named = set(re.findall(rf"(?<![\w/.])(?:{groups})\.[a-z]\w*", text))
    assert named <= set(known), sorted(named - set(known))
    thresholds = {key for key in known if not key.startswith(("static.", "input."))}
    assert thresholds <= named, sorted(thresholds - named)


@pytest.mark.parametrize("page", METHODS)
def test_rules_tell_the_published_values(page):
    text = (DOCS / page).read_text(encoding="utf-8")
    known = settings(page)
    told = re.findall(r"`(\w+\.\w+)`\s+=\s+(true|false|-?[\d.]+(?:e-?\d+)?(?:, \d+)*)", text)
    assert len(told) > 40
    wrong = {key: (value, known[key]) for key, value in told if not _is(known[key], value)}
    assert not wrong


def test_rules_tell_the_values_of_constants():
    told = [
        (name, value, MODULE.findall(rule))
        for rule in rules("method_plus.md").values()
        for name, value in re.findall(r"`([A-Z][A-Z_]+)`\s+=\s+(-?[\d.]+(?:, [\d.]+)*)", rule)
    ]
    assert len(told) > 20
    wrong = {name for name, value, modules in told if not _tells(modules, name, value)}
    assert not wrong


def _tells(modules: list[str], name: str, told: str) -> bool:
    """Whether one of some modules has a constant of this value."""
    named = (importlib.import_module(path[:-3].replace("/", ".")) for path in modules)
    return any(_is(getattr(module, name, None), told) for module in named)


def _is(value: Any, told: str) -> bool:
    if isinstance(value, bool):
        return told == str(value).lower()
    if isinstance(value, tuple):
        return told.rstrip(".") == ", ".join(map(str, value))
    return value is not None and float(told.rstrip(".").partition(",")[0]) == float(value)
