import csv
import json
import shutil

import pytest

from remind_jax.cli.main import main


def test_the_command_writes_tables_and_tells_numbers(dataset, tmp_path, capsys, monkeypatch):
    out = tmp_path / "out"
    words = ["benchmark", str(dataset), "--methods", "iou", "--out", str(out), "--json"]
    words += ["--feature-cache", str(tmp_path / "features")]
    assert main(words) == 0
    printed = capsys.readouterr()
    scores = json.loads(printed.out)["scores"]["IoU"]
    assert 0 < scores["IDF1"] < 1
    assert "alike-1, iou: 8 frames" in printed.err
    with (out / "tables" / "masks.csv").open() as file:
        (row,) = csv.DictReader(file)
    assert float(row["IDF1"]) == pytest.approx(scores["IDF1"])
    assert "| alike | light |" in (out / "tables" / "masks_axes.md").read_text()

    assert main([*words[:-3], "--quiet", "--scenes", "light-1"]) == 0
    assert capsys.readouterr().err == ""


def test_without_annotations_there_is_nothing_to_score(dataset, tmp_path, capsys):
    copy = tmp_path / "copy"
    shutil.copytree(dataset / "alike-1", copy)
    shutil.rmtree(copy / "Annotations")
    assert main(["benchmark", str(copy), "--methods", "iou", "--out", str(tmp_path / "out")]) == 1
    assert "nothing can be scored" in capsys.readouterr().err
