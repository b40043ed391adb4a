"""What plain lists, one object at a time, made of the observations that tests draw."""

from __future__ import annotations

from typing import Any

import jax
import numpy as np

from remind_jax.observation import Descriptors
from tests.golden import load


def assert_as_recorded(channel: str, setting: str, seen: Any, qualities: bool = True) -> None:
    """Compares banks `[T, S, C, O, ...]` with the recorded ones of some frames, in every slot used.

    Args:
      channel: Kind of the banks.
      setting: Under which they were kept.
      seen: Those after every frame; `S` are the work and the stable bank.
      qualities: Whether they count them.
    """
    with np.load(load.ROOT / "banks" / f"{channel}.npz") as file:
        index, size, embedding, counts, sums = (
            file[f"{setting}.{name}"]
            for name in ("index", "size", "embedding", "counts", "qualities")
        )
    at = tuple(index.T.astype(int))
    bank = jax.tree.map(lambda leaf: np.asarray(leaf)[at], seen)
    np.testing.assert_array_equal(bank.size, size, setting)
    used = np.arange(bank.counts.shape[1]) < size[:, None]
    ours = jax.tree.map(lambda leaf: leaf[used], (bank.embedding, bank.counts, bank.qualities))
    np.testing.assert_array_equal(ours[1][:, :2], counts[:, :2], setting)  # hits, last seen
    np.testing.assert_allclose(ours[0], embedding, atol=1e-5, err_msg=setting)  # float32 steps
    np.testing.assert_allclose(np.linalg.norm(ours[0], axis=-1), 1.0, atol=1e-6)
    if qualities:
        np.testing.assert_array_equal(ours[1][:, 2], counts[:, 2], setting)
        np.testing.assert_allclose(ours[2], sums, atol=1e-9, err_msg=setting)


def random_views(rng, *shape, dim=4, directions=5, spread=0.2) -> np.ndarray:
    """Unit vectors around a few directions, so that duplicates, merges and novelties all occur."""
    centers = rng.standard_normal((directions, dim))
    centers /= np.linalg.norm(centers, axis=1, keepdims=True)
    views = centers[rng.integers(0, directions, shape)]
    views = views + spread * rng.random((*shape, 1)) * rng.standard_normal((*shape, dim))
    return (views / np.linalg.norm(views, axis=-1, keepdims=True)).astype(np.float32)


def descriptors_of(num: int, **fields):
    """Descriptors of `num` detections with nothing in them but the given fields."""
    dim = max(
        [v.shape[-1] for k, v in fields.items() if k in ("appearance", "parts", "rings")], default=1
    )
    empty = dict(
        appearance=np.zeros((num, 2, dim), np.float32),
        appearance_valid=np.zeros((num, 2), bool),
        parts=np.zeros((num, 1, 1, dim), np.float32),
        parts_valid=np.zeros((num, 1, 1), bool),
        rings=np.zeros((num, 2, dim), np.float32),
        rings_valid=np.zeros((num, 2), bool),
        num_patches=np.zeros(num, np.int32),
        patch_sum=np.zeros(num),
        num_parts=np.zeros(num, np.int32),
        part_support=np.zeros(num),
        ring_patches=np.zeros((num, 2), np.int32),
        mask_quality=np.ones(num),
        class_id=np.zeros(num, np.int32),
        valid=np.ones(num, bool),
        num_bad_patches=np.int32(0),
    )
    return Descriptors(**{**empty, **fields})
