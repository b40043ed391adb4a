"""What memory files of schema 7 hold side by side in one array, in the order of its columns."""

from __future__ import annotations

# Name of the array: the axis that its columns lie along, and the leaf that each of them is now.
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
        ("verdicts.owners_id", -1, "answers", "tracklet_id answer_id merged_id"),
        # Why they were given is not remembered.
        ("verdicts.wholes", -1, "", ""),
        ("verdicts.reals", -1, "", ""),
        ("verdicts.option_id", -1, "", ""),
        ("verdicts.option_reals", -1, "", ""),
    )
}

NEW_LEAVES = (
    "ticks",
    "phase",
    "objects.class_lead",
    "objects.visits",
    "tracklets.class_lead",
    "tracklets.course",
    "tracklets.duration",
    "tracklets.last_class",
    "tracklets.met",
    "tracklets.met_id",
    "tracklets.pace",
    "tracklets.trust",
    "tracklets.unseen",
    "scene.links",
    "scene.names",
    "scene.newness",
    "scene.newness_known",
)
