"""`remind export`: a run for labeling tools."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import Positional, arg

from remind_jax.cli import process
from remind_jax.cli.flags import quiet_defaults
from remind_jax.errors import OutputError
from remind_jax.files import refuse_file
from remind_jax.printing.terminal import print_lines


@quiet_defaults
@dataclasses.dataclass(frozen=True)
class Export:
    """Write a run for a labeling tool, to be corrected there and scored against here.

    Examples:
      remind export runs/rooms --format cvat
      remind export runs/rooms --format mots-png -o rooms.zip
    """

    run: Annotated[Positional[Path], arg(metavar="RUN")]  # output folder of a run
    # cvat: XML of CVAT for video; mots-png: zip of instance maps
    format: Annotated[Literal["cvat", "mots-png"], arg(metavar="NAME")] = "cvat"
    # file to write; cvat.xml or mots_png.zip in the folder RUN if left out
    out: Annotated[Path | None, arg(aliases=["-o"])] = None
    overwrite: bool = False  # replace an existing file
    quiet: bool = False  # say nothing but errors

    def execute(self) -> int:
        """Reads the run and writes the file; returns the exit code."""
        from remind_jax.outputs.labeling import FILE_NAMES, export
        from remind_jax.outputs.result import Result

        out = self.out or self.run / FILE_NAMES[self.format]
        if out.exists() and not self.overwrite:
            raise OutputError(f"'{out}' exists; name another file, or allow --overwrite")
        if out.name not in FILE_NAMES.values():
            refuse_file(out, [self.run])
        result = Result.load(self.run)
        export(result, self.format, out)
        if not self.quiet:
            print_lines([f"{out}: {len(result.objects())} identities, {len(result)} frames"])
        return process.FINE
