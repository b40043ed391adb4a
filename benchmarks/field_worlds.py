"""The sequences of `field.py`: objects are seen, then nothing is, for so long, then they are back.

Three worlds, each rendered once per seed; only the number of frames in between changes:

* `same view`: nothing moves, and the camera is where it was: time alone has passed;
* `other side`: the camera walks out of a room and comes back from elsewhere; nothing else moves;
* `moving`: the camera stands, all objects fly about, and go on while nobody looks.

While they are away the lens is covered: gray pictures without detections. In `other side` the first
of these frames show another room with objects of its own. All objects are of one class.
"""

from __future__ import annotations

import dataclasses
import hashlib
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int, UInt8

import remind_jax.synthetic as synthetic
from remind_jax.frame import Detections, Frame
from remind_jax.synthetic import (
    LookalikeGroup,
    Placement,
    Pose,
    Scene,
    SceneObject,
    SceneOptions,
    make_scene,
    render,
)
from remind_jax.synthetic.shapes import CLASSES

SAME, OTHER, MOVING = "same view", "other side", "moving"
ABSENCES = (1, 3, 10, 30, 100, 300, 1000, 3000)
ABSENCES_OF_SAME = (1, 10, 100, 1000)
ALIKE = (1, 2, 4, 12)
LIGHT = (1.0, 0.3, 0.1, 0.03)
SWEPT_ABSENCE = 30  # frames away where something else is varied
FIRST_SEED = 200  # worlds of seeds from here on are for evaluation only
NUM_OBJECTS = 12
FPS = 10.0
LABEL = "thing"  # the class of everything
SCORE = 0.95  # the detector's, of everything
COVERED = -1  # instead of the number of a picture
COVERED_GRAY = 40

_BEFORE, _AFTER = 30, 30  # frames of a still camera
_LOOK_BEFORE, _LOOK_AWAY, _LOOK_AFTER = 50, 30, 50  # frames of a walk
_SHOWN_AWAY = 20  # at most, of the other room
_SMALL = tuple(name for name, kind in CLASSES.items() if kind.place == "surface")
_ALIKE_CLASSES = ("mug", "box", "vase", "bottle", "book", "bowl")
_FEW = (
    LookalikeGroup("mug", 3, "glaze"),
    LookalikeGroup("box", 2, "pattern"),
    LookalikeGroup("vase", 2, "tint"),
)
_BASE = SceneOptions(
    width=320, height=240, min_mask_px=80, fps=FPS, light_drop=1.0, objects_per_room=NUM_OBJECTS
)


@dataclasses.dataclass(frozen=True)
class Question:
    """One point on the horizontal axis of one plot."""

    varied: str  # "absence", "alike" or "light"
    world: str
    absence: int = SWEPT_ABSENCE  # frames
    alike: int = 0  # objects per group of look-alikes; 0: the usual few
    light: float = 1.0  # lamps at the return, relative to before

    @property
    def value(self) -> float:
        """What is varied."""
        return {"absence": self.absence, "alike": self.alike, "light": self.light}[self.varied]

    @property
    def name(self) -> str:
        """Unique, fit for a file."""
        return f"{self.varied}-{self.world.replace(' ', '-')}-{self.value:g}"


@dataclasses.dataclass(frozen=True)
class Pictures:
    """What was rendered for some questions of one seed."""

    file: Path  # .npy, RGB uint8 [K, H, W, 3]
    instances: UInt8[np.ndarray, "K H W"]  # 0: none
    before: Int[np.ndarray, "B"]  # numbers of pictures
    away: Int[np.ndarray, "A"]
    after: Int[np.ndarray, "C"]

    def images(self) -> UInt8[np.ndarray, "K H W 3"]:
        """The pictures, read when they are looked at."""
        return np.load(self.file, mmap_mode="r")


@dataclasses.dataclass(frozen=True)
class Trial:
    """One sequence: a question asked of one seed."""

    name: str
    question: Question
    pictures: Pictures
    picture: Int[np.ndarray, "T"]  # shown in each frame, or COVERED
    gone: int  # first frame of the absence
    back: int  # first frame after it

    def frames(self) -> Iterator[Frame]:
        """The frames with true masks; all objects are of one class."""
        images = self.pictures.images()
        height, width = images.shape[1:3]
        covered = np.full((height, width, 3), COVERED_GRAY, np.uint8)
        for index, number in enumerate(self.picture):
            image, found = covered, Detections.empty(height, width)
            if number != COVERED:
                image = np.array(images[number])
                found = _detections(self.pictures.instances[number])
            yield Frame(index, index, index / FPS, f"{index:05d}", image, found)


def questions(quick: bool = False) -> tuple[Question, ...]:
    """All points of all plots; `quick`: few of each."""
    absences, of_same = ((1, 30), (30,)) if quick else (ABSENCES, ABSENCES_OF_SAME)
    alike, light = ((4,), (0.1,)) if quick else (ALIKE, LIGHT)
    return (
        *(Question("absence", SAME, n) for n in of_same),
        *(Question("absence", world, n) for world in (OTHER, MOVING) for n in absences),
        *(Question("alike", world, alike=n) for world in (OTHER, MOVING) for n in alike),
        *(Question("light", OTHER, light=level) for level in light),
    )


def make_trials(asked: tuple[Question, ...], seed: int, folder: Path) -> Iterator[Trial]:
    """Renders what is not in the folder yet, and makes one sequence per question."""
    for question in asked:
        pictures = _rendered(question, seed, folder)
        shown = pictures.away[: min(question.absence, _SHOWN_AWAY)]
        wait = np.full(question.absence - len(shown), COVERED)
        picture = np.concatenate([pictures.before, shown, wait, pictures.after]).astype(np.int32)
        gone = len(pictures.before)
        name = f"{question.name}-{seed}"
        yield Trial(name, question, pictures, picture, gone, gone + question.absence)


def _rendered(question: Question, seed: int, folder: Path) -> Pictures:
    options = _options(question, seed)
    # What moves is elsewhere after every absence; what stays is rendered once for all of them.
    absence = question.absence if question.world == MOVING else 0
    key = hashlib.sha256(f"{question.world} {absence} {options} {_renderer()}".encode()).hexdigest()
    stem = folder / f"{question.world.replace(' ', '-')}-{seed}-{key[:12]}"
    images_file, rest_file = stem.with_suffix(".npy"), stem.with_suffix(".npz")
    if not rest_file.is_file():
        folder.mkdir(parents=True, exist_ok=True)
        scene = make_scene(options)
        if question.world == MOVING:
            scene = _set_flying(scene, absence, seed)
        frames = list(render(scene))
        instances = np.stack([_instance_map(frame) for frame in frames])
        np.save(images_file, np.stack([np.asarray(frame.image) for frame in frames]))
        before, away, after = _divide(question.world, scene, instances)
        np.savez_compressed(rest_file, instances=instances, before=before, away=away, after=after)
    with np.load(rest_file) as rest:
        return Pictures(images_file, **{name: rest[name] for name in rest.files})


def _options(question: Question, seed: int) -> SceneOptions:
    lookalikes, classes = _FEW, _BASE.classes
    if question.alike:
        classes = _ALIKE_CLASSES if question.alike > 1 else classes
        lookalikes = tuple(
            LookalikeGroup(label, question.alike, "tint")
            for label in _ALIKE_CLASSES[: NUM_OBJECTS // question.alike]
            if question.alike > 1
        )
    common = {"name": "field", "seed": seed, "lookalikes": lookalikes, "classes": classes}
    if question.world == OTHER:
        frames = _LOOK_BEFORE + _LOOK_AWAY + _LOOK_AFTER
        walk = {"num_rooms": 2, "frames": frames, "absence_frames": _LOOK_AWAY}
        return dataclasses.replace(_BASE, **common, **walk, light_drop=question.light)
    if question.world == MOVING and not question.alike > 1:
        common["classes"] = _SMALL  # what hides little
    still = {"num_rooms": 1, "frames": _BEFORE + _AFTER, "absence_frames": 0, "camera": "still"}
    return dataclasses.replace(_BASE, **common, **still)


def _divide(world: str, scene: Scene, instances: np.ndarray) -> tuple[np.ndarray, ...]:
    """Numbers of the pictures before, away and after; none of those away shows what returns."""
    every = np.arange(len(instances))
    if world != OTHER:
        return every[:_BEFORE], every[:0], every[_BEFORE:]
    ((start, end),) = scene.path.away
    here = [item.instance_id for item in scene.objects if item.placements[0].room == 0]
    is_away = ~np.isin(instances[start:end], here).any(axis=(1, 2))
    return every[:start], every[start:end][is_away], every[end:]


def _set_flying(scene: Scene, absence: int, seed: int) -> Scene:
    """All objects on ways of their own before the camera, that go on through the absence."""
    rng = np.random.default_rng([seed, 29])
    poses = tuple(
        pose
        if index < _BEFORE
        else dataclasses.replace(pose, source_index=index + absence, time_s=(index + absence) / FPS)
        for index, pose in enumerate(scene.path.poses)
    )
    shown = np.array([pose.source_index for pose in poses])
    objects = tuple(_flying(item, poses[0], shown, rng) for item in scene.objects)
    path = dataclasses.replace(scene.path, poses=poses)
    return dataclasses.replace(scene, objects=objects, path=path)


def _flying(
    item: SceneObject, camera: Pose, shown: Int[np.ndarray, "T"], rng: np.random.Generator
) -> SceneObject:
    """To and fro between limits of bearing, elevation and depth, each in a time of its own."""
    periods, phases = rng.uniform((100, 90, 140), (180, 160, 260)), rng.uniform(0, 1, 3)
    yaw, turn = rng.uniform(-0.5, 0.5), rng.uniform(-1, 1) * np.radians(0.6)

    def place(frame: Int[np.ndarray, "T"]) -> Float[np.ndarray, "T 3"]:
        there = np.abs(2 * ((frame[:, None] / periods + phases) % 1) - 1)  # 0 to 1 and back
        low, high = (-27.0, -26.0, 1.3), (27.0, 12.0, 2.5)
        bearing, elevation, depth = (low + there * np.subtract(high, low)).T
        angle = camera.yaw_rad + np.radians(bearing)
        x, y, z = camera.position_m
        away = (depth * np.cos(angle), depth * np.sin(angle), depth * np.tan(np.radians(elevation)))
        return np.stack([x + away[0], y + away[1], z + away[2]], axis=1)

    now, later = place(shown), place(shown + 1)
    placements = tuple(
        Placement(
            tuple(map(float, at)), float(yaw + turn * frame), 0, int(frame), int(frame) + 1,
            tuple(map(float, step)), float(turn),
        )
        for frame, at, step in zip(shown, now, later - now, strict=True)
    )  # fmt: skip
    return dataclasses.replace(item, placements=placements)


def _instance_map(frame: Frame) -> UInt8[np.ndarray, "H W"]:
    found = frame.detections
    assert found is not None
    drawn = np.zeros(frame.size, np.uint8)
    for mask, instance in zip(np.asarray(found.masks), found.instance_ids, strict=True):
        drawn[mask] = instance
    return drawn


def _detections(instances: UInt8[np.ndarray, "H W"]) -> Detections:
    ids = np.unique(instances)
    ids = ids[ids > 0]
    masks = instances[None] == ids[:, None, None]
    num = len(ids)
    return Detections.create(masks, [LABEL] * num, np.full(num, SCORE, np.float32), ids)


def _renderer() -> str:
    """Changes with the program that renders."""
    files = sorted(Path(str(synthetic.__file__)).parent.glob("*.py"))
    return hashlib.sha256(b"".join(file.read_bytes() for file in files)).hexdigest()
