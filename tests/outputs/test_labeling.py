"""What labeling tools get is read back, and scores as the run itself."""

import numpy as np
import pytest

from remind_jax.errors import OutputError
from remind_jax.metrics import evaluate
from remind_jax.metrics.formats.opening import open_scenes
from remind_jax.outputs import labeling, tables
from remind_jax.outputs.result import Result
from tests.outputs.fake_run import make_info, make_run, make_tracks


@pytest.fixture(scope="module")
def result() -> Result:
    return make_run()[1]


def firm(result: Result) -> list[tuple[int, int, bytes, str]]:
    """Frame, id, mask and class of every firm identity, without shared pixels."""
    return [
        (index, int(tracks.object_id[row]), rle["counts"], tracks.labels[row])
        for index, tracks in enumerate(result.tracks)
        for rows in [tables.firm_rows(tracks)]
        for row, rle in zip(rows, tables.masks_without_overlap(tracks, rows), strict=True)
        if rle is not None
    ]


def read(path):
    (scene,) = open_scenes(path).read.values()
    return scene()


def test_cvat_gives_the_run_back(result, tmp_path):
    labeling.export(result, "cvat", tmp_path / "cvat.xml")
    rows = read(tmp_path / "cvat.xml")
    assert rows.num_frames == result.tracks[-1].source_index + 1
    rows = rows.select(np.isin(rows.frame, [tracks.source_index for tracks in result.tracks]))
    expected = [
        (
            tracks.source_index,
            int(tracks.object_id[row]),
            tracks.rles[row]["counts"],
            tracks.labels[row],
        )
        for tracks in result.tracks
        for row in tables.firm_rows(tracks)
        for counts in [tracks.rles[row]["counts"]]
    ]
    assert rows.rles is not None
    got = zip(rows.frame, rows.track_id, (rle["counts"] for rle in rows.rles), strict=True)
    names = [rows.class_names[number] for number in rows.class_id]
    assert sorted((*one, name) for one, name in zip(got, names, strict=True)) == sorted(expected)


def test_mots_png_gives_the_run_back(result, tmp_path):
    labeling.export(result, "mots-png", tmp_path / "run.zip")
    rows = read(tmp_path / "run.zip")
    assert rows.rles is not None
    names = [rows.class_names[number] for number in rows.class_id]
    counts = [rle["counts"] for rle in rows.rles]
    expected = firm(result)
    got = list(zip(rows.frame.tolist(), counts, names, strict=True))
    assert sorted(got) == sorted((index, code, name) for index, _, code, name in expected)
    ids = {(index, code): number for index, number, code, _ in expected}
    pairs = {
        (number, ids[index, code])
        for index, number, code in zip(rows.frame.tolist(), rows.track_id, counts, strict=True)
    }
    assert len(pairs) == len({number for number, _ in pairs}) == len(set(ids.values()))


def test_the_same_run_gives_the_same_bytes(result):
    assert labeling.to_mots_png(result) == labeling.to_mots_png(result)


@pytest.mark.parametrize("format", ["cvat", "mots-png"])
def test_a_run_is_perfect_by_its_own_labels(result, tmp_path, format):
    truth = tmp_path / labeling.FILE_NAMES[format]
    labeling.export(result, format, truth)
    result.save(tmp_path / "run")
    scores = evaluate(truth, tmp_path / "run")
    assert scores.scores()["IDF1"] == pytest.approx(1.0)  # both count the same rows


def test_a_run_of_nothing_can_be_exported(tmp_path):
    empty = Result((), make_info())
    for format in labeling.FORMATS:
        labeling.export(empty, format, tmp_path / format)
        assert (tmp_path / format).stat().st_size > 0


def test_too_many_classes_are_told():
    masks = np.ones((1, 4, 4), bool)
    rows = [{"object_id": number, "label": f"class {number}"} for number in range(70)]
    run = tuple(make_tracks(index, masks, [row]) for index, row in enumerate(rows))
    info = make_info()
    with pytest.raises(OutputError, match="beyond that; export to cvat"):
        labeling.to_mots_png(Result(run, info))
