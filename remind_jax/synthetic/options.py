"""What a generated tour should be like: every choice in one place, checked before work starts."""

from __future__ import annotations

import dataclasses
import math

from remind_jax.errors import ConfigError, nearest_names
from remind_jax.settings.record import setting, walk_settings
from remind_jax.synthetic.shapes import CLASSES

LOOKALIKE_KINDS = ("identical", "tint", "glaze", "pattern")
CAMERA_WAYS = ("tour", "still", "pan")


@dataclasses.dataclass(frozen=True)
class LookalikeGroup:
    """Several objects of one class that are easily confused.

    Kinds: `identical` (the very same thing, only place and neighbors differ), `tint` (same
    pattern, slightly other hue), `glaze` (same pattern, other colors), `pattern` (same colors,
    other pattern).
    """

    label: str  # class
    members: int
    kind: str = "identical"
    rooms: tuple[int, ...] = (0,)  # members are dealt out to these rooms in turn


@dataclasses.dataclass(frozen=True)
class SceneOptions:
    """Options of `make_scene`; equal options give equal scenes and equal pixels."""

    name: str = "tour"
    seed: int = setting(0, "of all that is drawn at random", least=0)
    # Space and objects.
    num_rooms: int = setting(
        2, "in a row, joined by corridors; with 1 the camera waits in a corridor", least=1, most=12
    )
    objects_per_room: int = setting(10, "look-alikes included", least=1)
    classes: tuple[str, ...] = tuple(CLASSES)
    lookalikes: tuple[LookalikeGroup, ...] = ()
    gap_m: float = setting(
        0.05,
        "least gap between objects on the same furniture; smaller is denser",
        least=0.0,
        most=1.0,
    )
    # Tour.
    frames: int = setting(120, "that are processed", least=1)
    absence_frames: int = setting(
        44, "frames of each absence from the first room; 0: never leaves it", least=0
    )
    returns: int = setting(1, "how often the camera comes back to the first room", least=1)
    fps: float = setting(5.0, "frames per second", least=0.01, most=1000)
    shake: float = setting(1.0, "factor on the hand shake", least=0, most=20)
    # `tour`: through the rooms and back; `still`: stands in the first room; `pan`: turns there.
    camera: str = "tour"
    # Light and sensor.
    light_drop: float = setting(
        0.1, "lamp level after the drop, relative to before; 1: no drop", least=0.001, most=1
    )
    window_level: float = setting(
        0.2, "light of the windows, relative to lamps at full level", least=0, most=2
    )
    width: int = setting(640, "pixels", least=32, most=4096)
    height: int = setting(480, "pixels", least=32, most=4096)
    noise: float = setting(2.0, "gray levels at normal gain", least=0, most=50)
    min_mask_px: int = setting(100, "instances with fewer visible pixels are left out", least=1)
    # Changes in the first room while the camera is away, as shares of its objects.
    moved: float = setting(0.0, "share of the objects", least=0, most=1)
    removed: float = setting(0.0, "share of the objects", least=0, most=1)
    added: float = setting(0.0, "share of the objects", least=0, most=1)
    swapped: float = setting(0.0, "share of the objects", least=0, most=1)
    # The whole time.
    roaming: float = setting(
        0.0,
        "share of the objects of the first room that fly about it, each on a way of its own, leave "
        "and come back elsewhere",
        least=0,
        most=1,
    )
    # Trouble with the camera.
    roll_deg: float = setting(0.0, "amplitude of slow rolling", least=0, most=45)
    zoom: float = setting(1.0, "largest zoom factor, reached and left slowly", least=1, most=4)
    jumps: int = setting(0, "sudden small changes of view", least=0)
    dropped_frames: float = setting(
        0.0, "share of source frames that are missing", least=0, most=0.9
    )

    def __post_init__(self) -> None:
        for name, value, record in walk_settings(self):
            least, most = record.least, record.most
            if least is not None and not least <= value <= (math.inf if most is None else most):
                allowed = f"{least:g} or more"
                if most is not None:
                    allowed = f"a number from {least:g} to {most:g}"
                raise ConfigError(f"scene option {name}={value!r} is not allowed; give {allowed}")
        if not self.name or set(self.name) & set("/\\") or self.name in (".", ".."):
            raise ConfigError(
                f"scene option name={self.name!r} is not allowed; give a name fit for a folder"
            )
        if not self.classes:
            raise ConfigError("scene option classes=() is not allowed; give one class or more")
        if self.camera not in CAMERA_WAYS:
            hint = nearest_names(self.camera, CAMERA_WAYS)
            raise ConfigError(f"there is no way of the camera {self.camera!r}; {hint}")
        self._check_tour()
        for label in (*self.classes, *(group.label for group in self.lookalikes)):
            if label not in CLASSES:
                hint = nearest_names(label, CLASSES)
                raise ConfigError(f"there is no object class {label!r} to render; {hint}")
        self._check_lookalikes()

    def _check_tour(self) -> None:
        away = self.absence_frames * self.returns if self.camera == "tour" else 0
        if away and away > self.frames - 2 * (self.returns + 1):
            raise ConfigError(
                f"{self.returns} absences of {self.absence_frames} frames do not fit into "
                f"frames={self.frames}; give at least {away + 2 * (self.returns + 1)} frames"
            )
        changes = self.moved + self.removed + self.swapped + self.roaming
        if changes > 1:
            raise ConfigError(
                f"moved, removed, swapped and roaming add up to {changes:g}; "
                "give shares of at most 1 in all"
            )

    def _check_lookalikes(self) -> None:
        for group in self.lookalikes:
            if group.kind not in LOOKALIKE_KINDS:
                hint = nearest_names(group.kind, LOOKALIKE_KINDS)
                raise ConfigError(f"there is no look-alike kind {group.kind!r}; {hint}")
            if group.members < 2:
                raise ConfigError(
                    f"a look-alike group of {group.label!r} has {group.members} members; "
                    "give 2 or more"
                )
            if not group.rooms or not all(0 <= room < self.num_rooms for room in group.rooms):
                raise ConfigError(
                    f"the look-alikes of {group.label!r} are in rooms {group.rooms}; "
                    f"rooms are numbered 0 to {self.num_rooms - 1}"
                )


def demo_options(seed: int = 8) -> SceneOptions:
    """The tour of `remind demo`: 120 frames, out of a bright room and back into it in the dark."""
    return SceneOptions(
        name="demo",
        seed=seed,
        min_mask_px=400,  # a patch and a half; few detectors find less
        num_rooms=2,
        objects_per_room=13,
        lookalikes=(
            LookalikeGroup("mug", 3, "glaze"),
            LookalikeGroup("box", 2, "identical"),
            LookalikeGroup("vase", 2, "tint"),
            LookalikeGroup("bottle", 2, "pattern", rooms=(0, 1)),
        ),
    )
