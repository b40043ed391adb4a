"""Every setting on one page of Markdown, made from the dataclasses and their comments.

    python -m remind_jax.config.reference_page docs/thresholds.md

The comment at a field is its meaning, with the paper's symbol in brackets; `config/effects.py` adds
unit and effect, `config/reference_keys.py` the original's key.
"""

from __future__ import annotations

import ast
import dataclasses
import inspect
import io
import re
import sys
import textwrap
import tokenize
import typing
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from remind_jax.config import reference_keys
from remind_jax.config.config import Config, load_config
from remind_jax.config.effects import NUMBERS
from remind_jax.method import PAPER_METHOD, get_method, list_methods
from remind_jax.remind.thresholds import outcome as outcome_thresholds

INTRODUCTION = """\
# Every setting

Made from the code by `make docs`; a test keeps it up to date. `input` and `static` serve every
tracker; thresholds belong to one: those of [plus](#thresholds-of-tracker-plus), the default, come
first, then those of the [paper's](#thresholds-of-tracker-remind) and of the baselines. Values are
the published ones of each tracker. `remind config show` prints every value that runs, `remind
config diff published remind` what one configuration changes of another, and what a backbone changes
stands in `configs/backbones/`.

Set any of them with `--set thresholds.decision.new=1.5`, in a file (`remind run --config FILE`),
or in Python with `load_config({"thresholds": {"decision": {"new": 1.5}}})`. Names are those of the
section and the row, joined by a dot; `thresholds.` may be left out. What you set is what runs: a
backbone changes only what nobody set. `run.json` holds the values of a run.

* **Larger means** says what a larger value does. A yes/no setting does what its meaning says.
* In small print: the key of the [original implementation](parity.md), which
  `remind config import-reference` translates.
* The *symbols* are those of the paper.
* `input` is read on the host. `static` fixes the compiled program: another value compiles anew. But
  for capacities, solver and precision its switches are those of the paper's tracker.
  `thresholds` are traced: another value does not, and
  [many can run at once](performance.md#many-settings-at-once).
* Scores, similarities, shares and qualities lie in [0, 1]. *Effective patches* are patches weighed
  by how much of each the mask covers. An *object size* is the mean side of the two objects between
  which a distance is measured.
"""

# Keys of the original that decide a setting together with others, or by another rule.
SWITCHES: dict[str, tuple[str, ...]] = {
    "thresholds.perception.patch_coverage": ("dino.patch_selection", "dino.patch_threshold"),
    "input.erosion_px": ("davis.mask_erosion_px", "davis.mask_erosion_iters"),
    "input.sanitize": ("bg_local.sanitize.enabled", "bg_local.sanitize.mode"),
    "static.ring_prototypes": (
        "bg_local.prototypes.enabled",
        "association.similarity.background_partials.enabled",
    ),
    "static.context_hypotheses": ("association.scores.neighbor_sets.context.k",),
    "static.expected_neighbours": (
        "association.scores.neighbor_sets.context.k",
        "association.matching.neighbor_sets_context_veto.local.expected_topk_scale",
    ),
    "thresholds.background.enabled": (
        "memory.background.enabled",
        "update.background_memory.enabled",
    ),
    "thresholds.perception.global_enabled": (
        "object_features.global.enabled",
        "memory.appearance.enabled",
        "memory.appearance.channels.global.enabled",
        "memory.appearance.channels.patch.enabled",
    ),
    "thresholds.perception.trimmed_enabled": (
        "object_features.global_trimmed.enabled",
        "memory.appearance.channels.global_trimmed.enabled",
    ),
    "static.part_source": (
        "part_descriptors.kmeans.enabled",
        "part_descriptors.attention.enabled",
    ),
    "static.part_resembling": (
        "part_descriptors.kmeans.merge.enabled",
        "part_descriptors.kmeans.merge.mode",
    ),
    "static.attention_heads": ("part_descriptors.attention.head_ids",),
    "thresholds.perception.parts_enabled": ("part_descriptors.enabled",),
    "thresholds.perception.kmeans_parts_kept": (
        "memory.parts.enabled",
        "memory.parts.channels.kmeans.enabled",
    ),
    "thresholds.perception.attention_parts_kept": ("memory.parts.channels.attention.enabled",),
}

_GREEK = {"tau": "τ", "delta": "δ", "rho": "ρ", "alpha": "α"}
_SIGNS = {"plus": "+", "minus": "−"}


@dataclasses.dataclass(frozen=True)
class Setting:
    """One row of the page."""

    name: str  # of the field
    default: str  # as in YAML
    unit: str  # or the values that it may have
    meaning: str
    symbol: str | None  # of the paper
    effect: str  # of a larger value
    keys: tuple[str, ...]  # of the original


@dataclasses.dataclass(frozen=True)
class Section:
    """Settings under one prefix."""

    path: str  # dotted
    words: str  # what the section is about
    settings: tuple[Setting, ...]


def read_comments(kind: type) -> dict[str, str]:
    """The comment of every field of a dataclass: behind it, else in the lines above it."""
    source = textwrap.dedent(inspect.getsource(kind))
    tokens = tokenize.generate_tokens(io.StringIO(source).readline)
    comments, alone = {}, set()
    for token in tokens:
        if token.type == tokenize.COMMENT:
            line = token.start[0]
            comments[line] = token.string.lstrip("# ")
            if token.line.lstrip().startswith("#"):
                alone.add(line)
    (node,) = ast.parse(source).body
    assert isinstance(node, ast.ClassDef)
    found = {}
    for field in node.body:
        if not (isinstance(field, ast.AnnAssign) and isinstance(field.target, ast.Name)):
            continue
        lines = range(field.lineno, (field.end_lineno or field.lineno) + 1)
        behind = [comments[line] for line in lines if line in comments]
        above = []
        while not behind and (line := field.lineno - 1 - len(above)) in alone:
            above.insert(0, comments[line])
        if words := " ".join(behind or above).rstrip("."):
            found[field.target.id] = words[0].lower() + words[1:] if above else words
    return found


def original_keys() -> dict[str, tuple[str, ...]]:
    """Keys of the original by the setting that they decide."""
    keys: dict[str, list[str]] = {path: list(names) for path, names in SWITCHES.items()}
    for key, path in reference_keys.RENAMED.items():
        keys.setdefault(path, []).append(key)
    for key, (path, _) in reference_keys.CHOICES.items():
        keys.setdefault(path, []).append(key)
    for key, gates in reference_keys.SUBSETS.items():
        for path in gates.values():
            keys.setdefault(path, []).append(key)
    for key, places in reference_keys.SLOTS.items():
        for path, _ in places:
            keys.setdefault(path, []).append(key)
    return {path: tuple(dict.fromkeys(names)) for path, names in keys.items()}


def list_sections(method: str = PAPER_METHOD) -> list[Section]:
    """The settings of a tracker, section by section; those that all share come with REMIND."""
    thresholds: Any = get_method(method).thresholds()
    nested = [
        field.name
        for field in dataclasses.fields(thresholds)
        if dataclasses.is_dataclass(getattr(thresholds, field.name))
    ]
    shared = method == PAPER_METHOD
    values: dict[str, Any] = {}
    if shared:
        values = {"input": Config().input, "static": Config().static}
    if nested:
        values |= {f"thresholds.{name}": getattr(thresholds, name) for name in nested}
    else:
        values["thresholds"] = thresholds
    return [_read_section(path, value, known=shared) for path, value in values.items()]


def render_page() -> str:
    """The whole page, Markdown: the default tracker, what all share, then the other trackers."""
    own, default = list_sections(), load_config().tracker
    shared = [section for section in own if not section.path.startswith("thresholds")]
    lines = [INTRODUCTION, *_threshold_lines(default, list_sections(default))]
    for section in shared:
        lines += ["", f"## {section.path}", "", *_section_lines(section)]
    lines += ["", "## Symbols of the paper", "", *_symbol_table(own)]
    lines += ["", *_threshold_lines(PAPER_METHOD, own[len(shared) :])]
    for method in list_methods():
        if method not in (PAPER_METHOD, default):
            lines += ["", *_threshold_lines(method, list_sections(method))]
    lines += ["", *_other_keys()]
    return "\n".join(lines) + "\n"


def _threshold_lines(method: str, sections: list[Section]) -> Iterator[str]:
    yield f"## Thresholds of tracker `{method}`"
    for section in sections:
        if section.path != "thresholds":
            yield ""
            # Sections of several trackers share their names, headings may not.
            is_paper = method == PAPER_METHOD
            yield f"### {section.path}" if is_paper else f"### {method}: {section.path}"
        yield ""
        yield from _section_lines(section)


def _read_section(path: str, values: Any, known: bool) -> Section:
    kind = type(values)
    comments, keys = read_comments(kind), original_keys() if known else {}
    effects = NUMBERS.get(path.removeprefix("thresholds."), {}) if known else {}
    hints = typing.get_type_hints(kind)
    settings = []
    for field in dataclasses.fields(kind):
        meaning, symbol = _split_symbol(comments.get(field.name, ""))
        unit, effect = effects.get(field.name, (_describe_kind(hints[field.name]), ""))
        settings.append(
            Setting(
                field.name,
                _as_yaml(getattr(values, field.name)),
                unit,
                meaning,
                symbol,
                effect,
                keys.get(f"{path}.{field.name}", ()),
            )
        )
    return Section(path, _describe_class(kind), tuple(settings))


def _describe_class(kind: type) -> str:
    """Its docstring; citations of rules become links."""
    return re.sub(r"(\w+\.md)#([\w-]+)", _link, inspect.getdoc(kind) or "")


def _link(rule: re.Match[str]) -> str:
    return f"[{rule[2].replace('-', ' ')}]({rule[0]})"


def _describe_kind(hint: Any) -> str:
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


def _split_symbol(comment: str) -> tuple[str, str | None]:
    match = re.fullmatch(r"(.*?)\s*\[([A-Za-z]\w*(?:_[\w,]+)?)\]", comment)
    return (match[1], match[2]) if match else (comment, None)


def _show_symbol(symbol: str) -> str:
    letter, _, index = symbol.partition("_")
    index = _SIGNS.get(index, index)
    shown = f"*{_GREEK.get(letter, letter)}*"
    return f"{shown}<sub>{index}</sub>" if index else shown


def _show_key(key: str) -> str:
    """A key that may break between its words."""
    return re.sub(r"([._])", r"\1<wbr>", key)


def _symbol_table(sections: list[Section]) -> Iterator[str]:
    yield "| symbol | setting | default |"
    yield "| --- | --- | --- |"
    for section in sections:
        for row in section.settings:
            if row.symbol:
                path = f"{section.path}.{row.name}"
                yield f"| {_show_symbol(row.symbol)} | `{path}` | `{row.default}` |"


def _section_lines(section: Section) -> Iterator[str]:
    yield section.words
    yield ""
    has_effects = any(row.effect for row in section.settings)
    yield "| setting | default | unit | meaning |" + (" larger means |" if has_effects else "")
    yield "| --- | --- | --- | --- |" + (" --- |" if has_effects else "")
    for row in section.settings:
        keys = "".join(f"<br><small>{_show_key(key)}</small>" for key in row.keys)
        meaning = row.meaning + (f" {_show_symbol(row.symbol)}" if row.symbol else "")
        cells = [f"`{row.name}`{keys}", f"`{row.default}`", row.unit, meaning]
        cells += [row.effect] if has_effects else []
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
    for key, (most, why) in outcome_thresholds.LIMITS.items():
        yield f"* `{key}`: `{most}` ({why})"
    yield ""
    yield "Without influence on an identity in any supported setting; accepted and passed over:"
    yield ""
    for key in sorted(reference_keys.INERT):
        yield f"* `{key}`"


def main(arguments: list[str]) -> int:
    """Writes the page to the file that is named, or prints it."""
    page = render_page()
    if arguments:
        Path(arguments[0]).write_text(page, encoding="utf-8")
    else:
        print(page, end="")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
