"""`label.html`: the report page of a run in which a person corrects its identities.

The page is the report with `label_page.js`: edits are shown at once, kept by the browser, and saved
as the file that `label_edits` reads: evaluation.md#labeling.
"""

from __future__ import annotations

import dataclasses
from pathlib import Path

from remind_jax import files
from remind_jax.outputs import overlay, report
from remind_jax.outputs.label_edits import first_labels
from remind_jax.outputs.result import Result
from remind_jax.outputs.writer import OVERLAY_NAME

LABEL_PAGE_NAME = "label.html"
_SCRIPTS = (report.SCRIPT_NAME, "label_page.js")


def write_label_page(folder: str | Path) -> tuple[Path, Result]:
    """Writes the labeling page into the folder of a run, with the pictures of its report.

    Returns:
      The page, and the run.

    Raises:
      OutputError: If the folder holds no run, or the page cannot be written.
    """
    folder = Path(folder)
    # Why it was decided so does not matter here, and makes a large page.
    result = dataclasses.replace(Result.load(folder), trace=None)
    sightings = report.read_sightings(folder / report.REPORT_NAME)
    video = folder / OVERLAY_NAME
    address = report.video_address(video) if overlay.is_playable(video) else None
    labels = first_labels(result.tracks)
    data = report.report_data(result, sightings, address) | {
        "labeling": {
            "run": result.info.name,
            "num_detections": sum(len(label) for label in labels),
            "labels": [label.tolist() for label in labels],
            "classes": [list(tracks.labels) for tracks in result.tracks],
            "boxes": [tracks.boxes.round().astype(int).tolist() for tracks in result.tracks],
            "sizes": [list(tracks.frame_size) for tracks in result.tracks],
        }
    }
    page = folder / LABEL_PAGE_NAME
    text = report.render_page(f"{result.info.name}: labels", data, _SCRIPTS)
    files.replace_file(page, text.encode("utf-8"))
    return page, result
