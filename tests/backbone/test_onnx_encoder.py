"""Exported encoders: the patch output is recognized by its shape, on real runs of tiny networks."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from remind_jax.backbone import get_backbone
from remind_jax.backbone.onnx_encoder import PatchOutput, recognize
from remind_jax.errors import ConfigError, WeightsError
from tests.detectors import onnx_bytes
from tests.detectors.onnx_bytes import model, node, number, text, varint, write_fixed_answer

pytest.importorskip("onnxruntime")

RNG = np.random.default_rng(0)
KERNEL = RNG.normal(size=(5, 3, 16, 16)).astype(np.float32)
IMAGES = RNG.integers(0, 256, (2, 48, 80, 3), np.uint8)
OPEN = ("b", 3, "h", "w")
MEAN, STD = np.array([0.485, 0.456, 0.406]), np.array([0.229, 0.224, 0.225])


def ints(name: str, values: list[int]) -> bytes:
    """An attribute of a node."""
    packed = b"".join(varint(value) for value in values)
    return text(5, text(1, name) + text(8, packed) + bytes([0xA0, 0x01, 7]))


def write_encoder(path, kind: str, inputs=OPEN):
    """A convolution over patches, as a grid or as tokens behind two others."""
    nodes = [node("Conv", ["image", "kernel"], "grid") + ints("strides", [16, 16])]
    constants = {"kernel": KERNEL}
    outputs = {"grid": ("b", 5, "y", "x")}
    if kind != "grid":
        constants |= {"shape": np.array([0, 5, -1]), "prefix": np.zeros((1, 2, 5), np.float32)}
        nodes += [
            node("Reshape", ["grid", "shape"], "flat"),
            node("Transpose", ["flat"], "patches") + ints("perm", [0, 2, 1]),
            node("Concat", ["prefix", "patches"], "tokens") + axis(1),
            node("ReduceMean", ["tokens"], "pooled") + ints("axes", [1]),
        ]
        outputs = {"pooled": ("b", 1, 5), "tokens": ("b", "t", 5)}
    if kind == "both":
        outputs |= {"grid": ("b", 5, "y", "x")}
    path.write_bytes(model(nodes, {"image": inputs}, outputs, constants))
    return path


def axis(value: int) -> bytes:
    return text(5, text(1, "axis") + bytes([0x18, value]) + bytes([0xA0, 0x01, 2]))


def expected() -> np.ndarray:
    pixels = (IMAGES / 255 - MEAN) / STD
    cells = pixels.reshape(2, 3, 16, 5, 16, 3)
    return np.einsum("nyixjc,dcij->nyxd", cells, KERNEL)


@pytest.mark.parametrize("kind", ["grid", "tokens"])
def test_grids_and_tokens_are_recognized_and_read(tmp_path, kind):
    backbone = get_backbone(f"onnx:{write_encoder(tmp_path / 'tiny.onnx', kind)}")
    assert (backbone.patch_px, backbone.dim) == (16, 5)
    assert backbone.name.startswith("onnx-tiny-")
    # Sums of 768 products in float32.
    np.testing.assert_allclose(backbone.extract(IMAGES), expected(), rtol=0, atol=1e-3)


def test_weights_in_a_file_beside_it_are_part_of_what_it_is(tmp_path, monkeypatch):
    """As `onnx.save(..., save_as_external_data=True)` writes them."""

    def apart(name, array):
        sizes = b"".join(number(1, size) for size in array.shape)
        place = text(13, text(1, "location") + text(2, "tiny.onnx.data")) + number(14, 1)
        return sizes + number(2, 1) + text(8, name) + place

    monkeypatch.setattr(onnx_bytes, "constant", apart)
    path, made = write_encoder(tmp_path / "tiny.onnx", "grid"), []
    for kernel in (KERNEL, 2 * KERNEL):
        (tmp_path / "tiny.onnx.data").write_bytes(kernel.tobytes())
        made.append(get_backbone(f"onnx:{path}"))
    # Sums of 768 products in float32.
    np.testing.assert_allclose(made[0].extract(IMAGES), expected(), rtol=0, atol=1e-3)
    assert made[0].name != made[1].name
    assert made[0].fingerprint != made[1].fingerprint


def test_of_several_outputs_those_meant_have_to_be_named(tmp_path):
    path = write_encoder(tmp_path / "tiny.onnx", "both")
    several = r"several outputs of patches, 'tokens' \(16 pixels\), 'grid' .* 'onnx:.*#tokens'"
    with pytest.raises(ConfigError, match=several):
        get_backbone(f"onnx:{path}")
    for named in (get_backbone(f"onnx:{path}#tokens"), get_backbone(f"onnx:{path}#grid")):
        np.testing.assert_allclose(named.extract(IMAGES), expected(), rtol=0, atol=1e-3)
    both = get_backbone(f"onnx:{path}#tokens,grid")
    assert both.dim == 10
    twice = np.concatenate([expected()] * 2, axis=-1)
    np.testing.assert_allclose(both.extract(IMAGES), twice, rtol=0, atol=1e-3)
    assert both.fingerprint != named.fingerprint
    with pytest.raises(ConfigError, match="has no output 'patches'; its outputs are pooled"):
        get_backbone(f"onnx:{path}#patches")
    with pytest.raises(WeightsError, match="not every one of the outputs 'tokens,pooled'"):
        get_backbone(f"onnx:{path}#tokens,pooled")


def test_a_frame_of_the_fixed_size_is_seen_as_it_is(tmp_path):
    path = write_encoder(tmp_path / "tiny.onnx", "grid", (1, 3, 48, 80))
    backbone = get_backbone(f"onnx:{path}")
    np.testing.assert_allclose(backbone.extract(IMAGES), expected(), rtol=0, atol=1e-3)


@pytest.mark.parametrize("side", [64, 128, 256])
@pytest.mark.parametrize("size", [(96, 128), (128, 96), (160, 160)])
def test_frames_of_other_sizes_are_scaled_and_tokens_mapped_back(tmp_path, side, size):
    """A frame of four even quarters: away from their borders, each has its color's features."""
    path = write_encoder(tmp_path / "tiny.onnx", "grid", (1, 3, side, side))
    backbone = get_backbone(f"onnx:{path}")
    colors = RNG.integers(0, 256, (2, 2, 3), np.uint8)
    halves = [np.repeat(np.arange(2), side // 2) for side in size]
    frame = colors[halves[0][:, None], halves[1][None]]
    found = np.asarray(backbone.extract(frame[None])[0])
    assert found.shape == (size[0] // 16, size[1] // 16, 5)
    even = np.broadcast_to(colors[:, :, None, None], (2, 2, 16, 16, 3))
    features = np.einsum("abijc,dcij->abd", (even / 255 - MEAN) / STD, KERNEL)
    corners = found[[[0, 0], [-1, -1]], [[0, -1], [0, -1]]]
    # A quarter of the smallest input is one and a half tokens high.
    reach = np.abs(features).max() * (0.4 if side == 64 else 0.02)
    np.testing.assert_allclose(corners, features, rtol=0, atol=reach)


@pytest.mark.parametrize("inputs", [OPEN, (1, 3, 48, 80)])
def test_files_in_the_format_of_onnxruntime(tmp_path, inputs):
    import onnxruntime

    path = write_encoder(tmp_path / "tiny.onnx", "grid", inputs)
    options = onnxruntime.SessionOptions()
    options.optimized_model_filepath = str(tmp_path / "tiny.ort")
    options.add_session_config_entry("session.save_model_format", "ORT")
    onnxruntime.InferenceSession(str(path), options, providers=["CPUExecutionProvider"])
    backbone = get_backbone(f"onnx:{tmp_path / 'tiny.ort'}")
    assert (backbone.patch_px, backbone.dim) == (16, 5)
    np.testing.assert_allclose(backbone.extract(IMAGES), expected(), rtol=0, atol=1e-3)
    (tmp_path / "cut.ort").write_bytes((tmp_path / "tiny.ort").read_bytes()[:200])
    with pytest.raises(WeightsError, match="onnxruntime cannot load"):
        get_backbone(f"onnx:{tmp_path / 'cut.ort'}")
    with pytest.raises(WeightsError, match="does not exist"):
        get_backbone(f"onnx:{tmp_path / 'missing.ort'}")


def test_output_that_does_not_follow_the_image(tmp_path):
    path = write_fixed_answer(tmp_path / "a.onnx", {"out": np.zeros((1, 8, 14, 28))}, OPEN)
    backbone = get_backbone(f"onnx:{path}")
    with pytest.raises(WeightsError, match=r"shape \[1, 8, 14, 28\] instead of \[1, 8, 3, 5\]"):
        backbone.extract(IMAGES)


@given(
    st.sampled_from([7, 8, 14, 16, 28, 32]),
    st.integers(1, 2000),
    st.integers(0, 9),
    st.sampled_from(["channels first", "channels last", "tokens"]),
)
def test_every_common_layout_is_recognized(side, dim, num_prefix, kind):
    rows, columns = 224 // side, 448 // side
    shape = {
        "channels first": (1, dim, rows, columns),
        "channels last": (1, rows, columns, dim),
        "tokens": (1, num_prefix + rows * columns, dim),
    }[kind]
    found = recognize("out", shape, (224, 448))
    prefix = num_prefix if kind == "tokens" else 0
    if kind == "channels last" and dim == 2 * columns:
        return  # its last two axes are a grid as well
    assert found == PatchOutput("out", kind, side, dim, prefix)


@pytest.mark.parametrize("shape", [(1, 768), (2, 3, 14, 28), (1, 90, 384), (1, 3, 5, 7)])
def test_what_is_no_patch_output(shape):
    assert recognize("out", shape, (224, 448)) is None
