"""Whole verbs of the command line, from one changed file to what it leaves behind."""

from __future__ import annotations

from pathlib import Path

from tests.cli import scenes
from tests.corpus import binary_seeds, seeds
from tests.corpus.seeds import NUM_FRAMES, Format, remind


def _run(path: Path, *words: object) -> None:
    """Tracks a tiny scene, with a share of what `remind run` does."""
    images = seeds.scene_beside(path)
    remind(
        *("run", images, "--out", path.parent / "out", "--tracker", "bank", "--no-overlay"),
        *("--quiet", *words),
    )


def _memory_of_a_run(folder: Path) -> Path:
    images, masks = scenes.write_scene(folder / "scene", NUM_FRAMES)
    run = folder / "run"
    words = ("--out", run, "--tracker", "bank", "--no-overlay", "--quiet")
    remind("run", images, "--masks", masks, *words)
    return run / "memory.safetensors"


# Whole verbs: seconds each, most of them for compiled programs.
VERBS: dict[str, Format] = {
    "run with coco results": Format(
        "json", seeds.coco_results, lambda path: _run(path, "--masks", path)
    ),
    "run with polygons": Format(
        "json", binary_seeds.polygons, lambda path: _run(path, "--masks", path)
    ),
    "run with a detector": Format(
        "header", binary_seeds.detector, lambda path: _run(path, "--detector", path)
    ),
    "run with metadata": Format(
        "json",
        seeds.metadata,
        lambda path: remind(
            *("run", path.parents[1] / "images", "--masks", path.parent, "--tracker", "bank"),
            *("--out", path.parents[2] / "out", "--no-overlay", "--quiet"),
        ),
    ),
    "run with features": Format(
        "npz",
        seeds.features,
        lambda path: remind(
            *("run", path, "--out", path.parent / "out", "--tracker", "bank", "--quiet"),
        ),
    ),
    "run with a memory": Format(
        "safetensors",
        _memory_of_a_run,
        lambda path: _run(
            path, "--masks", path.parents[1] / "scene" / "masks", "--memory", path, "--overwrite"
        ),
    ),
    "run with a configuration": Format(
        "yaml",
        seeds.config,
        lambda path: remind(
            *("run", seeds.scene_beside(path), "--masks", path.parent / "scene" / "masks"),
            *("--config", path, "--out", path.parent / "out", "--no-overlay", "--quiet"),
        ),
    ),
    "view": Format(
        "jsonl", seeds.run_file("detections.jsonl"), lambda path: remind("view", path.parent)
    ),
    "label": Format(
        "jsonl",
        seeds.run_file("detections.jsonl"),
        lambda path: remind("label", path.parent, "--quiet"),
    ),
    "config validate": Format(
        "yaml", seeds.config, lambda path: remind("config", "validate", path)
    ),
    "sweep": Format(
        "json",
        seeds.sweep_settings,
        lambda path: remind(
            *("sweep", seeds.scene_beside(path).parent, "--settings", path),
            *("--out", path.parent / "sweep.csv"),
        ),
    ),
}
