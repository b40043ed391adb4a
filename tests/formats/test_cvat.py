import dataclasses
import zipfile

import numpy as np
import pytest

from remind_jax.errors import SourceError
from remind_jax.formats.cvat import looks_like_cvat, read_cvat, to_cvat
from remind_jax.formats.firm import firm_rows
from remind_jax.masks.run_length import decode_mask
from remind_jax.metrics.scene_evaluation import evaluate
from remind_jax.outputs.result import Result
from tests.outputs import fake_run
from tests.outputs.fake_run import make_info, make_run

HEAD = (
    "<annotations><version>1.1</version><meta><task><size>6</size><original_size>"
    "<width>10</width><height>8</height></original_size></task></meta>"
)


def write(path, shapes, *, head=HEAD, label="mug", number="4"):
    path.write_text(f'{head}<track id="{number}" label="{label}">{shapes}</track></annotations>')
    return path


def box(frame, sides, outside=0):
    left, top, right, bottom = sides
    return (
        f'<box frame="{frame}" outside="{outside}" xtl="{left}" ytl="{top}" xbr="{right}" '
        f'ybr="{bottom}"/>'
    )


def mask(frame, rle, left=1, top=2, width=3, height=2, outside=0):
    return (
        f'<mask frame="{frame}" outside="{outside}" rle="{rle}" left="{left}" top="{top}" '
        f'width="{width}" height="{height}"/>'
    )


def test_boxes_go_over_to_the_next_one(tmp_path):
    shapes = box(0, (0, 0, 2, 2)) + box(2, (4, 2, 6, 4)) + box(3, (4, 2, 6, 4), outside=1)
    rows = read_cvat(write(tmp_path / "a.xml", shapes + box(5, (1, 1, 3, 3))))
    assert rows.frame.tolist() == [0, 1, 2, 5]
    np.testing.assert_array_equal(rows.boxes[1], [2, 1, 4, 3])
    assert (rows.num_frames, rows.rles, rows.class_names) == (6, None, ("mug",))
    assert set(rows.track_id) == {4}


def test_masks_hold_until_the_next_one(tmp_path):
    shapes = mask(1, "1, 2, 3") + mask(3, "0, 6") + mask(4, "0, 6", outside=1)
    rows = read_cvat(write(tmp_path / "a.xml", shapes))
    assert rows.frame.tolist() == [1, 2, 3]
    expected = np.zeros((8, 10), np.uint8)
    expected[2, 2:4] = 1
    np.testing.assert_array_equal(decode_mask(rows.rles[0]), expected)
    assert rows.rles[1]["counts"] == rows.rles[0]["counts"]
    assert decode_mask(rows.rles[2]).sum() == 6


def test_polygons_and_boxes_beside_masks_become_masks(tmp_path):
    polygon = '<polygon frame="1" outside="0" points="2,1;6,1;6,5;2,5"/>'
    shapes = mask(0, "0, 6") + polygon + box(2, (2, 1, 6, 5))
    rows = read_cvat(write(tmp_path / "a.xml", shapes))
    np.testing.assert_array_equal(decode_mask(rows.rles[1]), decode_mask(rows.rles[2]))
    assert decode_mask(rows.rles[1]).sum() == 16


def test_frames_of_a_job_are_those_that_it_shows(tmp_path):
    said = "<start_frame>30</start_frame><stop_frame>47</stop_frame>"
    head = HEAD.replace("</size>", f"</size>{said}<frame_filter>step=3</frame_filter>")
    shapes = box(33, (0, 0, 2, 2)) + box(39, (2, 4, 4, 6)) + box(42, (2, 4, 4, 6), outside=1)
    rows = read_cvat(write(tmp_path / "a.xml", shapes, head=head))
    assert (rows.num_frames, rows.source_frames.tolist()) == (6, [30, 33, 36, 39, 42, 45])
    assert rows.frame.tolist() == [1, 2, 3]
    np.testing.assert_array_equal(rows.boxes[1], [1, 2, 3, 4])
    text = "".join(f"{frame},1,1,2,2,2,1,-1,-1,-1\n" for frame in (31, 37, 38))
    (tmp_path / "mot.txt").write_text(text)
    scored = evaluate(tmp_path / "a.xml", tmp_path / "mot.txt")
    # Frame 38 of the text is 37 of the video, which the job does not show.
    assert (scored.scores()["Dets"], scored.scores()["IDTP"]) == (2, 1)
    # What is not in the frames that it says is of another program, or changed by hand.
    rows = read_cvat(write(tmp_path / "b.xml", box(2, (0, 0, 2, 2)), head=head))
    assert (rows.num_frames, rows.source_frames, rows.frame.tolist()) == (6, None, [2])


def test_the_zip_of_cvat_is_read(tmp_path):
    path = write(tmp_path / "annotations.xml", box(0, (0, 0, 2, 2)))
    with zipfile.ZipFile(tmp_path / "task.zip", "w") as archive:
        archive.write(path, "annotations.xml")
        archive.writestr("images/frame_000000.png", b"")
    assert read_cvat(tmp_path / "task.zip").name == "task"


def test_what_cannot_be_is_refused(tmp_path):
    one = box(0, (0, 0, 1, 1))
    for shapes, options in (
        (mask(0, "1, 2"), {}),
        (mask(0, "-1, 7"), {}),
        (mask(0, "0, 6", left=8), {}),
        (mask(0, "0, 99999999999999999999999"), {}),
        (mask(0, "0, 6", width=70000), {}),
        (box("x", (0, 0, 1, 1)), {}),
        (box(99999999999, (0, 0, 1, 1)), {}),
        (box(0, ("nan", 0, 1, 1)), {}),
        (box(0, (5, 0, 1, 1)), {}),
        ('<polygon frame="0" points="1,1;2,2"/>', {}),
        ('<polygon frame="0" points="1,1;2,inf;3,3"/>', {}),
        ('<ellipse frame="0"/>', {}),
        (one, {"label": "x" * 201}),
        (one, {"number": "-3"}),
        (mask(0, "0, 6"), {"head": "<annotations>"}),
        (mask(0, "0, 6"), {"head": HEAD.replace(">10<", ">0<")}),
        (one, {"head": "<!DOCTYPE a><annotations>"}),
        ("</track>", {}),
        (one.replace("/>", ' rotation="45.00"/>'), {}),
        (one, {"head": "<annotations><meta><project><task/><task/></project></meta>"}),
        (f'{one}</track><track id="5" label="mug" task_id="2">{one}', {}),
    ):
        with pytest.raises(SourceError, match=r"a\.xml") as refused:
            read_cvat(write(tmp_path / "a.xml", shapes, **options))
        assert str(refused.value).count("; ") == 1, refused.value  # one piece of advice
    (tmp_path / "a.xml").write_text("<html/>")
    with pytest.raises(SourceError, match="html"):
        read_cvat(tmp_path / "a.xml")
    (tmp_path / "a.xml").write_text("<annotations><image id='0'/></annotations>")
    with pytest.raises(SourceError, match="export 'CVAT for video'"):
        read_cvat(tmp_path / "a.xml")
    (tmp_path / "a.zip").write_bytes(b"PK")
    with pytest.raises(SourceError, match=r"a\.zip"):
        read_cvat(tmp_path / "a.zip")


def write_cvat(result, path):
    info = result.info
    path.write_bytes(to_cvat(result.tracks, info.name, result.class_names, info.frame_size))


def test_cvat_gives_the_run_back(tmp_path):
    result = make_run()[1]
    write_cvat(result, tmp_path / "cvat.xml")
    rows = read_cvat(tmp_path / "cvat.xml")
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
    rows = read_cvat(tmp_path / "uneven.xml")
    assert (rows.num_frames, rows.source_frames) == (result.tracks[-1].source_index + 1, None)
    write_cvat(Result((), make_info()), tmp_path / "empty.xml")
    assert (tmp_path / "empty.xml").stat().st_size > 0


def test_outlines_are_the_masks_with_their_parts_and_holes(tmp_path):
    random = np.random.default_rng(0)
    masks = random.random((24, 12, 9)) < np.linspace(0.05, 0.98, 24)[:, None, None]
    masks[:, 5, 5] = True
    run = [fake_run.make_tracks(i, one[None], [{"object_id": 0}]) for i, one in enumerate(masks)]
    (tmp_path / "run.xml").write_bytes(to_cvat(run, "run", ["object"], (12, 9)))
    rows = read_cvat(tmp_path / "run.xml")
    assert rows.rles is not None
    np.testing.assert_array_equal([decode_mask(rle) > 0 for rle in rows.rles], masks)
    assert "<mask" not in (tmp_path / "run.xml").read_text(), "CVAT knows no tracks of masks"


def test_what_would_take_too_much_is_refused(tmp_path):
    shapes = box(0, (0, 0, 2, 2)) + box(9_999_999, (0, 0, 2, 2))
    tracks = "".join(f'<track id="{i}" label="a">{shapes}</track>' for i in range(2))
    (tmp_path / "a.xml").write_text(f"{HEAD}{tracks}</annotations>")
    with pytest.raises(SourceError, match="over 20000000 frames in all; at most"):
        read_cvat(tmp_path / "a.xml")
    (tmp_path / "b.xml").write_text(f"{HEAD}</annotations>", encoding="utf-16")
    with pytest.raises(SourceError, match="no text in UTF-8"):
        read_cvat(tmp_path / "b.xml")
    with zipfile.ZipFile(tmp_path / "c.zip", "w") as archive:
        archive.writestr("annotations.xml", f"{HEAD}</annotations>")
    damaged = (tmp_path / "c.zip").read_bytes().replace(b"PK\1\2", b"PK\1\3")
    (tmp_path / "c.zip").write_bytes(damaged)
    with pytest.raises(SourceError, match=r"'.*c\.zip' is damaged"):
        looks_like_cvat(tmp_path / "c.zip")
