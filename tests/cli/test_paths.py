"""Paths that nothing can have are refused in one sentence, in every verb."""

import pytest

from remind_jax.cli.main import main
from tests.cli import scenes

LONG = "x" * 300
VERBS = {
    "run": "run scene/images --masks scene/masks --out {}",
    "run source": "run {}",
    "run masks": "run scene/images --masks {}",
    "run memory": "run scene/images --masks scene/masks --memory {}",
    "run config": "run scene/images --masks scene/masks --config {}.yaml",
    "run mcap": "run scene/images --masks scene/masks --out o --mcap {}",
    "run detector": "run scene/images --detector {}",
    "run weights": "run scene/images --masks scene/masks --backbone vit --weights {}",
    "run encoder": "run scene/images --masks scene/masks --backbone onnx:{}",
    "run metadata": "run scene/images --masks scene/masks --metadata {}",
    "run cache": "run scene/images --masks scene/masks --out o --feature-cache {}",
    "demo": "demo --out {}",
    "view": "view {}",
    "view source": "view run --source {}",
    "explain": "explain {} --frame 0 --detection 0",
    "export": "export {}",
    "export out": "export run --out {}",
    "label": "label {}",
    "label edits": "label run --apply {} --out truth",
    "eval": "eval {0} {0}",
    "eval json": "eval gt.txt gt.txt --json {}",
    "eval table": "eval gt.txt gt.txt --table {}.csv",
    "benchmark": "benchmark scene --out {}",
    "benchmark root": "benchmark {}",
    "sweep": "sweep scene --set decision.new=1,2 --out {}",
    "sweep settings": "sweep scene --settings {}.json",
    "convert": "convert {}",
    "convert out": "convert gt.txt --out {}.safetensors",
    "config show": "config show {}.yaml",
    "config validate": "config validate {}",
    "config import": "config import-reference {}",
    "config import out": "config import-reference gt.txt --out {}",
}


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    folder = tmp_path_factory.mktemp("paths")
    scenes.write_scene(folder / "scene", 2)
    (folder / "gt.txt").write_text("1,1,1,1,5,5,1,1,1\n")
    return folder


@pytest.mark.parametrize("path", [f"a/{LONG}/b", "a\0b", "round/x", "a\udcff"])
def test_an_impossible_path_is_refused(path, place, monkeypatch, capsys):
    monkeypatch.chdir(place)
    if path == "round/x" and not (place / "round").is_symlink():
        (place / "round").symlink_to("round")
    before = sorted(place.rglob("*"))
    for verb, words in VERBS.items():
        assert main([word.format(path) for word in words.split()]) in (1, 2), verb
        told = capsys.readouterr().err
        assert told.count("remind: ") == 1, told
    assert sorted(place.rglob("*")) == before
