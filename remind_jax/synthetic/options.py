"""What a generated tour should be like: every choice in one place, checked before work starts."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

from remind_jax.errors import ConfigError, nearest_names
from remind_jax.synthetic.shapes import CLASSES

LOOKALIKE_KINDS = ("identical", "tint", "glaze", "pattern")


@dataclasses.dataclass(frozen=True)
class LookalikeGroup:
    """Several objects of one class that are easily confused.

    Kinds: `identical` (the very same thing, only place and neighbours differ), `tint` (same
    pattern, slightly other hue), `glaze` (same pattern, other colours), `pattern` (same colours,
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
    seed: int = 0
    # Space and objects.
    num_rooms: int = 2  # in a row, joined by corridors; with 1 the camera waits in a corridor
    objects_per_room: int = 10  # look-alikes included
    classes: tuple[str, ...] = tuple(CLASSES)
    lookalikes: tuple[LookalikeGroup, ...] = ()
    gap_m: float = 0.05  # least gap between objects on the same furniture; smaller is denser
    # Tour.
    frames: int = 120
    absence_frames: int = 44  # frames of each absence from the first room; 0: never leaves it
    returns: int = 1  # how often the camera comes back to the first room
    fps: float = 5.0
    pause_s: float = 180.0  # unrecorded time in the middle of each absence
    horizontal_fov_deg: float = 70.0
    shake: float = 1.0  # factor on the hand shake
    # Light and sensor.
    light_drop: float = 0.1  # lamp level after the drop, relative to before; 1: no drop
    light_ramp_frames: int = 5
    window_level: float = 0.2
    width: int = 640
    height: int = 480
    noise: float = 2.0  # grey levels at normal gain
    motion_blur: float = 0.15  # share of the frame interval
    vignetting: float = 0.3
    exposure_lag: float = 0.75
    min_mask_px: int = 100
    # Changes in the first room while the camera is away, as shares of its objects.
    moved: float = 0.0
    removed: float = 0.0
    added: float = 0.0
    swapped: float = 0.0
    # Trouble with the camera.
    roll_deg: float = 0.0  # amplitude of slow rolling
    zoom: float = 1.0  # largest zoom factor, reached and left slowly
    jumps: int = 0  # sudden small changes of view
    dropped_frames: float = 0.0  # share of source frames that are missing

    def __post_init__(self) -> None:
        for name, (is_allowed, allowed) in _LIMITS.items():
            value = getattr(self, name)
            if not is_allowed(value):
                raise ConfigError(f"scene option {name}={value!r} is not allowed; give {allowed}")
        self._check_tour()
        for label in (*self.classes, *(group.label for group in self.lookalikes)):
            if label not in CLASSES:
                hint = nearest_names(label, CLASSES)
                raise ConfigError(f"there is no object class {label!r} to render; {hint}")
        self._check_lookalikes()

    def _check_tour(self) -> None:
        away = self.absence_frames * self.returns
        if self.absence_frames and away > self.frames - 2 * (self.returns + 1):
            raise ConfigError(
                f"{self.returns} absences of {self.absence_frames} frames do not fit into "
                f"frames={self.frames}; give at least {away + 2 * (self.returns + 1)} frames"
            )
        changes = self.moved + self.removed + self.swapped
        if changes > 1:
            raise ConfigError(
                f"moved, removed and swapped add up to {changes:g}; give shares of at most 1 in all"
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


def _at_least(low: float) -> tuple[Callable[[float], bool], str]:
    return (lambda value: value >= low), f"{low:g} or more"


def _between(low: float, high: float) -> tuple[Callable[[float], bool], str]:
    return (lambda value: low <= value <= high), f"a number from {low:g} to {high:g}"


_LIMITS: dict[str, tuple[Callable[..., bool], str]] = {
    "name": (
        lambda name: bool(name) and not set(name) & set("/\\") and name not in (".", ".."),
        "a name fit for a folder",
    ),
    "seed": _at_least(0),
    "num_rooms": _between(1, 12),
    "objects_per_room": _at_least(1),
    "classes": (bool, "one class or more"),
    "gap_m": _between(0.0, 1.0),
    "frames": _at_least(1),
    "absence_frames": _at_least(0),
    "returns": _at_least(1),
    "fps": _between(0.01, 1000),
    "pause_s": _at_least(0),
    "horizontal_fov_deg": _between(20, 120),
    "shake": _between(0, 20),
    "light_drop": _between(0.001, 1),
    "light_ramp_frames": _at_least(1),
    "window_level": _between(0, 2),
    "width": _between(32, 4096),
    "height": _between(32, 4096),
    "noise": _between(0, 50),
    "motion_blur": _between(0, 1),
    "vignetting": _between(0, 0.9),
    "exposure_lag": _between(0, 0.99),
    "min_mask_px": _at_least(1),
    "moved": _between(0, 1),
    "removed": _between(0, 1),
    "added": _between(0, 1),
    "swapped": _between(0, 1),
    "roll_deg": _between(0, 45),
    "zoom": _between(1, 4),
    "jumps": _at_least(0),
    "dropped_frames": _between(0, 0.9),
}
