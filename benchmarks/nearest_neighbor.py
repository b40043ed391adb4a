"""How well a backbone tells objects apart, without any tracker.

Usage: python benchmarks/nearest_neighbor.py ROOT [--backbone NAME] [--every 20] [--json OUT]

Every 10th frame of each sequence under ROOT (`JPEGImages`, `Annotations`, `metadata.json`) is
described; each instance of at least 400 pixels in it becomes one vector, the mean of its patch
features weighted by the share of the patch that its mask covers. Rank-1 is the share of these
vectors whose nearest other one by cosine, at least 30 (100) frames away, is the same instance.
Vectors without the same instance that far away are not asked.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import time
from pathlib import Path

import cv2
import numpy as np
from rich.console import Console
from rich.table import Table

from remind_jax.backbone import DEFAULT_BACKBONE, Backbone
from remind_jax.backbone.opening import open_backbone
from remind_jax.errors import SourceError

FRAME_STEP = 10
MIN_MASK_PX = 400
GAPS = (30, 100)  # frames
HSV_BINS = (16, 8, 4)
PERCENTILES = (10, 50, 90)

# Rank-1 at both gaps as published with the sequences, where they are these.
PUBLISHED = {
    "ALIKED-n16 (trained)": {
        "kitchen": (0.749, 0.701),
        "rooms_a": (0.473, 0.555),
        "rooms_b": (0.295, 0.436),
    },
    "color histogram (HSV)": {
        "kitchen": (0.769, 0.735),
        "rooms_a": (0.466, 0.373),
        "rooms_b": (0.305, 0.372),
    },
    "gradients and Lab": {
        "kitchen": (0.602, 0.611),
        "rooms_a": (0.435, 0.418),
        "rooms_b": (0.253, 0.372),
    },
    "random ViT-S/16": {
        "kitchen": (0.571, 0.499),
        "rooms_a": (0.137, 0.073),
        "rooms_b": (0.116, 0.064),
    },
}


@dataclasses.dataclass(frozen=True)
class Sightings:
    """The sampled frames of a sequence and one row per instance seen in one of them."""

    name: str
    images: np.ndarray  # [T, H, W, 3] uint8 RGB
    masks: list[np.ndarray]  # [H, W] bool
    image_index: np.ndarray  # [N] into images
    frame: np.ndarray  # [N] number in the sequence
    instance: np.ndarray  # [N]
    label: np.ndarray  # [N] class names


def read_sightings(folder: Path, patch_px: int, step: int = FRAME_STEP) -> Sightings:
    """Reads every `step`-th frame, cut about the center to whole patches."""
    name = folder.name
    classes = json.loads((folder / "metadata.json").read_text())["id_to_class"]
    images, masks, rows = [], [], []
    paths = sorted((folder / "JPEGImages" / name).glob("*.jpg"))
    for frame in range(0, len(paths), step):
        image = cv2.cvtColor(_read(paths[frame], cv2.IMREAD_COLOR), cv2.COLOR_BGR2RGB)
        labels_path = folder / "Annotations" / name / f"{paths[frame].stem}.png"
        labels = _read(labels_path, cv2.IMREAD_UNCHANGED)
        height, width = (patch_px * (side // patch_px) for side in labels.shape)
        top, left = (labels.shape[0] - height) // 2, (labels.shape[1] - width) // 2
        cut = np.s_[top : top + height, left : left + width]
        for instance in np.unique(labels[labels > 0]):
            mask = labels == instance
            if mask.sum() >= MIN_MASK_PX and mask[cut].any():
                masks.append(mask[cut])
                rows.append((len(images), frame, int(instance), classes[str(instance)]))
        images.append(image[cut])
    image_index, frames, instances, names = (np.array(column) for column in zip(*rows, strict=True))
    return Sightings(name, np.stack(images), masks, image_index, frames, instances, names)


def _read(path: Path, mode: int) -> np.ndarray:
    image = cv2.imread(str(path), mode)
    if image is None:
        raise SourceError(f"'{path}' cannot be read as an image")
    return image


def describe_with(backbone: Backbone, sightings: Sightings) -> tuple[np.ndarray, float]:
    """Unit vectors `[N, D]` and the median CPU milliseconds per frame after compilation."""
    features, elapsed_ms = [], []
    backbone.extract(sightings.images[:1])
    for image in sightings.images:
        start = time.process_time()
        features.append(np.asarray(backbone.extract(image[None]))[0])
        elapsed_ms.append(1e3 * (time.process_time() - start))
    rows, cols = features[0].shape[:2]
    vectors = []
    for mask, index in zip(sightings.masks, sightings.image_index, strict=True):
        coverage = cv2.resize(mask.astype(np.float32), (cols, rows), interpolation=cv2.INTER_AREA)
        vectors.append(np.tensordot(coverage, features[index], 2) / coverage.sum())
    return to_unit(np.stack(vectors)), float(np.median(elapsed_ms))


def describe_hsv(sightings: Sightings) -> np.ndarray:
    """Square-root HSV histogram of the mask's pixels: the protocol's own check."""
    ranges = ((0, 180), (0, 256), (0, 256))
    vectors = []
    for mask, index in zip(sightings.masks, sightings.image_index, strict=True):
        hsv = cv2.cvtColor(sightings.images[index], cv2.COLOR_RGB2HSV)
        counts, _ = np.histogramdd(hsv[mask].astype(np.float32), HSV_BINS, ranges)
        vectors.append(np.sqrt(counts.ravel() / counts.sum()))
    return to_unit(np.stack(vectors))


def to_unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-12)


def rank_one(vectors: np.ndarray, sightings: Sightings, gap: int) -> tuple[float | None, int]:
    """Share of queries answered by their own instance (none without queries), and their number."""
    allowed = np.abs(sightings.frame[:, None] - sightings.frame) >= gap
    same = sightings.instance[:, None] == sightings.instance
    asked = (allowed & same).any(1)
    nearest = np.where(allowed, vectors @ vectors.T, -np.inf).argmax(1)
    hits = same[np.arange(len(same)), nearest][asked]
    return (float(hits.mean()) if asked.any() else None), len(hits)


def cosine_percentiles(vectors: np.ndarray, sightings: Sightings) -> dict[str, list[float]]:
    """`PERCENTILES` of the cosines of pairs by what they are and how far apart they were seen."""
    cosine = vectors @ vectors.T
    distance = np.abs(sightings.frame[:, None] - sightings.frame)
    same = sightings.instance[:, None] == sightings.instance
    same_class = sightings.label[:, None] == sightings.label
    pairs = {"same": same, "class": same_class & ~same, "other": ~same_class}
    spans = {"near": (distance > 0) & (distance <= FRAME_STEP), "far": distance >= GAPS[0]}
    return {
        f"{span} {kind}": np.percentile(cosine[when & which], PERCENTILES).round(3).tolist()
        for span, when in spans.items()
        for kind, which in pairs.items()
        if (when & which).any()
    }


def measure(root: Path, backbone: Backbone, step: int = FRAME_STEP) -> list[dict]:
    """One record per sequence under `root` and descriptor."""
    records = []
    for metadata in sorted(root.glob("*/metadata.json")):
        sightings = read_sightings(metadata.parent, backbone.patch_px, step)
        ours, ms_per_frame = describe_with(backbone, sightings)
        descriptors: dict[str, tuple[np.ndarray, float | None]] = {
            backbone.name: (ours, ms_per_frame),
            "HSV, measured here": (describe_hsv(sightings), None),
        }
        for name, (vectors, ms) in descriptors.items():
            ranks = [rank_one(vectors, sightings, gap) for gap in GAPS]
            records.append(
                {
                    "sequence": sightings.name,
                    "descriptor": name,
                    "dim": vectors.shape[1],
                    "ms_per_frame": ms,
                    "rank_1": dict(zip(map(str, GAPS), [rank for rank, _ in ranks], strict=True)),
                    "queries": dict(zip(map(str, GAPS), [num for _, num in ranks], strict=True)),
                    "cosine_percentiles": cosine_percentiles(vectors, sightings),
                }
            )
    return records


def print_ranks(records: list[dict], console: Console) -> None:
    sequences = sorted({record["sequence"] for record in records})
    table = Table(title=f"rank-1, gallery at least {GAPS[0]} ({GAPS[1]}) frames away")
    for column in ("descriptor", *sequences):
        table.add_column(column)
    rows: dict[str, dict] = {name: dict(cells) for name, cells in PUBLISHED.items()}
    for record in records:
        cell = [record["rank_1"][str(gap)] for gap in GAPS]
        rows.setdefault(record["descriptor"], {})[record["sequence"]] = cell
    for name, cells in rows.items():
        shares = [cells.get(sequence, (None, None)) for sequence in sequences]
        table.add_row(name, *(f"{_share(near)} ({_share(far)})" for near, far in shares))
    console.print(table)


def _share(value: float | None) -> str:
    return "-" if value is None else f"{value:.3f}"


def print_cosines(records: list[dict], console: Console) -> None:
    table = Table(title="cosines, 10 / 50 / 90 %: near is <= 10 frames apart, far >= 30")
    kinds = [f"{span} {kind}" for span in ("near", "far") for kind in ("same", "class", "other")]
    for column in ("sequence", *kinds):
        table.add_column(column)
    for record in records:
        texts = record["cosine_percentiles"]
        cells = ["/".join(f"{c:.2f}" for c in texts[k]) if k in texts else "-" for k in kinds]
        table.add_row(record["sequence"], *cells)
    console.print(table)


def main() -> None:
    parser = argparse.ArgumentParser(description="Rank-1 of a backbone's masked mean vectors.")
    parser.add_argument("root", type=Path, help="folder of sequences")
    parser.add_argument("--backbone", default=DEFAULT_BACKBONE)
    parser.add_argument("--every", type=int, default=FRAME_STEP, metavar="FRAMES")
    parser.add_argument("--json", type=Path, help="where to write the figures")
    arguments = parser.parse_args()
    backbone = open_backbone(arguments.backbone)
    records = measure(arguments.root, backbone, arguments.every)
    if not records:
        parser.error(f"no sequence (folder with a metadata.json) in {arguments.root}")
    console = Console()
    print_ranks(records, console)
    ours = [record for record in records if record["descriptor"] == backbone.name]
    print_cosines(ours, console)
    times = ", ".join(f"{record['sequence']} {record['ms_per_frame']:.1f}" for record in ours)
    console.print(f"{backbone.name}: {backbone.dim} features, CPU ms per frame (median): {times}")
    if arguments.json:
        arguments.json.write_text(json.dumps(records, indent=1))


if __name__ == "__main__":
    main()
