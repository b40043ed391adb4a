"""`remind convert`: published files become ours, all others are answered in one sentence."""

import json

import pytest

from remind_jax.backbone import vit_weights
from remind_jax.backbone.vit_weights import load_weights
from remind_jax.cli import process
from tests.golden.vit import load as golden
from tests.weights_convert.pth_files import call_of, write_pth

TINY = ("--heads", 2, "--custom")


@pytest.fixture
def source(tmp_path):
    return write_pth(tmp_path / "tiny.pth", golden.load("dinov3_tiny_mlp").official())


def test_conversion_says_what_it_did(command, source):
    outcome = command("convert", source, "-o", "out.safetensors", *TINY)
    assert (outcome.code, outcome.stderr) == (0, "")
    for said in ("custom", "official .pth", "sha256", "DINOv3 License"):
        assert said in outcome.stdout
    assert load_weights("out.safetensors").variant.width == 64
    facts = json.loads(command("convert", source, "-o", "a.safetensors", *TINY, "--json").stdout)
    assert facts["data_sha256"] == load_weights("a.safetensors").sha256
    assert facts["layout"] == "official .pth"


def test_left_out_the_result_lies_where_backbones_look(command, source, tmp_path, monkeypatch):
    monkeypatch.setattr(vit_weights, "user_cache_folder", lambda: tmp_path / "cache")
    outcome = command("convert", source, *TINY, "--quiet")
    assert (outcome.code, outcome.stdout) == (0, "")
    assert load_weights(tmp_path / "cache" / "weights" / "custom.safetensors").params


def test_wrong_files_are_answered_in_one_sentence(command, source, tmp_path):
    truncated = tmp_path / "truncated.pth"
    truncated.write_bytes(source.read_bytes()[:-1000])
    corrupted = tmp_path / "corrupted.pth"
    data = bytearray(source.read_bytes())
    data[len(data) // 2] ^= 255
    corrupted.write_bytes(data)
    evil = write_pth(tmp_path / "evil.pth", {"bomb": call_of("os", "mkdir", "ran")})
    for words, told in (
        ((truncated,), "is damaged or cut short"),
        ((corrupted, *TINY), "is damaged or cut short (Bad CRC-32"),
        ((evil,), "asks for 'os.mkdir' to be run"),
        ((source, "--variant", "dinov3-vits16"), "does not hold 'dinov3-vits16'"),
        ((source,), "none of the published networks"),
        ((source, "--heads", 3, "--custom"), "64 features cannot be split among 3 attention heads"),
        ((tmp_path / "missing.pth",), "does not exist"),
        ((), "name the weight file to convert"),
    ):
        outcome = command("convert", *words, "-o", "out.safetensors")
        assert outcome.code == process.ERROR
        assert outcome.stderr.startswith("remind: ")
        assert outcome.stderr.count("\n") == 1
        assert told in outcome.stderr
    assert not (tmp_path / "out.safetensors").exists()
    assert not (tmp_path / "ran").exists()
