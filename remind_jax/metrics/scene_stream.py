"""Goes through the scenes of truth and predictions; one that fails is kept with the reason."""

from __future__ import annotations

import dataclasses
import posixpath
from collections.abc import Callable, Mapping, Sized
from pathlib import Path
from typing import Any, TypeVar

from remind_jax.errors import RemindError, SourceError, nearest_names
from remind_jax.metrics.comparison import Row
from remind_jax.metrics.opening import (
    FORMATS,
    TEXT_FORMATS,
    Format,
    SceneSet,
    is_blank,
    open_scenes,
)
from remind_jax.printing.small_table import Printable
from remind_jax.printing.words import first_of, plural

Score = TypeVar("Score")

# Scenes that share a note are named up to this number, counted above it.
MAX_NAMED = 3


@dataclasses.dataclass(frozen=True, repr=False)
class SceneScores(Printable):
    """One set of predictions: its scenes, and those that could not be scored."""

    name: str
    scenes: Sized
    failed: Mapping[str, str] = dataclasses.field(default_factory=dict)  # scene: why
    notes: tuple[str, ...] = ()

    @property
    def num_scenes(self) -> int:
        """All scenes, those that failed too."""
        return len(self.scenes) + len(self.failed)

    @property
    def failure_note(self) -> str:
        """How many scenes failed; nothing if none did."""
        return f"{len(self.failed)} of {self.num_scenes} scenes failed" if self.failed else ""

    def list_failed(self) -> list[str]:
        """A sentence for every scene that failed."""
        return [f"{self.name}: scene '{s}' failed: {why}" for s, why in self.failed.items()]

    def scene_counts(self) -> dict[str, float]:
        """How many scenes there are and how many failed, as scores."""
        return {"Scenes": float(self.num_scenes), "FailedScenes": float(len(self.failed))}

    def notes_json(self) -> dict[str, Any]:
        """`failed` and `notes`, where there are any, for JSON."""
        known = {"failed": dict(self.failed), "notes": list(self.notes)}
        return {name: value for name, value in known.items() if value}


def row_of(scored: Any, num_resamples: int, *notes: str) -> Row:
    """The row of a `SceneScores` in a table, with intervals where there are resamples."""
    intervals = scored.intervals(num_resamples=num_resamples) if num_resamples else {}
    note = "; ".join(filter(None, (*notes, scored.failure_note)))
    return Row(scored.name, scored.scores(), intervals, note, is_partial=bool(scored.failed))


@dataclasses.dataclass(frozen=True)
class SceneStream:
    """Truth and predictions of the same scenes, matched by name but not yet read."""

    truth: SceneSet
    predictions: SceneSet
    partner: Mapping[str, str | None]  # scene of the truth: scene of the predictions, if any
    notes: tuple[str, ...]
    name: str  # of the predictions

    def score(
        self, score_scene: Callable[[str, str], tuple[Score, list[str]]]
    ) -> tuple[dict[str, Score], dict[str, str], tuple[str, ...]]:
        """Scores all scenes, each by its names in the truth and in the predictions.

        Given are results by scene, why others failed by scene, and notes; by `score_scene` a
        result and notes.

        Raises:
          RemindError: What a scene raised, if it is the only one.
          SourceError: If every scene failed.
        """
        results: dict[str, Score] = {}
        failed: dict[str, str] = {}
        said = list(self.notes)
        scenes_of: dict[str, list[str]] = {}  # by note
        is_alone = len(self.partner) == 1
        for scene, predicted in self.partner.items():
            if predicted is None:
                failed[scene] = "there is no prediction of this scene"
                continue
            try:
                results[scene], notes = score_scene(scene, predicted)
            except RemindError as error:
                if is_alone:
                    raise
                failed[scene] = str(error)
                continue
            for note in notes:
                scenes_of.setdefault(note, []).append(scene)
        for note, scenes in scenes_of.items():
            few = len(scenes) <= MAX_NAMED
            where = ", ".join(scenes) if few else f"{len(scenes)} scenes"
            said.append(note if is_alone else f"{where}: {note}")
        if not results:
            scene, why = next(iter(failed.items()), ("", "there is no scene"))
            raise SourceError(f"none of {len(failed)} scenes could be scored; '{scene}': {why}")
        return results, failed, tuple(said)


def open_stream(
    truth: str | Path | SceneSet,
    prediction: str | Path,
    *,
    format: Format | None = None,
    truth_format: Format | None = None,
    name: str | None = None,
) -> SceneStream:
    """Opens both sides and matches their scenes; arguments are those of `evaluate`.

    Raises:
      RemindError: If a format is unknown.
      SourceError: If a side cannot be read or is not recognized.
    """
    for given in (format, truth_format):
        if given is not None and given not in FORMATS:
            raise RemindError(f"format is '{given}'; {nearest_names(given, FORMATS)}")
    if not isinstance(truth, SceneSet):
        truth = _open_truth(truth, prediction, format, truth_format)
    like: Any = truth.format if truth.format in TEXT_FORMATS else None
    predictions = open_scenes(prediction, format, truth=truth, like=like)
    mixed = {truth.format, predictions.format} == {"mots", "kitti-mots"}
    late, said = (truth, truth_format) if truth.format == "mots" else (predictions, format)
    guess = []
    if mixed and said is None:
        # One side has a frame 0, so both count from 0: the other begins without any object.
        truth = open_scenes(truth.path, "kitti-mots")
        predictions = open_scenes(prediction, "kitti-mots", truth=truth)
        guess.append(
            f"'{late.path}' has no frame 0 and the other side has one, so both are taken to count "
            "from 0; if it counts from 1, as mots.txt of a run does, give the formats of both"
        )
    partner, notes = match_scenes(truth, predictions)
    name = name or path_name(Path(prediction))
    return SceneStream(truth, predictions, partner, (*guess, *notes), name)


def match_scenes(truth: SceneSet, predictions: SceneSet) -> tuple[dict[str, str | None], list[str]]:
    """The prediction of each scene of the truth, None without one; and notes about the others.

    Raises:
      SourceError: If no scene has one.
    """
    if len(truth.files) == len(predictions.files) == 1:
        return dict(zip(truth.files, predictions.files, strict=True)), []
    known = {posixpath.basename(name): name for name in predictions.files}
    partner = {
        scene: scene if scene in predictions.files else known.get(posixpath.basename(scene))
        for scene in truth.files
    }
    if not any(partner.values()):
        theirs, ours = (first_of([*side.files], MAX_NAMED) for side in (predictions, truth))
        raise SourceError(
            f"'{predictions.path}' predicts no scene of '{truth.path}': it holds {theirs}, and the "
            f"truth {ours}; name its files or folders as the scenes of the truth"
        )
    extra = sorted(set(predictions.files) - set(partner.values()))
    notes = []
    if extra:
        shown = ", ".join(extra[:3]) + (", ..." if len(extra) > 3 else "")
        are = "is" if len(extra) == 1 else "are"
        notes.append(f"{plural(len(extra), 'predicted scene')} {are} not in the truth: {shown}")
    return partner, notes


def path_name(path: Path) -> str:
    """What predictions at a path are called: the folder's name, or the file's without ending."""
    return (path.stem if path.suffix.lower() in (".txt", ".json") else path.name) or str(path)


def _open_truth(
    truth: str | Path, prediction: str | Path, format: Format | None, truth_format: Format | None
) -> SceneSet:
    """Opens truth; text is as was said of predictions, empty text of the format that they have."""
    opened = open_scenes(truth, truth_format)
    if truth_format is not None or opened.format not in TEXT_FORMATS:
        return opened
    if format is None and all(map(is_blank, opened.files.values())):
        format = open_scenes(prediction, truth=opened).format
    return open_scenes(truth, format) if format in TEXT_FORMATS else opened
