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


def listed(path, capsys) -> list[dict]:
    capsys.readouterr()
    assert main(["memory", str(path), "--json"]) == process.FINE
    return json.loads(capsys.readouterr().out)


def test_objects_are_listed(run, capsys):
    objects = listed(run[0], capsys)
    assert [one["id"] for one in objects] == [0, 1, 2]
    assert all(one["frames"] == 3 and one["pictures"] > 0 for one in objects)
    assert main(["memory", str(run[0])]) == process.FINE
    said = " ".join(capsys.readouterr().out.split())
    assert "3 objects in 1 session, tracker bank, patch-statistics" in said
    assert "session 1, frame 2" in said


def test_changes_are_kept(memory, capsys):
    assert main(["memory", str(memory), "rename", "1", "my mug"]) == process.FINE
    assert "object 1 is called 'my mug'" in capsys.readouterr().out
    assert main(["memory", str(memory), "merge", "0", "2"]) == process.FINE
    objects = listed(memory, capsys)
    assert [(one["id"], one["name"], one["merged"]) for one in objects] == [
        (0, "", [2]),
        (1, "my mug", []),
    ]
    assert main(["memory", str(memory), "split", "0"]) == process.FINE
    assert main(["memory", str(memory), "forget", "0", "2"]) == process.FINE
    assert [one["id"] for one in listed(memory, capsys)] == [1]


def test_the_file_is_left_alone_where_another_is_named(memory, tmp_path, capsys):
    before = memory.read_bytes()
    other = tmp_path / "other.safetensors"
    words = ["memory", str(memory), "forget", "0", "-o", str(other)]
    assert main(words) == process.FINE
    assert memory.read_bytes() == before
    assert [one["id"] for one in listed(other, capsys)] == [1, 2]
    assert main(words) == process.ERROR
    assert "exists" in capsys.readouterr().err


def test_two_memories_become_one(tmp_path, capsys):
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
    words = ["memory", str(paths[0]), "join", str(paths[1].parent), "-o", str(out)]
    assert main(words) == process.FINE
    said = " ".join(capsys.readouterr().out.split())
    assert f"{out}: " in said
    assert f"3 objects of {paths[1]} added, 2 of them known" in said
    assert "4 merged into object 1" in said
    assert [path.read_bytes() for path in paths] == before
    objects = listed(out, capsys)
    assert [(one["id"], one["label"], one["merged"]) for one in objects] == [
        (0, "cup", []),
        (1, "cup", [4]),
        (2, "book", [5]),
        (3, "vase", []),
    ]
    assert main(["memory", str(out), "split", "2", "--quiet"]) == process.FINE
    assert [one["id"] for one in listed(out, capsys)] == [0, 1, 2, 3, 5]
    assert main([*words[:4], "-o", str(paths[1]), "--overwrite"]) == process.ERROR
    assert "is an input" in capsys.readouterr().err
    assert main(["memory", str(out), "join", str(tmp_path / "none")]) == process.ERROR
    assert "Traceback" not in capsys.readouterr().err


def test_memories_that_do_not_fit_are_not_joined(memory, capsys):
    before = memory.read_bytes()
    assert main(["memory", str(memory), "join", str(memory)]) == process.ERROR
    assert "tracker 'bank' cannot join memories" in capsys.readouterr().err
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
    (["forget", "0", "9"], process.ERROR, "there is no object 9"),
    (["split", "1"], process.ERROR, "nothing was merged into object 1"),
    (["rename", "1", "a\nb"], process.ERROR, "cannot be called"),
    (["-o", "elsewhere"], process.USAGE, "--out is for a changed memory"),
)


def test_what_is_no_change_is_refused(memory, capsys):
    before = memory.read_bytes()
    for words, code, said in CHANGES_THAT_ARE_NONE:
        assert main(["memory", str(memory), *words]) == code, words
        shown = capsys.readouterr()
        assert said in shown.err
        assert "Traceback" not in shown.err + shown.out
        assert memory.read_bytes() == before


def test_pictures_are_named_by_their_objects(memory, tmp_path):
    assert main(["memory", str(memory), "rename", "1", "<b>/mug", "--quiet"]) == process.FINE
    folder = tmp_path / "objects"
    words = ["memory", str(memory), "--pictures", str(folder), "--quiet"]
    assert main(words) == process.FINE
    names = sorted(path.name for path in folder.iterdir())
    assert {name[:8] for name in names} >= {"000000-1", "000001-1", "000002-1"}
    assert "000001-1-_b_mug.jpg" in names
    assert cv2.imread(str(folder / names[0])) is not None
    assert main(words) == process.ERROR
    assert main([*words, "--overwrite"]) == process.FINE


def test_a_later_run_says_whom_it_met_again(memory, tmp_path, capsys):
    for number, name in (("0", "my mug"), ("2", "=spoon")):
        assert main(["memory", str(memory), "rename", number, name, "--quiet"]) == process.FINE
    seen = scenes.write_scene(tmp_path, 2, seen={0: (1, 2), 1: (1, 2)})
    words = [seen[0], "--masks", seen[1], "--out", tmp_path / "later", "--memory", memory]
    words += ["--tracker", "bank", "--no-overlay"]
    assert main(["run", *map(str, words)]) == process.FINE
    assert "2 of 3 known objects met again; not met: =spoon" in capsys.readouterr().out
    result = Result.load(tmp_path / "later")
    assert result.tracks[0].display_name(0) == "my mug"
    assert [one.object_id for one in result.not_met()] == [2]
    assert result.objects()[0].title == "my mug"
    with (tmp_path / "later" / "tracks.csv").open(newline="") as file:
        assert {row["object_name"] for row in csv.DictReader(file)} == {"my mug", ""}
    assert '"name":"my mug"' in (tmp_path / "later" / "report.html").read_text()
    assert [one["last"]["session"] for one in listed(tmp_path / "later", capsys)] == [2, 2, 1]
