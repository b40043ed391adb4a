"""`remind label`: a page to correct the identities of a run, and the truth that it makes of it."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg

from remind_jax.cli.flags import flags
from remind_jax.errors import OptionError, OutputError
from remind_jax.files import refuse_file, refuse_folder, remove_unfinished, replace_file
from remind_jax.printing.terminal import print_lines
from remind_jax.printing.words import plural


@flags
class Label:
    """Correct the identities of a run by hand, and write them as truth.

    Two steps:
      without --apply   writes RUN/label.html, a page to correct identities in
      with --apply      makes truth for `remind eval` of the edits saved there

    Examples:
      remind label runs/rooms
      remind label runs/rooms --apply edits.json --out truth
      remind label runs/rooms --apply edits.json --out truth.xml
    """

    run: Annotated[Positional[Path], arg(metavar="RUN")]  # output folder of a run
    apply: Annotated[Path | None, arg(metavar="EDITS")] = None  # what the page saved
    # folder of instance maps with classes, or a file .xml as `remind export` writes
    out: Annotated[Path | None, arg(aliases=["-o"], metavar="TRUTH")] = None
    overwrite: bool = False  # replace what is there
    quiet: bool = False  # say nothing but errors

    def execute(self) -> None:
        """Writes the page or the truth."""
        if self.apply is None:
            if self.out is not None:
                raise OptionError(
                    "'out' is where the truth goes, which the edits make of the run; give --apply "
                    "EDITS too",
                    "out",
                )
            if self.overwrite:
                reason = "'overwrite' is for the truth; give --apply EDITS too"
                raise OptionError(reason, "overwrite")
            self._write_page()
        elif self.out is None:
            raise OptionError(f"'{self.apply}' is to be applied; say where to, by --out", "out")
        else:
            self._write_truth(self.apply, self.out)

    def _write_page(self) -> None:
        from remind_jax.outputs.label_edits import write_label_page

        page, result = write_label_page(self.run)
        if not self.quiet:
            num = sum(len(tracks) for tracks in result.tracks)
            identities = plural(len(result.objects()), "identity", "identities")
            print_lines(
                f"{page}: {identities}, {plural(num, 'detection')}; open it in a browser, and "
                "apply what it saves with --apply"
            )
            if not result.complete:
                print_lines(
                    "the run is not complete, and corrections are of this part of it only; go on "
                    "with it (--resume) first"
                )

    def _write_truth(self, edits_file: Path, out: Path) -> None:
        from remind_jax.formats.cvat import to_cvat
        from remind_jax.formats.instance_maps import write_instance_maps
        from remind_jax.outputs.label_edits import apply_edits, read_edits
        from remind_jax.outputs.result import Result

        is_folder = out.suffix.lower() != ".xml"
        (refuse_folder if is_folder else refuse_file)(out, [self.run, edits_file])
        if is_folder and out.is_dir():
            remove_unfinished(out)
        if out.exists() and not self.overwrite and not _is_empty(out):
            raise OutputError(f"'{out}' exists; name another place, or allow --overwrite")
        edits = read_edits(edits_file)
        truth = apply_edits(Result.load(self.run), edits, str(edits_file))
        if is_folder:
            write_instance_maps(truth.tracks, truth.info.name, out)
        else:
            info = truth.info
            replace_file(out, to_cvat(truth.tracks, info.name, truth.class_names, info.frame_size))
        if not self.quiet:
            num = len(truth.objects())
            print_lines(f"{out}: {num} identities, {len(truth)} frames, {len(edits.edits)} edits")


def _is_empty(path: Path) -> bool:
    """Whether it is a folder in which, and below which, no files are."""
    return path.is_dir() and not any(not below.is_dir() for below in path.rglob("*"))
