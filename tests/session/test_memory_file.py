"""Memory files: bit for bit what was saved, and one sentence for what cannot be read.

The step is a pure function of state, static and thresholds, so equal bits mean equal decisions;
`test_session.py` goes on from a file.
"""

from __future__ import annotations

import dataclasses
import json
import re
from pathlib import Path

import chex
import jax
import numpy as np
import pytest
from safetensors.numpy import load_file, save_file

from remind_jax.config import load_config
from remind_jax.errors import OutputError, RemindError
from remind_jax.remind.state import init
from remind_jax.session.announcement import Announcements
from remind_jax.session.memory_file import (
    SCHEMA_VERSION,
    SavedMemory,
    check_backbone,
    check_tracker,
    load_memory,
    save_memory,
    static_of,
)
from remind_jax.static import Static
from tests.remind.test_state import fill
from tests.tiny_world import STATIC

NAMES = ("cup", "Stuhl", "椅子", "a, b")


@pytest.fixture
def memory() -> SavedMemory:
    return SavedMemory(fill(init(STATIC)), STATIC, NAMES, "patch-statistics")


@pytest.fixture
def path(tmp_path, memory) -> Path:
    save_memory(tmp_path / "memory.safetensors", memory)
    return tmp_path / "memory.safetensors"


def rewrite(path: Path, *, header: dict | None = None, drop: str = "", change: str = "") -> Path:
    """Spoils a memory file in one respect."""
    content = path.read_bytes()
    length = int.from_bytes(content[:8], "little")
    metadata = json.loads(content[8 : 8 + length])["__metadata__"] | (header or {})
    metadata = {name: value for name, value in metadata.items() if value is not None}
    tensors = load_file(path)
    tensors.pop(drop, None)
    if change:
        tensors[change] = tensors[change][..., None]
    save_file(tensors, path, metadata=metadata)
    return path


def test_round_trip_is_exact(path, memory):
    loaded = load_memory(path)
    chex.assert_trees_all_equal(loaded.state, memory.state, strict=True)
    assert loaded.static == memory.static
    assert hash(loaded.static) == hash(memory.static)
    assert (loaded.class_names, loaded.backbone) == (NAMES, "patch-statistics")


def test_what_was_announced_is_kept(tmp_path, memory):
    announced = Announcements(3, {7: 3, 4: 4}, {9: 2}, next_id=5)
    saved = dataclasses.replace(memory, announced=announced)
    save_memory(tmp_path / "memory", saved)
    assert load_memory(tmp_path / "memory").announced == announced


def test_files_without_announcements_are_read(path):
    assert load_memory(path).announced is None


@pytest.mark.parametrize("damaged", ["[]", '{"known_below": 0}', '{"ids": [[1]]}', "{"])
def test_announcements_that_cannot_be_read(path, damaged):
    with pytest.raises(OutputError, match="description cannot be read"):
        load_memory(rewrite(path, header={"announced": damaged}))


def test_round_trip_in_double_precision(tmp_path, x64):
    static = dataclasses.replace(STATIC, precision="float64")
    state = jax.tree.map(
        lambda leaf: leaf / 3 if leaf.dtype == np.float64 else leaf, fill(init(static))
    )
    save_memory(tmp_path / "memory", SavedMemory(state, static, (), "features"))
    loaded = load_memory(tmp_path / "memory")
    chex.assert_trees_all_equal(loaded.state, state, strict=True)
    assert loaded.static == static


def test_double_precision_needs_64_bits(tmp_path, x64):
    static = dataclasses.replace(STATIC, precision="float64")
    save_memory(tmp_path / "memory", SavedMemory(init(static), static, (), "features"))
    jax.config.update("jax_enable_x64", False)
    with pytest.raises(OutputError, match="JAX_ENABLE_X64"):
        load_memory(tmp_path / "memory")


def test_saving_again_replaces_the_file(path, memory):
    later = dataclasses.replace(memory, class_names=("cup",))
    save_memory(path, later)
    assert load_memory(path).class_names == ("cup",)
    assert [file.name for file in path.parent.iterdir()] == [path.name]


@pytest.mark.parametrize("content", [b"", b"1234", b"\xff" * 100, b"PNG" * 1000])
def test_other_files_are_refused(tmp_path, content):
    path = tmp_path / "memory.safetensors"
    path.write_bytes(content)
    with pytest.raises(OutputError, match="cannot read memory from"):
        load_memory(path)


def test_truncated_and_missing_files_are_refused(path):
    path.write_bytes(path.read_bytes()[:-100])
    with pytest.raises(OutputError, match="cannot read memory from"):
        load_memory(path)
    with pytest.raises(OutputError, match=r"cannot read memory from .*nowhere"):
        load_memory(path.with_name("nowhere"))


@pytest.mark.parametrize(
    ("spoil", "said"),
    [
        ({"header": {"format": "other"}}, "not a memory file"),
        ({"header": {"format": None}}, "not a memory file"),
        ({"header": {"schema": "999"}}, f"schema 999; this version reads schema {SCHEMA_VERSION}"),
        ({"header": {"static": None}}, "damaged"),
        ({"header": {"static": "{"}}, "damaged"),
        ({"header": {"static": '{"num_objectz": 3}'}}, "damaged"),
        ({"header": {"class_names": "cup"}}, "damaged"),
        ({"header": {"backbone": None}}, "damaged"),
        ({"drop": "objects.hits"}, "'objects.hits' is missing"),
        ({"change": "objects.hits"}, "'objects.hits' is missing or of another shape"),
    ],
)
def test_what_is_wrong_is_said(path, spoil, said):
    with pytest.raises(OutputError, match=said):
        load_memory(rewrite(path, **spoil))


def test_capacities_that_do_not_fit_the_tensors_are_refused(path):
    other = json.dumps(dataclasses.asdict(dataclasses.replace(STATIC, num_objects=9)))
    with pytest.raises(OutputError, match="of another shape"):
        load_memory(rewrite(path, header={"static": other}))


def test_a_folder_that_is_missing_cannot_be_written_to(tmp_path, memory):
    with pytest.raises(OutputError, match="cannot write memory to"):
        save_memory(tmp_path / "nowhere" / "memory", memory)


def test_features_of_another_backbone_are_refused(memory):
    check_backbone(memory, "patch-statistics", "file")
    with pytest.raises(RemindError, match="cannot be compared"):
        check_backbone(memory, "dinov3", "file")


def test_switches_that_leave_room_are_followed(memory):
    config = load_config({"base": "remind", "static": {"assignment": "greedy", "num_objects": 999}})
    going_on = static_of(memory, config, "file")
    assert going_on == dataclasses.replace(STATIC, assignment="greedy")
    assert static_of(memory, load_config("published"), "file") == STATIC


@pytest.mark.parametrize(
    ("name", "value"),
    [("appearance_slots", (3, 5)), ("precision", "float64"), ("first_object_id", 100)],
)
def test_switches_that_ask_for_another_memory_are_refused(memory, name, value):
    config = load_config({"base": "remind", "static": {name: value}})
    made_with = re.escape(str(getattr(STATIC, name)))
    with pytest.raises(RemindError, match=rf"file was made with static\.{name} {made_with}, not"):
        static_of(memory, config, "file")
    assert static_of(memory, load_config("remind"), "file") == STATIC


@pytest.mark.parametrize(("tracker", "said"), [("plus", "--config"), ("bank", "--tracker")])
def test_the_memory_of_another_tracker_says_what_to_do(memory, tracker, said):
    made = dataclasses.replace(memory, tracker=tracker)
    with pytest.raises(RemindError, match=rf"memory of tracker '{tracker}'.*{said} {tracker}, or"):
        check_tracker(made, "remind", "file")
    check_tracker(made, tracker, "file")


def test_static_with_every_kind_of_field_survives(tmp_path):
    static = Static(feature_dim=4, appearance_slots=(3, 5), solver="jax", remove_objects=True)
    save_memory(tmp_path / "memory", SavedMemory(init(static), static, (), "x"))
    assert load_memory(tmp_path / "memory").static == static
