"""From what a user says to a backbone."""

import dataclasses

import numpy as np
import pytest

from remind_jax.backbone import registry
from remind_jax.backbone.opening import open_backbone
from remind_jax.errors import ConfigError, OptionError, SourceError
from tests.backbone.networks import converted_file
from tests.cli.test_streams import run_python


@pytest.fixture
def names(monkeypatch):
    """A registry of its own, so that nothing stays behind."""
    monkeypatch.setattr(registry, "_factories", dict(registry._factories))


def make_backbone(*, dim: int = 3) -> registry.Backbone:
    return registry.Backbone("mean-color", 4, dim, lambda images: images[:, ::4, ::4] / 255)


def test_default_backbone_is_listed_and_made_by_default():
    assert registry.DEFAULT_BACKBONE in registry.list_backbones()
    assert registry.get_backbone() is registry.get_backbone("patch-statistics")


def test_listing_imports_no_backbone():
    code = (
        "import sys; from remind_jax.backbone import list_backbones; print(list_backbones());"
        "heavy = {'remind_jax.backbone.patch_statistics', 'flax', 'torch', 'onnxruntime'};"
        "sys.exit(', '.join(heavy & set(sys.modules)) or 0)"
    )
    done = run_python(code)
    assert done.returncode == 0, done.stderr
    assert "patch-statistics" in done.stdout


@pytest.mark.usefixtures("names")
def test_decorated_factory_is_found_and_gets_its_options():
    registry.register("mean-color")(make_backbone)
    assert "mean-color" in registry.list_backbones()
    assert registry.get_backbone("mean-color", dim=5).dim == 5


@pytest.mark.usefixtures("names")
def test_factory_can_be_named_and_is_imported_when_asked_for():
    registry.register("lazy", "a_module_that_is_not_there:factory")
    assert "lazy" in registry.list_backbones()
    with pytest.raises(ModuleNotFoundError, match="a_module_that_is_not_there"):
        registry.get_backbone("lazy")


@pytest.mark.usefixtures("names")
def test_text_after_the_colon_is_handed_to_the_factory():
    opened = []

    @registry.register("onnx-like")
    def open_file(path, *, threads=1):
        opened.append((path, threads))
        return make_backbone()

    registry.get_backbone("onnx-like:C:/dir/encoder.onnx", threads=2)
    assert opened == [("C:/dir/encoder.onnx", 2)]
    with pytest.raises(ConfigError, match="path"):
        registry.get_backbone("onnx-like")
    registry.register("forgetful", lambda: None)
    with pytest.raises(ConfigError, match="'forgetful' returns NoneType"):
        registry.get_backbone("forgetful")
    for sides in ({"patch_px": 0, "dim": 8}, {"patch_px": 16, "dim": 0}):
        with pytest.raises(OptionError, match="is 0; give a whole number from 1"):
            registry.Backbone("flat", apply=np.asarray, **sides)


@pytest.mark.parametrize("backbone", ["patch-statistics", make_backbone()])
def test_an_unknown_option_is_not_passed_over(backbone):
    """A misspelt option of a tracker arrives here."""
    with pytest.raises(ConfigError, match="'confg' is no option here"):
        registry.get_backbone(backbone, confg="remind")


@pytest.mark.usefixtures("names")
def test_a_name_belongs_to_one_backbone():
    for _ in range(2):
        registry.register("mean-color", make_backbone)
    with pytest.raises(ConfigError, match="registered already"):
        registry.register("patch-statistics")(make_backbone)
    with pytest.raises(ConfigError, match="without a colon"):
        registry.register("mean:color", make_backbone)


@pytest.mark.parametrize(
    ("shape", "dtype", "message"),
    [
        ((1, 3, 40, 3), np.uint8, r"40x3 pixels is smaller than one patch .* at least 4 pixels"),
        ((1, 8, 42, 3), np.uint8, r"42x8 pixels does not divide .* crop it to 40x8 first"),
        ((8, 8, 3), np.uint8, r"shape \(8, 8, 3\); give uint8 RGB images \[B, H, W, 3\]"),
        ((1, 8, 8, 1), np.uint8, r"shape \(1, 8, 8, 1\)"),
        ((1, 8, 8, 3), np.float32, "given float32 images"),
    ],
)
def test_unfit_images_are_refused(shape, dtype, message):
    with pytest.raises(SourceError, match=message):
        make_backbone().extract(np.zeros(shape, dtype))


@pytest.mark.parametrize("wrong", [lambda x: x[0], lambda x: x[:, :1], lambda x: x.astype(int)])
def test_unfit_features_are_refused(wrong):
    right = make_backbone()
    images, covered = np.zeros((2, 8, 8, 3), np.uint8), np.ones((2, 2, 2))

    def apply(images, *_):
        return wrong(np.asarray(right.apply(images)))

    broken = dataclasses.replace(right, apply=apply, apply_closeups=apply)
    for extract in (broken.extract, lambda one: broken.extract_closeups(one, None, covered)):
        with pytest.raises(ConfigError, match=r"gives .* are needed"):
            extract(images)
    narrow = dataclasses.replace(
        right, apply_closeups=lambda x, *_: right.apply(x), num_background=3
    )
    with pytest.raises(ConfigError, match=r"floats of shape \(2, 2, 2, 4\) are needed"):
        narrow.extract_closeups(images, None, covered)


def test_features_may_be_those_of_another_library():
    class Tensor:
        dtype = "tensor.float32"

        def __init__(self, values):
            self.values, self.shape = values, values.shape

        def __array__(self, *_, **__):
            return self.values

    right = make_backbone()
    images = np.arange(2 * 8 * 8 * 3, dtype=np.uint8).reshape(2, 8, 8, 3)
    other = dataclasses.replace(right, apply=lambda x: Tensor(np.asarray(right.apply(x))))
    np.testing.assert_array_equal(other.extract(images), right.extract(images))


def test_parts_of_a_backbone_are_checked():
    for name, wrong in (("fingerprint", 3), ("name", None), ("num_background", 9)):
        with pytest.raises(ConfigError, match=f"'{name}' is"):
            dataclasses.replace(make_backbone(), **{name: wrong})


def test_name_with_weights_and_cache(tmp_path):
    file, images = converted_file("dinov3_s16"), np.zeros((1, 32, 32, 3), np.uint8)
    backbone = open_backbone("dinov3-vits16", weights=file, feature_cache=tmp_path)
    expected = registry.get_backbone("dinov3-vits16", weights=file).extract(images)
    for _ in range(2):
        np.testing.assert_array_equal(backbone.extract(images), expected)
    assert backbone.name == "dinov3-vits16"
    assert len(list(tmp_path.rglob("*.npy"))) == 1


def test_finished_backbone():
    backbone = registry.get_backbone()
    assert open_backbone(backbone) is backbone
    with pytest.raises(ConfigError, match="beside the finished backbone 'patch-statistics'"):
        open_backbone(backbone, weights="a.safetensors")
