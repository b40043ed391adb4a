"""`remind eval`."""

import json
import math

import pytest

BOX = "10,10,50,50,1,1,1"
BOX_AWAY = "310,310,50,50,1,1,1"


def write_tracks(path, ids: list[int]) -> None:
    path.write_text("".join(f"{frame},{i},{BOX}\n" for frame, i in enumerate(ids, start=1)))


def test_scores_are_printed_and_written(command, tmp_path):
    write_tracks(tmp_path / "gt.txt", [1, 1, 1, 1])
    write_tracks(tmp_path / "pred.txt", [5, 5, 5, 6])
    outcome = command("eval", "gt.txt", "pred.txt", "--json", "scores.json")
    assert outcome.code == 0
    assert "75.00 %" in outcome.stdout
    metrics = json.loads((tmp_path / "scores.json").read_text())["metrics"]
    assert math.isclose(metrics["IDF1"], 0.75)
    assert (metrics["IDSW"], metrics["GT_IDs"], metrics["IDs"]) == (1, 1, 2)


@pytest.mark.parametrize(("box", "first"), [(BOX_AWAY, 1), (BOX, 101)], ids=["place", "frames"])
def test_truth_of_another_scene_is_doubted(command, tmp_path, box, first):
    write_tracks(tmp_path / "gt.txt", [1] * 30)
    rows = "".join(f"{frame},1,{box}\n" for frame in range(first, first + 30))
    (tmp_path / "pred.txt").write_text(rows)
    outcome = command("eval", "gt.txt", "pred.txt", "--json", "scores.json")
    doubt = "only 0 of 30 predictions have a counterpart that overlaps by half or more"
    assert outcome.code == 0
    assert doubt in " ".join(outcome.stdout.split())
    assert doubt in json.loads((tmp_path / "scores.json").read_text())["notes"][0]
    several = command("eval", "gt.txt", "pred.txt", "gt.txt", "--resamples", "0").stdout
    assert doubt in " ".join(several.split())
    assert several.count("counterpart") == 1


def test_a_poor_but_fitting_prediction_is_not_doubted(command, tmp_path):
    write_tracks(tmp_path / "gt.txt", [1] * 30)
    rows = [f"{frame},1,{BOX if frame <= 3 else BOX_AWAY}\n" for frame in range(1, 31)]
    (tmp_path / "pred.txt").write_text("".join(rows))
    assert "counterpart" not in command("eval", "gt.txt", "pred.txt").stdout


def test_several_predictions_are_compared(command, tmp_path):
    write_tracks(tmp_path / "gt.txt", [1, 1, 1, 1])
    write_tracks(tmp_path / "ours.txt", [5, 5, 5, 5])
    write_tracks(tmp_path / "peer.txt", [5, 5, 5, 6])
    words = ("eval", "gt.txt", "ours.txt", "peer.txt", "--json", "all.json", "--resamples", "20")
    outcome = command(*words, "--table", "table.md", "table.csv", "--table", "table.txt")
    assert outcome.code == 0
    assert "ours" in outcome.stdout
    assert "peer" in outcome.stdout
    assert "**100.00**" in (tmp_path / "table.md").read_text()
    assert "peer" in (tmp_path / "table.csv").read_text()
    assert "peer" in (tmp_path / "table.txt").read_text()
    predictions = json.loads((tmp_path / "all.json").read_text())["predictions"]
    assert predictions["peer"]["metrics"]["IDSW"] == 1


def test_the_paper_protocol_names_its_deviations(command, tmp_path):
    write_tracks(tmp_path / "gt.txt", [1, 1])
    outcome = command("eval", "gt.txt", "gt.txt", "--protocol", "paper", "--json", "paper.json")
    assert outcome.code == 0
    assert "any overlap above 0" in outcome.stdout
    assert json.loads((tmp_path / "paper.json").read_text())["metrics"]["IDF1"] == 1.0


def test_options_that_change_nothing_are_refused(command, tmp_path):
    write_tracks(tmp_path / "gt.txt", [1, 1])
    video = {
        "videos": [{"id": 1, "file_names": ["1.png", "2.png"], "width": 100, "height": 100}],
        "annotations": [],
        "categories": [],
    }
    (tmp_path / "tracks.json").write_text(json.dumps(video))
    for option in ("--class-id", "--num-frames"):
        said = command("eval", "gt.txt", "tracks.json", option, "2").stderr
        assert f"{option} is for truth and predictions in text of one format" in said
        assert "they are 'mot' and 'coco-video'; leave it out" in said
    paper = ("eval", "gt.txt", "gt.txt", "--protocol", "paper")
    for words in (["--class-id", "2"], ["--by-class"], ["--undecided", "collapse"]):
        said = command(*paper, *words).stderr
        assert f"{words[0]} is of the standard protocol; leave it out" in said


def test_files_that_cannot_be_written_are_refused_before_anything_is_scored(command, tmp_path):
    write_tracks(tmp_path / "gt.txt", [1, 1])
    for words, why in {
        ("--json", "scores/x.json"): "there is no folder 'scores'; make it",
        ("--table", "scores/x.md"): "there is no folder 'scores'; make it",
        ("--table", "x.html"): "a table can be written as .md, .csv or .txt",
    }.items():
        outcome = command("eval", "gt.txt", "no_prediction.txt", *words)
        assert outcome.code == 1
        assert why in " ".join(outcome.stderr.split())
