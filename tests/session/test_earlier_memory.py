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
from remind_jax.plus.earlier_files import GONE_LEAVES, LENGTHENED, NEW_LEAVES
from remind_jax.session.earlier_memory import EARLIER_VERSIONS, WITH_OTHER_DECISIONS, split_columns
from remind_jax.session.live import Tracker
from remind_jax.session.memory_file import SavedMemory, load_memory, save_memory
from tests.cli import scenes
from tests.session.test_memory_file import rewrite

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


def test_leaves_of_what_lives_follow_from_those_that_there_were(tmp_path):
    tracker = Tracker()
    for index in range(3):
        tracker.update(*scenes.picture(index, (1, 2) if index == 2 else (1, 2, 3)))
    path = tmp_path / "memory.safetensors"
    tracker.save(path)
    rewrite(path, tensors=dict.fromkeys(NEW_LEAVES))
    found, expected = (dict(named_leaves(one)) for one in (load_memory(path).state, tracker.state))
    expected["tracklets.pace"] = expected["tracklets.drift"]  # averages of the same steps
    alive = expected["tracklets.alive"]
    assert alive.sum() == 3
    for name in NEW_LEAVES:
        if name.startswith("tracklets."):
            of_file, of_run = (np.asarray(leaves[name])[alive] for leaves in (found, expected))
            np.testing.assert_allclose(of_file, of_run, atol=1e-4, err_msg=name)


def test_kept_looks_of_fewer_places_are_read(tmp_path):
    tracker, path = Tracker(), tmp_path / "memory.safetensors"
    scenes.follow(tracker, range(10))
    tracker.save(path)
    assert load_file(path)["objects.bank_count"].any()
    rewrite(path, tensors=dict.fromkeys(LENGTHENED, lambda leaf: leaf[:, :8].copy()))
    chex.assert_trees_all_equal(load_memory(path).state, tracker.state)


def test_leaves_that_are_gone_are_left_out(tmp_path):
    path = tmp_path / "memory.safetensors"
    state = write_earlier(path, "plus", EARLIER_VERSIONS[-1])
    rewrite(path, tensors=dict.fromkeys(GONE_LEAVES, np.zeros(3, np.int32)))
    chex.assert_trees_all_equal(load_memory(path).state, state, strict=True)


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
