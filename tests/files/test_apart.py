"""Outputs never lie on inputs, whatever verb writes them; nothing is touched before."""

import pytest

from remind_jax.cli.main import main
from remind_jax.errors import OutputError
from remind_jax.files import refuse_file, refuse_folder
from tests.cli import scenes
from tests.outputs import fake_run
from tests.sources import making


def test_a_folder_that_is_or_holds_an_input_is_refused(tmp_path):
    images = tmp_path / "scene" / "images"
    images.mkdir(parents=True)
    for folder in (images, tmp_path / "scene", tmp_path):
        with pytest.raises(OutputError, match=r"(is|holds) the input"):
            refuse_folder(folder, [images, None])
    refuse_folder(tmp_path / "scene", [images], may_hold=True)
    with pytest.raises(OutputError, match="is the input"):
        refuse_folder(images, [images], may_hold=True)
    refuse_folder(tmp_path / "out", [images])
    refuse_folder(images / "out", [images])


def test_a_folder_inside_of_an_input_holds_nothing_but_ours(tmp_path):
    folder = tmp_path / "a"
    refuse_folder(folder, [tmp_path], ["ours.txt"])
    folder.mkdir()
    (folder / "theirs.png").touch()
    with pytest.raises(OutputError, match="lies in the input"):
        refuse_folder(folder, [tmp_path], ["ours.txt"])
    (folder / "ours.txt").touch()
    refuse_folder(folder, [tmp_path], ["ours.txt"])


def test_links_are_followed(tmp_path):
    (tmp_path / "images").mkdir()
    (tmp_path / "link").symlink_to("images")
    with pytest.raises(OutputError, match="is the input"):
        refuse_folder(tmp_path / "link", [tmp_path / "images"])


def test_a_file_that_is_an_input_or_one_of_its_files_is_refused(tmp_path):
    (tmp_path / "a.txt").write_text("")
    with pytest.raises(OutputError, match="is an input"):
        refuse_file(tmp_path / "a.txt", [tmp_path / "a.txt"])
    with pytest.raises(OutputError, match="belongs to"):
        refuse_file(tmp_path / "a.txt", [tmp_path])
    refuse_file(tmp_path / "a.txt", [tmp_path], is_read=lambda name: name.endswith(".png"))
    refuse_file(tmp_path / "b.txt", [tmp_path])


def contents(folder) -> dict[str, bytes]:
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }


@pytest.fixture
def place(tmp_path, monkeypatch):
    """A scene, a video and a run, in the folder that commands run in."""
    scenes.write_scene(tmp_path / "scene", 2)
    making.write_video(tmp_path / "scene" / "v.mp4", 2)
    fake_run.make_run(4, (48, 64), 2)[1].save(tmp_path / "run")
    (tmp_path / "gt.txt").write_text("1,1,1,1,5,5,1,1,1\n")
    (tmp_path / "theirs.yaml").write_text("association: {}\n")
    (tmp_path / "round").symlink_to("round")
    monkeypatch.chdir(tmp_path)
    return tmp_path


SCENE = "scene/images --masks scene/masks"


@pytest.mark.parametrize(
    "words",
    [
        f"run {SCENE} --overwrite --out scene/images",
        f"run {SCENE} --overwrite --out scene/masks",
        f"run {SCENE} --overwrite --out scene",
        f"run {SCENE} --overwrite --out .",
        "run scene/v.mp4 --masks none --overwrite --out scene",
        "run scene/v.mp4 --masks none --overwrite --out scene/images/..",
        f"run {SCENE} --out round/a",
        f"run {SCENE} --out fresh --mcap scene/images/0000.png",
        "sweep scene --set decision.new=1,2 --out scene",
        "sweep scene/images --masks scene/masks --set decision.new=1,2 --out scene/masks",
        "benchmark scene --out scene",
        "benchmark scene --out scene/images",
        "view run --source run",
        "view run --source run/overlay.mp4",
        "export run --out run/run.json --overwrite",
        "eval gt.txt gt.txt --json gt.txt",
        "eval run run --json run/run.json",
        "config import-reference theirs.yaml --out theirs.yaml",
    ],
)
def test_every_verb_leaves_its_inputs_alone(words, place, capsys):
    before = contents(place)
    assert main(words.split()) in (1, 2)
    assert contents(place) == before
    assert capsys.readouterr().err.count("remind: ") == 1
