"""Memory files: bit for bit what was saved, and one sentence for what cannot be read.

The step is a pure function of state, static and thresholds, so equal bits mean equal decisions;
`test_session.py` goes on from a file.
"""

import dataclasses
import functools
import json
from pathlib import Path
from typing import Any

import chex
import jax
import numpy as np
import pytest
from safetensors.numpy import load_file, save_file

from remind_jax.errors import ConfigError, OutputError
from remind_jax.files.tensors import read_safetensors_header
from remind_jax.method import list_methods
from remind_jax.remind.state import init
from remind_jax.session.announcement import Announcements
from remind_jax.session.live import Tracker
from remind_jax.session.memory_file import SavedMemory, load_memory, save_memory
from remind_jax.session.memory_parts import SCHEMA_VERSION
from tests import tiny_world
from tests.cli import scenes
from tests.statics import change_parts, change_static
from tests.tiny_world import STATIC

NAMES = ("cup", "Stuhl", "椅子", "a, b")


@functools.cache
def remembered() -> Any:
    """A memory after a few frames."""
    return tiny_world.run(tiny_world.make_frames(6))[-1]


@pytest.fixture
def memory() -> SavedMemory:
    return SavedMemory(remembered(), STATIC, NAMES, "patch-statistics")


@pytest.fixture
def path(tmp_path, memory) -> Path:
    save_memory(tmp_path / "memory.safetensors", memory)
    return tmp_path / "memory.safetensors"


def rewrite(path: Path, *, header: dict | None = None, tensors: dict | None = None) -> Path:
    """Changes entries of the header, and tensors by values or functions; None takes one out.

    The checksum is left out, as in a file of an earlier version: all else must be found without it.
    """
    metadata = read_safetensors_header(path, refused=OutputError).metadata | (header or {})
    kept = load_file(path)
    for name, change in (tensors or {}).items():
        kept[name] = change(kept[name]) if callable(change) else change
    save_file(
        {name: one for name, one in kept.items() if one is not None},
        path,
        metadata={k: v for k, v in metadata.items() if k != "sha256" and v is not None},
    )
    return path


def test_a_file_is_as_readable_as_others(path):
    other = path.with_name("other")
    other.touch()
    assert path.stat().st_mode == other.stat().st_mode


def test_round_trip_is_exact(path, memory):
    loaded = load_memory(path)
    chex.assert_trees_all_equal(loaded.state, memory.state, strict=True)
    assert loaded.static == memory.static
    assert hash(loaded.static) == hash(memory.static)
    assert (loaded.class_names, loaded.backbone) == (NAMES, "patch-statistics")
    assert loaded.announced.is_identity


def test_what_lies_in_parts_in_memory_is_saved_as_it_is(tmp_path, memory):
    """As after a crowd, when the memory moves into smaller capacities: views of larger arrays."""

    def as_view(leaf: Any) -> np.ndarray:
        leaf = np.asarray(leaf)
        return np.repeat(leaf, 2, axis=-1)[..., ::2] if leaf.ndim else leaf

    state = jax.tree.map(as_view, memory.state)
    save_memory(tmp_path / "memory", dataclasses.replace(memory, state=state))
    chex.assert_trees_all_equal(load_memory(tmp_path / "memory").state, memory.state, strict=True)


def test_round_trip_in_double_precision(tmp_path, x64):
    static = change_static(STATIC, precision="float64")
    empty = init(static)
    thirds = empty.distances.edges.gap_mean + 1 / 3
    assert thirds.dtype == np.float64
    distances = change_parts(empty.distances, edges={"gap_mean": thirds})
    state = dataclasses.replace(empty, distances=distances)
    save_memory(tmp_path / "memory", SavedMemory(state, static, NAMES, "features"))
    loaded = load_memory(tmp_path / "memory")
    chex.assert_trees_all_equal(loaded.state, state, strict=True)
    assert loaded.static == static
    jax.config.update("jax_enable_x64", False)
    with pytest.raises(OutputError, match="JAX_ENABLE_X64"):
        load_memory(tmp_path / "memory")


def test_other_and_missing_files_are_refused(path):
    for content in (b"", b"1234", b"\xff" * 100, b"PNG" * 1000, path.read_bytes()[:-100]):
        path.write_bytes(content)
        with pytest.raises(OutputError, match=r"memory\.safetensors"):
            load_memory(path)
    with pytest.raises(OutputError, match=r"cannot read .*nowhere"):
        load_memory(path.with_name("nowhere"))


def spoiled(value: Any, index: Any = 0) -> Any:
    def change(values: np.ndarray) -> np.ndarray:
        values[index] = value
        return values

    return change


OTHER_CAPACITY = dataclasses.asdict(change_static(STATIC, num_objects=9))


@pytest.mark.parametrize(
    ("entry", "value", "said"),
    [
        ("format", "other", "not a memory file"),
        ("format", None, "not a memory file"),
        ("schema", "999", f"'999'; this version reads schemas 7, 8 and {SCHEMA_VERSION}"),
        ("static", None, "its header lacks 'static'"),
        ("static", "{", "header, 'static'"),
        ("static", '{"num_objectz": 3}', "'static' has no 'num_objectz'"),
        ("static", '{"num_objects": 1e12}', "header, 'static'"),
        ("static", json.dumps(OTHER_CAPACITY), r"of shape \[8\]; expected: I32 of shape \[9\]"),
        ("class_names", "[1, 2]", "header, 'class_names'"),
        ("class_names", '["cup"]', "'objects.class_id' holds 1; allowed: 0 to 0"),
        ("class_names", '["cup", "cup"]', "'class_names' holds cup twice"),
        ("class_names", json.dumps(["cup", "c" * 201]), "up to 200 characters"),
        ("backbone", None, "its header lacks 'backbone'"),
        ("announced", '{"ids": [[1]]}', "header, 'announced'"),
    ],
)
def test_headers_that_cannot_be_are_refused(path, entry, value, said):
    with pytest.raises(OutputError, match=said):
        load_memory(rewrite(path, header={entry: value}))


def test_a_memory_of_a_tracker_that_is_not_registered_is_named(path):
    with pytest.raises(ConfigError, match=r"safetensors': there is no tracker 'mine'.*register"):
        load_memory(rewrite(path, header={"tracker": "mine"}))


@pytest.mark.parametrize(
    ("leaf", "change", "said"),
    [
        ("objects.id", None, "'objects.id' is missing"),
        ("objects.id", lambda ids: ids[:, None], r"is I32 of shape \[8, 1\]; expected"),
        ("objects.id", spoiled(5), "'objects.id' holds"),
        ("objects.id", spoiled(1, np.s_[:2]), "'objects.id' holds 1 twice"),
        ("next_id", np.array(2, np.int32), "'objects.id' holds 2; allowed: 0 to 1"),
        ("frame", np.array(-1, np.int32), "'frame' holds -1; allowed: 0 or more"),
        ("frame", np.array(2, np.int32), "allowed: -1 to 1"),
        ("frame", np.array(6, np.float32), "'frame' is F32 of shape"),
        ("objects.class_id", spoiled(-2), "'objects.class_id' holds -2; allowed: 0 to 3"),
        ("objects.hits", spoiled(-1), "'objects.hits' holds -1; allowed: 0 or more"),
        ("objects.lifecycle", spoiled(9), "'objects.lifecycle' holds 9; allowed: 0 to 3"),
        ("pending.kind", spoiled(7), "'pending.kind' holds 7"),
        ("decisions.outcome", spoiled(99), "'decisions.outcome' holds 99"),
        ("distances.edges.gap_mean", spoiled(np.nan), "gap_mean' holds 8 values that are not"),
        ("cooccurrence.weight", spoiled(-1.0), "'cooccurrence.weight' holds -1"),
        ("more", np.zeros(3, np.float32), "it holds 'more', which no memory"),
    ],
)
def test_tensors_that_no_run_leaves_are_refused(path, leaf, change, said):
    with pytest.raises(OutputError, match=said):
        load_memory(rewrite(path, tensors={leaf: change}))


def test_announcements_that_no_run_leaves_are_refused(path, memory):
    for known_below, ids, counts in (
        (1, {77: 1}, {}), (1, {2: 9}, {}), (1, {}, {2: -4}), (-5, {}, {})
    ):  # fmt: skip
        announced = Announcements(known_below, ids, counts, next_id=3)
        save_memory(path, dataclasses.replace(memory, announced=announced))
        with pytest.raises(OutputError, match=r"announced|detected"):
            load_memory(path)


def test_one_bit_is_found(path):
    """Whatever a check of values would take for good."""
    content = bytearray(path.read_bytes())
    content[-20] ^= 1
    path.write_bytes(content)
    with pytest.raises(OutputError, match="its checksum is another one"):
        load_memory(path)


def test_vectors_that_are_not_of_unit_length_are_refused(path):
    names = [name for name in load_file(path) if name.endswith("embedding")]
    assert names
    for name in names:
        copy = path.with_name("copy")
        copy.write_bytes(path.read_bytes())
        with pytest.raises(OutputError, match="holds a vector of length 2; allowed: unit vectors"):
            load_memory(rewrite(copy, tensors={name: lambda values: 2 * values}))


@pytest.mark.parametrize("name", [name for name in list_methods() if name != "remind"])
def test_memories_of_every_method_are_checked(tmp_path, name):
    """What a run leaves is read; ids that are there twice, and numbers that are none, are not."""
    path, tracker = tmp_path / "memory", Tracker(tracker=name)
    scenes.follow(tracker, range(3))
    tracker.save(path)
    assert load_memory(path).tracker == name
    whole = path.read_bytes()
    with pytest.raises(OutputError, match=r"'objects.id' holds"):
        load_memory(rewrite(path, tensors={"objects.id": spoiled(5)}))
    path.write_bytes(whole)
    for leaf, values in load_file(path).items():
        if values.dtype.kind == "f" and values.size:
            path.write_bytes(whole)
            with pytest.raises(OutputError, match=f"'{leaf}' holds"):
                load_memory(rewrite(path, tensors={leaf: np.full_like(values, np.nan)}))
