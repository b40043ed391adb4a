"""Memory files that are brought up to date: what changed is added, and outlives a kill anywhere."""

import dataclasses
import logging
from pathlib import Path

import chex
import numpy as np
import pytest

from remind_jax import files
from remind_jax.errors import OutputError
from remind_jax.plus.recall import ObjectsAtRest
from remind_jax.session.announcement import Announcements
from remind_jax.session.filed_records import to_file
from remind_jax.session.memory_file import MemoryFile, SavedMemory, load_memory, save_memory
from remind_jax.session.object_records import ObjectRecords
from tests.plus.test_archive import CENTER, EMPTY, STATIC, remembered
from tests.session.test_object_records import seen

NUM = 30


class Life:
    """A memory that goes on: objects rest and come back, are seen, named and forgotten."""

    def __init__(self) -> None:
        self.state, self.at_rest = remembered(NUM), ObjectsAtRest()
        self.state = dataclasses.replace(self.state, frame=np.int32(100))
        self.records = ObjectRecords()
        self.records.note(seen(0, [3 * one for one in range(NUM)]), None)
        self.rest(range(20))

    def rest(self, slots) -> None:
        self.state = self.at_rest.rest_slots(self.state, EMPTY, slots)

    def wake(self, ids) -> None:
        self.state = self.at_rest.wake(self.state, ids, CENTER)
        self.at_rest.drop_present(self.state)

    def go_on(self, frame: int) -> None:
        """Two objects come back, of which one rests again at once, and one is forgotten."""
        first, second, third, *_ = self.at_rest.ids()
        self.wake([first, second])
        self.records.note(seen(frame, [first, second]), None)
        self.records.rename(second, f"named in frame {frame}")
        self.rest([self.state.objects.id.tolist().index(first)])
        self.at_rest.forget([third])
        self.records.drop(third)
        self.state = dataclasses.replace(self.state, frame=np.int32(100 + frame))

    @property
    def memory(self) -> SavedMemory:
        return SavedMemory(
            self.state, STATIC, ("cup", "mug", "pot"), "none", "plus",
            Announcements(), self.records, self.at_rest,
        )  # fmt: skip


def assert_same(one: SavedMemory, other: SavedMemory) -> None:
    chex.assert_trees_all_equal(one.state, other.state, strict=True)
    assert one.at_rest is not None
    assert other.at_rest is not None
    chex.assert_trees_all_equal(*(_resting(memory) for memory in (one, other)), strict=True)
    assert one.at_rest.ids() == other.at_rest.ids()
    of_each = [to_file(memory.records, memory.object_ids())[0] for memory in (one, other)]
    assert of_each[0] == of_each[1]


def _resting(memory: SavedMemory):
    assert memory.at_rest is not None
    snapshot = memory.at_rest.snapshot()
    resting = {
        one: (kept.values, kept.bank, kept.bank_count) for one, kept in snapshot.resting.items()
    }
    return resting, {one: partners.tolist() for one, partners in snapshot.partners.items()}


@pytest.fixture
def path(tmp_path) -> Path:
    return tmp_path / "memory.safetensors"


@pytest.fixture
def begun(path) -> tuple[Life, MemoryFile]:
    """A life whose memory was written once."""
    life, file = Life(), MemoryFile(path)
    file.update(life.memory)
    return life, file


def test_what_changed_is_added_and_read_back(path, begun, caplog):
    life, file = begun
    whole = path.read_bytes()
    for frame in (1, 2, 3):
        life.go_on(frame)
        if frame == 2:
            life.at_rest.forget(life.at_rest.ids()[-4:])
        file.update(life.memory)
        save_memory(path.with_name("whole"), life.memory)
        assert_same(load_memory(path), load_memory(path.with_name("whole")))
        if frame == 1:
            assert path.read_bytes().startswith(whole)
    assert not caplog.records


def test_nothing_at_rest_is_added_where_nothing_changed(path, begun):
    life, file = begun
    size = path.stat().st_size
    file.update(life.memory)
    assert life.at_rest.tensors(life.at_rest.snapshot()) == {}
    looks = sum(tensor.nbytes for tensor in life.at_rest.tensors().values())
    assert path.stat().st_size < 2 * size - looks
    assert_same(load_memory(path), life.memory)


def test_a_kill_at_any_byte_leaves_the_memory_before(path, begun, caplog):
    life, file = begun
    life.go_on(1)
    file.update(life.memory)
    kept, before = load_memory(path), path.stat().st_size
    life.go_on(2)
    file.update(life.memory)
    content = path.read_bytes()
    added = len(content) - before
    for cut in sorted({1, 7, 8, 9, added - 1, *range(2, added, added // 5)}):
        for left in (content[: before + cut], content[: before + cut] + bytes(added - cut)):
            if left != content:  # zeros: blocks that were not on the disk when the power went
                path.write_bytes(left)
                assert_same(load_memory(path), kept)
                assert "was not written to its end" in caplog.text
                caplog.clear()
    path.write_bytes(content)
    assert_same(load_memory(path), life.memory)


def test_a_disk_that_was_full_for_a_while_is_no_other_program(path, begun, monkeypatch):
    def write_half(path: Path, content: bytes) -> None:
        path.write_bytes(path.read_bytes() + content[: len(content) // 2])
        raise OutputError("no space left")

    life, file = begun
    kept = load_memory(path)
    life.go_on(1)
    with monkeypatch.context() as patched:
        patched.setattr(files, "append_durably", write_half)
        with pytest.raises(OutputError, match="no space left"):
            file.update(life.memory)
    assert_same(load_memory(path), kept)
    file.update(life.memory)
    assert_same(load_memory(path), life.memory)


def test_a_file_is_written_anew_before_it_is_three_times_as_large(path, begun):
    life, file = begun
    whole, sizes = path.stat().st_size, []
    for _ in range(12):
        file.update(life.memory)
        sizes.append(path.stat().st_size)
    assert min(sizes[1:]) <= 1.1 * whole
    assert max(sizes) < 3 * whole
    assert_same(load_memory(path), life.memory)


def test_a_file_that_is_gone_is_written_anew(path, begun):
    life, file = begun
    path.unlink()
    life.go_on(1)
    file.update(life.memory)
    assert_same(load_memory(path), life.memory)


def test_changes_that_do_not_fit_are_refused(path, begun, caplog):
    caplog.set_level(logging.ERROR)
    life, file = begun
    ends = [path.stat().st_size]
    for frame in (1, 2):
        life.go_on(frame)
        file.update(life.memory)
        ends.append(path.stat().st_size)
    content = path.read_bytes()
    first, second, third = (
        content[start:end] for start, end in zip([0, *ends], ends, strict=False)
    )
    spoiled = bytearray(second)
    spoiled[-20] ^= 1
    for parts in (
        (first, bytes(spoiled), third),
        (first, third),
        (first, second, second),
        (first, first),
        (first, third, second),
    ):
        path.write_bytes(b"".join(parts))
        with pytest.raises(OutputError, match="a change in it is another one"):
            load_memory(path)
    path.write_bytes(second)
    with pytest.raises(OutputError, match="is not a memory file"):
        load_memory(path)
