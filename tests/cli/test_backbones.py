"""`remind backbones` lists what can be named, and a name is enough for a run."""

from __future__ import annotations

import dataclasses
import hashlib
import json

import numpy as np
import pytest
from safetensors.numpy import save

from remind_jax.backbone import published_weights, vit_weights
from remind_jax.backbone.published_weights import PUBLISHED
from remind_jax.backbone.registry import list_backbones
from remind_jax.backbone.vit_variants import VARIANTS
from remind_jax.cli import process
from tests.backbone.hub_networks import FILE, NAME, ask_there, published_network
from tests.backbone.local_hub import LocalHub
from tests.golden.vit.weights import official_shapes
from tests.weights_convert.hugging_face import as_hugging_face


@pytest.fixture
def published(tmp_path, monkeypatch):
    with published_network(tmp_path, monkeypatch) as it:
        yield it


@pytest.fixture
def nothing_here(tmp_path, monkeypatch):
    monkeypatch.setattr(vit_weights, "user_cache_folder", lambda: tmp_path / "cache")
    monkeypatch.delenv(vit_weights.WEIGHTS_VARIABLE, raising=False)


def rows(outcome) -> dict[str, dict]:
    assert (outcome.code, outcome.stderr) == (process.FINE, "")
    return {row["name"]: row for row in json.loads(outcome.stdout)}


def test_every_name_with_license_and_size(command, nothing_here):
    found = rows(command("backbones", "--json"))
    assert set(found) == set(list_backbones())
    for name, row in found.items():
        if name in VARIANTS:
            is_gated = name.startswith("dinov3")
            assert row["license"] == ("DINOv3 License" if is_gated else "Apache-2.0")
            assert row["weights"] == ("on request" if is_gated else "on first use")
            assert row["path"] is None
    small = found["dinov2-vits14"]
    assert (small["patch_px"], small["dim"], small["num_bytes"] >> 20) == (14, 384, 84)
    assert small["page"] == "https://huggingface.co/facebook/dinov2-small"
    assert found["patch-statistics"]["weights"] == "none needed"


def test_list_for_people(command, nothing_here):
    shown = command("backbones", "dinov2-vits14", "dinov3-vits16").stdout
    assert "Apache-2.0" in shown
    assert "Weights 'on request' are given out" in shown
    assert "your file" not in shown


def test_what_is_here(command, published):
    before = rows(command("backbones", NAME, "--json"))[NAME]
    assert before["weights"] == "on first use"
    assert published.kept == []
    folder = published.cache
    folder.mkdir(parents=True)
    command("backbones", "--json")
    assert published.hub.requests == []
    from remind_jax.backbone.weights_download import obtain_weights

    path = obtain_weights(NAME, quiet=True)
    after = rows(command("backbones", NAME, "--json"))[NAME]
    assert (after["weights"], after["path"]) == ("here", str(path))


def test_an_unknown_name(command):
    outcome = command("backbones", "dinov2-vits16")
    assert outcome.code == process.ERROR
    assert "did you mean 'dinov3-vits16' or 'dinov2-vits14'" in outcome.stderr


@pytest.mark.parametrize("verb", ["run", "sweep"])
def test_a_hub_without_it_ends_a_command_in_one_sentence(command, scene, published, verb):
    published.hub.behavior.missing = "RepoNotFound"
    more = ("--set", "decision.new=1.5,1.6") if verb == "sweep" else ()
    outcome = command(verb, scene[0], *more, "--backbone", NAME)
    assert outcome.code == process.ERROR
    announced, told, _ = outcome.stderr.split("\n")
    assert "fetching the weights" in announced
    assert "facebook/test/model.safetensors at" in told
    assert published.kept == []


@pytest.mark.slow
def test_a_run_with_dinov2_by_name(command, scene, tmp_path, monkeypatch):
    """The network of its real size and key layout, with random numbers."""
    monkeypatch.setattr(vit_weights, "user_cache_folder", lambda: tmp_path / "cache")
    shapes = official_shapes(
        "dinov2", 384, 12, 6, 14, mlp="mlp", hidden=1536, registers=0, grid=37, qkv_bias=True
    )
    rng = np.random.default_rng(0)
    made = {key: 0.02 * rng.standard_normal(s, np.float32) for key, s in shapes.items()}
    content = save(as_hugging_face(made, "dinov2"))
    entry = dataclasses.replace(
        PUBLISHED["dinov2-vits14"],
        sha256=hashlib.sha256(content).hexdigest(),
        num_bytes=len(content),
    )
    monkeypatch.setitem(published_weights.PUBLISHED, "dinov2-vits14", entry)
    assert entry.revision
    hub = LocalHub({f"facebook/dinov2-small/{FILE}": content}, entry.revision)
    with hub, ask_there(hub, tmp_path, monkeypatch):
        words = ("run", scene[0], "--masks", scene[1], "--backbone", "dinov2-vits14", "--json")
        outcome = command(*words, "--no-overlay")
    assert outcome.code == process.FINE, outcome.stderr
    assert json.loads(outcome.stdout)["complete"]
    kept = [path for path in (tmp_path / "cache" / "weights").rglob("*") if path.is_file()]
    assert {path.name for path in kept} == {"dinov2-vits14.safetensors", "dinov2-vits14.lock"}
