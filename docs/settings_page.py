"""Every setting in Markdown, made from the records of the settings.

Those of the default tracker stand at the end of the page of its rules, the others on a page.

python docs/settings_page.py docs/thresholds.md docs/method_plus.md
"""

from __future__ import annotations

import dataclasses
import inspect
import re
import sys
import typing
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from remind_jax.config import Config, load_config, reference_keys
from remind_jax.method import PAPER_METHOD, get_method, list_methods
from remind_jax.settings.record import Setting, walk_settings
from remind_jax.static import Static

INTRODUCTION = """\
# Every setting

Made from the code by `make docs`; a test keeps it up to date. `input` and `static` serve every
tracker; thresholds belong to one: those of [plus](method_plus.md#thresholds-of-tracker-plus), the
default, stand with its rules, here those of the [paper's](#thresholds-of-tracker-remind) and of the
baselines. Values are the published ones of each tracker. In a terminal,
`remind config describe KEY` says what is said here, `remind config show` prints every value that
runs, and `remind config diff published remind` what one configuration changes of another;
what a backbone changes stands in `configs/backbones/`.

Set any of them with `--set thresholds.decision.new=1.5`, in a file (`remind run --config FILE`),
or in Python with `load_config({"thresholds": {"decision": {"new": 1.5}}})`. Names are those of the
section and the row, joined by a dot; `thresholds.` may be left out. What you set is what runs: a
backbone changes only what nobody set. `run.json` holds the values of a run.

* **Larger means** says what a larger value does. A yes/no setting does what its meaning says.
* In small print: the key of the [original implementation](parity.md), which
  `remind config import-reference` translates.
* The *symbols* are those of the paper.
* `input` is read on the host. `static` fixes the compiled program: another value compiles anew.
  Its switches are those of the paper's tracker; `static.part_top` is short for
  `static.switches.part_top`. `thresholds` are traced: another value does not compile anew, and
  [many can run at once](performance.md#many-settings-at-once).
* Scores, similarities, shares and qualities lie in [0, 1]. *Effective patches* are patches weighed
  by how much of each the mask covers. An *object size* is the mean side of the two objects between
  which a distance is measured. A *length* of plus is in units of which a frame has the area 30.72:
  100 pixels of a frame of 640x480.
"""


MARK = "<!-- From here on made from the code by `make docs`. -->\n"


@dataclasses.dataclass(frozen=True)
class Section:
    """Settings under one prefix."""

    path: str  # dotted
    words: str  # what the section is about
    rows: tuple[tuple[str, str, str, Setting], ...]  # name, default as in YAML, unit, record


def list_sections(method: str = PAPER_METHOD) -> list[Section]:
    """The settings of a tracker, section by section; those that all share come with REMIND."""
    thresholds: Any = get_method(method).settings()
    nested = [
        field.name
        for field in dataclasses.fields(thresholds)
        if dataclasses.is_dataclass(getattr(thresholds, field.name))
    ]
    shared = method == PAPER_METHOD
    values: dict[str, Any] = {}
    if shared:
        values = {"input": Config().input, "static": Static()}
    if dataclasses.fields(switches := get_method(method).switches()):
        values["static.switches"] = switches
    if nested:
        values |= {f"thresholds.{name}": getattr(thresholds, name) for name in nested}
    else:
        values["thresholds"] = thresholds
    return [_read_section(path, value) for path, value in values.items()]


def render_page() -> str:
    """The page, Markdown: what all share, the paper's tracker, then the baselines."""
    own, default = list_sections(), load_config().tracker
    shared = [section for section in own if not section.path.startswith("thresholds")]
    lines = [INTRODUCTION.rstrip()]
    for section in shared:
        lines += ["", f"## {section.path}", "", *_section_lines(section)]
    lines += ["", "## Symbols of the paper", "", *_symbol_table(own)]
    lines += ["", *_threshold_lines(PAPER_METHOD, own[len(shared) :])]
    for method in list_methods():
        if method not in (PAPER_METHOD, default):
            words = _describe_method(method)
            lines += ["", *_threshold_lines(method, list_sections(method), words)]
    lines += ["", *_other_keys()]
    return "\n".join(lines) + "\n"


def with_settings(rules: str) -> str:
    """The page of the rules of the default tracker, with its settings at the end."""
    default = load_config().tracker
    lines = _threshold_lines(default, list_sections(default))
    return rules.partition(MARK)[0] + MARK + "\n" + "\n".join(lines) + "\n"


def _threshold_lines(method: str, sections: list[Section], words: str = "") -> Iterator[str]:
    yield f"## Thresholds of tracker `{method}`"
    if words:
        yield ""
        yield words
    for section in sections:
        if section.path != "thresholds":
            yield ""
            # Sections of several trackers share their names, headings may not.
            is_paper = method == PAPER_METHOD
            yield f"### {section.path}" if is_paper else f"### {method}: {section.path}"
        yield ""
        yield from _section_lines(section)


def _read_section(path: str, values: Any) -> Section:
    hints = typing.get_type_hints(type(values))
    rows = tuple(
        (name, _as_yaml(value), _describe_unit(record, hints[name]), record)
        for name, value, record in walk_settings(values)
    )
    return Section(path, _describe_class(type(values)), rows)


def _describe_method(method: str) -> str:
    """What the docstring of its module begins with."""
    module = sys.modules[get_method(method).decide.__module__]
    return (inspect.getdoc(module) or "").partition("\n\n")[0]


def _describe_class(kind: type) -> str:
    """Its docstring; citations of rules become links."""
    return re.sub(r"(\w+\.md)#([\w-]+)", _link, inspect.getdoc(kind) or "")


def _link(rule: re.Match[str]) -> str:
    return f"[{rule[2].replace('-', ' ')}]({rule[0]})"


def _describe_unit(record: Setting, hint: Any) -> str:
    """The unit of a number with its largest value, or the values that there are."""
    if record.unit:
        return record.unit if record.most is None else f"{record.unit}, at most {record.most:g}"
    if typing.get_origin(hint) is typing.Literal:
        return " or ".join(f"`{choice}`" for choice in typing.get_args(hint))
    if hint is bool:
        return "yes/no"
    return "list" if typing.get_origin(hint) is tuple else "number"


def _as_yaml(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, tuple):
        return f"[{', '.join(map(str, value))}]"
    return f"{value:g}" if isinstance(value, float) else str(value)


def _show_symbol(symbol: str) -> str:
    letter, _, index = symbol.partition("_")
    return f"*{letter}*<sub>{index}</sub>" if index else f"*{letter}*"


def _show_key(key: str) -> str:
    """A key that may break between its words."""
    return re.sub(r"([._])", r"\1<wbr>", key)


def _symbol_table(sections: list[Section]) -> Iterator[str]:
    yield "| symbol | setting | default |"
    yield "| --- | --- | --- |"
    for section in sections:
        for name, default, _, record in section.rows:
            if record.symbol:
                yield f"| {_show_symbol(record.symbol)} | `{section.path}.{name}` | `{default}` |"


def _section_lines(section: Section) -> Iterator[str]:
    yield section.words
    yield ""
    has_effects = any(record.more for *_, record in section.rows)
    yield "| setting | default | unit | meaning |" + (" larger means |" if has_effects else "")
    yield "| --- | --- | --- | --- |" + (" --- |" if has_effects else "")
    for name, default, unit, record in section.rows:
        keys = (*record.own_keys, *record.decided_by)
        small = "".join(f"<br><small>{_show_key(key)}</small>" for key in keys)
        meaning = record.meaning + (f" {_show_symbol(record.symbol)}" if record.symbol else "")
        cells = [f"`{name}`{small}", f"`{default}`", unit, meaning]
        cells += [record.more] if has_effects else []
        yield "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |"


def _other_keys() -> Iterator[str]:
    yield "## Keys of the original without a setting here"
    yield ""
    yield "Supported with this value only; another is refused by name:"
    yield ""
    for key, value in reference_keys.FIXED.items():
        shown = f"[{', '.join(map(str, value))}]" if isinstance(value, list) else _as_yaml(value)
        yield f"* `{key}`: `{shown}`"
    yield ""
    yield "Supported up to this value; a larger one is refused by name:"
    yield ""
    for _, _, record in walk_settings(Config()):
        if record.most is not None and record.key:
            yield f"* `{record.key}`: `{record.most}` ({record.why})"
    yield ""
    yield "Without influence on an identity in any supported setting; accepted and passed over:"
    yield ""
    for key in sorted(reference_keys.INERT):
        yield f"* `{key}`"


def main(arguments: list[str]) -> int:
    """Writes the page to the file that is named, or prints it; fills in the page of the rules."""
    page = render_page()
    if arguments:
        Path(arguments[0]).write_text(page, encoding="utf-8")
    else:
        print(page, end="")
    for path in map(Path, arguments[1:]):
        path.write_text(with_settings(path.read_text(encoding="utf-8")), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
