"""Detections, tracklets and objects of a few values, the rest empty."""

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from remind_jax.plus.linking import advance_tracklets
from remind_jax.plus.observation import Motion, Sightings
from remind_jax.plus.state import Objects, PlusState, Tracklets, blank, init, no_tracklets
from remind_jax.plus.thresholds import PlusThresholds
from remind_jax.static import Static

DIM = 3
STATIC = Static(num_detections=3, num_objects=4, feature_dim=DIM)
T = PlusThresholds().as_arrays()


def detections(centers, looks=None, **fields) -> Sightings:
    """Squares of size 1 around the centers, all of class 0."""
    center = np.asarray(centers, np.float32)
    num = len(center)
    look = np.eye(num, DIM) if looks is None else np.asarray(looks)
    values = blank(
        Sightings,
        {"N": num, "D": look.shape[1], "G": 0},
        look=look.astype(np.float32),
        box=np.concatenate([center - 0.5, center + 0.5], axis=1),
        center=center,
        size=1.0,
        valid=True,
        frame_center=np.array([3.2, 2.4], np.float32),
    )
    return dataclasses.replace(values, **fields)


def tracklets_of(seen: Sightings, frame: int, room: int, **fields) -> Tracklets:
    """Tracklets that these detections of that frame began, in a table with that much room."""
    num = len(seen.valid)
    begun = jax.tree.map(np.array, no_tracklets(room, DIM))
    begun.alive[:num] = seen.valid
    for name in ("box", "center", "size", "class_id", "look"):
        getattr(begun, name)[:num] = getattr(seen, name)
    begun.first_look[:num] = seen.look
    begun.last[:num], begun.age[:num], begun.id[:num] = frame, 1, np.arange(num)
    begun.class_lead[:num] = 1
    return dataclasses.replace(begun, **fields)


TICK = jnp.float32(1)


def go_on(tracklets: Tracklets, seen: Sightings, origin, frame: int, **more):
    """Tracklets after a frame, the next id, and how looks changed; see `linking.advance_tracklets`.

    `next_id` is 9, `shift` of the image 0 and `doubt` about it 1 unless given.
    """
    given = {"next_id": 9, "shift": 0.0, "doubt": 1.0, **more}
    return _advance(
        tracklets,
        seen,
        jnp.asarray(origin),
        jnp.int32(frame),
        jnp.int32(given["next_id"]),
        seen.valid,
        np.zeros(len(seen.valid), bool),
        TICK,
        jnp.float32(given["shift"]),
        jnp.float32(given["doubt"]),
        T.mobility,
    )


_advance = jax.jit(advance_tracklets)


def motion(shift: Any = (0.0, 0.0), score: Any = 1.0) -> Motion:
    """A shift of the whole image, in frame units."""
    shift = jnp.reshape(jnp.asarray(shift, jnp.float32), (2, 1))
    matrix = jnp.concatenate([jnp.eye(2), shift], axis=1)
    return Motion(matrix, jnp.float32(score), jnp.array([480, 640]), jnp.float32(1))


def empty_state() -> PlusState:
    return init(STATIC)


def objects_of(looks, **fields) -> Objects:
    """Objects of class 0, each with one kept look, compared as it is."""
    known, num = jax.tree.map(np.array, init(STATIC).objects), len(looks)
    known.id[:num], known.class_id[:num], known.seen[:num] = np.arange(num), 0, 10
    known.bank[:num, 0] = known.white_bank[:num, 0] = looks
    known.bank_count[:num, 0] = known.class_lead[:num] = 1
    return dataclasses.replace(jax.tree.map(jnp.asarray, known), **fields)
