"""What labeling tools get is read back, and scores as the run itself."""

import dataclasses

import pytest

from remind_jax.formats.cvat import to_cvat
from remind_jax.formats.firm import firm_rows
from remind_jax.metrics.opening import open_scenes
from remind_jax.outputs.result import Result
from tests.outputs.fake_run import make_info, make_run


@pytest.fixture(scope="module")
def result() -> Result:
    return make_run()[1]


def write_cvat(result, path):
    info = result.info
    path.write_bytes(to_cvat(result.tracks, info.name, result.class_names, info.frame_size))


def read(path):
    (scene,) = open_scenes(path).read.values()
    return scene()


def test_cvat_gives_the_run_back(result, tmp_path):
    write_cvat(result, tmp_path / "cvat.xml")
    rows = read(tmp_path / "cvat.xml")
    assert rows.source_frames.tolist() == [tracks.source_index for tracks in result.tracks]
    expected = [
        (one.frame_index, one.object_id[row], one.rles[row]["counts"], one.labels[row])
        for one in result.tracks
        for row in firm_rows(one)
    ]
    got = zip(rows.frame, rows.track_id, (rle["counts"] for rle in rows.rles), strict=True)
    names = [rows.class_names[number] for number in rows.class_id]
    assert sorted((*one, name) for one, name in zip(got, names, strict=True)) == sorted(expected)
    uneven = dataclasses.replace(result, tracks=result.tracks[:2] + result.tracks[3:])
    write_cvat(uneven, tmp_path / "uneven.xml")  # no step of CVAT says which
    rows = read(tmp_path / "uneven.xml")
    assert (rows.num_frames, rows.source_frames) == (result.tracks[-1].source_index + 1, None)
    write_cvat(Result((), make_info()), tmp_path / "empty.xml")
    assert (tmp_path / "empty.xml").stat().st_size > 0
