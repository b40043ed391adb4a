"""What a tracker of others reads and writes; runs in its environment, so it needs NumPy only.

A folder holds one `NAME.npz` per sequence: `frame`, `boxes` (left, top, right, bottom in pixels),
`scores`, `classes` and `embeddings` (of unit length) of all detections, ordered by frame; the
number of the `picture` that each frame shows (-1: the lens is covered), the path of the `pictures`
and `fps`. The answer is `SETTING/NAME.npy`: the identity of each detection, -1 without one.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import sys
import time
import traceback
from collections.abc import Callable, Iterator, Sequence
from importlib import metadata
from pathlib import Path

import numpy as np

FOR_EVER = 1_000_000  # frames; longer than any sequence
COVERED_GRAY = 40
UNANSWERED = -1
_SHORT = 500  # frames


@dataclasses.dataclass(frozen=True)
class Seen:
    """The detections of one frame."""

    boxes: np.ndarray  # [N, 4]
    scores: np.ndarray  # [N]
    classes: np.ndarray  # [N]
    embeddings: np.ndarray  # [N, D]
    picture: np.ndarray  # BGR [H, W, 3]

    def __len__(self) -> int:
        return len(self.boxes)


Update = Callable[[Seen], np.ndarray]  # identities [N], UNANSWERED without one
Settings = dict[str, Callable[[float], Update]]  # a new tracker for so many frames per second


def read(file: Path) -> tuple[float, Iterator[Seen]]:
    """Frames per second, and the frames."""
    with np.load(file) as content:
        given = {name: content[name] for name in content.files}
    pictures = np.load(str(given["pictures"]), mmap_mode="r")
    covered = np.full(pictures.shape[1:], COVERED_GRAY, np.uint8)
    starts = np.searchsorted(given["frame"], np.arange(len(given["picture"]) + 1))
    rows = ("boxes", "scores", "classes", "embeddings")

    def frames() -> Iterator[Seen]:
        for index, number in enumerate(given["picture"]):
            own = slice(starts[index], starts[index + 1])
            image = covered if number < 0 else pictures[number]
            picture = np.ascontiguousarray(image[..., ::-1])
            boxes, scores, classes, embeddings = (given[name][own].copy() for name in rows)
            yield Seen(boxes, scores, classes, embeddings, picture)

    return float(given["fps"]), frames()


def identities(num: int, rows: Sequence[int], ids: Sequence[int]) -> np.ndarray:
    """Identities by detection, from the rows of those that have one."""
    answer = np.full(num, UNANSWERED, np.int64)
    answer[np.asarray(rows, int)] = np.asarray(ids, np.int64)
    return answer


def serve(settings: Settings, packages: Sequence[str]) -> None:
    """Answers what is not answered yet with every setting; notes what fails, and goes on."""
    parser = argparse.ArgumentParser()
    parser.add_argument("sequences", type=Path)
    parser.add_argument("out", type=Path)
    given = parser.parse_args()
    about = {
        "versions": {name: metadata.version(name) for name in packages},
        "python": sys.version.split()[0],
    }
    told: dict[str, dict[str, object]] = {name: {"error": "", "cpu_s": 0.0} for name in settings}
    lengths = {file: _num_frames(file) for file in given.sequences.glob("*.npz")}
    # Short ones of all settings first: whoever stops it early has most of the points.
    for least, most in ((0, _SHORT), (_SHORT, FOR_EVER)):
        files = sorted(file for file, length in lengths.items() if least <= length < most)
        for name, make in sorted(settings.items(), key=lambda one: _rank(one[0])):
            if not told[name]["error"]:
                told[name] = _answer(name, make, files, given.out / name, told[name])
            (given.out / "report.json").write_text(
                json.dumps({**about, "settings": told}, indent=1)
            )


def _answer(
    name: str,
    make: Callable[[float], Update],
    files: Sequence[Path],
    out: Path,
    told: dict[str, object],
) -> dict[str, object]:
    """Answers some sequences with one setting; what is told of it."""
    out.mkdir(parents=True, exist_ok=True)
    start, error = time.process_time(), ""
    try:
        for file in files:
            if (out / f"{file.stem}.npy").is_file():
                continue
            fps, frames = read(file)
            update = make(fps)
            answers = [update(seen) for seen in frames]
            np.save(out / f"{file.stem}.npy", np.concatenate(answers).astype(np.int64))
    except Exception as failure:
        traceback.print_exc()
        error = f"{type(failure).__name__}: {failure}".splitlines()[0]
    spent = float(str(told["cpu_s"])) + time.process_time() - start
    told = {"error": error, "cpu_s": round(spent, 1)}
    print(f"{name}: {told}", file=sys.stderr, flush=True)
    return told


def _rank(name: str) -> int:
    """The most favorable settings first."""
    return ("open", "published", "for-ever").index(name.rpartition(".")[2])


def _num_frames(file: Path) -> int:
    with np.load(file) as content:
        return len(content["picture"])
