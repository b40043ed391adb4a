import dataclasses

import pytest

from remind_jax.synthetic import LookalikeGroup, SceneOptions, render_sequence

SMALL = SceneOptions(
    name="small",
    seed=3,
    num_rooms=2,
    objects_per_room=7,
    lookalikes=(LookalikeGroup("mug", 2, "identical"), LookalikeGroup("vase", 2, "tint")),
    frames=40,
    absence_frames=16,
    width=160,
    height=120,
    min_mask_px=12,
)
# One bare room: the quickest scene that still has everything.
TINY = dataclasses.replace(
    SMALL, name="tiny", num_rooms=1, objects_per_room=5, frames=6, absence_frames=2
)


@pytest.fixture(scope="session")
def small():
    return render_sequence(SMALL)


@pytest.fixture(scope="session")
def tiny():
    return render_sequence(TINY)
