"""From scenes to a profile that runs find, in bounded memory, or a sentence why not."""

import dataclasses
import json

import jax.numpy as jnp
import numpy as np
import pytest

import remind_jax as rj
from remind_jax.backbone.registry import Backbone, get_backbone
from remind_jax.calibration.calibrate import ENDS, start_for
from remind_jax.calibration.reading import read_scene
from remind_jax.config import load_config, profiles
from remind_jax.errors import ConfigError, SourceError
from remind_jax.frame import Detections, Frame

SIZE, PATCH = 96, 16
COLORS = Backbone("colors", PATCH, 8, lambda images: _colors(images), fingerprint="v1")


def _colors(images):
    """Means of the halves of each patch by channel, beside numbers that never change."""
    images = np.asarray(images, np.float32) / 255
    batch, height, width, _ = images.shape
    grid = images.reshape(batch, height // PATCH, PATCH, width // PATCH, 2, PATCH // 2, 3)
    halves = grid.mean(axis=(2, 5)).reshape(batch, height // PATCH, width // PATCH, 6)
    return jnp.asarray(np.concatenate([halves, np.full((*halves.shape[:3], 2), 0.5)], axis=-1))


def frames(num=40, objects=3):
    """Colored squares that drift over noise, side by side."""
    rng = np.random.default_rng(0)
    paint = rng.integers(0, 255, (objects, 3))
    for index in range(num):
        image = rng.integers(90, 160, (SIZE, SIZE, 3)).astype(np.uint8)
        masks = np.zeros((objects, SIZE, SIZE), bool)
        for one in range(objects):
            top, left = 30 * one + 2, 4 + index % 24
            masks[one, top : top + 28, left : left + 40] = True
            shade = 1 - 0.4 * index / num
            image[masks[one]] = np.clip(paint[one] * shade + rng.normal(0, 12, (1, 3)), 0, 255)
        yield Frame(index, index, index / 10, str(index), image, Detections.create(masks))


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    monkeypatch.setenv(profiles.VARIABLE, str(tmp_path / "profiles"))
    return tmp_path / "profiles"


@pytest.fixture(scope="module")
def found(tmp_path_factory):
    out = tmp_path_factory.mktemp("made") / "colors.yaml"
    return rj.calibrate([list(frames())], backbone=COLORS, out=out)


def test_a_profile_is_found_by_runs_with_these_features_only(found, folder):
    kept = found.save()
    assert kept.path.parent == folder / "remind"
    remind = load_config("remind")
    used = remind.for_backbone(*COLORS.identity)
    assert used.profile == found.made_for.name
    assert used.thresholds == found.to_config().thresholds
    assert used.thresholds.matching.match == found.thresholds["matching.match"]
    assert used.for_backbone(*COLORS.identity) == used
    assert remind.for_backbone("colors", "v2") == remind
    assert load_config("published").for_backbone(*COLORS.identity) == load_config("published")
    mine = load_config({"base": "remind", "matching.match": 0.33}).for_backbone(*COLORS.identity)
    assert mine.thresholds.matching.match == 0.33
    assert mine.thresholds.appearance == used.thresholds.appearance


def test_a_run_uses_it_and_says_so(found, folder, tmp_path, monkeypatch):
    """The step of the method is not needed for that."""

    def stop(self, prepared):
        raise SourceError("enough")

    found.save()
    monkeypatch.setattr(rj.Tracker, "advance", stop)
    with pytest.raises(SourceError, match="enough"):
        rj.run(list(frames(2)), config="remind", backbone=COLORS, out=tmp_path / "run")
    told = json.loads((tmp_path / "run" / "run.json").read_text())["info"]["config"]
    assert told["profile"] == found.made_for.name
    assert told["thresholds"]["matching"]["match"] == found.thresholds["matching.match"]


def test_the_same_scenes_give_the_same_profile(found, tmp_path):
    again = rj.calibrate([list(frames())], backbone=COLORS, out=tmp_path / "again.yaml")
    assert again.path is not None
    assert again.path.read_bytes() == found.path.read_bytes()
    assert found.made_for.evidence == ENDS


def test_the_reference_features_keep_the_shipped_profile():
    found = rj.calibrate([list(frames())])
    shipped = load_config("remind").for_backbone("patch-statistics").thresholds
    assert found.to_config().thresholds == shipped


def test_a_detector_takes_the_place_of_masks(found, tmp_path):
    given = list(frames())
    by_image = {np.asarray(one.image).tobytes(): one.detections for one in given}
    bare = [dataclasses.replace(one, detections=None) for one in given]
    with pytest.raises(SourceError, match="mask"):
        rj.calibrate([bare], backbone=COLORS, out=tmp_path / "none.yaml")
    seen = rj.calibrate(
        [bare],
        backbone=COLORS,
        detector=lambda image: by_image[image.tobytes()],
        out=tmp_path / "seen.yaml",
    )
    assert seen.thresholds == found.thresholds
    nothing = np.zeros((0, SIZE, SIZE), bool)
    with pytest.raises(SourceError, match="give scenes where it finds some"):
        rj.calibrate([bare], backbone=COLORS, detector=lambda image: nothing)


def test_other_features_start_with_the_published_weight_of_the_background():
    shipped = load_config("remind").for_backbone("patch-statistics")
    assert start_for(get_backbone("patch-statistics")) == shipped
    changed = start_for(COLORS).difference(shipped)
    assert [(key, value) for key, value, _ in changed] == [
        ("thresholds.similarity.background_weight", 0.25)
    ]


def test_a_profile_of_other_features_is_refused(found):
    config = load_config(str(found.path))
    with pytest.raises(ConfigError, match=r"a profile of colors-.*are those of patch-statistics-"):
        rj.Tracker(config).update(next(frames(1)))


def test_a_profile_in_the_place_of_another_is_refused(found, folder):
    path = profiles.place_profile("remind", "other", "v1")
    path.parent.mkdir(parents=True)
    path.write_bytes(found.path.read_bytes())
    with pytest.raises(ConfigError, match=r"a profile of colors-.*, not of other-"):
        load_config("remind").for_backbone("other", "v1")


def test_too_few_comparisons_are_refused():
    with pytest.raises(SourceError, match="0 of objects seen together, and 30 of each are needed"):
        rj.calibrate([list(frames(objects=1))], backbone=COLORS)


def test_scenes_that_say_nothing_are_refused():
    with pytest.raises(SourceError, match="no scenes to calibrate on"):
        rj.calibrate([], backbone=COLORS)
    bare = [dataclasses.replace(one, image=None, features=np.ones((6, 6, 4), np.float32))
            for one in frames(2)]  # fmt: skip
    with pytest.raises(SourceError, match="has no images"):
        rj.calibrate([bare], backbone=COLORS)


def test_long_scenes_are_thinned_out_but_linked_frame_by_frame():
    source = rj.open_source(list(frames(16)))
    config = load_config("remind").for_backbone("patch-statistics")
    both = (get_backbone("patch-statistics"), COLORS)
    whole = read_scene(source, config, both)
    size = sum(views.num_bytes for views in whole.views)
    thin = read_scene(source, config, both, most_bytes=size // 2)
    assert sorted(set(thin.tracklets.frame)) == list(range(0, 16, 2))
    assert set(thin.tracklets.track) == set(whole.tracklets.track) == {0, 1, 2}
    assert sum(views.num_bytes for views in thin.views) == size // 2
