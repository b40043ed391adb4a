"""`remind view`: draws overlay and report of a run again."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg

from remind_jax.cli.flags import flags
from remind_jax.cli.summary import print_summary
from remind_jax.errors import SourceError
from remind_jax.files import refuse_file, refuse_folder


@flags
class View:
    """Draw overlay and report of a run again, finished or not.

    Frames are read where the run found them; without them the overlay stays.

    Examples:
      remind view runs/rooms
      remind view runs/rooms --source /new/place/rooms.mp4
    """

    run: Annotated[Positional[Path], arg(metavar="RUN")]  # output folder of a run
    source: Path | None = None  # where the frames are now, if they were moved
    quiet: bool = False  # say nothing but errors

    def execute(self) -> None:
        """Draws everything and prints the summary."""
        from remind_jax.outputs.result import Result
        from remind_jax.outputs.writer import FILE_NAMES, render_again
        from remind_jax.sources import open_source, reopen_source
        from remind_jax.sources.opening import NO_MASKS, read_arguments

        info = Result.load(self.run).info
        notes = []
        has_path = bool((info.source or {}).get("reopen"))
        if self.source is not None:
            refuse_folder(self.run, [self.source], may_hold=True)
            for name in FILE_NAMES:
                refuse_file(self.run / name, [self.source])
            # The same sampling at another place; masks are not needed.
            earlier = read_arguments(info.source or {}) if has_path else {"allow_size_change": True}
            kept = {name: earlier[name] for name in earlier if name not in ("spec", "metadata")}
            frames = open_source(self.source, **{**kept, "masks": NO_MASKS})
        else:
            try:
                frames = reopen_source(info.source or {"name": info.name})
            except SourceError as error:
                frames, notes = None, [f"drawn without the frames: {error}"]
        is_moved = self.source is not None and has_path
        result = render_again(self.run, frames, is_moved=is_moved)
        if not self.quiet:
            print_summary(result, self.run, notes)
