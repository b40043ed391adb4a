"""`timeline.png`: who was seen when, who came back, what stayed undecided.

Positions count the processed frames 0, 1, 2, ...
"""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Iterator, Sequence

import cv2
import numpy as np
from jaxtyping import UInt8

from remind_jax.decision import Outcome
from remind_jax.outputs.drawing import (
    AMBIGUOUS,
    PROVISIONAL,
    Color,
    identity_color,
    put_text,
    shorten,
    text_width,
)
from remind_jax.outputs.presence import (
    MIN_ABSENCE_FRAMES,
    UNDECIDED,
    Presence,
    Span,
    find_presences,
    join_positions,
)
from remind_jax.outputs.result import Result

_BACKGROUND: Color = (20, 23, 29)
_STRIPE: Color = (27, 31, 38)
_GRID: Color = (46, 52, 62)
_INK: Color = (228, 231, 237)
_FAINT: Color = (142, 150, 164)
_PLOT_PX = 1180
_MAX_NAME_PX = 240
_MARGIN_PX = 24
_HEADING_PX = 84
_FOOTER_PX = 44
_MOST_TICKS = 12


@dataclasses.dataclass(frozen=True)
class Timeline:
    """All identities over time, sorted by first sight, and what was never decided."""

    num_frames: int
    rows: tuple[Presence, ...]
    ambiguous: tuple[Span, ...]  # frames with at least one such detection
    provisional: tuple[Span, ...]


def build_timeline(result: Result) -> Timeline:
    """Collects presence, absence and doubt from a run."""

    def frames_with(outcomes: Sequence[Outcome]) -> tuple[Span, ...]:
        return join_positions(
            position
            for position, tracks in enumerate(result.tracks)
            if np.isin(tracks.outcome, outcomes).any()
        )

    by_first_sight = sorted(find_presences(result.tracks), key=lambda row: row.seen[0][0])
    provisional = [outcome for outcome in UNDECIDED if outcome != Outcome.AMBIGUOUS]
    return Timeline(
        num_frames=len(result.tracks),
        rows=tuple(by_first_sight),
        ambiguous=frames_with([Outcome.AMBIGUOUS]),
        provisional=frames_with(provisional),
    )


@dataclasses.dataclass(frozen=True)
class _Axes:
    """Where things are on the picture, in pixels."""

    names_px: int
    row_px: int
    num_frames: int

    def x(self, position: float) -> int:
        share = position / max(self.num_frames, 1)
        return _MARGIN_PX + self.names_px + round(share * _PLOT_PX)

    def top(self, row: int) -> int:
        return _HEADING_PX + row * self.row_px


def draw_timeline(result: Result) -> UInt8[np.ndarray, "H W 3"]:
    """The picture of a run; RGB, 1180 pixels of time beside the names."""
    timeline = build_timeline(result)
    row_px = 26 if len(timeline.rows) <= 24 else 20
    names = ["provisional", *(row.title for row in timeline.rows)]
    widest_px = max(text_width(name, row_px - 8) for name in names)
    axes = _Axes(min(widest_px, _MAX_NAME_PX) + 18, row_px, timeline.num_frames)
    num_rows = len(timeline.rows) + 2
    canvas = np.full(
        (axes.top(num_rows) + 10 + _FOOTER_PX, axes.x(axes.num_frames) + _MARGIN_PX, 3),
        _BACKGROUND,
        np.uint8,
    )
    _draw_heading(canvas, result, timeline)
    _draw_grid(canvas, axes, num_rows, result.info.fps)
    for number, row in enumerate(timeline.rows):
        _draw_row(canvas, axes, number, row)
    bottom = len(timeline.rows)
    for number, name, runs, color in (
        (bottom, "ambiguous", timeline.ambiguous, AMBIGUOUS),
        (bottom + 1, "provisional", timeline.provisional, PROVISIONAL),
    ):
        _draw_name(canvas, axes, number, name, _FAINT)
        for run in runs:
            _fill_run(canvas, axes, number, run, color, inset=axes.row_px // 3)
    return canvas


def _draw_heading(canvas: np.ndarray, result: Result, timeline: Timeline) -> None:
    num_returns = sum(len(row.returns) for row in timeline.rows)
    facts = f"{len(timeline.rows)} identities, {num_returns} returns, {timeline.num_frames} frames"
    title = shorten(result.info.name, 19, round(0.62 * canvas.shape[1]), tail=f": {facts}")
    put_text(canvas, title, _MARGIN_PX, 38, 19, _INK)
    x = canvas.shape[1] - _MARGIN_PX - 408
    canvas[26:38, x : x + 22] = identity_color(0)
    put_text(canvas, "seen", x + 30, 37, 13, _FAINT)
    _draw_return(canvas, x + 88, 32, 13)
    put_text(canvas, f"back after {MIN_ABSENCE_FRAMES}+ frames", x + 100, 37, 13, _FAINT)
    canvas[30:34, x + 250 : x + 272] = AMBIGUOUS
    put_text(canvas, "candidate, undecided", x + 280, 37, 13, _FAINT)


def _draw_grid(canvas: np.ndarray, axes: _Axes, num_rows: int, fps: float) -> None:
    """Striped rows and, above and below, frame numbers and times."""
    for number in range(0, num_rows, 2):
        canvas[axes.top(number) : axes.top(number + 1), axes.x(0) : axes.x(axes.num_frames)] = (
            _STRIPE
        )
    bottom = axes.top(num_rows)
    put_text(canvas, "frame", _MARGIN_PX, _HEADING_PX - 10, 12, _FAINT)
    step = round(choose_step(axes.num_frames, frame_steps(axes.num_frames)))
    for position in range(0, axes.num_frames, step):
        x = axes.x(position)
        cv2.line(canvas, (x, _HEADING_PX - 4), (x, bottom), _GRID, 1)
        _put_tick(canvas, str(position), x, _HEADING_PX - 10)
    if fps > 0 and axes.num_frames:
        _draw_times(canvas, axes, bottom, fps)


def _draw_times(canvas: np.ndarray, axes: _Axes, bottom: int, fps: float) -> None:
    """Times of the video, below; round ones fall on other frames than those above."""
    put_text(canvas, "video", _MARGIN_PX, bottom + 20, 12, _FAINT)
    duration_s = axes.num_frames / fps
    step_s = choose_step(duration_s, time_steps(duration_s))
    for number in range(math.ceil(duration_s / step_s)):
        x = axes.x(number * step_s * fps)
        cv2.line(canvas, (x, bottom), (x, bottom + 6), _FAINT, 1)
        _put_tick(canvas, time_label(number * step_s, step_s), x, bottom + 20)


def _put_tick(canvas: np.ndarray, text: str, x: int, baseline: int) -> None:
    """A label to the right of its tick, or as far right as the picture goes."""
    rightmost = canvas.shape[1] - text_width(text, 12) - 2
    put_text(canvas, text, min(x + 2, rightmost), baseline, 12, _FAINT)


def _draw_row(canvas: np.ndarray, axes: _Axes, number: int, row: Presence) -> None:
    tail = f" {row.object_id}"
    kept = tail if row.title.endswith(tail) else ""
    title = row.title.removesuffix(kept)
    name = shorten(title, axes.row_px - 8, axes.names_px - 14, tail=kept)
    _draw_name(canvas, axes, number, name, _INK)
    color = identity_color(row.object_id)
    middle = axes.top(number) + axes.row_px // 2
    dim = tuple(round(0.4 * c + 0.6 * b) for c, b in zip(color, _STRIPE, strict=True))
    cv2.line(canvas, (axes.x(row.seen[0][0]), middle), (axes.x(row.seen[-1][1]), middle), dim, 1)
    for run in row.seen:
        _fill_run(canvas, axes, number, run, color, inset=4)
    for run in row.candidate:
        _fill_run(canvas, axes, number, run, AMBIGUOUS, inset=axes.row_px // 2 - 2)
    for position in row.returns:
        _draw_return(canvas, axes.x(position), middle, axes.row_px - 9)


def _draw_name(canvas: np.ndarray, axes: _Axes, number: int, name: str, ink: Color) -> None:
    size_px = axes.row_px - 8
    baseline = axes.top(number) + axes.row_px // 2 + round(0.36 * size_px)
    put_text(canvas, name, _MARGIN_PX, baseline, size_px, ink)


def _fill_run(
    canvas: np.ndarray, axes: _Axes, number: int, run: Span, color: Color, inset: int
) -> None:
    """A bar from the first to the last frame of the run, two pixels wide at least."""
    left = axes.x(run[0])
    right = max(axes.x(run[1] + 1), left + 2)
    canvas[axes.top(number) + inset : axes.top(number + 1) - inset, left:right] = color


def _draw_return(canvas: np.ndarray, x: int, middle: int, size_px: int) -> None:
    """A white triangle with a dark rim whose tip points at the moment of the return."""
    half = size_px // 2
    triangle = np.array([[x - half, middle - half], [x - half, middle + half], [x + half, middle]])
    cv2.fillConvexPoly(canvas, triangle, (255, 255, 255), cv2.LINE_AA)
    cv2.polylines(canvas, [triangle], True, _BACKGROUND, 1, cv2.LINE_AA)


def frame_steps(num_frames: int) -> list[int]:
    """Round numbers of frames, up to the first that leaves one tick."""
    return [int(step) for step in _up_to(num_frames, _round_numbers(1.0))]


def time_steps(duration_s: float) -> list[float]:
    """Round seconds and, from one minute on, round minutes; up to the first that leaves one tick.

    Args:
      duration_s: Of the axis; positive.
    """
    smallest = 10.0 ** math.floor(math.log10(duration_s) - 2)
    seconds = itertools.takewhile(lambda step: step < 50, _round_numbers(min(smallest, 1.0)))
    minutes = (60 * step for step in _round_numbers(1.0))
    return _up_to(duration_s, itertools.chain(seconds, minutes))


def choose_step(length: float, steps: Sequence[float], most: int = _MOST_TICKS) -> float:
    """The smallest of the steps with at most so many ticks; else the largest."""
    return next((step for step in steps if length <= most * step), steps[-1])


def time_label(time_s: float, step_s: float) -> str:
    """Minutes and seconds, `1:05`, with the decimals that the step needs."""
    decimals = max(0, math.ceil(-math.log10(step_s) - 1e-9))
    minutes, seconds = divmod(round(time_s, decimals), 60)
    width = 3 + decimals if decimals else 2
    return f"{minutes:.0f}:{seconds:0{width}.{decimals}f}"


def _round_numbers(smallest: float) -> Iterator[float]:
    """From a power of ten on."""
    for power in itertools.count(round(math.log10(smallest))):
        for factor in (1, 2, 5):
            yield factor * 10.0**power if power >= 0 else factor / 10.0**-power


def _up_to(length: float, steps: Iterator[float]) -> list[float]:
    taken = []
    for step in steps:
        taken.append(step)
        if step >= length:
            break
    return taken
