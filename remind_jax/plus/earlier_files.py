"""How leaves of memory files of earlier versions differ from those of now."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from operator import itemgetter

import numpy as np

from remind_jax.numerics.absent import NO_ID

# What schema 7 holds side by side: name of the array, the axis that its columns lie along, and the
# leaves that they are now, in their order.
COLUMNS: dict[str, tuple[int, tuple[str, ...]]] = {
    name: (axis, tuple(f"{record}.{leaf}" for leaf in leaves.split()))
    for name, axis, record, leaves in (
        ("objects.wholes", -1, "objects", "id class_id seen last ring_count"),
        ("objects.place", -1, "objects", "position size speed"),
        ("pairs.lies", -1, "pairs", "relation spread log_ratio"),
        (
            "tracklets.wholes",
            -1,
            "tracklets",
            "alive class_id last age ring_count slot fresh num_moves touched named leans_new id",
        ),
        ("tracklets.place", -1, "tracklets", "box center size drift image_shift belief"),
        ("tracklets.looks", 1, "tracklets", "look ring first_look"),
        ("scene.means", 0, "scene", "mean ring_mean"),
        ("scene.weights", 0, "scene", "num_looks num_rings total_weight within_weight"),
        ("scene.recent", 0, "scene", "recent_looks recent_steps"),
        ("scene.recent_fade", 0, "scene", "looks_fade steps_fade"),
        ("scene.cosines", 1, "scene", "cosine_weight cosine_sum cosine_squares"),
        ("verdicts.owners_id", -1, "answers", "tracklet_id answer_id"),
        # Why they were given is not remembered.
        ("verdicts.wholes", -1, "", ""),
        ("verdicts.reals", -1, "", ""),
        ("verdicts.option_id", -1, "", ""),
        ("verdicts.option_reals", -1, "", ""),
    )
}

# Leaves that had fewer places along their second axis: an object kept 8 looks.
LENGTHENED = ("objects.bank", "objects.bank_count", "objects.white_bank")

# Leaves that there are no more.
GONE_LEAVES = ("answers.merged_id",)


def _is_object(file: Mapping[str, np.ndarray]) -> np.ndarray:
    return file["objects.id"] != NO_ID


def _corners_middle(file: Mapping[str, np.ndarray]) -> np.ndarray:
    return file["tracklets.box"].reshape(-1, 2, 2).mean(axis=1)


def _frames_unseen(file: Mapping[str, np.ndarray]) -> np.ndarray:
    return file["tracklets.alive"] * (file["frame"] - 1 - file["tracklets.last"])


# Leaves that came later, and what they were then by the others; None: as in an empty memory.
NEW_LEAVES: dict[str, Callable[[Mapping[str, np.ndarray]], np.ndarray] | None] = {
    "ticks": None,
    "phase": None,
    "objects.class_lead": itemgetter("objects.seen"),
    "objects.visits": _is_object,
    "tracklets.class_lead": itemgetter("tracklets.age"),
    "tracklets.course": _corners_middle,
    "tracklets.duration": itemgetter("tracklets.age"),
    "tracklets.last_class": itemgetter("tracklets.class_id"),
    "tracklets.met": None,
    "tracklets.met_id": None,
    "tracklets.pace": itemgetter("tracklets.drift"),
    "tracklets.trust": None,
    "tracklets.unseen": _frames_unseen,
    "scene.class_cosines": None,
    "scene.class_offset": None,
    "scene.raised": None,
    "scene.links": None,
    "scene.apart": None,
    "scene.names": None,
    "scene.newness": None,
    "scene.newness_known": None,
}
