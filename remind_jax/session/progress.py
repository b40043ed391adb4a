"""What is seen of a run while it goes on: one line on a terminal or in a notebook, else nothing."""

from __future__ import annotations

import contextlib
import dataclasses
import html
import sys
import threading
import time
from collections.abc import Callable, Iterator
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, ProgressColumn, TimeRemainingColumn
from rich.progress import Progress as Bars
from rich.text import Text

_BAR_WIDTH = 16  # so that the line fits a terminal of 80 columns
_NOTEBOOK_REFRESH_S = 0.5
# A frame that takes longer than this, and than so many usual ones, is reported.
_LONG_S, _LONG_FRAMES = 3.0, 10


@dataclasses.dataclass(frozen=True)
class Progress:
    """How far a run is; handed to the caller's function after every frame."""

    num_done: int  # frames
    num_frames: int | None  # frames in all, where known
    ms_per_frame: float  # median of the last frames
    num_identities: int
    undecided_share: float  # of the detections so far


class RunLine:
    """The line, from `with` until its end; call it after every frame.

    Attributes:
      num_done: Frames so far.
      note: Said in the place of what goes on, if set.
    """

    def __init__(
        self,
        title: str,
        num_frames: int | None,
        *,
        is_shown: bool = True,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.num_done, self.note = 0, ""
        self._title, self._num_frames, self._clock = title, num_frames, clock
        self._last: Progress | None = None
        self._since = clock()
        self._view: Any = contextlib.nullcontext()
        if is_shown and _in_notebook():
            self._view = _NotebookView(self)
        elif is_shown and Console(stderr=True).is_terminal:
            self._view = _TerminalView(self)

    def __enter__(self) -> RunLine:
        self._since = self._clock()
        self._view.__enter__()
        return self

    def __exit__(self, *raised: Any) -> None:
        self._view.__exit__(*raised)

    def __call__(self, progress: Progress) -> None:
        """Takes note of a frame."""
        self._last, self.num_done, self._since = progress, progress.num_done, self._clock()
        if isinstance(self._view, _TerminalView):
            bar = self._view.task_ids[0]
            self._view.update(bar, completed=self.num_done, total=self.num_frames)

    @property
    def num_frames(self) -> int | None:
        """Frames in all, where known."""
        return (self._last and self._last.num_frames) or self._num_frames

    @property
    def is_last(self) -> bool:
        """Whether all frames are done."""
        return self.num_done > 0 and self.num_done == self.num_frames

    @property
    def has_begun(self) -> bool:
        """Whether a frame is done, so that more is known than for how long one waits."""
        return self._last is not None

    def doing(self) -> str:
        """Whose run it is, and what goes on if that is not simply the next frame."""
        waited_s = self._clock() - self._since
        if self.note:
            return f"{self._title}: {self.note}"
        if self._last is None:
            once = "(once; kept for later runs)"
            return f"{self._title}: preparing the tracker, {waited_s:.0f} s {once}"
        if self.is_last:
            return f"{self._title}: drawing, {waited_s:.0f} s"
        return self._title

    def facts(self) -> str:
        """Speed and what was found; of a frame that takes long, for how long."""
        if self._last is None:
            return ""
        last, waited_s = self._last, self._clock() - self._since
        long_s = max(_LONG_S, _LONG_FRAMES * last.ms_per_frame / 1000)
        if waited_s > long_s and not self.is_last:
            return f"frame {last.num_done + 1} takes {waited_s:.0f} s so far"
        return (
            f"{last.ms_per_frame:.0f} ms/frame, {last.num_identities} identities, "
            f"{100 * last.undecided_share:.0f} % uncertain"
        )


@contextlib.contextmanager
def follow_run(
    progress: Callable[[Progress], None] | bool | None, title: str, num_frames: int | None
) -> Iterator[Callable[[Progress], None] | None]:
    """What is called after every frame: the caller's function, the line, or nothing.

    Args:
      progress: A function; False for nothing; None or True for the line on terminals and in
        notebooks.
    """
    if callable(progress):
        yield progress
    elif progress is False:
        yield None
    else:
        with RunLine(title, num_frames) as line:
            yield line


class _Words(ProgressColumn):
    """A column that asks for its words every time that it is drawn, so that seconds tick."""

    def __init__(self, say: Callable[[], str]) -> None:
        super().__init__()
        self._say = say

    def render(self, task: Any) -> Text:
        """The words of now."""
        return Text(self._say(), no_wrap=True, overflow="ellipsis")


class _TerminalView(Bars):
    """A bar, drawn ten times a second; until the first frame is done, only words."""

    def __init__(self, line: RunLine) -> None:
        self._run_line = line
        super().__init__(
            _Words(line.doing),
            BarColumn(bar_width=_BAR_WIDTH),
            MofNCompleteColumn(),
            TimeRemainingColumn(compact=True),
            _Words(line.facts),
            console=Console(stderr=True),
            transient=True,
            # What others print goes above the line, unless it goes elsewhere.
            redirect_stdout=sys.stdout.isatty(),
        )
        self.add_task("", total=line.num_frames)

    def get_renderables(self) -> Iterator[Any]:
        """What is drawn now."""
        line = self._run_line
        if line.has_begun:
            yield self.make_tasks_table(self.tasks)
        else:
            yield Text(line.doing(), no_wrap=True, overflow="ellipsis")


class _NotebookView:
    """An output of the cell that is written anew until the run is over, and empty then."""

    def __init__(self, line: RunLine) -> None:
        self._line, self._over = line, threading.Event()
        self._thread = threading.Thread(target=self._refresh, name="remind-jax progress")

    def __enter__(self) -> None:
        display, page = _notebook_display()
        self._page = page
        self._handle = display(page(self._draw()), display_id=True)
        self._thread.start()

    def __exit__(self, *raised: Any) -> None:
        self._over.set()
        self._thread.join()
        self._handle.update(self._page(""))

    def _refresh(self) -> None:
        while not self._over.wait(_NOTEBOOK_REFRESH_S):
            self._handle.update(self._page(self._draw()))

    def _draw(self) -> str:
        line = self._line
        words = html.escape(f"{line.doing()} {line.facts()}".strip())
        if not line.has_begun:
            return f"<div>{words}</div>"
        if line.num_frames is None:
            return f"<div>{words}, {line.num_done} frames</div>"
        bar = f'<progress value="{line.num_done}" max="{line.num_frames}"></progress>'
        return f"<div>{bar} {line.num_done}/{line.num_frames} {words}</div>"


def _notebook_display() -> tuple[Any, Any]:
    from IPython.display import HTML, display  # pyright: ignore[reportMissingImports]

    return display, HTML


def _in_notebook() -> bool:
    """Whether this is a Jupyter kernel; nothing is imported to find out."""
    shell = getattr(sys.modules.get("IPython"), "get_ipython", lambda: None)()
    return type(shell).__name__ == "ZMQInteractiveShell"
