"""Renders scenes: pictures with exact instance masks, frame by frame."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator

import numpy as np

from remind_jax.frame import Detections, Frame
from remind_jax.synthetic.atlas import Atlas, pack_images
from remind_jax.synthetic.casting import change_objects, place_objects
from remind_jax.synthetic.floor_plan import furnish, lay_out_rooms
from remind_jax.synthetic.furniture import build_furniture, build_room
from remind_jax.synthetic.lighting import bake_light
from remind_jax.synthetic.mesh import Mesh, build_mesh
from remind_jax.synthetic.options import SceneOptions
from remind_jax.synthetic.raster import NO_FACE, Camera, see_faces, shade
from remind_jax.synthetic.roaming import set_roaming
from remind_jax.synthetic.scene import Pose, Scene, Sensor
from remind_jax.synthetic.sensor import Developer
from remind_jax.synthetic.shapes import build_object
from remind_jax.synthetic.surfaces import Part, turn
from remind_jax.synthetic.tour import plan_path

_ROOM_TEXEL_M = 0.05
_FURNITURE_TEXEL_M = 0.03
_OBJECT_TEXEL_M = 0.02
_OUT_OF_SIGHT_M = (0.0, 0.0, -1000.0)


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
    sensor = Sensor(
        options.width,
        options.height,
        options.noise,
        options.motion_blur,
        options.vignetting,
        options.exposure_lag,
        options.min_mask_px,
    )
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
        yield Frame(index, pose.source_index, pose.time_s, name, image, detections)


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
