"""How Ctrl-C and other signals end a run well, and what is seen of a sweep."""

from __future__ import annotations

import contextlib
import signal
from collections.abc import Callable, Iterator
from types import FrameType
from typing import TYPE_CHECKING, Any

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.progress import Progress as Bars

from remind_jax.cli.process import ending_signals, handling
from remind_jax.session.progress import Progress, RunLine

if TYPE_CHECKING:
    from remind_jax.sweeps.worker import Progress as SweepProgress


class RunDisplay(RunLine):
    """The line of a run, and its Ctrl-C; hand it to `run` as `progress`.

    The first Ctrl-C, SIGTERM or SIGHUP ends the run after the frame in work, so that everything
    done is written and the memory is whole; the second ends it at once.

    Attributes:
      signal: What asked the run to stop; None if nothing did.
      on_stop: Called then, so that nothing is waited for in vain.
    """

    def __init__(self, title: str, num_frames: int | None, is_shown: bool) -> None:
        super().__init__(title, num_frames, is_shown=is_shown)
        self.signal: int | None = None
        self.on_stop: Callable[[], None] = lambda: None

    def __enter__(self) -> RunDisplay:
        self._handled = contextlib.ExitStack()
        self._handled.enter_context(handling({signal.SIGINT, *ending_signals()}, self._stop))
        super().__enter__()
        return self

    def __exit__(self, *raised: Any) -> None:
        with self._handled:
            super().__exit__(*raised)

    def __call__(self, progress: Progress) -> None:
        """Takes note of a frame.

        Raises:
          KeyboardInterrupt: If the run was asked to stop since the last one.
        """
        super().__call__(progress)
        if self.signal is not None and not self.is_last:
            raise KeyboardInterrupt

    def _stop(self, number: int, frame: FrameType | None) -> None:
        if self.signal is not None:
            raise KeyboardInterrupt
        self.signal = number
        self.note = "stopping after this frame"
        self.on_stop()


@contextlib.contextmanager
def follow_sweep(is_shown: bool) -> Iterator[Callable[[SweepProgress], None]]:
    """A progress bar on a terminal, silence elsewhere; gives what is told of rows."""
    console = Console(stderr=True)
    with Bars(
        TextColumn("{task.description}"),
        BarColumn(bar_width=24),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TimeRemainingColumn(compact=True),
        console=console,
        disable=not (is_shown and console.is_terminal),
        transient=True,
    ) as bars:
        task = bars.add_task("reading scenes, compiling", total=None)

        def follow(progress: SweepProgress) -> None:
            bars.update(
                task,
                completed=progress.num_done,
                total=progress.num_rows,
                description=f"settings x scenes: {progress.scene}",
            )

        yield follow
