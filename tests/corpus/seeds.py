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
from remind_jax.detectors import as_detector
from remind_jax.outputs.store import DETECTIONS_NAME, RUN_NAME
from remind_jax.outputs.writer import TRACE_NAME
from remind_jax.session.memory_file import SavedMemory, load_memory, save_memory
from tests.backbone.networks import converted_file
from tests.cli import scenes
from tests.detectors.onnx_bytes import write_fixed_answer
from tests.formats import scenes as tracks
from tests.outputs.fake_run import make_run
from tests.outputs.traced_run import make_plus_run, make_traced_run
from tests.sources.making import run_lengths, write_image, write_video
from weights_convert.stored_tensors import open_source as open_weights

NUM_FRAMES = 3
_SIDE_PX = 96  # of videos


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


def _detections(index: int, **more: Any) -> list[dict]:
    """Those of a frame, as COCO has them."""
    labels = scenes.picture(index)[1]
    return [
        {"segmentation": run_lengths(labels == instance), "score": 0.9, **more}
        for instance in scenes.FIRST_THREE
    ]


def _coco_results() -> list[dict]:
    found = (_detections(index, image_id=index, category_id=1) for index in range(NUM_FRAMES))
    return list(itertools.chain(*found))


def _polygons(folder: Path) -> Path:
    """A COCO data set with polygons and boxes."""
    scenes.write_scene(folder / "scene", NUM_FRAMES)
    outline = [[8.0, 8.0, 60.0, 8.5, 60.0, 60.0, 8.0, 60.0]]
    annotations = [
        {"id": 2 * image, "image_id": image, "category_id": 1, "segmentation": outline}
        for image in range(NUM_FRAMES)
    ]
    annotations += [
        {"id": 2 * image + 1, "image_id": image, "category_id": 2, "bbox": [100, 20, 50, 60.5]}
        for image in range(NUM_FRAMES)
    ]
    content = {
        "images": [{"id": i, "file_name": f"{i:04d}.png"} for i in range(NUM_FRAMES)],
        "categories": [{"id": 1, "name": "cup"}, {"id": 2, "name": "book"}],
        "annotations": annotations,
    }
    return tracks.write_json(folder / "dataset.json", content)


def _categories(folder: Path) -> Path:
    """Names of categories, beside results that need them."""
    scenes.write_scene(folder / "scene", NUM_FRAMES)
    rows = [
        {"image_id": i, "category_id": 1, "bbox": [8, 8, 50, 50], "score": 0.5}
        for i in range(NUM_FRAMES)
    ]
    tracks.write_json(folder / "results.json", rows)
    names = {"categories": [{"id": 1, "name": "cup"}]}
    return tracks.write_json(folder / "categories.json", names)


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


def _small_run() -> rj.Result:
    return make_run(6, (48, 64), 3)[1]


def _file_of(make: Callable[[], rj.Result], name: str) -> Callable[[Path], Path]:
    """A file of the folder of a run."""

    def write(folder: Path) -> Path:
        make().save(folder / "run")
        return folder / "run" / name

    return write


def _edits(folder: Path) -> Path:
    result = _small_run()
    result.save(folder / "run")
    num = sum(len(tracks) for tracks in result.tracks)
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
    settings = [{"decision.new": 1.0}, {"decision.new": 1.5, "looks.gain": 0.7}]
    return tracks.write_json(folder / "settings.json", settings)


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


def _result_list(folder: Path) -> Path:
    tracks.write_json(folder / "truth.json", tracks.coco_video(tracks.TRUTH))
    return tracks.write_json(folder / "results.json", tracks.coco_results(tracks.ANSWERS))


def _explain(path: Path) -> None:
    for frame in (0, 3):
        remind("explain", path.parent, "--frame", frame, "--detection", 0)


def _weights(folder: Path) -> Path:
    path = folder / "weights.safetensors"
    path.write_bytes(converted_file("dino_tiny").read_bytes())
    return path


def _pictures(suffix: str) -> Callable[[Path], Path]:
    """A folder of pictures of a kind; the first is changed."""

    def write(folder: Path) -> Path:
        for index in range(NUM_FRAMES):
            path = folder / "images" / f"{index:04d}{suffix}"
            write_image(path, scenes.picture(index)[0])
        return folder / "images" / f"0000{suffix}"

    return write


def _video(name: str, codec: str, pixels: str) -> Callable[[Path], Path]:
    """A video of a kind."""

    def make(index: int) -> np.ndarray:
        return np.ascontiguousarray(scenes.picture(index)[0][:_SIDE_PX, :_SIDE_PX])

    def write(folder: Path) -> Path:
        write_video(folder / name, NUM_FRAMES, codec, make=make, pixels=pixels)
        return folder / name

    return write


def _detector(folder: Path) -> Path:
    """A YOLO-seg network that finds one thing wherever it looks."""
    rows = np.zeros((1, 4 + 2 + 4, 84), np.float32)
    rows[0, :4, 0], rows[0, 4, 0], rows[0, 6:, 0] = (32, 32, 20, 20), 0.9, 1
    answers = {"output0": rows, "output1": np.ones((1, 4, 16, 16), np.float32)}
    metadata = {"names": "{0: 'cup', 1: 'tv'}", "imgsz": "[64, 64]", "stride": "32"}
    return write_fixed_answer(folder / "network.onnx", answers, (1, 3, 64, 64), metadata)


def _detect(path: Path) -> None:
    """Finds things in one frame."""
    as_detector(path)(scenes.picture(0)[0])


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
    "detections.jsonl viewed": Format("jsonl", _file_of(_small_run, DETECTIONS_NAME), _load_run),
    "run.json": Format("json", _file_of(_small_run, RUN_NAME), _load_run),
    "run scored": Format(
        "jsonl", _file_of(_small_run, DETECTIONS_NAME), lambda path: _score(path.parent)
    ),
    "configuration": Format("yaml", config, lambda path: remind("config", "show", path)),
    "sweep settings": Format("json", sweep_settings, _read_settings),
    "memory": Format("safetensors", _memory, load_memory),
    "instance map": Format("header", _map, _scene_with_masks),
    "coco polygons": Format("json", _polygons, _as_masks),
    "coco categories": Format(
        "json",
        _categories,
        lambda path: _look_at(
            scene_beside(path), masks=path.with_name("results.json"), metadata=path
        ),
    ),
    "detector": Format("header", _detector, _detect),
    **{
        f"{suffix} picture": Format("header", _pictures(suffix), lambda path: _look_at(path.parent))
        for suffix in (".png", ".jpg", ".webp", ".bmp", ".tiff")
    },
    **{
        f"{name} video": Format("header", _video(name, codec, pixels), _look_at)
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
    "trace explained": Format("npz", _file_of(lambda: make_traced_run()[1], TRACE_NAME), _explain),
    "plus trace explained": Format("npz", _file_of(make_plus_run, TRACE_NAME), _explain),
    "traced run explained": Format("jsonl", _file_of(make_plus_run, DETECTIONS_NAME), _explain),
    "run drawn": Format(
        "json", _file_of(_small_run, RUN_NAME), lambda path: remind("view", path.parent)
    ),
    "edits of labels": Format("json", _edits, _apply_edits),
    "weights": Format("safetensors", _weights, load_weights),
    "index of shards": Format("json", _index_of_shards, open_weights),
}
