"""What a person corrected in a run: the page for it, the file of edits, and what they leave.

Rules: evaluation.md#labeling, evaluation.md#edits.
"""

from __future__ import annotations

import dataclasses
import zlib
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Literal

import msgspec
import numpy as np
from jaxtyping import Int
from msgspec import Meta

from remind_jax import files
from remind_jax.decision import NO_ID, Outcome, Reason
from remind_jax.errors import SourceError
from remind_jax.files.records import Count, Text, read_json
from remind_jax.formats.firm import firm_ids, main_labels
from remind_jax.outputs import report
from remind_jax.outputs.result import Result
from remind_jax.tracks import Tracks

MAX_EDITS = 1_000_000

Labels = list[Int[np.ndarray, "_"]]  # identity of each detection of each frame, NO_ID for none

LABEL_PAGE_NAME = "label.html"
_SCRIPTS = (report.SCRIPT_NAME, "label_page.js")


class _Edit(msgspec.Struct, tag_field="edit", forbid_unknown_fields=True, frozen=True):
    """One correction."""


class Merge(_Edit, tag="merge", frozen=True):
    """All detections of an identity belong to another one."""

    id: Count
    into: Count


class Move(_Edit, tag="move", frozen=True):
    """The detections of an identity in some frames belong to another one, or to none."""

    id: Count
    first: Count  # numbers of frames, both included
    last: Count
    to: Count | None


class Assign(_Edit, tag="assign", frozen=True):
    """One detection belongs to an identity, or to none."""

    frame: Count
    detection: Count  # row in its frame
    to: Count | None


Edit = Merge | Move | Assign


class Edits(msgspec.Struct, forbid_unknown_fields=True, frozen=True):
    """A file of edits."""

    format: Literal["remind-jax edits"]
    version: Literal[1]
    run: Text  # name of the run
    num_detections: Count  # of the whole run: whether the file is of this run
    edits: Annotated[list[Edit], Meta(max_length=MAX_EDITS)]
    labels: Text = ""  # `digest` of the labels that they change; earlier files have none


def read_edits(path: str | Path) -> Edits:
    """Reads what the labeling page saved."""
    return read_json(path, Edits)


def first_labels(run: Sequence[Tracks]) -> Labels:
    """The labels of a run before any edit; an identity given twice in a frame labels one."""
    return [firm_ids(tracks) for tracks in run]


def digest(labels: Labels) -> str:
    """Tells runs apart that found the same detections and decided otherwise."""
    return f"{zlib.crc32(repr([label.tolist() for label in labels]).encode()):08x}"


def apply_edits(result: Result, edits: Edits, where: str) -> Result:
    """The run as its edits leave it: labeled detections are firm, all others have no identity.

    The class of an identity is that of most of its detections.

    Raises:
      SourceError: If the edits are of another run, name what is not there, or leave an identity
        twice in a frame.
    """
    num = sum(len(tracks) for tracks in result.tracks)
    if edits.num_detections != num:
        raise SourceError(
            f"'{where}' was made for a run of {edits.num_detections} detections ('{edits.run}'), "
            f"this one has {num}; give the run that was labeled"
        )
    labels = first_labels(result.tracks)
    if edits.labels not in ("", digest(labels)):
        raise SourceError(
            f"'{where}' was made for a run ('{edits.run}') with other identities than this one; "
            "give the run that was labeled, or label this one"
        )
    place = {tracks.frame_index: index for index, tracks in enumerate(result.tracks)}
    for number, edit in enumerate(edits.edits, 1):
        if not _apply(edit, labels, place):
            raise SourceError(
                f"'{where}', edit {number} ({_say(edit)}): there is no such detection then; save "
                "the edits anew from the labeling page"
            )
    for tracks, label in zip(result.tracks, labels, strict=True):
        _check_once(tracks, label, where)
    classes = main_labels(result.tracks, labels)
    labeled = tuple(
        _relabeled(tracks, label, classes)
        for tracks, label in zip(result.tracks, labels, strict=True)
    )
    return dataclasses.replace(result, tracks=labeled, trace=None)


def _apply(edit: Edit, labels: Labels, place: dict[int, int]) -> bool:
    """Changes the labels; False if there is nothing that the edit speaks of."""
    if isinstance(edit, Assign):
        label = labels[place[edit.frame]] if edit.frame in place else np.zeros(0, np.int64)
        if edit.detection >= len(label):
            return False
        label[edit.detection] = NO_ID if edit.to is None else edit.to
        return True
    if isinstance(edit, Merge):
        first, last, to = 0, max(place, default=0), edit.into
    else:
        first, last, to = edit.first, edit.last, NO_ID if edit.to is None else edit.to
    found = False
    for frame, index in place.items():
        if first <= frame <= last:
            rows = labels[index] == edit.id
            labels[index][rows] = to
            found = found or bool(rows.any())
    return found


def _say(edit: Edit) -> str:
    if isinstance(edit, Merge):
        return f"identity {edit.id} into {edit.into}"
    if isinstance(edit, Move):
        return f"identity {edit.id} in frames {edit.first} to {edit.last}"
    return f"detection {edit.detection} of frame {edit.frame}"


def _check_once(tracks: Tracks, label: np.ndarray, where: str) -> None:
    given, counts = np.unique(label[label != NO_ID], return_counts=True)
    if (counts > 1).any():
        twice = int(given[counts > 1][0])
        rows = " and ".join(str(row) for row in np.flatnonzero(label == twice)[:2])
        raise SourceError(
            f"'{where}' leaves identity {twice} twice in frame {tracks.frame_index} (detections "
            f"{rows}); correct it in the labeling page, which lists such frames"
        )


def _relabeled(tracks: Tracks, label: np.ndarray, classes: dict[int, str]) -> Tracks:
    is_labeled = label != NO_ID
    return dataclasses.replace(
        tracks,
        object_id=label.astype(tracks.object_id.dtype),
        outcome=np.where(is_labeled, Outcome.MATCH, Outcome.DROPPED).astype(tracks.outcome.dtype),
        reason=np.full_like(tracks.reason, Reason.ASSIGNED),
        pending_id=np.full_like(tracks.pending_id, NO_ID),
        score=np.where(is_labeled, 1.0, 0.0).astype(tracks.score.dtype),
        confidence=np.where(is_labeled, 1.0, 0.0).astype(tracks.confidence.dtype),
        candidate_id=np.full_like(tracks.candidate_id, NO_ID),
        candidate_score=np.zeros_like(tracks.candidate_score),
        labels=tuple(
            classes[int(one)] if one != NO_ID else own
            for one, own in zip(label, tracks.labels, strict=True)
        ),
    )


def write_label_page(folder: str | Path) -> tuple[Path, Result]:
    """Writes the labeling page into the folder of a run, with its pictures; gives page and run.

    Raises:
      OutputError: If the folder holds no run, or the page cannot be written.
    """
    folder = Path(folder)
    # Why it was decided so does not matter here, and makes a large page.
    result = dataclasses.replace(Result.load(folder), trace=None)
    sightings = report.read_sightings(folder / report.REPORT_NAME)
    labels = first_labels(result.tracks)
    data = report.report_data(result, sightings, report.video_address(folder)) | {
        "labeling": {
            "run": result.info.name,
            "num_detections": sum(len(label) for label in labels),
            "labels": [label.tolist() for label in labels],
            "digest": digest(labels),
            "classes": [list(tracks.labels) for tracks in result.tracks],
            "boxes": [tracks.boxes.round().astype(int).tolist() for tracks in result.tracks],
            "sizes": [list(tracks.frame_size) for tracks in result.tracks],
        }
    }
    page = folder / LABEL_PAGE_NAME
    text = report.render_page(f"{result.info.name}: labels", data, _SCRIPTS)
    files.replace_file(page, text.encode("utf-8"))
    return page, result
