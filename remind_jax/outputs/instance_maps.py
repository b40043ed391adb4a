"""A run as a folder of instance maps in the DAVIS layout, as truth to score against.

OUT/Annotations/NAME/*.png   one map per processed frame: 0 background, else identity + 1
OUT/metadata.json            class of each instance
"""

from __future__ import annotations

import json
from pathlib import Path, PurePath

import cv2
import numpy as np

from remind_jax import files
from remind_jax.decision import NO_ID
from remind_jax.errors import OutputError
from remind_jax.masks.run_length import decode_mask
from remind_jax.outputs.labeling import picture_names
from remind_jax.outputs.result import Result
from remind_jax.outputs.tables import firm_rows, masks_without_overlap
from remind_jax.printing.terminal import printable
from remind_jax.tracks import Tracks

METADATA_NAME = "metadata.json"
_MOST_8_BIT = 254  # 255 is void in 8-bit truth


def write_instance_maps(result: Result, folder: str | Path) -> None:
    """Writes the firm identities of a run; shared pixels go to the higher confidence.

    The maps come to be all at once, or none.

    Raises:
      OutputError: If an identity is beyond 16 bits, something else lies where the maps go, or the
        folder cannot be written.
    """
    name = PurePath(printable(result.info.name)).name or "run"
    maps = Path(folder) / "Annotations" / name
    classes = {
        int(tracks.object_id[row]) + 1: printable(tracks.labels[row])
        for tracks in result.tracks
        for row in np.flatnonzero(tracks.object_id != NO_ID)
    }
    most = max(classes, default=0)
    if most > np.iinfo(np.uint16).max:
        raise OutputError(
            f"identity {most - 1} does not fit into instance maps of 16 bits; write cvat instead"
        )
    pictures = [f"{picture}.png" for picture in picture_names(result.tracks)]
    others = {path.name for path in maps.iterdir()} - set(pictures) if maps.is_dir() else set()
    if others:
        raise OutputError(
            f"'{maps}' holds '{min(others)}', which is no map of this run; name another folder"
        )
    dtype = np.uint8 if most <= _MOST_8_BIT else np.uint16
    with files.replacing_folder(maps, Path(folder)) as unfinished:
        for tracks, picture in zip(result.tracks, pictures, strict=True):
            (unfinished / picture).write_bytes(_draw(tracks, dtype))
        content = {"sequence": name, "id_to_class": {str(k): v for k, v in sorted(classes.items())}}
        text = json.dumps(content, ensure_ascii=False, indent=1) + "\n"
        files.replace_file(Path(folder) / METADATA_NAME, text.encode("utf-8"))


def _draw(tracks: Tracks, dtype: type[np.unsignedinteger]) -> bytes:
    """The map of a frame as a PNG."""
    drawn = np.zeros(tracks.frame_size, dtype)
    rows = firm_rows(tracks)
    for row, rle in zip(rows, masks_without_overlap(tracks, rows), strict=True):
        if rle is not None:
            drawn[decode_mask(rle).astype(bool)] = int(tracks.object_id[row]) + 1
    return cv2.imencode(".png", drawn)[1].tobytes()
