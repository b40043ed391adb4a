"""Tables and figures of `field.py`, and their place in benchmarks/field.md."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from benchmarks.field_worlds import MOVING, OTHER, SAME

Result = dict[str, Any]
Row = dict[str, Any]

_TITLES = {SAME: "Same view", OTHER: "From the other side", MOVING: "Everything moves"}
_ABSENCE, _ALIKE, _LIGHT = "absence", "alike", "light"
_AXES = {
    _ABSENCE: "frames away",
    _ALIKE: "objects that look alike",
    _LIGHT: "lamps at the return, of before",
}
_PLOTS = (
    (_ABSENCE, SAME),
    (_ABSENCE, OTHER),
    (_ABSENCE, MOVING),
    (_ALIKE, OTHER),
    (_ALIKE, MOVING),
    (_LIGHT, OTHER),
)
_OPEN = ("open", "for-ever", "published")  # what is drawn of a tracker of others: the first it has
_OURS_STYLE = {"color": "#d1495b", "lw": 2.4}
_COLORS = ("#2e5eaa", "#3a8f5c", "#8a5fb0", "#c98a1b", "#4a9fb5", "#7a5c48", "#98a33c", "#6b7280",
           "#b0578d", "#2f7f79", "#a86b32")  # fmt: skip


def write_tables(result: Result) -> dict[str, str]:
    """Markdown tables by name: one per plot, and all questions together."""
    tables = {"all": _overall(result)}
    for varied, world in _PLOTS:
        if _rows(result, varied, world):
            tables[f"{varied}-{world.replace(' ', '-')}"] = _plot_table(result, varied, world)
    tables["peers"] = _peer_table(result)
    return tables


def _rows(result: Result, varied: str, world: str, contender: str = "") -> list[Row]:
    return [
        row
        for row in result["rows"]
        if (row["varied"], row["world"]) == (varied, world) and contender in ("", row["contender"])
    ]


def _table(heads: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    aligned = "---:" if len(heads) > 2 else "---"
    lines = [heads, ["---", *[aligned] * (len(heads) - 1)], *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def _overall(result: Result) -> str:
    heads = (
        "tracker",
        "IDF1",
        "recovered",
        "in the first frame",
        "taken for another",
        "ids per object",
        "unanswered",
    )
    rows = sorted(_rows(result, "all", "all"), key=lambda row: -row["recovery"])
    return _table(
        heads,
        [
            (
                _name(result, row["contender"]),
                f"{row['idf1']:.1f}",
                f"{row['recovery']:.1f}",
                f"{row['hard']:.1f}",
                f"{row['another']:.1f}",
                f"{row['ids']:.2f}",
                f"{row['unanswered']:.1f}",
            )
            for row in rows
        ],
    )


def _plot_table(result: Result, varied: str, world: str) -> str:
    """Recovery, and in the first frame, at every value."""
    values = sorted({row["value"] for row in _rows(result, varied, world)})
    if varied == _LIGHT:
        values.reverse()
    order = [row["contender"] for row in _rows(result, "all", "all")]
    order.sort(key=lambda name: -_rows(result, "all", "all", name)[0]["recovery"])
    body = []
    for name in order:
        found = {row["value"]: row for row in _rows(result, varied, world, name)}
        cells = [
            f"{found[value]['recovery']:.0f} / {found[value]['hard']:.0f}" if value in found else ""
            for value in values
        ]
        body.append([_name(result, name), *cells])
    return _table([_AXES[varied], *(f"{value:,g}" for value in values)], body)


def _peer_table(result: Result) -> str:
    rows = [
        (name, ", ".join(f"{package} {version}" for package, version in versions.items()))
        for name, versions in result["versions"].items()
    ]
    rows += [(name, f"absent: {why}") for name, why in result["absent"].items()]
    failed = {
        name: about["error"] for name, about in result["contenders"].items() if about.get("error")
    }
    rows += [(name, f"failed: {why}") for name, why in failed.items()]
    rows += [(name, "not finished, left out") for name in result.get("unfinished", ())]
    return _table(("package", "versions"), rows)


def _name(result: Result, contender: str) -> str:
    is_ours = result["contenders"][contender]["setting"] == "ours"
    return f"**{contender}**" if is_ours else contender


def _drawn(result: Result) -> list[tuple[str, str]]:
    """Contenders of the figures and their labels: ours, and every other tracker at its best."""
    drawn, seen = [], set()
    for name, about in result["contenders"].items():
        if about["setting"] == "ours":
            drawn.append((name, name))
            continue
        tracker = name.rpartition(",")[0]
        settings = {
            other["setting"]: title
            for title, other in result["contenders"].items()
            if title.rpartition(",")[0] == tracker
        }
        if tracker not in seen:
            seen.add(tracker)
            best = next(settings[one] for one in _OPEN if one in settings)
            drawn.append((best, best))
    return drawn


def write_figures(result: Result, folder: Path) -> list[Path]:
    """`field_recovery.svg` and `field_first_frame.svg`: all plots, a line per tracker."""
    import matplotlib

    matplotlib.use("Agg")
    matplotlib.rcParams.update({"svg.hashsalt": "field", "svg.fonttype": "none", "font.size": 9})
    folder.mkdir(parents=True, exist_ok=True)
    files = []
    scores = {"recovery": "recovered, %", "hard": "in the first frame, %"}
    for (score, label), stem in zip(
        scores.items(), ("field_recovery", "field_first_frame"), strict=True
    ):
        files.append(folder / f"{stem}.svg")
        _draw(result, score, label, files[-1])
    return files


def _draw(result: Result, score: str, label: str, file: Path) -> None:
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(2, 3, figsize=(10.5, 6.6), sharey=True)
    drawn = _drawn(result)
    styles = _styles(result, [name for name, _ in drawn])
    for axis, (varied, world) in zip(axes.flat, _PLOTS, strict=True):
        # Published settings of others, to show what memory alone brings.
        for name, about in result["contenders"].items():
            if about["setting"] == "published":
                _line(axis, _rows(result, varied, world, name), score, color="#c5cad3", lw=0.8)
        for name, shown in drawn[::-1]:
            _line(axis, _rows(result, varied, world, name), score, label=shown, **styles[name])
        axis.set_title(f"{_TITLES[world]}", fontsize=10)
        axis.set_xlabel(_AXES[varied])
        axis.set_ylim(-3, 103)
        axis.grid(color="#e5e7eb", lw=0.6)
        axis.spines[["top", "right"]].set_visible(False)
        axis.set_xscale("log")
        values = sorted({row["value"] for row in _rows(result, varied, world)})
        axis.set_xticks(values, [f"{value:,g}" for value in values], fontsize=8)
        axis.minorticks_off()
        if varied == _LIGHT:
            axis.invert_xaxis()
    for axis in axes[:, 0]:
        axis.set_ylabel(label)
    handles, labels = axes.flat[1].get_legend_handles_labels()
    figure.legend(
        handles[::-1], labels[::-1], loc="lower center", ncols=3, frameon=False, fontsize=8
    )
    figure.tight_layout(rect=(0, 0.17, 1, 1))
    figure.savefig(file, metadata={"Date": None})
    plt.close(figure)


def _styles(result: Result, names: Sequence[str]) -> dict[str, dict[str, Any]]:
    styles: dict[str, dict[str, Any]] = {}
    dashes, colors = iter(("-", "--", ":")), iter(_COLORS * 4)
    for name in names:
        if result["contenders"][name]["setting"] == "ours":
            styles[name] = {**_OURS_STYLE, "ls": next(dashes), "marker": "o", "ms": 4}
        else:
            styles[name] = {"color": next(colors), "lw": 1.2, "marker": ".", "ms": 5}
    return styles


def _line(axis: Any, rows: list[Row], score: str, **style: Any) -> None:
    rows = sorted(rows, key=lambda row: row["value"])
    if rows:
        axis.plot([row["value"] for row in rows], [row[score] for row in rows], **style)
