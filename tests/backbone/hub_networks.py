"""A small made network under a name of its own, published on a hub of this machine."""

from __future__ import annotations

import contextlib
import dataclasses
import hashlib
from collections.abc import Iterator
from pathlib import Path

import pytest
from safetensors.numpy import save

from remind_jax.backbone import published_weights, registry, vit_variants, vit_weights
from remind_jax.backbone.published_weights import PublishedWeights
from remind_jax.backbone.vit_weights import load_weights
from tests.backbone.local_hub import LocalHub
from tests.golden.vit import load as golden
from tests.weights_convert.hugging_face import as_hugging_face
from tests.weights_convert.pth_files import write_pth
from weights_convert.conversion import convert
from weights_convert.variant_detection import Wishes

NAME, REPOSITORY, REVISION = (
    "dinov2-test",
    "facebook/test",
    "0123456789abcdef0123456789abcdef01234567",
)
FILE, PLAIN = "model.safetensors", "authors/test_pretrain.pth"


@dataclasses.dataclass(frozen=True)
class Published:
    """A hub with one network on it, once as the hub has it and once as authors do."""

    hub: LocalHub
    content: bytes
    pickled: bytes
    cache: Path  # folder of converted weights
    monkeypatch: pytest.MonkeyPatch

    @property
    def kept(self) -> list[str]:
        """What is in the folder of weights, locks aside."""
        found = (p for p in self.cache.rglob("*") if p.is_file() and p.suffix != ".lock")
        return sorted(str(path.relative_to(self.cache)) for path in found)

    def publish(self, **changes: object) -> None:
        """Changes what the table says of the network."""
        entry = dataclasses.replace(published_weights.PUBLISHED[NAME], **changes)
        self.monkeypatch.setitem(published_weights.PUBLISHED, NAME, entry)

    def publish_plain(self, **changes: object) -> None:
        """Lets the table name a file of an authors' server."""
        entry = PublishedWeights(
            PLAIN.rpartition("/")[2],
            address=f"{self.hub.address}/{PLAIN}",
            sha256=hashlib.sha256(self.pickled).hexdigest(),
            num_bytes=len(self.pickled),
        )
        self.monkeypatch.setitem(published_weights.PUBLISHED, NAME, entry)
        self.publish(**changes)


@contextlib.contextmanager
def published_network(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Published]:
    """Serves the network, and lets `huggingface_hub` ask there."""
    official = golden.load("dinov2_tiny").official()
    content = save(as_hugging_face(official, "dinov2"))
    pickled = write_pth(tmp_path / "made.pth", official).read_bytes()
    (tmp_path / "made.safetensors").write_bytes(content)
    convert(tmp_path / "made.safetensors", tmp_path / "x.safetensors", wishes=Wishes(custom=True))
    found = load_weights(tmp_path / "x.safetensors").variant
    variant = dataclasses.replace(found, name=NAME, position="offset")
    monkeypatch.setitem(vit_variants.VARIANTS, NAME, variant)
    factory = f"remind_jax.backbone.vit_backbone:vit:{NAME}"
    monkeypatch.setitem(registry._factories, NAME, factory)
    monkeypatch.setattr(vit_weights, "user_cache_folder", lambda: tmp_path / "cache")
    monkeypatch.delenv(vit_weights.WEIGHTS_VARIABLE, raising=False)
    entry = PublishedWeights(
        FILE, REPOSITORY, REVISION, None, hashlib.sha256(content).hexdigest(), len(content)
    )
    monkeypatch.setitem(published_weights.PUBLISHED, NAME, entry)
    hub = LocalHub({f"{REPOSITORY}/{FILE}": content, PLAIN: pickled}, REVISION)
    with hub, ask_there(hub, tmp_path, monkeypatch):
        yield Published(hub, content, pickled, tmp_path / "cache" / "weights", monkeypatch)


@contextlib.contextmanager
def ask_there(hub: LocalHub, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """`huggingface_hub` in this process as if HF_ENDPOINT and HF_HOME had been set before."""
    from huggingface_hub import close_session, constants

    for name in ("NO_PROXY", "no_proxy"):
        monkeypatch.setenv(name, "127.0.0.1,localhost")
    for name in ("HF_TOKEN", "HUGGING_FACE_HUB_TOKEN", "HF_ENDPOINT", "HF_HUB_OFFLINE"):
        monkeypatch.delenv(name, raising=False)
    template = "/{repo_id}/resolve/{revision}/{filename}"
    monkeypatch.setattr(constants, "ENDPOINT", hub.address)
    monkeypatch.setattr(constants, "HUGGINGFACE_CO_URL_TEMPLATE", hub.address + template)
    monkeypatch.setattr(constants, "HF_HUB_OFFLINE", False)
    monkeypatch.setattr(constants, "HF_HUB_CACHE", str(tmp_path / "hf" / "hub"))
    monkeypatch.setattr(constants, "HF_TOKEN_PATH", str(tmp_path / "hf" / "token"))
    monkeypatch.setattr(constants, "HF_HUB_DOWNLOAD_TIMEOUT", 2)
    monkeypatch.setattr(constants, "HF_HUB_ETAG_TIMEOUT", 2)
    close_session()
    yield
    close_session()
