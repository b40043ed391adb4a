"""Memory files of the schema before are read as what they hold."""

from __future__ import annotations

import json

import chex
import jax
import numpy as np
import pytest
from safetensors.numpy import load_file, save_file

from remind_jax.errors import OutputError
from remind_jax.files.tensors import read_safetensors_header
from remind_jax.method import get_method, named_leaves
from remind_jax.session.earlier_memory import EARLIER_VERSION, split_columns
from remind_jax.session.memory_file import SavedMemory, load_memory, save_memory
from remind_jax.static import Static

STATIC = Static(num_detections=3, num_objects=4, feature_dim=5)
PLUS = get_method("plus")
COLUMNS = PLUS.host.columns


def join(leaves):
    """The leaves of a memory as a file of the schema before has them."""
    joined = dict(leaves)
    for name, (axis, parts) in COLUMNS.items():
        given = [joined.pop(part) for part in parts]
        if not given:
            continue
        most = max(one.ndim for one in given) + (len({one.ndim for one in given}) == 1)
        given = [one if one.ndim == most else np.expand_dims(one, axis) for one in given]
        joined[name] = np.concatenate(given, axis)
    return joined


def test_every_leaf_is_found_again():
    rng = np.random.default_rng(0)
    leaves = {
        name: rng.integers(0, 2, leaf.shape).astype(leaf.dtype)
        for name, leaf in named_leaves(jax.device_get(PLUS.init(STATIC)))
    }
    chex.assert_trees_all_equal(split_columns(join(leaves), COLUMNS, leaves), leaves, strict=True)


@pytest.mark.parametrize("lacks", [False, True])
def test_a_file_is_read(tmp_path, lacks):
    path, state = tmp_path / "memory.safetensors", PLUS.init(STATIC)
    save_memory(path, SavedMemory(state, STATIC, ("cup",), "patch-statistics", "plus"))
    metadata = dict(
        read_safetensors_header(path, refused=OutputError).metadata, schema=str(EARLIER_VERSION)
    )
    del metadata["sha256"]
    static = json.loads(metadata["static"])
    del static["switches"]
    metadata["static"] = json.dumps({**static, "part_top": 3})  # the paper's, in every file
    tensors = join(load_file(path))
    tensors = {name: one for name, one in tensors.items() if not name.startswith("decisions.")}
    tensors["decisions.wholes"] = np.zeros((3, 9), np.int32)
    if lacks:
        tensors["tracklets.wholes"] = tensors["tracklets.wholes"][:, :-1].copy()
    save_file(tensors, path, metadata=metadata)
    if lacks:
        with pytest.raises(OutputError, match=r"'tracklets.id' is missing"):
            load_memory(path)
    else:
        chex.assert_trees_all_equal(load_memory(path).state, state, strict=True)
