"""`remind backbones` lists what can be named, and a name is enough for a run."""

import json

import pytest

from remind_jax.backbone import vit_weights
from remind_jax.backbone.registry import list_backbones
from remind_jax.backbone.vit_variants import VARIANTS
from remind_jax.backbone.weights_download import obtain_weights
from remind_jax.cli import process
from tests.backbone.hub_networks import NAME, published_network


@pytest.fixture
def published(tmp_path, monkeypatch):
    return published_network(tmp_path, monkeypatch)


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
    assert published.hub.fetched == []
    path = obtain_weights(NAME, quiet=True)
    after = rows(command("backbones", NAME, "--json"))[NAME]
    assert (after["weights"], after["path"]) == ("here", str(path))


@pytest.mark.parametrize("verb", ["run", "sweep"])
def test_a_hub_without_it_ends_a_command_in_one_sentence(command, scene, published, verb):
    published.hub.error = OSError("no such repository")
    more = ("--set", "decision.new=1.5,1.6") if verb == "sweep" else ()
    outcome = command(verb, scene[0], *more, "--backbone", NAME)
    assert outcome.code == process.ERROR
    announced, told, _ = outcome.stderr.split("\n")
    assert "fetching the weights" in announced
    assert "facebook/test/model.safetensors at" in told
    assert published.kept == []
