"""`remind export`: a run for a labeling tool."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg

from remind_jax.cli.flags import flags
from remind_jax.errors import OutputError
from remind_jax.files import refuse_file, replace_file
from remind_jax.printing.terminal import print_lines
from remind_jax.printing.words import plural


@flags
class Export:
    """Write a run for CVAT (for video), to be corrected there and scored against here.

    Examples:
      remind export runs/rooms
      remind export runs/rooms -o rooms.xml
    """

    run: Annotated[Positional[Path], arg(metavar="RUN")]  # output folder of a run
    # file to write; cvat.xml in the folder RUN if left out
    out: Annotated[Path | None, arg(aliases=["-o"])] = None
    overwrite: bool = False  # replace an existing file
    quiet: bool = False  # say nothing but errors

    def execute(self) -> None:
        """Reads the run and writes the file."""
        from remind_jax.formats.cvat import to_cvat
        from remind_jax.outputs.result import Result
        from remind_jax.outputs.writer import CVAT_NAME

        out = self.out or self.run / CVAT_NAME
        if out.exists() and not self.overwrite:
            raise OutputError(f"'{out}' exists; name another file, or allow --overwrite")
        if out.name != CVAT_NAME:
            refuse_file(out, [self.run])
        result = Result.load(self.run)
        replace_file(
            out,
            to_cvat(result.tracks, result.info.name, result.class_names, result.info.frame_size),
        )
        if not self.quiet:
            num = plural(len(result.objects()), "identity", "identities")
            print_lines(f"{out}: {num}, {plural(len(result), 'frame')}")
