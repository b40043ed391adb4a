"""Which objects there are, where they stand, and what changes while the camera is away."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from remind_jax.errors import ConfigError
from remind_jax.synthetic.options import LookalikeGroup, SceneOptions
from remind_jax.synthetic.places import Places
from remind_jax.synthetic.scene import Furniture, Look, Placement, SceneObject
from remind_jax.synthetic.shapes import CLASSES


def cast_objects(
    options: SceneOptions, rng: np.random.Generator
) -> list[tuple[str, Look, float, str, int]]:
    """Which objects there are: class, look, scale, look-alike group and room of each."""
    cast = []
    for number, group in enumerate(options.lookalikes):
        name = f"{group.label} {group.kind} {number + 1}"
        scale = float(rng.uniform(1.05, 1.25))
        for member, look in enumerate(_similar_looks(group, rng)):
            room = group.rooms[member % len(group.rooms)]
            cast.append((group.label, look, scale, name, room))
    taken = {group.label for group in options.lookalikes}
    for room in range(options.num_rooms):
        free = options.objects_per_room - sum(member[4] == room for member in cast)
        if free < 0:
            raise ConfigError(
                f"objects_per_room={options.objects_per_room} is less than the "
                f"{options.objects_per_room - free} look-alikes of room {room}; give more"
            )
        # Classes not used by look-alikes come first, so that few objects differ most.
        order = rng.permutation(len(options.classes))
        pool = sorted((options.classes[i] for i in order), key=lambda label: label in taken)
        for index in range(free):
            label = pool[index % len(pool)]
            look = Look(int(rng.integers(2**31)), int(rng.integers(2**31)))
            cast.append((label, look, float(rng.uniform(1.05, 1.3)), "", room))
    return cast


def _similar_looks(group: LookalikeGroup, rng: np.random.Generator) -> list[Look]:
    pattern, palette = int(rng.integers(2**31)), int(rng.integers(2**31))
    start = float(rng.uniform(0, 360))
    looks = []
    for member in range(group.members):
        if group.kind == "tint":
            looks.append(Look(pattern, palette, 20.0 * member))
        elif group.kind == "glaze":
            looks.append(Look(pattern, palette, start + 360.0 * member / group.members))
        elif group.kind == "pattern":
            looks.append(Look(int(rng.integers(2**31)), palette))
        else:
            looks.append(Look(pattern, palette))
    return looks


def place_objects(
    options: SceneOptions, furniture: Sequence[Furniture], rng: np.random.Generator
) -> tuple[list[SceneObject], Places]:
    """All objects at their first places, numbered from 1."""
    places = Places(options, furniture)
    cast = cast_objects(options, rng)
    # Large things first: small ones still fit between them.
    order = sorted(range(len(cast)), key=lambda index: -max(CLASSES[cast[index][0]].size_m))
    placements: dict[int, Placement] = {}
    for index in order:
        label, _, scale, group, room = cast[index]
        # Look-alikes are found in different surroundings, or nothing could tell them apart.
        alike = [spot for other, spot in placements.items() if group and cast[other][3] == group]
        placements[index] = places.find(label, scale, room, rng, away_from=alike)
    objects = [
        SceneObject(index + 1, label, look, scale, (placements[index],), group)
        for index, (label, look, scale, group, _) in enumerate(cast)
    ]
    return objects, places


def change_objects(
    objects: list[SceneObject],
    places: Places,
    options: SceneOptions,
    source_frame: int,
    rng: np.random.Generator,
) -> list[SceneObject]:
    """Moves, removes, swaps and adds objects of the first room at a frame."""
    here = [index for index, item in enumerate(objects) if item.placements[0].room == 0]
    counts = [round(share * len(here)) for share in (options.moved, options.removed)]
    num_pairs = round(options.swapped * len(here) / 2)
    shuffled = [int(index) for index in rng.permutation(here)]
    moved, removed = shuffled[: counts[0]], shuffled[counts[0] : sum(counts)]
    rest = shuffled[sum(counts) :]
    changed = list(objects)
    for index in moved:
        item = objects[index]
        changed[index] = _replace_from(
            item, places.find(item.label, item.scale, 0, rng, source_frame), source_frame
        )
    for index in removed:
        changed[index] = _replace_from(objects[index], None, source_frame)
    for first, second in _swappable(objects, rest)[:num_pairs]:
        for one, other in ((first, second), (second, first)):
            spot = dataclasses.replace(objects[other].placements[0], start_frame=source_frame)
            changed[one] = _replace_from(objects[one], spot, source_frame)
    for _ in range(round(options.added * len(here))):
        label = options.classes[int(rng.integers(len(options.classes)))]
        look = Look(int(rng.integers(2**31)), int(rng.integers(2**31)))
        scale = float(rng.uniform(1.05, 1.3))
        placement = places.find(label, scale, 0, rng, source_frame)
        changed.append(SceneObject(len(changed) + 1, label, look, scale, (placement,)))
    return changed


def _swappable(objects: Sequence[SceneObject], indices: Sequence[int]) -> list[tuple[int, int]]:
    """Disjoint pairs that can take each other's place: same habitat, nearest in height."""
    pairs = []
    for place in ("surface", "wall", "floor"):
        fitting = [index for index in indices if CLASSES[objects[index].label].place == place]
        fitting.sort(key=lambda index: CLASSES[objects[index].label].size_m[2])
        pairs += list(zip(fitting[::2], fitting[1::2], strict=False))
    return pairs


def _replace_from(item: SceneObject, new: Placement | None, source_frame: int) -> SceneObject:
    ended = dataclasses.replace(item.placements[0], end_frame=source_frame)
    placements = (ended,) if new is None else (ended, new)
    return dataclasses.replace(item, placements=placements)
