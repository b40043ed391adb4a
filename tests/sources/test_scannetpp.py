import json

import numpy as np
import pytest

from remind_jax.errors import SourceError
from remind_jax.sources import open_source
from remind_jax.sources.scannetpp import scene_name
from tests.sources import making

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


def write(place, files, kind):
    if kind == "folder":
        for name, data in files.items():
            (place / name).parent.mkdir(parents=True, exist_ok=True)
            (place / name).write_bytes(data)
        return place
    path = place.with_name(place.name + ".tar" + (".gz" if kind == "tar.gz" else ""))
    path.parent.mkdir(parents=True, exist_ok=True)
    wrapped = {f"{place.name}/{n}": d for n, d in files.items()}
    making.write_tar(
        path, files if kind == "flat tar" else wrapped, "w:gz" if "gz" in kind else "w"
    )
    return path


def seen(source):
    return [(f.name, f.detections.labels) for f in source]


WANTED = [(n, ("chair", "office lamp") if i != 1 else ()) for i, n in enumerate(NAMES)]


@pytest.mark.parametrize("kind", ["folder", "tar", "flat tar", "tar.gz"])
def test_images_and_annotations_in_one_place(tmp_path, kind):
    path = write(tmp_path / "0a1b2c3d4e", IMAGES | exported(), kind)
    before = sorted(tmp_path.rglob("*"))
    source = open_source(path)
    assert source.name == "0a1b2c3d4e"
    assert seen(source) == WANTED
    assert seen(source) == WANTED, "a second pass reads again"
    assert sorted(tmp_path.rglob("*")) == before, "nothing is unpacked"


@pytest.mark.parametrize("kind", ["folder", "tar"])
@pytest.mark.parametrize("root", ["annotations", "2Dmasks"])
def test_annotations_kept_apart_are_found(tmp_path, kind, root):
    data = write(tmp_path / "data" / "scene1", IMAGES, kind)
    masks = write(tmp_path / root / "scene1", exported(), kind)
    assert seen(open_source(data)) == WANTED
    assert seen(open_source(data, masks=masks)) == WANTED


def test_listed_frames_give_the_order(tmp_path):
    listed = [NAMES[2], NAMES[0], NAMES[1]]
    path = write(tmp_path / "s", IMAGES | exported(frame_names=listed), "tar")
    assert [name for name, _ in seen(open_source(path))] == listed
    assert [bool(labels) for _, labels in seen(open_source(path))] == [True, False, True]


def test_variants(tmp_path):
    files = IMAGES | exported("raw", ids=(2,)) | exported()
    path = write(tmp_path / "s", files, "folder")
    assert seen(open_source(path))[0][1] == ("chair", "office lamp")
    assert seen(open_source(path, mask_variant="benchmark"))[0][1] == ("chair", "office lamp")
    assert seen(open_source(path, mask_variant="raw"))[0][1] == ("office lamp",)
    with pytest.raises(SourceError, match="no masks 'row'; did you mean 'raw'"):
        open_source(path, mask_variant="row")


def test_unlabelled_instances(tmp_path):
    path = write(tmp_path / "s", IMAGES | exported(ids=(1, 7)), "tar")
    with pytest.raises(SourceError, match=r"instances 7 in .*meta_benchmark_instance\.json"):
        open_source(path)
    assert seen(open_source(path, unlabelled="skip"))[0][1] == ("chair",)


def test_rendered_ids_with_labels_of_the_scan(tmp_path):
    groups = {"segGroups": [{"objectId": 1, "label": "chair"}, {"objectId": 2, "label": "lamp"}]}
    files = {"scans/segments_anno.json": json.dumps(groups).encode()} | {
        f"obj_ids/{name}.png": making.gray_png(making.instance_map().astype(np.uint16))
        for name in NAMES
    }
    path = write(tmp_path / "s", IMAGES | files, "tar")
    assert seen(open_source(path)) == [(n, ("chair", "lamp")) for n in NAMES]


def test_images_can_be_chosen(tmp_path):
    phone = {f"iphone/rgb/frame_{i:06d}.jpg": making.jpg(i) for i in (0, 10)}
    path = write(tmp_path / "s", IMAGES | phone, "tar")
    assert len(list(open_source(path))) == 3
    assert [f.name for f in open_source(path, images="iphone/rgb")] == list(
        f"frame_{i:06d}.jpg" for i in (0, 10)
    )
    with pytest.raises(SourceError, match="did you mean 'iphone/rgb'"):
        open_source(path, images="iphon/rgb")


@pytest.mark.parametrize("kind", ["folder", "tar", "tar.gz"])
def test_video_of_a_scene_is_read_in_place(tmp_path, kind):
    making.write_video(tmp_path / "rgb.mkv", 6)
    path = write(tmp_path / "s", {"iphone/rgb.mkv": (tmp_path / "rgb.mkv").read_bytes()}, kind)
    source = open_source(path)
    assert [f.source_index for f in source] == list(range(6))
    assert source.name == "s"


def test_images_only(tmp_path):
    path = write(tmp_path / "s", IMAGES, "tar")
    assert [f.detections for f in open_source(path)] == [None] * 3


def test_scene_name(tmp_path):
    assert scene_name(tmp_path / "a.tar.gz") == "a"
    assert scene_name(tmp_path / "a.tar") == "a"
    assert scene_name(tmp_path / "a.b") == "a.b"
