"""The way of the camera: through the first room, out, and back in from elsewhere."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from scipy.ndimage import gaussian_filter1d

from remind_jax.synthetic.floor_plan import DOOR_Y_M, ROOM_WIDTH_M, room_offset_m
from remind_jax.synthetic.options import SceneOptions
from remind_jax.synthetic.scene import LIGHT_RAMP_FRAMES, CameraPath, Light, Pose

_EYE_M = 1.38
_FIELD_OF_VIEW_DEG = 70.0  # from side to side
_PAUSE_S = 180.0  # not recorded, in the middle of each absence
_DEG_PER_M = 20.0  # walking a meter takes as many frames as turning by this angle
_SHAKE_DEG = 0.22
_SHAKE_M = 0.004

# Views are x, y (relative to the room's south-west corner), yaw and pitch in degrees. The camera
# keeps looking north of its way, as somebody does who films while walking: so the whole tour needs
# few degrees per frame, and an object's masks overlap from frame to frame.
_View = tuple[float, float, float, float]
_FIRST_LOOK: tuple[_View, ...] = (
    (2.5, 1.85, 158.0, -15.0),
    (1.95, 1.95, 112.0, -17.0),
    (2.2, 2.0, 82.0, -17.0),
    (2.4, 1.85, 56.0, -15.0),
)
_STILL: tuple[_View, ...] = ((2.0, 0.45, 90.0, -8.0),) * 2
_PAN_DEG = 32.0  # to both sides
_PAN_FRAMES = 90  # there and back
_LEAVE: tuple[_View, ...] = ((3.05, 1.3, 38.0, -10.0),)
_TURN_BACK: tuple[_View, ...] = (
    (0.5, 1.1, 38.0, -9.0),
    (1.0, 1.4, 70.0, -13.0),
    (1.1, 1.45, 105.0, -14.0),
    (0.7, 1.2, 128.0, -10.0),
)
_PASS_EAST: tuple[_View, ...] = ((1.2, 1.15, 50.0, -11.0), (2.6, 1.15, 55.0, -12.0))
_PASS_WEST: tuple[_View, ...] = ((2.6, 1.15, 125.0, -12.0), (1.2, 1.15, 130.0, -11.0))
_SECOND_LOOK: tuple[_View, ...] = (
    (3.45, 1.25, 148.0, -11.0),
    (3.15, 1.65, 140.0, -14.0),
    (2.95, 1.8, 98.0, -16.0),
    (2.7, 1.65, 52.0, -15.0),
)


def plan_path(options: SceneOptions, rng: np.random.Generator) -> tuple[CameraPath, Light]:
    """Camera poses of all processed frames and the schedule of the light.

    A tour is a first look, then `returns` times an absence and another look. Within each of these
    the camera turns and walks at an even pace; the lamps go down late in the last absence.
    """
    num_source = round(options.frames / (1 - options.dropped_frames))
    kept = np.sort(rng.choice(num_source, options.frames, replace=False))
    kept[0] = 0
    spans = _divide_frames(options)
    stretch = num_source / options.frames
    source_spans = [(round(a * stretch), round(b * stretch)) for a, b in spans]
    views = _fly(_sections(options), source_spans, num_source)
    views = views + _hand_shake(options, num_source, rng) + _jumps(options, num_source, rng)
    slow = np.linspace(0, 2 * np.pi * max(1.0, num_source / 150), num_source)
    if options.camera == "pan":
        views[:, 3] += _PAN_DEG * np.sin(
            np.linspace(0, 2 * np.pi * num_source / _PAN_FRAMES, num_source)
        )
    roll = np.radians(options.roll_deg) * np.sin(slow)
    roll += np.radians(0.5 * _SHAKE_DEG * options.shake) * _smooth_noise(num_source, 1, rng)[:, 0]
    zoom = options.zoom ** (0.5 - 0.5 * np.cos(slow))
    away = [span for index, span in enumerate(source_spans) if index % 2 == 1]
    time_s = np.arange(num_source) / options.fps
    for start, end in away:
        time_s[(start + end) // 2 :] += _PAUSE_S
    poses = tuple(
        Pose(
            (float(x), float(y), float(z)),
            float(np.radians(yaw)),
            float(np.radians(pitch)),
            float(roll[frame]),
            float(zoom[frame]),
            int(frame),
            float(time_s[frame]),
        )
        for frame in kept
        for x, y, z, yaw, pitch in (views[frame],)
    )
    fov_rad = float(np.radians(_FIELD_OF_VIEW_DEG))
    gone = tuple(
        (int(np.searchsorted(kept, start)), int(np.searchsorted(kept, end))) for start, end in away
    )
    return CameraPath(poses, fov_rad, gone), _plan_light(options, away)


def _plan_light(options: SceneOptions, away: list[tuple[int, int]]) -> Light:
    drop_frame = None
    if away and options.light_drop < 1:
        start, end = away[-1]
        drop_frame = max(start, end - max(LIGHT_RAMP_FRAMES, (end - start) // 4))
    return Light(drop_frame, options.light_drop, options.window_level)


def _divide_frames(options: SceneOptions) -> list[tuple[int, int]]:
    """Frame spans of look, absence, look, absence, ..., look."""
    if options.absence_frames == 0 or options.camera != "tour":
        return [(0, options.frames)]
    looking = options.frames - options.returns * options.absence_frames
    # The first look takes somewhat longer: it turns further and ends at the door.
    weights = np.array([1.45] + [1.0] * options.returns)
    ends = np.round(np.cumsum(weights) / weights.sum() * looking).astype(int)
    spans, at = [], 0
    for index, length in enumerate(np.diff(ends, prepend=0)):
        spans.append((at, at + int(length)))
        at += int(length)
        if index < options.returns:
            spans.append((at, at + options.absence_frames))
            at += options.absence_frames
    return spans


def _sections(options: SceneOptions) -> list[list[_View]]:
    """Views of every span, in world coordinates, yaw unwrapped; neighbors share their border."""
    if options.camera != "tour":
        return [list(_STILL)]
    if options.absence_frames == 0:
        return [list(_FIRST_LOOK)]
    east = (ROOM_WIDTH_M, DOOR_Y_M, 34.0, -7.0)
    west = (ROOM_WIDTH_M, DOOR_Y_M, 140.0, -8.0)
    sections = [[*_FIRST_LOOK, *_LEAVE, east]]
    for number in range(options.returns):
        sections.append([east, *_outing(options.num_rooms), west])
        is_last = number + 1 == options.returns
        leave = () if is_last else (*_LEAVE, east)
        sections.append([west, *_SECOND_LOOK, *leave])
    return sections


def _outing(num_rooms: int) -> list[_View]:
    """From the first room's door through the other rooms and back, turning by the north."""
    if num_rooms == 1:
        x = ROOM_WIDTH_M
        return [(x + 1.5, DOOR_Y_M, 20.0, -8.0), (x + 1.6, DOOR_Y_M, 90.0, -8.0)]
    views: list[_View] = []
    for room in range(1, num_rooms):
        local = _TURN_BACK if room == num_rooms - 1 else _PASS_EAST
        views += [(room_offset_m(room) + x, y, yaw, pitch) for x, y, yaw, pitch in local]
    for room in range(num_rooms - 2, 0, -1):
        views += [(room_offset_m(room) + x, y, yaw, pitch) for x, y, yaw, pitch in _PASS_WEST]
    return views


def _fly(
    sections: list[list[_View]], spans: list[tuple[int, int]], num_frames: int
) -> Float[np.ndarray, "T 5"]:
    """x, y, z, yaw, pitch of every frame, through all views at an even pace in each section."""
    times, views = [], []
    for section, (start, end) in zip(sections, spans, strict=True):
        points = np.array(section)
        steps = np.diff(points, axis=0)
        walk_m = np.hypot(steps[:, 0], steps[:, 1])
        effort = np.maximum(_DEG_PER_M * walk_m, np.abs(steps[:, 2])) + 2.0
        share = np.concatenate([[0.0], np.cumsum(effort) / effort.sum()])
        is_first = start == 0
        times.append((start + share * (end - start))[0 if is_first else 1 :])
        views.append(points[0 if is_first else 1 :])
    at, through = np.concatenate(times), np.concatenate(views)
    flat = np.stack([np.interp(np.arange(num_frames), at, column) for column in through.T], 1)
    flat = gaussian_filter1d(flat, min(3.0, num_frames / 40), axis=0, mode="nearest")
    height = np.full((num_frames, 1), _EYE_M)
    return np.concatenate([flat[:, :2], height, flat[:, 2:]], axis=1)


def _hand_shake(
    options: SceneOptions, num_frames: int, rng: np.random.Generator
) -> Float[np.ndarray, "T 5"]:
    size = np.array([_SHAKE_M, _SHAKE_M, 2 * _SHAKE_M, _SHAKE_DEG, _SHAKE_DEG])
    return options.shake * size * _smooth_noise(num_frames, 5, rng)


def _smooth_noise(
    num_frames: int, columns: int, rng: np.random.Generator
) -> Float[np.ndarray, "T columns"]:
    """Noise of unit spread with a memory of about two frames."""
    return 1.9 * gaussian_filter1d(rng.standard_normal((num_frames, columns)), 1.0, axis=0)


def _jumps(
    options: SceneOptions, num_frames: int, rng: np.random.Generator
) -> Float[np.ndarray, "T 5"]:
    """Steps of the view that last until the next one."""
    offset = np.zeros((num_frames, 5))
    if options.jumps:
        frames = np.sort(rng.integers(1, max(2, num_frames), options.jumps))
        for frame in frames:
            offset[frame:] = rng.uniform(-1, 1, 5) * (0.15, 0.15, 0.08, 14.0, 5.0)
    return offset
