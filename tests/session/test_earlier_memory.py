"""Memory files of earlier schemas are read as what they hold."""

import json

import chex
import jax
import numpy as np
import pytest
from safetensors.numpy import load_file, save_file

from remind_jax.errors import OutputError
from remind_jax.files.tensors import read_safetensors_header
from remind_jax.method import get_method, named_leaves
from remind_jax.session.earlier_memory import EARLIER_VERSIONS, WITH_OTHER_DECISIONS, split_columns
from remind_jax.session.memory_file import SavedMemory, load_memory, save_memory

NAMES = ("plus", "remind")


def method_and_static(name):
    method = get_method(name)
    return method, method.static(num_detections=3, num_objects=4, feature_dim=5)


def join(leaves, columns):
    """The leaves of a memory as a file of an earlier schema has them."""
    joined = dict(leaves)
    for name, (axis, parts) in columns.items():
        given = [joined.pop(part) for part in parts]
        if not given:
            continue
        most = max(one.ndim for one in given) + (len({one.ndim for one in given}) == 1)
        given = [one if one.ndim == most else np.expand_dims(one, axis) for one in given]
        joined[name] = np.concatenate(given, axis)
    return joined


@pytest.mark.parametrize("name", NAMES)
def test_every_leaf_is_found_again(name):
    method, static = method_and_static(name)
    columns, rng = method.host.columns, np.random.default_rng(0)
    leaves = {
        name: rng.integers(0, 2, leaf.shape).astype(leaf.dtype)
        for name, leaf in named_leaves(jax.device_get(method.init(static)))
    }
    joined = join(leaves, columns)
    assert not joined.keys() >= leaves.keys()
    chex.assert_trees_all_equal(split_columns(joined, columns, leaves), leaves, strict=True)


@pytest.mark.parametrize("version", EARLIER_VERSIONS)
@pytest.mark.parametrize("name", NAMES)
def test_a_file_is_read(tmp_path, name, version):
    path = tmp_path / "memory.safetensors"
    state = write_earlier(path, name, version)
    chex.assert_trees_all_equal(load_memory(path).state, state, strict=True)


def test_a_file_that_lacks_a_column_is_refused(tmp_path):
    path = tmp_path / "memory.safetensors"
    write_earlier(path, "plus", "7", lacking="tracklets.wholes")
    with pytest.raises(OutputError, match=r"'tracklets.id' is missing"):
        load_memory(path)


def write_earlier(path, name, version, lacking=""):
    """Writes an empty memory as earlier versions did; returns its state."""
    method, static = method_and_static(name)
    state = method.init(static)
    save_memory(path, SavedMemory(state, static, ("cup",), "patch-statistics", name))
    metadata = dict(read_safetensors_header(path, refused=OutputError).metadata, schema=version)
    del metadata["sha256"]
    tensors = join(load_file(path), method.host.columns)
    if version == WITH_OTHER_DECISIONS:
        written = json.loads(metadata["static"])
        switches = written.pop("switches")
        metadata["static"] = json.dumps(written | {"part_top": 3} | switches)
        tensors = {name: one for name, one in tensors.items() if not name.startswith("decisions.")}
        tensors["decisions.wholes"] = np.zeros((3, 9), np.int32)
    if lacking:
        tensors[lacking] = tensors[lacking][:, :-1].copy()
    save_file(tensors, path, metadata=metadata)
    return state
