"""The output folder of a run, written while the run goes on and finished whatever happens."""

from __future__ import annotations

import contextlib
import dataclasses
import pickle
import tempfile
import weakref
from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np

from remind_jax import files
from remind_jax.errors import OutputError
from remind_jax.explanation.archive import TRACE_NAME
from remind_jax.files import writing
from remind_jax.frame import UNTIMED_FPS, Frame
from remind_jax.outputs import gallery, overlay, report, store, tables
from remind_jax.outputs.label_edits import LABEL_PAGE_NAME
from remind_jax.outputs.mcap_record import McapRecord
from remind_jax.outputs.overlay import OVERLAY_NAME
from remind_jax.outputs.result import Result
from remind_jax.outputs.run_records import RunInfo
from remind_jax.tracks import Tracks


class KeptTracks:
    """A list of frames on disk, that can be added to and gone through.

    They are in a file without a name, which is gone with the process that wrote it, so that nothing
    but this object ever reads it.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._num = 0
        with writing(folder):
            self._file = tempfile.TemporaryFile(dir=folder)  # noqa: SIM115
        weakref.finalize(self, self._file.close)

    def append(self, tracks: Tracks) -> None:
        """Adds a frame. Raises OutputError if the disk is full."""
        self._num += 1
        with writing(self._folder):
            self._file.seek(0, 2)
            pickle.dump(tracks, self._file, pickle.HIGHEST_PROTOCOL)

    def __iter__(self) -> Iterator[Tracks]:
        self._file.flush()
        place = 0
        for _ in range(self._num):
            self._file.seek(place)
            yield pickle.load(self._file)
            place = self._file.tell()


CSV_NAME = "tracks.csv"
# What a run writes and `overwrite` removes; the memory file is left to whoever writes it.
FILE_NAMES = (
    store.DETECTIONS_NAME,
    CSV_NAME,
    "mot.txt",
    "mots.txt",
    "coco_video.json",
    OVERLAY_NAME,
    report.REPORT_NAME,
    store.RUN_NAME,
)
CVAT_NAME = "cvat.xml"  # of `remind export`
MEMORY_NAME = "memory.safetensors"  # written by the tracker
CHECKPOINT_NAME = "checkpoint"  # folder of what is needed to go on, until the run is complete


class RunWriter:
    """Writes everything a run leaves behind: a context manager around the loop over frames.

    `add` streams detections, table and overlay; `finish` draws the rest. Left without it, the files
    are closed, and hold what was added.

    Nothing can be added to a video, so a run that is gone on with adds all frames again; until
    `end_repeating`, what the earlier process wrote stays as it was.

    Attributes:
      is_repeating: Whether frames are added that were done before.
    """

    def __init__(
        self,
        out_dir: str | Path,
        info: RunInfo,
        *,
        overlay: bool = True,
        overwrite: bool = False,
        resume: bool = False,
        mcap: McapRecord | None = None,
    ) -> None:
        """Prepares the folder, before any work is done."""
        self.folder = Path(out_dir)
        fps = float(info.fps) if np.isfinite(info.fps) and info.fps > 0 else UNTIMED_FPS
        self._info = dataclasses.replace(info, fps=fps)
        self._with_overlay = overlay
        self._mcap = mcap
        self._sightings = gallery.SightingCollector()
        self.is_repeating = resume
        _prepare_folder(self.folder, overwrite, resume)
        self._answers: list[int] = []  # as written so far, a number for each frame

    def __enter__(self) -> RunWriter:
        self._open_files = contextlib.ExitStack()
        with contextlib.ExitStack() as opening:
            # Records that are there stay until what is written again has come as far as they.
            part = ".part" if self.is_repeating else ""
            self._open_records(opening, part)
            self._video = (
                opening.enter_context(
                    overlay.OverlayVideo(self.folder / OVERLAY_NAME, self._info.fps)
                )
                if self._with_overlay
                else None
            )
            if self._mcap is not None:
                opening.enter_context(self._mcap)
            self._open_files = opening.pop_all()
        return self

    def _open_records(self, stack: contextlib.ExitStack, part: str, append: bool = False) -> None:
        detections = self.folder / (store.DETECTIONS_NAME + part)
        table = self.folder / (CSV_NAME + part)
        self._detections = stack.enter_context(
            store.detections_writer(detections, self._info, append=append)
        )
        self._csv = stack.enter_context(tables.csv_writer(table, append=append))

    def end_repeating(self) -> None:
        """From now on frames are added that were not done before.

        Raises:
          OutputError: If what was written again cannot take the place of what was there.
        """
        if not self.is_repeating:
            return
        self._detections.close()
        self._csv.close()
        for name in (store.DETECTIONS_NAME, CSV_NAME):
            with files.writing(self.folder / name):
                (self.folder / f"{name}.part").replace(self.folder / name)
        self._open_records(self._open_files, "", append=True)
        self.is_repeating = False

    def add(self, frame: Frame, tracks: Tracks) -> None:
        """Writes one frame."""
        self._detections.add(tracks)
        self._answers.append(_number_answers(tracks))
        self._csv.add(tracks)
        self._sightings.add(frame.image, tracks)
        if self._video is not None:
            self._video.add(overlay.draw_for_video(frame.image, tracks))
        if self._mcap is not None:
            self._mcap.add(frame, tracks)

    def finish(self, result: Result) -> None:
        """Closes the streamed files, draws the report, and writes `run.json`."""
        result = dataclasses.replace(result, info=self._info)
        try:
            self._open_files.close()
            if self._answers != [*map(_number_answers, result.tracks)]:
                self._write_records_again(result)
            result.save_trace(self.folder)
            _write_products(self.folder, result, self._sightings.sightings)
        except BaseException:
            with contextlib.suppress(OutputError):
                dataclasses.replace(result, complete=False).save_run_json(self.folder)
            raise
        result.save_run_json(self.folder)

    def _write_records_again(self, result: Result) -> None:
        """Detections and table of a run in which later frames changed earlier answers."""
        detections, table = self.folder / store.DETECTIONS_NAME, self.folder / CSV_NAME
        with (
            files.replacing(detections) as new_detections,
            files.replacing(table) as new_table,
            store.detections_writer(new_detections, self._info) as records,
            tables.csv_writer(new_table) as rows,
        ):
            for tracks in result.tracks:
                records.add(tracks)
                rows.add(tracks)

    def __exit__(self, *raised: object) -> None:
        with contextlib.suppress(OutputError):
            self._open_files.close()
        if self.is_repeating:
            for name in (store.DETECTIONS_NAME, CSV_NAME):
                (self.folder / f"{name}.part").unlink(missing_ok=True)


def render_again(
    run_dir: str | Path, source: Iterable[Frame] | None = None, *, is_moved: bool = False
) -> Result:
    """Draws overlay and report of a finished or interrupted run anew; gives the run.

    Args:
      source: The frames that the run was made from, in order, as they are sampled; frames that
        the run does not know are passed over. Without it the overlay stays as it is (drawn on
        gray if there is none), and the crops are taken from the earlier report.
      is_moved: They were at another place, so a source that has more of them is another one.

    Raises:
      OutputError: If the folder holds no run, `source` is another one, or writing fails.
    """
    folder = Path(run_dir)
    result = Result.load(folder)
    with files.locked(folder):
        sightings = report.read_sightings(folder / report.REPORT_NAME) if source is None else []
        has_overlay = overlay.is_playable(folder / OVERLAY_NAME)
        if source is not None or not sightings or not has_overlay:
            none = (None for _ in result.tracks)
            images = none if source is None else _images(result, source, is_moved)
            drawn = _draw_overlay_again(folder, result, images, keep=source is None and has_overlay)
            sightings = sightings or drawn
        _write_products(folder, result, sightings)
        if not (folder / store.RUN_NAME).exists():
            result.save_run_json(folder)
    return result


def add_comparison(run_dir: Path, result: Result, rows: tuple[tuple[str, ...], ...]) -> Result:
    """Adds a comparison with the truth to the report and `run.json` of a run that is there."""
    result = dataclasses.replace(result, comparison=rows)
    report.write_report(run_dir, result, report.read_sightings(run_dir / report.REPORT_NAME))
    result.save_run_json(run_dir)
    return result


def _draw_overlay_again(
    folder: Path, result: Result, images: Iterable[np.ndarray | None], keep: bool
) -> list[gallery.Sighting]:
    """Passes over the run once: writes the overlay unless it is kept, and collects the crops."""
    collector = gallery.SightingCollector()
    path = folder / OVERLAY_NAME
    with contextlib.nullcontext() if keep else overlay.OverlayVideo(path, result.info.fps) as video:
        for image, tracks in zip(images, result.tracks, strict=True):
            collector.add(image, tracks)
            if video is not None:
                video.add(overlay.draw_for_video(image, tracks))
    return collector.sightings


def _images(result: Result, source: Iterable[Frame], is_moved: bool) -> Iterable[np.ndarray | None]:
    """The images of the frames of the run, matched by their number in the source.

    Of a live run there is only what was recorded, which is the frames that it took and no others.
    """
    frames = iter(source)
    is_live = "opened_at" in (result.info.source or {})
    for tracks in result.tracks:
        fits = (f for f in frames if is_live or f.source_index == tracks.source_index)
        frame = next(fits, None)
        if frame is None:
            raise OutputError(
                f"the source has no frame {tracks.source_index} ('{tracks.name}'), which the run "
                "knows; give the source and sampling that the run was made with"
            )
        if frame.image is not None and frame.size != tracks.frame_size:
            (height, width), (was_height, was_width) = frame.size, tracks.frame_size
            raise OutputError(
                f"frame {tracks.source_index} of the source is {width}x{height}, that of the run "
                f"{was_width}x{was_height} pixels; give the source that the run was made with"
            )
        yield frame.image
    has_all = result.complete and not result.skipped and not is_live
    if has_all and is_moved and next(frames, None) is not None:
        raise OutputError(
            f"the source has more frames than the {len(result)} of the run; give the source that "
            "the run was made with"
        )


def _write_products(folder: Path, result: Result, sightings: list[gallery.Sighting]) -> None:
    """Writes what is made of the whole run: tables and report."""
    info = result.info
    tables.write_tables(folder, result.tracks, result.class_names, info.name, info.fps)
    report.write_report(folder, result, sightings)


def _number_answers(tracks: Tracks) -> int:
    """A number that changes with what is answered about a frame."""
    given = (tracks.object_id, tracks.outcome, tracks.pending_id, tracks.candidate_id)
    return hash(tuple(answer.tobytes() for answer in given))


def check_folder(folder: Path, overwrite: bool, resume: bool) -> None:
    """Looks whether a run may write to a folder, which need not be there; changes nothing.

    Raises:
      OutputError: If it is a file, or has files and neither `overwrite` nor `resume` is given, or
        has files that no run writes and `resume` is.
    """
    if folder.exists() and not folder.is_dir():
        raise OutputError(f"the output folder '{folder}' is a file; choose another name")
    present = {path.name for path in folder.iterdir()} if folder.exists() else set()
    present.discard(files.LOCK_NAME)
    if not present or overwrite:
        return
    if not resume:
        hint = "choose another one, or overwrite it (overwrite=True, --overwrite)"
        if CHECKPOINT_NAME in present:
            hint = (
                "go on with the run in it (resume=True, --resume), or start it anew "
                "(overwrite=True, --overwrite)"
            )
        raise OutputError(
            f"the output folder '{folder}' is not empty (it holds '{min(present)}'); {hint}"
        )
    is_of_a_run = CHECKPOINT_NAME in present or store.DETECTIONS_NAME in present
    if not is_of_a_run and not present <= {*FILE_NAMES, TRACE_NAME, MEMORY_NAME}:
        raise OutputError(
            f"the output folder '{folder}' holds no run to go on with, but '{min(present)}'; "
            "choose the folder of a run, or an empty one"
        )


def _prepare_folder(folder: Path, overwrite: bool, resume: bool) -> None:
    files.make_folder(folder)
    check_folder(folder, overwrite, resume)
    # What was made of the run that was there shows another one.
    made_of_it, own = (LABEL_PAGE_NAME, CVAT_NAME), (*FILE_NAMES, TRACE_NAME)
    parts = (f"{name}.part" for name in (*own, *made_of_it))
    for name in (*parts, *made_of_it, *(() if resume else own)):
        with files.writing(folder / name):
            (folder / name).unlink(missing_ok=True)
