"""Which objects move of their own: a person, a cat, whatever is carried about.

Rule: method_plus.md#own-movement.

Where such an object was says little of where it will be. So errors of its place and of how it lies
to others grow with its speed while it is out of view, its background counts less, and its looks
may decide alone. In a world that stands still nothing of this happens.

Letters: `N` detections, `T` tracklets, `O` object slots. Lengths are in frame units.
"""

from __future__ import annotations

import dataclasses

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from remind_jax.numerics.absent import NO_SLOT
from remind_jax.numerics.plane import medians, squared_length
from remind_jax.plus import thresholds as th
from remind_jax.plus.observation import Sightings
from remind_jax.plus.slots import NO_ROW
from remind_jax.plus.state import Objects, Scene, Tracklets

NOISE = 0.01  # own movement per tick that things at rest seem to have, length
NOISE_RATE = 0.4  # more of it, per length that the image moves
# What is averaged.
SAMPLES = 16  # ticks that the own movement of a tracklet averages
LEAST_MOVES = 3  # ticks from which on it counts
MEMORY = 32.0  # ticks of the speed of an object
PRIOR = 4.0  # ticks that the speed of the scene counts for in that of a new object
SCENE_RATE = 0.05  # share that a tick changes of the speed of the scene
# What speeds make of objects.
HALF_SPEED = 0.02  # of one that is by half one that moves, length
FORGETTING = 2.0  # errors of places and relations grow by this times the speed
STAYING = 2.0  # power of one less the mobility, by which it is believed where an object was left
STAYING_PRIOR = 2.0  # objects at rest that each class is assumed to have
LEAVING = 4.0  # the same, by which its background and its class count in a look


def expect_step(tracklets: Tracklets, t: th.Mobility) -> Float[Array, "T 2"]:
    """How far each tracklet will move of its own in a tick, as far as that is known."""
    length = jnp.sqrt(squared_length(tracklets.drift))
    share = speed_of(tracklets) / jnp.maximum(length, 1e-6)
    known = tracklets.num_moves >= LEAST_MOVES
    return t.weight * jnp.where(known, share, 0.0)[:, None] * tracklets.drift


def follow_movement(
    before: Tracklets,
    linked: Bool[Array, "N"],
    sightings: Sightings,
    tick: Float[Array, ""],
    shift: Float[Array, ""],
    doubt: Float[Array, ""],
    t: th.Mobility,
) -> dict[str, Array]:
    """Smoothed own movement of each detection's tracklet, by fields of `Tracklets`.

    Where the image motion is doubted, what most detections of a frame share is that of the camera.
    At the border of the frame the center of a mask moves with what is cut off.

    Args:
      before: The tracklet that each detection goes on with, carried to this frame.
      shift: How far the image moved since the last one.
      doubt: How little that is believed, [0, 1].
    """
    whole = ~(before.touched | sightings.touches)
    moves = linked & whole & before.just_seen
    movement = (sightings.center - before.center) / tick + expect_step(before, t)
    shared = doubt * medians(movement.T, moves)
    shift = shift / tick + jnp.sqrt(squared_length(shared))
    passed = tick * moves
    num_moves = jnp.where(linked, before.num_moves, 0.0) + passed
    rate = passed / jnp.clip(num_moves, tick, SAMPLES)
    drift = jnp.where(linked[:, None], before.drift, 0.0)
    image_shift = jnp.where(linked, before.image_shift, 0.0)
    return {
        "drift": drift + rate[:, None] * (movement - shared - drift),
        "image_shift": image_shift + rate * (shift - image_shift),
        "num_moves": num_moves,
    }


def speed_of(tracklets: Tracklets) -> Float[Array, "T"]:
    """Length of the own movement per tick, beyond what things at rest seem to have.

    What is nearer or farther than the rest moves otherwise than the image, before a moving camera.
    """
    noise = NOISE + NOISE_RATE * tracklets.image_shift
    return jnp.maximum(jnp.sqrt(squared_length(tracklets.drift)) - noise, 0.0)


def first_speed(tracklets: Tracklets, scene: Scene) -> Float[Array, "T"]:
    """Speed of new objects: that of their tracklets, and of the scene where these are short."""
    num = tracklets.num_moves
    return (num * speed_of(tracklets) + PRIOR * scene.speed) / (num + PRIOR)


def learn_speeds(
    objects: Objects,
    scene: Scene,
    here: Tracklets,
    counts: Bool[Array, "N"],
    row: Int[Array, "O"],
) -> tuple[Objects, Scene]:
    """Follows the speeds of the objects in view, and that of all objects together.

    Args:
      row: Detection of each object, NO_ROW out of view.
    """
    speed = speed_of(here)
    counts = counts & (here.num_moves >= LEAST_MOVES) & ~here.touched
    learns = (row != NO_ROW) & counts[row]
    rate = learns / jnp.minimum(objects.seen + 1 + PRIOR, MEMORY)
    num = jnp.sum(counts)
    mean = jnp.sum(jnp.where(counts, speed, 0.0)) / jnp.maximum(num, 1)
    scene_rate = jnp.where(num > 0, SCENE_RATE, 0.0)
    return (
        dataclasses.replace(objects, speed=objects.speed + rate * (speed[row] - objects.speed)),
        dataclasses.replace(scene, speed=scene.speed + scene_rate * (mean - scene.speed)),
    )


def forgetting_speed(objects: Objects, t: th.Mobility) -> Float[Array, "O"]:
    """By how much the error of each object's place grows in a tick, for what moves of its own."""
    return FORGETTING * t.weight * objects.speed


def mobility(speed: Float[Array, "O"], t: th.Mobility) -> Float[Array, "O"]:
    """How far an object is one that moves of its own, [0, 1); 0 at rest."""
    speed = t.weight * speed
    return speed / (speed + HALF_SPEED)


def staying_of_class(
    class_id: Int[Array, "N"], objects: Objects, t: th.Mobility, power: float = STAYING
) -> Float[Array, "N"]:
    """How far objects of a class stay where they are while nobody looks, (0, 1].

    `power`: of one less their mobility.
    """
    alike = objects.exists & (class_id[:, None] == objects.class_id)
    moves = jnp.sum(jnp.where(alike, mobility(objects.speed, t), 0.0), axis=1)
    return (1.0 - moves / (jnp.sum(alike, axis=1) + STAYING_PRIOR)) ** power


def staying(objects: Objects, t: th.Mobility) -> Float[Array, "O"]:
    """How far each object may still be where it was left, [0, 1].

    Who stands among people who walk may have walked away meanwhile.
    """
    of_class = staying_of_class(objects.class_id, objects, t)
    return (1.0 - mobility(objects.speed, t)) ** STAYING * of_class


def mobility_of(slot: Int[Array, "N"], objects: Objects, t: th.Mobility) -> Float[Array, "N"]:
    """`mobility` of the object in each slot; 0 for NO_SLOT."""
    return jnp.where(slot != NO_SLOT, mobility(objects.speed[slot], t), 0.0)


def fade_background(
    sightings: Sightings,
    origin: Int[Array, "N"],
    before: Tracklets,
    scene: Scene,
    t: th.Mobility,
) -> Sightings:
    """Looks in which the background counts less, the more mobile what stands before it.

    What does not count is as in the mean of all looks, so that no comparison sees it.

    Args:
      origin: The tracklet that each goes on with, NO_SLOT for a new one.
      before: Tracklets before this frame.
    """
    known = first_speed(before, scene)[origin]
    rest = 1.0 - mobility(jnp.where(origin != NO_SLOT, known, scene.speed), t)
    share = jnp.where(sightings.has_ring, rest**LEAVING, 0.0)
    background = scene.mean + share[:, None] * (sightings.look - scene.mean)
    look = jnp.where(sightings.is_background, background, sightings.look)
    return dataclasses.replace(sightings, look=look)
