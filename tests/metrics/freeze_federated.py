"""Writes federated cases and TrackEval's numbers for them; needs an environment with TrackEval.

    python tests/metrics/freeze_federated.py tests/golden/metrics/federated [number of random cases]

TAO cases are boxes, BURST cases masks. Arrays over thresholds are stored as their means. At commit
12c8791b TrackEval's BURST hands the boxes of masks (cut to whole pixels) to the overlap that is to
be of masks: `expected_boxes.json` holds its numbers as they are, `expected.json` those with masks.
"""

from __future__ import annotations

import contextlib
import json
import shutil
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import trackeval  # pyright: ignore[reportMissingImports]
from hotcoco import mask as coco
from trackeval.datasets import burst  # pyright: ignore[reportMissingImports]

CLASSES = {1: "acorn", 2: "aerosol_can", 3: "air_conditioner", 4: "airplane", 20: "antenna"}
NUM_FRAMES, WIDTH, HEIGHT = 6, 64, 48


class MaskBurst(burst.BURST):
    """TrackEval's BURST with the overlap of masks."""

    def _load_raw_file(self, tracker: Any, seq: str, is_gt: bool) -> Any:
        raw = super()._load_raw_file(tracker, seq, is_gt)
        number = self.seq_name_to_seq_id[seq]
        images = self.videos_to_gt_images if is_gt else self.tracker_data[tracker]["vids_to_images"]
        masks = [np.empty(0, object) for _ in range(raw["num_timesteps"])]
        for image in images[number]:
            place = self.seq_to_images_to_timestep[number].get(image["id"])
            if place is not None:
                codes = [a["segmentation"] for a in image["annotations"]]
                masks[place] = np.array(codes, object)
        raw["gt_dets" if is_gt else "tracker_dets"] = masks
        return raw

    def _calculate_similarities(self, gt_dets_t: Any, tracker_dets_t: Any) -> Any:
        return super()._calculate_similarities(list(gt_dets_t), list(tracker_dets_t))


DATASETS = {"tao": trackeval.datasets.TAO, "burst": MaskBurst, "burst_boxes": burst.BURST}


# One constructed video per rule: rows are (frame, track, class, left), all boxes 10 x 10.
RULES = {
    "known": {
        "neg": [2],
        "incomplete": [3],
        "truth": [(t, 1, 1, 10) for t in range(4)] + [(t, 2, 3, 40) for t in (0, 1, 3)],
        "answers": [(t, 1, 1, 11) for t in range(4)]  # right
        + [(0, 2, 1, 52), (4, 3, 1, 52)]  # unmatched: wrong; in a frame without any truth: out
        + [(1, 4, 2, 52)]  # of an absent class: wrong
        + [(t, 5, 3, 41) for t in range(3)]  # right twice; in frame 2 not labeled: out
        + [(0, 6, 3, 20)]  # of a class that is not labeled exhaustively: out
        + [(0, 7, 4, 20), (1, 8, 4, 40)],  # of a class of which nothing is known: out
    },
    "others": {
        "neg": [4],
        "incomplete": [],
        "truth": [(t, 1, 2, 10) for t in range(3)],
        "answers": [(0, 1, 2, 12), (1, 9, 2, 12), (2, 9, 2, 30), (0, 3, 1, 10), (1, 4, 4, 10)],
    },
}


def write_rules() -> tuple[dict[str, Any], list[dict[str, Any]]]:
    """Truth and results of the constructed videos."""
    videos, truth, answers = [], [], []
    for number, (name, rule) in enumerate(RULES.items(), 1):
        videos.append(video(number, name, rule["neg"], rule["incomplete"]))
        for rows, found in ((rule["truth"], truth), (rule["answers"], answers)):
            found += [
                annotation(number, frame, track, class_id, [left, 5, 10, 10])
                for frame, track, class_id, left in rows
            ]
    return tao(videos, truth), [{**a, "score": 0.5} for a in answers]


def write_random(
    seed: int, *, is_merged: bool = False
) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    """Three videos of walking boxes, tracked with errors, some of them on unlabeled objects."""
    rng = np.random.default_rng(seed)
    numbers = list(CLASSES)[:4]
    videos, truth, answers = [], [], []
    for number in (1, 2, 3):
        classes = rng.permutation(numbers)
        present, rest = classes[: rng.integers(1, 4)], classes[rng.integers(1, 5) :]
        negative = [int(c) for c in rest if c not in present]
        incomplete = [int(c) for c in present if rng.random() < 0.4]
        videos.append(video(number, f"random/{number}", negative, incomplete))
        for track in range(rng.integers(2, 6)):
            class_id, is_labeled = int(rng.choice(present)), rng.random() < 0.7
            place, label = rng.uniform([0, 0], [WIDTH - 14, HEIGHT - 14]), 10 * number + track
            for frame in range(NUM_FRAMES):
                place = np.clip(place + rng.normal(0, 2, 2), 0, [WIDTH - 14, HEIGHT - 14])
                box = [*place.round(1).tolist(), 12.0, 13.0]
                if is_labeled and rng.random() < 0.8:
                    row_class = 5 if is_merged and class_id == 1 else class_id
                    truth.append(annotation(number, frame, 100 * number + track, row_class, box))
                label = label + 50 if rng.random() < 0.1 else label
                if rng.random() < 0.8:
                    seen = (np.array(box) + rng.normal(0, 1.5, 4)).round(1)
                    seen[:2] = np.clip(seen[:2], 0, [WIDTH - 18, HEIGHT - 18])
                    wrong = rng.random() < 0.15
                    guess = int(rng.choice(numbers)) if wrong else class_id
                    row = annotation(number, frame, label, guess, seen.tolist())
                    answers.append({**row, "score": float(rng.random().__round__(3))})
    categories = [{"id": i, "name": name} for i, name in CLASSES.items()]
    if is_merged:
        categories[0]["merged"] = [{"id": 5}]
        categories.append({"id": 5, "name": "acorn_too"})
    return {**tao(videos, truth), "categories": categories}, answers


def video(number: int, name: str, negative: list[int], incomplete: list[int]) -> dict[str, Any]:
    """A video of TAO."""
    size = {"id": number, "name": name, "width": WIDTH, "height": HEIGHT}
    return {**size, "neg_category_ids": negative, "not_exhaustive_category_ids": incomplete}


def annotation(number: int, frame: int, track: int, class_id: int, box: Any) -> dict[str, Any]:
    """One box of a track."""
    place = {"video_id": number, "image_id": 100 * number + frame, "track_id": track}
    return {**place, "category_id": class_id, "bbox": box}


def tao(videos: list[Any], annotations: list[Any]) -> dict[str, Any]:
    """A truth file of TAO."""
    images = [
        {
            "id": 100 * v["id"] + t,
            "video_id": v["id"],
            "frame_index": t,
            "file_name": f"{v['name']}/{t:05d}.jpg",
        }
        for v in videos
        for t in range(NUM_FRAMES)
    ]
    tracks = {a["track_id"]: {k: a[k] for k in ("category_id", "video_id")} for a in annotations}
    return {
        "videos": videos,
        "images": images,
        "annotations": annotations,
        "tracks": [{"id": t, **track} for t, track in tracks.items()],
        "categories": [{"id": i, "name": name} for i, name in CLASSES.items()],
    }


def as_burst(truth: dict[str, Any], answers: list[Any]) -> tuple[dict[str, Any], dict[str, Any]]:
    """The same as BURST files; class 4 becomes 20, which BURST does not evaluate."""
    sides = []
    for rows in (truth["annotations"], answers):
        sequences = []
        for number, source in enumerate(truth["videos"], 1):
            frames = [f"frame{t:05d}.jpg" for t in range(NUM_FRAMES)]
            masks: list[dict[str, Any]] = [{} for _ in frames]
            classes = {}
            for row in (a for a in rows if a["video_id"] == number):
                track = str(row["track_id"])
                class_id = classes.setdefault(
                    track, 20 if row["category_id"] == 4 else row["category_id"]
                )
                rle = coco.encode(np.asfortranarray(draw_ellipse(row["bbox"])))
                masks[row["image_id"] % 100][track] = {"rle": rle["counts"].decode()}
                if rows is answers and row["category_id"] == class_id:
                    masks[row["image_id"] % 100][track]["category_id"] = class_id
            sequences.append(
                {
                    **{"id": number, "dataset": "made", "seq_name": source["name"].split("/")[-1]},
                    **{k: source[k] for k in ("width", "height", "neg_category_ids")},
                    "not_exhaustive_category_ids": source["not_exhaustive_category_ids"],
                    "annotated_image_paths": frames,
                    "segmentations": masks,
                    "track_category_ids": classes,
                }
            )
        sides.append({"split": "val", "sequences": sequences, "categories": truth["categories"]})
    return sides[0], sides[1]


def draw_ellipse(box: Any) -> np.ndarray:
    """The ellipse inside a box."""
    left, top, width, height = box
    y, x = np.mgrid[:HEIGHT, :WIDTH] + 0.5
    radius = ((x - left) / width * 2 - 1) ** 2 + ((y - top) / height * 2 - 1) ** 2
    return (radius <= 1).astype(np.uint8)


def score(kind: str, truth: Any, answers: Any) -> dict[str, Any]:
    """TrackEval's numbers of the classes and of the ways to bring them together."""
    with tempfile.TemporaryDirectory() as name, contextlib.redirect_stdout(sys.stderr):
        root = Path(name)
        (root / "gt").mkdir()
        (root / "trackers" / "t" / "data").mkdir(parents=True)
        (root / "gt" / "gt.json").write_text(json.dumps(truth))
        (root / "trackers" / "t" / "data" / "t.json").write_text(json.dumps(answers))
        config = {"GT_FOLDER": str(root / "gt"), "TRACKERS_FOLDER": str(root / "trackers")}
        make = DATASETS[kind]
        quiet = {"PRINT_CONFIG": False}
        evaluator = trackeval.Evaluator(
            {
                **dict.fromkeys(("PRINT_RESULTS", "OUTPUT_SUMMARY", "OUTPUT_DETAILED"), False),
                **{"PLOT_CURVES": False, "TIME_PROGRESS": False, "USE_PARALLEL": False},
                **{"PRINT_CONFIG": False, "LOG_ON_ERROR": None, "BREAK_ON_ERROR": True},
            }
        )
        metrics = [
            trackeval.metrics.HOTA(),
            trackeval.metrics.CLEAR(quiet),
            trackeval.metrics.Identity(quiet),
        ]
        results, _ = evaluator.evaluate([make({**config, **quiet})], metrics)
    combined = results[make.__name__]["t"]["COMBINED_SEQ"]
    means = {
        label: {k: float(np.mean(v)) for fields in families.values() for k, v in fields.items()}
        for label, families in combined.items()
    }
    average, detections = means.pop("cls_comb_cls_av"), means.pop("cls_comb_det_av")
    return {"class_averaged": average, "detection_averaged": detections, "classes": means}


def main() -> None:
    out = Path(sys.argv[1])
    num_random = int(sys.argv[2]) if len(sys.argv) > 2 else 1
    cases: dict[str, tuple[str, Any, Any]] = {
        "tao_rules": ("tao", *write_rules()),
        "tao_merged_classes": ("tao", *write_random(0, is_merged=True)),
    }
    for seed in range(1, num_random + 1):
        cases[f"tao_random_{seed}"] = ("tao", *write_random(seed))
        cases[f"burst_random_{seed}"] = ("burst", *as_burst(*write_random(1000 + seed)))
    for name, (kind, truth, answers) in cases.items():
        # TrackEval changes what it reads; it gets its own copy as text.
        folder = out / name
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir(parents=True)
        expected = score(kind, truth, answers)
        files = {"gt": truth, "pred": answers, "expected": expected}
        if kind == "burst":
            files["expected_boxes"] = score("burst_boxes", truth, answers)
        for file, content in files.items():
            (folder / f"{file}.json").write_text(json.dumps(content, separators=(",", ":")) + "\n")


if __name__ == "__main__":
    main()
