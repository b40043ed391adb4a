import json
import os
from typing import Any

import numpy as np
import pytest

from remind_jax.errors import SourceError
from remind_jax.sources import open_source
from tests.sources import making

FEATURES = np.arange(3 * 2 * 3 * 4, dtype=np.float32).reshape(3, 2, 3, 4)
MAPS = np.stack([making.instance_map()] * 3)


def test_a_file_that_is_cut_short_while_it_is_read_ends_no_process(tmp_path):
    """Beyond its end, what is mapped of a file ends the process that looks."""
    large = np.zeros((4, 64, 64, 4), np.float32)
    np.save(tmp_path / "f.npy", large)
    source = open_source(tmp_path / "f.npy")
    frames = iter(source)
    next(frames)
    os.truncate(tmp_path / "f.npy", 4096)
    assert list(frames) == []
    assert [skipped.name for skipped in source.skipped] == ["000001", "000002", "000003"]
    assert source.skipped[0].reason.startswith("its file was cut short while it was read")


def test_maps_that_are_cut_short_while_they_are_read(tmp_path):
    images = [making.picture(index) for index in range(3)]
    np.save(tmp_path / "m.npy", MAPS.astype(np.int64))
    assert MAPS[0].nbytes * 8 > 4096
    source = open_source(images, masks=tmp_path / "m.npy")
    frames = iter(source)
    assert len(next(frames).detections) == 2
    os.truncate(tmp_path / "m.npy", 4096)
    assert list(frames) == []
    assert len(source.skipped) == 2


def test_npz_with_everything(tmp_path):
    images = np.stack([making.picture(i) for i in range(3)])
    np.savez(
        tmp_path / "f.npz",
        features=FEATURES.astype(np.float16),
        masks=MAPS,
        ids=np.array([1, 2]),
        labels=np.array(["cup", "desk lamp"]),
        images=images,
        times_s=np.array([0.0, 0.5, 1.0]),
        names=np.array(["a", "b", "c"]),
    )
    source = open_source(tmp_path / "f.npz")
    frames = list(source)
    assert source.fps == 2.0
    assert [f.name for f in frames] == ["a", "b", "c"]
    assert [f.time_s for f in frames] == [0.0, 0.5, 1.0]
    for index, frame in enumerate(frames):
        assert frame.features is not None
        assert frame.features.dtype == np.float32
        np.testing.assert_array_equal(frame.image, images[index])
        assert frame.detections is not None
        assert frame.detections.labels == ("cup", "desk lamp")
        np.testing.assert_array_equal(frame.detections.masks[1], MAPS[0] == 2)


def test_classes_from_metadata(tmp_path):
    np.savez(tmp_path / "f.npz", features=FEATURES, masks=MAPS)
    (tmp_path / "m.json").write_text(json.dumps(making.LABELS))
    frame = next(iter(open_source(tmp_path / "f.npz", metadata=tmp_path / "m.json")))
    assert frame.detections is not None
    assert frame.detections.labels == ("cup", "desk_lamp")


@pytest.mark.parametrize("name", ["m.npy", "m.npz"])
def test_instance_maps_of_a_numpy_file_as_masks(tmp_path, name):
    making.write_images(tmp_path / "v", ["0.png", "1.png", "2.png"])
    if name == "m.npy":
        np.save(tmp_path / name, MAPS)
    else:
        np.savez(tmp_path / name, masks=MAPS, ids=np.array([1, 2]), labels=np.array(["object"] * 2))
    frames = list(open_source(tmp_path / "v", masks=tmp_path / name))
    assert [f.detections.labels for f in frames if f.detections] == [("object", "object")] * 3


def test_unlabelled_instances_can_be_skipped(tmp_path):
    named: dict[str, Any] = {"ids": np.array([2]), "labels": np.array(["cup"])}
    np.savez(tmp_path / "f.npz", features=FEATURES, masks=MAPS, **named)
    np.savez(tmp_path / "m.npz", masks=MAPS, **named)
    making.write_images(tmp_path / "v", ["0.png", "1.png", "2.png"])
    with pytest.raises(SourceError, match="instances 1 in"):
        open_source(tmp_path / "v", masks=tmp_path / "m.npz")
    for source in (
        open_source(tmp_path / "f.npz", unlabelled="skip"),
        open_source(tmp_path / "v", masks=tmp_path / "m.npz", unlabelled="skip"),
    ):
        assert [f.detections.labels for f in source if f.detections] == [("cup",)] * 3


def test_wrong_arrays_are_one_sentence(tmp_path):
    one = np.array([1])
    for arrays in (
        {"feature": FEATURES},
        {"masks": MAPS},
        {"features": FEATURES[0]},
        {"features": FEATURES.astype(int)},
        {"features": FEATURES, "masks": MAPS[:2]},
        {"features": FEATURES, "masks": MAPS, "ids": one},
        {"features": FEATURES, "masks": MAPS, "ids": one, "labels": np.array(["a"])},
        {"features": FEATURES, "times_s": np.array([0.0, 2.0, 1.0])},
        {"features": FEATURES, "times_s": np.array([0.0, np.nan, 1.0])},
        {"features": FEATURES, "names": np.array(["a", "", "c"])},
        {"features": FEATURES[:0]},
    ):
        np.savez(tmp_path / "f.npz", **arrays)
        with pytest.raises(SourceError, match=r"'f|f\.npz"):
            open_source(tmp_path / "f.npz")


def test_pickles_and_damaged_files_are_refused(tmp_path):
    objects = np.array([{"a": 1}], dtype=object)
    for name, save in (("f.npy", np.save), ("f.npz", np.savez)):
        (tmp_path / name).write_bytes(b"nothing")
        with pytest.raises(SourceError, match=name):
            open_source(tmp_path / name)
        save(tmp_path / name, objects)
        with pytest.raises(SourceError, match=name):
            open_source(tmp_path / name)


def test_a_header_of_impossible_sides_is_refused(tmp_path):
    """Found by the fuzzer: the length of the memory map would be negative."""
    np.save(tmp_path / "f.npy", np.zeros(200, "<f4"))
    data = (tmp_path / "f.npy").read_bytes()
    header = b"{'descr': '<U100000000', 'fortran_order': False, 'shape': (-1, 2), }"
    (tmp_path / "f.npy").write_bytes(data[:10] + header.ljust(117) + b"\n" + data[128:])
    with pytest.raises(SourceError, match=r"f\.npy"):
        open_source(tmp_path / "f.npy")
