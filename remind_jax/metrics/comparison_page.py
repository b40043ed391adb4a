"""The page of a comparison: table, plots with intervals and legend in one HTML file."""

from __future__ import annotations

import contextlib
import html
import io
import math
from collections.abc import Sequence
from typing import Any

from remind_jax.errors import OutputError
from remind_jax.metrics.columns import Chart, Column, Row, column_of, is_best
from remind_jax.outputs.drawing import identity_color, to_hex

# Scores of which a plot tells more than the table does.
_PLOTTED = frozenset(
    (
        *("ClassHOTA", "ClassAssA", "ClassIDF1"),
        *("HOTA", "DetA", "AssA", "IDF1", "Recovery", "HardRecovery", "MOTA", "IDSW"),
    )
)

_STYLE = """
:root { color-scheme: light; font: 15px/1.5 system-ui, sans-serif; color: #1b1f24; }
body { max-width: 92rem; margin: 2rem auto; padding: 0 1.25rem; background: #fff; }
h1 { font-size: 1.5rem; } h2 { font-size: 1.1rem; margin-top: 2rem; }
.scroll { overflow-x: auto; }
table { border-collapse: collapse; font-variant-numeric: tabular-nums; }
th, td { padding: .35rem .6rem; border-bottom: 1px solid #d8dee4; text-align: right;
  vertical-align: top; }
th { border-bottom: 2px solid #1b1f24; white-space: nowrap; }
th:first-child, td:first-child, td.note, th.note { text-align: left; }
td:first-child { white-space: nowrap; }
th:first-child, td:first-child { position: sticky; left: 0; background: #fff; }
td small { display: block; color: #59636e; white-space: nowrap; }
td.best { font-weight: 700; } td.best small { font-weight: 400; }
.swatch { display: inline-block; width: .7em; height: .7em; border-radius: 50%;
  margin-right: .5em; }
.plots { display: flex; flex-wrap: wrap; gap: 1rem; }
.plots svg { max-width: 100%; height: auto; }
dl { display: grid; grid-template-columns: max-content 1fr; gap: .2rem 1rem; }
dt { font-weight: 600; } dd { margin: 0; }
"""


def render_page(
    title: str,
    columns: Sequence[Column],
    rows: Sequence[Row],
    *,
    legend: Sequence[str] = (),
    charts: Sequence[Chart] = (),
) -> str:
    """The whole page as text; it loads nothing.

    Raises:
      OutputError: If matplotlib is not installed.
    """
    title = html.escape(title or "Comparison")
    meanings = "".join(
        f"<dt>{html.escape(column.heading)}</dt><dd>{html.escape(column.meaning)}</dd>"
        for column in columns
        if column.meaning
    )
    sentences = "".join(f"<li>{html.escape(sentence)}</li>" for sentence in legend)
    plotted = [
        c for c in columns if c.name in _PLOTTED and not all(math.isnan(r.score(c)) for r in rows)
    ]
    plots = "".join(_draw_scores(rows, column) for column in plotted)
    drawn = "".join(_draw_chart([row.name for row in rows], chart) for chart in charts)
    parts = [
        f"<h1>{title}</h1>",
        f'<div class="scroll">{_render_table(columns, rows)}</div>',
        f"<ul>{sentences}</ul>" if legend else "",
        f'<h2>Scores</h2><div class="plots">{plots}</div>' if plots else "",
        f'<h2>Breakdowns</h2><div class="plots">{drawn}</div>' if charts else "",
        f"<h2>Columns</h2><dl>{meanings}</dl>" if meanings else "",
    ]
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{title}</title><style>{_STYLE}</style></head>\n<body>\n"
        + "\n".join(part for part in parts if part)
        + "\n</body></html>\n"
    )


def _render_table(columns: Sequence[Column], rows: Sequence[Row]) -> str:
    has_notes = any(row.note for row in rows)
    head = "".join(
        f'<th title="{html.escape(column.meaning)}">{html.escape(column.heading)}</th>'
        for column in columns
    )
    lines = []
    for place, row in enumerate(rows):
        cells = []
        for column in columns:
            score, interval = row.format(column)
            mark = ' class="best"' if is_best(rows, row, column) else ""
            small = f"<small>{interval}</small>" if interval else ""
            cells.append(f"<td{mark}>{score}{small}</td>")
        note = f'<td class="note">{html.escape(row.note)}</td>' if has_notes else ""
        swatch = f'<span class="swatch" style="background:{_color(place)}"></span>'
        lines.append(f"<tr><td>{swatch}{html.escape(row.name)}</td>{''.join(cells)}{note}</tr>\n")
    note = '<th class="note">note</th>' if has_notes else ""
    return (
        f"<table><thead><tr><th></th>{head}{note}</tr></thead>\n<tbody>\n{''.join(lines)}"
        "</tbody></table>"
    )


def _draw_scores(rows: Sequence[Row], column: Column) -> str:
    """One score of all rows: a dot each, with its interval."""
    scale = 100.0 if column.kind == "percent" else 1.0
    with _figure(4.6, 0.9 + 0.34 * len(rows)) as (axes, finish):
        for place, row in enumerate(rows):
            value = scale * row.score(column)
            low, high = row.intervals.get(column.name, (math.nan, math.nan))
            if not math.isnan(low):
                ends = [scale * low, scale * high]
                axes.plot(ends, [place] * 2, color=_color(place), lw=2, clip_on=False, zorder=3)
            axes.plot(value, place, "o", color=_color(place), ms=7, clip_on=False, zorder=3)
        axes.set_yticks(range(len(rows)), [_plain(row.name) for row in rows])
        axes.set_ylim(len(rows) - 0.5, -0.5)
        axes.set_title(column.heading + (" (%)" if column.kind == "percent" else ""), loc="left")
        if axes.get_xlim()[0] >= -5:
            axes.set_xlim(0, 102 if column.kind == "percent" else None)
        axes.xaxis.get_major_locator().set_params(integer=column.kind == "count")
        axes.grid(axis="x", color="#e6e9ec")
        return finish(f"{column.heading} of every row")


def _draw_chart(order: Sequence[str], chart: Chart) -> str:
    """A score by bins: one line per row, supports under the bins; bins without any are left out."""
    column = column_of(chart.column)
    scale = 100.0 if column.kind == "percent" else 1.0
    seen = [at for at, _ in enumerate(chart.bins) if not chart.supports or chart.supports[at]]
    with _figure(5.6, 3.4) as (axes, finish):
        for name, values in chart.series.items():
            place = order.index(name) if name in order else len(order)
            axes.plot(
                range(len(seen)),
                [scale * values[at] for at in seen],
                "o-",
                color=_color(place),
                label=_plain(name),
                clip_on=False,
                zorder=3,
            )
        labels = [
            f"{chart.bins[at]}\n{chart.supports[at]:,}" if chart.supports else chart.bins[at]
            for at in seen
        ]
        axes.set_xticks(range(len(labels)), labels, fontsize=9)
        axes.set_xlim(-0.4, len(labels) - 0.6)
        if column.kind == "percent":
            axes.set_ylim(0, 102)
        if chart.supports:
            axes.set_xlabel("observations under each bin", fontsize=9)
        axes.set_title(_plain(chart.title), loc="left")
        axes.set_ylabel(column.heading + (" (%)" if column.kind == "percent" else ""))
        axes.grid(axis="y", color="#e6e9ec")
        axes.legend(frameon=False, fontsize=9)
        return finish(chart.title)


@contextlib.contextmanager
def _figure(width: float, height: float) -> Any:
    """Axes in a style of our own, and a function that turns them into inline SVG."""
    try:
        import matplotlib as mpl
        from matplotlib.figure import Figure
    except ImportError as error:
        raise OutputError(
            "a page with plots needs matplotlib, which is not installed: "
            'pip install "remind-jax[viz]"'
        ) from error
    settings: dict[Any, Any] = {
        "svg.fonttype": "none",
        "svg.hashsalt": "remind-jax",
        "font.family": "sans-serif",
        "axes.spines.top": False,
        "axes.spines.right": False,
        "axes.axisbelow": True,
    }
    with mpl.rc_context(settings):
        figure = Figure((width, height), layout="constrained")
        axes = figure.add_subplot()

        def finish(label: str) -> str:
            text = io.StringIO()
            figure.savefig(text, format="svg", metadata={"Date": None, "Creator": None})
            svg = text.getvalue()
            name = f'<svg role="img" aria-label="{html.escape(label)}" '
            return svg[svg.index("<svg") :].replace("<svg ", name, 1)

        yield axes, finish


def _plain(text: str) -> str:
    """Text in which matplotlib finds no formula."""
    return text.replace("$", r"\$")


def _color(place: int) -> str:
    return to_hex(identity_color(place))
