"""`remind memory`: who is remembered, and what people know better."""

import csv
import json
import shutil

import cv2
import numpy as np
import pytest

import remind_jax as rj
from remind_jax.cli import process
from remind_jax.cli.main import main
from remind_jax.outputs.result import Result
from remind_jax.session import memory_file
from tests.cli import scenes


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """A run of three objects, and the folders of its frames and masks."""
    folder = tmp_path_factory.mktemp("visit")
    images, masks = scenes.write_scene(folder, 3)
    out = folder / "run"
    words = [images, "--masks", masks, "--out", out, "--tracker", "bank", "--no-overlay", "--quiet"]
    assert main(["run", *map(str, words)]) == process.FINE
    return out, images, masks


@pytest.fixture
def memory(run, tmp_path):
    return shutil.copy(run[0] / "memory.safetensors", tmp_path / "memory.safetensors")


def listed(command, path) -> list[dict]:
    outcome = command("memory", path, "--json")
    assert outcome.code == process.FINE
    return json.loads(outcome.stdout)


def test_objects_are_listed(command, run):
    objects = listed(command, run[0])
    assert [one["id"] for one in objects] == [0, 1, 2]
    assert all(one["frames"] == 3 and one["pictures"] > 0 for one in objects)
    said = " ".join(command("memory", run[0]).stdout.split())
    assert "3 objects in 1 session, tracker bank, patch-statistics" in said
    assert "session 1, frame 2" in said


def test_changes_are_kept(command, memory):
    renamed = command("memory", memory, "rename", 1, "my mug")
    assert "object 1 is called 'my mug'" in renamed.stdout
    assert command("memory", memory, "merge", 0, 2).code == process.FINE
    objects = listed(command, memory)
    assert [(one["id"], one["name"], one["merged"]) for one in objects] == [
        (0, "", [2]),
        (1, "my mug", []),
    ]
    assert command("memory", memory, "split", 0).code == process.FINE
    assert command("memory", memory, "forget", 0, 2).code == process.FINE
    assert [one["id"] for one in listed(command, memory)] == [1]


def test_a_change_by_a_link_is_one_of_the_file(command, memory, tmp_path):
    link = tmp_path / "current.safetensors"
    link.symlink_to(memory)
    assert command("memory", link, "rename", 1, "my mug").code == process.FINE
    assert link.is_symlink()
    assert listed(command, memory)[1]["name"] == "my mug"


def test_a_change_by_another_command_meanwhile_is_not_lost(command, memory, monkeypatch):
    load = memory_file.load_memory

    def load_while_another_renames(path):
        loaded = load(path)
        monkeypatch.setattr(memory_file, "load_memory", load)
        assert main(["memory", str(memory), "rename", "0", "first"]) == process.FINE
        return loaded

    monkeypatch.setattr(memory_file, "load_memory", load_while_another_renames)
    refused = command("memory", memory, "rename", 1, "second")
    assert refused.code != process.FINE
    assert "was changed by another program meanwhile" in refused.stderr
    assert [one["name"] for one in listed(command, memory)] == ["first", "", ""]


def test_what_resuming_would_not_know_is_said(command, memory):
    kept = memory.parent / "checkpoint" / memory.name
    kept.parent.mkdir()
    shutil.copy(memory, kept)
    said = " ".join(command("memory", memory, "rename", 1, "my mug").stdout.split())
    assert "not complete, and --resume goes on from" in said
    memory.unlink()  # as of a run that was killed
    assert "complete" not in command("memory", memory.parent, "rename", 2, "mine").stdout
    assert [one["name"] for one in listed(command, kept)] == ["", "", "mine"]


def test_the_file_is_left_alone_where_another_is_named(command, memory):
    before = memory.read_bytes()
    words = ("memory", memory, "forget", 0, "-o", "other.safetensors")
    assert command(*words).code == process.FINE
    assert memory.read_bytes() == before
    assert [one["id"] for one in listed(command, "other.safetensors")] == [1, 2]
    assert "exists" in command(*words).stderr


def test_two_memories_become_one(command, tmp_path):
    paths = []
    for name, ids in (("monday", (1, 2, 3)), ("tuesday", (4, 2, 3))):
        tracker = rj.Tracker()
        for index in range(12):
            # Side by side, so that no object has another one in its background.
            images, labels = zip(*(scenes.picture(index, (one,)) for one in ids), strict=True)
            masks = [np.hstack(labels) == one for one in ids]
            masks = rj.Detections.create(masks, [scenes.CLASSES[one] for one in ids])
            tracker.update(np.hstack(images), masks)
        (tmp_path / name).mkdir()
        paths.append(tmp_path / name / "memory.safetensors")
        tracker.save(paths[-1])
    before = [path.read_bytes() for path in paths]
    out = tmp_path / "both.safetensors"
    join = ("memory", paths[0], "join", paths[1].parent)
    said = " ".join(command(*join, "-o", out).stdout.split())
    assert f"{out}: " in said
    assert f"3 objects of {paths[1]} added, 2 of them known" in said
    assert "4 merged into object 1" in said
    assert [path.read_bytes() for path in paths] == before
    objects = listed(command, out)
    assert [(one["id"], one["label"], one["merged"]) for one in objects] == [
        (0, "cup", []),
        (1, "cup", [4]),
        (2, "book", [5]),
        (3, "vase", []),
    ]
    assert command("memory", out, "split", 2, "--quiet").code == process.FINE
    assert [one["id"] for one in listed(command, out)] == [0, 1, 2, 3, 5]
    assert "is an input" in command(*join, "-o", paths[1], "--overwrite").stderr
    missing = command("memory", out, "join", "none")
    assert missing.code == process.ERROR
    assert "Traceback" not in missing.stderr


def test_memories_that_do_not_fit_are_not_joined(command, memory):
    before = memory.read_bytes()
    assert "tracker 'bank' cannot join memories" in command("memory", memory, "join", memory).stderr
    assert memory.read_bytes() == before


CHANGES_THAT_ARE_NONE = (
    (["lose", "1"], process.USAGE, "cannot be changed by 'lose'"),
    (["rename", "1"], process.USAGE, "give rename ID NAME"),
    (["rename", "x", "mug"], process.USAGE, "is no change"),
    (["rename", "9" * 5000, "mug"], process.USAGE, "is no change"),
    (["forget", "\u0663"], process.USAGE, "is no change"),
    (["rename", "0", "a\udcff"], process.USAGE, "is no text in UTF-8"),
    (["merge", "1"], process.USAGE, "give merge ID ID"),
    (["join"], process.USAGE, "give join OTHER"),
    (["join", "a", "b"], process.USAGE, "give join OTHER"),
    (["split", "1", "2"], process.USAGE, "give split ID"),
    (["forget"], process.USAGE, "give forget ID"),
    (["forget", "-1"], process.USAGE, ""),
    (["forget", "9"], process.ERROR, "there is no object 9; known: 0, 1, 2"),
    (["forget", "0", "9"], process.ERROR, "there is no object 9; known: 0, 1, 2"),
    (["split", "1"], process.ERROR, "nothing was merged into object 1"),
    (["rename", "1", "a\nb"], process.ERROR, "cannot be called"),
    (["-o", "elsewhere"], process.USAGE, "--out is for a changed memory"),
)


def test_what_is_no_change_is_refused(command, memory):
    before = memory.read_bytes()
    for words, code, said in CHANGES_THAT_ARE_NONE:
        outcome = command("memory", memory, *words)
        assert outcome.code == code, words
        assert said in outcome.stderr
        assert "Traceback" not in outcome.stderr + outcome.stdout
        assert memory.read_bytes() == before


def test_pictures_are_named_by_their_objects(command, memory, tmp_path):
    assert command("memory", memory, "rename", 1, "<b>/mug", "--quiet").code == process.FINE
    words = ("memory", memory, "--pictures", "objects", "--quiet")
    assert command(*words).code == process.FINE
    files = sorted((tmp_path / "objects").iterdir())
    assert {file.name[:8] for file in files} >= {"000000-1", "000001-1", "000002-1"}
    assert "000001-1-_b_mug.jpg" in [file.name for file in files]
    assert cv2.imread(str(files[0])) is not None
    assert command(*words).code == process.ERROR
    assert command(*words, "--overwrite").code == process.FINE


def test_a_later_run_says_whom_it_met_again(command, memory, tmp_path):
    for number, name in (("0", "my mug"), ("2", "=spoon")):
        assert command("memory", memory, "rename", number, name, "--quiet").code == process.FINE
    images, masks = scenes.write_scene(tmp_path, 2, seen={0: (1, 2), 1: (1, 2)})
    words = ("run", images, "--masks", masks, "--out", "later", "--memory", memory)
    outcome = command(*words, "--tracker", "bank", "--no-overlay")
    assert "2 of 3 known objects met again; not met: =spoon" in outcome.stdout
    result = Result.load(tmp_path / "later")
    assert result.tracks[0].display_name(0) == "my mug"
    assert [one.object_id for one in result.not_met()] == [2]
    assert result.objects()[0].title == "my mug"
    with (tmp_path / "later" / "tracks.csv").open(newline="") as file:
        assert {row["object_name"] for row in csv.DictReader(file)} == {"my mug", ""}
    assert '"name":"my mug"' in (tmp_path / "later" / "report.html").read_text()
    assert [one["last"]["session"] for one in listed(command, "later")] == [2, 2, 1]
