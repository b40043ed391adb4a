"""Published files become ours: every layout, every key, and every way of being wrong."""

import json
import os

import numpy as np
import pytest
from safetensors import safe_open
from safetensors.numpy import load_file, save_file

from remind_jax.backbone.vit_positions import rotary_periods
from remind_jax.backbone.vit_variants import VARIANTS, Variant
from remind_jax.backbone.vit_weights import load_weights
from remind_jax.errors import ConfigError, OutputError, WeightsError
from tests.golden.vit import load as golden
from tests.weights_convert.hugging_face import as_hugging_face
from tests.weights_convert.pth_files import write_pth
from weights_convert.conversion import convert
from weights_convert.variant_detection import Wishes


def tiny(stem: str = "dinov3_tiny_mlp") -> dict[str, np.ndarray]:
    return golden.load(stem).official()


@pytest.fixture
def conversion(tmp_path):
    """Converts tensors by way of a file; returns the leaves and the header of the result."""

    def run(tensors, stem="dinov3_tiny_mlp", name="source.safetensors", **wishes):
        source = tmp_path / name
        if name.endswith(".pth"):
            write_pth(source, tensors)
        else:
            save_file({k: np.ascontiguousarray(v) for k, v in tensors.items()}, source)
        network = golden.load(stem)
        known = Wishes(**{"heads": network.config["heads"], "custom": True} | wishes)
        out = tmp_path / "out.safetensors"
        done = convert(source, out, wishes=known, overwrite=True)
        assert list(tmp_path.glob("*.part")) == []
        with safe_open(out, "np") as file:
            return load_file(out), file.metadata(), done

    return run


def refusal(conversion, *args, **kwargs) -> str:
    with pytest.raises(WeightsError) as caught:
        conversion(*args, **kwargs)
    return str(caught.value)


def assert_same(found, expected, besides=()):
    assert found.keys() == expected.keys()
    for name in found.keys() - set(besides):
        np.testing.assert_array_equal(found[name], expected[name], err_msg=name)


@pytest.mark.parametrize("stem", golden.TINY)
def test_all_layouts_give_the_same_leaves(conversion, stem):
    network = golden.load(stem)
    official = network.official()
    expected, header, done = conversion(official, stem)
    assert header["source_layout"] == done.layout == "official .pth"
    pickled, _, _ = conversion({"model": official, "epoch": 3}, stem, "source.pth")
    assert_same(pickled, expected)
    published = as_hugging_face(official, network.config["family"])
    found, header, _ = conversion(published, stem)
    assert header["source_layout"].startswith("Hugging Face")
    assert_same(found, expected, besides=["periods"])
    if "periods" in found:
        # Hugging Face leaves them to be computed.
        np.testing.assert_array_equal(found["periods"], rotary_periods(32))


@pytest.mark.parametrize("prefix", ["module.", "backbone.", "teacher.backbone.", "model."])
def test_prefixes_of_wrappers(conversion, prefix):
    expected, _, _ = conversion(tiny())
    wrapped = {prefix + key: value for key, value in tiny().items()}
    wrapped |= {"module.head.weight": np.ones(3, np.float32)}
    found, _, done = conversion(wrapped)
    assert_same(found, expected)
    assert done.dropped == ("head.weight",)


def test_layouts_of_transformers_5_in_memory(conversion):
    expected, _, _ = conversion(tiny())
    published = as_hugging_face(tiny(), "dinov3")
    memory = {k.replace("layer.", "model.layer."): v for k, v in published.items()}
    assert_same(conversion(memory)[0], expected)

    stem = "dinov2_tiny_swiglu"
    expected, _, _ = conversion(tiny(stem), stem)
    memory = {}
    for key, value in as_hugging_face(tiny(stem), "dinov2").items():
        for old, new in (("query", "q"), ("key", "k"), ("value", "v")):
            key = key.replace(f"attention.attention.{old}", f"attention.{new}_proj")
        key = key.replace("attention.output.dense", "attention.o_proj")
        if "weights_in" in key:
            for name, half in zip(("gate_proj", "up_proj"), np.split(value, 2), strict=True):
                memory[key.replace("weights_in", name)] = half
        else:
            memory[key.replace("weights_out", "down_proj")] = value
    assert_same(conversion(memory, stem)[0], expected)


def test_teacher_is_taken_before_student(conversion):
    expected, _, _ = conversion(tiny())
    student = {key: value + 1 for key, value in tiny().items()}
    both = {"student": student, "teacher": tiny()}
    assert_same(conversion(both, name="source.pth")[0], expected)


def test_sharded_folder_with_configuration(tmp_path):
    published = as_hugging_face(tiny(), "dinov3")
    parts = {"model-1.safetensors": {}, "model-2.safetensors": {}}
    listed = {}
    for number, (key, value) in enumerate(published.items()):
        file = f"model-{1 + number % 2}.safetensors"
        parts[file][key], listed[key] = value, file
    folder = tmp_path / "hf"
    folder.mkdir()
    for file, tensors in parts.items():
        save_file(tensors, folder / file)
    index = folder / "model.safetensors.index.json"
    index.write_text(json.dumps({"weight_map": listed}))
    (folder / "config.json").write_text(json.dumps({"num_attention_heads": 2, "hidden_size": 64}))
    done = convert(folder, tmp_path / "out.safetensors", wishes=Wishes(custom=True))
    assert done.variant.heads == 2
    (folder / "config.json").write_text(json.dumps({"num_attention_heads": 2, "hidden_size": 65}))
    with pytest.raises(WeightsError, match="hidden_size 65, not 64"):
        convert(folder, tmp_path / "b.safetensors", wishes=Wishes(custom=True))
    with pytest.raises(WeightsError, match=r"one of several files of a network; give .*json"):
        convert(folder / "model-1.safetensors", tmp_path / "b.safetensors")
    (folder / "model-2.safetensors").unlink()
    with pytest.raises(WeightsError, match=r"lists 'model-2.safetensors', which is missing"):
        convert(folder, tmp_path / "b.safetensors", wishes=Wishes(custom=True))


def test_a_shard_gives_what_the_index_says_of_it_and_nothing_else(conversion, tmp_path):
    published = as_hugging_face(tiny(), "dinov3")
    expected, _, _ = conversion(published)
    old = {key: value + 1 for key, value in published.items()}
    folder = tmp_path / "hf"
    folder.mkdir()
    listed = dict.fromkeys(published, "a.safetensors") | {"norm.bias": "b.safetensors"}
    save_file(published | {"norm.bias": old["norm.bias"]}, folder / "a.safetensors")
    save_file(old | {"norm.bias": published["norm.bias"]}, folder / "b.safetensors")
    (folder / "x.safetensors.index.json").write_text(json.dumps({"weight_map": listed}))
    done = convert(folder, tmp_path / "b.safetensors", wishes=Wishes(heads=2, custom=True))
    assert_same(load_file(done.path), expected)


def test_folder_with_a_pickled_file(conversion, tmp_path):
    expected, _, _ = conversion(tiny())
    (tmp_path / "hf").mkdir()
    write_pth(tmp_path / "hf" / "pytorch_model.bin", tiny())
    done = convert(tmp_path / "hf", tmp_path / "b.safetensors", wishes=Wishes(heads=2, custom=True))
    assert_same(load_file(done.path), expected)


@pytest.mark.parametrize(
    ("file", "said", "told"),
    [
        ("config.json", {"hidden_act": "quick_gelu"}, "hidden_act"),
        ("config.json", {"layer_norm_eps": 0.0}, "norm_eps"),
        ("config.json", {"pretrained_cfg": {"std": [0.5, 0.5, 0.5]}}, "image_std"),  # of timm
        ("preprocessor_config.json", {"image_mean": [0.5, 0.5, 0.5]}, "image_mean"),
        ("preprocessor_config.json", {"do_normalize": False}, "do_normalize"),
        ("preprocessor_config.json", {"do_rescale": False}, "do_rescale"),
        ("preprocessor_config.json", {"rescale_factor": 0.00784}, "rescale_factor"),
        ("config.json", {"rope_parameters": {"rope_theta": 1e4}}, "rope_theta"),
    ],
)
def test_a_configuration_that_asks_for_something_else(conversion, tmp_path, file, said, told):
    (tmp_path / file).write_text(json.dumps(said))
    assert told in refusal(conversion, tiny())


def test_what_is_quantized_has_no_scale(conversion):
    whole = {key: np.round(100 * value).astype(np.int8) for key, value in tiny().items()}
    assert "quantized" in refusal(conversion, whole)


def test_heads_are_not_guessed(conversion):
    wide = tiny("dino_tiny") | {"cls_token": np.zeros((1, 1, 96), np.float32)}
    assert "give it with --heads" in refusal(conversion, wide, "dino_tiny", heads=None)


def test_a_network_of_its_own_has_the_norm_of_its_configuration(conversion, tmp_path):
    (tmp_path / "config.json").write_text(json.dumps({"layer_norm_eps": 1e-12}))
    assert conversion(tiny("dino_tiny"), "dino_tiny")[2].variant.norm_eps == 1e-12


class TestPlainTransformer:
    """With the tensors of a published DINO."""

    @pytest.fixture(autouse=True)
    def published(self, conversion, monkeypatch):
        made = json.loads(conversion(tiny("dino_tiny"), "dino_tiny")[1]["architecture"])
        monkeypatch.setitem(VARIANTS, "dino-test", Variant(**made | {"name": "dino-test"}))

    def test_must_be_named_or_called_another(self, conversion):
        told = refusal(conversion, tiny("dino_tiny"), "dino_tiny", custom=False)
        assert "--variant dino-test" in told
        assert "--custom" in told

    def test_is_dino_by_name(self, conversion, tmp_path):
        (tmp_path / "config.json").write_text(json.dumps({"layer_norm_eps": 1e-12}))  # of the port
        trained = tiny("dino_tiny") | {"head.mlp.0.weight": np.ones((3, 64), np.float32)}
        _, header, done = conversion(trained, "dino_tiny", variant="dino-test", custom=False)
        assert (done.variant.name, done.variant.norm_eps) == ("dino-test", 1e-6)
        assert header["licence"] == "Apache-2.0"

    def test_is_else_of_an_unknown_publisher(self, conversion):
        supervised = tiny("dino_tiny") | {"head.weight": np.ones((3, 64), np.float32)}
        told = refusal(conversion, supervised, "dino_tiny", variant="dino-test", custom=False)
        assert "'head.weight'" in told
        _, header, done = conversion(supervised, "dino_tiny")
        assert load_weights(done.path).variant.name == "custom"
        assert header["licence"] == "unknown license"


def test_provenance_and_licence_are_in_the_header(conversion):
    _, header, done = conversion(tiny())
    assert header["source"] == "source.safetensors"
    assert header["source_sha256"] == done.source_sha256
    assert "DINOv3 License" in header["licence_notice"]
    assert header["data_sha256"] == done.data_sha256
    assert json.loads(header["architecture"])["width"] == 64


def test_faults_are_listed_all_at_once(conversion):
    tensors = tiny()
    del tensors["blocks.1.ls1.gamma"], tensors["norm.bias"]
    tensors["blocks.0.mlp.fc3.weight"] = np.ones(3, np.float32)
    tensors["blocks.2.norm1.weight"] = np.ones(63, np.float32)
    told = refusal(conversion, tensors)
    assert "missing: norm.bias, blocks.1.scale1" in told
    assert "unexpected: blocks.0.mlp.fc3.weight" in told
    assert "of another shape: blocks.2.norm1.weight [63] instead of [64]" in told


def drop_block(tensors):
    return {k: v for k, v in tensors.items() if not k.startswith("blocks.1.")}


def name_like_timm(tensors):
    return {k.replace("patch_embed.proj", "patch_embed.conv"): v for k, v in tensors.items()}


def with_nan(tensors):
    return tensors | {"norm.bias": np.full(64, np.nan, np.float32)}


def with_other_mask(tensors):
    return tensors | {"blocks.0.attn.qkv.bias_mask": np.ones(192, np.float32)}


@pytest.mark.parametrize(
    ("spoil", "told"),
    [
        (drop_block, "blocks.1.down.weight and 8 more"),
        (name_like_timm, "no known key layout, which are: official .pth"),
        (with_nan, "'norm.bias' holds numbers that are not finite"),
        (with_other_mask, "is not 1, 0, 1 by thirds"),
        (lambda tensors: {"x": np.ones(2, np.float32)}, "its first keys are: x"),
        (lambda tensors: {}, "its first keys are: none"),
    ],
)
def test_damaged_content(conversion, spoil, told):
    assert told in refusal(conversion, spoil(tiny()))


def test_mask_of_the_key_bias_may_be_missing_or_nan(conversion):
    expected, _, _ = conversion(tiny())
    masks = [key for key in tiny() if key.endswith("bias_mask")]
    assert_same(conversion({k: v for k, v in tiny().items() if k not in masks})[0], expected)
    empty = {key: np.full(192, np.nan, np.float32) for key in masks}
    assert_same(conversion(tiny() | empty)[0], expected)


def test_mislabelled_file(conversion):
    told = refusal(conversion, tiny(), variant="dinov3-vitb16")
    assert "does not hold 'dinov3-vitb16' but a network of its own" in told
    with pytest.raises(ConfigError, match="did you mean 'dinov3-vitb16'"):
        conversion(tiny(), variant="dinov3-vitb61")


def test_rule_of_resampling_is_that_of_the_layout_or_the_callers(conversion):
    def rule(tensors, **wishes):
        return json.loads(conversion(tensors, "dino_tiny", **wishes)[1]["architecture"])["position"]

    published = as_hugging_face(tiny("dino_tiny"), "dino")
    assert rule(tiny("dino_tiny")) == "offset"
    assert rule(published) == "size"
    assert rule(published, position="offset") == "offset"


def test_sources_that_are_none(tmp_path):
    (tmp_path / "notes.txt").write_text("x")
    (tmp_path / "empty").mkdir()
    save_file(tiny(), tmp_path / "cut.safetensors")
    os.truncate(tmp_path / "cut.safetensors", 20_000)
    for name, told in (
        ("missing.pth", "does not exist"),
        ("notes.txt", "is no weight file"),
        ("empty", "holds no weight file"),
        ("cut.safetensors", "is damaged or of another form"),
    ):
        with pytest.raises(WeightsError, match=told):
            convert(tmp_path / name, tmp_path / "out.safetensors")


def test_nothing_is_overwritten_unasked(tmp_path):
    (tmp_path / "out.safetensors").write_text("precious")
    with pytest.raises(OutputError, match="exists"):
        convert(tmp_path / "a.safetensors", tmp_path / "out.safetensors")
    with pytest.raises(OutputError, match="must end in"):
        convert(tmp_path / "a.safetensors", tmp_path / "out.pth")
    assert (tmp_path / "out.safetensors").read_text() == "precious"
