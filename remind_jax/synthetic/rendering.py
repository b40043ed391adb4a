"""Renders scenes: pictures with exact instance masks, frame by frame."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from remind_jax.frame import Detections, Frame
from remind_jax.synthetic.casting import change_objects, place_objects
from remind_jax.synthetic.floor_plan import furnish, lay_out_rooms
from remind_jax.synthetic.furniture import build_furniture, build_room
from remind_jax.synthetic.lighting import bake_light
from remind_jax.synthetic.mesh import Atlas, Mesh, build_mesh, pack_images
from remind_jax.synthetic.options import SceneOptions
from remind_jax.synthetic.raster import NO_FACE, Camera, see_faces, shade
from remind_jax.synthetic.scene import (
    CameraPath,
    Placement,
    Point,
    Pose,
    Scene,
    SceneObject,
    Sensor,
)
from remind_jax.synthetic.shapes import build_object
from remind_jax.synthetic.surfaces import Part, turn
from remind_jax.synthetic.tour import plan_path

_ROOM_TEXEL_M = 0.05
_FURNITURE_TEXEL_M = 0.03
_OBJECT_TEXEL_M = 0.02
_OUT_OF_SIGHT_M = (0.0, 0.0, -1000.0)

_DEPTHS_M = (1.1, 2.7)  # from the camera
_HEIGHTS_M = (0.5, 1.9)
_MARGIN_RAD = np.radians(8.0)  # beyond the sides of the field of view
_VISIT_FRAMES = (25, 60)
_ABSENCE_FRAMES = (12, 70)
_MAX_TURN_RAD = np.radians(1.5)  # per frame
_MAX_CURVE_M = 0.5  # by which the middle of a way is off the straight line
_LAMP_COLOR = np.array([1.06, 1.0, 0.9], np.float32)
_WINDOW_COLOR = np.array([0.86, 0.97, 1.14], np.float32)
_KEY = 0.3  # mean linear brightness that the exposure aims at
_COMPENSATION = 0.3  # 1: a dark room would end up as bright as a lit one
_GAIN_LIMITS = (0.35, 3.5)
_SHUTTER = 0.15  # share of the frame interval during which it is open
_VIGNETTING = 0.3  # loss of light in the corners
_EXPOSURE_LAG = 0.75  # 0: exposure follows at once, towards 1: never
_LENS_BLUR_PX = 0.62  # at 640 pixels width
_NOISE_POOL = 3


@dataclasses.dataclass(frozen=True)
class RenderedSequence:
    """A scene and all its frames."""

    scene: Scene
    frames: tuple[Frame, ...]


@dataclasses.dataclass(frozen=True, eq=False)
class _World:
    """One arrangement of a scene, ready to be drawn."""

    mesh: Mesh
    images: Atlas
    lights: Atlas
    light_scale: np.ndarray  # [surfaces, 2] light texels per color texel
    face_instance: np.ndarray  # [F + 1]; 0 where unannotated, and at -1 for `NO_FACE`

    def at(self, scene: Scene, source_frame: int) -> _World:
        """The same with everything that roams where it is in a frame, or out of sight."""
        roaming = [item for item in scene.objects if item.roams]
        if not roaming:
            return self
        face_instance = self.face_instance[:-1]
        rotation = np.broadcast_to(np.eye(3), (len(face_instance), 3, 3)).copy()
        shift = np.zeros((len(face_instance), 3))
        for item in roaming:
            faces = face_instance == item.instance_id
            start, now = item.placements[0], item.placement_at(source_frame)
            if now is None:
                shift[faces] = _OUT_OF_SIGHT_M
                continue
            position_m, yaw_rad = now.pose_at(source_frame)
            rotation[faces] = turn(np.eye(3), yaw_rad - start.yaw_rad).T
            shift[faces] = position_m - turn(np.array(start.position_m), yaw_rad - start.yaw_rad)
        return dataclasses.replace(self, mesh=self.mesh.moved(rotation, shift))


def make_scene(options: SceneOptions) -> Scene:
    """Draws a scene from options; the same options give an equal scene.

    Raises:
      ConfigError: If the objects do not fit into the rooms.
    """
    streams = [np.random.default_rng([options.seed, 10 + index]) for index in range(6)]
    rooms = lay_out_rooms(options, streams[0])
    furniture = furnish(options, streams[1])
    objects, places = place_objects(options, furniture, streams[2])
    path, light = plan_path(options, streams[3])
    if path.away and (options.moved or options.removed or options.added or options.swapped):
        start, end = path.away[0]
        frame = path.poses[(start + end) // 2].source_index
        objects = change_objects(objects, places, options, frame, streams[4])
    if options.roaming:
        objects = set_roaming(objects, path, options.roaming, streams[5])
    sensor = Sensor(options.width, options.height, options.noise, options.min_mask_px)
    return Scene(options.name, options.seed, rooms, furniture, tuple(objects), path, light, sensor)


def render(scene: Scene) -> Iterator[Frame]:
    """Yields the frames of a scene: RGB image and the instances seen in it.

    Detections come in order of instance id, with the class name as label and the truth in
    `instance_ids`; instances of fewer than `sensor.min_mask_px` visible pixels are left out.
    """
    sensor, light = scene.sensor, scene.light
    developer = Developer(sensor, scene.seed)
    gain = None
    labels = {item.instance_id: item.label for item in scene.objects}
    built, arrangement, last_pose = None, None, None
    for index, pose in enumerate(scene.path.poses):
        # What roams is built once, with the light of its first place, and moved as it is.
        current = tuple(
            item.placement_at(pose.source_index) for item in scene.objects if not item.roams
        )
        if built is None or current != arrangement:
            built, arrangement = _build_world(scene, pose.source_index), current
        world = built.at(scene, pose.source_index)
        fov_rad = scene.path.horizontal_fov_rad
        camera = Camera.at(pose, fov_rad, sensor.width_px, sensor.height_px)
        seen, projection = see_faces(world.mesh, camera)
        color, received = shade(
            world.mesh, projection, seen, camera, world.images, world.lights, world.light_scale
        )
        image, gain = developer.develop(
            color,
            received,
            light.lamp_level(pose.source_index),
            light.window_level,
            gain,
            _image_motion_px(last_pose, pose, camera),
            index,
        )
        last_pose = pose
        detections = _detect(world.face_instance[seen], labels, sensor)
        name = f"{index:05d}"
        yield Frame(index, pose.source_index, pose.time_s, name, image, detections, is_timed=True)


def render_sequence(options: SceneOptions) -> RenderedSequence:
    """Makes a scene and renders all its frames.

    Raises:
      ConfigError: If the objects do not fit into the rooms.
    """
    scene = make_scene(options)
    return RenderedSequence(scene, tuple(render(scene)))


def _build_world(scene: Scene, source_frame: int) -> _World:
    """Everything that stands in the rooms at a frame, textured and lit."""
    parts: list[Part] = []
    rooms: list[int] = []
    texels_m: list[float] = []
    instances: list[int] = []

    def add(new: list[Part], room: int, texel_m: float, instance: int = 0) -> None:
        parts.extend(new)
        rooms.extend([room] * len(new))
        texels_m.extend([texel_m] * len(new))
        instances.extend([instance] * len(new))

    for number, room in enumerate(scene.rooms):
        add(build_room(room, room.window is None), number, _ROOM_TEXEL_M)
    for piece in scene.furniture:
        add(build_furniture(piece), piece.room, _FURNITURE_TEXEL_M)
    for item in scene.objects:
        placement = item.placements[0] if item.roams else item.placement_at(source_frame)
        if placement is not None:
            built = build_object(item.label, item.look, item.scale)
            placed = [part.moved(placement.position_m, placement.yaw_rad) for part in built]
            add(placed, placement.room, _OBJECT_TEXEL_M, item.instance_id)
    surfaces = [surface for part in parts for surface in part.surfaces]
    layers = bake_light(parts, scene.rooms, rooms, texels_m)
    mesh = build_mesh(surfaces)
    instance = np.repeat(instances, [len(part.surfaces) for part in parts])
    sizes = np.array([surface.image.shape[1::-1] for surface in surfaces])
    light_sizes = np.array([layer.shape[1::-1] for layer in layers])
    assert NO_FACE == -1
    return _World(
        mesh,
        pack_images([surface.image for surface in surfaces]),
        pack_images(layers, num_levels=1),
        light_sizes / sizes,
        np.append(instance[mesh.surface], 0).astype(np.int32),
    )


def _detect(instances: np.ndarray, labels: dict[int, str], sensor: Sensor) -> Detections:
    counts = np.bincount(instances.ravel())
    ids = [i for i in range(1, len(counts)) if counts[i] >= sensor.min_mask_px]
    masks = instances[None] == np.array(ids, np.int32).reshape(-1, 1, 1)
    return Detections.create(masks, [labels[i] for i in ids], instance_ids=ids)


def _image_motion_px(last: Pose | None, pose: Pose, camera: Camera) -> tuple[float, float]:
    """How far the middle of the image moves between two poses when the camera turns."""
    if last is None:
        return (0.0, 0.0)
    yaw = (pose.yaw_rad - last.yaw_rad) * np.cos(pose.pitch_rad)
    pitch = pose.pitch_rad - last.pitch_rad
    # A cut is no motion: nothing smears by more than a tenth of the picture.
    limit = 0.1 * camera.width_px
    x, y = np.clip(np.array([yaw, pitch]) * camera.focal_px, -limit, limit)
    return (float(x), float(y))


def set_roaming(
    objects: Sequence[SceneObject], path: CameraPath, share: float, rng: np.random.Generator
) -> list[SceneObject]:
    """Sends a share of the objects of the first room on ways of their own, as long as the tour.

    They cross the field of view that the camera has at their entry, from one side to the other.
    """
    here = [index for index, item in enumerate(objects) if item.placements[0].room == 0]
    chosen = rng.permutation(here)[: round(share * len(here))]
    changed = list(objects)
    for index in sorted(int(i) for i in chosen):
        changed[index] = dataclasses.replace(
            objects[index], placements=tuple(_draw_ways(path, rng))
        )
    return changed


def _draw_ways(path: CameraPath, rng: np.random.Generator) -> list[Placement]:
    """Visits and absences in turn, until the end of the tour."""
    last = path.poses[-1].source_index
    starts = {pose.source_index: pose for pose in path.poses}
    at = int(rng.integers(0, min(_ABSENCE_FRAMES[1], last // 2 + 1)))
    placements: list[Placement] = []
    while at <= last:
        end = at + int(rng.integers(*_VISIT_FRAMES))
        pose = starts[min(starts, key=lambda frame, at=at: abs(frame - at))]
        placements += _draw_way(pose, path.horizontal_fov_rad, at, end, rng)
        at = end + int(rng.integers(*_ABSENCE_FRAMES))
    return placements


def _draw_way(
    pose: Pose, fov_rad: float, start: int, end: int, rng: np.random.Generator
) -> list[Placement]:
    """A bent way across the view of a camera: two straight pieces."""
    side = rng.choice([-1.0, 1.0]) * (fov_rad / 2 + _MARGIN_RAD)
    ends = []
    for angle in (side, -side):
        depth = rng.uniform(*_DEPTHS_M)
        yaw = pose.yaw_rad + angle
        x, y = np.array(pose.position_m[:2]) + depth * np.array([np.cos(yaw), np.sin(yaw)])
        ends.append(np.array([x, y, rng.uniform(*_HEIGHTS_M)]))
    middle = (ends[0] + ends[1]) / 2 + rng.uniform(-1, 1, 3) * _MAX_CURVE_M * (1, 1, 0.6)
    half = (start + end) // 2
    yaw, turn = float(rng.uniform(-0.6, 0.6)), float(rng.uniform(-1, 1) * _MAX_TURN_RAD)
    pieces = []
    for first, last, begin, finish in (
        (ends[0], middle, start, half),
        (middle, ends[1], half, end),
    ):
        step = (last - first) / (finish - begin)
        yaw_now = yaw + turn * (begin - start)
        pieces.append(Placement(_as_point(first), yaw_now, 0, begin, finish, _as_point(step), turn))
    return pieces


def _as_point(values: Float[np.ndarray, "3"]) -> Point:
    x, y, z = (float(value) for value in values)
    return (x, y, z)


class Developer:
    """Turns color and light images into pictures; holds what is the same for all frames."""

    def __init__(self, sensor: Sensor, seed: int):
        self._sensor = sensor
        height, width = sensor.height_px, sensor.width_px
        y, x = np.mgrid[0:height, 0:width].astype(np.float32)
        radius2 = ((x / width - 0.5) ** 2 + (y / height - 0.5) ** 2) * 2
        self._vignette = (1 - _VIGNETTING * radius2**1.2).astype(np.float32)[..., None]
        # Noise is cut from a few large sheets: fresh draws would double the time of a frame.
        rng = np.random.default_rng([seed, 5])
        shape = (_NOISE_POOL, height + 64, width + 64, 3)
        self._sheets = rng.standard_normal(shape, dtype=np.float32)
        self._seed = seed

    def develop(
        self,
        color: UInt8[np.ndarray, "H W 3"],
        light: Float[np.ndarray, "H W 2"],
        lamp_level: float,
        window_level: float,
        last_gain: float | None,
        motion_px: tuple[float, float],
        frame: int,
    ) -> tuple[UInt8[np.ndarray, "H W 3"], float]:
        """The picture of one frame and the gain that it was taken with.

        Args:
          light: Light from lamps at full level and from windows, per pixel.
          motion_px: How far the image moves per frame, for the blur.
        """
        mixed = light @ np.stack([lamp_level * _LAMP_COLOR, window_level * _WINDOW_COLOR])
        small = (slice(None, None, 8), slice(None, None, 8))
        # Highlights saturate in the meter as in the picture.
        radiance = (color[small].astype(np.float32) / 255) ** 2 * mixed[small]
        gain = self._meter(float(np.minimum(radiance, 1.0).mean()), last_gain)
        mixed *= gain * self._vignette
        picture = color.astype(np.float32) * np.sqrt(mixed, out=mixed)
        picture = self._blur(picture, motion_px, slow_shutter=lamp_level < 0.5)
        self._add_noise(picture, gain, frame)
        return np.clip(picture + 0.5, 0, 255).astype(np.uint8), gain

    def _meter(self, mean: float, last_gain: float | None) -> float:
        wanted = (_KEY / max(mean, 1e-5)) ** _COMPENSATION
        wanted = float(np.clip(wanted, *_GAIN_LIMITS))
        if last_gain is None:
            return wanted
        kept = _EXPOSURE_LAG * np.log(last_gain)
        return float(np.exp(kept + (1 - _EXPOSURE_LAG) * np.log(wanted)))

    def _blur(
        self, picture: np.ndarray, motion_px: tuple[float, float], slow_shutter: bool
    ) -> np.ndarray:
        """Lens blur, and a smear along the motion; a camera opens longer in the dark."""
        lens_px = _LENS_BLUR_PX * max(self._sensor.width_px / 640, 0.5)
        picture = cv2.GaussianBlur(picture, (3, 3), lens_px)
        share = _SHUTTER * (1.5 if slow_shutter else 1.0)
        smear = np.array(motion_px) * share
        length = float(np.hypot(*smear))
        if length < 1.0:
            return picture
        half = int(np.ceil(length / 2))
        kernel = np.zeros((2 * half + 1, 2 * half + 1), np.float32)
        steps = np.linspace(-0.5, 0.5, 4 * half + 1)[:, None] * smear + half
        for x, y in np.rint(steps).astype(int):
            kernel[y, x] += 1
        return cv2.filter2D(picture, -1, kernel / kernel.sum(), borderType=cv2.BORDER_REPLICATE)

    def _add_noise(self, picture: np.ndarray, gain: float, frame: int) -> None:
        if self._sensor.noise == 0:
            return
        rng = np.random.default_rng([self._seed, 6, frame])
        sheet = self._sheets[int(rng.integers(_NOISE_POOL))]
        top, left = rng.integers(0, 64, 2)
        height, width = picture.shape[:2]
        strength = np.float32(self._sensor.noise * np.sqrt(max(gain, 0.5)))
        picture += strength * sheet[top : top + height, left : left + width]
