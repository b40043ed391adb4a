"""A world small enough to compile in seconds: six boxes in a frame of 8 x 10 patches.

Boxes 0 and 1 look almost alike, 0 to 2 are of one class and 3 to 5 of another, and every box has
three looks. Which boxes are in view, where exactly and how they look is drawn for every frame.
"""

from collections.abc import Iterable, Iterator, Sequence
from typing import Any

import jax
import numpy as np

from remind_jax.compiled.frame_step import settle_types
from remind_jax.config import Config
from remind_jax.frame import Detections
from remind_jax.frame import Frame as SceneFrame
from remind_jax.masks.reduction import reduce_masks
from remind_jax.observation import FrameFeats, Masks
from remind_jax.remind.method import METHOD
from remind_jax.remind.stages import Stages
from remind_jax.remind.state import TrackerState, init
from remind_jax.remind.thresholds import Thresholds
from remind_jax.remind.trace import Trace
from remind_jax.static import Static
from tests.statics import make_static

PATCH, GRID, DIM, BOXES = 4, (8, 10), 8, 6
HEIGHT, WIDTH = PATCH * GRID[0], PATCH * GRID[1]
SIDE = 11  # pixels
LOOK_SPREAD = 0.5
CLASS_IDS = np.array([0, 0, 0, 1, 1, 1], np.int32)

# Capacities that fill within a few frames.
STATIC = make_static(
    num_detections=BOXES,
    num_objects=8,
    num_pending=8,
    feature_dim=DIM,
    part_clusters=2,
    part_iterations=3,
    part_restarts=1,
    appearance_slots=(2, 2),
    part_slots=(3, 2),
    inner_ring_slots=(2, 1),
    outer_ring_slots=(2, 2),
)
# Boxes of nine patches are large here.
THRESHOLDS = (
    Config()
    .updated(
        {
            "thresholds": {
                "appearance": {"patches_min": 0.0, "patches_full": 8.0, "promote_hits": 2},
                "background": {"promote_hits": 2},
                "parts": {"promote_hits": 2},
                "perception": {"part_min_patches": 2, "trim_min_patches": 4},
                "similarity": {"object_min_patches": 1.0, "object_full_patches": 9.0},
            }
        }
    )
    .thresholds
)

Frame = tuple[FrameFeats, Masks]


def _step(state: Any, feats: Any, masks: Any, *, static: Static, thresholds: Any) -> Any:
    options = {"static": static, "thresholds": thresholds}
    after, trace = METHOD.decide(state, METHOD.describe(feats, masks, None, **options), **options)
    return settle_types(after), trace


# The step as it runs in use, but for the donation of the old state, which tests still look at, and
# with what the decisions were made of.
STEP = jax.jit(_step, static_argnames="static")


def make_frames(num: int, seed: int = 0, share: float = 0.8, order: Any = None) -> list[Frame]:
    """Draws a sequence; each box is in view with probability `share`.

    `order` maps a frame's boxes in view to their detection order, e.g. `reversed`.
    """
    return [draw_frame(*view) for view in _draw_views(num, seed, share, order)]


def make_scene(num: int, seed: int = 0) -> list[SceneFrame]:
    """The same sequence as a source would give it: features, masks and who is who."""
    scene = []
    for index, (boxes, corners, shown, ground) in enumerate(_draw_views(num, seed, 0.8)):
        feats, _ = draw_frame(boxes, corners, shown, ground)
        detections = Detections.create(
            draw_masks(boxes, corners),
            [f"kind {CLASS_IDS[box]}" for box in boxes],
            instance_ids=np.array(boxes, np.int64) + 1,
        )
        scene.append(
            SceneFrame(
                index, index, float(index), str(index), detections=detections,
                features=np.asarray(feats.patches),
            )
        )  # fmt: skip
    return scene


def _draw_views(num: int, seed: int, share: float, order: Any = None) -> Iterator[tuple]:
    """Boxes in view, the corners of all, their looks and the ground, frame by frame."""
    rng = np.random.default_rng(seed)
    codes = rng.standard_normal((BOXES, DIM))
    codes[1] = codes[0] + 0.3 * rng.standard_normal(DIM)
    looks = codes[:, None] + LOOK_SPREAD * rng.standard_normal((BOXES, 3, DIM))
    ground = rng.standard_normal((HEIGHT, WIDTH, DIM)).reshape(GRID[0], PATCH, GRID[1], PATCH, DIM)
    ground = 0.5 * ground.mean(axis=(1, 3)) + 0.5 * rng.standard_normal(DIM)
    for _ in range(num):
        boxes = [box for box in range(BOXES) if rng.random() < share]
        corners = [(3 + 15 * (box // 3), 1 + 13 * (box % 3)) for box in range(BOXES)]
        corners = np.array(corners) + rng.integers(-1, 2, (BOXES, 2))
        noise = 0.2 * rng.standard_normal((*GRID, DIM))
        shown = looks[np.arange(BOXES), rng.integers(0, 3, BOXES)]
        if order is not None:
            boxes = list(order(boxes))
        yield boxes, corners, shown, ground + noise


def draw_frame(boxes: Sequence[int], corners: Any, codes: Any, ground: Any) -> Frame:
    """One frame with the given boxes in view, in detection order."""
    reduced = reduce_masks(
        draw_masks(boxes, corners),
        CLASS_IDS[list(boxes)],
        np.ones(len(boxes)),
        num_slots=BOXES,
        patch_px=PATCH,
    )
    features = np.array(ground)
    for row in np.argsort(boxes):  # neighbours share patches: the picture has no detection order
        box, share = boxes[row], reduced.coverage[row][..., None]
        features = (1 - share) * features + share * codes[box]
    return FrameFeats(features.astype(np.float32), np.array([HEIGHT, WIDTH], np.int32)), reduced


def draw_masks(boxes: Sequence[int], corners: Any) -> np.ndarray:
    """Pixel masks of the boxes in view, `[N, H, W]`."""
    masks = np.zeros((len(boxes), HEIGHT, WIDTH), bool)
    for row, box in enumerate(boxes):
        top, left = corners[box]
        masks[row, top : top + SIDE, left : left + SIDE] = True
    return masks


def pad(frames: Iterable[Frame], num_slots: int) -> list[Frame]:
    """The same frames with more detection slots."""

    def widen(leaf: np.ndarray) -> np.ndarray:
        sides = [num_slots if side == BOXES else side for side in leaf.shape]
        grown = np.zeros(sides, leaf.dtype)
        grown[tuple(slice(0, side) for side in leaf.shape)] = leaf
        return grown

    return [(feats, jax.tree.map(widen, masks)) for feats, masks in frames]


def run(
    frames: Iterable[Frame], static: Static = STATIC, state: TrackerState | None = None
) -> list[TrackerState]:
    """States after every frame, on the host."""
    return [after for after, _ in trace(frames, static, state=state)]


def follow(frames: Iterable[Frame]) -> list[tuple[TrackerState, Stages]]:
    """States after every frame, and the stages of its decisions, on the host."""
    return [(after, told.stages) for after, told in trace(frames)]


def trace(
    frames: Iterable[Frame],
    static: Static = STATIC,
    thresholds: Thresholds = THRESHOLDS,
    state: TrackerState | None = None,
) -> list[tuple[TrackerState, Trace]]:
    """States after every frame, and what its decisions were made of, on the host."""
    state = settle_types(init(static) if state is None else state)
    arrays = thresholds.as_arrays(static.scalar)
    found = []
    for feats, masks in frames:
        state, told = STEP(state, feats, masks, static=static, thresholds=arrays)
        found.append(jax.device_get((state, told)))
    return found


def decided(state: TrackerState, stages: Stages | None = None) -> dict[str, np.ndarray]:
    """The decisions about the detections of a frame, and their stages, padding left out."""
    fields = {**vars(state.decisions), **({} if stages is None else vars(stages))}
    num = int((fields["outcome"] != 0).sum())
    return {name: values[:num] for name, values in fields.items() if np.ndim(values)}
