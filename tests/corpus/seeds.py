"""One small valid file of every format that enters, and how a user hands it over."""

import dataclasses
import functools
import itertools
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import numpy as np
import yaml

import remind_jax as rj
from remind_jax import sweeps
from remind_jax.backbone.vit_weights import load_weights
from remind_jax.baselines.bank import METHOD
from remind_jax.cli import process
from remind_jax.cli.main import main
from remind_jax.errors import RemindError
from remind_jax.masks.run_length import encode_masks
from remind_jax.session.memory_file import SavedMemory, load_memory, save_memory
from tests.backbone.networks import converted_file
from tests.cli import scenes
from tests.corpus import binary_seeds
from tests.formats import scenes as tracks
from tests.outputs import fake_run
from tests.outputs.traced_run import make_plus_run, make_traced_run
from weights_convert.stored_tensors import open_source as open_weights

NUM_FRAMES = 3


class Refused(Exception):
    """The command said what is wrong; its sentence is on standard error."""


@dataclasses.dataclass(frozen=True)
class Format:
    """A kind of file."""

    kind: str  # how it is changed: "json", "jsonl", "yaml", "text", "npz", "safetensors", "header"
    # (numbers of a header) or "bytes"
    write: Callable[[Path], Path]  # into an empty folder; gives the file that is changed
    enter: Callable[[Path], Any]  # what a user does with it; raises where it is refused


def remind(*words: object) -> None:
    """The command line; exit code 0 or an exception."""
    code = main([str(word) for word in words])
    if code == process.FAILED:
        raise RuntimeError("the last resort was needed")
    if code:
        raise Refused(code)


class Told(Exception):
    """It went on without a part, and said so."""


def _look_at(source, **options) -> None:
    opened = rj.open_source(source, **options)
    for frame in itertools.islice(opened, NUM_FRAMES):
        if frame.detections is not None:
            _ = np.asarray(frame.detections.masks).sum()
    if opened.skipped or opened.notes:
        raise Told([(frame.name, frame.reason) for frame in opened.skipped], opened.notes)


def scene_beside(path: Path) -> Path:
    """Images of the tiny scene, in the folder of the file."""
    images = path.parent / "scene" / "images"
    if not images.exists():
        scenes.write_scene(path.parent / "scene", NUM_FRAMES)
    return images


def _rle(mask: np.ndarray) -> dict:
    (code,) = encode_masks(mask[None])
    return {"size": list(code["size"]), "counts": code["counts"].decode()}


def _detections(index: int, **more: Any) -> list[dict]:
    """Those of a frame, as COCO has them."""
    labels = scenes.picture(index)[1]
    return [
        {"segmentation": _rle(labels == instance), "score": 0.9, **more}
        for instance in scenes.FIRST_THREE
    ]


def _coco_results() -> list[dict]:
    found = (_detections(index, image_id=index, category_id=1) for index in range(NUM_FRAMES))
    return list(itertools.chain(*found))


def _frame_lines(folder: Path) -> Path:
    lines = [
        json.dumps({"frame": index, "detections": _detections(index, label="cup")})
        for index in range(NUM_FRAMES)
    ]
    path = folder / "frames.jsonl"
    path.write_text("\n".join(lines) + "\n")
    return path


def _json_of(make: Callable[[], Any]) -> Callable[[Path], Path]:
    return lambda folder: tracks.write_json(folder / "tracks.json", make())


def _text_of(make: Callable[[list[str]], str]) -> Callable[[Path], Path]:
    def write(folder: Path) -> Path:
        path = folder / "tracks.txt"
        path.write_text(make(tracks.TRUTH["one"]))
        return path

    return write


def metadata(folder: Path) -> Path:
    scenes.write_scene(folder / "scene", NUM_FRAMES)
    return folder / "scene" / "masks" / "metadata.json"


def run_file(name: str) -> Callable[[Path], Path]:
    def write(folder: Path) -> Path:
        _, result = fake_run.make_run(6, (48, 64), 3)
        result.save(folder / "run")
        return folder / "run" / name

    return write


def _edits(folder: Path) -> Path:
    num = sum(len(tracks) for tracks in rj.Result.load(run_file("run.json")(folder).parent).tracks)
    edits = [
        {"edit": "merge", "id": 2, "into": 7},
        {"edit": "move", "id": 0, "first": 1, "last": 3, "to": None},
        {"edit": "assign", "frame": 2, "detection": 0, "to": 9},
    ]
    content = {"format": "remind-jax edits", "version": 1, "run": "kitchen", "edits": edits}
    return tracks.write_json(folder / "edits.json", {**content, "num_detections": num})


def config(folder: Path) -> Path:
    path = folder / "config.yaml"
    values = {"base": "default", "decision": {"new": 1.5}, "input": {"ignored_classes": ["wall"]}}
    path.write_text(yaml.safe_dump({**values, "static": {"num_objects": 32}}))
    return path


def sweep_settings(folder: Path) -> Path:
    path = folder / "settings.json"
    path.write_text(json.dumps([{"decision.new": 1.0}, {"decision.new": 1.5, "looks.gain": 0.7}]))
    return path


@functools.cache  # a process that was forked from one that computed had better not compute
def _empty_memory(static: rj.Static) -> Any:
    return jax.device_get(METHOD.init(static))


def _memory(folder: Path) -> Path:
    static = METHOD.static(num_detections=2, num_objects=3, feature_dim=4)
    state = _empty_memory(static)
    path = folder / "memory.safetensors"
    save_memory(path, SavedMemory(state, static, ("cup",), "fingerprint", METHOD.name))
    return path


def _map(folder: Path) -> Path:
    return next(iter(sorted(scenes.write_scene(folder / "scene", NUM_FRAMES)[1].glob("*.png"))))


def _scene_with_masks(path: Path) -> None:
    scene = path.parents[1]
    _look_at(scene / "images", masks=scene / "masks")


def _load_run(path: Path) -> None:
    result = rj.Result.load(path.parent)
    _ = result.objects(), str(result)


def _read_settings(path: Path) -> None:
    for setting in sweeps.read_settings(path):
        rj.load_config("default").updated({"thresholds": dict(setting)})


def refusal(error: BaseException) -> bool:
    """Whether an exception is an answer to the user."""
    return isinstance(error, (Refused, RemindError))


def _result_list(folder: Path) -> Path:
    tracks.write_json(folder / "truth.json", tracks.coco_video(tracks.TRUTH))
    return tracks.write_json(folder / "results.json", tracks.coco_results(tracks.ANSWERS))


def _traced(make: Callable[[], Any], name: str) -> Callable[[Path], Path]:
    def write(folder: Path) -> Path:
        made = make()
        result = made[1] if isinstance(made, tuple) else made
        result.save(folder / "run")
        return folder / "run" / name

    return write


def _explain(path: Path) -> None:
    for frame in (0, 3):
        remind("explain", path.parent, "--frame", frame, "--detection", 0)


def _weights(folder: Path) -> Path:
    path = folder / "weights.safetensors"
    path.write_bytes(converted_file("dino_tiny").read_bytes())
    return path


def _index_of_shards(folder: Path) -> Path:
    (folder / "model.safetensors").write_bytes(converted_file("dino_tiny").read_bytes())
    names = dict.fromkeys(("cls_token", "norm.bias"), "model.safetensors")
    return tracks.write_json(folder / "model.safetensors.index.json", {"weight_map": names})


def _apply_edits(path: Path) -> None:
    words = ("label", path.parent / "run", "--apply", path, "--out", path.parent / "truth")
    remind(*words, "--overwrite", "--quiet")


def _score(path: Path) -> None:
    remind("eval", path, path, "--resamples", 0)


def _as_masks(path: Path) -> None:
    _look_at(scene_beside(path), masks=path)


FORMATS: dict[str, Format] = {
    "coco results as masks": Format("json", _json_of(_coco_results), _as_masks),
    "coco video scored": Format("json", _json_of(lambda: tracks.coco_video(tracks.TRUTH)), _score),
    "frame lines": Format("jsonl", _frame_lines, _as_masks),
    "mot scored": Format("text", _text_of(tracks.mot_text), _score),
    "metadata of masks": Format("json", metadata, _scene_with_masks),
    "detections.jsonl viewed": Format("jsonl", run_file("detections.jsonl"), _load_run),
    "run.json": Format("json", run_file("run.json"), _load_run),
    "run scored": Format("jsonl", run_file("detections.jsonl"), lambda path: _score(path.parent)),
    "configuration": Format("yaml", config, lambda path: remind("config", "show", path)),
    "sweep settings": Format("json", sweep_settings, _read_settings),
    "memory": Format("safetensors", _memory, load_memory),
    "instance map": Format("header", _map, _scene_with_masks),
    "coco polygons": Format("json", binary_seeds.polygons, _as_masks),
    "coco categories": Format(
        "json",
        binary_seeds.categories,
        lambda path: _look_at(
            scene_beside(path), masks=path.with_name("results.json"), metadata=path
        ),
    ),
    "detector": Format("header", binary_seeds.detector, binary_seeds.detect),
    **{
        f"{suffix} picture": Format(
            "header", binary_seeds.pictures(suffix), lambda path: _look_at(path.parent)
        )
        for suffix in (".png", ".jpg", ".webp", ".bmp", ".tiff")
    },
    **{
        f"{name} video": Format("header", binary_seeds.video(name, codec, pixels), _look_at)
        for name, codec, pixels in (
            ("v.mp4", "libx264", "yuv420p"),
            ("v.avi", "mjpeg", "yuvj420p"),
            ("v.mkv", "mpeg4", "yuv420p"),
            ("v.gif", "gif", "rgb8"),
            ("v.apng", "apng", "rgb24"),
        )
    },
    "coco boxes scored": Format(
        "json", _json_of(lambda: tracks.coco_video(tracks.TRUTH, "bboxes")), _score
    ),
    "result list scored": Format(
        "json", _result_list, lambda path: remind("eval", path.parent / "truth.json", path)
    ),
    "mots scored": Format("text", _text_of(tracks.mots_text), _score),
    "trace explained": Format("npz", _traced(make_traced_run, "trace.npz"), _explain),
    "plus trace explained": Format("npz", _traced(make_plus_run, "trace.npz"), _explain),
    "traced run explained": Format("jsonl", _traced(make_plus_run, "detections.jsonl"), _explain),
    "run drawn": Format("json", run_file("run.json"), lambda path: remind("view", path.parent)),
    "edits of labels": Format("json", _edits, _apply_edits),
    "weights": Format("safetensors", _weights, load_weights),
    "index of shards": Format("json", _index_of_shards, open_weights),
}
