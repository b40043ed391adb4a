import json
from typing import Any

import numpy as np
import pytest

from remind_jax.errors import SourceError
from remind_jax.formats.coco import read_categories
from remind_jax.sources import open_source
from remind_jax.sources.sampling import Sampling
from tests.sources import making

MASK = making.instance_map() == 2
CATEGORIES = [{"id": 1, "name": "cup"}, {"id": 5, "name": "tv"}]


RLE = making.run_lengths(MASK)


def opened(tmp_path, content, names=("00003.png", "00004.png"), suffix=".json", **options):
    making.write_images(tmp_path / "v", list(names))
    text = content if isinstance(content, str) else json.dumps(content)
    (tmp_path / f"d{suffix}").write_text(text)
    return open_source(tmp_path / "v", masks=tmp_path / f"d{suffix}", **options)


def seen(source):
    return [(f.detections.labels, f.detections.scores.tolist()) for f in source]


def test_results_list_with_categories_of_another_file(tmp_path):
    results = [
        {"image_id": 4, "category_id": 5, "segmentation": RLE, "score": 0.5},
        {"image_id": 4, "category_id": 1, "segmentation": RLE, "score": 0.25},
    ]
    (tmp_path / "c.json").write_text(json.dumps({"categories": CATEGORIES}))
    source = opened(tmp_path, results, metadata=tmp_path / "c.json")
    assert seen(source) == [((), []), (("tv", "cup"), [0.5, 0.25])]
    frame = list(source)[1]
    np.testing.assert_array_equal(frame.detections.masks, [MASK, MASK])


def test_categories_beside_a_davis_folder_are_not_its_metadata(tmp_path):
    making.write_davis(tmp_path, metadata=making.LABELS)
    results = [{"image_id": 1, "category_id": 5, "segmentation": RLE}]
    (tmp_path / "d.json").write_text(json.dumps(results))
    (tmp_path / "c.json").write_text(json.dumps({"categories": CATEGORIES}))
    source = open_source(tmp_path, masks=tmp_path / "d.json", metadata=tmp_path / "c.json")
    assert [labels for labels, _ in seen(source)] == [(), ("tv",), ()]


def test_data_set_goes_by_file_name(tmp_path):
    content = {
        "images": [{"id": 1, "file_name": "x/00004.jpg"}, {"id": 2, "file_name": "other.jpg"}],
        "annotations": [
            {"image_id": 1, "category_id": 1, "segmentation": RLE},
            {"image_id": 2, "category_id": 1, "segmentation": RLE},
        ],
        "categories": CATEGORIES,
    }
    source = opened(tmp_path, content)
    assert seen(source) == [((), []), (("cup",), [1.0])]
    assert source.notes == [f"1 of 2 images in '{tmp_path / 'd.json'}' are not frames of 'v'"]


def test_video_annotations(tmp_path):
    content = {
        "videos": [{"id": 1}],
        "annotations": [{"id": 9, "video_id": 1, "category_id": 5, "segmentations": [None, RLE]}],
        "categories": CATEGORIES,
    }
    frames = list(opened(tmp_path, content))
    assert seen(frames) == [((), []), (("tv",), [1.0])]
    assert frames[1].detections.instance_ids.tolist() == [9]


@pytest.mark.parametrize("shape", ["polygon", "box", "track"])
def test_shapes_of_pictures_of_another_size_are_scaled(tmp_path, shape):
    height, width = (2 * side for side in making.SIZE)
    size: dict[str, Any] = {"height": height, "width": width}
    if shape == "box":
        size = {"height": str(height), "width": float(width)}  # as some write them
    polygon = [[8, 8, 24, 8, 24, 16, 8, 16]]
    form = {"bbox": [8, 8, 16, 8]} if shape == "box" else {"segmentation": polygon}
    image = {"id": 3, "file_name": "00003.png", **size}
    content = {"images": [image], "annotations": [{"image_id": 3, "label": "a", **form}]}
    if shape == "track":
        tracks = [{"id": 1, "video_id": 1, "label": "a", "segmentations": [polygon]}]
        content = {"videos": [{"id": 1, **size}], "annotations": tracks}
    wanted = np.zeros(making.SIZE, bool)
    wanted[4:8, 4:12] = True
    frame = next(iter(opened(tmp_path, content)))
    np.testing.assert_array_equal(frame.detections.masks, [wanted])
    record = content["images" if "images" in content else "videos"][0]
    for wrong in ({"height": width}, {"height": 1 << 16, "width": 1 << 16}):
        record.update(wrong)
        with pytest.raises(SourceError, match=r"width x height|65536x65536"):
            list(opened(tmp_path, content))


def test_frames_one_per_line(tmp_path):
    lines = [
        {"name": "00003.png", "detections": [{"label": "cup", "bbox": [1, 2, 3, 4], "score": 0.5}]},
        {"frame": 4, "detections": [{"label": "tv", "segmentation": RLE, "instance_id": 6}]},
    ]
    frames = list(opened(tmp_path, "\n".join(map(json.dumps, lines)), suffix=".jsonl"))
    assert seen(frames) == [(("cup",), [0.5]), (("tv",), [1.0])]
    assert frames[0].detections.masks[0, 2:6, 1:4].all()
    assert np.asarray(frames[0].detections.masks).sum() == 12
    assert frames[1].detections.instance_ids.tolist() == [6]


@pytest.mark.parametrize(
    ("numbers", "sampling", "told"),
    [
        (range(4), Sampling(stride=3), ("2 of 4", "2 of 4")),
        (range(1, 13), None, ("1 of 12", "1 of 12")),
        (range(14), None, ("2 of 14", "0 of 12")),
        (range(12), Sampling(stride=3), None),
        (range(12), Sampling(end=5), None),
        ((0, 5), None, None),
    ],
    ids=["processed frames", "from one", "beyond the end", "of the source", "a part", "some"],
)
def test_detections_of_no_frame_are_counted_and_told(tmp_path, numbers, sampling, told):
    making.write_video(tmp_path / "a.mp4", 12)
    content = [{"frame": number, "detections": []} for number in numbers]
    (tmp_path / "d.json").write_text(json.dumps(content))
    source = open_source(tmp_path / "a.mp4", masks=tmp_path / "d.json", sampling=sampling)
    for _ in range(2):
        assert sum(1 for _ in source) > 0
        assert len(source.notes) == bool(told)
        if told:
            unused, lacking = told
            said = f"{unused} frames belong to no frame that was processed, and {lacking} processed"
            assert said in source.notes[0]


@pytest.mark.parametrize("form", ["tracks", "results", "images"])
def test_of_several_videos_one_is_taken_by_its_folder_or_none(tmp_path, form):
    names = ["00003.png", "00004.png"]
    videos = [{"id": n, "file_names": [f"{n}/{name}" for name in names]} for n in "vw"]
    tracks = [{"id": 1, "video_id": n, "label": n, "segmentations": [RLE, None]} for n in "vw"]
    images = [{"id": f"{n}{name}", "file_name": f"x/{n}/{name}"} for n in "vw" for name in names]
    boxes = [{"image_id": f"{n}00003.png", "label": n, "bbox": [1, 2, 3, 4]} for n in "vw"]
    content = {
        "tracks": {"videos": videos, "annotations": tracks},
        "results": tracks,
        "images": {"images": images, "annotations": boxes},
    }[form]
    if form != "results":
        assert seen(opened(tmp_path, content)) == [(("v",), [1.0]), ((), [])]
    with pytest.raises(SourceError, match="one video"):
        opened(tmp_path, content, name="other")


GOOD = {"image_id": 3, "label": "a", "segmentation": RLE}
BAD_ROWS = {
    "code": {"segmentation": {"size": [4, 6], "counts": "9"}},
    "huge code": {"segmentation": {"size": [60000, 60000], "counts": "PPkjmn3"}},
    "plain runs": {"segmentation": {"size": [4, 6], "counts": [25]}},
    "negative run": {"segmentation": {"size": [4, 6], "counts": [-1, 25]}},
    "far away": {"segmentation": [[0, 0, 1e9, 0, 5, 5]]},
    "odd polygon": {"segmentation": [[0, 0, 1, 1, 2, 2, 3]]},
    "long outline": {"segmentation": [[0, 0, 1e5, 1e5] * 100]},
    "short polygon": {"segmentation": [[0, 0, 1, 1]]},
    "score": {"score": 1.5},
    "score as text": {"score": "high"},
    "class": {"category_id": "cup"},
    "label": {"label": "x" * 201},
    "empty label": {"label": ""},
    "no mask": {"segmentation": None},
    "negative box": {"segmentation": None, "bbox": [1, 2, -3, 4]},
    "short box": {"segmentation": None, "bbox": [1, 2]},
    "no image": {"image_id": None},
    "other size": {"segmentation": making.run_lengths(np.ones((30, 7), bool))},
}


def test_a_bad_row_is_left_out_counted_and_told(tmp_path):
    for name, bad in BAD_ROWS.items():
        source = opened(tmp_path, [GOOD, {**GOOD, **bad}, GOOD])
        for _ in range(2):  # sources are iterated more than once
            assert seen(source) == [(("a", "a"), [1.0, 1.0]), ((), [])], name
        (note,) = source.notes
        assert note.startswith(f"1 of 3 detections of '{tmp_path / 'd.json'}'"), name
        with pytest.raises(SourceError):
            list(opened(tmp_path, [{**GOOD, **bad}]))


def test_rows_that_are_no_json_are_refused(tmp_path):
    for text in ("NaN", "-Infinity", '"\\ud800"', "[" * 500 + "]" * 500, "1e400"):
        row = json.dumps({**GOOD, "score": 7}).replace("7}", f"{text}}}")
        with pytest.raises(SourceError, match=r"d\.json"):
            opened(tmp_path, f"[{row}]")


def test_bad_masks_of_a_video_are_left_out_alone(tmp_path):
    tracks = [{"id": 9, "video_id": 1, "label": "tv", "segmentations": [RLE, {"size": [1]}]}]
    source = opened(tmp_path, {"videos": [{"id": 1}], "annotations": tracks})
    assert seen(source) == [(("tv",), [1.0]), ((), [])]
    assert "1 of 2 detections" in source.notes[0]


def test_files_that_are_no_detections_of_these_frames_are_refused(tmp_path):
    named = {"annotations": [GOOD], "categories": [{"id": 1, "name": n} for n in "ab"]}
    other = [{"image_id": 3, "category_id": 8, "segmentation": RLE}]
    for content in (
        [{"frame": 3, "detections": []}, {"frame": 3, "detections": []}],
        [{"detections": [{"label": "a", "bbox": [0, 0, 1, 1]}]}],
        named,
        {"annotations": {}},
        {"annotations": [GOOD], "images": [{"file_name": "a"}]},
        "{",
        {"a": 1},
        [1, 2],
        [{"category_id": 1}],
        [{"image_id": 77, "category_id": 1, "segmentation": RLE}],
        {"annotations": other, "categories": CATEGORIES},
    ):
        with pytest.raises(SourceError, match=r"d\.json"):
            opened(tmp_path, content)
    with pytest.raises(SourceError, match="record of a run, not masks"):
        opened(tmp_path, [{"format": "remind-jax run", "info": {}}])


def test_categories():
    assert read_categories(b'{"categories": [{"id": 4, "name": "a"}]}', "c") == {4: "a"}
    assert read_categories(b'{"0": "a", "7": "b"}', "c") == {0: "a", 7: "b"}
    assert read_categories(b'["a", "b"]', "c") == {0: "a", 1: "b"}
    with pytest.raises(SourceError, match="names of categories"):
        read_categories(b'{"x": "a"}', "c")
