"""Detections, tracklets and objects of a few values, the rest empty."""

from __future__ import annotations

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np

from remind_jax.plus.observation import Motion, Sightings
from remind_jax.plus.state import Objects, PlusState, Tracklets, init, no_tracklets
from remind_jax.plus.thresholds import PlusThresholds
from remind_jax.static import Static

DIM = 3
STATIC = Static(num_detections=3, num_objects=4, feature_dim=DIM)
T = PlusThresholds().as_arrays()


def detections(centers, looks=None, **fields) -> Sightings:
    """Squares of size 1 around the centers, all of class 0."""
    center = jnp.asarray(centers, jnp.float32)
    num = len(center)
    values = Sightings(
        look=jnp.eye(num, DIM) if looks is None else jnp.asarray(looks, jnp.float32),
        ring=jnp.zeros((num, DIM)),
        has_ring=jnp.zeros(num, bool),
        box=jnp.concatenate([center - 0.5, center + 0.5], axis=1),
        center=center,
        size=jnp.ones(num),
        patches=jnp.full(num, 4.0),
        class_id=jnp.zeros(num, jnp.int32),
        touches=jnp.zeros(num, bool),
        valid=jnp.ones(num, bool),
        frame_center=jnp.array([3.2, 2.4]),
        num_bad_patches=jnp.int32(0),
    )
    return dataclasses.replace(values, **fields)


def tracklets_of(seen: Sightings, frame: int, room: int, **fields) -> Tracklets:
    """Tracklets that these detections of that frame began, in a table with that much room."""
    num = len(seen.valid)

    def put(empty, values):
        return empty.at[:num].set(values)

    empty = jax.tree.map(jnp.asarray, no_tracklets(room, DIM))
    begun = dataclasses.replace(
        empty,
        alive=put(empty.alive, seen.valid),
        box=put(empty.box, seen.box),
        center=put(empty.center, seen.center),
        size=put(empty.size, seen.size),
        class_id=put(empty.class_id, seen.class_id),
        last=put(empty.last, jnp.full(num, frame)),
        age=put(empty.age, jnp.ones(num, jnp.int32)),
        look=put(empty.look, seen.look),
        first_look=put(empty.first_look, seen.look),
        id=put(empty.id, jnp.arange(num)),
    )
    return dataclasses.replace(begun, **fields)


def motion(shift=(0.0, 0.0), score: float = 1.0) -> Motion:
    """A shift of the whole image, in frame units."""
    matrix = np.concatenate([np.eye(2), np.reshape(shift, (2, 1))], axis=1)
    return Motion(jnp.asarray(matrix, jnp.float32), jnp.float32(score), jnp.array([480, 640]))


def empty_state() -> PlusState:
    return init(STATIC)


def objects_of(looks, **fields) -> Objects:
    """Objects of class 0, each with one kept look, compared as it is."""
    empty = jax.tree.map(jnp.asarray, init(STATIC).objects)
    looks = jnp.asarray(looks, jnp.float32)
    num = len(looks)
    ids = jnp.where(jnp.arange(STATIC.num_objects) < num, jnp.arange(STATIC.num_objects), -1)
    known = dataclasses.replace(
        empty,
        id=ids,
        class_id=jnp.where(ids >= 0, 0, -1),
        seen=jnp.where(ids >= 0, 10, 0),
        bank=empty.bank.at[:num, 0].set(looks),
        white_bank=empty.white_bank.at[:num, 0].set(looks),
        bank_count=empty.bank_count.at[:num, 0].set(1),
    )
    return dataclasses.replace(known, **fields)
