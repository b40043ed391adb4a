"""What a user sees while a run goes on, and how Ctrl-C ends it well."""

from __future__ import annotations

import signal
import threading
from types import FrameType, TracebackType
from typing import TYPE_CHECKING, Any

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    TextColumn,
    TimeRemainingColumn,
)
from rich.progress import Progress as Bars

if TYPE_CHECKING:
    from remind_jax.session import Progress
    from remind_jax.sweep.worker import Progress as SweepProgress


class RunDisplay:
    """Progress bar on a terminal, silence elsewhere; hand it to `run` as `progress`.

    The first Ctrl-C ends the run after the frame in work, so that everything done is written and
    the memory is whole; the second ends it at once.
    """

    def __init__(self, title: str, num_frames: int | None, is_shown: bool) -> None:
        console = Console(stderr=True)
        self.num_done = 0  # frames
        self.stop_requested = False
        self._num_frames = num_frames
        self._title = title
        self._bars = Bars(
            TextColumn("{task.description}"),
            BarColumn(bar_width=24),
            MofNCompleteColumn(),
            TimeRemainingColumn(compact=True),
            TextColumn("{task.fields[facts]}"),
            console=console,
            disable=not (is_shown and console.is_terminal),
            transient=True,
        )
        self._task = self._bars.add_task(
            f"{title}: compiling, once per frame size", total=num_frames, facts=""
        )

    def __enter__(self) -> RunDisplay:
        self._former: Any = None
        if threading.current_thread() is threading.main_thread():
            self._former = signal.signal(signal.SIGINT, self._on_interrupt)
        self._bars.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        tb: TracebackType | None,
    ) -> None:
        self._bars.stop()
        if self._former is not None:
            signal.signal(signal.SIGINT, self._former)

    def __call__(self, progress: Progress) -> None:
        """Takes note of a frame.

        Raises:
          KeyboardInterrupt: If Ctrl-C was pressed since the last one.
        """
        self.num_done = progress.num_done
        total = progress.num_frames or self._num_frames
        is_last = progress.num_done == total
        self._bars.update(
            self._task,
            completed=progress.num_done,
            total=total,
            description=f"{self._title}: drawing" if is_last else self._title,
            facts=(
                f"{progress.ms_per_frame:.0f} ms/frame, {progress.num_identities} identities, "
                f"{100 * progress.undecided_share:.0f} % uncertain"
            ),
        )
        if self.stop_requested and not is_last:
            raise KeyboardInterrupt

    def _on_interrupt(self, number: int, frame: FrameType | None) -> None:
        if self.stop_requested:
            raise KeyboardInterrupt
        self.stop_requested = True
        self._bars.update(self._task, description=f"{self._title}: stopping after this frame")


class SweepDisplay:
    """Progress bar of a sweep on a terminal, silence elsewhere."""

    def __init__(self, is_shown: bool) -> None:
        console = Console(stderr=True)
        self._bars = Bars(
            TextColumn("{task.description}"),
            BarColumn(bar_width=24),
            MofNCompleteColumn(),
            TimeRemainingColumn(compact=True),
            console=console,
            disable=not (is_shown and console.is_terminal),
            transient=True,
        )
        self._task = self._bars.add_task("reading scenes, compiling", total=None)

    def __enter__(self) -> SweepDisplay:
        self._bars.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        tb: TracebackType | None,
    ) -> None:
        self._bars.stop()

    def __call__(self, progress: SweepProgress) -> None:
        """Takes note of rows."""
        self._bars.update(
            self._task,
            completed=progress.num_done,
            total=progress.num_rows,
            description=f"settings x scenes: {progress.scene}",
        )
