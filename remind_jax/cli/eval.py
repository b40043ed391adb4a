"""`remind eval`: scores any tracker's output against the truth."""

from __future__ import annotations

import dataclasses
import json
import math
from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import Positional, arg

from remind_jax.cli import exit_codes
from remind_jax.errors import OutputError

_SHOWN = ("HOTA", "DetA", "AssA", "LocA", "MOTA", "IDF1", "IDP", "IDR", "Recovery", "HardRecovery")
_COUNTED = ("IDSW", "Frag", "MT", "PT", "ML", "GT_IDs", "IDs", "GT_Dets", "Dets", "Frames")


@dataclasses.dataclass(frozen=True)
class Eval:
    """Score a file of tracks against a file of ground truth with the standard metrics.

    Numbers equal TrackEval's. Recovery: returns that got their identity back.

    Examples:
      remind eval gt.txt runs/rooms/mot.txt
      remind eval gt.txt pred.txt --format mots --json scores.json
    """

    truth: Annotated[Positional[Path], arg(metavar="GT")]  # ground truth
    prediction: Annotated[Positional[Path], arg(metavar="PRED")]  # in the same format
    format: Literal["mot", "mots", "kitti-mots"] | None = None  # recognised if left out
    num_frames: int | None = None  # length of the sequence; up to the last frame if left out
    class_id: int | None = None  # class to score; MOT: all, MOTS: 2 (pedestrian) if left out
    json: Path | None = None  # also write every field to this file
    quiet: bool = False  # print no table

    def execute(self) -> int:
        """Scores, prints and writes; returns the exit code.

        Raises:
          RemindError: If a file cannot be read, or the result not be written.
        """
        from remind_jax.metrics import evaluate_files

        evaluation = evaluate_files(
            self.truth,
            self.prediction,
            format=self.format,
            num_frames=self.num_frames,
            class_id=self.class_id,
        )
        if self.json is not None:
            try:
                self.json.write_text(json.dumps(evaluation.to_json(), indent=1) + "\n")
            except OSError as error:
                raise OutputError(f"cannot write '{self.json}': {error.strerror}") from error
        if not self.quiet:
            print_scores(evaluation.scores())
        return exit_codes.FINE


def print_scores(scores: dict[str, float]) -> None:
    """Prints the main scores in percent and the main counts."""
    from rich.console import Console
    from rich.table import Table

    table = Table()
    for heading in ("score", "count"):
        table.add_column(heading)
        table.add_column("", justify="right")
    for score, count in zip(_SHOWN, _COUNTED, strict=True):
        value = "-" if math.isnan(scores[score]) else f"{100 * scores[score]:.2f} %"
        table.add_row(score, value, count, f"{scores[count]:.0f}")
    Console().print(table)
