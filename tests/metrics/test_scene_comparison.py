from pathlib import Path

import pytest

import remind_jax as rj
from remind_jax.errors import RemindError
from remind_jax.metrics.comparison import column_of, is_best
from remind_jax.metrics.paper_evaluation import evaluate_paper, paper_table
from remind_jax.metrics.scene_evaluation import name_predictions
from tests.formats import scenes as made
from tests.formats.scenes import ANSWERS, TRUTH


def test_predictions_of_any_format_in_one_table(tmp_path: Path):
    truth = made.write_davis(tmp_path / "truth", TRUTH)
    masks = made.write_maps(tmp_path / "masks", TRUTH)
    boxes = made.write_texts(
        tmp_path / "boxes", {name: made.mot_text(rows) for name, rows in ANSWERS.items()}
    )
    (boxes / "two.txt").unlink()
    table = rj.compare(truth, {"perfect": masks, "switching": boxes}, num_resamples=50)
    perfect, switching = table.rows
    assert perfect.scores["IDF1"] == 1.0
    assert switching.scores["IDSW"] == 1
    assert switching.note == "1 of 2 scenes failed"
    assert "switching: scene 'two' failed: there is no prediction of this scene" in table.legend
    assert any(
        line.endswith("over scenes; of a single scene over its objects.") for line in table.legend
    )
    assert perfect.intervals["IDF1"] == (1.0, 1.0)
    assert "**100.00** (100.0 to 100.0)" in table.to_markdown()


def test_what_failed_on_some_scenes_is_not_the_best_under_the_papers_protocol(tmp_path: Path):
    truth = made.write_davis(tmp_path / "truth", TRUTH)
    half = made.write_maps(tmp_path / "half", {"one": TRUTH["one"], "other": TRUTH["two"]})
    whole = made.write_maps(tmp_path / "whole", ANSWERS)
    scored = [one for path in (half, whole) for one in evaluate_paper(truth, path)]
    table = paper_table(scored, num_resamples=0)
    assert table.rows[0].note == "generic formulas; 1 of 2 scenes failed"
    assert [is_best(table.rows, row, column_of("IDF1")) for row in table.rows] == [False, True]


def test_predictions_of_no_scene_say_which_scenes_there_are(tmp_path: Path):
    """As a run in a folder of another name, beside others that could be scored."""
    truth = made.write_davis(tmp_path / "truth", TRUTH)
    masks = made.write_maps(tmp_path / "masks", TRUTH)
    run = made.write_maps(tmp_path / "runs", {"mine": TRUTH["one"]})
    with pytest.raises(RemindError, match=r"runs' predicts no scene of .*: it holds mine, and the"):
        rj.compare(truth, [masks, run], num_resamples=0)


def test_one_scene_has_intervals_over_its_objects(tmp_path: Path):
    truth = made.write_maps(tmp_path / "truth", {"one": TRUTH["one"]})
    prediction = made.write_maps(tmp_path / "prediction", {"one": ANSWERS["one"]})
    table = rj.compare(truth, [prediction], num_resamples=50)
    low, high = table.rows[0].intervals["IDF1"]
    assert 0.5 < low < high == 1.0
    assert any("over objects" in sentence for sentence in table.legend)
    assert rj.compare(truth, [prediction], num_resamples=0).rows[0].intervals == {}


def test_predictions_are_named_by_what_tells_them_apart():
    assert list(name_predictions(["a/ours.txt", "b/peer.txt"])) == ["ours", "peer"]
    assert list(name_predictions(["a/mot.txt", "b/mot.txt"])) == ["a/mot", "b/mot"]
    with pytest.raises(RemindError, match="given twice"):
        name_predictions(["a.txt", "a.txt"])
    with pytest.raises(RemindError, match="no prediction to compare"):
        name_predictions([])
