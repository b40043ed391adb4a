import json

import numpy as np
import pytest

from remind_jax.errors import SourceError
from remind_jax.sources import open_source
from tests.sources import making
from tests.sources.making import write_files

NAMES = ["DSC00001.JPG", "DSC00002.JPG", "DSC00007.JPG"]
IMAGES = {f"dslr/resized_images/{n}": making.jpg(i) for i, n in enumerate(NAMES)}


def exported(variant="benchmark_instance", frame_names=None, ids=(1, 2)):
    """The export of the original: masks numbered by the place of the frame."""
    meta = {"id_to_label": {"1": "chair_1", "2": "office lamp_2"}}
    if frame_names:
        meta["frame_names"] = frame_names
    files = {f"meta_{variant}.json": json.dumps(meta).encode()}
    for i in range(len(NAMES)):
        labels = making.instance_map(ids=ids) * (i != 1)
        files[f"annotations/{variant}/frame_{i:06d}.png"] = making.gray_png(labels)
    return files


def seen(source):
    return [(f.name, f.detections.labels) for f in source]


WANTED = [(n, ("chair", "office lamp") if i != 1 else ()) for i, n in enumerate(NAMES)]


def test_images_and_annotations_in_one_place(tmp_path):
    path = write_files(tmp_path / "0a1b2c3d4e", IMAGES | exported())
    source = open_source(path)
    assert source.name == "0a1b2c3d4e"
    assert seen(source) == WANTED
    assert seen(source) == WANTED, "a second pass reads again"


@pytest.mark.parametrize("root", ["annotations", "2Dmasks"])
def test_annotations_kept_apart_are_found(tmp_path, root):
    data = write_files(tmp_path / "data" / "scene1", IMAGES)
    masks = write_files(tmp_path / root / "scene1", exported())
    assert seen(open_source(data)) == WANTED
    assert seen(open_source(data, masks=masks)) == WANTED


def test_listed_frames_give_the_order(tmp_path):
    listed = [NAMES[2], NAMES[0], NAMES[1]]
    path = write_files(tmp_path / "s", IMAGES | exported(frame_names=listed))
    assert [name for name, _ in seen(open_source(path))] == listed
    assert [bool(labels) for _, labels in seen(open_source(path))] == [True, False, True]


def test_the_preferred_masks_are_taken(tmp_path):
    path = write_files(tmp_path / "s", IMAGES | exported("raw", ids=(2,)) | exported())
    assert seen(open_source(path))[0][1] == ("chair", "office lamp")
    path = write_files(tmp_path / "t", IMAGES | exported("one") | exported("two"))
    with pytest.raises(SourceError, match=r"several kinds of masks \(one, two\); leave one"):
        open_source(path)


def test_rendered_ids_with_labels_of_the_scan(tmp_path):
    groups = {"segGroups": [{"objectId": 1, "label": "chair"}, {"objectId": 2, "label": "lamp"}]}
    files = {"scans/segments_anno.json": json.dumps(groups).encode()} | {
        f"obj_ids/{name}.png": making.gray_png(making.instance_map().astype(np.uint16))
        for name in NAMES
    }
    path = write_files(tmp_path / "s", IMAGES | files)
    assert seen(open_source(path)) == [(n, ("chair", "lamp")) for n in NAMES]


def test_images_of_the_first_kind_are_taken(tmp_path):
    phone = {f"iphone/rgb/frame_{i:06d}.jpg": making.jpg(i) for i in (0, 10)}
    path = write_files(tmp_path / "s", IMAGES | phone)
    assert len(list(open_source(path))) == 3
    assert len(list(open_source(path / "iphone" / "rgb"))) == 2


def test_video_of_a_scene(tmp_path):
    making.write_video(tmp_path / "rgb.mkv", 6)
    path = write_files(tmp_path / "s", {"iphone/rgb.mkv": (tmp_path / "rgb.mkv").read_bytes()})
    source = open_source(path)
    assert [f.source_index for f in source] == list(range(6))
    assert source.name == "s"
