"""`remind eval`: scores any tracker's output against the truth."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from tyro.conf import Positional, UseAppendAction, arg

from remind_jax.cli.flags import flags
from remind_jax.errors import OptionError, RemindError
from remind_jax.files import check_place, refuse_file, writing
from remind_jax.files.limits import MAX_FRAMES
from remind_jax.printing.terminal import print_lines, print_table
from remind_jax.settings.ranges import check_option

if TYPE_CHECKING:
    from remind_jax.metrics import SetEvaluation

_MAX_RESAMPLES = 1_000_000
FormatName = Literal["mot", "mots", "kitti-mots", "davis", "coco-video", "cvat", "run"]


@flags
class Eval:
    """Score tracks of one or several trackers against ground truth.

    Numbers equal TrackEval's. Recovery: returns that got their identity back.

    Truth and predictions may be:
      MOTChallenge or MOTS text; COCO-video / YouTube-VIS JSON; CVAT XML;
      a folder of instance maps (DAVIS); an output folder of 'remind run';
      a folder with many scenes of these.

    Examples:
      remind eval gt.txt runs/rooms/mot.txt
      remind eval gt.txt pred.txt --format mots --json scores.json
      remind eval runs/rooms                      a run made with ground-truth masks
      remind eval DAVIS_ROOT runs/rooms --protocol paper
      remind eval DAVIS_ROOT runs/ours runs/theirs --table comparison.md
    """

    truth: Annotated[Positional[Path], arg(metavar="GT")]  # ground truth
    # predictions of any number of trackers
    predictions: Annotated[Positional[tuple[Path, ...]], arg(metavar="[PRED ...]")] = ()
    # of the predictions, and of text truth; recognized if left out
    format: FormatName | None = None
    truth_format: FormatName | None = None  # of the truth; recognized if left out
    # undecided detections of a run: without an id, or settled among their candidates
    undecided: Literal["strict", "collapse"] = "strict"
    # TrackEval's definitions, or the original evaluator's (every deviation is named)
    protocol: Literal["standard", "paper"] = "standard"
    num_frames: int | None = None  # text: length of the sequence; up to the last frame if left out
    class_id: int | None = None  # text: class to score; MOT: all, MOTS: 2 (pedestrian) if left out
    # processed frames out of view that make a return; 5, as in reports, suits truth with gaps where
    # a detector missed something
    min_absence_frames: int = 1
    # also score every class apart (in --json), where both sides name classes
    by_class: bool = False
    json: Path | None = None  # also write every field to this file
    # also write the table: .md, .csv, .txt
    table: Annotated[UseAppendAction[tuple[tuple[Path, ...], ...]], arg(metavar="FILE ...")] = ()
    resamples: int = 1000  # draws of the bootstrap intervals in tables; 0 for none
    quiet: bool = False  # print no table

    def execute(self) -> None:
        """Scores, prints and writes."""
        from remind_jax.metrics.comparison import check_table_place
        from remind_jax.metrics.scene_evaluation import table_of

        check_option("resamples", self.resamples, 0, _MAX_RESAMPLES)
        check_option("min_absence_frames", self.min_absence_frames, 1, MAX_FRAMES)
        for path in (*self._table_files, *([] if self.json is None else [self.json])):
            refuse_file(path, (self.truth, *self.predictions), is_read=_may_be_tracks)
            (check_place if path == self.json else check_table_place)(path)
        if self.protocol == "paper":
            self._execute_paper()
            return
        evaluations = self._evaluate()
        if self.json is not None:
            content = {"predictions": {e.name: e.to_json() for e in evaluations}}
            _write_json(self.json, content if len(evaluations) > 1 else evaluations[0].to_json())
        if self.table or (len(evaluations) > 1 and not self.quiet):
            table = table_of(evaluations, num_resamples=self.resamples, title=self.truth.name)
            for path in self._table_files:
                table.save(path)
            if len(evaluations) > 1 and not self.quiet:
                table.print()
        if len(evaluations) == 1 and not self.quiet:
            print_evaluation(evaluations[0])

    @property
    def _table_files(self) -> tuple[Path, ...]:
        return tuple(path for group in self.table for path in group)

    def _execute_paper(self) -> None:
        from remind_jax.metrics.paper_evaluation import evaluate_paper, paper_table
        from remind_jax.metrics.scene_evaluation import SceneOptions, name_predictions

        for option in dataclasses.fields(SceneOptions):
            if getattr(self, option.name) != option.default:
                why = f"'{option.name}' is of the standard protocol; leave it out"
                raise OptionError(why, option.name)
        if not self.predictions:
            raise RemindError("--protocol paper needs predictions; name them after the truth")
        formats: dict[str, Any] = {"format": self.format, "truth_format": self.truth_format}
        evaluations = [
            evaluation
            for name, path in name_predictions(self.predictions).items()
            for evaluation in evaluate_paper(self.truth, path, name=name, **formats)
        ]
        title = f"{self.truth.name}, the paper's protocol"
        table = paper_table(evaluations, num_resamples=self.resamples, title=title)
        if self.json is not None:
            by_name = {e.name: e.to_json() for e in evaluations}
            content = evaluations[0].to_json() if len(self.predictions) == 1 else {}
            _write_json(self.json, {**content, "predictions": by_name})
        for path in self._table_files:
            table.save(path)
        if not self.quiet:
            table.print()

    def _evaluate(self) -> list[SetEvaluation]:
        from remind_jax.metrics.scene_evaluation import SceneOptions, evaluate, name_predictions

        names = [field.name for field in dataclasses.fields(SceneOptions)]
        options = SceneOptions(**{name: getattr(self, name) for name in names})
        if not self.predictions:
            options.check_used_by("run", "run")
            return [self._evaluate_alone()]
        formats: dict[str, Any] = {"format": self.format, "truth_format": self.truth_format}
        return [
            evaluate(self.truth, path, name=name, options=options, **formats)
            for name, path in name_predictions(self.predictions).items()
        ]

    def _evaluate_alone(self) -> SetEvaluation:
        """Scores a run by the true instances that it was given."""
        from remind_jax.metrics import SetEvaluation, evaluate_tracks
        from remind_jax.metrics.run_folder import holds_run
        from remind_jax.outputs.result import Result

        if self.truth.exists() and not holds_run(self.truth):
            raise RemindError(
                f"there are no predictions to score against '{self.truth}'; name them after the "
                "truth (only a run that was made with ground-truth masks is scored alone)"
            )
        run = Result.load(self.truth)
        evaluation = evaluate_tracks(
            run.tracks,
            undecided=self.undecided,
            by_class=self.by_class,
            min_absence_frames=self.min_absence_frames,
            name=run.info.name,
        )
        return SetEvaluation(self.truth.name, (evaluation,))


def _may_be_tracks(name: str) -> bool:
    """Whether a file of this name in a folder may be one that is scored."""
    from remind_jax.outputs.writer import FILE_NAMES

    return name in FILE_NAMES or name.lower().endswith((".txt", ".png"))


def print_evaluation(evaluation: SetEvaluation) -> None:
    """Prints the main scores of one set of predictions, and what went wrong."""
    from remind_jax.metrics.evaluation import show_scores

    shown = show_scores(evaluation.scores())
    print_table([shown["heads"], *shown["rows"]], is_text=shown["is_text"])
    lines = [f"note: {note}" for note in evaluation.notes]
    if evaluation.failed:
        reasons = [f"  {scene}: {why}" for scene, why in evaluation.failed.items()]
        lines = [f"{evaluation.failure_note}:", *reasons, *lines]
    elif evaluation.num_scenes > 1:
        lines = [f"{evaluation.num_scenes} scenes, counts added", *lines]
    print_lines(*lines)


def _write_json(path: Path, content: dict[str, Any]) -> None:
    with writing(path):
        path.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
