"""Frozen scenes of a memory and a frame, and what the reference rules make of them.

The scenes were drawn at random (Python's `random.Random(seed)`, seeds below 400, stored as
`seeds`): 3 to 30 objects of 1 to 10 classes in 1 to 4 places, whose episodes come from 0 to 90
frames of walking between the places; up to 12 detections in one of them, some of unknown classes;
no anchor to nearly all of them. Kept were the first 12 and those that bring an effect of which
there were not enough yet. The answers are those of an independent plain implementation of the
rules that agrees with the original.
"""

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from remind_jax.remind.context.evidence import FrameView
from remind_jax.remind.context.reasoning import Reasoning, reason
from remind_jax.remind.memory.cooccurrence import conditional, empty_cooccurrence
from remind_jax.remind.thresholds import Thresholds
from remind_jax.static import Static
from tests.golden.load import load_cases
from tests.statics import change_parts, make_static, only

NUM, SLOTS = 12, 32  # detections and object slots of a scene
STATIC = make_static(num_detections=NUM, num_objects=SLOTS, precision="float64")


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Scene:
    """A memory and a frame; free slots have class -1."""

    count: Any  # [O, O] episodes together
    edge_time: Any  # [O, O]
    edge_order: Any  # [O, O]
    episodes: Any  # [O]
    object_class: Any  # [O]
    anchors: Any  # [O]
    det_class: Any  # [N]
    det_score: Any  # [N]
    score: Any  # [N, O] visual


def list_scenes(name: str = "scenes") -> list[Scene]:
    cases = load_cases(f"context/{name}")
    scenes = Scene(**{field.name: cases[field.name] for field in dataclasses.fields(Scene)})
    return [
        jax.tree.map(lambda leaf, row=row: leaf[row], scenes) for row in range(len(scenes.episodes))
    ]


def thresholds(**changed: dict[str, Any]) -> Thresholds:
    """The published thresholds but for those named, by section, in the types of the tracker."""
    return change_parts(Thresholds(), **changed).as_arrays(STATIC.scalar)


def view_of(shares: Any, **graph: Any) -> FrameView:
    """A view of which only the conditional probabilities matter, and what is given of the graph."""
    empty = empty_cooccurrence(len(shares), np.dtype("float64"))
    return only(FrameView, graph=dataclasses.replace(empty, **graph), conditional=shares)


def read_view(scene: Scene, t: Thresholds, static: Static) -> FrameView:
    """What the context reads of a scene."""
    graph = empty_cooccurrence(scene.episodes.shape[0], static.scalar)
    graph = dataclasses.replace(
        graph,
        episodes=scene.episodes,
        count=scene.count,
        weight=scene.count.astype(static.scalar),
        edge_time=scene.edge_time,
        edge_order=scene.edge_order,
    )
    exists = scene.object_class >= 0
    return FrameView(
        graph=graph,
        conditional=conditional(graph, jnp.sum(exists, dtype=jnp.int32), t.cooccurrence),
        exists=exists,
        object_class=scene.object_class,
        anchors=scene.anchors,
        det_class=scene.det_class,
        det_score=scene.det_score.astype(static.scalar),
        det_valid=scene.det_class >= 0,
    )


@jax.jit
def read(scene: Scene, t: Thresholds) -> Reasoning:
    """The whole package on one scene."""
    view = read_view(scene, t, STATIC)
    candidate = scene.det_class[:, None] == scene.object_class
    candidate = candidate & view.det_valid[:, None] & view.exists
    return reason(view, candidate, scene.score.astype(STATIC.scalar), STATIC, t)


def read_on(scene: Scene, **changed: dict[str, Any]) -> Reasoning:
    """The whole package on one scene, on the host; thresholds as in `thresholds`."""
    return jax.device_get(read(scene, thresholds(**changed)))


def example() -> Scene:
    """The worked example of method.md#example-company."""
    count = np.zeros((SLOTS, SLOTS), np.int32)
    for group, episodes in (((0, 1, 3), 6), ((2, 4), 4)):
        for one in group:
            count[one, [other for other in group if other != one]] = episodes
    object_class, det_class = np.full(SLOTS, -1, np.int32), np.full(NUM, -1, np.int32)
    object_class[:5], det_class[:3] = [0, 1, 1, 2, 3], [0, 1, 2]
    return Scene(
        count=count,
        edge_time=np.where(count > 0, 10, -1).astype(np.int32),
        edge_order=np.cumsum(count > 0, axis=1, dtype=np.int32),
        episodes=np.max(count, axis=1),
        object_class=object_class,
        anchors=np.isin(np.arange(SLOTS), [0, 3]),
        det_class=det_class,
        det_score=np.ones(NUM),
        score=np.zeros((NUM, SLOTS)),
    )
