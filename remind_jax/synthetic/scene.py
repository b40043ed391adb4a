"""What a generated tour is made of: rooms, furniture, objects, camera poses, light, sensor.

World frame: x east, y north, z up, meters. Yaw turns counter-clockwise from east, pitch is
positive upwards. An object's or a piece of furniture's own frame has its origin in the middle of
its foot and its front towards -y; things on a wall have their origin in the middle of their back.
Everything here is plain data: two scenes made from equal options compare equal.
"""

from __future__ import annotations

import dataclasses

Point = tuple[float, float, float]


@dataclasses.dataclass(frozen=True)
class Opening:
    """A hole in the west or east wall of a room that reaches down to the floor."""

    wall: str  # "west" or "east"
    center_m: float  # y of its middle
    width_m: float
    height_m: float


@dataclasses.dataclass(frozen=True)
class Window:
    """A bright rectangle on the south wall; it keeps shining when the lamps are turned down."""

    center_m: tuple[float, float]  # along the wall (x) and up (z)
    size_m: tuple[float, float]  # width, height


@dataclasses.dataclass(frozen=True)
class Room:
    """An axis-aligned room (or corridor) with one lamp under its ceiling."""

    name: str
    x_m: tuple[float, float]
    y_m: tuple[float, float]
    height_m: float
    texture_seed: int
    openings: tuple[Opening, ...] = ()
    window: Window | None = None

    @property
    def lamp_m(self) -> Point:
        """Where the lamp hangs."""
        return (sum(self.x_m) / 2, sum(self.y_m) / 2, self.height_m - 0.12)


@dataclasses.dataclass(frozen=True)
class Furniture:
    """Something that carries objects; it is never annotated."""

    kind: str  # a key of `furniture.KINDS`
    size_m: Point  # width, depth, height
    position_m: Point
    yaw_rad: float
    room: int  # index into `Scene.rooms`
    texture_seed: int


@dataclasses.dataclass(frozen=True)
class Look:
    """Seeds of an object's appearance; equal looks of one class are the very same thing."""

    pattern_seed: int
    palette_seed: int
    hue_shift_deg: float = 0.0


@dataclasses.dataclass(frozen=True)
class Placement:
    """Where an object is during some frames of the source, at rest or on a straight way."""

    position_m: Point  # of a moving object: in the first of the frames
    yaw_rad: float
    room: int
    start_frame: int = 0
    end_frame: int | None = None  # first frame without it; None: to the end
    step_m: Point = (0.0, 0.0, 0.0)  # movement per frame
    turn_rad: float = 0.0  # change of yaw per frame

    @property
    def is_moving(self) -> bool:
        """Whether the object is elsewhere in every frame."""
        return self.step_m != (0.0, 0.0, 0.0) or self.turn_rad != 0.0

    def pose_at(self, source_frame: int) -> tuple[Point, float]:
        """Position and yaw in a frame."""
        passed = source_frame - self.start_frame
        x, y, z = (a + passed * s for a, s in zip(self.position_m, self.step_m, strict=True))
        return (x, y, z), self.yaw_rad + passed * self.turn_rad


@dataclasses.dataclass(frozen=True)
class SceneObject:
    """An annotated instance; in frames that no placement covers it is not in the world."""

    instance_id: int  # >= 1, the same through the whole tour
    label: str  # class, a key of `shapes.CLASSES`
    look: Look
    scale: float  # of the class's nominal size
    placements: tuple[Placement, ...]
    group: str = ""  # name of its look-alike group, empty if it is one of a kind

    @property
    def roams(self) -> bool:
        """Whether the object is ever on the move."""
        return any(place.is_moving for place in self.placements)

    def placement_at(self, source_frame: int) -> Placement | None:
        """The placement valid in a frame, or None while the object is away."""
        for place in self.placements:
            has_ended = place.end_frame is not None and source_frame >= place.end_frame
            if place.start_frame <= source_frame and not has_ended:
                return place
        return None


@dataclasses.dataclass(frozen=True)
class Pose:
    """Where the camera is in one processed frame."""

    position_m: Point
    yaw_rad: float
    pitch_rad: float
    roll_rad: float = 0.0
    zoom: float = 1.0  # factor on the focal length
    source_index: int = 0  # frame number before frames were dropped
    time_s: float = 0.0


@dataclasses.dataclass(frozen=True)
class CameraPath:
    """One pose per processed frame."""

    poses: tuple[Pose, ...]
    horizontal_fov_rad: float
    away: tuple[tuple[int, int], ...]  # [first, last + 1) processed frames outside the first room


LIGHT_RAMP_FRAMES = 5  # that the fall of the lamps takes


@dataclasses.dataclass(frozen=True)
class Light:
    """How bright lamps and windows are over time."""

    drop_frame: int | None  # source frame at which the lamps start to go down; None: never
    drop_factor: float  # lamp level afterwards, relative to before
    window_level: float  # constant, relative to a lamp at full level

    def lamp_level(self, source_frame: int) -> float:
        """Lamp level in a frame, 1 before the drop."""
        if self.drop_frame is None or source_frame < self.drop_frame:
            return 1.0
        fallen = min((source_frame - self.drop_frame + 1) / LIGHT_RAMP_FRAMES, 1.0)
        return self.drop_factor**fallen


@dataclasses.dataclass(frozen=True)
class Sensor:
    """The camera's size and flaws."""

    width_px: int
    height_px: int
    noise: float  # standard deviation in gray levels at normal gain
    min_mask_px: int  # instances with fewer visible pixels are left out of the frame


@dataclasses.dataclass(frozen=True)
class Scene:
    """Everything needed to render a tour, and nothing else."""

    name: str
    seed: int
    rooms: tuple[Room, ...]
    furniture: tuple[Furniture, ...]
    objects: tuple[SceneObject, ...]
    path: CameraPath
    light: Light
    sensor: Sensor
